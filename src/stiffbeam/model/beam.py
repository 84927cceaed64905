"""A beam along x: its fields between the nodes and its stencils.

Displacement and velocity are those of a spline or of cubic Hermite elements: in an element of length h,
s = x/h, with v_0' = v_x at its left node,

    v = (1 - 3 s^2 + 2 s^3) v_0 + (s - 2 s^2 + s^3) h v_0' + (3 s^2 - 2 s^3) v_1 + (s^3 - s^2) h v_1'
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import InputError, numbers
from .problem import BeamProblem

HELD = {"free": (), "pinned": (0,), "clamped": (0, 1)}


def free_unknowns(ends: tuple[str, str], M: int) -> Array:
    """The unknowns that the supports leave free, of (v_0, h v_0', .., v_M, h v_M'). ends: at x = 0 and x = L."""
    left, right = ends
    held = [*HELD[left], *(2 * M + i for i in HELD[right])]
    return np.setdiff1d(np.arange(2 * M + 2), held)


def shape_functions(s: Array) -> Array:
    """N_1 .. N_4 at s in [0, 1] of an element: shape s.shape + (4,)."""
    return np.stack([1 - 3 * s**2 + 2 * s**3, s - 2 * s**2 + s**3, 3 * s**2 - 2 * s**3, s**3 - s**2], axis=-1)


def interpolation(share: Array, M: int) -> Array:
    """The rows of v at x = share L, for all 2 M + 2 unknowns: share.shape + (2 M + 2,)."""
    # The tip belongs to the last element.
    cell = np.minimum((share * M).astype(int), M - 1)
    rows = np.zeros((*np.shape(share), 2 * M + 2))
    np.put_along_axis(rows, 2 * cell[..., None] + np.arange(4), shape_functions(share * M - cell), axis=-1)
    return rows


def beam_field(problem: BeamProblem, form: str, M: int, t: Array, q: Array, x: ArrayLike, of: str = "value") -> Array:
    """u = v + phi (1 - (x/L)^2) at x; q (m, n) of the times t (m,), x (...) -> (m, ...). of="rate": u_t, q' for q.

    hermite: the element's own polynomials. The other forms: the cubic spline through the nodes with v = v_x = 0
    at the clamp and u_xx = 0 at the tip. Raises InputError for x outside [0, L].
    """
    x, L = numbers("x", x), problem.length
    if np.any((x < 0.0) | (x > L)):
        raise InputError("x", x, f"lie in [0, {L:g}]", "for example half of that")
    phi = np.zeros(np.shape(t)) if problem.base is None else getattr(problem.base, of)(t)
    share = x / L
    lift = np.multiply.outer(phi, 1.0 - share**2)
    if form == "hermite":
        return np.tensordot(q, interpolation(share, M)[..., free_unknowns(problem.ends, M)], axes=(-1, -1)) + lift
    # The forms of the paper have no slopes as unknowns: a spline gives them.
    from scipy.interpolate import CubicSpline

    values = np.concatenate([np.zeros((*q.shape[:-1], 1)), q], axis=-1)
    ends: Any = ((1, np.zeros(q.shape[:-1])), (2, 2.0 * phi))  # v_xx = 2 phi/L^2 where u_xx = 0
    return CubicSpline(np.arange(M + 1) / M, values, axis=-1, bc_type=ends)(share) + lift


# ---------------------------------------------------------------- the stencils of the paper, as matrices


def bending_stencil(M: int) -> Array:
    """-h^4 D H, whole numbers: 7, -4, 1 at the clamp, 1, -4, 6, -4, 1 inside, 5, -2 and 1 at the tip."""
    bands = {0: 6.0, 1: -4.0, -1: -4.0, 2: 1.0, -2: 1.0}
    stencil = sum((weight * np.eye(M, k=k) for k, weight in bands.items()), np.zeros((M, M)))
    stencil[0, 0] = 7.0
    stencil[-2:, -2:] = [[5.0, -2.0], [-2.0, 1.0]]
    return stencil


def velocity_curvature_matrices(M: int, length: float = 1.0) -> tuple[Array, Array, Array, Array]:
    """P, Q, L, R of (3.12), each (M, M): w_0..w_{M-1} = L s-integrated, P R = L^T Q."""
    h = length / M
    interior = np.eye(M - 1) * 4.0 / 3.0 - (np.eye(M - 1, k=1) + np.eye(M - 1, k=-1)) / 6.0
    P = h * np.asarray(scipy.linalg.block_diag(interior, 1.0 / 3.0))
    Q = h * np.asarray(scipy.linalg.block_diag(1.0 / 3.0, interior))
    L = np.eye(M) - 2.0 * np.eye(M, k=-1) + np.eye(M, k=-2)  # acts on s_1..s_M, s_0 = 0
    L[0, :2] = (4.0, -0.5)  # (3.9)
    R = np.eye(M) - 2.0 * np.eye(M, k=1) + np.eye(M, k=2)  # acts on w_0..w_{M-1}; w_M = 2 phi/L^2 is a load
    R[-1, -2:] = (-0.5, 4.0)  # (3.10)
    return P, Q, L / h**2, R / h**2
