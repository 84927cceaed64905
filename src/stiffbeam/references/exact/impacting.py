"""Rigid stops with Newton's law of restitution, from event to event: impacts, chatter brought to its end, sticking.

    u'+ = -e u'-  where a gap closes,   M (q'+ - q'-) = row^T P;  several at once: 0 <= P _|_ U+ + e U- >= 0
    among those that are approached; one that this drives into its stop is hit after it
    M q'' + C q' + K q = f + row^T R,   u = g while a contact is held; it lets go where R = 0

Far from events the motion is in closed form, by the compiled loop of piecewise; around them, and while a contact is
held, it is a Taylor series (taylor.py): an event is the first zero of a gap or of a reaction in it.
After an impact the gap's series starts with an exact zero and the exact speed, so that flights of any length are
found to rounding, relative to themselves. Where e < 1 impacts may accumulate: speeds v_k = e^k v_0 under the
acceleration a into the stop end after 2 v/(a (1 - e)) to first order. Once that is short against every motion, CHATTER
radians, the rest of the series is summed with a and a' as they are, the speed taken at once, and the contact held.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...basics.exact_float import exact_value
from ...basics.validation import InputError
from ...model.active_set import solve_node
from ...model.system import System
from ...piecewise.follow import DONE, follow
from ...piecewise.motion import Motion
from ...piecewise.regimes import Regimes, Source
from ...piecewise.rounding import Perturbation
from ...piecewise.touching import EPS
from ...piecewise.tracer import QUIET
from ...trajectory.trajectory import SolverFailure
from ..rigid_stops import order_decides
from .taylor import Model, first_zero, rate, stays, value

LEFT = 1e-12  # of the distance between a stop and a start, relative: the start is on the stop


def on_stops(model: Model) -> dict[int, int]:
    """The contacts on their stops at t = 0, by their sides. Raises InputError for one beyond its stop."""
    closed = {}
    for contact, each in enumerate(model.system.contacts):
        moved = float(model.shift(contact, 0.0)[0])
        u = float(model.rows[contact] @ model.system.q0) + moved
        for side, g in ((1, each.stops.upper_bound), (-1, each.stops.lower_bound)):
            if math.isfinite(g) and side * (u - g) >= -LEFT * max(abs(g), abs(moved)):
                if side * (u - g) > LEFT * max(abs(g), abs(moved)):
                    remedy = "move the stop or the start"
                    raise InputError("initial displacement", u, "lie between rigid stops", remedy)
                closed[contact] = side
    return closed


def off_stop(model: Model, contact: int, side: int) -> bool:
    """Tell whether the start, as it is written, is not exactly on the stop of a contact."""
    each = model.system.contacts[contact]
    ratio, pi = exact_value(each.stops.upper if side > 0 else each.stops.lower)  # type: ignore[arg-type]
    terms = zip(model.rows[contact].tolist(), model.system.q0.tolist(), strict=True)
    shifted = model.shift(contact, 0.0)[0] != 0.0
    return pi or shifted or sum(Fraction(row) * Fraction(q) for row, q in terms) != ratio


def together_but_for_rounding(model: Model, compliance: Array, closed: dict[int, int], going: dict[int, int]) -> bool:
    """Tell whether contacts that move each other start on their stops but for rounding, so that who is hit first is not
    known."""
    joined = {c for c in closed for x in going if c != x and compliance[c, x]}
    return any(off_stop(model, c, closed[c]) for c in joined | (going.keys() if joined else set()))


def at_rest(model: Model) -> list[int]:
    """Contacts that start at rest on their stops as they are written, not but for rounding."""
    found = []
    for contact, each in enumerate(model.system.contacts):
        still = each.offset is None and not np.any(model.rows[contact] * model.system.v0)
        stops = (1, each.stops.upper_bound), (-1, each.stops.lower_bound)
        if still and any(math.isfinite(g) and not off_stop(model, contact, side) for side, g in stops):
            found.append(contact)
    return found


@dataclass(eq=False)
class Event:
    """An impact on ``side`` of a contact; ``end`` > ``time`` where the contact is then held."""

    contact: int
    side: int
    time: float
    impulse: float
    end: float = math.nan


@dataclass(eq=False)
class RigidMotion:
    """Stretches from times (k,) on, with states and the contacts held in each; what impacts took."""

    model: Model
    times: list[float] = field(default_factory=list)
    states: list[tuple[Array, Array]] = field(default_factory=list)
    held: list[tuple[int, ...]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    struck: list[tuple[float, int, float]] = field(default_factory=list)  # time, contact, impulse that is no event's
    blows: list[tuple[int, int]] = field(default_factory=list)  # stretch at whose start it is, contact
    taken: list[tuple[float, float, float]] = field(default_factory=list)  # time, energy taken, put in by stops moving
    stuck: list[tuple[float, int]] = field(default_factory=list)  # where a contact's impacts ended, and which
    tie: float = math.inf  # where two contacts first close together but for rounding, and the order matters
    flights: dict[int, Motion] = field(default_factory=dict)  # stretches in closed form, by their places

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """q, q' (k, n) and reactions (k, m), of held contacts only, at times in any order."""
        t = np.asarray(t, float)
        q, v = np.empty((2, len(t), self.model.system.size))
        R = np.zeros((len(t), len(self.model.rows)))
        piece = self.stretch_at(t)
        for k in np.unique(piece):
            here = np.flatnonzero(piece == k)
            if k in self.flights:
                q[here], v[here] = self.flights[k].states_in(t[here], np.zeros(len(here), np.int64))
                continue
            start, moving = self.states[k]
            c, reactions = self.model.stretch(self.times[k], start, moving, self.held[k])
            powers = (t[here] - self.times[k])[:, None] ** np.arange(len(c))
            q[here] = powers @ c
            v[here] = powers[:, :-1] @ (np.arange(1, len(c))[:, None] * c[1:])
            if len(self.held[k]):
                R[here[:, None], list(self.held[k])] = powers[:, : len(reactions)] @ reactions
        return q, v, R

    def stretch_at(self, t: Array) -> NDArray[np.int64]:
        """The stretch that each time (k,) lies in; a switch belongs to the one it begins."""
        return np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)

    def is_held(self, t: Array, contact: int) -> NDArray[np.bool_]:
        """Truth values (k,): the contact is held at times t."""
        return np.array([contact in held for held in self.held])[self.stretch_at(t)]


RADIANS = 1.0  # of the fastest motion, in one stretch
CHATTER = 1e-6
NEAR = 1e-9  # of the motion: the distance to a stop at which a flight ends
MOST_IMPACTS = 200_000
NOTHING = 1e-100  # of the fastest impact: contacts that throw each other off by less are at rest
MOST_AT_ONCE = 10_000
TURNS = 100  # events at one time, after which contacts that are SLOW come to rest
TOGETHER = 16.0  # roundings of the time: which of two contacts closes first is not known
SLOW = 1e-12  # of the fastest impact: of two that are so slow it does not matter which comes first
ROUNDINGS = 4.0  # of a velocity
RELEASED = 3  # zeros of the gap of a contact that presses no more


class Flights:
    """Motion in closed form while no contact is on its stop, by the compiled loop of piecewise; of a copy moved by
    ``roundings`` in its modes and where a flight starts."""

    def __init__(self, system: System, t_end: float, radian: float, roundings: float, seed: int) -> None:
        size = roundings * EPS
        self.size, self.t_end, self.noise = size, t_end, np.random.default_rng([seed, 98])
        self.regimes = Regimes(Source(system, span=t_end), Perturbation(size, size, seed) if size else None)
        self.contacts = len(system.contacts)
        number = self.regimes.at((0,) * self.contacts, t_end)
        self.possible = self.regimes.made[number].followed and math.isfinite(radian)
        self.g1, self.g2 = self.regimes.table.g1.copy(), self.regimes.table.g2.copy()
        self.rows, self.radian = np.abs([contact.row for contact in system.contacts]), radian
        self.gaps = np.max(np.nan_to_num(np.abs([self.g1, self.g2]), posinf=0.0), axis=0)

    def next(self, t: float, q: Array, v: Array) -> tuple[Motion, float]:
        """The flight from q, q' at t and the time at which its first gap closes, or t_end."""
        table, m = self.regimes.table, self.contacts
        near = NEAR * (self.gaps + self.rows @ (np.abs(q) + self.radian * np.abs(v)))
        table.g1[:], table.g2[:] = self.g1 + near, self.g2 - near  # the series decides on all that comes so close
        eta, rate = self.regimes.start(q, v, self.t_end)
        K = table.sigma.shape[1]
        noise = self.noise.uniform(-1.0, 1.0, (1, 3, K)) if self.size else QUIET
        sides = np.zeros((1, m), np.int64)
        out = np.empty(1), np.empty(1, np.int64), sides, *np.zeros((2, 1, K))
        why, _, used, end = follow(
            table, t, self.t_end, eta, rate, np.abs(eta), np.abs(rate), sides[0].copy(), sides[0].copy(), noise,
            self.size, *out, None,
        )  # fmt: skip
        times, regime, _, x, y = out
        return Motion(self.regimes, times, sides, regime, x, y, used), self.t_end if why == DONE else end


class Tracer:
    """Solver for one system. radians: see RADIANS. roundings: by as many, at most, every segment moves the state and
    the time at its end, for a perturbed copy of the solution; seed: of these roundings."""

    def __init__(self, system: System, radians: float = RADIANS, roundings: float = 0.0, seed: int = 0) -> None:
        self.system, self.model, self.radians = system, Model.of(system), radians
        self.roundings, self.seed = roundings, seed
        self.radian = 1.0 / self.model.fastest if self.model.fastest else math.inf  # of the fastest motion, a time
        self.m = len(system.contacts)
        self.e = np.array([contact.stops.restitution for contact in system.contacts], float)
        self.compliance = np.ascontiguousarray(self.model.rows @ self.model.back)

    def solve(self, t_end: float) -> RigidMotion:
        """Raises InputError for more than MOST_IMPACTS impacts, SolverFailure where the motion cannot go on."""
        model, system = self.model, self.system
        self.t, self.q, self.v = 0.0, system.q0.copy(), system.v0.copy()
        self.found = RigidMotion(model)
        self.held: dict[int, int] = {}
        self.fastest = 0.0  # speed of an impact so far
        # A contact at its stop: side, zeros of its gap or, where it is held, of its reaction, and its speed.
        self.fresh: dict[int, tuple[int, int, float]] = {}
        self.random = np.random.default_rng(self.seed)
        self.flights, self.free_until = Flights(system, t_end, self.radian, self.roundings, self.seed), 0.0
        self._start()
        still, turns = 0, dict[int, int]()  # events at one time, and the contacts hit in them
        while self.t < t_end:
            held = tuple(sorted(self.held))
            if not held and not self.fresh and self.flights.possible and self.t >= self.free_until:
                self._fly()
            c, R = model.stretch(self.t, self.q, self.v, held)
            self._record(held)
            edge = model.next_edge(self.t, t_end)
            longest = min(edge - self.t, self.radians * self.radian)
            events = self._next(c, R, held, longest)
            event = events[0] if events else None
            s = longest if event is None else event[0]
            if not s > 0.0 and event is None:
                raise SolverFailure(
                    "exact", self.t, "time does not go on in float64", "use a scheme with an impact law"
                )
            now = self.t + s
            self.q, self.v = value(c, s), rate(c, s)
            still, turns = (0, {}) if now > self.t else (still + 1, turns)
            if still > MOST_AT_ONCE:
                raise SolverFailure(
                    "exact", now, f"{MOST_AT_ONCE} events at one time", "use a scheme with an impact law"
                )
            if self.roundings and now > self.t:
                now = self._perturb(c, R, held, s, edge)
            self.t = edge if event is None and longest == edge - self.t else now
            near = TOGETHER * EPS * now
            self._note_tie(events, s)
            lets_go = event is not None and event[3]
            self.fresh = self.fresh if lets_go and s <= near else {}
            if event is not None and lets_go:
                released = {x: side for x, (side, zeros, _) in self.fresh.items() if zeros == RELEASED}
                self._let_go(released | {x: side for after, x, side, ends in events if ends and after - s <= near})
            elif event is not None:
                hits = {x: side for after, x, side, ends in events if not ends and after - s <= near}
                turns |= hits
                if still < TURNS or not self._rest(turns):
                    pressed = {x for i, x in enumerate(held) if np.any(R[:, i])}
                    self._note_order({**self.held, **hits}, pressed)
                    self._impact(hits)
        for event in self.found.events:
            if math.isnan(event.end) and event.contact in self.held and event is self._last(event.contact):
                continue  # still held
            event.end = event.time if math.isnan(event.end) else event.end
        return self.found

    def _fly(self) -> None:
        """Go on in closed form to where the next event is half a stretch away, if that is far."""
        stretch = self.radians * self.radian
        flight = self._flight(stretch)
        if flight is not None and self.roundings:
            # Loads that cancel are one load there: what their sum loses in every stretch is lost at once.
            c, R = self.model.stretch(self.t, self.q, self.v, ())
            self._perturb(c, R, (), stretch, math.inf, (self.free_until - self.t) / stretch)
            flight = self._flight(stretch)
        if flight is not None:
            self.found.flights[len(self.found.times)] = flight
            self._record(())
            self.t = self.free_until - 0.5 * stretch
            q, v = flight.states_in(np.array([self.t]), np.zeros(1, np.int64))
            self.q, self.v = q[0], v[0]

    def _flight(self, stretch: float) -> Motion | None:
        """The flight that begins now, None where it is short; ``free_until``: where it ends."""
        try:
            flight, self.free_until = self.flights.next(self.t, self.q, self.v)
        except SolverFailure:  # a gap that float64 cannot follow so: its series goes on
            self.free_until = math.inf
            return None
        return flight if self.free_until - 0.5 * stretch > self.t + stretch else None

    def _perturb(
        self, c: Array, R: Array, held: tuple[int, ...], s: float, edge: float, stretches: float = 1.0
    ) -> float:
        """Move the state after s by roundings of the terms it is summed from in so many ``stretches``, held contacts
        kept where they are. Return the time, moved likewise, which shifts loads and stops against the motion."""
        sizes, model, at = np.abs(c), self.model, list(held)
        # Damping brings copies to rest, and equal to the bit: they diverge again by what the loads lose.
        terms = model.load_sizes(self.t) + np.abs(model.stiff) @ sizes[0] + np.abs(model.damp) @ sizes[1]
        terms += np.abs(model.back[:, at]) @ np.abs(R[0])
        lost = np.array([value(sizes, s) + 0.5 * s * s * terms, rate(sizes, s) + s * terms])
        lost *= self.roundings * EPS * math.sqrt(stretches) * self.random.uniform(-1.0, 1.0, lost.shape)
        if at:
            lost -= np.linalg.solve(self.compliance[np.ix_(at, at)], model.rows[at] @ lost.T).T @ model.back[:, at].T
        self.q, self.v = self.q + lost[0], self.v + lost[1]
        now = (self.t + s) * (1.0 + self.roundings * EPS * self.random.uniform(-1.0, 1.0))
        return min(max(now, self.t), edge)

    def _record(self, held: tuple[int, ...]) -> None:
        self.found.times.append(self.t)
        self.found.states.append((self.q, self.v))
        self.found.held.append(held)

    def _kinetic(self) -> float:
        return float(self.system.energies(np.zeros(1), self.q[None], self.v[None])[0][0])

    def _last(self, contact: int) -> Event | None:
        return next((event for event in reversed(self.found.events) if event.contact == contact), None)

    def _gap(self, contact: int, side: int, c: Array) -> Array:
        """The series of the distance to the stop on that side."""
        stops = self.system.contacts[contact].stops
        u = c @ self.model.rows[contact] + self.model.shift(contact, self.t)
        gap = -side * u
        gap[0] += side * (stops.upper_bound if side > 0 else stops.lower_bound)
        return gap

    def _next(self, c: Array, R: Array, held: tuple[int, ...], longest: float) -> list[tuple[float, int, int, bool]]:
        """(after, contact, side, whether a held one lets go) of what each contact does first in ``longest``, in order
        of time."""
        events: list[tuple[float, int, int, bool]] = []
        for i, contact in enumerate(held):
            reaction, zeros = -self.held[contact] * R[:, i], int(contact in self.fresh)
            reaction[:zeros] = 0.0
            s = first_zero(reaction, longest, zeros)
            if s is not None:
                events.append((s, contact, self.held[contact], True))
        for contact in range(self.m):
            stops = self.system.contacts[contact].stops
            for side, g in ((1, stops.upper_bound), (-1, stops.lower_bound)):
                if contact in self.held or not math.isfinite(g):
                    continue
                gap, zeros = self._gap(contact, side, c), 0
                if contact in self.fresh and self.fresh[contact][0] == side:
                    _, zeros, speed = self.fresh[contact]
                    gap[:zeros] = 0.0
                    if zeros == 1:
                        gap[1] = speed
                elif gap[0] <= 0.0 < gap[1]:  # beyond the stop by its rounding, and leaving
                    gap[0], zeros = 0.0, 1
                s = first_zero(gap, longest, zeros)
                if s is not None:
                    events.append((s, contact, side, False))
        return sorted(events, key=lambda event: event[0])

    def _note_tie(self, events: list[tuple[float, int, int, bool]], s: float) -> None:
        """Now, after s: two contacts that move each other, of which one is hit and which comes first is not known."""
        if len(events) > 1 and not (events[0][3] and events[1][3]):
            (_, a, _, _), (later, b, _, _) = events[:2]
            known = s if {a, b} <= self.fresh.keys() else self.t  # what the times are known relative to
            speed = min(abs(self._velocity(x)) for _, x, _, ends in events[:2] if not ends)
            if later - s <= TOGETHER * EPS * known and self.compliance[a, b] and speed > SLOW * self.fastest:
                self.found.tie = min(self.found.tie, self.t)

    def _start(self) -> None:
        """Contacts on their stops at t = 0."""
        closed = on_stops(self.model)
        speeds = {c: side * self._known_velocity(c) for c, side in closed.items()}
        resting = {c: side for c, side in closed.items() if speeds[c] == 0.0}
        going = {c: side for c, side in closed.items() if speeds[c] > 0.0}
        if going:
            self.held = dict(resting)
            self._note_order(closed, set())
            if together_but_for_rounding(self.model, self.compliance, closed, going):
                self.found.tie = 0.0
            self._bounce({**resting, **going})
        at_rest = {c: side for c, side in {**resting, **going}.items() if c not in self.fresh}
        for contact in closed.keys() - resting.keys() - going.keys():
            side = closed[contact]
            left = -side * self._known_velocity(contact)  # after the blows, which may drive it into its stop
            if left > 0.0:
                self.fresh[contact] = (side, 1, left)
            elif left == 0.0:
                at_rest[contact] = side
        self._settle(at_rest)
        for contact, side in self.held.items():
            self._note_held(contact, side, 0.0)

    def _note_order(self, closed: dict[int, int], pressed: set[int]) -> None:
        """Contacts on their stops now, before a blow of which the order would decide what follows."""
        speeds = np.array([0.0 if c in self.held else self._velocity(c) for c in range(self.m)])
        fast = max((closed[c] * speeds[c] for c in closed), default=0.0) > SLOW * self.fastest
        if fast and order_decides(self.compliance, self.e, speeds, closed, pressed):
            self.found.tie = min(self.found.tie, self.t)

    def _velocity(self, contact: int) -> float:
        return float(self.model.rows[contact] @ self.v + self.model.shift(contact, self.t)[1])

    def _known_velocity(self, contact: int) -> float:
        """0 where it is no more than its rounding: a body that starts with its stop is at rest on it."""
        velocity = self._velocity(contact)
        return velocity if abs(velocity) > self._rounding(contact) else 0.0

    def _rounding(self, contact: int) -> float:
        """Of ``_velocity``: of a body that moves with its stop a chatter at that speed has no end."""
        terms = np.abs(self.model.rows[contact]) @ np.abs(self.v) + abs(self.model.shift(contact, self.t)[1])
        return ROUNDINGS * EPS * float(terms)

    def _impact(self, hits: dict[int, int]) -> None:
        if len(self.found.events) >= MOST_IMPACTS:
            rule = f"hold at most {MOST_IMPACTS} impacts"
            raise InputError("t_end", self.t, rule, f"end before t = {self.t:.6g}, or take e < 1")
        closed, now = {**self.held, **hits}, self.t
        self._bounce(closed)
        self._settle({c: side for c, side in closed.items() if c not in self.fresh})
        for contact, side in hits.items():
            if contact in self.fresh and self._complete(contact, side):
                self._settle({})
            self._note_held(contact, side, now)

    def _note_held(self, contact: int, side: int, now: float) -> None:
        last = self._last(contact)
        if contact in self.held and (last is None or not math.isnan(last.end)):  # it came to be held without a blow
            self.found.events.append(Event(contact, side, now, 0.0))

    def _bounce(self, closed: dict[int, int]) -> None:
        """Newton's law at the contacts ``closed``: those that leave are fresh, the others are held no more and
        wait to be settled."""
        before = np.array([self._velocity(c) for c in range(self.m)])
        before[[c for c in closed if c in self.held]] = 0.0
        self.fastest = max(self.fastest, float(np.max(np.abs(before))))
        P = solve_node((1.0 + self.e) * before, self.compliance, self._law(closed))
        energy = self._kinetic()
        self.v = self.v + self.model.back @ P
        after = before + self.compliance @ P
        moved = -float(sum(P[c] * self.model.shift(c, self.t)[1] for c in closed))
        self.found.taken.append((self.t, energy - self._kinetic() + moved, moved))
        self.found.blows += [(len(self.found.times), c) for c in closed if P[c]]
        for c, side in closed.items():
            if P[c] and c not in self.held:
                self.found.events.append(Event(c, side, self.t, abs(float(P[c]))))
                after[c] = -self.e[c] * before[c]  # exactly
            elif P[c]:
                after[c] = 0.0
                self.found.struck.append((self.t, c, abs(float(P[c]))))
            leaves = -side * after[c] > NOTHING * self.fastest
            if self.held.pop(c, None) is not None and leaves:
                self._end(c)
            if leaves:
                self.fresh[c] = (side, 1, float(-side * after[c]))

    def _law(self, closed: dict[int, int], firm: frozenset[int] = frozenset()) -> Array:
        """Stops (m, 3) at 0 for ``solve_node``: on the sides where contacts are closed, on both of those that stay."""
        law = np.full((self.m, 3), np.inf)
        for c in range(self.m):
            law[c, 1] = 0.0 if c in firm or closed.get(c) == -1 else -np.inf
            law[c, 2] = 0.0 if c in firm or closed.get(c) == 1 else np.inf
        return law

    def _complete(self, contact: int, side: int) -> bool:
        """Where the impacts to come are over within CHATTER radians: take the speed and hold. Whether that is so."""
        e, speed = float(self.e[contact]), self.fresh[contact][2]
        held = tuple(sorted(self.held))
        c, _ = self.model.stretch(self.t, self.q, self.v, held)
        gap = self._gap(contact, side, c)
        a, j = -2.0 * gap[2], -6.0 * gap[3]
        short = CHATTER * min(self.radian, max(self.t, 1e-300))
        if e >= 1.0 or a <= 0.0 or not 2.0 * speed < max(short * a * (1.0 - e), 2.0 * self._rounding(contact)):
            return False
        after, v = 0.0, speed  # a sample that comes before bends the rest by less than CHATTER of it
        while v > 1e-18 * speed:
            s = 2.0 * v / (0.5 * a + math.sqrt(max(0.25 * a * a + 2.0 / 3.0 * v * j, 0.0)))
            v = e * (a * s + 0.5 * j * s * s - v)
            a += j * s
            after += s
        # What holding the contact would do in that time, where nothing else happens in it. The series brings less than
        # that, and shakes those that are held already.
        before = self.v
        self.held[contact] = side
        together = tuple(sorted(self.held))
        self._stop(self.held)
        c, R = self.model.stretch(self.t, self.q, self.v, together)
        fresh = self.fresh.pop(contact)
        events = self._next(c, R, together, after)
        another = bool(events) and not events[0][3] and self.t + after > self.t  # an impact that comes before the last
        if another and np.count_nonzero(self.compliance[contact]) > 1:
            self.v, self.fresh[contact] = before, fresh
            del self.held[contact], self.found.taken[-1]
            del self.found.struck[-len(together) :], self.found.blows[-len(together) :]
            return False
        self.found.stuck.append((self.t + after, contact))
        if not another:
            self._record(together)
            self.t, self.q, self.v, self.fresh = self.t + after, value(c, after), rate(c, after), {}
        return True

    def _stop(self, closed: dict[int, int]) -> None:
        """Take the speeds of contacts at once."""
        at, energy = sorted(closed), self._kinetic()
        P = -np.linalg.solve(self.compliance[np.ix_(at, at)], [self._velocity(x) for x in at])
        self.v = self.v + self.model.back[:, at] @ P
        moved = -float(sum(p * self.model.shift(x, self.t)[1] for p, x in zip(P, at, strict=True)))
        self.found.taken.append((self.t, energy - self._kinetic() + moved, moved))
        self.found.struck += [(self.t, x, -closed[x] * float(p)) for p, x in zip(P, at, strict=True)]
        self.found.blows += [(len(self.found.times), x) for x in at]

    def _rest(self, sides: dict[int, int]) -> bool:
        """Contacts that throw each other off without end come to rest, where they are SLOW. Whether that is so."""
        closed = {**self.held, **sides}
        if max(abs(self._velocity(c)) for c in closed) > SLOW * self.fastest:
            return False
        self._stop(closed)
        self._settle(closed)
        for contact, side in sides.items():
            self._note_held(contact, side, self.t)
        return True

    def _settle(self, closed: dict[int, int]) -> None:
        """Contacts at rest on their stops, the held ones with them: held where they press, else they leave."""
        everyone = {**self.held, **closed}
        if not everyone:
            return
        c, _ = self.model.stretch(self.t, self.q, self.v, ())
        moved = c @ self.model.rows.T
        moved += np.array([self.model.shift(contact, self.t) for contact in range(self.m)]).T
        # Loads that all rise from zero press by their first derivative that does not vanish.
        r = next((line for line in moved[2:] if np.any(line[list(everyone)])), moved[2])
        R = solve_node(r, self.compliance, self._law(everyone))
        c, _ = self.model.stretch(self.t, self.q, self.v, tuple(sorted(x for x in everyone if R[x])))
        for contact, side in everyone.items():
            if R[contact] or stays(self._gap(contact, side, c)[2:]):
                self.held[contact] = side
            else:
                self.held.pop(contact, None)
                self.fresh[contact] = (side, 2, 0.0)
                self._end(contact)
        at = sorted(self.held)
        if at:  # on the stop but for rounding
            off = np.array([self._beyond(c, self.held[c]) for c in at])
            self.q = self.q - self.model.back[:, at] @ np.linalg.solve(self.compliance[np.ix_(at, at)], off)

    def _beyond(self, contact: int, side: int) -> float:
        """u - g."""
        stops = self.system.contacts[contact].stops
        u = float(self.model.rows[contact] @ self.q + self.model.shift(contact, self.t)[0])
        return u - (stops.upper_bound if side > 0 else stops.lower_bound)

    def _let_go(self, sides: dict[int, int]) -> None:
        """Contacts that press no more, at one time but for rounding: by the first derivative of the reactions those go
        on that the others that leave press on their stops again."""
        everyone = {**self.held, **sides}
        at = sorted(everyone)
        _, R = self.model.stretch(self.t, self.q, self.v, tuple(at))
        firm = frozenset(everyone.keys() - sides.keys())
        slopes = solve_node(-self.compliance[:, at] @ R[1], self.compliance, self._law(everyone, firm))
        for contact, side in sides.items():
            last = self._last(contact)
            if slopes[contact]:
                if contact not in self.held and last is not None:
                    last.end = math.nan  # it had left at this time
                self.held[contact] = side
                self.fresh[contact] = (side, 1, 0.0)
            else:
                self.held.pop(contact, None)
                self.fresh[contact] = (side, RELEASED, 0.0)
                self._end(contact)

    def _end(self, contact: int) -> None:
        last = self._last(contact)
        if last is not None and math.isnan(last.end):
            last.end = self.t
