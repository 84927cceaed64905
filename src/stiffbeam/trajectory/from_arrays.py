"""A run of another program: all results that follow from its arrays, and a reason for those that do not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array
from ..basics.validation import InputError, numbers
from ..model.system import System, require_system
from ..model.time_functions import offset_rate
from .impacts import ContactRecord, Impacts
from .ledger import Ledger, step_ledger
from .recorder import sampled_record

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
    times, rows = distinct_times("t", all_times)
    if times[0] != 0.0 or len(times) < 3:
        raise InputError("t", all_times, "be three or more times from 0 on", "begin with the initial state, at t = 0")
    if not isinstance(name, str) or not name:
        raise InputError("name", name, "be a text", 'for example "mine"')
    if system is not None:
        require_system(system)
    q = v = None
    if states is not None:
        if system is None:
            raise InputError("states", "without a system", "come with their system", "pass system=")
        q, v = (_states(x, (len(all_times), system.size)) for x in states)
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
            **({} if system is None else {"units": asdict(system.units)}),
            **notes,
        },
        "system": system,
        "pieces": None if system is None or q is None or v is None else partial(_pieces, system, times, q, v),
        "ledger": None
        if system is None or q is None or v is None or any(contact.stops.rigid for contact in system.contacts)
        else partial(_ledger, system, times, q, v),
    }


def _contacts(
    system: System, t: Array, u: Array, w: Array, smoothed: bool, q: Array | None, v: Array | None
) -> Iterator[ContactRecord]:
    """Record of every contact: from the states, or from the tip where it is the contact point; else NaN."""
    positions = None if q is None else system.positions(t, q)
    for i, contact in enumerate(system.contacts):
        if system.reads_tip(i):
            yield sampled_record(t, u, w, contact.stops, smoothed)
        elif positions is not None and v is not None:
            rate = v @ contact.row + offset_rate(contact.offset, t)
            yield sampled_record(t, positions[:, i], rate, contact.stops)
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
