"""A motion from event to event: its solver, and its evaluation at any time.

Marks, states behind every event and every few dozen steps, are all that is kept: from the mark before it any part is
computed again, without a search.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array, IntArray
from ...basics.resources import Forecast
from ...kernels.exact import NOT_FINITE, RADIANS, STALLED, Followed, Follower, Marks, carry, press, read, work
from ...model.contact import Contact
from ...model.system import System
from ...model.time_functions import Drive
from ...piecewise.search import REMEDY
from ...trajectory.trajectory import SolverFailure
from .free import FreeSystem, closed_form, free_system, pressed_system

NO_TIMES = np.zeros(0)


class Solver:
    """Solver of one system. radians: of the fastest motion in a step of series."""

    def __init__(self, system: System, made: FreeSystem | None = None, radians: float = RADIANS) -> None:
        self.system, self.drive, self.radians = system, Drive.of(system), radians
        self.made = made or free_system(system, self.drive)
        self.eta, self.rate = self.made.start(system.q0, system.v0)

    def perturbed(self, size: float, seed: int) -> Solver:
        """A solver of a copy of the problem, whose numbers are off by ``size``, relative, each in its own way."""
        twin, free, rng = copy(self), self.made.free, np.random.default_rng(seed)

        def off(x: Array) -> Array:
            return x * (1.0 + size * rng.uniform(-1.0, 1.0, x.shape))

        shared = {
            name: getattr(free, name) for name in ("coupling", "waves", "edges", "damping", "drag", "meet", "offsets")
        } | {name: off(getattr(free, name)) for name in ("w2", "loads", "rows", "stops", "laws", "pieces")}
        if free.kind == 2 and free.coupling == 2:  # without another eigenproblem, which loses eps of the largest pole
            lost = size * np.max(np.abs(free.poles)) * rng.uniform(-1.0, 1.0, free.poles.shape)
            exponentials = np.arange(free.poles.shape[1]) < free.poles.shape[1] - len(free.waves)
            real = (free.poles[1] == 0.0) & (np.arange(2) > 0)[:, None]
            copied = free.changed(**shared, poles=free.poles + np.where(exponentials & ~real, lost, 0.0))
        else:
            shared["drag"] = off(free.drag)
            shared["damping"] = np.diag(shared["drag"]) if free.coupling < 2 else off(free.damping)
            copied = closed_form(shared)
        twin.made = self.made._replace(free=copied, pressed=pressed_system(copied))
        twin.eta, twin.rate = off(self.eta), off(self.rate)
        return twin

    def solve(self, t_end: float, start: tuple[Array, Array] | None = None, stations: Array = NO_TIMES) -> Motion:
        """The motion on [0, t_end] from q, q' (n,), of the system by default. Raises SolverFailure where it cannot go
        on; the states at ``stations`` (k,), increasing, are found on the way."""
        eta, rate = (self.eta, self.rate) if start is None else self.made.start(*start)
        forecast = Forecast(t_end)
        follower = Follower(self.made.free, self.made.pressed, eta, rate)
        found = follower.follow(t_end, stations, self.radians, lambda t, floats: forecast.check(t, floats))
        return self.motion_of(found, t_end, stations)

    def motion_of(self, found: Followed, t_end: float, stations: Array) -> Motion:
        """A Motion from the results of the kernel; SolverFailure where they end before t_end."""
        if found.result == STALLED:
            raise SolverFailure("exact", found.t, "events follow each other without an advance of time", REMEDY)
        if found.result == NOT_FINITE:
            raise SolverFailure("exact", found.t, "the motion overflows float64", REMEDY)
        first = np.concatenate([[0], found.event_mark])
        # The last event may come with t_end: no mark is behind it.
        first = first[: np.searchsorted(first, len(found.mark_t))]
        seen = (stations, found.eta_at, found.rate_at, found.force_at) if len(found.eta_at) == len(stations) else None
        return Motion(
            self.system, self.made, self.radians, np.append(0.0, found.event_t[: len(first) - 1]),
            found.mark_side[first], first, Marks(found.mark_t, found.mark_eta, found.mark_rate, found.mark_side),
            int(found.counts[0] + found.counts[2]), seen,
        )  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """Segments: at times[i] the contacts are on sides[i] (m,), see exact.h; first[i] is the mark there."""

    system: System
    made: FreeSystem
    radians: float
    times: Array
    sides: IntArray
    first_mark: IntArray
    marks: Marks
    evaluations: int
    seen: tuple[Array, ...] | None = None  # times and the states there
    last: list[Any] = field(default_factory=list)  # the same of the last times that were read

    def first(self, count: int) -> Motion:
        """The first ``count`` segments."""
        return replace(
            self, times=self.times[:count], sides=self.sides[:count], first_mark=self.first_mark[:count], last=[]
        )

    @property
    def drive(self) -> Drive:
        """The drive of the system."""
        return Drive.of(self.system)

    @cached_property
    def _fastest(self) -> float:
        free, pressed = self.made.free, self.made.pressed
        squares = [float(np.max(x.w2)) for x in (free, pressed.up, pressed.low) if x is not None]
        if pressed.up is None and pressed.low is None:
            stiff = np.any(np.abs(self.sides) == 1, axis=0) & np.isfinite(free.laws[:, 0])
            squares[0] += float(np.sum((free.laws[:, 0] * np.diag(free.meet))[stiff]))
        return math.sqrt(max(squares))

    @cached_property
    def shortest_period(self) -> float:
        """A bound of the shortest period of all motions and drives."""
        return 2.0 * np.pi / max(self._fastest, *self.drive.frequencies, 1e-300)

    @cached_property
    def fastest_decay(self) -> float:
        """A bound of the decay rates of all modes and dashpots, 1/time."""
        free = self.made.free
        rates = float(np.max(-free.poles[0], initial=0.0))
        if free.coupling == 2:
            rates = max(rates, float(np.linalg.norm(free.damping, 2)))
        pressed = np.any(np.abs(self.sides) == 1, axis=0) & np.isfinite(free.laws[:, 0])
        return rates + float(np.sum((free.laws[:, 1] * np.diag(free.meet))[pressed]))

    def piece_at(self, t: Array) -> NDArray[np.int64]:
        """The segment that each time t (k,) lies in; an event belongs to the segment it begins."""
        return np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)

    def _read(self, t: Array, piece: NDArray[np.int64] | None = None) -> tuple[Array, Array, Array]:
        """eta, eta' (k, n) and reactions of held contacts (k, m) at times t (k,) as the given segments have them."""
        t = np.array(t, float)
        if piece is None:
            for kept in (self.seen, self.last[0] if self.last else None):
                if kept is not None and np.array_equal(kept[0], t):
                    return kept[1:]  # type: ignore[return-value]
        where = self.piece_at(t) if piece is None else piece
        ends = np.append(self.first_mark[1:], len(self.marks.t))
        mark = np.clip(np.searchsorted(self.marks.t, t, "right") - 1, self.first_mark[where], ends[where] - 1)
        found = read(self.made.free, self.made.pressed, self.marks, t, mark, self.radians)
        if piece is None:
            self.last[:] = [(t, *found)]
        return found

    def states(self, t: Array) -> tuple[Array, Array]:
        """q, q' (k, n) at any times."""
        eta, rate, _ = self._read(t)
        return eta @ self.made.X.T, rate @ self.made.X.T

    def states_in(self, t: Array, piece: NDArray[np.int64]) -> tuple[Array, Array]:
        """q, q' (k, n) as the given segments have them at times t, which may be the ends of those."""
        eta, rate, _ = self._read(t, piece)
        return eta @ self.made.X.T, rate @ self.made.X.T

    def state_at_start(self, piece: int) -> tuple[Array, Array]:
        """q, q' (1, n) where a segment begins, from that segment."""
        return self.states_in(self.times[piece : piece + 1], np.array([piece]))

    def observed(self, t: Array, row: Array) -> tuple[Array, Array]:
        """row @ q and its rate at any times, (k,)."""
        eta, rate, _ = self._read(t)
        row = row @ self.made.X
        return eta @ row, rate @ row

    def flow(self, piece: int, tau: float, dq: Array, dv: Array) -> tuple[Array, Array]:
        """The homogeneous flow of a segment's regime over tau: (n, k) -> (n, k)."""
        into, X = self.made.into, self.made.X
        sides = np.ascontiguousarray(self.sides[piece])
        eta, rate = carry(self.made.free, self.made.pressed, sides, tau, dq.T @ into, dv.T @ into, self.radians)
        return X @ eta.T, X @ rate.T

    def press(
        self, system: System, contact: int, starts: Array, ends: Array, sides: NDArray[np.int64]
    ) -> tuple[Array, Array]:
        """Peak |sigma| and the integral of |sigma| in the spans [starts, ends] (k,) of contact, in order."""
        return press(self.made.free, self.made.pressed, self.marks, contact, starts, ends, self.radians)

    def offset(self, system: System, channel: int) -> Callable[[Array], tuple[Array, Array]]:
        """o(t) and o'(t) of a channel."""
        return self.drive.offset(system, channel)

    def settled(self, system: System, t: Array, channel: int, u: Array, v: Array) -> tuple[Array, Array]:
        """Position u and velocity v of a channel at times t, without the rounding of a held contact."""
        return u, v

    def force(self, contact: Contact, i: int, t: Array, piece: NDArray[np.int64]) -> Array:
        """Force of stop i on its contact, without that of a damper, at times t (k,) in the given segments."""
        u, sigma = self.observed(t, contact.row)[0] + self.offset(self.system, i)(t)[0], 0.0
        for side in (-1, 1):
            kappa, constant = contact.stops.spring(side)
            sigma = sigma + np.where(self.sides[piece, i] == side, constant - kappa * u, 0.0)
        return np.asarray(sigma)

    def work(self, system: System, edges: Array) -> tuple[Array, Array, Array]:
        """Work of the loads and moving stops, viscous loss, and loss in the stops' dashpots between consecutive edges,
        which include every event."""
        found = work(self.made.free, self.made.pressed, self.marks, edges, self.radians)
        return found[:, 0], found[:, 1], found[:, 2]
