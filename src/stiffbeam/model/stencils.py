"""The stencils of the paper's space discretisations, as matrices."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from ..basics.arrays import Array


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
