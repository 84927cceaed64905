"""Derivatives along a motion, through its segments and events.

    within a segment     dy' = A dy + dA y, by Taylor steps                                         (variation.py)
    at an event h = 0    dt = -dh/h',  dz+ = J (dz- + z'- dt) - z'+ dt

J is the derivative of what happens there. On a compliant stop nothing does, and z' is continuous: dz+ = dz-. At the
entry into a damped one the force jumps by c u', see exact.c. On a rigid one with restitution the impulses P solve

    M (q'+ - q'-) = H^T P,   H q'+ + o' = -e (H q'- + o')

with the rows H of the contacts that take part, and so do their derivatives, its right side differentiated.
Source: di Bernardo et al., Piecewise-smooth Dynamical Systems (2008), section 2.5; Mueller, Chaos, Solitons & Fractals
5 (1995) 1671-1681.
"""

from __future__ import annotations

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.resources import afford
from .motion import Motion
from .variation import RADIANS, STEP, Variation

GRAZE = 64.0 * float(np.finfo(float).eps)  # of h, by which a graze is told from an event
CHUNK = 1_000_000  # numbers of a series at once


class Tangent:
    """Derivatives along a motion in the parameters of ``variation``, or in ``directions`` (2n, D) of its start.

    Segments also begin at the samples of records: at times (k,), with the contacts on ``sides`` (k, m), in segment
    ``piece`` (k,) of the motion. hits: contacts that are hit where a segment begins. grazes: times of impacts without
    derivative, on rigid or damped stops. ties: times at which several free rigid contacts are hit.
    """

    def __init__(
        self, variation: Variation, motion: Motion, t_end: float, directions: Array | None = None, graze: float = GRAZE
    ) -> None:
        self.variation, self.motion, self.t_end, self.graze, n = variation, motion, t_end, graze, variation.n
        self.rigid, self.grazes, self.ties = variation.system.rigid, list[float](), list[float]()
        count = max(1, int(np.searchsorted(motion.times, t_end, side="left")))
        edges = np.setdiff1d(variation.edges, motion.times)
        edges = edges[(edges > 0.0) & (edges < t_end)]
        place = np.searchsorted(motion.times[:count], edges, "right")
        self.times = np.insert(motion.times[:count], place, edges)
        self.piece = np.insert(np.arange(count), place, place - 1)
        self.sides = np.abs(motion.sides[self.piece]) if self.rigid else motion.sides[self.piece]
        ends = np.append(self.times[1:], t_end)
        self.hits: dict[int, list[int]] = {}
        # A contact may take two blows at one time, for example where it is then held: it is hit once.
        first = {int(mark): k for k, mark in reversed(list(enumerate(motion.first_mark[self.piece].tolist())))}
        for mark, contact in dict.fromkeys(zip(motion.blows.mark.tolist(), motion.blows.contact.tolist(), strict=True)):
            if mark in first:
                self.hits.setdefault(first[mark], []).append(contact)
        # The regimes, and the samples between which the functions of time have one series.
        self.regimes = [variation.regime(sides) for sides in self.sides.tolist()]
        samples = np.append(self.times[0], variation.edges)
        self.since = samples[np.searchsorted(variation.edges, self.times, "right")]
        segments = np.arange(len(self.times))
        self.z, self.z_end = self.states(self.times, segments), self.states(ends, segments)
        start = np.array([np.append(x.q0, x.v0) for x in variation.columns]).reshape(-1, 2 * n)
        if directions is not None:
            start = np.hstack([directions[:n].T @ variation.into, directions[n:].T @ variation.into])
        # Steps of the Taylor series; without parameters a segment is one step.
        self.lengths = ends - self.times
        self.steps = self.cut() if variation.P else (segments, self.times, self.lengths, self.z)
        _, t, h, _ = self.steps
        afford("t_end", t_end, "shorten t_end", floats=4.0 * len(t) * (1 + len(start)) * n)
        driven = np.zeros((len(t), len(start), 2 * n))
        if variation.P:
            driven = self._later(driven, np.arange(len(t)), h)[:, 1:, : 2 * n]
        self.dz, self.end = self._follow(start, driven)  # at the starts of steps, and at the end

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
        q, v = self.motion.states(t, self.piece[segment])
        return np.hstack([q @ self.variation.into, v @ self.variation.into])

    def cut(self) -> tuple[IntArray, Array, Array, Array]:
        """Steps of RADIANS at most: the segment, time, length and state of each."""
        count = np.maximum(1, np.ceil(self.lengths * np.array([x.fastest for x in self.regimes]) / RADIANS))
        floats = 4.0 * float(np.sum(count)) * self.variation.n
        afford("t_end", self.t_end, "shorten t_end", floats=floats)
        count = count.astype(int)
        h, owner = np.repeat(self.lengths / count, count), np.repeat(np.arange(len(count)), count)
        t = self.times[owner] + h * (np.arange(len(h)) - np.repeat(np.cumsum(count) - count, count))
        return owner, t, h, self.states(t, owner)

    def at(self, t: Array, segment: IntArray) -> Array:
        """Motion and derivatives y (k, 1 + D, N) at increasing times t (k,) in the given segments."""
        owner, at = self.steps[:2]
        # The last step that begins before each time, in its segment.
        first, last = np.searchsorted(owner, segment), np.searchsorted(owner, segment, "right") - 1
        step = np.clip(np.searchsorted(at, t, "right") - 1, first, last)
        return self._later(self.dz, step, t - at[step])

    def _later(self, dz: Array, step: IntArray, late: Array) -> Array:
        """y (k, 1 + D, N) at ``late`` (k,) behind the starts of steps (k,), from dz there."""
        owner, t, _, z = (x[step] for x in self.steps)
        regimes = np.array([id(x) for x in self.regimes])[owner]
        found = np.empty((len(late), 1 + dz.shape[1], len(self.variation.base.seen)))
        for one in dict.fromkeys(regimes.tolist()):
            here = np.flatnonzero(regimes == one)
            for part in np.array_split(here, 1 + len(here) * found[0].size // CHUNK):
                of = owner[part]
                y = self.variation.whole(t[part], self.since[of], np.concatenate([z[part, None], dz[step[part]]], 1))
                found[part] = self.regimes[of[0]].later(y, late[part])
        return found

    def segment_at(self, t: Array) -> IntArray:
        """The segment that each time lies in; an event belongs to the segment it begins."""
        return np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)

    def whole(self, i: int, t: float, z: Array, dz: Array) -> Array:
        """y (1 + D, N) at a time of segment i from z (2n,) and dz (D, 2n)."""
        return self.variation.whole(np.array([t]), self.since[i : i + 1], np.vstack([z, dz])[None])[0]

    def gap(self, y: Array, contact: int, side: int) -> tuple[Array, Array, float]:
        """u - g and u' of a contact in y (1 + D, N), their derivatives (2, D), and the size of the terms of u - g."""
        numbers, data = self.variation.base, self.variation.data
        forms = [np.array([x.gap(contact, side), x.rate[contact]]) for x in (numbers, *self.variation.beside)]
        slopes = forms[0] @ y[1:].T
        for p, form in enumerate(forms[1 : len(y)]):
            slopes[:, p] += np.imag(form) @ y[0] / STEP
        stop = (data.upper if side > 0 else data.lower)[contact]
        return forms[0] @ y[0], slopes, float(np.abs(numbers.position[contact]) @ np.abs(y[0]) + abs(stop))

    def across(self, i: int, dz: Array) -> Array:
        """dz (D, 2n) after the event at which segment i begins, from that before it."""
        t, before, after = float(self.times[i]), self.sides[i - 1], self.sides[i]
        data, n = self.variation.data, self.variation.n
        if self.rigid:
            return self._struck(i, dz) if i in self.hits else dz
        for contact in np.flatnonzero((before == 0) & (after != 0) & (data.c > 0.0)).tolist():
            # A neighbour enters later by -dh/h', without the force c h' until then.
            y = self.whole(i - 1, t, self.z_end[i - 1], dz)
            late = self._reached(i, y, contact, int(np.sign(after[contact])))[1][0]
            dz = dz.copy()
            dz[:, n:] -= data.c[contact] * np.outer(late, data.rows[contact])
        return dz

    def _reached(self, i: int, y: Array, contact: int, side: int) -> tuple[Array, Array]:
        """Gap and rate of the contact that meets its stop in y (1 + D, N), with their derivatives; notes a graze."""
        h, slopes, size = self.gap(y, contact, side)
        curve = float(self.variation.base.rate[contact] @ (self.regimes[i - 1].A @ y[0]))
        # The parabola with h' and h'' turns within ``graze`` of the terms of h, of this size.
        if h[1] ** 2 <= 2.0 * abs(curve) * self.graze * size:
            self.grazes.append(float(self.times[i]))
        return h, slopes

    def _struck(self, i: int, dz: Array) -> Array:
        """dz (D, 2n) behind the impact on a rigid stop at which segment i begins, from that before it."""
        variation, n, t = self.variation, self.variation.n, float(self.times[i])
        before, after, hits = self.sides[i - 1], self.sides[i], list(self.hits[i])
        y = self.whole(i - 1, t, self.z_end[i - 1], dz)
        arriving = variation.base.rate @ y[0]
        # The fastest of the free contacts is hit; if all were held, the fastest of these.
        free = [c for c in hits if not before[c]]
        if len(free) > 1:
            self.ties.append(t)
        hit = max(free or hits, key=lambda c: abs(arriving[c]))
        # Held contacts take part in the blow: those in ``hits`` and those that stay held.
        taking = [hit, *(c for c in hits if c != hit)]
        taking += [c for c in np.flatnonzero(before & after).tolist() if c not in hits]
        (_, speed), (slope, _) = self._reached(i, y, hit, int(np.sign(arriving[hit])) or 1)
        # The time of the impact, and the derivatives of the motion there. Without speed it is the graze noted above.
        late = -slope / speed if speed else np.zeros(len(dz))
        y[1:] += np.outer(late, self.regimes[i - 1].A @ y[0])
        # The same blow for all directions, or by the numbers of the neighbour of each parameter.
        beside = [([p], x) for p, x in enumerate(variation.beside[: len(dz)])] or [(slice(None), variation.base)]
        out = y[1:, : 2 * n].copy()
        for these, numbers in beside:
            e = np.where(after[taking] != 0, 0.0, numbers.data.restitution[taking])
            out[these, n:] += np.imag(numbers.kick(y[0] + 1j * STEP * y[1:][these], taking, e)) / STEP
        # Derivatives behind the blow, brought back to a fixed time.
        then = self.whole(i - 1, t, self.z[i], dz[:0])[0]
        return out - np.outer(late, (self.regimes[i].A @ then)[: 2 * n])

    @property
    def monodromy(self) -> Array:
        """Derivative of q, q' at the end of the path in the directions of its start, (2n, D)."""
        X, n = self.variation.X, self.variation.n
        return np.vstack([X @ self.end[:, :n].T, X @ self.end[:, n:].T])
