"""The semi-discrete problem without rounding: rational geometry, the given doubles at their exact value.

A beam's matrices are whole multiples of k^2 h^-3 or thirds and sixths of h; the float64 entries of the
System carry roundings that past the horizon lead to another trajectory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb, arb_mat, fmpq

from ..drive import Drive
from ..problem import BeamProblem, PointLoad
from ..semidiscretisation import bending_stencil
from ..system import System
from ..time_functions import Constant, Harmonic


@dataclass(frozen=True, eq=False)
class Exact:
    """M, K (n, n) and the loads' basis (d, n) as arb_mat; the first contact's row (n,), its offset in
    the drive coefficients (d,), the stops kappa, g1, g2 (None where free) and q0, v0 (n,) as arb."""

    mass: Any
    stiffness: Any
    basis: Any
    row: list[Any]
    offset: list[Any]
    stops: tuple[Any, Any, Any] | None
    q0: list[Any]
    v0: list[Any]


def number(x: float) -> fmpq:
    """The exact value of a double."""
    return fmpq(*float(x).as_integer_ratio())


def exact_problem(system: System, drive: Drive) -> Exact:
    """The problem at the current precision: call it again after raising ctx.prec."""
    n = system.size
    basis = [[arb(0)] * n for _ in range(drive.size)]

    def add(vector: list[Any], function: Harmonic | Constant, factor: Any = 1) -> None:
        """basis += vector times the drive coefficients of factor * function."""
        if isinstance(function, Constant):
            coefficients = [(0, arb(number(function.level)))]
        else:
            k = 1 + 2 * drive.frequencies.index(function.frequency)
            s, c = arb(number(function.phase)).sin_cos()
            amplitude = arb(number(function.amplitude))
            coefficients = [(k, amplitude * c), (k + 1, amplitude * s)]
        for k, value in coefficients:
            basis[k] = [b + p * factor * value for b, p in zip(basis[k], vector, strict=True)]

    if system.problem is not None:
        mass, stiffness, q0, v0 = _beam(system, system.problem, add)
    else:
        mass, stiffness = ([[number(x) for x in line] for line in matrix] for matrix in (system.mass, system.stiffness))
        for vector, function in system.loads:
            assert isinstance(function, (Harmonic, Constant))
            add([number(x) for x in vector], function)
        q0, v0 = ([number(x) for x in values] for values in (system.q0, system.v0))
    row, offset_function = system.channels[0]
    offset = [arb(0)] * drive.size
    if isinstance(offset_function, (Harmonic, Constant)):
        loads, basis = basis, [[arb(0)] for _ in range(drive.size)]
        add([arb(1)], offset_function)
        offset, basis = [line[0] for line in basis], loads
    stops = None
    if system.contacts:
        s = system.contacts[0].stops
        lower, upper = (None if x is None else arb(number(x)) for x in (s.lower, s.upper))
        stops = (arb(number(s.stiffness)), lower, upper)
    return Exact(
        mass=arb_mat([[arb(x) for x in line] for line in mass]),
        stiffness=arb_mat([[arb(x) for x in line] for line in stiffness]),
        basis=arb_mat(basis),
        row=[arb(number(x)) for x in row],
        offset=offset,
        stops=stops,
        q0=[arb(x) for x in q0],
        v0=[arb(x) for x in v0],
    )


def _beam(system: System, problem: BeamProblem, add: Any) -> tuple[Any, Any, Any, Any]:
    """Mass, stiffness and initial data of both forms; the loads go through ``add``."""
    M = system.size
    k2 = number(problem.stiffness)
    if system.form == "displacement":
        mass = [[fmpq(0)] * M for _ in range(M)]
        for i in range(M):
            mass[i][i] = fmpq(1, M if i < M - 1 else 2 * M)
        stencil = bending_stencil(M)
        stiffness = [[k2 * M**3 * int(x) for x in line] for line in stencil]
        clamp = [fmpq(0)] * (M - 2) + [fmpq(-2 * M), fmpq(2 * M)]
    else:
        mass = _weights(M, last=True)
        Q = _weights(M, last=False)
        L = _curvature(M)
        QL = [[sum((Q[i][k] * L[k][j] for k in range(M)), fmpq(0)) for j in range(M)] for i in range(M)]
        stiffness = [[k2 * sum((L[k][i] * QL[k][j] for k in range(M)), fmpq(0)) for j in range(M)] for i in range(M)]
        moment = [fmpq(0)] * (M - 2) + [fmpq(-2 * M**2), fmpq(7 * M**2)]
        clamp = [sum((a * b for a, b in zip(line, moment, strict=True)), fmpq(0)) for line in mass]
    x = [fmpq(i, M) for i in range(1, M + 1)]
    lift = [1 - y * y for y in x]

    def weighted(values: list[Any]) -> list[Any]:
        return [sum((a * b for a, b in zip(line, values, strict=True)), fmpq(0)) for line in mass]

    phi = problem.base
    phi0 = rate0 = arb(0)
    if isinstance(phi, Harmonic):
        frequency = number(phi.frequency)
        add(weighted(lift), phi, frequency * frequency)  # -mass lift phi''
        s, c = arb(number(phi.phase)).sin_cos()
        phi0, rate0 = arb(number(phi.amplitude)) * s, arb(number(phi.amplitude) * frequency) * c
    elif isinstance(phi, Constant):
        phi0 = arb(number(phi.level))
    if phi is not None:
        add([k2 * p for p in clamp], phi)  # type: ignore[arg-type]
    for load in problem.loads:
        if isinstance(load, PointLoad):
            cell = min(int(load.position * M), M - 1)
            theta = number(load.position) * M - cell
            weights = [fmpq(0)] * (M + 1)
            weights[cell], weights[cell + 1] = 1 - theta, theta
            add(weights[1:], load.time)  # type: ignore[arg-type]
        else:
            shape = np.broadcast_to(load.shape(np.arange(1, M + 1) / M), M)
            add(weighted([number(y) for y in shape]), load.time)  # type: ignore[arg-type]
    grid = np.arange(1, M + 1) / M
    u0 = [phi0] * M if problem.initial_displacement is None else [number(y) for y in problem.initial_displacement(grid)]
    w0 = [fmpq(0)] * M if problem.initial_velocity is None else [number(y) for y in problem.initial_velocity(grid)]
    q0 = [arb(a) - phi0 * b for a, b in zip(u0, lift, strict=True)]
    v0 = [arb(a) - rate0 * b for a, b in zip(w0, lift, strict=True)]
    return mass, stiffness, q0, v0


def _weights(M: int, last: bool) -> list[list[Any]]:
    """P (last) and Q of (3.12): h times tridiag(-1/6, 4/3, -1/6) and 1/3 at the last or the first place."""
    matrix = [[fmpq(0)] * M for _ in range(M)]
    first = 0 if last else 1
    for i in range(first, first + M - 1):
        matrix[i][i] = fmpq(4, 3 * M)
        if i + 1 < first + M - 1:
            matrix[i][i + 1] = matrix[i + 1][i] = fmpq(-1, 6 * M)
    end = M - 1 if last else 0
    matrix[end][end] = fmpq(1, 3 * M)
    return matrix


def _curvature(M: int) -> list[list[Any]]:
    """L of (3.12), w = L x."""
    matrix = [[fmpq(0)] * M for _ in range(M)]
    matrix[0][0], matrix[0][1] = fmpq(4 * M**2), fmpq(-(M**2), 2)
    for i in range(1, M):
        matrix[i][i] = fmpq(M**2)
        matrix[i][i - 1] = fmpq(-2 * M**2)
        if i >= 2:
            matrix[i][i - 2] = fmpq(M**2)
    return matrix
