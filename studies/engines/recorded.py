"""The runs that an adapter has written, as an integrator of the score.

An engine may live in a Python of its own: its adapter is a program that reads the problems and writes files.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import stiffbeam as sb
from stiffbeam.integrators import FUNCTION, Integrator, run_of
from stiffbeam.testset.problem import folder
from stiffbeam.trajectory.trajectory import Work

HERE = Path(__file__).resolve().parent


def recorded(out: Path) -> Integrator:
    """The runs that an adapter wrote into ``out``."""
    record = json.loads((out / "engine.json").read_text("utf-8"))
    names = {problem.system.fingerprint: name for name, problem in sb.problems().items()}

    def solve(system: sb.System, dt: float, t_end: float) -> sb.Trajectory:
        name, steps = names[system.fingerprint], f"{round(t_end / dt)}"
        if name in record["refused"]:
            engine = f"{record['engine']} ({record['refused'][name]})"
            raise sb.InputError(engine, name, "support the problem", "score another engine on it")
        if steps in record["failed"].get(name, {}):
            raise RuntimeError(record["failed"][name][steps])
        if not (file := out / f"{name}-{steps}.npz").is_file():
            raise sb.Diverged(record["engine"], 0.0, "the adapter has written no run of these steps")
        with np.load(file) as run:
            made = run_of((run["t"], run["q"], run["v"]), system, record["engine"])
            seconds = float(run["seconds"])
        return replace(made, work=Work(int(steps), seconds, seconds))

    return Integrator(record["engine"], FUNCTION, solve)


def run(python: str, adapter: str, out: Path, names: Sequence[str] = ()) -> dict[str, Any]:
    """Let ``adapter`` of this folder run on the problems, all or of ``names``, in an interpreter that has its engine.

    Returns its record. Raises RuntimeError with the last line of what it said where it breaks off.
    """
    program, *options = adapter.split()
    found = subprocess.run(
        [python, str(HERE / program), str(folder()), str(out), *options, *names],
        capture_output=True, text=True, cwd=out,
    )  # fmt: skip
    if found.returncode:
        said = found.stderr.strip().splitlines() or [f"exit status {found.returncode}"]
        raise RuntimeError(said[-1])
    return json.loads((out / "engine.json").read_text("utf-8"))
