"""Phase lag: by how much a run comes late."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize_scalar

from ..basics.arrays import Array, step_lengths

GRID = 401


@dataclass(frozen=True)
class PhaseLag:
    """tau minimising J(tau) = sum_j dt_j (u_run(t_j + tau) - u_ref(t_j))^2, dt_j of t_j as in ``step_lengths``;
    > 0: the run is late.

    residual: sqrt(J(tau)/sum u_ref^2), what is left after the shift. unshifted: the same with J(0).
    lag and residual are NaN where the lag is undefined, and ``undefined`` says why.
    """

    lag: float
    residual: float
    unshifted: float
    undefined: str = ""


def phase_lag(
    t: Array, u: Array, v: Array, reference: Callable[[Array], Array], end: float, drive: float, first: float
) -> PhaseLag:
    """The lag of a run (t, u, u') behind u_ref over t_j in [tau_m, end - tau_m], |tau| <= tau_m.

    tau_m = pi/(2 max(a, w1)) with the drive frequency a = ``drive`` and the lowest natural frequency
    w1 = ``first``. u_run between its steps is the cubic Hermite interpolant. A grid of 401 shifts, then
    Brent's method. Undefined if ``end`` < 4 tau_m or the minimum lies at an end of the range.
    """
    nan = float("nan")
    if max(drive, first) <= 0.0:
        return PhaseLag(nan, nan, nan, "nothing here has a frequency")
    tau_m = np.pi / (2.0 * max(drive, first))
    if end < 4.0 * tau_m:
        return PhaseLag(nan, nan, nan, f"the window {end:.3g} is shorter than 4 tau_m = {4 * tau_m:.3g}")
    counted = (t >= tau_m) & (t <= end - tau_m)
    inside, weights = t[counted], step_lengths(t)[counted]
    target = reference(inside)
    scale = float(np.sum(weights * target**2))
    if scale == 0.0:
        return PhaseLag(nan, nan, nan, "the reference is at rest")
    run = CubicHermiteSpline(t, u, v)

    def J(tau: float) -> float:
        return float(np.sum(weights * (run(inside + tau) - target) ** 2))

    shifts = np.linspace(-tau_m, tau_m, GRID)
    values = [J(tau) for tau in shifts]
    best = int(np.argmin(values))
    unshifted = float(np.sqrt(J(0.0) / scale))
    if best in (0, GRID - 1):
        return PhaseLag(nan, nan, unshifted, f"no best shift within {tau_m:.3g}")
    result: Any = minimize_scalar(J, bracket=(shifts[best - 1], shifts[best], shifts[best + 1]), method="brent")
    return PhaseLag(float(result.x), float(np.sqrt(max(0.0, result.fun) / scale)), unshifted)
