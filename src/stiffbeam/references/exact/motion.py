"""A motion from event to event: its solver, and its evaluation at any time.

Marks, states behind every event and every few dozen steps, are all that is kept: from the mark before it any part is
computed again, without a search.

    M (q'+ - q'-) = row^T P,  u'+ = -e u'-    at an impact on a rigid stop; several at once: 0 <= P _|_ U+ + e U- >= 0
    F = -(kappa d + c d')_+                   of a compliant one, d its depth: a damped one lets go before it opens
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array, IntArray
from ...basics.resources import afford, in_time
from ...basics.validation import InputError
from ...kernels.library import DONE, STALLED, TOGETHER, Blows, Events, Follower, Free, Marks, States, press, read
from ...model.contact import channel_motion, on_rigid_stops
from ...model.system import System
from ...model.time_functions import evaluate
from ...trajectory.trajectory import SolverFailure
from .free import closed_form, free_system, with_pressed

EPS = float(np.finfo(float).eps)
NO_TIMES = np.zeros(0)
LET_GO = 2  # times the stop: the side of a contact beyond a damped stop that does not press
REMEDY = "check the stops and stiffnesses for sizes that float64 cannot hold together, or use cvode-adams"
# With e = 1 and a lasting load impacts accumulate without end, and the search would never stop.
MOST_IMPACTS = 200_000
NODES, WEIGHTS = np.polynomial.legendre.leggauss(10)
MOST_RADIANS = 1e8  # of the fastest decay of modes without a closed form, each half a step


def pressed(sides: Any) -> IntArray:
    """The sides, 0 where nothing presses."""
    sides = np.asarray(sides, np.int64)
    return np.where(np.abs(sides) == LET_GO, 0, sides)


def switched_by_force(old: int, new: int) -> bool:
    """Return True if a damped stop's force became zero, or its spring's, not the depth."""
    return {abs(old), abs(new)} == {1, LET_GO}


def fresh_after(system: System, before: Sequence[int], after: Sequence[int]) -> IntArray:
    """The stops at which gaps, or forces, are zero exactly after an event from one of the sides to the other, (m,)."""
    fresh = np.zeros(len(system.contacts), np.int64)
    for i, (old, new) in enumerate(zip(before, after, strict=True)):
        # The force of a damped stop jumps where it is entered.
        if old != new and not (old == 0 and system.contacts[i].stops.damping > 0.0):
            fresh[i] = np.sign(new or old)
    return fresh


def require_short(free: Free, length: float) -> None:
    """Raise SolverFailure where every radian of the fastest decay is a step, and these are too many."""
    if free.kind == 0:
        fast = float(np.max(free.w2)) ** 0.5 + float(np.linalg.norm(free.damping, 2))
        if length * fast > MOST_RADIANS:
            reason = f"decay rates of {fast:.2g} leave no closed form, and are too many radians for series"
            raise SolverFailure("exact", 0.0, reason, "use the solver cvode")


class Solver:
    """Solver of one system; free: its free system, where it is known."""

    def __init__(self, system: System, free: Free | None = None) -> None:
        self.system, self.free, self.together = system, free or free_system(system), TOGETHER
        self.eta, self.rate = system.q0 @ self.free.into, system.v0 @ self.free.into
        self.closed = on_rigid_stops(system.contacts, system.q0)
        if self.closed:  # what is on its stop but for rounding is on it
            stops = self._stops_at(self.free.stops, self.eta, np.zeros(len(system.contacts)))
            self.free = self.free.changed(stops=stops)

    def _stops_at(self, stops: Array, eta: Array, off: Array) -> Array:
        """The stops (m, 2) moved to the contacts that start on them, and ``off`` (m,) farther."""
        stops = stops.copy()
        for i, side in self.closed.items():
            place = float(self.free.rows[i] @ eta + evaluate(self.system.contacts[i].offset, 0.0))
            stops[i, int(side > 0)] = place + side * off[i]
        return stops

    def perturbed(self, size: float, seed: int) -> Solver:
        """A solver of a copy of the problem, whose numbers are off by ``size``, relative, each in its own way.

        Contacts that start on their rigid stops, or at rest there, do so in the copy too; those that reach them
        together in the original may do so one after the other.
        """
        twin, free, rng = copy(self), self.free, np.random.default_rng(seed)

        def noise(x: Array) -> Array:
            return size * rng.uniform(-1.0, 1.0, x.shape)

        def off(x: Array) -> Array:
            return x * (1.0 + noise(x))

        other: dict[str, Any] = free.stated | {
            x: off(getattr(free, x)) for x in ("w2", "loads", "rows", "stops", "laws", "pieces")
        }
        lost = noise(free.cancelled) * free.cancelled
        other["loads"] = other["loads"] + lost @ free.X
        other["laws"][:, 2] = free.laws[:, 2]  # restitution 1 is another law than anything below
        twin.eta, twin.rate = off(self.eta), off(self.rate)
        if self.system.rigid:
            # Contacts that do not move each other stay so, and stops move as they do.
            twin.together, other["rows"], other["pieces"] = 0.0, free.rows, free.pieces
            # Bodies without a force have none: pushed off their stops by rounding they would bounce for ever.
            forces = free.loads @ free.into.T
            other["loads"] = free.loads + (off(forces) - forces + lost) @ free.X
            # What is zero by symmetry is off as well: who is hit first may decide.
            twin.eta = twin.eta + np.max(np.abs(self.eta), initial=0.0) * noise(self.eta)
            other["stops"] = self._start_of(twin, other["stops"], rng)
        other |= dict.fromkeys(("up", "low", "V"))
        if free.kind == 2 and free.coupling == 2:  # without another eigenproblem, which loses eps of the largest pole
            lost = np.max(np.abs(free.poles)) * noise(free.poles)
            lost[:, -len(free.waves) :], lost[1, free.poles[1] == 0.0] = 0.0, 0.0  # drives stay, and real poles real
            seen = np.array([other["rows"] @ free.out[0], other["rows"] @ free.out[1]])
            other |= {"poles": free.poles + lost, "answer": off(free.answer), "seen": seen}
            copied = Free(**other)
        else:
            drag = off(free.drag)
            other["damping"] = np.diag(drag) if free.coupling < 2 else off(free.damping)
            copied = closed_form(other)
        twin.free = with_pressed(copied)
        return twin

    def _start_of(self, twin: Solver, stops: Array, rng: np.random.Generator) -> Array:
        """Stops (m, 2) of a copy moved to the contacts that start on them; those that rest there are stopped.

        Contacts that touch their stops and do not press, and all where one of several is hit at once, are a rounding
        off: the order of blows may decide.
        """
        closed, v0, rows, contacts = self.closed, self.system.v0, self.free.rows, self.system.contacts
        still = [i for i in closed if contacts[i].offset is None and not np.any(contacts[i].row * v0)]
        speeds = {
            i: side * float(contacts[i].row @ v0 + evaluate(contacts[i].offset, 0.0, 1)) for i, side in closed.items()
        }
        hit = any(speed > 0.0 for i, speed in speeds.items() if i not in still)
        loose = [i for i in closed if (hit and len(closed) > 1) or (i in still and not self._pressed_at_start[i])]
        reach, off = np.abs(twin.eta) + np.abs(twin.rate) / self.fastest, np.zeros(len(rows))
        rounding = 4.0 * EPS * np.abs(rows) @ (reach + EPS * np.max(reach, initial=0.0))
        off[loose] = rng.uniform(size=len(loose)) * rounding[loose]
        if still:
            held = rows[still]
            twin.rate = twin.rate - held.T @ np.linalg.solve(held @ held.T, held @ twin.rate)
        return self._stops_at(stops, twin.eta, off)

    @property
    def fastest(self) -> float:
        """The largest angular frequency of the free modes, 1 where there is none."""
        return math.sqrt(float(np.max(self.free.w2))) or 1.0

    @cached_property
    def _pressed_at_start(self) -> Array:
        """True for the contacts that rigid stops hold against a force soon after t = 0, (m,)."""
        soon = 0.01 / self.fastest
        forces = np.abs(self.solve(soon).reactions(np.array([0.5 * soon]))[0])
        return forces > 1e-9 * np.max(forces, initial=0.0)

    def solve(
        self, t_end: float, start: tuple[Array, Array] | None = None, stations: Array = NO_TIMES, t: float = 0.0,
        sides: IntArray | None = None, fresh: IntArray | None = None,
    ) -> Motion:  # fmt: skip
        """The motion on [t, t_end] from q, q' (n,), of the system by default, with the contacts on ``sides`` (m,);
        fresh: see ``fresh_after``. Raises SolverFailure where it cannot go on; the states at ``stations`` (k,),
        increasing, are found on the way."""
        require_short(self.free, t_end - t)

        def check(reached: float, marks: int, events: int) -> None:
            in_time(reached)
            floats = 2.0 * marks * (self.system.size + 1)
            if floats > 2**22:  # a small part tells nothing of the whole
                afford("t_end", t_end, "shorten t_end", floats=floats / max((reached - t) / (t_end - t), 1e-12))
            if self.system.rigid and events > MOST_IMPACTS:
                rule = f"hold at most {MOST_IMPACTS} impacts"
                raise InputError("t_end", t_end, rule, f"end before t = {reached:.6g}")

        follower = self.follower(start, t, sides, fresh)
        result, marks, events, blows, passed = follower.follow(t_end, stations, check)
        if result != DONE:
            stalled = "events follow each other without an advance of time"
            reason = stalled if result == STALLED else "the motion overflows float64"
            raise SolverFailure("exact", follower.state.t, reason, REMEDY)
        # Segments begin at the start and behind every event. The last event may come with t_end: no mark is behind it.
        first = np.unique(np.concatenate([[0], events[3]]))
        first = first[: np.searchsorted(first, len(marks.t))]
        seen = (stations, *passed) if len(passed[0]) == len(stations) else None
        return Motion(self.system, self.free, marks, first, follower.state.evaluations, events, blows, seen)

    def follower(
        self, start: Sequence[Array] | None, t: float = 0.0, sides: IntArray | None = None,
        fresh: IntArray | None = None,
    ) -> Follower:  # fmt: skip
        """The kernel's motion from q, q' (n,) at t, see ``solve``. Without ``sides`` those of gaps that are zero are
        decided by the first derivative that is not."""
        eta, rate = (self.eta, self.rate) if start is None else (x @ self.free.into for x in start)
        return Follower(self.free, eta, rate, t, sides, fresh, self.together)


_WHOLE = np.zeros(0, np.int64)
NO_EVENTS = NO_TIMES, _WHOLE, _WHOLE, _WHOLE
NO_BLOWS = Blows(NO_TIMES, NO_TIMES, NO_TIMES, NO_TIMES, _WHOLE, _WHOLE, _WHOLE)


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """Segments: first_mark[i] is the mark where segment i begins, at times[i] with the contacts on sides[i] (m,).

    events: times, contacts, sides behind (9 times the stop: thrown back) and marks behind, (events,) each. blows: the
    impulses of rigid stops.
    """

    system: System
    free: Free
    marks: Marks
    first_mark: IntArray
    evaluations: int
    events: Events = NO_EVENTS
    blows: Blows = NO_BLOWS
    seen: tuple[Array, ...] | None = None  # times and the states there
    last: list[Any] = field(default_factory=list)  # the same of the last times that were read

    def first(self, count: int) -> Motion:
        """The first ``count`` segments."""
        if count >= len(self.times):
            return self
        marks = Marks(*(np.ascontiguousarray(x[: self.first_mark[count]]) for x in self.marks))
        return replace(self, marks=marks, first_mark=self.first_mark[:count], last=[])

    @cached_property
    def times(self) -> Array:
        """Times at which the segments begin."""
        return self.marks.t[self.first_mark]

    @cached_property
    def sides(self) -> IntArray:
        """Sides of the contacts in every segment, (segments, m), see exact.h."""
        return self.marks.side[self.first_mark]

    @cached_property
    def fastest(self) -> float:
        """A bound of the angular frequencies of all undamped motions and of the drives."""
        free = self.free
        squares = [float(np.max(x.w2)) for x in (free, free.up, free.low) if x is not None]
        if free.V is None:
            stiff = np.any(np.abs(self.sides) == 1, axis=0) & np.isfinite(free.laws[:, 0])
            squares[0] += float(np.sum((free.laws[:, 0] * np.diag(free.meet))[stiff]))
        return max(math.sqrt(max(squares)), *free.waves.tolist(), 1e-300)

    def piece_at(self, t: Array) -> NDArray[np.int64]:
        """The segment that each time t (k,) lies in; an event belongs to the segment it begins."""
        return np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)

    def modal(self, t: Array, piece: NDArray[np.int64] | None = None) -> States:
        """eta, eta' (k, n) and reactions of held contacts (k, m) at times t (k,) as the given segments have them."""
        t = np.array(t, float)
        if piece is None:
            for kept in (self.seen, *self.last):
                if kept is not None and np.array_equal(kept[0], t):
                    return kept[1:]  # type: ignore[return-value]
        mark = self.mark_at(t, self.piece_at(t) if piece is None else piece)
        found = read(self.free, self.marks, t, mark)
        if piece is None:
            self.last[:] = [(t, *found)]
        return found

    def mark_at(self, t: Array, piece: NDArray[np.int64]) -> NDArray[np.int64]:
        """The last mark before each time t (k,), in the given segments."""
        ends = np.append(self.first_mark[1:], len(self.marks.t))
        return np.clip(np.searchsorted(self.marks.t, t, "right") - 1, self.first_mark[piece], ends[piece] - 1)

    def states(self, t: Array, piece: NDArray[np.int64] | None = None) -> tuple[Array, Array]:
        """q, q' (k, n) at any times, as the given segments have them, whose ends they may be."""
        eta, rate, _ = self.modal(t, piece)
        return eta @ self.free.X.T, rate @ self.free.X.T

    def path(self, t: Array, channel: int) -> tuple[Array, Array]:
        """Position and velocity of a channel at any times, (k,) each; of a held contact those of its stop."""
        row, function = self.system.channels[channel]
        eta, rate, _ = self.modal(t)
        u, v = channel_motion(row @ self.free.X, function, t, eta, rate)
        if not self.system.rigid or channel >= len(self.system.contacts):
            return u, v
        stops, side = self.system.contacts[channel].stops, self.sides[self.piece_at(t), channel]
        u = np.where(side > 0, stops.law.g2, np.where(side < 0, stops.law.g1, u))
        return u, np.where(side != 0, 0.0, v)

    def press(self, contact: int, starts: Array, ends: Array) -> tuple[Array, Array]:
        """Peak |sigma| and the integral of |sigma| in the spans [starts, ends] (k,) of contact, in order."""
        return press(self.free, self.marks, contact, starts, ends)

    def reactions(self, t: Array) -> Array:
        """Forces (k, m) of rigid stops on the positions of held contacts at any times."""
        return self.modal(t)[2]

    def work(self, edges: Array) -> tuple[Array, Array, Array]:
        """Work of the loads and moving stops, viscous loss, and loss in the stops' dashpots between consecutive edges,
        which include every event: Gauss's rule in parts in which the motion turns by pi or decays by e at most."""
        span, n, free = float(edges[-1] - edges[0]), self.system.size, self.free
        require_short(free, span)
        turning, dashpots = self.fastest, float(free.laws[:, 1] @ np.diag(free.meet))
        decay = float(np.linalg.norm(free.damping, 2)) + dashpots
        if span * turning > MOST_RADIANS:
            reason = f"its energy is a sum over {span * turning:.2g} radians of the motion, more than {MOST_RADIANS:g}"
            raise SolverFailure("exact", 0.0, reason, "shorten t_end")
        longest = min(np.pi / turning, span)
        # Behind events and samples what decays is fast at first: parts that double.
        doublings = max(0, math.ceil(math.log2(max(decay * longest, 1.0))))
        grades = np.append(0.0, 2.0 ** np.arange(doublings) / max(decay, 1e-300))
        begun = np.concatenate([self.times, free.edges])
        at = np.linspace(edges[0], edges[-1], 2 + int(span / longest))
        at = np.unique(np.concatenate([edges, at, np.add.outer(begun, grades).ravel()]))
        at = at[(at >= edges[0]) & (at <= edges[-1])]
        found = np.empty((3, len(at) - 1))
        for part in np.array_split(np.arange(len(at) - 1), 1 + len(at) * n // 2**17):
            middle, half = 0.5 * (at[part + 1] + at[part]), 0.5 * (at[part + 1] - at[part])
            t = middle[:, None] + half[:, None] * NODES
            found[:, part] = half * (self._powers(t.ravel()).reshape(3, *t.shape) @ WEIGHTS)
        return tuple(np.add.reduceat(found, np.searchsorted(at, edges[:-1]), axis=1))  # type: ignore[return-value]

    def _powers(self, t: Array) -> Array:
        """Powers at times t (k,) of loads and moving stops, of the damping, and of the stops' dashpots, (3, k)."""
        free, piece = self.free, self.piece_at(t)
        eta, rate, force = read(free, self.marks, t, self.mark_at(t, piece))
        given, stops = np.zeros(len(t)), np.zeros(len(t))
        for vector, function in self.system.loads:
            given += evaluate(function, t) * (rate @ (vector @ free.X))
        lost = np.sum(rate * (rate @ free.damping.T), axis=1) if free.coupling == 2 else rate**2 @ free.drag
        for i, contact in enumerate(self.system.contacts):
            side, moves = self.sides[piece, i], evaluate(contact.offset, t, 1)
            if contact.stops.rigid:
                given -= force[:, i] * moves
                continue
            u, speed = eta @ free.rows[i] + evaluate(contact.offset, t), rate @ free.rows[i] + moves
            stop = np.where(side > 0, free.stops[i, 1], free.stops[i, 0])
            pull = free.laws[i, 0] * np.where(side != 0, u - stop, 0.0)
            drag, presses = free.laws[i, 1] * speed, np.abs(side) == 1
            given += np.where(presses, (drag + pull) * moves, 0.0)
            # Beyond a stop that has let go its energy falls without a force.
            stops += np.where(presses, drag, -pull) * speed
        return np.array([given, lost, stops])


def joined(parts: Sequence[Motion]) -> Motion:
    """One motion of parts that follow each other."""
    behind = np.cumsum([0, *(len(part.marks.t) for part in parts)])
    first = np.concatenate([part.first_mark + k for part, k in zip(parts, behind, strict=False)])
    marks = Marks(*(np.concatenate(x) for x in zip(*(part.marks for part in parts), strict=True)))
    evaluations = sum(part.evaluations for part in parts)
    return replace(parts[0], marks=marks, first_mark=first, evaluations=evaluations, seen=None, last=[])
