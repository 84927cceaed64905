"""The witness of motions on linear stops: matrix exponentials between events. It shares no code with the package.

    M q'' + C q' + K q = sum_k p_k f_k(t) + sum_c row_c^T F_c(row_c q + o_c(t)),
    F_c(u) = -kappa_c [(u - upper_c)_+ - (lower_c - u)_+]

In a window between the corners of the records and with every contact free or on one stop this is the autonomous system
z' = A z of z = (q, q', 1, t - t_window, sin, cos of every oscillation). Gaps are followed in float64 on a grid of a
32nd of the fastest period, denser after every event; a gap whose rate changes sign inside an interval is looked at
where it is smallest. With ``digits`` every event is refined by Newton's method in mpmath.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mpmath as mp
import numpy as np
import scipy.linalg
from scipy.optimize import brentq

EPS = 2.0**-52
PER_PERIOD = 32  # grid points in the fastest period
RATIO = 1.3  # of consecutive grid intervals after an event
BLOCK = 64  # grid points that are computed at once
MOST_POINTS = 400_000  # between two events
MOST_AT_ONCE = 40  # events without time in between
NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)
Wave = tuple  # ("constant", level), ("harmonic", amplitude, frequency, phase), ("sampled", times, values)


class Undecided(RuntimeError):
    """The witness does not know: too many events at one time, or too much work."""


@dataclass(frozen=True, eq=False)
class Contact:
    """Stops of stiffness kappa at row q + offset(t); lower and upper are -inf and inf where there is none."""

    row: np.ndarray
    lower: float
    upper: float
    kappa: float
    offset: Wave | None = None


@dataclass(frozen=True, eq=False)
class Case:
    """A system as plain arrays and numbers, and how long it is followed. observe: the row of the tip."""

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    q0: np.ndarray
    v0: np.ndarray
    loads: tuple[tuple[np.ndarray, Wave], ...]
    contacts: tuple[Contact, ...]
    observe: np.ndarray
    t_end: float
    notes: str = ""

    @property
    def size(self) -> int:
        return len(self.mass)

    @property
    def waves(self) -> list[Wave]:
        return [wave for _, wave in self.loads] + [c.offset for c in self.contacts if c.offset is not None]

    @cached_property
    def windows(self) -> list[float]:
        """Where the windows begin: 0 and every sample of a record before the end."""
        corners = {float(t) for wave in self.waves if wave[0] == "sampled" for t in wave[1]}
        return sorted(t for t in corners | {0.0} if 0.0 <= t < self.t_end)

    @cached_property
    def frequencies(self) -> np.ndarray:
        """Natural angular frequencies without contact and damping."""
        return np.sqrt(np.maximum(scipy.linalg.eigh(self.stiffness, self.mass, eigvals_only=True), 0.0))


def wave_value(wave: Wave, t: Any) -> np.ndarray:
    """f(t), vectorised."""
    t = np.asarray(t, float)
    if wave[0] == "constant":
        return np.full(t.shape, wave[1])
    return wave[1] * np.sin(wave[2] * t + wave[3]) if wave[0] == "harmonic" else np.interp(t, wave[1], wave[2])


@dataclass(eq=False)
class Regime:
    """z' = A z with contacts on sides chi in one window; gaps[k] = (contact, side, row of z), > 0 inside."""

    A: np.ndarray
    gaps: list[tuple[int, int, np.ndarray]]

    @cached_property
    def rows(self) -> np.ndarray:
        return np.array([row for _, _, row in self.gaps]).reshape(-1, len(self.A))

    @cached_property
    def balanced(self) -> tuple[np.ndarray, np.ndarray]:
        """B and d with A = diag(d) B diag(1/d)."""
        B, (scale, _) = scipy.linalg.matrix_balance(self.A, permute=False, separate=True)
        return B, scale

    def exponential(self, tau: Any) -> np.ndarray:
        """exp(A tau) for one tau or an array of them."""
        B, d = self.balanced
        return d[:, None] * scipy.linalg.expm(np.multiply.outer(np.asarray(tau, float), B)) / d

    def flow(self, z: np.ndarray, tau: float) -> np.ndarray:
        """exp(A tau) z."""
        return self.exponential(tau) @ z

    @cached_property
    def scales(self) -> tuple[float, float]:
        """The largest |eigenvalue| and the largest angular frequency."""
        values = np.linalg.eigvals(self.balanced[0])
        oscillation = np.abs(values.imag)[np.abs(values.imag) > 1e-9 * np.abs(values)]
        return float(np.max(np.abs(values), initial=0.0)), float(np.max(oscillation, initial=0.0))

    @cached_property
    def stencil(self) -> dict[float, tuple[np.ndarray, np.ndarray, float, np.ndarray]]:
        return {}

    def grid(self, span: float, refine: float) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
        """Times after an event, exponentials there, and those of up to BLOCK further equal steps, for a span."""
        fastest, oscillation = self.scales
        longest = min(2.0 * np.pi / (PER_PERIOD * refine * max(oscillation, 1e-300)), span / 16.0)
        if longest not in self.stencil:
            first = min(longest, 1e-3 / max(fastest, 1e-300))
            count = 1 + int(np.ceil(np.log(longest / first) / np.log(RATIO)))
            widths = longest * RATIO ** -np.arange(count, -1.0, -1.0)
            times = np.cumsum(widths)
            powers = self.exponential(longest * np.arange(1.0, BLOCK + 1.0))
            self.stencil[longest] = times, self.exponential(times), longest, powers
        return self.stencil[longest]

    def stretches(self, z: np.ndarray, span: float, refine: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Grid points in (0, span], the last of them span, and the states there from z on, block by block."""
        if not self.gaps:
            yield np.array([span]), self.flow(z, span)[None]
            return
        times, exponentials, step, powers = self.grid(span, refine)
        left, tau, new = 0.0, times, exponentials @ z
        while tau[-1] < span:
            yield tau, new
            left, z = tau[-1], new[-1]
            tau, new = left + step * np.arange(1, len(powers) + 1), powers @ z
        tau, new = tau[tau < span], new[tau < span]
        end = self.flow(new[-1], span - tau[-1]) if len(tau) else self.flow(z, span - left)
        yield np.append(tau, span), np.concatenate([new, end[None]])


class Equations:
    """The regimes of a case, in float64 or, for ``number`` = mpmath.mpf, in its precision."""

    def __init__(self, case: Case, number: Callable[[Any], Any] = float) -> None:
        self.case, self.number, self.digits = case, number, mp.mp.dps
        self.regimes: dict[tuple, Regime] = {}
        self.sin, self.cos = (np.sin, np.cos) if number is float else (mp.sin, mp.cos)
        convert = np.vectorize(number, otypes=[float if number is float else object])
        self.M, self.C, self.K = (convert(x) for x in (case.mass, case.damping, case.stiffness))
        if number is float:
            self.inverse = lambda x: scipy.linalg.solve(self.M, x, assume_a="pos")
        else:
            inverse = np.array((mp.matrix(self.M.tolist()) ** -1).tolist(), object)
            self.inverse = lambda x: inverse @ x
        self.convert = convert
        waves = [wave for wave in case.waves if wave[0] == "harmonic"]
        self.oscillations = [(number(wave[2]), number(wave[3])) for wave in waves]  # frequency, phase
        self.length = 2 * case.size + 2 + 2 * len(self.oscillations)

    def functions(self, t: Any, window: int) -> np.ndarray:
        """(1, t - t_window, sin, cos, ...) at t."""
        values = [self.number(1), t - self.number(self.case.windows[window])]
        for frequency, phase in self.oscillations:
            values += [self.sin(frequency * t + phase), self.cos(frequency * t + phase)]
        return np.array(values)

    def coefficients(self, wave: Wave, window: int) -> np.ndarray:
        """The wave in a window as a combination of ``functions``."""
        number, begin = self.number, self.case.windows[window]
        out = self.convert(np.zeros(self.length - 2 * self.case.size))
        if wave[0] == "constant":
            out[0] += number(wave[1])
        elif wave[0] == "harmonic":
            out[2 + 2 * self.oscillations.index((number(wave[2]), number(wave[3])))] += number(wave[1])
        else:
            k = min(int(np.searchsorted(wave[1], begin, side="right")), len(wave[1]) - 1)
            (t0, t1), (f0, f1) = (map(number, x[k - 1 : k + 1]) for x in wave[1:])
            slope = (f1 - f0) / (t1 - t0)
            out[0] += f0 + slope * (number(begin) - t0)
            out[1] += slope
        return out

    def start(self, q: np.ndarray, v: np.ndarray, t: Any, window: int) -> np.ndarray:
        return np.concatenate([q, v, self.functions(t, window)])

    def position(self, i: int, window: int) -> np.ndarray:
        """The row of z that gives contact i's position."""
        contact, n = self.case.contacts[i], self.case.size
        row = self.convert(np.zeros(self.length))
        row[:n] = self.convert(contact.row)
        if contact.offset is not None:
            row[2 * n :] = self.coefficients(contact.offset, window)
        return row

    def gap(self, i: int, side: int, window: int) -> np.ndarray:
        """The row of side (u - stop): > 0 beyond the stop."""
        row, contact = self.position(i, window), self.case.contacts[i]
        row[2 * self.case.size] -= self.number(contact.upper if side > 0 else contact.lower)
        return side * row

    def regime(self, window: int, chi: tuple[int, ...]) -> Regime:
        if (window, chi) in self.regimes:
            return self.regimes[window, chi]
        case, n = self.case, self.case.size
        force = self.convert(np.zeros((n, self.length)))
        force[:, :n], force[:, n : 2 * n] = -self.K, -self.C
        for vector, wave in case.loads:
            force[:, 2 * n :] += np.outer(self.convert(vector), self.coefficients(wave, window))
        gaps = []
        for i, (contact, side) in enumerate(zip(case.contacts, chi, strict=True)):
            if side:
                gaps.append((i, side, self.gap(i, side, window)))
                force += np.outer(self.convert(contact.row), -side * self.number(contact.kappa) * gaps[-1][2])
            else:
                gaps += [(i, s, -self.gap(i, s, window)) for s in self.open_sides(i)]
        A = self.convert(np.zeros((self.length, self.length)))
        A[:n, n : 2 * n] = self.convert(np.eye(n))
        A[n : 2 * n] = self.inverse(force)
        A[2 * n + 1, 2 * n] = self.number(1)
        for k, (frequency, _) in enumerate(self.oscillations):
            j = 2 * n + 2 + 2 * k
            A[j, j + 1], A[j + 1, j] = frequency, -frequency
        self.regimes[window, chi] = Regime(A, gaps)
        return self.regimes[window, chi]

    def open_sides(self, i: int) -> list[int]:
        contact = self.case.contacts[i]
        return [s for s, stop in ((1, contact.upper), (-1, contact.lower)) if np.isfinite(stop)]

    def sides(self, z: np.ndarray, window: int, at: set[tuple[int, int]], eps: Any) -> tuple[int, ...]:
        """Which side every contact is on just after z. One whose gap is zero, as those (contact, side) in
        ``at``, goes where the first derivative that is not zero takes it; at rest for ever it is open."""
        chi, pending = [0] * len(self.case.contacts), []
        for i in range(len(chi)):
            for side in self.open_sides(i):
                row = self.gap(i, side, window)
                depth, size = row @ z, np.abs(row) @ np.abs(z)
                if (i, side) in at or abs(depth) <= 20 * eps * size:
                    pending.append((i, side, row))
                elif depth > 0:
                    chi[i] = side
        derivative, bound = z, np.abs(z)
        for order in range(1, 9):
            regime = self.regime(window, tuple(chi))
            # The part of a closed contact's force enters at every order from 2 on: start again from z.
            derivative, bound = z, np.abs(z)
            for _ in range(order):
                derivative, bound = regime.A @ derivative, np.abs(regime.A) @ bound
            left = []
            for i, side, row in pending:
                rate, size = row @ derivative, np.abs(row) @ bound
                if abs(rate) <= 100 * eps * size:
                    left.append((i, side, row))
                elif rate > 0:
                    chi[i] = side
            pending = left
            if not pending:
                break
        return tuple(chi)


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
    taus, states, count = [np.zeros(1)], [z[None]], 0
    held = np.array([(i, s) in resting for i, s, _ in regime.gaps], bool)
    for tau, new in regime.stretches(z, span, refine):
        at, every = np.append(taus[-1][-1], tau), np.concatenate([states[-1][-1:], new])
        found = _closing(regime, every, at, None if count else held) if regime.gaps else None
        if found is not None:
            when, gap = found
            keep = int(np.sum(tau < when))
            end = regime.flow(every[keep], when - at[keep])
            taus, states = [*taus, np.append(tau[:keep], when)], [*states, np.concatenate([new[:keep], end[None]])]
            return when, regime.gaps[gap][:2], np.concatenate(taus), np.concatenate(states)
        taus.append(tau)
        states.append(new)
        count += len(tau)
        if count > MOST_POINTS:
            raise Undecided(f"more than {MOST_POINTS} grid points in one piece")
    return span, None, np.concatenate(taus), np.concatenate(states)


def _closing(regime: Regime, z: np.ndarray, tau: np.ndarray, held: Any) -> tuple[float, int] | None:
    """The first root of a gap on the grid, and which."""
    G, R = z @ regime.rows.T, z @ (regime.rows @ regime.A).T
    noise = 20.0 * EPS * np.abs(z) @ np.abs(regime.rows).T
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
class Piece:
    """From t on in one window with contacts on sides chi: the state z, in many digits where asked, and in float64 the
    states at t + tau, the first and the last included."""

    t: Any
    window: int
    chi: tuple[int, ...]
    z: np.ndarray
    tau: np.ndarray
    states: np.ndarray


@dataclass(eq=False)
class Motion:
    """The motion of ``case`` as pieces; states at any time by one exponential from the grid, or from the start of the
    piece in many digits."""

    case: Case
    equations: Equations
    pieces: list[Piece]
    precise: Equations | None = None

    def __post_init__(self) -> None:
        self.starts = np.array([float(p.t) for p in self.pieces])

    def state(self, t: Any) -> np.ndarray:
        """(q, q') at t in the digits of mpmath."""
        piece = self.pieces[max(0, int(np.searchsorted(self.starts, float(t), side="right")) - 1)]
        A = self.precise.regime(piece.window, piece.chi).A
        return precise_flow(A, piece.z, mp.mpf(t) - piece.t)[: 2 * self.case.size]

    def states(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """q, q' (k, n) at times t, in float64."""
        n = self.case.size
        z = np.empty((len(t), self.equations.length))
        if self.precise is not None:
            with mp.workdps(self.precise.digits):
                z[:, : 2 * n] = [[float(x) for x in self.state(float(s))] for s in t]
            return z[:, :n], z[:, n : 2 * n]
        owner = np.maximum(np.searchsorted(self.starts, t, side="right") - 1, 0)
        for i in np.unique(owner):
            piece = self.pieces[i]
            regime, tau = self.equations.regime(piece.window, piece.chi), t[owner == i] - piece.t
            left = np.clip(np.searchsorted(piece.tau, tau, side="right") - 1, 0, len(piece.tau) - 1)
            rest = np.maximum(tau - piece.tau[left], 0.0)
            z[owner == i] = np.einsum("kij,kj->ki", regime.exponential(rest), piece.states[left])
        return z[:, :n], z[:, n : 2 * n]

    def tip(self, t: np.ndarray) -> np.ndarray:
        return self.states(t)[0] @ self.case.observe

    def switches(self, i: int) -> list[tuple[float, int]]:
        """(t, side) of every change of contact i from one side to another."""
        sides = [piece.chi[i] for piece in self.pieces]
        return [(float(p.t), p.chi[i]) for p, old in zip(self.pieces[1:], sides, strict=False) if p.chi[i] != old]

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
                    away = float(np.max(-(piece.states @ self.equations.gap(i, last, piece.window))))
                clear = max(0.0 if before else clear, away) if found else np.inf
            else:
                gap = self.equations.gap(i, side, piece.window)
                depth, rate, curve = (piece.states @ (gap @ np.linalg.matrix_power(regime.A, k)) for k in range(3))
                h = np.diff(piece.tau)
                area = h / 2 * (depth[:-1] + depth[1:]) + h**2 / 10 * (rate[:-1] - rate[1:])
                area += h**3 / 120 * (curve[:-1] + curve[1:])
                fast = np.max(np.abs(np.linalg.eigvals(regime.A))) * np.max(h, initial=0.0) > 0.3
                if fast:  # what decays within a step needs more than its ends
                    at = zip(0.5 * (1.0 + NODES), 0.5 * WEIGHTS, strict=True)
                    area = sum(
                        w * h * (np.einsum("kij,kj->ki", regime.exponential(x * h), piece.states[:-1]) @ gap)
                        for x, w in at
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
            z, width = piece.states[j], piece.tau[j + 1] - piece.tau[j]
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


def solve(
    case: Case, digits: int | None = None, refine: float = 1.0, most_pieces: int = 20_000,
    most_seconds: float = float("inf"),
) -> Motion:  # fmt: skip
    """The motion, in float64 or in so many digits; refine: how much finer than PER_PERIOD the grid is.

    Raises Undecided, also after ``most_seconds`` of processor time.
    """
    begun, ends = time.process_time(), [*case.windows[1:], case.t_end]
    with mp.workdps(digits or 15):
        coarse = Equations(case)
        fine, eps = (Equations(case, mp.mpf), mp.mpf(10) ** (8 - digits)) if digits else (coarse, EPS)
        n, t, window, at_once = case.size, fine.number(0), 0, 0
        pieces, at = list[Piece](), set[tuple[int, int]]()
        z = fine.start(fine.convert(case.q0), fine.convert(case.v0), t, 0)
        while True:
            chi = fine.sides(z, window, at, eps)
            regime, guide, span = fine.regime(window, chi), coarse.regime(window, chi), fine.number(ends[window]) - t
            resting = {
                (i, s)
                for i, s, row in regime.gaps
                if (i, s) in at or abs(row @ z) <= 20 * eps * np.abs(row) @ np.abs(z)
            }
            tau, crossed, taus, states = first_crossing(guide, z.astype(float), float(span), resting, refine)
            pieces.append(Piece(t, window, chi, z, taus, states))
            at_once = at_once + 1 if t + tau == t else 0
            if at_once > MOST_AT_ONCE or len(pieces) > most_pieces or time.process_time() - begun > most_seconds:
                raise Undecided(f"{len(pieces)} pieces by t = {float(t):g}")
            new = states[-1]
            if crossed is None:
                new = precise_flow(regime.A, z, span) if digits else new
                t, window, at = fine.number(ends[window]), window + 1, set()
                if window == len(ends):
                    return Motion(case, coarse, pieces, fine if digits else None)
            else:
                if digits:
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
    raise Undecided("a grazing event")
