"""Where compiled kernels and computed references are kept between runs."""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
import warnings
from functools import cache
from pathlib import Path

import platformdirs


@cache
def directory() -> Path:
    """STIFFBEAM_CACHE_DIR, else the platform's cache directory, else a temporary one with a warning.

    Compiled kernels are code that is run: a folder in which others can write is not used.
    """
    wanted = os.environ.get("STIFFBEAM_CACHE_DIR") or platformdirs.user_cache_dir("stiffbeam")
    path = Path(wanted)
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        for folder in (path, path / "numba"):
            _require_own(folder)
        with tempfile.TemporaryFile(dir=path):
            return path
    except OSError as error:
        path = Path(tempfile.mkdtemp(prefix="stiffbeam-"))
        why = error if isinstance(error, _NotOwn) else f"cannot write to the cache directory {wanted}"
        warnings.warn(
            f"{why}: using {path} for this process; "
            "set STIFFBEAM_CACHE_DIR to a writable directory of your own to keep compiled kernels",
            stacklevel=2,
        )
        return path


class _NotOwn(OSError):
    """A folder into which somebody else may put code."""


def _require_own(folder: Path) -> None:
    """Raise where the folder, or a file of kernels in it, is another user's, or others may write there."""
    if not hasattr(os, "getuid") or not folder.exists():
        return
    kernels = folder.glob("*/*") if folder.name == "numba" else ()
    for path in (folder, *kernels):
        found = path.stat()
        if found.st_uid not in (os.getuid(), 0) or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise _NotOwn(f"others can write to {path}, from which compiled code is run")


@cache
def source_hash(folder: Path = Path(__file__).parents[1]) -> str:
    """Hash of the code and data in a folder, the package's by default: results of an edited one are not those of it."""
    digest = hashlib.sha256()
    for file in sorted({*folder.rglob("*.py"), *folder.rglob("*.toml")}):
        digest.update(file.read_bytes())
    return digest.hexdigest()
