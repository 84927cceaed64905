"""Which march pays where modes do not decouple: blocks of all unknowns together, or steps one by one.

A block of K steps is a product with (R + D) x D numbers, D = k N for the k components that a scheme carries of N
unknowns, once the powers of one step are made. A single step is a few products with N x N matrices in Python.
"""

from __future__ import annotations

import numpy as np

from ..model.equations import Matrices
from ..schemes import Scheme
from .coordinates import Coordinates, InModes
from .probe import independent

# Seconds, measured on one core: a product of matrices, of a matrix in cache and one out of it, per multiply-add.
MATRIX, CACHED, STREAMED = 1.2e-10, 1.5e-10, 5e-10
CACHE = 2.5e5  # numbers
CALLS, CALL = 3e-3, 5e-5  # of the set-up and of a node of a direct step: Python
MOST = 1 << 27  # numbers in the powers of a step: 1 GiB
LEAST, LONGEST = 32, 256  # force nodes of a block; more pay more for the contact than they save


def nodes_per_block(coordinates: Coordinates, scheme: Scheme) -> int:
    """More where the product with the transition is large, since it is shared by the steps of a block."""
    return (
        LEAST if isinstance(coordinates, InModes) else int(np.clip(_carried(coordinates, scheme) / 4, LEAST, LONGEST))
    )


def pays(coordinates: Coordinates, scheme: Scheme, steps: int) -> bool:
    """Whether blocks are faster than ``steps`` direct ones, set-up included; in modes always."""
    if isinstance(coordinates, InModes):
        return True
    D, N, S = _carried(coordinates, scheme), coordinates.rows.shape[1], len(scheme.nodes)
    length = max(1, nodes_per_block(coordinates, scheme) // (S * max(1, len(coordinates.columns))))
    levels = 2.0 + np.log2(length)
    work = float(D) ** 2 / length + float(D) * S * max(1, len(coordinates.columns))
    blocks = CALLS + MATRIX * (levels * float(D) ** 3 + 6.0 * S * D * float(N) ** 2)
    blocks += steps * work * (CACHED if float(D) ** 2 < CACHE else STREAMED)
    entries = coordinates.equation.entries if isinstance(coordinates.equation, Matrices) else 3.0 * float(N) ** 2
    direct = steps * S * (CALL + 1.5 * CACHED * entries)
    return levels * float(D) ** 2 <= MOST and blocks < direct


def _carried(coordinates: Coordinates, scheme: Scheme) -> int:
    """D."""
    return len(independent(scheme, coordinates.equation.order, 1.0)[0]) * coordinates.rows.shape[1]
