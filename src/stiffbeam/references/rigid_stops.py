"""What a system must have for its solution between rigid stops, in float64 and in many digits alike."""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..model.active_set import solve_node
from ..model.system import System
from ..model.time_functions import covered

MOST_BLOWS = 1000  # of one order; what they have not settled by then is as good as settled, or has no end
SPENT = 1e-12  # of the fastest approach: a contact so slow is hit no more
ALIKE = 1e-6  # of the largest impulse: orders that differ by less give one result


def require_rigid(system: System, t_end: float) -> None:
    """Raise InputError unless all stops are rigid with restitution, no contact follows from the others, and samples
    go on to t_end."""
    for contact in system.contacts:
        if not contact.stops.rigid:
            raise InputError("contacts", "rigid and compliant ones", "be all of one kind", "take stiff ones for inf")
        if contact.stops.restitution is None:
            remedy = "give the stops a restitution, or take the mass of the contact nodes away (massless_contacts)"
            raise InputError("stops.restitution", None, "be given for rigid stops", remedy)
    covered([*(f for _, f in system.loads), *(offset for _, offset in system.channels)], t_end)
    rows = np.array([contact.row for contact in system.contacts])
    least, most = np.linalg.eigvalsh(rows @ np.linalg.solve(system.mass, rows.T))[[0, -1]]
    if not least > 1e-12 * most:
        rule = "be independent of each other for rigid stops"
        raise InputError("contacts", f"{len(rows)} that follow from each other", rule, "leave one out")


def order_decides(compliance: Array, e: Array, speeds: Array, sides: dict[int, int], pressed: set[int]) -> bool:
    """Return whether blows one after the other, in two opposite orders, end otherwise than all of them at once.

    compliance: row M^-1 row^T (m, m). e: restitutions (m,). speeds: u' of every contact before (m,), 0 where it rests.
    sides: contacts that are on a stop at this time. pressed: those among them that a force holds there, which no change
    of the start within its rounding would open; they answer every blow at once.
    """
    at = sorted(sides)
    signs = np.array([sides[c] for c in at], float)
    A, e, w = np.outer(signs, signs) * compliance[np.ix_(at, at)], e[at], signs * speeds[at]
    held = np.array([c in pressed for c in at])
    if np.count_nonzero(~held) < 2 or not np.any(w > 0.0):
        return False
    least = SPENT * float(np.max(np.abs(w)))

    def blow(w: Array, struck: Array) -> Array:
        law = np.array([[np.inf, -np.inf, 0.0 if hit else np.inf] for hit in struck])
        return solve_node((1.0 + e) * np.where(held & (w > -least), 0.0, w), A, law)

    together = blow(w, np.ones(len(at), bool))
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
