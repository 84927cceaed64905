"""Tables of comparisons as text and HTML. force_jupyter=False keeps rich from displaying them at once in a notebook."""

from __future__ import annotations

import io
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from html import escape
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
from rich import box
from rich.console import Console, Group, RenderableType
from rich.constrain import Constrain
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from ..basics.text import html_table, several
from ..basics.units import with_unit
from ..references.registry import REFERENCES
from ..schemes.labels import short_label
from ..trajectory.trajectory import Reference, Trajectory
from .errors import ContactMeasures, Matching

if TYPE_CHECKING:
    from .comparison import Comparison, ContactComparison


def short(label: str) -> str:
    """Short name of a method: that of the scheme or of the reference solver; any other label is returned as it is."""
    if label in REFERENCES:
        return REFERENCES[label].label
    return short_label(label).removeprefix("__main__:")


DASH = "–"
EVEN = 1e-6  # of the median step: steps that differ by less are of one length
WIDTH = 80  # columns of a table that goes to a file; a terminal keeps its own
LINE = 100  # columns of a sentence on a wide terminal: longer lines are hard to follow


def number(value: float, digits: int = 3) -> str:
    """A short decimal, a dash for NaN."""
    return DASH if not np.isfinite(value) else f"{value:.{digits}g}"


def percent(value: float, sign: str = "") -> str:
    """A fraction in per cent: two digits, all before the point, and a power of ten where that would be long."""
    hundredths = 100.0 * value
    if not np.isfinite(hundredths):
        return DASH
    form = ".2g" if abs(hundredths) < 99.5 else ".0f"
    return f"{hundredths:{sign}{form if 1e-4 <= abs(hundredths) < 1e5 or not value else '.0e'}} %"


def largest(run: Trajectory) -> str:
    """Number of impacts, largest contact force or, on rigid stops, impulse, and largest displacement of a run, and the
    horizon within it."""
    records = run.contacts
    impulses = [x for record in records if record.stops.rigid for x in record.impacts.impulses]
    facts = [
        f"largest {name} {np.nanmax(values):.4g}"
        for name, values in (
            ("contact force", [record.peak_force for record in records]),
            ("impulse", impulses),
            ("displacement", np.abs(run.tip)),
        )
        if np.any(np.greater(values, 0.0))
    ]
    if records and not any(record.impacts.kind == "unknown" for record in records):
        facts.insert(0, several(sum(record.impacts.count for record in records), "impact"))
    if isinstance(run, Reference) and run.horizon < run.t[-1]:
        facts.append(f"horizon t = {run.horizon:.4g}")
    return ", ".join(facts) or "at rest"


def _names(comparisons: Sequence[Comparison]) -> list[str]:
    """Short names, or whole labels if two runs would share one."""
    # A label is method@form.
    methods = [c.label.partition("@")[0] for c in comparisons]
    names = [short(method) for method in methods]
    return [method if names.count(name) > 1 else name for method, name in zip(methods, names, strict=True)]


def _lag(comparison: Comparison) -> str:
    """The phase lag, or in brackets the median impact delay of a single contact where it is undefined."""
    if not comparison.phase.undefined:
        return number(comparison.phase.lag, 2)
    return _delay(comparison.contacts[0].matching) if len(comparison.contacts) == 1 else DASH


def _delay(matching: Matching) -> str:
    """The median impact delay in brackets."""
    return f"({number(matching.median_delay, 2)})" if np.isfinite(matching.median_delay) else DASH


def _matched(until: float, window: float, horizon: float) -> str:
    """The time to which impacts match, or the words for the end of the table or of a shorter run."""
    end = "its end" if window < horizon * (1 - 1e-9) else "horizon"
    return DASH if np.isnan(until) else number(until) if until < window else end


def _touched(comparisons: Sequence[Comparison]) -> tuple[list[Comparison], str]:
    """The comparisons without the contacts that neither run nor reference touches, and a sentence that names those."""

    def free(contact: ContactComparison) -> bool:
        measures = (contact.run, contact.reference, contact.run_totals, contact.reference_totals)
        return not any(m.impacts or m.event_impacts or m.fraction for m in measures)

    places = [contact.place for contact in comparisons[0].contacts]
    untouched = [all(free(c.contacts[i]) for c in comparisons) for i in range(len(places))]
    if len(places) < 2 or not any(untouched):
        return list(comparisons), ""
    shorter = [
        replace(c, contacts=tuple(x for x, drop in zip(c.contacts, untouched, strict=True) if not drop))
        for c in comparisons
    ]
    if all(untouched):  # the remark says so
        return shorter, ""
    runs = [list(group) for drop, group in groupby(range(len(places)), untouched.__getitem__) if drop]
    names = (places[g[0]] if len(g) == 1 else f"{places[g[0]]} to {places[g[-1]]}" for g in runs)
    return shorter, f"Never touched: {', '.join(names)}."


def common_window(comparisons: Sequence[Comparison]) -> float:
    """The time to which the impacts of all the runs match: up to it their errors can be compared.

    If a run misses the first impact, it is the time before that impact; the horizon if a run has no such time.
    A solver whose budget ended earlier than the others has its error to its own end.
    """
    longest = max(c.window for c in comparisons)
    # A run whose impacts part within its first step would leave no step to compare.
    whole = [c for c in comparisons if c.window >= longest * (1 - 1e-9)]
    return min((c.matched_until for c in whole if c.matched_until > c.dt), default=longest)


def comparison_tables(
    comparisons: Sequence[Comparison],
    references: Sequence[Reference] = (),
    failures: Sequence[tuple[str, str]] = (),
    truths: Mapping[str, Reference] | None = None,
    refused: Container[str] = (),
    verbose: bool = False,
) -> RenderableType:
    """Tables of a comparison: one per form inside the horizon, one of the whole runs, and the failures.

    truths: by form, a solution that holds over the whole span where there is one. refused: the labels of those
    failures that cannot be asked of the case. verbose: with all details below the table, as the file has them.
    """
    # The runs of one form have one reference and one table.
    by_reference = [
        [c for c in comparisons if c.reference == r] for r in dict.fromkeys(c.reference for c in comparisons)
    ]
    parts: list[RenderableType] = [Text(said) for said in dict.fromkeys(c.remark for c in comparisons) if said]
    shorter = [_touched(of_form) for of_form in by_reference]
    by_reference, comparisons = [x for x, _ in shorter], [c for of_form, _ in shorter for c in of_form]
    parts += [_inside(of_form) for of_form in by_reference]
    if comparisons:
        lines = _legend(comparisons, references) + list(dict.fromkeys(said for _, said in shorter if said))
        lines += _details(comparisons, references) if verbose else []
        parts.append(Constrain(Text("\n".join([*lines, ""]), style="dim"), LINE))
    for of_form in by_reference:
        parts.append(_whole(of_form, (truths or {}).get(of_form[0].reference.partition("@")[2])))
    for label, message in failures:
        word = ("refused  ", "bold") if label in refused else ("failed  ", "bold red")
        parts.append(Text.assemble(word, (label, "bold"), f"  {message}"))
    return Group(*parts)


def _table(title: str, headings: Sequence[str]) -> Table:
    table = Table(
        box=box.SIMPLE_HEAD,
        title=title,
        title_justify="left",
        title_style="bold",
        padding=(0, 1, 0, 0),
        show_edge=False,
    )
    table.add_column("run", overflow="fold", min_width=12)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _fitted(table: Table) -> Table:
    """The table with narrower gaps where it would not fit a file or an ordinary terminal."""
    console = Console(width=10 * WIDTH, force_jupyter=False)
    if Measurement.get(console, console.options, table).maximum > WIDTH:
        table.padding = 0
    return table


def _inside(comparisons: Sequence[Comparison]) -> Table:
    """The measures on [0, horizon] of one form's runs; errors while the impacts of all of them match."""
    first = comparisons[0]
    units = first.units
    method, _, form = first.reference.partition("@")
    common = common_window(comparisons)
    table = _table(
        f"To the horizon t = {number(first.window)}, {form} form",
        ("match to", "tip error", with_unit(units, "lag", "time"), "loss", "impacts", "contact"),
    )
    table.add_row(f"{short(method)}, reference", *4 * [DASH], *_impacts(first, "reference", True), style="bold")
    for contact in _several(first):
        table.add_row(_line(contact), *4 * [DASH], *_counts(contact.reference, True), style="bold")
    for name, c in zip(_names(comparisons), comparisons, strict=True):
        table.add_row(
            name,
            _matched(c.matched_until, c.window, first.window),
            percent(c.tip_error_to(min(common, c.window))),
            _lag(c),
            percent(c.energy_lost),
            *_impacts(c, "run"),
        )
        for contact in _several(c):
            # A negative count: the run does not determine this contact.
            known = contact.run.impacts >= 0
            until = _matched(contact.matching.matched_until if known else np.nan, c.window, first.window)
            delay = _delay(contact.matching)
            table.add_row(_line(contact), until, "", delay, "", *_counts(contact.run))
    return _fitted(table)


def _several(comparison: Comparison) -> tuple[ContactComparison, ...]:
    """The contacts with their own lines: all of them if there are several."""
    return comparison.contacts if len(comparison.contacts) > 1 else ()


def _impacts(comparison: Comparison, whose: str, events: bool = False, forces: bool = False) -> tuple[str, ...]:
    """The columns of the contact in a run's own line: of the only contact, zeros without, empty with several."""
    if _several(comparison):
        return ("", "", "", "") if forces else ("", "")
    none = ContactMeasures(0, 0, 0.0, 0.0, 0.0)
    statistics = getattr(comparison.contacts[0], whose) if comparison.contacts else none
    return _counts(statistics, events, forces)


def _counts(statistics: ContactMeasures, events: bool = False, forces: bool = False) -> tuple[str, ...]:
    """Impacts, with ``events`` those of the trajectory itself in brackets; share; peak force and impulse."""
    count = f"{statistics.impacts}" if statistics.impacts >= 0 else DASH
    count += f" [{statistics.event_impacts}]" if events else ""
    columns = (count, percent(statistics.fraction))
    return (*columns, number(statistics.peak_force, 4), number(statistics.impulse, 4)) if forces else columns


def _whole(comparisons: Sequence[Comparison], truth: Reference | None) -> Table:
    """Cost and totals of the whole runs of one form; the adaptive solvers ended at the horizon."""
    first = comparisons[0]
    method, _, form = first.reference.partition("@")
    units, end = first.units, max(c.t_end for c in comparisons)
    # Past the horizon, or where impacts have parted, the title says that single runs differ by chance.
    beyond = ": one realisation each, compare statistically" if first.window < end * (1 - 1e-9) else ""
    parted = min((c.matched_until for c in comparisons if not np.isnan(c.matched_until)), default=first.window)
    if not beyond and parted < first.window:
        beyond = f"; impacts differ from t = {number(parted)} on"
    peak = with_unit(units, "peak" if units else "peak force", "force")
    table = _table(
        f"To t = {end:g}, {form} form{beyond}",
        ("ns/step", "impacts", "contact", peak, with_unit(units, "impulse", "impulse"), "loss"),
    )
    if truth is not None:
        table.add_row(f"true, {truth.provenance['digits']} digits", DASH, *_of_truth(truth, first), DASH, style="bold")
    table.add_row(short(method), DASH, *_impacts(first, "reference_totals", True, forces=True), DASH, style="bold")
    for contact in _several(first):
        counts = _counts(contact.reference_totals, True, forces=True)
        table.add_row(_line(contact), DASH, *counts, DASH, style="bold")
    for name, c in zip(_names(comparisons), comparisons, strict=True):
        if c.steps:
            totals = _impacts(c, "run_totals", forces=True)
            table.add_row(
                name,
                f"{c.ns_per_step:.0f}" if np.isfinite(c.ns_per_step) else DASH,
                *totals,
                percent(c.totals_energy_lost),
            )
            for contact in _several(c):
                table.add_row(_line(contact), "", *_counts(contact.run_totals, forces=True), "")
    return _fitted(table)


def _line(contact: ContactComparison) -> str:
    return f"  {contact.place.removeprefix('stops at ')}"


def _of_truth(truth: Reference, comparison: Comparison) -> tuple[str, ...]:
    """The columns of the only contact of a solution that is right over the whole span."""
    if len(truth.contacts) != 1:
        return ("", "", "", "")
    record = truth.contacts[0]
    sampled = truth.impacts_sampled(comparison.dt).count
    statistics = ContactMeasures(sampled, truth.impacts.count, record.fraction, record.peak_force, record.impulse)
    return _counts(statistics, True, True)


def _legend(comparisons: Sequence[Comparison], references: Sequence[Reference]) -> list[str]:
    """The notes without which the tables would be misread."""
    first = comparisons[0]
    common = common_window(comparisons)
    while_matched = "" if common == first.window else ", while the impacts of all runs match"
    events = any(contact.reference_totals.events for c in comparisons for contact in c.contacts)
    by_events = "; of the reference, like force and impulse, by events, not sampled" if events else ""
    lines = [
        "Match to: up to this time, the impacts are those of the reference. "
        f"Tip error: rms to t = {number(common)}{while_matched}, over max |u|. "
        "Lag: positive if late; in brackets, the median delay of the impacts. "
        "Loss: numerical dissipation, over the energy put in. "
        f"Impacts: seen at the time steps, [all by events]. Contact: share of the time{by_events}."
    ]
    if any(np.isnan(c.energy_lost) and not c.missing for c in comparisons):
        lines.append("Loss is – if the time step does not resolve the dissipation of dampers.")
    system = None if first.pair is None else first.pair[1].system
    if first.reference.partition("@")[0] in ("exact", "multiprecision") and system is not None and system.problem:
        lines.append(
            "The exact solution is exact for this mesh; `stiffbeam study space` measures the error of the mesh."
        )
    lines += [
        f"{short(r.label.partition('@')[0])} was computed {r.provenance['budget']}, and its tip error is to that time."
        for r in references
        if "budget" in r.provenance
    ]
    if any(x.impacts.at_start for c in comparisons if c.pair for x in c.pair[1].contacts):
        lines.append("A contact that begins at t = 0 counts as contact, not as an impact.")
    if any(map(_several, comparisons)):
        lines.append("Impacts match as long as they match at all contacts.")
    for c in comparisons:
        lengths = np.diff(c.times)
        if np.ptp(lengths) > EVEN * c.dt:
            least, most, median = (number(x) for x in (lengths.min(), lengths.max(), c.dt))
            lines.append(f"{c.label.partition('@')[0]}: steps of {least} to {most}, {median} in the median.")
    return lines + [f"{c.label.partition('@')[0]}, {reason}." for c in comparisons for reason in c.missing]


def _details(comparisons: Sequence[Comparison], references: Sequence[Reference]) -> list[str]:
    """Horizons and cost of the references, set-up."""
    lines = [
        f"{r.label}: horizon {number(r.horizon)} "
        f"(against {r.provenance.get('horizon_against', '')}), {number(r.work.seconds)} s of computing"
        f"{' in an earlier run' if r.provenance.get('kept') else ''}."
        for r in references
    ]
    steps = [c for c in comparisons if c.steps and np.isfinite(c.seconds)]
    if steps:
        # Set-up is what the run takes beyond its steps, in milliseconds.
        ms = [1e3 * c.seconds - 1e-6 * c.ns_per_step * c.steps for c in steps]
        lines.append(
            f"A run is {max(c.steps for c in steps)} steps and {max(0.0, float(np.median(ms))):.2g} ms of set-up."
        )
    return lines


def comparison_text(comparisons: Sequence[Comparison]) -> str:
    """The tables as plain text."""
    stream = io.StringIO()
    Console(file=stream, width=WIDTH, color_system=None, force_jupyter=False).print(comparison_tables(comparisons))
    return stream.getvalue()


def comparison_html(comparisons: Sequence[Comparison]) -> str:
    """Tables and paragraphs of a comparison in HTML, for a notebook."""
    tables = comparison_tables(comparisons)
    assert isinstance(tables, Group)
    return "".join(_html(part) for part in tables.renderables)


def _html(part: RenderableType) -> str:
    part = part.renderable if isinstance(part, Constrain) else part
    if not isinstance(part, Table):
        return "".join(f"<p>{escape(line)}</p>" for line in str(part).splitlines())
    heads = [" ".join(str(column.header).split()) for column in part.columns]
    columns = [[str(cell) for cell in column.cells] for column in part.columns]
    return html_table(heads, zip(*columns, strict=True), str(part.title))
