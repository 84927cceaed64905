"""The exact piecewise-linear solution in as many digits as error growth requires, with python-flint.

Between two events the system is one linear flow, whatever damps, drives or holds it. Compliant stops: compliant.py
refines events and modes of float64. Rigid stops: rigid.py finds its own events. Two runs with different digits have to
agree.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import flint
import numpy as np
from flint import ctx

from ...basics.arrays import Array
from ...basics.resources import clock
from ...basics.validation import InputError, positive
from ...model.system import System
from ...piecewise.motion import Motion
from ...trajectory.trajectory import Reference, SolverFailure
from ..exact.lyapunov import lyapunov
from ..exact.piecewise import reference_of, refuse
from ..registry import Request
from .compliant import GUARD_BITS, MOST, Known, Sampler, Switch, follow, grazes_of, passed_over

BITS = math.log2(10.0)
MAX_DIGITS = 20_000
CANCELLED = 1e-10  # of max |u|: more than that is lost by float64 sums between the events
AGREEMENT = 1e-12  # of max |u| and of the time: how closely two precisions have to agree


def solve(request: Request) -> Reference:
    """The exact solution with ``digits`` decimal digits, and again with a quarter more.

    "auto" estimates the digits from the growth of tangent vectors along the float64 solution, and goes
    on until both runs agree to t_end. A fixed number gives the horizon to which both
    agree. Positions and velocities at the output times are evaluated in that many digits and rounded
    once. Any other time, the peaks and the energy ledger are evaluated in float64 from the rounded states at the
    switches, or where that is off by more than ``CANCELLED`` in many digits too: provenance["between"] is how far
    what is used is off at the output times, relative to max |u|. Takes what the exact solution takes: any damping,
    any number of contacts, time functions made of Harmonic, Constant and Sampled, rigid stops too (rigid.py); raises
    InputError otherwise, SolverFailure where even ``MAX_DIGITS`` do not suffice.

    Numbers: those of a case file, and in Python those given as texts, Fractions or Decimals, have their exact
    values. All others are doubles; provenance["parameters"] names the
    exact ones. Past the horizon of float64 the two readings have different solutions. t_end and output
    times are doubles: nothing magnifies their rounding. Float64 finds the next event, which is then refined. Events
    that float64 passes over are searched where gaps turn (compliant.py). On compliant stops a contact shallower than
    1e-18 of the motion counts as none, see provenance["grazes"]. Between rigid stops power series in balls decide.
    """
    system, t_end, t_eval, digits = request.system, request.t_end, request.t_eval, request.digits
    positive("t_end", t_end)
    if digits != "auto" and (isinstance(digits, bool) or not isinstance(digits, int) or not 20 <= digits <= MAX_DIGITS):
        raise InputError("digits", digits, f"be 'auto' or an integer from 20 to {MAX_DIGITS}", "auto decides by itself")
    if system.rigid:
        from .rigid import solve_rigid

        return solve_rigid(request)
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
    wrong = np.flatnonzero(~(np.abs(a.tip - b.tip) <= AGREEMENT * scale) & (b.t <= end))
    return min(end, float(b.t[max(0, wrong[0] - 1)])) if len(wrong) else end
