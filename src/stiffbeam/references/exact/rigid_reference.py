"""The solution with rigid stops as a Reference: its contacts, its energy and its horizon."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from ...basics.arrays import Array
from ...basics.resources import clock
from ...basics.validation import InputError, numbers, positive
from ...model.system import System, require_system
from ...model.time_functions import Drive, offset_values
from ...piecewise.measures import ROUNDINGS, exact_ledger, path_of, within_float64
from ...piecewise.search import EPS
from ...trajectory.records import ContactRecord, Impacts, Ledger
from ...trajectory.trajectory import Reference, SolverFailure
from ..horizon import DISPLACEMENT_TOLERANCE, Watched, agree_until, scales_of, watched
from ..registry import Request
from ..rigid_stops import REMEDY, at_rest, require_rigid
from .impacting import RADIANS, Tracer
from .piecewise import observed_paths, reference_of, refuse
from .rigid_motion import RigidMotion, held_spans, impacts_of

# A negative number reverses the change of the start; every segment uses its size.
COPIES = ((0.7, 4.0), (0.55, -4.0), (0.85, 16.0))  # radians a segment, roundings of the start and of every segment
PART = 0.5  # of the tolerances of a horizon: each of two motions may be off by as much
LOST = 1e-9  # of the energy: what the balance may be open by


def solve(request: Request) -> Reference:
    """Return the exact solution with rigid stops; of a request it takes system, t_end and t_eval."""
    return solve_rigid(request.system, request.t_end, request.t_eval)


def solve_rigid(
    system: System, t_end: float, t_eval: Array | None = None, since: float = 0.0, trusted: bool = True
) -> Reference:
    """The solution on [0, t_end] with rigid stops and Newton's law of restitution.

    Takes any damping, several contacts, moving stops, functions of time made of Harmonic, Constant and Sampled.
    Contacts are recorded from ``since`` on. Its horizon, not a number unless ``trusted``, is the time to which it
    agrees with COPIES of itself. A copy has other segments, each of which loses a few roundings of the terms that it
    sums. It starts with velocities that are off by a few roundings of the largest, but for contacts that are written
    as at rest on their stops. Copies agree to half the tolerances of a horizon, see
    ``agree_until``. The horizon ends before two contacts that
    move each other close at one time but for rounding, and before blows at one time of which the order decides what
    follows, see ``order_decides``; the solution goes on with all of them at once.
    Impacts that two contacts deal each other without end are counted as far as float64 tells them apart: how many is
    not a number of the motion.
    Raises InputError for compliant stops beside rigid ones, for stops without restitution, dependent contacts, other
    functions of time, more than 200 000 impacts (e = 1 with a lasting load has infinitely many); SolverFailure where
    it cannot go on, or its energy balance is open.
    """
    begun = clock()
    positive("t_end", t_end)
    require_rigid(system, t_end)
    with within_float64("exact", t_end):
        tracer = Tracer(system)
        solution = tracer.solve(t_end)
        reference = reference_of(system, solution, t_end, t_eval, begun, "exact", {}, since, observations)
        ledger = partial(ledger_of, system, solution, reference.t)
        reference = replace(reference, ledger=ledger, contact_by_events=None)
        opened = np.max(np.abs(reference.energy.loss))
        scale = np.max(np.abs(reference.energy.energy)) + np.max(np.abs(reference.energy.input))
        # Bodies at rest on their stops move by rounding alone, which is no fault of the energy balance.
        withheld, kept = _withheld(system, solution, t_end)
        if opened > LOST * scale + withheld:
            reason = f"the energy balance is open, by {opened / scale:.2g} of the energy"
            raise SolverFailure("exact", t_end, reason, REMEDY)
        # A contact beyond its stop shows that an event was missed.
        beyond = _beyond(system, solution, kept)
        if beyond > LOST:
            reason = f"the motion is beyond a stop, by {beyond:.2g} of its largest displacement"
            raise SolverFailure("exact", t_end, reason, REMEDY)
        if not trusted:
            return reference
        t = reference.t
        horizon = min(_horizon(tracer, reference, kept, t_end), float(np.max(t[t < solution.tie], initial=0.0)))
    provenance = reference.provenance | {
        "horizon_against": f"{len(COPIES)} copies with other segments, starts and roundings, to half the tolerance"
    }
    return replace(reference, horizon=horizon, provenance=provenance)


def observations(
    system: System, solution: RigidMotion, t: Array, t_end: float, since: float
) -> tuple[Array, Array, tuple[ContactRecord, ...]]:
    """Tip and tip velocity at the times t (k,), and the records of the contacts."""
    seen = observed_paths(system, solution, t)
    R, held = solution.reactions(t, solution.piece_at(t)), held_spans(solution, t_end, since)
    contacts = tuple(
        ContactRecord(contact.stops, *seen[i], R[:, i], *_contact(solution, i, held[i], t_end, since))
        for i, contact in enumerate(system.contacts)
    )
    return *seen[system.tip_channel], contacts


def _contact(
    solution: RigidMotion, c: int, held: list[tuple[float, float, float]], t_end: float, since: float
) -> tuple[Impacts, float, float, float]:
    """Impacts, share of time, peak and impulse of a contact: a rigid stop has no largest force, NaN. What a contact
    that is held after an impact presses, and what it takes from impacts of others, counts with that impact."""
    events = [event for event in solution.events if event.contact == c and event.time >= since]
    struck = [(time, impulse) for time, contact, impulse in solution.struck if contact == c and time >= since]
    times, ends = np.array([e.time for e in events]), np.array([e.end for e in events])
    impulses = np.array([e.impulse for e in events])
    # Impacts after which the contact is held also gather what it presses later.
    total, kept = float(np.sum(impulses)), ends > times
    for presses, at_end in (([(a, impulse) for a, _, impulse in held], False), (struck, True)):
        begun, amounts = np.array(presses).reshape(-1, 2).T
        so_far = np.concatenate([[0.0], np.cumsum(amounts)])
        # A reaction that begins at the end of an impact is outside it; a blow at that time belongs to it.
        until = np.searchsorted(begun, ends[kept], "right" if at_end else "left")
        since_then = np.searchsorted(begun, times[kept])
        impulses[kept] += so_far[until] - so_far[since_then]
        total += float(so_far[-1])
    impacts = Impacts.at(
        times, [e.side for e in events], "event", ends=ends, impulses=np.where(np.isnan(ends), np.nan, impulses)
    )
    share = sum(b - a for a, b, _ in held) / (t_end - since)
    return impacts, share, math.nan if events or held else 0.0, total


def ledger_of(system: System, solution: RigidMotion, t: Array) -> Ledger:
    """``exact_ledger`` with what impacts take as stop_dissipation."""
    smooth = exact_ledger(system, solution, t)
    # Impacts change the energy at once: sum what they took and what moving stops put in up to each time.
    when, *impulsive = np.array(solution.taken).reshape(-1, 3).T
    so_far = np.searchsorted(when, t, side="right")
    taken, moved = (np.concatenate([[0.0], np.cumsum(x)])[so_far] for x in impulsive)
    # From t = 0, not from the first output: impacts before that count.
    start = float(system.energy(np.zeros(1), system.q0[None], system.v0[None])[0])
    supplied = smooth.input + moved
    loss = start - smooth.energy + supplied - smooth.viscous - taken
    return replace(
        smooth, input=supplied, loss=loss, loss_in_contact=loss, loss_without_contact=0.0 * loss, stop_dissipation=taken
    )


def _horizon(tracer: Tracer, reference: Reference, kept: Array, t_end: float) -> float:
    """Horizon of the solution, see ``solve_rigid``. kept: from ``_withheld``; positions below it are rounding."""
    system, eps = tracer.system, float(np.finfo(float).eps)
    channels = system.tip_channel, *range(len(system.contacts))
    # Differences as large as the rounding of held positions pass, or a body at rest would have no horizon.
    rounding = np.array([kept @ np.abs(system.channels[channel][0]) for channel in channels])
    scales = np.maximum(scales_of(reference), rounding / (PART * DISPLACEMENT_TOLERANCE)).tolist()
    # Rates are roots of eigenvalues: so far below the largest they may be the rounding of a zero.
    slowest = tracer.rates[tracer.rates > 1e-6 * np.max(tracer.rates, initial=0.0)]
    tolerance = DISPLACEMENT_TOLERANCE * (2.0 * np.pi / float(np.min(slowest)) if len(slowest) else t_end)
    fastest, horizon, unperturbed = float(np.max(np.abs(reference.states[1]))), t_end, watched(reference)
    at = at_rest(system)
    rows, back = tracer.rows[at], tracer.back[:, at]
    for seed, (radians, roundings) in enumerate(COPIES):
        off = (-1.0) ** np.arange(system.size)
        off -= back @ np.linalg.solve(rows @ back, rows @ off)  # what is written as at rest is at rest
        # What the projection leaves of a zero by rounding is no change.
        off[np.abs(off) < 16.0 * eps] = 0.0
        start = system.v0 + roundings * eps * fastest * off
        copy = tracer.copy(start, radians, abs(roundings), seed).solve(t_end)
        paths = tuple(path_of(system, copy, unperturbed.t, channel)[0] for channel in channels)
        impacts = tuple(impacts_of(copy, i) for i in range(len(system.contacts)))
        # A copy of what starts at rest on a stop is thrown off it by its rounding of the speed; and of a chatter
        # either may count more.
        horizon = min(
            horizon, agree_until(unperturbed, Watched(unperturbed.t, paths, impacts), tolerance, scales, PART, True)
        )
    return horizon


def _withheld(system: System, solution: RigidMotion, t_end: float) -> tuple[float, Array]:
    """The rounding of what held contacts withhold: of the energy and of the positions (n,) that forces would give the
    system in one stretch, were it free. A body that is pressed on its stop at rest has none of its own. A load that
    rises from zero is looked at where the last stretch ends, too."""
    segments = np.arange(len(solution.times))
    times, segments = np.append(solution.times, t_end), np.append(segments, segments[-1])
    q, v = solution.states_in(np.append(solution.times, solution.times[-1]), segments)
    force = system.load(times) - q @ system.stiffness - v @ system.damping
    acceleration = np.linalg.solve(system.mass, force.T).T
    # From rest a force f does the work f a t^2/2 in a stretch t.
    longest = min(t_end, RADIANS / max(solution.fastest, 1e-300))
    energy = 0.5 * float(np.max(np.sum(force * acceleration, axis=1))) * longest**2
    return ROUNDINGS * EPS * energy, ROUNDINGS * EPS * np.max(np.abs(acceleration), axis=0) * longest**2


def _beyond(system: System, solution: RigidMotion, kept: Array) -> float:
    """Largest penetration at the starts of the segments, less rounding and ``kept`` (n,), relative to the largest gap
    or displacement."""
    times, worst = solution.times, 0.0
    q, _ = solution.states_in(times, np.arange(len(times)))
    for contact in system.contacts:
        shift, stops = offset_values(contact.offset, times), contact.stops
        u = q @ contact.row + shift
        rounding = ROUNDINGS * EPS * float(np.max(np.abs(q) @ np.abs(contact.row) + np.abs(shift)))
        rounding += float(kept @ np.abs(contact.row))
        sizes = [
            float(np.max(np.abs(u))),
            *(abs(g) for g in (stops.lower_bound, stops.upper_bound) if math.isfinite(g)),
            1e-300,
        ]
        worst = max(worst, (float(np.max(np.abs(stops.penetration(u)))) - rounding) / max(sizes))
    return worst


def rigid_limit(system: System, t_end: float, t_eval: Array | None = None) -> Reference:
    """Return the solution with the stops of a system's only contact made rigid, restitution 1, on a node with mass.

    Parameters
    ----------
    system : System
        As for the exact solution without damping.
    t_end : float
    t_eval : array (k,), optional

    Returns
    -------
    Reference
        With impulses |M (q'+ - q'-)| along the row in the place of forces, and without horizon. Its ledger leaves the
        stops' energy out.

    Raises
    ------
    InputError
        For other systems, and for more than 200 000 impacts.
    SolverFailure
        If a load presses the contact at rest on its stop, which no impact describes, or if the energy balance does not
        close.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system()
    >>> sb.rigid_limit(system, 0.2).impacts.count > 10
    True
    """
    require_system(system)
    t_end = positive("t_end", t_end)
    t_eval = None if t_eval is None else numbers("t_eval", t_eval)
    refuse(system, t_end)
    if len(system.contacts) != 1 or system.damped:
        rule = "be undamped with one contact for rigid stops"
        remedy = "take stiffbeam.reference, or a scheme for rigid stops"
        raise InputError("system", "a damped one, or not one contact", rule, remedy)
    if Drive.of(system).records:
        rule = "be Harmonic or Constant for rigid stops"
        remedy = "take stiffbeam.reference, or a scheme for rigid stops"
        raise InputError("time function", Drive.of(system).records[0], rule, remedy)
    if system.contacts[0].offset is not None:
        remedy = "take stiffbeam.reference, or a scheme for rigid stops"
        raise InputError("contact.offset", system.contacts[0].offset, "be None for rigid stops", remedy)
    stops = replace(system.contacts[0].stops, stiffness=math.inf, restitution=1.0)
    rigid = replace(system, contacts=(replace(system.contacts[0], stops=stops),))
    reference = solve_rigid(rigid, t_end, t_eval, trusted=False)
    held = np.flatnonzero(np.any(reference.solution.sides != 0, axis=1))
    if len(held):
        time = float(reference.solution.times[held[0]])
        raise SolverFailure("rigid", time, "the contact is pressed on its stop without speed", "use compliant stops")
    record = replace(reference.contacts[0], force=np.full(len(reference.t), np.nan))
    return replace(reference, contacts=(record,), provenance=reference.provenance | {"method": "rigid"})
