"""BeamProblem -> System: the paper's space discretisations, Dumont (2002), Section 3.

All are written in v = u - phi(t) (1 - x^2), which vanishes with its slope at the clamp and leaves the
tip alone, u(1, t) = v(1, t). Grid: h = 1/M, x_i = i h, unknowns at x_1..x_M.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from .arrays import Array
from .contact import Contact
from .first_order import FirstOrderContact, FirstOrderSystem, interleaved
from .problem import BeamProblem, DistributedLoad, PointLoad
from .system import System
from .time_functions import Constant, Harmonic, LoadFunction, TimeFunction
from .validation import InputError, near

FORMS = ("displacement", "velocity-curvature")


def semidiscretise(problem: BeamProblem, cells: int, form: str = "displacement") -> System:
    """The method of lines with ``cells`` = M >= 4 cells, second order in h = 1/M.

    form "displacement": (3.5) and (3.6), one System; a scheme for first-order systems reads it as
    (3.5), one for second-order systems as (3.6). form "velocity-curvature": (3.12), d = 0 only.
    Raises InputError.
    """
    if not isinstance(problem, BeamProblem):
        raise InputError("problem", type(problem).__name__, "be a BeamProblem")
    if isinstance(cells, bool) or not isinstance(cells, (int, np.integer)) or cells < 4:
        raise InputError("cells", cells, "be an integer >= 4", "the stencils at both ends must not overlap")
    if form == "displacement":
        return _displacement(problem, int(cells))
    if form == "velocity-curvature":
        return _velocity_curvature(problem, int(cells))
    raise InputError("form", form, "be one of the paper's forms", near(form, FORMS))


def _displacement(problem: BeamProblem, M: int) -> System:
    """(3.6) times h D, D = diag(1, ..., 1, 1/2): M = h D, K = -k^2 h D H, C = -d h D H.

    -v^T D H v = 1/2 kappa_0^2 + sum_i kappa_i^2 with the curvatures kappa_0 = 2 v_1/h^2 and
    kappa_i = (v_{i-1} - 2 v_i + v_{i+1})/h^2, which gives the factor G of the stiffness.
    """
    weights = np.full(M, 1.0 / M)
    weights[-1] = 0.5 / M
    bending = bending_stencil(M) * float(M) ** 3
    factor = np.vstack([np.zeros(M), (np.eye(M, k=1) - 2.0 * np.eye(M) + np.eye(M, k=-1))[:-1]])
    factor[0, 0] = np.sqrt(2.0)  # sqrt(1/2) kappa_0
    factor *= np.sqrt(float(M) ** 3)
    clamp = np.zeros(M)
    clamp[-2:] = (-2.0 * M, 2.0 * M)  # the moment condition (2.5) in v: k^2 v_xx + d v_xxt = 2 (k^2 phi + d phi')
    return System(
        mass=np.diag(weights),
        damping=problem.viscosity * bending,
        stiffness=problem.stiffness * bending,
        loads=_loads(problem, M, np.diag(weights), clamp),
        contacts=_contacts(problem, M),
        observe=None if problem.stops else _tip(M),
        **_initial(problem, M),
        stiffness_factor=np.sqrt(problem.stiffness) * factor,
        form="displacement",
        problem=problem,
        build_first_order=_paper_displacement,
    )


def bending_stencil(M: int) -> Array:
    """-h^4 D H, whole numbers: 7, -4, 1 at the clamp, 1, -4, 6, -4, 1 inside, 5, -2 and 1 at the tip."""
    curvature = (np.eye(M, k=1) - 2.0 * np.eye(M) + np.eye(M, k=-1))[:-1]
    stencil = curvature.T @ curvature
    stencil[0, 0] += 2.0
    return stencil


def _paper_displacement(system: System) -> FirstOrderSystem:
    """(3.5) itself. Its entries are small whole multiples of k^2/h^4, rounded alike.

    Dividing the stiffness by the mass entry by entry would perturb the lowest frequency by
    eps (w_max/w_1)^2, more than a tight tolerance allows.
    """
    M, problem = system.size, system.problem
    assert problem is not None
    H = bending_stencil(M)
    H[-1] *= 2.0
    first_order = interleaved(system)
    q, v = slice(0, 2 * M, 2), slice(1, 2 * M, 2)
    first_order.matrix[v, q] = 0.0 - problem.stiffness * float(M) ** 4 * H
    first_order.matrix[v, v] = 0.0 - problem.viscosity * float(M) ** 4 * H
    return first_order


def _velocity_curvature(problem: BeamProblem, M: int) -> System:
    """(3.12) with w = L x, s = x':  P x'' + k^2 L^T Q L x = P F + sigma e_M.

    With w' = L s and s' = -k^2 R w + F + (3/h) sigma e_M the weights P and Q satisfy P R = L^T Q, so
    the energy is 1/2 s^T P s + k^2/2 w^T Q w and the form is a symmetric second-order system.
    """
    if problem.viscosity > 0:
        raise InputError(
            "viscosity",
            problem.viscosity,
            "be 0 in the velocity-curvature form",
            "(3.12) eliminates the displacement, and d u_xxxxt has no place in it: use form='displacement'",
        )
    P, Q, L, _ = velocity_curvature_matrices(M)
    h = 1.0 / M
    moment = np.zeros(M)
    moment[-2:] = (-2.0 / h**2, 7.0 / h**2)  # w_M = 2 phi in the last two rows of -k^2 R w, (3.10)
    factor = np.sqrt(problem.stiffness) * scipy.linalg.cholesky(Q) @ L
    return System(
        mass=P,
        damping=np.zeros((M, M)),
        stiffness=factor.T @ factor,
        loads=_loads(problem, M, P, P @ moment),
        contacts=_contacts(problem, M),
        observe=None if problem.stops else _tip(M),
        **_initial(problem, M),
        stiffness_factor=factor,
        form="velocity-curvature",
        problem=problem,
        build_first_order=_paper_state,
    )


def velocity_curvature_matrices(M: int) -> tuple[Array, Array, Array, Array]:
    """P, Q, L, R of (3.12), each (M, M): w_0..w_{M-1} = L s-integrated, P R = L^T Q."""
    h = 1.0 / M
    interior = np.eye(M - 1) * 4.0 / 3.0 - (np.eye(M - 1, k=1) + np.eye(M - 1, k=-1)) / 6.0
    P = h * np.asarray(scipy.linalg.block_diag(interior, 1.0 / 3.0))
    Q = h * np.asarray(scipy.linalg.block_diag(1.0 / 3.0, interior))
    L = np.zeros((M, M))  # acts on s_1..s_M, s_0 = 0
    L[0, :2] = (4.0, -0.5)  # (3.9)
    for i in range(1, M):
        L[i, i] = 1.0  # s_{i+1}
        L[i, i - 1] = -2.0  # s_i
        if i >= 2:
            L[i, i - 2] = 1.0  # s_{i-1}
    L /= h**2
    R = np.zeros((M, M))  # acts on w_0..w_{M-1}; w_M = 2 phi is a load
    for i in range(1, M):
        R[i - 1, i - 1] = 1.0  # w_{i-1}
        R[i - 1, i] = -2.0  # w_i
        if i < M - 1:
            R[i - 1, i + 1] = 1.0  # w_{i+1}
    R[M - 1, M - 1] = 4.0
    R[M - 1, M - 2] = -0.5  # (3.10)
    return P, Q, L, R / h**2


def _paper_state(system: System) -> FirstOrderSystem:
    """(3.12) itself: y = (w_0, s_1, w_1, s_2, ..., w_{M-1}, s_M, v_M), banded."""
    M = system.size
    assert system.problem is not None
    k2 = system.problem.stiffness
    _, _, L, R = velocity_curvature_matrices(M)
    w, s = slice(0, 2 * M, 2), slice(1, 2 * M, 2)
    size = 2 * M + 1
    matrix = np.zeros((size, size))
    matrix[w, s], matrix[s, w] = L, -k2 * R
    matrix[-1, 2 * M - 1] = 1.0  # v_M' = s_M (Remark 4)
    matrix += 0.0
    mass = scipy.linalg.cho_factor(system.mass)

    def column(vector: Array) -> Array:
        out = np.zeros(size)
        out[s] = scipy.linalg.cho_solve(mass, vector)
        return out

    tip = np.zeros(size)
    tip[-1] = 1.0
    h = 1.0 / M
    push = np.zeros(size)
    push[2 * M - 1] = 3.0 / h
    y0 = np.zeros(size)
    y0[w], y0[s], y0[-1] = L @ system.q0, system.v0, system.q0[-1]
    to_q, to_v = np.zeros((M, size)), np.zeros((M, size))
    to_q[:, w], to_v[:, s] = np.linalg.inv(L), np.eye(M)
    return FirstOrderSystem(
        matrix=matrix,
        loads=tuple((column(p), f) for p, f in system.loads),
        contacts=tuple(FirstOrderContact(row=tip, column=push, contact=c) for c in system.contacts),
        observe=None if system.observe is None else tip,
        y0=y0,
        to_q=to_q,
        to_v=to_v,
        system=system,
    )


def _tip(M: int) -> Array:
    row = np.zeros(M)
    row[-1] = 1.0
    return row


def _contacts(problem: BeamProblem, M: int) -> tuple[Contact, ...]:
    return () if problem.stops is None else (Contact(_tip(M), problem.stops),)


def _initial(problem: BeamProblem, M: int) -> dict[str, Array]:
    """v(x,0) = u0 - phi(0) (1 - x^2) and v_t(x,0) = v0 - phi'(0) (1 - x^2) at the nodes."""
    x = np.arange(1, M + 1) / M
    phi = 0.0 if problem.base is None else float(problem.base.value(0.0))
    rate = 0.0 if problem.base is None else float(problem.base.rate(0.0))
    u0 = phi if problem.initial_displacement is None else problem.initial_displacement(x)
    v0 = 0.0 if problem.initial_velocity is None else problem.initial_velocity(x)
    lift = 1.0 - x**2
    return {"q0": np.asarray(u0 - phi * lift, float) + 0.0, "v0": np.asarray(v0 - rate * lift, float) + 0.0 * x}


def _loads(problem: BeamProblem, M: int, mass: Array, clamp: Array) -> tuple[tuple[Array, LoadFunction], ...]:
    """Base motion -mass (1 - x^2) phi'' and clamp (k^2 phi + d phi'), then the loads mass f.

    A Dirac load is spread on the two nodes beside it as the generalised force (1 - theta, theta).
    """
    x = np.arange(1, M + 1) / M
    loads: list[tuple[Array, LoadFunction]] = []
    phi = problem.base
    if phi is not None:
        k2, d = problem.stiffness, problem.viscosity
        loads.append((-(mass @ (1.0 - x**2)), _derivative(phi, 2)))
        loads.append((k2 * clamp, phi if isinstance(phi, (Harmonic, Constant)) else phi.value))
        if d > 0:
            loads.append((d * clamp, _derivative(phi, 1)))
    for load in problem.loads:
        if isinstance(load, PointLoad):
            loads.append((_dirac(load.position, M), load.time))
        elif isinstance(load, DistributedLoad):
            shape = np.broadcast_to(np.asarray(load.shape(x), float), x.shape)
            loads.append((mass @ shape, load.time))
    return tuple(loads)


def _dirac(position: float, M: int) -> Array:
    """Hat-function weights of the nodes beside ``position``; the share of the clamped node 0 is lost."""
    cell = min(int(position * M), M - 1)
    theta = position * M - cell
    weights = np.zeros(M + 1)
    weights[cell], weights[cell + 1] = 1.0 - theta, theta
    return weights[1:]


def _derivative(phi: TimeFunction, times: int) -> LoadFunction:
    """phi' or phi''; a Harmonic stays one, so that the exact solvers can take it."""
    if isinstance(phi, Harmonic):
        if times == 2:
            return Harmonic(-phi.amplitude * phi.frequency**2, phi.frequency, phi.phase)
        return Harmonic(phi.amplitude * phi.frequency, phi.frequency, phi.phase + np.pi / 2)
    if isinstance(phi, Constant):
        return Constant(0.0)
    return phi.rate if times == 1 else phi.acceleration


def beam_displacement(system: System, t: Array, q: Array, x: ArrayLike) -> Array:
    """u(x, t) = v + phi (1 - x^2), v by a cubic spline through the nodes with v = v_x = 0 at the clamp."""
    from scipy.interpolate import CubicSpline

    if system.problem is None:
        raise InputError("displacement(x)", system.form, "be asked of a beam", "for from_matrices use run.states")
    x = np.asarray(x, float)
    if np.any((x < 0.0) | (x > 1.0)):
        raise InputError("x", x, "lie in [0, 1]")
    M = system.size
    values = np.concatenate([np.zeros((*q.shape[:-1], 1)), q], axis=-1)
    ends: Any = ((1, np.zeros(q.shape[:-1])), "not-a-knot")
    spline = CubicSpline(np.arange(M + 1) / M, values, axis=-1, bc_type=ends)
    phi = system.problem.base
    return spline(x) if phi is None else spline(x) + np.multiply.outer(phi.value(t), 1.0 - x**2)
