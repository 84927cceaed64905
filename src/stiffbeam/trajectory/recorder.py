"""The contacts of a fixed-step run, as records."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array, step_lengths
from ..basics.validation import InputError, numbers, sequence
from ..kernels.contact import contact_forces
from ..kernels.march import EVENT, switch_time
from ..model.contact import Stops, channel_motion, side_at_start
from ..model.contact_law import all_laws, jumps
from ..model.system import System, require_system
from ..model.time_functions import offset_rate
from .records import ContactRecord, Impacts, Ledger, step_ledger
from .sampling import (
    AT_START,
    CONTACT,
    END,
    IMPACT_IMPULSE,
    IMPACT_PEAK,
    IMPULSE,
    LAST,
    MEMBER,
    PEAK,
    ROW,
    SIDE,
    SINCE,
    STOP,
    TIME,
    TOUCHING,
)

AT_REST = 1e-12  # of a position: so near a rigid stop a body is on it


def impacts_of(events: Array) -> Impacts:
    """Rows of a list of events of one contact as sampled impacts."""
    times, stops, peaks, impulses, ends = events[:, TIME : END + 1].T.copy()  # the columns side by side
    sides = stops.astype(np.int64)
    rows = Impacts(times=times, ends=ends, stops=sides, peaks=peaks, impulses=impulses, kind="sampled")
    first = times == AT_START
    return rows.started(first) if np.any(first) else rows


def forces_at(u: Array, v: Array, law: Array) -> Array:
    """F (M, m) on the bodies at positions and velocities (M, C), the contacts first, under laws (M, m, 6)."""
    m = law.shape[1]
    return contact_forces(u[:, :m], v[:, :m], law)


def events_at_start(tally: Array, law: Array, dt: float, first: tuple[Array, Array], means: bool) -> Array:
    """Rows of the contacts that are there at t = 0, open, to begin the list of events with; new tallies (M, m, 8) get
    their numbers. Peak and impulse begin with those of the force there, as in ``with_ends``."""
    if not np.any(tally[..., SIDE]):
        return np.zeros((0, EVENT))
    # A tally that begins later leaves out the contact at t = 0.
    member, contact = np.nonzero((tally[..., SIDE] != 0.0) & (tally[..., SINCE] == 0.0))
    size = np.abs(forces_at(*first, law))[member, contact]
    rows = np.zeros((len(member), EVENT))
    rows[:, MEMBER], rows[:, CONTACT], rows[:, TIME], rows[:, END] = member, contact, AT_START, -1.0
    rows[:, STOP], rows[:, IMPACT_PEAK] = tally[member, contact, SIDE], size
    rows[:, IMPACT_IMPULSE] = 0.0 if means else 0.5 * dt * size
    tally[member, contact, ROW] = np.arange(len(member))
    return rows


def with_ends(
    tally: Array, law: Array, dt: float, first: tuple[Array, Array], last: tuple[Array, Array], means: bool,
    any_jumps: bool,
) -> Array:  # fmt: skip
    """The tallies (M, m, 8) of steps 1 to n as those of whole runs. first, last: (u, u'), each (M, C) with the contacts
    first, at t = 0 and at the last step. The largest force may be that at the start, and the impulse is the trapezoidal
    rule's, but of means. A tally that begins later stays. any_jumps: True where a law's force jumps."""
    tally = tally.copy()
    peak, impulse, whole = tally[..., PEAK], tally[..., IMPULSE], tally[..., SINCE] == 0.0
    begin, end = (np.abs(forces_at(*motion, law)) for motion in (first, last))
    # A force that jumps does not follow from the last state: the tally keeps it.
    if any_jumps:
        end = np.where(jumps(all_laws(law)), tally[..., LAST], end)
    np.fmax(begin, peak, out=peak, where=whole)
    # The tally sums dt |F| over steps 1 to n; the trapezoidal rule takes half of that at n and half of that at 0.
    if not means:
        with np.errstate(over="ignore", invalid="ignore"):
            np.add(impulse, 0.5 * dt * (begin - end), out=impulse, where=whole)
    return tally


def shares(tally: Array, steps: int) -> Array:
    """The share of the steps in contact, of those after SINCE."""
    return tally[..., TOUCHING] / np.maximum(1.0, steps - tally[..., SINCE])


def record(
    stops: Stops,
    position: Array,
    velocity: Array,
    tally: Array,
    events: Array,
    steps: int,
    node_forces: Array | None = None,
    force: Array | None = None,
) -> ContactRecord:
    """With position and velocity at the output times, and the forces that nodes have there, NaN for none, see
    ``force_of_node``; ``steps`` of the whole run. ``force``: at the output times, where it has been computed."""
    if force is None:
        with np.errstate(over="ignore", invalid="ignore"):  # of which ``overflow`` tells
            force = stops.force(position, velocity)
    # A force that jumps does not follow from the state: the node's counts where there is one.
    if node_forces is not None and stops.jumps:
        force = np.where(np.isnan(node_forces), force, node_forces)
    return ContactRecord(
        stops=stops,
        position=position,
        velocity=velocity,
        force=force,
        impacts=impacts_of(events),
        fraction=float(shares(tally, steps)),
        peak_force=float(tally[PEAK]),
        impulse=float(tally[IMPULSE]),
    )


def overflow(contacts: Sequence[ContactRecord], t_end: float) -> float:
    """Time at which a force overflowed although no position did: the first impact whose impulse is beyond float64, at
    the latest t_end. NaN if none did."""
    if all(np.isfinite(contact.impulse) for contact in contacts):
        return float("nan")
    return min((float(t) for c in contacts for t in c.impacts.times[np.isinf(c.impacts.impulses)]), default=t_end)


def contact_spans(t: Array, u: Array, v: Array, stops: Stops) -> Array:
    """Spans of contact in positions u (k,) and velocities v (k,) at increasing times t (k,), one row (6,) a span.

    Columns: the first step in contact; the first step after it, k of an open span; the times of entry and exit, an
    exit NaN of an open span; the side, +1 or -1; the impulse, the sum of |sigma| times the step length. Entry and exit
    are found by cubic Hermite interpolation over the interval's own length. A span with first step 0 is no impact:
    where t begins at 0 it is the contact that is there at the start.
    """
    law = stops.law
    chi = stops.state(u, v)
    # At the first time a position exactly on a stop is contact unless it leaves.
    chi[0] = side_at_start(u[0], v[0], stops.law)
    impulse = np.concatenate([[0.0], np.cumsum(np.abs(stops.force(u, v)) * step_lengths(t))])

    def switch(k: int, side: int) -> float:
        length = float(t[k] - t[k - 1])
        return float(t[k - 1]) + length * switch_time(u[k - 1], v[k - 1], u[k], v[k], side, law, length)

    # From change to change the contact keeps its side.
    changes = [0, *(np.flatnonzero(chi[1:] != chi[:-1]) + 1).tolist(), len(t)]
    rows = [
        (a, b, switch(a, side) if a else t[0], switch(b, side) if b < len(t) else np.nan, side, impulse[b] - impulse[a])
        for a, b in pairwise(changes)
        if (side := int(chi[a]))
    ]
    return np.array(rows, float).reshape(-1, 6)


def rebounds(t: Array, u: Array, v: Array | None, stops: Stops) -> Impacts:
    """Impacts on rigid stops in positions u (k,), velocities v (k,) or None, at increasing times t (k,).

    An impact is a step in which a body that approaches a stop, and would reach it within a step and a half, stops
    approaching. Its time is that at which the body would have been at the stop with the previous speed. A speed below a
    millionth of the largest is no approach: a body at rest on its stop may move by rounding. If velocities are not
    given, each side of the jump has its own differences.
    """
    step, rows = np.diff(t), np.zeros((0, 2))
    rates = np.diff(u) / step
    for sign, g in ((-1.0, stops.lower_bound), (1.0, stops.upper_bound)):
        if not np.isfinite(g):
            continue
        # Without velocities: the difference that leads to a time arrives, the one that follows it leaves.
        arriving, leaving = sign * np.append(0.0, rates), sign * np.append(rates, rates[-1])
        if v is not None:
            arriving = leaving = sign * v
        gap, rounding = sign * (g - u), AT_REST * max(abs(g), float(np.max(np.abs(u))))
        near = gap[:-1] <= 1.5 * step * np.maximum(arriving[:-1], 0.0) + rounding
        near[0] &= gap[0] > rounding  # a blow at t = 0 is no impact
        least = 1e-6 * np.max(np.abs(arriving))
        # Near the stop, approaching at the start of the step and no longer at its end.
        hit = np.flatnonzero(near & (arriving[:-1] > least) & (leaving[1:] <= least))
        if v is None:  # the difference across an impact may seem to arrive once more, or to leave before it
            again = np.flatnonzero(np.diff(hit) == 1)
            beyond = gap[hit[again]] > arriving[hit[again]] * step[hit[again]]
            hit = np.delete(hit, again + ~beyond)
        # The time at the stop at the speed of the approach, within the step.
        when = t[hit] + np.clip(gap[hit] / arriving[hit], 0.0, step[hit])
        rows = np.concatenate([rows, np.stack([when, np.full(len(hit), sign)], axis=1)])
    times, sides = rows[np.argsort(rows[:, 0], kind="stable")].T
    return Impacts.at(times, sides, "sampled")


def sampled_impacts(t: Array, u: Array, v: Array | None, stops: Stops) -> Impacts:
    """Sampled impacts in positions u (k,) and velocities v (k,) at increasing times t (k,); see ``rebounds``, where v
    may be None, for those on rigid stops."""
    if stops.rigid:
        return rebounds(t, u, v, stops)
    assert v is not None
    spans = contact_spans(t, u, v, stops)
    # A span that is there at the first time counts only at t = 0, as the contact at the start.
    first, after, times, ends, sides, impulses = spans[(spans[:, 0] > 0.0) | (t[0] == 0.0)].T
    size, ended = np.abs(stops.force(u, v)), ~np.isnan(ends)
    peaks = [float(np.max(size[a:b])) for a, b in zip(first.astype(int), after.astype(int), strict=True)]
    peaks, impulses = np.where(ended, peaks, np.nan), np.where(ended, impulses, np.nan)
    impacts = Impacts.at(times, sides, "sampled", ends=ends, peaks=peaks, impulses=impulses)
    return impacts.started(first == 0.0)


def sampled_record(t: Array, u: Array, v: Array, stops: Stops, smoothed: bool = False) -> ContactRecord:
    """Contact record of positions u (k,) and velocities v (k,) at increasing times t (k,).

    Against rigid stops positions tell impacts, not forces: these are NaN. smoothed: v is a spline's, which has no jump.
    """
    if stops.rigid:
        impacts, unknown = rebounds(t, u, None if smoothed else v, stops), float("nan")
        return ContactRecord(stops, u, v, np.full(len(t), np.nan), impacts, *3 * (unknown,))
    force = stops.force(u, v)
    size, lengths = np.abs(force), step_lengths(t)[1:]
    return ContactRecord(
        stops=stops,
        position=u,
        velocity=v,
        force=force,
        impacts=sampled_impacts(t, u, v, stops),
        # Every step counts by its end.
        fraction=float(np.average(stops.state(u[1:], v[1:]) != 0, weights=lengths)),
        peak_force=float(np.max(size)),
        impulse=float(np.trapezoid(size, t)),
    )


class Reactions:
    """Record of one contact from the mean reactions R of consecutive steps. Impacts are counted after step ``since``.

    An impact is a sequence of steps with R of one sign: it begins with the first and ends with the last of them. An
    impact before a contact at t = 0 has opened is part of that contact. A rigid stop has no largest force but an
    impulse, so peaks are NaN. The largest mean of a step, ``max(abs(force))``, grows like 1/dt.
    """

    def __init__(self, stops: Stops, dt: float, u0: float, v0: float, since: int = 0) -> None:
        self.stops, self.dt, self.since = stops, dt, since
        self._fed: list[Array] = []
        self._closed = bool(u0 <= stops.lower_bound or u0 >= stops.upper_bound)  # since t = 0
        self._last = -1  # the step in which that contact opens

    def feed(self, u: Array, means: Array) -> None:
        """Positions at the ends of the next steps (k,), and their reactions."""
        # The contact at t = 0 lasts to the first position between the stops.
        if self._closed:
            free = np.flatnonzero((u > self.stops.lower_bound) & (u < self.stops.upper_bound))
            self._closed = not len(free)
            self._last += len(u) if self._closed else 1 + int(free[0])
        self._fed.append(np.array(means, float))

    def record(self, position: Array, velocity: Array, every: int) -> ContactRecord:
        """Contact record with position, velocity and the reaction of the previous step at every ``every``-th step."""
        # R[n] belongs to step n; there is no reaction before the first.
        R = np.concatenate([[0.0], *self._fed])
        force = R[::every][: len(position)]
        R = R[1 + self.since :]
        size = np.abs(R)
        return ContactRecord(
            stops=self.stops,
            position=position,
            velocity=velocity,
            force=force,
            impacts=self._impacts(R),
            fraction=float(np.mean(R != 0.0)) if len(R) else 0.0,
            peak_force=float("nan") if np.any(size) else 0.0,
            impulse=float(np.sum(size) * self.dt),
        )

    def _impacts(self, R: Array) -> Impacts:
        before = np.concatenate([[0.0], *self._fed])[self.since]  # in the last step that does not count
        side = np.concatenate([[np.sign(before)], np.sign(R)])
        enters = np.flatnonzero((side[1:] != 0.0) & (side[1:] != side[:-1]))
        first = enters + self.since <= self._last
        # A record that begins later leaves out the contact at t = 0.
        if self.since:
            enters, first = enters[~first], first[~first]
        # The end of an impact is the first change after its beginning that leaves its side.
        leaves = np.flatnonzero((side[:-1] != 0.0) & (side[1:] != side[:-1]))
        # Impulses are differences of the sum over the steps.
        sizes = np.concatenate([[0.0], np.cumsum(np.abs(R))]) * self.dt
        ends = np.full(len(enters), len(R))
        nearest = np.searchsorted(leaves, enters, side="right")
        ended = nearest < len(leaves)
        ends[ended] = leaves[nearest[ended]]
        start = self.since
        return Impacts.at(
            (start + enters) * self.dt,
            -side[1:][enters],
            "sampled",
            ends=np.where(ended, (start + ends) * self.dt, np.nan),
            impulses=np.where(ended, sizes[ends] - sizes[enters], np.nan),
        ).started(first)


NO_STATES = "the run came as arrays without states=(q, q')"
NO_REACTIONS = "arrays, which have no reactions of rigid stops"
ROUNDING = 4.0 * float(np.finfo(float).eps)  # of the end: times that are apart by no more are one time
SAME_POSITION = 1e-4  # of the motion: the rounding of five digits, less than a step changes


def run_fields(
    t: ArrayLike, tip: ArrayLike | None, tip_velocity: ArrayLike | None, system: System | None,
    states: tuple[ArrayLike, ArrayLike] | None, name: str,
) -> dict[str, Any]:  # fmt: skip
    """The fields of a Trajectory except its work, see ``Trajectory.from_arrays``."""
    all_times = _row("t", t, None)
    # Times first: of several rows at one time, as at an event, the last counts.
    times, rows = distinct_times("t", all_times)
    if times[0] != 0.0 or len(times) < 3:
        raise InputError("t", all_times, "be three or more times from 0 on", "begin with the initial state, at t = 0")
    if not isinstance(name, str) or not name:
        raise InputError("name", name, "be a text", 'for example "mine"')
    if system is not None:
        require_system(system)
    # States determine the tip and its velocity where these are not passed.
    q = v = None
    if states is not None:
        if system is None:
            raise InputError("states", "without a system", "come with their system", "pass system=")
        if len(pair := sequence("states", states, "be two arrays, (q, q')")) != 2:
            raise InputError("states", f"{len(pair)} arrays", "be two arrays, (q, q')", "give both")
        q, v = (_states(x, (len(all_times), system.size)) for x in pair)
        row, offset = system.channels[system.tip_channel]
        if tip is None:
            tip = system.positions(all_times, q)[:, system.tip_channel]
        if tip_velocity is None:
            tip_velocity = v @ row + offset_rate(offset, all_times)
        q, v = q[rows], v[rows]
    if tip is None:
        raise InputError("tip", None, "be given", "pass the positions of the tip, or states=(q, q')")
    u = _row("tip", tip, len(all_times))
    one_position("t", all_times, rows, u)
    u = u[rows]
    # The velocity of a spline is smooth where the true one has a kink: the provenance states its source.
    notes = {"tip_velocity": "of a spline through the tip"} if tip_velocity is None else {}
    w = _spline_rate(times, u) if tip_velocity is None else _row("tip_velocity", tip_velocity, len(all_times))[rows]
    return {
        "t": times,
        "tip": u,
        "tip_velocity": w,
        "contacts": () if system is None else tuple(_contacts(system, times, u, w, tip_velocity is None, q, v)),
        "provenance": {
            "method": name,
            "source": "arrays",
            "form": "arrays" if system is None else system.form,
            "dt": float(np.median(np.diff(times))),
            "t_end": float(times[-1]),
            "every": 1,
            **({} if system is None else {"units": list(system.units)}),
            **notes,
        },
        "system": system,
        "pieces": None if system is None or q is None or v is None else partial(_pieces, system, times, q, v),
        "ledger": None
        if system is None or q is None or v is None or system.rigid
        else partial(_ledger, system, times, q, v),
    }


def _contacts(
    system: System, t: Array, u: Array, w: Array, smoothed: bool, q: Array | None, v: Array | None
) -> Iterator[ContactRecord]:
    """Record of every contact: from the states, or from the tip where it is the contact point; else NaN."""
    for i, contact in enumerate(system.contacts):
        if system.reads_tip(i):
            yield sampled_record(t, u, w, contact.stops, smoothed)
        elif q is not None and v is not None:
            yield sampled_record(t, *channel_motion(contact.row, contact.offset, t, q, v), contact.stops)
        else:
            nothing = np.full(len(t), np.nan)
            unknown = float("nan")
            yield ContactRecord(contact.stops, nothing, nothing, nothing, Impacts.none("unknown"), *3 * (unknown,))


def distinct_times(name: str, t: Array) -> tuple[Array, NDArray[np.int64]]:
    """Strictly increasing times in t (k,), and for each the last row that has it.

    Solvers write an event twice, before and after it: times that increase by rounding only are one time.
    Raises InputError for times that decrease.
    """
    rounding = ROUNDING * float(np.max(np.abs(t)))
    steps = np.diff(t)
    if np.any(steps < -rounding):
        back = float(t[1 + int(np.argmax(steps < -rounding))])
        raise InputError(name, back, "be no smaller than the time before it", "sort the rows by time")
    first = np.concatenate([[True], steps > rounding])
    # The last row of every time is the one before the next time begins.
    return t[first], np.append(np.flatnonzero(first)[1:], len(t)) - 1


def one_position(name: str, t: Array, rows: NDArray[np.int64], u: Array) -> None:
    """Raise InputError where positions u (k, ...) differ at one time, see ``distinct_times``."""
    again = np.setdiff1d(np.arange(len(t)), rows)
    jump = np.max(np.abs(u[again + 1] - u[again]), axis=tuple(range(1, u.ndim)))
    apart = jump > SAME_POSITION * np.max(np.abs(u))
    if np.any(apart):
        when = float(t[again[np.argmax(apart)]])
        raise InputError(name, when, "belong to one position, not several", "write the times with more digits")


def _pieces(system: System, t: Array, q: Array, v: Array) -> Iterator[tuple[Array, Array, Array, Array]]:
    yield t, q, v, np.full((len(t), len(system.contacts)), np.nan)


def _ledger(system: System, t: Array, q: Array, v: Array) -> Ledger:
    return step_ledger(system, _pieces(system, t, q, v), t)


def _spline_rate(t: Array, u: Array) -> Array:
    """u' of the cubic spline through the samples, of third order in their spacing if u is smooth."""
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(t, u)(t, 1))


def _row(name: str, values: Any, length: int | None) -> Array:
    array = numbers(name, values, remedy="end the run before it overflows")
    if array.ndim != 1 or len(array) < 3 or (length is not None and len(array) != length):
        rule = "be three or more numbers in a row" if length is None else f"be one number per time, {length}"
        raise InputError(name, f"shape {array.shape}", rule, "give a list")
    return array


def _states(values: Any, shape: tuple[int, int]) -> Array:
    array = numbers("states", values)
    if array.shape != shape:
        remedy = "give a row per time and a column per unknown"
        raise InputError("states", array.shape, f"be two arrays of finite numbers, {shape}, (times, unknowns)", remedy)
    return array
