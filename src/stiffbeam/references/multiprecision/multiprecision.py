"""The exact piecewise-linear solution in as many digits as error growth requires, with python-flint.

Between two events the system is one linear flow, z' = G z, in blocks (linear_flow.py). Float64 finds the next event
from the state, Newton's method doubles its digits, and one evaluation of the exponentials uses all of them. Digits that
the motion has lost are dropped. Two runs with different digits have to agree.

Limitation: the event search runs in float64, so that a contact shallower than 1e-12 of the motion may be missed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import flint
import numpy as np
from flint import arb, arb_mat, ctx
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...basics.resources import afford, clock, in_time
from ...basics.validation import InputError
from ...kernels.exact import Marks
from ...model.system import System
from ...model.time_functions import Drive
from ...trajectory.records import last_before
from ...trajectory.trajectory import Reference, SolverFailure
from ..exact.motion import (
    NO_BLOWS,
    NO_EVENTS,
    REMEDY,
    Motion,
    Solver,
    fresh_after,
    pressed,
    switched_by_force,
)
from ..exact.solution import reference_of, refuse
from ..horizon import lyapunov
from ..registry import Request
from .linear_flow import LinearFlow, Split, by_float64
from .rational import carried

BITS = math.log2(10.0)
MAX_DIGITS = 20_000
GUARD_BITS = 100  # below the digits that are lost: two doubles' worth for the outputs
KNOWN_BITS = 28  # precision of a time between two events in float64
AGREEMENT = 1e-12  # of max |u| and of the time: how closely two precisions have to agree

Known = dict[tuple[int, ...], Split]  # by the contacts that are closed


def solve(request: Request) -> Reference:
    """The exact solution with ``digits`` decimal digits, and again with a quarter more.

    "auto" estimates the digits from the growth of tangent vectors along the float64 solution, and goes
    on until both runs agree to t_end. A fixed number gives the horizon to which both
    agree. Positions and velocities at the output times are evaluated in that many digits and rounded
    once, and so at any other time. Peaks, impulses and work are integrated in float64 from the rounded states at the
    switches. Takes what the exact solution takes: any damping,
    any number of contacts, time functions made of Harmonic, Constant and Sampled; raises InputError otherwise and for
    rigid stops, SolverFailure where even ``MAX_DIGITS`` do not suffice.

    Numbers: those of a case file, and in Python those given as texts, Fractions or Decimals, have their exact
    values. All others are doubles; provenance["parameters"] names the
    exact ones. Past the horizon of float64 the two readings have different solutions. t_end and output
    times are doubles: nothing magnifies their rounding. Float64 finds the next event, which is then refined.
    """
    system, t_end, t_eval, digits = request.system, request.t_end, request.t_eval, request.digits
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
        solution = carry(system, t_end, wanted, guard, known)
        run = reference_of(solution, t_end, t_eval, begun, "multiprecision", notes)
        if previous is not None:
            horizon = _agreement(previous, run)
            # A fixed number of digits is confirmed once: the horizon tells how far it is good.
            if horizon >= t_end or digits != "auto":
                notes = {
                    "digits_confirmed_with": previous.provenance["digits"],
                    "horizon": horizon,
                    "horizon_against": f"itself with {previous.provenance['digits']} digits",
                    "horizon_tolerance": f"|du| <= {AGREEMENT:g} max|u| at the output times, the same events",
                }
                return replace(run, horizon=horizon, provenance=run.provenance | notes)
        previous = run
        # The guard grows too: other outputs then reveal cancellation that it did not cover.
        wanted, guard = math.ceil(1.25 * wanted) + 15, math.ceil(1.25 * guard) + 50


def carry(
    system: System, t_end: float, digits: int, guard: int = GUARD_BITS, known: Known | None = None
) -> PreciseMotion:
    """The solution with ``digits`` at the start beside the ``guard`` bits that the outputs need.

    Those also pay for cancellation: between modes, between the motion and its response to the drive, and
    in the eigenproblem. How much of it there is shows when another guard gives other outputs.
    """
    before = ctx.prec
    full = math.ceil(digits * BITS) + guard
    try:
        ctx.prec = full + guard
        return follow(PreciseSolver(system, t_end, full, guard, {} if known is None else known))
    finally:
        ctx.prec = before


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
    """A regime from time t on: the coordinates y there, the bits carried, q and q' (2n,) rounded, sides of contacts."""

    regime: PreciseRegime
    t: Any
    y: Any
    bits: int
    state: Array
    sides: list[int]

    def ahead(self, t: float) -> Any:
        """y at time t."""
        return self.regime.split.ahead(self.y, arb(t) - self.t)

    def whole(self, t: float) -> Any:
        """z (N, 1) at time t."""
        return (self.regime.split.V * self.ahead(t)).mid()

    def channels(self, t: float) -> Any:
        """Positions of all channels at time t, and their velocities, (2 channels, 1)."""
        return self.regime.channels * self.ahead(t)


@dataclass(frozen=True, eq=False)
class PreciseMotion(Motion):
    """A motion with the states of its ``precise`` pieces, one of every mark: of what is read only the values are
    rounded."""

    precise: list[Piece] = field(default_factory=list)
    sampled: list[Array] = field(default_factory=list)  # the last times of ``path``, and all channels there

    def __reduce__(self) -> tuple[Any, ...]:
        # In another process it is a motion in float64, from the same states behind the events.
        return Motion, tuple(getattr(self, x.name) for x in fields(Motion))

    def _read(self, t: Array, piece: NDArray[np.int64] | None = None) -> tuple[Array, Array, Array]:
        # The last times that were read are kept, as those of other motions are.
        if piece is None and self.last and np.array_equal(self.last[0][0], t):
            return self.last[0][1:]
        z = self.values(t, self.piece_at(t) if piece is None else piece, Piece.whole)
        n = self.system.size
        found = *self.made.start(z[:, :n], z[:, n : 2 * n]), np.zeros((len(t), len(self.system.contacts)))
        if piece is None:
            self.last[:] = [(np.array(t), *found)]
        return found

    def path(self, t: Array, channel: int) -> tuple[Array, Array]:
        """Position and velocity of a channel at any times, (k,) each: no sum of float64 has cancelled in them."""
        if not self.sampled or not np.array_equal(self.sampled[0], t):
            self.sampled[:] = np.array(t), self.values(t, self.piece_at(t), Piece.channels)
        seen = self.sampled[1]
        return seen[:, channel], seen[:, len(self.system.channels) + channel]

    def values(
        self,
        t: Array,
        piece: NDArray[np.int64],
        read: Callable[[Piece, float], Any],
        value: Callable[[Any], Any] = float,
    ) -> Array:
        """Entries (k, ...) that ``read`` finds at times t (k,) in the given segments, each as ``value`` keeps it."""
        found = []
        for k, when in zip(self.mark_at(t, piece).tolist(), t.tolist(), strict=True):
            with carried(self.precise[k].bits):
                found.append([value(x) for x in read(self.precise[k], when).entries()])
        return np.array(found)


class PreciseSolver:
    """Regimes in many digits, and events that float64 finds, on [0, t_end].

    ``full`` bits are carried at the start and ``guard`` at the end; ctx.prec has room to spare. known: see
    ``PreciseRegime``.
    """

    def __init__(self, system: System, t_end: float, full: int, guard: int, known: Known) -> None:
        self.system, self.t_end, self.full, self.guard, self.known = system, t_end, full, guard, known
        self.room, self.drive, self.solver, self.flow = ctx.prec, Drive.of(system), Solver(system), LinearFlow(system)
        self.regimes: dict[tuple[int, ...], PreciseRegime] = {}

    def begin(self, t: Any, z: Any, resting: bool, sides: list[int]) -> Piece:
        """The piece that begins with z at t. resting: a gap may be zero, and opens or closes."""
        state, begun = np.array([float(x) for x in z.entries()[: 2 * self.flow.n]]), float(t)
        if resting:
            sides = self.solver.sides_at(begun, np.split(state, 2)).tolist()
        # The regime of these contacts, refined where it is first met.
        key = tuple(pressed(sides).tolist())
        if key not in self.regimes:
            with carried(self.room):
                self.regimes[key] = PreciseRegime(self.flow, key, self.known)
        regime, share = self.regimes[key], min(1.0, begun / self.t_end)
        # Errors grow with time: precision falls evenly from ``full`` at the start to ``guard`` at the end.
        ctx.prec = max(self.guard, math.ceil(self.full - (self.full - self.guard) * share)) + 30
        return Piece(regime, t, (regime.split.L * z).mid(), ctx.prec, state, sides)

    def place(self, piece: Piece, start: float, contact: int, side: int) -> tuple[Any, Any, Any]:
        """The time of an event at which a contact changes to a side, near the time ``start``, to all digits; and the
        last step of it with the coordinates there."""
        rates: Any = np.concatenate([x.rates for x in self.regimes.values()])
        begun = float(piece.t)
        fastest = max(1.0 / self.t_end, float(np.max(np.abs(rates))))
        turning = max(1.0 / self.t_end, *self.drive.frequencies, float(np.max(np.abs(rates.imag))))
        before = piece.sides[contact]
        gap = piece.regime.gap(contact, int(np.sign(side or before)), switched_by_force(before, side))
        tau, shift, y = _locate(partial(_at, piece, gap), start - begun, fastest, 2.0 * np.pi / turning, begun)
        return (piece.t + tau + shift).mid(), shift, y

    def motion(self, pieces: list[Piece]) -> PreciseMotion:
        """The motion of these pieces, whose marks float64 stores."""
        times, states = np.array([float(x.t) for x in pieces]), np.array([x.state for x in pieces])
        sides = np.array([x.sides for x in pieces], np.int64).reshape(len(pieces), len(self.system.contacts))
        first = np.flatnonzero([True, *np.any(sides[1:] != sides[:-1], axis=1)])  # the marks of events
        marks = Marks(times, *self.solver.made.start(*np.split(states, 2, axis=1)), sides)
        return PreciseMotion(
            self.system, self.solver.made, times[first], sides[first], first, marks, len(pieces),
            NO_EVENTS, NO_BLOWS, precise=pieces,
        )  # fmt: skip


def follow(solver: PreciseSolver) -> PreciseMotion:
    """The solution from event to event."""
    system, t_end, pieces = solver.system, solver.t_end, list[Piece]()
    none = fresh = np.zeros(len(system.contacts), np.int64)
    t, z, sides, resting = arb(0), solver.flow.start(), list[int](), True
    while True:
        piece = solver.begin(t, z, resting, sides)
        pieces.append(piece)
        begun, sides, split = float(t), piece.sides, piece.regime.split
        afford("t_end", t_end, "shorten t_end", floats=len(pieces) * (solver.full / 32.0 + 20.0) * system.size)
        # Next event before the next sample, by float64.
        edge = solver.drive.next_edge(begun, t_end)
        known_sides = None if resting else np.array(sides, np.int64)
        found = solver.solver.first_event(begun, known_sides, fresh, np.split(piece.state, 2), edge)
        decided, resting = resting, False
        if found is not None and found[0] < edge:
            start, contact, side = found
            in_time(begun)
            # Refine the event to all digits, and go on from there in the new regime.
            when, shift, y = solver.place(piece, start, contact, side)
            if decided and when == t and start > begun:  # back to where the sides are known: float64's rounding
                t, z, fresh = arb(start), piece.whole(start), none
                continue
            # With records the flow holds up to the sample only: an event refined past it belongs to the next segment.
            if not solver.drive.records or t <= when < edge:
                after = [side if i == contact else x for i, x in enumerate(sides)]
                resting = when == t  # the state stays as it is: its rounding would bring the event back
                if not resting:
                    z = (split.V * split.ahead(y, shift)).mid()
                t, fresh, sides = when, fresh_after(system, sides, after), after
                continue
            if when < t:
                raise SolverFailure("multiprecision", begun, "an event at a sample that float64 cannot place", REMEDY)
        # No event before the sample: the same regime goes on with the next polynomials of the records.
        if edge >= t_end:
            return solver.motion(pieces)
        t, z, fresh = arb(edge), solver.flow.at_edge(piece.whole(edge), arb(edge)), none


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
