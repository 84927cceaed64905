"""Blocks that no force meets, all steps at once: what the energy ledger asks of them."""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array, IntArray, aligned
from .kernels.accounts import FreeBlock
from .kernels.single_steps import Step
from .kernels.single_steps import states as states_of


def no_block() -> FreeBlock:
    """Where every block goes step by step."""
    return FreeBlock(np.zeros((0, 0)), np.zeros(0, np.int64))


def free_block(step: Step, place: IntArray, n: int, P: int, K: int, T: Array) -> FreeBlock:
    """K of the ``step`` of n modes, probed with units of the components in their ``place`` and of the drive.

    T: (d, d), the drive's transition over a step, g_k = T^k g.
    """
    d, carried, width = len(T), len(place), step.transition.shape[1]
    acting = np.flatnonzero(np.any(step.driven != 0.0, axis=1))
    g = np.empty((K + 1, d, d))  # T^k
    g[0] = np.eye(d)
    for k in range(K):
        g[k + 1] = T @ g[k]
    undriven = np.zeros_like(step.driven)
    harmonics = step.driven.copy()
    harmonics[0] = 0.0  # the constant drives by itself, in every step
    T_rows = carried + len(acting)
    memory = np.empty((2, 2 * width))
    made = np.zeros((T_rows + T_rows % 2, K, width))
    for t in range(T_rows):
        start, driven, own = np.zeros(carried * n), undriven, np.zeros((K + 1, d))
        if t < carried:
            start[t * n : (t + 1) * n] = 1.0  # of all modes at once, which do not see each other
        else:
            e = acting[t - carried]
            driven, own = (harmonics, np.ascontiguousarray(g[:, :, e])) if e else (step.driven, own)
        quiet = step._replace(driven=driven, g=own, forces=np.zeros((K, len(step.push))))
        states_of(quiet, n, P, start, place, *memory, made[t])
    paths = aligned((n, 2, len(made), K))
    paths[:] = made[:, :, : 2 * P].reshape(len(made), K, 2, P)[..., :n].transpose(3, 2, 0, 1)
    return FreeBlock(paths.reshape(-1, K), acting)
