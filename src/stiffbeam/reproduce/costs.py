"""What the schemes cost, as ratios within a table beside the ratios of the paper's CPU seconds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..cases import Case, paper_cases
from ..march.integrate import integrate
from ..schemes import Scheme
from ..semidiscretisation import semidiscretise
from ..solvers import reference
from ..studies.common import first_impacts
from ..trajectory import Diverged
from .reading import Reading
from .table import equation_of

REPEATS = 15
YARDSTICK = ("(4.13)", "(4.14)")  # the scheme of a table that the others are counted in: HHT, else the Nystroem form
CPU_TABLES = ((1, 2, 3, 4, 5), (6, 7, 8, 9), (10, 11, 12, 13))


def costs(tables: Sequence[int], reading: Reading) -> list[dict[str, Any]]:
    """One row per table and run: the paper's seconds, ours a step, both over the table's yardstick.

    Timed one after the other in this process, the least of REPEATS; seconds hang on the machine, ratios
    within a table less so.
    """
    rows = []
    for table in tables:
        case = paper_cases()[f"table{table}"]
        published = case.published.get("cpu_seconds", {})
        if not published:
            continue
        own = _nanoseconds(case, case.runs, reading)
        timed = {
            equation_of(scheme, form): (published[f"{scheme}@{form}"], nanoseconds)
            for (scheme, form), nanoseconds in zip(case.runs, own, strict=True)
        }
        unit = next(equation for equation in YARDSTICK if equation in timed)
        paper_unit, own_unit = timed[unit]
        for equation, (paper, nanoseconds) in timed.items():
            rows.append(
                {
                    "table": table, "equation": equation, "paper_seconds": paper, "ns_per_step": nanoseconds,
                    "paper_ratio": paper / paper_unit,
                    "ratio": None if nanoseconds is None or own_unit is None else nanoseconds / own_unit,
                    "unit": unit,
                }
            )  # fmt: skip
    return rows


def _nanoseconds(case: Case, runs: Sequence[tuple[Scheme, str]], reading: Reading) -> list[float | None]:
    """Nanoseconds of marching a step, the least of REPEATS rounds; None where a run overflows.

    The runs take turns, so that what else the machine does meets all of them alike; a busy machine only
    ever adds.
    """
    systems = {form: semidiscretise(case.problem, case.cells, form) for _, form in runs}
    least: list[float | None] = [float("inf")] * len(runs)
    for _ in range(REPEATS):
        for i, (scheme, form) in enumerate(runs):
            best = least[i]
            if best is None:
                continue
            try:
                run = integrate(systems[form], reading.scheme(scheme), case.dt, case.t_end, reading.contact, every=1000)
            except Diverged:
                least[i] = None
                continue
            least[i] = min(best, run.work.ns_per_step)
    return least


def largest_step(scheme: Scheme, error: float = 1e-3, impacts: int = 4, halvings: int = 10) -> float | None:
    """The largest step dt/2^k of Table 10 from which on its tip error (rms) stays below ``error``.

    Over the first ``impacts`` impacts, inside the horizon. None where the finest is still above.
    """
    case = paper_cases()["table10"]
    system = semidiscretise(case.problem, case.cells)
    end = first_impacts(case, "displacement", impacts)
    exact = reference(system, end)
    found = None
    for k in reversed(range(halvings)):
        steps = round(end / case.dt * 2**k)
        run = integrate(system, scheme, end / steps, end, every=max(1, steps // 1000))
        u = exact.at(run.t)[0]
        if float((((run.tip - u) ** 2).mean()) ** 0.5 / abs(u).max()) > error:
            break
        found = end / steps
    return found
