"""A scorecard as tables and sentences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..figures.panels import short
from .verdicts import FAILED, LOW_ORDER, NOT_FALLING, NOT_TAKEN, Entry, shown_error, summary

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from .scorecard import Scorecard

MARKS = {NOT_FALLING: " !", LOW_ORDER: " <", FAILED: "failed", NOT_TAKEN: "–"}
LEGEND = (
    "rms error of the tip at the finest step or tolerance, over the largest displacement. ! this or another error does "
    "not fall with the step, or misses the tolerance. < the order is too low. – not supported"
)
PAST_TITLE = "Past the horizon: deviation of one run, in standard deviations of the exact motions"
ODD = 0.1  # of a velocity: what it is off by where more than the step is wrong with it
COLUMNS = (
    "problem",
    "error, coarsest",
    "finest",
    "order",
    "expected",
    "impacts",
    "impact times",
    "peak force",
    "energy",
    "gradient",
    "outcome",
)


def detail_rows(entries: Sequence[Entry]) -> list[list[str]]:
    """One row for each entry, as ``COLUMNS``."""
    return [_detail_row(entry) for entry in entries]


def _detail_row(e: Entry) -> list[str]:
    if not e.runs:
        return [e.problem.name, *[""] * (len(COLUMNS) - 2), e.outcome]
    last = e.runs[-1].errors
    return [
        e.problem.name,
        shown_error(e.runs[0].errors.tip_rms) if len(e.runs) > 1 else "",
        shown_error(last.tip_rms),
        str(e.order) if np.isfinite(e.order.interval) else "",
        _expected(e),
        f"{last.impacts}{_known(e)}" if last.impacts >= 0 else "",
        *(shown_error(abs(x)) for x in (last.impact_time, last.peak_force)),
        f"{last.energy:+.1e}" if np.isfinite(last.energy) else "",
        shown_error(last.gradient),
        e.outcome,
    ]


def _expected(e: Entry) -> str:
    """The expected order; for an integrator of unknown order the largest that the problem allows."""
    if np.isfinite(e.expected) or e.adaptive or e.problem.order_limit <= 0.0:
        return f"{e.expected:.3g}" if np.isfinite(e.expected) else ""
    return f"≤ {e.problem.order_limit:.3g}"


def _known(e: Entry) -> str:
    """Number of impacts that the file lists, infinite where they are the first of infinitely many."""
    if "impacts" not in e.problem.answers:
        return ""
    return " of ∞" if "accumulation" in e.problem.answers else f" of {len(e.problem.answers['impacts'].digits)}"


PAST = ("integrator", "problem", "to t =", "steps", "impacts", "contact fraction", "median peak")


def past_rows(card: Scorecard) -> list[list[str]]:
    """Errors of each integrator's statistics, in standard deviations of the exact motions."""
    return [
        [short(e.integrator), e.problem.name, f"{e.problem.statistics.t_end:g}", f"{row['steps']:.0f}",
         *(f"{row[name]:+.1f}" for name in e.problem.statistics.values)]
        for e in card.entries for row in e.past if e.problem.statistics is not None
    ]  # fmt: skip


def detail(card: Scorecard) -> RenderableType:
    """The score of one integrator."""
    from rich.console import Group

    table = _table(f"{card.integrators[0]}: {summary(card.entries)}", COLUMNS, detail_rows(card.entries))
    return Group(table, *_past(card), *reasons(card))


def _past(card: Scorecard) -> list[RenderableType]:
    rows = past_rows(card)
    return [_table(PAST_TITLE, PAST, rows)] if rows else []


def overview_rows(card: Scorecard) -> tuple[list[str], list[list[str]]]:
    """Headings, and one row for each problem with every integrator's finest error."""
    by = {(e.integrator, e.problem.name): e for e in card.entries}
    rows = []
    for problem in card.problems:
        cells = []
        for name in card.integrators:
            e = by.get((name, problem.name))
            error = (
                "" if e is None or e.best is None or e.outcome in (FAILED, NOT_TAKEN) else shown_error(e.best.tip_rms)
            )
            cells.append("" if e is None else error + MARKS.get(e.outcome, ""))
        rows.append([problem.name, *cells])
    return ["problem", *(short(name) for name in card.integrators)], rows


def overview(card: Scorecard) -> RenderableType:
    """Several integrators beside each other; the page has their statistics past the horizon."""
    from rich.console import Group

    headings, rows = overview_rows(card)
    table = _table(f"test set {card.version}: {summary(card.entries)}", headings, rows)
    return Group(table, LEGEND, "", *reasons(card))


def reasons(card: Scorecard) -> list[str]:
    """Every flagged or refused entry as a sentence; equal reasons of several problems share one line."""
    lines = [_words(e) for e in card.flagged]
    told: dict[tuple[str, str], list[str]] = {}  # the problems by integrator and reason
    for e in card.entries:
        if e.runs and e.reason:
            told.setdefault((short(e.integrator), e.reason), []).append(e.problem.name)
    lines += [f"{who} on {', '.join(names)}: {reason}" for (who, reason), names in told.items()]
    lines += [_words(e) for e in card.entries if not e.flagged and _remark(e)]
    refused: dict[tuple[str, str], list[Entry]] = {}  # by integrator and the field that is refused
    for e in card.entries:
        if e.outcome == NOT_TAKEN:
            refused.setdefault((e.integrator, e.reason.partition(" must ")[0]), []).append(e)
    together: dict[tuple[str, tuple[str, ...]], list[Entry]] = {}  # by that field and the problems
    for (_, field), entries in refused.items():
        together.setdefault((field, tuple(e.problem.name for e in entries)), []).append(entries[0])
    for (_, names), first in together.items():
        who = ", ".join(short(e.integrator) for e in first)
        lines.append(f"not taken by {who}: {', '.join(names)}: {first[0].reason}")
    return lines


def _words(e: Entry) -> str:
    where = f"{short(e.integrator)} on {e.problem.name}"
    if e.outcome == FAILED:
        return f"{where} failed: {e.reason}"
    if e.outcome == LOW_ORDER:
        return f"{where}: order {e.order}, {e.expected:.3g} expected"
    if _remark(e):
        return f"{where}: {_remark(e)}"
    if e.missed:
        return f"{where}: the tip converges, but not {', '.join(e.missed)}"
    first, last = (shown_error(run.errors.tip_rms) for run in (e.runs[0], e.runs[-1]))
    return f"{where}: the error does not fall, {first} to {last}"


def _remark(e: Entry) -> str:
    """Hint if the finest run is the right motion except for a factor, of it, its times or its velocity."""
    if not e.runs:
        return ""
    errors = e.runs[-1].errors
    if np.isfinite(errors.factor):
        sort = "units?" if errors.factor > 0.0 else "signs?"
        return f"the right motion times a constant factor of {errors.factor:.4g}: {sort}"
    if np.isfinite(errors.clock):
        return f"the right motion, but its times are {errors.clock:g} times as long: units?"
    if abs(errors.rate) > ODD and errors.velocity > ODD > errors.tip_rms:
        sort = "units?" if errors.rate > -1.0 else "signs?"
        return f"the velocity is the rate of the position over {1.0 + errors.rate:.4g}: {sort}"
    return ""


def _table(title: str, headings: Sequence[str], rows: list[list[str]]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1))
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="right" if 0 < i < len(headings) - (headings[-1] == "outcome") else "left",
                         no_wrap=heading == "problem", overflow="fold")  # fmt: skip
    for row in rows:
        table.add_row(*row)
    return table
