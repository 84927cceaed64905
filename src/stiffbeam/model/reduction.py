"""Thousands of unknowns in the modes that matter: a small System from sparse matrices.

    q = T z,   T = [phi_1 .. phi_k, K^-1 p for every load, contact and observed row p],   T^T M T = I

Galerkin's projection on the lowest k modes and on what the forces do statically. So the deflection under a constant
force of any load or contact is exact whatever k is (static correction), and the dynamic error is that of the modes
left out, at frequency w of the order (w/w_{k+1})^4. Unknowns without mass follow the others statically. No dense
n x n matrix is made, only one sparse factor of K.

Source: Craig, Structural Dynamics (1981), Section 19 (residual attachment modes).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.resources import afford
from ..basics.validation import InputError, integer, vector
from .contact import Contact
from .modes import uncoupled
from .system import ModelData, System, asymmetry, contacts_of, loads_of
from .time_functions import LoadFunction

DENSE = 600  # unknowns up to which all modes are computed: Lanczos' method needs more than it looks for
ROUNDING = 1e-13  # of the largest eigenvalue of K^-1 M, and of the largest pivot of K: a smaller one is zero
INDEPENDENT = 1e-10  # of its size: a static deflection that has less left beside the modes adds nothing
LOST = 1e-3  # of the norm of initial data, and of the strain of a deflection: more is told


def reduce_model(
    mass: Any,
    stiffness: Any,
    damping: Any = None,
    loads: Sequence[tuple[ArrayLike, LoadFunction]] = (),
    contacts: Sequence[Contact] = (),
    modes: int = 40,
    **data: Unpack[ModelData],
) -> tuple[System, Array]:
    """Return a large system reduced to natural modes and static deflections, and T (n, r) with q = T z.

    Warns where T lacks a part of the initial data.

    Parameters
    ----------
    mass, stiffness, damping : array (n, n)
        Dense or SciPy sparse. Unknowns may be without mass.
    loads, contacts
        As for ``System.from_matrices``.
    modes : int
        Number of natural modes to keep.
    **data
        observe, initial_displacement, initial_velocity and units as for ``System.from_matrices``.

    Returns
    -------
    system : System
        Of the r unknowns z, diagonal without damping.
    basis : array (n, r)
        T. A row of the large model becomes ``row @ basis``.

    Raises
    ------
    InputError
        For a stiffness that does not hold the system, for as many modes as the mass matrix has rank, for a load that
        moves no mass, and as ``System`` does.

    Examples
    --------
    >>> import numpy as np
    >>> import stiffbeam as sb
    >>> chain, end = 2.0 * np.eye(200) - np.eye(200, k=1) - np.eye(200, k=-1), np.eye(200)[-1]
    >>> system, basis = sb.reduce_model(np.eye(200), chain, observe=end, modes=10)
    >>> system.size, basis.shape
    (11, (200, 11))
    """
    M, K = _sparse("mass", mass), _sparse("stiffness", stiffness)
    n = int(M.shape[0])
    if K.shape != M.shape:
        raise InputError("stiffness", K.shape, f"have the shape of the mass, {M.shape}", "give one for each unknown")
    integer("modes", modes, 1)
    pairs, all_contacts = loads_of(loads, n), contacts_of(contacts, n)
    vectors = {name: vector(name, x, n) for name, x in data.items() if name != "units" and x is not None}
    rows = [*(p for p, _ in pairs), *(contact.row for contact in all_contacts)]
    rows = np.array(rows + [vectors[x] for x in vectors if x == "observe"]).reshape(-1, n).T
    T, squares = _basis(M, K, rows, modes)
    C = np.zeros((len(squares), len(squares)))
    if damping is not None:  # without its rounding, so that what couples no modes couples none here
        D = _sparse("damping", damping)
        C = uncoupled(D, T, M, K, squares == 0.0)
        C = C if (D != D.T).nnz else 0.5 * (C + C.T)
    # Initial data by projection.
    changed: Any = {name: T.T @ (x if name == "observe" else M @ x) for name, x in vectors.items()}
    reduced_loads = [(T.T @ p, f) for p, f in pairs]
    reduced_contacts = [replace(contact, row=T.T @ contact.row) for contact in all_contacts]
    matrices = np.eye(len(squares)), np.diag(squares), C
    system = System.from_matrices(*matrices, reduced_loads, reduced_contacts, **(data | changed))
    for name, x in vectors.items():
        norm = x @ (M @ x) if name != "observe" else 0.0
        lost = np.sqrt(max(0.0, 1.0 - changed[name] @ changed[name] / norm)) if norm > 0.0 else 0.0
        if lost > LOST:
            warnings.warn(f"{modes} modes lose {lost:.2g} of the {name}", stacklevel=2)
    return system, T


def _sparse(name: str, matrix: Any) -> Any:
    """``matrix`` in SciPy's sparse columns; InputError where it is not square, or not symmetric as in a System."""
    try:
        sparse: Any = scipy.sparse.csc_array(matrix, dtype=float)
        error = None if name == "damping" else asymmetry(name, sparse)
    except (TypeError, ValueError):
        raise InputError(name, matrix, "be a square matrix", "give one row and column for each unknown") from None
    if error is not None:
        raise error
    return sparse


def _basis(M: Any, K: Any, rows: Array, modes: int) -> tuple[Array, Array]:
    """T (n, r), with the static deflections under the rows (n, k), and the squares of the frequencies in it (r,)."""
    strainless = InputError("stiffness", "a motion without strain", "hold the system", "support it")
    try:
        factor = scipy.sparse.linalg.splu(K)
    except RuntimeError:  # only for an exactly singular K
        raise strainless from None
    pivots = np.abs(factor.U.diagonal())
    if np.min(pivots) < ROUNDING * np.max(pivots):
        raise strainless
    # Natural modes M x = x/w^2 K x by Lanczos' method, where it has room for more vectors than it looks for.
    n = M.shape[0]
    if n > DENSE and modes < np.unique(M.nonzero()[0]).size // 4:
        start = np.random.default_rng(0).normal(size=n)  # the same modes in every process
        T = scipy.sparse.linalg.eigsh(K, modes, M, sigma=0.0, v0=start)[1]
    else:
        afford("modes", modes, "ask for fewer", floats=4.0 * n * n)
        squares, shapes = scipy.linalg.eigh(M.toarray(), K.toarray())  # 1/w^2, zero of an unknown without mass
        rank = np.count_nonzero(squares > ROUNDING * squares[-1])
        if modes >= rank or squares[0] < -ROUNDING * squares[-1]:
            rule = f"be positive semidefinite, of a rank above {modes}"
            raise InputError("mass", f"rank {rank}", rule, "ask for fewer modes, or look at its signs")
        T = shapes[:, -modes:] / np.sqrt(squares[-modes:])
    # Of the static deflection of every force what it has beside the modes, in the metric of M.
    for static in factor.solve(rows).T:
        beside = static - T @ (T.T @ (M @ static))
        beside = beside - T @ (T.T @ (M @ beside))  # twice, for orthogonality to rounding
        size, whole = (np.sqrt(x @ (M @ x)) for x in (beside, static))
        if size > INDEPENDENT * whole:
            T = np.column_stack([T, beside / size])
        elif beside @ (K @ beside) > LOST * (static @ (K @ static)):
            rule, remedy = "move mass beside the modes", "leave it out, or give its unknowns mass"
            raise InputError("loads, contacts and observe", "a row that bends massless unknowns alone", rule, remedy)
    # A diagonal system again: the appended deflections are no modes.
    small = T.T @ (K @ T)
    squares, turn = scipy.linalg.eigh(0.5 * (small + small.T), T.T @ (M @ T))
    return T @ turn, squares
