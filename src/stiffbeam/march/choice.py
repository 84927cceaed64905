"""Choice of the march of a run and of the rule for its contact forces, and checks that the scheme supports them.

A block of K steps is a product with (R + D) x D numbers, D = k N for the k components that a scheme carries of N
unknowns, once the powers of one step are made. A single step is a few products with N x N matrices in Python.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..model.contact import Contact
from ..model.contact import linear as all_linear
from ..model.equations import Matrices
from ..model.modes import modes
from ..model.stage import BY_LAW, LINEAR, MEAN
from ..model.system import System
from ..model.time_functions import offset_values
from ..schemes import RigidScheme, Scheme
from ..trajectory.trajectory import SolverFailure
from .probe import Coordinates, InModes, independent

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


def takes_contact(scheme: Scheme, contact: str) -> bool:
    """Return True if a scheme takes this treatment of contact, see ``integrate``."""
    return contact != "conserving" or scheme.conserving is not None


def scheme_for(scheme: Scheme, contact: str) -> Scheme:
    """The scheme itself, or its form for contact="conserving". Raises InputError if it does not take this contact."""
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
        # A negative entry within the rounding of the largest one counts as zero.
        if np.any(own < -1e-12 * np.max(np.abs(own), initial=0.0)):
            rule = f"move the {name} of a node along with the force there, for stops whose force depends on velocity"
            raise InputError("scheme", str(scheme), rule, "use another scheme, or stops without damping")


def require_moved(scheme: Scheme, S: Array) -> None:
    """Raise InputError unless a force moves its node, s > 0, for stops with c > 0.

    Their force jumps at the stop. A node that yields to a force finds the one that holds it there. Another node
    evaluates F from a state, and rounding decides the result. S: (..., m, m).
    """
    if not np.all(np.diagonal(S, axis1=-2, axis2=-1) > 0.0):
        rule = "move every node by the force there, for stops with damping, whose force jumps"
        raise InputError("scheme", str(scheme), rule, "use another scheme, or stops with dissipation= in place of it")


def unsolved(scheme: Scheme, t: float) -> SolverFailure:
    """Error: the forces of several contacts at one node were not found."""
    reason = "the forces of several contacts at once were not found"
    return SolverFailure(str(scheme), t, reason, "use a smaller dt, or the solver cvode")


# Seconds, measured on one core: a product of matrices, of a matrix in cache and one out of it, per multiply-add.
MATRIX, CACHED, STREAMED = 1.2e-10, 1.5e-10, 5e-10
CACHE = 2.5e5  # numbers
CALLS, CALL = 3e-3, 5e-5  # of the set-up and of a node of a direct step: Python
MOST = 1 << 27  # numbers in the powers of a step: 1 GiB
LEAST, LONGEST = 32, 256  # force nodes of a block; more pay more for the contact than they save


def nodes_per_block(coordinates: Coordinates, scheme: Scheme) -> int:
    """Force nodes per block: more if the product with the transition is large, since all steps of a block share it."""
    return (
        LEAST if isinstance(coordinates, InModes) else int(np.clip(_carried(coordinates, scheme) / 4, LEAST, LONGEST))
    )


def pays(coordinates: Coordinates, scheme: Scheme, steps: int) -> bool:
    """Return True if blocks are faster than ``steps`` direct steps, including set-up; always True in modal
    coordinates."""
    if isinstance(coordinates, InModes):
        return True
    D, N, S = _carried(coordinates, scheme), coordinates.rows.shape[1], len(scheme.nodes)
    length = max(1, nodes_per_block(coordinates, scheme) // (S * max(1, len(coordinates.columns))))
    # Set-up: a product of D x D matrices for each doubling, and the probing of one step.
    levels = 2.0 + np.log2(length)
    work = float(D) ** 2 / length + float(D) * S * max(1, len(coordinates.columns))
    blocks = CALLS + MATRIX * (levels * float(D) ** 3 + 6.0 * S * D * float(N) ** 2)
    # Steps: a block reads its matrices once, from cache where D x D numbers fit into it.
    blocks += steps * work * (CACHED if float(D) ** 2 < CACHE else STREAMED)
    entries = coordinates.equation.entries if isinstance(coordinates.equation, Matrices) else 3.0 * float(N) ** 2
    # Single steps: one call and the entries of the factorised matrices for every node.
    direct = steps * S * (CALL + 1.5 * CACHED * entries)
    return levels * float(D) ** 2 <= MOST and blocks < direct


def _carried(coordinates: Coordinates, scheme: Scheme) -> int:
    """Number D of state components of a block."""
    return len(independent(scheme, coordinates.equation.order, 1.0)[0]) * coordinates.rows.shape[1]


def is_rigid(system: System, scheme: Scheme) -> bool:
    """Return True for a run on rigid stops. Raises InputError for options that such a run cannot have."""
    # A scheme with an impact law needs rigid stops; compliant and rigid stops take different marches.
    rigid = [contact.stops.rigid for contact in system.contacts]
    if isinstance(scheme, RigidScheme) and not all(rigid):
        stops = system.contacts[rigid.index(False)].stops
        remedy = "use a scheme for compliant stops, as trapezoidal, or give stiffness = inf"
        raise InputError("stops.stiffness", stops.stiffness, f"be inf for {scheme}", remedy)
    if any(rigid) and not all(rigid):
        raise InputError("contacts", "rigid and compliant ones", "be all of one kind", "take very stiff ones for inf")
    return isinstance(scheme, RigidScheme) or any(rigid)


def require_rigid(system: System, scheme: Scheme, contact: str) -> None:
    """Raise InputError if the scheme, the restitution of the stops, or the start do not fit together."""
    if contact != "implicit":
        raise InputError("contact", contact, "be 'implicit' for rigid stops", "a reaction is no function of positions")
    restitutes = isinstance(scheme, RigidScheme) and scheme.restitutes
    for each in system.contacts:
        e = each.stops.restitution
        if restitutes and e is None:
            remedy = "give the stops a restitution in [0, 1]"
            raise InputError("stops.restitution", e, f"be given for {scheme}, which has an impact law", remedy)
        if not restitutes and e is not None:
            rule = f"be left out for {scheme}, which has no impact law"
            raise InputError("stops.restitution", e, rule, "use moreau-jean, or leave it out")
        moved = float(offset_values(each.offset, 0.0))
        u = float(each.row @ system.q0) + moved
        if abs(each.stops.penetration(u)) > 1e-14 * max(abs(u), abs(moved)):  # what rounds u
            raise InputError("initial displacement", u, "lie between rigid stops", "move the stop or the start")
    if isinstance(scheme, RigidScheme) and scheme.modal_only and modes(system) is None:
        rule = f"decouple in the modes for {scheme}"
        raise InputError("damping", "a damping that couples modes", rule, "use moreau-jean")
