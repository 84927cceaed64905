"""Systems with rigid stops: checks, and contacts at the start."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from ..basics.validation import InputError, exact_value
from ..model.contact import Contact
from ..model.system import System
from ..model.time_functions import Sampled, covered, offset_values, parts_of, require_closed_form

REMEDY = "use a scheme with an impact law"
LEFT = 1e-12  # of the distance between a stop and a start, relative: the start is on the stop


def require_rigid(system: System, t_end: float) -> None:
    """Raise InputError unless all stops are rigid with restitution, the contact rows are independent, and functions of
    time are Harmonic, Constant and Sampled to t_end; for stops that move along a polygon, too: at its corners the
    contact point has no velocity."""
    for contact in system.contacts:
        if not contact.stops.rigid:
            raise InputError("contacts", "rigid and compliant ones", "be all of one kind", "take stiff ones for inf")
        if contact.stops.restitution is None:
            remedy = "give one, or condense the contact node into a stop of its own stiffness K_bb"
            raise InputError("stops.restitution", None, "be given for rigid stops", remedy)
    covered(system.time_functions, t_end)
    require_closed_form(system.time_functions, "the exact solution with rigid stops", REMEDY)
    for part in (x for contact in system.contacts for x in parts_of(contact.offset)):
        if isinstance(part, Sampled) and part.degree < 2:
            rule = "have a velocity at its samples, where it moves a rigid stop"
            raise InputError("contact.offset", part, rule, 'take samples of kind "cubic"')
    rows = np.array([contact.row for contact in system.contacts])
    # Dependent rows make row M^-1 row^T singular: impulses and reactions would not be unique.
    least, most = np.linalg.eigvalsh(rows @ np.linalg.solve(system.mass, rows.T))[[0, -1]]
    if not least > 1e-12 * most:
        rule = "be independent of each other for rigid stops"
        remedy = "leave one out; stops on both sides of one row are one, Stops(lower=, upper=)"
        raise InputError("contacts", f"{len(rows)} that follow from each other", rule, remedy)


def shift_at_start(contact: Contact) -> float:
    """The offset at t = 0."""
    return float(offset_values(contact.offset, np.zeros(1))[0])


def on_stops(system: System) -> dict[int, int]:
    """The contacts on their stops at t = 0, by their sides. Raises InputError for one beyond its stop."""
    closed = {}
    for contact, each in enumerate(system.contacts):
        moved = shift_at_start(each)
        u = float(each.row @ system.q0) + moved
        # A start that is a state of a motion is beyond a stop that holds it by the rounding of the whole state.
        whole = float(np.sum(np.abs(each.row))) * float(np.max(np.abs(system.q0)))
        for side, g in each.stops.sides:
            # Within rounding of its stop a contact is on it, neither off nor beyond.
            if side * (u - g) >= -LEFT * max(abs(g), abs(moved)):
                if side * (u - g) > LEFT * max(abs(g), abs(moved), whole):
                    remedy = "move the stop or the start"
                    raise InputError("initial displacement", u, "lie between rigid stops", remedy)
                closed[contact] = side
    return closed


def resting(system: System) -> tuple[list[int], list[int]]:
    """Contacts that start on their stops as they are written, not but for rounding, and those of them at rest there."""
    on = []
    for i, side in on_stops(system).items():
        contact = system.contacts[i]
        ratio, pi = exact_value(contact.stops.upper if side > 0 else contact.stops.lower)  # type: ignore[arg-type]
        terms = zip(contact.row.tolist(), system.q0.tolist(), strict=True)
        # Exact fractions of the numbers as written. What has a factor pi or an offset counts as off the stop.
        if not pi and not shift_at_start(contact) and sum(Fraction(row) * Fraction(q) for row, q in terms) == ratio:
            on.append(i)
    still = [i for i in on if system.contacts[i].offset is None and not np.any(system.contacts[i].row * system.v0)]
    return on, still
