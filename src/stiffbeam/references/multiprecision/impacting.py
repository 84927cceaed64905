"""Motion between rigid stops in many digits: from event to event; accumulating impacts are summed by their series.

    0 <= P _|_ U+ + e U- >= 0            what closes together, towards the inside; U+ = U- + A P, A = row M^-1 row^T
    0 <= R _|_ (u - g) >= 0              what rests on its stops, both in the order of their first derivatives
    T = T_0 (1 + T_0 (k/(3 a) - c/6)),   T_0 = 2 v/(a (1 - e)),   gap'' = -(a - k s) - c gap'

A is positive definite: Murty's least-index method, which changes the first contact that violates its condition again
and again, ends with the one answer. In the second line it works on series, of which the first term that is not zero
counts: it says at once what is held, what is let go and what leaves by a higher derivative. The third is how long
impacts go on after one that leaves with speed v: two terms of a power series, taken once the next, T_0^3, is below the
digits carried. That long the contact is held instead, which changes the motion of the others by T_0^3 as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from flint import arb, arb_mat

from ...basics.resources import Forecast
from ...basics.validation import InputError
from ...model.system import System
from ...trajectory.trajectory import SolverFailure
from ..rigid_stops import order_decides
from .linear_flow import LinearFlow, Regime, Series, Undecided, first_zero, leading
from .rational import number

MOST_IMPACTS = 200_000
MOST_AT_ONCE = 100
MOST_CHANGES = 10_000
UNLISTED = 1e-6  # radians of the fastest motion: impacts that are all over so soon count with the one before
ON_THE_STOP = 1e-12  # of the heights that round the gap: a start so little beyond a stop is on it


@dataclass(eq=False)
class Impact:
    """Impact on ``side`` of a contact, with ``impulse``, held until ``end`` (NaN: to the end of the solution)."""

    contact: int
    side: int
    time: Any
    impulse: Any
    end: Any = None


@dataclass(eq=False)
class Stretch:
    """Segment from time t on z, with the contacts of the regime held, over ``length``."""

    t: Any
    z: Any
    regime: Regime
    length: Any


@dataclass(eq=False)
class Motion:
    """A solution: the segments, the impacts, energies (time, dissipated by the stops, input by their motion), times
    held and pressed by contact, the ends of chatter (time, contact), the remainder of its series relative to the time,
    and the first tie."""

    flow: LinearFlow
    stretches: list[Stretch] = field(default_factory=list)
    impacts: list[Impact] = field(default_factory=list)
    taken: list[tuple[float, float, float]] = field(default_factory=list)
    held: list[float] = field(default_factory=list)
    pressed: list[float] = field(default_factory=list)
    stuck: list[tuple[Any, int]] = field(default_factory=list)
    left_out: float = 0.0
    tie: float = math.inf  # time of the first impact whose order would decide what follows


class March:
    """Follows ``system`` to t_end with ``bits`` right, at a current precision above."""

    def __init__(self, system: System, t_end: float, bits: int) -> None:
        self.system, self.t_end, self.bits = system, t_end, bits
        self.flow = LinearFlow(system, bits)
        self.m = len(system.contacts)
        self.e = [arb(number(contact.stops.restitution or 0.0)) for contact in system.contacts]
        self.stops = [
            (c, side, g)
            for c, contact in enumerate(self.flow.problem.contacts)
            for side, g in ((1, contact.g2), (-1, contact.g1))
            if g is not None
        ]
        self.t, self.z = arb(0), self.flow.start()
        self.held: dict[int, int] = {}
        self.unlisted: set[int] = set()
        self.soon = math.inf  # the length of a flight and a half
        self.scale = [0.0] * self.m  # of u', in the stretch before
        self.motion = Motion(self.flow, held=[0.0] * self.m, pressed=[0.0] * self.m)
        # Rate of the fastest motion, by which times are called short: frequencies, damping and drives.
        rates = [np.sqrt(np.max(np.abs(np.linalg.eigvals(np.linalg.solve(system.mass, system.stiffness)))))]
        rates += [np.max(np.abs(np.linalg.eigvals(np.linalg.solve(system.mass, system.damping))))]
        self.fastest = max(*map(float, rates), *self.flow.drive.frequencies, 0.0)

    def run(self) -> Motion:
        """Raises Undecided(t) where more digits may help, InputError for too many impacts, SolverFailure."""
        try:
            return self._run()
        except Undecided:
            raise Undecided(float(self.t)) from None

    def _run(self) -> Motion:
        self._begin()
        forecast, still = Forecast(self.t_end), 0
        while self.t < self.t_end:
            forecast.check(float(self.t), len(self.motion.stretches) * self.flow.N * (self.bits / 32.0 + 4.0))
            # One series: over as long a time as its regime, the expected flight and the next sample allow.
            regime = self.flow.regime(tuple(sorted(self.held)))
            edge = self.flow.next_edge(self.t, self.t_end)
            rest = edge - self.t
            most = min(self.flow.longest(regime, math.inf), self.soon)
            length = arb(most) if most < rest else rest
            series = self.flow.series(regime, self.z, length)
            # Go on to the first event in it, or to its end.
            x, hits = self._next(regime, series)
            whole = x is None
            self.soon = math.inf
            self._keep(regime, series, arb(1) if x is None else x)
            at_edge = whole and bool(length == rest)
            # Contacts that throw each other off have events without end at one time.
            still = still + 1 if x is not None and x == 0 else 0
            if still > MOST_AT_ONCE:
                reason = f"{MOST_AT_ONCE} events at one time: contacts that throw each other off"
                raise SolverFailure("multiprecision", float(self.t), reason, "use compliant stops, or integrate")
            # At a sample the loads change, and perhaps which contacts press. At an event contacts close or let go.
            if at_edge:
                self.t = edge
                self.z = self.flow.at_edge(self.z, edge) if edge < self.t_end else self.z
                self._settle(self.held)
            elif not whole:
                self._meet(hits)
        return self.motion

    def _keep(self, regime: Regime, series: Series, x: Any) -> None:
        """Go on to x of the series."""
        length = (x * series.length).mid()
        if length > 0:
            self.scale = [series.sizes(rate)[0] for rate in self.flow.rates[: self.m]]
            self.motion.stretches.append(Stretch(self.t, self.z, regime, length))
        for i, c in enumerate(regime.held):
            self.motion.held[c] += float(length)
            # Impulse of the reaction, its series integrated term by term.
            R = series.of(regime.reactions[i])
            impulse = abs(sum((r * x ** (k + 1) / (k + 1) for k, r in enumerate(R)), arb(0)) * series.length).mid()
            self._press(c, impulse)
        self.t, self.z = (self.t + length).mid(), series.at(x)

    def _press(self, contact: int, impulse: Any) -> None:
        self.motion.pressed[contact] += float(impulse)
        last = self._last(contact)
        if last is not None and last.end is None:
            last.impulse += impulse

    def _last(self, contact: int) -> Impact | None:
        return next((x for x in reversed(self.motion.impacts) if x.contact == contact), None)

    def _gap(self, contact: int, side: int, g: Any, series: Series) -> list[Any]:
        """The series of side (g - u), which is open where it is positive."""
        gap = [-side * x for x in series.of(self.flow.forms[contact])]
        gap[0] += side * g
        # The gap is a difference of two positions: the rounding of the stop's position counts too.
        gap[0] = arb(gap[0].mid(), gap[0].rad() + abs(g).mid() * arb(2) ** -self.bits)
        return gap

    def _next(self, regime: Regime, series: Series) -> tuple[Any, dict[int, int]]:
        """The first event in the series and the contacts that close at it; None and none where there is none."""
        events: list[tuple[Any, int, int]] = []
        # A held contact lets go where its reaction would pull; a free one closes where its gap is zero.
        for i, c in enumerate(regime.held):
            x = first_zero([-self.held[c] * r for r in series.of(regime.reactions[i])], self.bits)
            events += [] if x is None else [(x, c, 0)]
        for c, side, g in self.stops:
            if c not in self.held:
                x = first_zero(self._gap(c, side, g, series), self.bits)
                events += [] if x is None else [(x, c, side)]
        if not events:
            return None, {}
        first = events[0][0]
        for x, _, _ in events:
            first = x if x < first else first
        near = arb(2) ** (-2 * self.bits // 3)  # as well as flights of 2^(-bits/3) are known
        return first, {c: side for x, c, side in events if side and x - first <= near}

    def _speed(self, contact: int) -> Any:
        """u', a ball."""
        rate = self.flow.rates[contact]
        # A speed may be small by cancellation: the largest u' of the segment before also sets its rounding.
        size = sum((abs(x * y) for x, y in zip(rate.entries(), self.z.entries(), strict=True)), arb(0)).mid()
        return arb((rate * self.z)[0, 0].mid(), (size + self.scale[contact]) * arb(2) ** -self.bits)

    def _begin(self) -> None:
        """Contacts on their stops at t = 0."""
        closed: dict[int, int] = {}
        rounded: set[int] = set()  # on their stops but for the rounding of the start
        for c, side, g in self.stops:
            series = self.flow.series(self.flow.regime(()), self.z, arb(0))
            gap = self._gap(c, side, g, series)[0]
            # Float64 rounds a start on a stop to one beside it. A start so little beyond the stop is moved back.
            little = ON_THE_STOP * max(abs(g), abs(self._offset(self.flow.forms[c])))
            if not gap.contains(0) and abs(gap.mid()) <= little:
                rounded.add(c)
            if gap.contains(0) or gap < 0:
                if not -gap.mid() <= little + gap.rad():
                    u = float((self.flow.forms[c] * self.z)[0, 0])
                    raise InputError("initial displacement", u, "lie between rigid stops", "move the stop or the start")
                # Back onto the stop in the direction M^-1 row^T of an impulse.
                push = [line[c] * (side * gap.mid() / self.flow.compliance[c, c]) for line in self.flow.back.tolist()]
                n = self.flow.n
                moved = [push[n + i] if i < n else arb(0) for i in range(self.flow.N)]
                self.z = (self.z + arb_mat([[x] for x in moved])).mid()
                closed[c] = side
        # Contacts that move into their stops hit them now; those without a speed are held or let go.
        speeds = {c: side * self._speed(c) for c, side in closed.items()}
        going = {c: closed[c] for c, speed in speeds.items() if speed > 0}
        # Rounding of such a start decides which of two coupled contacts is hit first: then there is no horizon.
        near = {c for c, side, _ in self.stops if c in rounded and (c in going or side * self._speed(c) > 0)}
        if any(c != x and not self.flow.compliance[c, x].contains(0) for c in rounded for x in going.keys() | near):
            self.motion.tie = 0.0
        if going:
            self._meet(going, resting={c: closed[c] for c, speed in speeds.items() if speed.contains(0)})
        else:
            self._settle({c: closed[c] for c, speed in speeds.items() if speed.contains(0)})
        # A contact that is held from the start is an impact at t = 0, without an impulse of its own.
        for c in self.held:
            if self._last(c) is None:
                self.motion.impacts.append(Impact(c, self.held[c], self.t, arb(0)))

    def _meet(self, hits: dict[int, int], resting: dict[int, int] | None = None) -> None:
        """Newton's law where contacts close, then what is at rest on a stop is held or let go."""
        if len(self.motion.impacts) > MOST_IMPACTS:
            rule = f"hold at most {MOST_IMPACTS} impacts"
            raise InputError("t_end", self.t_end, rule, f"end before t = {float(self.t):.6g}, or take e < 1")
        # All contacts that can take an impulse: those held, those at rest here, and those that close.
        closed = {**self.held, **(resting or {}), **hits}
        before = {c: self._speed(c) if c in hits else arb(0) for c in closed}
        hits = {c: side for c, side in hits.items() if side * before[c] > 0}  # the others touch without a speed
        if len(closed) > 1 and hits:
            self._note_order(closed, before)
        # Impulses of all at once.
        P, jump = newton(self.flow, self.e, closed, before) if hits else ({}, dict.fromkeys(closed, arb(0)))
        self._push(P)
        # A contact that was hit leaves if e > 0; with e = 0 it has no speed and may stay. Others leave by moving off.
        at_rest = {}
        for c, side in closed.items():
            if c in P and c in hits:
                self._list(c, side, abs(P[c]))
                leaves = self.e[c] > 0
            else:
                if c in P:
                    self._press(c, abs(P[c]))
                leaves = c not in P and side * (before[c] + jump[c]) < 0
            if not leaves:
                at_rest[c] = side
        self._settle(at_rest)
        # Contacts that bounce: their next impacts may follow so fast that they are summed.
        for c, side in hits.items():
            if c not in self.held:
                self._complete(c, side)

    def _note_order(self, closed: dict[int, int], before: dict[int, Any]) -> None:
        """Contacts on their stops now, before a blow of which the order would decide what follows."""
        # Contacts that were pressed in the segment before: a reaction that is zero is none.
        last = self.motion.stretches[-1] if self.motion.stretches else None
        pressed: set[int] = set()
        if last is not None:
            series = self.flow.series(last.regime, last.z, last.length)
            pressed = {
                c
                for c, form in zip(last.regime.held, last.regime.reactions, strict=True)
                if any(not x.contains(0) for x in series.of(form))
            }
        compliance = np.array(self.flow.compliance.tolist(), float)
        speeds = np.array([float(before[c]) if c in before else float(self._speed(c)) for c in range(self.m)])
        if order_decides(compliance, np.array(self.e, float), speeds, closed, pressed):
            self.motion.tie = min(self.motion.tie, float(self.t))

    def _list(self, c: int, side: int, impulse: Any) -> None:
        last = self._last(c)
        # The rest of a chatter that is over within UNLISTED counts with the impact before it.
        if c in self.unlisted and last is not None:
            last.impulse += impulse
        else:
            self.motion.impacts.append(Impact(c, side, self.t, impulse, self.t))
        self.motion.pressed[c] += float(impulse)

    def _push(self, P: dict[int, Any]) -> None:
        """Apply impulses, and note what they take."""
        if not P:
            return
        push = arb_mat([[P[c].mid() if c in P else arb(0)] for c in range(self.m)])
        rates = {c: (self._speed(c).mid(), self._offset(self.flow.rates[c])) for c in P}
        self.z = (self.z + self.flow.back * push).mid()
        # An impulse does the work P (U- + U+)/2, and the motion of its stop P times the rate of the offset.
        taken = moved = arb(0)
        for c, (speed, rate) in rates.items():
            taken -= P[c] * (speed + self._speed(c).mid()) / 2
            moved -= P[c] * rate
        self.motion.taken.append((float(self.t), float(taken), float(moved)))

    def _offset(self, form: Any) -> Any:
        """The part of a form that depends on time alone: of a gap or its rate that of the offset."""
        n = 2 * self.flow.n
        pairs = zip(form.entries()[n:], self.z.entries()[n:], strict=True)
        return sum((a * b for a, b in pairs), arb(0)).mid()

    def _settle(self, at_rest: dict[int, int]) -> None:
        """Hold those contacts at rest on their stops that press, in the order of derivatives."""

        def violated(held: set[int]) -> Iterable[int]:
            regime = self.flow.regime(tuple(sorted(held)))
            length = arb(self.flow.longest(regime, self.t_end))
            series = self.flow.series(regime, self.z, length)
            for c, side in at_rest.items():
                if c in held:
                    _, sign = leading(series.of(regime.reactions[regime.held.index(c)]))
                    if side * sign > 0:
                        yield c
                else:
                    # At rest on the stop the first two terms, gap and speed, are zero but for rounding.
                    _, sign = leading(series.of(self.flow.forms[c])[2:])
                    if side * sign > 0:
                        yield c

        # Start with all held, and change what violates its condition.
        held = least_index(set(at_rest), violated) if at_rest else set()
        # An impact lasts until its contact is let go; one whose contact is held from the same time on goes on.
        for c in [*self.held]:
            last = self._last(c)
            if c not in held and last is not None and last.end is None:
                last.end = self.t
        for c in held:
            last = self._last(c)
            if c not in self.held and last is not None and last.time == self.t:
                last.end = None
        self.held = {c: at_rest[c] for c in sorted(held)}

    def _complete(self, c: int, side: int) -> None:
        """If the coming impacts end within the digits carried, remove the speed and hold the contact: see above."""
        self.unlisted.discard(c)
        e = self.e[c]
        if not e < 1:
            return
        # Acceleration a towards the stop and its rate without the speed; the drag by which the speed changes a.
        held = tuple(sorted(self.held))
        regime, together = self.flow.regime(held), tuple(sorted({*held, c}))
        speed = -side * self._speed(c).mid()
        wanted = {x: (side * speed if x == c else arb(0)) for x in together}
        P, _ = solve(self.flow, set(together), wanted, together)
        push = self.flow.back * arb_mat([[P[x].mid() if x in P else arb(0)] for x in range(self.m)])
        still = (self.z + push).mid()
        second = (self.flow.rates[c] * regime.G).mid()
        a = (side * (second * still)[0, 0]).mid()
        jerk = (-side * (second * regime.G * still)[0, 0]).mid()
        drag = (-(second * push)[0, 0] / (side * speed)).mid()  # u'' changes by -c u'
        # Nothing drives the contact back to its stop.
        if not a > 0:
            return
        k = jerk - drag * a
        T = (2 * speed / (a * (1 - e))).mid()
        # A flight lasts about 2 v/a: the next series covers it and half as much again.
        self.soon = min(self.soon, 3.0 * float(speed / a))
        # Only impacts that are all over soon count with this one, and may be summed.
        if not T * self.fastest < UNLISTED or not UNLISTED * self.t > T:
            return
        self.unlisted.add(c)
        # The terms that the series leaves out must be below the digits: else the next impact is followed as well.
        fast = max(float(abs(k) / a), abs(float(drag)), self.fastest)
        if not T * fast < arb(2) ** (-self.bits // 3):
            return
        # Remove the speed, and hold the contact for as long as the impacts would last.
        self.unlisted.discard(c)
        self._push(P)
        last = self._last(c)
        assert last is not None
        last.end, here = None, self.t
        for x, side_of in {**self.held, c: side}.items():  # less on c than holding it that long brings
            self._press(x, (-side_of * P[x]).mid() if x in P else arb(0))
        self.motion.stuck.append(((self.t + T * (1 + T * (k / (3 * a) - drag / 6))).mid(), c))
        self.motion.left_out = max(self.motion.left_out, float(T) * (float(T) * fast) ** 2)
        self._settle({**self.held, c: side})
        if c not in self.held:
            last.end = here


def least_index(start: set[int], violated: Callable[[set[int]], Iterable[int]]) -> set[int]:
    """The set that violates nothing; ``violated`` names what a set does violate. Raises Undecided for no end."""
    taking = set(start)
    for _ in range(MOST_CHANGES):
        wrong = min(violated(taking), default=None)
        if wrong is None:
            return taking
        taking ^= {wrong}
    raise Undecided


def newton(
    flow: LinearFlow, e: list[Any], closed: dict[int, int], before: dict[int, Any]
) -> tuple[dict[int, Any], dict[int, Any]]:
    """P of the contacts that take part, and U+ - U- of all ``closed`` (contact: side), U- = ``before``, as balls."""
    wanted = {c: -(1 + e[c]) * before[c] for c in closed}

    # P must not pull, and a contact without P must not keep more speed into its stop than Newton's law allows.
    def violated(taking: set[int]) -> Iterable[int]:
        P, jump = solve(flow, taking, wanted, closed)
        for c, side in closed.items():
            if side * P[c] > 0 if c in taking else side * (jump[c] - wanted[c]) > 0:
                yield c

    taking = least_index(set(closed), violated)
    P, jump = solve(flow, taking, wanted, closed)
    return {c: P[c] for c in taking if not P[c].contains(0)}, jump


def solve(flow: LinearFlow, taking: set[int], wanted: dict[int, Any], closed: Iterable[int]) -> tuple[Any, Any]:
    """Impulses that change the velocities of ``taking`` as ``wanted``, and the changes of all ``closed``, as balls."""
    at = tuple(sorted(taking))
    # An impulse may be zero but for rounding, which all the speeds together determine.
    noise = (sum((abs(x) for x in wanted.values()), arb(0)) * arb(2) ** -flow.bits).mid()
    P = dict.fromkeys(closed, arb(0))
    if at:
        solved = flow.among(at).solve(arb_mat([[wanted[c]] for c in at])).entries()
        for c, x in zip(at, solved, strict=True):
            P[c] = arb(x.mid(), (noise / flow.compliance[c, c]).mid())
    jump = {c: arb(sum((flow.compliance[c, k] * P[k].mid() for k in at), arb(0)).mid(), noise) for c in closed}
    return P, jump
