"""The physics: a beam between stops, Dumont (2002), eqs. (2.1)-(2.5), validated on construction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.text import Units
from ..basics.validation import Frozen, InputError, instance, number, numbers, one_of, positive, sequence, units_labels
from .contact import Stops
from .time_functions import LoadFunction, TimeFunction, derivative, time_function


@dataclass(frozen=True)
class PolynomialProfile:
    """p(x) = sum_k coefficients[k] x^k, the constant first; a case file gives it as a list.

    Parameters
    ----------
    coefficients : sequence of float
        Texts, Fractions and Decimals keep their exact values for multiprecision.

    Raises
    ------
    InputError
        For an empty sequence, and for entries that are no numbers.

    Examples
    --------
    >>> import numpy as np
    >>> import stiffbeam as sb
    >>> sb.PolynomialProfile([0.1, 0.0, 2.0])(np.array([0.0, 0.5, 1.0]))
    array([0.1, 0.6, 2.1])
    """

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        rule, remedy = "be one number or more, the constant first", "for example (0, 0, 1)"
        coefficients = sequence("coefficients", self.coefficients, rule, remedy)
        if not coefficients:
            raise InputError("coefficients", self.coefficients, rule, remedy)
        vars(self)["coefficients"] = tuple(number("coefficients", c, exact=True) for c in coefficients)

    def __call__(self, x: ArrayLike) -> Array:
        """c_0 + c_1 x + c_2 x^2 + ... at every x."""
        return np.polynomial.polynomial.polyval(np.asarray(x, float), np.array(self.coefficients, float))


def ratios_of(value: float | Sequence[float]) -> float | tuple[float, ...]:
    """A damping ratio for every mode, or one for each of the first modes; >= 0."""
    if isinstance(value, (list, tuple, np.ndarray)):
        return tuple(number("modal_damping", x, least=0.0) for x in value)
    return number("modal_damping", value, least=0.0)


Profile = Callable[[Any], Any]
BESIDE = 1e-5  # of the length, where the slope at a clamp is seen
SUPPORTS = ("clamped-free", "clamped-clamped", "clamped-pinned", "pinned-pinned", "free-free")


@dataclass(frozen=True)
class PointLoad(Frozen):
    """f(x, t) = time(t) delta(x - position): a force on one point of a beam.

    Parameters
    ----------
    position : float
        0 < position <= beam length.
    time : time function
        The resultant, a force. A bare function of t is allowed for loads.

    Raises
    ------
    InputError
        For a position that is not positive, and a time that is no function.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.PointLoad(position=0.23, time=sb.Harmonic(67.024, 6.0)).position
    0.23
    """

    position: float
    time: LoadFunction

    def __post_init__(self) -> None:
        vars(self)["position"] = positive("load.position", self.position, exact=True)
        time_function("load.time", self.time)


@dataclass(frozen=True)
class DistributedLoad(Frozen):
    """f(x, t) = shape(x) time(t), force per unit length of a beam.

    Parameters
    ----------
    shape : function or PolynomialProfile
        From an array of x to an array.
    time : time function
        A bare function of t is allowed for loads.

    Raises
    ------
    InputError
        For a time that is no function; a beam refuses a shape that is none.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> weight = sb.DistributedLoad(shape=sb.PolynomialProfile([1.0]), time=sb.Constant(-9.81))
    >>> weight.time
    Constant(level=-9.81)
    """

    shape: Profile
    time: LoadFunction

    def __post_init__(self) -> None:
        time_function("load.time", self.time)


Load = PointLoad | DistributedLoad


@dataclass(frozen=True, kw_only=True)
class BeamProblem(Frozen):
    """m u_tt = sigma_x + f on 0 < x < L, sigma = -EI u_xxx - eta u_xxxt, between stops.

        u(0,t) = phi(t),  u_x(0,t) = 0                                (2.3) clamped to a moving device
        sigma(L,t) = -kappa [(u(L,t) - g2)_+ - (g1 - u(L,t))_+]        (2.4) normal compliance
        EI u_xx(L,t) + eta u_xxt(L,t) = 0                              (2.5) no moment at the tip

    The beam is integrated in the units of these numbers. By default they are the paper's, with L = m = 1. A number
    given as a text ("0.001", "1/3", "2*pi*50"), Fraction or Decimal keeps its exact value in multiprecision; a float is
    a double.

    Parameters
    ----------
    stiffness : float
        EI > 0, the paper's k^2.
    viscosity : float
        eta >= 0 (Kelvin-Voigt), the paper's d.
    length, mass_per_length : float
        L and m.
    stops : Stops or sequence of Stops, optional
        g1, g2, kappa and the place along the beam, the tip by default. Each of several is a point force at its
        ``position``. None: no contact.
    base : TimeFunction, optional
        phi; None is a clamp at rest.
    loads : sequence of PointLoad and DistributedLoad
        f.
    initial_displacement, initial_velocity : function or PolynomialProfile, optional
        u0(x) and v0(x), from an array of x in [0, L] to an array. None is at rest: u0 = phi(0), v0 = 0.
    units : tuple
        Names of the units of length, time and force that the numbers are in, for axes, tables and files:
        ("mm", "s", "N") counts EI in N mm^2, m in tonnes per mm and stop stiffnesses in N/mm.
    supports : str
        Ends at x = 0 and x = L: "clamped-free" is the paper's; others are for form="hermite". A clamped end holds u and
        u_x, a pinned one u, a free one neither.
    tip_mass : float
        Point mass at x = L.
    mass_damping : float
        a of the force -a m u_t per length, and -a tip_mass u_t at the tip.
    modal_damping : float or sequence of float
        For form="hermite": damping ratios that are added to the modes of v.

    Raises
    ------
    InputError
        A ValueError that names field, value and rule.

    References
    ----------
    Dumont (2002), Section 2.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> stops, base = sb.Stops(lower=-0.1, upper=0.1, stiffness=5e6), sb.Harmonic(amplitude=0.2, frequency=10.0)
    >>> problem = sb.BeamProblem(stiffness=300.0, stops=stops, base=base)
    >>> problem.length, problem.supports
    (1.0, 'clamped-free')
    """

    stiffness: float
    viscosity: float = 0.0
    length: float = 1.0
    mass_per_length: float = 1.0
    stops: Stops | Sequence[Stops] | None = None
    base: TimeFunction | None = None
    loads: tuple[Load, ...] = ()
    initial_displacement: Profile | None = None
    initial_velocity: Profile | None = None
    units: Units = ()
    supports: str = "clamped-free"
    tip_mass: float = 0.0
    mass_damping: float = 0.0
    modal_damping: float | Sequence[float] = 0.0

    def __post_init__(self) -> None:
        # Numbers first, then what they must be to each other.
        for name in ("stiffness", "mass_per_length"):
            vars(self)[name] = positive(name, getattr(self, name), exact=True)
        for name in ("viscosity", "tip_mass", "mass_damping"):
            vars(self)[name] = number(name, getattr(self, name), exact=True, least=0.0)
        # The fifth power of the length is in float64.
        vars(self)["length"] = number("length", self.length, exact=True, least=1e-60, most=1e60)
        vars(self)["modal_damping"] = ratios_of(self.modal_damping)
        vars(self)["units"] = units_labels(self.units)
        # Supports, stops, base and loads: their kind, and where they act.
        self._check_supports()
        self._check_stops()
        if self.base is not None:
            derivative(time_function("base", self.base, moves=True), 2)  # which refuses a polygon
        rule, remedy = "hold PointLoad and DistributedLoad only", "for example PointLoad(0.5, Constant(1.0))"
        loads = [self.loads] if isinstance(self.loads, Load) else sequence("loads", self.loads, rule, remedy)
        vars(self)["loads"] = tuple(loads)
        for load in self.loads:
            if not isinstance(load, Load):
                raise InputError("loads", load, rule, remedy)
            if isinstance(load, PointLoad) and load.position > self.length:
                rule = f"lie on the beam, 0 < position <= {self.length:g}"
                raise InputError("load.position", load.position, rule, "its end is the length")
        self._check_profiles()

    @property
    def all_stops(self) -> tuple[Stops, ...]:
        """The stops in the order given, () for none."""
        stops: Any = self.stops
        return stops if isinstance(stops, tuple) else () if stops is None else (stops,)

    def place(self, stops: Stops) -> float:
        """x of stops along the beam."""
        return self.length if stops.position is None else stops.position

    @property
    def for_elements(self) -> tuple[str, ...]:
        """Names of the properties that need form="hermite"."""
        held = () if self.supports == "clamped-free" else ("supports",)
        return (*held, *(("modal_damping",) if np.any(self.modal_damping) else ()))

    @property
    def ends(self) -> tuple[str, str]:
        """Support of the beam at x = 0 and at x = L: clamped, pinned or free."""
        left, _, right = self.supports.partition("-")
        return left, right

    def _check_supports(self) -> None:
        one_of("supports", self.supports, SUPPORTS, "be known")
        if self.base is not None and self.supports != "clamped-free":
            remedy = "in the frame of supports that all move alike it is DistributedLoad(-m phi'')"
            raise InputError("base", self.base, f"be None for a {self.supports} beam", remedy)
        if self.tip_mass and self.ends[1] != "free":
            raise InputError("tip_mass", self.tip_mass, f"be 0 for a {self.supports} beam", "its end does not move")

    def _check_stops(self) -> None:
        # One Stops of a list is stored by itself: equal problems are equal however their stops were given.
        if isinstance(self.stops, (list, tuple)):
            vars(self)["stops"] = self.stops[0] if len(self.stops) == 1 else tuple(self.stops) or None
        for stops in self.all_stops:
            instance("stops", stops, Stops, "for no contact leave them out", "be a Stops or a list of them")
            position, L = self.place(stops), self.length
            free = [x for x, end in zip((0.0, L), self.ends, strict=True) if end == "free"]
            if not 0.0 < position < L and position not in free:
                rule = f"lie inside a {self.supports} beam, 0 < position < {L:g}, or at a free end"
                raise InputError("stops.position", stops.position, rule, f"for example {0.5 * L:g}")

    def _check_profiles(self) -> None:
        """Functions of x return one finite value per x; u0 meets the supports: at a clamp u0 = phi(0) and u0' = 0
        (2.3), at a pin u0 = 0."""
        x = self.length * np.array([0.0, BESIDE, 0.25, 0.5, 0.75, 1.0 - BESIDE, 1.0])
        profiles = [("initial_displacement", self.initial_displacement), ("initial_velocity", self.initial_velocity)]
        profiles += [("load.shape", load.shape) for load in self.loads if isinstance(load, DistributedLoad)]
        rule, remedy = "be a function of x and return one finite value per x", "write it with NumPy functions"
        for name, profile in ((name, profile) for name, profile in profiles if profile is not None):
            try:
                result = profile(x)
            except Exception as error:  # of what is no function, or whatever the functions of others raise
                raise InputError(name, profile, rule, f"{remedy}: {error!r}") from None
            u = numbers(name, result, rule, remedy)
            if u.shape != x.shape:
                raise InputError(name, result, rule, remedy)
            if name == "initial_displacement":
                self._check_ends(x, u)

    def _check_ends(self, x: Array, u: Array) -> None:
        phi0 = 0.0 if self.base is None else float(self.base.value(0.0))
        scale = max(abs(phi0), float(np.max(np.abs(u))))
        for end, at, beside in zip(self.ends, (0, -1), (1, -2), strict=True):
            if end != "free" and abs(u[at] - phi0) > 1e-9 * scale:
                rule = f"equal the base motion phi(0) = {phi0} at x = {x[at]:g}"
                remedy = "add what is missing to initial_displacement, or change the phase of the base"
                raise InputError("initial_displacement", float(u[at]), rule, remedy)
            # A smooth profile with u0' = 0 moves by O(BESIDE^2) only.
            moved = u[beside] - u[at]
            if end == "clamped" and abs(moved) > 0.02 * BESIDE * np.max(np.abs(u - u[at])) + 1e-14 * scale:
                rule, remedy = f"have zero slope at the clamp x = {x[at]:g}", "leave the clamp flat, as x**2 does"
                raise InputError("initial_displacement", float(moved / (x[beside] - x[at])), rule, remedy)
