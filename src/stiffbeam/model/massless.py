"""Contact nodes without mass: Signorini's condition as an ordinary System with compliant stops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..basics.validation import InputError, integer, one_of, sequence
from .contact import Contact
from .time_functions import Constant, Harmonic, LoadFunction, combined, parts, parts_of, require_closed_form

if TYPE_CHECKING:
    from .system import System

REDISTRIBUTIONS = ("neighbour", "renard")
DAMPINGS = ("none", "relaxed", "condensed")
ROUNDING = 1e-12  # of a sum of entries, relative to the largest
CONDENSE = "pass damping='condensed', which leaves it out of the contact"


def massless_contacts(
    system: System, redistribute: str = "neighbour", damping: str = "none", nodes: Sequence[int] | None = None
) -> System:
    """The system whose contact nodes b have no mass, condensed to its other unknowns i.

        K_bb q_b + K_bi q_i = f_b + W_b^T F,  u = W_b q_b + W_i q_i + o between the stops, F only where u is at one

    W has the rows of the contacts. The nodes are at rest under their forces, so that

        u = u_f + G F,  u_f = (W_i - S K_bi) q_i + S f_b + o,  S = W_b K_bb^-1,  G = S W_b^T.

    G is the compliance of the nodes. Where it is diagonal, no contact moves another, and F_c is the force of a stop of
    stiffness 1/G_cc that u_f meets; where the stop's own kappa is finite, both are in series, 1/(G_cc + 1/kappa):

        M_ii q_i'' + C_ii q_i' + (K_ii - K_ib K_bb^-1 K_bi) q_i = f_i - K_ib K_bb^-1 f_b + r^T F(r q_i + S f_b + o),
        r = W_i - S K_bi.

    A contact's position is therefore u_f, the position without the stop. The nodes themselves are at u_f less
    ``stops.penetration``, that is on the stop while it is pressed. No impact law is needed, so stops have no
    restitution. A row may read one node (a body and a wall), two nodes (rod on rod: two springs in series) or more (a
    point between nodes), and unknowns that keep their mass (a ball on a rod). Neighbouring nodes have a G that is not
    diagonal. Their forces solve a linear complementarity problem, which is not a law of scalar stops, so such contacts
    raise an error. An obstacle along a string, a rod or a surface has contacts at every second node: these interact
    only through nodes with mass.

    nodes: the unknowns without mass. None: all unknowns that contacts read and that stiffness couples to others. An
    unknown that is coupled to no other is a separate body and keeps its mass. Contacts that read none of the nodes are
    unchanged.

    redistribute: new place of the nodes' mass. "neighbour": the unknown to which each node is coupled most, M_jj +
    M_bb, for a mass matrix without coupling at b. "renard": the matrix M~ with the entries of M, none at b, that is
    nearest to M (sum of squares) among those with X^T M~ X = X^T M X. X = (1, x) for a beam, so mass, centre and
    inertia are kept; for matrices X are the motions without strain.

    damping: the damping that acts on the nodes. "none": no damping there. With C_bb > 0 a node has a first-order
    equation, and between contacts a state of its own, which a System cannot hold. If C_b = beta K_b, with one beta for
    all nodes of a contact, as in a body of one material, the nodes move the others by F alone, which is the force of a
    Kelvin-Voigt stop:

        u + beta u' = u_f + beta u_f' + G F      free: u - u_f decays with exp(-t/beta)
        F = -(kappa d + c d')_+,   d = u_f - g,   kappa = 1/G_cc,   c = beta/G_cc,   C_ii - C_ib C_bb^-1 C_bi for C_ii

    "relaxed": these stops, for u_f. The error is exp(-flight/beta), where flight is the time from the start or from a
    contact to the next contact, ``impacts.times[1:] - impacts.ends[:-1]``. It needs rigid stops, and Harmonic and
    Constant loads on the node. If flights are not long, leave the node a little of its mass and use restitution=0: the
    error is of first order in that mass. "condensed": no c, so contacts are without the node's damping; the motion
    between contacts keeps it; for any damping of the node.

    Raises InputError for contacts whose nodes move each other (neighbours, and several contacts at one node); a rigid
    stop on no node; damping of the node that ``damping`` does not allow; stops with a law that is not linear, or with
    restitution; a load on the node that is a bare callable; a mass that cannot be moved; and an ``observe`` that reads
    the node. Source: Khenous, Laborde and Renard, Eur. J. Mech. A 27 (2008) 918-932; the condensation is this module's
    own.
    """
    one_of("redistribute", redistribute, REDISTRIBUTIONS)
    one_of("damping", damping, DAMPINGS)
    # Which unknowns lose their mass, and whether stops, loads and ``observe`` allow it.
    if not system.contacts:
        raise InputError("system", "no contact", "have contacts for massless ones", "give the problem stops")
    rows = np.array([contact.row for contact in system.contacts])
    massless = _nodes(system, rows, nodes)
    inner = [i for i in range(system.size) if i not in massless]
    for c, contact in enumerate(system.contacts):
        _require_condensable(contact, c, bool(np.any(rows[c, massless])))
    _require_unseen(system, massless)
    # Nodes at rest under their forces. K_bb is symmetric: S is the transpose of one solution.
    K, held = system.stiffness, _held(system, massless)
    to_inner = -np.linalg.solve(held, K[np.ix_(massless, inner)])  # q_b from q_i, (b, i)
    lever = np.linalg.solve(held, rows[:, massless].T).T  # S
    compliance = lever @ rows[:, massless].T  # G
    light = np.abs(rows[:, massless])
    _require_independent(compliance, light @ np.abs(held) @ light.T > 0.0)
    if not inner:
        remedy = "refine the grid, or pass nodes= of one side of the contact"
        raise InputError("contacts", "all unknowns", "leave unknowns with mass", remedy)
    # Damping, mass and contacts of what stays.
    C, late = _damping(system, rows, massless, damping)
    mass = (_to_neighbours if redistribute == "neighbour" else _nearest)(system, massless)
    loads = [(p[massless], f) for p, f in system.loads]
    follow = rows[:, inner] + rows[:, massless] @ to_inner  # r
    # A contact that reads no node keeps its stops: its compliance in G is zero.
    contacts = tuple(
        _condensed(contact, row, to_node, float(node_compliance), float(beta), loads)
        if node_compliance
        else replace(contact, row=row)
        for contact, row, to_node, node_compliance, beta in zip(
            system.contacts, follow, lever, np.diag(compliance), late, strict=True
        )
    )
    # A condensed system is no beam on its grid, so it has no origin.
    return replace(
        system,
        mass=mass[np.ix_(inner, inner)],
        damping=C[np.ix_(inner, inner)],
        stiffness=K[np.ix_(inner, inner)] - to_inner.T @ (held @ to_inner),
        loads=tuple((p[inner] + p[massless] @ to_inner, f) for p, f in system.loads),
        contacts=contacts,
        observe=None if system.observe is None else system.observe[inner],
        q0=system.q0[inner],
        v0=system.v0[inner],
        origin=None,
    )


def _nodes(system: System, rows: Array, nodes: Sequence[int] | None) -> list[int]:
    """The unknowns without mass, in increasing order."""
    # Coupling counts beside both diagonals: what is stiff elsewhere must not hide a soft coupling.
    size = np.sqrt(np.diag(system.stiffness).clip(0.0))
    coupled = np.count_nonzero(np.abs(system.stiffness) > ROUNDING * np.outer(size, size), axis=1) > 1
    able = np.flatnonzero(np.any(rows != 0.0, axis=0) & (size > 0.0) & coupled).tolist()
    if not able:
        rule = "read an unknown that is coupled to others in stiffness and held by them"
        remedy = "put the stop at a node of the structure; a body of one unknown keeps its mass: restitution=e"
        raise InputError("contacts", "none that does", rule, remedy)
    massless = able
    if nodes is not None:
        rule = "hold unknowns that contacts read and stiffness couples to others"
        massless = sorted({integer("nodes", b, 0) for b in sequence("nodes", nodes, rule)})
        if not massless or not set(massless) <= set(able):
            raise InputError("nodes", nodes, rule, f"choose among {able}")
    return massless


def _require_condensable(contact: Contact, c: int, light: bool) -> None:
    """Raise InputError if the law of the stops of contact ``c`` does not fit; ``light``: it reads a node without
    mass."""
    stops = contact.stops
    if light and stops.restitution is not None:
        rule = "be left out for a massless contact, which has no velocity to turn round"
        raise InputError("stops.restitution", stops.restitution, rule, "leave restitution out of the Stops")
    if not light and stops.rigid:
        rule = "be finite where the contact reads no node without mass"
        remedy = "name one of its unknowns in nodes=, or give it a compliant stop"
        raise InputError(f"contacts[{c}].stops.stiffness", float(stops.stiffness), rule, remedy)
    if light and not stops.rigid:
        stops.require_linear("a massless contact")


def _require_unseen(system: System, nodes: list[int]) -> None:
    """Raise InputError for an ``observe`` and for loads that need the position of a node."""
    if system.observe is not None and np.any(system.observe[nodes]):
        rule = "not read a massless contact node, which is no linear function of the others"
        remedy = "dataclasses.replace(system, observe=None) makes .tip the first contact's position"
        raise InputError("observe", f"a row on {np.count_nonzero(system.observe)} unknowns", rule, remedy)
    acting = [function for vector, function in system.loads if np.any(vector[nodes])]
    require_closed_form(acting, "a load on a massless contact", "give samples of it")


def _held(system: System, nodes: list[int]) -> Array:
    """K_bb, where the others hold the nodes."""
    held = system.stiffness[np.ix_(nodes, nodes)]
    # Scaled to a diagonal of ones, so that stiff nodes do not hide a soft one.
    size = np.sqrt(np.diag(held))
    if not np.linalg.eigvalsh(held / np.outer(size, size))[0] > ROUNDING * len(nodes):
        rule = "hold the nodes without mass by unknowns that have mass"
        raise InputError(
            f"stiffness of the nodes {nodes}", "a motion without force", rule, "take contacts at every second node"
        )
    return held


def _require_independent(compliance: Array, linked: NDArray[np.bool_]) -> None:
    """Raise InputError for contacts that move each other, for which G is not diagonal; linked (contacts, contacts):
    whose nodes are coupled or the same."""
    size = np.sqrt(np.diag(compliance))
    pairs = np.argwhere(np.triu(np.abs(compliance) > ROUNDING * np.outer(size, size), 1))
    if not len(pairs):
        return
    # For the message: contacts that can stand together, the first ones first.
    apart: list[int] = []
    for c in range(len(compliance)):
        if not np.any(linked[c, apart]):
            apart.append(c)
    listed = ", ".join(map(str, apart[:4])) + (", ..." if len(apart) > 4 else "")
    rule = "be at nodes of their own that are not coupled: a force at one moves the other"
    remedy = f"take contacts whose nodes are not coupled, here {listed}, or join stops of one row"
    raise InputError(f"contacts {pairs[0, 0]} and {pairs[0, 1]}", "one beside the other", rule, remedy)


def _damping(system: System, rows: Array, nodes: list[int], damping: str) -> tuple[Array, Array]:
    """C (n, n) with nothing in the rows of the nodes, and beta (contacts,)."""
    C, beta = np.array(system.damping), np.zeros(system.size)
    for b in nodes:
        if damping != "condensed" and np.any(system.damping[b]):
            beta[b] = _relaxation_time(system, b, damping)
        # Eliminate the rate of a node without force. What earlier nodes have left of C_bb may be rounding of zero.
        if C[b, b] > ROUNDING * system.damping[b, b]:
            C -= np.outer(C[b], C[b]) / C[b, b]
    late = [_common(contact, beta[[b for b in nodes if contact.row[b]]]) for contact in system.contacts]
    return C, np.array(late)


def _relaxation_time(system: System, b: int, damping: str) -> float:
    """beta, with C_b = beta K_b at node b."""
    C, K = system.damping[b], system.stiffness[b]
    beta = float(C[b] / K[b])
    if np.max(np.abs(C - beta * K)) > ROUNDING * np.max(np.abs(C)):
        rule = "be 0 in the row of a massless contact, or a multiple of the stiffness"
        raise InputError(f"damping[{b}]", float(C[b]), rule, CONDENSE)
    if damping == "none":
        rule = "be 0 in the row of a massless contact, or be asked for"
        relax = f"pass damping='relaxed' where the flights between contacts are long against {beta:.3g}, or"
        raise InputError(f"damping[{b}]", float(C[b]), rule, f"{relax} {CONDENSE}")
    for vector, function in system.loads:
        if vector[b] and not all(isinstance(part, (Harmonic, Constant)) for part in parts_of(function)):
            rule = "be made of Harmonic and Constant where it acts on a damped massless contact"
            raise InputError("loads", function, rule, CONDENSE)
    return beta


def _common(contact: Contact, beta: Array) -> float:
    """The one beta of the nodes that a contact reads."""
    if not np.any(beta):
        return 0.0
    if np.ptp(beta) > ROUNDING * np.max(beta):
        rule = "be the same multiple of the stiffness at all nodes of a massless contact"
        raise InputError("damping", f"multiples {beta.min():.3g} and {beta.max():.3g}", rule, CONDENSE)
    if not contact.stops.rigid:
        rule = "be inf at a massless contact whose node is damped"
        raise InputError("stops.stiffness", float(contact.stops.stiffness), rule, CONDENSE)
    return float(beta[0])


def _late(part: LoadFunction, beta: float) -> LoadFunction:
    """Steady solution of y = f - beta y'."""
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
        if not coupling[j]:
            rule = "be coupled to an unknown with mass in stiffness, for redistribute='neighbour'"
            remedy = "refine the grid there, or pass nodes= of one side of the contact"
            raise InputError(f"unknown {b}", "a node coupled to other contact nodes only", rule, remedy)
        mass[j, j] += mass[b, b]
        mass[b, b] = 0.0
    return mass


def _nearest(system: System, nodes: list[int]) -> Array:
    """M~ = M - M_b + sum of P (X L X^T), P the entries of M that are left: the least change that keeps X^T M X."""
    X = _rigid_motions(system)
    if not np.all(np.any(np.abs(X[nodes]) > 1e-6 / math.sqrt(system.size), axis=1)):
        rule = "let every contact node move without strain: redistribute='renard' keeps that motion's inertia"
        raise InputError("stiffness", "a body that is held", rule, "use redistribute='neighbour'")
    kept = np.array(system.mass)
    kept[nodes], kept[:, nodes] = 0.0, 0.0
    # M~ may have entries only where the rest of M has them.
    pattern = (kept != 0.0).astype(float)
    lost = X.T @ (system.mass - kept) @ X
    # A symmetric multiplier L_ij and one equation for each pair of motions.
    pairs = [(i, j) for i in range(X.shape[1]) for j in range(i + 1)]
    units = [pattern * (np.outer(X[:, i], X[:, j]) + np.outer(X[:, j], X[:, i])) for i, j in pairs]
    matrix = np.array([[(X.T @ unit @ X)[i, j] for unit in units] for i, j in pairs])
    share = np.linalg.lstsq(matrix, np.array([lost[i, j] for i, j in pairs]))[0]
    nearest = kept + np.tensordot(share, np.array(units), 1)
    # Least squares give a result even where the entries have too little room.
    if not np.max(np.abs(X.T @ nearest @ X - X.T @ system.mass @ X)) <= 1e-9 * np.max(np.abs(X.T @ system.mass @ X)):
        remedy = "use redistribute='neighbour'"
        raise InputError("mass", "too few entries", "have room for the mass of the nodes", remedy)
    return nearest


def _rigid_motions(system: System) -> Array:
    """X (n, k), columns of size one: 1 and x of a beam's grid, else the motions without strain."""
    if system.form == "displacement" and system.cells:
        x = np.arange(1, system.size + 1) / system.cells
        return np.stack([np.ones_like(x), x], axis=1)
    # Motions without strain have squares that are zero to rounding.
    squares, vectors = scipy.linalg.eigh(system.stiffness)
    X = vectors[:, squares <= ROUNDING * system.size * squares[-1]]
    return X


def _condensed(
    contact: Contact,
    row: Array,
    to_node: Array,
    compliance: float,
    beta: float,
    loads: list[tuple[Array, LoadFunction]],
) -> Contact:
    """The contact at u_f = row q + offset, ``to_node`` its row of S; loads: on the nodes, with their functions."""
    # Node and stop in series: compliances add.
    stop_compliance = 0.0 if contact.stops.rigid else 1.0 / float(contact.stops.stiffness)
    stops = replace(contact.stops, stiffness=1.0 / (compliance + stop_compliance), damping=beta / compliance)
    terms: list[tuple[float, LoadFunction | None]] = [(1.0, contact.offset)]
    for vector, function in loads:
        # A load moves the node, and so the position that the stop meets.
        if moved := float(to_node @ vector):
            terms += [(moved * factor, _late(part, beta)) for factor, part in parts(function)]
    return Contact(row, stops, combined(*terms))
