"""Exact motion of M q'' + C q' + K q = f(t) + sum_i row_i^T F_i, event by event: the functions of exact.c.

Arrays are checked here once: a wrong type, shape or order is a TypeError, not a crash. The library releases the GIL.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache, partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ..basics.arrays import Array, IntArray
from .library import INTEGER, Address, Int, Real, Structure, address, library

DONE, FULL, STALLED, NOT_FINITE, NO_MEMORY = range(5)
REBOUND = 9  # times the stop: the side of a contact that an impact throws back
TOGETHER = 16.0  # roundings of the time within which rigid stops are hit together
FIRST_ROOM, LARGEST_ROOM = 256, 8192  # marks, events and blows of one call


def _structure(name: str, *kinds: tuple[Any, str]) -> Any:
    """A structure in the order of exact.h: (type, names) of its fields."""
    return type(name, (ctypes.Structure,), {"_fields_": [(x, kind) for kind, names in kinds for x in names.split()]})


STATE_INTS = "side fresh fresh_side closed"
_Free = Structure(
    "n m F R E N coupling kind damped",
    "longest",
    "w2: n; drag: n; damping: n n; rows: m n; stops: m 2; laws: m 3; meet: m m; loads: B n; offsets: B m; waves: F; "
    "edges: E; pieces: E R 4; poles: 2 T; sorted: 3 T; answer: 2F n; out?: 4 n N; back?: 2 N 2n; seen?: 2 m N; "
    "order int: T; apart int: n",
)
_State = _structure(
    "_State", (Real, "t late leap fastest together"), (Int, "piece begun waits hit still since evaluations"),
    (Address, "eta rate lost speed size slack"), (Address, STATE_INTS),
)  # fmt: skip
_Output = _structure(
    "_Output", (Int, "room marks events blows n_stations station"),
    (Address, """mark_t mark_eta mark_rate mark_side event_t event_contact event_side event_mark blow_t blow_impulse
        blow_before blow_after blow_contact blow_side blow_mark stations eta_at rate_at force_at"""),
)  # fmt: skip
_Marks = _structure("_Marks", (Int, "count"), (Address, "t eta rate side"))


@cache
def _functions() -> ctypes.CDLL:
    """The library, with the arguments of its functions declared."""
    lib, at = library(), ctypes.POINTER
    flown = [at(_Free.type)] * 3 + [Address]
    lib.exact_follow.argtypes = [*flown, at(_State), Real, at(_Output)]
    lib.exact_read.argtypes = [*flown, at(_Marks), Int, *[Address] * 5]
    lib.exact_press.argtypes = [*flown, at(_Marks), Int, Int, *[Address] * 4]
    for function in (lib.exact_follow, lib.exact_read, lib.exact_press):
        function.restype = Int
    return lib


def _done(result: int) -> None:
    if result != DONE:
        raise MemoryError("no memory for an exact motion")


class Free(SimpleNamespace):
    """The free system in its modes, and its contacts: numbers and arrays as exact.h states them; ``c`` holds them for
    C. They do not change."""

    def __init__(self, **stated: Any) -> None:
        super().__init__(**stated, stated=stated)
        n, m, F, E, R = len(self.w2), len(self.rows), len(self.waves), len(self.edges), self.pieces.shape[1]
        N, p = self.poles.shape[1] - F, self.poles[:, self.order]
        self.sorted = np.ascontiguousarray(np.vstack([p, np.hypot(*p)[None]]))
        if self.kind == 1 and n != N:
            raise ValueError("kind: one pair a mode wanted")
        if self.kind == 2 and "out" not in stated:
            raise ValueError("kind: complex modes wanted")
        sizes = {
            "n": n, "m": m, "F": F, "R": R, "E": E, "N": N, "coupling": self.coupling, "kind": self.kind,
            "damped": bool(self.poles[0].any()), "longest": self.longest, "B": 2 * F + R, "T": N + F, "2F": 2 * F,
            "2n": 2 * n,
        }  # fmt: skip
        self.c = _Free(sizes, vars(self))

    def changed(self, **values: Any) -> Free:
        """A copy with other values."""
        return Free(**self.stated | values)

    def __reduce__(self) -> Any:
        return partial(Free, **self.stated), ()  # addresses do not travel


class Pressed(NamedTuple):
    """The system with its only contact pressed at the upper and lower stop, in its modes V eta; None where that is no
    closed form."""

    up: Free | None
    low: Free | None
    V: Array

    def arguments(self, free: Free) -> tuple[Any, ...]:
        """The arguments of the library."""
        n = len(free.w2)
        for x in (self.up, self.low):
            if x is not None and (len(x.w2) != n or x.edges is not free.edges or self.V.shape != (n, n)):
                raise ValueError("pressed: the modes of this system wanted")
        up, low = (None if x is None else ctypes.byref(x.c) for x in (self.up, self.low))
        return ctypes.byref(free.c), up, low, address(self.V, self.V.shape)


NONE_PRESSED = Pressed(None, None, np.zeros((0, 0)))


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
        k, n, m = len(self.t), len(free.w2), len(free.rows)
        floats = (address(x, (k, *width)) for x, width in ((self.t, ()), (self.eta, (n,)), (self.rate, (n,))))
        return ctypes.byref(_Marks(k, *floats, address(self.side, (k, m), INTEGER)))


class Followed(NamedTuple):
    """A motion to t_end or to where it cannot go on (``result``). events: times, contacts, sides and marks behind.
    passed: eta, rate (k, n) and held forces (k, m) at the stations that it has passed."""

    result: int
    t: float
    marks: Marks
    events: tuple[Array, IntArray, IntArray, IntArray]
    blows: Blows
    passed: tuple[Array, Array, Array]
    evaluations: int


class Follower:
    """A motion in parts: each call goes on until t_end or until its room is full."""

    def __init__(
        self, free: Free, pressed: Pressed, eta: Array, rate: Array, t: float = 0.0, sides: IntArray | None = None,
        fresh: IntArray | None = None, together: float = TOGETHER,
    ) -> None:  # fmt: skip
        """sides (m,): in the middle of a motion. fresh (m,): the stops at which gaps are zero."""
        n, m = len(free.w2), len(free.rows)
        self.free, self.pressed = free, pressed
        self.arrays = {"eta": np.array(eta, float), "rate": np.array(rate, float), "lost": np.zeros(2 * n)}
        self.arrays |= {x: np.zeros(m) for x in ("speed", "size", "slack")}
        self.whole = {x: np.zeros(m, np.int64) for x in STATE_INTS.split()}
        for x in ("eta", "rate"):
            address(self.arrays[x], (n,))
        pointers = [x.ctypes.data for x in (*self.arrays.values(), *self.whole.values())]
        self.state = _State(t, 0.0, 0.0, 0.0, together, *[0] * 7, *pointers)
        if sides is not None:
            self.whole["side"][:], self.state.begun, self.state.since = sides, 2, 1 << 40
        if fresh is not None:
            self.whole["fresh"][:], self.whole["fresh_side"][:] = fresh != 0, fresh

    def follow(
        self, t_end: float, stations: Array,
        between: Callable[[float, int, int], None] | None = None,
    ) -> Followed:  # fmt: skip
        """Go on to t_end; the states at ``stations`` (k,), increasing. between: called after every part, with the time
        and the numbers of marks and events so far."""
        m = len(self.free.rows)
        room, result, passed, kept, events = FIRST_ROOM + 8 * m * m, FULL, 0, 0, 0
        parts = []
        while result == FULL:
            result, part, at = self._part(t_end, stations[passed:], room)
            # Numbers of marks count over all parts.
            part[1][3] += kept
            part[2][6] += kept
            parts.append((*part, at))
            passed, kept, events = passed + len(at[0]), kept + len(part[0][0]), events + len(part[1][0])
            if between is not None:
                between(self.state.t, kept, events)
            room = min(4 * room, max(LARGEST_ROOM, FIRST_ROOM + 8 * m * m))
        whole: Any = ([np.concatenate(x) for x in zip(*(p[j] for p in parts), strict=True)] for j in range(4))
        marks, found, blows, at = map(tuple, whole)
        return Followed(result, self.state.t, Marks(*marks), found, Blows(*blows), at, self.state.evaluations)

    def first_event(self, t_end: float) -> tuple[float, int, int] | None:
        """Time, contact and its new side of the first event before t_end; None for none."""
        while True:
            result, (_, found, _), _ = self._part(t_end, np.zeros(0), 8 * len(self.free.rows) ** 2 + 2)
            if len(found[0]):
                return float(found[0][0]), int(found[1][0]), int(found[2][0])
            if result != FULL:
                return None

    def _part(self, t_end: float, stations: Array, room: int) -> tuple[int, Any, Any]:
        """One call: its result; marks, events and blows; the states at the stations passed."""
        n, m, k = len(self.free.w2), len(self.free.rows), len(stations)
        at = np.empty((k, n)), np.empty((k, n)), np.empty((k, m))
        stations = np.ascontiguousarray(stations, float)
        marks = np.empty(room), np.empty((room, n)), np.empty((room, n)), np.empty((room, m), np.int64)
        found = np.empty(room), *np.empty((3, room), np.int64)
        blows = *np.empty((4, room)), *np.empty((3, room), np.int64)
        pointers = [x.ctypes.data for x in (*marks, *found, *blows, stations, *at)]
        out, flown = _Output(room, 0, 0, 0, k, 0, *pointers), self.pressed.arguments(self.free)
        result = _functions().exact_follow(*flown, ctypes.byref(self.state), t_end, ctypes.byref(out))
        if result == NO_MEMORY:
            _done(result)
        kept = ((marks, out.marks), (found, out.events), (blows, out.blows))
        parts = [[x[:count].copy() for x in some] for some, count in kept]
        return result, parts, [x[: out.station] for x in at]


def read(free: Free, pressed: Pressed, marks: Marks, times: Array, mark: IntArray) -> tuple[Array, Array, Array]:
    """eta, eta' (k, n) and the reactions of held contacts (k, m) at times (k,), each from its mark."""
    order = np.lexsort((times, mark))
    t, at = np.ascontiguousarray(times[order], float), np.ascontiguousarray(mark[order], np.int64)
    k, n, m = len(t), len(free.w2), len(free.rows)
    if k and not (at[0] >= 0 and at[-1] < len(marks.t)):
        raise ValueError("mark: a number of a mark wanted")
    eta, rate, force = np.empty((k, n)), np.empty((k, n)), np.empty((k, m))
    _done(_functions().exact_read(
        *pressed.arguments(free), marks.argument(free), k, t.ctypes.data, at.ctypes.data, eta.ctypes.data,
        rate.ctypes.data, force.ctypes.data,
    ))  # fmt: skip
    if np.array_equal(order, np.arange(k)):
        return eta, rate, force
    back = np.empty(k, np.int64)
    back[order] = np.arange(k)
    return eta[back], rate[back], force[back]


def press(free: Free, pressed: Pressed, marks: Marks, contact: int, starts: Array, ends: Array) -> tuple[Array, Array]:
    """Largest force and impulse of a contact in spans from starts to ends (k,), in order; of rigid stops their
    reactions."""
    if not 0 <= contact < len(free.rows):
        raise ValueError("contact: the number of a contact wanted")
    a, b = np.ascontiguousarray(starts, float), np.ascontiguousarray(ends, float)
    peaks, impulses = np.empty(len(a)), np.empty(len(a))
    _done(_functions().exact_press(
        *pressed.arguments(free), marks.argument(free), contact, len(a), a.ctypes.data,
        address(b, a.shape), peaks.ctypes.data, impulses.ctypes.data,
    ))  # fmt: skip
    return peaks, impulses
