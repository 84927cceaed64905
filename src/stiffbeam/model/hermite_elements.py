"""The cubic Hermite beam element: shape functions, matrices in whole numbers, quadrature.

In an element of length h, s = x/h, with v_0' = v_x at its left node,

    v = (1 - 3 s^2 + 2 s^3) v_0 + (s - 2 s^2 + s^3) h v_0' + (3 s^2 - 2 s^3) v_1 + (s^3 - s^2) h v_1'
"""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array

MASS = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
ROTARY = np.array([[36, 3, -36, 3], [3, 4, -3, -1], [-36, -3, 36, -3], [3, -1, -3, 4]])  # times J/(30 h)
BENDING = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])  # times EI/h^3
# The same as (a a^T + b b^T): the mean curvature of an element and its slope.
MEAN, SLOPE = np.array([0.0, -1.0, 0.0, 1.0]), np.sqrt(3.0) * np.array([2.0, 1.0, -2.0, 1.0])
HELD = {"free": (), "pinned": (0,), "clamped": (0, 1)}
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(6)  # integrates loads of degree 8 along an element exactly
POINTS, WEIGHTS = 0.5 * (POINTS + 1.0), 0.5 * WEIGHTS


def free_unknowns(ends: tuple[str, str], M: int) -> Array:
    """The unknowns that the supports leave free, of (v_0, h v_0', .., v_M, h v_M'). ends: at x = 0 and x = L."""
    left, right = ends
    held = [*HELD[left], *(2 * M + i for i in HELD[right])]
    return np.setdiff1d(np.arange(2 * M + 2), held)


def shape_functions(s: Array, times: int = 0) -> Array:
    """N_1 .. N_4 or their derivatives by s, at s in [0, 1] of an element: shape s.shape + (4,)."""
    one, zero = np.ones_like(s), np.zeros_like(s)
    powers = (
        (1 - 3 * s**2 + 2 * s**3, s - 2 * s**2 + s**3, 3 * s**2 - 2 * s**3, s**3 - s**2),
        (6 * s**2 - 6 * s, 1 - 4 * s + 3 * s**2, 6 * s - 6 * s**2, 3 * s**2 - 2 * s),
        (12 * s - 6, 6 * s - 4, 6 - 12 * s, 6 * s - 2),
        (12 * one, 6 * one, -12 * one, 6 * one),
    )
    return np.stack([zero + value for value in powers[times]], axis=-1)


def interpolation(share: Array, M: int, times: int = 0) -> Array:
    """The rows of h^times d^times v/dx^times at x = share L, for all 2 M + 2 unknowns: share.shape + (2 M + 2,)."""
    cell = np.minimum((share * M).astype(int), M - 1)
    values = shape_functions(share * M - cell, times)
    rows = np.zeros((*np.shape(share), 2 * M + 2))
    np.put_along_axis(rows, 2 * cell[..., None] + np.arange(4), values, axis=-1)
    return rows
