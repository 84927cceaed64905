"""The equations of an adaptive solver, E y' = f(t, y): the structure and the functions of rhs.h."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.sparse

from ..basics.arrays import Array
from .library import FLOAT, Structure, address, library

THROUGH = 2  # regime of a contact that follows its law on both sides of its events

EQUATIONS = Structure("rhs.h", "Equations")


def equations(
    arrays: Mapping[str, Any], matrices: Mapping[str, Array], size: int, bandwidths: Any, **flags: bool
) -> Any:
    """The structure of rhs.h from its ``arrays``, from the ``matrices`` A, D and E, and from its ``flags``.

    bandwidths: of a Jacobian of SUNDIALS, None for a full one.
    """
    rows = dict[str, Any]()
    for name, matrix in matrices.items():
        sparse = scipy.sparse.csr_array(matrix)
        columns = {"starts": sparse.indptr.astype(np.int64), "columns": sparse.indices.astype(np.int64)}
        rows[name] = EQUATIONS.parts["Rows"](columns | {"entries": sparse.data})
    # Entry (i, j) of a Jacobian at first + i + j stride: the storage of SUNDIALS.
    first, stride = 0, size
    if bandwidths is not None:
        first = min(size - 1, sum(bandwidths))  # upper bandwidth of the factors
        stride = first + bandwidths[0]
    structure = EQUATIONS(arrays, size=size, first=first, stride=stride, **flags, **rows)
    structure.rows = rows  # which keep their arrays
    return structure


def function_address(name: str) -> int:
    """Address of a function of the library, for other C code."""
    return ctypes.cast(getattr(library(), name), ctypes.c_void_p).value or 0


def evaluated(name: str, t: float, z: Array, results: int, structure: Any) -> Array:
    """The ``results`` of a function of a time and a state."""
    if z.dtype != FLOAT or z.shape != (structure.size,):
        raise TypeError(f"{name} takes a float64 array of shape {(structure.size,)}, not {z.dtype} {z.shape}")
    out = (ctypes.c_double * results)()
    # Solvers call this for each evaluation: ctypes takes bytes in a tenth of the time of an array's address.
    getattr(library(), name)(t, z.tobytes(), out, structure)
    return np.frombuffer(out)  # type: ignore[call-overload]


def jacobian(t: float, z: Array, structure: Any) -> Array:
    """df/dz, (size, size), the rows of the integrals zero."""
    N = structure.size
    J = np.zeros((N, N))
    library().jacobian(t, address(z, (N,)), 0.0, 1.0, address(J, (N, N)), 0, N, structure)
    return J.T
