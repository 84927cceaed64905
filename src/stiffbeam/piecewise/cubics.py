"""Minimum of a cubic p0 + p1 s + p2 s^2 + p3 s^3, and its first zero; compiled."""

from __future__ import annotations

import math

from ..basics.compiled import compiled
from .touching import safe_step


@compiled
def least(p0: float, p1: float, p2: float, p3: float, step: float) -> float:
    """The least value of a cubic on [0, step]."""
    low = min(p0, p0 + step * (p1 + step * (p2 + step * p3)))
    discriminant = p2 * p2 - 3.0 * p1 * p3
    if discriminant > 0.0:
        q = -(p2 + math.copysign(math.sqrt(discriminant), p2))
        s = q / (3.0 * p3) if p3 != 0.0 else -1.0
        if 0.0 < s < step:
            low = min(low, p0 + s * (p1 + s * (p2 + s * p3)))
        s = p1 / q if q != 0.0 else -1.0
        if 0.0 < s < step:
            low = min(low, p0 + s * (p1 + s * (p2 + s * p3)))
    return low


@compiled
def reached(p0: float, p1: float, p2: float, p3: float, step: float) -> float:
    """An s <= ``step`` before which a cubic with p0 > 0 stays positive, close to where it does not."""
    s = 0.0
    value = p0
    for _ in range(12):
        # Nowhere on [s, step] more curved than at one of the two.
        curve = max(0.0, -2.0 * p2 - 6.0 * p3 * (s if p3 > 0.0 else step))
        move = safe_step(value, p1 + s * (2.0 * p2 + s * 3.0 * p3), curve)
        s += move
        if not s < step:
            return step
        value = p0 + s * (p1 + s * (p2 + s * p3))
        if value <= 1e-8 * p0 or move <= 1e-8 * s:
            break
    return s
