"""A motion between rigid stops, and what is read of it at any time; the first zero of a Taylor series."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array, IntArray
from ...model.contact import Contact
from ...model.system import System
from ...piecewise.generator import ORDER, Generators, RegimeFlow
from ...piecewise.motion import Motion
from ...trajectory.records import Impacts

FEW = 2000  # numbers, of which all terms of their series are held at once
SMALL = 1e-6  # of a stretch
LOCAL = 3  # in the place of sides: the segments that are Taylor series


@dataclass(eq=False)
class Event:
    """An impact on ``side`` of a contact; ``end`` > ``time`` where the contact is then held."""

    contact: int
    side: int
    time: float
    impulse: float
    end: float = math.nan


@dataclass(frozen=True, eq=False, repr=False)
class RigidMotion(Motion):
    """A motion between rigid stops: sides are those of held contacts. Segments in the regime LOCAL are Taylor series of
    ``generators`` from q, q' in the place of pairs; the others are flights in closed form.

    struck: (time, contact, impulse that is no event's). blows: (segment at whose start it is, contact). taken: (time,
    energy taken by impacts, put in by stops moving). stuck: (time, contact) where impacts accumulate. tie: where two
    contacts first close together but for rounding, and the order matters. fastest: rate of any motion or drive.
    """

    generators: Generators
    fastest: float
    events: list[Event]
    struck: list[tuple[float, int, float]]
    blows: list[tuple[int, int]]
    taken: list[tuple[float, float, float]]
    stuck: list[tuple[float, int]]
    tie: float

    @cached_property
    def shortest_period(self) -> float:
        """Shortest period of any motion or drive."""
        return 2.0 * np.pi / max(self.fastest, 1e-300)

    @property
    def held(self) -> list[tuple[int, ...]]:
        """The contacts that are held in every segment."""
        return [tuple(np.flatnonzero(sides).tolist()) for sides in self.sides]

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """q, q' (k, n) and reactions (k, m), of held contacts only, at times in any order."""
        t = np.asarray(t, float)
        return *self.states(t), self.reactions(t, self.piece_at(t))

    def reactions(self, t: Array, piece: NDArray[np.int64]) -> Array:
        """Reactions (k, m) at times in the given segments, 0 where a contact is not held."""
        R = np.zeros((len(t), self.sides.shape[1]))
        holding = np.flatnonzero(np.any(self.sides[piece] != 0, axis=1))
        for flow, points, which, tau, C in self.expanded(piece[holding], t[holding]):
            R[holding[points][:, None], flow.held] = horner(C @ flow.reactions.T, which, tau)
        return R

    def presses(
        self, contact: int, since: float, t_end: float
    ) -> tuple[list[tuple[float, float, float]], list[tuple[float, float]]]:
        """Segments (from, to, impulse) in which a contact is held after ``since``, and its impulses (time, impulse) by
        impacts, its own and those of others."""
        blows = [(e.time, e.impulse) for e in self.events if e.contact == contact]
        blows += [(time, impulse) for time, c, impulse in self.struck if c == contact]
        return held_spans(self, t_end, since)[contact], blows

    def settled(self, system: System, t: Array, channel: int, u: Array, v: Array) -> tuple[Array, Array]:
        """Position and velocity of a channel; of a held contact those of its stop."""
        if channel >= len(system.contacts):
            return u, v
        stops, side = system.contacts[channel].stops, self.sides[self.piece_at(t), channel]
        u = np.where(side > 0, stops.upper_bound, np.where(side < 0, stops.lower_bound, u))
        return u, np.where(side != 0, 0.0, v)

    def force(self, contact: Contact, i: int, t: Array, piece: NDArray[np.int64]) -> Array:
        """Reaction of stop i at times in the given segments."""
        return self.reactions(t, piece)[:, i]

    @cached_property
    def flows(self) -> tuple[list[RegimeFlow], IntArray, Array]:
        """Flows of the segments that are Taylor series, which of them every segment has, and Z (segments, N) at the
        starts."""
        basis, flows, number = self.generators.basis, dict[int, RegimeFlow](), []
        # Row k is (q, q', g) at the start of segment k.
        Z = np.empty((len(self.times), self.generators.N))
        Z[:, : 2 * self.generators.n] = np.hstack([z[:, : self.generators.n] for z in (self.x, self.y)])
        # Segments with equal contacts and equal intervals between samples share a flow, and are expanded together.
        places: dict[int, int] = {}
        for k, (t, sides) in enumerate(zip(self.times.tolist(), self.sides.tolist(), strict=True)):
            interval = basis.interval(t)
            flow = self.generators.regime(tuple(map(abs, sides)), True, interval)
            flows[id(flow)], Z[k, 2 * self.generators.n :] = flow, basis.values(t, interval)
            number.append(places.setdefault(id(flow), len(places)))
        return list(flows.values()), np.array(number), Z

    def expanded(
        self, piece: NDArray[np.int64], t: Array
    ) -> Iterator[tuple[RegimeFlow, IntArray, IntArray, Array, Array]]:
        """Taylor series of the segments that times (k,) lie in: a flow, its points among the times, the series that
        each of them needs, the time since its start, and coefficients (ORDER + 1, series, N)."""
        flows, number, Z = self.flows
        # At most a million coefficients at a time, to bound the memory.
        most = max(1, 1_000_000 // ((ORDER + 1) * self.generators.N))
        # In order of flows, then of segments: each series is computed once for all of its times.
        order = np.lexsort((piece, number[piece]))
        new = np.diff(piece[order], prepend=-1) != 0
        series = np.cumsum(new) - 1  # in order of flows and segments
        segments = piece[order][new]
        cuts = np.flatnonzero(np.diff(number[segments], prepend=-1) != 0).tolist()
        for begin, end in pairwise([*cuts, len(segments)]):
            flow = flows[number[segments[begin]]]
            for first in range(begin, end, most):
                last = min(first + most, end)
                a, b = np.searchsorted(series, [first, last])
                points, at = order[a:b], segments[first:last]
                yield flow, points, series[a:b] - first, t[points] - self.times[piece[points]], flow.series(Z[at])

    def _alone(self, piece: NDArray[np.int64], t: Array, row: Array, u: Array, v: Array) -> None:
        super()._alone(piece, t, row, u, v)
        n, local = self.generators.n, self.regimes.number[(LOCAL,) * self.sides.shape[1]]
        # The closed form is for flights; segments that are series are overwritten.
        here, Z = np.flatnonzero(self.regime[piece] == local), self.flows[2]
        # At its start a segment has its stored state, without a series.
        still = t[here] == self.times[piece[here]]
        start, here = here[still], here[~still]
        u[start], v[start] = Z[piece[start], :n] @ row.T, Z[piece[start], n : 2 * n] @ row.T
        for _, points, which, tau, C in self.expanded(piece[here], t[here]):
            both = np.stack([C[..., :n] @ row.T, C[..., n : 2 * n] @ row.T], axis=2)
            u[here[points]], v[here[points]] = np.moveaxis(horner(both, which, tau), 1, 0)


def impacts_of(solution: RigidMotion, i: int, since: float = 0.0) -> Impacts:
    """Impacts of contact i from ``since`` on, with the impulses of the blows alone."""
    events = [(x.time, x.side, x.end, x.impulse) for x in solution.events if x.contact == i and x.time >= since]
    times, sides, ends, impulses = np.array(events).reshape(-1, 4).T
    return Impacts.at(times, sides, "event", ends=ends, impulses=impulses)


def horner(C: Array, which: IntArray, tau: Array) -> Array:
    """The series ``which`` (k,) among C (terms, series, ...) at tau (k,)."""
    tau = tau.reshape(-1, *[1] * (C.ndim - 2))
    # Few numbers: all terms at once, without a loop in Python.
    if len(which) * C[0, 0].size < FEW:
        return np.sum(C[:, which] * tau ** np.arange(len(C)).reshape(-1, *[1] * tau.ndim), axis=0)
    total = C[-1][which]
    for c in C[-2::-1]:
        total = c[which] + tau * total
    return total


def value(series: Array, s: float) -> Array:
    """sum_k c_k s^k."""
    return np.tensordot(s ** np.arange(len(series)), series, 1)


def _at(c: list[float], s: float) -> tuple[float, float]:
    """The series and its derivative at s: of numbers faster in Python than in NumPy."""
    total, slope = c[-1], 0.0
    for x in c[-2::-1]:
        total, slope = x + s * total, total + s * slope
    return total, slope


def _near(c: Array) -> float | None:
    """The first zero if the series is quadratic up to there. A body that leaves at the speed of rounding returns at
    once, and such a root is lost among the others."""
    under = c[1] ** 2 - 4.0 * c[0] * c[2]
    if under < 0.0 or not (c[1] < 0.0 or c[2] < 0.0):
        return None
    # The form of the root without cancellation, by the sign of the rate.
    s = 2.0 * c[0] / (math.sqrt(under) - c[1]) if c[1] < 0.0 else (c[1] + math.sqrt(under)) / (-2.0 * c[2])
    # The cubic and later terms must be below a thousandth of the constant one.
    return s if s < SMALL and s**3 * np.sum(np.abs(c[3:])) < 1e-3 * c[0] else None


def _real_roots(c: Array) -> Array:
    """Real roots of a series in (0, 1], in order."""
    # np.roots divides by the last coefficient, which must not be rounding.
    last = np.flatnonzero(np.abs(c) > 1e-18 * np.max(np.abs(c)))[-1]
    roots = np.roots(c[last::-1])
    return np.sort(roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real <= 1.0 + 1e-12)])


def first_zero(gap: Array, length: float, zeros: int) -> float | None:
    """First time at which a series turns negative that is positive right after a zero of multiplicity ``zeros`` at 0.

    None if not in (0, length]; 0.0 where it is negative from the start. One that is zero throughout never does.
    """
    # Without the exact zeros at 0.
    c = gap[zeros:]
    if not np.any(c):
        return None
    # Leading coefficients that vanish raise the order of the zero; the first other one decides the sign.
    c = c[np.argmax(c != 0.0) :]
    if c[0] <= 0.0:
        return 0.0
    scaled = c * length ** np.arange(len(c))
    # All falling terms together do not reach zero: no roots to compute.
    if scaled[0] > -np.sum(np.minimum(scaled[1:], 0.0)):
        return None
    near = _near(scaled)
    terms = c.tolist()
    for root in _real_roots(scaled) if near is None else [near]:
        # Newton's method improves each root; the first at which the series does not rise counts.
        s = float(min(root, 1.0)) * length
        for _ in range(3):
            height, slope = _at(terms, s)
            if slope < 0.0:
                s = min(max(s - height / slope, 0.0), length)
        if _at(terms, s)[1] <= 0.0:
            return s
    return None


def stays(acceleration: Array) -> bool:
    """Return True where a gap at rest, of which nothing presses now, does not open, by the series of its acceleration:
    a load on it rises from zero, or none ever comes."""
    later = acceleration[acceleration != 0.0]
    return acceleration[0] == 0.0 and not (len(later) and later[0] > 0.0)


def held_spans(solution: RigidMotion, t_end: float, since: float = 0.0) -> list[list[tuple[float, float, float]]]:
    """For every contact the segments (from, to, impulse of the reaction) in which it is held after ``since``."""
    spans: list[list[tuple[float, float, float]]] = [[] for _ in range(solution.sides.shape[1])]
    ends = np.append(solution.times[1:], t_end)
    held = np.flatnonzero(np.any(solution.sides != 0, axis=1) & (ends > since))
    starts = np.maximum(solution.times, since)
    impulses: dict[int, Array] = {}
    for flow, points, which, tau, C in solution.expanded(held, starts[held]):
        # Impulse of the reaction: its series, integrated term by term.
        R = C @ flow.reactions.T
        R = np.concatenate([np.zeros((1, *R.shape[1:])), R / np.arange(1.0, len(R) + 1.0)[:, None, None]])
        until = ends[held[points]] - solution.times[held[points]]
        total = np.abs(horner(R, which, until) - horner(R, which, tau))
        impulses |= dict(zip(held[points].tolist(), total, strict=True))
    for k in held.tolist():
        for i, impulse in zip(np.flatnonzero(solution.sides[k]).tolist(), impulses[k].tolist(), strict=True):
            spans[i].append((float(starts[k]), float(ends[k]), impulse))
    return spans
