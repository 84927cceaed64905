"""The exact piecewise-linear solution in as many digits as error growth requires, with python-flint.

Between two events the system is one linear flow, z' = G z, in blocks (linear_flow.py). Float64 finds the next event
from the state, Newton's method doubles its digits, and one evaluation of the exponentials uses all of them. Digits that
the motion has lost are dropped. Two runs with different digits have to agree.

Contacts that float64 cannot see: where a gap is almost zero as it turns, many digits say whether it is closed.

The event search runs in float64, where a gap that turns at less than the rounding of its terms counts as open.
Near such a turn gap = d + a s^2/2, a > 0, s the time from it, and d in all the digits that are carried decides:

    d < 0    closed for 2 sqrt(-2 d/a): a contact, or a moment between two, that was passed over
    d > 0    open; where |d| is less than ``TOUCH`` of the motion it touches, and that is no contact

In contact the gap is the penetration. Of a damped stop that presses only the penetration is looked at, not the force.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import flint
import numpy as np
from flint import arb, arb_mat, ctx
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...basics.resources import afford, clock, in_time
from ...basics.validation import InputError, positive
from ...kernels.exact import Marks
from ...model.contact import Stops
from ...model.system import System
from ...model.time_functions import Drive
from ...trajectory.records import last_before
from ...trajectory.trajectory import Reference, SolverFailure
from ..exact.contacts import path_of
from ..exact.motion import (
    EPS,
    LET_GO,
    NO_BLOWS,
    NO_EVENTS,
    REMEDY,
    Motion,
    Solver,
    fresh_after,
    pressed,
    require_short,
    switched_by_force,
)
from ..exact.solution import reference_of, refuse
from ..horizon import lyapunov
from ..registry import Request
from .linear_flow import LinearFlow, Split, by_float64
from .rational import carried, exact_problem

BITS = math.log2(10.0)
MAX_DIGITS = 20_000
GUARD_BITS = 100  # below the digits that are lost: two doubles' worth for the outputs
KNOWN_BITS = 28  # precision of a time between two events in float64
CANCELLED = 1e-10  # of max |u|: more than that is lost by float64 sums between the events
AGREEMENT = 1e-12  # of max |u| and of the time: how closely two precisions have to agree
MOST = 100  # contacts that float64 passes over; each costs the whole solution once more

Known = dict[tuple[int, ...], Split]  # by the contacts that are closed
Sampler = Callable[..., tuple[Array, Array]]  # of the channels at any times, rounded by what it is given


class Switch(NamedTuple):
    """An event that the search receives: approximate time, contact, and side of the stop."""

    t: float
    contact: int
    side: int


def solve(request: Request) -> Reference:
    """The exact solution with ``digits`` decimal digits, and again with a quarter more.

    "auto" estimates the digits from the growth of tangent vectors along the float64 solution, and goes
    on until both runs agree to t_end. A fixed number gives the horizon to which both
    agree. Positions and velocities at the output times are evaluated in that many digits and rounded
    once. Any other time, the peaks and the energy ledger are evaluated in float64 from the rounded states at the
    switches, or where that is off by more than ``CANCELLED`` in many digits too: provenance["between"] is how far
    what is used is off at the output times, relative to max |u|. Takes what the exact solution takes: any damping,
    any number of contacts, time functions made of Harmonic, Constant and Sampled; raises InputError otherwise and for
    rigid stops, SolverFailure where even ``MAX_DIGITS`` do not suffice.

    Numbers: those of a case file, and in Python those given as texts, Fractions or Decimals, have their exact
    values. All others are doubles; provenance["parameters"] names the
    exact ones. Past the horizon of float64 the two readings have different solutions. t_end and output
    times are doubles: nothing magnifies their rounding. Float64 finds the next event, which is then refined. Events
    that float64 passes over are searched where gaps turn, see above. A contact shallower than 1e-18 of the motion
    counts as none, see provenance["grazes"].
    """
    system, t_end, t_eval, digits = request.system, request.t_end, request.t_eval, request.digits
    positive("t_end", t_end)
    if digits != "auto" and (isinstance(digits, bool) or not isinstance(digits, int) or not 20 <= digits <= MAX_DIGITS):
        raise InputError("digits", digits, f"be 'auto' or an integer from 20 to {MAX_DIGITS}", "auto decides by itself")
    for contact in system.contacts:
        contact.stops.require_compliant("multiprecision")
    refuse(system, t_end)
    begun = clock()
    # Solve with more and more digits until two runs agree.
    wanted, guard = (_estimate(system, t_end) if digits == "auto" else int(digits)), GUARD_BITS
    previous: Reference | None = None
    known: Known = {}
    while True:
        if wanted > MAX_DIGITS:
            raise SolverFailure("multiprecision", t_end, f"{wanted} digits are not enough", "shorten t_end")
        notes: dict[str, Any] = {
            "digits": wanted,
            "parameters": "doubles; exact: " + ("; ".join(system.exact_parameters) or "none"),
            "python-flint": flint.__version__,
        }
        solution, sample, unrounded = carry(system, t_end, wanted, guard, known)
        try:
            require_short(solution.made.free, t_end)
        except SolverFailure:  # float64 has no way between the states
            solution = unrounded
        run = reference_of(system, solution, t_end, t_eval, begun, "multiprecision", notes)
        run = _sampled(run, *sample(run.t))
        if previous is not None:
            horizon = _agreement(previous, run)
            # A fixed number of digits is confirmed once: the horizon tells how far it is good.
            if horizon >= t_end or digits != "auto":
                # Sums of float64 cancel between the events: evaluate there in many digits as well.
                if run.provenance["between"] > CANCELLED:
                    run = reference_of(system, unrounded, t_end, t_eval, begun, "multiprecision", notes)
                    run = _sampled(run, *sample(run.t))
                notes = {
                    "digits_confirmed_with": previous.provenance["digits"],
                    "horizon": horizon,
                    "horizon_against": f"itself with {previous.provenance['digits']} digits",
                    "grazes": grazes_of(solution, t_end),
                    "horizon_tolerance": f"|du| <= {AGREEMENT:g} max|u| at the output times, the same events",
                }
                return replace(run, horizon=horizon, provenance=run.provenance | notes)
        previous = run
        # The guard grows too: other outputs then reveal cancellation that it did not cover.
        wanted, guard = math.ceil(1.25 * wanted) + 15, math.ceil(1.25 * guard) + 50


def carry(
    system: System, t_end: float, digits: int, guard: int = GUARD_BITS, known: Known | None = None
) -> tuple[Motion, Sampler, Motion]:
    """Follow the solution with ``digits`` at the start beside the ``guard`` bits that the outputs need: rounded to
    float64, what samples its channels before that, and the first again by sums that do not cancel.

    Those also pay for cancellation: between modes, between the motion and its response to the drive, and
    in the eigenproblem. How much of it there is shows when another guard gives other outputs.
    """
    before = ctx.prec
    full = math.ceil(digits * BITS) + guard
    try:
        ctx.prec = full + guard
        told: list[Switch] = []
        known = {} if known is None else known
        # A contact that float64 passed over changes all that follows: solve again with it.
        for _ in range(MOST):
            solution = follow(system, t_end, full, guard, told, known)
            another = passed_over(system, solution[0], solution[1], t_end, told[-1].t if told else 0.0)
            if another is None:
                return solution
            told.append(another)
        remedy = f"end before t = {told[0].t:.6g}"
        raise SolverFailure("multiprecision", told[-1].t, f"{MOST} contacts that float64 does not see", remedy)
    finally:
        ctx.prec = before


def _sampled(run: Reference, positions: Array, velocities: Array) -> Reference:
    """``run`` with its outputs (k, channels) as they were before the states were rounded."""
    assert run.system is not None
    tip = run.system.tip_channel
    scale = float(np.max(np.abs(positions[:, tip]))) or 1.0
    contacts = tuple(
        replace(
            record,
            position=positions[:, i],
            velocity=velocities[:, i],
            force=record.stops.force(positions[:, i], velocities[:, i]),
        )
        for i, record in enumerate(run.contacts)
    )
    between = float(np.max(np.abs(run.tip - positions[:, tip]))) / scale
    return replace(
        run,
        tip=positions[:, tip],
        tip_velocity=velocities[:, tip],
        contacts=contacts,
        provenance=run.provenance | {"between": between},
    )


def _estimate(system: System, t_end: float) -> int:
    """Digits for t_end: what tangent vectors lose on the way, a twentieth for another way, and 20 to be left.

    Where float64 has no solution to take them along, 40: the runs go on until they agree.
    """
    try:
        lost = lyapunov(system, t_end).digits
    except SolverFailure:
        return 40
    return 20 + math.ceil(1.05 * max(0.0, lost))


def _agreement(a: Reference, b: Reference) -> float:
    """The time to which two precisions agree in every event and in the displacement."""
    # First event that differs, or that only one run has.
    x, y = a.solution, b.solution
    n = min(len(x.times), len(y.times))
    apart = np.any(x.sides[:n] != y.sides[:n], axis=1)
    apart |= np.abs(x.times[:n] - y.times[:n]) > AGREEMENT * y.times[:n]
    end = float(b.provenance["t_end"])
    if np.any(apart):
        end = float(min(x.times[np.argmax(apart)], y.times[np.argmax(apart)]))
    elif len(x.times) != len(y.times):
        end = float((x if len(x.times) > n else y).times[n])
    # First output up to there at which the displacements differ.
    scale = float(np.max(np.abs(b.tip)))
    return last_before(b.t, ~(np.abs(a.tip - b.tip) <= AGREEMENT * scale) & (b.t <= end), end)


# ---------------------------------------------------------------- from event to event


class PreciseRegime:
    """The flow with contacts ``closed``.

    known: splits by the contacts that are closed, on either side; this one is added.
    """

    def __init__(self, flow: LinearFlow, closed: tuple[int, ...], known: Known) -> None:
        self.flow, self.G = flow, flow.closed(closed)
        # A stop adds the same stiffness and damping on either side; only the constant term of G differs. The split of
        # one side is therefore where the refinement of the other begins.
        contacts = tuple(map(abs, closed))
        if contacts in known:
            self.split = known[contacts].again(self.G)
        else:
            self.split = Split(self.G, *by_float64(flow, self.G), drives=2 * flow.n)
        known[contacts] = self.split
        self.rates = np.array([x for block in self.split.blocks for x in block.values])
        self._rows: dict[tuple[int, int, bool], Any] = {}

    @cached_property
    def channels(self) -> Any:
        """Rows of all channels and their rates on y (2 channels, N)."""
        return self._seen(*self.flow.forms, *self.flow.rates)

    def gap(self, contact: int, side: int, lagging: bool) -> Any:
        """Rows of u - g of a contact, or of u - g + (c/kappa) u', and of its rate on y (2, N)."""
        key = contact, side, lagging
        if key not in self._rows:
            form = self.flow.gap(contact, side, lagging)
            self._rows[key] = self._seen(form, form * self.G)
        return self._rows[key]

    def _seen(self, *forms: Any) -> Any:
        return (arb_mat([form.entries() for form in forms]) * self.split.V).mid()


class Piece(NamedTuple):
    """A regime from time t on, the coordinates y there and the bits carried."""

    regime: PreciseRegime
    t: Any
    y: Any
    bits: int

    def ahead(self, t: float) -> Any:
        """y at time t."""
        return self.regime.split.ahead(self.y, arb(t) - self.t)

    def state(self, t: float) -> Any:
        """z (N, 1) at time t."""
        return (self.regime.split.V * self.ahead(t)).mid()


@dataclass(frozen=True, eq=False)
class Unrounded(Motion):
    """A motion with the states of its ``precise`` pieces, for motions that are small differences of
    large amplitudes: of these only the values are rounded."""

    precise: list[Piece] = field(default_factory=list)  # of every mark

    def _read(self, t: Array, piece: NDArray[np.int64] | None = None) -> tuple[Array, Array, Array]:
        where = self.piece_at(t) if piece is None else piece
        n, z = self.system.size, np.empty((len(t), self.precise[0].regime.flow.N))
        for i, (k, when) in enumerate(zip(self.mark_at(t, where).tolist(), t.tolist(), strict=True)):
            with carried(self.precise[k].bits):
                z[i] = [float(x) for x in self.precise[k].state(when).entries()]
        return *self.made.start(z[:, :n], z[:, n : 2 * n]), np.zeros((len(t), len(self.system.contacts)))


def follow(
    system: System, t_end: float, full: int, guard: int, told: Sequence[Switch], known: Known
) -> tuple[Motion, Sampler, Unrounded]:
    """The solution on [0, t_end] carried with ``full`` bits at the start and ``guard`` at the end, rounded to
    float64, what samples its channels before it is rounded, and itself unrounded; ctx.prec has room to spare.

    told: events that float64 does not see, in order. known: see ``PreciseRegime``.
    """
    room, drive, solver = ctx.prec, Drive.of(system), Solver(system)
    # The flow in many digits; the events are found by float64.
    flow, regimes = LinearFlow(system), dict[tuple[int, ...], PreciseRegime]()
    t, z = arb(0), flow.start()
    chi = [
        side_of(contact.stops, *(float((form * z)[0, 0]) for form in forms))
        for contact, *forms in zip(system.contacts, flow.forms, flow.rates, strict=False)
    ]
    sides, states, first = list[list[int]](), list[Array](), list[int]()  # of marks, and the marks of events
    fresh, pieces, untold = np.zeros(len(chi), np.int64), list[Piece](), list(told)
    fastest, turning = 1.0 / t_end, max(1.0 / t_end, *drive.frequencies, 0.0)  # of all regimes met
    while True:
        # The regime of these contacts, refined where it is first met.
        key = tuple(pressed(chi).tolist())
        if key not in regimes:
            with carried(room):
                regimes[key] = PreciseRegime(flow, key, known)
            fastest = max(fastest, float(np.max(np.abs(regimes[key].rates))))
            turning = max(turning, float(np.max(np.abs(regimes[key].rates.imag))))
        # Errors grow with time: precision falls evenly from ``full`` at the start to ``guard`` at the end.
        regime, begun = regimes[key], float(t)
        ctx.prec = max(guard, math.ceil(full - (full - guard) * min(1.0, begun / t_end))) + 30
        if not sides or chi != sides[-1]:
            first.append(len(sides))
        sides.append(list(chi))
        states.append(np.array([float(x) for x in z.entries()[: 2 * flow.n]]))
        pieces.append(Piece(regime, t, (regime.split.L * z).mid(), ctx.prec))
        afford("t_end", t_end, "shorten t_end", floats=len(sides) * (full / 32.0 + 20.0) * system.size)
        # Next event before the next sample: by float64, or one that float64 passes over if that comes first.
        edge = drive.next_edge(begun, t_end)
        found = solver.first_event(begun, np.array(chi, np.int64), fresh, np.split(states[-1], 2), edge)
        start, contact, side = found or (edge, -1, 0)
        if untold and untold[0].t < (start if contact >= 0 else edge):
            start, contact, side = untold[0]
            # In contact the event that was passed over is an exit.
            side = 0 if chi[contact] else side
            del untold[0]
        if contact >= 0 and start < edge:
            # Refine the event to all digits, and go on from there in the new regime.
            in_time(begun)
            gap = regime.gap(contact, int(np.sign(side or chi[contact])), switched_by_force(chi[contact], side))
            look = partial(_at, pieces[-1], gap)
            tau, shift, ahead = _locate(look, start - begun, fastest, 2.0 * np.pi / turning, begun)
            when = (t + tau + shift).mid()
            # With records the flow holds up to the sample only: an event refined past it belongs to the next segment.
            if not drive.records or t <= when < edge:
                after = [side if i == contact else x for i, x in enumerate(chi)]
                t, fresh, chi = when, fresh_after(system, chi, after), after
                z = (regime.split.V * regime.split.ahead(ahead, shift)).mid()
                continue
            if when < t:
                raise SolverFailure("multiprecision", begun, "an event at a sample that float64 cannot place", REMEDY)
        # No event before the sample: the same regime goes on with the next polynomials of the records.
        if edge >= t_end:
            break
        t, z, fresh = arb(edge), flow.at_edge(pieces[-1].state(edge), arb(edge)), 0 * fresh
    # The motion as float64 stores it: the states at all marks.
    q, v = np.split(np.array(states), 2, axis=1)
    times, at = np.array([float(x.t) for x in pieces]), np.array(sides, np.int64).reshape(len(sides), len(chi))
    marks = Marks(times, *solver.made.start(q, v), at)
    places = np.array(first)
    motion = (
        system, solver.made, solver.radians, times[places], at[places], places, marks, len(sides), NO_EVENTS, NO_BLOWS,
    )  # fmt: skip
    return Motion(*motion), partial(_sample, times.tolist(), pieces), Unrounded(*motion, precise=pieces)


def side_of(stops: Stops, u: float, velocity: float) -> int:
    """The side of a contact at u."""
    closed = int(stops.state(u, velocity))
    return closed if closed else LET_GO * int(np.sign(stops.penetration(u))) if stops.dissipative else 0


def _sample(
    times: list[float], pieces: list[Piece], t: Array, rounded: Callable[[Any], Any] = float
) -> tuple[Array, Array]:
    """Positions and velocities (k, channels) at any times, ``rounded``."""
    states = []
    for when, k in zip(t.tolist(), np.maximum(np.searchsorted(times, t, "right") - 1, 0).tolist(), strict=True):
        with carried(pieces[k].bits):
            seen = pieces[k].regime.channels * pieces[k].ahead(when)
            states.append([rounded(x) for x in seen.entries()])
    u, v = np.array(states).reshape(len(t), 2, -1).transpose(1, 0, 2)
    return u, v


def _at(piece: Piece, gap: Any, tau: Any) -> tuple[Any, Any, Any]:
    """A gap and its rate at tau after the start of a piece, and y there."""
    y = piece.regime.split.ahead(piece.y, tau)
    return *(gap * y).mid().entries(), y  # type: ignore[return-value]


def _locate(
    gap_at: Callable[[Any], tuple[Any, Any, Any]], start: float, fastest: float, shortest: float, t: float
) -> tuple[Any, Any, Any]:
    """(tau, shift, y at tau): the gap closes at tau + shift, by so little later that y is known there as well.

    gap_at(tau) -> (gap, gap', y). Newton's method from the float64 time ``start``, the precision doubled at each turn,
    so that only one evaluation is made at full precision. Where the gap is zero as the piece begins, at rest on its
    stop and pressed, that is the event. Raises SolverFailure where Newton's method leads further than a fiftieth of
    the ``shortest`` period away: two crossings so close to each other that float64 cannot tell them apart.
    """
    near = 0.02 * shortest
    # At rest on its stop and pressed: at the start gap and rate are zero to half the digits.
    if start < near:
        (gap, speed, y), soon = gap_at(arb(0)), arb(0.5 * near)
        if max(abs(gap), abs(speed) * soon) < arb(2) ** (-ctx.prec // 2) * abs(gap_at(soon)[0]):
            return arb(0), arb(0), y
    # Newton's method with few digits first: a step doubles the correct ones, so more would be computed in vain.
    full, tau, accurate = ctx.prec, arb(start), KNOWN_BITS
    while accurate < full // 2:
        accurate = 2 * accurate - 8  # the ratio of gap'' to gap' costs a few bits at each turn
        with carried(min(full, accurate + 70)):
            gap, speed, _ = gap_at(tau)
            tau = (tau - gap / speed).mid()
    # At full precision: the last step is returned as ``shift``, so that the gap need not be evaluated after it.
    for _ in range(64):
        gap, speed, y = gap_at(tau)
        shift = (-gap / speed).mid()
        if not abs(float(tau + shift) - start) < near:
            break
        # What the last step leaves is its square. A damped stop's force jumps, so all digits of the time count.
        if abs(shift) * fastest < arb(2) ** (-full // 2):
            return tau, shift, y
        tau = (tau + shift).mid()
    remedy = f"end before t = {t + start:.6g}" if t + start > near else "start a little off the stop"
    raise SolverFailure("multiprecision", t + start, "the event is a graze that float64 cannot place", remedy)


# ---------------------------------------------------------------- contacts that float64 does not see

PER_PERIOD = 16  # looks at a gap in the shortest period
AT_ONCE, MOST_LOOKS = 100_000, 30_000_000
CLOSE = 1e-9  # of the motion: deeper ones float64 sees
TOUCH = 1e-18
MOVES = 64.0 * EPS  # of the largest speed: a gap that turns more slowly rests
HALVINGS = 60
APART = 64.0 * EPS  # of the time: events that are closer have one time in float64


class Turn(NamedTuple):
    """A gap sign (u - stop) that turns at t with gap'' = curve > 0 within ``CLOSE`` of zero; size: of the motion."""

    t: float
    contact: int
    side: int
    sign: int
    curve: float
    size: float


def passed_over(system: System, solution: Motion, sample: Sampler, t_end: float, since: float) -> Switch | None:
    """The first event after ``since`` that is missing in ``solution``; ``sample`` gives its channels in many digits.

    None too for more than ``MOST_LOOKS``. Raises SolverFailure where it ends before float64 can tell its end from its
    beginning.
    """
    if np.sum(looks(solution, t_end)[0]) > MOST_LOOKS:
        return None
    # Turns close to zero by float64, then the least gap of each in many digits.
    turns = [turn for i in range(len(system.contacts)) for turn in _turns(system, solution, i, t_end)]
    contacts = exact_problem(system, Drive.of(system)).contacts if turns else []
    for turn in sorted(turn for turn in turns if turn.t > since):
        t, stop, least = turn.t, contacts[turn.contact].stop(turn.side), arb(0)
        for _ in range(3):  # to the double next to the turn
            (u,), (v,) = (x[:, turn.contact] for x in sample(np.array([t]), lambda x: x))
            # Least value of the parabola through gap, rate and curvature at t.
            least = turn.sign * (u - stop - v * v / (2 * arb(turn.sign * turn.curve)))
            t = min(max(0.0, t - turn.sign * float(v) / turn.curve), t_end)
        depth = -float(least)
        if depth <= TOUCH * turn.size:
            continue
        # The parabola crosses zero that long before its turn.
        early = math.sqrt(2.0 * depth / turn.curve)
        if early <= APART * t:
            remedy = f"end before t = {t:.6g}"
            raise SolverFailure("multiprecision", t, "a contact begins and ends at one time of float64", remedy)
        return Switch(t - early, turn.contact, turn.side)
    return None


def looks(solution: Motion, t_end: float) -> tuple[NDArray[np.int64], Array]:
    """Number of gap evaluations in every segment, and their distance in time, (segments,) each."""
    length = np.diff(np.append(solution.times, t_end))
    count = np.ceil(np.maximum(1.0, PER_PERIOD * length / min(solution.shortest_period, t_end)))
    return count.astype(np.int64), length / count


def grazes_of(solution: Motion, t_end: float) -> str:
    """Sentence that names the grazes that are decided."""
    count = float(np.sum(looks(solution, t_end)[0]))
    if count > MOST_LOOKS:
        return f"by float64, to 1e-12 of the motion: {count:.1g} looks are more than {MOST_LOOKS:.0e}"
    return f"by many digits, to {TOUCH:g} of the motion"


def _turns(system: System, solution: Motion, contact: int, t_end: float) -> Iterator[Turn]:
    """Turns of the gaps of a contact close to zero, in float64."""
    stops, sides = system.contacts[contact].stops, solution.sides[:, contact]
    count, apart = looks(solution, t_end)
    before = np.concatenate([[0], np.cumsum(count)])

    def path(t: Array) -> tuple[Array, Array]:
        return path_of(system, solution, t, contact)

    # Looks in blocks, which bounds the size of the arrays.
    for first in range(0, int(before[-1]), AT_ONCE):
        look = np.arange(first, min(first + AT_ONCE, before[-1]))
        piece = np.searchsorted(before, look, "right") - 1
        h, side = apart[piece], sides[piece]
        t = solution.times[piece] + (look - before[piece]) * h
        t = np.append(t, min(t[-1] + h[-1], t_end))
        u, v = path(t)
        size = float(np.max(np.abs(u)))
        moves = np.maximum(np.abs(v[:-1]), np.abs(v[1:])) > MOVES * np.max(np.abs(v))
        for which, stop in stops.sides:
            # A free contact is looked at for entries, one in an undamped stop or beyond one that has let go for exits.
            looked_at = (side == LET_GO * which) | ((side == which) & (stops.damping == 0.0))
            sign = np.where(side == 0, -which, np.where(looked_at, which, 0))
            near = CLOSE * (size + abs(stop))
            gap, rate, gap_after, rate_after = (sign * x for x in (u[:-1] - stop, v[:-1], u[1:] - stop, v[1:]))
            # Tangents from both ends over twice the distance: a generous estimate of the least gap between two looks.
            lowest = np.minimum(gap + 2.0 * h * rate, gap_after - 2.0 * h * rate_after)
            (k,) = np.nonzero((rate < 0.0) & (rate_after >= 0.0) & (lowest <= near) & moves)
            if not len(k):
                continue
            # Bisect for the turn, where the rate changes its sign.
            low, high = t[k], t[k + 1]
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                falls = sign[k] * path(middle)[1] < 0.0
                low, high = np.where(falls, middle, low), np.where(falls, high, middle)
            # Curvature by a difference of rates around the turn.
            left, right = np.maximum(high - 0.01 * h[k], 0.0), np.minimum(high + 0.01 * h[k], t_end)
            curve = sign[k] * (path(right)[1] - path(left)[1]) / (right - left)
            close = (np.abs(path(high)[0] - stop) <= near) & (curve > 0.0)
            for j in np.flatnonzero(close):
                yield Turn(float(high[j]), contact, which, int(sign[k[j]]), float(curve[j]), size + abs(stop))
