"""Does ``doubt`` name the right source of uncertainty? Random beams, each ranked by brute force with other draws.

    python tests/campaigns/doubt_ranks.py --systems 20 --seed 3

Every beam has a mesh, one uncertain parameter and admissible errors, all random over decades, so that scheme, mesh and
data all come first somewhere. Brute force draws other members, builds each beam by itself and follows it by matrix
exponentials between events (``tests/oracles/vibro_march.py``). The error of the mesh is the distance to beams of 12
cubic elements, a form of order 4: their errors are a hundredth of those of 32 cells. Printed for every quantity: the
source that the budget names, its rank by brute force, and the sizes. A ranking may stay open only between two sources
within a factor of 2.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("", "oracles")]

import numpy as np
import pandas as pd
from vibro_impact import Case as Motion
from vibro_impact import Contact
from vibro_march import solve

import stiffbeam as sb
from stiffbeam.files.cases import Case, case_of
from stiffbeam.model.members import value_at
from stiffbeam.studies.advise import advised_row
from stiffbeam.studies.common import scheme_of

DRAWS, MORE = 32, 128  # if not all verdicts are confirmed, MORE draws decide
MEMBERS = 96  # of the budget
ALIKE = 2.0  # largest ratio of sources that may be named as alike
CLEAR = 4.0  # a largest size so many times the second takes no further draws
PARAMETERS = ("stiffness", "stops.stiffness", "stops[0].upper", "loads[0].time.amplitude")
T_END = 0.9
TRUE = (12, "hermite")  # cells and form that stand for the beam itself


class Beam:
    """A random beam: ``build(factor, cells, form)`` with the uncertain parameter times ``factor``."""

    def __init__(self, seed: int, index: int) -> None:
        rng = np.random.default_rng([seed, index, 37])
        self.stiffness, self.viscosity = rng.uniform(1.0, 5.0), rng.choice([0.005, 0.03])
        self.kappa, self.gap = 10 ** rng.uniform(2.0, 3.3), rng.uniform(0.002, 0.01)
        self.load = (0.3 * rng.uniform(0.5, 1.5), rng.uniform(4.0, 20.0), rng.uniform(0.0, 6.3))
        self.places = (None,) if rng.random() < 0.6 else (0.5, None)
        self.cells = int(rng.choice([4, 8, 16, 32]))
        self.parameter, self.tolerance = str(rng.choice(PARAMETERS)), 10 ** rng.uniform(-4.0, -0.5)
        self.want = {"tip": 10 ** rng.uniform(-2.5, -0.4), "peak_force": 10 ** rng.uniform(-1.5, -0.3)}
        self.factors = rng.uniform(1.0 - self.tolerance, 1.0 + self.tolerance, MORE)

    def build(self, factor: float, cells: int, form: str = "displacement") -> sb.System:
        factors = {name: factor if name == self.parameter else 1.0 for name in PARAMETERS}
        stops = [
            sb.Stops(
                -self.gap, self.gap * (1.0 if i else factors["stops[0].upper"]),
                stiffness=self.kappa * factors["stops.stiffness"], position=place,
            )
            for i, place in enumerate(self.places)
        ]  # fmt: skip
        amplitude, frequency, phase = self.load
        load = sb.Harmonic(amplitude * factors["loads[0].time.amplitude"], frequency, phase)
        problem = sb.BeamProblem(
            stiffness=self.stiffness * factors["stiffness"], viscosity=self.viscosity, stops=stops,
            loads=(sb.PointLoad(0.7, load),),
        )  # fmt: skip
        return sb.semidiscretise(problem, cells, form)

    def case(self, cells: int = 0) -> Case:
        case = case_of(self.build(1.0, cells or self.cells), T_END / 1000, T_END, "random")
        value = value_at(case.system(), self.parameter)
        ends = (value * (1.0 - self.tolerance), value * (1.0 + self.tolerance))
        return replace(case, uncertain={self.parameter: ends})

    def exact(self, factor: float, t: np.ndarray, cells: int, form: str = "displacement") -> dict[str, np.ndarray]:
        """Tip (k,) and largest forces of one beam by matrix exponentials."""
        s = self.build(factor, cells, form)
        ((row, wave),) = s.loads
        contacts = tuple(Contact(c.row, c.stops.lower, c.stops.upper, c.stops.stiffness) for c in s.contacts)
        one = solve(Motion(
            s.mass, s.damping, s.stiffness, s.q0, s.v0,
            ((row, ("harmonic", wave.amplitude, wave.frequency, wave.phase)),), contacts,
            s.channels[s.tip_channel][0], T_END,
        ))  # fmt: skip
        depths = [max((e.depth for e in one.episodes(i)), default=0.0) for i in range(len(contacts))]
        return {"tip": one.tip(t), "peak_force": np.array([c.kappa * d for c, d in zip(contacts, depths, strict=True)])}


def brute(beam: Beam, run: Any, draws: int = DRAWS) -> dict[str, dict[str, float]]:
    """Sizes of scheme, mesh and data for every quantity, from as many draws as it takes to rank them."""
    steps = round(T_END / run.dt)
    every = max(1, steps // 400)
    t = np.arange(0, steps + 1, every) * run.dt
    rows: dict[str, list[dict[str, np.ndarray]]] = {"exact": [], "fine": [], "run": []}
    for number, x in enumerate(beam.factors[:draws], 1):
        rows["exact"].append(beam.exact(x, t, beam.cells))
        rows["fine"].append(beam.exact(x, t, *TRUE))
        one = sb.integrate(beam.build(x, beam.cells), scheme_of(run.scheme), run.dt, T_END, run.contact)
        rows["run"].append({"tip": one.tip[::every], "peak_force": np.array([c.peak_force for c in one.contacts])})
        if number in (8, 16) and draws == DRAWS and all(ranked(each) for each in sizes_of(rows).values()):
            break
    return sizes_of(rows)


def ranked(sizes: dict[str, float]) -> bool:
    """True if the largest exceeds the second CLEAR times, or all are 0."""
    second, first = sorted(sizes.values())[-2:]
    return first >= CLEAR * second


def sizes_of(rows: dict[str, list[dict[str, np.ndarray]]]) -> dict[str, dict[str, float]]:
    """Sizes from the draws so far."""
    tips, fine, marched = (np.array([x["tip"] for x in each]) for each in rows.values())
    size = np.max(np.abs(tips))

    def apart(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.mean(np.sqrt(np.mean((a - b) ** 2, axis=1))) / size)

    middle = np.median(tips, axis=0)
    sizes = {"tip": {"scheme": apart(marched, tips), "mesh": apart(fine, tips), "data": apart(tips, middle)}}
    peaks, fines, runs = (np.array([x["peak_force"] for x in each]) for each in rows.values())
    for i in range(peaks.shape[1]):
        mean = float(np.mean(peaks[:, i])) or 1.0  # nothing touches this stop, and all sizes are 0
        name = "largest force" + (f" at contact {i + 1}" if peaks.shape[1] > 1 else "")
        sizes[name] = {
            "scheme": abs(np.mean(runs[:, i] - peaks[:, i])) / mean,
            "mesh": abs(np.mean(fines[:, i] - peaks[:, i])) / mean,
            "data": np.std(peaks[:, i], ddof=1) / mean,
        }
    return sizes


def verdict(rows: pd.DataFrame, sizes: dict[str, float]) -> tuple[str, str]:
    """Right, alike or wrong, and the largest by brute force, or the sources that are named together.

    Sources are named together only if the largest is one of them and the second is within a factor ALIKE of it.
    """
    first, second, _ = sorted(sizes, key=lambda x: -sizes[x])
    largest = list(rows[rows.largest].source)
    if len(largest) == 1:
        return "right" if largest[0] == first else "wrong", first
    near = first in largest and sizes[first] < ALIKE * sizes[second]
    return "alike" if near else "wrong", " and ".join(sorted(largest))


def judged(seed: int, index: int) -> Counter[str]:
    """Outcomes of one beam: right, wrong or open, by source."""
    beam, outcomes = Beam(seed, index), Counter[str]()
    options = {"schemes": ["HHT(alpha=-0.1)", "BDF2"], "most_steps": 2**16}
    advice = sb.study("advise", beam.case(), want=beam.want, **options)
    run = advised_row(advice.table)
    if run is None or run.horizon < T_END:
        print(f"{index}: {advice.answer.verdict} {advice.answer.notes}", flush=True)
        return Counter(["without a run"])
    sizes = brute(beam, run)
    doubt = sb.study("doubt", beam.case(), dt=run.dt, scheme=run.scheme, members=MEMBERS, contact=run.contact)
    budgets = {name: rows for name, rows in doubt.table.groupby("quantity", sort=False) if name in sizes}
    if any(verdict(rows, sizes[name])[0] == "wrong" for name, rows in budgets.items() if (rows.high > 0.0).any()):
        sizes = brute(beam, run, MORE)
    for name, rows in budgets.items():
        if not (rows.high > 0.0).any():  # a stop that no beam touches
            assert not any(x > 0.0 for x in sizes[name].values())
            continue
        outcome, first = verdict(rows, sizes[name])
        outcomes[f"{outcome}, {first}"] += 1
        words = ", ".join(f"{source} {x:.2g}" for source, x in sizes[name].items())
        print(f"{index} {name}: {' and '.join(rows[rows.largest].source)}, {outcome}; {words}", flush=True)
        if outcome == "wrong":
            print(rows.to_string())
    return outcomes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--systems", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    begun, outcomes = time.monotonic(), Counter[str]()
    for index in range(options.first, options.first + options.systems):
        outcomes += judged(options.seed, index)
    print(f"{options.systems} systems in {time.monotonic() - begun:.0f} s: {dict(outcomes)}")
    return int(any(name.startswith("wrong") for name in outcomes))


if __name__ == "__main__":
    sys.exit(main())
