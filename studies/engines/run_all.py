"""MuJoCo, EXUDYN, Siconos, GetFEM and PyBullet on the test set.

    python studies/engines/run_all.py [--python NAME=PATH ...] [--runs DIR] [--beside NAMES]

writes README.md of this folder, in some ten minutes. Each engine runs by its adapter, in the interpreter that has it:
this one, or PATH. The page names the engines that are not installed. DIR keeps the runs; runs that it already holds are
not repeated. NAMES are schemes and solvers of this package to show beside the engines.
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


PAGE = """# External engines on the test set

`python studies/engines/run_all.py --python NAME=PATH ...` runs each engine on
[the problems](../../reference/problems/README.md) and scores its output. Each engine has an adapter in this folder. The
adapter runs in the Python interpreter PATH that has the engine. `--beside` names solvers of this package that the table
shows too.

| engine | install with |
|---|---|
| MuJoCo, EXUDYN, PyBullet | pip: `pip install "stiffbeam[engines]"` |
| Siconos, GetFEM | Debian: python3-siconos, python3-getfem |

An adapter needs NumPy, its engine and `problem_file.py`, which reads the TOML files.
[CONTRIBUTING](../../CONTRIBUTING.md#add-an-external-engine) shows how to add an engine.

The first line of the table names the version of the test set. No engine has run the problems that
[later versions](../../reference/problems/README.md#how-the-answers-are-made-and-changed) added.

```text
{card}
```

Settings of each engine (the docstring of its adapter gives more):

{engines}
{absent}
If Python calls an engine at every step, long runs are left out. The table then shows the finest of the other runs.

Results:

* EXUDYN and Siconos compute the trapezoidal rule on every compliant problem that they can express. Their errors equal
  each other, those of GetFEM at the same time steps, and those of this package. The exception is kelvin-voigt, where
  the force jumps within a step.
* EXUDYN's DOPRI5 meets its tolerance on all compliant problems of the table.
* MuJoCo has a spring with a dead band, which is a compliant stop without any approximation. With RK4 it is more
  accurate at the same time step than the implicit rule wherever it is stable. Where it is unstable, it warns.
* Siconos' Moreau-Jean converges on every rigid problem, with second order through the sticking phase.
* PyBullet, made for speed, is of first order.

Limitations:

* MuJoCo has no restitution. A limit tuned as a damped spring gives the same rebound speed. Its contact lasts eight time
  steps, so each rebound is late by eight steps. On nonsmooth-mode it needs more steps than these runs have.
* By default PyBullet pushes a body out of a plane with the speed contactERP times depth over time step, and the ball
  keeps this speed. The adapter therefore sets contactERP to 0. On two-mass-chain and hammer-pulse PyBullet loses order
  at these time steps, because it uses the forces from the beginning of each step.
* EXUDYN's limit stops open and close by the state of the previous step. The adapter gives the contact law as a force
  function instead.
* The contacts of GetFEM and EXUDYN have no restitution, and the relations of Siconos have no power law.

Not included: cardillo is not on the package index, and Chrono's bindings come with conda only (the pychrono of the
index is another program). Siconos is not on the package index either.
"""


def runs_of(name: str, python: str, into: Path) -> tuple[list[Path], str]:
    """Folders of the runs of one engine, and the reason if there are none."""
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
    """Version, options and failed runs of an engine, one line."""
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
