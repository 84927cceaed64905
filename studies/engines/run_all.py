"""MuJoCo, EXUDYN, Siconos, GetFEM and PyBullet on the test set.

    python studies/engines/run_all.py [--python NAME=PATH ...] [--runs DIR] [--beside NAMES]

writes README.md of this folder. Each engine runs by its adapter, in the interpreter that has it: this one, or PATH.
One that is not installed is said to be so. DIR keeps the runs, and gives those that it holds already. NAMES: schemes
and solvers of this package to show beside them. Some ten minutes.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from recorded import HERE, recorded, run

import stiffbeam as sb

ADAPTERS = {
    "mujoco": ["mujoco_engine.py"],
    "exudyn": ["exudyn_engine.py", "exudyn_engine.py --dopri5"],
    "siconos": ["siconos_engine.py"],
    "getfem": ["getfem_engine.py"],
    "pybullet": ["pybullet_engine.py"],
}


PAGE = """# Engines of others on the test set

`python studies/engines/run_all.py --python NAME=PATH ...` runs each engine by its adapter in this folder, in the
interpreter that has it, over [the problems](../../reference/problems/README.md), and scores what it has written. Beside
them stand solvers of this package (`--beside`). MuJoCo, EXUDYN and PyBullet come by pip (`pip install
"stiffbeam[engines]"`), Siconos and GetFEM with Debian (python3-siconos, python3-getfem). An adapter needs NumPy, its
engine and `problem_file.py`, which reads the TOML files: the way to add another one.

```text
{card}
```

How each is set up; the first lines of its adapter say more:

{engines}
{absent}
Long runs are left out where an engine is called from Python at every step; such a cell is the finest of fewer steps.

What they get right: EXUDYN and Siconos take the trapezoidal rule on everything compliant that they can express, and
print the same errors as each other, as GetFEM at the same steps, and as this package's own; only kelvin-voigt, where
the force jumps within a step, is taken differently. EXUDYN's DOPRI5 meets its tolerance on all seventeen. MuJoCo has a
spring with a dead band, which is a compliant stop without any approximation, and with RK4 it is more exact at the same
step than the implicit rule wherever it is stable; where it is not, it warns. Siconos' Moreau-Jean converges on every
rigid problem, and at second order through the sticking phase. PyBullet, made for speed, is of first order.

What to know: MuJoCo has no restitution; a limit tuned as a damped spring gives it back with a contact that lasts
eight steps, so a rebound is late by as many (nonsmooth-mode needs more steps than are taken here). PyBullet by default
pushes out of a plane with a speed of contactERP times depth over step, which is left to the ball; it is set to 0. On
two-mass-chain and hammer-pulse its forces from the begin of a step cost it the order at these steps. EXUDYN's limit
stops switch with the state of the step before; the law is a force function instead. GetFEM's and EXUDYN's contacts
have no restitution, and Siconos' relations no power law.

Not to be had: cardillo and Siconos are not on the package index, and Chrono's bindings come with conda only (the
pychrono of the index is something else).
"""


def runs_of(name: str, python: str, into: Path) -> tuple[list[Path], str]:
    """Folders of the runs of one engine, and why there are none."""
    found = []
    for k, adapter in enumerate(ADAPTERS[name]):
        out = into / f"{name}{k}"
        out.mkdir(parents=True, exist_ok=True)
        if not (out / "engine.json").exists():
            print(adapter, flush=True)
            try:
                run(python, adapter, out)
            except (RuntimeError, OSError) as error:
                return found, str(error)
        found.append(out)
    return found, ""


def described(out: Path) -> str:
    """Version and options, and what failed."""
    record = json.loads((out / "engine.json").read_text("utf-8"))
    failed = [
        f"{problem} in {', '.join(levels)} steps ({next(iter(levels.values())).partition(': ')[2]})"
        for problem, levels in record["failed"].items()
    ]
    tail = f"; no run of {'; '.join(failed)}" if failed else ""
    return f"* {record['engine']}, version {record['version']}: {record['options']}{tail}."


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--python", action="append", default=[], metavar="NAME=PATH", help="interpreter of an engine")
    asked.add_argument("--runs", type=Path, help="folder that keeps the runs")
    beside = "trapezoidal,moreau-jean,exact"
    asked.add_argument("--beside", default=beside, metavar="NAMES", help="solvers of this package")
    given = asked.parse_args()
    pythons = dict(each.split("=", 1) for each in given.python)
    with tempfile.TemporaryDirectory() as own:
        into = (given.runs or Path(own)).resolve()
        folders, missing = [], []
        for name in ADAPTERS:
            made, why = runs_of(name, pythons.get(name, sys.executable), into)
            folders += made
            missing += [f"{name} ({why})"] if why else []
        engines = [recorded(out) for out in folders]
        show = lambda what, done, total: print(f"{done}/{total} {what}", flush=True)  # noqa: E731
        card = sb.score([*engines, *filter(None, given.beside.split(","))], statistics=False, progress=show)
        said = "\n".join(described(out) for out in folders)
    absent = f"\nNot installed there, and not run: {', '.join(missing)}.\n" if missing else ""
    text = PAGE.format(card=card, engines=said, absent=absent)
    (HERE / "README.md").write_text("\n".join(x.rstrip() for x in text.split("\n")), "utf-8")
    print(card)


if __name__ == "__main__":
    main()
