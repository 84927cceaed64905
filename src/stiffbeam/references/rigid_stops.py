"""What a system must have for its solution between rigid stops, in float64 and in many digits alike."""

from __future__ import annotations

import numpy as np

from ..basics.validation import InputError
from ..model.system import System
from ..model.time_functions import covered


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
