"""Restitution: the speed at which a free mass leaves a damped stop over the speed at which it hits it."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import lambertw

from ..basics.validation import InputError, non_negative, number, positive

RTOL = np.float64(4.0 * np.finfo(float).eps)  # the least that brentq takes


def restitution_of(dissipation: float, speed: float) -> float:
    """e of m d'' = -kappa d^p (1 + lambda d') for a mass that comes in at ``speed`` v.

        e = (1 - y)/x,   y = -W0(-(1 + x) exp(-(1 + x))),   x = lambda v

    for every m, kappa and p: d'/(1 + lambda d') dd' = -(kappa/m) d^p dd has the same integral on both ways.
    Near x = 0, where this cancels, e is corrected to rounding by Newton's method on h(-e x) = h(x), h(z) =
    ln(1 + z) - z. Raises InputError for negative values.
    """
    x = non_negative("dissipation", dissipation) * positive("speed", speed)
    if x < 1e-7:
        return 1.0 + x * (-2.0 / 3.0 + x * 4.0 / 9.0)
    if x > 700.0:
        return 1.0 / x  # y = 0 in float64
    if x > 1.0:
        return (1.0 + float(lambertw(-(1.0 + x) * np.exp(-(1.0 + x))).real)) / x
    e = 1.0 / (1.0 + 2.0 * x / 3.0)
    for _ in range(6):
        e += (_log_less(-e * x) - _log_less(x)) * (1.0 - e * x) / (e * x * x)
    return e


def _log_less(z: float) -> float:
    """ln(1 + z) - z without cancellation: 2 artanh t - 2 t/(1 - t), t = z/(2 + z)."""
    if abs(z) > 0.3:
        return float(np.log1p(z)) - z
    t = z / (2.0 + z)
    return -2.0 * t * t / (1.0 - t) + 2.0 * sum(t**k / k for k in range(23, 2, -2))


def dissipation_for(restitution: float, speed: float) -> float:
    """lambda with ``restitution_of(lambda, speed) == restitution``, a number in (0, 1].

    Raises InputError for any other: e = 0 would take an infinite lambda.
    """
    e = number("restitution", restitution)
    if not 0.0 < e <= 1.0:
        raise InputError("restitution", restitution, "lie in (0, 1]", "0 takes an infinite dissipation")
    positive("speed", speed)
    if e == 1.0:
        return 0.0
    # e falls from 1 to 0 as x grows, and e x stays below 1: 1 - 2x/3 < e < 1/x. Beyond 1/e, where 1/(1/e) rounds up.
    if not e > 1e-150:
        raise InputError("restitution", restitution, "be larger than 1e-150", "or use a rigid stop with restitution=0")
    x: Any = brentq(lambda x: restitution_of(x, 1.0) - e, 0.0, 1.001 / e, xtol=1e-300, rtol=RTOL)
    return float(x) / speed
