"""Exact motion of M q'' + C q' + K q = f(t) + sum_i row_i^T F_i, event by event: the functions of exact.c.

Arrays are checked here once: a wrong type, shape or order is a TypeError, not a crash. The library releases the GIL.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ..basics.arrays import Array, IntArray
from ..basics.resources import clock
from .library import Structure, address, filled, library

DONE, FULL, STALLED, NOT_FINITE = range(4)
TOGETHER = 16.0  # roundings of the time within which rigid stops are hit together
FIRST_ROOM, LARGEST_ROOM = 256, 8192  # marks, events and blows of one call
SHORT = 0.05  # CPU seconds of a call that is followed by a longer one: between two of them a deadline is looked at

_FREE, _STATE, _OUTPUT, _MARKS = (Structure("exact.h", name) for name in ("Free", "State", "Output", "Marks"))


class Free(SimpleNamespace):
    """The free system in its modes, and its contacts: numbers and arrays as exact.h states them. They do not change.

    up, low: the system with its only contact pressed at the upper and lower stop, in its modes V eta (n, n); None where
    that is no closed form. c: all of it for C.
    """

    def __init__(self, up: Free | None = None, low: Free | None = None, V: Array | None = None, **stated: Any) -> None:
        super().__init__(**stated, up=up, low=low, V=V)
        self.stated = dict(vars(self))
        p = self.poles[:, self.order]
        self.drag = np.diag(self.damping).copy()
        self.sorted = np.ascontiguousarray(np.vstack([p, np.hypot(*p)[None]]))
        self.c = _FREE(
            vars(self), coupling=self.coupling, kind=self.kind, damped=bool(self.poles[0].any()), longest=self.longest,
            decay=np.max(np.sum(np.abs(self.damping), axis=1)), stiffest=np.max(self.w2),
            fastest_wave=np.max(self.waves, initial=1e-300), N=self.poles.shape[1] - len(self.waves),
            **{name: ctypes.addressof(x.c) for name, x in (("up", up), ("low", low)) if x is not None},
        )  # fmt: skip

    @property
    def size(self) -> dict[str, int]:
        """Numbers of modes and contacts."""
        return {"n": len(self.w2), "m": len(self.rows)}

    def changed(self, **values: Any) -> Free:
        """A copy with other values."""
        return Free(**self.stated | values)

    def __reduce__(self) -> Any:
        return partial(Free, **self.stated), ()  # addresses do not travel


class Blows(NamedTuple):
    """Impulses of rigid stops on the positions, the rates of these before and after, and the marks behind."""

    t: Array
    impulse: Array
    before: Array
    after: Array
    contact: IntArray
    side: IntArray
    mark: IntArray

    @property
    def outward(self) -> Array:
        """Impulses off the stops."""
        return -self.side * self.impulse


class Marks(NamedTuple):
    """States from which parts of a motion are computed again: times (k,), eta, rate (k, n), sides (k, m)."""

    t: Array
    eta: Array
    rate: Array
    side: IntArray

    def argument(self, free: Free) -> Any:
        """The argument of the library."""
        return _MARKS(self._asdict(), **free.size)


# Times, contacts, sides and marks behind; the side of a contact that an impact throws back is 9 times the stop.
Events = tuple[Array, IntArray, IntArray, IntArray]
States = tuple[Array, Array, Array]  # eta, rate (k, n) and held forces (k, m)


class Follower:
    """A motion in parts: each call goes on until t_end or until its room is full. state, arrays: see exact.h."""

    def __init__(
        self, free: Free, eta: Array, rate: Array, t: float = 0.0, sides: IntArray | None = None,
        fresh: IntArray | None = None, together: float = TOGETHER,
    ) -> None:  # fmt: skip
        """sides (m,): in the middle of a motion. fresh (m,): the stops at which gaps are zero."""
        self.free = free
        start = {"eta": np.array(eta, float), "rate": np.array(rate, float)}
        self.state = _STATE.new(start, **free.size, t=t, together=together)
        self.arrays = self.state.arrays
        if sides is not None:
            self.arrays["side"][:], self.state.begun, self.state.since = sides, 2, 1 << 40
        if fresh is not None:
            self.arrays["fresh"][:], self.arrays["fresh_side"][:] = fresh != 0, fresh

    def follow(
        self, t_end: float, stations: Array, between: Callable[[float, int, int], None] | None = None
    ) -> tuple[int, Marks, Events, Blows, States]:
        """Go on to t_end, or to where the motion cannot go on; the result, and the states at the ``stations`` (k,),
        increasing, that it has passed.

        between: called after every part, with the time and the numbers of marks and events so far.
        """
        least = FIRST_ROOM + 8 * self.free.size["m"] ** 2
        room, result, passed, kept, count = least, FULL, 0, 0, 0
        parts = []
        while result == FULL:
            begun = clock()
            result, *part = self._part(t_end, stations[passed:], room)
            marks, events, blows, at = part
            # Numbers of marks count over all parts.
            events[3] += kept
            blows[6] += kept
            parts.append(part)
            passed, kept, count = passed + len(at[0]), kept + len(marks[0]), count + len(events[0])
            if between is not None:
                between(self.state.t, kept, count)
            if clock() - begun < SHORT:
                room = min(4 * room, max(LARGEST_ROOM, least))
        whole: Any = ([np.concatenate(x) for x in zip(*some, strict=True)] for some in zip(*parts, strict=True))
        marks, events, blows, at = whole
        return result, Marks(*marks), tuple(events), Blows(*blows), tuple(at)

    def first_event(self, t_end: float) -> tuple[float, int, int] | None:
        """Time, contact and its new side of the first event before t_end; None for none."""
        while True:
            result, _, found, *_ = self._part(t_end, np.zeros(0), 8 * self.free.size["m"] ** 2 + 2)
            if len(found[0]):
                return float(found[0][0]), int(found[1][0]), int(found[2][0])
            if result != FULL:
                return None

    def _part(self, t_end: float, stations: Array, room: int) -> tuple[Any, ...]:
        """One call: its result; marks, events and blows; the states at the stations passed."""
        out = _OUTPUT.new(
            {"stations": np.ascontiguousarray(stations, float)}, **self.free.size, room=room, n_stations=len(stations)
        )
        result = filled(library().exact_follow(self.free.c, self.state, t_end, out))
        counts = {"mark_": out.marks, "event_": out.events, "blow_": out.blows}
        rows = ([x[:k].copy() for name, x in out.arrays.items() if name.startswith(y)] for y, k in counts.items())
        return result, *rows, [out.arrays[x][: out.station] for x in ("eta_at", "rate_at", "force_at")]


def read(free: Free, marks: Marks, times: Array, mark: IntArray) -> States:
    """eta, eta' (k, n) and the reactions of held contacts (k, m) at times (k,), each from its mark."""
    order = np.lexsort((times, mark))
    t, at = np.ascontiguousarray(times[order], float), np.ascontiguousarray(mark[order], np.int64)
    k, n, m = len(t), len(free.w2), len(free.rows)
    if k and not (at[0] >= 0 and at[-1] < len(marks.t)):
        raise ValueError("mark: a number of a mark wanted")
    found = np.empty((k, n)), np.empty((k, n)), np.empty((k, m))
    call = free.c, _STATE.new(**free.size), marks.argument(free), k, t.ctypes, at.ctypes, *(x.ctypes for x in found)
    filled(library().exact_read(*call))
    if np.array_equal(order, np.arange(k)):
        return found
    eta, rate, force = (x[np.argsort(order)] for x in found)
    return eta, rate, force


def press(free: Free, marks: Marks, contact: int, starts: Array, ends: Array) -> tuple[Array, Array]:
    """Largest force and impulse of a contact in spans from starts to ends (k,), in order; of rigid stops their
    reactions."""
    if not 0 <= contact < len(free.rows):
        raise ValueError("contact: the number of a contact wanted")
    a, b = np.ascontiguousarray(starts, float), np.ascontiguousarray(ends, float)
    peaks, impulses = found = np.empty((2, len(a)))
    spans = a.ctypes, address(b, a.shape), *(x.ctypes for x in found)
    filled(library().exact_press(free.c, _STATE.new(**free.size), marks.argument(free), contact, len(a), *spans))
    return peaks, impulses
