"""Where compiled kernels and computed references are kept between runs."""

from __future__ import annotations

import os
import tempfile
import warnings
from functools import cache
from pathlib import Path

import platformdirs


@cache
def directory() -> Path:
    """STIFFBEAM_CACHE_DIR, else the platform's cache directory, else a temporary one with a warning."""
    wanted = os.environ.get("STIFFBEAM_CACHE_DIR") or platformdirs.user_cache_dir("stiffbeam")
    path = Path(wanted)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            return path
    except OSError:
        path = Path(tempfile.mkdtemp(prefix="stiffbeam-"))
        warnings.warn(
            f"cannot write to the cache directory {wanted}: using {path} for this process; "
            "set STIFFBEAM_CACHE_DIR to a writable directory to keep compiled kernels",
            stacklevel=2,
        )
        return path
