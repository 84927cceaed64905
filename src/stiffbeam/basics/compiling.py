"""A process that compiles kernels beside this one, into the same cache."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from . import storage
from .compiled import is_compiled
from .resources import stopped_clock

_beside: subprocess.Popen[bytes] | None = None


def begin(code: str, given: bytes = b"") -> bool:
    """Run ``code`` in a process beside this one unless there is one; return True where it begins.

    given: what it can read from its standard input. In a program that embeds Python ``sys.executable`` may be that
    program: it is not started again, and nothing runs beside it.

    Not a thread: numba compiles one function at a time and holds the GIL most of that time, so that what this process
    compiles would wait.
    """
    global _beside
    if _beside is not None or not Path(sys.executable or "").name.startswith("python"):
        return False
    # The child imports the same sources and writes to the same cache.
    paths = os.pathsep.join(path for path in sys.path if path)
    environment = os.environ | {"PYTHONPATH": paths, "STIFFBEAM_CACHE_DIR": str(storage.directory())}
    silent = subprocess.DEVNULL
    with suppress(OSError), tempfile.TemporaryFile() as whole:  # where there is no process, the first call compiles
        whole.write(given)
        whole.seek(0)
        _beside = subprocess.Popen(
            [sys.executable, "-c", code], env=environment, stdin=whole, stdout=silent, stderr=silent
        )
    return _beside is not None


def wait() -> None:
    """Wait for the process beside this one. One that has failed left nothing on disk, and the first call compiles."""
    global _beside
    process = _beside  # another thread may wait for it too, and be first
    if process is not None:
        with stopped_clock():
            process.wait()
        _beside = None


@contextmanager
def beside(kernel: Any, rehearse: Callable[[], None]) -> Generator[None]:
    """Have ``kernel`` at the end of the context. If it is not on disk, ``rehearse``, a function of a module, compiles
    it, with whatever else it calls, in a process beside this one."""
    code = f"from {rehearse.__module__} import {rehearse.__name__}; {rehearse.__name__}()"
    begun = not is_compiled(kernel) and begin(code)
    try:
        yield
    finally:
        if begun:
            wait()
