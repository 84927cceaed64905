"""MuJoCo on the test set, beside schemes and solvers of this package.

    python studies/engines/run_all.py [--beside NAMES] [NAME ...]

prints the scorecard of all problems, or of those named. README.md has recorded results of more engines. An adapter is
a program of its own, which reads the problems and writes files: its engine may live in another Python.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import stiffbeam as sb
from stiffbeam.integrators import FUNCTION, Integrator, finite_run
from stiffbeam.testset.problem import folder
from stiffbeam.trajectory.trajectory import Work


def run(adapter: str, out: Path, names: Sequence[str] = ()) -> None:
    """Let ``adapter`` of this folder run on the problems, all or of ``names``.

    Raises RuntimeError with the last line of its errors where it breaks off.
    """
    program = [sys.executable, str(Path(__file__).with_name(adapter)), str(folder()), str(out), *names]
    found = subprocess.run(program, capture_output=True, text=True, cwd=out)
    if found.returncode:
        raise RuntimeError((found.stderr.strip().splitlines() or [f"exit status {found.returncode}"])[-1])


def recorded(out: Path) -> Integrator:
    """The runs that an adapter wrote into ``out``, as an integrator of the score."""
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
        with np.load(file) as arrays:
            made = finite_run((arrays["t"], arrays["q"], arrays["v"]), system, record["engine"])
            seconds = float(arrays["seconds"])
        return replace(made, work=Work(int(steps), seconds, seconds))

    return Integrator(record["engine"], FUNCTION, solve)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="problems of the test set")
    parser.add_argument("--beside", default="trapezoidal,moreau-jean,exact", help="solvers of this package")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as out:
        run("mujoco_engine.py", Path(out), given.names)
        rows = [recorded(Path(out)), *filter(None, given.beside.split(","))]
        print(sb.score(rows, given.names or None))


if __name__ == "__main__":
    main()
