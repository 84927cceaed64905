"""Contact nodes without mass: Signorini's condition as an ordinary System with compliant stops."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg

from ..basics.arrays import Array
from ..basics.validation import InputError, one_of
from .contact import Contact
from .offsets import combined
from .time_functions import Constant, Harmonic, LoadFunction, in_closed_form, parts, parts_of

if TYPE_CHECKING:
    from .system import System

REDISTRIBUTIONS = ("neighbour", "renard")
DAMPINGS = ("none", "relaxed", "condensed")
ROUNDING = 1e-12  # of a sum of entries, relative to the largest


def massless_contacts(system: System, redistribute: str = "neighbour", damping: str = "none") -> System:
    """The system whose contact nodes b have no mass, condensed to its other unknowns i.

        K_bb q_b + K_bi q_i = f_b + s F,  u = s q_b + o between the stops, F only where it is at one   (row = s e_b)

    The node is at rest under its forces, so u = u_f + s^2 F/K_bb with u_f = s (f_b - K_bi q_i)/K_bb + o, and F is
    that of a stop of stiffness kappa = K_bb/s^2 met by u_f; in series with the stop's own, 1/kappa_b = s^2/K_bb +
    1/kappa, where that is finite:

        M_ii q_i'' + C_ii q_i' + (K_ii - K_ib K_bi/K_bb) q_i = f_i - K_ib f_b/K_bb + r^T F(r q_i + o + s f_b/K_bb),
        r = -s K_bi/K_bb.

    So a contact's position is u_f, what the node would have without the stop; the node itself is at
    ``stops.penetration`` less, on the stop while it is pressed. No impact law is needed: stops have no restitution.

    redistribute: where the mass of the nodes goes. "neighbour": to the unknown that each is coupled to most,
    M_jj + M_bb, for a mass matrix without coupling at b. "renard": the matrix M~ with the entries of M, none at b,
    that is nearest to M (sum of squares) among those with X^T M~ X = X^T M X, X = (1, x) for a beam, so that mass,
    centre and inertia are kept, and the motions without strain for matrices.

    damping: what acts on the nodes. "none": nothing. With C_bb > 0 a node has a first-order equation, and between
    contacts a state of its own, for which a System has no place. Where it is that of a material, C_b = beta K_b with
    beta = C_bb/K_bb, the node moves the others by F alone, and that is the force of a Kelvin-Voigt stop:

        u + beta u' = u_f + beta u_f' + s^2 F/K_bb      free: u - u_f decays with exp(-t/beta)
        F = -(kappa d + c d')_+,   d = u_f - g,   kappa = K_bb/s^2,   c = C_bb/s^2,   C_ii - C_ib C_bi/C_bb for C_ii

    "relaxed": these stops, met by u_f. It is exact but for exp(-flight/beta), flight the time from the start or from a
    contact to the next one, ``impacts.times[1:] - impacts.ends[:-1]``; for rigid stops, and Harmonic and Constant
    loads on the node. Where flights are not long, leave the node a little of its mass and take restitution=0: the
    error is of first order in that mass. "condensed": no c, so that a contact is without the node's damping; what is
    between contacts stays; for any damping of the node.

    Raises InputError for a contact that is not at one unknown of its own; damping of the node that ``damping`` does
    not take; contact nodes beside each other; stops with a law that is not linear, or with restitution; a load on the
    node that is a bare callable; a mass that cannot be moved; and where ``observe`` reads the node.
    Source: Khenous, Laborde and Renard, Eur. J. Mech. A 27 (2008) 918-932; the condensation is this module's own.
    """
    one_of("redistribute", redistribute, REDISTRIBUTIONS)
    one_of("damping", damping, DAMPINGS)
    if not system.contacts:
        raise InputError("system", "no contact", "have contacts for massless ones", "give the problem stops")
    nodes = [_node(contact) for contact in system.contacts]
    for b in nodes:
        _require_condensable(system, nodes, b)
    C, drag = _drag(system, nodes, damping)
    mass = (_to_neighbours if redistribute == "neighbour" else _nearest)(system, nodes)
    inner = [i for i in range(system.size) if i not in nodes]
    K, held = system.stiffness, system.stiffness[nodes, nodes]
    to_inner = -K[np.ix_(nodes, inner)] / held[:, None]  # q_b from q_i, (contacts, inner)
    contacts = tuple(
        _condensed(system, contact, b, float(c), follow)
        for contact, b, c, follow in zip(system.contacts, nodes, drag, to_inner, strict=True)
    )
    return replace(
        system,
        mass=mass[np.ix_(inner, inner)],
        damping=C[np.ix_(inner, inner)],
        stiffness=K[np.ix_(inner, inner)] - to_inner.T @ (held[:, None] * to_inner),
        loads=tuple((p[inner] + p[nodes] @ to_inner, f) for p, f in system.loads),
        contacts=contacts,
        observe=None if system.observe is None else system.observe[inner],
        q0=system.q0[inner],
        v0=system.v0[inner],
        origin=None,
    )


def _node(contact: Contact) -> int:
    """The one unknown that a contact's row reads."""
    at = np.flatnonzero(contact.row)
    if len(at) != 1:
        remedy = "put the stop at a node of the grid, or change the unknowns so that the contact point is one"
        raise InputError("contact.row", contact.row, "read one unknown for a massless contact", remedy)
    return int(at[0])


def _require_condensable(system: System, nodes: list[int], b: int) -> None:
    contact = system.contacts[nodes.index(b)]
    stops, others = contact.stops, np.arange(system.size) != b
    if stops.restitution is not None:
        rule = "be left out for a massless contact, which has no velocity to turn round"
        raise InputError("stops.restitution", stops.restitution, rule, "leave restitution out of the Stops")
    if not stops.rigid:
        stops.require_linear("a massless contact")
    if nodes.count(b) > 1:
        remedy = "join their stops into one"
        raise InputError("contacts", f"several at unknown {b}", "be at unknowns of their own", remedy)
    if np.any(system.stiffness[b, [x for x in nodes if x != b]]):
        rule = "have no other contact node coupled to it in stiffness"
        raise InputError(f"unknown {b}", "a contact node beside another", rule, "refine the grid between the contacts")
    if not system.stiffness[b, b] > 0.0:
        remedy = "add stiffness at the node"
        raise InputError(f"stiffness[{b}, {b}]", float(system.stiffness[b, b]), "be > 0: the node must be held", remedy)
    if system.observe is not None and system.observe[b]:
        rule = "not read a massless contact node, which is no linear function of the others"
        raise InputError("observe", system.observe, rule, "leave it out: .tip is then the first contact's position")
    for vector, function in system.loads:
        if vector[b] and not in_closed_form(function):
            rule = "be made of Harmonic, Constant and Sampled where it acts on a massless contact"
            raise InputError("loads", function, rule, "give samples of it")
    if not np.any(system.stiffness[b, others]):
        remedy = "put the contact on a node of the structure"
        raise InputError(f"unknown {b}", "a node coupled to nothing", "be coupled to others in stiffness", remedy)


def _drag(system: System, nodes: list[int], damping: str) -> tuple[Array, Array]:
    """C (n, n) with nothing in the rows of the nodes, and the damping of each node's stop (contacts,)."""
    C, drag = np.array(system.damping), np.zeros(len(nodes))
    for i, (b, contact) in enumerate(zip(nodes, system.contacts, strict=True)):
        if np.any(system.damping[b]):
            if damping != "condensed":
                _require_a_material(system, b, contact, damping)
                drag[i] = system.damping[b, b]
            if C[b, b] > ROUNDING * system.damping[b, b]:
                C -= np.outer(C[b], C[b]) / C[b, b]
    return C, drag


def _require_a_material(system: System, b: int, contact: Contact, damping: str) -> None:
    C, K = system.damping[b], system.stiffness[b]
    beta, condense = float(C[b] / K[b]), "pass damping='condensed', which leaves it out of the contact"
    if np.max(np.abs(C - beta * K)) > ROUNDING * np.max(np.abs(C)):
        rule = "be 0 in the row of a massless contact, or a multiple of the stiffness"
        raise InputError(f"damping[{b}]", float(C[b]), rule, condense)
    if damping == "none":
        rule = "be 0 in the row of a massless contact, or be asked for"
        relax = f"pass damping='relaxed' where the flights between contacts are long against {beta:.3g}, or"
        raise InputError(f"damping[{b}]", float(C[b]), rule, f"{relax} {condense}")
    if not contact.stops.rigid:
        rule = "be inf at a massless contact whose node is damped"
        raise InputError("stops.stiffness", float(contact.stops.stiffness), rule, condense)
    for vector, function in system.loads:
        if vector[b] and not all(isinstance(part, (Harmonic, Constant)) for part in parts_of(function)):
            rule = "be made of Harmonic and Constant where it acts on a damped massless contact"
            raise InputError("loads", function, rule, condense)


def _late(part: LoadFunction, beta: float) -> LoadFunction:
    """What y = f - beta y' settles to."""
    if not beta or not isinstance(part, Harmonic):
        return part
    turned = beta * float(part.frequency)
    return Harmonic(part.amplitude / math.hypot(1.0, turned), part.frequency, part.phase - math.atan(turned))


def _to_neighbours(system: System, nodes: list[int]) -> Array:
    """The mass of each node at the unknown to which its stiffness couples it most."""
    mass = np.array(system.mass)
    for b in nodes:
        coupling = np.abs(system.stiffness[b])
        coupling[nodes] = 0.0
        others = np.delete(mass[b], b)
        if np.any(others):
            rule = "be 0 beside the diagonal in the row of a massless contact, for redistribute='neighbour'"
            remedy = "use redistribute='renard' or lump the mass"
            raise InputError(f"mass[{b}]", float(np.max(np.abs(others))), rule, remedy)
        j = int(np.argmax(coupling))
        mass[j, j] += mass[b, b]
        mass[b, b] = 0.0
    return mass


def _nearest(system: System, nodes: list[int]) -> Array:
    """M~ = M - M_b + sum of P (X L X^T), P the entries of M that are left: the least change that keeps X^T M X."""
    X = _rigid_motions(system)
    kept = np.array(system.mass)
    kept[nodes], kept[:, nodes] = 0.0, 0.0
    pattern = (kept != 0.0).astype(float)
    lost = X.T @ (system.mass - kept) @ X
    pairs = [(i, j) for i in range(X.shape[1]) for j in range(i + 1)]
    units = [pattern * (np.outer(X[:, i], X[:, j]) + np.outer(X[:, j], X[:, i])) for i, j in pairs]
    matrix = np.array([[(X.T @ unit @ X)[i, j] for unit in units] for i, j in pairs])
    share = np.linalg.lstsq(matrix, np.array([lost[i, j] for i, j in pairs]))[0]
    found = kept + np.tensordot(share, np.array(units), 1)
    if not np.max(np.abs(X.T @ found @ X - X.T @ system.mass @ X)) <= 1e-9 * np.max(np.abs(X.T @ system.mass @ X)):
        remedy = "use redistribute='neighbour'"
        raise InputError("mass", "too few entries", "have room for the mass of the nodes", remedy)
    return found


def _rigid_motions(system: System) -> Array:
    """X (n, k), columns of size one: 1 and x of a beam's grid, else the motions without strain."""
    if system.form == "displacement" and system.cells:
        x = np.arange(1, system.size + 1) / system.cells
        return np.stack([np.ones_like(x), x], axis=1)
    squares, vectors = scipy.linalg.eigh(system.stiffness)
    X = vectors[:, squares <= ROUNDING * system.size * squares[-1]]
    if not X.shape[1]:
        rule = "have motions without strain, whose inertia redistribute='renard' keeps"
        raise InputError("stiffness", "a system that is held", rule, "use redistribute='neighbour'")
    return X


def _condensed(system: System, contact: Contact, b: int, drag: float, follow: Array) -> Contact:
    s, held = float(contact.row[b]), float(system.stiffness[b, b])
    own = 0.0 if contact.stops.rigid else 1.0 / float(contact.stops.stiffness)
    stops = replace(contact.stops, stiffness=1.0 / (s * s / held + own), damping=drag / (s * s))
    terms: list[tuple[float, LoadFunction | None]] = [(1.0, contact.offset)]
    for p, f in ((p, f) for p, f in system.loads if p[b]):
        terms += [(s * float(p[b]) / held * factor, _late(part, drag / held)) for factor, part in parts(f)]
    return Contact(s * follow, stops, combined(*terms))
