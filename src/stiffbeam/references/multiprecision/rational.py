"""The semi-discrete problem without rounding: rational geometry, and all numbers at their exact values.

A beam's matrices are whole multiples of EI h^-3 or thirds and sixths of m h; the float64 entries of the
System carry roundings that past the horizon lead to another trajectory.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb, arb_mat, ctx, fmpq

from ...basics.validation import exact_value
from ...model.contact import Stops
from ...model.problem import BeamProblem, PointLoad, PolynomialProfile, Profile
from ...model.semidiscretisation import bending_stencil, curvature_stencil
from ...model.system import System
from ...model.time_functions import Constant, Drive, Harmonic, parts


@dataclass(frozen=True, eq=False)
class ExactContact:
    """Row (n,), offset in the drive coefficients (d,), kappa, c, g1, g2 (None where free)."""

    row: list[Any]
    offset: list[Any]
    kappa: Any
    damping: Any
    g1: Any
    g2: Any

    def stop(self, side: int) -> Any:
        """The position of the stop on ``side``; 0 for a side without one, which is never entered."""
        gap = self.g2 if side > 0 else self.g1
        return arb(0) if gap is None else gap


@dataclass(frozen=True, eq=False)
class Exact:
    """M, C, K (n, n) and the loads' basis (d, n) as arb_mat; contacts; q0, v0 (n,)."""

    mass: Any
    damping: Any
    stiffness: Any
    basis: Any
    contacts: list[ExactContact]
    q0: list[Any]
    v0: list[Any]


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


def exact_problem(system: System, drive: Drive) -> Exact:
    """The problem at the current precision: call it again after raising ctx.prec."""
    loads = _Loads(drive, system.size)
    # Of elements the matrices are taken as they are: see System.exact_parameters.
    beam = system.problem if system.form != "hermite" else None
    q0, v0 = ([number(x) for x in values] for values in (system.q0, system.v0))
    if beam is not None:
        mass, damping, stiffness, *start = _matrices(system, beam, loads)
        places = [_place(beam, stops, system.size, drive) for stops in beam.all_stops]
        if system.origin and system.origin.starts(system):
            q0, v0 = start
    else:
        mass, damping, stiffness = (
            [[number(x) for x in line] for line in matrix] for matrix in (system.mass, system.damping, system.stiffness)
        )
        places = [([number(x) for x in each.row], offset_of(drive, (1, each.offset))) for each in system.contacts]
        for vector, function in system.loads:
            loads.add([number(x) for x in vector], function)
    # Stops at the exact values of their numbers.
    contacts = []
    for contact, (weights, offset) in zip(system.contacts, places, strict=True):
        g1, g2 = (None if x is None else arb(number(x)) for x in (contact.stops.lower, contact.stops.upper))
        row = [arb(x) for x in weights]
        kappa, c = arb(number(contact.stops.stiffness)), arb(number(contact.stops.damping))
        contacts.append(ExactContact(row, offset, kappa, c, g1, g2))
    return Exact(
        mass=arb_mat([[arb(x) for x in line] for line in mass]),
        damping=arb_mat([[arb(x) for x in line] for line in damping]),
        stiffness=arb_mat([[arb(x) for x in line] for line in stiffness]),
        basis=arb_mat(loads.basis),
        contacts=contacts,
        q0=[arb(x) for x in q0],
        v0=[arb(x) for x in v0],
    )


def channels(system: System, problem: Exact, drive: Drive) -> list[tuple[list[Any], list[Any]]]:
    """Row (n,) and offset in the drive coefficients (d,) of every channel: the contacts, and the observed row."""
    channels = [(contact.row, contact.offset) for contact in problem.contacts]
    for row, offset in system.channels[len(channels) :]:
        channels.append(([arb(number(x)) for x in row], offset_of(drive, (1, offset))))
    return channels


def offset_of(drive: Drive, *terms: tuple[Any, Any]) -> list[Any]:
    """A sum of (factor, function), None for none, in the drive coefficients (d,)."""
    offset = _Loads(drive, 1)
    for factor, function in terms:
        offset.add([fmpq(1)], function, factor)
    return [line[0] for line in offset.basis]


def _place(problem: BeamProblem, stops: Stops, M: int, drive: Drive) -> tuple[list[Any], list[Any]]:
    """Row of stops on a beam by linear interpolation; phi (1 - (x/L)^2) - m(t) as ``offset_of``."""
    position = problem.length if stops.position is None else stops.position
    share = number(position) / number(problem.length)
    return _hat(share, M), offset_of(drive, (1 - share * share, problem.base), (-1, stops.motion))


def _hat(share: Any, M: int) -> list[Any]:
    """The weights of the nodes beside x = share L, node 0 left out."""
    place = share * M
    # The tip lies at the end of the last cell.
    cell = min(int(arb(place).floor().unique_fmpz() or 0), M - 1)
    theta = place - cell
    hats = [fmpq(0)] * (M + 1)
    hats[cell], hats[cell + 1] = 1 - theta, theta
    return hats[1:]


class _Loads:
    """A sum of vectors times time functions, gathered as a basis (d, n) of the drive coefficients."""

    def __init__(self, drive: Drive, n: int) -> None:
        self.drive, self.frequencies = drive, [exact_value(x) for x in drive.frequencies]
        self.basis = [[arb(0)] * n for _ in range(drive.size)]

    def add(self, vector: list[Any], function: Any, factor: Any = 1, order: int = 0) -> None:
        """Add vector * factor * f(t), or its first or second derivative; f is in closed form."""
        for scale, part in parts(function):
            weight = factor * number(scale)
            if isinstance(part, Constant):
                coefficients = [] if order else [(0, arb(number(part.level)))]
            else:
                assert isinstance(part, Harmonic)
                k = 1 + 2 * self.frequencies.index(exact_value(part.frequency))
                # a sin(w t + phase) = a cos(phase) sin w t + a sin(phase) cos w t.
                s, c = arb(number(part.phase)).sin_cos()
                size = arb(number(part.amplitude))
                for _ in range(order):  # a sin(w t + phase) -> a w cos(w t + phase)
                    s, c, size = c, -s, size * number(part.frequency)
                coefficients = [(k, size * c), (k + 1, size * s)]
            for k, value in coefficients:
                self.basis[k] = [b + p * weight * value for b, p in zip(self.basis[k], vector, strict=True)]


def _matrices(system: System, problem: BeamProblem, loads: _Loads) -> tuple[Any, Any, Any, Any, Any]:
    """Mass, damping, stiffness and initial data of both forms; the loads go to ``loads``."""
    M = system.size
    bending, viscosity = number(problem.stiffness), number(problem.viscosity)
    length, m = number(problem.length), number(problem.mass_per_length)
    paper = system.form == "displacement"
    # Matrices: stencils of whole numbers times (M/length)^3, and the weights of the nodes.
    weights = _scaled(length, _weights(M, paper))
    stencil, over = (bending_stencil(M), 1) if paper else (curvature_stencil(M), 24)
    strain = [[int(x) * (M / length) ** 3 / over for x in line] for line in stencil]
    damping, stiffness = (_scaled(k, strain) for k in (viscosity, bending))
    # (2.5) at the tip: (1 - (x/L)^2) phi has a curvature there, which v must balance.
    clamp = [fmpq(0)] * (M - 2) + [-2 * M / length**3, 2 * M / length**3]
    mass, drag = _scaled(m, weights), number(problem.mass_damping)
    mass[-1][-1] += number(problem.tip_mass)
    damping = [[c + drag * b for c, b in zip(*lines, strict=True)] for lines in zip(damping, mass, strict=True)]
    lift = [1 - fmpq(i, M) ** 2 for i in range(1, M + 1)]

    def weighted(values: list[Any]) -> list[Any]:
        return [sum((a * b for a, b in zip(line, values, strict=True)), fmpq(0)) for line in weights]

    if not paper:
        clamp = weighted([fmpq(0)] * (M - 2) + [fmpq(-2 * M**2) / length**4, fmpq(7 * M**2) / length**4])
    # Position and velocity of the base at t = 0, for the initial data.
    phi = problem.base
    phi0 = rate0 = arb(0)
    for factor, part in parts(phi):
        value = rate = arb(0)
        if isinstance(part, Harmonic):
            s, c = arb(number(part.phase)).sin_cos()
            value = arb(number(part.amplitude)) * s
            rate = arb(number(part.amplitude) * number(part.frequency)) * c
        elif isinstance(part, Constant):
            value = arb(number(part.level))
        phi0, rate0 = phi0 + number(factor) * value, rate0 + number(factor) * rate
    # Loads of the base: its inertia, its bending with viscosity at the tip, and its mass damping.
    if phi is not None:
        loads.add(weighted(lift), phi, -m, order=2)  # -m weights lift phi''
        loads.add([bending * p for p in clamp], phi)
        if problem.viscosity > 0:
            loads.add([viscosity * p for p in clamp], phi, order=1)
        if problem.mass_damping > 0:
            loads.add(weighted(lift), phi, -drag * m, order=1)
    # Loads of the problem, and the initial data in v = u - phi (1 - (x/L)^2).
    x = [length * fmpq(i, M) for i in range(1, M + 1)]
    for load in problem.loads:
        if isinstance(load, PointLoad):
            loads.add(_hat(number(load.position) / length, M), load.time)
        else:
            loads.add(weighted(_values(load.shape, x)), load.time)
    u0 = [phi0] * M if problem.initial_displacement is None else _values(problem.initial_displacement, x)
    w0 = [fmpq(0)] * M if problem.initial_velocity is None else _values(problem.initial_velocity, x)
    q0 = [arb(a) - phi0 * b for a, b in zip(u0, lift, strict=True)]
    v0 = [arb(a) - rate0 * b for a, b in zip(w0, lift, strict=True)]
    return mass, damping, stiffness, q0, v0


def _values(profile: Profile, x: list[Any]) -> list[Any]:
    """A polynomial exactly; of any other function of x, the doubles that it gives."""
    if isinstance(profile, PolynomialProfile):
        return [sum((number(c) * y**k for k, c in enumerate(profile.coefficients)), fmpq(0)) for y in x]
    grid = np.array([float(arb(y)) for y in x])
    return [number(y) for y in np.broadcast_to(profile(grid), grid.shape)]


def _scaled(factor: Any, matrix: list[list[Any]]) -> list[list[Any]]:
    return [[factor * x for x in line] for line in matrix]


def _weights(M: int, lumped: bool) -> list[list[Any]]:
    """The weights of the nodes over L: 1/M and half of it at the tip; or P of (3.12), h times tridiag(-1/6, 4/3, -1/6)
    and 1/3 at the tip."""
    diagonal = fmpq(1, M) if lumped else fmpq(4, 3 * M)
    matrix = [[diagonal if i == j else fmpq(0) for j in range(M)] for i in range(M)]
    matrix[-1][-1] = fmpq(1, 2 * M) if lumped else fmpq(1, 3 * M)
    for i in range(0 if lumped else M - 2):
        matrix[i][i + 1] = matrix[i + 1][i] = fmpq(-1, 6 * M)
    return matrix
