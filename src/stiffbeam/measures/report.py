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
from .errors import ContactMeasures

if TYPE_CHECKING:
    from ..model.problem import BeamProblem
    from .comparison import Comparison, ContactComparison

DASH = "–"
WIDTH = 100  # letters of a line of text
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
    """Number of impacts, largest contact force or, on rigid stops, impulse, and largest displacement of a run, and the
    horizon within it."""
    records = run.contacts
    sizes: dict[str, Any] = {
        "contact force": [record.peak_force for record in records],
        "impulse": [x for record in records if record.stops.rigid for x in record.impacts.impulses],
        "displacement": np.abs(run.tip),
    }
    facts = [f"largest {name} {np.nanmax(x):.4g}" for name, x in sizes.items() if np.any(np.greater(x, 0.0))]
    if records and not any(record.impacts.kind == "unknown" for record in records):
        facts.insert(0, several(sum(record.impacts.count for record in records), "impact"))
    if isinstance(run, Reference) and run.horizon < run.t[-1]:
        facts.append(f"horizon t = {run.horizon:.4g}")
    return ", ".join(facts) or "at rest"


def extremes(values: Mapping[str, float], written: Callable[[float], str]) -> str:
    """The least and the largest of the numbers that are known, each with the short name of its method."""
    known = sorted((value, short(name)) for name, value in values.items() if np.isfinite(value))
    if not known:
        return "not known"
    (low, first), (high, last) = known[0], known[-1]
    if written(low) == written(high):
        return f"{written(low)} ({first if len(known) == 1 else 'all'})"
    return f"{written(low)} ({first}) to {written(high)} ({last})"


def verdict(comparisons: Sequence[Comparison]) -> str:
    """A sentence on runs with one reference: how long their impacts match, or how far off the tip is."""
    known = {c.label: c.matched_until for c in comparisons if c.contacts and np.isfinite(c.matched_until)}
    name = error_name(comparisons[0].pair[1])
    if not known:
        errors = extremes({c.label: c.tip_error_rms for c in comparisons}, percent)
        return f"{name} {errors} rms to t = {comparisons[0].window:.3g}"
    if len(comparisons) == 1:
        (one,) = comparisons
        error = percent(one.tip_error_to(one.matched_until))
        return f"impacts match to t = {one.matched_until:.3g}, {name} {error} rms"
    return f"impacts match to t = {extremes(known, '{:.3g}'.format)}"


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

    def text(self, width: int | None = None) -> str:
        """The report in lines of at most ``width`` letters; a wider table is in parts with the same first column."""
        before, after = (
            [line if width is None else fill(line, width) for line in lines if line]
            for lines in (self.before, self.after)
        )
        tables = [f"{title}\n{_table_text(frame, width)}\n".lstrip("\n") for title, frame in self.tables if len(frame)]
        return "\n".join([*before, *tables, *after])

    def __str__(self) -> str:
        return self.text(WIDTH)


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


def _table_text(frame: Any, width: int | None) -> str:
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
    remarks, tables, notes = dict.fromkeys(c.remark for c in comparisons), list[tuple[str, Any]](), dict[str, None]()
    if comparisons:
        tables = [_table(comparisons, to_end) for to_end in (False, True)]
        heads = " ".join(str(head) for _, frame in tables for head in frame)
        notes = dict.fromkeys(_notes(comparisons, heads))
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

    def of_run(c: Comparison) -> dict[str, str]:
        if to_end:
            return {"ns per step": number(c.ns_per_step), "energy lost": energy_share(c.totals_energy_lost)}
        return {
            error: percent(c.tip_error_to(min(common, c.window))), lag: number(c.phase.lag, 2),
            "energy lost": energy_share(c.energy_lost),
            "impacts right to": _until(c.matched_until, c.window, first.window),
        }  # fmt: skip

    def of_contact(c: Comparison, run: bool, contact: ContactComparison | None) -> dict[str, str]:
        side = ("run" if run else "reference") + "_totals" * to_end
        x = ContactMeasures() if contact is None else getattr(contact, side)
        row = {"impacts": str(x.impacts) if x.impacts >= 0 else DASH, "contact time": percent(x.fraction)}
        if to_end:
            return row | {force: number(x.peak_force, 4), impulse: number(x.impulse, 4)}
        if contact is None or not run or contact.run.impacts < 0:
            return row
        until = _until(contact.matching.matched_until, c.window, first.window)
        return row | {delay: number(contact.matching.median_delay, 2), "impacts right to": until}

    rows = list[dict[str, str]]()
    lines = [(f"{short(first.reference)} (reference)", first, False)]
    lines += [(name, c, True) for name, c in zip(_names(comparisons), comparisons, strict=True)]
    for name, c, run in lines:
        if run and to_end and not c.steps:
            continue  # the adaptive solvers end at the horizon
        contact = c.contacts[touched[0]] if touched else None
        alone = of_contact(c, run, contact) if len(touched) < 2 else {}
        rows.append({"run": name} | alone | (of_run(c) if run else {}))
        for i in touched if len(touched) > 1 else ():
            rows.append({"run": f"  {c.contacts[i].name}"} | of_contact(c, run, c.contacts[i]))
    order = ["run", "ns per step", error, lag, delay, "energy lost", "impacts right to", "impacts",
             "contact time", force, impulse]  # fmt: skip
    frame: Any = pandas.DataFrame(rows).fillna("")
    kept = [head for head in order if head in frame and not frame[head].isin([DASH, ""]).all()]
    return _title(comparisons, to_end), frame[kept]


def _title(comparisons: Sequence[Comparison], to_end: bool) -> str:
    """Title of a table. Past the horizon, or where impacts differ, single runs differ by chance."""
    first, end = comparisons[0], max(c.t_end for c in comparisons)
    form = first.reference.partition("@")[2]
    if not to_end:
        return f"To the horizon t = {number(first.window)}, {form} form"
    parted = min((c.matched_until for c in comparisons if c.matched_until < c.window), default=first.window)
    differ = f"; impacts differ from t = {number(parted)} on" if parted < first.window else ""
    if first.window < end * (1 - 1e-9):
        differ = ": one realisation each, compare statistically"
    return f"To t = {end:g}, {form} form{differ}"


def _until(until: float, window: float, horizon: float) -> str:
    """The time to which impacts match, or the words for the end of the table or of a shorter run."""
    end = "its end" if window < horizon * (1 - 1e-9) else "horizon"
    return DASH if np.isnan(until) else number(until) if until < window else end


HEADS = {  # what the heads of columns mean
    "lag": "Lag: > 0 is late.", "delay": "Delay: > 0 is late.",
    "energy lost": "Energy lost: by the scheme, of the energy supplied.",
    "impacts": "Impacts: those that the time steps show.",
}  # fmt: skip
ON_RIGID_STOPS = "Impacts: of a scheme one a step at most, of the reference all, beside arrays those of their steps."


def _notes(comparisons: Sequence[Comparison], heads: str) -> Iterator[str]:
    """The notes without which the tables, with these heads of columns, would be misread."""
    first, common = comparisons[0], common_window(comparisons)
    match = "" if common == first.window else ", where the impacts of all runs still match"
    rigid = any(np.isnan(c.reference.peak_force) for c in first.contacts)
    counted = {"impacts": ON_RIGID_STOPS} if rigid else {}
    meanings = [meaning for head, meaning in (HEADS | counted).items() if head in heads]
    error = error_name(first.pair[1])
    yield " ".join([f"{error.capitalize()}: rms over max |u|, to t = {number(common)}{match}.", *meanings])
    touched, contacts = _touched(comparisons), first.contacts
    if 0 < len(touched) < len(contacts):
        yield f"Never touched: {len(contacts) - len(touched)} of {len(contacts)} contacts."
    events = sum(c.reference_totals.event_impacts for c in contacts)
    if events != sum(c.reference_totals.impacts for c in contacts):
        yield f"The reference has {events} impacts to t = {first.t_end:g} in all."
    for c in (c for c in comparisons if np.isnan(c.energy_lost) and c.pair[0].has_energy):
        why = "almost no energy is supplied"
        if not c.pair[0].energy.is_resolved(len(c.times) - 1):
            why = "the time step does not resolve the dissipation of dampers"
        yield f"Energy lost is {DASH} or left out where {why}."
    system = first.pair[1].system
    if first.reference.partition("@")[0] in ("exact", "multiprecision") and system is not None and system.problem:
        yield "The reference is exact for this mesh; `stiffbeam study space` measures the mesh."
    for run in (first.pair[1], *(c.pair[0] for c in comparisons)):
        if "budget" in run.provenance:
            yield f"{short(run.label)} was computed {run.provenance['budget']}, and its {error} is to that time."
    if any(x.impacts.at_start for x in first.pair[1].contacts):
        yield "A contact that begins at t = 0 counts as contact, not as an impact."
    for c in comparisons:
        yield from (f"{c.label.partition('@')[0]}, {reason}." for reason in c.missing)
