"""Systems with rigid stops: checks, contacts at the start, and simultaneous impacts whose order matters."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError, exact_value
from ..kernels.contact import solve_node
from ..model.contact import Contact
from ..model.sampled import Sampled
from ..model.system import System
from ..model.time_functions import covered, offset_values, parts_of, require_closed_form

REMEDY = "use a scheme with an impact law"
MOST_BLOWS = 1000  # of one order; what they have not settled by then is as good as settled, or has no end
SPENT = 1e-12  # of the fastest approach: a contact so slow is hit no more
LEFT = 1e-12  # of the distance between a stop and a start, relative: the start is on the stop
ALIKE = 1e-6  # of the largest impulse: orders that differ by less give one result


def require_rigid(system: System, t_end: float) -> None:
    """Raise InputError unless all stops are rigid with restitution, the contact rows are independent, and samples go on
    to t_end."""
    for contact in system.contacts:
        if not contact.stops.rigid:
            raise InputError("contacts", "rigid and compliant ones", "be all of one kind", "take stiff ones for inf")
        if contact.stops.restitution is None:
            remedy = "give one, or condense the contact node into a stop of its own stiffness K_bb"
            raise InputError("stops.restitution", None, "be given for rigid stops", remedy)
    covered(system.time_functions, t_end)
    rows = np.array([contact.row for contact in system.contacts])
    # Dependent rows make row M^-1 row^T singular: impulses and reactions would not be unique.
    least, most = np.linalg.eigvalsh(rows @ np.linalg.solve(system.mass, rows.T))[[0, -1]]
    if not least > 1e-12 * most:
        rule = "be independent of each other for rigid stops"
        remedy = "leave one out; stops on both sides of one row are one, Stops(lower=, upper=)"
        raise InputError("contacts", f"{len(rows)} that follow from each other", rule, remedy)


def require_smooth(system: System) -> None:
    """Raise InputError for functions of time other than Harmonic, Constant and Sampled, and for stops that move along a
    polygon: at its corners the contact point has no velocity."""
    require_closed_form(system.time_functions, "the exact solution with rigid stops", REMEDY)
    for part in (x for contact in system.contacts for x in parts_of(contact.offset)):
        if isinstance(part, Sampled) and part.degree < 2:
            rule = "have a velocity at its samples, where it moves a rigid stop"
            raise InputError("contact.offset", part, rule, 'take samples of kind "cubic"')


def order_decides(compliance: Array, e: Array, speeds: Array, sides: dict[int, int], pressed: set[int]) -> bool:
    """Return True if impacts in sequence, in two opposite orders, end differently from all of them at once.

    compliance: row M^-1 row^T (m, m). e: restitutions (m,). speeds: u' of every contact before (m,), 0 where it rests.
    sides: contacts that are on a stop at this time. pressed: those among them that a force holds there, which no change
    of the start within its rounding would open; they answer every blow at once.
    """
    at = sorted(sides)
    signs = np.array([sides[c] for c in at], float)
    # Speeds into the stops: positive where a contact approaches.
    A, e, w = np.outer(signs, signs) * compliance[np.ix_(at, at)], e[at], signs * speeds[at]
    held = np.array([c in pressed for c in at])
    # Without two contacts that may be hit apart, and one that approaches, there is no order.
    if np.count_nonzero(~held) < 2 or not np.any(w > 0.0):
        return False
    least = SPENT * float(np.max(np.abs(w)))

    def blow(w: Array, struck: Array) -> Array:
        # Held contacts pass blows on but do not rebound: their speed before counts as zero.
        law = np.array([[np.inf, -np.inf, 0.0 if hit else np.inf] for hit in struck])
        return solve_node((1.0 + e) * np.where(held & (w > -least), 0.0, w), A, law)

    # The result that the solver goes on with.
    together = blow(w, np.ones(len(at), bool))
    # One blow at a time, until no contact approaches.
    for order in (range(len(at)), range(len(at) - 1, -1, -1)):
        now, total = w.copy(), np.zeros(len(at))
        for _ in range(MOST_BLOWS):
            hit = next((i for i in order if now[i] > least), None)
            if hit is None:
                break
            P = blow(now, (held & (now > -least)) | (np.arange(len(at)) == hit))
            now, total = now + A @ P, total + P
        if np.max(np.abs(total - together)) > ALIKE * np.max(np.abs(together)):
            return True
    return False


def shift_at_start(contact: Contact) -> float:
    """The offset at t = 0."""
    return float(offset_values(contact.offset, np.zeros(1))[0])


def on_stops(system: System) -> dict[int, int]:
    """The contacts on their stops at t = 0, by their sides. Raises InputError for one beyond its stop."""
    closed = {}
    for contact, each in enumerate(system.contacts):
        moved = shift_at_start(each)
        u = float(each.row @ system.q0) + moved
        for side, g in each.stops.sides:
            # Within rounding of its stop a contact is on it, neither off nor beyond.
            if side * (u - g) >= -LEFT * max(abs(g), abs(moved)):
                if side * (u - g) > LEFT * max(abs(g), abs(moved)):
                    remedy = "move the stop or the start"
                    raise InputError("initial displacement", u, "lie between rigid stops", remedy)
                closed[contact] = side
    return closed


def beyond_stops(system: System) -> float:
    """The largest distance by which a contact starts beyond its stop, negative where all start between them."""
    places = [(each.stops, float(each.row @ system.q0) + shift_at_start(each)) for each in system.contacts]
    return max(side * (u - g) for stops, u in places for side, g in stops.sides)


def off_stop(system: System, contact: int, side: int) -> bool:
    """Tell whether the start, as it is written, is not exactly on the stop of a contact."""
    each = system.contacts[contact]
    ratio, pi = exact_value(each.stops.upper if side > 0 else each.stops.lower)  # type: ignore[arg-type]
    terms = zip(each.row.tolist(), system.q0.tolist(), strict=True)
    # Exact fractions of the numbers as written. What has a factor pi or an offset counts as off the stop.
    return pi or shift_at_start(each) != 0.0 or sum(Fraction(row) * Fraction(q) for row, q in terms) != ratio


def together_but_for_rounding(system: System, compliance: Array, closed: dict[int, int], going: dict[int, int]) -> bool:
    """Tell whether contacts that move each other start on their stops but for rounding, so that who is hit first is not
    known."""
    joined = {c for c in closed for x in going if c != x and compliance[c, x]}
    return any(off_stop(system, c, closed[c]) for c in joined | (going.keys() if joined else set()))


def at_rest(system: System) -> list[int]:
    """Contacts that start at rest on their stops as they are written, not but for rounding."""
    resting = []
    for contact, each in enumerate(system.contacts):
        still = each.offset is None and not np.any(each.row * system.v0)
        if still and not all(off_stop(system, contact, side) for side, _ in each.stops.sides):
            resting.append(contact)
    return resting
