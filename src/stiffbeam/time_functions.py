"""Functions of time: the base motion phi(t), the load factors f_k(t), the stop offsets o_c(t)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array
from .validation import InputError, number, positive


@runtime_checkable
class TimeFunction(Protocol):
    """f(t) with two derivatives, vectorised: an array of times gives an array of that shape."""

    def value(self, t: ArrayLike, /) -> Array: ...  # f(t)
    def rate(self, t: ArrayLike, /) -> Array: ...  # f'(t)
    def acceleration(self, t: ArrayLike, /) -> Array: ...  # f''(t)


@dataclass(frozen=True)
class Harmonic:
    """f(t) = amplitude sin(frequency t + phase); ``frequency`` is angular (rad per time) and > 0."""

    amplitude: float
    frequency: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitude", number("amplitude", self.amplitude))
        object.__setattr__(self, "frequency", positive("frequency", self.frequency))
        object.__setattr__(self, "phase", number("phase", self.phase))

    def value(self, t: ArrayLike) -> Array:
        return self.amplitude * np.sin(self.frequency * np.asarray(t, float) + self.phase)

    def rate(self, t: ArrayLike) -> Array:
        return self.frequency * self.amplitude * np.cos(self.frequency * np.asarray(t, float) + self.phase)

    def acceleration(self, t: ArrayLike) -> Array:
        return -(self.frequency**2) * self.value(t)

    @property
    def sine(self) -> float:
        """The coefficient of sin(frequency t)."""
        return self.amplitude * math.cos(self.phase)

    @property
    def cosine(self) -> float:
        """The coefficient of cos(frequency t)."""
        return self.amplitude * math.sin(self.phase)


@dataclass(frozen=True)
class Constant:
    """f(t) = level."""

    level: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "level", number("level", self.level))

    def value(self, t: ArrayLike) -> Array:
        return np.full(np.shape(t), float(self.level))

    def rate(self, t: ArrayLike) -> Array:
        return np.zeros(np.shape(t))

    def acceleration(self, t: ArrayLike) -> Array:
        return np.zeros(np.shape(t))


LoadFunction = TimeFunction | Callable[[Any], Any]


def evaluate(function: LoadFunction, t: ArrayLike) -> Array:
    """f(t) of a TimeFunction or of a bare callable, as a float array of the shape of ``t``."""
    t = np.asarray(t, float)
    try:
        values = np.asarray(function.value(t) if isinstance(function, TimeFunction) else function(t), float)
    except (TypeError, ValueError) as error:
        remedy = "write it with NumPy functions, for example numpy.where for an if"
        raise InputError("a time function", str(error), "take an array of times", remedy) from None
    if values.shape != t.shape and values.shape != ():
        raise InputError(
            "a time function",
            values.shape,
            f"return one value per time, shape {t.shape}",
            "write it with NumPy functions, so that it takes an array of times",
        )
    if not np.all(np.isfinite(values)):
        first = t[~np.isfinite(np.broadcast_to(values, t.shape))].flat[0]
        raise InputError("a time function", f"a value that is not finite at t = {first:g}", "be finite")
    return np.broadcast_to(values, t.shape)


def offset_values(offset: LoadFunction | None, t: ArrayLike) -> Array:
    """o(t), zero for None."""
    return np.zeros(np.shape(t)) if offset is None else evaluate(offset, t)


def offset_rate(offset: LoadFunction | None, t: ArrayLike) -> Array:
    """o'(t), of a bare callable by differences that stay inside [0, t], but for the first few steps."""
    if offset is None:
        return np.zeros(np.shape(t))
    if isinstance(offset, TimeFunction):
        return offset.rate(t)
    t = np.asarray(t, float)
    step = 1e-6 * float(np.max(np.abs(t))) or 1e-8
    step = np.where(t < 2.0 * step, step, -step)  # forwards there, else backwards
    here, next_, last = (offset_values(offset, t + k * step) for k in range(3))
    return (4.0 * next_ - 3.0 * here - last) / (2.0 * step)
