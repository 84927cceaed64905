"""The semi-discrete problem without rounding: rational geometry, and all numbers at their exact values.

A beam's matrices are whole multiples of EI h^-3 or thirds and sixths of m h; the float64 entries of the
System carry roundings that past the horizon lead to another trajectory. Arrays are NumPy's, of fmpq and arb.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from flint import arb, ctx, fmpq

from ...basics.validation import exact_value
from ...model.contact import Stops
from ...model.problem import BeamProblem, PointLoad, PolynomialProfile, Profile
from ...model.semidiscretisation import bending_stencil, curvature_stencil
from ...model.system import System
from ...model.time_functions import Constant, Drive, Harmonic, parts

Term = tuple[Any, Any, int]  # vector (n,), function of time, order of its derivative


class ExactContact(NamedTuple):
    """Row (n,), offset in the drive coefficients (d,), kappa, c, g1, g2 (0 for a side without a stop)."""

    row: Any
    offset: Any
    kappa: Any
    damping: Any
    g1: Any
    g2: Any


class Exact(NamedTuple):
    """M, C, K (n, n), the loads' basis (d, n), the contacts, and q0, v0 (n,)."""

    mass: Any
    damping: Any
    stiffness: Any
    basis: Any
    contacts: list[ExactContact]
    q0: Any
    v0: Any


@contextmanager
def carried(bits: int) -> Generator[None, None, None]:
    """Context with a precision of so many bits."""
    before, ctx.prec = ctx.prec, bits
    try:
        yield
    finally:
        ctx.prec = before


def number(x: float) -> Any:
    """The exact value of a given number: fmpq, or at the current precision arb for a multiple of pi."""
    ratio, pi = exact_value(x)
    rational = fmpq(ratio.numerator, ratio.denominator)
    return rational * arb.pi() if pi else rational


_numbers = np.vectorize(number, otypes=[object])


def exact_problem(system: System, drive: Drive) -> Exact:
    """The problem at the current precision: call it again after raising ctx.prec."""
    # Of elements the matrices are taken as they are: see System.exact_parameters.
    beam = system.problem if system.form != "hermite" else None
    start = _numbers(system.q0), _numbers(system.v0)
    if beam is not None:
        mass, damping, stiffness, loads, of_beam = _beam(system, beam, drive)
        places = [_place(beam, stops, system.size, drive) for stops in beam.all_stops]
        start = of_beam if system.origin and system.origin.starts(system) else start
    else:
        mass, damping, stiffness = (_numbers(x) for x in (system.mass, system.damping, system.stiffness))
        places = [(_numbers(each.row), in_drive(drive, [([1], each.offset, 0)])[:, 0]) for each in system.contacts]
        loads = [(_numbers(vector), function, 0) for vector, function in system.loads]
    contacts = []
    for stops, place in zip((contact.stops for contact in system.contacts), places, strict=True):
        sides = [number(0.0 if g is None else g) for g in (stops.lower, stops.upper)]
        contacts.append(ExactContact(*place, number(stops.stiffness), number(stops.damping), *sides))
    return Exact(mass, damping, stiffness, in_drive(drive, loads, system.size), contacts, *start)


def in_drive(drive: Drive, terms: Iterable[Term], n: int = 1) -> Any:
    """A sum of vectors times time functions in closed form as a basis (d, n) of the drive coefficients."""
    frequencies, basis = [exact_value(x) for x in drive.frequencies], np.full((drive.size, n), arb(0), object)
    for vector, function, order in terms:
        for factor, part in parts(function):
            weighted = np.array(vector, object) * number(factor)
            if isinstance(part, Constant) and not order:
                basis[0] += weighted * number(part.level)
            elif isinstance(part, Harmonic):
                k = 1 + 2 * frequencies.index(exact_value(part.frequency))
                # a sin(w t + phase) = a cos(phase) sin w t + a sin(phase) cos w t.
                s, c = arb(number(part.phase)).sin_cos()
                size = number(part.amplitude)
                for _ in range(order):  # a sin(w t + phase) -> a w cos(w t + phase)
                    s, c, size = c, -s, size * number(part.frequency)
                basis[k] += weighted * (size * c)
                basis[k + 1] += weighted * (size * s)
    return basis


def _place(problem: BeamProblem, stops: Stops, M: int, drive: Drive) -> tuple[Any, Any]:
    """Row of stops on a beam by linear interpolation, and phi (1 - (x/L)^2) - m(t) in the drive coefficients."""
    position = problem.length if stops.position is None else stops.position
    share = number(position) / number(problem.length)
    offset = [([1 - share * share], problem.base, 0), ([-1], stops.motion, 0)]
    return _hat(share, M), in_drive(drive, offset)[:, 0]


def _hat(share: Any, M: int) -> Any:
    """The weights of the nodes beside x = share L, node 0 left out."""
    place = share * M
    # The tip lies at the end of the last cell.
    cell = min(int(arb(place).floor().unique_fmpz() or 0), M - 1)
    hats = np.full(M + 1, fmpq(0), object)
    hats[cell], hats[cell + 1] = 1 - (place - cell), place - cell
    return hats[1:]


def _beam(system: System, problem: BeamProblem, drive: Drive) -> tuple[Any, Any, Any, list[Term], tuple[Any, Any]]:
    """Mass, damping and stiffness of both forms, the terms of the loads, and the initial data."""
    M = system.size
    bending, viscosity = number(problem.stiffness), number(problem.viscosity)
    length, m, drag = (number(x) for x in (problem.length, problem.mass_per_length, problem.mass_damping))
    paper, phi = system.form == "displacement", problem.base
    # Matrices: stencils of whole numbers times (M/length)^3, and the weights of the nodes.
    weights = length * _weights(M, paper)
    stencil, over = (bending_stencil(M), 1) if paper else (curvature_stencil(M), 24)
    strain = stencil.astype(int).astype(object) * ((M / length) ** 3 / over)
    mass = m * weights
    mass[-1, -1] += number(problem.tip_mass)
    # (2.5) at the tip: (1 - (x/L)^2) phi has a curvature there, which v must balance.
    lift = np.array([1 - fmpq(i, M) ** 2 for i in range(1, M + 1)], object)
    clamp = np.full(M, fmpq(0), object)
    clamp[-2:] = [-2 * M / length**3, 2 * M / length**3] if paper else [-2 * M**2 / length**4, 7 * M**2 / length**4]
    clamp = clamp if paper else weights @ clamp
    # Loads of the base: its inertia and mass damping, its bending with viscosity at the tip; then those of the problem.
    loads: list[Term] = [(-m * (weights @ lift), phi, 2), (bending * clamp, phi, 0)]
    loads.append((viscosity * clamp - drag * m * (weights @ lift), phi, 1))
    x = [length * fmpq(i, M) for i in range(1, M + 1)]
    for load in problem.loads:
        point = isinstance(load, PointLoad)
        vector = _hat(number(load.position) / length, M) if point else weights @ _values(load.shape, x)
        loads.append((vector, load.time, 0))
    # The initial data in v = u - phi (1 - (x/L)^2).
    base = in_drive(drive, [([1], phi, 0)])[:, 0]
    at, rate = (
        base[0] + sum(base[2::2]),
        sum(w * s for w, s in zip(map(number, drive.frequencies), base[1::2], strict=True)),
    )
    u0 = at if problem.initial_displacement is None else _values(problem.initial_displacement, x)
    w0 = 0 if problem.initial_velocity is None else _values(problem.initial_velocity, x)
    return mass, viscosity * strain + drag * mass, bending * strain, loads, (u0 - at * lift, w0 - rate * lift)


def _values(profile: Profile, x: list[Any]) -> Any:
    """A polynomial exactly; of any other function of x, the doubles that it gives."""
    if isinstance(profile, PolynomialProfile):
        powers = [sum((number(c) * y**k for k, c in enumerate(profile.coefficients)), fmpq(0)) for y in x]
        return np.array(powers, object)
    grid = np.array([float(arb(y)) for y in x])
    return _numbers(np.broadcast_to(profile(grid), grid.shape))


def _weights(M: int, lumped: bool) -> Any:
    """The weights of the nodes over L: 1/M and half of it at the tip; or P of (3.12), h times tridiag(-1/6, 4/3, -1/6)
    and 1/3 at the tip."""
    matrix = np.full((M, M), fmpq(0), object)
    np.fill_diagonal(matrix, fmpq(1, M) if lumped else fmpq(4, 3 * M))
    matrix[-1, -1] = fmpq(1, 2 * M) if lumped else fmpq(1, 3 * M)
    for i in range(0 if lumped else M - 2):
        matrix[i, i + 1] = matrix[i + 1, i] = fmpq(-1, 6 * M)
    return matrix
