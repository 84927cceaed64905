"""An independent vibro-impact solver: matrix exponentials between switches. It shares no code with the package.

    M q'' + C q' + K q = sum_k p_k f_k(t) + sum_c row_c^T F_c(row_c q + o_c(t)),
    F_c(u) = -kappa_c [(u - upper_c)_+ - (lower_c - u)_+]

In a window between the corners of the pulses and with every contact free or on one stop this is the
autonomous system z' = A z of z = (q, q', 1, t - t_window, sin, cos of every oscillation). Gaps are
followed on a grid of a 32nd of the fastest period, denser after every switch; a gap whose rate changes
sign inside an interval is looked at where it is smallest. ``precise`` repeats the motion in mpmath.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mpmath as mp
import numpy as np
import scipy.linalg

PER_PERIOD = 32  # grid points in the fastest period
RATIO = 1.3  # of consecutive grid intervals after a switch
BLOCK = 64  # grid points that are computed at once
MOST_POINTS = 4_000_000
Wave = tuple  # ("constant", level), ("harmonic", amplitude, frequency, phase), (pulse, amplitude, begin, end)
PULSES = ("half-sine", "rectangular", "triangular")


class Undecided(RuntimeError):
    """The solver does not know: too many switches at one time, or too much work."""


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
        """Where the windows begin: 0 and every corner of a pulse before the end."""
        corners = {0.0}
        for wave in self.waves:
            if wave[0] in PULSES:
                _, _, begin, end = wave
                corners |= {begin, end} | ({0.5 * (begin + end)} if wave[0] == "triangular" else set())
        return sorted(t for t in corners if 0.0 <= t < self.t_end)

    @cached_property
    def frequencies(self) -> np.ndarray:
        """Natural angular frequencies without contact and damping."""
        return np.sqrt(np.maximum(scipy.linalg.eigh(self.stiffness, self.mass, eigvals_only=True), 0.0))


def wave_value(wave: Wave, t: Any) -> np.ndarray:
    """f(t), vectorised; a pulse is zero outside its interval."""
    t = np.asarray(t, float)
    if wave[0] == "constant":
        return np.full(t.shape, wave[1])
    if wave[0] == "harmonic":
        return wave[1] * np.sin(wave[2] * t + wave[3])
    kind, amplitude, begin, end = wave
    s = (t - begin) / (end - begin)
    shape = {
        "half-sine": np.sin(np.pi * np.clip(s, 0.0, 1.0)),
        "rectangular": np.ones(t.shape),
        "triangular": 1.0 - np.abs(2.0 * s - 1.0),
    }[kind]
    return np.where((s >= 0.0) & (s <= 1.0), amplitude * shape, 0.0)


@dataclass(eq=False)
class Regime:
    """z' = A z with contacts on sides chi in one window; gaps[k] = (contact, side, row of z), > 0 inside."""

    A: np.ndarray
    gaps: list[tuple[int, int, np.ndarray]]
    number: Callable[[Any], Any]

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
        """exp(A tau) z: Taylor's series where it is short."""
        B, d = self.balanced
        size = np.linalg.norm(B, 1) * tau
        if size > 1.0:
            return self.exponential(tau) @ z
        term = total = z / d
        for k in range(1, 25):
            term = (tau / k) * (B @ term)
            total = total + term
            if size**k < 1e-30:
                break
        return d * total

    @cached_property
    def scales(self) -> tuple[float, float]:
        """The largest |eigenvalue| and the largest angular frequency."""
        values = np.linalg.eigvals(self.balanced[0])
        oscillation = np.abs(values.imag)[np.abs(values.imag) > 1e-9 * np.abs(values)]
        return float(np.max(np.abs(values), initial=0.0)), float(np.max(oscillation, initial=0.0))

    @cached_property
    def stencil(self) -> dict[float, tuple[np.ndarray, np.ndarray]]:
        return {}

    def grid(self, span: float, refine: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times after a switch, exponentials there, and those of up to BLOCK further equal steps, for a span."""
        fastest, oscillation = self.scales
        longest = min(2.0 * np.pi / (PER_PERIOD * refine * max(oscillation, 1e-300)), span / 16.0)
        if longest not in self.stencil:
            first = min(longest, 1e-3 / max(fastest, 1e-300))
            count = 1 + int(np.ceil(np.log(longest / first) / np.log(RATIO)))
            widths = longest * RATIO ** -np.arange(count, -1.0, -1.0)
            times = np.cumsum(widths)
            powers = np.empty((BLOCK, *self.A.shape))
            powers[0] = self.exponential(longest)
            for k in range(1, BLOCK):
                powers[k] = powers[k - 1] @ powers[0] if k % 8 else self.exponential((k + 1) * longest)
            self.stencil[longest] = times, self.exponential(times), longest, powers  # type: ignore[assignment]
        return self.stencil[longest]  # type: ignore[return-value]


class Equations:
    """The regimes of a case, in float64 or, for ``number`` = mpmath.mpf, in its precision."""

    def __init__(self, case: Case, number: Callable[[Any], Any] = float) -> None:
        self.case, self.number = case, number
        self.regimes: dict[tuple, Regime] = {}
        self.sin, self.cos, self.pi = (np.sin, np.cos, np.pi) if number is float else (mp.sin, mp.cos, +mp.pi)
        convert = np.vectorize(number, otypes=[float if number is float else object])
        self.M, self.C, self.K = (convert(x) for x in (case.mass, case.damping, case.stiffness))
        if number is float:
            self.inverse = lambda x: scipy.linalg.solve(self.M, x, assume_a="pos")
        else:
            inverse = np.array((mp.matrix(self.M.tolist()) ** -1).tolist(), object)
            self.inverse = lambda x: inverse @ x
        self.convert = convert
        self.oscillations: list[tuple] = []  # (frequency, phase) of every oscillation of any window
        for wave in case.waves:
            if wave[0] == "harmonic":
                self.oscillations.append((number(wave[2]), number(wave[3])))
            elif wave[0] == "half-sine":
                frequency = self.pi / (number(wave[3]) - number(wave[2]))
                self.oscillations.append((frequency, -frequency * number(wave[2])))
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
        elif wave[2] <= begin < wave[3]:
            amplitude, first, last = (number(x) for x in wave[1:])
            if wave[0] == "rectangular":
                out[0] += amplitude
            elif wave[0] == "half-sine":
                frequency = self.pi / (last - first)
                out[2 + 2 * self.oscillations.index((frequency, -frequency * first))] += amplitude
            else:
                slope = 2 * amplitude / (last - first)
                rising = begin < 0.5 * (wave[2] + wave[3])
                out[0] += slope * (number(begin) - first) if rising else slope * (last - number(begin))
                out[1] += slope if rising else -slope
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
        self.regimes[window, chi] = Regime(A, gaps, self.number)
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
