"""The exact piecewise-linear solution in as many digits as error growth requires, with python-flint.

Between two events the system is one linear flow, z' = G z, in blocks (linear_flow.py). Float64 finds the next event
from the state, Newton's method doubles its digits, and one evaluation of the exponentials uses all of them. Digits that
the motion has lost are dropped. Two runs with different digits have to agree.

Limitation: the event search runs in float64, so that a contact shallower than 1e-12 of the motion may be missed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx

from ...basics.arrays import Array
from ...basics.resources import afford, clock, in_time
from ...basics.validation import InputError
from ...kernels.exact import Marks
from ...model.system import System
from ...trajectory.records import last_before
from ...trajectory.trajectory import Reference, SolverFailure
from ..exact.motion import NO_TIMES, Motion, Solver, fresh_after, pressed, require_short, switched_by_force
from ..exact.solution import reference_of, refuse
from ..horizon import lyapunov
from ..registry import Request, output_times
from .linear_flow import LinearFlow, Split

BITS = math.log2(10.0)
MAX_DIGITS = 20_000
GUARD_BITS = 100  # below the digits that are lost: two doubles' worth for the outputs
KNOWN_BITS = 28  # precision of a time between two events in float64
AGREEMENT = 1e-12  # of max |u| and of the time: how closely two precisions have to agree


def solve(request: Request) -> Reference:
    """The exact solution with ``digits`` decimal digits, and again with a quarter more.

    "auto" estimates the digits from the growth of tangent vectors along the float64 solution, and goes
    on until both runs agree to t_end. A fixed number gives the horizon to which both
    agree. The states at the output times are evaluated in that many digits and rounded once. From these states and
    those at the events float64 finds all others, and integrates peaks, impulses and work. Takes what the exact solution
    takes but records: any damping, any number of contacts, time functions made of Harmonic and Constant; raises
    InputError otherwise and for rigid stops, SolverFailure where even ``MAX_DIGITS`` do not suffice.

    Numbers: those of a case file, and in Python those given as texts, Fractions or Decimals, have their exact
    values. All others are doubles; provenance["parameters"] names the
    exact ones. Past the horizon of float64 the two readings have different solutions. t_end and output
    times are doubles: nothing magnifies their rounding. Float64 finds the next event, which is then refined.
    """
    system, t_end, t_eval, digits = request.system, request.t_end, request.t_eval, request.digits
    if digits != "auto" and (isinstance(digits, bool) or not isinstance(digits, int) or not 20 <= digits <= MAX_DIGITS):
        raise InputError("digits", digits, f"be 'auto' or an integer from 20 to {MAX_DIGITS}", "auto decides by itself")
    for contact in system.contacts:
        contact.stops.require_compliant("multiprecision", "use the method exact, or a large one")
    for function in system.drive.others:
        rule = "be made of Harmonic and Constant for multiprecision"
        raise InputError("time function", function, rule, "use the method exact, and sample Python functions for it")
    refuse(system, t_end)
    begun = clock()
    # Solve with more and more digits until two runs agree.
    wanted, guard = (_estimate(system, t_end) if digits == "auto" else int(digits)), GUARD_BITS
    previous: Reference | None = None
    while wanted <= MAX_DIGITS:
        exact = "; ".join(system.exact_parameters) or "none"
        notes: dict[str, Any] = {"digits": wanted, "parameters": f"doubles; exact: {exact}"}
        solution = carry(system, t_end, wanted, guard, output_times(t_eval, t_end))
        run = reference_of(solution, t_end, t_eval, begun, "multiprecision", notes)
        if previous is not None:
            horizon, before = _agreement(previous, run), previous.provenance["digits"]
            # A fixed number of digits is confirmed once: the horizon tells how far it is good.
            if horizon >= t_end or digits != "auto":
                notes = {
                    "digits_confirmed_with": before,
                    "horizon": horizon,
                    "horizon_against": f"itself with {before} digits",
                    "horizon_tolerance": f"|du| <= {AGREEMENT:g} max|u| at the output times, the same events",
                }
                return replace(run, horizon=horizon, provenance=run.provenance | notes)
        previous = run
        # The guard grows too: other outputs then reveal cancellation that it did not cover.
        wanted, guard = math.ceil(1.25 * wanted) + 15, math.ceil(1.25 * guard) + 50
    raise SolverFailure("multiprecision", t_end, f"{wanted} digits are not enough", "shorten t_end")


def carry(system: System, t_end: float, digits: int, guard: int = GUARD_BITS, outputs: Array = NO_TIMES) -> Motion:
    """The solution with ``digits`` at the start beside the ``guard`` bits that the ``outputs`` (k,) need.

    Those also pay for cancellation: between modes, between the motion and its response to the drive, and
    in the eigenproblem. How much of it there is shows when another guard gives other outputs.
    """
    full = math.ceil(digits * BITS) + guard
    with ctx.workprec(full + guard):
        solver = PreciseSolver(system, t_end, full, guard)
        return solver.motion(solver.follow(), outputs)


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


class Piece(NamedTuple):
    """A flow from time t on: the coordinates y there, the bits carried, q and q' (2n,) rounded, sides of contacts."""

    split: Split
    t: Any
    y: Any
    bits: int
    state: Array
    sides: list[int]

    def whole(self, t: Any) -> Any:
        """z (N, 1) at time t, a float or arb."""
        with ctx.workprec(self.bits):
            return (self.split.V * self.split.ahead(self.y, arb(t) - self.t)).mid()


class PreciseSolver:
    """Flows of regimes in many digits, and events that float64 finds, on [0, t_end].

    ``full`` bits are carried at the start and ``guard`` at the end; ctx.prec has room to spare.
    """

    def __init__(self, system: System, t_end: float, full: int, guard: int) -> None:
        self.system, self.t_end, self.full, self.guard = system, t_end, full, guard
        self.room, self.solver, self.flow = ctx.prec, Solver(system), LinearFlow(system)
        self.regimes: dict[tuple[int, ...], Split] = {}
        require_short(self.solver.free, t_end)

    def follow(self) -> list[Piece]:
        """The pieces of the solution from event to event."""
        system, t_end, pieces = self.system, self.t_end, list[Piece]()
        none = fresh = np.zeros(len(system.contacts), np.int64)
        t, z, sides, resting = arb(0), self.flow.start, list[int](), True
        while True:
            begun, state = float(t), self._rounded(z)
            in_time(begun)
            afford("t_end", t_end, "shorten t_end", floats=len(pieces) * (self.full / 32.0 + 20.0) * system.size)
            # The sides, where a gap may be zero, and the next event by float64.
            begin = partial(self.solver.follower, np.split(state, 2), begun)
            if resting:
                soon = begin()
                soon.follow(np.nextafter(begun, np.inf), NO_TIMES)
                sides = soon.arrays["side"].tolist()
            piece = self._piece(t, z, state, sides)
            pieces.append(piece)
            follower = begin() if resting else begin(np.array(sides, np.int64), fresh)
            found = follower.first_event(t_end) if system.contacts else None
            if found is None or found[0] >= t_end:
                return pieces
            start, contact, side = found
            # Refine the event to all digits, and go on from there in the new regime.
            when = self._event_time(piece, start, contact, side)
            if not resting and when == t and start > begun:  # back to where the sides are known: float64's rounding
                t, z, fresh, resting = arb(start), piece.whole(start), none, False
                continue
            after = [side if i == contact else x for i, x in enumerate(sides)]
            resting = when == t  # the state stays as it is: its rounding would bring the event back
            if not resting:
                z = piece.whole(when)
            t, fresh, sides = when, fresh_after(system, sides, after), after

    def _piece(self, t: Any, z: Any, state: Array, sides: list[int]) -> Piece:
        """The piece that begins with z, rounded ``state``, at t."""
        # The regime of these contacts, refined where it is first met.
        key = tuple(pressed(sides).tolist())
        if key not in self.regimes:
            with ctx.workprec(self.room):
                self.regimes[key] = Split(self.flow, key)
        split, share = self.regimes[key], min(1.0, float(t) / self.t_end)
        # Errors grow with time: precision falls evenly from ``full`` at the start to ``guard`` at the end.
        ctx.prec = max(self.guard, math.ceil(self.full - (self.full - self.guard) * share)) + 30
        return Piece(split, t, (split.L * z).mid(), ctx.prec, state, sides)

    def _rounded(self, z: Any) -> Array:
        """q and q' (2n,) of z, each rounded once."""
        return np.array([float(x) for x in z.entries()[: 2 * self.flow.n]])

    def _event_time(self, piece: Piece, start: float, contact: int, side: int) -> Any:
        """The time of an event at which a contact changes to a side, near the time ``start``, to all digits."""
        rates: Any = np.array([x for split in self.regimes.values() for block in split.blocks for x in block.values])
        fastest = max(1.0 / self.t_end, float(np.max(np.abs(rates))))
        turning = max(1.0 / self.t_end, *self.flow.drive.frequencies, float(np.max(np.abs(rates.imag))))
        before, begun, split = piece.sides[contact], float(piece.t), piece.split
        form = self.flow.gap(contact, int(np.sign(side or before)), switched_by_force(before, side))
        with ctx.workprec(self.room):
            gap = (arb_mat([x.entries() for x in (form, form * split.G)]) * split.V).mid()

        def gap_at(tau: Any) -> list[Any]:
            return (gap * split.ahead(piece.y, tau)).mid().entries()

        return (piece.t + _locate(gap_at, start - begun, fastest, 2.0 * np.pi / turning, begun)).mid()

    def motion(self, pieces: list[Piece], outputs: Array) -> Motion:
        """The motion of these pieces as float64 reads it, from states behind every event and at every output."""
        m, begun = len(self.system.contacts), np.array([float(x.t) for x in pieces])
        of = np.maximum(np.searchsorted(begun, outputs, "right") - 1, 0)
        seen = [self._rounded(pieces[k].whole(t)) for k, t in zip(of.tolist(), outputs.tolist(), strict=True)]
        # Marks in order of time; those of one time in order of the pieces.
        times, piece = np.concatenate([begun, outputs]), np.concatenate([np.arange(len(pieces)), of])
        order = np.argsort(times, kind="stable")
        whole = np.array([*(x.state for x in pieces), *seen])
        eta, rate = (x @ self.solver.free.into for x in np.split(whole, 2, axis=1))
        sides = np.array([x.sides for x in pieces], np.int64).reshape(len(pieces), m)[piece[order]]
        first = np.flatnonzero([True, *np.any(sides[1:] != sides[:-1], axis=1)])  # the marks of events
        marks = Marks(times[order], eta[order], rate[order], sides)
        at_outputs = outputs, eta[len(pieces) :], rate[len(pieces) :], np.zeros((len(outputs), m))
        return Motion(self.system, self.solver.free, marks, first, len(pieces), seen=at_outputs)


def _locate(gap_at: Callable[[Any], list[Any]], start: float, fastest: float, shortest: float, t: float) -> Any:
    """The time tau at which the gap closes.

    gap_at(tau) -> [gap, gap']. Newton's method from the float64 time ``start``, the precision doubled at each turn,
    so that only one evaluation is made at full precision. Where the gap is zero as the piece begins, at rest on its
    stop and pressed, that is the event. Raises SolverFailure where Newton's method leads further than a fiftieth of
    the ``shortest`` period away: two crossings so close to each other that float64 cannot tell them apart.
    """
    near = 0.02 * shortest
    # At rest on its stop and pressed: at the start gap and rate are zero to half the digits.
    if start < near:
        (gap, speed), soon = gap_at(arb(0)), arb(0.5 * near)
        if max(abs(gap), abs(speed) * soon) < arb(2) ** (-ctx.prec // 2) * abs(gap_at(soon)[0]):
            return arb(0)
    # Newton's method with few digits first: a step doubles the correct ones, so more would be computed in vain.
    full, tau, accurate = ctx.prec, arb(start), KNOWN_BITS
    while accurate < full // 2:
        accurate = 2 * accurate - 8  # the ratio of gap'' to gap' costs a few bits at each turn
        with ctx.workprec(min(full, accurate + 70)):
            gap, speed = gap_at(tau)
            tau = (tau - gap / speed).mid()
    for _ in range(64):
        gap, speed = gap_at(tau)
        shift = (-gap / speed).mid()
        tau = (tau + shift).mid()
        if not abs(float(tau) - start) < near:
            break
        # What the last step leaves is its square. A damped stop's force jumps, so all digits of the time count.
        if abs(shift) * fastest < arb(2) ** (-full // 2):
            return tau
    remedy = f"end before t = {t + start:.6g}" if t + start > near else "start a little off the stop"
    raise SolverFailure("multiprecision", t + start, "the event is a graze that float64 cannot place", remedy)
