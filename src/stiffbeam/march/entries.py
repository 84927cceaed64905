"""Where the readings of K steps stand among the entries of a block."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, padded
from .probe import Readers


@dataclass(frozen=True, eq=False)
class Entries:
    """The contacts at every node, padded to eight, then the channels at the ends of steps that are no node, then
    where they are read the contacts' velocities at every node."""

    nodes: int  # N, a multiple of eight
    end_first: NDArray[np.int64]  # (C,), see Block
    end_stride: NDArray[np.int64]
    rates: NDArray[np.int64]
    place: NDArray[np.int64]  # (entries,): the step times g plus the reading that stands there, -1 for padding

    @classmethod
    @lru_cache(maxsize=256)
    def of(cls, readers: Readers, steps: int, ends_at_last_node: bool) -> Entries:
        """Of so many steps."""
        S, m, C = len(readers.nodes), readers.contacts, readers.channels
        at_ends = C - m if ends_at_last_node else C
        count = steps * S * m
        N = padded(count, least=0)
        reading = np.arange(steps * readers.size).reshape(steps, -1)
        ends = reading[:, readers.at_ends][:, C - at_ends :]
        padding = np.full(N - count, -1)
        of_rates = reading[:, readers.node_rates].ravel()
        place = [reading[:, readers.at_nodes].ravel(), padding, ends.ravel(), of_rates]
        first, stride = N + np.arange(C), np.full(C, at_ends)
        if ends_at_last_node:
            first[:m], stride[:m] = (S - 1) * m + np.arange(m), S * m
            first[m:] = N + np.arange(at_ends)
        rates = np.pad(N + ends.size + np.arange(count), (0, N - count)) if len(of_rates) else of_rates
        return cls(N, first, stride, rates, np.concatenate(place))

    def of_readings(self, x: Array, width: int) -> Array:
        """(..., K, g) -> (..., width), zero where no reading stands."""
        *batch, K, g = x.shape
        flat = np.zeros((*batch, K * g + 1), x.dtype)
        flat[..., :-1] = x.reshape(*batch, K * g)
        found = np.zeros((*batch, width), x.dtype)
        found[..., : len(self.place)] = flat[..., self.place]
        return found
