"""A stretch of motion with some contacts held, as a Taylor series that ends below rounding."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...basics.arrays import Array
from ...basics.compiled import compiled
from ...basics.validation import InputError
from ...model.drive import Drive
from ...model.sampled import Sampled
from ...model.system import System
from ...model.time_functions import Constant, Harmonic, LoadFunction, parts, parts_of

ORDER = 18  # 1/(ORDER + 1)! = 8e-18: what is left out of a stretch of a radian of the fastest motion
SMALL = 1e-6  # of a stretch
FACTORIALS = np.array([float(math.factorial(k)) for k in range(ORDER + 1)])


@compiled
def coefficients(
    stiff: Array, damp: Array, forces: Array, rows: Array, back: Array, shifts: Array, q: Array, v: Array, held: Array
) -> tuple[Array, Array]:
    """c (ORDER + 1, n), the motion sum_k c_k s^k from q, v, and the reactions (ORDER - 1, h) along ``rows``.

    q'' = forces - damp q' - stiff q + M^-1 rows^T R with rows q = -shifts: forces (ORDER - 1, n) and shifts
    (ORDER + 1, h) are series, back (n, h) is M^-1 rows^T, held (h, h) the inverse of rows back.
    """
    n, h = q.size, rows.shape[0]
    c, R, y = np.zeros((ORDER + 1, n)), np.zeros((ORDER - 1, h)), np.zeros(h)
    c[0], c[1] = q, v
    for k in range(ORDER - 1):
        down = 1.0 / ((k + 2) * (k + 1))
        for i in range(n):
            total = forces[k, i]
            for j in range(n):
                total -= stiff[i, j] * c[k, j] + (k + 1) * damp[i, j] * c[k + 1, j]
            c[k + 2, i] = down * total
        for _ in range(2 if h else 0):  # what rounding leaves of forces that cancel would move a body at rest
            for a in range(h):
                y[a] = shifts[k + 2, a]
                for i in range(n):
                    y[a] += rows[a, i] * c[k + 2, i]
            for a in range(h):
                total = 0.0
                for b in range(h):
                    total -= held[a, b] * y[b]
                R[k, a] += total / down
                for i in range(n):
                    c[k + 2, i] += total * back[i, a]
    return c, R


@dataclass(frozen=True, eq=False)
class Model:
    """What every stretch of a system needs. ``fastest``: the largest rate of its motions and drives."""

    system: System
    rows: Array  # (m, n)
    back: Array  # (n, m), M^-1 rows^T
    stiff: Array
    damp: Array
    loads: Array  # (L, n), M^-1 p
    fastest: float
    edges: Array  # the times of all samples, between which every function of time is smooth

    @classmethod
    def of(cls, system: System) -> Model:
        """Raises InputError for functions of time other than Harmonic, Constant and Sampled, and for stops that move
        along a polygon: at its corners the contact point has no velocity."""
        rows = np.array([contact.row for contact in system.contacts])
        drives = [0.0]
        for function in [*(f for _, f in system.loads), *(contact.offset for contact in system.contacts)]:
            for _, part in parts(function):
                if not isinstance(part, (Harmonic, Constant, Sampled)):
                    rule = "be made of Harmonic, Constant and Sampled for the exact solution with rigid stops"
                    raise InputError("time function", part, rule, "use a scheme with an impact law")
                drives.append(float(part.frequency) if isinstance(part, Harmonic) else 0.0)
        for part in (x for contact in system.contacts for x in parts_of(contact.offset)):
            if isinstance(part, Sampled) and part.degree < 2:
                rule = "have a velocity at its samples, where it moves a rigid stop"
                raise InputError("contact.offset", part, rule, 'take samples of kind "cubic"')
        solved = np.linalg.solve(system.mass, np.hstack([system.stiffness, system.damping, rows.T]))
        n = system.size
        stiff, damp, back = solved[:, :n], solved[:, n : 2 * n], solved[:, 2 * n :]
        rates = np.sqrt(np.max(np.abs(np.linalg.eigvals(stiff)))), np.max(np.abs(np.linalg.eigvals(damp)))
        loads = np.array([np.linalg.solve(system.mass, p) for p, _ in system.loads]).reshape(-1, n)
        rows, back, stiff, damp, loads = (np.ascontiguousarray(x) for x in (rows, back, stiff, damp, loads))
        return cls(system, rows, back, stiff, damp, loads, max(*map(float, rates), *drives), Drive.of(system).edges)

    def next_edge(self, t: float, t_end: float) -> float:
        """The first edge after t, or t_end where that comes before."""
        k = int(np.searchsorted(self.edges, t, side="right"))
        return min(float(self.edges[k]), t_end) if k < len(self.edges) else t_end

    def stretch(self, t: float, q: Array, v: Array, held: tuple[int, ...]) -> tuple[Array, Array]:
        """Series of the motion from t with the contacts ``held`` where they are, and of their reactions."""
        forces = np.zeros((ORDER - 1, len(q)))
        for (_, f), p in zip(self.system.loads, self.loads, strict=True):
            forces += np.outer(series(f, t)[: ORDER - 1], p)
        shifts = np.array([self.shift(c, t) for c in held]).reshape(-1, ORDER + 1).T
        return self._series(forces, shifts, q, v, held)

    def load_sizes(self, t: float) -> Array:
        """Accelerations (n,) by all loads at t, were none against another: what the sum loses is relative to these."""
        sizes = [sum(abs(term[0]) for term in terms(f, t)) for _, f in self.system.loads]
        return np.abs(self.loads).T @ np.array(sizes, float)

    def _series(self, forces: Array, shifts: Array, q: Array, v: Array, held: tuple[int, ...]) -> tuple[Array, Array]:
        at = list(held)
        rows, back = np.ascontiguousarray(self.rows[at]), np.ascontiguousarray(self.back[:, at])
        inverse = np.linalg.inv(rows @ back) if at else np.zeros((0, 0))
        own = forces, rows, back, np.ascontiguousarray(shifts), np.ascontiguousarray(q), np.ascontiguousarray(v)
        return coefficients(self.stiff, self.damp, *own, inverse)

    def shift(self, contact: int, t: float) -> Array:
        """The series of a contact's offset."""
        offset = self.system.contacts[contact].offset
        return np.zeros(ORDER + 1) if offset is None else series(offset, t)


def series(function: LoadFunction, t: float) -> Array:
    """(ORDER + 1,), f(t + s) in powers of s, up to the next sample."""
    return np.sum(terms(function, t), axis=0)


def terms(function: LoadFunction, t: float) -> list[Array]:
    """The ``series`` of each term of a sum."""
    found, k = [], np.arange(ORDER + 1)
    for factor, part in parts(function):
        own = np.zeros(ORDER + 1)
        if isinstance(part, Harmonic):
            turned = np.sin(part.frequency * t + part.phase + 0.5 * np.pi * (k % 4))
            own = part.amplitude * float(part.frequency) ** k * turned / FACTORIALS
        elif isinstance(part, Constant):
            own[0] = part.level
        elif isinstance(part, Sampled):
            own[:4] = part.taylor(t)
        found.append(factor * own)
    return found


def value(series: Array, s: float) -> Array:
    """sum_k c_k s^k."""
    return np.tensordot(s ** np.arange(len(series)), series, 1)


def rate(series: Array, s: float) -> Array:
    """Its derivative by s."""
    k = np.arange(1, len(series))
    return np.tensordot(k * s ** (k - 1.0), series[1:], 1)


def _near(c: Array) -> float | None:
    """The first zero where it is so near that the series is a quadratic up to there: a body thrown off at the speed of
    roundings comes back in no time, and such a root is lost among the others."""
    under = c[1] ** 2 - 4.0 * c[0] * c[2]
    if under < 0.0 or not (c[1] < 0.0 or c[2] < 0.0):
        return None
    s = 2.0 * c[0] / (math.sqrt(under) - c[1]) if c[1] < 0.0 else (c[1] + math.sqrt(under)) / (-2.0 * c[2])
    return s if s < SMALL and s**3 * np.sum(np.abs(c[3:])) < 1e-3 * c[0] else None


def _real_roots(c: Array) -> Array:
    """Those of a series in (0, 1], in order."""
    last = np.flatnonzero(np.abs(c) > 1e-18 * np.max(np.abs(c)))[-1]
    roots = np.roots(c[last::-1])
    return np.sort(roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real <= 1.0 + 1e-12)])


def first_zero(gap: Array, length: float, zeros: int) -> float | None:
    """Where a series that is positive at once, after a zero of multiplicity ``zeros`` at 0, next turns negative.

    None if not in (0, length]; 0.0 where it is negative from the start. One that is zero throughout never does.
    """
    c = gap[zeros:]
    if not np.any(c):
        return None
    c = c[np.argmax(c != 0.0) :]
    if c[0] <= 0.0:
        return 0.0
    scaled = c * length ** np.arange(len(c))
    if scaled[0] > -np.sum(np.minimum(scaled[1:], 0.0)):
        return None
    near = _near(scaled)
    for root in _real_roots(scaled) if near is None else [near]:
        s = float(min(root, 1.0)) * length
        for _ in range(3):
            slope = float(rate(c, s))
            if slope < 0.0:
                s = min(max(s - float(value(c, s)) / slope, 0.0), length)
        if float(rate(c, s)) <= 0.0:
            return s
    return None


def stays(acceleration: Array) -> bool:
    """Whether a gap at rest, of which nothing presses now, does not open, by the series of its acceleration: a load on
    it rises from zero, or none ever comes."""
    later = acceleration[acceleration != 0.0]
    return acceleration[0] == 0.0 and not (len(later) and later[0] > 0.0)
