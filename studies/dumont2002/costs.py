"""Costs of the schemes: ratios within a table, beside those of the paper's CPU seconds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from stiffbeam.files.cases import Case, paper_cases
from stiffbeam.march.integrate import integrate
from stiffbeam.measures.errors import tip_error
from stiffbeam.model.semidiscretisation import semidiscretise
from stiffbeam.references import reference
from stiffbeam.schemes import Scheme
from stiffbeam.studies.base import first_impacts
from stiffbeam.trajectory.trajectory import Diverged

from .table import Reading, equation_of

REPEATS = 15
# The scheme of a table that the others are counted in: HHT, else the Nystroem form.
REFERENCE_SCHEME = ("(4.13)", "(4.14)")
CPU_TABLES = ((1, 2, 3, 4, 5), (6, 7, 8, 9), (10, 11, 12, 13))


def costs(tables: Sequence[int], reading: Reading) -> list[dict[str, Any]]:
    """One row per table and run: the paper's seconds, ours a step, both over the table's reference scheme.

    Timed one after the other in this process, the least of REPEATS; seconds depend on the machine, ratios within a
    table less so.
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
        unit = next(equation for equation in REFERENCE_SCHEME if equation in timed)
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

    The runs take turns, so that other work on the machine slows all of them alike; it only ever adds time.
    """
    systems = {form: semidiscretise(case.beam, case.cells, form) for _, form in runs}
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


def ratios(rows: Sequence[dict[str, Any]], tables: tuple[int, ...], equation: str) -> tuple[list[float], list[float]]:
    """The paper's and our ratios of an equation to the reference scheme of its table."""
    found = [r for r in rows if r["table"] in tables and r["equation"] == equation and r["ratio"] is not None]
    return [r["paper_ratio"] for r in found], [r["ratio"] for r in found]


ERRORS = (1e-2, 1e-3, 1e-4)  # rms over the largest displacement
RUNGS = 8  # to a factor of two in the step: a ratio of works is known to a rung, 9 %
LADDER = (-2, 8)  # from four times the table's step to a 256th of it


def steps_needed(table: int, scheme: Scheme, impacts: int = 4) -> dict[float, int | None]:
    """For each of ERRORS the fewest steps from which on the tip error stays below it; None where the finest is above.

    Over the first ``impacts`` impacts, inside the horizon, with RUNGS steps to a factor of two over LADDER halvings of
    the table's step.
    """
    case = paper_cases()[f"table{table}"]
    system = semidiscretise(case.beam, case.cells)
    end = first_impacts(case, "displacement", impacts)
    exact = reference(system, end)
    found: dict[float, int | None] = dict.fromkeys(ERRORS)
    open_ = set(ERRORS)
    for k in reversed(range(RUNGS * LADDER[0], RUNGS * LADDER[1] + 1)):
        steps = round(end / case.dt * 2.0 ** (k / RUNGS))
        run = integrate(system, scheme, end / steps, end, every=max(1, steps // 1000))
        u = exact.at(run.t)[0]
        error = tip_error(run.tip, u).rms
        open_ &= {wanted for wanted in ERRORS if error <= wanted}
        found |= dict.fromkeys(open_, steps)
        if not open_:
            break
    return found
