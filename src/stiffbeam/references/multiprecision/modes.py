"""What both multiprecision solutions share: eigenvectors and switching times, refined from float64 ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from flint import acb, acb_mat, arb, arb_mat, ctx

from ...basics.arrays import Array
from ...basics.validation import InputError
from ...model.drive import Drive
from ...model.system import System
from ...trajectory.trajectory import SolverFailure
from .rational import Exact, number, offset_of

START_BITS = 240
MAX_TURNS = 60
GUARD_BITS = 100  # below the digits that are lost: two doubles' worth for the outputs
KNOWN_BITS = 28  # what float64 knows of a time between two switches


Sampler = Callable[..., tuple[Array, Array]]


class Pencil(Protocol):
    """A symmetric eigenproblem B x = lambda A x, transposed and not conjugated where it is complex."""

    def products(self, X: Any, values: list[Any], /) -> tuple[Any, Any]:
        """X^T A X and X^T B X."""
        ...

    def from_scratch(self) -> tuple[Any, list[Any]]:
        """X with x^T A x = 1, and the eigenvalues, by the QR algorithm at the current precision."""
        ...


def refine(pencil: Pencil, X: Any, values: list[Any]) -> tuple[Any, list[Any]]:
    """Eigenvectors, X^T A X = I, and eigenvalues to the current precision from those of float64.

    Ogita and Aishima's iteration, quadratic: with R = I - X^T A X and S = X^T B X,
    X <- X (I + E), E_ij = (S_ij + lambda_j R_ij)/(lambda_j - lambda_i), E_ij = R_ij/2 on the diagonal
    and between equal eigenvalues. Where float64 is too far off to start from, as with eigenvalues that
    nearly coincide, it starts from the QR algorithm. Raises InputError where that does not help either: what comes
    back has X^T A X = I and X^T B X diagonal to half the digits.
    """
    target, n = ctx.prec, X.ncols()
    precision, done, fresh = START_BITS, False, False
    try:
        for _ in range(MAX_TURNS):
            ctx.prec = min(target, precision)
            R, S = (matrix.mid().tolist() for matrix in pencil.products(X, values))
            values = [(S[i][i] / R[i][i]).mid() for i in range(n)]
            fastest = max((abs(x).mid() for x in values), key=float)
            values = [x * 0 if abs(x).mid() < fastest * arb(2) ** (-2 * ctx.prec // 3) else x for x in values]
            if done:
                if all(_apart(i, j, R[i][j], S[i][j], fastest) for i in range(n) for j in range(n)):
                    return X, values
                break
            E = [[_correction(i, j, R[i][j], S[i][j], values) for j in range(n)] for i in range(n)]
            largest = max((abs(x).mid() for line in E for x in line), key=lambda x: x if x.is_finite() else arb("inf"))
            if not largest < 0.5 and not fresh:
                (X, values), fresh = pencil.from_scratch(), True
                continue
            X = (X + X * type(X)(E)).mid()
            # The next error is the square of this one, and the one after that what has to be carried.
            bits = target if largest == 0 else math.floor(-float(largest.log()) / math.log(2.0))
            done = ctx.prec == target and 2 * bits > target - 40
            precision = max(START_BITS, 4 * bits + 120)
    finally:
        ctx.prec = target
    raise InputError(
        "damping", "modes that cannot be separated", "have as many eigenvectors as unknowns",
        "a mode is critically damped: change the damping a little or use the solver cvode",
    )  # fmt: skip


def _apart(i: int, j: int, r: Any, s: Any, fastest: Any) -> bool:
    """Whether x_i^T A x_j is 1 or 0, and x_i^T B x_j is 0 for others, to half the digits."""
    small = arb(2) ** (-ctx.prec // 2)
    return bool(abs(r - (i == j)).mid() < small and (i == j or abs(s).mid() <= small * fastest))


def _correction(i: int, j: int, r: Any, s: Any, values: list[Any]) -> Any:
    """E_ij of ``refine``; eigenvalues that agree in a third of the digits are equal, and so are two that are zero."""
    if i == j:
        return (1 - r) / 2
    apart = values[j] - values[i]
    equal = abs(apart).mid() <= abs(values[j]).mid() * arb(2) ** (-ctx.prec // 3)
    return (-r / 2 if equal else (s - values[j] * r) / apart).mid()


def eigenvectors(A: Any, B: Any) -> tuple[list[list[Any]], list[Any]]:
    """Columns and values of B x = lambda A x by the QR algorithm, ordered by the values' real parts."""
    values, vectors = acb_mat(A.solve(B)).eig(right=True, algorithm="approx")
    columns = vectors.transpose().tolist()
    order = sorted(range(len(values)), key=lambda i: float(values[i].real))
    return [columns[i] for i in order], [values[i].mid() for i in order]


@dataclass(frozen=True, eq=False)
class UndampedPencil:
    """K x = omega^2 M x, real."""

    mass: Any
    stiffness: Any

    def products(self, X: Any, values: list[Any]) -> tuple[Any, Any]:
        """X^T M X and X^T K X."""
        turned = X.transpose()
        return turned * (self.mass * X), turned * (self.stiffness * X)

    def from_scratch(self) -> tuple[Any, list[Any]]:
        """X with X^T M X = I and the eigenvalues, by the QR algorithm."""
        columns, values = eigenvectors(self.mass, self.stiffness)
        real = [[(x / max(column, key=lambda x: float(abs(x)))).real for x in column] for column in columns]
        X = arb_mat(real).transpose().mid()
        norms = (X.transpose() * self.mass * X).tolist()
        X = arb_mat([[(x / norms[j][j].sqrt()).mid() for j, x in enumerate(line)] for line in X.tolist()])
        return X, [value.real for value in values]


@dataclass(frozen=True, eq=False)
class DampedPencil:
    """A = [[C, M], [M, 0]], B = [[-K, 0], [0, M]] on x = (phi, lambda phi), of which phi (n, 2n) is held."""

    mass: Any
    damping: Any
    stiffness: Any

    def products(self, phi: Any, values: list[Any]) -> tuple[Any, Any]:
        """X^T A X and X^T B X of the vectors x = (phi, lambda phi), lambda from ``values``."""
        turned = phi.transpose()
        M, C, K = ((turned * (matrix * phi)).tolist() for matrix in (self.mass, self.damping, self.stiffness))
        n = range(len(values))
        A = [[C[i][j] + (values[i] + values[j]) * M[i][j] for j in n] for i in n]
        return acb_mat(A), acb_mat([[values[i] * values[j] * M[i][j] - K[i][j] for j in n] for i in n])

    def normalised(self, phi: Any, values: list[Any]) -> tuple[Any, list[Any]]:
        """phi with x^T A x = 1."""
        norms = self.products(phi, values)[0].tolist()
        return acb_mat([[(x / norms[j][j].sqrt()).mid() for j, x in enumerate(line)] for line in phi.tolist()]), values

    def from_scratch(self) -> tuple[Any, list[Any]]:
        """phi (n, 2n) and the eigenvalues, by the QR algorithm."""
        n = self.mass.nrows()
        M, C, K = (matrix.tolist() for matrix in (self.mass, self.damping, self.stiffness))
        nothing = [acb(0)] * n
        A = acb_mat([[*C[i], *M[i]] for i in range(n)] + [[*M[i], *nothing] for i in range(n)])
        B = acb_mat([[-x for x in K[i]] + nothing for i in range(n)] + [[*nothing, *M[i]] for i in range(n)])
        columns, values = eigenvectors(A, B)
        return self.normalised(acb_mat([column[:n] for column in columns]).transpose(), values)


def precision_at(full: int, guard: int, t: float, t_end: float) -> int:
    """Bits to carry at time t: from ``full`` down to ``guard`` for the outputs: error growth uses them up."""
    return max(guard, math.ceil(full - (full - guard) * min(1.0, t / t_end))) + 30


def channels(system: System, problem: Exact, drive: Drive) -> list[tuple[list[Any], list[Any], list[Any]]]:
    """Row (n,), offset in the drive coefficients (d,) and in the records (R,) of every channel: the contacts, and
    the observed row."""
    found = [(contact.row, contact.offset, contact.recorded) for contact in problem.contacts]
    for row, offset in system.channels[len(found) :]:
        found.append(([arb(number(x)) for x in row], *offset_of(offset, drive)))
    return found


def sampler(times: list[float], pieces: list[Any], sample: Callable[[Any, float], Any]) -> Sampler:
    """What gives positions and velocities (k, channels) at any times, ``rounded`` from ``sample(piece, t)``."""

    def at(t: Array, rounded: Callable[[Any], Any] = float) -> tuple[Array, Array]:
        before, found = ctx.prec, []
        try:
            for when, k in zip(t.tolist(), np.maximum(np.searchsorted(times, t, "right") - 1, 0).tolist(), strict=True):
                ctx.prec = pieces[k].bits
                found.append([[rounded(x) for x in line] for line in sample(pieces[k], when)])
        finally:
            ctx.prec = before
        u, v = np.array(found).transpose(1, 0, 2)
        return u, v

    return at


def locate(
    gap_at: Callable[[Any], tuple[Any, Any, Any]],
    start: float,
    fastest: float,
    shortest: float,
    t: float,
    lost: int = 0,
) -> tuple[Any, Any, Any]:
    """(tau, shift, parts): the gap closes at tau + shift, ``parts`` are those of the evaluation at tau.

    gap_at(tau) -> (gap, gap', parts). Newton's method from the float64 time ``start``, the precision
    doubled at each turn, so that only one evaluation is made at full precision; what is left is
    ``shift``, so small against 1/fastest that a Taylor step of second order is exact. Where the gap is zero as the
    piece begins, at rest on its stop and pressed, that is the switch. Raises
    SolverFailure where Newton's method leads further than a fiftieth of the ``shortest`` period away: two
    crossings so close to each other that float64 cannot tell them apart.
    """
    if start < 0.02 * shortest:
        (gap, speed, parts), near = gap_at(arb(0)), arb(0.01 * shortest)
        if max(abs(gap), abs(speed) * near) < arb(2) ** (-ctx.prec // 2) * abs(gap_at(near)[0]):
            return arb(0), arb(0), parts
    full, tau, accurate = ctx.prec, arb(start), KNOWN_BITS
    try:
        while accurate < full // 2:
            accurate = 2 * accurate - 8  # the ratio of gap'' to gap' costs a few bits at each turn
            ctx.prec = min(full, accurate + 70 + lost)
            gap, speed, _ = gap_at(tau)
            tau = (tau - gap / speed).mid()
    finally:
        ctx.prec = full
    for _ in range(64):
        gap, speed, parts = gap_at(tau)
        shift = (-gap / speed).mid()
        if not abs(float(tau + shift) - start) < 0.02 * shortest:
            break
        if abs(shift) * fastest < arb(2) ** (-full // 3):
            return tau, shift, parts
        tau = (tau + shift).mid()
    remedy = f"end before t = {t + start:.6g}" if t + start > 0.02 * shortest else "start a little off the stop"
    raise SolverFailure("multiprecision", t + start, "the switch is a graze that float64 cannot place", remedy)


def dot(a: list[Any], b: list[Any]) -> Any:
    """sum a_i b_i."""
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))


def double(matrix: Any) -> Array:
    """Rounded to float64."""
    return np.array([[float(x) for x in line] for line in matrix.tolist()])
