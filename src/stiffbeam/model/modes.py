"""System -> modes, in which the linear part decouples where its damping allows, and damping given mode by mode.

Of the eigenpairs of K x = lambda M x the smallest lambda has as many digits as the largest. A solver for symmetric
matrices errs by eps lambda_max in every eigenvalue. Its vectors X are good enough to start from: S = X^T K X and
R = X^T M X, each entry rounded once, are graded, S_ij of the size sqrt(S_ii S_jj) or below. One-sided Jacobi
rotations of a Cholesky factor, LAPACK's dgejsv, err by eps lambda_j in each eigenvalue of such a matrix (Demmel and
Veselic, SIAM J. Matrix Anal. Appl. 13, 1992).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce, wraps
from operator import mul
from threading import RLock
from typing import Any

import numpy as np
import scipy.linalg
import scipy.linalg.lapack
from numpy.typing import ArrayLike

from ..basics.arrays import Array, Recent, content
from ..basics.validation import InputError
from .equations import Equation
from .problem import ratios_of
from .system import System, checked_matrix, require_system

EPS = float(np.finfo(float).eps)
PASSES = 5
GRADED = 0.5  # least eigenvalue of S with its diagonal scaled to ones: from there on all squares have their digits
BITS = 200  # of products of matrices whose sums cancel
SMALL = 100  # unknowns up to which all pairs are refined
SUMMED = 8.0  # times sqrt(n) eps of its terms: more than twice what sums of n^2 of them have been seen to lose
ENOUGH = 1e-10  # of lambda: beyond SMALL those that the solver knows to that much are left as they are
PRECISION = RLock()  # of flint, which has one for all threads


@dataclass(frozen=True, eq=False)
class Modes:
    """Free motions of a system away from its stops, slowest first.

    Where the damping does not couple them, k = n and

        q = shapes eta,   eta_j'' + damping_j eta_j' + omega_j^2 eta_j = shapes_j . f,   shapes^T M shapes = I,

    with the undamped frequencies omega. Where it does, a mode is q = Re(shape e^(lambda t)) with a complex shape,
    (lambda^2 M + lambda C + K) shape = 0, omega = |lambda| and damping = -2 Re lambda: one for every pair of conjugate
    lambda, and one of ratio 1 for every real lambda, a motion that only decays; then k > n. For one underdamped degree
    of freedom the two definitions agree.

    Parameters
    ----------
    omega : array (k,)
        Angular frequencies.
    shapes : array (n, k)
        A column per mode, shape^H M shape = 1, its largest entry positive.
    damping : array (k,)
        2 damping_ratio omega.
    mass : array (n, n)
    coupled : bool
        True where the damping couples the modes.
    """

    omega: Array
    shapes: Array
    damping: Array
    mass: Array
    coupled: bool = False

    def __repr__(self) -> str:
        lines = [f"{'':4}{'omega':>14}{'damping ratio':>16}"]
        lines += [
            f"{j:4d}{w:14.6g}{z:16.4g}" for j, (w, z) in enumerate(zip(self.omega, self.damping_ratio, strict=True), 1)
        ]
        return "\n".join(lines if len(lines) <= 21 else [*lines[:20], f"    ... {len(self.omega)} modes"])

    @property
    def damping_ratio(self) -> Array:
        """Damping over critical damping, (k,); NaN for a rigid motion, omega = 0."""
        unknown = np.full(len(self.omega), np.nan)
        return np.divide(0.5 * self.damping, self.omega, out=unknown, where=self.omega > 0.0)

    @property
    def equation(self) -> Equation:
        """The decoupled equations as a scheme sees them."""
        return Equation(np.ones_like(self.omega), self.damping, self.omega**2)

    def to_modal(self, q: Array) -> Array:
        """eta = shapes^T M q; q of shape (..., n)."""
        return (q @ self.mass) @ self.shapes

    def to_nodal(self, eta: Array) -> Array:
        """q = shapes eta; eta of shape (..., n)."""
        return eta @ self.shapes.T

    def force(self, vector: Array) -> Array:
        """shapes^T f, of a load vector or a contact row (..., n)."""
        return vector @ self.shapes


def modes(system: System) -> Modes:
    """Return the natural modes of a system away from its stops, whatever its damping.

    Parameters
    ----------
    system : System
        For models of thousands of unknowns see ``reduce_model``.

    Returns
    -------
    Modes

    Raises
    ------
    InputError
        For anything but a System.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.modes(sb.System.from_matrices([[2.0]], [[8.0]], damping=[[0.4]], observe=[1.0])).omega
    array([2.])
    """
    require_system(system)
    return decoupled_modes(system) or _complex_modes(system)


def _kept(of_system: Callable[[System], Any]) -> Callable[[System], Any]:
    """A function of the matrices of a system, with its last results."""
    recent = Recent[Any](16)

    def found(system: System) -> Any:
        linear = system.mass, system.damping, system.stiffness, system.stiffness_factor
        return recent.get(tuple(map(content, linear)), lambda: of_system(system))

    return wraps(of_system)(found)


@_kept
@np.errstate(over="ignore")  # refused by ``_within_float64``
def undamped_modes(system: System) -> Modes:
    """The modes of ``system`` without its damping, which always decouple."""
    factor = system.stiffness_factor
    # A start by singular values of a factor of K, which lose w_max/w_1 instead of its square, or by eigenvalues.
    if factor is None:
        squares, start = scipy.linalg.eigh(system.stiffness, system.mass)
    else:
        upper = scipy.linalg.cholesky(system.mass)
        scaled = scipy.linalg.solve_triangular(upper, factor.T, trans=1).T
        _, omega, vectors = scipy.linalg.svd(_within_float64("stiffness", scaled), full_matrices=False)
        squares, start = omega[::-1] ** 2, scipy.linalg.solve_triangular(upper, vectors[::-1].T)
    squares = _within_float64("stiffness", squares)
    squares, shapes = graded_eigenpairs(system.mass, system.stiffness, factor, squares, start)
    omega = np.sqrt(np.maximum(squares, 0.0))
    shapes = shapes * np.where(_largest(shapes) < 0.0, -1.0, 1.0)  # equal systems have equal modes
    return Modes(np.ascontiguousarray(omega), shapes, damping=np.zeros(len(omega)), mass=system.mass)


@_kept
def decoupled_modes(system: System) -> Modes | None:
    """The modes of ``system``, or None if damping couples them by more than rounding, see ``uncoupled``, however small
    that is beside the damping of other modes."""
    basis = undamped_modes(system)
    if not system.damped:
        return basis
    damping = uncoupled(system.damping, basis.shapes, system.mass, system.stiffness, basis.omega == 0.0)
    diagonal = np.diag(damping).copy()
    return None if np.any(damping != np.diag(diagonal)) else replace(basis, damping=diagonal)


def _complex_modes(system: System) -> Modes:
    """The modes by the first-order form in undamped modal coordinates, scaled by their frequencies."""
    # In undamped modes the matrices are diagonal but for the damping.
    basis = undamped_modes(system)
    n, scale = system.size, np.where(basis.omega > 0.0, basis.omega, 1.0)
    damping = basis.shapes.T @ system.damping @ basis.shapes
    # z = (scale eta, eta'): entries of one size, so that the slow eigenvalues are as good as the fast ones.
    A = np.block([[np.zeros((n, n)), np.diag(scale)], [-np.diag(basis.omega**2 / scale), -damping]])
    values, left, vectors = (np.asarray(part, complex) for part in scipy.linalg.eig(A, left=True))
    # One of each conjugate pair, and the real ones.
    kept = np.imag(values) >= 0.0
    values, vectors = values[kept], vectors[:, kept]
    x, y = vectors[:n] / scale[:, None], np.conj(left[n:, kept])
    # The algorithm errs by eps of the largest eigenvalue in all of them, too much for the slow ones. Two of Newton's
    # steps on y^T (lambda^2 + lambda D + Omega^2) x = 0 give them their digits; none where the slope cancels, as of
    # eigenvalues that nearly meet.
    a, b, c = (np.sum(y * z, axis=0) for z in (x, damping @ x, basis.omega[:, None] ** 2 * x))
    for _ in range(2):
        slope = 2.0 * a * values + b
        single = np.abs(slope) > 1e-2 * (2.0 * np.abs(a * values) + np.abs(b))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            off = -((a * values + b) * values + c) / slope
        values = values + np.where(single & np.isfinite(off), off, 0.0)
    order = np.argsort(np.abs(values), kind="stable")
    values, shapes = values[order], basis.shapes @ (vectors[:n, order] / scale[:, None])
    # Unit norm in M, and the phase at which the largest entry is real and positive.
    norms = np.sqrt(np.real(np.sum(np.conj(shapes) * (system.mass @ shapes), axis=0)))
    largest = _largest(shapes)
    shapes = shapes / np.where(norms > 0.0, norms, 1.0) * np.conj(largest) / np.where(largest == 0, 1, np.abs(largest))
    return Modes(np.abs(values), shapes, -2.0 * np.real(values), system.mass, coupled=True)


def _largest(shapes: Array) -> Array:
    """The largest entry of every shape."""
    return shapes[np.argmax(np.abs(shapes), axis=0), np.arange(shapes.shape[1])]


def _within_float64(name: str, scaled: Array) -> Array:
    """``scaled``, a matrix over the mass. Raises InputError where that overflows."""
    if not np.all(np.abs(scaled) < 1e300):  # a few are added up on the way
        remedy = "count length, time or mass in other units"
        raise InputError(name, "1e300 or more beside its mass", "be in the range of float64 over the mass", remedy)
    return scaled


def modal_damping(mass: ArrayLike, stiffness: ArrayLike, ratio: float | Sequence[float]) -> Array:
    """Return C = M Phi diag(2 zeta_j omega_j) Phi^T M, Phi^T M Phi = I: damping that keeps the natural modes.

    Parameters
    ----------
    mass, stiffness : array (n, n)
        Dense or SciPy sparse.
    ratio : float or sequence of float
        zeta of every mode, or of the first ones; the others have none. A rigid motion has none either.

    Returns
    -------
    array (n, n)
        ``damping`` of ``System.from_matrices``.

    Raises
    ------
    InputError
        For a negative ratio, for more ratios than modes, and for matrices that make no System.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.modal_damping([[2.0]], [[8.0]], 0.05)
    array([[0.4]])
    """
    checked = checked_matrix("mass", mass)
    system = System.from_matrices(checked, stiffness, observe=np.ones(len(checked)))
    return damping_of(undamped_modes(system), ratio)


def damping_of(basis: Modes, ratio: float | Sequence[float]) -> Array:
    """``modal_damping`` in known modes: in those of the system itself it couples none of them."""
    ratios, modes = ratios_of(ratio), len(basis.omega)
    count = len(ratios) if isinstance(ratios, tuple) else modes
    if count > modes:
        remedy = "leave the last ones out, or take more cells"
        raise InputError("modal_damping", count, f"be at most one for each of {modes} modes", remedy)
    weighted = (basis.mass @ basis.shapes)[:, :count]
    return (weighted * (2.0 * np.array(ratios) * basis.omega[:count])) @ weighted.T


def graded_eigenpairs(
    mass: Array, stiffness: Array, factor: Array | None, squares: Array, X: Array
) -> tuple[Array, Array]:
    """(lambda ascending (n,), vectors (n, n), vectors^T M vectors = I) from approximate ones, ``squares`` and ``X``.

    A factor G of K = G^T G has more digits of the slow ones than the rounded entries of K. An eigenvalue below the
    rounding, seen along its vector, is that of a rigid-body motion, and zero. Where S_ij comes near sqrt(S_ii S_jj) the
    vectors were too far off, and the better ones are the next start. Of more than SMALL unknowns only the slow pairs
    are refined, within the space that they span.
    """
    # The solver errs by n eps of the largest square, with a factor of the largest root: those below have more than
    # ENOUGH of error.
    known = squares if factor is None else np.sqrt(squares)
    slow = len(X) if len(X) <= SMALL else int(np.count_nonzero(known < EPS * len(X) / ENOUGH * known[-1]))
    if not slow:
        return squares, X
    fast, (X, rest) = squares[slow:], np.split(X, [slow], axis=1)
    squares = rounding = np.zeros(slow)
    for _ in range(PASSES):
        # S = X^T K X, and its rounding by the size of the terms that are summed.
        if factor is None:
            S, terms = exact_product(X.T, stiffness, X), np.sum(np.abs(X) * (np.abs(stiffness) @ np.abs(X)), axis=0)
            rounding = rounding_of_zero(terms, len(mass))
        else:
            S, terms = exact_product(X.T, factor.T, factor, X), np.sum((np.abs(factor) @ np.abs(X)) ** 2, axis=0)
            rounding = rounding_of_zero(np.sqrt(terms), len(mass)) ** 2
        # R = U^T U makes one symmetric matrix of the pair: U^-T S U^-1.
        upper = scipy.linalg.cholesky(exact_product(X.T, mass, X))
        S = scipy.linalg.solve_triangular(upper, S, trans=1)
        S = scipy.linalg.solve_triangular(upper, S.T, trans=1)
        # Its pairs, and their vectors back in the space of X.
        squares, turned, lowest = graded_eigh(0.5 * (S + S.T), rounding)
        X = X @ scipy.linalg.solve_triangular(upper, turned)
        # Graded already: the squares have their digits, and no better start is needed.
        if lowest > GRADED:
            break
    # A rigid motion has the square zero, not its rounding.
    squares[np.abs(squares) < rounding] = 0.0
    order = np.argsort(squares, kind="stable")
    # The fast shapes are orthogonal to the slow ones as these are now.
    return np.append(squares[order], fast), np.hstack([X[:, order], rest - X @ (X.T @ (mass @ rest))])


def rounding_of_zero(terms: Array, n: int) -> Array:
    """Below which squares count as zero: sums of n terms that are ``terms`` large in all."""
    return 2.0 * EPS * max(n, 8) * terms


@np.errstate(over="ignore", invalid="ignore")  # refused by ``_within_float64``
def uncoupled(damping: Any, X: Array, mass: Any, stiffness: Any, rigid: Array) -> Array:
    """X^T C X (k, k) of a damping C in modes X (n, k) without the rounding of zero: entries beside the diagonal d, and
    those of rigid motions (k,). Matrices are dense or sparse.

    Modes are inexact: G = X^T M X and S = X^T K X have entries beside their diagonals too. Damping that couples none
    then has, to first order,

        d_i G_ij + (S_ij - s_i G_ij) (d_i - d_j)/(s_i - s_j)    C = M f(M^-1 K), proportional damping for example
        (d_i + d_j) G_ij                                        C = M X diag(d) X^T M, made of these modes

    with the diagonal s of S. The lesser remainder counts.
    """
    projected, weighted = _within_float64("damping", X.T @ (damping @ X)), mass @ X
    G, S = X.T @ weighted, X.T @ (stiffness @ X)
    d, s = np.diag(projected)[:, None], np.diag(S)[:, None]
    apart, size = s - s.T, np.abs(projected)
    slope = np.divide(d - d.T, apart, out=np.zeros_like(apart), where=apart != 0.0)
    rest = np.fmin(np.abs(projected - d * G - slope * (S - s * G)), np.abs(projected - (d + d.T) * G))
    # The terms of the projection, and those of C where it is a sum over modes: between two modes at the ends of a body
    # these are larger than its entries. Rows scaled by the masses, so that no square overflows.
    terms = np.abs(X.T) @ (abs(damping) @ np.abs(X))
    unit, most = np.sqrt(mass.diagonal())[:, None], np.max(np.abs(d)) or 1.0
    overlap = ((unit * X) ** 2).T @ (np.divide(weighted, unit, out=np.zeros_like(X), where=unit > 0.0) ** 2)
    sums = most * np.sqrt((overlap * (d.T / most) ** 2) @ overlap.T)
    # Rounding by its statistics, sqrt(n). On the diagonal entries stay: of slow motions they can be that small.
    rounding = SUMMED * EPS * np.sqrt(len(X))
    none = ((size <= rounding * terms) | (rest <= rounding * (terms + sums))) & ~np.eye(len(size), dtype=bool)
    # Those of rigid motions by the full bound, diagonal included.
    none = np.where(rigid[:, None] | rigid, size <= rounding_of_zero(terms, len(X)), none)
    return np.where(none, 0.0, projected)


def exact_product(*factors: Array) -> Array:
    """The product of matrices, each entry rounded once."""
    from flint import arb_mat, ctx

    with PRECISION, ctx.workprec(BITS):
        product = reduce(mul, (arb_mat(factor.tolist()) for factor in factors))
        return np.array(product.tolist(), float)


def graded_eigh(S: Array, least: Array) -> tuple[Array, Array, float]:
    """Eigenvalues (n,) and orthonormal vectors (n, n) of a symmetric graded matrix, in the order of its diagonal.

    Of S = G^T G they are the squared singular values of G, a well-conditioned matrix with scaled columns, and its
    vectors. ``least`` (n,) are diagonals below which no digit is known. Also returns the least eigenvalue of S with its
    diagonal scaled to ones: near one where S is graded.
    """
    rest = np.diag(S) <= least
    size = np.sqrt(np.maximum(np.diag(S), 1e-3 * least))  # less than any square that counts
    size = np.where(size > 0.0, size, 1.0)
    scaled = np.where(np.outer(rest, rest), 0.0, S / np.outer(size, size))
    np.fill_diagonal(scaled, 1.0)
    lowest = float(np.linalg.eigvalsh(scaled)[0])
    definite = lowest >= 1e-8
    if not definite:  # its vectors are for the next pass
        scaled += (1e-3 - lowest) * np.eye(len(S))
    jacobi: Any = getattr(scipy.linalg.lapack, "dgejsv")  # noqa: B009  which scipy's types do not know
    singular, _, vectors, work, _, _ = jacobi(
        np.linalg.cholesky(scaled).T * size, joba=0, jobu=3, jobv=0, jobr=0, jobp=0
    )
    values = (singular * (work[0] / work[1])) ** 2 if definite else np.sum(vectors * (S @ vectors), axis=0)
    place = np.argsort(np.argsort(-size, kind="stable"))
    return np.where(rest, 0.0, values[place]), vectors[:, place], lowest
