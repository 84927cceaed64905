"""BeamProblem -> System: the paper's space discretisations, Dumont (2002), Section 3, and cubic Hermite elements.

All are written in v = u - phi(t) (1 - (x/L)^2), which vanishes with its slope at the clamp and leaves the
tip alone, u(L, t) = v(L, t). Grid: h = L/M, x_i = i h, unknowns at x_1..x_M. The paper has L = m = 1,
k^2 for EI and d for eta. Point loads and stops between nodes act through linear interpolation, see hat.
A stop at x meets u - m(t) = v + o(t) with

    o(t) = phi(t) (1 - (x/L)^2) - m(t),   m the stop's own motion.

It acts through the same row as a point load at its place, so that its force does its virtual work on the position
it measures: ``row(share)`` of a discretisation is the row of v at x = share L.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.resources import afford
from ..basics.validation import InputError, itself, one_of
from .beam import BENDING, MASS, MEAN, POINTS, ROTARY, SLOPE, WEIGHTS, free_unknowns, interpolation, shape_functions
from .contact import Contact, Stops
from .modes import damping_of, undamped_modes
from .problem import BeamProblem, DistributedLoad, PointLoad, element_factors
from .stencils import bending_stencil, velocity_curvature_matrices
from .system import Origin, System
from .time_functions import LoadFunction, combined, derivative

Row = Callable[[float], Array]


def contacts(problem: BeamProblem, row: Row) -> tuple[Contact, ...]:
    """Contacts of the stops, one each, in their order."""
    return tuple(_contact(problem, stops, row) for stops in problem.all_stops)


def _contact(problem: BeamProblem, stops: Stops, row: Row) -> Contact:
    share = problem.place(stops) / problem.length
    offset = combined((1.0 - share**2, problem.base), (-1.0, stops.motion))
    at_a_place = stops.position is not None or stops.motion is not None
    return Contact(row(share), replace(stops, position=None, motion=None) if at_a_place else stops, offset)


def observed(stops: tuple[Contact, ...], tip: Array) -> Array | None:
    """The row of ``tip``, None where the first contact reads just that."""
    reads_tip = bool(stops) and stops[0].offset is None and np.array_equal(stops[0].row, tip)
    return None if reads_tip else tip


def hat(share: float, M: int) -> Array:
    """Linear interpolation between the nodes beside x = share L; node 0 is held.

    The error for a smooth v is theta (1 - theta) h^2/2 v_xx, theta in [0, 1] the place within the cell: second order.
    """
    cell = min(int(share * M), M - 1)
    theta = share * M - cell
    weights = np.zeros(M + 1)
    weights[cell], weights[cell + 1] = 1.0 - theta, theta
    return weights[1:]


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
    itself("problem", problem, BeamProblem)
    if isinstance(cells, bool) or not isinstance(cells, (int, np.integer)) or cells < 4:
        raise InputError("cells", cells, "be an integer >= 4", "the stencils at both ends must not overlap")
    one_of("form", form, ALL_FORMS)
    # A dozen dense matrices.
    unknowns = float(min(cells, 2**53)) * (2.0 if form == "hermite" else 1.0)
    afford("cells", cells, "take fewer cells", floats=12.0 * unknowns**2)
    if form == "hermite":
        return hermite(problem, int(cells))
    if problem.supports != "clamped-free":
        rule = f"be clamped-free in the {form} form"
        raise InputError("supports", problem.supports, rule, "its stencils are the cantilever's: use the form hermite")
    for name in problem.for_elements:
        remedy = "the paper's stencils have no place for it: use the form hermite"
        raise InputError(name, getattr(problem, name), f"be left out in the {form} form", remedy)
    return _displacement(problem, int(cells)) if form == "displacement" else _velocity_curvature(problem, int(cells))


def _displacement(problem: BeamProblem, M: int) -> System:
    """(3.6) times h D, D = diag(1, ..., 1, 1/2): M = m h D, K = -EI h D H, C = -eta h D H.

    -v^T D H v = 1/2 kappa_0^2 + sum_i kappa_i^2 with the curvatures kappa_0 = 2 v_1/h^2 and
    kappa_i = (v_{i-1} - 2 v_i + v_{i+1})/h^2, which gives the factor G of the stiffness.
    """
    L, m = problem.length, problem.mass_per_length
    weights = np.full(M, L / M)
    weights[-1] = 0.5 * L / M
    clamp = np.zeros(M)  # (2.5) in v: EI v_xx + eta v_xxt = 2 (EI phi + eta phi')/L^2
    clamp[-2:] = (-2.0 * M / L**3, 2.0 * M / L**3)
    # Beams that differ by base, loads, stops and starts share their matrices, and what is derived from these.
    key = (M, L, m, problem.stiffness, problem.viscosity, problem.tip_mass, problem.mass_damping)
    other = _CANTILEVERS.get(key)
    arrays = _matrices(problem, M, weights) if other is None or other.origin is None else {
        name: getattr(other.origin, name) for name in ("mass", "damping", "stiffness", "stiffness_factor")
    }  # fmt: skip
    system = _made(
        **arrays,
        loads=_loads(problem, np.diag(weights), clamp),
        **_initial(problem, M),
        form="displacement",
        problem=problem,
    )
    _CANTILEVERS.setdefault(key, system)
    return system


_CANTILEVERS: WeakValueDictionary[tuple[float, ...], System] = WeakValueDictionary()  # by the numbers of the matrices


def _matrices(problem: BeamProblem, M: int, weights: Array) -> dict[str, Array]:
    # The stencil is whole numbers, scaled once: equal on every machine.
    L = problem.length
    bending = bending_stencil(M) * (M / L) ** 3
    factor = np.vstack([np.zeros(M), (np.eye(M, k=1) - 2.0 * np.eye(M) + np.eye(M, k=-1))[:-1]])
    factor[0, 0] = np.sqrt(2.0)  # sqrt(1/2) kappa_0
    factor *= np.sqrt((M / L) ** 3)
    mass = problem.mass_per_length * weights
    mass[-1] += problem.tip_mass
    damping = problem.viscosity * bending
    if problem.mass_damping > 0:  # a sum with zero would change the sign of zeros, and so the fingerprint
        damping = damping + problem.mass_damping * np.diag(mass)
    return {
        "mass": np.diag(mass),
        "damping": damping,
        "stiffness": problem.stiffness * bending,
        "stiffness_factor": np.sqrt(problem.stiffness) * factor,
    }


def _made(
    *, problem: BeamProblem, form: str, stiffness_factor: Array, **arrays: Any
) -> System:  # fmt: skip
    """The system with its origin."""
    M = len(arrays["mass"])
    stops = contacts(problem, lambda share: hat(share, M))
    system = System(**arrays, contacts=stops, observe=observed(stops, _tip(M)))
    return _with_origin(
        system, problem=problem, form=form, cells=M, stiffness_factor=stiffness_factor, tip=_tip(M)
    )  # fmt: skip


def _with_origin(system: System, **facts: Any) -> System:
    """A new system, which nothing has read yet, with an Origin of the ``facts`` and of its own arrays."""
    names = ("mass", "damping", "stiffness", "loads", "contacts", "q0", "v0")
    origin = Origin(**facts, **{name: getattr(system, name) for name in names})
    # In place: all that ``replace`` would check again has just been checked.
    object.__setattr__(system, "origin", origin)
    object.__setattr__(system, "units", origin.problem.units)
    return system


def curvature_stencil(M: int) -> Array:
    """24 h^3 L^T Q L of (3.12), whole numbers, so that every machine makes the same matrix of it."""
    second = 2.0 * (np.eye(M) - 2.0 * np.eye(M, k=-1) + np.eye(M, k=-2))
    second[0, :2] = (8.0, -1.0)  # (3.9)
    weights = 8.0 * np.eye(M) - np.eye(M, k=1) - np.eye(M, k=-1)
    weights[0, :2], weights[1, 0] = (2.0, 0.0), 0.0
    return second.T @ weights @ second


def _velocity_curvature(problem: BeamProblem, M: int) -> System:
    """(3.12) with w = L x, s = x':  m P x'' + EI L^T Q L x = P f + sigma e_M.

    With w' = L s and m s' = -EI R w + f + (3/h) sigma e_M the weights P and Q satisfy P R = L^T Q, so
    the energy is m/2 s^T P s + EI/2 w^T Q w and the form is a symmetric second-order system.
    """
    if problem.viscosity > 0:
        remedy = "(3.12) eliminates the displacement, and eta u_xxxxt has no place in it: use the form displacement"
        raise InputError("viscosity", problem.viscosity, "be 0 in the velocity-curvature form", remedy)
    for name in ("tip_mass", "mass_damping"):
        if getattr(problem, name) > 0:
            rule = "be 0 in the velocity-curvature form"
            raise InputError(
                name, getattr(problem, name), rule, "(3.12) has no place for it: use the form displacement"
            )
    P, Q, L, _ = velocity_curvature_matrices(M, problem.length)
    h = problem.length / M
    moment = np.zeros(M)
    moment[-2:] = (-2.0 / h**2, 7.0 / h**2)  # w_M = 2 phi/L^2 in the last two rows of -EI R w, (3.10)
    moment /= problem.length**2
    factor = np.sqrt(problem.stiffness) * scipy.linalg.cholesky(Q) @ L
    return _made(
        mass=problem.mass_per_length * P,
        damping=np.zeros((M, M)),
        stiffness=problem.stiffness * (curvature_stencil(M) / 24.0 * (M / problem.length) ** 3),
        loads=_loads(problem, P, _weighted(P, moment)),
        **_initial(problem, M),
        stiffness_factor=factor,
        form="velocity-curvature",
        problem=problem,
    )


def _tip(M: int) -> Array:
    row = np.zeros(M)
    row[-1] = 1.0
    return row


def _initial(problem: BeamProblem, M: int) -> dict[str, Array]:
    """v(x,0) = u0 - phi(0) (1 - (x/L)^2) and v_t(x,0) = v0 - phi'(0) (1 - (x/L)^2) at the nodes."""
    x, lift = _nodes(problem, M)
    phi = 0.0 if problem.base is None else float(problem.base.value(0.0))
    rate = 0.0 if problem.base is None else float(problem.base.rate(0.0))
    u0 = phi if problem.initial_displacement is None else problem.initial_displacement(x)
    v0 = 0.0 if problem.initial_velocity is None else problem.initial_velocity(x)
    return {"q0": np.asarray(u0 - phi * lift, float) + 0.0, "v0": np.asarray(v0 - rate * lift, float) + 0.0 * x}


def _nodes(problem: BeamProblem, M: int) -> tuple[Array, Array]:
    """x_1..x_M and 1 - (x/L)^2 there."""
    share = np.arange(1, M + 1) / M
    return problem.length * share, 1.0 - share**2


def _weighted(weights: Array, values: Array) -> Array:
    """weights @ values for tridiagonal weights, entry by entry: a sum in an order of its own, which a library's product
    is not, gives the same bits, and so the same fingerprint, on every machine."""
    beside = np.diag(weights, 1)
    out = np.diag(weights) * values
    out[:-1] += beside * values[1:]
    out[1:] += beside * values[:-1]
    return out


def _loads(problem: BeamProblem, weights: Array, clamp: Array) -> tuple[tuple[Array, LoadFunction], ...]:
    """Base motion -m weights (1 - (x/L)^2) (phi'' + a phi') and clamp (EI phi + eta phi'), then the loads weights f.

    A Dirac load is spread on the two nodes beside it as the generalised force (1 - theta, theta), see ``hat``.
    """
    M = len(weights)
    x, lift = _nodes(problem, M)
    loads: list[tuple[Array, LoadFunction]] = []
    phi = problem.base
    if phi is not None:
        loads.append((-problem.mass_per_length * _weighted(weights, lift), derivative(phi, 2)))
        loads.append((problem.stiffness * clamp, phi))
        if problem.viscosity > 0:
            loads.append((problem.viscosity * clamp, derivative(phi, 1)))
        if problem.mass_damping > 0:
            drag = -problem.mass_damping * problem.mass_per_length * _weighted(weights, lift)
            loads.append((drag, derivative(phi, 1)))
    for load in problem.loads:
        if isinstance(load, PointLoad):
            loads.append((hat(load.position / problem.length, M), load.time))
        elif isinstance(load, DistributedLoad):
            shape = np.broadcast_to(np.asarray(load.shape(x), float), x.shape)
            loads.append((_weighted(weights, shape), load.time))
    return tuple(loads)


def hermite(problem: BeamProblem, M: int) -> System:
    """The system of ``M`` elements."""
    L, h = problem.length, problem.length / M
    free = free_unknowns(problem.ends, M)

    stiffer, heavier = (element_factors(problem.sections, L, M, name) for name in ("stiffness", "mass"))

    def integral(shape: Callable[[Array], ArrayLike], times: int = 0, factor: Array | None = None) -> Array:
        """int factor shape d^times N_i/dx^times dx over the beam, for every unknown i; shape takes an array of x."""
        total, N = np.zeros(2 * M + 2), shape_functions(POINTS, times)
        by = np.ones(M) if factor is None else factor / h**times
        for e in range(M):
            x = h * (e + POINTS)
            values = np.broadcast_to(np.asarray(shape(x), float), x.shape)
            total[2 * e : 2 * e + 4] += by[e] * (h * np.sum((WEIGHTS * values)[:, None] * N, axis=0))
        return total[free]

    def row(share: float) -> Array:
        return interpolation(np.array(share), M)[free]

    # Element matrices, summed over the elements.
    factor = np.zeros((2 * M + 2, 2 * M + 2))  # two zero rows, so that a free beam has its rigid motions
    gram, inertia, bending = np.zeros((3, 2 * M + 2, 2 * M + 2))
    for e in range(M):
        here = slice(2 * e, 2 * e + 4)
        factor[2 * e, here], factor[2 * e + 1, here] = np.sqrt(stiffer[e]) * MEAN, np.sqrt(stiffer[e]) * SLOPE
        bending[here, here] += stiffer[e] * BENDING
        gram[here, here] += MASS * (h / 420.0)
        inertia[here, here] += heavier[e] * (MASS * (h / 420.0))
        if problem.rotary_inertia:
            inertia[here, here] += heavier[e] * problem.rotary_inertia / problem.mass_per_length / (30.0 * h) * ROTARY
    # Without the unknowns that the supports hold.
    factor = np.sqrt(problem.stiffness / h**3) * factor[:, free]
    gram, inertia, bending = (matrix[np.ix_(free, free)] for matrix in (gram, inertia, bending))
    # Where the end at x = L is held, the middle of the beam is observed.
    tip = row(1.0) if problem.ends[1] == "free" else row(0.5)
    slope = interpolation(np.array(1.0), M, times=1)[free] * (M / L)  # v_x(L)
    mass = problem.mass_per_length * inertia
    if problem.tip_mass:
        mass = mass + problem.tip_mass * np.outer(tip, tip)
    if problem.tip_inertia:
        mass = mass + problem.tip_inertia * np.outer(slope, slope)
    stiffness = problem.stiffness / h**3 * bending
    damping = (problem.viscosity / problem.stiffness) * stiffness + problem.mass_damping * mass
    stops = contacts(problem, row)
    phi = 0.0 if problem.base is None else float(problem.base.value(0.0))
    rate = 0.0 if problem.base is None else float(problem.base.rate(0.0))
    u0, v0 = problem.initial_displacement, problem.initial_velocity
    system = System(
        mass=mass,
        damping=0.5 * (damping + damping.T),
        stiffness=stiffness,
        loads=_element_loads(problem, integral, row, slope, (stiffer, heavier)),
        contacts=stops,
        observe=observed(stops, tip),
        # The mean-square nearest to the given data: exact for cubics, and it asks for no slope.
        q0=_projected(gram, integral(lambda x: (phi if u0 is None else u0(x)) - phi * (1.0 - (x / L) ** 2))),
        v0=_projected(gram, integral(lambda x: (0.0 if v0 is None else v0(x)) - rate * (1.0 - (x / L) ** 2))),
    )
    known = partial(
        _with_origin,
        problem=problem,
        form="hermite",
        cells=M,
        stiffness_factor=factor,
        tip=tip,
    )
    # Modal damping takes the modes of the system, which is therefore built without it first.
    if not problem.modal_damping:
        return known(system)
    damping = system.damping + damping_of(undamped_modes(known(system)), problem.modal_damping)
    return known(replace(system, damping=0.5 * (damping + damping.T)))


def _projected(gram: Array, moments: Array) -> Array:
    return np.asarray(scipy.linalg.solve(gram, moments, assume_a="pos")) if np.any(moments) else np.zeros(len(gram))


def _element_loads(
    problem: BeamProblem,
    integral: Callable[..., Array],
    row: Callable[[float], Array],
    slope: Array,
    along: tuple[Array, Array],
) -> tuple[tuple[Array, LoadFunction], ...]:
    """Work of base motion and loads on v.

    phi'' + a phi':   -int m (1 - (x/L)^2) v dx + (2/L^2) int J x v_x dx + (2/L) J_tip v_x(L)
    phi, phi':        (2/L^2) int (EI phi + eta phi') v_xx dx, for one EI (2/L^2) (EI phi + eta phi') v_x(L)
    f:                int f v dx.  slope: the row of v_x(L). along: factors of stiffness and mass by element.
    """
    loads: list[tuple[Array, LoadFunction]] = []
    phi, L, m = problem.base, problem.length, problem.mass_per_length
    if phi is not None:  # of a clamped-free beam
        stiffer, heavier = along
        # The inertia of the base motion, its rotary parts included, see the docstring.
        inertia = -m * integral(lambda x: 1.0 - (x / L) ** 2, factor=heavier)
        if problem.rotary_inertia or problem.tip_inertia:
            inertia = inertia + 2.0 * problem.rotary_inertia / L**2 * integral(lambda x: x, 1, heavier)
            inertia = inertia + 2.0 * problem.tip_inertia / L * slope
        bend = 2.0 / L**2 * (integral(np.ones_like, 2, stiffer) if problem.sections else slope)
        loads += [(inertia, derivative(phi, 2)), (problem.stiffness * bend, derivative(phi, 0))]
        drag = problem.viscosity * bend + problem.mass_damping * inertia
        if np.any(drag):
            loads.append((drag, derivative(phi, 1)))
    for load in problem.loads:
        if isinstance(load, PointLoad):
            loads.append((row(load.position / L), load.time))
        else:
            loads.append((integral(load.shape), load.time))
    return tuple(loads)
