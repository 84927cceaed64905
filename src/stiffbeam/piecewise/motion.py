"""A motion as segments between events, and its evaluation at any time: states, positions, work, tangent vectors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, IntArray
from ..basics.compiled import compiled, inner
from ..model.contact import Contact
from ..model.system import System
from ..model.time_functions import Drive, evaluate
from .follow import LET_GO, Table, drive, enter, leave, see, see_close, turn
from .linear import Complex, spin_of
from .measures import NODES, WEIGHTS, integrated, pressed_by, work_of_damping
from .regimes import Pairs, Regimes
from .search import EPS
from .terms import (
    CONSTANT,
    END,
    LEVEL,
    OMEGA,
    RATE,
    SQUARE,
    S,
    U,
    V,
    carry,
    curvature,
    layout,
    oscillation,
    oscillations,
    pair,
)

RUN = 16  # times that are answered from one of them


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """Segments: at times[i] the contacts are on the sides[i] (m,), see follow.py, in the regime[i], with the pairs
    x[i], y[i] (K,)."""

    regimes: Regimes
    times: Array
    sides: NDArray[np.int64]
    regime: NDArray[np.int64]
    x: Array
    y: Array
    evaluations: int

    @classmethod
    def joined(cls, parts: Sequence[Motion]) -> Motion:
        """One motion from consecutive motions of the same tracer."""
        whole = {name: np.concatenate([getattr(p, name) for p in parts]) for name in ("times", "sides", "regime")}
        # A later part may have more pairs: its table has grown.
        K = max(part.x.shape[1] for part in parts)
        for name in ("x", "y"):
            pairs = ((getattr(part, name), K - part.x.shape[1]) for part in parts)
            whole[name] = np.concatenate([np.pad(x, [(0, 0), (0, more)]) if more else x for x, more in pairs])
        return replace(parts[-1], **whole, evaluations=sum(part.evaluations for part in parts))

    @property
    def drive(self) -> Drive:
        """The drive of the system."""
        return self.regimes.source.drive

    def first(self, count: int) -> Motion:
        """The first ``count`` segments."""
        part = (z[:count] for z in (self.times, self.sides, self.regime, self.x, self.y))
        times, sides, regime, x, y = part
        return replace(self, times=times, sides=sides, regime=regime, x=x, y=y)

    def state_at_start(self, piece: int) -> tuple[Array, Array]:
        """q, q' (1, n) where a segment begins, from that segment."""
        return self.states_in(self.times[piece : piece + 1], np.array([piece]))

    def flow(self, piece: int, tau: float, dq: Array, dv: Array) -> tuple[Array, Array]:
        """The homogeneous flow of a segment's regime over tau: (n, k) -> (n, k)."""
        # Pairs are reached through the amplitudes of the free modes, as in the table.
        free = self.regimes.free
        assert free is not None
        x, y = self._made[self.regime[piece]].flow(tau, free.to_modal(dq.T).T, free.to_modal(dv.T).T)
        return free.to_nodal(x.T).T, free.to_nodal(y.T).T

    @property
    def _made(self) -> list[Pairs]:
        return self.regimes.made

    @cached_property
    def _met(self) -> list[Pairs]:
        """The regimes of this motion."""
        return [self._made[r] for r in np.unique(self.regime)]

    @cached_property
    def shortest_period(self) -> float:
        """Shortest period of the oscillating pairs of all regimes and of the drive."""
        fastest = [float(np.max(oscillating(pairs), initial=0.0)) for pairs in self._met]
        return 2.0 * np.pi / max(*fastest, *self.drive.frequencies, 1e-300)

    @property
    def periods(self) -> Array:
        """The shortest of the oscillating pairs of every segment and of the drive, (segments,)."""
        fastest = np.array([np.max(oscillating(pairs), initial=0.0) for pairs in self._made])
        return 2.0 * np.pi / np.maximum(fastest[self.regime], max(*self.drive.frequencies, 0.0, 1e-300))

    @property
    def fastest_decay(self) -> float:
        """The largest decay rate of any pair in any regime, 1/time."""
        return max(float(-np.min(pairs.sigma, initial=0.0)) for pairs in self._met)

    def piece_at(self, t: Array) -> NDArray[np.int64]:
        """The segment that each time t (k,) lies in; an event belongs to the segment it begins."""
        return np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)

    def states(self, t: Array) -> tuple[Array, Array]:
        """q, q' (k, n) at any times."""
        return self.states_in(t, self.piece_at(t))

    def states_in(self, t: Array, piece: NDArray[np.int64]) -> tuple[Array, Array]:
        """q, q' (k, n) as the given segments have them at times t, which may be the ends of those."""
        t = np.array(t, float)
        q, v = np.zeros((2, len(t), self.regimes.source.system.size))
        if any(pairs.followed for pairs in self._met):
            states(self.regimes.table, self.times, self.regime, self.x, self.y, t, piece, q, v)
            q, v = self.regimes.nodal(q, v)
        # Segments that the compiled loop cannot follow.
        self._alone(piece, t, np.eye(q.shape[1]), q, v)
        return q, v

    def observed(self, t: Array, row: Array) -> tuple[Array, Array]:
        """row @ q and its rate at any times, (k,)."""
        t, table = np.array(t, float), self.regimes.table
        piece, (u, v) = self.piece_at(t), np.empty((2, len(t)))
        assert self.regimes.free is not None
        modal = self.regimes.free.force(row)
        # The row in terms of the pairs and the drive of every regime.
        rows, waves = table.outward[:, :2] @ modal, np.zeros((len(table.sizes), self.drive.size))
        for r, pairs in enumerate(self._made):
            waves[r] = pairs.steady @ modal
        observe(table, self.times, self.regime, self.x, self.y, rows, waves, t, piece, u, v)
        self._alone(piece, t, row, u, v)
        return u, v

    def _alone(self, piece: NDArray[np.int64], t: Array, row: Array, u: Array, v: Array) -> None:
        """row @ q and its rate at times of those of the given segments whose regimes are no pairs, into u and v."""
        if all(pairs.followed for pairs in self._made):
            return
        for r in np.unique(self.regime[piece]):
            pairs = self._made[r]
            regime, size = pairs.exponentials, len(pairs.sigma)
            if regime is None or pairs.followed:
                continue
            # What the row sees of the coefficients and of the drives: of z its real part, as real numbers.
            seen, seen_rate = (
                _parts(np.concatenate([(row @ x).T, (row @ y).T]))
                for x, y in ((regime.W, regime.response), (regime.W_rate, regime.response_rate))
            )
            here = np.flatnonzero(self.regime[piece] == r)
            # Parts of some 1e6 numbers each, so that the exponentials fit into memory.
            for part in np.array_split(here, max(1, len(here) * (size + 1 + self.drive.order) // 1_000_000)):
                if not len(part):
                    continue
                # Coefficients at the start of each segment, then at its times.
                at, start = np.unique(piece[part], return_inverse=True)
                begun = self.times[at]
                c = pairs.coefficients(self.x[at, :size], self.y[at, :size])
                force = regime.push @ self.drive.polynomials(begun)
                z = regime.ahead(c, spin_of(self.drive, begun), force, t[part] - begun[start], start)
                terms = np.concatenate([z, spin_of(self.drive, t[part])], axis=1).view(float)
                u[part], v[part] = terms @ seen, terms @ seen_rate

    def press(
        self, system: System, contact: int, starts: Array, ends: Array, sides: NDArray[np.int64]
    ) -> tuple[Array, Array]:
        """Peak |sigma| and the integral of |sigma| in the spans [starts, ends] (k,) of contact on ``sides``."""
        # The compiled ``press`` integrates terms without damping in closed form.
        if any(pairs.exponentials is not None for pairs in self._met):
            return pressed_by(system, self, contact, starts, ends, sides)
        deepest, depths = np.zeros((2, len(starts)))
        press(
            self.regimes.table, self.times, self.sides[:, contact].copy(), self.regime, self.x, self.y, contact,
            starts, ends, self.piece_at(starts), deepest, depths,
        )  # fmt: skip
        kappa = system.contacts[contact].stops.spring(1)[0]
        return kappa * deepest, kappa * depths

    def grow(self, system: System, edges: Array, dq: Array, dv: Array, enough: float) -> tuple[int, Array]:
        """ln of the growth of unit tangent vectors dq, dv (n, vectors) at the edges (k,), and how far that got: see
        ``grow``."""
        logs = np.zeros((len(edges), dq.shape[1]))
        # The tangent flow knows no records, but chains are no pairs: the compiled loop passes none of their segments.
        if any(pairs.exponentials is not None and pairs.exponentials.chains for pairs in self._met):
            return 0, logs
        free = self.regimes.free
        assert free is not None
        rows = np.array([free.force(c.row) for c in system.contacts]).reshape(-1, system.size)
        # c M^-1 row in amplitudes of the free modes, whose mass is 1: see ``events.entry``.
        kicks = rows * np.array([float(c.stops.damping) for c in system.contacts])[:, None]
        q, v = (np.array(free.to_modal(z.T), order="C") for z in (dq, dv))  # changed in place
        steps = self.piece_at(edges[:-1]), np.diff(edges)
        passed = grow(
            self.regimes.table, self.sides, self.regime, *steps, kicks, rows, free.omega, q, v, enough, logs
        )  # fmt: skip
        return passed, logs

    def offset(self, system: System, channel: int) -> Callable[[Array], tuple[Array, Array]]:
        """o(t) and o'(t) of a channel."""
        return self.drive.offset(system, channel)

    def work(self, system: System, edges: Array) -> tuple[Array, Array, Array]:
        """Work of the loads and moving stops, viscous loss, and loss in the stops' dashpots between consecutive edges,
        which include every event."""
        basis, rest = self.drive.split(system.loads, system.size)
        moving = [(i, c, self.offset(system, i)) for i, c in enumerate(system.contacts) if c.offset is not None]
        pieces = self.piece_at(edges[:-1])

        def powers(t: Array, owner: NDArray[np.int64]) -> tuple[Array, Array]:
            piece, (power, drag) = pieces[owner], np.zeros((2, t.size))
            if system.damped or rest:
                _, v = self.states_in(t, piece)
                for vector, function in system.loads:
                    power += evaluate(function, t) * (v @ vector)
                drag += np.sum(v * (v @ system.damping), axis=1)
            else:
                g = self.drive.coefficients(t)
                for k in np.flatnonzero(np.any(basis, axis=1)):
                    power += g[:, k] * self.observed(t, basis[k])[1]
            for i, contact, offset in moving:
                power -= self.force(contact, i, t, piece) * offset(t)[1]
            return power, drag

        given, taken = integrated(self, edges, powers)
        moved, stops = work_of_damping(system, self, edges)
        return given + moved, taken, stops

    def settled(self, system: System, t: Array, channel: int, u: Array, v: Array) -> tuple[Array, Array]:
        """Position u and velocity v of a channel at times t, without the rounding of what a rigid stop holds."""
        return u, v

    def force(self, contact: Contact, i: int, t: Array, piece: NDArray[np.int64]) -> Array:
        """Force of stop i on its contact, without that of a damper, at times t (k,) in the given segments."""
        u, sigma = self.observed(t, contact.row)[0] + self.drive.offset(self.regimes.source.system, i)(t)[0], 0.0
        for side in (-1, 1):
            kappa, constant = contact.stops.spring(side)
            sigma = sigma + np.where(self.sides[piece, i] == side, constant - kappa * u, 0.0)
        return np.asarray(sigma)


def _parts(z: Complex) -> Array:
    """(2k, ...), by which real and imaginary parts in turn give Re sum_k (a + i b)_k z_k."""
    return np.stack([z.real, -z.imag], axis=1).reshape(2 * len(z), *z.shape[1:])


def oscillating(pairs: Pairs) -> Array:
    """The frequencies of a regime."""
    return pairs.omega if pairs.exponentials is None else np.abs(pairs.exponentials.eigenvalues.imag)


@compiled
def states(
    table: Table, times: Array, regime: IntArray, x: Array, y: Array, t: Array, piece: IntArray, q: Array, v: Array
) -> None:
    """q and q' at times t inside the given segments into q, v (k, n)."""
    g, work = np.empty(1 + 2 * table.frequencies.size), np.empty((5, table.sigma.shape[1]))
    for i in range(t.size):
        k = piece[i]
        r = regime[k]
        size = table.sizes[r]
        if size < 0:
            continue
        x1, y1 = work[3, :size], work[4, :size]
        turn(table, r, x[k, :size], y[k, :size], times[k], t[i] - times[k], x1, y1, work)
        drive(table, t[i], g)
        leave(table, r, x1, y1, g, q[i], v[i])


@compiled
def observe(
    table: Table, times: Array, regime: IntArray, x: Array, y: Array, rows: Array, waves: Array, t: Array,
    piece: IntArray, u: Array, v: Array,
) -> None:  # fmt: skip
    """row . q and its rate at times t inside the given segments into u and v (k,).

    rows: (R, 2, K), what the row sees of x and of y in every regime; waves: (R, d), of the drive. Up to RUN times at
    equal distances in one segment are answered from the first of them, by the turns that every pair and drive makes
    until the others; distances are equal where they differ by the rounding of the times, and that difference counts to
    first order.
    """
    R, K, F = rows.shape[0], rows.shape[2], table.frequencies.size
    # What the row sees of each pair and drive at the first time of a run, and the rates of these.
    X, Y, pull, bend, turned = np.empty((5, K + F))
    work = np.empty((5, K))
    distance = t[1] - t[0] if t.size > 1 else 0.0
    turns, known = np.empty((R, RUN, 3, K + F)), np.zeros(R, np.int64)
    i = 0
    while i < t.size:
        k = piece[i]
        r = regime[k]
        n = table.sizes[r]
        if n < 0:
            i += 1
            continue
        x1, y1 = work[3, :n], work[4, :n]
        # The first time of a run, from the start of its segment.
        turn(table, r, x[k, :n], y[k, :n], times[k], t[i] - times[k], x1, y1, work)
        for j in range(n):
            a, b, w = rows[r, 0, j], rows[r, 1, j], table.omega[r, j]
            X[j], Y[j] = a * x1[j] + b * y1[j], a * y1[j] - w * w * b * x1[j]
        for j in range(F):
            frequency = table.frequencies[j]
            sine, cosine = math.sin(frequency * t[i]), math.cos(frequency * t[i])
            a, b = waves[r, 1 + 2 * j], waves[r, 2 + 2 * j]
            X[n + j], Y[n + j] = a * sine + b * cosine, frequency * (a * cosine - b * sine)
        position, velocity = waves[r, 0], 0.0
        for j in range(n + F):
            position += X[j]
            velocity += Y[j]
        for j in range(n):
            velocity += table.sigma[r, j] * X[j]
        u[i], v[i] = position, velocity
        # As many times as follow at the same distance. Close pairs answer from rest and have no such turns.
        count = 1
        while distance > 0.0 and table.closes[r] == 0 and count < RUN and i + count < t.size:
            if piece[i + count] != k or abs(t[i + count] - t[i] - count * distance) > 4.0 * EPS * t[i + count]:
                break
            count += 1
        # The turns of this regime over 1, 2, ... distances, computed once.
        if count > 1 and known[r] == 0:
            known[r] = 1
            c, s, versine = np.empty(n), np.empty(n), np.empty(n)
            for m in range(1, RUN):
                own_turns = turns[r, m]
                oscillations(table.omega[r, :n], m * distance, c, s, versine)
                for j in range(n):
                    decay = math.exp(table.sigma[r, j] * m * distance)
                    own_turns[0, j], own_turns[1, j], own_turns[2, j] = decay * c[j], decay * s[j], versine[j]
                for j in range(F):
                    own_turns[0, n + j], own_turns[1, n + j], own_turns[2, n + j] = oscillation(
                        table.frequencies[j], m * distance
                    )
        if count > 1:
            # Level, curvature and its rate, for the other times of the run.
            for j in range(n):
                pull[j] = rows[r, 0, j] * table.level[r, j]
                square = table.omega[r, j] ** 2
                bend[j], turned[j] = pull[j] - square * X[j], -square * Y[j]
            for j in range(n, n + F):
                square = table.frequencies[j - n] ** 2
                pull[j], bend[j], turned[j] = 0.0, -square * X[j], -square * Y[j]
        # The other times, each by one turn from the first.
        for m in range(1, count):
            position, velocity, acceleration = waves[r, 0], 0.0, 0.0
            for j in range(n + F):
                C, S, V = turns[r, m, 0, j], turns[r, m, 1, j], turns[r, m, 2, j]
                place, speed = X[j] * C + Y[j] * S + pull[j] * V, Y[j] * C + bend[j] * S
                sigma = table.sigma[r, j] if j < n else 0.0
                position += place
                velocity += sigma * place + speed
                acceleration += sigma * (sigma * place + 2.0 * speed) + bend[j] * C + turned[j] * S
            # A distance that is off by rounding counts by rate and acceleration.
            late = t[i + m] - t[i] - m * distance
            u[i + m], v[i + m] = position + velocity * late, velocity + acceleration * late
        i += count


@inner
def energy_norm(omega: Array, q: Array, v: Array) -> float:
    """sqrt(v^T M v + q^T K q) of amplitudes q and rates v of the free modes."""
    total = 0.0
    for j in range(q.size):
        total += v[j] * v[j] + (omega[j] * q[j]) ** 2
    return math.sqrt(total)


@compiled
def grow(
    table: Table, sides: IntArray, regime: IntArray, piece: IntArray, widths: Array, kicks: Array, rows: Array,
    omega: Array, q: Array, v: Array, enough: float, logs: Array,
) -> int:  # fmt: skip
    """Carry tangent vectors q, v (vectors, n) of length 1, amplitudes and rates of the free modes of frequencies omega,
    through the segments of the given widths, (k,) each, and add up ln of their growth in logs (k + 1, vectors). kicks,
    rows: (m, n), what the entry into a damped stop takes of a velocity, for what a contact sees. Ended where a growth
    is above ``enough``; returns how many of the widths were passed, less where a vector vanishes or overflows."""
    n, last = q.shape[1], piece[0]
    none, work = np.empty(0), np.empty((2, n))  # no drive acts on the difference of two motions
    for i in range(widths.size):
        over = False
        r = regime[piece[i]]
        size = abs(table.sizes[r])
        # Turns of the pairs over this width, decay included.
        x, y, c, s, versine = np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.empty(size)
        oscillations(table.omega[r, :size], widths[i], c, s, versine)
        for j in range(size):
            if table.sigma[r, j] != 0.0:
                decay = math.exp(table.sigma[r, j] * widths[i])
                c[j] *= decay
                s[j] *= decay
        for k in range(q.shape[0]):
            # Entries into damped stops since the last width turn the vector.
            for new in range(last + 1, piece[i] + 1):
                for contact in range(rows.shape[0]):
                    if sides[new - 1, contact] == 0 and sides[new, contact] != 0:
                        seen = 0.0
                        for j in range(n):
                            seen += rows[contact, j] * q[k, j]
                        for j in range(n):
                            v[k, j] -= kicks[contact, j] * seen
            # To the pairs, ahead by the turns, and back to the free modes.
            enter(table, r, q[k], v[k], none, x, y, work)
            for j in range(size):
                w = table.omega[r, j]
                x[j], y[j] = x[j] * c[j] + y[j] * s[j], y[j] * c[j] - w * w * s[j] * x[j]
            leave(table, r, x, y, none, q[k], v[k])
            length = energy_norm(omega, q[k], v[k])
            # Squares of the length must stay within float64.
            if not 1e-150 < length < 1e150:
                return i
            # Length 1 again, the logarithm kept: a growth beyond float64 stays a number.
            for j in range(n):
                q[k, j] /= length
                v[k, j] /= length
            logs[i + 1, k] = logs[i, k] + math.log(length)
            over |= logs[i + 1, k] > enough
        last = piece[i]
        if over:
            return i + 1
    return widths.size


@compiled
def press(
    table: Table, times: Array, sides: IntArray, regime: IntArray, x: Array, y: Array, contact: int, starts: Array,
    ends: Array, first: IntArray, deepest: Array, depths: Array,
) -> None:  # fmt: skip
    """Largest depth of a contact without damping beyond its stop in [starts, ends] (k,), and the integral of how far
    it is. sides: (segments,), of the contact; first: (k,), the segments that the starts lie in."""
    m, F = table.lags.size, table.frequencies.size
    at = np.array([contact])
    for i in range(starts.size):
        # All segments of the span in which the contact presses.
        k = first[i]
        while k < times.size and times[k] < ends[i]:
            until = times[k + 1] if k + 1 < times.size else math.inf
            if sides[k] != 0 and abs(sides[k]) != LET_GO and until > starts[i]:
                r = regime[k]
                size = table.sizes[r]
                stop = table.g2[contact] if sides[k] > 0 else table.g1[contact]
                # Terms of all contacts in this segment; only those of this contact are read.
                speeds, terms, seen, _ = layout(m, size + F, 0)
                see(table, r, x[k, :size], y[k, :size], times[k], speeds, terms, seen)
                pairs = np.zeros((table.closes[r], 5))
                see_close(table, r, pairs, at)
                one, of_one = terms[contact : contact + 1], seen[contact : contact + 1]
                a, b = max(0.0, starts[i] - times[k]), min(until, ends[i]) - times[k]
                deepest[i] = max(deepest[i], peak(speeds, one, of_one, pairs, times[k], a, b, float(sides[k]), stop))
                depths[i] += sides[k] * area(speeds, one, of_one, pairs, times[k], a, b, stop)
            k += 1


RADIANS = 1.5  # of the fastest motion between two samples: cubics through them err by a hundredth of it
RIVAL = 0.96  # of the largest sample: what is less does not hide the peak, cos(1.5/2) = 0.73 with its slopes


@inner
def fastest_of(speeds: Array, pairs: Array) -> float:
    """The largest frequency among the terms and close pairs."""
    found = speeds[OMEGA, speeds.shape[1] - 1]
    for k in range(pairs.shape[0]):
        found = max(found, pairs[k, 0], pairs[k, 1])
    return found


@inner
def top(
    speeds: Array, terms: Array, seen: Array, pairs: Array, start: float, tau: float, width: float, sign: float,
    stop: float, rise: float, fall: float,
) -> float:  # fmt: skip
    """The largest sign (u - stop) in [tau, tau + width], with rates ``rise`` > 0 at its start and ``fall`` < 0 at its
    end: Newton's method for u' = 0 inside the bracket. u is flat there: half the digits of the time give all of it."""
    # Start where the chord of the rates is zero.
    low, high = tau, tau + width
    found = 0.0
    at = low + width * rise / (rise - fall)
    for _ in range(30):
        carry(speeds, terms, seen, pairs, False, start, at, 0)
        value, rate = sign * (seen[0, U] - stop), sign * seen[0, RATE]
        curve = sign * curvature(speeds, terms, pairs, start, at, 0, 0)
        found = max(found, value)
        if rate > 0.0:
            low = at
        else:
            high = at
        move = -rate / curve if curve < 0.0 else math.inf
        if not low <= at + move <= high:
            move = 0.5 * (low + high) - at
        elif abs(rate * move) <= 1e-9 * abs(value):  # the next such number is the square of this
            return max(found, value + 0.5 * rate * move)
        if abs(move) <= 1e-15 * (start + at):
            break
        at += move
    return found


@inner
def peak(
    speeds: Array, terms: Array, seen: Array, pairs: Array, start: float, a: float, b: float, sign: float, stop: float
) -> float:
    """The largest sign (u - stop) for tau in [a, b], 0 at least."""
    # Samples of value and rate, RADIANS apart.
    count = 1 + int((b - a) * fastest_of(speeds, pairs) / RADIANS)
    width = (b - a) / count
    values, rates = np.empty(count + 1), np.empty(count + 1)
    found = 0.0
    for i in range(count + 1):
        carry(speeds, terms, seen, pairs, False, start, a + i * width, 0)
        values[i], rates[i] = sign * (seen[0, U] - stop), sign * seen[0, RATE]
        found = max(found, values[i])
    # Below the largest sample by more than the cubics err, see RADIANS.
    reach = RIVAL * found
    for i in range(count):
        # A cubic that rises at first and falls at last is not above where its ends' tangents meet.
        if rates[i] > 0.0 > rates[i + 1]:
            meet = (values[i + 1] - values[i] - rates[i + 1] * width) / (rates[i] - rates[i + 1])
            if values[i] + rates[i] * min(max(meet, 0.0), width) >= reach:
                at = a + i * width
                reached = top(speeds, terms, seen, pairs, start, at, width, sign, stop, rates[i], rates[i + 1])
                found = max(found, reached)
    return found


@inner
def area(
    speeds: Array, terms: Array, seen: Array, pairs: Array, start: float, a: float, b: float, stop: float
) -> float:
    """The integral of u - stop over tau in [a, b]: of every term x S + y V + level T, T = (tau - S)/omega^2, and of
    close pairs by Gauss-Legendre quadrature."""
    carry(speeds, terms, seen, pairs, False, start, a, 1)
    carry(speeds, terms, seen, pairs, False, start, b - a, 0)  # for S and V alone
    # The constant, then the integral of every term in closed form.
    tau = b - a
    total = (seen[0, CONSTANT] - stop) * tau
    for k in range(speeds.shape[1]):
        x = speeds[OMEGA, k] * tau
        z = x * x
        # tau - sin(omega tau)/omega cancels for short times: there its series.
        if x < 0.5:
            tail = 1.0 - z / 72.0 * (1.0 - z / 110.0 * (1.0 - z / 156.0))
            T = tau**3 / 6.0 * (1.0 - z / 20.0 * (1.0 - z / 42.0 * tail))
        else:
            T = (tau - speeds[S, k]) / speeds[SQUARE, k]
        total += terms[0, END + 2, k] * speeds[S, k] + terms[0, END + 3, k] * speeds[V, k] + terms[0, LEVEL, k] * T
    for k in range(pairs.shape[0]):
        w, frequency = pairs[k, 0], pairs[k, 1]
        # Panels of 3 radians at most at w + frequency, about twice the frequency of eta.
        count = 1 + int(tau * (w + frequency) / 3.0)
        width = tau / count
        for i in range(count):
            for j in range(NODES.size):
                at = a + width * (i + 0.5 * (NODES[j] + 1.0))
                eta, _, _ = pair(w, frequency, pairs[k, 2], pairs[k, 3], start, at)
                total += pairs[k, 4] * eta * WEIGHTS[j] * 0.5 * width
    return total
