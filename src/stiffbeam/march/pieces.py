"""A run in pieces: what the marches hand to the recorder, in bounded memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..basics.arrays import Array

STEPS_PER_PIECE = 4096


@dataclass(frozen=True, eq=False)
class Piece:
    """Consecutive steps first + 1 .. first + k of a run; valid until the next piece is made."""

    first: int
    positions: Array  # (k, channels) at the ends of the steps
    velocities: Array  # (k, channels)
    states: Callable[[], tuple[Array, Array]]  # q, q' at the ends of the steps, each (k, n)
    seconds: float
    means: Array | None = None  # (k, contacts): the reactions, where they are means over the steps
    found: Array | None = None  # (k, contacts): the forces that nodes found at the ends of the steps, see found_force
