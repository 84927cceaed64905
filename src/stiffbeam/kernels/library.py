"""The library of the kernels, and the checks of what is handed to it: C checks nothing."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..basics.arrays import Array
from . import compile as compilation

Int, Real, Address = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
addressof, _buffer = ctypes.addressof, ctypes.c_char.from_buffer
FLOAT, INTEGER = np.dtype(np.float64), np.dtype(np.int64)


# The result and the arguments of every function: i integer, d number, p address, v nothing.
FUNCTIONS = {
    "march": "i ppp", "states": "v iiiiipppppp", "rigid_steps": "i p", "switch_time": "d dddddpd",
    "solve_node": "i ipppp", "contact_forces": "v ippppp",
    "exact_follow": "i ppdp", "exact_read": "i pppippppp", "exact_press": "i pppiipppp",
    "state_rate": "v dppp", "right_hand_side": "v dppp", "event_functions": "v dppp", "jacobian": "v dpddpiip",
}  # fmt: skip


@cache
def library() -> ctypes.CDLL:
    """The compiled kernels; in a checkout they are compiled where the library is missing or of other sources.

    STIFFBEAM_KERNELS names another library. Its functions hold no GIL.
    """
    other = os.environ.get("STIFFBEAM_KERNELS")
    path = Path(other) if other else compilation.library_path()
    if not other and not path.exists():
        compilation.build()
    found, kinds = ctypes.CDLL(os.fspath(path)), {"i": Int, "d": Real, "p": Address, "v": None}
    for name, signature in FUNCTIONS.items():
        function, (result, arguments) = getattr(found, name), signature.split()
        function.restype, function.argtypes = kinds[result], [kinds[x] for x in arguments]
    return found


class Structure:
    """A structure of C: integers, then numbers, then arrays, in the order of the header.

    arrays: "name: shape", separated by semicolons, a shape in numbers and in names of sizes; "int" behind the name for
    integers, "?" for an array that may be left out or have no entries, for which C gets NULL.
    """

    def __init__(self, ints: str, reals: str, arrays: str) -> None:
        self.names, self.arrays = [*ints.split(), *reals.split()], list[tuple[str, list[str], Any, bool]]()
        for entry in arrays.split(";"):
            left, shape = (side.split() for side in entry.split(":"))
            self.arrays.append((left[0].rstrip("?"), shape, INTEGER if "int" in left else FLOAT, "?" in left[0]))
        self.numbers = {size: int(size) for _, shape, *_ in self.arrays for size in shape if size.isdigit()}
        fields = [(name, Int) for name in ints.split()] + [(name, Real) for name in reals.split()]
        fields += [(name, Address) for name, *_ in self.arrays]
        own = {"_fields_": fields, "_as_parameter_": property(ctypes.addressof)}
        self.type = type("Structure", (ctypes.Structure,), own)

    def zeros(self, **sizes: int) -> dict[str, Array]:
        """All arrays, of these sizes."""
        known = self.numbers | sizes
        return {name: np.zeros([known[x] for x in shape], dtype) for name, shape, dtype, _ in self.arrays}

    def new(self, **sizes: int) -> Any:
        """The structure with ``arrays`` of its own of these sizes, zero."""
        arrays = self.zeros(**sizes)
        structure = self(arrays, **sizes)
        structure.arrays = arrays
        return structure

    def __call__(self, arrays: Mapping[str, Any], **numbers: float) -> Any:
        """The structure. A size that is not among the ``numbers`` is that of the first array that has it; what neither
        gives is 0.

        Raises TypeError for arrays of other shapes. The caller keeps the arrays as long as it is used.
        """
        known: dict[str, Any] = self.numbers | numbers
        at = list[int | None]()
        for name, shape, dtype, optional in self.arrays:
            x = arrays.get(name)
            if optional and (x is None or not x.size):
                at.append(None)
                continue
            for size, length in zip(shape, getattr(x, "shape", ()), strict=False):
                known.setdefault(size, length)
            at.append(address(x, tuple([known.get(size, -1) for size in shape]), dtype))
        return self.type(*[known.get(name, 0) for name in self.names], *at)


def address(x: Any, shape: tuple[int, ...], dtype: Any = FLOAT) -> int:
    """Address of an array of this type and shape, row by row.

    Raises TypeError for any other array. The caller keeps the array as long as the address is used.
    """
    if not isinstance(x, np.ndarray) or x.dtype != dtype or x.shape != shape or not (flags := x.flags).c_contiguous:
        given = f"{getattr(x, 'dtype', type(x).__name__)} {getattr(x, 'shape', '')}"
        raise TypeError(f"a kernel takes a {dtype} array of shape {shape}, row by row, not {given}")
    if not (flags.writeable and x.size):
        return x.ctypes.data
    # In a third of the time.
    return addressof(_buffer(x))  # type: ignore[arg-type]


def filled(status: int) -> int:
    """A kernel's result. Raises MemoryError where it found no memory."""
    if status < 0:
        raise MemoryError("no memory for a kernel")
    return status
