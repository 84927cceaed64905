"""The whole campaign of bad input and faults, with one seed.

    python tests/campaigns/break_it.py --seed 1 --inputs 10000 --kills 100 --jobs 2

Wild inputs by surface (``fuzz.py``) and kills of a command that goes on in one folder; each with its
outcomes. Ends with 1 where an input is a violation or a kill has lost something.
"""

from __future__ import annotations

import argparse
import collections
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COMMAND = [
    "study", "modes", "table10", "--schemes", "bdf2,bathe,trapezoidal,SDIRK(gamma=0.4359)", "--jobs", "1", "--out",
]  # fmt: skip
LOSSES = ("finished points lost", "ends that differ", "half-written files")


def _begun(folder: Path) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "stiffbeam", *COMMAND, str(folder)]
    return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True)


def kills(seed: int, wanted: int, place: Path) -> collections.Counter[str]:
    """SIGKILL, SIGTERM and SIGINT at any time of a command that goes on in one folder. The finished points only grow,
    and ends as without any kill; then the folder is emptied and it all begins again."""
    rng, folder, found = random.Random(seed), place / "killed", collections.Counter[str]()
    begun = time.monotonic()
    _begun(place / "whole").communicate(timeout=600)
    longest = time.monotonic() - begun
    whole = (place / "whole" / "modes.csv").read_text()

    def finished() -> int:
        return len(list(folder.glob("points/*.json")))

    while found["kills"] < wanted or not found["runs that ended between them"]:
        before, child = finished(), _begun(folder)
        try:
            child.wait(rng.uniform(0.3, 1.2) * longest)
        except subprocess.TimeoutExpired:
            child.send_signal(rng.choice([signal.SIGKILL, signal.SIGTERM, signal.SIGINT]))
            found["kills"] += 1
        child.communicate(timeout=600)
        found["finished points lost"] += max(0, before - finished())
        found["most points there at a kill"] = max(found["most points there at a kill"], finished())
        if child.returncode == 0:
            found["runs that ended between them"] += 1
            rows = (folder / "modes.csv").read_text()
            found["ends that differ"] += rows != whole
            found["half-written files"] += len(list(folder.rglob("*.partial")))
            for file in [*folder.glob("points/*.json"), *folder.glob("modes.*")]:
                file.unlink()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("seed", 1), ("inputs", 10000), ("kills", 100), ("jobs", 2)):
        parser.add_argument(f"--{name}", type=int, default=default)
    given = parser.parse_args()
    bad = False
    if given.inputs:
        words = [sys.executable, str(Path(__file__).with_name("fuzz.py")), "--seed", str(given.seed)]
        words += ["--inputs", str(given.inputs), "--jobs", str(given.jobs)]
        limits = {"STIFFBEAM_MEMORY": "1"}
        bad = bool(subprocess.run(words, env=limits | os.environ, check=False).returncode)
    with tempfile.TemporaryDirectory() as folder:
        if given.kills:
            lost = kills(given.seed, given.kills, Path(folder))
            bad = bad or any(lost[name] for name in LOSSES)
            print("kills: ", ", ".join(f"{name} {count}" for name, count in lost.items()))
    raise SystemExit(bad)


if __name__ == "__main__":
    main()
