"""The paper's beam in many digits by matrix exponentials: no code, no modes and no search of the package.

Textbook finite differences of u_tt = -k^2 u_xxxx on u itself, with ghost points at both ends, are one linear
system of first order while the tip is free and one on each stop. Its exponentials over H, H/2, H/4, ... carry the
state; the tip is looked at a thousand times in every H, a few periods of the fastest motion.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from flint import arb, arb_mat, arb_poly, ctx, fmpq

LEVELS = 10
RADIANS = 16.0  # of the fastest motion in H


def impacts(
    stiffness: Fraction, gap: Fraction, kappa: Fraction, amplitude: Fraction, frequency: Fraction,
    cells: int, t_end: float, digits: int,
) -> list[tuple[float, int]]:  # fmt: skip
    """(time, stop) of every entry into a stop at +-gap, from rest, u(0, t) = amplitude sin(frequency t).

    With h = 1/cells: u_{-1} = u_1 at the clamp, u_{M+1} - 2 u_M + u_{M-1} = 0 and the central difference
    of k^2 u_xxx = -sigma at the tip, which give u_M'' = -2 k^2/h^4 (u_M - 2 u_{M-1} + u_{M-2}) + 2 sigma/h.
    """
    before, ctx.prec = ctx.prec, math.ceil(digits * math.log2(10.0)) + 64
    try:
        k2, g, kappa, a, w = (fmpq(x.numerator, x.denominator) for x in (stiffness, gap, kappa, amplitude, frequency))
        fastest = max(4.0 * math.sqrt(stiffness) * cells**2, math.sqrt(2.0 * float(kappa.p) / float(kappa.q) * cells))
        H = fmpq(1, 2 ** math.ceil(math.log2(fastest / RADIANS)))
        regimes = {side: _Regime(_matrix(k2, kappa if side else fmpq(0), side * g, w, cells), H) for side in (0, 1, -1)}
        y = arb_mat([[arb(0)]] * (2 * cells) + [[arb(0)], [arb(a)], [arb(1)]])  # u, u', (a sin, a cos), 1
        t, side, found = arb(0), 0, []
        while True:
            regime = regimes[side]
            path = regime.look @ np.array([float(x[0]) for x in y.tolist()])
            looks = []
            for other in (1, -1) if side == 0 else (side,):
                over = other * path[1:] > float(g.p) / float(g.q)
                changed = np.flatnonzero(over if side == 0 else ~over)
                looks += [(int(changed[0]), other)] if len(changed) else []
            if not looks:
                y, t = (regime.powers[0] * y).mid(), t + H
                if t > t_end:
                    return found
                continue
            index, other = min(looks)
            for level in range(1, LEVELS + 1):  # to the look before the crossing
                if index >> (LEVELS - level) & 1:
                    y = (regime.powers[level] * y).mid()
            y, late = regime.cross(y, cells - 1, other * g, H / 2**LEVELS)
            t = (t + H * fmpq(index, 2**LEVELS) + late).mid()
            if t > t_end:
                return found
            side = 0 if side else other
            if side:
                found.append((float(t), side))
    finally:
        ctx.prec = before


class _Regime:
    """y' = A y: exp(A H/2^level) for every level, and in float64 y at every look in H."""

    def __init__(self, A: list[list[fmpq]], H: fmpq) -> None:
        n = len(A)
        self.A = arb_mat([[arb(x) for x in line] for line in A])
        powers = [(self.A * arb(H / 2**LEVELS)).exp().mid()]
        for _ in range(LEVELS):
            powers.append((powers[-1] * powers[-1]).mid())
        self.powers = powers[::-1]
        tip = n // 2 - 2  # (n - 3)/2 unknowns, the last of them the tip
        rows, step = [arb_mat([[arb(int(j == tip)) for j in range(n)]])], self.powers[-1]
        for _ in range(2**LEVELS):
            rows.append((rows[-1] * step).mid())
        self.look = np.array([[float(x) for x in row.tolist()[0]] for row in rows])

    def cross(self, y: arb_mat, tip: int, stop: fmpq, step: fmpq) -> tuple[arb_mat, arb]:
        """The state where the tip passes ``stop``, and how long after y: Newton's method on a Taylor series."""
        terms, small, k = [y], arb(2) ** -ctx.prec, 0
        while k < 8 or max(abs(x[0]) for x in terms[-1].tolist()) * arb(step) ** k > small:
            k += 1
            terms.append((self.A * terms[-1] * arb(fmpq(1, k))).mid())
        series = arb_poly([term.tolist()[tip][0] for term in terms]) - arb(stop)
        slope, s = series.derivative(), arb(step) / 2
        for _ in range(60):
            change = (series(s) / slope(s)).mid()
            s = (s - change).mid()
            if abs(change) < arb(2) ** (-ctx.prec // 2 - 40):
                break
        assert -0.01 < float(s / step) < 1.01, "the crossing lies where it was seen"
        return sum((term * s**k for k, term in enumerate(terms)), y * arb(0)).mid(), s


def _matrix(k2: fmpq, kappa: fmpq, stop: fmpq, w: fmpq, cells: int) -> list[list[fmpq]]:
    """A of y = (u_1..u_M, u_1'..u_M', a sin wt, a cos wt, 1), the tip pressed by -kappa (u_M - stop)."""
    M, n = cells, 2 * cells + 3
    A = [[fmpq(0)] * n for _ in range(n)]

    def add(line: int, node: int, value: fmpq) -> None:
        A[M + line - 1][2 * M if node == 0 else abs(node) - 1] += value

    for i in range(1, M + 1):
        A[i - 1][M + i - 1] = fmpq(1)
        for shift, weight in zip(range(-2, 3), (1, -4, 6, -4, 1), strict=True):
            value, node = -k2 * M**4 * weight, i + shift
            if node == M + 1:
                ghosts = [(M, 2), (M - 1, -1)]
            elif node == M + 2:  # 2 u_{M+1} - 2 u_{M-1} + u_{M-2}, without sigma
                ghosts = [(M, 4), (M - 1, -4), (M - 2, 1)]
            else:
                ghosts = [(node, 1)]
            for other, times in ghosts:
                add(i, other, value * times)
    add(M, M, -2 * M * kappa)
    A[2 * M - 1][n - 1] = 2 * M * kappa * stop
    A[2 * M][2 * M + 1], A[2 * M + 1][2 * M] = w, -w
    return A
