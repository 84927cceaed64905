"""Observed orders: a straight line through log(error) over log(step), with its interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.stats
from numpy.typing import ArrayLike

WIDEST = 1.5  # an interval wider than this cannot tell one order from the next


@dataclass(frozen=True)
class Order:
    """error = C step^slope by least squares; slope +- interval holds with 95 % (Student's t, n - 2)."""

    slope: float
    interval: float
    constant: float
    points: int

    @property
    def unclear(self) -> bool:
        """Whether the interval is too wide to speak of a rate."""
        return 2.0 * self.interval > WIDEST

    def __str__(self) -> str:
        if self.unclear:
            return "no clear rate"
        return f"{self.slope:.2f} " + (f"± {self.interval:.2f}" if np.isfinite(self.interval) else "(two points)")


def observed_order(steps: ArrayLike, errors: ArrayLike) -> Order:
    """The Order through (steps, errors), all > 0; NaN for fewer than two steps, no interval for two points."""
    x, y = np.log(np.asarray(steps, float)), np.log(np.asarray(errors, float))
    n = len(x)
    nan = float("nan")
    if len(np.unique(x)) < 2:
        return Order(nan, nan, nan, n)
    fit: Any = scipy.stats.linregress(x, y)
    interval = float(scipy.stats.t.ppf(0.975, n - 2) * fit.stderr) if n > 2 else nan
    return Order(float(fit.slope), interval, float(np.exp(fit.intercept)), n)
