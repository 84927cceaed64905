"""The physics: a cantilever between stops, Dumont (2002), eqs. (2.1)-(2.5), validated on construction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array
from .contact import Stops
from .time_functions import Constant, Harmonic, LoadFunction, TimeFunction
from .validation import InputError, non_negative, positive

Profile = Callable[[Any], Any]


@dataclass(frozen=True)
class PointLoad:
    """f(x, t) = time(t) delta(x - position): a Dirac load of resultant time(t), 0 < position <= beam length."""

    position: float
    time: LoadFunction

    def __post_init__(self) -> None:
        positive("load.position", self.position)
        _require_load_function("load.time", self.time)


@dataclass(frozen=True)
class DistributedLoad:
    """f(x, t) = shape(x) time(t), force per unit length; ``shape`` takes an array of x."""

    shape: Profile
    time: LoadFunction

    def __post_init__(self) -> None:
        if not callable(self.shape):
            raise InputError("load.shape", self.shape, "be a function of x")
        _require_load_function("load.time", self.time)


Load = PointLoad | DistributedLoad


@dataclass(frozen=True)
class Units:
    """One unit of the non-dimensional problem in physical units; multiply to go back to them."""

    length: float
    time: float
    force: float

    def displacement(self, u: ArrayLike) -> Array:
        """Length (m) of the non-dimensional displacement ``u``."""
        return self.length * np.asarray(u, float)

    def velocity(self, v: ArrayLike) -> Array:
        """Length per time (m/s) of the non-dimensional velocity ``v``."""
        return self.length / self.time * np.asarray(v, float)

    def seconds(self, t: ArrayLike) -> Array:
        """Time (s) of the non-dimensional time ``t``."""
        return self.time * np.asarray(t, float)

    def newtons(self, sigma: ArrayLike) -> Array:
        """Force (N) of the non-dimensional contact force ``sigma``."""
        return self.force * np.asarray(sigma, float)


@dataclass(frozen=True, kw_only=True)
class BeamProblem:
    """u_tt = sigma_x + f on 0 < x < 1, sigma = -k^2 u_xxx - d u_xxxt, between stops at the tip.

        u(0,t) = phi(t),  u_x(0,t) = 0                                (2.3) clamped to a moving device
        sigma(1,t) = -kappa [(u(1,t) - g2)_+ - (g1 - u(1,t))_+]        (2.4) normal compliance
        k^2 u_xx(1,t) + d u_xxt(1,t) = 0                               (2.5) no moment at the tip

    stiffness: k^2 > 0. viscosity: d >= 0 (Kelvin-Voigt). stops: g1, g2, kappa, or None for no contact.
    base: phi, None for a clamp at rest. loads: f. initial_displacement, initial_velocity: u0(x), v0(x)
    taking an array of x to one of values; None is at rest, u0 = phi(0) and v0 = 0. All quantities are non-dimensional;
    ``from_physical`` makes the problem from physical ones and sets ``units``, the way back.
    Raises InputError (a ValueError) naming field, value and rule. Source: Dumont (2002), Section 2.
    """

    stiffness: float
    viscosity: float = 0.0
    stops: Stops | None = None
    base: TimeFunction | None = None
    loads: tuple[Load, ...] = ()
    initial_displacement: Profile | None = None
    initial_velocity: Profile | None = None
    units: Units | None = None

    def __post_init__(self) -> None:
        positive("stiffness", self.stiffness)
        non_negative("viscosity", self.viscosity)
        if self.stops is not None and not isinstance(self.stops, Stops):
            raise InputError("stops", self.stops, "be a Stops or None")
        if self.base is not None and not isinstance(self.base, TimeFunction):
            raise InputError("base", self.base, "have value, rate and acceleration", "use Harmonic or Constant")
        loads = (self.loads,) if isinstance(self.loads, (PointLoad, DistributedLoad)) else tuple(self.loads)
        object.__setattr__(self, "loads", loads)
        for load in self.loads:
            if not isinstance(load, (PointLoad, DistributedLoad)):
                raise InputError("loads", load, "hold PointLoad and DistributedLoad only")
            if isinstance(load, PointLoad) and load.position > 1.0:
                raise InputError("load.position", load.position, "lie on the beam, 0 < position <= 1")
        self._check_profiles()
        self._check_clamp()

    def _check_profiles(self) -> None:
        x = np.linspace(0.0, 1.0, 7)
        profiles = [("initial_displacement", self.initial_displacement), ("initial_velocity", self.initial_velocity)]
        profiles += [("load.shape", load.shape) for load in self.loads if isinstance(load, DistributedLoad)]
        for name, profile in profiles:
            if profile is None:
                continue
            if not callable(profile):
                raise InputError(name, profile, "be a function of x", "for a constant write lambda x: 0 * x + c")
            values = np.asarray(profile(x), float)
            if values.shape != x.shape or not np.all(np.isfinite(values)):
                raise InputError(name, values, "return one finite value per x", "write it with NumPy functions")

    def _check_clamp(self) -> None:
        """u0 has to meet the clamp: u0(0) = phi(0) and u0'(0) = 0 (2.3)."""
        if self.initial_displacement is None:
            return
        phi0 = 0.0 if self.base is None else float(self.base.value(0.0))
        step = 1e-5
        x = np.array([0.0, step, 0.25, 0.5, 0.75, 1.0])
        u = np.asarray(self.initial_displacement(x), float)
        scale = max(1e-300, abs(phi0), float(np.max(np.abs(u))))
        if abs(u[0] - phi0) > 1e-9 * scale:
            raise InputError("initial_displacement", float(u[0]), f"equal the base motion phi(0) = {phi0} at x = 0")
        # A smooth profile with u0'(0) = 0 moves by O(step^2) only.
        if abs(u[1] - u[0]) > 0.02 * step * float(np.max(np.abs(u - u[0]))) + 1e-14 * scale:
            raise InputError("initial_displacement", float(u[1] - u[0]) / step, "have zero slope at the clamp x = 0")

    @classmethod
    def from_physical(
        cls,
        *,
        length: float,
        bending_stiffness: float,
        mass_per_length: float,
        bending_viscosity: float = 0.0,
        stops: Stops | None = None,
        base: TimeFunction | None = None,
        loads: tuple[Load, ...] = (),
        initial_displacement: Profile | None = None,
        initial_velocity: Profile | None = None,
        time_unit: float = 1.0,
    ) -> BeamProblem:
        """rho A U_TT = -EI U_XXXX - eta U_XXXXT + f on 0 < X < L, made non-dimensional.

        With X = L x, U = L u, T = t0 t:  k^2 = EI t0^2/(rho A L^4),  d = eta t0/(rho A L^4), and a force
        is counted in units of rho A L^2/t0^2.

        length: L (m). bending_stiffness: EI (N m^2). mass_per_length: rho A (kg/m). bending_viscosity:
        eta (N m^2 s). stops: positions (m) and stiffness (N/m). base: phi (m) of time (s). loads: a
        PointLoad at X (m) with N(t) newtons, a DistributedLoad with shape(X) N(t) newtons per metre.
        initial_displacement, initial_velocity: m and m/s as functions of X (m). time_unit: t0 (s).
        ``problem.units`` converts results back.
        """
        length, t0 = positive("length", length), positive("time_unit", time_unit)
        bending = positive("bending_stiffness", bending_stiffness)
        mass = positive("mass_per_length", mass_per_length)
        force = mass * length**2 / t0**2
        loads = (loads,) if isinstance(loads, (PointLoad, DistributedLoad)) else tuple(loads)
        for load in loads:
            if isinstance(load, PointLoad) and load.position > length:
                raise InputError("load.position", load.position, f"lie on the beam, at most length = {length:g}")
        if stops is not None:
            stops = Stops(
                lower=None if stops.lower is None else stops.lower / length,
                upper=None if stops.upper is None else stops.upper / length,
                stiffness=stops.stiffness * length / force,
            )
        return cls(
            stiffness=bending * t0**2 / (mass * length**4),
            viscosity=non_negative("bending_viscosity", bending_viscosity) * t0 / (mass * length**4),
            stops=stops,
            base=None if base is None else _rescaled(base, 1.0 / length, t0),
            loads=tuple(_scaled_load(load, length, t0, force) for load in loads),
            initial_displacement=_scaled_profile(initial_displacement, length, 1.0 / length),
            initial_velocity=_scaled_profile(initial_velocity, length, t0 / length),
            units=Units(length=length, time=t0, force=force),
        )


def _require_load_function(field: str, function: object) -> None:
    if not isinstance(function, TimeFunction) and not callable(function):
        raise InputError(field, function, "be a Harmonic, a Constant or a function of time")


@dataclass(frozen=True)
class _Rescaled:
    """t -> factor f(t0 t), with its derivatives, for a TimeFunction f."""

    function: TimeFunction
    factor: float
    t0: float

    def value(self, t: ArrayLike) -> Array:
        return self.factor * self.function.value(self.t0 * np.asarray(t, float))

    def rate(self, t: ArrayLike) -> Array:
        return self.factor * self.t0 * self.function.rate(self.t0 * np.asarray(t, float))

    def acceleration(self, t: ArrayLike) -> Array:
        return self.factor * self.t0**2 * self.function.acceleration(self.t0 * np.asarray(t, float))


def _rescaled(function: Any, factor: float, t0: float) -> Any:
    """factor f(t0 t); a Harmonic or Constant stays one, so that the exact solvers can take it."""
    if isinstance(function, Harmonic):
        return Harmonic(factor * function.amplitude, t0 * function.frequency, function.phase)
    if isinstance(function, Constant):
        return Constant(factor * function.level)
    if isinstance(function, TimeFunction):
        return _Rescaled(function, factor, t0)
    return lambda t: factor * np.asarray(function(t0 * np.asarray(t, float)), float)


def _scaled_profile(profile: Profile | None, length: float, factor: float) -> Profile | None:
    if profile is None:
        return None
    return lambda x: factor * np.asarray(profile(length * np.asarray(x, float)), float)


def _scaled_load(load: Load, length: float, t0: float, force: float) -> Load:
    if isinstance(load, PointLoad):
        return PointLoad(load.position / length, _rescaled(load.time, 1.0 / force, t0))
    shape = _scaled_profile(load.shape, length, 1.0)
    assert shape is not None
    return DistributedLoad(shape, _rescaled(load.time, length / force, t0))
