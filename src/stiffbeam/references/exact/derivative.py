"""Derivatives of the exact solution in initial data and parameters: ``reference.derivative``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.resources import afford
from ...basics.validation import InputError, sequence
from ...model.system import System
from ...model.system_data import slopes
from ...piecewise.generator import Generators
from ...piecewise.measures import panels
from ...piecewise.motion import Motion
from ...piecewise.rounding import Perturbation
from ...piecewise.tangent import Path, Tangent
from ...piecewise.tracer import tracer_of
from ...trajectory.trajectory import Reference
from .impacted import Solution as Impacted
from .impacting import Tracer as ImpactTracer

NODES, WEIGHTS = np.polynomial.legendre.leggauss(10)
PER_PERIOD = 12  # samples of a force in the shortest period, among which its peak is looked for
STEPS = 12  # of Newton's method for a peak: two samples bracket it to a twelfth of a period
RIVALS = 1e-9  # relative distance of two peaks below which the larger is not known
AGREEMENT = 1e-3  # of the largest derivative so far: two copies that differ by more are past the horizon
COPY = 4.0 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class ContactDerivative:
    """Derivatives of the impacts of one contact, (impacts, columns) each; NaN where there is none.

    times: of the entries, NaN at a graze. peaks: of the largest |force|, NaN for rigid stops, for a contact that is
    open at the end, and where two peaks are equal. impulses: of the integral of |force|.
    """

    times: Array
    peaks: Array
    impulses: Array


@dataclass(frozen=True, eq=False)
class Derivative:
    """Derivatives of a Reference in the parameters ``wrt``, columns last.

    tip, tip_velocity, energy: (times, columns), at fixed times, those of the reference. state: two arrays
    (times, n, columns), of q and q'. contacts: see ``ContactDerivative``; impact_times, peaks and impulses are those of
    the first contact. bounds: (columns,), relative error of the derivatives of the system's data. exists_until: the
    first time from which no derivative exists, with ``reason``; values after it are NaN. horizon: the time to which
    the derivative of a copy, perturbed by rounding, agrees to 1e-3; past it, it is that of another motion.
    """

    reference: Reference
    wrt: tuple[str, ...]
    bounds: Array
    exists_until: float
    reason: str
    tangent: Tangent
    columns: Sequence[Any]

    def __repr__(self) -> str:
        until = "" if np.isinf(self.exists_until) else f", exists until t = {self.exists_until:.6g}: {self.reason}"
        return f"<Derivative in {', '.join(self.wrt)}{until}>"

    def _masked(self, t: Array, values: Array) -> Array:
        values[t >= self.exists_until] = np.nan
        return values

    @cached_property
    def _tip(self) -> tuple[Array, Array]:
        generators, t = self.tangent.generators, self.reference.t

        def forms(segment: int) -> tuple[Array, list[Array]]:
            own, derived = generators.forms(self.tangent.intervals[segment])
            tip, tips = own.positions[-1], [x.positions[-1] for x in derived]
            rate, rates = generators.rate(tip, tips)
            return np.array([tip, rate]), [np.array(x) for x in zip(tips, rates, strict=True)]

        _, derived = self.tangent.read(forms, t)
        derived = self._masked(t, derived)
        return derived[:, 0], derived[:, 1]

    @property
    def tip(self) -> Array:
        """Derivative of the tip at the reference's times, (times, columns)."""
        return self._tip[0]

    @property
    def tip_velocity(self) -> Array:
        """Derivative of the tip's velocity, (times, columns)."""
        return self._tip[1]

    @cached_property
    def state(self) -> tuple[Array, Array]:
        """Derivatives of q and q', (times, n, columns) each."""
        generators, t = self.tangent.generators, self.reference.t
        n, columns = generators.n, len(self.wrt)
        afford("wrt", columns, "ask for fewer parameters or times", floats=4.0 * len(t) * n * columns)
        eye, none = np.eye(2 * n, generators.N), np.zeros((2 * n, generators.N))
        _, derived = self.tangent.read(lambda _: (eye, [none] * generators.count), t)
        derived = self._masked(t, derived)
        return derived[:, :n], derived[:, n:]

    @cached_property
    def energy(self) -> Array:
        """Derivative of the energy, kinetic, elastic and of the stops, (times, columns)."""
        generators, t, system = self.tangent.generators, self.reference.t, self._system
        q, v = self.reference.states
        dq, dv = self.state
        total = np.einsum("ti,tip->tp", v @ system.mass, dv) + np.einsum("ti,tip->tp", q @ system.stiffness, dq)
        for p, column in enumerate(generators.columns):
            total[:, p] += 0.5 * np.sum(v * (v @ column.mass), axis=1) + 0.5 * np.sum(
                q * (q @ column.stiffness), axis=1
            )
        for i, contact in enumerate(system.contacts):
            if contact.stops.rigid:
                continue
            for side in (-1, 1):
                if not np.isfinite(contact.stops.g2 if side > 0 else contact.stops.g1):
                    continue

                def forms(segment: int, i: int = i, side: int = side) -> tuple[Array, list[Array]]:
                    own, derived = generators.gap(i, side, self.tangent.intervals[segment])
                    return own[None], [x[None] for x in derived]

                depth, slope = self.tangent.read(forms, t)
                depth = np.maximum(side * depth[:, 0], 0.0)
                total += float(contact.stops.stiffness) * depth[:, None] * side * slope[:, 0]
                for p, column in enumerate(generators.columns):
                    total[:, p] += 0.5 * column.kappa[i] * depth**2
        return self._masked(t, total)

    @property
    def _system(self) -> System:
        assert self.reference.system is not None
        return self.reference.system

    @cached_property
    def contacts(self) -> tuple[ContactDerivative, ...]:
        """Derivatives at every contact."""
        rigid = self.tangent.path.rigid
        return tuple((self._struck if rigid else self._pressed)(i) for i in range(len(self._system.contacts)))

    @property
    def impact_times(self) -> Array:
        """Derivatives of the impact times of the first contact, (impacts, columns)."""
        return self.contacts[0].times

    @property
    def peaks(self) -> Array:
        """Derivatives of the peak forces of the first contact, (impacts, columns)."""
        return self.contacts[0].peaks

    @property
    def impulses(self) -> Array:
        """Derivatives of the impulses of the first contact, (impacts, columns)."""
        return self.contacts[0].impulses

    def _struck(self, i: int) -> ContactDerivative:
        """Impacts on a rigid stop: a contact that is held after one has an impulse in time, which has none here."""
        impacts, columns = self.reference.contacts[i].impacts, len(self.wrt)
        times, impulses = np.full((2, len(impacts.times), columns), np.nan)
        starts = self.tangent.path.times
        for k, (t, end) in enumerate(zip(impacts.times.tolist(), impacts.ends.tolist(), strict=True)):
            if t >= self.exists_until:
                continue
            at = [s for s in np.flatnonzero(starts == t).tolist() if i in self.tangent.impulses.get(s, {})]
            if at:
                value, slope = self.tangent.impulses[at[0]][i]
                times[k] = self.tangent.event_slopes[at[0]]
                impulses[k] = np.sign(value) * slope if end == t else np.nan
        return ContactDerivative(times, np.full_like(times, np.nan), impulses)

    def _pressed(self, i: int) -> ContactDerivative:
        """Impacts on a compliant stop."""
        tangent, impacts, columns = self.tangent, self.reference.contacts[i].impacts, len(self.wrt)
        times, leaving = np.full((2, len(impacts.times), columns), np.nan)
        spans = []  # impact, first segment and the one after the last
        for k, (start, end) in enumerate(zip(impacts.times.tolist(), impacts.ends.tolist(), strict=True)):
            first = self._segment_of_change(start, i)
            if start > 0.0:
                times[k] = tangent.event_slope(first, i)
            if not np.isnan(end):
                last = self._segment_of_change(end, i)
                leaving[k] = tangent.event_slope(last, i)
                spans.append((k, first, last))
        peaks, impulses = np.full((2, len(impacts.times), columns), np.nan)
        if spans:
            pressed = [(k, s) for k, a, b in spans for s in range(a, b) if tangent.lengths[s] > 0.0]
            owner, segments = np.array(pressed).T
            self._forces(i, owner, segments, (times, leaving), peaks, impulses)
        return ContactDerivative(times, peaks, impulses)

    def _segment_of_change(self, t: float, contact: int) -> int:
        """The segment with which a contact changes at t."""
        path = self.tangent.path
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
            own, derived = generators.pressure(i, side, tangent.intervals[segment])
            return side * own[None], [side * x[None] for x in derived]

        motion: Motion = self.reference.solution
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
            at_entry = tangent.values(forms, starts[first], segments[first])
            at_exit = tangent.values(forms, ends[last], segments[last])
            impulses[impacts] += np.nan_to_num(at_exit * leaving[impacts]) - at_entry * entering[impacts]
        # Every sample before which the force rises and after which it does not brackets a peak.
        count = 2 + np.ceil((ends - starts) / motion.shortest_period * PER_PERIOD).astype(int)
        which = np.repeat(np.arange(len(segments)), count)
        step = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        t = starts[which] + (ends - starts)[which] * step / (count[which] - 1)
        rising = tangent.values(forms, t, segments[which], 1)[:, 0] > 0.0
        at = np.flatnonzero(rising[:-1] & ~rising[1:] & (which[:-1] == which[1:]))
        low, high, place = t[at], t[at + 1], which[at]
        top = 0.5 * (low + high)
        for _ in range(STEPS):  # Newton's method in a bracket
            rate, curve = (tangent.values(forms, top, segments[place], order)[:, 0] for order in (1, 2))
            low, high = np.where(rate > 0.0, top, low), np.where(rate > 0.0, high, top)
            step = -rate / np.where(curve < 0.0, curve, -np.inf)
            top = np.where(curve < 0.0, np.clip(top + step, low, high), 0.5 * (low + high))
        every = np.concatenate([top, starts, ends]), np.concatenate([place, *[np.arange(len(segments))] * 2])
        value, slope = (x[:, 0] for x in tangent.read(forms, every[0], segments[every[1]]))
        rate = tangent.values(forms, every[0], segments[every[1]], 1)
        for impact, begin, end in zip(impacts.tolist(), starts[first].tolist(), ends[last].tolist(), strict=True):
            mine = np.flatnonzero(owner[every[1]] == impact)
            best = mine[np.argmax(value[mine])]
            rivals = (value[mine] > value[best] * (1.0 - RIVALS)) & (
                np.abs(every[0][mine] - every[0][best]) > 1e-6 * (end - begin)
            )
            moves = rate[best] * entering[impact] if every[0][best] == begin else 0.0
            peaks[impact] = np.nan if np.any(rivals) else slope[best] + moves

    @cached_property
    def horizon(self) -> float:
        """Time to which the derivative of a copy of the motion agrees to 1e-3 of the largest, 0 where it never does."""
        t, system = self.reference.t, self._system
        if self.tangent.path.rigid:
            copy: Any = ImpactTracer(system, 0.7, 4.0, 1).solve(float(self.reference.provenance["t_end"]))
        else:
            copy = tracer_of(system, Perturbation(COPY, COPY, 1)).solve(float(self.reference.provenance["t_end"]))
        path = path_of_solution(system, copy, self.tangent.path.t_end)
        other = Tangent(self.tangent.generators, path)
        there = Derivative(self.reference, self.wrt, self.bounds, self.exists_until, self.reason, other, self.columns)
        largest = np.maximum.accumulate(np.nan_to_num(np.abs(self.tip)), axis=0)
        apart = np.abs(there.tip - self.tip) > AGREEMENT * largest + 1e-300
        wrong = np.flatnonzero(np.any(apart, axis=1) | (t >= self.exists_until))
        known = float(t[max(0, wrong[0] - 1)]) if len(wrong) else float(t[-1])
        return min(known, self.reference.horizon) if np.isfinite(self.reference.horizon) else known


def path_of_solution(system: System, solution: Any, t_end: float) -> Path:
    """Segments of an exact solution, compliant or rigid."""
    if isinstance(solution, Impacted):
        sides = np.zeros((len(solution.times), len(system.contacts)), np.int64)
        for k, held in enumerate(solution.held):
            sides[k, list(held)] = 1
        hits: dict[int, list[int]] = {}
        for segment, contact in solution.blows:
            hits.setdefault(segment, [])
            if contact not in hits[segment]:
                hits[segment].append(contact)
        q, v = (np.array(x) for x in zip(*solution.states, strict=True))
        return Path(np.array(solution.times), sides, q, v, t_end, True, hits)
    count = int(np.searchsorted(solution.times, t_end, side="left"))
    times = solution.times[: max(1, count)]
    q, v = solution.states_in(times, np.arange(len(times)))
    return Path(times, solution.sides[: len(times)], q, v, t_end)


def derivative(reference: Reference, wrt: Sequence[str]) -> Derivative:
    """See ``Reference.derivative``."""
    remedy = 'for example ["stops.stiffness", "initial_velocity"]'
    paths = [wrt] if isinstance(wrt, str) else list(sequence("wrt", wrt, "be paths to parameters", remedy))
    if not paths or not all(isinstance(path, str) for path in paths):
        raise InputError("wrt", wrt, "be paths to parameters", remedy)
    system, solution = reference.system, reference.solution
    if system is None or not isinstance(solution, (Motion, Impacted)):
        rule = 'be asked of a reference of method "exact" in this process'
        raise InputError("derivative", reference.provenance["method"], rule, 'take reference(..., method="exact")')
    names, columns, bounds = slopes(system, paths)
    t_end = float(reference.provenance["t_end"])
    path = path_of_solution(system, solution, t_end)
    size = (2.0 * system.size + 8.0) * len(names)
    afford("wrt", len(names), "ask for fewer parameters", floats=3.0 * size * len(path.times))
    exists, reason = np.inf, ""
    if isinstance(solution, Impacted):
        ends = [
            (min((t for t, _ in solution.stuck), default=np.inf), "the impacts of a chatter end"),
            (solution.tie, "two contacts close together, and their order decides"),
            (0.0 if 0 in path.hits else np.inf, "an impact at the start"),
        ]
        exists, reason = min(ends)
    tangent = Tangent(Generators(system, columns), path)
    if tangent.grazes and tangent.grazes[0] < exists:
        exists, reason = tangent.grazes[0], "a contact grazes its stop"
    return Derivative(
        reference, tuple(names), bounds, float(exists), reason if np.isfinite(exists) else "", tangent, columns
    )
