"""From the switches that an adaptive solver saw to what happened at a contact."""

from __future__ import annotations

import numpy as np

from ...basics.arrays import Array
from ...model.right_hand_side import RightHandSide
from ...trajectory.impacts import COLUMNS, ContactRecord, Impacts
from ...trajectory.recorder import contact_spans
from .restarts import Contacts


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
    """Contact ``i``: by its events where these were asked for, else sampled at the output times t.

    Impulses are integrals that the solver carries, peaks the largest of the forces where the rate of the gap, of a
    damped stop that of the force, is zero or jumps: both as accurate as the motion. A peak is NaN where the solver saw
    no such place between entry and exit, the impulse where no events were asked for: it has a sign on each stop.
    """
    stops = rhs.first_order.contacts[i].contact.stops
    force = stops.force(position, velocity)
    if contacts is None:
        spans = contact_spans(t, position, velocity, stops)
        first, _, begins, exits, sides, _ = spans.T
        closed_time = float(np.sum(np.where(np.isnan(exits), t[-1], exits) - begins))
        counted = (first > 0.0) | (t[0] == 0.0)
        return ContactRecord(
            stops, position, velocity, force,
            Impacts.at(begins[counted], sides[counted], "sampled", ends=exits[counted]).started(first[counted] == 0.0),
            fraction=closed_time / t_end if t[0] == 0.0 and t[-1] == t_end else np.nan,
            peak_force=float(np.max(np.abs(force))),
            impulse=float("nan"),
        )  # fmt: skip
    impacts: list[tuple[float, float, int, float, float]] = []  # time, end, side, peak, impulse
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
            impacts.append((entry, left, side, own, impulse) if ended else (entry, nan, side, nan, nan))
    impacts.sort(key=lambda impact: impact[0])
    columns = np.array(impacts).reshape(-1, len(COLUMNS)).T
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
