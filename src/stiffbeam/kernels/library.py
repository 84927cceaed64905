"""The library of the kernels, and the checks of what is handed to it: C checks nothing."""

from __future__ import annotations

import ctypes
import math
import os
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from . import compile as compilation

Address, SCALARS = ctypes.c_void_p, dict[str, Any](Int=ctypes.c_int64, double=ctypes.c_double, void=None)
addressof, _buffer = ctypes.addressof, ctypes.c_char.from_buffer
FLOAT, INTEGER = np.dtype(np.float64), np.dtype(np.int64)


@cache
def declarations(header: str) -> str:
    """A header of the kernels without its comments."""
    text = (compilation.FOLDER / header).read_text(encoding="utf-8")
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


@cache
def library() -> ctypes.CDLL:
    """The compiled kernels; in a checkout they are compiled where the library is missing or of other sources.

    STIFFBEAM_KERNELS names another library. Its functions hold no GIL.
    """
    other = os.environ.get("STIFFBEAM_KERNELS")
    path = Path(other) if other else compilation.library_path()
    if not other and not path.exists():
        compilation.build()
    found = ctypes.CDLL(os.fspath(path))
    text = "".join(map(declarations, ("march.h", "rhs.h", "exact.h")))
    for result, name, arguments in re.findall(r"^API (\w+) (\w+)\(([^)]*)\);", text, re.MULTILINE):
        function, arguments = getattr(found, name), arguments.split(",")
        function.restype = SCALARS[result]
        function.argtypes = [Address if "*" in x else SCALARS[x.split()[0]] for x in arguments]
    return found


def function_address(name: str) -> int:
    """Address of a function of the library, for other C code."""
    return ctypes.cast(getattr(library(), name), ctypes.c_void_p).value or 0


class Structure:
    """A structure of C, as a header declares it with the shapes of its arrays, see SHAPE in law.h.

    An array that may be None or have no entries is NULL in C. parts: the structures within it, by type.
    """

    def __init__(self, header: str, name: str) -> None:
        declared = re.findall(rf"typedef struct \w*\s*{{([^}}]*)}} {name};", declarations(header))[0]
        fields, self.arrays = list[tuple[str, Any]](), list[tuple[str, list[str], Any, bool]]()
        self.parts = dict[str, Structure]()
        for declaration in declared.split(";")[:-1]:  # const double *w2 SHAPE(n), ...
            kind, names = re.sub(r"\b(const|struct) ", "", declaration).split(maxsplit=1)
            for star, field, macro, shape in re.findall(r"(\*?)(\w+)(?: (SHAPE|OR_NULL)\((.*?)\))?", names):
                if not star and kind not in {*SCALARS, *self.parts}:
                    self.parts[kind] = Structure(header, kind)
                fields.append((field, Address if star else SCALARS.get(kind) or self.parts[kind].type))
                if shape:
                    dtype = INTEGER if kind == "Int" else FLOAT
                    self.arrays.append((field, shape.split(", "), dtype, macro == "OR_NULL"))
        self.names = {field for field, _ in fields} - {field for field, *_ in self.arrays}
        sizes = {size for _, shape, *_ in self.arrays for size in shape}
        self.numbers = {size: int(size) for size in sizes if size.isdigit()}
        # Sizes that are sums of products of others.
        self.sums = {size: [x.split() for x in size.split(" + ")] for size in sizes if " " in size}
        own = {"_fields_": fields, "_as_parameter_": property(ctypes.addressof)}
        self.type = type("Structure", (ctypes.Structure,), own)

    def _known(self, sizes: dict[str, Any]) -> dict[str, Any]:
        """All sizes, from those of fields."""
        known = self.numbers | sizes
        for size, terms in self.sums.items():
            known[size] = sum(math.prod(int(x) if x.isdigit() else known.get(x, 0) for x in term) for term in terms)
        return known

    def new(self, given: Mapping[str, Any] | None = None, /, **numbers: Any) -> Any:
        """The structure with arrays of these sizes, those that are not ``given`` zero."""
        known = self._known(numbers)
        arrays = {name: np.zeros([known[x] for x in shape], dtype) for name, shape, dtype, _ in self.arrays}
        return self(arrays | dict(given or {}), **numbers)

    def __call__(self, arrays: Mapping[str, Any], **numbers: Any) -> Any:
        """The structure, which keeps its ``arrays``. A size that is not among the ``numbers`` is that of the first
        array that has it; what neither gives is 0.

        Raises TypeError for arrays of other shapes.
        """
        given = list[tuple[str, Any, list[str], Any]]()
        for name, shape, dtype, optional in self.arrays:
            if name not in arrays:
                raise TypeError(f"{name}: an array wanted, or None for none")
            x = arrays[name]
            if optional and (x is None or not x.size):
                continue
            given.append((name, x, shape, dtype))
            for size, length in zip(shape, getattr(x, "shape", ()), strict=False):
                if size not in self.sums:
                    numbers.setdefault(size, length)
        known = self._known(numbers)
        at = {name: address(x, tuple([known.get(k, -1) for k in shape]), dtype) for name, x, shape, dtype in given}
        structure: Any = self.type(**at, **{name: known[name] for name in self.names if name in known})
        structure.arrays = {name: x for name, x, *_ in given}
        return structure


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
