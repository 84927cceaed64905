"""Derivatives along a motion: of its segments, of its events, and so of all that is read of it.

    within a segment     dZ' = A dZ + dA Z                                                   (generator.py)
    at an event h = 0    dt = -(h.dZ + dh.Z)/(h.Z'),  dZ+ = J (dZ- + Z'- dt) - Z'+ dt

J is the derivative of what happens there. On a compliant stop nothing does, and Z' is continuous: dZ+ = dZ-. At the
entry into a damped one the force jumps by c d', see events.py. On a rigid one with restitution the impulses P solve

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

from ..basics.arrays import Array
from .events import LET_GO, switched_by_force
from .generator import Generators, RegimeFlow, saddle, saddle_times

GRAZE = 64.0 * float(np.finfo(float).eps)  # of h, by which a graze is told from an event, see ``grazes``


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


class Tangent:
    """Derivatives along a path in the columns of ``generators``, and in ``directions`` (2n, D) of its start.

    All derivatives have the columns last, those of parameters before directions.
    """

    def __init__(self, generators: Generators, path: Path, directions: Array | None = None) -> None:
        self.generators, self.path = generators, path
        self.parameters = generators.count
        directions = np.zeros((2 * generators.n, 0)) if directions is None else directions
        self.count = self.parameters + directions.shape[1]
        basis, k, N = generators.basis, len(path.times), generators.N
        self.intervals = [basis.interval(t) for t in path.times.tolist()]
        g = [basis.values(t, i) for t, i in zip(path.times.tolist(), self.intervals, strict=True)]
        self.Z = np.hstack([path.q, path.v, np.array(g).reshape(k, -1)])
        self.dZ, self.ends = np.zeros((2, k, N, self.count))  # at the starts and ends of segments
        self.lengths = np.diff(np.append(path.times, path.t_end))
        self.regimes = [
            generators.regime(self._regime_sides(i), path.rigid, interval) for i, interval in enumerate(self.intervals)
        ]
        self.groups: dict[int, list[int]] = {}
        for i, regime in enumerate(self.regimes):
            self.groups.setdefault(id(regime), []).append(i)
        self.impulses: dict[int, dict[int, tuple[float, Array]]] = {}  # rigid: by segment and contact, with derivative
        self.event_slopes: dict[int, Array] = {}  # rigid: derivatives of the times of impacts, by segment
        self.grazes: list[float] = []  # rigid: times of impacts without derivative
        start = np.zeros((N, self.count))
        for p, column in enumerate(generators.columns):
            start[: generators.n, p], start[generators.n : 2 * generators.n, p] = column.q0, column.v0
        start[: 2 * generators.n, self.parameters :] = directions
        self.last = self._follow(start)

    def _regime_sides(self, i: int) -> tuple[int, ...]:
        sides = self.path.sides[i]
        return tuple(np.where(np.abs(sides) == LET_GO, 0, sides).tolist())

    def _follow(self, dZ: Array) -> Array:
        """Fill dZ at the starts of all segments; return those at the end of the last."""
        driven = np.zeros((len(self.Z), self.generators.N, self.parameters))
        eye = np.eye(self.generators.N)
        for members in self.groups.values():
            driven[members] = self.regimes[members[0]].seen(eye, self.Z[members], self.lengths[members])
        for i, (regime, tau) in enumerate(zip(self.regimes, self.lengths.tolist(), strict=True)):
            if i:
                dZ = self._across(i, dZ)
            self.dZ[i] = dZ
            dZ = regime.ahead(dZ, tau)
            dZ[:, : self.parameters] += driven[i]
            self.ends[i] = dZ
        return dZ

    def _with_parameters(self, form: Array, derived: Sequence[Array], Z: Array, dZ: Array) -> Array:
        """Derivative of a form of Z, which depends on the parameters itself, (columns,)."""
        total = form @ dZ
        for p, each in enumerate(derived):
            total[p] += each @ Z
        return total

    def _across(self, i: int, dZ: Array) -> Array:
        """dZ behind the event at which segment i begins, from that before it."""
        before, after = self.path.sides[i - 1], self.path.sides[i]
        if self.path.rigid:
            return self._struck(i, dZ) if i in self.path.hits else self._renewed(i, dZ)
        generators, n = self.generators, self.generators.n
        for contact in np.flatnonzero((before == 0) & (after != 0)).tolist():
            c = generators.data.c[contact]
            if c > 0.0:
                form, derived = generators.gap(contact, int(np.sign(after[contact])), self.intervals[i - 1])
                late = self._with_parameters(form, derived, self._clock_before(i), dZ)
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
    def _back(self) -> Array:
        """M^-1 rows^T, (n, m)."""
        return np.linalg.solve(self.generators.data.mass, self.generators.data.rows.T)

    def _before(self, i: int) -> Array:
        """Z at the end of segment i - 1."""
        Z = self.regimes[i - 1].ahead(self.Z[i - 1][:, None], float(self.lengths[i - 1]))[:, 0]
        n = self.generators.n
        Z[:n] = self.path.q[i]
        Z[2 * n :] = self._clock_before(i)[2 * n :]
        return Z

    def _struck(self, i: int, dZ: Array) -> Array:
        """dZ behind impacts on rigid stops."""
        generators, n, interval = self.generators, self.generators.n, self.intervals[i - 1]
        data, hits = generators.data, list(self.path.hits[i])
        Z = self._before(i)
        rates = [generators.rate(*generators.gap(c, 1, interval)) for c in range(generators.m)]
        speeds = np.array([form @ Z for form, _ in rates])
        first = max(hits, key=lambda c: abs(speeds[c]))
        held = [c for c in np.flatnonzero(self.path.sides[i]).tolist() if self.path.sides[i - 1][c] and c not in hits]
        taking = hits + held
        e = np.array([0.0 if self.path.sides[i][c] else data.restitution[c] for c in taking])
        if grazes(generators.gap(first, 1, interval)[0], self.regimes[i - 1], Z):
            self.grazes.append(float(self.path.times[i]))
        form, derived = generators.gap(first, int(np.sign(speeds[first])) or 1, interval)
        gone = self._with_parameters(form, derived, Z, dZ)
        late = -gone / speeds[first] if speeds[first] else np.full(self.count, np.nan)
        moved = dZ + np.outer(self.regimes[i - 1].A @ Z, late)
        # the blow and its derivative
        H = data.rows[taking]
        solve = saddle(data.mass, H)
        shift = np.array([rates[c][0][2 * n :] @ Z[2 * n :] for c in taking])
        arriving = speeds[taking]
        X = solve(np.concatenate([data.mass @ Z[n : 2 * n], -e * arriving - shift])[:, None])
        right = np.zeros((n + len(taking), self.count))
        right[:n] = data.mass @ moved[n : 2 * n]
        for k, c in enumerate(taking):
            rate, rate_slopes = rates[c]
            right[n + k] = -e[k] * self._with_parameters(rate, rate_slopes, Z, moved) - rate[2 * n :] @ moved[2 * n :]
            for p, each in enumerate(rate_slopes):
                right[n + k, p] -= each[2 * n :] @ Z[2 * n :]
                if not self.path.sides[i][c]:
                    right[n + k, p] -= generators.columns[p].restitution[c] * arriving[k]
        for p, column in enumerate(generators.columns):
            right[:n, p] += column.mass @ Z[n : 2 * n]
            right[:, p] -= saddle_times(column.mass, column.rows[taking], X)[:, 0]
        dX = solve(right)
        self.impulses[i] = {c: (float(X[n + k, 0]), dX[n + k]) for k, c in enumerate(taking)}
        self.event_slopes[i] = late
        out = moved.copy()
        out[n : 2 * n] = dX[:n]
        landed = self.Z[i].copy()
        return self._renewed(i, out - np.outer(self.regimes[i].A @ landed, late))

    def event_slope(self, i: int, contact: int) -> Array:
        """Derivative (columns,) of the time at which segment i begins by an event of a contact; NaN at a graze."""
        if self.path.rigid:
            return self.event_slopes.get(i, np.full(self.count, np.nan))
        generators, interval = self.generators, self.intervals[i - 1]
        old, new = int(self.path.sides[i - 1][contact]), int(self.path.sides[i][contact])
        side, Z = int(np.sign(new or old)), self._clock_before(i)
        force = switched_by_force(old, new)
        form, derived = (generators.pressure if force else generators.gap)(contact, side, interval)
        speed = float(form @ (self.regimes[i - 1].A @ Z))
        if grazes(form, self.regimes[i - 1], Z):
            return np.full(self.count, np.nan)
        # before the event: the derivative behind it differs where the force of a damped stop jumps
        return -self._with_parameters(form, derived, Z, self.ends[i - 1]) / speed

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
            for part in np.array_split(here, 1 + len(here) * self.generators.N * (2 + self.count) // 1_000_000):
                if len(part):
                    own = segment[part]
                    form, derived = forms(int(own[0]))
                    tau = t[part] - self.path.times[own]
                    values[part], slopes[part] = self._states(self.regimes[members[0]], own, tau, form, derived)
        return values, slopes

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
        every = np.concatenate([form, *derived])
        f = len(form)
        if regime.eigen is None:
            flows = [regime.flow(x) for x in tau.tolist()]
            seen = np.array([every @ (E @ self.Z[i]) for E, i in zip(flows, own.tolist(), strict=True)])
            slopes = np.array([form @ (E @ self.dZ[i]) for E, i in zip(flows, own.tolist(), strict=True)])
        else:
            rates, V, W = regime.eigen
            seen, U = self._values(regime, own, tau, every), form @ V
            unique, where = np.unique(own, return_inverse=True)
            E, turned = np.exp(np.multiply.outer(tau, rates)), (W @ self.dZ[unique])[where]
            slopes = (U @ (E[:, :, None] * turned)).real
        slopes[:, :, : self.parameters] += regime.seen(form, self.Z[own], tau)
        for p in range(len(derived)):
            slopes[:, :, p] += seen[:, f * (p + 1) : f * (p + 2)]
        return seen[:, :f], slopes


def grazes(form: Array, regime: RegimeFlow, Z: Array) -> bool:
    """Return True where a zero of the form h is a graze but for rounding: h'^2 <= 2 |h''| GRAZE sum |terms of h|."""
    rate = regime.A @ Z
    size = float(np.abs(form) @ np.abs(Z))
    return float(form @ rate) ** 2 <= 2.0 * abs(float(form @ (regime.A @ rate))) * GRAZE * size


def monodromy(tangent: Tangent) -> Array:
    """Derivative of the state at the end of a path in the directions of its start, (2n, D)."""
    return tangent.last[: 2 * tangent.generators.n, tangent.parameters :]
