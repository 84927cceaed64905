"""Tables of comparisons: texts in DataFrames, which pandas writes as text, HTML and LaTeX."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.text import several, with_unit
from ..references.registry import REFERENCES
from ..schemes.labels import short_label
from ..trajectory.trajectory import Reference, Trajectory

if TYPE_CHECKING:
    from ..model.problem import BeamProblem
    from .comparison import Comparison, ContactComparison

DASH = "–"
WIDTH, SCREEN = 100, 160  # letters of a line of text, and of a table's
ROUNDING = 1e-9  # of an energy: less is rounding


def short(label: str) -> str:
    """Short name of the method in a label, method@form: that of the scheme or solver; any other as it is."""
    label = label.partition("@")[0]
    if label in REFERENCES:
        return REFERENCES[label].label
    return short_label(label).removeprefix("__main__:")


def number(value: float, digits: int = 3) -> str:
    """A short decimal, a dash for NaN."""
    return DASH if not np.isfinite(value) else f"{value:.{digits}g}"


def percent(value: float) -> str:
    """A fraction in per cent: two digits, all before the point, and a power of ten where that would be long."""
    hundredths = 100.0 * value
    if not np.isfinite(hundredths):
        return DASH
    form = ".2g" if abs(hundredths) < 99.5 else ".0f"
    return f"{hundredths:{form if 1e-4 <= abs(hundredths) < 1e5 or not value else '.0e'}} %"


def energy_share(value: float) -> str:
    """A share of the energy supplied in per cent; rounding is 0."""
    return percent(0.0 if abs(value) <= ROUNDING else value)


def point_name(problem: BeamProblem | None) -> str:
    """Name of the observed point: the tip of a beam, its mid-span where its end is held, "" of matrices."""
    return "" if problem is None else "tip" if problem.ends[1] == "free" else "mid-span"


def error_name(run: Trajectory) -> str:
    """Name of the error of the observed displacement: "tip error" of a beam, "error" of matrices."""
    return f"{point_name(run.system and run.system.problem)} error".strip()


def largest(run: Trajectory) -> str:
    """Number of impacts, where it is known, largest displacement of a run, and the horizon within it."""
    facts = [f"largest displacement {np.max(np.abs(run.tip)):.4g}"]
    if run.contacts and not any(record.impacts.kind == "unknown" for record in run.contacts):
        facts.insert(0, several(sum(record.impacts.count for record in run.contacts), "impact"))
    if isinstance(run, Reference) and run.horizon < run.t[-1]:
        facts.append(f"horizon t = {run.horizon:.4g}")
    return ", ".join(facts)


def extremes(values: Mapping[str, float], written: Callable[[float], str]) -> str:
    """The least and the largest of the numbers that are known, each with the short name of its method."""
    known = sorted((value, short(name)) for name, value in values.items() if np.isfinite(value))
    if not known:
        return "not known"
    (low, first), (high, last) = known[0], known[-1]
    if written(low) == written(high):
        return f"{written(low)}{' (all)' * (len(known) > 1)}"
    return f"{written(low)} ({first}) to {written(high)} ({last})"


def verdict(comparisons: Sequence[Comparison]) -> str:
    """A sentence on runs with one reference: how long their impacts match, or how far off the tip is."""
    known = {c.label: c.matched_until for c in comparisons if c.contacts and np.isfinite(c.matched_until)}
    if known:
        return f"impacts match to t = {extremes(known, '{:.3g}'.format)}"
    errors = extremes({c.label: c.tip_error_rms for c in comparisons}, percent)
    return f"{error_name(comparisons[0].pair[1])} {errors} rms to t = {comparisons[0].window:.3g}"


def common_window(comparisons: Sequence[Comparison]) -> float:
    """The time to which the impacts of all the runs match: up to it their errors can be compared.

    If a run misses the first impact, it is the time before that impact; the horizon if a run has no such time.
    A solver whose budget ended earlier than the others has its error to its own end.
    """
    longest = max(c.window for c in comparisons)
    # A run whose impacts part within its first step would leave no step to compare.
    whole = [c for c in comparisons if c.window >= longest * (1 - 1e-9)]
    return min((c.matched_until for c in whole if c.matched_until > c.dt), default=longest)


@dataclass(frozen=True)
class Report:
    """Lines, tables with their titles, and notes below them, as text and for a notebook."""

    before: Iterable[str]
    tables: Sequence[tuple[str, Any]]  # (title, pandas.DataFrame), each to its number of rows
    after: Iterable[str] = ()

    def text(self, width: int = SCREEN) -> str:
        """The report in lines of at most ``width`` letters; a wider table is in parts with the same first column."""
        wrap = min(width, WIDTH)
        before, after = ([fill(line, wrap) for line in lines if line] for lines in (self.before, self.after))
        tables = [f"{title}\n{_table_text(frame, width)}\n".lstrip("\n") for title, frame in self.tables if len(frame)]
        return "\n".join([*before, *tables, *after])


class Reported:
    """Views of what has a ``report``: as text, for a notebook, for a paper."""

    def report(self) -> Report:
        """Lines, tables and notes."""
        raise NotImplementedError

    def to_latex(self) -> str:
        """The tables for a paper, by booktabs."""
        options: dict[str, Any] = {"index": False, "escape": True, "position": "ht", "na_rep": DASH}
        return "\n".join(
            frame.to_latex(caption=title or None, column_format="l" + "r" * (len(frame.columns) - 1), **options)
            for title, frame in self.report().tables if len(frame)
        )  # fmt: skip

    def __str__(self) -> str:
        return self.report().text()

    def _repr_html_(self) -> str:
        report = self.report()
        tables = [f"<p><b>{escape(title)}</b></p>" * bool(title) + frame.to_html(index=False, na_rep=DASH)
                  for title, frame in report.tables if len(frame)]  # fmt: skip
        before, after = ("".join(f"<p>{escape(x)}</p>" for x in lines if x) for lines in (report.before, report.after))
        return before + "".join(tables) + after


def _table_text(frame: Any, width: int) -> str:
    """Text of a table, its first column to the left; heads of several words are in two lines."""
    import pandas

    def two_lines(head: str) -> tuple[str, str]:
        cut = min((i for i, x in enumerate(head) if x == " "), key=lambda i: abs(2 * i - len(head)), default=0)
        return head[:cut], head[cut:].strip()

    first, *heads = frame.columns
    rows = frame.set_index(first).fillna(DASH).rename_axis(index=None)
    rows.columns.name = first
    if any(" " in head for head in heads):
        rows.columns = pandas.MultiIndex.from_tuples(map(two_lines, heads), names=("", first))
    return rows.to_string(line_width=width)


def report_of(comparisons: Sequence[Comparison], failures: Sequence[tuple[str, str, str]] = ()) -> Report:
    """Tables of comparisons with one reference, to the horizon and of the whole runs, remarks and notes.

    failures: ("failed" or "refused", label, message) of what could not be compared.
    """
    remarks = dict.fromkeys(c.remark for c in comparisons)
    tables = [_table(comparisons, to_end) for to_end in (False, True) if comparisons]
    notes = dict.fromkeys(_notes(comparisons) if comparisons else ())
    return Report(remarks, tables, [*notes, *("  ".join(failure) for failure in failures)])


def _names(comparisons: Sequence[Comparison]) -> list[str]:
    """Short names of the runs, whole ones where two are alike."""
    names = [short(c.label) for c in comparisons]
    return [c.label.partition("@")[0] if names.count(x) > 1 else x for x, c in zip(names, comparisons, strict=True)]


def _touched(comparisons: Sequence[Comparison]) -> list[int]:
    """Numbers of the contacts that a run or the reference touches; the only contact in any case."""
    contacts = range(len(comparisons[0].contacts))

    def touches(contact: ContactComparison) -> bool:
        return any(m.impacts or m.event_impacts or m.fraction for m in (contact.run_totals, contact.reference_totals))

    return [i for i in contacts if len(contacts) == 1 or any(touches(c.contacts[i]) for c in comparisons)]


def _table(comparisons: Sequence[Comparison], to_end: bool) -> tuple[str, Any]:
    """A title, and a line for the reference and each run, with its only contact, or with a line for each of several.

    to_end: totals and cost of the whole runs, else the measures to the horizon. Empty columns are left out.
    """
    import pandas

    first, touched, common = comparisons[0], _touched(comparisons), common_window(comparisons)
    error = error_name(first.pair[1])
    lag, delay, force, impulse = (
        with_unit(first.units, *name)
        for name in (("lag", "time"), ("impact delay", "time"), ("peak force", "force"), ("impulse", "impulse"))
    )
    forms: dict[str, Callable[[Any], str]] = {
        "ns per step": number, error: percent, lag: "{:.2g}".format, delay: "{:.2g}".format,
        "energy lost": energy_share, "impacts right to": str, "impacts": "{:.0f}".format, "contact time": percent,
        force: "{:.4g}".format, impulse: "{:.4g}".format,
    }  # fmt: skip

    def of_run(c: Comparison) -> dict[str, Any]:
        if to_end:
            return {"ns per step": c.ns_per_step, "energy lost": c.totals_energy_lost}
        return {
            error: c.tip_error_to(min(common, c.window)), lag: c.phase.lag, "energy lost": c.energy_lost,
            "impacts right to": _until(c.matched_until, c.window, first.window),
        }  # fmt: skip

    def of_contact(c: Comparison, run: bool, contact: ContactComparison) -> dict[str, Any]:
        x = getattr(contact, ("run" if run else "reference") + "_totals" * to_end)
        row = {"impacts": x.impacts if x.impacts >= 0 else np.nan, "contact time": x.fraction}
        if to_end:
            return row | {force: x.peak_force, impulse: x.impulse}
        if not run or contact.run.impacts < 0:
            return row
        until = _until(contact.matching.matched_until, c.window, first.window)
        return row | {delay: contact.matching.median_delay, "impacts right to": until}

    rows = list[dict[str, Any]]()
    lines = [(f"{short(first.reference)} (reference)", first, False)]
    lines += [(name, c, True) for name, c in zip(_names(comparisons), comparisons, strict=True)]
    for name, c, run in lines:
        if run and to_end and not c.steps:
            continue  # the adaptive solvers end at the horizon
        alone = of_contact(c, run, c.contacts[touched[0]]) if len(touched) == 1 else {}
        rows.append({"run": name} | alone | (of_run(c) if run else {}))
        for i in touched if len(touched) > 1 else ():
            rows.append({"run": f"  {c.contacts[i].name}"} | of_contact(c, run, c.contacts[i]))
    frame: Any = pandas.DataFrame(rows).reindex(columns=["run", *forms]).dropna(axis="columns", how="all")
    for head in frame.columns[1:]:
        frame[head] = frame[head].map(forms[head], na_action="ignore")
    return _title(comparisons, to_end), frame.fillna("")


def _title(comparisons: Sequence[Comparison], to_end: bool) -> str:
    """Title of a table. Past the horizon, or where impacts differ, single runs differ by chance."""
    first, end = comparisons[0], max(c.t_end for c in comparisons)
    form = first.reference.partition("@")[2]
    if not to_end:
        return f"To the horizon t = {number(first.window)}, {form} form"
    chance = first.window < end * (1 - 1e-9) or any(c.matched_until < c.window for c in comparisons)
    return f"To t = {end:g}, {form} form{': one realisation each, compare statistically' * chance}"


def _until(until: float, window: float, horizon: float) -> str | None:
    """The time to which impacts match, or the words for the end of the table or of a shorter run."""
    end = "its end" if window < horizon * (1 - 1e-9) else "horizon"
    return None if np.isnan(until) else number(until) if until < window else end


def _notes(comparisons: Sequence[Comparison]) -> Iterator[str]:
    """The notes without which the tables would be misread, and the reasons of numbers that are missing."""
    first, common = comparisons[0], common_window(comparisons)
    match = "" if common == first.window else ", where the impacts of all runs still match"
    yield f"{error_name(first.pair[1]).capitalize()}: rms over max |u|, to t = {number(common)}{match}."
    touched, contacts = _touched(comparisons), first.contacts
    if 0 < len(touched) < len(contacts):
        yield f"Never touched: {len(contacts) - len(touched)} of {len(contacts)} contacts."
    events = sum(c.reference_totals.event_impacts for c in contacts)
    if events != sum(c.reference_totals.impacts for c in contacts):
        yield f"Impacts: those that the time steps show; the reference has {events} to t = {first.t_end:g} in all."
    for c in comparisons:
        label = c.label.partition("@")[0]
        if c.window < common:
            yield f"{label} ends at t = {number(c.window)}, and its error is to that time."
        if np.isnan(c.energy_lost) and c.pair[0].has_energy:
            why = "almost no energy is supplied"
            if not c.pair[0].energy.is_resolved(len(c.times) - 1):
                why = "the time step does not resolve the dissipation of dampers"
            yield f"{label}, energy lost: {why}."
        yield from (f"{label}, {reason}." for reason in c.missing)
