"""Tables of comparisons: texts in DataFrames, which rich prints and pandas writes as HTML and LaTeX."""

from __future__ import annotations

import io
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.text import several
from ..basics.units import with_unit
from ..references.registry import REFERENCES
from ..schemes.labels import short_label
from ..trajectory.trajectory import Reference, Trajectory
from .errors import ContactMeasures

if TYPE_CHECKING:
    from rich.console import RenderableType

    from .comparison import Comparison, ContactComparison

DASH = "–"
EVEN = 1e-6  # of the median step: steps that differ by less are of one length
WIDTH = 80  # columns of a table that goes to a file; a terminal keeps its own
LINE = 100  # columns of a sentence on a wide terminal: longer lines are hard to follow


def short(label: str) -> str:
    """Short name of a method: that of the scheme or of the reference solver; any other label is returned as it is."""
    if label in REFERENCES:
        return REFERENCES[label].label
    return short_label(label).removeprefix("__main__:")


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


def verdict(comparisons: Sequence[Comparison]) -> str:
    """A sentence on runs with one reference: how long their impacts match, or how far off the tip is.

    Of several runs the first and the last to part from the reference are named.
    """
    known = [c for c in comparisons if np.isfinite(c.matched_until) and c.contacts]
    ends = sorted((c.matched_until, short(c.label.partition("@")[0])) for c in known)
    if not ends:
        errors = sorted(c.tip_error_rms for c in comparisons)
        span = " to ".join(dict.fromkeys(percent(error) for error in (errors[0], errors[-1])))
        return f"tip error {span} rms to t = {comparisons[0].window:.3g}"
    (first, early), (last, late) = ((f"{t:.3g}", name) for t, name in (ends[0], ends[-1]))
    if len(ends) == 1:
        return f"impacts match to t = {first}, tip error {percent(known[0].tip_error_matched)} rms"
    return f"impacts match to t = {first}" + (f" ({early}) to {last} ({late})" if first != last else " in all runs")


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
    """Tables of a comparison, each a title and a DataFrame of texts, with notes above, between and below them."""

    remarks: tuple[str, ...]
    tables: tuple[tuple[str, Any], ...]
    notes: tuple[str, ...]
    failures: tuple[tuple[str, str, str], ...] = ()  # "failed" or "refused", label, message

    def rich(self) -> RenderableType:
        """The tables for a terminal or a file."""
        from rich import box
        from rich.console import Console, Group
        from rich.constrain import Constrain
        from rich.measure import Measurement
        from rich.table import Table
        from rich.text import Text

        parts: list[RenderableType] = [Text(remark) for remark in self.remarks]
        wide = Console(width=10 * WIDTH, force_jupyter=False)
        for title, frame in self.tables:
            table = Table(
                box=box.SIMPLE_HEAD, title=title, title_justify="left", title_style="bold", padding=(0, 1, 0, 0),
                show_edge=False,
            )  # fmt: skip
            table.add_column("run", overflow="fold", min_width=12)
            for head in frame.columns[1:]:
                table.add_column(str(head).replace(" ", "\n", 1), justify="right", no_wrap=True)
            for name, *cells in frame.itertuples(index=False):
                table.add_row(name, *cells, style="" if name not in frame.attrs["references"] else "bold")
            # Narrower gaps where it would not fit a file or an ordinary terminal.
            table.padding = 0 if Measurement.get(wide, wide.options, table).maximum > WIDTH else table.padding
            parts += [table, ""]
        if self.notes:
            parts.append(Constrain(Text("\n".join(self.notes), style="dim"), LINE))
        return Group(*parts, *self.failed())

    def failed(self) -> list[Any]:
        """A line for each failure."""
        from rich.text import Text

        styles = {"failed": "bold red", "refused": "bold"}
        return [
            Text.assemble((f"{word}  ", styles[word]), (who, "bold"), f"  {why}") for word, who, why in self.failures
        ]

    def __str__(self) -> str:
        from rich.console import Console

        stream = io.StringIO()
        Console(file=stream, width=WIDTH, color_system=None, force_jupyter=False).print(self.rich())
        return stream.getvalue()

    def html(self) -> str:
        """The tables for a notebook."""
        tables = [f"<p><b>{escape(title)}</b></p>{frame.to_html(index=False)}" for title, frame in self.tables]
        before, after = ("".join(f"<p>{escape(x)}</p>" for x in lines) for lines in (self.remarks, self.notes))
        return before + "".join(tables) + after

    def latex(self) -> str:
        """The tables for a paper, by booktabs."""
        return "\n".join(
            frame.style.hide(axis="index").to_latex(
                hrules=True, caption=title, position="ht", column_format="l" + "r" * (len(frame.columns) - 1)
            ).replace("%", r"\%").replace("_", r"\_")
            for title, frame in self.tables
        )  # fmt: skip


def report(
    comparisons: Sequence[Comparison],
    references: Sequence[Reference] = (),
    failures: Sequence[tuple[str, str]] = (),
    truths: Mapping[str, Reference] | None = None,
    refused: Container[str] = (),
    verbose: bool = False,
) -> Report:
    """Return the tables of comparisons: one per form to the horizon, one of the whole runs, and the failures.

    truths: by form, a solution that holds over the whole span where there is one. refused: the labels of those
    failures that the case does not allow. verbose: with all details below the tables, as in the file.
    """
    remarks = tuple(dict.fromkeys(c.remark for c in comparisons if c.remark))
    # The runs of one form have one reference and one table.
    by_reference = [
        [c for c in comparisons if c.reference == r] for r in dict.fromkeys(c.reference for c in comparisons)
    ]
    touched = [_touched(of_form) for of_form in by_reference]
    tables = [_to_horizon(of_form) for of_form, _ in touched]
    tables += [_to_end(of_form, (truths or {}).get(of_form[0].reference.partition("@")[2])) for of_form, _ in touched]
    shown = [c for of_form, _ in touched for c in of_form]
    notes = (_notes(shown, references) + [said for _, said in touched if said]) if shown else []
    notes += _details(shown, references) if verbose and shown else []
    lost = tuple(("refused" if label in refused else "failed", label, message) for label, message in failures)
    return Report(remarks, tuple(tables), tuple(dict.fromkeys(notes)), lost)


def _names(comparisons: Sequence[Comparison]) -> list[str]:
    """Short names, or whole labels if two runs would share one."""
    methods = [c.label.partition("@")[0] for c in comparisons]  # a label is method@form
    names = [short(method) for method in methods]
    return [method if names.count(name) > 1 else name for method, name in zip(methods, names, strict=True)]


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


def _frame(rows: Sequence[Mapping[str, str]], references: Sequence[str]) -> Any:
    """The rows as a DataFrame without the columns that say nothing."""
    import pandas

    frame: Any = pandas.DataFrame(list(rows))
    frame = frame.loc[:, [any(cell not in (DASH, "") for cell in frame[head]) for head in frame]]
    frame.attrs["references"] = list(references)
    return frame


def _to_horizon(comparisons: Sequence[Comparison]) -> tuple[str, Any]:
    """The measures on [0, horizon] of one form's runs; errors while the impacts of all of them match."""
    first = comparisons[0]
    method, _, form = first.reference.partition("@")
    common, main = common_window(comparisons), f"{short(method)} (reference)"
    lag, delay = with_unit(first.units, "lag", "time"), with_unit(first.units, "impact delay", "time")

    def line(name: str, c: Comparison, whose: str, contact: ContactComparison | None) -> dict[str, str]:
        """A line of a whole run, or of one of several contacts."""
        one = contact or (c.contacts[0] if len(c.contacts) == 1 else None)
        known = whose == "run" and (one is None or one.run.impacts >= 0)
        whole, match = whose == "run" and contact is None, one.matching if one and known else None
        until = c.matched_until if contact is None else match.matched_until if match else np.nan
        counts = _counts(getattr(one, whose) if one else None, bool(c.contacts) and one is None)
        return {
            "run": name,
            "tip error": percent(c.tip_error_to(min(common, c.window))) if whole else DASH,
            lag: number(c.phase.lag, 2) if whole else DASH,
            delay: number(match.median_delay, 2) if match else DASH,
            "energy lost": percent(c.energy_lost) if whole else DASH,
            "impacts right to": _until(until, c.window, first.window) if whose == "run" else DASH,
            **{head: counts[head] for head in ("impacts", "contact time")},
        }

    rows = [line(main, first, "reference", None)]
    rows += [line(_line(x), first, "reference", x) for x in _several(first)]
    for name, c in zip(_names(comparisons), comparisons, strict=True):
        rows += [line(name, c, "run", None), *(line(_line(x), c, "run", x) for x in _several(c))]
    title = f"To the horizon t = {number(first.window)}, {form} form"
    return title, _frame(rows, [main])


def _to_end(comparisons: Sequence[Comparison], truth: Reference | None) -> tuple[str, Any]:
    """Cost and totals of the whole runs of one form; the adaptive solvers ended at the horizon."""
    first = comparisons[0]
    method, _, form = first.reference.partition("@")
    units, end = first.units, max(c.t_end for c in comparisons)
    # Past the horizon, or where impacts have parted, the title says that single runs differ by chance.
    beyond = first.window < end * (1 - 1e-9)
    said = ": one realisation each, compare statistically" if beyond else ""
    parted = min((c.matched_until for c in comparisons if not np.isnan(c.matched_until)), default=first.window)
    if not beyond and parted < first.window:
        said = f"; impacts differ from t = {number(parted)} on"
    main = f"{short(method)} ({'double precision' if truth is not None else 'reference'})"
    rows: list[dict[str, str]] = []

    def line(name: str, c: Comparison, whose: str, contact: ContactComparison | None) -> dict[str, str]:
        one = contact or (c.contacts[0] if len(c.contacts) == 1 else None)
        whole = whose == "run_totals" and contact is None
        counts = _counts(getattr(one, whose) if one else None, bool(c.contacts) and one is None)
        return {
            "run": name, "ns per step": number(c.ns_per_step, 3) if whole else DASH,
            "impacts": counts["impacts"], "contact time": counts["contact time"],
            with_unit(units, "peak force", "force"): counts["peak"],
            with_unit(units, "impulse", "impulse"): counts["impulse"],
            "energy lost": percent(c.totals_energy_lost) if whole else DASH,
        }  # fmt: skip

    rows.append(line(main, first, "reference_totals", None))
    rows += [line(_line(x), first, "reference_totals", x) for x in _several(first)]
    names = [main]
    if truth is not None and len(truth.contacts) == len(first.contacts) == 1:
        names.append(f"exact ({truth.provenance['digits']} digits)")
        record, sampled = truth.contacts[0], truth.impacts_sampled(first.dt).count
        of_truth = ContactMeasures(sampled, record.impacts.count, record.fraction, record.peak_force, record.impulse)
        one = replace(first, contacts=(replace(first.contacts[0], reference_totals=of_truth),))
        rows.insert(0, line(names[-1], one, "reference_totals", None))
    for name, c in zip(_names(comparisons), comparisons, strict=True):
        if c.steps:
            rows += [line(name, c, "run_totals", None), *(line(_line(x), c, "run_totals", x) for x in _several(c))]
    return f"To t = {end:g}, {form} form{said}", _frame(rows, names)


def _several(comparison: Comparison) -> tuple[ContactComparison, ...]:
    """The contacts with their own lines: all of them if there are several."""
    return comparison.contacts if len(comparison.contacts) > 1 else ()


def _line(contact: ContactComparison) -> str:
    return f"  {contact.place.removeprefix('stops at ')}"


def _counts(measures: ContactMeasures | None, elsewhere: bool) -> dict[str, str]:
    """Impacts at the time steps, share of the time, peak and impulse of a contact; empty if its lines follow."""
    if measures is None and elsewhere:
        return dict.fromkeys(("impacts", "contact time", "peak", "impulse"), "")
    x = measures or ContactMeasures(0, 0, 0.0, 0.0, 0.0)
    return {
        "impacts": str(x.impacts) if x.impacts >= 0 else DASH, "contact time": percent(x.fraction),
        "peak": number(x.peak_force, 4), "impulse": number(x.impulse, 4),
    }  # fmt: skip


def _until(until: float, window: float, horizon: float) -> str:
    """The time to which impacts match, or the words for the end of the table or of a shorter run."""
    end = "its end" if window < horizon * (1 - 1e-9) else "horizon"
    return DASH if np.isnan(until) else number(until) if until < window else end


def _notes(comparisons: Sequence[Comparison], references: Sequence[Reference]) -> list[str]:
    """The notes without which the tables would be misread."""
    first = comparisons[0]
    common = common_window(comparisons)
    lines = [
        f"Tip error: rms over max |u|, to t = {number(common)}"
        f"{'' if common == first.window else ', where the impacts of all runs still match'}. Lag, delay: > 0 is late. "
        "Energy lost: by the scheme, of the energy supplied. Impacts: those that the time steps show."
    ]
    events = sum(c.reference_totals.event_impacts for c in first.contacts)
    if events != sum(c.reference_totals.impacts for c in first.contacts):
        lines.append(f"The reference has {events} impacts to t = {first.t_end:g} in all.")
    if any(np.isnan(c.energy_lost) and not c.missing for c in comparisons):
        lines.append("Energy lost is – if the time step does not resolve the dissipation of dampers.")
    system = None if first.pair is None else first.pair[1].system
    if first.reference.partition("@")[0] in ("exact", "multiprecision") and system is not None and system.problem:
        lines.append("The reference is exact for this mesh; `stiffbeam study space` measures the mesh.")
    lines += [
        f"{short(r.label.partition('@')[0])} was computed {r.provenance['budget']}, and its tip error is to that time."
        for r in references
        if "budget" in r.provenance
    ]
    if any(x.impacts.at_start for c in comparisons if c.pair for x in c.pair[1].contacts):
        lines.append("A contact that begins at t = 0 counts as contact, not as an impact.")
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
