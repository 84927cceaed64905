"""What a beam does between its nodes: displacement and velocity, moment and shear at any x."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import InputError, numbers
from .hermite_elements import free_unknowns, interpolation
from .problem import BeamProblem
from .sections import factors
from .time_functions import TimeFunction


def beam_field(problem: BeamProblem, form: str, t: Array, q: Array, x: ArrayLike, slopes: int = 0) -> Array:
    """d^slopes u/dx^slopes at x, u = v + phi (1 - (x/L)^2); q (m, n) of the times t (m,), x (...) -> (m, ...).

    hermite: the element's own polynomials. The other forms: the cubic spline through the nodes with v = v_x = 0
    at the clamp and u_xx = 0 at the tip. Raises InputError for x outside [0, L].
    """
    return _derivative(problem, form, q, x, slopes, _base(problem, t, "value"))


def beam_field_rate(problem: BeamProblem, form: str, t: Array, v: Array, x: ArrayLike, slopes: int = 0) -> Array:
    """The same of u_t, from v = q'."""
    return _derivative(problem, form, v, x, slopes, _base(problem, t, "rate"))


def beam_stress(problem: BeamProblem, form: str, t: Array, q: Array, v: Array, x: ArrayLike, slopes: int) -> Array:
    """EI d^slopes u/dx^slopes + eta d^slopes u_t/dx^slopes: with 2 the moment, with 3 minus the shear stress."""
    stress = problem.stiffness * beam_field(problem, form, t, q, x, slopes)
    if problem.viscosity != 0.0:
        stress = stress + problem.viscosity * beam_field_rate(problem, form, t, v, x, slopes)
    return stress * factors(problem.sections, x, "stiffness") if problem.sections else stress


def _base(problem: BeamProblem, t: Array, of: str) -> Array:
    """phi(t) or phi'(t)."""
    phi: TimeFunction | None = problem.base
    return np.zeros(np.shape(t)) if phi is None else getattr(phi, of)(t)


def _derivative(problem: BeamProblem, form: str, q: Array, x: ArrayLike, slopes: int, phi: Array) -> Array:
    x, L = numbers("x", x), problem.length
    if np.any((x < 0.0) | (x > L)):
        raise InputError("x", x, f"lie in [0, {L:g}]", "for example half of that")
    share = x / L
    lift = np.multiply.outer(phi, (1.0 - share**2, -2.0 * share, -2.0 + 0.0 * share, 0.0 * share)[slopes])
    if form == "hermite":
        # n = 2 M + 2 unknowns less those that are held
        M = (q.shape[-1] + sum({"free": 0, "pinned": 1, "clamped": 2}[end] for end in problem.ends)) // 2 - 1
        rows = interpolation(share, M, slopes)[..., free_unknowns(problem.ends, M)]
        return (np.tensordot(q, rows, axes=(-1, -1)) * float(M) ** slopes + lift) / L**slopes
    from scipy.interpolate import CubicSpline

    M = q.shape[-1]
    values = np.concatenate([np.zeros((*q.shape[:-1], 1)), q], axis=-1)
    ends: Any = ((1, np.zeros(q.shape[:-1])), (2, 2.0 * phi))  # v_xx = 2 phi/L^2 where u_xx = 0
    spline = CubicSpline(np.arange(M + 1) / M, values, axis=-1, bc_type=ends)
    return (spline(share, slopes) + lift) / L**slopes
