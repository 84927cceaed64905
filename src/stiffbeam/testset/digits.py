"""Error of a motion from the rounding of its written numbers: a file with six digits has no error below 1e-6."""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array
from .measure import Motion
from .problem import Problem

SAMPLE = 200  # numbers that are looked at
DIGITS = range(3, 10)  # that are few
SINGLE, NEAR = 2.0**-23, 5e-9  # the spacing of single precision; what a decimal of one is off by, relative


def lost_to_digits(problem: Problem, motion: Motion) -> float:
    """Largest error of the tip from rounding of the positions, and of times that are not equidistant, over its largest
    displacement; 0 for doubles."""
    rounding = _spacing(motion.u)
    if rounding and np.ptp(np.diff(motion.t)) > 1e-9 * problem.t_end and "tip_velocity" in problem.answers:
        largest, fastest = (np.max(np.abs(problem.answers[name].value)) for name in ("tip", "tip_velocity"))
        rounding += _spacing(motion.t) * float(motion.t[-1] * fastest / largest)
    return rounding


def _spacing(x: Array) -> float:
    """Between the numbers that x was rounded to, over the largest |x|; 0 where no rounding shows."""
    numbers = x[x != 0.0]
    numbers = numbers[:: max(1, len(numbers) // SAMPLE)]
    if not len(numbers):
        return 0.0
    single = numbers.astype(np.float32).astype(float)
    if np.all(np.abs(numbers - single) <= NEAR * np.abs(numbers)):
        return SINGLE
    largest = float(np.max(np.abs(numbers)))
    for digits in DIGITS:
        if all(float(f"{v:.{digits - 1}e}") == v for v in numbers):
            return 10.0 ** (1 - digits)
        places = digits - 1 - int(np.floor(np.log10(largest)))
        if places >= 0 and all(float(f"{v:.{places}f}") == v for v in numbers):
            return 10.0**-places / largest
    return 0.0
