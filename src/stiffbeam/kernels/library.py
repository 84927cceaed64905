"""The library of the kernels, and the checks of what is handed to it: C checks nothing."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Mapping
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from . import compile as compilation

Int, Real, Address = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
_address_of, _buffer = ctypes.addressof, ctypes.c_char.from_buffer
FLOAT, INTEGER = np.dtype(np.float64), np.dtype(np.int64)


@cache
def library() -> ctypes.CDLL:
    """The compiled kernels; in a checkout they are compiled where the library is missing or of other sources.

    STIFFBEAM_KERNELS names another library. Its functions hold no GIL.
    """
    other = os.environ.get("STIFFBEAM_KERNELS")
    path = Path(other) if other else compilation.library_path()
    if not other and not path.exists():
        compilation.build()
    return ctypes.CDLL(os.fspath(path))


class Structure:
    """A structure of C: integers, then numbers, then arrays, in the order of the header.

    arrays: "name: shape", separated by semicolons, a shape in names of sizes and in numbers; "int" behind the name for
    integers, "?" for an array that may be left out or have no entries, for which C gets NULL.
    """

    def __init__(self, ints: str, reals: str, arrays: str) -> None:
        kinds, self.arrays, sizes = [(ints, Int), (reals, Real)], list[tuple[str, slice, Any, bool]](), list[str]()
        for entry in arrays.split(";"):
            left, shape = (side.split() for side in entry.split(":"))
            name, place = left[0].removesuffix("?"), slice(len(sizes), len(sizes) + len(shape))
            self.arrays.append((name, place, INTEGER if "int" in left else FLOAT, left[0].endswith("?")))
            sizes += shape
        names = [*ints.split(), *reals.split()]
        self.numbers, self.sizes = itemgetter(*names), itemgetter(*sizes)
        self.known = dict.fromkeys(names, 0) | {size: int(size) for size in sizes if size.isdigit()}
        fields = [(name, kind) for words, kind in kinds for name in words.split()]
        fields += [(name, Address) for name, *_ in self.arrays]
        self.type = type("Structure", (ctypes.Structure,), {"_fields_": fields})

    def __call__(self, sizes: Mapping[str, float], arrays: Mapping[str, Any]) -> Any:
        """The structure, by sizes and numbers and by arrays; numbers left out are 0.

        Raises TypeError for arrays of other shapes. The caller keeps the arrays as long as it is used.
        """
        known, given = {**self.known, **sizes}, arrays.get
        shapes, at = self.sizes(known), list[int | None]()
        for name, place, dtype, optional in self.arrays:
            x = given(name)
            at.append(None if optional and (x is None or not x.size) else address(x, shapes[place], dtype))
        return self.type(*self.numbers(known), *at)


def address(x: Any, shape: tuple[int, ...], dtype: Any = FLOAT, wanted: Any = True) -> int | None:
    """Address of an array of this type and shape, row by row; None, C's NULL, where it is not wanted.

    Raises TypeError for any other array. The caller keeps the array as long as the address is used.
    """
    if not wanted:
        return None
    if not isinstance(x, np.ndarray) or x.dtype != dtype or x.shape != shape or not (flags := x.flags).c_contiguous:
        given = f"{getattr(x, 'dtype', type(x).__name__)} {getattr(x, 'shape', '')}"
        raise TypeError(f"a kernel takes a {dtype} array of shape {shape}, row by row, not {given}")
    if not (flags.writeable and x.size):
        return x.ctypes.data
    # In a third of the time.
    return _address_of(_buffer(x))  # type: ignore[arg-type]


def filled(status: int) -> int:
    """A kernel's result. Raises MemoryError where it found no memory."""
    if status < 0:
        raise MemoryError("no memory for a kernel")
    return status
