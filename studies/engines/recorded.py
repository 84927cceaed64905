"""The runs that an adapter has written, as an integrator of the score.

An engine may live in a Python of its own: its adapter is a program that reads the problems and writes files.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import stiffbeam as sb
from stiffbeam.testset.integrators import Made, ProblemSolver
from stiffbeam.testset.measure import motion_of
from stiffbeam.testset.problem import Problem, folder

HERE = Path(__file__).resolve().parent


class Unsupported(sb.InputError):
    """A problem that an engine does not support, and the reason, which is the whole message."""

    def __init__(self, reason: str) -> None:
        super().__init__("problem", reason, "be supported by the engine", "score another engine on it")
        self.args = (reason,)


@dataclass(frozen=True)
class Recorded(ProblemSolver):
    """The runs in ``out``; its levels are those that were made."""

    out: Path = field(default_factory=Path)

    def levels(self, problem: Problem) -> Sequence[float]:
        made = [float(f.stem.removeprefix(f"{problem.name}-")) for f in self.out.glob(f"{problem.name}-*.npz")]
        found = sorted(x for x in made if (self.out / f"{problem.name}-{x:g}.npz").exists())
        return (found[::-1] if self.adaptive else found) or [0.0]


def recorded(out: Path) -> Recorded:
    """The runs that an adapter wrote into ``out``."""
    record = json.loads((out / "engine.json").read_text("utf-8"))

    def solve(problem: Problem, level: float, t_end: float) -> Made:
        if problem.name in record["refused"]:
            raise Unsupported(record["refused"][problem.name])
        if problem.name in record["failed"] and not level:
            raise RuntimeError(next(iter(record["failed"][problem.name].values())))
        with np.load(out / f"{problem.name}-{level:g}.npz") as run:
            motion = motion_of(problem, run["t"], run["q"], run["v"])
            return Made(level, level, float(run["seconds"]), motion)

    return Recorded(record["engine"], source=solve, tolerances=record["adaptive"], out=out)


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
