"""Records of contacts from positions, velocities and reactions, and the runs of other programs as records."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array, step_lengths
from ..basics.validation import InputError, instance, numbers
from ..kernels.library import switch_time
from ..model.contact import Stops, channel_motion, side_at_start
from ..model.system import System, require_system
from .records import ContactRecord, Impacts, step_ledger

AT_REST = 1e-12  # of a position: so near a rigid stop a body is on it


def impacts_in(
    t: Array, side: Array, size: Array, switch: Callable[[int, int], float], starts: bool, held: int = 0,
    peaks: Array | None = None,
) -> Impacts:  # fmt: skip
    """Sampled impacts in the contact state ``side`` (k,) at increasing times t (k,).

    switch(k, side): the time at which step k enters or leaves a side. An impulse is a sum of ``size`` (k,), a peak the
    largest of ``peaks`` (k,). Contacts that begin by step ``held`` are the contact at the start, which only a record
    that ``starts`` at t = 0 has.
    """
    # From change to change the contact keeps its side.
    changes = [0, *(np.flatnonzero(side[1:] != side[:-1]) + 1).tolist(), len(t)]
    spans = [(a, b, int(side[a])) for a, b in pairwise(changes) if side[a] and (starts or a > held)]
    first, after, sides = np.array(spans, int).reshape(-1, 3).T
    times = [switch(a, s) if a else t[0] for a, _, s in spans]
    ends = [switch(b, s) if b < len(t) else np.nan for _, b, s in spans]
    total = np.concatenate([[0.0], np.cumsum(size)])
    known = {"impulses": total[after] - total[first]}
    if peaks is not None:
        known["peaks"] = np.array([np.max(peaks[a:b]) for a, b, _ in spans], float)
    known = {name: np.where(after < len(t), x, np.nan) for name, x in known.items()}
    return Impacts.at(times, sides, "sampled", ends=ends, **known).started(first <= held)


def rebounds(t: Array, u: Array, v: Array, stops: Stops) -> Impacts:
    """Impacts on rigid stops in positions u (k,) and velocities v (k,) at increasing times t (k,).

    An impact is a step in which a body that approaches a stop, and would reach it within a step and a half, stops
    approaching. Its time is that at which the body would have been at the stop with the previous speed. A speed below a
    millionth of the largest is no approach: a body at rest on its stop may move by rounding.
    """
    step, rows = np.diff(t), np.zeros((0, 2))
    for sign, g in stops.sides.items():
        speed = sign * v
        gap, rounding = sign * (g - u), AT_REST * max(abs(g), float(np.max(np.abs(u))))
        near = gap[:-1] <= 1.5 * step * np.maximum(speed[:-1], 0.0) + rounding
        near[0] &= gap[0] > rounding  # a blow at t = 0 is no impact
        least = 1e-6 * np.max(np.abs(speed))
        # Near the stop, approaching at the start of the step and no longer at its end.
        hit = np.flatnonzero(near & (speed[:-1] > least) & (speed[1:] <= least))
        # The time at the stop at the speed of the approach, within the step.
        when = t[hit] + np.clip(gap[hit] / speed[hit], 0.0, step[hit])
        rows = np.concatenate([rows, np.stack([when, np.full(len(hit), sign)], axis=1)])
    times, sides = rows[np.argsort(rows[:, 0], kind="stable")].T
    return Impacts.at(times, sides, "sampled")


def totals(t: Array, force: Array) -> tuple[float, float, float]:
    """Share of the time in contact, peak and impulse of a ``force`` (k,) at times t (k,). Every step counts by its end,
    so that the start has no share."""
    size = np.abs(force)
    share = np.average(size[1:] != 0.0, weights=step_lengths(t)[1:]) if len(t) > 1 else 0.0
    return float(share), float(np.max(size)), float(np.trapezoid(size, t))


def sampled_record(t: Array, u: Array, v: Array, stops: Stops) -> ContactRecord:
    """Contact record of positions u (k,) and velocities v (k,) at increasing times t (k,), see ``Impacts``.

    Against rigid stops positions tell impacts, see ``rebounds``, not forces: these are NaN.
    """
    if stops.rigid:
        return ContactRecord(stops, u, v, np.full(len(t), np.nan), rebounds(t, u, v, stops), *3 * (float("nan"),))
    chi, force = stops.state(u, v), stops.force(u, v)
    # At the first time a position exactly on a stop is contact unless it leaves.
    law = np.array(stops.law)
    chi[0] = side_at_start(u[0], v[0], law)

    def switch(k: int, side: int) -> float:
        length = float(t[k] - t[k - 1])
        return float(t[k - 1]) + length * switch_time(u[k - 1], v[k - 1], u[k], v[k], side, law, length)

    size = np.abs(force)
    impacts = impacts_in(t, chi, size * step_lengths(t), switch, bool(t[0] == 0.0), peaks=size)
    return ContactRecord(stops, u, v, force, impacts, *totals(t, force))


ROUNDING = 4.0 * float(np.finfo(float).eps)  # of the end: times that are apart by no more are one time
SAME_POSITION = 1e-4  # of the motion: the rounding of five digits, less than a step changes
OVERFLOWS = "end the run before it overflows"


def run_fields(
    t: ArrayLike, tip: ArrayLike, tip_velocity: ArrayLike | None, system: System | None, name: str
) -> dict[str, Any]:
    """The fields of a Trajectory except its work, see ``Trajectory.from_arrays``."""
    from scipy.interpolate import CubicSpline

    instance("name", name, str, 'for example "mine"')
    given = numbers("t", t, remedy=OVERFLOWS)
    if given.ndim != 1 or len(given) < 3:
        raise InputError("t", f"shape {given.shape}", "be three or more numbers in a row", "give a list")
    # Times first: of several rows at one time, as at an event, the last counts.
    times, rows = distinct_times(given)
    if times[0] != 0.0 or len(times) < 3:
        raise InputError("t", given, "be three or more times from 0 on", "begin with the initial state, at t = 0")
    of_all = [] if system is None else [(len(given), require_system(system).size)]
    u, q, v, smoothed = _rows("tip", tip, given.shape, *of_all), None, None, tip_velocity is None
    w = None if smoothed else _rows("tip_velocity", tip_velocity, u.shape)
    # All unknowns determine the tip; the other way round where it is the only one.
    if system is not None and u.ndim == 2:
        q, v = u, w
        u, w = channel_motion(*system.channels[system.tip_channel], given, q, np.zeros_like(q) if v is None else v)
    elif system is not None and w is not None and system.size == 1:
        row, offset = system.channels[system.tip_channel]
        q, v = (u[:, None], w[:, None]) if row == 1.0 and offset is None else (None, None)
    again = np.setdiff1d(np.arange(len(given)), rows)
    apart = again[np.abs(u[again + 1] - u[again]) > SAME_POSITION * np.max(np.abs(u))]
    if len(apart):
        remedy = "write the times with more digits"
        raise InputError("t", float(given[apart[0]]), "belong to one position, not several", remedy)
    u, states = u[rows], None if q is None or v is None else (q[rows], v[rows])
    w = CubicSpline(times, u)(times, 1) if smoothed or w is None else w[rows]
    notes: dict[str, Any] = {
        "method": name, "source": "arrays", "form": "arrays" if system is None else system.form,
        "dt": float(np.median(np.diff(times))), "t_end": float(times[-1]), "every": 1,
    }  # fmt: skip
    if smoothed:  # a spline's velocity is smooth where the true one has a kink
        notes["tip_velocity"] = "of a spline through the tip"
    fields: dict[str, Any] = {"t": times, "tip": u, "tip_velocity": w, "provenance": notes, "system": system}
    if system is None:
        return fields | {"contacts": ()}
    notes["units"] = list(system.units)
    fields["contacts"] = tuple(_contacts(system, times, (u, w), smoothed, states))
    if states is not None:
        pieces = [(times, *states, np.full((len(times), len(system.contacts)), np.nan))]
        fields["pieces"] = partial(iter, pieces)
        fields["ledger"] = None if system.rigid else partial(step_ledger, system, pieces, times)
    return fields


def _contacts(
    system: System, t: Array, tip: tuple[Array, Array], smoothed: bool, states: tuple[Array, Array] | None
) -> Iterator[ContactRecord]:
    """Record of every contact: from the states, or from the motion of the tip where it is the contact point; else NaN.
    smoothed: the velocity of the tip is a spline's, which has no jump at rigid stops."""
    for i, contact in enumerate(system.contacts):
        motion = tip if system.reads_tip(i) and not (smoothed and contact.stops.rigid) else None
        if states is not None:
            motion = channel_motion(contact.row, contact.offset, t, *states)
        if motion is not None:
            yield sampled_record(t, *motion, contact.stops)
        else:
            nothing, unknown = np.full(len(t), np.nan), float("nan")
            yield ContactRecord(
                contact.stops, nothing, nothing, nothing, Impacts.at([], [], "unknown"), *3 * (unknown,)
            )


def distinct_times(t: Array) -> tuple[Array, NDArray[np.int64]]:
    """Strictly increasing times in t (k,), and for each the last row that has it.

    Solvers write an event twice, before and after it: times that increase by rounding only are one time.
    Raises InputError for times that decrease.
    """
    rounding = ROUNDING * float(np.max(np.abs(t)))
    steps = np.diff(t)
    if np.any(steps < -rounding):
        back = float(t[1 + int(np.argmax(steps < -rounding))])
        raise InputError("t", back, "be no smaller than the time before it", "sort the rows by time")
    first = np.concatenate([[True], steps > rounding])
    # The last row of every time is the one before the next time begins.
    return t[first], np.append(np.flatnonzero(first)[1:], len(t)) - 1


def _rows(name: str, values: Any, *shapes: tuple[int, ...]) -> Array:
    """Finite numbers of one of the shapes."""
    array = numbers(name, values, remedy=OVERFLOWS)
    if array.shape not in shapes:
        remedy = "give one number per time, or with their system a row of all unknowns"
        raise InputError(name, f"shape {array.shape}", f"have shape {' or '.join(map(str, shapes))}", remedy)
    return array
