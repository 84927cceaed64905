"""The array type, and arrays laid out for vector registers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]  # float64 unless a docstring says otherwise
LANES = 8  # doubles in the widest vector register


def padded(size: int, least: int = LANES) -> int:
    """``size`` rounded up to a multiple of LANES, not below ``least``."""
    return max(least, -(-size // LANES) * LANES)


def aligned(shape: tuple[int, ...]) -> Array:
    """Zeros at a 64-byte boundary."""
    count = int(np.prod(shape))
    buffer = np.zeros(count + LANES)
    start = (-buffer.ctypes.data // 8) % LANES
    return buffer[start : start + count].reshape(shape)
