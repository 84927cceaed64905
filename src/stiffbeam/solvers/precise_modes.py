"""Modes of the contact regimes in many digits, refined from the float64 ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb, arb_mat, ctx

from ..arrays import Array
from ..drive import Drive
from ..modal import Modes, modes
from ..system import System
from .rational import Exact
from .undamped import Regime


@dataclass(eq=False)
class PreciseRegime:
    """Modes of one regime at full precision: omega, omega^2 (n,), X (n, n), level (n,), P (n, d)."""

    omega: list[Any]
    squares: list[Any]
    shapes: Any
    level: list[Any]
    particular: list[list[Any]]
    row: list[Any]


def precise_regime(
    system: System, problem: Exact, drive: Drive, frequencies: list[Any], side: int, other: PreciseRegime | None
) -> PreciseRegime:
    """The regime of ``side``; on the lower stop the modes are those of the ``other``, on the upper."""
    n = system.size
    springs: tuple = ()
    stiffness, basis = problem.stiffness, problem.basis.tolist()
    if side:
        assert problem.stops is not None
        kappa, lower, upper = problem.stops
        gap = upper if side > 0 else lower
        springs = ((system.contacts[0].row, system.contacts[0].stops.stiffness),)
        stiffness = stiffness + arb_mat([[kappa * a * b for a in problem.row] for b in problem.row])
        basis = [
            [b - kappa * o * r for b, r in zip(line, problem.row, strict=True)]
            for line, o in zip(basis, problem.offset, strict=True)
        ]
        basis[0] = [b + kappa * (gap if gap is not None else 0) * r for b, r in zip(basis[0], problem.row, strict=True)]
    if other is None:
        base = modes(system, springs)
        assert base is not None
        squares, shapes = _refine(problem.mass, stiffness, base.shapes)
    else:
        squares, shapes = other.squares, other.shapes
    force = (shapes.transpose() * arb_mat(basis).transpose()).tolist()  # (n, d)
    particular = [[arb(0)] * drive.size for _ in range(n)]
    for k, frequency in enumerate(frequencies):
        for j in range(n):
            gain = 1 / (squares[j] - frequency * frequency)
            for i in (1 + 2 * k, 2 + 2 * k):
                particular[j][i] = (force[j][i] * gain).mid()
    row = (arb_mat([problem.row]) * shapes).tolist()[0]
    return PreciseRegime(
        omega=[x.sqrt().mid() for x in squares],
        squares=squares,
        shapes=shapes,
        level=[force[j][0].mid() for j in range(n)],
        particular=particular,
        row=[x.mid() for x in row],
    )


def _refine(mass: Any, stiffness: Any, shapes: Array) -> tuple[list[Any], Any]:
    """Eigenvalues and mass-normalised eigenvectors from float64 ones, to the current precision.

    Ogita and Aishima's iteration for the pencil (K, M), quadratic: with R = I - X^T M X and S = X^T K X,
    X <- X (I + E), E_ij = (S_ij + lambda_j R_ij)/(lambda_j - lambda_i), E_ii = R_ii/2.
    """
    target, n = ctx.prec, shapes.shape[0]
    X = arb_mat([[arb(float(x)) for x in line] for line in shapes])
    precision, done = 240, False
    while True:
        ctx.prec = min(target, precision)
        R = (X.transpose() * mass * X).tolist()
        S = (X.transpose() * stiffness * X).tolist()
        values = [(S[i][i] / R[i][i]).mid() for i in range(n)]
        if done:
            ctx.prec = target
            return values, X
        largest = arb(0)
        E = [[arb(0)] * n for _ in range(n)]
        for i in range(n):
            for j in range(n):
                r = (1 if i == j else 0) - R[i][j].mid()
                E[i][j] = r / 2 if i == j else (S[i][j].mid() + values[j] * r) / (values[j] - values[i])
                largest = max(largest, abs(E[i][j]).mid())
        step = X * arb_mat(E)
        X = (X + step).mid()
        # The next error is the square of this one; stop when that is below the target.
        done = ctx.prec == target and largest * largest < arb(2) ** (40 - target)
        precision *= 2


def rounded_regime(regime: PreciseRegime, drive: Drive, problem: Exact) -> Regime:
    return Regime(
        np.array([float(x) for x in regime.omega]),
        np.array([float(x) for x in regime.level]),
        np.array([[float(x) for x in line] for line in regime.particular]).reshape(len(regime.omega), drive.size),
        np.array([float(x) for x in regime.row]),
        np.array([float(x) for x in problem.offset]),
    )


def rounded_modes(regime: PreciseRegime, system: System) -> Modes:
    omega = np.array([float(x) for x in regime.omega])
    return Modes(omega, double(regime.shapes), np.zeros_like(omega), system.mass)


def double(matrix: Any) -> Array:
    return np.array([[float(x) for x in line] for line in matrix.tolist()])


def dot(a: list[Any], b: list[Any]) -> Any:
    """sum a_i b_i."""
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))
