"""Common parts of the adaptive solvers: tolerances, smooth intervals and scales before, the Reference after."""

from __future__ import annotations

from collections.abc import Callable
from threading import RLock
from typing import Any

import numpy as np

from ...basics.arrays import Array
from ...basics.resources import clock
from ...basics.validation import InputError, positive
from ...model.right_hand_side import RightHandSide
from ...model.system import System
from ...model.time_functions import in_closed_form
from ...trajectory.records import COLUMNS, ContactRecord, Impacts, Ledger, in_contact
from ...trajectory.trajectory import Reference, Work
from ..registry import REFERENCES, Request, output_times, provenance_of
from .intervals import smooth_intervals
from .restarts import Contacts, Outcome, Path, Phase, Scales, follow, scales_of

LEAST_RTOL = 100.0 * float(np.finfo(float).eps)  # below it steps shrink without end instead of failing
LEAST_SHARE = 1e-6  # of the default atol: below it an unknown that passes through zero stops the solver
UNCONTROLLED = 1e200  # the absolute tolerance of the impulses, which follow the motion
SOLVING = RLock()  # of references that are asked for further times, by several threads at once


Solver = Callable[[Phase], Outcome]


def reference_from(
    request: Request, solver: Callable[[RightHandSide, float, Array], Solver], descriptor: bool = False
) -> Reference:
    """The Reference of a solver that makes one phase. solver: takes the right-hand side, a ``descriptor`` or not, the
    relative tolerance, and the absolute ones of all unknowns.

    atol defaults to rtol/100 of every unknown's scale (``scales_of``). Input, dissipation and impulses are integrated
    with the motion; the impulses take no part in error control, the others to rtol of the energy of the motion.
    """
    system, t_end, method, t_eval, rtol, atol, _, steps = request
    rtol = positive("rtol", rtol)
    if rtol < LEAST_RTOL:
        raise InputError("rtol", rtol, f"be at least {LEAST_RTOL:.2g} in float64", "use multiprecision")
    # Smooth intervals of the loads, the equations, and the sizes from which the tolerances follow.
    t = output_times(t_eval, t_end)
    begun = clock()
    intervals = smooth_intervals(system, t_end, steps)  # which asks the functions of time what they are
    rhs = RightHandSide(system, descriptor)
    scales = scales_of(system, t_end)
    share, tolerances = _tolerances(rhs, scales, rtol, atol)

    def solve(t: Array) -> Path:
        run = solver(rhs, share * rtol, tolerances)
        begun = clock()
        return follow(method, rhs, intervals, t, scales, run)._replace(seconds=clock() - begun)

    # Outputs at t, from which positions and velocities of all channels follow.
    result = solve(t)
    y = result.states[:, : rhs.states]
    answers = Answers(solve, rhs, t_end, t, y)
    positions, velocities = rhs.channels(t, y)
    tip = system.tip_channel
    states = (y[:, ::2].copy(), y[:, 1::2].copy())

    def ledger() -> Ledger:
        given, taken = result.states[:, rhs.states : rhs.states + 2].T
        of_stops = _taken_by_stops(rhs, result.states, positions)
        return _ledger(system, t, states[0], states[1], given, taken, of_stops)

    # Record of how the solution was computed.
    bounds = [interval.max_step for interval in intervals if np.isfinite(interval.max_step)]
    notes: dict[str, Any] = {
        "rtol": rtol,
        "atol": "rtol/100 of every unknown's scale" if atol is None else atol,
        "intervals": len(intervals),
        **({"shortest_step_bound": min(bounds)} if bounds else {}),
        **({} if all(map(in_closed_form, system.time_functions)) else {"functions_seen_every": max(bounds)}),
    }
    return Reference(
        t=t,
        tip=positions[:, tip],
        tip_velocity=velocities[:, tip],
        contacts=tuple(
            contact_record(rhs, i, t, positions[:, i], velocities[:, i], result.contacts, result.end, t_end)
            for i in range(len(system.contacts))
        ),
        work=Work(steps=0, seconds=clock() - begun, march_seconds=result.seconds, counters=result.counters),
        provenance=provenance_of(system, method, t_end, notes) | REFERENCES[method].versions(),
        system=system,
        evaluate=answers.channel,
        state_at=answers.states,
        ledger=ledger,
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


class Answers:
    """States of the solution at any times: its outputs, or those of a second solve with outputs at these times.

    The last answer is kept: a comparison asks the same times of the tip and of every contact.
    """

    def __init__(self, solve: Callable[[Array], Path], rhs: RightHandSide, t_end: float, t: Array, y: Array) -> None:
        self.solve, self.rhs, self.t_end = solve, rhs, t_end
        self.kept = t, y

    def at(self, times: Array) -> Array:
        """The states (k, size) at ``times`` (k,), in any order, in [0, t_end]."""
        due, (t, y) = np.unique(times), self.kept
        # Only states at output times are stored: other times need a second solve, with outputs at them. Times and
        # states are kept together, so that an interrupted solve leaves no others; two solves would share the rhs.
        if not np.all(np.isin(due, t)):
            t = due if len(due) > 1 else np.unique([0.0, *due, self.t_end])
            with SOLVING:
                y = self.solve(t).states[:, : self.rhs.states]
            self.kept = t, y
        return y[np.searchsorted(t, times)]

    def channel(self, times: Array, channel: int) -> tuple[Array, Array]:
        """Position and velocity of a channel at ``times``."""
        u, v = self.rhs.channels(times, self.at(times))
        return u[:, channel], v[:, channel]

    def states(self, times: Array) -> tuple[Array, Array]:
        """(q, q') at ``times``."""
        y = self.at(times)
        return y[:, ::2].copy(), y[:, 1::2].copy()


def _taken_by_stops(rhs: RightHandSide, z: Array, positions: Array) -> Array:
    """Energy dissipated by the stops with damping at the outputs: absorbed less stored."""
    if not rhs.damped:
        return np.zeros(len(z))
    start, _ = rhs.channels(np.zeros(1), rhs.z0[None, : rhs.states])
    # The integral is dissipated plus stored energy. What a stop stored at t = 0 it never absorbed.
    taken = z[:, -1].copy()
    for i, contact in enumerate(rhs.system.contacts):
        if contact.stops.dissipative:
            taken -= contact.stops.energy(positions[:, i]) - contact.stops.energy(start[:, i])
    return taken


def _ledger(system: System, t: Array, q: Array, v: Array, given: Array, taken: Array, of_stops: Array) -> Ledger:
    """The energy balance with input and dissipation as the solver integrated them. The loss is then that of the
    solver."""
    energies = system.energies(t, q, v)
    start = float(system.energy(np.zeros(1), system.q0[None], system.v0[None])[0])
    loss = start - sum(energies) + given - taken - of_stops
    touching = in_contact(system, t, q, v)
    # A loss between two outputs cannot be divided: contact at either of them counts as contact.
    closed = np.concatenate([[False], touching[1:] | touching[:-1]])
    contact = np.cumsum(np.where(closed, np.diff(loss, prepend=0.0), 0.0))
    return Ledger(t, *energies, given, taken, loss, contact, loss - contact, of_stops, np.zeros(len(t)))


def contact_record(
    rhs: RightHandSide, i: int, t: Array, position: Array, velocity: Array, contacts: Contacts, end: Array, t_end: float
) -> ContactRecord:
    """Record of contact ``i`` by its events.

    Impulses are integrals that the solver carries, peaks the largest of the forces where the rate of the gap, of a
    damped stop that of the force, is zero or jumps: both as accurate as the motion. A peak is NaN where the solver saw
    no such place between entry and exit.
    """
    stops = rhs.system.contacts[i].stops
    force = stops.force(position, velocity)
    # One row for every entry, up to the exit after it or to the end of the solution.
    impacts: list[tuple[float, float, int, float, float]] = []  # time, end, side, peak, impulse
    closed_time, largest, total = 0.0, 0.0, 0.0
    for k, (contact, side) in enumerate(rhs.sides):
        if contact != i:
            continue
        exits = contacts.exits[k]
        for n, (entry, z, at_entry) in enumerate(contacts.entries[k]):
            left, z_left, at_exit = exits[n] if n < len(exits) else (t_end, end, rhs.pressing(t_end, end, k))
            peak = max((value for when, value in contacts.peaks[k] if entry <= when <= left), default=float("nan"))
            if stops.jumps:  # the force of a stop with c > 0 may be largest where it begins
                peak = float(np.nanmax([peak, at_entry, at_exit]))
            ended = n < len(exits)
            closed_time += left - entry
            # A contact that lasts from the start or to the end may be pressed hardest there, without a peak between.
            largest = np.nanmax([largest, peak, at_entry, at_exit])
            # The integral of -F, after the states, the input and the viscous loss.
            impulse = side * float(z_left[rhs.states + 2 + i] - z[rhs.states + 2 + i])
            total += impulse
            nan = np.nan
            # Peak and impulse of a contact that is closed at the end are still open.
            impacts.append((entry, left, side, peak, impulse) if ended else (entry, nan, side, nan, nan))
    impacts.sort(key=lambda impact: impact[0])
    times, ends, of_sides, peaks, impulses = np.array(impacts).reshape(-1, len(COLUMNS)).T
    found = Impacts.at(times, of_sides, "event", ends=ends, peaks=peaks, impulses=impulses)
    return ContactRecord(stops, position, velocity, force, found, closed_time / t_end, float(largest), total)
