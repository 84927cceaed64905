"""The beam without contact in closed form, without a grid: the limit of the semi-discrete systems."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from ..basics.arrays import Array
from ..basics.validation import InputError
from .problem import BeamProblem
from .time_functions import Harmonic


def roots(count: int) -> Array:
    """l_1 .. l_count with cos l cosh l = -1: the clamped-free beam; w_i = l_i^2 k (Dumont, Section 5.1)."""
    f = lambda x: np.cos(x) + 1.0 / np.cosh(x)  # noqa: E731  bounded for large x
    # The i-th root is within 0.31 of (i - 1/2) pi.
    centres = (np.arange(1, count + 1) - 0.5) * np.pi
    # Centres are pi apart, so that half a unit to each side holds one root.
    return np.array([brentq(f, c - 0.5, c + 0.5, xtol=1e-15) for c in centres])


def mode(root: float, x: ArrayLike) -> Array:
    """X(x) = r (cosh lx - cos lx) + sin lx - sinh lx, r = (sin l + sinh l)/(cos l + cosh l).

    x is a share of the length. Written over e^{-lx} and e^{-l(1-x)}: the difference of cosh and sinh
    cancels for large l.
    """
    x = np.asarray(x, float)
    c, s, small = np.cos(root), np.sin(root), np.exp(-root)
    below = c + 0.5 * (np.exp(root) + small)
    r = (s + 0.5 * (np.exp(root) - small)) / below
    # sinh l - cosh l = -e^-l by hand: in float64 the difference of the two would lose it.
    growing = 0.5 * (s - c - small) / below  # (r - 1)/2, of size e^{-l}
    return growing * np.exp(root * x) + 0.5 * (r + 1.0) * np.exp(-root * x) - r * np.cos(root * x) + np.sin(root * x)


def natural_frequencies(problem: BeamProblem, count: int) -> Array:
    """w_i = l_i^2 sqrt(EI/(m L^4)) of the undamped clamped-free beam, the paper's l_i^2 k.

    Raises InputError for another beam.
    """
    _papers(problem)
    return roots(count) ** 2 * np.sqrt(problem.stiffness / problem.mass_per_length) / problem.length**2


def tip_response(problem: BeamProblem) -> complex:
    """The complex ratio of tip and base in the steady motion u(L, t) = Im(ratio E e^{i (a t + phase)}).

    ratio = (cos l + cosh l)/(1 + cos l cosh l), l^4 = m L^4 a^2/(EI + i a eta): the solution of
    (EI + i a eta) u'''' = m a^2 u, u(0) = 1, u'(0) = u''(L) = u'''(L) = 0. Raises InputError unless the base
    is Harmonic and the only drive of a clamped-free beam.
    """
    _papers(problem)
    if not isinstance(problem.base, Harmonic) or problem.loads:
        remedy = "take stiffbeam.reference for other drives"
        raise InputError("problem", "its drive", "be a harmonic base and no loads for the closed form", remedy)
    a = problem.base.frequency
    inertia = problem.mass_per_length * problem.length**4 * a**2
    root = (inertia / complex(problem.stiffness, a * problem.viscosity)) ** 0.25
    return complex((np.cos(root) + np.cosh(root)) / (1.0 + np.cos(root) * np.cosh(root)))


def _papers(problem: BeamProblem) -> None:
    """Raise InputError unless the ends and the damping are those of the paper's beam."""
    if problem.for_elements or problem.tip_mass or problem.mass_damping:
        description = f"{problem.supports}, tip mass {problem.tip_mass:g}, mass damping {problem.mass_damping:g}"
        description += "".join(f", {name}" for name in problem.for_elements if name != "supports")
        rule = "be clamped-free without tip mass and mass damping for the closed form"
        raise InputError("problem", description, rule, "take stiffbeam.reference for other beams")
