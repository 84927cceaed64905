"""The semi-discrete problem without rounding: rational geometry, the given doubles at their exact value.

A beam's matrices are whole multiples of k^2 h^-3 or thirds and sixths of h; the float64 entries of the
System carry roundings that past the horizon lead to another trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from flint import arb, arb_mat, fmpq

from ..drive import Drive
from ..problem import BeamProblem, PointLoad
from ..semidiscretisation import bending_stencil, semidiscretise
from ..system import System
from ..time_functions import Constant, Harmonic


@dataclass(frozen=True, eq=False)
class ExactContact:
    """Row (n,), offset in the drive coefficients (d,), kappa, g1, g2 (None where free), all arb."""

    row: list[Any]
    offset: list[Any]
    kappa: Any
    g1: Any
    g2: Any

    def stop(self, side: int) -> Any:
        """The position of the stop on ``side``; 0 for a side without one, which is never entered."""
        gap = self.g2 if side > 0 else self.g1
        return arb(0) if gap is None else gap


@dataclass(frozen=True, eq=False)
class Exact:
    """M, C, K (n, n) and the loads' basis (d, n) as arb_mat; contacts; q0, v0 (n,) as arb."""

    mass: Any
    damping: Any
    stiffness: Any
    basis: Any
    contacts: list[ExactContact]
    q0: list[Any]
    v0: list[Any]

    def closed(self, sides: Sequence[int]) -> tuple[Any, list[list[Any]]]:
        """K and the loads' basis with every contact on the given side, 0 free.

        sigma = kappa (g - row q - offset): row q goes to the stiffness, the rest to the loads.
        """
        stiffness, basis = self.stiffness, self.basis.tolist()
        for contact, side in zip(self.contacts, sides, strict=True):
            if side:
                push = [contact.kappa * r for r in contact.row]
                stiffness = stiffness + arb_mat([[a * b for a in push] for b in contact.row])
                basis = [
                    [b - o * p for b, p in zip(line, push, strict=True)]
                    for line, o in zip(basis, contact.offset, strict=True)
                ]
                basis[0] = [b + contact.stop(side) * p for b, p in zip(basis[0], push, strict=True)]
        return stiffness, basis


def number(x: float) -> fmpq:
    """The exact value of a double."""
    return fmpq(*float(x).as_integer_ratio())


def exact_problem(system: System, drive: Drive) -> Exact:
    """The problem at the current precision: call it again after raising ctx.prec."""
    loads = _Loads(drive, system.size)
    made = None if system.problem is None else semidiscretise(system.problem, system.size, system.form)
    q0, v0 = ([number(x) for x in values] for values in (system.q0, system.v0))
    # A system that its problem makes, but perhaps for initial data of its own, as a perturbed member has.
    own = system.fingerprint
    if made and system.problem and replace(made, q0=system.q0, v0=system.v0).fingerprint == own:
        mass, damping, stiffness, *start = _beam(system, system.problem, loads)
        if made.fingerprint == own:
            q0, v0 = start
    else:
        mass, damping, stiffness = (
            [[number(x) for x in line] for line in matrix] for matrix in (system.mass, system.damping, system.stiffness)
        )
        for vector, function in system.loads:
            loads.add([number(x) for x in vector], function)
    contacts = []
    for contact in system.contacts:
        offset = _Loads(drive, 1)
        if contact.offset is not None:
            offset.add([fmpq(1)], contact.offset)
        g1, g2 = (None if x is None else arb(number(x)) for x in (contact.stops.lower, contact.stops.upper))
        row, kappa = [arb(number(x)) for x in contact.row], arb(number(contact.stops.stiffness))
        contacts.append(ExactContact(row, [line[0] for line in offset.basis], kappa, g1, g2))
    return Exact(
        mass=arb_mat([[arb(x) for x in line] for line in mass]),
        damping=arb_mat([[arb(x) for x in line] for line in damping]),
        stiffness=arb_mat([[arb(x) for x in line] for line in stiffness]),
        basis=arb_mat(loads.basis),
        contacts=contacts,
        q0=[arb(x) for x in q0],
        v0=[arb(x) for x in v0],
    )


class _Loads:
    """A sum of vectors times time functions, gathered as a basis (d, n) of the drive coefficients."""

    def __init__(self, drive: Drive, n: int) -> None:
        self.frequencies = drive.frequencies
        self.basis = [[arb(0)] * n for _ in range(drive.size)]

    def add(self, vector: list[Any], function: Any, factor: Any = 1, rate: bool = False) -> None:
        """Add vector * factor * f(t), or f'(t) for ``rate``; f is Harmonic or Constant."""
        assert isinstance(function, (Harmonic, Constant))
        if isinstance(function, Constant):
            coefficients = [] if rate else [(0, arb(number(function.level)))]
        else:
            k = 1 + 2 * self.frequencies.index(function.frequency)
            s, c = arb(number(function.phase)).sin_cos()
            size = arb(number(function.amplitude))
            if rate:  # a w cos(w t + phase)
                s, c, size = c, -s, size * number(function.frequency)
            coefficients = [(k, size * c), (k + 1, size * s)]
        for k, value in coefficients:
            self.basis[k] = [b + p * factor * value for b, p in zip(self.basis[k], vector, strict=True)]


def _beam(system: System, problem: BeamProblem, loads: _Loads) -> tuple[Any, Any, Any, Any, Any]:
    """Mass, damping, stiffness and initial data of both forms; the loads go to ``loads``."""
    M = system.size
    k2, d = number(problem.stiffness), number(problem.viscosity)
    if system.form == "displacement":
        mass = [[fmpq(0)] * M for _ in range(M)]
        for i in range(M):
            mass[i][i] = fmpq(1, M if i < M - 1 else 2 * M)
        stencil = [[fmpq(M**3 * int(x)) for x in line] for line in bending_stencil(M)]
        damping, stiffness = ([[k * x for x in line] for line in stencil] for k in (d, k2))
        clamp = [fmpq(0)] * (M - 2) + [fmpq(-2 * M), fmpq(2 * M)]
    else:
        mass = _weights(M, last=True)
        Q = _weights(M, last=False)
        L = _curvature(M)
        QL = [[sum((Q[i][k] * L[k][j] for k in range(M)), fmpq(0)) for j in range(M)] for i in range(M)]
        stiffness = [[k2 * sum((L[k][i] * QL[k][j] for k in range(M)), fmpq(0)) for j in range(M)] for i in range(M)]
        damping = [[fmpq(0)] * M for _ in range(M)]  # the form exists for d = 0 only
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
        loads.add(weighted(lift), phi, frequency * frequency)  # -mass lift phi''
        s, c = arb(number(phi.phase)).sin_cos()
        phi0, rate0 = arb(number(phi.amplitude)) * s, arb(number(phi.amplitude) * frequency) * c
    elif isinstance(phi, Constant):
        phi0 = arb(number(phi.level))
    if phi is not None:
        loads.add([k2 * p for p in clamp], phi)
        loads.add([d * p for p in clamp], phi, rate=True)
    for load in problem.loads:
        if isinstance(load, PointLoad):
            cell = min(int(load.position * M), M - 1)
            theta = number(load.position) * M - cell
            weights = [fmpq(0)] * (M + 1)
            weights[cell], weights[cell + 1] = 1 - theta, theta
            loads.add(weights[1:], load.time)
        else:
            shape = np.broadcast_to(load.shape(np.arange(1, M + 1) / M), M)
            loads.add(weighted([number(y) for y in shape]), load.time)
    grid = np.arange(1, M + 1) / M
    u0 = [phi0] * M if problem.initial_displacement is None else [number(y) for y in problem.initial_displacement(grid)]
    w0 = [fmpq(0)] * M if problem.initial_velocity is None else [number(y) for y in problem.initial_velocity(grid)]
    q0 = [arb(a) - phi0 * b for a, b in zip(u0, lift, strict=True)]
    v0 = [arb(a) - rate0 * b for a, b in zip(w0, lift, strict=True)]
    return mass, damping, stiffness, q0, v0


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
