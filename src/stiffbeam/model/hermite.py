"""BeamProblem -> System by cubic Hermite elements with consistent mass: any supports, fourth order in h.

Unknowns: v and h v_x at every node, both lengths, less what the supports hold (see hermite_elements).

    M_e = m h/420 MASS + J/(30 h) ROTARY,   K_e = EI/h^3 STIFFNESS,   C = eta/EI K + a M + modal damping

The frequencies converge from above at order 4; v and its slope are exact at the nodes of a beam at rest under
loads at nodes. Frame, base motion and stops as in the other forms, see frame. Source: any text on finite elements,
for example Hughes, The Finite Element Method (1987), Section 1.16.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from .first_order import FirstOrderSystem, interleaved
from .frame import contacts, observed
from .hermite_elements import (
    BENDING,
    MASS,
    MEAN,
    POINTS,
    ROTARY,
    SLOPE,
    WEIGHTS,
    free_unknowns,
    interpolation,
    shape_functions,
)
from .modal_damping import damping_of
from .modes import undamped_modes
from .origin import Origin
from .problem import BeamProblem, PointLoad
from .sections import element_factors
from .system import System
from .time_functions import LoadFunction, derivative


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
    factor = np.sqrt(problem.stiffness / h**3) * factor[:, free]
    gram, inertia, bending = (matrix[np.ix_(free, free)] for matrix in (gram, inertia, bending))
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
    made = System(
        mass=mass,
        damping=0.5 * (damping + damping.T),
        stiffness=stiffness,
        loads=_loads(problem, integral, row, slope, (stiffer, heavier)),
        contacts=stops,
        observe=observed(stops, tip),
        # The mean-square nearest to the given data: exact for cubics, and it asks for no slope.
        q0=_projected(gram, integral(lambda x: (phi if u0 is None else u0(x)) - phi * (1.0 - (x / L) ** 2))),
        v0=_projected(gram, integral(lambda x: (0.0 if v0 is None else v0(x)) - rate * (1.0 - (x / L) ** 2))),
    )
    names = ("mass", "damping", "stiffness", "loads", "contacts", "q0", "v0")

    def known(made: System) -> System:
        own = {name: getattr(made, name) for name in names}
        origin = Origin(
            problem=problem, form="hermite", cells=M, stiffness_factor=factor, paper_form=_first_order, tip=tip, **own
        )
        return replace(made, origin=origin)

    if not problem.modal_damping:
        return known(made)
    damping = made.damping + damping_of(undamped_modes(known(made)), problem.modal_damping)
    return known(replace(made, damping=0.5 * (damping + damping.T)))


def _projected(gram: Array, moments: Array) -> Array:
    return np.asarray(scipy.linalg.solve(gram, moments, assume_a="pos")) if np.any(moments) else np.zeros(len(gram))


def _first_order(system: System, problem: BeamProblem) -> FirstOrderSystem:
    """The paper has no form of its own for elements: positions and velocities, interleaved."""
    return interleaved(system)


def _loads(
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
