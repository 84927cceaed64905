"""Compilation of the kernels, kept on disk so that only the first run pays for it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba

from . import cache

# Sums may be reassociated and contracted, but NaN and inf stay honest: an overflow must be seen.
FASTMATH = {"reassoc", "contract"}


def compiled(function: Callable[..., Any]) -> Any:
    """``function`` compiled by numba on its first call, cached in the cache directory; it holds no GIL."""
    return _njit(function)


def inlined(function: Callable[..., Any]) -> Any:
    """``function`` compiled as a part of those that call it.

    A call of its own would count references to every array it is given, with locked instructions.
    """
    return _njit(function, inline="always")


@lru_cache
def directory() -> Path:
    """Where the compiled kernels are kept: one folder per state of the sources that hold any.

    numba itself looks at the file of the function it compiles, not at those of the functions in it.
    """
    sources = [path.read_bytes() for path in sorted(Path(__file__).parent.rglob("*.py"))]
    digest = hashlib.sha256(b"".join(text for text in sources if b"compiled import" in text))
    return cache.directory() / "numba" / digest.hexdigest()[:16]


def _njit(function: Callable[..., Any], **options: Any) -> Any:
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = str(directory())  # type: ignore[attr-defined]
    try:
        return numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", **options)(function)
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
