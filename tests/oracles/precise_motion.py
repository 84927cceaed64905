"""Motion between linear stops in mpmath, from the law of contact itself, by small steps.

    M q'' + C q' + K q = sum of p a sin(w t + phase) + sum of row^T F,   F = -(kappa d + c d')_+,   or u'+ = -e u'-

Shares no code with the package and reads of its System the float64 numbers only, which it takes as exact.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import Any

import mpmath as mp
import numpy as np

TERMS = 45  # of a series
RADIANS = 2.5  # of the fastest motion, in one step: RADIANS^TERMS/TERMS! is 1e-38
LOOKS = 24  # for events, within a step


def exact(matrix: Any) -> Any:
    """The doubles of a matrix."""
    return mp.matrix([[mp.mpf(float(x)) for x in line] for line in matrix])


def fastest(system: Any) -> float:
    """Largest rate of the motion with all springs and dampers of the stops in action."""
    n, stiffness, damping = system.size, system.stiffness.copy(), system.damping.copy()
    for contact in system.contacts:
        if not contact.stops.rigid:
            stiffness += float(contact.stops.stiffness) * np.outer(contact.row, contact.row)
            damping += float(contact.stops.damping) * np.outer(contact.row, contact.row)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(system.mass, np.hstack([stiffness, damping]))]])
    return float(np.max(np.abs(np.linalg.eigvals(A))))


def wave(f: Any, t: Any, k: int) -> Any:
    """Coefficient k of a Harmonic at t + s."""
    w = mp.mpf(float(f.frequency))
    turned = mp.sin(w * t + mp.mpf(float(f.phase)) + k * mp.pi / 2)
    return mp.mpf(float(f.amplitude)) * w**k * turned / mp.factorial(k)


def horner(p: list[Any], s: Any) -> Any:
    """sum_k p_k s^k."""
    total = mp.mpf(0)
    for x in reversed(p):
        total = total * s + x
    return total


class PreciseMotion:
    """All numbers of a System whose loads are Harmonic, as mpf; ``step``: of the search for events."""

    def __init__(self, system: Any, step: Any) -> None:
        self.n, inverse = system.size, exact(system.mass) ** -1
        self.contacts = system.contacts
        self.rows = [[mp.mpf(float(x)) for x in contact.row] for contact in system.contacts]
        self.back = [inverse * mp.matrix(row) for row in self.rows]
        self.loads = [(inverse * mp.matrix([mp.mpf(float(x)) for x in p]), f) for p, f in system.loads]
        self.stiff, self.damped = inverse * exact(system.stiffness), inverse * exact(system.damping)
        self.step = min(mp.mpf(step), mp.mpf(RADIANS / fastest(system)))

    def offset(self, c: int, t: Any) -> list[Any]:
        """Coefficients of the offset of a contact at t + s."""
        f = self.contacts[c].offset
        if f is None:
            return [mp.mpf(0)] * (TERMS + 2)
        return [wave(f, t, k) for k in range(TERMS + 2)]

    def taylor(self, t: Any, q: Any, v: Any, pressed: tuple[int, ...]) -> list[Any]:
        """Coefficients of q(t + s): (k + 1)(k + 2) q_{k+2} = what k-th coefficients of the forces do."""
        series, offsets = [q, v], [self.offset(c, t) for c in range(len(pressed))]
        for k in range(TERMS):
            rate = (k + 1) * series[k + 1]
            a = -(self.stiff * series[k]) - self.damped * rate
            for p, f in self.loads:
                a += p * wave(f, t, k)
            for c, side in enumerate(pressed):
                if side:
                    o = offsets[c]
                    u, du = self.along(c, series[k]) + o[k], self.along(c, rate) + (k + 1) * o[k + 1]
                    a += self.back[c] * self.force(c, u - (self.stop(c, side) if k == 0 else 0), du)
            series.append(a / ((k + 1) * (k + 2)))
        return series

    def along(self, c: int, x: Any) -> Any:
        """row x."""
        return mp.fdot(self.rows[c], x)

    def stop(self, c: int, side: int) -> Any:
        stops = self.contacts[c].stops
        return mp.mpf(stops.upper_bound if side > 0 else stops.lower_bound)

    def force(self, c: int, beyond: Any, rate: Any) -> Any:
        """Of u - g and its rate."""
        stops = self.contacts[c].stops
        return -mp.mpf(stops.stiffness) * beyond - mp.mpf(stops.damping) * rate

    def state(self, c: int, t: Any, q: Any, v: Any) -> int:
        """0 short of both stops, 1 and -1 pressed, 2 and -2 beyond and not pressed."""
        o = self.offset(c, t)
        u, rate = self.along(c, q) + o[0], self.along(c, v) + o[1]
        for side in (1, -1):
            if abs(self.stop(c, side)) < mp.inf and side * (u - self.stop(c, side)) > 0:
                return side if -side * self.force(c, u - self.stop(c, side), rate) > 0 else 2 * side
        return 0

    def over(self, t_end: Any, q: Any, v: Any) -> tuple[list[tuple[Any, int, int]], Any, Any]:
        """Events (time, contact, new side) on (0, t_end), q and v there."""
        t, q, v = mp.mpf(0), mp.matrix(q), mp.matrix(v)
        sides, events = [self.state(c, t, q, v) for c in range(len(self.rows))], []
        while t < t_end:
            h = min(self.step, t_end - t)
            series = self.taylor(t, q, v, tuple(s if abs(s) == 1 else 0 for s in sides))
            first = min((e for c, s in enumerate(sides) for e in self.leaves(series, t, c, s, h)), default=None)
            h = h if first is None else first[0]
            q = sum((x * h**k for k, x in enumerate(series)), mp.zeros(self.n, 1))
            v = sum((k * x * h ** (k - 1) for k, x in enumerate(series) if k), mp.zeros(self.n, 1))
            t += h
            if first is not None:
                _, c, new = first
                stops = self.contacts[c].stops
                if stops.rigid:
                    rate = self.along(c, v) + self.offset(c, t)[1]
                    loss = (1 + mp.mpf(stops.restitution)) * rate / self.along(c, self.back[c])
                    v, new = v - self.back[c] * loss, 0
                sides[c] = new
                events.append((t, c, new))
        return events, q, v

    def leaves(self, series: list[Any], t: Any, c: int, old: int, h: Any) -> list[tuple[Any, int, int]]:
        """Zeros on (0, h] of what keeps a contact on its side, with the side after it."""
        u = [self.along(c, x) + o for x, o in zip(series, self.offset(c, t), strict=True)]
        stops, zeros = self.contacts[c].stops, []
        lag = mp.mpf(0) if stops.rigid else mp.mpf(stops.damping) / mp.mpf(stops.stiffness)
        for side in (1, -1):
            if abs(self.stop(c, side)) == mp.inf or (old and side != mp.sign(old)):
                continue
            depth = [side * x for x in u]
            depth[0] -= side * self.stop(c, side)
            lagged = [a + lag * (k + 1) * b for k, (a, b) in enumerate(pairwise(depth))]
            watched = {0: [(depth, 1, side)], 1: [(lagged, -1, 2 * side if lag else 0)]}.get(
                abs(old), [(depth, -1, 0), (lagged, 1, side)]
            )
            for p, way, new in watched:
                value = partial(horner, p)
                grid = [h * k / LOOKS for k in range(LOOKS + 1)]
                grid[0] = h * mp.mpf("1e-9")  # after an event the quantity is zero at 0
                signs = [way * value(s) > 0 for s in grid]
                for k in range(LOOKS):
                    if signs[k + 1] and not signs[k]:
                        zeros.append((mp.findroot(value, (grid[k], grid[k + 1]), solver="anderson"), c, new))
                        break
        return zeros
