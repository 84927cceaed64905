"""Thousands of unknowns in the modes that matter: a small System from sparse matrices, with its truncation error.

    q = T z,   T = [phi_1 .. phi_k, K^-1 p for every load, contact and observed row p],   T^T M T = I

Galerkin's projection on the lowest k modes and on what the forces do statically. So the deflection under a constant
force of any load or contact is exact whatever k is (static correction), and the dynamic error is that of the modes
left out, at frequency w of the order (w/w_{k+1})^4. Unknowns without mass follow the others statically. No dense
n x n matrix is made: one sparse factor of K, and one of K - w^2 M for each ``error_at``.

Source: Craig, Structural Dynamics (1981), Section 19 (residual attachment modes).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.resources import afford
from ..basics.units import UNKNOWN, Units
from ..basics.validation import InputError, instance, integer, non_negative, numbers, sequence
from .contact import Contact
from .modes import damping_ratios, uncoupled
from .system import System, unsymmetric
from .time_functions import LoadFunction

DENSE = 600  # unknowns with mass, up to which all modes are computed: Lanczos' method needs more than it looks for
MASSLESS = 1e-13  # of the largest eigenvalue of M: a smaller one is rounding of 0
INDEPENDENT = 1e-10  # of its size: a static deflection that has less left beside the modes adds nothing
SOFT = 1e-6  # of its strain energy: a static deflection that has lost more is remarked on
HELD = 1e-13  # of the largest pivot: a smaller one is a motion that nothing holds


@dataclass(frozen=True, eq=False, repr=False)
class ReducedModel:
    """A reduced system of r unknowns z with q = T z.

    Parameters
    ----------
    system : System
        Of z, diagonal without damping.
    basis : array (n, r)
        T.
    omega : array (k,)
        Natural frequencies that were kept.
    first_omitted : float
        The next one.
    initial_data_error : float
        Share of the norms |q0|_M, |v0|_M of the initial data that T does not hold.
    static_error : float
        Share of the strain energy of a static deflection that T does not hold, the largest over loads, contacts and the
        observed row. Larger than rounding where a deflection moves little mass, such as that of a load on unknowns
        without mass.
    mass, stiffness : array (n, n)
    rows : array
    reduce : function
        Reduction of the same model to another number of modes.
    """

    system: System
    basis: Array
    omega: Array
    first_omitted: float
    initial_data_error: float
    static_error: float
    mass: Any = field(repr=False)
    stiffness: Any = field(repr=False)
    rows: Array = field(repr=False)
    reduce: Callable[[int], ReducedModel] = field(repr=False)

    def __repr__(self) -> str:
        kept = (
            f"{len(self.omega)} modes to {self.omega[-1]:.4g} and {self.basis.shape[1] - len(self.omega)} deflections"
        )
        lost = f", {self.static_error:.2g} of a static deflection lost" if self.static_error > SOFT else ""
        return f"<ReducedModel: {len(self.basis)} unknowns in {kept}, first left out {self.first_omitted:.4g}{lost}>"

    def expand(self, z: ArrayLike) -> Array:
        """q = T z; z (..., r) gives (..., n)."""
        return np.asarray(z, float) @ self.basis.T

    def refined(self) -> System:
        """The system with twice as many modes, from which ``doubt`` estimates the truncation error. Raises InputError
        where the model has no more."""
        return self.reduce(2 * len(self.omega)).system

    def error_at(self, frequency: float) -> float:
        """The truncation error at an angular frequency, undamped: the largest over the loads, contacts and the
        observed row of |R - R_r|/|R|, R = (K - w^2 M)^-1 p in the norm of M, R_r that of the reduced system; 1 for a
        force that moves no mass."""
        w2 = non_negative("frequency", frequency) ** 2
        exact = scipy.sparse.linalg.splu((self.stiffness - w2 * self.mass).tocsc()).solve(self.rows)
        deflections = self.basis @ np.linalg.solve(
            self.system.stiffness - w2 * self.system.mass, self.basis.T @ self.rows
        )
        norm = lambda x: np.sqrt(np.sum(x * (self.mass @ x), axis=0))  # noqa: E731
        size = norm(exact)
        # A load of zeros moves nothing, and nothing of it is lost.
        lost = np.any(self.rows, axis=0).astype(float)
        return float(np.max(np.divide(norm(deflections - exact), size, out=lost, where=size > 0.0), initial=0.0))


def reduce_model(
    mass: Any,
    stiffness: Any,
    damping: Any = None,
    loads: Sequence[tuple[ArrayLike, LoadFunction]] = (),
    contacts: Sequence[Contact] = (),
    observe: ArrayLike | None = None,
    initial_displacement: ArrayLike | None = None,
    initial_velocity: ArrayLike | None = None,
    modes: int = 40,
    units: Units = UNKNOWN,
    modal_damping: float | Sequence[float] = 0.0,
) -> ReducedModel:
    """Return a large system reduced to natural modes and static deflections, by Craig and Bampton's idea.

    Parameters
    ----------
    mass, stiffness, damping : array (n, n)
        Dense or SciPy sparse. Unknowns may be without mass.
    loads, contacts, observe, initial_displacement, initial_velocity
        As for ``System.from_matrices``.
    modes : int
        Number of natural modes to keep.
    units : Units, optional
        Names for tables, pictures and files.
    modal_damping : float or sequence of float, optional
        Damping ratio of every mode of the reduced system, or of its first ones; added to ``damping``.

    Returns
    -------
    ReducedModel

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
    >>> small = sb.reduce_model(np.eye(n), stiffness, contacts=[contact], initial_velocity=np.ones(n), modes=10)
    >>> small.system.size < 20
    True
    """
    M, K = (_symmetric(name, x) for name, x in (("mass", mass), ("stiffness", stiffness)))
    n = int(M.shape[0])  # type: ignore[index]
    if K.shape != M.shape:
        raise InputError("stiffness", K.shape, f"have the shape of the mass, {M.shape}", "give one for each unknown")
    integer("modes", modes, 1)
    # SuperLU raises for an exactly singular K only: small pivots show the others.
    try:
        factor = scipy.sparse.linalg.splu(K)
        pivots = np.abs(factor.U.diagonal())
    except RuntimeError:  # exactly singular
        factor, pivots = None, np.zeros(1)
    strainless = InputError("stiffness", "a motion without strain", "hold the system", "support it")
    if factor is None or np.min(pivots) < HELD * np.max(pivots):
        raise strainless
    # Natural modes, and the static deflection of every force.
    squares, shapes = _lowest(M, K, factor.solve, modes)
    for load in sequence("loads", loads, "be pairs (vector, function of time)"):
        if not isinstance(load, (tuple, list)) or len(load) != 2:
            raise InputError(
                "loads", load, "be pairs (vector, function of time)", "for example [(row, Harmonic(1.0, 2.0))]"
            )
    for contact in sequence("contacts", contacts, "be contacts"):
        instance("contacts", contact, Contact, "for example [Contact(row, Stops(upper=0.1, stiffness=1e4))]")
    forces = [numbers("loads", p) for p, _ in loads] + [row for contact in contacts for row in contact.rows]
    forces += [] if observe is None else [numbers("observe", observe)]
    for p in forces:
        if p.shape != (n,):
            remedy = "give one number per unknown of the matrices"
            raise InputError("loads, contacts and observe", p.shape, f"have shape ({n},)", remedy)
    rows = np.array(forces).reshape(len(forces), n).T
    # Append what each deflection has beside the basis so far, in the metric of M.
    T = shapes[:, :modes]
    statics = factor.solve(rows)
    for static in statics.T:
        left = static - T @ (T.T @ (M @ static))
        left = left - T @ (T.T @ (M @ left))  # twice, for orthogonality to rounding
        size = np.sqrt(left @ (M @ left))
        if size > INDEPENDENT * np.sqrt(static @ (M @ static)):
            T = np.column_stack([T, left / size])
    # A diagonal system again: the appended deflections are no modes.
    small = T.T @ (K @ T)
    try:
        omega2, turn = scipy.linalg.eigh(0.5 * (small + small.T), T.T @ (M @ T))
    except np.linalg.LinAlgError:  # deflections of a support so soft are rounding beside its rigid motion
        raise strainless from None
    T = T @ turn
    C = None if damping is None else _projected(_symmetric("damping", damping), T)
    zeta = damping_ratios(modal_damping, len(omega2))
    if np.any(zeta):
        C = np.diag(2.0 * zeta * np.sqrt(omega2)) + (0.0 if C is None else C)
    # Initial data by projection, and the share that is lost.
    given = {"initial_displacement": initial_displacement, "initial_velocity": initial_velocity}
    states = [np.zeros(n) if x is None else numbers(name, x) for name, x in given.items()]
    for name, x in zip(given, states, strict=True):
        if x.shape != (n,):
            raise InputError(name, x.shape, f"have shape ({n},)", "give one number per unknown of the matrices")
    z = [T.T @ (M @ x) for x in states]
    lost = [_share(M, x - T @ y, x) for x, y in zip(states, z, strict=True)]
    system = System.from_matrices(
        np.eye(len(omega2)),
        np.diag(omega2),
        C,
        loads=[(T.T @ np.asarray(p, float), f) for p, f in loads],
        contacts=[replace(contact, row=(T.T @ contact.row.T).T) for contact in contacts],
        observe=None if observe is None else T.T @ np.asarray(observe, float),
        initial_displacement=z[0],
        initial_velocity=z[1],
        units=units,
    )
    # Strain energy of each static deflection, p^T K^-1 p, and the part of it in T.
    strain, held = np.sum(rows * statics, axis=0), np.sum((T.T @ rows) ** 2 / omega2[:, None], axis=0)
    static_lost = float(
        np.max(1.0 - np.divide(held, strain, out=np.ones_like(strain), where=strain > 0.0), initial=0.0)
    )
    kept = np.sqrt(squares)
    data = (mass, stiffness, damping, loads, contacts, observe, initial_displacement, initial_velocity)
    lost_most, again = (
        (max(lost), max(static_lost, 0.0)),
        partial(reduce_model, *data, units=units, modal_damping=modal_damping),
    )
    return ReducedModel(system, T, kept[:modes], float(kept[modes]), *lost_most, M, K, rows, again)


def _symmetric(name: str, matrix: Any) -> Any:
    """``matrix`` in SciPy's sparse columns; InputError where it is not symmetric, by the rule of a System."""
    try:
        sparse: Any = scipy.sparse.csc_array(matrix, dtype=float)
    except (TypeError, ValueError):
        raise InputError(name, matrix, "be a matrix", "give rows of numbers, or a matrix of SciPy") from None
    if sparse.ndim != 2 or sparse.shape[0] != sparse.shape[1]:
        raise InputError(name, sparse.shape, "be square", "give a row and a column for each unknown")
    size, apart = np.sqrt(np.abs(sparse.diagonal())), (sparse - sparse.T).tocoo()
    if np.any(np.abs(apart.data) > 1e-12 * size[apart.row] * size[apart.col]):
        raise unsymmetric(name, sparse, "be symmetric")
    return sparse


def _lowest(M: Any, K: Any, solve: Callable[[Array], Array], modes: int) -> tuple[Array, Array]:
    """The squares of the lowest ``modes`` + 1 natural frequencies and their shapes, x^T M x = 1; solve: b -> K^-1 b."""
    n, moved = M.shape[0], np.unique(M.nonzero()[0])
    # Lanczos' method, where it has room for more vectors than it looks for.
    if len(moved) > DENSE and modes < len(moved) // 4:
        inverse = scipy.sparse.linalg.LinearOperator((n, n), matvec=solve)  # type: ignore[call-arg]
        start = np.random.default_rng(0).normal(size=n)  # the same modes in every process
        squares, shapes = scipy.sparse.linalg.eigsh(K, modes + 1, M, sigma=0.0, OPinv=inverse, v0=start)
        order = np.argsort(squares)
        return squares[order], shapes[:, order]
    # All modes, of the unknowns that have mass.
    afford("modes", modes, "ask for fewer", floats=3.0 * n * len(moved))
    masses, R = np.linalg.eigh(M[moved][:, moved].toarray())
    if masses[0] < -MASSLESS * masses[-1]:
        remedy = "look at its signs"
        raise InputError("mass", f"least eigenvalue {masses[0]:.3g}", "be positive semidefinite", remedy)
    massive = masses > MASSLESS * masses[-1]
    if modes >= np.count_nonzero(massive):
        rule = f"be fewer than the rank of the mass matrix, {np.count_nonzero(massive)}"
        raise InputError(
            "modes", modes, rule, "ask for fewer, or use System.from_matrices where all unknowns have mass"
        )
    # M = R R^T, so that (R^T K^-1 R) y = y/w^2 and the shape is x = w^2 K^-1 R y: symmetric, and no mass divides.
    forces = np.zeros((n, np.count_nonzero(massive)))
    forces[moved] = R[:, massive] * np.sqrt(masses[massive])
    deflections = solve(forces)
    # The largest compliances are the lowest frequencies.
    flexibility = forces.T @ deflections
    compliances, y = np.linalg.eigh(0.5 * (flexibility + flexibility.T))
    compliances, y = compliances[::-1][: modes + 1], y[:, ::-1][:, : modes + 1]
    return 1.0 / compliances, deflections @ (y / compliances)


def _projected(C: Any, T: Array) -> Array:
    """T^T C T without its rounding, so that what couples no modes couples none here."""
    projected = uncoupled(C, T, T.T @ (C @ T), np.zeros(T.shape[1], bool))
    return 0.5 * (projected + projected.T)


def _share(M: Any, part: Array, whole: Array) -> float:
    size = float(whole @ (M @ whole))
    return float(np.sqrt((part @ (M @ part)) / size)) if size else 0.0
