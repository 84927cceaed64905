"""The cache directory, and files that are either complete or absent."""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import socket
import stat
import tempfile
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path

import platformdirs

from .validation import InputError, file_path


@cache
def directory() -> Path:
    """STIFFBEAM_CACHE_DIR, else the platform's cache directory, else a temporary one with a warning.

    Compiled kernels are code that is run: a folder in which others can write is not used.
    """
    wanted = os.environ.get("STIFFBEAM_CACHE_DIR") or platformdirs.user_cache_dir("stiffbeam")
    path = Path(wanted)
    try:
        # For this user alone, since compiled code lies here.
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        for folder in (path, path / "numba"):
            _require_private(folder)
        # Only writing shows that a folder can be written to.
        with tempfile.TemporaryFile(dir=path):
            return path
    except OSError as error:
        path = Path(tempfile.mkdtemp(prefix="stiffbeam-"))
        why = error if isinstance(error, _Shared) else f"cannot write to the cache directory {wanted}"
        warnings.warn(
            f"{why}: using {path} for this process; "
            "set STIFFBEAM_CACHE_DIR to a writable directory of your own to keep compiled kernels",
            stacklevel=2,
        )
        return path


class _Shared(OSError):
    """A folder into which another user may put code."""


def _require_private(folder: Path) -> None:
    """Raise an error if another user owns the folder or a kernel file in it, or may write there."""
    if not hasattr(os, "getuid") or not folder.exists():
        return
    kernels = folder.glob("*/*") if folder.name == "numba" else ()
    for path in (folder, *kernels):
        status = path.stat()
        # Root can write everywhere: a folder of root's is as safe as one of this user.
        if status.st_uid not in (os.getuid(), 0) or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise _Shared(f"others can write to {path}, from which compiled code is run")


@cache
def source_hash(folder: Path = Path(__file__).parents[1]) -> str:
    """Hash of the code and data in a folder, by default the package's. It changes with every edit, so old results are
    not reused."""
    digest = hashlib.sha256()
    for file in sorted({*folder.rglob("*.py"), *folder.rglob("*.toml")}):
        digest.update(file.read_bytes())
    return digest.hexdigest()


PARTIAL = re.compile(r"\.(.+)\.([^.]*)-(\d+)-[0-9a-f]{8}\.partial")  # name, host and process of the one that writes


def write_whole(file: str | Path, content: str | bytes) -> Path:
    """Write ``content`` to the file, text in UTF-8. The old content stays until the new one is completely on the disk.

    Folders on the way are made, the file has the mode that the umask gives, and what a killed process of this
    machine left half-written for the same file goes. Raises InputError for a place that cannot be written to, and
    where there is no room.
    """
    path = file_path("file", file)
    data = content.encode("utf-8") if isinstance(content, str) else content
    # A number of a process holds on one machine only, and several may share a disk.
    host = re.sub(r"[^\w]", "_", socket.gethostname())
    partial = path.parent / f".{_beginning(path.name)}.{host}-{os.getpid()}-{secrets.token_hex(4)}.partial"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_left_over(path, host)
        # A new file: "x" never opens one that is there.
        with partial.open("xb") as stream:
            stream.write(data)
            stream.flush()
            # On the disk before it takes the name: after a crash the name stands for the old content or the new.
            os.fsync(stream.fileno())
        os.replace(partial, path)
    except OSError as error:
        remedy = f"{error.strerror or error}; what was there is as it was"
        raise InputError("file", str(path), "lie in a folder that can be written to, with room", remedy) from None
    finally:
        with suppress(OSError):
            # It has its name by now, unless there was an error.
            partial.unlink()
    return path


def _beginning(name: str) -> str:
    """The first 150 bytes of a name: file systems allow 255 in all, and the rest is needed."""
    return name.encode("utf-8")[:150].decode("utf-8", errors="ignore")


def _remove_left_over(path: Path, host: str) -> None:
    for left in path.parent.glob(".*.partial"):
        match = PARTIAL.fullmatch(left.name)
        # Only what a dead process of this machine left: a living one is still writing.
        if match and match[1] == _beginning(path.name) and match[2] == host and not _lives(int(match[3])):
            left.unlink(missing_ok=True)


def _lives(process: int) -> bool:
    """Return True if a process with that number exists, or may exist."""
    if os.name == "nt":  # there the signal 0 would interrupt the process
        return True
    # Signal 0 sends nothing: it tests whether the process exists.
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True
