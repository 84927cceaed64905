"""The same motion in mpmath: every switch is found in float64 and refined by Newton's method."""

from __future__ import annotations

import time
from typing import Any

import mpmath as mp
import numpy as np
from vibro_impact import Case, Equations, Regime, Undecided
from vibro_march import first_crossing


class PreciseSolution:
    """The motion in mpmath: starts (t, window, chi, z) of the pieces; states at any time."""

    def __init__(self, case: Case, equations: Equations, pieces: list[tuple], digits: int) -> None:
        self.case, self.equations, self.pieces, self.digits = case, equations, pieces, digits
        self.starts = np.array([float(p[0]) for p in pieces])

    def states(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n, out = self.case.size, []
        with mp.workdps(self.digits):
            for s in t:
                piece = self.pieces[max(0, int(np.searchsorted(self.starts, s, side="right")) - 1)]
                z = precise_flow(self.equations.regime(*piece[1:3]).A, piece[3], mp.mpf(float(s)) - piece[0])
                out.append([float(x) for x in z[: 2 * n]])
        out = np.array(out)
        return out[:, :n], out[:, n:]

    def tip(self, t: np.ndarray) -> np.ndarray:
        return self.states(t)[0] @ self.case.observe

    def switches(self, i: int) -> list[tuple[float, int]]:
        """(t, side) of every switch of contact i from one side to another."""
        found, before = [], self.pieces[0][2][i]
        for t, _, chi, _ in self.pieces[1:]:
            if chi[i] != before:
                found.append((float(t), chi[i]))
            before = chi[i]
        return found


def precise_flow(A: np.ndarray, z: np.ndarray, tau: Any) -> np.ndarray:
    """exp(A tau) z in mpmath by Taylor's series, squared where tau is long."""
    size = max(sum(abs(x) for x in row) for row in A) * abs(tau)
    halvings = max(0, int(mp.ceil(mp.log(size / 20, 2)))) if size > 20 else 0
    with mp.workdps(mp.mp.dps + 15 + int(0.31 * halvings) + 10):
        small = mp.mpf(10) ** (-mp.mp.dps)
        step = A * (tau / 2**halvings)
        if not halvings:
            total = term = z
            k = 0
            while max(abs(x) for x in term) > small * max(abs(x) for x in total):
                k += 1
                term = step.dot(term) / k
                total = total + term
            return total
        total = term = np.array([[mp.mpf(i == j) for j in range(len(A))] for i in range(len(A))], object)
        for k in range(1, 400):
            term = term.dot(step) / k
            total = total + term
            if max(abs(x) for x in term.ravel()) < small:
                break
        for _ in range(halvings):
            total = total.dot(total)
        return total.dot(z)


def precise(
    case: Case, digits: int = 40, most_pieces: int = 2_000, most_seconds: float = float("inf")
) -> PreciseSolution:
    """The motion in mpmath: every switch is found in float64 and refined by Newton's method.

    Raises Undecided, also after ``most_seconds`` of processor time.
    """
    begun = time.process_time()
    with mp.workdps(digits):
        coarse, fine = Equations(case), Equations(case, mp.mpf)
        n, eps = case.size, mp.mpf(10) ** (8 - digits)
        t, window, pieces, at = mp.mpf(0), 0, [], set()
        z = fine.start(fine.convert(case.q0), fine.convert(case.v0), t, 0)
        ends = [*case.windows[1:], case.t_end]
        while True:
            chi = fine.sides(z, window, at, eps)
            pieces.append((t, window, chi, z))
            if len(pieces) > most_pieces:
                raise Undecided(f"{len(pieces)} pieces by t = {float(t):g}")
            if time.process_time() - begun > most_seconds:
                raise Undecided(f"{most_seconds:g} s of work by t = {float(t):g}")
            regime, guide = fine.regime(window, chi), coarse.regime(window, chi)
            resting = {(i, s) for i, s, row in regime.gaps if (i, s) in at or abs(row.dot(z)) <= eps}
            span = mp.mpf(ends[window]) - t
            tau, crossed, _, _ = first_crossing(guide, z.astype(float), float(span), resting, 1.0)
            if crossed is None:
                new, t, at = precise_flow(regime.A, z, span), mp.mpf(ends[window]), set()
                window += 1
                if window == len(ends):
                    return PreciseSolution(case, fine, pieces, digits)
            else:
                row = next(r for i, s, r in regime.gaps if (i, s) == crossed)
                tau, new = _newton(regime, row, z, mp.mpf(tau), eps)
                t, at = t + tau, {crossed}
            z = fine.start(new[:n], new[n : 2 * n], t, window)


def _newton(regime: Regime, row: np.ndarray, z: np.ndarray, tau: Any, eps: Any) -> tuple[Any, np.ndarray]:
    rate = row.dot(regime.A)
    new = precise_flow(regime.A, z, tau)
    for _ in range(60):
        change = row.dot(new) / rate.dot(new)
        tau = tau - change
        new = precise_flow(regime.A, z, tau)
        if abs(change) <= eps * abs(tau):
            if tau < 0:
                break
            return tau, new
    raise Undecided("a grazing switch")
