"""Drive an adaptive solver through its time span, from one smooth interval and one event to the next.

The solver restarts wherever its right-hand side is not smooth: at the cuts of the functions of time, at every entry
into a stop and every exit from one. In a phase between two restarts every contact keeps its side. The force is then
smooth beyond the stop as well, and the event is a root of a smooth function.

A solver evaluates a load only at its steps. At rest it doubles its step and can pass over a short pulse. The time span
is therefore cut where a function of time is known not to be smooth, and the step is bounded by the period of a Harmonic
and by a share of the span for Python functions.

Limitation: a Python function is seen only at the steps. A feature shorter than a step can be missed, unless the caller
gives ``breakpoints`` around it. The reference states the bound, and its horizon is measured against
a solution with shorter steps at other times.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...basics.arrays import Array
from ...basics.resources import clock, late
from ...basics.validation import InputError
from ...model.contact import chord
from ...model.modes import undamped_modes
from ...model.right_hand_side import THROUGH, RightHandSide
from ...model.system import System
from ...model.time_functions import evaluate
from ...trajectory.trajectory import SolverFailure
from ..registry import Request

PERIODS_PER_STEP = 0.25  # of a Harmonic
PER_STEP = 0.25  # of an interval with a cubic: it turns twice, and a stop that does is in and out again in one step
STEPS_OF_FUNCTIONS = 200  # in the span, at least, where a load or an offset is a Python function
SECOND_LOOK = 0.381966  # of the step bounds, for the steps of a second solution to lie at other times
SAMPLES = 4097  # of every function of time, for its largest value
STUCK = 1000  # phases without progress in time, after which a solver gives up
MOST_EVALUATIONS = 50_000_000  # of the right-hand side: some ten minutes
ORDERS = 6  # powers of time in the rate of a body at rest on its stop, of which the first decides


class Interval(NamedTuple):
    """Interval [start, end] with smooth functions of time, the only one in which they may be evaluated: a jump at an
    end belongs to the neighbour. max_step: inf without a bound."""

    start: float
    end: float
    max_step: float


def smooth_intervals(request: Request) -> list[Interval]:
    """Cut [0, t_end] for the loads and contact offsets of the system."""
    system, t_end = request.system, request.t_end
    drive = system.drive
    drive.require_samples(t_end)
    cubic = any(record.kind == "cubic" for record in drive.records)
    # A harmonic load bounds the step: error control sees a load at the steps only.
    longest = min((PERIODS_PER_STEP * 2.0 * math.pi / w for w in drive.frequencies), default=math.inf)
    if drive.called:
        longest = min(longest, t_end / STEPS_OF_FUNCTIONS)
    if request.second:
        longest = SECOND_LOOK * min(longest, t_end / STEPS_OF_FUNCTIONS)
    # Cuts that are a few roundings apart would leave an interval of rounding length between them.
    cuts, least = [0.0], 64.0 * float(np.finfo(float).eps) * t_end
    for t in np.union1d(request.breakpoints, drive.edges).tolist():
        if cuts[-1] + least < t < t_end - least:
            cuts.append(t)
    # The functions may jump at a cut: an interval ends one double before it, and the next one evaluates them after it.
    ends = [*(math.nextafter(t, -math.inf) for t in cuts[1:]), t_end]
    starts = [0.0, *(math.nextafter(t, math.inf) for t in cuts[1:])]
    return [
        Interval(start, end, min(longest, PER_STEP * (end - start) if cubic else math.inf))
        for start, end in zip(starts, ends, strict=True)
    ]


class Scales(NamedTuple):
    """unknowns (m,): of y. lengths, speeds (contacts,): of the contact positions and their rates. energy: E."""

    unknowns: Array
    lengths: Array
    speeds: Array
    energy: float


def scales_of(system: System, t_end: float) -> Scales:
    """The largest value that every unknown would reach with the whole energy of the motion.

        E = E_0 + 1/2 sum_k max|f_k|^2 p_k^T S p_k + 1/2 sum_c (max |o_c - o_c(0)|)^2/(1/kappa_c + r_c^T S r_c)
        |q_i| <= sqrt(2 E S_ii),  |q'_i| <= sqrt(2 E (M^-1)_ii),  S = (K + 2 M/t_end^2)^-1

    E_0 is the energy at the start, the others are the work of the loads and of the moving stops if they
    acted slowly. 2 M/t_end^2 stands for what inertia holds back in the time: it gives f t_end^2/2m for a
    free mass. Every term has its dimension, so other units of length, time and mass give the same motion
    the same scales. A system in which nothing can move has scales 1.
    """
    basis, t, moves = undamped_modes(system), np.linspace(0.0, t_end, SAMPLES), list[float]()
    # S = soft soft^T, M^-1 = light light^T.
    light, soft = basis.shapes, basis.shapes / np.hypot(basis.omega, np.sqrt(2.0) / t_end)
    # Energy of the start, of the loads and of the moving stops.
    energy = float(sum(system.energies(0.0, system.q0, system.v0)))
    for vector, function in system.loads:
        root = float(np.max(np.abs(evaluate(function, t))) * np.linalg.norm(vector @ soft))
        energy += 0.5 * root * root
    for contact in system.contacts:
        o, gives = evaluate(contact.offset, t), float(np.linalg.norm(contact.row @ soft)) ** 2
        moves.append(float(np.max(np.abs(o))))
        move = float(np.max(np.abs(o - o[0])))
        if move and not contact.stops.law.damps:  # one that damps may hold the contact as if it were rigid
            gives += 1.0 / chord(move, contact.stops.law)
        energy += 0.5 * move * move / gives
    if not np.isfinite(energy):
        rule = "have an energy that float64 can hold"
        raise InputError("the motion", energy, rule, "take units in which loads and motions are smaller")
    if not energy > 0.0:
        ones = np.ones(len(system.contacts))
        return Scales(np.ones(2 * system.size), ones, ones, 1.0)
    # Largest values at that energy.
    rows = np.array([contact.row for contact in system.contacts]).reshape(-1, system.size)
    lengths, speeds = (np.sqrt(2.0 * energy) * np.linalg.norm(rows @ root, axis=1) for root in (soft, light))
    unknowns = np.stack([np.linalg.norm(root, axis=1) for root in (soft, light)], axis=1).ravel()
    # A tolerance must be positive, also for an unknown that cannot move.
    unknowns = np.sqrt(2.0 * energy) * np.where(unknowns > 0.0, unknowns, np.max(unknowns))
    return Scales(unknowns, lengths + np.array(moves), speeds, energy)


class Phase:
    """Way of a solver from (t, z) towards ``end``, with outputs at ``times``, steps up to max_step (inf: no bound), and
    root functions: every gap, then every gap's rate. For damped stops see ``kernels/rhs.h``: the gap is positive where
    they press, and the rates of the forces follow.

    The solver moves (t, z) on, with the ``states`` at the outputs on its way, until it is at the end, it has met a root
    that ``ends`` the phase, or the deadline has passed. ended_by: roots. peaks: side, time and state of each.

    A gap ends the phase, from below where the side is free, from above where it is closed. It is watched at a level a
    few roundings past where it starts, so that the root a phase starts on is not found again; a rate at one a few
    roundings above zero, where it does not stay at rest. A rate that changes sign where the gap is past its level shows
    that both crossings lie inside one step: the phase is ``missed`` and made again up to there. The rates of closed
    sides give the peaks.
    """

    def __init__(
        self, rhs: RightHandSide, t: float, end: float, z: Array, times: Array, max_step: float, closed: list[bool],
        rounding: Array,
    ) -> None:  # fmt: skip
        self.t, self.end, self.z, self.max_step = t, end, z, max_step
        self.times, self.states = times[: np.searchsorted(times, end, "right")], list[Array]()
        self.rhs, self.closed, self.count, self.size = rhs, closed, len(closed), len(rounding)
        rhs.levels[:] = rounding
        rhs.levels[: self.count] = 0.0
        gaps, margin = self.values(t, z)[: self.count], rounding[: self.count]
        rhs.levels[: self.count] = np.where(closed, np.minimum(gaps - margin, 0.0), np.maximum(gaps + margin, 0.0))
        self.ended_by, self.peaks = list[int](), list[tuple[int, float, Array]]()

    @property
    def directions(self) -> list[int]:
        """Direction of every root: +1 rising, -1 falling, 0 both."""
        more = self.size // max(1, self.count) - 1  # rows of rates
        # A rate falls through zero at the peak of a closed side. The rate of an open side does so where it is closest
        # to its stop, or deepest after a missed entry. A rising rate of a closed side can show a missed exit.
        return [-1 if c else 1 for c in self.closed] + more * [0 if c else -1 for c in self.closed]

    @property
    def missed(self) -> bool:
        """True where rates alone have ended it."""
        return bool(self.ended_by) and min(self.ended_by) >= self.count

    def values(self, t: float, z: Array) -> Array:
        """The root functions."""
        return self.rhs.event_functions(t, z) if self.count else np.empty(0)

    def ends(self, t: float, z: Array, roots: dict[int, int]) -> bool:
        """Return True if roots at t with state z, their signs +1 rising and -1 falling, end the phase. Peaks, which do
        not, are recorded."""
        for root, sign in roots.items():
            k = root % self.count
            # Gap past its level at a zero of the rate: the step holds both crossings.
            pressed = root >= self.count and self.values(t, z)[k] > 0.0
            if root < self.count or pressed != self.closed[k]:
                self.ended_by = list(roots)
                break
            if sign < 0 and pressed and root >= self.size - self.count:  # of the last row of rates
                self.peaks.append((k, t, z))
        return bool(self.ended_by)


@dataclass
class Span:
    """A closed interval of a side: time, state and |F| at its ends, the second the end of the solution while it is
    ``open``, and the largest |F| between."""

    ends: list[tuple[float, Array, float]]
    peak: float = float("nan")
    open: bool = True


Solver = Callable[[Phase], dict[str, int]]


class Path:
    """A motion from event to event, by a ``solver`` of phases, which returns what it has counted.

    states: at the outputs. end, z: the time that it has reached, and the state there. spans: the contacts of every
    side. counters: sums of what the solver has counted. seconds: of CPU. Forces are computed while the functions of
    time may be evaluated.
    """

    def __init__(self, method: str, rhs: RightHandSide, scales: Scales, solver: Solver) -> None:
        self.method, self.rhs, self.solver = method, rhs, solver
        # What event functions are good to: a gap is a difference of numbers as large as the motion and the stop, and
        # below some roundings of these its sign means nothing. The rates of forces, each in units of its own, have 0.
        stops = [max(abs(g) for g in rhs.system.contacts[i].stops.sides.values()) for i, _ in rhs.sides]
        contacts = [i for i, _ in rhs.sides]
        extents = np.concatenate([scales.lengths[contacts] + stops, scales.speeds[contacts]])
        self.rounding = 16.0 * np.finfo(float).eps * np.pad(extents, (0, len(rhs.levels) - len(extents)))
        self.states, self.spans = list[Array](), [list[Span]() for _ in rhs.sides]
        self.counters, self.end = Counter(restarts=-1), 0.0
        rhs.lengths[:], rhs.regime[:] = scales.lengths, THROUGH

    def follow(self, intervals: Sequence[Interval], t: Array) -> None:
        """Integrate from 0 to the end of the last interval, with output at the times t, or to the deadline."""
        rhs, z, now, still, begun = self.rhs, self.rhs.z0.copy(), 0.0, 0, clock()
        self.states += [z] if len(t) and t[0] <= 0.0 else []
        # In every smooth interval, phases from event to event.
        for interval in intervals:
            stored = rhs.stored(now, z)
            rhs.window[:] = (interval.start, interval.end)
            if interval is intervals[0]:
                switched = np.flatnonzero(self._closed_at_start(z, interval)).tolist()
            else:
                # A stop may jump where an interval begins, or its velocity does, and with it the force of its damping.
                z = rhs.jumped(now, z, stored)
                gaps = self._gaps_and_rates(now, z)[0]
                turned = (np.abs(gaps) > self.rounding[: len(gaps)]) & ((gaps > 0.0) != self.closed)
                switched = np.flatnonzero(turned).tolist()
            while True:
                for k in switched:
                    self._switch(k, now, z)
                self._pass_kink(now, z)
                if now >= interval.end or late(now):
                    break
                phase, switched = self._phase(interval, now, z, t[len(self.states) :])
                # Phases without progress in time would never end.
                self.counters["restarts"] += 1
                still = still + 1 if phase.t <= now else 0
                if still > STUCK:
                    remedy = "take the exact solution, or a damped stop"
                    raise SolverFailure(self.method, now, "events without end", remedy)
                now, z = phase.t, phase.z
                self.states += phase.states
            if now < interval.end:
                break
        else:
            # A root at the end itself leaves the output there to a phase that does not come.
            self.states += [z] * (len(t) - len(self.states))
        for k in np.flatnonzero(self.closed).tolist():
            self.spans[k][-1].ends.append((now, z, rhs.pressing(now, z, k)))
        self.end, self.z, self.seconds = now, z, clock() - begun

    def _phase(self, interval: Interval, now: float, z: Array, times: Array) -> tuple[Phase, list[int]]:
        """Integrate from an event to the next, or to the end of the interval; also the sides that change there.

        Each contact keeps its side, so that its force is smooth past the event, an ordinary root. A phase that passed
        over both crossings of a gap is repeated to the time between them.
        """
        rhs, closed = self.rhs, self.closed
        rhs.regime[:] = 0
        for k in np.flatnonzero(closed):
            contact, side = rhs.sides[k]
            rhs.regime[contact] = side
        end, landing, tries = interval.end, None, 0
        while True:
            tries += 1
            phase = Phase(rhs, now, end, z, times, interval.max_step, closed, self.rounding)
            self.counters.update(self.solver(phase))
            refuse_endless(self.method, phase.t, max(self.counters.values()))
            # Ended by rates only, it is repeated with a step that ends there.
            if not phase.missed or phase.t <= now or tries == STUCK:
                break
            landing, end = phase.ended_by[0] % phase.count, phase.t
        for peak in phase.peaks:
            self._note(*peak)
        # Sides that change: those with an event, and the one at which a repeated phase ended past the event.
        switched = [root for root in phase.ended_by if root < phase.count]
        if landing is not None and not switched:
            past = (phase.values(phase.t, phase.z)[landing] > 0.0) != closed[landing]
            switched = [landing] if past else []  # on the stop at the end of the step, to rounding
        return phase, switched

    @property
    def closed(self) -> list[bool]:
        """True for sides that have been entered and not left."""
        return [bool(spans) and spans[-1].open for spans in self.spans]

    def _switch(self, side: int, t: float, z: Array) -> None:
        """Record an event at t with state z: the side is left if it is closed, else entered."""
        at = t, z, self.rhs.pressing(t, z, side)
        if self.closed[side]:
            self.spans[side][-1].ends.append(at)
            self.spans[side][-1].open = False
        else:
            self.spans[side].append(Span([at]))

    def _note(self, side: int, t: float, z: Array) -> None:
        """Record a force that may be the largest of a closed side."""
        span = self.spans[side][-1]
        span.peak = float(np.fmax(span.peak, self.rhs.pressing(t, z, side)))

    def _pass_kink(self, t: float, z: Array) -> None:
        """Record the forces where a phase begins or ends within a contact. The force of a moving or damped stop may
        turn there from rising to falling without a zero of its rate."""
        for k in np.flatnonzero(self.closed).tolist():
            contact = self.rhs.system.contacts[self.rhs.sides[k][0]]
            if (contact.offset is not None or contact.stops.law.damps) and self.spans[k][-1].ends[0][0] < t:
                self._note(k, t, z)

    def _gaps_and_rates(self, t: float, z: Array) -> Array:
        """Gaps and their rates (2, sides) > 0 in the stops, not less any level."""
        self.rhs.levels[:] = 0.0
        count = len(self.rhs.sides)
        return self.rhs.event_functions(t, z)[: 2 * count].reshape(2, count)

    def _closed_at_start(self, z: Array, interval: Interval) -> list[bool]:
        """True inside the stop, or exactly on it and moving or pushed in, at once or later."""
        rhs, z_rate, orders = self.rhs, self.rhs.rate(0.0, z), []
        for (i, side), gap, rate in zip(rhs.sides, *self._gaps_and_rates(0.0, z), strict=True):
            # On the stop the first derivative that is not zero decides: gap, rate, acceleration, and those after it.
            push = side * float(rhs.system.contacts[i].row @ z_rate[1 : rhs.states : 2])
            orders.append(next((x for x in (gap, rate, push) if x != 0.0), 0.0))
        if 0.0 in orders:
            # Open, or a stiff stop would make the steps too short to show where the body goes.
            rhs.regime[[i for (i, _), x in zip(rhs.sides, orders, strict=True) if x == 0.0]] = 0
            orders = [x or later for x, later in zip(orders, self._leaving(z, interval).tolist(), strict=True)]
            rhs.regime[:] = THROUGH
        return [x > 0.0 for x in orders]

    def _leaving(self, z: Array, interval: Interval) -> Array:
        """The rate of every gap just after the start, 0.0 where it is below rounding.

        A load that grows from zero, or a neighbour, moves a body at rest by a high power of time. A step of Euler's
        method is a polynomial with positive coefficients, so that ``ORDERS`` short ones have the sign of the first
        power.
        """
        rhs = self.rhs
        fastest = np.max(np.abs(np.linalg.eigvals(rhs.jacobian(0.0, z)[: rhs.states, : rhs.states])))
        h = 1e-2 * min(10.0 / float(fastest) if fastest > 0.0 else np.inf, interval.max_step, interval.end)
        for k in range(ORDERS):
            z = z + h * rhs.rate(k * h, z)
        rates = self._gaps_and_rates(ORDERS * h, z)[1]
        return np.where(np.abs(rates) > self.rounding[len(rates) : 2 * len(rates)], rates, 0.0)


def refuse_endless(method: str, t: float, evaluations: int) -> None:
    """Raise SolverFailure for a solver that has done too much work by time t."""
    if evaluations > MOST_EVALUATIONS:
        reason = f"{evaluations} evaluations of the right-hand side, more than {MOST_EVALUATIONS}"
        raise SolverFailure(method, t, reason, "loosen rtol, shorten t_end or take the exact solution")
