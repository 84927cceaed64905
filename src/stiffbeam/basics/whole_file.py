"""Files that appear whole or not at all: made in memory, then written beside their place and moved there."""

from __future__ import annotations

import os
import re
import secrets
import socket
from contextlib import suppress
from pathlib import Path

from .validation import InputError, file_path

PARTIAL = re.compile(r"\.(.+)\.([^.]*)-(\d+)-[0-9a-f]{8}\.partial")  # name, host and process of the one that writes


def write_whole(file: str | Path, content: str | bytes) -> Path:
    """Put ``content`` into the file, text in UTF-8; what was there stays until all of it is on the disk.

    Folders on the way are made, the file has the mode that the umask gives, and what a killed process of this
    machine left half-written for the same file goes. Raises InputError for a place that cannot be written to, and
    where there is no room.
    """
    path = file_path("file", file)
    data = content.encode("utf-8") if isinstance(content, str) else content
    host = re.sub(r"[^\w]", "_", socket.gethostname())
    partial = path.parent / f".{path.name[:150]}.{host}-{os.getpid()}-{secrets.token_hex(4)}.partial"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_left_over(path, host)
        with partial.open("xb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(partial, path)
    except OSError as error:
        remedy = f"{error.strerror or error}; what was there is as it was"
        raise InputError("file", str(path), "lie in a folder that can be written to, with room", remedy) from None
    finally:
        with suppress(OSError):
            partial.unlink()
    return path


def _remove_left_over(path: Path, host: str) -> None:
    for left in path.parent.glob(".*.partial"):
        match = PARTIAL.fullmatch(left.name)
        if match and match[1] == path.name[:150] and match[2] == host and not _lives(int(match[3])):
            left.unlink(missing_ok=True)


def _lives(process: int) -> bool:
    """Whether there is a process of that number."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True
