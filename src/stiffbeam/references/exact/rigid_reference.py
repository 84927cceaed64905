"""The solution with rigid stops as a Reference: its contacts, its energy, and how long it can be trusted."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from ...basics.arrays import Array
from ...basics.compiled import clock
from ...basics.validation import InputError, numbers, positive
from ...model.drive import Drive
from ...model.system import System, require_system
from ...model.time_functions import evaluate, offset_rate, offset_values
from ...piecewise.follow import DONE, follow
from ...piecewise.measures import ROUNDINGS, audit, within_float64
from ...piecewise.motion import Motion
from ...piecewise.regimes import Regimes, Source
from ...piecewise.touching import EPS
from ...piecewise.tracer import QUIET
from ...trajectory.impacts import ContactRecord, Impacts
from ...trajectory.ledger import Ledger
from ...trajectory.trajectory import Reference, SolverFailure, Work, versions
from ..agreement import apart, scales_of, watched
from ..request import output_times
from ..rigid_stops import require_rigid
from .derivative import derivative
from .impacting import RADIANS, RigidMotion, Tracer, at_rest
from .piecewise import reference_of, refuse
from .taylor import Model

COPIES = ((0.7, 4.0), (0.55, -4.0), (0.85, 16.0))  # radians a segment, roundings of the start and of every segment
APART = 5e-4  # of the largest displacement, and of a radian of the slowest motion: half the tolerance of a horizon
LOST = 1e-9  # of the energy: what the balance may be open by
GAUSS = np.polynomial.legendre.leggauss(10)


def solve_rigid(
    system: System, t_end: float, t_eval: Array | None = None, since: float = 0.0, trusted: bool = True
) -> Reference:
    """The solution on [0, t_end] with rigid stops and Newton's law of restitution.

    Takes any damping, several contacts, moving stops, functions of time made of Harmonic, Constant and Sampled.
    Contacts are recorded from ``since`` on. Its horizon, not a number unless ``trusted``, is the time to which it
    agrees with COPIES of itself. A copy has other segments, each of which loses a few roundings of the terms that it
    sums. It starts with velocities that are off by a few roundings of the largest, but for contacts that are written
    as at rest on their stops. Copies agree in positions of the tip and of every contact to APART of the largest, in
    impact times likewise and to a fortieth of the mean time between them. The horizon ends before two contacts that
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
    t = output_times(t_eval, t_end)
    with within_float64("exact", t_end):
        solution = Tracer(system).solve(t_end)
        found = _reference(system, solution, t, t_end, begun, since)
        opened = np.max(np.abs(found.energy.loss))
        scale = np.max(np.abs(found.energy.energy)) + np.max(np.abs(found.energy.input))
        withheld, kept = _withheld(system, solution, t_end)
        if opened > LOST * scale + withheld:
            reason = f"the energy balance is open, by {opened / scale:.2g} of the energy"
            raise SolverFailure("exact", t_end, reason, "use a scheme with an impact law")
        beyond = _beyond(system, solution, kept)
        if beyond > LOST:
            reason = f"the motion is beyond a stop, by {beyond:.2g} of its largest displacement"
            raise SolverFailure("exact", t_end, reason, "use a scheme with an impact law")
        if not trusted:
            return found
        horizon = min(_horizon(system, found, kept, t, t_end), float(np.max(t[t < solution.tie], initial=0.0)))
    provenance = found.provenance | {
        "horizon_against": f"{len(COPIES)} copies with other segments, starts and roundings, to half the tolerance"
    }
    return replace(found, horizon=horizon, provenance=provenance)


def _reference(system: System, solution: RigidMotion, t: Array, t_end: float, begun: float, since: float) -> Reference:
    seconds = clock() - begun
    q, v, R = solution.at(t)

    def observed(times: Array, channel: int) -> tuple[Array, Array]:
        q, v, _ = solution.at(np.asarray(times, float))
        return _seen(solution, np.asarray(times, float), q, v, channel)

    tip, velocity = _seen(solution, t, q, v, system.tip_channel)
    held = _held(solution, t_end, since)
    contacts = tuple(
        ContactRecord(
            contact.stops,
            *_seen(solution, t, q, v, c),
            R[:, c],
            *_contact(solution, c, held[c], t_end, since),
        )
        for c, contact in enumerate(system.contacts)
    )
    return Reference(
        t=t,
        tip=tip,
        tip_velocity=velocity,
        contacts=contacts,
        work=Work(seconds=seconds, march_seconds=seconds, counters={"stretches": len(solution.times)}),
        provenance={
            "method": "exact", "form": system.form, "units": asdict(system.units), "t_end": float(t_end), **versions(),
        },
        system=system,
        evaluate=observed,
        state_at=lambda times: solution.at(np.asarray(times, float))[:2],
        ledger=partial(_ledger, system, solution, t),
        solution=solution,
        derive=derivative,
    )  # fmt: skip


def _seen(solution: RigidMotion, t: Array, q: Array, v: Array, channel: int) -> tuple[Array, Array]:
    """Position and velocity of a channel; of a held contact those of its stop, not what rounding leaves of them."""
    system = solution.model.system
    row, offset = system.channels[channel]
    u, w = q @ row + offset_values(offset, t), v @ row + offset_rate(offset, t)
    if channel < len(system.contacts):
        held, stops = solution.is_held(t, channel), system.contacts[channel].stops
        stop = np.where(
            np.abs(u - stops.upper_bound) < np.abs(u - stops.lower_bound), stops.upper_bound, stops.lower_bound
        )
        u, w = np.where(held, stop, u), np.where(held, 0.0, w)
    return u, w


def _withheld(system: System, solution: RigidMotion, t_end: float) -> tuple[float, Array]:
    """The rounding of what held contacts withhold: of the energy and of the positions (n,) that forces would give the
    system in one stretch, were it free. A body that is pressed on its stop at rest has none of its own. A load that
    rises from zero is looked at where the last stretch ends, too."""
    times = np.array([*solution.times, t_end])
    q, v = (np.array(x) for x in zip(*solution.states, solution.states[-1], strict=True))
    force = system.load(times) - q @ system.stiffness - v @ system.damping
    acceleration = np.linalg.solve(system.mass, force.T).T
    longest = min(t_end, RADIANS / solution.model.fastest if solution.model.fastest else t_end)
    energy = 0.5 * float(np.max(np.sum(force * acceleration, axis=1))) * longest**2
    return ROUNDINGS * EPS * energy, ROUNDINGS * EPS * np.max(np.abs(acceleration), axis=0) * longest**2


def _beyond(system: System, solution: RigidMotion, kept: Array) -> float:
    """How far the starts of the stretches lie beyond stops, but for rounding and what is ``kept`` of it (n,), over the
    largest gap or displacement."""
    times, q = np.array(solution.times), np.array([q for q, _ in solution.states])
    worst = 0.0
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


def _held(solution: RigidMotion, t_end: float, since: float = 0.0) -> list[list[tuple[float, float, float]]]:
    """For every contact the stretches (from, to, impulse of the reaction) in which it is held after ``since``."""
    found: list[list[tuple[float, float, float]]] = [[] for _ in solution.model.rows]
    ends = [*solution.times[1:], t_end]
    for k, held in enumerate(solution.held):
        if held and ends[k] > since:
            _, R = solution.model.stretch(solution.times[k], *solution.states[k], held)
            powers = np.arange(1, len(R) + 1)
            start, length = max(0.0, since - solution.times[k]), ends[k] - solution.times[k]
            impulses = ((length**powers - start**powers) / powers) @ R
            for c, impulse in zip(held, impulses, strict=True):
                found[c].append((solution.times[k] + start, ends[k], abs(float(impulse))))
    return found


def _contact(
    solution: RigidMotion, c: int, held: list[Any], t_end: float, since: float
) -> tuple[Impacts, float, float, float]:
    """Impacts, share of time, peak and impulse of a contact: a rigid stop has no largest force, NaN. What a contact
    that is held after an impact presses, and what it takes from impacts of others, counts with that impact."""
    events = [event for event in solution.events if event.contact == c and event.time >= since]
    struck = [(time, impulse) for time, contact, impulse in solution.struck if contact == c and time >= since]
    times, ends = np.array([e.time for e in events]), np.array([e.end for e in events])
    impulses = np.array([e.impulse for e in events])
    total, kept = float(np.sum(impulses)), ends > times
    for presses, at_end in (([(a, impulse) for a, _, impulse in held], False), (struck, True)):
        begun, amounts = np.array(presses).reshape(-1, 2).T
        so_far = np.concatenate([[0.0], np.cumsum(amounts)])
        until = np.searchsorted(begun, ends[kept], "right" if at_end else "left")
        since_then = np.searchsorted(begun, times[kept])
        impulses[kept] += so_far[until] - so_far[since_then]
        total += float(so_far[-1])
    impacts = Impacts.at(
        times,
        [e.side for e in events],
        "event",
        ends=ends,
        impulses=np.where(np.isnan(ends), np.nan, impulses),
    )
    share = sum(b - a for a, b, _ in held) / (t_end - since)
    return impacts, share, math.nan if events or held else 0.0, total


def _ledger(system: System, solution: RigidMotion, t: Array) -> Ledger:
    """Input and viscous by quadrature in every stretch, stop_dissipation from the impulses."""
    edges = np.unique(np.concatenate([[0.0], t, [x for x in solution.times if x < t[-1]]]))
    points, weights = GAUSS
    input_, viscous = np.zeros(len(edges)), np.zeros(len(edges))
    if len(edges) > 1:
        length = np.diff(edges)
        panels = np.maximum(1, np.ceil(length * solution.model.fastest / RADIANS)).astype(int)
        cuts = np.concatenate([a + np.arange(n) / n * d for a, d, n in zip(edges, length, panels, strict=False)])
        half = 0.5 * np.repeat(length / panels, panels)
        nodes = (cuts + half)[:, None] + half[:, None] * points
        q, v, R = solution.at(nodes.ravel())
        power = np.zeros(nodes.size)
        for p, f in system.loads:
            power += evaluate(f, nodes.ravel()) * (v @ p)
        for c, contact in enumerate(system.contacts):
            power -= R[:, c] * offset_rate(contact.offset, nodes.ravel())
        drag = np.sum(v * (v @ system.damping), axis=1)
        owner = np.repeat(np.arange(len(length)), panels)
        for total, density in ((input_, power), (viscous, drag)):
            of_panels = half * (density.reshape(nodes.shape) @ weights)
            total[1:] = np.cumsum(np.bincount(owner, of_panels, len(length)))
    at = np.searchsorted(edges, t)
    when, *impulsive = np.array(solution.taken).reshape(-1, 3).T
    so_far = np.searchsorted(when, t, side="right")
    taken, moved = (np.concatenate([[0.0], np.cumsum(x)])[so_far] for x in impulsive)
    q, v, _ = solution.at(t)
    energies = system.energies(t, q, v)
    energy = sum(energies)
    given, lost = input_[at] + moved, viscous[at]
    start = float(system.energy(np.zeros(1), system.q0[None], system.v0[None])[0])
    loss = start - energy + given - lost - taken
    return Ledger(t, *energies, given, lost, loss, loss, np.zeros_like(loss), taken)


def _horizon(system: System, found: Reference, kept: Array, t: Array, t_end: float) -> float:
    """See ``solve_rigid``. kept: of ``_withheld``, below which positions are rounding."""
    horizon, eps = t_end, float(np.finfo(float).eps)
    channels = system.tip_channel, *range(len(system.contacts))
    rounding = np.array([kept @ np.abs(system.channels[channel][0]) for channel in channels])
    scales = np.maximum(scales_of(found), rounding / APART)
    seen = list(zip(channels, watched(found).paths, scales, strict=True))
    slowest = np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(system.mass, system.stiffness))))
    slowest = slowest[slowest > 1e-6 * np.max(slowest, initial=0.0)]
    longest = APART * 2.0 * np.pi / float(np.min(slowest)) if len(slowest) else APART * t_end
    fastest = float(np.max(np.abs(found.states[1])))
    model: Model = found.solution.model
    rows, back = (x[at_rest(model)] for x in (model.rows, model.back.T))
    for seed, (radians, roundings) in enumerate(COPIES):
        off = (-1.0) ** np.arange(system.size)
        off -= back.T @ np.linalg.solve(rows @ back.T, rows @ off)  # what is written as at rest is at rest
        off[np.abs(off) < 16.0 * eps] = 0.0
        moved = replace(system, v0=system.v0 + roundings * eps * fastest * off)
        copy = Tracer(moved, radians, abs(roundings), seed).solve(t_end)
        q, v, _ = copy.at(t)
        for channel, path, scale in seen:
            wrong = np.abs(_seen(copy, t, q, v, channel)[0] - path) > APART * scale
            if np.any(wrong):
                horizon = min(horizon, float(t[max(0, int(np.argmax(wrong)) - 1)]))
        for c, record in enumerate(found.contacts):
            mine = record.impacts.times
            theirs = np.array([e.time for e in copy.events if e.contact == c])
            tolerance = min(longest, 0.5 * apart(max(len(mine), len(theirs)), t_end))
            # A copy of what starts at rest on a stop is thrown off it by its rounding of the speed.
            mine, theirs = mine[mine > tolerance], theirs[theirs > tolerance]
            n = min(len(mine), len(theirs))
            bad = np.flatnonzero(np.abs(mine[:n] - theirs[:n]) > tolerance)
            if len(bad):
                horizon = min(horizon, float(min(mine[bad[0]], theirs[bad[0]])))
            # One without a partner: more of a chatter comes at once.
            rest, last = np.concatenate([mine[n:], theirs[n:]]), mine[n - 1] if n else 0.0
            alone = rest[(rest > last + tolerance) & (rest < t_end - tolerance)]
            horizon = min(horizon, float(np.min(alone, initial=horizon)))
    return horizon


MOST_IMPACTS = 200_000


def rigid_limit(system: System, t_end: float, t_eval: Array | None = None) -> Reference:
    """Return the solution with the stops of a system's one contact made rigid, restitution 1, on a node with mass.

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
        Where a load presses the contact at rest on its stop, which no impact describes, and where the energy balance
        does not close.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system()
    >>> sb.rigid_limit(system, 0.2).impacts.count > 10
    True
    """
    begun = clock()
    require_system(system)
    t_end = positive("t_end", t_end)
    t_eval = None if t_eval is None else numbers("t_eval", t_eval)
    refuse(system, t_end)
    if len(system.contacts) != 1 or system.damped:
        raise InputError(
            "system",
            "a damped one, or not one contact",
            "be undamped with one contact for rigid stops",
            "take stiffbeam.reference, or a scheme for rigid stops",
        )
    if Drive.of(system).records:
        raise InputError(
            "time function",
            Drive.of(system).records[0],
            "be Harmonic or Constant for rigid stops",
            "take stiffbeam.reference, or a scheme for rigid stops",
        )
    if system.contacts[0].offset is not None:
        remedy = "take stiffbeam.reference, or a scheme for rigid stops"
        raise InputError("contact.offset", system.contacts[0].offset, "be None for rigid stops", remedy)
    with within_float64("rigid", t_end):
        return _solve(system, t_end, t_eval, begun)


def _solve(system: System, t_end: float, t_eval: Array | None, begun: float) -> Reference:
    row = system.contacts[0].row
    mass = 1.0 / float(row @ np.linalg.solve(system.mass, row))  # what the stop feels
    q, v = system.q0, system.v0
    if system.contacts[0].stops.state(row @ q):
        remedy = "start the contact point inside the gap"
        raise InputError("initial displacement", float(row @ q), "lie between rigid stops", remedy)
    regimes = Regimes(Source(system))
    q, v = regimes.start(q, v, t_end)  # alone: the loop ends where another regime would begin
    assert regimes.free is not None
    row = kick = regimes.free.force(row)  # M^-1 row in the modes
    table, K = regimes.table, regimes.table.sigma.shape[1]
    out = np.empty(1), np.empty(1, np.int64), np.empty((1, 1), np.int64), *np.empty((2, 1, K))
    sides, switched, unused = np.zeros(1, np.int64), np.zeros(1, np.int64), np.empty(system.size)
    found: list[tuple[Array, ...]] = []
    stops: list[int] = []
    impulses: list[float] = []
    t, evaluations = 0.0, 0
    while True:
        why, _, used, t = follow(table, t, t_end, q, v, unused, unused, sides, switched, QUIET, 0.0, *out, None)
        found.append(tuple(x.copy() for x in out))
        evaluations += used
        if why == DONE:
            break
        if len(found) > MOST_IMPACTS:
            raise InputError("t_end", t_end, f"hold at most {MOST_IMPACTS} impacts", f"end before t = {t:.6g}")
        approach = float(row @ v)
        if not int(sides[0]) * approach > 0.0:
            raise SolverFailure("rigid", t, "the contact is pressed on its stop without speed", "use compliant stops")
        v -= 2.0 * mass * approach * kick
        stops.append(int(sides[0]))
        impulses.append(2.0 * mass * abs(approach))
        sides[0] = 0
    times, regime, chi, x, y = (np.concatenate(z) for z in zip(*found, strict=True))
    solution = Motion(regimes, times, chi, regime, x, y, evaluations)
    audit(system, solution, t_end, "rigid")
    reference = reference_of(system, solution, t_end, t_eval, begun, "rigid", {})
    times = solution.times[1:]
    impacts = Impacts.at(times, stops, "event", ends=times, impulses=impulses)
    record = replace(
        reference.contacts[0],
        force=np.full(len(reference.t), np.nan),
        impacts=impacts,
        peak_force=float("nan") if len(times) else 0.0,
        impulse=float(np.sum(impulses)),
    )
    return replace(reference, contacts=(record,))
