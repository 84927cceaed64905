"""Compilation of the kernels, kept on disk so that only the first run pays for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

from . import cache

# Sums may be reassociated and contracted, but NaN and inf stay honest: an overflow must be seen.
FASTMATH = {"reassoc", "contract"}


def compiled(function: Callable[..., Any]) -> Any:
    """``function`` compiled by numba on its first call, cached in the cache directory."""
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = str(cache.directory() / "numba")  # type: ignore[attr-defined]
    try:
        return numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy")(function)
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
