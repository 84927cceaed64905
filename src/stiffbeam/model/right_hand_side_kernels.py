"""The compiled method-of-lines equations: right-hand side, Jacobian, IDA's residual and the event functions.

Every function here reads the numbers of a system from one ``block`` of addresses and shapes, at the places of
``Equations``. Python and SUNDIALS therefore call the same machine code, SUNDIALS without Python in between
(``references.adaptive.sundials``). A function takes the arrays that it needs: whole tuples of them take numba
long to compile.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic
from numba.np.numpy_support import carray

from ..basics.arrays import Array, IntArray
from ..basics.compiled import compiled
from .contact_law import Law, damps, law_of, law_state, pull, side_force, side_slopes, slopes

THROUGH = 2  # regime of a contact that follows its law on both sides of its events


class Equations(NamedTuple):
    """The numbers of E y' = A y + loads + contact forces.

    n unknowns, m contacts, d + R functions of time: 1, sin w_1 t, cos w_1 t, ..., then R records, polynomials of P
    coefficients between ``edges``. A, the damping and E are sparse rows; E is empty where it is the identity.
    """

    row_starts: IntArray
    columns: IntArray
    entries: Array
    damping_row_starts: IntArray
    damping_columns: IntArray
    damping_entries: Array
    mass_row_starts: IntArray  # (size + 1,), with the identity of the integrals
    mass_columns: IntArray
    mass_entries: Array
    frequencies: Array
    edges: Array
    records: Array  # (edges, R P)
    loads: Array  # (d + R, n)
    power: Array  # (d + R, n), of the loads on the velocities
    pushes: Array  # (m, n), what a unit force of a contact adds to E y'
    position_rows: Array  # (m, n)
    velocity_rows: Array  # (m, n)
    acceleration_rows: Array  # (m, n), of E y'
    offsets: Array  # (d + R, m)
    law: Array  # (m, 6)
    lengths: Array  # (m,), of the contacts' motion
    regime: IntArray  # (m,), the side of each contact or THROUGH
    shifts: Array  # (3, m), offsets that are not compiled, their rates and accelerations
    levels: Array  # (roots,), at which an event function counts as zero
    window: Array  # (2,), the times at which records may be asked


(
    ROW_STARTS, COLUMNS, ENTRIES, DAMPING_ROW_STARTS, DAMPING_COLUMNS, DAMPING_ENTRIES, MASS_ROW_STARTS, MASS_COLUMNS,
    MASS_ENTRIES, FREQUENCIES, EDGES, RECORDS, LOADS, POWER, PUSHES, POSITION_ROWS, VELOCITY_ROWS, ACCELERATION_ROWS,
    OFFSETS, LAW, LENGTHS, REGIME, SHIFTS, LEVELS, WINDOW,
) = range(len(Equations._fields))  # fmt: skip
INTEGERS = {name for name, kind in Equations.__annotations__.items() if "IntArray" in str(kind)}
MATRICES = (
    "records", "loads", "power", "pushes", "position_rows", "velocity_rows", "acceleration_rows", "offsets", "law",
    "shifts",
)  # fmt: skip


def _pointer_to(kind: Any) -> Any:
    """Return what turns an address into a pointer to numbers of this kind, in compiled code."""

    def pointer(typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return types.CPointer(kind)(types.int64), generate

    return intrinsic(pointer)


_floats_at, _integers_at = _pointer_to(types.float64), _pointer_to(types.int64)


@compiled
def floats(address: int, size: int) -> Array:
    """Return the ``size`` doubles at ``address``."""
    return carray(_floats_at(address), (size,))


@compiled
def integers(address: int, size: int) -> IntArray:
    """Return the ``size`` integers at ``address``."""
    return carray(_integers_at(address), (size,))


@compiled
def _vector(block: IntArray, k: int) -> Array:
    return carray(_floats_at(block[3 * k]), (block[3 * k + 1],))


@compiled
def _indices(block: IntArray, k: int) -> IntArray:
    return carray(_integers_at(block[3 * k]), (block[3 * k + 1],))


@compiled
def _matrix(block: IntArray, k: int) -> Array:
    return carray(_floats_at(block[3 * k]), (block[3 * k + 1], block[3 * k + 2]))


def block_of(arrays: Equations) -> IntArray:
    """Return the block of ``arrays``, which have to outlive it."""
    # Kernels read bare addresses: another kind or layout would give wrong numbers and no error.
    block = np.zeros((len(arrays), 3), np.int64)
    for row, name, array in zip(block, Equations._fields, arrays, strict=True):
        kind = np.int64 if name in INTEGERS else np.float64
        if array.dtype != kind or not array.flags.c_contiguous or array.ndim != 1 + (name in MATRICES):
            raise TypeError(f"{name}: {array.dtype} {array.shape}")
        row[0], row[1 : 1 + array.ndim] = array.ctypes.data, array.shape
    return block.ravel()


@compiled
def functions_of_time(t: float, order: int, block: IntArray) -> Array:
    """Return the derivative of the given order, 0 to 2, of the d + R functions of time at t."""
    frequencies = _vector(block, FREQUENCIES)
    d = 1 + 2 * frequencies.size
    # The constant first: its derivatives are zero.
    g = np.zeros(block[3 * OFFSETS + 1])
    g[0] = 1.0 if order == 0 else 0.0
    for k in range(frequencies.size):
        w = frequencies[k]
        sine, cosine = np.sin(w * t), np.cos(w * t)
        if order == 0:
            g[1 + 2 * k], g[2 + 2 * k] = sine, cosine
        elif order == 1:
            g[1 + 2 * k], g[2 + 2 * k] = w * cosine, -w * sine
        else:
            g[1 + 2 * k], g[2 + 2 * k] = -w * w * sine, -w * w * cosine
    if g.size > d:
        _add_records(t, order, g[d:], block)
    return g


@compiled
def _add_records(t: float, order: int, out: Array, block: IntArray) -> None:
    """Write the derivatives of the records at t, kept within the window, into ``out``."""
    edges, records, window = _vector(block, EDGES), _matrix(block, RECORDS), _vector(block, WINDOW)
    inside = min(max(t, window[0]), window[1])
    # At the end of a window the polynomial before it holds.
    until = np.nextafter(window[1], -np.inf)
    # The last edge at or before t, by bisection.
    low, high = 0, edges.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if edges[middle] <= min(inside, until):
            low = middle
        else:
            high = middle
    s = inside - edges[low]
    P = records.shape[1] // out.size
    for r in range(out.size):
        value = 0.0
        # Horner's scheme on the derivative, whose factors are p (p - 1) ...
        for p in range(P - 1, order - 1, -1):
            factor = 1.0
            for q in range(order):
                factor *= p - q
            value = value * s + factor * records[low, r * P + p]
        out[r] = value


@compiled
def _add_product(matrix: int, sign: float, x: Array, out: Array, block: IntArray) -> None:
    """out += sign S x for the sparse rows S at ``matrix`` in the block."""
    starts, columns, entries = _indices(block, matrix), _indices(block, matrix + 1), _vector(block, matrix + 2)
    for i in range(starts.size - 1):
        total = 0.0
        for k in range(starts[i], starts[i + 1]):
            total += entries[k] * x[columns[k]]
        out[i] += sign * total


@compiled
def _motion(c: int, z: Array, g: Array, g_rate: Array, block: IntArray) -> tuple[float, float, float]:
    """Return position and velocity of contact c relative to its stop, and the offset's part of the velocity."""
    offsets, shifts = _matrix(block, OFFSETS), _matrix(block, SHIFTS)
    rows, velocity_rows = _matrix(block, POSITION_ROWS), _matrix(block, VELOCITY_ROWS)
    # The offset, from Python where it is not compiled, then its harmonics and records.
    u, rate = shifts[0, c], shifts[1, c]
    for k in range(g.size):
        u += offsets[k, c] * g[k]
        rate += offsets[k, c] * g_rate[k]
    # The motion of the contact point.
    v = rate
    for i in range(rows.shape[1]):
        u += rows[c, i] * z[i]
        v += velocity_rows[c, i] * z[i]
    return u, v, rate


@compiled
def _side(c: int, u: float, v: float, stop: Law, block: IntArray) -> int:
    """Return the side on which contact c presses: that of its regime, or of its law."""
    chi = _indices(block, REGIME)[c]
    return int(law_state(u, v, stop)) if chi == THROUGH else chi


@compiled
def right_hand_side(t: float, z: Array, out: Array, block: IntArray) -> None:
    """out = A y with the loads and contact forces of the regime, then the rates of the ledger's integrals."""
    loads, power, pushes, law = (
        _matrix(block, LOADS), _matrix(block, POWER), _matrix(block, PUSHES), _matrix(block, LAW),
    )  # fmt: skip
    n, m = loads.shape[1], law.shape[0]
    g, g_rate = functions_of_time(t, 0, block), functions_of_time(t, 1, block)
    taken, absorbed = 0.0, 0.0
    out[:] = 0.0
    # The viscous power y^T D y, with ``out`` as its work space.
    if block[3 * DAMPING_ENTRIES + 1]:
        _add_product(DAMPING_ROW_STARTS, 1.0, z, out, block)
        for i in range(n):
            taken += out[i] * z[i]
            out[i] = 0.0
    # The linear part.
    _add_product(ROW_STARTS, 1.0, z, out, block)
    # Loads, and the power that they supply.
    given = 0.0
    for k in range(g.size):
        weight = 0.0
        for i in range(n):
            out[i] += loads[k, i] * g[k]
            weight += power[k, i] * z[i]
        given += weight * g[k]
    # Contacts: force, power of moving stops, impulse, and what damped stops take.
    for c in range(m):
        stop = law_of(law, c)
        u, v, rate = _motion(c, z, g, g_rate, block)
        chi, push = _side(c, u, v, stop, block), 0.0
        if chi != 0:
            force = side_force(u, v, chi, stop)
            for i in range(n):
                out[i] += pushes[c, i] * force
            given -= force * rate
            push = -force
            if damps(stop):
                absorbed -= force * v
        out[n + 2 + c] = push
    # The integrals of the ledger, behind the state.
    out[n], out[n + 1] = given, taken
    if out.size > n + 2 + m:
        out[n + 2 + m] = absorbed


@compiled
def residual(t: float, z: Array, rate: Array, out: Array, block: IntArray) -> None:
    """out = E z' - f(t, z)."""
    right_hand_side(t, z, out, block)
    for i in range(out.size):
        out[i] = -out[i]
    _add_product(MASS_ROW_STARTS, 1.0, rate, out, block)


@compiled
def jacobian(t: float, z: Array, cj: float, sign: float, J: Array, first: int, stride: int, block: IntArray) -> None:
    """J[first + i + j stride] = cj E_ij + sign df_i/dz_j, which is dense or banded storage by columns.

    The rows of the integrals stay zero in df/dz: nothing depends on them. Entries outside a band are not stored, nor
    do they occur: the band holds A, E and the pushes.
    """
    pushes, law = _matrix(block, PUSHES), _matrix(block, LAW)
    rows, velocity_rows = _matrix(block, POSITION_ROWS), _matrix(block, VELOCITY_ROWS)
    n = pushes.shape[1]
    # E and A, by their nonzero entries.
    J[:] = 0.0
    for matrix, factor in ((MASS_ROW_STARTS, cj), (ROW_STARTS, sign)):
        starts, columns, entries = _indices(block, matrix), _indices(block, matrix + 1), _vector(block, matrix + 2)
        for i in range(starts.size - 1):
            for k in range(starts[i], starts[i + 1]):
                J[first + i + columns[k] * stride] += factor * entries[k]
    # Contacts that press: the slopes of their forces in positions and velocities.
    g, g_rate = functions_of_time(t, 0, block), functions_of_time(t, 1, block)
    for c in range(law.shape[0]):
        stop = law_of(law, c)
        u, v, _ = _motion(c, z, g, g_rate, block)
        chi = _side(c, u, v, stop, block)
        slope, to_rate = side_slopes(u, v, chi, stop)
        if slope == 0.0 and to_rate == 0.0:
            continue
        for i in range(n):
            for j in range(n):
                weight = pushes[c, i] * (slope * rows[c, j] + to_rate * velocity_rows[c, j])
                # Outside a band J has no place for a zero.
                if weight != 0.0:
                    J[first + i + j * stride] -= sign * weight


@compiled
def event_functions(t: float, z: Array, out: Array, block: IntArray) -> None:
    """out = u - g2 and g1 - u of every stop, > 0 in it, then their rates, less the levels.

    Of a damped stop, instead of its gap, what is > 0 where it presses: the lesser of gap and force, as a length. With
    one among the stops a third row follows: the rates of the forces of the damped ones, else of the gaps.
    """
    # Rows of the output: two, or three where a stop damps.
    law, levels = _matrix(block, LAW), _vector(block, LEVELS)
    damped = False
    for c in range(law.shape[0]):
        damped = damped or damps(law_of(law, c))
    sides = out.size // 3 if damped else out.size // 2
    g, g_rate = functions_of_time(t, 0, block), functions_of_time(t, 1, block)
    k = 0
    for c in range(law.shape[0]):
        stop = law_of(law, c)
        u, v, _ = _motion(c, z, g, g_rate, block)
        # The acceleration takes another right-hand side: only a damped stop needs it.
        acceleration = _acceleration(c, t, z, block) if damps(stop) else 0.0
        for side in (1.0, -1.0):
            if not np.isfinite(stop.g2 if side > 0.0 else stop.g1):
                continue
            gap, rate = (u - stop.g2 if side > 0.0 else stop.g1 - u), side * v
            out[k], out[sides + k] = gap, rate
            if damped:
                out[2 * sides + k] = rate
                if damps(stop):
                    to_depth, to_rate = slopes(gap, rate, stop)
                    out[2 * sides + k] = to_depth * rate + to_rate * side * acceleration
                    # A damped stop lets go before its gap opens: its event is the lesser of gap and force.
                    out[k] = min(gap, pull(gap, rate, _vector(block, LENGTHS)[c], stop))
            k += 1
    for k in range(out.size):
        out[k] -= levels[k]


@compiled
def event_functions_at(t: Array, z: Array, out: Array, block: IntArray) -> None:
    """The event functions at times t (k,) with states z (k, n), in the rows of ``out``."""
    for k in range(t.size):
        event_functions(t[k], z[k], out[k], block)


@compiled
def _acceleration(c: int, t: float, z: Array, block: IntArray) -> float:
    """Return the acceleration of contact c relative to its stop."""
    offsets, rows = _matrix(block, OFFSETS), _matrix(block, ACCELERATION_ROWS)
    forces, g = np.empty(z.size), functions_of_time(t, 2, block)
    # From the forces of the regime, as the right-hand side has them.
    right_hand_side(t, z, forces, block)
    total = _matrix(block, SHIFTS)[2, c]
    for k in range(g.size):
        total += offsets[k, c] * g[k]
    for i in range(rows.shape[1]):
        total += rows[c, i] * forces[i]
    return total
