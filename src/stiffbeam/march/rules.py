"""Which contact a run has: how its nodes find their forces, and what of it a scheme cannot do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..model.contact import Contact
from ..model.contact import linear as all_linear
from ..model.stage import BY_LAW, LINEAR, MEAN
from ..schemes import Scheme
from ..trajectory.trajectory import SolverFailure

CONTACTS = ("implicit", "extrapolated", "conserving")


def rule_of(contacts: Sequence[Contact], contact: str) -> int:
    """LINEAR, BY_LAW or MEAN, see stage. Raises InputError for laws that ``contact`` does not take."""
    if contact != "implicit":
        for each in contacts:
            if each.stops.dissipative:
                name = "damping" if each.stops.damping else "dissipation"
                why = {
                    "extrapolated": "be 0 for the extrapolated contact, which predicts positions only",
                    "conserving": "be 0 for the conserving contact, which keeps the energy of the stops",
                }[contact]
                raise InputError(f"stops.{name}", getattr(each.stops, name), why, "use the implicit contact")
    if contact == "conserving" and contacts:
        return MEAN
    return LINEAR if all_linear(contacts) else BY_LAW


def scheme_for(scheme: Scheme, contact: str) -> Scheme:
    """The scheme itself, or its form for contact="conserving". Raises InputError where it has none."""
    if contact != "conserving":
        return scheme
    if scheme.conserving is None:
        rule = f"conserve the energy of the linear system for the conserving contact, as {scheme} does not"
        remedy = "use trapezoidal or exponential-flow"
        raise InputError("scheme", str(scheme), rule, remedy)
    return scheme.conserving


def require_giving_way(scheme: Scheme, S: Array, S_rate: Array) -> None:
    """Raise InputError unless a force moves its node and speeds it up in its own direction: s, s' >= 0.

    Else a law that depends on the velocity may have no force, or several. S, S_rate: (..., m, m).
    """
    for name, x in (("position", S), ("velocity", S_rate)):
        own = np.diagonal(x, axis1=-2, axis2=-1)
        if np.any(own < -1e-12 * np.max(np.abs(own), initial=0.0)):
            rule = f"move the {name} of a node along with the force there, for stops whose force depends on velocity"
            raise InputError("scheme", str(scheme), rule, "use another scheme, or stops without damping")


def require_moved(scheme: Scheme, S: Array) -> None:
    """Raise InputError unless a force moves its node, s > 0, for stops with c > 0.

    Their force jumps at the stop. A node that gives way finds one that holds it there; another takes F of a state,
    and rounding says which. S: (..., m, m).
    """
    if not np.all(np.diagonal(S, axis1=-2, axis2=-1) > 0.0):
        rule = "move every node by the force there, for stops with damping, whose force jumps"
        raise InputError("scheme", str(scheme), rule, "use another scheme, or stops with dissipation= in place of it")


def unsolved(scheme: Scheme, t: float) -> SolverFailure:
    """The forces of several contacts at one node were not found."""
    reason = "the forces of several contacts at once were not found"
    return SolverFailure(str(scheme), t, reason, "use a smaller dt, or the solver cvode")
