"""Treatments of contact: which force of a stop acts in a step, and the stops and schemes that each treatment serves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..kernels.library import BY_LAW, LINEAR, MEAN
from ..model.contact import on_rigid_stops
from ..model.system import System
from ..schemes import RIGID as RIGID_SCHEMES
from ..schemes import RigidScheme, Scheme

RIGID = -1  # the rule of rigid stops: reactions by complementarity


@dataclass(frozen=True)
class Treatment:
    """Force of a stop that acts in a step: treatments differ in it, and so in the stops and the schemes that they take.

        "implicit"      at a node, from the position and the velocity there, v = r + s F(v, v')
        "extrapolated"  F at the position that the scheme ``predicts`` from known values, as in the paper
        "conserving"    the mean force over the step, ``means``, that keeps the energy of system and stops:
                        F = -(U(u+) - U(u0))/(u+ - u0), u+ = r + s F, u0 where the step begins

    That F does the work F (u+ - u0) = U(u0) - U(u+) whatever the step is. A scheme which conserves the energy of the
    linear system under a constant force therefore conserves the sum of both. U is convex, so there is one F. Source:
    Gonzalez, J. Nonlinear Sci. 6 (1996) 449-467; Simo and Tarnow, ZAMP 43 (1992) 757-792.
    """

    name: str
    predicts: bool = False
    means: bool = False

    def rule(self, system: System, scheme: Scheme) -> int:
        """RIGID, or how a node finds its forces: LINEAR, BY_LAW or MEAN. Raises InputError for stops and a start that
        do not fit the treatment or the scheme."""
        contacts, rigid = system.contacts, [contact.stops.rigid for contact in system.contacts]
        if any(rigid) and not all(rigid):
            remedy = "take very stiff ones for inf"
            raise InputError("contacts", "rigid and compliant ones", "be all of one kind", remedy)
        if isinstance(scheme, RigidScheme):
            if not all(rigid):
                remedy = "use a scheme for compliant stops, as Trapezoidal, or give stiffness = inf"
                raise InputError("stops.stiffness", contacts[0].stops.stiffness, f"be inf for {scheme}", remedy)
            if self.name != "implicit":
                rule = "be 'implicit' for rigid stops, whose reaction is no function of positions"
                raise InputError("contact", self.name, rule, "leave it out")
            _require_rigid(system, scheme)
            return RIGID
        if any(rigid):
            rule = f"be finite for {scheme}, which has no impact law"
            have = ", ".join(f"{name}()" for name, kind in RIGID_SCHEMES.items() if kind().restitutes)
            raise InputError("stops.stiffness", np.inf, rule, f"use {have}, or a large finite stiffness")
        for stops in (contact.stops for contact in contacts if self.name != "implicit"):
            if stops.law.damps:
                name = "damping" if stops.damping else "dissipation"
                why = "keeps the energy of the stops" if self.means else "predicts positions only"
                rule = f"be 0 for the {self.name} contact, which {why}"
                raise InputError(f"stops.{name}", getattr(stops, name), rule, "use the implicit contact")
        if self.means and contacts:
            return MEAN
        # The search for several linear springs ends for a symmetric compliance, which gyroscopic terms do not leave.
        linear = all(contact.stops.linear for contact in contacts)
        return LINEAR if linear and not (len(contacts) > 1 and system.gyroscopic) else BY_LAW

    def form_of(self, scheme: Scheme) -> Scheme | None:
        """Return the form of the scheme for this treatment, None where it has none: a mean force takes one that
        conserves the energy of the linear system under a constant force."""
        return scheme.conserving if self.means else scheme


_ALL = Treatment("implicit"), Treatment("extrapolated", predicts=True), Treatment("conserving", means=True)
TREATMENTS = {treatment.name: treatment for treatment in _ALL}


def _require_rigid(system: System, scheme: RigidScheme) -> None:
    """Raise InputError if the scheme, the restitution of rigid stops, or the start do not fit together."""
    for each in system.contacts:
        e = each.stops.restitution
        if scheme.restitutes and e is None:
            remedy = "give the stops a restitution in [0, 1]"
            raise InputError("stops.restitution", e, f"be given for {scheme}, which has an impact law", remedy)
        if not scheme.restitutes and e is not None:
            rule = f"be left out for {scheme}, which has no impact law"
            raise InputError("stops.restitution", e, rule, "use MoreauJean, or leave it out")
    on_rigid_stops(system.contacts, system.q0)


def require_giving_way(scheme: Scheme, S: Array, S_rate: Array) -> None:
    """Raise InputError unless a force moves its node and speeds it up in its own direction: s, s' >= 0.

    Else a law that depends on the velocity may have no force, or several. S, S_rate: (..., m, m).
    """
    for name, x in (("position", S), ("velocity", S_rate)):
        own = np.diagonal(x, axis1=-2, axis2=-1)
        # A negative entry within the rounding of the largest one counts as zero.
        if np.any(own < -1e-12 * np.max(np.abs(own), initial=0.0)):
            rule = (
                f"change the {name} of a contact in the direction of its force, for stops with damping or dissipation"
            )
            raise InputError("scheme", str(scheme), rule, "use another scheme, or stops without damping")


def require_moved(scheme: Scheme, S: Array) -> None:
    """Raise InputError unless a force moves its node, s > 0, for stops with c > 0.

    Their force jumps at the stop. A node that yields to a force finds the one that holds it there. Another node
    evaluates F from a state, and rounding decides the result. S: (..., m, m).
    """
    if not np.all(np.diagonal(S, axis1=-2, axis2=-1) > 0.0):
        rule = "answer a contact force within its step, for stops with damping, whose force jumps"
        remedy = "use an implicit scheme, or pass your method as a function solve(system, dt, t_end)"
        raise InputError("scheme", str(scheme), rule, remedy)
