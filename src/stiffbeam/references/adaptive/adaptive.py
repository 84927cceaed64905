"""Common parts of the adaptive solvers: tolerances, smooth intervals and scales before, the Reference after."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from threading import RLock
from typing import Any

import numpy as np

from ...basics.arrays import Array
from ...basics.resources import OutOfTime, clock
from ...basics.validation import InputError, positive
from ...model.right_hand_side import RightHandSide
from ...trajectory.records import ContactRecord, Impacts, Ledger, in_contact
from ...trajectory.trajectory import Reference, Work
from ..registry import Request, output_times, provenance_of
from .restarts import Path, Scales, Solver, Span, scales_of, smooth_intervals

LEAST_RTOL = 100.0 * float(np.finfo(float).eps)  # below it steps shrink without end instead of failing
LEAST_SHARE = 1e-6  # of the default atol: below it an unknown that passes through zero stops the solver
UNCONTROLLED = 1e200  # the absolute tolerance of the impulses, which follow the motion
SOLVING = RLock()  # of references that are asked for further times, by several threads at once


def reference_from(
    request: Request, solver: Callable[[RightHandSide, float, Array], Solver], descriptor: bool = False
) -> Reference:
    """The Reference of a solver of phases, to the deadline at most. solver: takes the right-hand side, a ``descriptor``
    or not, the relative tolerance, and the absolute ones of all unknowns.

    atol defaults to rtol/100 of every unknown's scale (``scales_of``). Input, dissipation and impulses are integrated
    with the motion; the impulses take no part in error control, the others to rtol of the energy of the motion.
    """
    system, t_end, method, rtol, atol = request.system, request.t_end, request.method, request.rtol, request.atol
    rtol = positive("rtol", rtol)
    if rtol < LEAST_RTOL:
        raise InputError("rtol", rtol, f"be at least {LEAST_RTOL:.2g} in float64", "use multiprecision")
    # Smooth intervals of the loads, the equations, and the sizes from which the tolerances follow.
    t = output_times(request.t_eval, t_end)
    begun = clock()
    intervals = smooth_intervals(request)  # which asks the functions of time what they are
    rhs = RightHandSide(system, descriptor)
    scales = scales_of(system, t_end)
    share, tolerances = _tolerances(rhs, scales, rtol, atol)

    def solve(t: Array) -> Path:
        path = Path(method, rhs, scales, solver(rhs, share * rtol, tolerances))
        path.follow(intervals, t)
        return path

    # Outputs at t, from which positions and velocities of all channels follow.
    result = solve(t)
    t, states, end = t[: len(result.states)], result.states, result.end
    if request.t_eval is None and t[-1] < end:  # a deadline between two outputs
        t, states = np.append(t, end), [*states, result.z]
    if len(states) < 2:
        raise OutOfTime(0.0)
    z = np.array(states)
    y = z[:, : rhs.states]
    intervals = [part._replace(end=min(part.end, end)) for part in intervals if part.start < end]
    positions, velocities = system.motions(t, y[:, ::2], y[:, 1::2])
    tip = system.tip_channel
    evaluate, state_at = _answers(solve, rhs, end, t, y)
    # Record of how the solution was computed.
    bounds = [interval.max_step for interval in intervals if np.isfinite(interval.max_step)]
    notes: dict[str, Any] = {
        "rtol": rtol,
        "atol": "rtol/100 of every unknown's scale" if atol is None else atol,
        "intervals": len(intervals),
        **({"shortest_step_bound": min(bounds)} if bounds else {}),
        **({"functions_seen_every": max(bounds)} if system.drive.called else {}),
    }
    return Reference(
        t=t,
        tip=positions[:, tip],
        tip_velocity=velocities[:, tip],
        contacts=tuple(
            _contact_record(rhs, i, (positions[:, i], velocities[:, i]), result.spans, end)
            for i in range(len(system.contacts))
        ),
        work=Work(steps=0, seconds=clock() - begun, march_seconds=result.seconds, counters=dict(result.counters)),
        provenance=provenance_of(system, method, end, notes),
        system=system,
        evaluate=evaluate,
        state_at=state_at,
        ledger=partial(_ledger, rhs, t, z, positions),
    )


def _tolerances(rhs: RightHandSide, scales: Scales, rtol: float, atol: float | None) -> tuple[float, Array]:
    """Factor of rtol, and the absolute tolerances of z. Raises InputError for an atol that no solver can hold."""
    # An unknown that passes through zero has no relative error there: the absolute tolerance bounds it.
    tolerances = rtol / 100.0 * scales.unknowns
    if atol is not None:
        least = LEAST_SHARE * float(np.min(tolerances))
        if positive("atol", atol) < least:
            remedy = "leave it out for rtol/100 of every unknown's scale"
            raise InputError("atol", atol, f"be at least {least:.2g}, a millionth of its default", remedy)
        tolerances = np.full(rhs.states, float(atol))
    # The impulses are no part of the error, but all are counted in its root mean square. A motion that is a polynomial
    # asks for no short steps, its power under a load does.
    share = float(np.sqrt(rhs.states / rhs.size))
    integrals = np.full(rhs.size - rhs.states, UNCONTROLLED)
    integrals[[0, 1, *([-1] if rhs.damped else [])]] = rtol * scales.energy
    return share, np.concatenate([share * tolerances, integrals])


def _answers(solve: Callable[[Array], Path], rhs: RightHandSide, end: float, t: Array, y: Array) -> tuple[Any, Any]:
    """Functions of times (k,) in any order: position and velocity of a channel, and (q, q').

    They know the outputs y at t, and solve once more with outputs at other times. The last answer is kept: a comparison
    asks the same times of the tip and of every contact.
    """
    kept = [(t, y)]

    def at(times: Array) -> Array:
        due, (known, y) = np.unique(times), kept[0]
        # Times and states are kept together, so that an interrupted solve leaves no others; two would share the rhs.
        if not np.all(np.isin(due, known)):
            known = due if len(due) > 1 else np.unique([0.0, *due, end])
            with SOLVING:
                y = np.array(solve(known).states)[:, : rhs.states]
            kept[0] = known, y
        return y[np.searchsorted(known, times)]

    def evaluate(times: Array, channel: int) -> tuple[Array, Array]:
        u, v = rhs.system.motions(times, *state_at(times))
        return u[:, channel], v[:, channel]

    def state_at(times: Array) -> tuple[Array, Array]:
        y = at(times)
        return y[:, ::2].copy(), y[:, 1::2].copy()

    return evaluate, state_at


def _ledger(rhs: RightHandSide, t: Array, z: Array, positions: Array) -> Ledger:
    """The energy balance with input and dissipation as the solver integrated them. The loss is then that of the
    solver."""
    system, y = rhs.system, z[:, : rhs.states]
    (given, taken), of_stops = z[:, rhs.states : rhs.states + 2].T, np.zeros(len(z))
    if rhs.damped:
        # The integral is dissipated plus stored energy. What a stop stored at t = 0 it never absorbed.
        start = system.positions(np.zeros(1), system.q0[None])
        of_stops = z[:, -1].copy()
        for i, contact in enumerate(system.contacts):
            if contact.stops.law.damps:
                of_stops -= contact.stops.energy(positions[:, i]) - contact.stops.energy(start[:, i])
    q, v = y[:, ::2].copy(), y[:, 1::2].copy()
    energies = system.energies(t, q, v)
    start = float(sum(system.energies(0.0, system.q0, system.v0)))
    loss = start - sum(energies) + given - taken - of_stops
    touching = in_contact(system, t, q, v)
    # A loss between two outputs cannot be divided: contact at either of them counts as contact.
    closed = np.concatenate([[False], touching[1:] | touching[:-1]])
    contact = np.cumsum(np.where(closed, np.diff(loss, prepend=0.0), 0.0))
    return Ledger(t, *energies, given, taken, loss, contact, loss - contact, of_stops, np.zeros(len(t)))


def _contact_record(
    rhs: RightHandSide, i: int, seen: tuple[Array, Array], spans: list[list[Span]], end: float
) -> ContactRecord:
    """Record of contact ``i`` by its events.

    Impulses are integrals that the solver carries, peaks the largest of the forces where the rate of the gap, of a
    damped stop that of the force, is zero or jumps: both as accurate as the motion. A peak is NaN where the solver saw
    no such place between entry and exit.
    """
    stops = rhs.system.contacts[i].stops
    rows: list[tuple[float, ...]] = []  # time, end, side, peak, impulse, force at an end, open
    for (contact, side), of_side in zip(rhs.sides, spans, strict=True):
        for span in of_side if contact == i else ():
            (entry, z, first), (left, z_left, last) = span.ends
            # The force of a stop with c > 0 may be largest where it begins.
            peak = float(np.nanmax([span.peak, first, last])) if stops.law.jumps else span.peak
            # The integral of -F, after the states, the input and the viscous loss.
            impulse = side * float(z_left[rhs.states + 2 + i] - z[rhs.states + 2 + i])
            rows.append((entry, left, side, peak, impulse, max(first, last), span.open))
    rows.sort(key=lambda row: row[0])
    times, ends, sides, peaks, impulses, at_ends, is_open = np.array(rows).reshape(-1, 7).T
    # Peak and impulse of a contact that is closed at the end are still open.
    known = {"ends": ends, "peaks": peaks, "impulses": impulses}
    impacts = Impacts.at(times, sides, "event", **{x: np.where(is_open, np.nan, y) for x, y in known.items()})
    # A contact that lasts from the start or to the end may be pressed hardest there, without a peak between.
    largest, fraction = float(np.nanmax([0.0, *peaks, *at_ends])), float(np.sum(ends - times)) / end
    return ContactRecord(stops, *seen, stops.force(*seen), impacts, fraction, largest, float(np.sum(impulses)))
