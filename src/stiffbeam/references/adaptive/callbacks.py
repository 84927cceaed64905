"""The equations of ``right_hand_side_kernels`` as C functions that CVODE and IDA call without Python.

SUNDIALS hands over its vectors and matrices as structures. Of a serial vector and of a dense or banded matrix the first
member is the address of a content, in which the numbers' address stands at ``VECTOR``, ``DENSE`` or ``BAND``
(``sundials_library`` verifies this once against the library's own functions). The user data is the address of four
numbers: those of the block, its length, the number of unknowns and the number of event functions.
"""

from __future__ import annotations

from numba import types

from ...basics.arrays import Array, IntArray
from ...basics.compiled import called_from_c, compiled
from ...model.right_hand_side_kernels import event_functions, floats, integers, jacobian, residual, right_hand_side

VECTOR, DENSE, BAND = 1, 1, 3  # words of 8 bytes into the content; indices of SUNDIALS have 4 bytes
USER = 6  # words of the user data: block, its length, unknowns, event functions, first, stride (see jacobian)

REAL, ADDRESS, INT = types.float64, types.int64, types.int32


@compiled
def numbers_of(structure: int, word: int, size: int) -> Array:
    """Return the ``size`` numbers of a vector or matrix of SUNDIALS."""
    content = integers(structure, 1)[0]
    return floats(integers(content, word + 1)[word], size)


@compiled
def block_in(user: IntArray) -> IntArray:
    """Return the block of the equations."""
    return integers(user[0], user[1])


@compiled
def fill(t: float, y: int, matrix: int, data: int, cj: float, sign: float) -> None:
    """Write cj E + sign df/dz into a matrix of SUNDIALS."""
    user = integers(data, USER)
    size, first, stride = user[2], user[4], user[5]
    word = DENSE if stride == size else BAND
    J = numbers_of(matrix, word, size * (stride if word == DENSE else stride + 1))
    jacobian(t, numbers_of(y, VECTOR, size), cj, sign, J, first, stride, block_in(user))


@called_from_c(INT(REAL, ADDRESS, ADDRESS, ADDRESS))
def cvode_right_hand_side(t: float, y: int, rate: int, data: int) -> int:
    """CVRhsFn."""
    user = integers(data, USER)
    right_hand_side(t, numbers_of(y, VECTOR, user[2]), numbers_of(rate, VECTOR, user[2]), block_in(user))
    return 0


@called_from_c(INT(REAL, ADDRESS, ADDRESS, ADDRESS))
def cvode_events(t: float, y: int, out: int, data: int) -> int:
    """CVRootFn."""
    user = integers(data, USER)
    event_functions(t, numbers_of(y, VECTOR, user[2]), floats(out, user[3]), block_in(user))
    return 0


@called_from_c(INT(REAL, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS))
def cvode_jacobian(t: float, y: int, rate: int, matrix: int, data: int, a: int, b: int, c: int) -> int:
    """CVLsJacFn."""
    fill(t, y, matrix, data, 0.0, 1.0)
    return 0


@called_from_c(INT(REAL, ADDRESS, ADDRESS, ADDRESS, ADDRESS))
def ida_residual(t: float, y: int, rate: int, out: int, data: int) -> int:
    """IDAResFn."""
    user = integers(data, USER)
    size = user[2]
    y_, rate_, out_ = numbers_of(y, VECTOR, size), numbers_of(rate, VECTOR, size), numbers_of(out, VECTOR, size)
    residual(t, y_, rate_, out_, block_in(user))
    return 0


@called_from_c(INT(REAL, ADDRESS, ADDRESS, ADDRESS, ADDRESS))
def ida_events(t: float, y: int, rate: int, out: int, data: int) -> int:
    """IDARootFn."""
    user = integers(data, USER)
    event_functions(t, numbers_of(y, VECTOR, user[2]), floats(out, user[3]), block_in(user))
    return 0


@called_from_c(INT(REAL, REAL, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS, ADDRESS))
def ida_jacobian(
    t: float, cj: float, y: int, rate: int, res: int, matrix: int, data: int, a: int, b: int, c: int
) -> int:
    """IDALsJacFn."""
    fill(t, y, matrix, data, cj, -1.0)
    return 0
