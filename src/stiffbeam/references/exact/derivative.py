"""Derivatives of the exact solution with respect to initial data and parameters: ``reference.derivative``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array, IntArray
from ...basics.resources import afford
from ...basics.validation import InputError
from ...model.system import System
from ...model.system_data import slopes
from ...trajectory.trajectory import Reference
from .motion import Motion, Solver
from .tangent import GRAZE, Tangent, path_of_solution
from .variation import Series, Variation

LOOKS = 4  # parts of a step, two radians of the fastest motion, among which a peak is looked for
HALVINGS = 45  # of the part in which a peak is
RIVALS = 1e-9  # relative distance of two peaks below which the larger is not known
AGREEMENT = 1e-3  # of the largest derivative so far: two copies that differ by more are past the horizon
# As large as the perturbations of the copies of a horizon.
COPY = 4.0 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Derivative:
    """Derivatives of a Reference with respect to p parameters, which are the last axis of every array.

    Attributes
    ----------
    wrt : tuple of str
        The p paths.
    t : (k,) array
        Fixed times of ``tip``, ``tip_velocity``, ``state`` and ``energy``.
    bounds : (p,) array
        Relative errors of the derivatives of the system's data.
    exists_until : float
        The first time from which no derivative exists; values from it on are NaN. Infinite where there is none.
    reason : str
        Reason why no derivative exists from then on; empty if it exists throughout.
    """

    reference: Reference = field(repr=False)
    wrt: tuple[str, ...]
    t: Array
    bounds: Array
    exists_until: float
    reason: str
    tangent: Tangent = field(repr=False)

    def __repr__(self) -> str:
        until = "" if np.isinf(self.exists_until) else f", exists until t = {self.exists_until:.6g}: {self.reason}"
        return f"<Derivative in {', '.join(self.wrt)}{until}>"

    def _masked(self, t: Array, values: Array) -> Array:
        values[t >= self.exists_until] = np.nan
        return values

    @cached_property
    def _at_outputs(self) -> tuple[IntArray, Array]:
        """Segments (k,) of the times t, and the motion and its derivatives there, (k, 1 + p, 2n)."""
        segments = self.tangent.segment_at(self.t)
        return segments, self.tangent.at(self.t, segments)

    def _read(self, f: Callable[[Series], Array]) -> Array:
        """f (k, ...) of the series at the times t."""
        (segments, z), values = self._at_outputs, {}
        for part, series in self.tangent.expanded(segments, self.t, z[:, 0], z[:, 1:], 2):
            values |= dict(zip(part.tolist(), f(series), strict=True))
        return self._masked(self.t, np.array([values[k] for k in range(len(self.t))]))

    @cached_property
    def _tip(self) -> tuple[Array, Array]:
        variation = self.tangent.variation
        observe, slopes = variation.data.observe, variation.slopes["observe"]
        seen = self._system.observe is not None

        def tip(series: Series) -> Array:
            if not seen:
                return np.moveaxis(series.u[:2, :, 1:, 0], 0, 1)
            eta = series.eta[:2]
            return np.moveaxis(eta[:, :, 1:] @ observe + eta[:, :, 0] @ slopes.T, 0, 1)

        derived = self._read(tip)
        return derived[:, 0], derived[:, 1]

    @property
    def tip(self) -> Array:
        """Derivative of the observed position, (k, p)."""
        return self._tip[0]

    @property
    def tip_velocity(self) -> Array:
        """Derivative of the observed velocity, (k, p)."""
        return self._tip[1]

    @cached_property
    def state(self) -> Array:
        """Derivative of (q, q'), (k, 2n, p)."""
        X, t, p = self.tangent.variation.X, self.t, len(self.wrt)
        afford("wrt", p, "ask for fewer parameters or times", floats=8.0 * len(t) * len(X) * p)
        read = lambda series: np.concatenate([series.eta[0] @ X.T, series.eta[1] @ X.T], axis=2)[:, 1:]  # noqa: E731
        return np.moveaxis(self._read(read), 1, 2)

    @cached_property
    def energy(self) -> Array:
        """Derivative of the energy, kinetic, elastic and of the stops, (k, p)."""
        tangent, variation, system = self.tangent, self.tangent.variation, self._system
        squares, slopes = variation.free.w2, variation.slopes

        def energy(series: Series) -> Array:
            (q, dq), (v, dv) = ((x[:, 0], x[:, 1:]) for x in series.eta[:2])
            # v.dv + q.W dq, and the parts of parameters that change M and K.
            total = np.einsum("si,spi->sp", v, dv) + np.einsum("si,spi->sp", q * squares, dq)
            for x, name in ((v, "mass"), (q, "stiffness")):
                total += 0.5 * np.einsum("si,pij,sj->sp", x, slopes[name], x)
            # Compliant stops: E = kappa d^2/2 at the depth d beyond the stop.
            for i, contact in enumerate(system.contacts):
                for side, _ in contact.stops.sides if not contact.stops.rigid else ():
                    gap = side * tangent.gap(series, i, side)[0]
                    depth = np.maximum(gap[:, :1], 0.0)
                    total += variation.data.kappa[i] * depth * gap[:, 1:] + 0.5 * slopes["kappa"][:, i] * depth**2
            return total

        return self._read(energy)

    @property
    def _system(self) -> System:
        assert self.reference.system is not None
        return self.reference.system

    @cached_property
    def _events(self) -> list[tuple[int, int]]:
        """(segment, contact) of every opening and closing, in order."""
        return [(int(k) + 1, int(contact)) for k, contact in zip(*np.nonzero(self.tangent.path.changed), strict=True)]

    @property
    def events(self) -> Array:
        """Times at which a contact opens or closes, (events,)."""
        return self.tangent.path.times[[segment for segment, _ in self._events]]

    @cached_property
    def event_times(self) -> Array:
        """Derivative of ``events``, (events, p); NaN at a graze."""
        slopes = [self.tangent.event_slope(segment, contact) for segment, contact in self._events]
        return self._masked(self.events, np.reshape(slopes, (len(slopes), len(self.wrt))))

    @property
    def impact_times(self) -> tuple[Array, ...]:
        """Derivatives of ``contacts[i].impacts.times``, (impacts, p) for every contact; NaN at a graze."""
        return tuple(times for times, _, _ in self._impacts)

    @property
    def peaks(self) -> tuple[Array, ...]:
        """Derivatives of ``contacts[i].impacts.peaks``, (impacts, p) for every contact.

        NaN for rigid stops, for a contact that is closed at the end, and where two peaks are equal.
        """
        return tuple(peaks for _, peaks, _ in self._impacts)

    @property
    def impulses(self) -> tuple[Array, ...]:
        """Derivatives of ``contacts[i].impacts.impulses``, (impacts, p) for every contact.

        NaN for a contact that is closed at the end, and where a rigid stop holds it.
        """
        return tuple(impulses for _, _, impulses in self._impacts)

    @cached_property
    def _impacts(self) -> tuple[tuple[Array, Array, Array], ...]:
        """Derivatives of times, peaks and impulses of every contact."""
        read = self._struck if self.tangent.rigid else self._pressed
        return tuple(read(i) for i in range(len(self._system.contacts)))

    def _struck(self, i: int) -> tuple[Array, Array, Array]:
        """Impacts on a rigid stop. A contact that is held after an impact has an impulse over time, which is left out
        here."""
        impacts, tangent = self.reference.contacts[i].impacts, self.tangent
        times, impulses = np.full((2, len(impacts.times), len(self.wrt)), np.nan)
        for k, (t, end) in enumerate(zip(impacts.times.tolist(), impacts.ends.tolist(), strict=True)):
            # Impacts and segments take their times from one number: equality is exact.
            at = [s for s in np.flatnonzero(tangent.path.times == t).tolist() if i in tangent.impulses.get(s, {})]
            if at and t < self.exists_until:
                value, slope = tangent.impulses[at[0]][i]
                times[k] = tangent.event_slope(at[0], i)
                # Impulses are recorded without sign.
                impulses[k] = np.sign(value) * slope if end == t else np.nan
        return times, np.full_like(times, np.nan), impulses

    def _pressed(self, i: int) -> tuple[Array, Array, Array]:
        """Impacts on a compliant stop."""
        tangent, impacts, columns = self.tangent, self.reference.contacts[i].impacts, len(self.wrt)
        times, leaving = np.full((2, len(impacts.times), columns), np.nan)
        spans: list[tuple[int, int, int]] = []  # impact, first segment and the one after the last
        for k, (start, end) in enumerate(zip(impacts.times.tolist(), impacts.ends.tolist(), strict=True)):
            first = self._segment_of_change(start, i)
            # A contact that is there at t = 0 has no entry that could move.
            if start > 0.0:
                times[k] = tangent.event_slope(first, i)
            if not np.isnan(end):
                last = self._segment_of_change(end, i)
                leaving[k] = tangent.event_slope(last, i)
                spans.append((k, first, last))
        peaks, impulses = np.full((2, len(impacts.times), columns), np.nan)
        if spans:
            # Events of other contacts divide an impact into several segments.
            pressed = [(k, s) for k, a, b in spans for s in range(a, b) if tangent.lengths[s] > 0.0]
            owner, segments = np.array(pressed).T
            self._forces(i, owner, segments, (times, leaving), peaks, impulses)
        self._masked(impacts.times, times)
        until = np.where(np.isnan(impacts.ends), np.inf, impacts.ends)
        return times, self._masked(until, peaks), self._masked(until, impulses)

    def _segment_of_change(self, t: float, contact: int) -> int:
        """The segment with which a contact changes at t."""
        path = self.tangent.path
        # Several segments may begin at one time: the one in which this contact changes.
        for s in range(*np.searchsorted(path.times, [t, np.nextafter(t, np.inf)]).tolist()):
            if s == 0 or path.sides[s][contact] != path.sides[s - 1][contact]:
                return s
        return int(np.searchsorted(path.times, t))

    def _forces(
        self, i: int, owner: IntArray, segments: IntArray, events: tuple[Array, Array], peaks: Array, impulses: Array
    ) -> None:
        """Derivatives of peaks and impulses of the impacts ``owner`` of a contact, pressed in ``segments``, (k,) each.

        A peak inside has its derivative at a fixed time, one at the entry into a damped stop moves with the entry.
        """
        tangent, (entering, leaving) = self.tangent, events
        path, sides = tangent.path, tangent.path.sides[:, i]
        impacts = np.unique(owner)
        first = segments[np.searchsorted(owner, impacts)]
        last = segments[np.searchsorted(owner, impacts, side="right") - 1]
        # Steps of all these segments, each with the series of the force and of its derivatives.
        of_steps, at, lengths, z = tangent.steps
        steps = np.flatnonzero(np.isin(of_steps, segments))
        impact = owner[np.searchsorted(segments, of_steps[steps])]
        impulses[impacts] = 0.0
        tops: dict[int, list[tuple[float, float, Any]]] = {k: [] for k in impacts.tolist()}  # time, force, derivative
        for part, series in tangent.expanded(of_steps[steps], at[steps], z[steps], tangent.dz[steps]):
            side = int(sides[of_steps[steps[part[0]]]])
            force, h = side * tangent.pressure(series, i, side), lengths[steps[part]]
            k = np.arange(1.0, 1 + len(force))[:, None]
            np.add.at(impulses, impact[part], np.einsum("ksp,ks->sp", force[:, :, 1:], h**k / k))
            for step, s in zip(*maxima(force[:, :, 0], h), strict=True):
                top: Any = np.polynomial.polynomial.polyval(s, force[:, step])
                tops[int(impact[part[step]])].append((float(at[steps[part[step]]] + s), top[0], top[1:]))
        # Where events of other contacts divide an impact the force may have a kink, whose peak has no derivative here.
        for k, segment in zip(owner.tolist(), segments.tolist(), strict=True):
            side = int(sides[segment])
            force, rate, *_ = side * tangent.pressure(tangent.at_start(segment), i, side)[:, 0]
            slope = force[1:] + rate[0] * entering[k] if segment in first else np.nan
            tops[k].append((float(path.times[segment]), force[0], slope))
            if tangent.variation.data.c[i] > 0.0:  # Leibniz's rule: where the force jumps, the integral's ends move
                if segment in first:
                    impulses[k] -= force[0] * entering[k]
                if segment in last:
                    left = side * tangent.pressure(tangent.at_end(segment), i, side)[0, 0, 0]
                    impulses[k] += np.nan_to_num(left * leaving[k])
        for k, begin, end in zip(impacts.tolist(), path.times[first].tolist(), path.ends[last].tolist(), strict=True):
            time, top, slope = max(tops[k], key=lambda top: top[1])
            # Rounding decides between two equal peaks: no derivative.
            rivals = [t for t, x, _ in tops[k] if x > top * (1.0 - RIVALS) and abs(t - time) > 1e-6 * (end - begin)]
            peaks[k] = np.nan if rivals else slope

    @cached_property
    def horizon(self) -> float:
        """Time to which the derivative of a copy of the motion agrees to 1e-3 of the largest, 0 where it never does."""
        # A copy as for the horizon of the motion: rounded otherwise, or with other segments.
        t, system, t_end = self.t, self._system, float(self.reference.provenance["t_end"])
        copy = Solver(system).perturbed(COPY, 1).solve(t_end)
        tangent = Tangent(self.tangent.variation, path_of_solution(system, copy, t_end))
        other = Derivative(self.reference, self.wrt, t, self.bounds, self.exists_until, self.reason, tangent)
        # Until a wave arrives the terms of the tip cancel to rounding.
        variation, modes = self.tangent.variation, self._at_outputs[1][:, 1:, : self.tangent.variation.n]
        row = variation.free.rows[0] if system.observe is None else variation.data.observe
        terms = np.abs(modes) @ np.abs(row) + np.abs(self.tip - modes @ row)
        scale = AGREEMENT * np.nan_to_num(np.abs(self.tip)) + GRAZE * np.nan_to_num(terms)
        apart = np.abs(other.tip - self.tip) > np.maximum.accumulate(scale, axis=0)
        wrong = np.flatnonzero(np.any(apart, axis=1) | (t >= self.exists_until))
        known = float(t[max(0, wrong[0] - 1)]) if len(wrong) else float(t[-1])
        return min(known, self.reference.horizon) if np.isfinite(self.reference.horizon) else known


def maxima(p: Array, h: Array) -> tuple[IntArray, Array]:
    """The inner maxima of polynomials p (K, S) on [0, h], h (S,): the number of each and its place."""
    rate = np.arange(1.0, len(p))[:, None] * p[1:]

    def rising(s: Array, which: Any) -> NDArray[np.bool_]:
        return np.polynomial.polynomial.polyval(s, rate[:, which], tensor=False) > 0.0

    edges = np.multiply.outer(np.linspace(0.0, 1.0, 1 + LOOKS), h)
    up = np.array([rising(s, slice(None)) for s in edges])
    part, which = np.nonzero(up[:-1] & ~up[1:])
    low, high = edges[part, which], edges[part + 1, which]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        before = rising(middle, which)
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return which, high


def chatter_ends(solution: Motion) -> list[float]:
    """Times at which impacts on a rigid stop have accumulated: 2 v/(a (1 - e)) after the one behind which the contact
    is held, which would have left it with v under the acceleration a into the stop."""
    times, contacts, sides, marks = solution.events
    meet, blows, ends = solution.made.free.meet, solution.blows, []
    for t, i, side, mark in zip(times.tolist(), contacts.tolist(), sides.tolist(), marks.tolist(), strict=True):
        e = float(solution.system.contacts[i].stops.restitution or 0.0)
        if abs(side) != 1 or e == 0.0:
            continue
        held = np.flatnonzero(solution.sides[solution.piece_at(np.array([t]))[0]])
        speed = np.abs(blows.before[(blows.mark == mark) & (blows.contact == i)])
        if i in held and len(speed) and e < 1.0:
            reaction = abs(float(solution.reactions(np.array([t]))[0, i]))
            pull = reaction / float(np.linalg.inv(meet[np.ix_(held, held)])[held == i, held == i][0])
            t += 2.0 * float(speed[-1]) / (pull * (1.0 - e)) if pull > 0.0 else 0.0
        ends.append(t)
    return ends


def derivative(reference: Reference, wrt: Sequence[Any], t: Array) -> Derivative:
    """Derivatives of an exact solution, see ``Reference.derivative``."""
    system, solution = reference.system, reference.solution
    assert system is not None
    if not isinstance(solution, Motion):
        rule, remedy = 'be of method "exact" and solved in this process for a derivative', "take stiffbeam.reference"
        raise InputError("reference", reference.provenance["method"], rule, remedy)
    names, columns, bounds = slopes(system, wrt)
    t_end = float(reference.provenance["t_end"])
    path = path_of_solution(system, solution, t_end)
    size = (2.0 * system.size + 8.0) * len(names)
    afford("wrt", len(names), "ask for fewer parameters", floats=3.0 * size * len(path.times))
    tangent = Tangent(Variation(system, columns), path)
    exists, reason = min(ends_of(system, solution, tangent), default=(np.inf, ""))
    return Derivative(reference, tuple(names), t, bounds, exists, reason, tangent)


def ends_of(system: System, solution: Any, tangent: Tangent) -> list[tuple[float, str]]:
    """Times from which a motion has no derivative, each with the reason.

    Undamped compliant stops have none of these: their force is continuous, and so is the derivative of the flow.
    """
    ends = [(t, "a contact grazes its stop") for t in tangent.grazes]
    ends += [(t, "two impacts at one time change each other") for t in tangent.ties]
    if system.rigid:
        ends += [(t, "the impacts of a chatter end") for t in chatter_ends(solution)]
        if 0 in tangent.path.hits:
            ends.append((0.0, "an impact at the start"))
    # On rigid and damped stops velocity or force jumps: a near miss is another motion than an impact.
    for contact, stops in enumerate(x.stops for x in system.contacts):
        if stops.rigid or stops.damping > 0.0:
            for side, _ in stops.sides:
                ends += [(t, "a contact grazes its stop") for t in near_misses(tangent, contact, side)]
                if starts_on_stop(tangent, contact, side):
                    ends.append((0.0, "a contact starts on its stop, which the parameter moves away or into it"))
    return ends


def near_misses(tangent: Tangent, contact: int, side: int) -> list[float]:
    """Times at which an open contact reaches its stop to rounding and turns back."""

    def near(owner: IntArray, t: Array) -> NDArray[np.bool_]:
        found = np.zeros(len(t), bool)
        for part, series in tangent.expanded(owner, t, tangent.states(t, owner), K=2):
            depth, size = side * tangent.gap(series, contact, side)[0, :, 0], tangent.size(series, contact, side)
            found[part] = depth > -tangent.graze * size
        return found

    segments = np.flatnonzero((tangent.path.sides[:, contact] == 0) & (tangent.lengths > 0.0))
    owner, at, h, z = tangent.cut(segments)
    tops, segment = [np.zeros(0)], [np.zeros(0, np.int64)]
    for part, series in tangent.expanded(owner, at, z):
        which, s = maxima(side * tangent.gap(series, contact, side)[:, :, 0], h[part])
        tops.append(at[part[which]] + s)
        segment.append(owner[part[which]])
    top, own = np.concatenate(tops), np.concatenate(segment)
    # Of a contact that leaves its stop slowly rounding makes maxima: half the way to one of these it is no farther.
    return top[near(own, top) & ~near(own, 0.5 * (tangent.path.times[own] + top))].tolist()


def starts_on_stop(tangent: Tangent, contact: int, side: int) -> bool:
    """Return True if a contact starts on its stop to rounding, and its gap there depends on a parameter."""
    variation, n, series = tangent.variation, tangent.variation.n, tangent.at_start(0)
    row, z, dz = variation.free.rows[contact], tangent.z[0], tangent.dz[0]
    gap, size = tangent.gap(series, contact, side)[:2, 0], float(tangent.size(series, contact, side)[0])
    if abs(float(gap[0, 0])) > tangent.graze * size:
        return False
    speeds = np.abs(row) @ np.abs(z[n:]) + abs(float(gap[1, 0] - row @ z[n:]))
    # At rest there, a rigid contact is hit or leaves as the speed is turned.
    both = tangent.rigid and abs(float(gap[1, 0])) <= tangent.graze * speeds
    for k, part in enumerate([slice(0, n), slice(n, 2 * n)][: 1 + both]):
        # Sums far below their terms are cancellation: the gap does not depend on the parameter.
        terms = np.abs(dz[:, part]) @ np.abs(row) + np.abs(gap[k, 1:] - dz[:, part] @ row)
        if np.any(np.abs(gap[k, 1:]) > 1e-12 * terms):
            return True
    return False
