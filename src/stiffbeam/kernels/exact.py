"""Exact motion of M q'' + C q' + K q = f(t) + sum_i row_i^T F_i, event by event: the functions of exact.c.

Arrays are checked here once: a wrong type, shape or order is a TypeError, not a crash. The library releases the GIL.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, IntArray
from .local_build import library

Int, Real, Pointer = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
DONE, FULL, STALLED, NOT_FINITE, NO_MEMORY = range(5)
REBOUND = 9  # times the stop: the side of a contact that an impact throws back
RADIANS = 2.0  # of the fastest motion in a step of series
FIRST_ROOM, LARGEST_ROOM = 256, 8192  # marks, events and blows of one call


def _structure(name: str, *kinds: tuple[Any, str]) -> Any:
    """A structure in the order of exact.h: (type, names) of its fields."""
    fields_ = [(field, kind) for kind, names in kinds for field in names.split()]
    return type(name, (ctypes.Structure,), {"_fields_": fields_})


FREE_REALS = """w2 drag damping rows stops laws meet loads offsets waves edges pieces poles sorted answer out back
    seen"""
STATE_INTS = "side fresh fresh_side closed"
_Free = _structure(
    "_Free",
    (Int, "n m F R E N coupling kind damped"),
    (Real, "longest"),
    (Pointer, FREE_REALS),
    (Pointer, "order apart"),
)
_State = _structure(
    "_State", (Real, "t late leap fastest"), (Int, "piece begun waits hit still since"),
    (Pointer, "eta rate lost speed size slack"), (Pointer, STATE_INTS),
)  # fmt: skip
_Output = _structure(
    "_Output", (Int, "room marks events blows n_stations station"), (Int * 3, "counts"),
    (Pointer, """mark_t mark_eta mark_rate mark_side event_t event_contact event_side event_mark blow_t blow_impulse
        blow_before blow_after blow_contact blow_mark stations eta_at rate_at force_at"""),
)  # fmt: skip


def _address(x: Any, dtype: Any, shape: tuple[int, ...], name: str) -> int:
    if not isinstance(x, np.ndarray) or x.dtype != dtype or x.shape != shape or not x.flags.c_contiguous:
        stated = f"{getattr(x, 'dtype', type(x))} {getattr(x, 'shape', '')}"
        raise TypeError(f"{name}: {np.dtype(dtype)} array of shape {shape} row by row wanted, got {stated}")
    return x.ctypes.data


@dataclass(frozen=True, eq=False)
class Free:
    """The free system in its modes, and its contacts: see exact.h for the shapes."""

    w2: Array
    drag: Array
    damping: Array
    coupling: int
    rows: Array
    stops: Array
    laws: Array
    meet: Array
    loads: Array
    offsets: Array
    waves: Array
    edges: Array
    pieces: Array
    kind: int
    poles: Array
    order: IntArray
    answer: Array
    apart: IntArray
    longest: float
    out: Array = field(default_factory=lambda: np.zeros((4, 0, 0)))
    back: Array = field(default_factory=lambda: np.zeros((2, 0, 0)))
    seen: Array = field(default_factory=lambda: np.zeros((2, 0, 0)))
    c: Any = field(init=False, repr=False)
    sorted: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        n, m, F, E, R = len(self.w2), len(self.rows), len(self.waves), len(self.edges), self.pieces.shape[1]
        N = self.poles.shape[1] - F
        p = self.poles[:, self.order]
        object.__setattr__(self, "sorted", np.ascontiguousarray(np.vstack([p, np.hypot(*p)[None]])))
        complex_modes = self.kind == 2 or self.out.size > 0
        k, N2, M = (n, N, m) if complex_modes else (0, 0, 0)
        if self.kind == 1 and n != N:
            raise ValueError("kind: one pair a mode wanted")
        B, T = 2 * F + R, N + F
        shapes: dict[str, tuple[int, ...]] = {
            "w2": (n,),
            "drag": (n,),
            "damping": (n, n),
            "rows": (m, n),
            "stops": (m, 2),
            "laws": (m, 3),
            "meet": (m, m),
            "loads": (B, n),
            "offsets": (B, m),
            "waves": (F,),
            "edges": (E,),
            "pieces": (E, R, 4),
            "poles": (2, T),
            "sorted": (3, T),
            "answer": (2 * F, n),
            "out": (4, k, N2),
            "back": (2, N2, 2 * k),
            "seen": (2, M, N2),
        }
        at = [_address(getattr(self, x), float, shapes[x], x) for x in FREE_REALS.split()]
        whole = [_address(self.order, np.int64, (T,), "order"), _address(self.apart, np.int64, (n,), "apart")]
        damped = bool(self.poles[0].any())
        sizes = (n, m, F, R, E, N, self.coupling, self.kind, damped)
        object.__setattr__(self, "c", _Free(*sizes, self.longest, *at, *whole))

    def changed(self, **values: Any) -> Free:
        """A copy with other values."""
        stated = {x.name: getattr(self, x.name) for x in fields(self) if x.init}
        return Free(**stated | values)


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
        return ctypes.byref(free.c), up, low, _address(self.V, float, self.V.shape, "V")


NONE_PRESSED = Pressed(None, None, np.zeros((0, 0)))


class Blows(NamedTuple):
    """Impulses of rigid stops: speeds off the stop before and after; mark: the one behind the impact."""

    t: Array
    contact: IntArray
    impulse: Array
    before: Array
    after: Array
    mark: IntArray


class Followed(NamedTuple):
    """A motion to t_end or to where it cannot go on (``result``): marks, events, blows, and the stations passed."""

    result: int
    t: float
    mark_t: Array  # (marks,)
    mark_eta: Array  # (marks, n)
    mark_rate: Array
    mark_side: IntArray  # (marks, m)
    event_t: Array  # (events,)
    event_contact: IntArray
    event_side: IntArray
    event_mark: IntArray
    blows: Blows
    eta_at: Array  # (stations, n)
    rate_at: Array
    force_at: Array  # (stations, m)
    counts: IntArray  # steps of series, flights, evaluations in flight


class Follower:
    """A motion in parts: each call goes on until t_end or until its room is full."""

    def __init__(
        self, free: Free, pressed: Pressed, eta: Array, rate: Array, t: float = 0.0, sides: IntArray | None = None,
        fresh: IntArray | None = None,
    ) -> None:  # fmt: skip
        n, m = len(free.w2), len(free.rows)
        self.free, self.pressed = free, pressed
        self.arrays = {
            "eta": np.array(eta, float),
            "rate": np.array(rate, float),
            "lost": np.zeros(2 * n),
            "speed": np.zeros(m),
            "size": np.zeros(m),
            "slack": np.zeros(m),
        }
        self.whole = {x: np.zeros(m, np.int64) for x in STATE_INTS.split()}
        for x in ("eta", "rate"):
            _address(self.arrays[x], float, (n,), x)
        pointers = [x.ctypes.data for x in (*self.arrays.values(), *self.whole.values())]
        self.state = _State(t, *[0] * 9, *pointers)
        if sides is not None:  # in the middle of a motion
            self.whole["side"][:], self.state.begun, self.state.since = sides, 2, 1 << 40
        if fresh is not None:  # contacts whose gap is zero
            self.whole["fresh"][:], self.whole["fresh_side"][:] = fresh != 0, fresh

    def follow(
        self, t_end: float, stations: Array, radians: float = RADIANS,
        between: Callable[[float, float], None] | None = None,
    ) -> Followed:  # fmt: skip
        """Go on to t_end; the states at ``stations`` (k,), increasing. between: called with the time and the count of
        numbers so far, after every part."""
        n, m, k = len(self.free.w2), len(self.free.rows), len(stations)
        at = (np.empty((k, n)), np.empty((k, n)), np.empty((k, m)))
        stations = np.ascontiguousarray(stations, float)
        room, parts, result, passed, kept = FIRST_ROOM + 8 * m, [], FULL, 0, 0
        counts = np.zeros(3, np.int64)
        arguments = self.pressed.arguments(self.free)
        while result == FULL:
            marks = np.empty(room), np.empty((room, n)), np.empty((room, n)), np.empty((room, m), np.int64)
            found = np.empty(room), *np.empty((3, room), np.int64)
            blows = *np.empty((4, room)), *np.empty((2, room), np.int64)
            pointers = [x.ctypes.data for x in (*marks, *found, *blows)]
            rest = [stations[passed:], *(x[passed:] for x in at)]
            out = _Output(
                room, 0, 0, 0, k - passed, 0, (Int * 3)(), *pointers,
                *(x.ctypes.data for x in rest),
            )  # fmt: skip
            result = _follow(*arguments, ctypes.byref(self.state), t_end, radians, ctypes.byref(out))
            passed, kept, counts = passed + out.station, kept + out.marks, counts + np.array(out.counts[:])
            if between is not None:
                between(self.state.t, 2.0 * kept * (n + 1))
            parts.append((
                [x[: out.marks].copy() for x in marks], [x[: out.events].copy() for x in found],
                [x[: out.blows].copy() for x in blows],
            ))  # fmt: skip
            room = min(4 * room, max(LARGEST_ROOM, FIRST_ROOM + 8 * m))
        if result == NO_MEMORY:
            raise MemoryError("exact motion")
        # Numbers of marks count over all parts.
        behind = np.cumsum([0, *(len(p[0][0]) for p in parts)])
        for p, first in zip(parts, behind, strict=False):
            p[1][3] += first
            p[2][5] += first
        marks, found, blows = ([np.concatenate(x) for x in zip(*(p[j] for p in parts), strict=True)] for j in range(3))
        t, impulse, before, after, contact, mark = blows
        return Followed(
            result, self.state.t, *marks, *found, Blows(t, contact, impulse, before, after, mark),
            *(x[:passed] for x in at), counts,
        )  # fmt: skip


class Marks(NamedTuple):
    """States from which parts of a motion are computed again: times (k,), eta, rate (k, n), sides (k, m)."""

    t: Array
    eta: Array
    rate: Array
    side: IntArray

    def arguments(self, free: Free) -> tuple[Any, ...]:
        """The arguments of the library."""
        k, n, m = len(self.t), len(free.w2), len(free.rows)
        return (
            k, _address(self.t, float, (k,), "t"), _address(self.eta, float, (k, n), "eta"),
            _address(self.rate, float, (k, n), "rate"), _address(self.side, np.int64, (k, m), "side"),
        )  # fmt: skip


def read(
    free: Free, pressed: Pressed, marks: Marks, times: Array, mark: IntArray, radians: float = RADIANS
) -> tuple[Array, Array, Array]:
    """eta, eta' (k, n) and the reactions of held contacts (k, m) at times (k,), each from its mark."""
    order = np.lexsort((times, mark))
    t, at = np.ascontiguousarray(times[order], float), np.ascontiguousarray(mark[order], np.int64)
    k, n, m = len(t), len(free.w2), len(free.rows)
    if k and not (at[0] >= 0 and at[-1] < len(marks.t)):
        raise ValueError("mark: a number of a mark wanted")
    eta, rate, force = np.empty((k, n)), np.empty((k, n)), np.empty((k, m))
    result = _read(
        *pressed.arguments(free), radians, *marks.arguments(free), k, t.ctypes.data, at.ctypes.data, eta.ctypes.data,
        rate.ctypes.data, force.ctypes.data,
    )  # fmt: skip
    if result != DONE:
        raise MemoryError("exact motion")
    if np.array_equal(order, np.arange(k)):
        return eta, rate, force
    back = np.empty(k, np.int64)
    back[order] = np.arange(k)
    return eta[back], rate[back], force[back]


def press(
    free: Free, pressed: Pressed, marks: Marks, contact: int, starts: Array, ends: Array, radians: float = RADIANS
) -> tuple[Array, Array]:
    """Largest force and impulse of a contact in spans from starts to ends (k,), in order; of rigid stops their
    reactions."""
    if not 0 <= contact < len(free.rows):
        raise ValueError("contact: the number of a contact wanted")
    a, b = np.ascontiguousarray(starts, float), np.ascontiguousarray(ends, float)
    peaks, impulses = np.empty(len(a)), np.empty(len(a))
    result = _press(
        *pressed.arguments(free), radians, *marks.arguments(free), contact, len(a), a.ctypes.data,
        _address(b, float, a.shape, "ends"), peaks.ctypes.data, impulses.ctypes.data,
    )  # fmt: skip
    if result != DONE:
        raise MemoryError("exact motion")
    return peaks, impulses


def work(free: Free, pressed: Pressed, marks: Marks, edges: Array, radians: float = RADIANS) -> Array:
    """Work between consecutive edges (k,), which include every event: (k - 1, 3) of the loads and moving stops, of the
    damping, and of the stops' dashpots."""
    at, found = np.ascontiguousarray(edges, float), np.empty((len(edges) - 1, 3))
    result = _work(
        *pressed.arguments(free), radians, *marks.arguments(free), len(at), at.ctypes.data, found.ctypes.data
    )  # fmt: skip
    if result != DONE:
        raise MemoryError("exact motion")
    return found


def carry(
    free: Free, pressed: Pressed, sides: IntArray, tau: float, eta: Array, rate: Array, radians: float = RADIANS
) -> tuple[Array, Array]:
    """The homogeneous flow over tau, contacts on sides (m,), of eta, eta' (k, n)."""
    eta, rate, n = np.array(eta, float, order="C"), np.array(rate, float, order="C"), len(free.w2)
    k = len(eta)
    result = _carry(
        *pressed.arguments(free), radians, _address(sides, np.int64, (len(free.rows),), "sides"), tau, k,
        _address(eta, float, (k, n), "eta"), _address(rate, float, (k, n), "rate"),
    )  # fmt: skip
    if result != DONE:
        raise MemoryError("exact motion")
    return eta, rate


def pressed_modes(w2: Array, row: Array, kappa: float) -> tuple[Array, NDArray[np.int64], Array]:
    """Shifts (n,) and poles (n,) of the squared frequencies w2[near] + shift with a spring on a row, and modes V."""
    n = len(w2)
    shift, near, V, scratch = np.empty(n), np.empty(n, np.int64), np.empty((n, n)), np.empty(n)
    _modes(
        n, _address(w2, float, (n,), "w2"), _address(row, float, (n,), "row"), kappa, shift.ctypes.data,
        near.ctypes.data, V.ctypes.data, scratch.ctypes.data,
    )  # fmt: skip
    return shift, near, V


_lib = library()
_flown = [ctypes.POINTER(_Free)] * 3 + [Pointer]
_marks = [Int, *[Pointer] * 4]
_follow, _read, _press, _work, _carry, _modes = (
    getattr(_lib, f"exact_{x}") for x in ("follow", "read", "press", "work", "carry", "pressed_modes")
)
_follow.argtypes = [*_flown, ctypes.POINTER(_State), Real, Real, ctypes.POINTER(_Output)]
_read.argtypes = [*_flown, Real, *_marks, Int, *[Pointer] * 5]
_press.argtypes = [*_flown, Real, *_marks, Int, Int, *[Pointer] * 4]
_work.argtypes = [*_flown, Real, *_marks, Int, Pointer, Pointer]
_carry.argtypes = [*_flown, Real, Pointer, Real, Int, Pointer, Pointer]
_modes.argtypes = [Int, Pointer, Pointer, Real, Pointer, Pointer, Pointer, Pointer]
_modes.restype = None
for _function in (_follow, _read, _press, _work, _carry):
    _function.restype = Int
