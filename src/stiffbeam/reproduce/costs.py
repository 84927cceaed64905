"""What the schemes cost, as ratios within a table beside the ratios of the paper's CPU seconds."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

from ..cases import Case, paper_cases
from ..march import integrate
from ..schemes import HHT, SDIRK
from ..semidiscretisation import semidiscretise
from ..solvers import reference
from ..studies.common import first_impacts
from ..trajectory import Diverged
from .reading import Reading
from .table import equation_of

REPEATS = 5
YARDSTICK = ("(4.13)", "(4.14)")  # the scheme of a table that the others are counted in: HHT, else the Nystroem form
CPU_TABLES = ((1, 2, 3, 4, 5), (6, 7, 8, 9), (10, 11, 12, 13))


def costs(tables: Sequence[int], reading: Reading) -> list[dict[str, Any]]:
    """One row per table and run: the paper's seconds, ours a step, both over the table's yardstick.

    Timed one after the other in this process, the median of REPEATS; seconds hang on the machine, ratios
    within a table less so.
    """
    rows = []
    for table in tables:
        case = paper_cases()[f"table{table}"]
        published = case.published.get("cpu_seconds", {})
        if not published:
            continue
        timed = {
            equation_of(scheme, form): (published[f"{scheme}@{form}"], _nanoseconds(case, scheme, form, reading))
            for scheme, form in case.runs
        }
        unit = next(equation for equation in YARDSTICK if equation in timed)
        paper_unit, own_unit = timed[unit]
        for equation, (paper, own) in timed.items():
            rows.append(
                {
                    "table": table, "equation": equation, "paper_seconds": paper, "ns_per_step": own,
                    "paper_ratio": paper / paper_unit,
                    "ratio": None if own is None or own_unit is None else own / own_unit,
                    "unit": unit,
                }
            )  # fmt: skip
    return rows


def _nanoseconds(case: Case, scheme, form: str, reading: Reading) -> float | None:
    """Nanoseconds of marching a step; None where the run overflows."""
    system = semidiscretise(case.problem, case.cells, form)
    try:
        runs = [
            integrate(system, reading.scheme(scheme), case.dt, case.t_end, reading.contact, every=1000)
            for _ in range(REPEATS)
        ]
    except Diverged:
        return None
    return median(run.work.ns_per_step for run in runs)


def cost_of_accuracy(error: float = 0.01, impacts: int = 4, halvings: int = 9) -> list[dict[str, Any]]:
    """Table 10's two schemes at the largest step dt/2^k with a tip error (rms) below ``error``.

    Over the first ``impacts`` impacts, inside the horizon. steps_per_time and nanoseconds per unit of time;
    None where no step tried is small enough.
    """
    case = paper_cases()["table10"]
    system = semidiscretise(case.problem, case.cells)
    end = first_impacts(case, "displacement", impacts)
    exact = reference(system, end)
    rows = []
    for scheme in (HHT(-0.1), SDIRK(nystrom=True)):
        row: dict[str, Any] = {"scheme": str(scheme), "dt": None, "error": None, "ns_per_time": None}
        for k in range(halvings):
            steps = round(end / case.dt * 2**k)
            run = integrate(system, scheme, end / steps, end)
            u = exact.at(run.t)[0]
            off = float((((run.tip - u) ** 2).mean()) ** 0.5 / abs(u).max())
            if off < error:
                row |= {"dt": end / steps, "error": off, "ns_per_time": run.work.march_seconds * 1e9 / end}
                break
        rows.append(row)
    return rows
