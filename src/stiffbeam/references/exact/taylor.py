"""The first zero of a Taylor series."""

from __future__ import annotations

import math

import numpy as np

from ...basics.arrays import Array

SMALL = 1e-6  # of a stretch


def value(series: Array, s: float) -> Array:
    """sum_k c_k s^k."""
    return np.tensordot(s ** np.arange(len(series)), series, 1)


def _at(c: list[float], s: float) -> tuple[float, float]:
    """The series and its derivative at s: of numbers faster in Python than in NumPy."""
    total, slope = c[-1], 0.0
    for x in c[-2::-1]:
        total, slope = x + s * total, total + s * slope
    return total, slope


def _near(c: Array) -> float | None:
    """The first zero if the series is quadratic up to there. A body that leaves at the speed of rounding returns at
    once, and such a root is lost among the others."""
    under = c[1] ** 2 - 4.0 * c[0] * c[2]
    if under < 0.0 or not (c[1] < 0.0 or c[2] < 0.0):
        return None
    s = 2.0 * c[0] / (math.sqrt(under) - c[1]) if c[1] < 0.0 else (c[1] + math.sqrt(under)) / (-2.0 * c[2])
    return s if s < SMALL and s**3 * np.sum(np.abs(c[3:])) < 1e-3 * c[0] else None


def _real_roots(c: Array) -> Array:
    """Real roots of a series in (0, 1], in order."""
    last = np.flatnonzero(np.abs(c) > 1e-18 * np.max(np.abs(c)))[-1]
    roots = np.roots(c[last::-1])
    return np.sort(roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real <= 1.0 + 1e-12)])


def first_zero(gap: Array, length: float, zeros: int) -> float | None:
    """First time at which a series turns negative that is positive right after a zero of multiplicity ``zeros`` at 0.

    None if not in (0, length]; 0.0 where it is negative from the start. One that is zero throughout never does.
    """
    c = gap[zeros:]
    if not np.any(c):
        return None
    c = c[np.argmax(c != 0.0) :]
    if c[0] <= 0.0:
        return 0.0
    scaled = c * length ** np.arange(len(c))
    if scaled[0] > -np.sum(np.minimum(scaled[1:], 0.0)):
        return None
    near = _near(scaled)
    terms = c.tolist()
    for root in _real_roots(scaled) if near is None else [near]:
        s = float(min(root, 1.0)) * length
        for _ in range(3):
            height, slope = _at(terms, s)
            if slope < 0.0:
                s = min(max(s - height / slope, 0.0), length)
        if _at(terms, s)[1] <= 0.0:
            return s
    return None


def stays(acceleration: Array) -> bool:
    """Return True where a gap at rest, of which nothing presses now, does not open, by the series of its acceleration:
    a load on it rises from zero, or none ever comes."""
    later = acceleration[acceleration != 0.0]
    return acceleration[0] == 0.0 and not (len(later) and later[0] > 0.0)
