"""The processes that a command has started."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def session(leader: int) -> list[int]:
    """The processes of the session that ``leader`` began, itself among them."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(session) == leader and state != "Z":
            found.append(int(stat.parent.name))
    return found


def nobody_left(leader: int) -> None:
    """Fails where a process of the session is still there after 20 s, and ends it."""
    end = time.monotonic() + 20
    while session(leader) and time.monotonic() < end:
        time.sleep(0.1)
    left = session(leader)
    for process in left:
        os.kill(process, signal.SIGKILL)
    assert not left
