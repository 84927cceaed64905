"""Costs of the schemes: ratios within a table, beside those of the paper's CPU seconds."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import stiffbeam as sb
from stiffbeam.files.cases import Case
from stiffbeam.studies.converge import cheapest

from .table import Reading, equations, published

REPEATS = 15
# The scheme of a table that the others are counted in: HHT, else the Nystroem form.
REFERENCE_SCHEME = ("(4.13)", "(4.14)")
CPU_TABLES = ((1, 2, 3, 4, 5), (6, 7, 8, 9), (10, 11, 12, 13))
ERRORS = (1e-2, 1e-3, 1e-4)  # rms over the largest displacement


def costs(reading: Reading) -> list[dict[str, Any]]:
    """One row per table and run: the paper's seconds, ours a step, both over the table's reference scheme.

    Timed one after the other in this process, the least of REPEATS; seconds depend on the machine, ratios within a
    table less so.
    """
    rows = []
    for table in (number for group in CPU_TABLES for number in group):
        paper, ours = published(sb.paper_case(table), "cpu_seconds"), _nanoseconds(sb.paper_case(table), reading)
        unit = next(equation for equation in REFERENCE_SCHEME if equation in paper)
        for equation, seconds in paper.items():
            timed = equation in ours and unit in ours
            rows.append(
                {
                    "table": table, "equation": equation, "paper_seconds": seconds, "ns_per_step": ours.get(equation),
                    "paper_ratio": seconds / paper[unit], "ratio": ours[equation] / ours[unit] if timed else None,
                    "unit": unit,
                }
            )  # fmt: skip
    return rows


def _nanoseconds(case: Case, reading: Reading) -> dict[str, float]:
    """Nanoseconds of marching a step by equation, the least of REPEATS rounds; a run that overflows has none.

    The runs take turns, so that other work on the machine slows all of them alike; it only ever adds time.
    """
    least = dict[str, float]()
    for _ in range(REPEATS):
        for equation, (scheme, form) in equations(case).items():
            with suppress(sb.Diverged):
                chosen = reading.scheme(scheme)
                run = sb.integrate(case.system(form), chosen, case.dt, case.t_end, reading.contact, every=1000)
                least[equation] = min(run.work.ns_per_step, least.get(equation, float("inf")))
    return least


def ratios(rows: Sequence[dict[str, Any]], tables: tuple[int, ...], equation: str) -> tuple[list[float], list[float]]:
    """The paper's and our ratios of an equation to the reference scheme of its table."""
    found = [r for r in rows if r["table"] in tables and r["equation"] == equation and r["ratio"] is not None]
    return [r["paper_ratio"] for r in found], [r["ratio"] for r in found]


def step_ratios(table: int) -> list[float]:
    """Steps of SDIRK over those of HHT from which on the tip error through the first impacts stays below each of
    ERRORS, as far as four times the table's step to its 256th reach."""
    case, (hht, sdirk) = sb.paper_case(table), (sb.HHT(-0.1), sb.SDIRK(nystrom=True))
    options: dict[str, Any] = {"kinds": ["contact"], "halvings": 11, "form": "displacement", "progress": False}
    records = sb.study("converge", case, dt=4.0 * case.dt, integrators=(hht, sdirk), **options)
    found = [cheapest(records.table, error, "steps") for error in ERRORS]
    return [steps[str(sdirk)] / steps[str(hht)] for steps in found if len(steps) == 2]
