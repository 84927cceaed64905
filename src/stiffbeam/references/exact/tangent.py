"""Derivatives along a motion: of its segments, its events, and all quantities of the motion.

    within a segment     dZ' = A dZ + dA Z                                                   (generator.py)
    at an event h = 0    dt = -(h.dZ + dh.Z)/(h.Z'),  dZ+ = J (dZ- + Z'- dt) - Z'+ dt

J is the derivative of what happens there. On a compliant stop nothing does, and Z' is continuous: dZ+ = dZ-. At the
entry into a damped one the force jumps by c d', see exact.c. On a rigid one with restitution the impulses P solve

    M (q'+ - q'-) = H^T P,   H q'+ + o' = -e (H q'- + o')

with the rows H of the contacts that take part, and so do their derivatives, its right side differentiated.
Source: di Bernardo et al., Piecewise-smooth Dynamical Systems (2008), section 2.5; Mueller, Chaos, Solitons & Fractals
5 (1995) 1671-1681.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from .generator import Generators, RegimeFlow, saddle, saddle_times
from .motion import LET_GO, switched_by_force

GRAZE = 64.0 * float(np.finfo(float).eps)  # of h, by which a graze is told from an event, see ``grazes``
APART = 1e-12  # of the compliances of two contacts: below it an impact on one leaves the other alone
TOGETHER = 4.0 * float(np.finfo(float).eps)  # of a time: two events that are closer are one
LEAST = 0.01  # of the position or velocity that one turn in the time of a path gives: its least unit

# Segment -> forms (f, N) and their own derivatives (f, N) in every parameter, equal for segments of one regime.
Forms = Callable[[int], tuple[Array, Sequence[Array]]]


@dataclass(frozen=True, eq=False)
class Path:
    """Segments of a motion: they start at times (k,) with q, v (k, n) and the contacts on ``sides`` (k, m).

    rigid: contacts with a side are held there. hits: for segments that start with impacts the contacts that are hit.
    """

    times: Array
    sides: NDArray[np.int64]
    q: Array
    v: Array
    t_end: float
    rigid: bool = False
    hits: Mapping[int, Sequence[int]] = field(default_factory=dict)

    @property
    def units(self) -> Array:
        """The largest |q| and |q'| where segments start, for each entry of a state, (2n,).

        Where all starts are near zeros of one of them it counts as LEAST of one turn in the time of the path.
        """
        turn, (q, v) = self.t_end / (2.0 * np.pi), (float(np.max(np.abs(x))) for x in (self.q, self.v))
        return np.repeat([max(q, LEAST * turn * v, 1e-300), max(v, LEAST * q / turn, 1e-300)], self.q.shape[1])


class Tangent:
    """Derivatives along a path in the columns of ``generators``, and in ``directions`` (2n, D) of its start.

    All derivatives have the columns last, those of parameters before directions.
    """

    def __init__(
        self, generators: Generators, path: Path, directions: Array | None = None, graze: float = GRAZE
    ) -> None:
        self.generators, self.path, self.graze = generators, path, graze
        self.parameters = generators.count
        directions = np.zeros((2 * generators.n, 0)) if directions is None else directions
        self.count = self.parameters + directions.shape[1]
        basis, k, N = generators.basis, len(path.times), generators.N
        # Z at the start of every segment.
        self.intervals = [basis.interval(t) for t in path.times.tolist()] if basis.records else [0] * k
        self.Z = np.hstack([path.q, path.v, basis.all_values(path.times, self.intervals)])
        self.lengths = np.diff(np.append(path.times, path.t_end))
        sides = map(tuple, np.where(np.abs(path.sides) == LET_GO, 0, path.sides).tolist())
        self.regimes = [generators.regime(x, path.rigid, i) for x, i in zip(sides, self.intervals, strict=True)]
        # Segments of one regime share its eigenvectors: most work is done a regime at a time.
        self.groups: dict[int, list[int]] = {}
        for i, regime in enumerate(map(id, self.regimes)):
            self.groups.setdefault(regime, []).append(i)
        self.impulses: dict[int, dict[int, tuple[float, Array]]] = {}  # rigid: by segment and contact, with derivative
        self.hit_slopes: dict[tuple[int, int], Array] = {}  # rigid: of the times of impacts, by segment and contact
        self.grazes: list[float] = []  # times of impacts without derivative, on rigid or damped stops
        self.ties: list[float] = []  # rigid: times of impacts together that have none
        # Derivatives of the start: of its data by the parameters, then the directions.
        start = np.zeros((N, self.count))
        for p, column in enumerate(generators.columns):
            start[: generators.n, p], start[generators.n : 2 * generators.n, p] = column.q0, column.v0
        start[: 2 * generators.n, self.parameters :] = directions
        self.dZ, self.ends = self._follow(start)  # at the starts and ends of segments, (k, N, columns)
        self.last = self.ends[-1]

    def _follow(self, dZ: Array) -> tuple[Array, Array]:
        """dZ at the starts and ends of all segments."""
        (k, N), P = self.Z.shape, self.parameters
        # Where nothing happens at events, the end of a segment is the start of the next.
        smooth = not (self.path.rigid or self.generators.basis.records or self._jumps)
        # With many columns the flow of every segment, [E, d; 0, 1] with the part d of dA: one product a segment.
        wide = 2 * self.count > N
        rows = N + P if wide else N
        starts = np.zeros((k + 1, rows, self.count))
        starts[0, :N], starts[:, range(N, rows), range(rows - N)] = dZ, 1.0
        ends = starts[1:] if smooth else np.zeros((k, rows, self.count))
        driven, flows = np.zeros((k, N, P)), np.zeros((k, rows, rows) if wide else 0)
        for members in self.groups.values() if self.count else ():
            regime, tau = self.regimes[members[0]], self.lengths[members]
            if P:
                driven[members] = regime.seen(None, self.Z[members], None, tau)[1]
            if wide:
                flows[members, :N, :N] = regime.flows(tau)
        if wide:
            flows[:, :N, N:], flows[:, range(N, rows), range(N, rows)] = driven, 1.0
        for i, (start, end) in enumerate(zip(starts[:-1], ends, strict=True)):
            if i and not smooth:
                start[:N] = self.across(i, ends[i - 1, :N])
            if wide:
                np.dot(flows[i], start, out=end)
            elif self.count:
                end[:] = self.regimes[i].ahead(start, float(self.lengths[i]))
                end[:, :P] += driven[i]
        return starts[:-1, :N], ends[:, :N]

    def slope_of(self, form: Array, derived: Sequence[Array], Z: Array, dZ: Array) -> Array:
        """Derivative of a form of Z, which depends on the parameters itself, (columns,)."""
        total = form @ dZ
        for p, each in enumerate(derived):
            total[p] += each @ Z
        return total

    def across(self, i: int, dZ: Array) -> Array:
        """dZ after the event at which segment i begins, from that before it."""
        before, after = self.path.sides[i - 1], self.path.sides[i]
        if self.path.rigid:
            return self._struck(i, dZ) if i in self.path.hits else self._renewed(i, dZ)
        generators, n = self.generators, self.generators.n
        # Without damped stops no force jumps, and dZ is continuous.
        if not self._jumps:
            return self._renewed(i, dZ)
        for contact in np.flatnonzero((before == 0) & (after != 0)).tolist():
            c = generators.data.c[contact]
            if c > 0.0:
                # The event ends segment i - 1: its gap is in the functions of that segment.
                form, derived = generators.gap(contact, int(np.sign(after[contact])), self.intervals[i - 1])
                Z = self._clock_before(i)
                if grazes(form, self.regimes[i - 1], Z, self.graze):
                    self.grazes.append(float(self.path.times[i]))
                late = self.slope_of(form, derived, Z, dZ)
                # A neighbour enters later by -late/d', without the force c d' until then.
                dZ = dZ.copy()
                dZ[n : 2 * n] -= c * np.outer(self._back[:, contact], late)
        return self._renewed(i, dZ)

    def _renewed(self, i: int, dZ: Array) -> Array:
        """dZ where the time of samples starts anew: s and its powers depend on no parameter."""
        if self.generators.basis.records:
            dZ = dZ.copy()
            dZ[-3:] = 0.0
        return dZ

    def _clock_before(self, i: int) -> Array:
        """Z at the start of segment i with the time functions of the segment before."""
        basis, Z = self.generators.basis, self.Z[i].copy()
        if basis.records:
            Z[2 * self.generators.n :] = basis.values(float(self.path.times[i]), self.intervals[i - 1])
        return Z

    @cached_property
    def _jumps(self) -> bool:
        """True where the force of a stop jumps at its entry."""
        return bool(np.any(self.generators.data.c > 0.0))

    @cached_property
    def _back(self) -> Array:
        """M^-1 rows^T, (n, m)."""
        return np.linalg.solve(self.generators.data.mass, self.generators.data.rows.T)

    def _before(self, i: int) -> Array:
        """Z at the end of segment i - 1."""
        Z = self.regimes[i - 1].ahead(self.Z[i - 1][:, None], float(self.lengths[i - 1]))[:, 0]
        n = self.generators.n
        # Positions are continuous, velocities are those before the blow.
        Z[:n] = self.path.q[i]
        Z[2 * n :] = self._clock_before(i)[2 * n :]
        return Z

    def _struck(self, i: int, dZ: Array) -> Array:
        """dZ behind impacts on rigid stops: one after the other where they do not change each other."""
        before, after, hits = self.path.sides[i - 1].copy(), self.path.sides[i], list(self.path.hits[i])
        # Free contacts one after the other, the fastest first; if all were held, the fastest alone.
        Z = self._before(i)
        speeds = {c: abs(self._speed(c, i, Z)) for c in hits}
        free = sorted((c for c in hits if not before[c]), key=lambda c: -speeds[c]) or [
            max(hits, key=lambda c: speeds[c])
        ]
        # Held contacts take part in every blow: those in ``hits`` and those that stay held.
        taking = [c for c in hits if c not in free]
        taking += [c for c in np.flatnonzero(before & after).tolist() if c not in hits]
        if len(free) > 1 and not self._apart(free, taking):
            self.ties.append(float(self.path.times[i]))
        # Between two blows at one time the contacts hit so far are in their state after it, for no time.
        for k, c in enumerate(free):
            first = (
                self.regimes[i - 1] if k == 0 else self.generators.regime(tuple(before), True, self.intervals[i - 1])
            )
            before[c] = after[c]
            last = k == len(free) - 1
            then = self.regimes[i] if last else self.generators.regime(tuple(before), True, self.intervals[i - 1])
            dZ, Z = self._blow(i, dZ, Z, [c, *taking], (first, then), self.Z[i] if last else None)
        return self._renewed(i, dZ)

    def _apart(self, free: Sequence[int], taking: Sequence[int]) -> bool:
        """Return True where blows on the ``free`` contacts change neither each other's speeds nor accelerations."""
        data = self.generators.data
        # Velocities that an impulse on each causes, while the others taking part stay held.
        H = data.rows[list(taking)]
        right = np.zeros((self.generators.n + len(H), len(free)))
        right[: self.generators.n] = data.rows[list(free)].T
        back = saddle(data.mass, H)(right)[: self.generators.n]
        # Speeds change by M^-1, accelerations by the damping force of the changed speeds.
        for coupled in (data.rows[list(free)] @ back, back.T @ data.damping @ back):
            size = np.sqrt(np.abs(np.diag(coupled)))
            if np.any(np.abs(coupled - np.diag(np.diag(coupled))) > APART * np.outer(size, size)):
                return False
        return True

    def _speed(self, contact: int, i: int, Z: Array) -> float:
        """Rate of a gap before segment i."""
        return float(self.generators.rate(*self.generators.gap(contact, 1, self.intervals[i - 1]))[0] @ Z)

    def _blow(
        self,
        i: int,
        dZ: Array,
        Z: Array,
        taking: Sequence[int],
        flows: tuple[RegimeFlow, RegimeFlow],
        end: Array | None,
    ) -> tuple[Array, Array]:
        """dZ and Z behind the impact of taking[0], in which the other contacts ``taking`` have a part.

        flows: before and after it. end: Z there where it is known.
        """
        generators, n, interval = self.generators, self.generators.n, self.intervals[i - 1]
        data, after, hit = generators.data, self.path.sides[i], taking[0]
        # Gap rates before the blow. A contact that stays on its stop has no rebound.
        rates = [generators.rate(*generators.gap(c, 1, interval)) for c in taking]
        arriving = np.array([form @ Z for form, _ in rates])
        e = np.array([0.0 if after[c] else data.restitution[c] for c in taking])
        form, derived = generators.gap(hit, int(np.sign(arriving[0])) or 1, interval)
        if grazes(form, flows[0], Z, self.graze):
            self.grazes.append(float(self.path.times[i]))
        # The time of the impact, and dZ there.
        gone = self.slope_of(form, derived, Z, dZ)
        late = -gone / arriving[0] if arriving[0] else np.full(dZ.shape[1], np.nan)
        moved = dZ + np.outer(flows[0].A @ Z, late)
        # the blow and its derivative
        H = data.rows[list(taking)]
        solve = saddle(data.mass, H)
        shift = np.array([rate[2 * n :] @ Z[2 * n :] for rate, _ in rates])
        X = solve(np.concatenate([data.mass @ Z[n : 2 * n], -e * arriving - shift])[:, None])
        # The same equation differentiated: its right side, and the change of its matrix by the parameters.
        right = np.zeros((n + len(taking), dZ.shape[1]))
        right[:n] = data.mass @ moved[n : 2 * n]
        for k, (c, (rate, rate_slopes)) in enumerate(zip(taking, rates, strict=True)):
            right[n + k] = -e[k] * self.slope_of(rate, rate_slopes, Z, moved) - rate[2 * n :] @ moved[2 * n :]
            for p, each in enumerate(rate_slopes):
                right[n + k, p] -= each[2 * n :] @ Z[2 * n :]
                if not after[c]:
                    right[n + k, p] -= generators.columns[p].restitution[c] * arriving[k]
        for p, column in enumerate(generators.columns):
            right[:n, p] += column.mass @ Z[n : 2 * n]
            right[:, p] -= saddle_times(column.mass, column.rows[list(taking)], X)[:, 0]
        dX = solve(right)
        # Impulses with derivatives; velocities behind the blow, brought back to a fixed time.
        of_segment = self.impulses.setdefault(i, {})
        of_segment |= {c: (float(X[n + k, 0]), dX[n + k]) for k, c in enumerate(taking)}
        self.hit_slopes[i, hit] = late
        out = moved.copy()
        out[n : 2 * n] = dX[:n]
        if end is None:
            end = Z.copy()
            end[n : 2 * n] = X[:n, 0]
        return out - np.outer(flows[1].A @ end, late), end

    def event_slope(self, i: int, contact: int) -> Array:
        """Derivative (columns,) of the time at which segment i begins by an event of a contact; NaN at a graze."""
        if self.path.rigid:
            return self._rigid_slope(i, contact)
        generators, interval = self.generators, self.intervals[i - 1]
        old, new = int(self.path.sides[i - 1][contact]), int(self.path.sides[i][contact])
        # h of the event: the gap, or the force of a damped stop.
        side, Z = int(np.sign(new or old)), self._clock_before(i)
        force = switched_by_force(old, new)
        form, derived = (generators.pressure if force else generators.gap)(contact, side, interval)
        speed = float(form @ (self.regimes[i - 1].A @ Z))
        if grazes(form, self.regimes[i - 1], Z) or (force and self._jumps_with(i)):
            return np.full(self.count, np.nan)
        # before the event: the derivative behind it differs where the force of a damped stop jumps
        return -self.slope_of(form, derived, Z, self.ends[i - 1]) / speed

    def _jumps_with(self, i: int) -> bool:
        """Return True where a damped stop is entered at the time at which segment i begins: its force jumps."""
        times, sides = self.path.times, self.path.sides
        at = [k for k in np.flatnonzero(np.abs(times - times[i]) <= TOGETHER * times[i]).tolist() if k]
        entered = np.any([(sides[k - 1] == 0) & (sides[k] != 0) for k in at], axis=0)
        return bool(np.any(entered & (self.generators.data.c > 0.0)))

    def _rigid_slope(self, i: int, contact: int) -> Array:
        """``event_slope`` of an impact on a rigid stop, or of the release of a contact, where its reaction vanishes."""
        unknown = np.full(self.count, np.nan)
        if (i, contact) in self.hit_slopes:
            return self.hit_slopes[i, contact]
        regime = self.regimes[i - 1]
        if i in self.path.hits or contact not in regime.held:
            return unknown
        # A release: h is the reaction of the contact.
        k, Z = regime.held.index(contact), self._before(i)
        form = regime.reactions[k]
        if grazes(form, regime, Z):
            return unknown
        derived = [slopes[k] for slopes in regime.reaction_slopes]
        return -self.slope_of(form, derived, Z, self.ends[i - 1]) / float(form @ (regime.A @ Z))

    def segment_at(self, t: Array) -> NDArray[np.int64]:
        """The segment that each time lies in; an event belongs to the segment it begins."""
        return np.maximum(np.searchsorted(self.path.times, t, side="right") - 1, 0)

    def read(self, forms: Forms, t: Array, segment: NDArray[np.int64] | None = None) -> tuple[Array, Array]:
        """Values (k, f) and derivatives (k, f, columns) of forms (f, N) at fixed times t (k,).

        segment: (k,), where times at events belong to another than the one they begin.
        """
        segment = self.segment_at(t) if segment is None else segment
        width = len(forms(int(segment[0]) if len(t) else 0)[0])
        values, slopes = np.zeros((len(t), width)), np.zeros((len(t), width, self.count))
        for members in self.groups.values():
            here = np.flatnonzero(np.isin(segment, members))
            # Parts of some 1e6 numbers, so that they fit into memory.
            for part in np.array_split(here, 1 + len(here) * self.generators.N * (2 + self.count) // 1_000_000):
                if len(part):
                    own = segment[part]
                    form, derived = forms(int(own[0]))
                    tau = t[part] - self.path.times[own]
                    values[part], slopes[part] = self._states(self.regimes[members[0]], own, tau, form, derived)
        return values, slopes

    def states(self, t: Array, segment: NDArray[np.int64] | None = None) -> Array:
        """Z (k, N) at times t (k,), as the given segments have it."""
        eye = np.eye(self.generators.N)
        return self.values(lambda _: (eye, []), t, self.segment_at(t) if segment is None else segment)

    def values(self, forms: Forms, t: Array, segment: NDArray[np.int64], order: int = 0) -> Array:
        """Values (k, f) of forms, or of their ``order``-th derivatives by time, at times in the given segments."""
        values = np.zeros((len(t), len(forms(int(segment[0]) if len(t) else 0)[0])))
        for members in self.groups.values():
            here = np.flatnonzero(np.isin(segment, members))
            if len(here):
                regime, own = self.regimes[members[0]], segment[here]
                form = forms(int(own[0]))[0] @ np.linalg.matrix_power(regime.A, order)
                values[here] = self._values(regime, own, t[here] - self.path.times[own], form)
        return values

    def _values(self, regime: RegimeFlow, own: NDArray[np.int64], tau: Array, form: Array) -> Array:
        if regime.eigen is None:
            ahead = (regime.ahead(self.Z[i][:, None], x)[:, 0] for i, x in zip(own.tolist(), tau.tolist(), strict=True))
            return np.array([form @ Z for Z in ahead])
        rates, V, W = regime.eigen
        return ((np.exp(np.multiply.outer(tau, rates)) * (self.Z[own] @ W.T)) @ (form @ V).T).real

    def _states(
        self, regime: RegimeFlow, own: NDArray[np.int64], tau: Array, form: Array, derived: Sequence[Array]
    ) -> tuple[Array, Array]:
        """Values (k, f) and derivatives (k, f, columns) of forms in one regime."""
        # Forms and their derivatives in one product; dZ in eigenvectors once a segment.
        unique, start = np.unique(own, return_inverse=True)
        values, slopes = regime.seen(form, self.Z[unique], self.dZ[unique], tau, start)
        # The forms' derivatives in the parameters.
        active = [p for p, x in enumerate(derived) if np.any(x)]
        if active:
            seen = self._values(regime, own, tau, np.concatenate([derived[p] for p in active]))
            slopes[:, :, active] += np.moveaxis(seen.reshape(len(tau), len(active), -1), 1, 2)
        return values, slopes


def grazes(form: Array, regime: RegimeFlow, Z: Array, depth: float = GRAZE) -> bool:
    """Return True if a zero of the form h is a graze to rounding: h'^2 <= 2 |h''| depth sum |terms of h|."""
    # The parabola with h' and h'' turns within ``depth`` of the terms of h.
    rate = regime.A @ Z
    size = float(np.abs(form) @ np.abs(Z))
    return float(form @ rate) ** 2 <= 2.0 * abs(float(form @ (regime.A @ rate))) * depth * size


def monodromy(tangent: Tangent) -> Array:
    """Derivative of the state at the end of a path in the directions of its start, (2n, D)."""
    return tangent.last[: 2 * tangent.generators.n, tangent.parameters :]
