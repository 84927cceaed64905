"""Derivatives of the exact solution with respect to initial data and parameters: ``reference.derivative``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.resources import afford
from ...basics.validation import InputError
from ...model.modes import undamped_modes
from ...model.system import System
from ...model.system_data import slopes
from ...trajectory.trajectory import Reference
from .contacts import NODES, WEIGHTS, panels
from .generator import Generators
from .motion import Motion, Solver
from .tangent import Forms, Path, Tangent

PER_PERIOD = 12  # samples in the shortest period, among which a peak is looked for
STEPS = 24  # of Newton's method for a peak: two samples bracket it to a twelfth of a period
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
    def _tip(self) -> tuple[Array, Array]:
        generators = self.tangent.generators

        def forms(segment: int) -> tuple[Array, list[Array]]:
            of_interval, derived = generators.forms(self.tangent.intervals[segment])
            tip, tips = of_interval.positions[-1], [x.positions[-1] for x in derived]
            rate, rates = generators.rate(tip, tips)
            return np.array([tip, rate]), [np.array(x) for x in zip(tips, rates, strict=True)]

        _, derived = self.tangent.read(forms, self.t)
        derived = self._masked(self.t, derived)
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
        generators, size = self.tangent.generators, 2 * self.tangent.generators.n
        afford(
            "wrt", len(self.wrt), "ask for fewer parameters or times", floats=4.0 * len(self.t) * size * len(self.wrt)
        )
        eye, none = np.eye(size, generators.N), np.zeros((size, generators.N))
        _, derived = self.tangent.read(lambda _: (eye, [none] * generators.count), self.t)
        return self._masked(self.t, derived)

    @cached_property
    def energy(self) -> Array:
        """Derivative of the energy, kinetic, elastic and of the stops, (k, p)."""
        generators, t, system = self.tangent.generators, self.t, self._system
        n = generators.n
        q, v = self.tangent.states(t)[:, :n], self.tangent.states(t)[:, n : 2 * n]
        dq, dv = np.split(self.state, 2, axis=1)
        # dE = q'.M dq' + q.K dq, and the parts of parameters that change M and K.
        total = np.einsum("ti,tip->tp", v @ system.mass, dv) + np.einsum("ti,tip->tp", q @ system.stiffness, dq)
        for p, column in enumerate(generators.columns):
            kinetic, elastic = np.sum(v * (v @ column.mass), axis=1), np.sum(q * (q @ column.stiffness), axis=1)
            total[:, p] += 0.5 * (kinetic + elastic)
        # Compliant stops: E = kappa d^2/2 at the depth d beyond the stop.
        for i, contact in enumerate(system.contacts):
            if contact.stops.rigid:
                continue
            for side, _ in contact.stops.sides:
                depth, slope = self.tangent.read(gap_forms(self.tangent, i, side), t)
                depth = np.maximum(depth[:, 0], 0.0)
                total += float(contact.stops.stiffness) * depth[:, None] * slope[:, 0]
                for p, column in enumerate(generators.columns):
                    total[:, p] += 0.5 * column.kappa[i] * depth**2
        return self._masked(t, total)

    @property
    def _system(self) -> System:
        assert self.reference.system is not None
        return self.reference.system

    @cached_property
    def _events(self) -> list[tuple[int, int]]:
        """(segment, contact) of every opening and closing, in order."""
        path = self.tangent.path
        changed = path.sides[1:] != path.sides[:-1]
        # Impacts that hold nothing change no side.
        for segment, contacts in path.hits.items():
            for contact in contacts:
                changed[segment - 1, contact] |= segment > 0 and path.sides[segment - 1][contact] == 0
        return [(int(k) + 1, int(contact)) for k, contact in zip(*np.nonzero(changed), strict=True)]

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
        read = self._struck if self.tangent.path.rigid else self._pressed
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
        generators, sides = tangent.generators, tangent.path.sides[:, i]

        def forms(segment: int) -> tuple[Array, list[Array]]:
            side = int(sides[segment])
            force, derived = generators.pressure(i, side, tangent.intervals[segment])
            return side * force[None], [side * x[None] for x in derived]

        # Impulse: Gauss quadrature of the derivative of the force, by panels.
        motion = self.reference.solution
        starts = tangent.path.times[segments]
        ends = starts + tangent.lengths[segments]
        index, left, width = panels(motion.shortest_period, starts, ends, motion.fastest_decay)
        t = (left[:, None] + width[:, None] * (NODES + 1.0) / 2.0).ravel()
        slope = tangent.read(forms, t, segments[index].repeat(len(NODES)))[1][:, 0].reshape(len(left), len(NODES), -1)
        impacts = np.unique(owner)
        impulses[impacts] = 0.0
        np.add.at(impulses, owner[index], np.einsum("kjp,j,k->kp", slope, WEIGHTS / 2.0, width))
        first = np.searchsorted(owner, impacts)
        last = np.searchsorted(owner, impacts, side="right") - 1
        if generators.data.c[i] > 0.0:  # the force jumps at the entry
            # Leibniz's rule: the ends of the integral move with the events.
            at_entry = tangent.values(forms, starts[first], segments[first])
            at_exit = tangent.values(forms, ends[last], segments[last])
            impulses[impacts] += np.nan_to_num(at_exit * leaving[impacts]) - at_entry * entering[impacts]
        # Peak: the largest of the inner maxima and of the values at the ends of segments.
        top, place = tops(tangent, forms, segments, motion.shortest_period)
        times = np.concatenate([top, starts, ends])
        place = np.concatenate([place, *[np.arange(len(segments))] * 2])
        value, slope = (x[:, 0] for x in tangent.read(forms, times, segments[place]))
        rate = tangent.values(forms, times, segments[place], 1)
        for impact, begin, end in zip(impacts.tolist(), starts[first].tolist(), ends[last].tolist(), strict=True):
            mine = np.flatnonzero(owner[place] == impact)
            # Rounding decides between two equal peaks: no derivative.
            best = mine[np.argmax(value[mine])]
            rivals = (value[mine] > value[best] * (1.0 - RIVALS)) & (
                np.abs(times[mine] - times[best]) > 1e-6 * (end - begin)
            )
            moves = rate[best] * entering[impact] if times[best] == begin else 0.0
            peaks[impact] = np.nan if np.any(rivals) else slope[best] + moves

    @cached_property
    def horizon(self) -> float:
        """Time to which the derivative of a copy of the motion agrees to 1e-3 of the largest, 0 where it never does."""
        # A copy as for the horizon of the motion: rounded otherwise, or with other segments.
        t, system, t_end = self.t, self._system, float(self.reference.provenance["t_end"])
        copy = Solver(system).perturbed(COPY, 1).solve(t_end)
        tangent = Tangent(self.tangent.generators, path_of_solution(system, copy, t_end))
        other = Derivative(self.reference, self.wrt, t, self.bounds, self.exists_until, self.reason, tangent)
        largest = np.maximum.accumulate(np.nan_to_num(np.abs(self.tip)), axis=0)
        apart = np.abs(other.tip - self.tip) > AGREEMENT * largest + 1e-300
        wrong = np.flatnonzero(np.any(apart, axis=1) | (t >= self.exists_until))
        known = float(t[max(0, wrong[0] - 1)]) if len(wrong) else float(t[-1])
        return min(known, self.reference.horizon) if np.isfinite(self.reference.horizon) else known


def gap_forms(tangent: Tangent, contact: int, side: int) -> Forms:
    """The depth of a contact beyond its stop, < 0 before it, as a form for every segment."""

    def forms(segment: int) -> tuple[Array, list[Array]]:
        gap, derived = tangent.generators.gap(contact, side, tangent.intervals[segment])
        return side * gap[None], [side * x[None] for x in derived]

    return forms


def tops(tangent: Tangent, forms: Forms, segments: IntArray, shortest: float) -> tuple[Array, IntArray]:
    """Times of the inner maxima of a form in segments (k,), and the index of the segment of each.

    Every sample before which the form rises and after which it does not brackets one; shortest: period.
    """
    starts, lengths = tangent.path.times[segments], tangent.lengths[segments]
    count = 2 + np.ceil(lengths / shortest * PER_PERIOD).astype(int)
    afford(
        "t_end", float(tangent.path.t_end), "shorten t_end", floats=4.0 * tangent.generators.N * float(np.sum(count))
    )
    which = np.repeat(np.arange(len(segments)), count)
    step = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    t = starts[which] + lengths[which] * step / (count[which] - 1)
    rising = tangent.values(forms, t, segments[which], 1)[:, 0] > 0.0
    at = np.flatnonzero(rising[:-1] & ~rising[1:] & (which[:-1] == which[1:]))
    low, high, place = t[at], t[at + 1], which[at]
    top = 0.5 * (low + high)
    for _ in range(STEPS):  # Newton's method in a bracket
        rate, curve = (tangent.values(forms, top, segments[place], order)[:, 0] for order in (1, 2))
        low, high = np.where(rate > 0.0, top, low), np.where(rate > 0.0, high, top)
        # Where Newton's method leaves the bracket, or the curvature is not negative: bisect.
        after = top - rate / np.where(curve < 0.0, curve, -np.inf)
        inside = (curve < 0.0) & (after >= low) & (after <= high)
        top = np.where(inside, after, 0.5 * (low + high))
    return top, place


def path_of_solution(system: System, solution: Motion, t_end: float) -> Path:
    """Segments of an exact solution, compliant or rigid, which also begin at the samples of records."""
    count = max(1, int(np.searchsorted(solution.times, t_end, side="left")))
    times, segments = solution.times[:count], np.arange(count)
    edges = np.setdiff1d(solution.drive.edges, times)
    edges = edges[(edges > 0.0) & (edges < t_end)]
    place = np.searchsorted(times, edges, "right")
    times, segments = np.insert(times, place, edges), np.insert(segments, place, place - 1)
    q, v = solution.states_in(times, segments)
    if not system.rigid:
        return Path(times, solution.sides[segments], q, v, t_end)
    hits: dict[int, list[int]] = {}
    # A contact may take two blows at one time, for example where it is then held: it is hit once.
    first = {int(mark): k for k, mark in reversed(list(enumerate(solution.first_mark[segments].tolist())))}
    for mark, contact in dict.fromkeys(zip(solution.blows.mark.tolist(), solution.blows.contact.tolist(), strict=True)):
        if mark in first:
            hits.setdefault(first[mark], []).append(contact)
    return Path(times, np.abs(solution.sides[segments]), q, v, t_end, True, hits)


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


def derivative(reference: Reference, wrt: Sequence[str], t: Array) -> Derivative:
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
    tangent = Tangent(Generators(system, columns), path)
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
                ends += [(t, "a contact grazes its stop") for t in near_misses(system, tangent, contact, side)]
                if starts_on_stop(tangent, contact, side):
                    ends.append((0.0, "a contact starts on its stop, which the parameter moves away or into it"))
    return ends


def near_misses(system: System, tangent: Tangent, contact: int, side: int) -> list[float]:
    """Times at which an open contact reaches its stop to rounding and turns back."""
    path, forms = tangent.path, gap_forms(tangent, contact, side)
    segments = np.flatnonzero((path.sides[:, contact] == 0) & (tangent.lengths > 0.0))
    if not len(segments):
        return []
    # Samples must resolve the free modes, the drive and every regime on the way.
    waves = tangent.generators.basis.frequencies
    fastest = max(float(undamped_modes(system).omega[-1]), float(np.max(waves, initial=0.0)))
    fastest = max(fastest, *(tangent.regimes[group[0]].fastest for group in tangent.groups.values()))
    shortest = 2.0 * np.pi / max(fastest, 1e-300)
    top, place = tops(tangent, forms, segments, shortest)
    if not len(top):
        return []
    # Of a contact that leaves its stop slowly rounding makes maxima: half the way to one of these it is no farther.
    half = 0.5 * (path.times[segments[place]] + top)
    near = np.ones(len(top), bool)
    for times, closer in ((top, True), (half, False)):
        for k, (segment, z) in enumerate(zip(segments[place], tangent.states(times, segments[place]), strict=True)):
            gap = forms(int(segment))[0][0]
            near[k] &= (gap @ z > -tangent.graze * (np.abs(gap) @ np.abs(z))) == closer
    return top[near].tolist()


def starts_on_stop(tangent: Tangent, contact: int, side: int) -> bool:
    """Return True if a contact starts on its stop to rounding, and its gap there depends on a parameter."""
    path, generators = tangent.path, tangent.generators
    gap, gaps = generators.gap(contact, side, tangent.intervals[0])
    Z, dZ = tangent.Z[0], tangent.dZ[0]
    if abs(float(gap @ Z)) > tangent.graze * float(np.abs(gap) @ np.abs(Z)):
        return False
    forms, speed = [(gap, gaps)], generators.rate(gap, gaps)
    if path.rigid and abs(float(speed[0] @ Z)) <= tangent.graze * float(np.abs(speed[0]) @ np.abs(Z)):
        forms.append(speed)  # at rest there, it is hit or leaves as the speed is turned
    for form, derived in forms:
        # Sums far below their terms are cancellation: the gap does not depend on the parameter.
        terms = np.abs(form) @ np.abs(dZ)
        for p, each in enumerate(derived):
            terms[p] += np.abs(each) @ np.abs(Z)
        if np.any(np.abs(tangent.slope_of(form, derived, Z, dZ)) > 1e-12 * terms):
            return True
    return False
