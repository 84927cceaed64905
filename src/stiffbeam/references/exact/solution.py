"""The exact solution: between events the system is linear and has a closed form, so only event times are searched.

With linear compliance every contact is free or on one of its stops, which a damped one leaves before the gap opens,
and each combination is a linear system with a solution in closed form. The search for the next event uses steps that
provably contain none (kernels/exact.c). An energy balance that does not close raises an error:

    E - E_0 = input - dissipation,   E = 1/2 q'^T M q' + 1/2 q^T K q + sum_c U_c

Inside a segment the closed form keeps the balance of its own regime, in which U_c = kappa gap^2/2 wherever chi is not 0
for contact c. The balance of the whole can therefore fail in three places only: at the start; at an event, by the
energies on its two sides and by the energy of a jump between them; and inside a segment whose gap is not on the side of
chi, by the error of U_c there. All of these are added up.

A motion far smaller than the amplitudes it is the difference of has lost its digits with the balance intact:
there the observed positions do not start where they should.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array, IntArray
from ...basics.resources import clock
from ...basics.validation import InputError, positive
from ...model.contact import channel_position
from ...model.system import System
from ...model.time_functions import Sampled, evaluate, leaves
from ...trajectory.records import ContactRecord, Impacts, Ledger, as_it_starts
from ...trajectory.trajectory import Reference, SolverFailure, Work
from ..registry import Request, output_times, provenance_of
from .derivative import derivative
from .motion import EPS, REMEDY, Motion, Solver, pressed


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


# ---------------------------------------------------------------- contacts and energy of a motion


def entries(solution: Motion, i: int, t_end: float) -> Impacts:
    """Impacts of contact i: entries into a stop, without peaks and impulses; of a rigid one every impact, with the
    impulses that it takes from blows."""
    if solution.system.contacts[i].stops.rigid:
        times, ends, sides, impulses = _rigid_rows(solution, i, t_end)
        return Impacts.at(times, sides, "event", ends=ends, impulses=impulses)
    starts, _, sides = _closed(solution, i, t_end)
    return Impacts.at(starts[starts > 0.0], sides[starts > 0.0], "event")


def _rigid_rows(solution: Motion, i: int, t_end: float) -> tuple[Array, Array, IntArray, Array]:
    """Times, ends, sides and impulses of the impacts on a rigid stop, also of those that begin to press without a blow.

    Ends: the time itself where the contact is thrown back, NaN where it is held at t_end. Blows while it is held count
    with the impact before them; those that are rounding beside the largest momentum of the contact do not.
    """
    blows, mine = solution.blows, solution.blows.contact == i
    at, t, outward = blows.mark[mine], blows.t[mine], blows.outward[mine]
    strong = set(at[outward >= DUST * np.max(outward, initial=largest_momentum(solution, i))].tolist())
    # By the mark behind an impact: time, end, side. A blow at the start is no event of the search.
    rows = {0: (t[0], t[0], float(blows.side[mine][0]))} if 0 in strong else {}
    when, contact, side, mark = (x.tolist() for x in solution.events)
    for time, one, on, behind in zip(when, contact, side, mark, strict=True):
        if one == i and on and behind in strong:
            rows[behind] = time, time, float(np.sign(on))
    for start, end, on in zip(*_closed(solution, i, t_end), strict=True):
        behind = solution.first_mark[np.flatnonzero(solution.times == start)].tolist()
        k = next((x for x in reversed(behind) if x in rows), behind[-1])
        time, _, struck = rows.get(k, (start, start, float(on)))
        rows[k] = time, np.nan if end == t_end else end, struck
    marks = np.array(sorted(rows), np.int64)
    times, ends, sides = np.array([rows[x] for x in marks.tolist()]).reshape(-1, 3).T
    row = np.searchsorted(marks, at, "right") - 1
    own = (row >= 0) & ((marks[row] == at) | (t <= ends[row])) if len(marks) else np.zeros(len(at), bool)
    return times, ends, sides.astype(np.int64), np.bincount(row[own], outward[own], len(times)).astype(float)


def record_of(solution: Motion, i: int, seen: tuple[Array, Array, Array], t_end: float, since: float) -> ContactRecord:
    """Contact history in [since, t_end] by events; seen: output times, position and velocity there. Impacts are the
    events from free to a stop. A rigid stop has no largest force, NaN, and what a held contact presses counts with the
    impact before it."""
    stops, (t, position, velocity) = solution.system.contacts[i].stops, seen
    # Spans of contact in [since, t_end].
    begun, ends, sides = _closed(solution, i, t_end)
    begun, ends, sides = (x[ends > since] for x in (begun, ends, sides))
    starts = np.maximum(begun, since)
    peaks, impulses = solution.press(i, starts, ends) if len(starts) else np.zeros((2, 0))
    total, peak = float(np.sum(impulses)), float(np.max(peaks, initial=0.0))
    if stops.rigid:
        held = impulses > 0.0
        starts, ends, impulses = starts[held], ends[held], impulses[held]
        blows, (times, until, struck_sides, struck) = solution.blows, _rigid_rows(solution, i, t_end)
        total += float(np.sum(blows.outward[(blows.contact == i) & (blows.t >= since)]))
        for k, impulse in zip(np.searchsorted(times, starts, "right") - 1, impulses, strict=True):
            struck[k] += impulse
        # A contact that touches at the start and never presses has no row: it is none for any scheme.
        late, force = (times >= since) & ((times > 0.0) | (struck > 0.0)), solution.reactions(t)[:, i]
        struck = np.where(np.isnan(until), np.nan, struck)
        impacts = Impacts.at(times[late], struck_sides[late], "event", ends=until[late], impulses=struck[late])
        peak = np.nan if np.any(late) or np.any(held) else 0.0
    else:
        # Contact that is there at the start is no impact; that at t = 0 has a row too, flagged as open at the start.
        force, listed = stops.force(position, velocity), (begun > since) | (begun == 0.0)
        # A span that t_end cuts has no peak and impulse yet.
        until, tops, pushes = (np.where(ends < t_end, x, np.nan)[listed] for x in (ends, peaks, impulses))
        impacts = Impacts.at(begun[listed], sides[listed], "event", ends=until, peaks=tops, impulses=pushes)
    fraction = float(np.sum(ends - starts) / (t_end - since))
    return ContactRecord(stops, position, velocity, force, impacts, fraction, peak, total)


def largest_momentum(solution: Motion, i: int) -> float:
    """The largest impulse that brings contact i to rest."""
    free, rates = solution.free, [solution.marks.rate, *([] if solution.seen is None else [solution.seen[2]])]
    return max(float(np.max(np.abs(x @ free.rows[i]), initial=0.0)) for x in rates) / float(free.meet[i, i])


def _closed(solution: Motion, i: int, t_end: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Start, end and side of every interval in which the contact stays on one stop.

    Pieces of no length, where it touches and turns straight back, do not count; pieces in which only
    other contacts have events belong together.
    """
    ends = np.concatenate([solution.times[1:], [t_end]])
    real = ends > solution.times
    starts, ends, side = solution.times[real], ends[real], pressed(solution.sides[real, i])
    # Segments on one side belong to one span: only other contacts have events between them.
    new = np.concatenate([[True], side[1:] != side[:-1]])
    first = np.flatnonzero(new)
    last = np.concatenate([first[1:], [len(side)]]) - 1
    closed = side[first] != 0
    return starts[first][closed], ends[last][closed], side[first][closed]


def exact_ledger(solution: Motion, times: Array) -> Ledger:
    """Energy balance of the exact flow at increasing times, with what impacts take as loss in the stops.

    input = int (sum_k f_k p_k^T q' - sum_c F_c o_c') dt and viscous = int q'^T C q' dt are exact to
    rounding, so the loss left over is the error of the solution itself.
    """
    # From t = 0, where the balance starts.
    edges = np.unique(np.concatenate([solution.times[solution.times < times[-1]], times, [0.0]]))
    where = np.searchsorted(edges, times)
    works, system = solution.work(edges), solution.system
    given, taken, stops = (np.concatenate([[0.0], np.cumsum(x)])[where] for x in works)
    # With u = row q + o a stop moves at -o', and the impulse P of a blow works on the mean of u' before and after.
    blows, speeds = solution.blows, np.zeros(len(solution.blows.t))
    for i in np.unique(blows.contact).tolist():
        here = blows.contact == i
        speeds[here] = evaluate(system.contacts[i].offset, blows.t[here], 1)
    moved, struck = -blows.impulse * speeds, -0.5 * blows.impulse * (blows.before + blows.after)
    so_far = np.searchsorted(blows.t, times, side="right")
    given, stops = (x + np.concatenate([[0.0], np.cumsum(y)])[so_far] for x, y in ((given, moved), (stops, struck)))
    energies = system.energies(times, *solution.states(times))
    # Between rigid stops with a blow at the start, which the motion has behind it.
    start = (system.q0[None], system.v0[None]) if system.rigid else solution.states(np.zeros(1))
    loss = sum(system.energies(np.zeros(1), *start)) - sum(energies) + given - taken - stops
    none = np.zeros(len(times))
    return Ledger(times, *energies, given, taken, loss, none, loss, stops, none)


DUST = 1e-13  # of the largest momentum of a contact
ROUNDINGS = 64.0
SEEN = 1e-6  # of the largest energy so far: less is not held against a motion
NOTHING = 1e-20  # of the largest energy of all: what rounding makes of none
START = 1e-3  # of the largest displacement: what a start may be off
FLOWN = 8.0  # radians of the fastest motion below which a motion is a series, which does not cancel: see exact.c
SMALLER = "the motion is smaller than the rounding of the amplitudes it is the difference of"


@contextmanager
def within_float64(solver: str, t_end: float) -> Generator[None, None, None]:
    """Turn overflows, NaN and matrices without eigenvectors into SolverFailure, so that every result is finite."""
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        if isinstance(error, OverflowError) or "overflow" in str(error):
            raise SolverFailure(solver, t_end, f"the motion overflows float64 ({error})", REMEDY) from None
        reason = f"float64 has no result for a step of the calculation ({error})"
        raise SolverFailure(solver, t_end, reason, "use the method multiprecision") from None


def audit(solution: Motion, t_end: float) -> None:
    """Raise SolverFailure with the first time at which a contact is not in the regime of its segment.

    Inside a segment the motion is that of its regime: what may fail is an event that was missed. Then the energy of the
    regime's springs is not that of the stops, by more than rounding, and SEEN of the largest energy so far. Looked at
    are the outputs, or the middles of segments where these are more.
    """
    _answered(solution, t_end)
    system, segments = solution.system, np.arange(len(solution.times))
    q, v = solution.states(solution.times, segments)
    energy = np.sum(system.free_energies(q, v), axis=0)
    terms = EPS * np.sum(np.abs(q) * (np.abs(q) @ np.abs(system.stiffness)), axis=1)
    seen, middles = solution.seen, 0.5 * (solution.times + np.append(solution.times[1:], t_end))
    t = middles if seen is None or len(seen[0]) < 4 * len(middles) else seen[0]
    piece, (wrong, held) = solution.piece_at(t), np.zeros((2, len(t)))
    for i, contact in enumerate(system.contacts):
        stops, chi, u = contact.stops, solution.sides[piece, i], solution.path(t, i)[0]
        stop = np.where(chi > 0, stops.law.g2, np.where(chi < 0, stops.law.g1, 0.0))
        law = stops.energy(u)
        wrong += np.abs(np.where(chi != 0, 0.5 * stops.law.kappa, 0.0) * (u - stop) ** 2 - law)
        held += law
        given, begun = (float(channel_position(contact.row, contact.offset, 0.0, x)) for x in (system.q0, q[0]))
        if abs(begun - given) > START * max(abs(given), float(np.max(np.abs(u)))):
            raise SolverFailure("exact", 0.0, SMALLER, "use multiprecision")
    # The largest energy so far, between events too: a body squeezed from both sides may have none at them.
    between = np.sum(system.free_energies(*solution.states(t)), axis=0)
    largest = np.maximum.accumulate(np.max([energy[piece], held, between], axis=0))
    bad = np.flatnonzero(wrong > SEEN * largest + terms[piece] + NOTHING * np.max(largest, initial=0.0))
    if len(bad):
        share = wrong[bad[0]] / max(float(largest[bad[0]]), 1e-300)
        reason = f"the energy balance is open, by {share:.2g} of the energy"
        raise SolverFailure("exact", float(t[bad[0]]), reason, REMEDY)


def _answered(solution: Motion, t_end: float) -> None:
    """Raise SolverFailure where the closed form's answer to the loads is so much larger than the motion that this is
    its rounding; both in the norm of M."""
    free = solution.free
    lost = 4.0 * EPS * float(np.linalg.norm(free.answer))
    if lost and t_end * float(np.max(np.hypot(*free.poles))) > FLOWN:
        length = np.linalg.norm(solution.states(np.linspace(0.0, t_end, 33))[0] @ free.into, axis=1)
        if lost > START * float(np.max(length)):
            raise SolverFailure("exact", 0.0, SMALLER, "use multiprecision")


BALANCE = 1e-9  # of the energy, and of the largest displacement: what the balance and the stops may be off by


def audit_rigid(solution: Motion, ledger: Ledger, t_end: float) -> None:
    """Raise SolverFailure where the energy balance of a motion between rigid stops is open, or a contact is beyond one,
    which shows that an event was missed."""
    opened = np.max(np.abs(ledger.loss))
    scale = np.max(np.abs(ledger.energy)) + np.max(np.abs(ledger.input))
    # Bodies at rest on their stops move by rounding alone, which is no fault of the energy balance.
    rounding, kept = withheld(solution, t_end)
    if opened > BALANCE * scale + rounding:
        reason = f"the energy balance is open, by {opened / scale:.2g} of the energy"
        raise SolverFailure("exact", t_end, reason, REMEDY)
    beyond = _beyond(solution, ledger.t, kept)
    if beyond > BALANCE:
        reason = f"the motion is beyond a stop, by {beyond:.2g} of its largest displacement"
        raise SolverFailure("exact", t_end, reason, REMEDY)


def withheld(solution: Motion, t_end: float) -> tuple[float, Array]:
    """The rounding of what held contacts withhold: of the energy and of the positions (n,) that forces would give the
    system in one stretch, were it free. A body that is pressed on its stop at rest has none of its own. A load that
    rises from zero is looked at where the last stretch ends, too."""
    system, segments = solution.system, np.arange(len(solution.times))
    times, segments = np.append(solution.times, t_end), np.append(segments, segments[-1])
    q, v = solution.states(np.append(solution.times, solution.times[-1]), segments)
    force = system.load(times) - q @ system.stiffness - v @ system.damping
    acceleration = np.linalg.solve(system.mass, force.T).T
    # From rest a force f does the work f a t^2/2 in a stretch t.
    longest = min(t_end, 2.0 / solution.fastest)  # a step of series
    energy = 0.5 * float(np.max(np.sum(force * acceleration, axis=1))) * longest**2
    return ROUNDINGS * EPS * energy, ROUNDINGS * EPS * np.max(np.abs(acceleration), axis=0) * longest**2


def _beyond(solution: Motion, t: Array, kept: Array) -> float:
    """Largest penetration at the starts of the segments, less rounding and ``kept`` (n,), relative to the largest gap
    or displacement, also at the times t (k,)."""
    times, worst = solution.times, 0.0
    (q, v), (q_between, _) = solution.states(times, np.arange(len(times))), solution.states(t)
    for contact in solution.system.contacts:
        u, between = (channel_position(contact.row, contact.offset, *x) for x in ((times, q), (t, q_between)))
        # Of positions, and of the times of events.
        row, moved = np.abs(contact.row), np.abs(q) + times[:, None] * np.abs(v)
        rounding = ROUNDINGS * EPS * float(np.max(moved @ row + np.abs(evaluate(contact.offset, times))))
        largest = max(float(np.max(np.abs(x))) for x in (u, between))
        size = max(largest, *(abs(g) for g in contact.stops.sides.values()), 1e-300)
        beyond = float(np.max(np.abs(contact.stops.penetration(u)))) - rounding - float(kept @ row)
        worst = max(worst, beyond / size)
    return worst
