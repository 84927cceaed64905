"""The exact solution: between events the system is linear and has a closed form, so only event times are searched.

With linear compliance every contact is free or on one of its stops, which a damped one leaves before the gap opens,
and each combination is a linear system with a solution in closed form. The search for the next event uses steps that
provably contain none (kernels/exact.c).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ...basics.arrays import Array
from ...basics.resources import clock
from ...basics.validation import InputError, positive
from ...model.system import System
from ...model.time_functions import Sampled, leaves
from ...trajectory.records import as_it_starts
from ...trajectory.trajectory import Reference, Work
from ..registry import Request, output_times, provenance_of
from .contacts import audit, audit_rigid, exact_ledger, record_of, within_float64
from .derivative import derivative
from .motion import Motion, Solver


def solve(request: Request) -> Reference:
    """Return the exact solution; of a request it takes system, t_end and t_eval."""
    return solve_exact(request.system, request.t_end, request.t_eval)


def solve_exact(system: System, t_end: float, t_eval: Array | None = None, since: float = 0.0) -> Reference:
    """The exact solution in float64, from event to event, with a search that misses none deeper than rounding.

    Takes any damping, critical too, free bodies, drives in resonance with any regime, any number of contacts, linear
    stops, damped ones too, or all of them rigid with Newton's law of restitution, and time functions made of Harmonic,
    Constant and Sampled. Contacts are recorded from ``since`` on. Impacts that two rigid contacts deal each other
    without end are counted as far as float64 tells them apart: how many is not a number of the motion.

    Raises InputError with the reason for what it does not take, and for more than 200 000 impacts (restitution 1 with a
    lasting load has infinitely many); SolverFailure where it cannot go on, or the energy balance of the motion is open.
    The search: see kernels/exact.c.
    """
    begun = clock()
    positive("t_end", t_end)
    refuse(system, t_end)
    with within_float64("exact", t_end):
        solution = Solver(system).solve(t_end, stations=output_times(t_eval, t_end))
        # An energy balance that is open beyond rounding raises SolverFailure: no solution is returned.
        if not system.rigid:
            audit(solution, t_end)
        reference = reference_of(solution, t_end, t_eval, begun, "exact", {}, since)
        if system.rigid:
            audit_rigid(solution, reference.energy, t_end)
        return reference


def reference_of(
    solution: Motion,
    t_end: float,
    t_eval: Array | None,
    begun: float,
    method: str,
    notes: dict[str, Any],
    since: float = 0.0,
) -> Reference:
    """A piecewise solution as a Reference; ``begun`` is the clock when the work on it began."""
    system, t = solution.system, output_times(t_eval, t_end)
    # Position and velocity of every channel; outputs at t = 0 are those of the start.
    seen = [as_it_starts(system, i, t, *solution.path(t, i)) for i in range(len(system.channels))]
    contacts = tuple(record_of(solution, i, (t, *seen[i]), t_end, since) for i in range(len(system.contacts)))
    tip, velocity = seen[system.tip_channel]
    seconds = clock() - begun
    return Reference(
        t=t,
        tip=tip,
        tip_velocity=velocity,
        contacts=contacts,
        work=Work(
            seconds=seconds,
            march_seconds=seconds,
            counters={"evaluations": solution.evaluations, "switches": len(solution.times) - 1},
        ),
        provenance=provenance_of(system, method, t_end, notes),
        system=system,
        evaluate=solution.path,
        state_at=solution.states,
        # The ledger is computed on demand.
        ledger=partial(exact_ledger, solution, t),
        solution=solution,
        derive=derivative,
    )


def refuse(system: System, t_end: float, other: str = "use the solver cvode-adams") -> None:
    """Raise InputError for what has no exact solution; other: a remedy of the caller's beside a change of the system.

    Laws that are not linear between events, functions of time without a closed form, samples that end before t_end, and
    damped stops that move by samples. Of rigid stops, which have to be all of one kind, those without restitution,
    contacts that follow from each other, and stops that move along a polygon: at its corners the contact point has no
    velocity.
    """
    other = other and f", or {other}"
    if not system.passive:
        rule = "take energy from every motion for the exact solution"
        raise InputError("damping", "a matrix that gives energy", rule, f"leave out what gives energy{other}")
    for contact in system.contacts:
        stops, records = contact.stops, [x for x in leaves(contact.offset) if isinstance(x, Sampled)]
        if not system.rigid:
            stops.require_linear("the exact solution", damped=True, remedy=f"leave it out{other}")
            if stops.damping > 0.0 and records:
                rule = "be made of Harmonic and Constant where the stop is damped"
                raise InputError("contact.offset", contact.offset, rule, f"leave the damping out{other}")
        elif not stops.rigid:
            raise InputError("contacts", "rigid and compliant ones", "be all of one kind", "take stiff ones for inf")
        elif stops.restitution is None:
            remedy = "give one, or condense the contact node into a stop of its own stiffness K_bb"
            raise InputError("stops.restitution", None, "be given for rigid stops", remedy)
        elif any(x.degree < 2 for x in records):
            rule = "have a velocity at its samples, where it moves a rigid stop"
            raise InputError("contact.offset", contact.offset, rule, 'take samples of kind "cubic"')
    system.drive.require_samples(t_end)
    system.drive.require_closed_form("the exact solution")
    if not system.rigid:
        return
    rows = np.array([contact.row for contact in system.contacts])
    # Dependent rows make row M^-1 row^T singular: impulses and reactions would not be unique.
    least, most = np.linalg.eigvalsh(rows @ np.linalg.solve(system.mass, rows.T))[[0, -1]]
    if not least > 1e-12 * most:
        rule = "be independent of each other for rigid stops"
        remedy = "leave one out; stops on both sides of one row are one, Stops(lower=, upper=)"
        raise InputError("contacts", f"{len(rows)} that follow from each other", rule, remedy)
