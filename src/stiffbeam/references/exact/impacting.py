"""Rigid stops with Newton's law of restitution, from event to event: impacts, chatter brought to its end, sticking.

    u'+ = -e u'-  where a gap closes,   M (q'+ - q'-) = row^T P;  several at once: 0 <= P _|_ U+ + e U- >= 0
    among those that are approached; one that this drives into its stop is hit after it
    M q'' + C q' + K q = f + row^T R,   u = g while a contact is held; it lets go where R = 0

Far from events the motion is in closed form, by the compiled loop of piecewise; around them, and while a contact is
held, it is the Taylor series of its generator (piecewise/generator.py): an event is the first zero of a gap or of a
reaction in it.
After an impact the gap's series starts with an exact zero and the exact speed, so that flights of any length are
found to rounding, relative to themselves. Where e < 1 impacts may accumulate: speeds v_k = e^k v_0 under the
acceleration a into the stop end after 2 v/(a (1 - e)) to first order. Once that is short against every motion, CHATTER
radians, the rest of the series is summed with a and a' as they are, the speed taken at once, and the contact held.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace

import numpy as np

from ...basics.arrays import Array
from ...basics.validation import InputError
from ...kernels.contact import solve_node
from ...model.system import System
from ...piecewise.follow import DONE
from ...piecewise.generator import Generators
from ...piecewise.linear import Perturbation
from ...piecewise.motion import Motion
from ...piecewise.regimes import NONE, Known, Pairs, Source
from ...piecewise.search import EPS
from ...piecewise.tracer import Tracer as FreeTracer
from ...trajectory.trajectory import SolverFailure
from ..rigid_stops import REMEDY, on_stops, order_decides, require_smooth, together_but_for_rounding
from .rigid_motion import LOCAL, Event, RigidMotion, first_zero, stays, value

# Over one radian the Taylor series of ORDER terms leave out 8e-18, less than float64's rounding (generator.py).
RADIANS = 1.0  # of the fastest motion, in one stretch
# Radians of the fastest motion in which a chatter must end: so short that a and a' describe all of it.
CHATTER = 1e-6
NEAR = 1e-9  # of the motion: the distance to a stop at which a flight ends
# With e = 1 and a lasting load impacts accumulate without end, and the search would never stop.
MOST_IMPACTS = 200_000
NOTHING = 1e-100  # of the fastest impact: contacts that throw each other off by less are at rest
MOST_AT_ONCE = 10_000
TURNS = 100  # events at one time, after which contacts that are SLOW come to rest
TOGETHER = 16.0  # roundings of the time: which of two contacts closes first is not known
SLOW = 1e-12  # of the fastest impact: of two that are so slow it does not matter which comes first
ROUNDINGS = 4.0  # of a velocity
RELEASED = 3  # zeros of the gap of a contact that presses no more


class Flights(FreeTracer):
    """Motion in closed form while no contact is on its stop, by the compiled loop of piecewise; of a copy moved by
    ``roundings`` in its modes and where a flight starts. known: see ``Source``."""

    def __init__(
        self, system: System, t_end: float, radian: float, roundings: float, seed: int, known: Known | None
    ) -> None:
        size, m = roundings * EPS, len(system.contacts)
        super().__init__(Source(system, known, t_end), Perturbation(size, size, seed) if size else None)
        # Flights are possible where the compiled loop can follow the regime without contact.
        free = self.regimes.made[self.regimes.at((0,) * m, t_end)]
        self.possible = free.followed and math.isfinite(radian)
        # Segments that are series are one more regime, without modes: Motion needs a number for them.
        n, d, zeros = system.size, free.response.shape[1], np.zeros(0)
        none = np.zeros((4, 0, n)), np.zeros((4, n, 0)), np.zeros((2, d, 0))
        self.regimes.add((LOCAL,) * m, Pairs(zeros, zeros, zeros, *none, NONE, np.zeros((0, 2))))
        # The true stops: ``next`` moves those in the table closer for each flight.
        self.g1, self.g2 = self.regimes.table.g1.copy(), self.regimes.table.g2.copy()
        self.rows, self.radian, self.t_end = np.abs([contact.row for contact in system.contacts]), radian, t_end
        # A side without a stop has an infinite bound, which must not count as a scale.
        self.widths = np.max(np.nan_to_num(np.abs([self.g1, self.g2]), posinf=0.0), axis=0)

    def next(self, t: float, q: Array, v: Array) -> tuple[Motion, float]:
        """The flight from q, q' at t and the time at which its first gap closes, or t_end."""
        table, none = self.regimes.table, np.zeros(len(self.rows), np.int64)
        near = NEAR * (self.widths + self.rows @ (np.abs(q) + self.radian * np.abs(v)))
        table.g1[:], table.g2[:] = self.g1 + near, self.g2 - near  # the series decides on all that comes so close
        eta, rate = self.regimes.start(q, v, self.t_end)
        why, flight, end = self.ahead(t, self.t_end, eta, rate, np.abs(eta), np.abs(rate), none, none.copy(), 1)
        return flight, self.t_end if why == DONE else end


class Tracer:
    """Solver for one system. radians: see RADIANS. roundings: by as many, at most, every segment moves the state and
    the time at its end, for a perturbed copy of the solution; seed: of these roundings."""

    def __init__(self, system: System, radians: float = RADIANS, roundings: float = 0.0, seed: int = 0) -> None:
        require_smooth(system)
        self.system, self.radians, self.roundings, self.seed = system, radians, roundings, seed
        self.generators, self.known = Generators(system), Known()
        data, n, m = self.generators.data, system.size, len(system.contacts)
        self.n, self.m = n, m
        self.rows, self.forms = data.rows, dict[int, tuple[Array, Array, Array]]()
        self.e = np.array([contact.stops.restitution for contact in system.contacts], float)
        # One factorisation of M for the responses to impulses, displacements, velocities and loads.
        solved = np.linalg.solve(system.mass, np.hstack([data.rows.T, system.stiffness, system.damping, data.loads.T]))
        self.back, stiff, damp = solved[:, :m], solved[:, m : m + n], solved[:, m + n : m + 2 * n]
        self.compliance = np.ascontiguousarray(self.rows @ self.back)
        self.terms = np.abs(solved[:, m:])  # of accelerations, of q, q' and every load
        self.rates = np.sqrt(np.abs(np.linalg.eigvals(stiff)))  # of the system without its damping
        decays = np.abs(np.linalg.eigvals(damp))
        # The length of a series must suit oscillations, decays and drives alike.
        self.fastest = float(max(0.0, *self.rates, *decays, *self.generators.basis.frequencies))
        self.radian = 1.0 / self.fastest if self.fastest else math.inf  # of the fastest motion, a time

    def copy(self, v0: Array, radians: float, roundings: float, seed: int) -> Tracer:
        """A solver of the same system from velocities v0."""
        twin = copy(self)
        # Matrices, generators and known modes are shared: copies differ in the start, the segments and the roundings.
        twin.system, twin.radians, twin.roundings, twin.seed = replace(self.system, v0=v0), radians, roundings, seed
        return twin

    def solve(self, t_end: float) -> RigidMotion:
        """Raises InputError for more than MOST_IMPACTS impacts, SolverFailure where the motion cannot go on."""
        system = self.system
        self.t, self.q, self.v = 0.0, system.q0.copy(), system.v0.copy()
        self.now = math.nan, 0, np.zeros(0)  # the time of ``_forms``, its interval between samples, and g
        self.segments: list[tuple[float, tuple[int, ...], int, Array, Array]] = []
        self.events: list[Event] = []
        self.struck: list[tuple[float, int, float]] = []
        self.blows: list[tuple[int, int]] = []
        self.taken: list[tuple[float, float, float]] = []
        self.stuck: list[tuple[float, int]] = []
        self.tie, self.evaluations = math.inf, 0
        self.held: dict[int, int] = {}
        self.speed = 0.0  # of the fastest impact so far
        # A contact at its stop: side, zeros of its gap or, where it is held, of its reaction, and its speed.
        self.fresh: dict[int, tuple[int, int, float]] = {}
        self.random = np.random.default_rng(self.seed)
        self.flights = Flights(system, t_end, self.radian, self.roundings, self.seed, self.known)
        self.drive, self.free_until = self.flights.regimes.source.drive, 0.0
        self._start()
        still, turns = 0, dict[int, int]()  # events at one time, and the contacts hit in them
        while self.t < t_end:
            held = tuple(sorted(self.held))
            # Far from all stops the motion goes on in closed form; near one, and while one holds, it is a series.
            if not held and not self.fresh and self.flights.possible and self.t >= self.free_until:
                self._fly()
            C, R = self._series(held)
            self._record()
            # The series holds to the next sample of a record, and no longer than ``radians``.
            edge = self.drive.next_edge(self.t, t_end)
            longest = min(edge - self.t, self.radians * self.radian)
            events = self._next(C, R, held, longest)
            event = events[0] if events else None
            s = longest if event is None else event[0]
            if not s > 0.0 and event is None:
                raise SolverFailure("exact", self.t, "time does not go on in float64", REMEDY)
            # Count the events at one time: contacts may throw each other off without end.
            now = self.t + s
            still, turns = (0, {}) if now > self.t else (still + 1, turns)
            if still > MOST_AT_ONCE:
                raise SolverFailure("exact", now, f"{MOST_AT_ONCE} events at one time", REMEDY)
            # To the event. A copy is perturbed too, but not between events at one time.
            self._place(C, s)
            if self.roundings and now > self.t:
                now = self._perturb(C, R, held, s, edge)
            self.t = edge if event is None and longest == edge - self.t else now
            # Events that rounding of the time cannot put in order are taken together.
            near = TOGETHER * EPS * now
            self._note_tie(events, s)
            lets_go = event is not None and event[3]
            # Contacts that left just now still start from an exact zero if another one lets go at the same instant.
            self.fresh = self.fresh if lets_go and s <= near else {}
            if event is not None and lets_go:
                # Those let go at this instant join the others: one by one they throw each other off without end.
                released = {x: side for x, (side, zeros, _) in self.fresh.items() if zeros == RELEASED}
                self._let_go(released | {x: side for after, x, side, ends in events if ends and after - s <= near})
            elif event is not None:
                hits = {x: side for after, x, side, ends in events if not ends and after - s <= near}
                turns |= hits
                # After TURNS events at one time contacts that are slow enough come to rest in place of another impact.
                if still < TURNS or not self._rest(turns):
                    pressed = {x for i, x in enumerate(held) if np.any(R[:, i])}
                    self._note_order({**self.held, **hits}, pressed)
                    self._impact(hits)
        # An impact that holds nothing ends as it begins; a contact held at t_end has no end yet.
        for event in self.events:
            if math.isnan(event.end) and event.contact in self.held and event is self._last(event.contact):
                continue  # still held
            event.end = event.time if math.isnan(event.end) else event.end
        return self._motion()

    def _motion(self) -> RigidMotion:
        """The motion so far."""
        regimes = self.flights.regimes
        times, sides, regime = (np.array(x) for x in list(zip(*self.segments, strict=True))[:3])
        # Series store q and q', flights the amplitudes of their modes: rows are as wide as the longer of the two.
        x, y = np.zeros((2, len(times), max(self.system.size, regimes.table.sigma.shape[1])))
        for k, (_, _, _, of_x, of_y) in enumerate(self.segments):
            x[k, : len(of_x)], y[k, : len(of_y)] = of_x, of_y
        return RigidMotion(
            regimes, times, sides, regime, x, y, self.evaluations, self.generators, self.fastest, self.events,
            self.struck, self.blows, self.taken, self.stuck, self.tie,
        )  # fmt: skip

    def _fly(self) -> None:
        """Go on in closed form to where the next event is half a stretch away, if that is far."""
        stretch = self.radians * self.radian
        flight = self._flight(stretch)
        if flight is not None and self.roundings:
            # Loads that cancel are one load there: what their sum loses in every stretch is lost at once.
            C, R = self._series(())
            self._perturb(C, R, (), stretch, math.inf, (self.free_until - self.t) / stretch)
            flight = self._flight(stretch)
        if flight is not None:
            self.segments.append((self.t, (0,) * self.m, int(flight.regime[0]), flight.x[0], flight.y[0]))
            # Stop half a stretch before the event: the series decides whether a stop is hit or grazed.
            self.t, self.evaluations = self.free_until - 0.5 * stretch, self.evaluations + flight.evaluations
            q, v = flight.states_in(np.array([self.t]), np.zeros(1, np.int64))
            self.q, self.v = q[0], v[0]

    def _flight(self, stretch: float) -> Motion | None:
        """The flight that begins now, None where it is short; ``free_until``: where it ends."""
        try:
            flight, self.free_until = self.flights.next(self.t, self.q, self.v)
        except SolverFailure:  # a gap that float64 cannot follow so: its series goes on
            self.free_until = math.inf
            return None
        # A flight that one series would also cover gains nothing.
        return flight if self.free_until - 0.5 * stretch > self.t + stretch else None

    def _series(self, held: tuple[int, ...]) -> tuple[Array, Array]:
        """Series from now on with the contacts ``held`` where they are: of (q, q', g), (ORDER + 1, N), and of their
        reactions, (ORDER + 1, h)."""
        g = self._forms()[-1]
        flow = self.generators.regime(tuple(int(c in held) for c in range(self.m)), True, self.now[1])
        C = flow.series(np.concatenate([self.q, self.v, g]))
        return C, C @ flow.reactions.T

    def _place(self, C: Array, s: float) -> None:
        """Move the state along a series."""
        Z = value(C[:, : 2 * self.n], s)
        self.q, self.v = Z[: self.n], Z[self.n :]

    def _forms(self) -> tuple[Array, Array, Array, Array]:
        """Positions of contacts and their rates now as forms (m, N) of (q, q', g), loads as forms of g, and g."""
        if self.now[0] != self.t:
            # The functions of time are evaluated once for all calls at this time.
            basis = self.generators.basis
            interval = basis.interval(self.t)
            self.now = self.t, interval, basis.values(self.t, interval)
        _, interval, g = self.now
        # The forms change with the interval between samples only.
        if interval not in self.forms:
            positions = self.generators.forms(interval)[0].positions[: self.m]
            rates = np.array([self.generators.rate(form, [])[0] for form in positions])
            loads = self.generators.basis.terms(self.generators.data, interval)[: self.terms.shape[1] - 2 * self.n]
            self.forms[interval] = positions, rates, loads
        return *self.forms[interval], g

    def _perturb(
        self, C: Array, R: Array, held: tuple[int, ...], s: float, edge: float, stretches: float = 1.0
    ) -> float:
        """Move the state after s by roundings of the terms it is summed from in so many ``stretches``, held contacts
        kept where they are. Return the time, moved likewise, which shifts loads and stops against the motion."""
        n, at = self.n, list(held)
        # Sizes of the terms that the state after s sums: series in absolute values, and forces.
        sizes, loads = np.abs(C[:, : 2 * n]), self._forms()[2] @ C[0, 2 * n :]
        # Damping brings copies to rest, and equal to the bit: they diverge again by what the loads lose, each for
        # itself where they cancel.
        terms = self.terms @ np.concatenate([sizes[0], np.abs(loads)]) + np.abs(self.back[:, at]) @ np.abs(R[0])
        moved = value(sizes, s)
        lost = np.array([moved[:n] + 0.5 * s * s * terms, moved[n:] + s * terms])
        # The roundings of so many stretches are independent: their sum grows by the square root.
        lost *= self.roundings * EPS * math.sqrt(stretches) * self.random.uniform(-1.0, 1.0, lost.shape)
        if at:
            # Held contacts stay on their stops: remove what would move them, by forces at the contacts alone.
            lost -= np.linalg.solve(self.compliance[np.ix_(at, at)], self.rows[at] @ lost.T).T @ self.back[:, at].T
        self.q, self.v = self.q + lost[0], self.v + lost[1]
        now = (self.t + s) * (1.0 + self.roundings * EPS * self.random.uniform(-1.0, 1.0))
        # Time must not go back, nor pass the edge at which the records change.
        return min(max(now, self.t), edge)

    def _record(self) -> None:
        """Begin a segment that is a series."""
        sides = tuple(self.held.get(c, 0) for c in range(self.m))
        self.segments.append((self.t, sides, self.flights.regimes.number[(LOCAL,) * self.m], self.q, self.v))

    def _kinetic(self) -> float:
        return 0.5 * float(self.v @ self.system.mass @ self.v)

    def _last(self, contact: int) -> Event | None:
        return next((event for event in reversed(self.events) if event.contact == contact), None)

    def _positions(self, C: Array) -> Array:
        """Series (ORDER + 1, m) of the positions of all contacts."""
        return C @ self._forms()[0].T

    def _gap(self, contact: int, side: int, u: Array) -> Array:
        """The series of the distance to the stop on that side; u: (terms, m), of ``_positions``."""
        gap = -side * u[:, contact]
        gap[0] += side * self.system.contacts[contact].stops.bound(side)
        return gap

    def _next(self, C: Array, R: Array, held: tuple[int, ...], longest: float) -> list[tuple[float, int, int, bool]]:
        """(after, contact, side, whether a held one lets go) of what each contact does first in ``longest``, in order
        of time."""
        events: list[tuple[float, int, int, bool]] = []
        # Held contacts: the first time at which the reaction would pull.
        for i, contact in enumerate(held):
            reaction, zeros = -self.held[contact] * R[:, i], int(contact in self.fresh)
            # A contact held again as its reaction vanished starts from an exact zero, not from rounding.
            reaction[:zeros] = 0.0
            s = first_zero(reaction, longest, zeros)
            if s is not None:
                events.append((s, contact, self.held[contact], True))
        # Open contacts: a bound on the way each can go in ``longest`` rules most stops out.
        u = self._positions(C)
        ahead = u[1:] * longest ** np.arange(1.0, len(u))[:, None]
        reach = {1: np.sum(np.maximum(ahead, 0.0), axis=0), -1: np.sum(np.maximum(-ahead, 0.0), axis=0)}
        for contact in (c for c in range(self.m) if c not in self.held):
            for side, g in self.system.contacts[contact].stops.sides:
                # A contact that has just left this stop is searched in any case: its gap is zero there.
                if self.fresh.get(contact, (0,))[0] != side and side * (g - u[0, contact]) > reach[side][contact]:
                    continue
                gap, zeros = self._gap(contact, side, u), 0
                # Exact zeros and the exact speed in place of their roundings, so that short flights keep their digits.
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
            speed = min(abs(self._speeds()[x]) for _, x, _, ends in events[:2] if not ends)
            if later - s <= TOGETHER * EPS * known and self.compliance[a, b] and speed > SLOW * self.speed:
                self.tie = min(self.tie, self.t)

    def _start(self) -> None:
        """Contacts on their stops at t = 0."""
        # By their speeds: at rest on the stop, going into it, or leaving it.
        closed = on_stops(self.system)
        speeds = {c: side * float(self._known_speeds()[c]) for c, side in closed.items()}
        resting = {c: side for c, side in closed.items() if speeds[c] == 0.0}
        going = {c: side for c, side in closed.items() if speeds[c] > 0.0}
        # Blows at t = 0, in which bodies at rest on their stops take part.
        if going:
            self.held = dict(resting)
            self._note_order(closed, set())
            # Rounding of the start decides which contact is hit first: the horizon ends at once.
            if together_but_for_rounding(self.system, self.compliance, closed, going):
                self.tie = 0.0
            self._bounce({**resting, **going})
        at_rest = {c: side for c, side in {**resting, **going}.items() if c not in self.fresh}
        for contact in closed.keys() - resting.keys() - going.keys():
            side = closed[contact]
            left = -side * float(self._known_speeds()[contact])  # after the blows, which may drive it into its stop
            if left > 0.0:
                self.fresh[contact] = (side, 1, left)
            elif left == 0.0:
                at_rest[contact] = side
        self._settle(at_rest)
        for contact, side in self.held.items():
            self._note_held(contact, side, 0.0)

    def _note_order(self, closed: dict[int, int], pressed: set[int]) -> None:
        """Contacts on their stops now, before a blow of which the order would decide what follows."""
        if len(closed) < 2:
            return
        speeds = self._speeds()
        # The speed of a held contact is rounding.
        speeds[list(self.held)] = 0.0
        fast = max((closed[c] * speeds[c] for c in closed), default=0.0) > SLOW * self.speed
        if fast and order_decides(self.compliance, self.e, speeds, closed, pressed):
            self.tie = min(self.tie, self.t)

    def _speeds(self) -> Array:
        """Rates of all positions, (m,)."""
        return self.rows @ self.v + self._stop_speeds()

    def _stop_speeds(self) -> Array:
        """Rates of all offsets, (m,)."""
        _, rates, _, g = self._forms()
        return rates[:, 2 * self.n :] @ g

    def _roundings(self) -> Array:
        """Rounding errors of ``_speeds`` (m,). So slow a body on a moving stop would chatter for ever."""
        return ROUNDINGS * EPS * (np.abs(self.rows) @ np.abs(self.v) + np.abs(self._stop_speeds()))

    def _known_speeds(self) -> Array:
        """0 where they are no more than their rounding: a body that starts with its stop is at rest on it."""
        speeds = self._speeds()
        return np.where(np.abs(speeds) > self._roundings(), speeds, 0.0)

    def _impact(self, hits: dict[int, int]) -> None:
        if len(self.events) >= MOST_IMPACTS:
            rule = f"hold at most {MOST_IMPACTS} impacts"
            raise InputError("t_end", self.t, rule, f"end before t = {self.t:.6g}, or take e < 1")
        # Newton's law first; contacts that do not leave are held or let go; those that leave may chatter to rest.
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
            self.events.append(Event(contact, side, now, 0.0))

    def _bounce(self, closed: dict[int, int]) -> None:
        """Newton's law at the contacts ``closed``: those that leave are fresh, the others are held no more and
        wait to be settled."""
        before = self._speeds()
        # The speed of a held contact is rounding.
        before[[c for c in closed if c in self.held]] = 0.0
        self.speed = max(self.speed, float(np.max(np.abs(before))))
        # With r = (1 + e) u'- the v = r + S P of solve_node is u'+ + e u'-, as in the law of this module.
        P = solve_node((1.0 + self.e) * before, self.compliance, self._law(closed))
        after = before + self.compliance @ P
        self._blow(P)
        for c, side in closed.items():
            # A contact that hits has an event; a held one only answers the blows on others.
            if P[c] and c not in self.held:
                self.events.append(Event(c, side, self.t, abs(float(P[c]))))
                after[c] = -self.e[c] * before[c]  # exactly
            elif P[c]:
                after[c] = 0.0
                self.struck.append((self.t, c, abs(float(P[c]))))
            leaves = -side * after[c] > NOTHING * self.speed
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
        """If the coming impacts end within CHATTER radians, remove the speed and hold the contact. Returns True if
        done."""
        e, speed = float(self.e[contact]), self.fresh[contact][2]
        # No speed is lost: the impacts do not accumulate.
        if e >= 1.0:
            return False
        # Acceleration into the stop and its rate, with the other contacts as they are.
        held = tuple(sorted(self.held))
        gap = self._gap(contact, side, self._positions(self._series(held)[0]))
        a, j = -2.0 * gap[2], -6.0 * gap[3]
        # The chatter ends after 2 v/(a (1 - e)). A speed within its rounding would chatter for ever.
        short = CHATTER * min(self.radian, max(self.t, 1e-300))
        if a <= 0.0 or not 2.0 * speed < max(short * a * (1.0 - e), 2.0 * float(self._roundings()[contact])):
            return False
        after, v = 0.0, speed  # a sample that comes before bends the rest by less than CHATTER of it
        # Flight by flight: s solves v - a s/2 - j s^2/6 = 0, in the form that also holds for j = 0.
        while v > 1e-18 * speed:
            s = 2.0 * v / (0.5 * a + math.sqrt(max(0.25 * a * a + 2.0 / 3.0 * v * j, 0.0)))
            v = e * (a * s + 0.5 * j * s * s - v)
            a += j * s
            after += s
        # What holding the contact would do in that time, where nothing else happens in it. The series brings less than
        # that, and shakes those that are held already.
        before, marks = self.v, (len(self.struck), len(self.blows))
        self.held[contact] = side
        together = tuple(sorted(self.held))
        self._stop(self.held)
        C, R = self._series(together)
        fresh = self.fresh.pop(contact)
        events = self._next(C, R, together, after)
        another = bool(events) and not events[0][3] and self.t + after > self.t  # an impact that comes before the last
        # Another contact is hit first, and this one moves others: undo, and go on impact by impact.
        if another and np.count_nonzero(self.compliance[contact]) > 1:
            self.v, self.fresh[contact] = before, fresh
            del self.held[contact], self.taken[-1], self.struck[marks[0] :], self.blows[marks[1] :]
            return False
        self.stuck.append((self.t + after, contact))
        # Held from now on; time goes on by the duration of the impacts that are left out.
        if not another:
            self._record()
            self._place(C, after)
            self.t, self.fresh = self.t + after, {}
        return True

    def _stop(self, closed: dict[int, int]) -> None:
        """Take the speeds of contacts at once."""
        at, P = sorted(closed), np.zeros(self.m)
        P[at] = -np.linalg.solve(self.compliance[np.ix_(at, at)], self._speeds()[at])
        self.struck += [(self.t, x, -closed[x] * float(P[x])) for x in at]
        self._blow(P)

    def _blow(self, P: Array) -> None:
        """Impulses P (m,) of the stops."""
        # With u = row q + o the stop moves at -o', and its impulse does work on the system.
        energy, moved = self._kinetic(), -float(P @ self._stop_speeds())
        self.v = self.v + self.back @ P
        self.taken.append((self.t, energy - self._kinetic() + moved, moved))
        self.blows += [(len(self.segments), x) for x in np.flatnonzero(P).tolist()]

    def _rest(self, sides: dict[int, int]) -> bool:
        """Contacts that throw each other off without end come to rest, where they are SLOW. Whether that is so."""
        closed = {**self.held, **sides}
        if np.max(np.abs(self._speeds()[list(closed)])) > SLOW * self.speed:
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
        # Series of all positions without reactions: the square term is half the acceleration.
        moved = self._positions(self._series(())[0])
        # Loads that all rise from zero press by their first derivative that does not vanish.
        r = next((line for line in moved[2:] if np.any(line[list(everyone)])), moved[2])
        R = solve_node(r, self.compliance, self._law(everyone))
        # With the pressing ones held, contacts without reaction stay if their gaps do not open.
        u = self._positions(self._series(tuple(sorted(x for x in everyone if R[x])))[0])
        for contact, side in everyone.items():
            if R[contact] or stays(self._gap(contact, side, u)[2:]):
                self.held[contact] = side
            else:
                self.held.pop(contact, None)
                # Gap and speed are zero: a zero of order two.
                self.fresh[contact] = (side, 2, 0.0)
                self._end(contact)
        at = sorted(self.held)
        if at:  # on the stop but for rounding
            u = self._positions(np.concatenate([self.q, self.v, self._forms()[-1]])[None])
            off = np.array([-self.held[c] * self._gap(c, self.held[c], u)[0] for c in at])
            self.q = self.q - self.back[:, at] @ np.linalg.solve(self.compliance[np.ix_(at, at)], off)

    def _let_go(self, sides: dict[int, int]) -> None:
        """Contacts that press no more, at one time but for rounding: by the first derivative of the reactions those go
        on that the others that leave press on their stops again."""
        everyone = {**self.held, **sides}
        at = sorted(everyone)
        _, R = self._series(tuple(at))
        # Those that press on stay on their stops: their reactions may change either way.
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
                # Gap, speed and acceleration vanish with the reaction: a zero of order three.
                self.fresh[contact] = (side, RELEASED, 0.0)
                self._end(contact)

    def _end(self, contact: int) -> None:
        last = self._last(contact)
        if last is not None and math.isnan(last.end):
            last.end = self.t
