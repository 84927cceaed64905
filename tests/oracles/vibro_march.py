"""Following a motion from switch to switch in float64, with the equations of ``vibro_impact``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq
from vibro_impact import Case, Equations, Regime, Undecided, wave_value

EPS = 2.0**-52
MOST_POINTS = 400_000
MOST_AT_ONCE = 40  # switches without time in between


NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)


@dataclass(eq=False)
class Piece:
    """From t on in one window with contacts on sides chi: the states z at t + tau, the first and the last included."""

    t: Any
    window: int
    chi: tuple[int, ...]
    tau: np.ndarray
    z: np.ndarray


@dataclass(frozen=True)
class Episode:
    """A contact on one stop from ``begin`` to ``end``: largest depth, integral of the depth over time, and
    ``clear``, how far from the stop it had been since it was last on it. ``open``: not over at the end."""

    begin: float
    end: float
    side: int
    depth: float
    area: float
    clear: float
    open: bool


def first_crossing(
    regime: Regime, z: np.ndarray, span: float, resting: set[tuple[int, int]], refine: float
) -> tuple[float, tuple[int, int] | None, np.ndarray, np.ndarray]:
    """(tau, (contact, side) or None, grid of tau, states there) of the first gap that closes within span.

    The gaps of ``resting`` are exactly zero at the start and open.
    """
    if not regime.gaps:
        return span, None, np.array([0.0, span]), np.array([z, regime.flow(z, span)])
    times, exponentials, step, powers = regime.grid(span, refine)  # type: ignore[misc]
    rows, rates = regime.rows, regime.rows @ regime.A
    held = np.array([(i, s) in resting for i, s, _ in regime.gaps], bool)
    taus, states = [np.zeros(1)], [z[None]]
    count = 1
    while True:
        left = taus[-1][-1]
        if count == 1:
            tau, new = times[times < span], exponentials[times < span] @ z
        else:
            tau, new = left + step * np.arange(1, len(powers) + 1), powers @ states[-1][-1]
            tau, new = tau[tau < span], new[tau < span]
        last = len(tau) < (len(times) if count == 1 else len(powers))
        if last:
            end = regime.flow(new[-1], span - tau[-1]) if len(tau) else regime.flow(states[-1][-1], span - left)
            tau, new = np.append(tau, span), np.concatenate([new, end[None]])
        if len(regime.gaps):
            every = np.concatenate([states[-1][-1:], new])
            noise = 20.0 * EPS * np.abs(every) @ np.abs(rows).T
            found = _closing(
                regime,
                every,
                np.append(left, tau),
                every @ rows.T,
                every @ rates.T,
                noise,
                held if count == 1 else None,
            )
            if found is not None:
                when, gap = found
                keep = tau < when
                end = regime.flow(every[int(np.sum(keep))], when - np.append(left, tau)[int(np.sum(keep))])
                taus.append(np.append(tau[keep], when))
                states.append(np.concatenate([new[keep], end[None]]))
                return when, regime.gaps[gap][:2], np.concatenate(taus), np.concatenate(states)
        taus.append(tau)
        states.append(new)
        count += len(tau)
        if last:
            return span, None, np.concatenate(taus), np.concatenate(states)
        if count > MOST_POINTS:
            raise Undecided(f"more than {MOST_POINTS} grid points in one piece")


def _closing(
    regime: Regime, z: np.ndarray, tau: np.ndarray, G: np.ndarray, R: np.ndarray, noise: np.ndarray, held: Any
) -> tuple[float, int] | None:
    """The first root of a gap on the grid, and which."""
    G = G.copy()
    if held is not None:
        G[0, held] = 0.0
    width = np.diff(tau)[:, None]
    below = G[1:] < -noise[1:]
    turns = (R[:-1] < 0.0) & (R[1:] > 0.0) & ~below
    # The smallest value if the rate is linear between the two: good to a few per cent of the change.
    share = np.where(turns, -R[:-1] / np.where(turns, R[1:] - R[:-1], 1.0), 0.0)
    least = np.minimum(G[:-1], G[1:]) - np.where(turns, 0.6 * np.abs(R[:-1]) * share * width, 0.0)
    suspects = below | (turns & (least < 0.3 * np.maximum(G[:-1], G[1:])))
    for j in np.flatnonzero(np.any(suspects, axis=1)):
        roots = []
        for k in np.flatnonzero(suspects[j]):
            root = _root(regime, z[j], float(width[j, 0]), k, G[j, k], R[j], noise[j, k], below[j, k])
            if root is not None:
                roots.append((float(tau[j]) + root, int(k)))
        if roots:
            return min(roots)
    return None


def _root(regime: Regime, z: np.ndarray, width: float, k: int, g0: float, R: np.ndarray, noise: float, below: bool):
    """Where gap k closes in (0, width], None if it does not; ``below``: it is closed at the end."""
    row = regime.rows[k]
    rate = row @ regime.A

    def gap(s: float) -> float:
        return float(row @ regime.flow(z, s)) if s else max(float(g0), 0.0)

    def speed(s: float) -> float:
        return float(rate @ regime.flow(z, s))

    low, high = 0.0, width
    if not below or g0 <= noise:  # an extremum in between: a dip, or the top of what rises from zero
        if speed(0.0) * speed(width) < 0.0:
            top = brentq(speed, 0.0, width, xtol=1e-15 * width, rtol=4 * EPS)
            if below:
                low = top
            else:
                high = top
        if gap(low) <= 0.0:
            return low
        if gap(high) >= -noise:
            return None
    return brentq(gap, low, high, xtol=1e-16 * width, rtol=4 * EPS, maxiter=2000)


@dataclass(eq=False)
class Solution:
    """The motion of ``case`` as pieces; states at any time by one exponential from the grid."""

    case: Case
    equations: Equations
    pieces: list[Piece]

    def __post_init__(self) -> None:
        self.starts = np.array([float(p.t) for p in self.pieces])

    def states(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """q, q' (k, n) at times t."""
        n = self.case.size
        z = np.empty((len(t), self.equations.length))
        owner = np.maximum(np.searchsorted(self.starts, t, side="right") - 1, 0)
        for i in np.unique(owner):
            piece = self.pieces[i]
            regime, tau = self.equations.regime(piece.window, piece.chi), t[owner == i] - piece.t
            left = np.clip(np.searchsorted(piece.tau, tau, side="right") - 1, 0, len(piece.tau) - 1)
            rest = np.maximum(tau - piece.tau[left], 0.0)
            z[owner == i] = np.einsum("kij,kj->ki", regime.exponential(rest), piece.z[left])
        return z[:, :n], z[:, n : 2 * n]

    def tip(self, t: np.ndarray) -> np.ndarray:
        return self.states(t)[0] @ self.case.observe

    def episodes(self, i: int) -> list[Episode]:
        """The times contact i is on a stop, those at the start and the end included."""
        found: list[list] = []  # begin, end, side, depth, area, clear
        clear, before = np.inf, 0
        for piece in self.pieces:
            side = piece.chi[i]
            end = float(piece.t) + float(piece.tau[-1])
            regime = self.equations.regime(piece.window, piece.chi)
            if side == 0:
                last = found[-1][2] if found else 0
                away = np.inf
                if last:
                    away = float(np.max(-(piece.z @ self.equations.gap(i, last, piece.window))))
                clear = max(0.0 if before else clear, away) if found else np.inf
            else:
                gap = self.equations.gap(i, side, piece.window)
                depth, rate, curve = (piece.z @ (gap @ np.linalg.matrix_power(regime.A, k)) for k in range(3))
                h = np.diff(piece.tau)
                area = h / 2 * (depth[:-1] + depth[1:]) + h**2 / 10 * (rate[:-1] - rate[1:])
                area += h**3 / 120 * (curve[:-1] + curve[1:])
                fast = np.max(np.abs(np.linalg.eigvals(regime.A))) * np.max(h, initial=0.0) > 0.3
                if fast:  # what decays within a step needs more than its ends
                    at = zip(0.5 * (1.0 + NODES), 0.5 * WEIGHTS, strict=True)
                    area = sum(
                        w * h * (np.einsum("kij,kj->ki", regime.exponential(x * h), piece.z[:-1]) @ gap) for x, w in at
                    )
                if before == side:
                    found[-1][1], found[-1][3] = end, max(found[-1][3], self._peak(regime, piece, gap, depth, rate))
                    found[-1][4] += float(np.sum(area))
                else:
                    away = np.inf if not found or found[-1][2] != side or before != 0 else clear
                    deepest = self._peak(regime, piece, gap, depth, rate)
                    found.append([float(piece.t), end, side, deepest, float(np.sum(area)), away])
            before = side
        return [Episode(*x, open=x[1] >= self.case.t_end) for x in found]  # type: ignore[misc]

    @staticmethod
    def _peak(regime: Regime, piece: Piece, gap: np.ndarray, depth: np.ndarray, rate: np.ndarray) -> float:
        """The largest depth in a piece: its turning points by their rates' roots."""
        best = float(np.max(depth, initial=0.0))
        turns = np.flatnonzero((rate[:-1] > 0.0) & (rate[1:] < 0.0) & (np.maximum(depth[:-1], depth[1:]) > 0.9 * best))
        for j in turns:
            z, width = piece.z[j], piece.tau[j + 1] - piece.tau[j]
            at = brentq(lambda s, z=z: float(gap @ regime.A @ regime.flow(z, s)), 0.0, width)
            best = max(best, float(gap @ regime.flow(z, at)))
        return best

    def energy(self, t: np.ndarray) -> np.ndarray:
        """1/2 q'^T M q' + 1/2 q^T K q + the stops' energy."""
        q, v = self.states(t)
        total = 0.5 * np.sum(v * (v @ self.case.mass), axis=1) + 0.5 * np.sum(q * (q @ self.case.stiffness), axis=1)
        for c in self.case.contacts:
            u = q @ c.row + (0.0 if c.offset is None else wave_value(c.offset, t))
            total += 0.5 * c.kappa * (np.maximum(u - c.upper, 0.0) ** 2 + np.maximum(c.lower - u, 0.0) ** 2)
        return total


def solve(case: Case, refine: float = 1.0, most_pieces: int = 20_000) -> Solution:
    """The motion in float64. refine: how much finer than PER_PERIOD the grid is. Raises Undecided."""
    equations = Equations(case)
    t, window, pieces, at_once = 0.0, 0, [], 0
    z = equations.start(case.q0.astype(float), case.v0.astype(float), 0.0, 0)
    at: set[tuple[int, int]] = set()
    ends = [*case.windows[1:], case.t_end]
    n = case.size
    while True:
        chi = equations.sides(z, window, at, EPS)
        regime = equations.regime(window, chi)
        resting = {
            (i, s) for i, s, row in regime.gaps if (i, s) in at or abs(row @ z) <= 20 * EPS * np.abs(row) @ np.abs(z)
        }
        tau, crossed, taus, states = first_crossing(regime, z, ends[window] - t, resting, refine)
        pieces.append(Piece(t, window, chi, taus, states))
        at_once = at_once + 1 if t + tau == t else 0
        if at_once > MOST_AT_ONCE or len(pieces) > most_pieces:
            raise Undecided(f"{len(pieces)} pieces by t = {t:g}")
        if crossed is None:
            t, window, at = ends[window], window + 1, set()
            if window == len(ends):
                return Solution(case, equations, pieces)
        else:
            t, at = t + tau, {crossed}
        z = equations.start(states[-1][:n], states[-1][n : 2 * n], t, window)
