"""The exact solution: between events the system is linear and has a closed form, so only event times are searched.

With linear compliance every contact is free or on one of its stops, and each combination is a linear
system with a solution in closed form. The search for the next event uses steps that provably contain none
(search.py).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from ...basics.arrays import Array
from ...basics.resources import clock
from ...basics.validation import InputError, positive
from ...model.sampled import Sampled
from ...model.system import System
from ...model.time_functions import covered, parts_of, require_closed_form
from ...piecewise.measures import audit, contact_between, exact_ledger, path_of, record_of, within_float64
from ...piecewise.motion import Motion
from ...piecewise.regimes import Known
from ...piecewise.tracer import tracer_of
from ...trajectory.records import ContactRecord, as_it_starts
from ...trajectory.trajectory import Reference, Work
from ..registry import Request, output_times, provenance_of
from .derivative import derivative


def solve(request: Request) -> Reference:
    """Return the exact solution with compliant stops; of a request it takes system, t_end and t_eval."""
    return solve_exact(request.system, request.t_end, request.t_eval)


def solve_exact(
    system: System, t_end: float, t_eval: Array | None = None, known: Known | None = None, since: float = 0.0
) -> Reference:
    """The exact piecewise-linear solution in float64, with a search that misses no event deeper than rounding.

    Takes any damping, critical too, free bodies, drives in resonance with any regime, any number of contacts, linear
    stops, damped ones too (follow.py), and time functions made of Harmonic, Constant and Sampled. Raises InputError
    with the reason for other time functions. ``known`` keeps the modes of systems that share their matrices and contact
    rows, see ``Source``. Contacts are recorded from ``since`` on. Raises SolverFailure where the search cannot go on,
    or the energy balance of the motion is open.

    With u the gap's position, u' its rate and B >= |u''| on the rest of the segment, no event lies
    before the smaller positive root s of (g2 - u) - u' s - B s^2/2 = 0 and (u - g1) + u' s - B s^2/2 = 0;
    B = sum_j |row_j| (amplitude of eta_j'') + that of the drive. Stepping by s approaches a transversal
    crossing quadratically and from before. After an event the gap is exactly 0 and s = 2 |u'|/B; where
    u' vanishes too the first derivative that does not decides (search.py).
    """
    begun = clock()
    positive("t_end", t_end)
    refuse(system, t_end)
    with within_float64("exact", t_end):
        tracer = tracer_of(system, known=known, span=t_end)
        solution = tracer.solve(t_end)
        # An energy balance that is open beyond rounding raises SolverFailure: no solution is returned.
        audit(system, solution, t_end)
        frequencies = "SVD of the curvature factor" if system.stiffness_factor is not None else "eigh"
        return reference_of(system, solution, t_end, t_eval, begun, "exact", {"frequencies": frequencies}, since)


def observed_paths(
    system: System, solution: Motion, t: Array, start: tuple[Array, Array] | None = None
) -> list[tuple[Array, Array]]:
    """Position and velocity of every channel at the times t (k,), with those of the ``start`` at t = 0."""
    channels = range(len(system.channels))
    return [as_it_starts(system, i, t, *path_of(system, solution, t, i), start) for i in channels]


def observations(
    system: System, solution: Motion, t: Array, t_end: float, since: float, start: tuple[Array, Array] | None = None
) -> tuple[Array, Array, tuple[ContactRecord, ...]]:
    """Tip and tip velocity at the times t (k,), and the records of the contacts; start: see ``as_it_starts``."""
    seen = observed_paths(system, solution, t, start)
    contacts = (record_of(system, solution, i, seen[i], t_end, since) for i in range(len(system.contacts)))
    return *seen[system.tip_channel], tuple(contacts)


def reference_of(
    system: System,
    solution: Motion,
    t_end: float,
    t_eval: Array | None,
    begun: float,
    method: str,
    notes: dict[str, Any],
    since: float = 0.0,
    observe: Callable[..., Any] = observations,
) -> Reference:
    """A piecewise solution as a Reference; ``begun`` is the clock when the work on it began. observe: of rigid stops
    their own ``observations``."""
    t = output_times(t_eval, t_end)
    tip, velocity, contacts = observe(system, solution, t, t_end, since)
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
        evaluate=partial(path_of, system, solution),
        state_at=solution.states,
        # Ledger and measures of parts of the motion are computed on demand.
        ledger=partial(exact_ledger, system, solution, t),
        contact_by_events=partial(contact_between, system, solution, (since, t_end), contacts),
        solution=solution,
        derive=derivative,
    )


def refuse(system: System, t_end: float) -> None:
    """Raise InputError for laws that are not linear between events, for time functions without a closed form, for
    damped stops that move by samples, and for samples that end before t_end."""
    if not system.passive:
        rule = "take energy from every motion for the exact solution"
        raise InputError("damping", "a matrix that gives energy", rule, "use dop853 or cvode-adams")
    for contact in system.contacts:
        contact.stops.require_linear("the exact solution", damped=True)
        if contact.stops.damping > 0.0 and any(isinstance(part, Sampled) for part in parts_of(contact.offset)):
            rule, remedy = "be made of Harmonic and Constant where the stop is damped", "use the adaptive solver cvode"
            raise InputError("contact.offset", contact.offset, rule, remedy)
    require_closed_form(system.time_functions, "a closed form")
    covered(system.time_functions, t_end)
