"""System -> modes: coordinates in which the linear part decouples, and damping given mode by mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ..basics.arrays import MOST, Array, Recent, content
from ..basics.validation import InputError
from .equations import Modal
from .graded import EPS, graded_eigenpairs, uncoupled
from .problem import ratios_of
from .system import System


@dataclass(frozen=True, eq=False)
class Modes:
    """q = shapes @ eta,  eta_j'' + damping_j eta_j' + omega_j^2 eta_j = shapes_j . f.

    omega: (n,) ascending angular frequencies. shapes: (n, n), shapes^T M shapes = I. damping: (n,).
    """

    omega: Array
    shapes: Array
    damping: Array
    mass: Array

    @property
    def equation(self) -> Modal:
        """The decoupled equations as a scheme sees them."""
        return Modal(self.omega, self.damping)

    def to_modal(self, q: Array) -> Array:
        """eta = shapes^T M q; q of shape (..., n)."""
        return (q @ self.mass) @ self.shapes

    def to_nodal(self, eta: Array) -> Array:
        """q = shapes eta; eta of shape (..., n)."""
        return eta @ self.shapes.T

    def force(self, vector: Array) -> Array:
        """shapes^T f, of a load vector or a contact row (..., n)."""
        return vector @ self.shapes


def undamped_modes(system: System, springs: tuple[tuple[Array, float], ...] = ()) -> Modes:
    """The modes of ``system`` without its damping, which always decouple; with springs as in ``modes``. Those of a
    system, which cannot change, are found once."""
    if springs:
        return _undamped(system, springs)
    if system not in _UNDAMPED:
        _UNDAMPED[system] = _shared(system, _undamped)
    return _UNDAMPED[system]


def modes(system: System, springs: tuple[tuple[Array, float], ...] = ()) -> Modes | None:
    """The modes of ``system`` with extra springs (row, stiffness), or None if damping couples them: by more than what
    rounding each entry of the matrices would do, however small that is beside the damping of other modes.

    With the mass M = R^T R and the factor K = G^T G, omega are the singular values of G R^-1, a spring
    (row, kappa) being one more row sqrt(kappa) row of G: the error is eps w_max in each omega. Without
    a factor they are the roots of eigenvalues, eps omega in each (``graded_eigenpairs``).
    """
    if not system.damped:
        return undamped_modes(system, springs)
    if springs:
        return _damped(system, springs)
    if system not in _DAMPED:
        _DAMPED[system] = _shared(system, _damped)
    return _DAMPED[system]


_UNDAMPED: WeakKeyDictionary[System, Modes] = WeakKeyDictionary()
_DAMPED: WeakKeyDictionary[System, Modes | None] = WeakKeyDictionary()
_RECENT: Recent[Any] = Recent(16)


def _shared(system: System, find: Callable[[System], Any]) -> Any:
    """Modes of ``system``, or of a recent one with the same matrices."""
    if system.size > MOST:
        return find(system)
    return _RECENT.get((find, *matrices(system)), lambda: find(system))


def matrices(system: System) -> tuple[bytes, ...]:
    """Digests of the matrices of ``system`` and of the factor of its stiffness, on which its modes depend."""
    return tuple(map(content, (system.mass, system.damping, system.stiffness, system.stiffness_factor)))


def slowest(system: System, count: int) -> Modes | None:
    """The slowest modes by Lanczos' method with a sparse factor G of the stiffness, in a fraction of the time of all.

    K^-1 = G^-1 G^-T loses eps w_max/w_1 where the inverse of K itself would lose the square, and omega = |G x| of
    every shape x. None where there is no such factor, the system can move without strain, or the damping is not
    alpha M + beta K.
    """
    import scipy.sparse.linalg

    G = system.stiffness_factor
    # Only proportional damping can be judged by few modes: other damping may couple them to those left out.
    if G is None or G.shape[0] != G.shape[1]:
        return None
    ratio = _multiple(system.damping, system.stiffness)
    if ratio is None and not _proportional(system):
        return None
    # Sparse LU of G: two triangular solves stand for K^-1.
    factor, mass = scipy.sparse.csc_array(G), scipy.sparse.csc_array(system.mass)
    try:
        solve = scipy.sparse.linalg.splu(factor).solve
    except RuntimeError:  # singular
        return None
    # A fixed start gives the same modes in every process.
    shape, start = G.shape, np.random.default_rng(0).normal(size=len(G))
    operator: Any = scipy.sparse.linalg.LinearOperator  # whose stubs lack the arguments of a plain one
    inverse = operator(shape, matvec=lambda x: solve(solve(x, "T")))
    stiffness = scipy.sparse.csc_array(system.stiffness)
    # Shifted to zero and inverted, the slowest modes are the largest, which Lanczos' method yields first.
    _, x = scipy.sparse.linalg.eigsh(stiffness, count, mass, sigma=0.0, OPinv=inverse, v0=start)
    x = x / np.sqrt(np.sum(x * (mass @ x), axis=0))
    omega = np.linalg.norm(factor @ x, axis=0)
    order = np.argsort(omega, kind="stable")
    omega, x = omega[order], _with_signs(x[:, order])
    damping = np.sum(x * (system.damping @ x), axis=0) if ratio is None else ratio * omega**2
    return Modes(omega, x, damping, system.mass)


def _multiple(a: Array, b: Array) -> float | None:
    """The factor c of a = c b, to the rounding of every entry; None where there is none."""
    largest = np.unravel_index(np.argmax(np.abs(a)), a.shape)
    # A zero in b gives factor 0, which only a zero a passes below.
    factor = float(a[largest] / (b[largest] or np.inf))
    return factor if np.all(np.abs(a - factor * b) <= 4.0 * EPS * np.abs(a)) else None


@np.errstate(over="ignore")  # refused by ``_within_float64``
def _damped(system: System, springs: tuple[tuple[Array, float], ...] = ()) -> Modes | None:
    basis = undamped_modes(system, springs)
    damping = _within_float64("damping", basis.shapes.T @ system.damping @ basis.shapes)
    # Couplings below the rounding of the entries are none.
    damping = uncoupled(system.damping, basis.shapes, damping, basis.omega == 0.0)
    diagonal = np.diag(damping).copy()
    # Springs change the modes: alpha M + beta K then couples them as any other damping does.
    if np.any(damping != np.diag(diagonal)) and (springs or not _proportional(system)):
        return None
    return replace(basis, damping=diagonal)


def _proportional(system: System) -> bool:
    """Return True if the damping is alpha M + beta K to the rounding of every entry. This test is sharper than products
    of shapes."""
    C, on = system.damping, system.damping != 0.0
    for parts in ([system.mass], [system.stiffness], [system.mass, system.stiffness]):
        # Every entry relative to its size: entries of C may differ by orders of magnitude.
        columns = np.stack([part[on] for part in parts], axis=1) / np.abs(C[on])[:, None]
        size = np.linalg.norm(columns, axis=0)
        columns, wanted, share = columns / np.where(size > 0.0, size, 1.0), np.sign(C[on]), np.zeros(len(parts))
        # Twice: the second fit takes away the rounding of the first, 30 eps with 300 unknowns.
        for _ in range(2):
            share += np.linalg.lstsq(columns, wanted - columns @ share)[0]
        terms = [x / (y or 1.0) * part for x, y, part in zip(share, size, parts, strict=True)]
        if np.all(np.abs(C - sum(terms)) <= 16.0 * EPS * sum(np.abs(term) for term in terms)):
            return True
    return False


@np.errstate(over="ignore")  # refused by ``_within_float64``
def _undamped(system: System, springs: tuple[tuple[Array, float], ...] = ()) -> Modes:
    into, back = _root(system.mass)
    name = "stops.stiffness" if springs else "stiffness"  # what is too large with springs is one of these
    # With a factor of K by singular values, which lose w_max/w_1 instead of its square.
    if system.stiffness_factor is not None:
        factor = np.vstack([system.stiffness_factor, *(np.sqrt(kappa) * row for row, kappa in springs)])
        _, omega, vectors = scipy.linalg.svd(_within_float64(name, into(factor.T).T), full_matrices=False)
        omega, shapes = omega[::-1], back(vectors[::-1].T)
        rigid = len(omega) - np.count_nonzero(np.any(factor, axis=1))  # as many motions strain nothing
        omega = np.where(np.arange(len(omega)) < rigid, 0.0, omega)
    # Without one by eigenvalues, whose slow ones are refined afterwards.
    else:
        stiffness = system.stiffness + sum(kappa * np.outer(row, row) for row, kappa in springs)
        scaled = 0.5 * into(into(stiffness).T)
        squares, vectors = scipy.linalg.eigh(_within_float64(name, scaled + scaled.T))
        # Rounding makes zeros slightly negative; a larger negative square is in the matrix.
        if squares[0] < -1e-9 * squares[-1]:
            remedy = "look at the signs and the supports it was made with"
            raise InputError("stiffness", f"least eigenvalue {squares[0]:.3g}", "be positive semidefinite", remedy)
        squares, shapes = graded_eigenpairs(system.mass, system.stiffness, springs, squares, back(vectors))
        omega = np.sqrt(np.maximum(squares, 0.0))
    return Modes(np.ascontiguousarray(omega), _with_signs(shapes), damping=np.zeros(len(omega)), mass=system.mass)


def _with_signs(shapes: Array) -> Array:
    """The shapes with one sign each, so that equal systems give equal modes."""
    return shapes * np.where(shapes[np.argmax(np.abs(shapes), axis=0), np.arange(shapes.shape[1])] < 0, -1.0, 1.0)


def _within_float64(name: str, scaled: Array) -> Array:
    """``scaled``, a matrix over the mass. Raises InputError where that overflows."""
    if not np.all(np.abs(scaled) < 1e300):  # a few are added up on the way
        remedy = "count length, time or mass in other units"
        raise InputError(name, "1e300 or more beside its mass", "be in the range of float64 over the mass", remedy)
    return scaled


def _root(mass: Array) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """x -> R^-T x and x -> R^-1 x of M = R^T R."""
    diagonal = np.diag(mass)
    # n entries of a definite matrix stand on its diagonal, which has none that is zero.
    if np.count_nonzero(mass) == len(mass):
        root = np.sqrt(diagonal)[:, None]
        return lambda x: x / root, lambda x: x / root
    upper = scipy.linalg.cholesky(mass)
    return partial(scipy.linalg.solve_triangular, upper, trans=1), partial(scipy.linalg.solve_triangular, upper)


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
    system = System.from_matrices(mass, stiffness, observe=np.ones(np.shape(mass)[0]))
    return damping_of(undamped_modes(system), ratio)


def damping_of(basis: Modes, ratio: float | Sequence[float]) -> Array:
    """``modal_damping`` in known modes: in those of the system itself it couples none of them."""
    ratios, zeta = ratios_of(ratio), np.zeros(len(basis.omega))
    if isinstance(ratios, tuple):
        if len(ratios) > len(zeta):
            remedy = "leave the last ones out, or take more cells"
            raise InputError("modal_damping", len(ratios), f"be at most one for each of {len(zeta)} modes", remedy)
        zeta[: len(ratios)] = ratios
    else:
        zeta[:] = ratios
    weighted = basis.mass @ basis.shapes
    return (weighted * (2.0 * zeta * basis.omega)) @ weighted.T
