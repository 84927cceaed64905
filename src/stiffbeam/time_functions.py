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
        number("amplitude", self.amplitude)
        positive("frequency", self.frequency)
        number("phase", self.phase)

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
        number("level", self.level)

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
    values = function.value(t) if isinstance(function, TimeFunction) else function(t)
    values = np.asarray(values, float)
    if values.shape != t.shape and values.shape != ():
        raise InputError(
            "a load's time function",
            values.shape,
            f"return one value per time, shape {t.shape}",
            "write it with NumPy functions, so that it takes an array of times",
        )
    if not np.all(np.isfinite(values)):
        first = t[~np.isfinite(np.broadcast_to(values, t.shape))].flat[0]
        raise InputError("a load's time function", f"a value that is not finite at t = {first:g}", "be finite")
    return np.broadcast_to(values, t.shape)


def offset_values(offset: LoadFunction | None, t: ArrayLike) -> Array:
    """o(t), zero for None."""
    return np.zeros(np.shape(t)) if offset is None else evaluate(offset, t)


def offset_rate(offset: LoadFunction | None, t: ArrayLike) -> Array:
    """o'(t); by a central difference for a bare callable."""
    if offset is None:
        return np.zeros(np.shape(t))
    if isinstance(offset, TimeFunction):
        return offset.rate(t)
    step = 1e-6 * max(1.0, float(np.max(np.abs(t))))
    return (offset_values(offset, np.asarray(t) + step) - offset_values(offset, np.asarray(t) - step)) / (2 * step)
