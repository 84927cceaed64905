"""The beam without contact in closed form, before any grid: what a semi-discrete system converges to."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from .arrays import Array
from .problem import BeamProblem
from .time_functions import Harmonic
from .validation import InputError


def roots(count: int) -> Array:
    """l_1 .. l_count with cos l cosh l = -1: the clamped-free beam; w_i = l_i^2 k (Dumont, Section 5.1)."""
    f = lambda x: np.cos(x) + 1.0 / np.cosh(x)  # noqa: E731  bounded for large x
    # The i-th root is within 0.31 of (i - 1/2) pi.
    centres = (np.arange(1, count + 1) - 0.5) * np.pi
    return np.array([brentq(f, c - 0.5, c + 0.5, xtol=1e-15) for c in centres])


def mode(root: float, x: ArrayLike) -> Array:
    """X(x) = r (cosh lx - cos lx) + sin lx - sinh lx, r = (sin l + sinh l)/(cos l + cosh l).

    Written over e^{-lx} and e^{-l(1-x)}: the difference of cosh and sinh cancels for large l.
    """
    x = np.asarray(x, float)
    c, s, small = np.cos(root), np.sin(root), np.exp(-root)
    below = c + 0.5 * (np.exp(root) + small)
    r = (s + 0.5 * (np.exp(root) - small)) / below
    growing = 0.5 * (s - c - small) / below  # (r - 1)/2, of size e^{-l}
    return growing * np.exp(root * x) + 0.5 * (r + 1.0) * np.exp(-root * x) - r * np.cos(root * x) + np.sin(root * x)


def natural_frequencies(problem: BeamProblem, count: int) -> Array:
    """w_i = l_i^2 k of the undamped beam."""
    return roots(count) ** 2 * np.sqrt(problem.stiffness)


def tip_response(problem: BeamProblem) -> complex:
    """The complex ratio of tip and base in the steady motion u(1, t) = Im(ratio E e^{i (a t + phase)}).

    ratio = (cos l + cosh l)/(1 + cos l cosh l), l^4 = a^2/(k^2 + i a d): the solution of
    (k^2 + i a d) u'''' = a^2 u, u(0) = 1, u'(0) = u''(1) = u'''(1) = 0. Raises InputError unless the base
    is Harmonic and the only drive.
    """
    if not isinstance(problem.base, Harmonic) or problem.loads:
        raise InputError("problem", "its drive", "be a harmonic base and no loads for the closed form")
    a = problem.base.frequency
    root = (a**2 / complex(problem.stiffness, a * problem.viscosity)) ** 0.25
    return complex((np.cos(root) + np.cosh(root)) / (1.0 + np.cos(root) * np.cosh(root)))
