"""One door to the library of the kernels: the structures of its headers, the checks of what is handed to it, since C
checks nothing, and the functions of march.h and exact.h. The library releases the GIL.

An array of another type, shape or order raises TypeError.
"""

from __future__ import annotations

import ctypes
import math
import os
import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ..basics.arrays import Array, IntArray, padded
from ..basics.resources import clock
from . import compile as compilation

Address, SCALARS = ctypes.c_void_p, dict[str, Any](Int=ctypes.c_int64, double=ctypes.c_double, void=None)
FLOAT, INTEGER = np.dtype(np.float64), np.dtype(np.int64)

LINEAR, BY_LAW, MEAN = range(3)  # how a node finds its force: of springs, any law, or its mean over the step
LAW, TALLY, EVENT = 6, 8, 6  # numbers of a law, a tally and an impact
OVERFLOW = 1e100  # A position beyond this ends the run. Its square, in an energy, is still a float64.
AT_A_STOP, WHERE_PREDICTED, WHERE_CLOSED = range(3)  # when a node can press; the first in a position, else a velocity
DONE, FULL, STALLED, NOT_FINITE = range(4)
TOGETHER = 16.0  # roundings of the time within which rigid stops are hit together
FIRST_ROOM, LARGEST_ROOM = 256, 8192  # marks, events and blows of one call
SHORT = 0.05  # CPU seconds of a call that is followed by a longer one: between two of them a deadline is looked at


@cache
def declarations(header: str) -> str:
    """A header of the kernels without its comments."""
    text = (compilation.FOLDER / header).read_text(encoding="utf-8")
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


@cache
def library() -> ctypes.CDLL:
    """The compiled kernels; in a checkout they are compiled where the library is missing or of other sources.

    STIFFBEAM_KERNELS names another library. Its functions hold no GIL.
    """
    other = os.environ.get("STIFFBEAM_KERNELS")
    path = Path(other) if other else compilation.library_path()
    if not other and not path.exists():
        compilation.build()
    found = ctypes.CDLL(os.fspath(path))
    text = "".join(map(declarations, ("march.h", "rhs.h", "exact.h")))
    for result, name, arguments in re.findall(r"^API (\w+) (\w+)\(([^)]*)\);", text, re.MULTILINE):
        function, arguments = getattr(found, name), arguments.split(",")
        function.restype = SCALARS[result]
        function.argtypes = [Address if "*" in x else SCALARS[x.split()[0]] for x in arguments]
    return found


class Structure:
    """A structure of C, as a header declares it with the shapes of its arrays, see SHAPE in law.h.

    An array that may be None or have no entries is NULL in C. parts: the structures within it, by type.
    """

    def __init__(self, header: str, name: str) -> None:
        declared = re.findall(rf"typedef struct \w*\s*{{([^}}]*)}} {name};", declarations(header))[0]
        fields, self.arrays = list[tuple[str, Any]](), list[tuple[str, list[str], Any, bool]]()
        self.parts = dict[str, Structure]()
        for declaration in declared.split(";")[:-1]:  # const double *w2 SHAPE(n), ...
            kind, names = re.sub(r"\b(const|struct) ", "", declaration).split(maxsplit=1)
            for star, field, macro, shape in re.findall(r"(\*?)(\w+)(?: (SHAPE|OR_NULL)\((.*?)\))?", names):
                if not star and kind not in {*SCALARS, *self.parts}:
                    self.parts[kind] = Structure(header, kind)
                fields.append((field, Address if star else SCALARS.get(kind) or self.parts[kind].type))
                if shape:
                    dtype = INTEGER if kind == "Int" else FLOAT
                    self.arrays.append((field, shape.split(", "), dtype, macro == "OR_NULL"))
        self.names = {field for field, _ in fields} - {field for field, *_ in self.arrays}
        sizes = {size for _, shape, *_ in self.arrays for size in shape}
        self.numbers = {size: int(size) for size in sizes if size.isdigit()}
        # Sizes that are sums of products of others.
        self.sums = {size: [x.split() for x in size.split(" + ")] for size in sizes if " " in size}
        own = {"_fields_": fields, "_as_parameter_": property(ctypes.addressof)}
        self.type = type("Structure", (ctypes.Structure,), own)

    def _known(self, sizes: dict[str, Any]) -> dict[str, Any]:
        """All sizes, from those of fields."""
        known = self.numbers | sizes
        for size, terms in self.sums.items():
            known[size] = sum(math.prod(int(x) if x.isdigit() else known.get(x, 0) for x in term) for term in terms)
        return known

    def new(self, given: Mapping[str, Any] | None = None, /, **numbers: Any) -> Any:
        """The structure with arrays of these sizes, those that are not ``given`` zero."""
        known = self._known(numbers)
        arrays = {name: np.zeros([known[x] for x in shape], dtype) for name, shape, dtype, _ in self.arrays}
        return self(arrays | dict(given or {}), **numbers)

    def __call__(self, arrays: Mapping[str, Any], **numbers: Any) -> Any:
        """The structure, which keeps its ``arrays``. A size that is not among the ``numbers`` is that of the first
        array that has it; what neither gives is 0.

        Raises TypeError for arrays of other shapes.
        """
        given = list[tuple[str, Any, list[str], Any]]()
        for name, shape, dtype, optional in self.arrays:
            if name not in arrays:
                raise TypeError(f"{name}: an array wanted, or None for none")
            x = arrays[name]
            if optional and (x is None or not x.size):
                continue
            given.append((name, x, shape, dtype))
            for size, length in zip(shape, getattr(x, "shape", ()), strict=False):
                if size not in self.sums:
                    numbers.setdefault(size, length)
        known = self._known(numbers)
        at = {name: address(x, tuple([known.get(k, -1) for k in shape]), dtype) for name, x, shape, dtype in given}
        structure: Any = self.type(**at, **{name: known[name] for name in self.names if name in known})
        structure.arrays = {name: x for name, x, *_ in given}
        return structure


def address(x: Any, shape: tuple[int, ...], dtype: Any = FLOAT) -> int:
    """Address of an array of this type and shape, row by row.

    Raises TypeError for any other array. The caller keeps the array as long as the address is used.
    """
    if not isinstance(x, np.ndarray) or x.dtype != dtype or x.shape != shape or not x.flags.c_contiguous:
        given = f"{getattr(x, 'dtype', type(x).__name__)} {getattr(x, 'shape', '')}"
        raise TypeError(f"a kernel takes a {dtype} array of shape {shape}, row by row, not {given}")
    return x.ctypes.data


def filled(status: int) -> int:
    """A kernel's result. Raises MemoryError where it found no memory."""
    if status < 0:
        raise MemoryError("no memory for a kernel")
    return status


# ---------------------------------------------------------------- march.h

BLOCK, DRIVE, _RUN, _RIGID = (Structure("march.h", name) for name in ("Block", "Drive", "Run", "Rigid"))


def run(block: Any, drive: Any, arrays: Mapping[str, Any], first: int, steps: int, every: int, dt: float) -> bool:
    """Compute ``steps`` steps from step ``first`` with a BLOCK, a DRIVE and the arrays of a Run.

    Returns True if all are done; where the list of impacts may not hold another block's, False is returned and the call
    can be made again with a longer one.
    """
    outputs = len(arrays["positions"])
    if 0 < outputs <= (first + steps) // every or min(first, steps) < 0:
        raise ValueError("outputs do not fit the steps")
    if block.nodes % max(1, block.K * len(arrays["law"])):
        raise ValueError("contacts do not fit the block")
    x = _RUN(
        arrays, first=first, steps=steps, every=every, dt=dt, B=-(-steps // block.K), C=block.C, K=block.K,
        N=block.N, R=block.R, D=block.D, state=block.D + (block.a - 1) * block.n,
        W=padded(block.D + 1 + 2 * drive.F) + block.N,
    )  # fmt: skip
    return bool(filled(library().march(block, drive, x)))


def switch_time(u0: float, v0: float, u1: float, v1: float, side: float, law: Array, dt: float) -> float:
    """Fraction of the step, 0 to 1, at which contact with the stop on ``side`` begins or ends, from positions and
    velocities at both ends; law (6,).

    That is where the cubic Hermite interpolant crosses the stop. At a damped stop that is penetrated, or held on to
    rounding, contact ends, and begins again, where the force changes sign.
    """
    return library().switch_time(u0, v0, u1, v1, side, address(law, (LAW,)), dt)


def states(transition: Array, push: Array, forces: Array, starts: Array, K: int, room: Array) -> Array:
    """q and q' (2, 1 + steps, n) at the ends of single steps under known forces, every K steps from one of the starts.
    The first row, before the steps, is zero.

    transition: (a, a n), as in a Block; push: (F, a n); forces: (steps, F); starts: (B, a n). room: numbers in a row,
    the first of which the result takes.
    """
    (a, D), (steps, F), B = transition.shape, forces.shape, -(-len(forces) // K)
    n, z = D // a, np.empty((3, D))
    out = room[: 2 * (1 + steps) * n].reshape(2, 1 + steps, n)
    out[:, 0] = 0.0
    arrays = (transition, (a, a * n)), (push, (F, D)), (forces, (steps, F)), (starts, (B, D))
    at = (address(x, shape) for x, shape in (*arrays, (z, z.shape), (out, out.shape)))
    library().states(a, n, F, steps, K, *at)
    return out


def rigid_steps(linear: Mapping[str, Array], **given: Array) -> tuple[Array, Array]:
    """States (K, D) at the ends of K steps from z (D,), advanced in place, and reactions (K, S, m).

    linear, given: the arrays of Rigid in march.h; ``linear`` those of the scheme, ``given`` driven, shifts, predicted
    and z.
    """
    (S, m, D), K = linear["reading"].shape, len(given["driven"])
    path, reactions = np.empty((K, D)), np.empty((K, S, m))
    filled(library().rigid_steps(_RIGID({**linear, **given, "path": path, "reactions": reactions})))
    return path, reactions


def contact_forces(u: Array, v: Array, law: Array, energy: Array | None = None) -> Array:
    """F(u, u') on the beam, of the shape of u and v; law (.., 6), of each or of all. ``energy`` takes U(u)."""
    shape = np.shape(u)
    law = law if law.shape == (*shape, LAW) else np.broadcast_to(law, (*shape, LAW))
    u, v, law, F = *(np.asarray(x, float, order="C") for x in (u, v, law)), np.empty(shape)
    at = address(u, shape), address(v, shape), address(law, (*shape, LAW)), address(F, shape)
    library().contact_forces(F.size, *at, None if energy is None else address(energy, shape))
    return F


# ---------------------------------------------------------------- exact.h: motion of the modes, event by event

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
