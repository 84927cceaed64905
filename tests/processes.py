"""The processes that a command has started, and pytest in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path


def passed(folder: Path, text: str, **environment: str) -> str:
    """The output of pytest on a test file of this text, whose tests pass, in a folder of its own."""
    (folder / "pytest.ini").touch()  # nothing above the folder is asked
    (folder / "test_mine.py").write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", "pytest.ini", "test_mine.py"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=os.environ | environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


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
