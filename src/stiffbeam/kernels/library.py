"""The library of the kernels, and the checks of what is handed to it: C checks nothing."""

from __future__ import annotations

import ctypes
import os
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from . import compile as compilation

Int, Real, Address = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
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


def structure(name: str, ints: str, reals: str, arrays: str) -> Any:
    """A structure of integers, then numbers, then addresses, in the order of the header."""
    kinds = [(ints, Int), (reals, Real), (arrays, Address)]
    fields = [(field, kind) for names, kind in kinds for field in names.split()]
    return type(name, (ctypes.Structure,), {"_fields_": fields})


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
    return ctypes.addressof(ctypes.c_char.from_buffer(x))  # type: ignore[arg-type]


def filled(status: int) -> int:
    """A kernel's result. Raises MemoryError where it found no memory."""
    if status < 0:
        raise MemoryError("no memory for a kernel")
    return status
