"""What a motion is too little for: one that never moves, one without contact."""

from __future__ import annotations

from ..model.drive import stays_at_rest
from ..model.system import System
from ..trajectory.trajectory import Reference

AT_REST = (
    "Nothing moves: the system starts at rest and nothing drives it. Give it a base motion, a load or initial data."
)


def remark(system: System, reference: Reference) -> str:
    """One sentence where the motion of ``system`` stays at rest or touches no stop, else ""."""
    if stays_at_rest(system):
        return AT_REST
    if not reference.contacts or any(c.impacts.count or c.fraction for c in reference.contacts):
        return ""
    return f"No impacts: the motion reaches no stop to t = {system.units.measure(f'{reference.t[-1]:g}', 'time')}."
