"""Derivatives along a motion, through its segments and events.

    within a segment     the equations of variation, by Taylor steps                              (variation.py)
    at an event h = 0    dt = -dh/h',  dz+ = J (dz- + z'- dt) - z'+ dt

J is the derivative of what happens there. On a compliant stop nothing does, and z' is continuous: dz+ = dz-. At the
entry into a damped one the force jumps by c u', see exact.c. On a rigid one with restitution the impulses P solve

    M (q'+ - q'-) = H^T P,   H q'+ + o' = -e (H q'- + o')

with the rows H of the contacts that take part, and so do their derivatives, its right side differentiated.
Source: di Bernardo et al., Piecewise-smooth Dynamical Systems (2008), section 2.5; Mueller, Chaos, Solitons & Fractals
5 (1995) 1671-1681.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array, IntArray
from ...basics.resources import afford
from ...model.system import System
from .motion import Motion
from .variation import RADIANS, TERMS, Regime, Series, Variation

GRAZE = 64.0 * float(np.finfo(float).eps)  # of h, by which a graze is told from an event, see ``grazes``
CHUNK = 1_000_000  # numbers of a series at once


@dataclass(frozen=True, eq=False)
class Path:
    """Segments of a motion: they start at times (k,) with the contacts on ``sides`` (k, m).

    piece: (k,) the segments of the solution, which records divide. hits: for segments that start with impacts on rigid
    stops the contacts that are hit.
    """

    solution: Motion
    times: Array
    sides: IntArray
    t_end: float
    piece: IntArray
    hits: Mapping[int, Sequence[int]] = field(default_factory=dict)

    @property
    def ends(self) -> Array:
        """Times (k,) at which the segments end."""
        return np.append(self.times[1:], self.t_end)

    @property
    def changed(self) -> NDArray[np.bool_]:
        """True for the contacts that open, close or are hit where each segment but the first begins, (k - 1, m)."""
        changed = self.sides[1:] != self.sides[:-1]
        # Impacts that hold nothing change no side.
        for segment, contacts in self.hits.items():
            for contact in contacts:
                changed[segment - 1, contact] |= segment > 0 and self.sides[segment - 1][contact] == 0
        return changed


def path_of_solution(system: System, solution: Motion, t_end: float) -> Path:
    """Segments of an exact solution, compliant or rigid, which also begin at the samples of records."""
    count = max(1, int(np.searchsorted(solution.times, t_end, side="left")))
    times, segments = solution.times[:count], np.arange(count)
    edges = np.setdiff1d(solution.drive.edges, times)
    edges = edges[(edges > 0.0) & (edges < t_end)]
    place = np.searchsorted(times, edges, "right")
    times, segments = np.insert(times, place, edges), np.insert(segments, place, place - 1)
    sides = solution.sides[segments]
    hits: dict[int, list[int]] = {}
    # A contact may take two blows at one time, for example where it is then held: it is hit once.
    first = {int(mark): k for k, mark in reversed(list(enumerate(solution.first_mark[segments].tolist())))}
    for mark, contact in dict.fromkeys(zip(solution.blows.mark.tolist(), solution.blows.contact.tolist(), strict=True)):
        if mark in first:
            hits.setdefault(first[mark], []).append(contact)
    return Path(solution, times, np.abs(sides) if system.rigid else sides, t_end, segments, hits)


class Tangent:
    """Derivatives along a path in the parameters of ``variation``, or in ``directions`` (2n, D) of its start."""

    def __init__(self, variation: Variation, path: Path, directions: Array | None = None, graze: float = GRAZE) -> None:
        self.variation, self.path, self.graze, n = variation, path, graze, variation.n
        self.rigid, self.lengths = variation.system.rigid, path.ends - path.times
        self.regimes = [variation.regime(sides) for sides in path.sides.tolist()]
        # Samples between which the functions of time have one series.
        edges = variation.edges
        self.since = edges[np.maximum(np.searchsorted(edges, path.times, "right") - 1, 0)] if len(edges) else path.times
        segments = np.arange(len(path.times))
        self.z = self.states(path.times, segments)
        self.z_end = self.states(path.ends, segments)
        self.grazes: list[float] = []  # times of impacts without derivative, on rigid or damped stops
        self.ties: list[float] = []  # rigid: times at which several free contacts are hit
        start = np.zeros((variation.P, 2 * n))
        for p, column in enumerate(variation.columns):
            start[p, :n], start[p, n:] = column.q0, column.v0
        if directions is not None:
            start = self.into(directions)
        self.count = len(start)
        # Steps of the Taylor series; without parameters a segment is one step.
        self.steps = self.cut() if variation.P else (segments, path.times, self.lengths, self.z)
        _, t, h, _ = self.steps
        afford("t_end", path.t_end, "shorten t_end", floats=4.0 * len(t) * (1 + self.count) * n)
        driven = np.zeros((len(t), self.count, 2 * n))
        if variation.P:
            driven = self._later(driven, np.arange(len(t)), h)[:, 1:]
        self.dz, self.end = self._follow(start, driven)  # at the starts of steps, and at the end

    def into(self, directions: Array) -> Array:
        """Derivatives (D, 2n) in modes of directions (2n, D) of q, q'."""
        n, into = self.variation.n, self.variation.into
        return np.hstack([directions[:n].T @ into, directions[n:].T @ into])

    def _follow(self, dz: Array, driven: Array) -> tuple[Array, Array]:
        """Derivatives at the starts of all steps and at the end of the path."""
        (owner, _, h, _), n = self.steps, self.variation.n
        starts = np.zeros((len(owner), *dz.shape))
        first = np.searchsorted(owner, np.arange(len(self.regimes) + 1))
        for i, regime in enumerate(self.regimes if len(dz) else ()):
            if i:
                dz = self.across(i, dz)
            tau, steps = float(h[first[i]]), range(first[i], first[i + 1])
            flow = regime.flow(tau, np.eye(2 * n)) if len(steps) > 1 else None
            for k in steps:
                starts[k] = dz
                dz = (regime.flow(tau, dz) if flow is None else dz @ flow) + driven[k]
        return starts, dz

    def states(self, t: Array, segment: IntArray) -> Array:
        """Motion (k, 2n) in modes at times t (k,), as the given segments have it."""
        q, v = self.path.solution.states(t, self.path.piece[segment])
        return np.hstack([q @ self.variation.into, v @ self.variation.into])

    def cut(self) -> tuple[IntArray, Array, Array, Array]:
        """Steps of RADIANS at most: the segment, time, length and state of each."""
        count = np.maximum(1, np.ceil(self.lengths * np.array([x.fastest for x in self.regimes]) / RADIANS))
        floats = 4.0 * float(np.sum(count)) * self.variation.n
        afford("t_end", self.path.t_end, "shorten t_end", floats=floats)
        count = count.astype(int)
        h, owner = np.repeat(self.lengths / count, count), np.repeat(np.arange(len(count)), count)
        t = self.path.times[owner] + h * (np.arange(len(h)) - np.repeat(np.cumsum(count) - count, count))
        return owner, t, h, self.states(t, owner)

    def at(self, t: Array, segment: IntArray) -> Array:
        """Motion and derivatives (k, 1 + D, 2n) at increasing times t (k,) in the given segments."""
        owner, at = self.steps[:2]
        # The last step that begins before each time, in its segment.
        first, last = np.searchsorted(owner, segment), np.searchsorted(owner, segment, "right") - 1
        step = np.clip(np.searchsorted(at, t, "right") - 1, first, last)
        return self._later(self.dz, step, t - at[step])

    def _later(self, dz: Array, step: IntArray, late: Array) -> Array:
        """Motion and derivatives (k, 1 + D, 2n) at ``late`` (k,) behind the starts of rising steps, from dz there."""
        used = np.unique(step)
        owner, t, _, z = (x[used] for x in self.steps)
        whole = np.concatenate([z[:, None], dz[used]], axis=1)
        found = np.empty((len(late), *whole.shape[1:]))
        for regime, part in self.parts(owner, (TERMS + 1) * whole.shape[1] * self.variation.n):
            here = np.flatnonzero(np.isin(step, used[part]))
            of = np.searchsorted(used[part], step[here])
            found[here] = regime.later(t[part], self.since[owner[part]], whole[part], of, late[here])
        return found

    def parts(self, owner: IntArray, size: int) -> Iterator[tuple[Regime, IntArray]]:
        """Parts of the segments ``owner`` (k,) of one regime each, with ``size`` numbers for each, CHUNK at once."""
        regimes = np.array([id(x) for x in self.regimes])[owner]
        for one in dict.fromkeys(regimes.tolist()):
            here = np.flatnonzero(regimes == one)
            for part in np.array_split(here, min(len(here), 1 + size * len(here) // CHUNK)):
                yield self.regimes[owner[part[0]]], part

    def segment_at(self, t: Array) -> IntArray:
        """The segment that each time lies in; an event belongs to the segment it begins."""
        return np.maximum(np.searchsorted(self.path.times, t, side="right") - 1, 0)

    def _at_end(self, i: int, dz: Array) -> Series:
        """Series at the end of segment i."""
        return self._series(self.regimes[i], i, float(self.path.ends[i]), self.z_end[i], dz)

    def at_start(self, i: int) -> Series:
        """Series at the start of segment i, behind the event there."""
        first = int(np.searchsorted(self.steps[0], i))
        return self._series(self.regimes[i], i, float(self.path.times[i]), self.z[i], self.dz[first])

    def _series(self, regime: Regime, i: int, t: float, z: Array, dz: Array) -> Series:
        return regime.series(np.array([t]), self.since[i : i + 1], np.concatenate([z[None], dz])[None], 4)

    def gap(self, series: Series, contact: int, side: int) -> Array:
        """Coefficients (K + 1, S, 1 + D) of u - g of a contact."""
        gap = series.u[..., contact].copy()
        gap[0] = self.variation.gap(series.u[0][..., [contact]], [contact], [side])[..., 0]
        return gap

    def size(self, series: Series, contact: int, side: int) -> Array:
        """Sizes (S,) of the terms of a gap."""
        row, eta = self.variation.free.rows[contact], series.eta[0][:, 0]
        stop = getattr(self.variation.data, "upper" if side > 0 else "lower")[contact]
        return np.abs(eta) @ np.abs(row) + np.abs(series.u[0][:, 0, contact] - eta @ row) + abs(stop)

    def across(self, i: int, dz: Array) -> Array:
        """dz (D, 2n) after the event at which segment i begins, from that before it."""
        variation, n = self.variation, self.variation.n
        if self.rigid:
            return self._struck(i, dz) if i in self.path.hits else dz
        before, after = self.path.sides[i - 1], self.path.sides[i]
        for contact in np.flatnonzero((before == 0) & (after != 0) & (variation.data.c > 0.0)).tolist():
            # A neighbour enters later by -dh/h', without the force c h' until then.
            side = int(np.sign(after[contact]))
            series = self._at_end(i - 1, dz)
            h = self.gap(series, contact, side)[:, 0]
            if grazes(h[:, 0], float(self.size(series, contact, side)[0]), self.graze):
                self.grazes.append(float(self.path.times[i]))
            dz = dz.copy()
            dz[:, n:] -= variation.data.c[contact] * np.outer(h[0, 1:], variation.free.rows[contact])
        return dz

    def _struck(self, i: int, dz: Array) -> Array:
        """dz (D, 2n) behind the impact on a rigid stop at which segment i begins, from that before it."""
        variation, n, t = self.variation, self.variation.n, float(self.path.times[i])
        before, after, hits = self.path.sides[i - 1], self.path.sides[i], list(self.path.hits[i])
        now, z, end = self._at_end(i - 1, dz), self.z_end[i - 1], self.z[i]
        # The fastest of the free contacts is hit; if all were held, the fastest of these.
        free = [c for c in hits if not before[c]]
        if len(free) > 1:
            self.ties.append(t)
        hit = max(free or hits, key=lambda c: abs(now.u[1, 0, 0, c]))
        # Held contacts take part in the blow: those in ``hits`` and those that stay held.
        taking = [hit, *(c for c in hits if c != hit)]
        taking += [c for c in np.flatnonzero(before & after).tolist() if c not in hits]
        held, slopes, P = after[taking] != 0, variation.slopes, variation.P if len(dz) else 0
        arriving, rates = now.u[1, 0, 0, taking], now.u[1, 0, 1:, taking].T
        side = int(np.sign(arriving[0])) or 1
        h = self.gap(now, hit, side)[:, 0]
        if grazes(h[:, 0], float(self.size(now, hit, side)[0]), self.graze):
            self.grazes.append(t)
        # The time of the impact, and the derivatives of the motion there. Without speed it is the graze noted above.
        late = -h[0, 1:] / arriving[0] if arriving[0] else np.zeros(len(dz))
        moved = dz + np.outer(late, np.concatenate([z[n:], 2.0 * now.eta[2, 0, 0]]))
        rates = rates + np.outer(late, 2.0 * now.u[2, 0, 0, taking])
        # The impulses, by (1 + e) times the speeds, and the same equation differentiated.
        H, e = variation.free.rows[taking], np.where(held, 0.0, variation.data.restitution[taking])
        inverse = np.linalg.inv(H @ H.T)
        impulse = -inverse @ ((1.0 + e) * arriving)
        kick = impulse @ H
        kicks = np.zeros((len(dz), n))
        right = -(1.0 + e) * rates
        if P:
            rows = slopes["rows"][:, taking]
            kicks[:P] = impulse @ rows - kick @ slopes["mass"]
            right[:P] -= np.where(held, 0.0, slopes["restitution"][:, taking]) * arriving + rows @ kick
        kicks += (right - kicks @ H.T) @ inverse @ H
        # Derivatives behind the blow, brought back to a fixed time.
        then = self._series(self.regimes[i], i - 1, t, end, np.zeros((0, 2 * n)))
        out = moved - np.outer(late, np.concatenate([end[n:], 2.0 * then.eta[2, 0, 0]]))
        out[:, n:] += kicks
        return out

    @property
    def monodromy(self) -> Array:
        """Derivative of q, q' at the end of the path in the directions of its start, (2n, D)."""
        X, n = self.variation.X, self.variation.n
        return np.vstack([X @ self.end[:, :n].T, X @ self.end[:, n:].T])


def grazes(h: Array, size: float, depth: float = GRAZE) -> bool:
    """Return True if a zero of h, of coefficients (k,), is a graze to rounding: h'^2 <= 2 |h''| depth size.

    The parabola with h' and h'' turns within ``depth`` of the terms of h, of this size.
    """
    return float(h[1]) ** 2 <= 4.0 * abs(float(h[2])) * depth * size
