"""Stops: the data of a law of contact, its force and energy, its restitution; contacts: where stops act."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array
from ..basics.validation import Frozen, InputError, instance, number, vector
from ..kernels.library import LAW, contact_forces
from .time_functions import TimeFunction, evaluate, time_function

# Parameters beside the stiffness, in the order of ``Law``, each with its value in the linear law.
LINEAR = {"exponent": 1.0, "damping": 0.0, "dissipation": 0.0}


class Law(NamedTuple):
    """The parameters of the law in the form for kernels, with the stops g1 and g2, those after g2 in the order of
    ``LINEAR``. ``Law(*laws.T)`` are those of an array of laws (.., 6)."""

    kappa: float
    g1: float  # the lower stop, -inf for none
    g2: float
    p: float
    c: float
    lam: float

    @property
    def jumps(self) -> Any:
        """Return True where F jumps when the gap closes with a velocity other than zero: a state on the stop does not
        tell the force."""
        return self.c > 0.0

    @property
    def damps(self) -> Any:
        """Return True where F depends on the velocity."""
        return self.jumps | (self.lam > 0.0)


# ---------------------------------------------------------------- the terms of the law, see Stops
#
# They are arithmetic alone, on numbers, NumPy arrays or JAX arrays. A new term is a field of ``Stops``, its place in
# ``Law``, a change of these, and the same in kernels/law.h; a test holds both against each other.


def chord(d: Any, law: Law) -> Any:
    """f(d)/d of d > 0: the stiffness of a linear spring with the same force."""
    return law.kappa * d ** (law.p - 1.0)


def stored(d: Any, law: Law) -> Any:
    """U(d), even in d."""
    return 0.5 * law.kappa * d * d if law.p == 1.0 else law.kappa * abs(d) ** (law.p + 1.0) / (law.p + 1.0)


def depth_under(force: Any, law: Law) -> Any:
    """The depth at which f is ``force``."""
    return (force / law.kappa) ** (1.0 / law.p)


def depth_holding(energy: Any, law: Law) -> Any:
    """The depth at which U is ``energy``."""
    return ((law.p + 1.0) * energy / law.kappa) ** (1.0 / (law.p + 1.0))


def pressure(d: Any, rate: Any, law: Law) -> Any:
    """f(d) (1 + lambda d') + c d' with f = kappa d^p, not yet cut off at zero; f is odd in d, so that it goes on
    smoothly where a root is sought beyond the stop."""
    # The sign by arithmetic: this line runs on floats, NumPy arrays and JAX arrays.
    power = d if law.p == 1.0 else (2.0 * (d >= 0.0) - 1.0) * abs(d) ** law.p
    return law.kappa * power * (1.0 + law.lam * rate) + law.c * rate


@dataclass(frozen=True, repr=False)
class Stops(Frozen):
    """F = -(kappa d^p (1 + lambda d') + c d')_+ into the upper stop, d = u - g2 > 0, mirrored at the lower.

    F < 0 at the upper stop, F > 0 at the lower. A stop only pushes: where damping would turn F into a pull, contact
    ends before d = 0. With c > 0 the force jumps by c d' at entry. U = kappa d^(p+1)/(p+1) is the energy stored at d;
    the rest of the work of F is dissipated.

    Parameters
    ----------
    lower, upper : float, optional
        g1 and g2 > g1, displacements. None leaves that side free.
    stiffness : float
        kappa > 0, force per displacement^p. ``inf`` is a rigid stop: a reaction of any size where the gap is closed,
        none elsewhere.
    exponent : float
        p >= 1: 1 is linear compliance (2.4), 3/2 Hertz's law, any other the power law of Kuttler and Shillor.
    damping : float
        c >= 0, force per velocity: with p = 1 the unilateral Kelvin-Voigt law.
    dissipation : float
        lambda >= 0, per velocity: the law of Hunt and Crossley. A free mass with the speed s rebounds with e s where
        1 - e x = (1 + x) exp(-(1 + e) x), x = lambda s.
    restitution : float, optional
        Rigid stops only: Newton's e in [0, 1], u'+ = -e u'-. None for ``ContactStabilisedNewmark``.
    position : float, optional
        Beams only: the place x along the beam; None is the tip. A contact of matrices has its row instead.
    motion : time function, optional
        Beams only: m(t), by which both stops move; d is then that of v = u(x, t) - m(t). None: stops at rest. A
        contact of matrices has its offset instead.

    Raises
    ------
    InputError
        For stops that bound no side, cross each other, or have a law that is none of these.

    References
    ----------
    Dumont (2002), eq. (2.4); Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> stops = sb.Stops(lower=-0.1, upper=0.1, stiffness=5e6)
    >>> round(float(stops.force(0.101, 0.0)), 6)  # 0.001 beyond the upper stop
    -5000.0
    """

    lower: float | None = None
    upper: float | None = None
    stiffness: float = field(kw_only=True)
    exponent: float = field(default=1.0, kw_only=True)
    damping: float = field(default=0.0, kw_only=True)
    dissipation: float = field(default=0.0, kw_only=True)
    restitution: float | None = field(default=None, kw_only=True)
    position: float | None = field(default=None, kw_only=True)
    motion: TimeFunction | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        # Every number by itself, then what the numbers must be to each other.
        if not self.rigid:
            remedy = "inf is a rigid stop"  # times a compliance that of a compliant one has to be a number
            value = number("stops.stiffness", self.stiffness, exact=True, least=1e-200, most=1e200, remedy=remedy)
            vars(self)["stiffness"] = value
        for side in ("lower", "upper"):
            if getattr(self, side) is not None:
                vars(self)[side] = number(f"stops.{side}", getattr(self, side), exact=True)
        # A rigid stop has an impact law in place of a law of force, a compliant one the reverse.
        for name, plain in LINEAR.items():
            # Below the exponent 1 the force has no slope; its dampings are 0 in the linear law, and not negative.
            vars(self)[name] = number(f"stops.{name}", getattr(self, name), exact=True, least=plain)
            if self.rigid and getattr(self, name) != plain:
                raise InputError(f"stops.{name}", getattr(self, name), "be left out for rigid stops", "use restitution")
        if self.restitution is not None:
            vars(self)["restitution"] = number("stops.restitution", self.restitution, least=0.0, most=1.0)
            if not self.rigid:
                rule, remedy = "be left out unless stiffness=inf", "for compliant ones use damping or dissipation"
                raise InputError("stops.restitution", self.restitution, rule, remedy)
        # The gap between the sides.
        if self.lower is None and self.upper is None:
            raise InputError("stops", "no side", "have a lower or an upper stop", "for no contact leave stops out")
        if not self.law.g1 < self.law.g2:
            raise InputError("stops.upper", self.upper, f"be > stops.lower = {self.lower}", "leave a gap between them")
        if self.position is not None:
            vars(self)["position"] = number("stops.position", self.position, exact=True, least=0.0)
        if self.motion is not None:
            time_function("stops.motion", self.motion, moves=True)

    def __repr__(self) -> str:
        """The fields; exponent, damping and so on only where they differ from the linear law's."""
        values = ((x.name, x.default, getattr(self, x.name)) for x in fields(self))
        shown = (
            f"{name}={value!r}" for name, default, value in values if name in ("lower", "upper") or value != default
        )
        return f"Stops({', '.join(shown)})"

    @cached_property
    def sides(self) -> dict[int, float]:
        """The stop on each side that has one, the upper one, +1, before the lower, -1."""
        return {side: g for side, g in ((1, self.law.g2), (-1, self.law.g1)) if math.isfinite(g)}

    @property
    def rigid(self) -> bool:
        """True if stiffness is inf."""
        return isinstance(self.stiffness, (int, float)) and self.stiffness == math.inf

    def require_compliant(self, for_what: str, remedy: str = "use a large one, 1e8 for example") -> None:
        """Raise InputError for a rigid stop, whose reaction is no function of position and velocity."""
        if self.rigid:
            raise InputError("stops.stiffness", self.stiffness, f"be finite for {for_what}", remedy)

    @cached_property
    def law(self) -> Law:
        """(kappa, g1, g2, p, c, lambda) as the terms of the law take them, -inf and inf where a side is free."""
        lower, upper = (
            free if g is None else float(g) for g, free in ((self.lower, -math.inf), (self.upper, math.inf))
        )
        return Law(float(self.stiffness), lower, upper, *(float(getattr(self, name)) for name in LINEAR))

    @cached_property
    def linear(self) -> bool:
        """Return True where F = -kappa d, kappa finite."""
        return not self.rigid and all(getattr(self, name) == plain for name, plain in LINEAR.items())

    def penetration(self, v: ArrayLike) -> Array:
        """v - clip(v, g1, g2): > 0 into the upper stop, < 0 into the lower, 0 between them."""
        v = np.asarray(v, float)
        return v - np.clip(v, self.law.g1, self.law.g2)

    def require_linear(self, for_what: str, damped: bool = False, remedy: str = "leave it out") -> None:
        """Raise InputError unless the law is the linear one; ``damped``: or unilateral Kelvin-Voigt."""
        self.require_compliant(for_what)
        for name in (x for x in LINEAR if getattr(self, x) != LINEAR[x] and not (damped and x == "damping")):
            rule = f"be {LINEAR[name]:g}, a linear law, for {for_what}"
            raise InputError(f"stops.{name}", getattr(self, name), rule, remedy)

    def force(self, v: ArrayLike, velocity: ArrayLike | None = None) -> Array:
        """F on the beam at position v, with the ``velocity`` of v. InputError where F depends on one that is not given,
        and for a rigid stop."""
        if velocity is None and self.law.damps:
            remedy = "pass the velocity of the contact point"
            raise InputError("velocity", None, "be given for stops whose force depends on it", remedy)
        motion = (np.asarray(x, float) for x in (v, 0.0 if velocity is None else velocity))
        u, rate = np.broadcast_arrays(*motion)
        # The kernel finds a position that is no number between the stops.
        self.require_compliant("a law of force")
        return np.where(np.isnan(u + rate), np.nan, contact_forces(u, rate, np.array(self.law)))

    def energy(self, v: ArrayLike) -> Array:
        """U(v): -U' is the force at rest. A rigid stop holds none."""
        return np.zeros(np.shape(v)) if self.rigid else stored(self.penetration(v), self.law)

    def state(self, v: ArrayLike, velocity: ArrayLike | None = None) -> NDArray[np.int64]:
        """chi = +1 where the upper stop presses, -1 where the lower does, else 0.

        Without damping that is v > g2 and v < g1 (strict). With a damped stop contact ends earlier; needs ``velocity``.
        """
        v = np.asarray(v, float)
        chi = (v > self.law.g2).astype(np.int64) - (v < self.law.g1).astype(np.int64)
        return chi * (self.force(v, velocity) != 0.0) if self.law.damps else chi


@dataclass(frozen=True, eq=False)
class Contact(Frozen):
    """Stops that act on the position row @ q + offset(t), with the force row^T F(row @ q + offset(t)).

    Parameters
    ----------
    row : array (n,)
        Which combination of the unknowns meets the stops.
    stops : Stops
        Their gaps and their law.
    offset : time function, optional
        Moves the contact point against the stops, as a moving support does in absolute coordinates.

    Raises
    ------
    InputError
        For a row that is zero or not finite, and for an offset without rate and acceleration.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> contact = sb.Contact([0.0, 1.0], sb.Stops(upper=0.1, stiffness=1e4), offset=sb.Harmonic(0.02, 5.0))
    >>> contact.row
    array([0., 1.])
    """

    row: Array
    stops: Stops
    offset: TimeFunction | None = None

    def __post_init__(self) -> None:
        vars(self)["row"] = vector("contact.row", self.row)
        if not np.any(self.row):
            raise InputError("contact.row", self.row, "not be all zero", "for example [0, 0, 1]")
        instance("contact.stops", self.stops, Stops, "for example Stops(upper=0.1, stiffness=1e4)")
        for name, remedy in (("position", "put it into the row"), ("motion", "its negative is an offset")):
            if getattr(self.stops, name) is not None:
                rule = "be None in a contact, which has row and offset"
                raise InputError(f"contact.stops.{name}", getattr(self.stops, name), rule, remedy)
        if self.offset is not None:
            time_function("contact.offset", self.offset, moves=True)


def channel_position(row: Array, offset: TimeFunction | None, t: ArrayLike, q: Array) -> Array:
    """Position of a channel at times t for q (..., n): row q + o(t)."""
    return q @ row + evaluate(offset, t)


def channel_motion(row: Array, offset: TimeFunction | None, t: ArrayLike, q: Array, v: Array) -> tuple[Array, Array]:
    """Position and velocity of a channel."""
    return channel_position(row, offset, t, q), v @ row + evaluate(offset, t, 1)


def laws(contacts: Sequence[Contact]) -> Array:
    """The laws of all contacts, (m, 6), see Law."""
    for contact in contacts:
        contact.stops.require_compliant("a law of force")
    return np.array([contact.stops.law for contact in contacts]).reshape(-1, LAW)


def side_at_start(u0: Array, v0: Array, law: Array) -> Array:
    """The stop of a contact that exists at t = 0, +-1, or 0: a start exactly on a stop that does not leave it is
    contact, see ``Impacts``."""
    stops = Law(*law.T)
    on = 1.0 * ((u0 == stops.g2) & (v0 >= 0.0)) - 1.0 * ((u0 == stops.g1) & (v0 <= 0.0))
    # Beyond a stop by the force, which a damped one may have let go before the gap opens.
    return np.where((u0 == stops.g1) | (u0 == stops.g2), on, -np.sign(contact_forces(u0, v0, law)))


ON_STOP = 1e-12  # relative distance between a rigid stop and a start that counts as on it


def on_rigid_stops(contacts: Sequence[Contact], q: Array) -> dict[int, int]:
    """{contact: side, +-1} of the contacts that are on rigid stops at t = 0 in q (n,). Raises InputError for one beyond
    its stop."""
    closed = {}
    for i, contact in enumerate(contacts):
        if not contact.stops.rigid:
            continue
        moved = float(evaluate(contact.offset, 0.0))
        u = float(contact.row @ q) + moved
        # A start that is a state of a motion is beyond a stop that holds it by the rounding of the whole state.
        whole = float(np.sum(np.abs(contact.row))) * float(np.max(np.abs(q)))
        for side, g in contact.stops.sides.items():
            # Within rounding of its stop a contact is on it, neither off nor beyond.
            if side * (u - g) >= -ON_STOP * max(abs(g), abs(moved)):
                if side * (u - g) > ON_STOP * max(abs(g), abs(moved), whole):
                    remedy = "move the stop or the start"
                    raise InputError("initial displacement", u, "lie between rigid stops", remedy)
                closed[i] = side
    return closed
