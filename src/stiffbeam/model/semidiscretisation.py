"""BeamProblem -> System: the paper's space discretisations, Dumont (2002), Section 3, and cubic Hermite elements.

All are written in v = u - phi(t) (1 - (x/L)^2), which vanishes with its slope at the clamp and leaves the
tip alone, u(L, t) = v(L, t). Grid: h = L/M, x_i = i h, unknowns at x_1..x_M. The paper has L = m = 1,
k^2 for EI and d for eta. Point loads and stops between nodes act through linear interpolation, whose error
for a smooth v is theta (1 - theta) h^2/2 v_xx, theta in [0, 1] the place within the cell. A stop at x
meets u - m(t) = v + o(t) with

    o(t) = phi(t) (1 - (x/L)^2) - m(t),   m the stop's own motion.

It acts through the same row as a point load at its place, so that its force does its virtual work on the position
it measures: ``row(share)`` of a discretisation is the row of v at x = share L.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from ..basics.arrays import Array, read_only
from ..basics.resources import afford
from ..basics.validation import InputError, instance, integer, one_of
from .beam import bending_stencil, free_unknowns, interpolation, shape_functions, velocity_curvature_matrices
from .contact import Contact, Stops
from .modes import damping_of, undamped_modes
from .problem import BeamProblem, PointLoad, Profile
from .system import Origin, System
from .time_functions import LoadFunction, Superposition, derivative

# Element matrices for (v_0, h v_0', v_1, h v_1'). MASS is times m h/420.
MASS = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
# Of its stiffness a a^T + b b^T, times EI/h^3: the mean curvature of an element and its slope.
MEAN, SLOPE = np.array([0.0, -1.0, 0.0, 1.0]), np.sqrt(3.0) * np.array([2.0, 1.0, -2.0, 1.0])
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(6)  # integrates loads of degree 8 along an element exactly
POINTS, WEIGHTS = 0.5 * (POINTS + 1.0), 0.5 * WEIGHTS


@dataclass(frozen=True, eq=False, kw_only=True)
class Grid:
    """Matrices of a beam on a grid, and the virtual work of what acts along x on v.

    stiffness_factor: G with G^T G = stiffness. row: of v at x = share L. work: int f v dx of a function f of x.
    bending: the work of EI phi, over EI. values: the unknowns of a function of x.
    """

    mass: Array
    damping: Array
    stiffness: Array
    stiffness_factor: Array
    row: Callable[[float], Array]
    work: Callable[[Profile], Array]
    bending: Array
    values: Callable[[Profile], Array]


FORMS = ("displacement", "velocity-curvature")  # the paper's
ALL_FORMS = (*FORMS, "hermite")


def semidiscretise(problem: BeamProblem, cells: int, form: str = "displacement") -> System:
    """Return the semi-discrete system of a beam by the method of lines.

    Parameters
    ----------
    problem : BeamProblem
        Beam, supports, stops, base motion and loads.
    cells : int
        M >= 4 cells of length h = L/M.
    form : {"displacement", "velocity-curvature", "hermite"}
        "displacement": (3.5) and (3.6), one System; a scheme for first-order systems reads it as (3.5), one for
        second-order systems as (3.6). "velocity-curvature": (3.12), without viscosity only. Both are of second order in
        h, for a clamped-free beam. "hermite": cubic finite elements of fourth order, for all supports.

    Returns
    -------
    System
        With M unknowns, 2M and fewer by the supports for "hermite".

    Raises
    ------
    InputError
        For a grid that is too coarse or too large, and for a form that cannot hold the problem.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> problem = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(upper=0.1, stiffness=5e6))
    >>> sb.semidiscretise(problem, cells=25)
    <System, displacement: 25 unknowns, 0 loads, 1 contact>
    """
    instance("problem", problem, BeamProblem, "make one with stiffbeam.BeamProblem")
    cells = integer("cells", cells, 4)  # the stencils at both ends must not overlap
    one_of("form", form, ALL_FORMS)
    # A dozen dense matrices.
    afford("cells", cells, "take fewer cells", floats=12.0 * (cells * (2.0 if form == "hermite" else 1.0)) ** 2)
    for name in problem.for_elements if form != "hermite" else ():
        rule = f"be {'clamped-free' if name == 'supports' else 'left out'} in the {form} form"
        raise InputError(name, getattr(problem, name), rule, "the stencils have no place for it: use the form hermite")
    make = {"displacement": _displacement, "velocity-curvature": _velocity_curvature, "hermite": _hermite}[form]
    grid = make(problem, cells)
    system = _system(problem, form, cells, grid)
    # Modal damping takes the modes of the system, which is therefore built without it first.
    if np.any(problem.modal_damping):
        damping = grid.damping + damping_of(undamped_modes(system), problem.modal_damping)
        system = _system(problem, form, cells, replace(grid, damping=0.5 * (damping + damping.T)))
    return system


def _system(problem: BeamProblem, form: str, cells: int, grid: Grid) -> System:
    """The system of a grid: its loads, contacts and start v(x, 0) = u0 - phi(0) (1 - (x/L)^2), v_t alike."""
    contacts = tuple(_contact(problem, stops, grid.row) for stops in problem.all_stops)
    tip = grid.row(1.0 if problem.ends[1] == "free" else 0.5)
    reads_tip = bool(contacts) and contacts[0].offset is None and np.array_equal(contacts[0].row, tip)
    phi, L = problem.base, problem.length
    base, speed = (0.0, 0.0) if phi is None else (float(phi.value(0.0)), float(phi.rate(0.0)))
    u0, v0 = problem.initial_displacement, problem.initial_velocity
    system = System(
        mass=grid.mass,
        damping=grid.damping,
        stiffness=grid.stiffness,
        loads=_loads(problem, grid),
        contacts=contacts,
        observe=None if reads_tip else tip,
        q0=grid.values(lambda x: (base if u0 is None else u0(x)) - base * (1.0 - (x / L) ** 2)),
        units=problem.units,
        v0=grid.values(lambda x: (0.0 if v0 is None else v0(x)) - speed * (1.0 - (x / L) ** 2)),
    )
    factor = read_only(grid.stiffness_factor)
    origin = Origin(problem=problem, form=form, cells=cells, stiffness_factor=factor, made=system)
    return replace(system, origin=origin)


def _contact(problem: BeamProblem, stops: Stops, row: Callable[[float], Array]) -> Contact:
    share = problem.place(stops) / problem.length
    moves = [(1.0 - share**2, problem.base), (-1.0, stops.motion)]
    moves = [(factor, f) for factor, f in moves if f is not None and factor]
    at_a_place = stops.position is not None or stops.motion is not None
    stops = replace(stops, position=None, motion=None) if at_a_place else stops
    return Contact(row(share), stops, Superposition(terms=moves) if moves else None)


def _loads(problem: BeamProblem, grid: Grid) -> tuple[tuple[Array, LoadFunction], ...]:
    """Base motion inertia (phi'' + a phi') and bending (EI phi + eta phi'), then the loads of the problem."""
    loads: list[tuple[Array, LoadFunction]] = []
    phi = problem.base
    if phi is not None:  # of a clamped-free beam
        inertia = -problem.mass_per_length * grid.work(lambda x: 1.0 - (x / problem.length) ** 2)
        loads += [(inertia, derivative(phi, 2)), (problem.stiffness * grid.bending, phi)]
        drag = problem.viscosity * grid.bending + problem.mass_damping * inertia
        if np.any(drag):
            loads.append((drag, derivative(phi, 1)))
    for load in problem.loads:
        point = isinstance(load, PointLoad)
        loads.append((grid.row(load.position / problem.length) if point else grid.work(load.shape), load.time))
    return tuple(loads)


def _nodal(problem: BeamProblem, weights: Array, bending: Array, **matrices: Array) -> Grid:
    """A form of the paper: its unknowns are v at the nodes, with their ``weights`` of integration."""
    M, L = len(weights), problem.length
    nodes = np.arange(1, M + 1)
    x = L * (nodes / M)

    def values(f: Profile) -> Array:
        return np.broadcast_to(np.asarray(f(x), float), x.shape) + 0.0

    return Grid(
        row=lambda share: np.maximum(0.0, 1.0 - np.abs(share * M - nodes)),
        work=lambda f: _weighted(weights, values(f)),
        bending=bending,
        values=values,
        **matrices,
    )


def _displacement(problem: BeamProblem, M: int) -> Grid:
    """(3.6) times h D, D = diag(1, ..., 1, 1/2): M = m h D, K = -EI h D H, C = -eta h D H.

    -v^T D H v = 1/2 kappa_0^2 + sum_i kappa_i^2 with the curvatures kappa_0 = 2 v_1/h^2 and
    kappa_i = (v_{i-1} - 2 v_i + v_{i+1})/h^2, which gives the factor G of the stiffness.
    """
    L = problem.length
    weights = np.full(M, L / M)
    weights[-1] = 0.5 * L / M
    clamp = np.zeros(M)  # (2.5) in v: EI v_xx + eta v_xxt = 2 (EI phi + eta phi')/L^2
    clamp[-2:] = (-2.0 * M / L**3, 2.0 * M / L**3)
    # The stencil is whole numbers, scaled once: equal on every machine.
    stencil = bending_stencil(M) * (M / L) ** 3
    factor = np.vstack([np.zeros(M), (np.eye(M, k=1) - 2.0 * np.eye(M) + np.eye(M, k=-1))[:-1]])
    factor[0, 0] = np.sqrt(2.0)  # sqrt(1/2) kappa_0
    mass = problem.mass_per_length * weights
    mass[-1] += problem.tip_mass
    damping = problem.viscosity * stencil
    if problem.mass_damping > 0:  # a sum with zero would change the sign of zeros, and so the fingerprint
        damping = damping + problem.mass_damping * np.diag(mass)
    return _nodal(
        problem,
        np.diag(weights),
        clamp,
        mass=np.diag(mass),
        damping=damping,
        stiffness=problem.stiffness * stencil,
        stiffness_factor=np.sqrt(problem.stiffness) * (factor * np.sqrt((M / L) ** 3)),
    )


def curvature_stencil(M: int) -> Array:
    """24 h^3 L^T Q L of (3.12), whole numbers, so that every machine makes the same matrix of it."""
    _, Q, L, _ = velocity_curvature_matrices(M, float(M))  # h = 1
    return np.rint(24.0 * (L.T @ Q @ L))


def _velocity_curvature(problem: BeamProblem, M: int) -> Grid:
    """(3.12) with w = L x, s = x':  m P x'' + EI L^T Q L x = P f + sigma e_M.

    With w' = L s and m s' = -EI R w + f + (3/h) sigma e_M the weights P and Q satisfy P R = L^T Q, so
    the energy is m/2 s^T P s + EI/2 w^T Q w and the form is a symmetric second-order system.
    """
    for name in ("viscosity", "tip_mass", "mass_damping"):
        if getattr(problem, name) > 0:
            remedy = "(3.12) eliminates the displacement and has no place for it: use the form displacement"
            raise InputError(name, getattr(problem, name), "be 0 in the velocity-curvature form", remedy)
    P, Q, L, _ = velocity_curvature_matrices(M, problem.length)
    h = problem.length / M
    moment = np.zeros(M)
    moment[-2:] = (-2.0 / h**2, 7.0 / h**2)  # w_M = 2 phi/L^2 in the last two rows of -EI R w, (3.10)
    moment /= problem.length**2
    return _nodal(
        problem,
        P,
        _weighted(P, moment),
        mass=problem.mass_per_length * P,
        damping=np.zeros((M, M)),
        stiffness=problem.stiffness * (curvature_stencil(M) / 24.0 * (M / problem.length) ** 3),
        stiffness_factor=np.sqrt(problem.stiffness) * scipy.linalg.cholesky(Q) @ L,
    )


def _weighted(weights: Array, values: Array) -> Array:
    """weights @ values for tridiagonal weights, entry by entry: a sum in an order of its own, which a library's product
    is not, gives the same bits, and so the same fingerprint, on every machine."""
    beside = np.diag(weights, 1)
    out = np.diag(weights) * values
    out[:-1] += beside * values[1:]
    out[1:] += beside * values[:-1]
    return out


def _hermite(problem: BeamProblem, M: int) -> Grid:
    """M cubic elements: inertia is -int m (1 - (x/L)^2) v dx, bending (2/L^2) int v_xx dx = (2/L^2) v_x(L)."""
    L, h = problem.length, problem.length / M
    free = free_unknowns(problem.ends, M)

    def work(f: Profile) -> Array:
        """int f N_i dx over the beam, for every unknown i."""
        total, N = np.zeros(2 * M + 2), shape_functions(POINTS)
        for e in range(M):
            x = h * (e + POINTS)
            values = np.broadcast_to(np.asarray(f(x), float), x.shape)
            total[2 * e : 2 * e + 4] += h * np.sum((WEIGHTS * values)[:, None] * N, axis=0)
        return total[free]

    def row(share: float) -> Array:
        return interpolation(np.array(share), M)[free]

    # Element matrices, summed over the elements.
    factor = np.zeros((2 * M + 2, 2 * M + 2))  # two zero rows, so that a free beam has its rigid motions
    gram = np.zeros((2 * M + 2, 2 * M + 2))
    for e in range(M):
        here = slice(2 * e, 2 * e + 4)
        factor[2 * e, here], factor[2 * e + 1, here] = MEAN, SLOPE
        gram[here, here] += MASS * (h / 420.0)
    # Without the unknowns that the supports hold. The stencil is whole numbers.
    gram, factor = gram[np.ix_(free, free)], factor[:, free]
    bending = np.rint(factor.T @ factor) + 0.0  # no signed zeros
    tip = row(1.0) if problem.ends[1] == "free" else row(0.5)
    slope = (np.arange(2 * M + 2) == 2 * M + 1)[free] * (M / L)  # v_x(L)
    mass = problem.mass_per_length * gram + problem.tip_mass * np.outer(tip, tip)
    stiffness = problem.stiffness / h**3 * bending
    damping = (problem.viscosity / problem.stiffness) * stiffness + problem.mass_damping * mass

    def values(f: Profile) -> Array:
        """The mean-square nearest to f: exact for cubics, and it asks for no slope."""
        moments = work(f)
        return np.asarray(scipy.linalg.solve(gram, moments, assume_a="pos")) if np.any(moments) else 0.0 * moments

    return Grid(
        mass=mass,
        damping=0.5 * (damping + damping.T),
        stiffness=stiffness,
        stiffness_factor=np.sqrt(problem.stiffness / h**3) * factor,
        row=row,
        work=work,
        bending=2.0 / L**2 * slope,
        values=values,
    )
