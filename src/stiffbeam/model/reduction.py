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
from .modes import damping_ratios, uncoupled
from .system import ModelData, System, contacts_of, loads_of, unsymmetric
from .time_functions import LoadFunction

DENSE = 600  # unknowns up to which all modes are computed: Lanczos' method needs more than it looks for
MASSLESS = 1e-13  # of the largest eigenvalue of K^-1 M: a smaller one is rounding of 0
INDEPENDENT = 1e-10  # of its size: a static deflection that has less left beside the modes adds nothing
LOST = 1e-3  # of the norm of initial data, and of the strain energy of a deflection: more is worth a warning
HELD = 1e-13  # of the largest pivot: a smaller one is a motion that nothing holds


def reduce_model(
    mass: Any,
    stiffness: Any,
    damping: Any = None,
    loads: Sequence[tuple[ArrayLike, LoadFunction]] = (),
    contacts: Sequence[Contact] = (),
    modes: int = 40,
    modal_damping: float | Sequence[float] = 0.0,
    **data: Unpack[ModelData],
) -> tuple[System, Array]:
    """Return a large system reduced to natural modes and static deflections, and T (n, r) with q = T z.

    Warns where T holds too little of the initial data or of a static deflection, such as that of a load on unknowns
    without mass.

    Parameters
    ----------
    mass, stiffness, damping : array (n, n)
        Dense or SciPy sparse. Unknowns may be without mass.
    loads, contacts
        As for ``System.from_matrices``.
    modes : int
        Number of natural modes to keep.
    modal_damping : float or sequence of float, optional
        Damping ratio of every mode of the reduced system, or of its first ones; added to ``damping``.
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
        For a stiffness that does not hold the system, for as many modes as the mass matrix has rank, for a mass matrix
        with a negative eigenvalue, and as ``System`` does.

    Examples
    --------
    >>> import numpy as np
    >>> import stiffbeam as sb
    >>> n = 200
    >>> stiffness = n**2 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    >>> contact = sb.Contact(np.eye(n)[-1], sb.Stops(upper=0.1, stiffness=1e4))
    >>> system, basis = sb.reduce_model(np.eye(n), stiffness, contacts=[contact], modes=10)
    >>> system.size, basis.shape
    (11, (200, 11))
    """
    M, K = (_square(name, x, symmetric=True) for name, x in (("mass", mass), ("stiffness", stiffness)))
    n = int(M.shape[0])
    if K.shape != M.shape:
        raise InputError("stiffness", K.shape, f"have the shape of the mass, {M.shape}", "give one for each unknown")
    integer("modes", modes, 1)
    pairs, all_contacts = loads_of(loads, n), contacts_of(contacts, n)
    vectors = {name: vector(name, x, n) for name, x in data.items() if name != "units" and x is not None}
    rows = [*(p for p, _ in pairs), *(contact.row for contact in all_contacts)]
    rows = np.array(rows + [vectors[x] for x in vectors if x == "observe"]).reshape(-1, n).T
    T, squares, statics = _basis(M, K, rows, modes)
    C = np.diag(2.0 * damping_ratios(modal_damping, len(squares)) * np.sqrt(squares))
    if damping is not None:  # without its rounding, so that what couples no modes couples none here
        D = _square("damping", damping)
        reduced = uncoupled(D, T, M, K, squares == 0.0)
        C = C + (reduced if (D != D.T).nnz else 0.5 * (reduced + reduced.T))
    # Initial data by projection.
    changed: Any = {name: T.T @ (x if name == "observe" else M @ x) for name, x in vectors.items()}
    reduced_loads = [(T.T @ p, f) for p, f in pairs]
    reduced_contacts = [replace(contact, row=T.T @ contact.row) for contact in all_contacts]
    matrices = np.eye(len(squares)), np.diag(squares), C
    system = System.from_matrices(*matrices, reduced_loads, reduced_contacts, **(data | changed))
    # Shares that T does not hold: of the norm of initial data, and of the strain energy of static deflections.
    squared = [(changed[name] @ changed[name], x @ (M @ x)) for name, x in vectors.items() if name != "observe"]
    strain = zip(np.sum((T.T @ rows) ** 2 / squares[:, None], axis=0), np.sum(rows * statics, axis=0), strict=True)
    shares = ([1.0 - held / whole for held, whole in each if whole > 0.0] for each in (squared, strain))
    lost, soft = (float(np.max(each, initial=0.0)) for each in shares)
    lost = np.sqrt(lost)
    if max(lost, soft) > LOST:
        warnings.warn(f"{modes} modes lose {lost:.2g} of the initial data, {soft:.2g} of a deflection", stacklevel=2)
    return system, T


def _basis(M: Any, K: Any, rows: Array, modes: int) -> tuple[Array, Array, Array]:
    """T (n, r), the squares of the frequencies in it (r,), and the static deflections (n, k) under the rows (n, k)."""
    # SuperLU raises for an exactly singular K only: small pivots show the others.
    strainless = InputError("stiffness", "a motion without strain", "hold the system", "support it")
    try:
        factor = scipy.sparse.linalg.splu(K)
    except RuntimeError:
        raise strainless from None
    pivots = np.abs(factor.U.diagonal())
    if np.min(pivots) < HELD * np.max(pivots):
        raise strainless
    # Natural modes, and of the static deflection of every force what it has beside them, in the metric of M.
    T, statics = _lowest(M, K, factor, modes), factor.solve(rows)
    for static in statics.T:
        beside = static - T @ (T.T @ (M @ static))
        beside = beside - T @ (T.T @ (M @ beside))  # twice, for orthogonality to rounding
        size = np.sqrt(beside @ (M @ beside))
        if size > INDEPENDENT * np.sqrt(static @ (M @ static)):
            T = np.column_stack([T, beside / size])
    # A diagonal system again: the appended deflections are no modes.
    small = T.T @ (K @ T)
    try:
        squares, turn = scipy.linalg.eigh(0.5 * (small + small.T), T.T @ (M @ T))
    except np.linalg.LinAlgError:  # deflections of a support so soft are rounding beside its rigid motion
        raise strainless from None
    return T @ turn, squares, statics


def _square(name: str, matrix: Any, symmetric: bool = False) -> Any:
    """``matrix`` in SciPy's sparse columns; InputError where it is not square, or not symmetric as in a System."""
    try:
        sparse: Any = scipy.sparse.csc_array(matrix, dtype=float)
    except (TypeError, ValueError):
        raise InputError(name, matrix, "be a matrix", "give rows of numbers, or a matrix of SciPy") from None
    if sparse.ndim != 2 or sparse.shape[0] != sparse.shape[1]:
        raise InputError(name, sparse.shape, "be square", "give a row and a column for each unknown")
    size, apart = np.sqrt(np.abs(sparse.diagonal())), (sparse - sparse.T).tocoo()
    if symmetric and np.any(np.abs(apart.data) > 1e-12 * size[apart.row] * size[apart.col]):
        raise unsymmetric(name, sparse, "be symmetric")
    return sparse


def _lowest(M: Any, K: Any, factor: Any, modes: int) -> Array:
    """Shapes (n, modes) of the lowest natural frequencies, x^T M x = 1: M x = x/w^2 K x. factor: of K."""
    n = M.shape[0]
    # Lanczos' method, where it has room for more vectors than it looks for.
    if n > DENSE and modes < np.unique(M.nonzero()[0]).size // 4:
        inverse = scipy.sparse.linalg.LinearOperator((n, n), matvec=factor.solve)  # type: ignore[call-arg]
        start = np.random.default_rng(0).normal(size=n)  # the same modes in every process
        return scipy.sparse.linalg.eigsh(K, modes, M, sigma=0.0, OPinv=inverse, v0=start)[1]
    afford("modes", modes, "ask for fewer", floats=4.0 * n * n)
    squares, shapes = scipy.linalg.eigh(M.toarray(), K.toarray())  # 1/w^2, zero of an unknown without mass
    if squares[0] < -MASSLESS * squares[-1]:
        raise InputError("mass", "a negative eigenvalue", "be positive semidefinite", "look at its signs")
    rank = np.count_nonzero(squares > MASSLESS * squares[-1])
    if modes >= rank:
        remedy = "ask for fewer, or use System.from_matrices where all unknowns have mass"
        raise InputError("modes", modes, f"be fewer than the rank of the mass matrix, {rank}", remedy)
    return shapes[:, -modes:] / np.sqrt(squares[-modes:])
