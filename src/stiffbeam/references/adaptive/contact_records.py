"""From the switches that an adaptive solver saw to what happened at a contact."""

from __future__ import annotations

import numpy as np

from ...basics.arrays import Array
from ...model.contact import Stops
from ...model.contact_law import Law
from ...trajectory.impacts import COLUMNS, ContactRecord, Impacts
from ...trajectory.sampling import side_at_start, switch_time
from .restarts import Contacts
from .rhs import RightHandSide


def contact_record(
    rhs: RightHandSide,
    i: int,
    t: Array,
    position: Array,
    velocity: Array,
    contacts: Contacts | None,
    end: Array,
    t_end: float,
) -> ContactRecord:
    """Contact ``i``: by its switches where the solver has roots, else sampled at the output times t.

    Impulses are integrals that the solver carries, peaks the largest of the forces where the rate of the gap, of a
    damped stop that of the force, is zero or jumps: both as accurate as the motion. A peak is NaN where the solver saw
    no such place between entry and exit, the impulse where it carries one with a sign and saw no switches.
    """
    stops = rhs.first_order.contacts[i].contact.stops
    force = stops.force(position, velocity)
    if contacts is None:
        total = np.nan if rhs.signed else float(end[rhs.states + 2 + i])
        found, share = _sampled(t, position, velocity, stops)
        return ContactRecord(
            stops, position, velocity, force,
            found,
            fraction=share if t[0] == 0.0 and t[-1] == t_end else np.nan,
            peak_force=float(np.max(np.abs(force))),
            impulse=total,
        )  # fmt: skip
    spans: list[tuple[float, float, int, float, float]] = []  # of impacts: time, end, side, peak, impulse
    closed_time, largest, total = 0.0, 0.0, 0.0
    for k, (contact, side) in enumerate(rhs.sides):
        if contact != i:
            continue
        exits = contacts.exits[k]
        for n, (entry, z, at_entry) in enumerate(contacts.entries[k]):
            left, z_left, at_exit = exits[n] if n < len(exits) else (t_end, end, rhs.pressing(t_end, end, k))
            own = max((value for when, value in contacts.peaks[k] if entry <= when <= left), default=float("nan"))
            if stops.jumps:  # the force of a stop with c > 0 may be largest where it begins
                own = float(np.nanmax([own, at_entry, at_exit]))
            ended = n < len(exits)
            closed_time += left - entry
            largest = np.nanmax([largest, own, at_entry, at_exit])
            impulse = side * float(z_left[rhs.states + 2 + i] - z[rhs.states + 2 + i])
            total += impulse
            nan = np.nan
            spans.append((entry, left, side, own, impulse) if ended else (entry, nan, side, nan, nan))
    spans.sort(key=lambda span: span[0])
    columns = np.array(spans).reshape(-1, len(COLUMNS)).T
    return ContactRecord(
        stops=stops,
        position=position,
        velocity=velocity,
        force=force,
        impacts=Impacts.at(columns[0], columns[2], "event", ends=columns[1], peaks=columns[3], impulses=columns[4]),
        fraction=closed_time / t_end,
        peak_force=float(largest),
        impulse=total,
    )


def _sampled(t: Array, u: Array, v: Array, stops: Stops) -> tuple[Impacts, float]:
    """The sampled impacts at output times that need not be equidistant, and the share of the time in contact."""
    chi = stops.state(u, v)
    chi[0] = side_at_start(u[0], v[0], stops.law)
    law = Law(*stops.law)

    def switch(k: int, side: int) -> float:
        length = float(t[k] - t[k - 1])
        return float(t[k - 1]) + length * switch_time(u[k - 1], v[k - 1], u[k], v[k], side, law, length)

    changes = (np.flatnonzero(chi[1:] != chi[:-1]) + 1).tolist()
    spans, closed = [], 0.0
    for a, b in zip([0, *changes], [*changes, None], strict=True):
        if side := int(chi[a]):
            begin, end = switch(a, side) if a else float(t[0]), np.nan if b is None else switch(b, side)
            closed += (float(t[-1]) if b is None else end) - begin
            spans += [(begin, end, side)] if a or t[0] == 0.0 else []
    times, ends, hit = np.array(spans).reshape(-1, 3).T
    return Impacts.at(times, hit, "sampled", ends=ends).started(times == 0.0), closed / float(t[-1] - t[0])
