"""Checks of the matrices and vectors that a system is made of."""

from __future__ import annotations

from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array, is_read_only, read_only
from ..basics.budget import afford
from ..basics.validation import InputError, numbers

_DEFINITE: WeakValueDictionary[tuple[str, int], Array] = WeakValueDictionary()  # read-only matrices once looked at


def symmetric_matrix(name: str, matrix: Any, n: int | None = None) -> Array:
    """``matrix`` as a read-only float array (n, n); InputError where it is not square, finite and symmetric."""
    if isinstance(matrix, np.ndarray) and _DEFINITE.get((name, id(matrix))) is matrix and n in (None, len(matrix)):
        return matrix
    remedy = "give a list of rows, a NumPy array or a SciPy sparse matrix"
    if isinstance(matrix, np.ndarray) and is_read_only(matrix):
        dense = matrix
    else:
        dense = read_only(numbers(name, _dense(name, matrix), "be a matrix of finite numbers", remedy))
    if dense.ndim != 2 or dense.shape[0] != dense.shape[1] or (n is not None and len(dense) != n) or not dense.size:
        rule = "be a square matrix" if n is None else f"have shape ({n}, {n})"
        raise InputError(name, f"shape {dense.shape}", rule, "one row and one column per unknown")
    if not np.all(np.isfinite(dense)):
        raise InputError(name, "an entry that is not finite", "be finite", "look at what it was computed from")
    if np.array_equal(dense, dense.T):
        return dense
    size = np.sqrt(np.abs(np.diag(dense)))
    if np.any(np.abs(dense - dense.T) > 1e-12 * np.outer(size, size)):
        rule = "be symmetric to 1e-12 of its diagonal there"
        raise InputError(name, "an unsymmetric matrix", rule, "gyroscopic terms have no place")
    return read_only(0.5 * (dense + dense.T))


def _dense(name: str, matrix: Any) -> Any:
    """A SciPy sparse matrix in full."""
    if not hasattr(matrix, "toarray") or isinstance(matrix, type):
        return matrix
    afford(name, f"shape {matrix.shape}", "condense the model", floats=float(np.prod(matrix.shape, dtype=float)))
    return matrix.toarray()


def definite_matrix(name: str, matrix: Array) -> Array:
    """The matrix once it is known to be positive semidefinite, the mass positive definite; looked at once."""
    if _DEFINITE.get((name, id(matrix))) is matrix:
        return matrix
    if name == "mass":
        if not _factorises(matrix):
            remedy, least = "stiffbeam.reduced condenses unknowns without mass", np.linalg.eigvalsh(matrix)[0]
            raise InputError(name, f"least eigenvalue {least:.3g}", "be positive definite", remedy)
    elif (least := _least(matrix)) < -1e-10:
        rule, remedy = "be positive semidefinite", "look at its signs"
        raise InputError(name, f"least eigenvalue {least:.3g}, its diagonal scaled to ones", rule, remedy)
    _DEFINITE[name, id(matrix)] = matrix
    return matrix


def _least(matrix: Array) -> float:
    """The least eigenvalue with the diagonal scaled to ones, which keeps its sign: what is soft may not be hidden
    by what is stiff."""
    diagonal = np.diag(matrix)
    size = np.sqrt(np.abs(diagonal))
    size = np.where(size > 0.0, size, 1.0)
    if np.count_nonzero(matrix) == np.count_nonzero(diagonal):
        return float(np.min(diagonal / size / size))
    return float(np.linalg.eigvalsh(matrix / size / size[:, None])[0])


def _factorises(matrix: Array) -> bool:
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True


def finite_vector(name: str, vector: ArrayLike, n: int) -> Array:
    """``vector`` as a read-only float array (n,); InputError where it is not n finite numbers."""
    given = vector if isinstance(vector, np.ndarray) and is_read_only(vector) else numbers(name, vector)
    array = read_only(given if given.ndim == 1 else given.ravel())
    if array.shape != (n,):
        raise InputError(name, array, f"be {n} finite numbers", "one per unknown")
    return array
