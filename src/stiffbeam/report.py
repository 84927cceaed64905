"""Tables on the terminal and in notebooks."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from .measures.comparison import Comparison
from .trajectory import Reference

DASH = "–"
WIDTH = 130  # columns of a table that goes to a file; a terminal keeps its own


def number(value: float, digits: int = 3) -> str:
    """A short decimal, a dash for NaN."""
    return DASH if not np.isfinite(value) else f"{value:.{digits}g}"


def percent(value: float) -> str:
    """Per cent to two digits, in powers of ten where that would be a long number."""
    if not np.isfinite(value):
        return DASH
    return f"{100 * value:.0e} %" if not 1e-5 < abs(value) < 1e3 and value else f"{100 * value:.2g} %"


def _lag(comparison: Comparison) -> str:
    """The phase lag, or in brackets the median impact delay where it is undefined."""
    if not comparison.phase.undefined:
        return number(comparison.phase.lag, 2)
    delay = comparison.matching.median_delay
    return f"({number(delay, 2)})" if np.isfinite(delay) else DASH


def comparison_tables(
    comparisons: Sequence[Comparison],
    references: Sequence[Reference] = (),
    failures: Sequence[tuple[str, str]] = (),
) -> RenderableType:
    """One table per form inside the horizon, the whole runs in a table of their own, the failures."""
    parts: list[RenderableType] = []
    for yardstick in dict.fromkeys(c.reference for c in comparisons):
        parts.append(_inside([c for c in comparisons if c.reference == yardstick]))
    if comparisons:
        parts.append(Text(_explanation(comparisons, references), style="dim"))
    for yardstick in dict.fromkeys(c.reference for c in comparisons):
        parts.append(_whole([c for c in comparisons if c.reference == yardstick]))
    for label, message in failures:
        parts.append(Text.assemble(("failed  ", "bold red"), (label, "bold"), f"  {message}"))
    return Group(*parts)


def _table(title: str, headings: Sequence[str]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", title_style="bold", padding=(0, 1, 0, 0))
    table.add_column("run", overflow="fold")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True, min_width=6)
    return table


def _inside(comparisons: Sequence[Comparison]) -> Table:
    """The measures on [0, horizon] of one form's runs."""
    first = comparisons[0]
    method, _, form = first.reference.partition("@")
    table = _table(
        f"To the horizon t = {number(first.window)}, {form} form",
        (
            "tip error\nrms",
            "before\nparting",
            "impacts\npart at",
            "lag\n(time)",
            "energy\nlost",
            "impacts",
            "in\ncontact",
        ),
    )
    table.add_row(
        f"{method}  (reference)", DASH, DASH, DASH, DASH, DASH,
        f"{first.reference_contacts.impacts} [{first.reference_events}]", percent(first.reference_contacts.fraction),
        style="bold",
    )  # fmt: skip
    for c in comparisons:
        parted = c.matching.matched_until < c.window
        table.add_row(
            c.label.partition("@")[0],
            percent(c.tip_error_rms),
            percent(c.tip_error_matched),
            number(c.matching.matched_until) if parted else "horizon",
            _lag(c),
            percent(c.energy_lost),
            str(c.contacts.impacts),
            percent(c.contacts.fraction),
        )
    return table


def _whole(comparisons: Sequence[Comparison]) -> Table:
    """Cost and totals of the whole runs of one form; the adaptive solvers ended at the horizon."""
    first = comparisons[0]
    method, _, form = first.reference.partition("@")
    end = max(c.t_end for c in comparisons)
    beyond = ": one realisation each, not comparable" if first.window < end * (1 - 1e-9) else ""
    table = _table(
        f"To t = {end:g}, {form} form{beyond}",
        ("steps", "seconds", "ns/step", "impacts", "in\ncontact", "peak\nforce", "impulse", "energy\nlost"),
    )
    totals = first.reference_totals
    table.add_row(
        method, DASH, DASH, DASH, f"{totals.impacts} [{first.reference_totals_events}]", percent(totals.fraction),
        number(totals.peak_force, 4), number(totals.impulse, 4), DASH, style="bold",
    )  # fmt: skip
    for c in comparisons:
        if c.steps:
            table.add_row(
                c.label.partition("@")[0], str(c.steps), number(c.seconds), f"{c.ns_per_step:.0f}",
                str(c.totals.impacts), percent(c.totals.fraction), number(c.totals.peak_force, 4),
                number(c.totals.impulse, 4), percent(c.totals_energy_lost),
            )  # fmt: skip
    return table


def _explanation(comparisons: Sequence[Comparison], references: Sequence[Reference]) -> str:
    lines = [
        f"{r.label}: horizon {number(r.horizon)} (against {r.provenance.get('horizon_against', '')}), "
        f"{number(r.work.seconds)} s"
        for r in references
    ]
    lines += [
        "Tip error: rms over max |u|, to the horizon and before the impacts part. Lag > 0: late; in brackets the",
        "median impact delay where the phase lag is undefined.",
        "Energy lost: of all energy the system has had. Impacts: sampled at the run's steps, [by events].",
    ]
    in_numpy = [c.label.partition("@")[0] for c in comparisons if c.engine == "numpy"]
    if in_numpy:
        lines += [
            f"ns/step in NumPy: {', '.join(dict.fromkeys(in_numpy))}.",
            "Short runs do not wait for the compiler, and modes that do not decouple march without it.",
        ]
    if any(c.contact_count > 1 for c in comparisons):
        lines.append("Impacts, contact and force are those of the first of several contacts; run.contacts has all.")
    return "\n".join(lines) + "\n"


def comparison_text(comparisons: Sequence[Comparison]) -> str:
    """The tables as plain text."""
    stream = io.StringIO()
    Console(file=stream, width=WIDTH, color_system=None).print(comparison_tables(comparisons))
    return stream.getvalue()


def comparison_html(comparisons: Sequence[Comparison]) -> str:
    """The tables for a notebook."""
    console = Console(record=True, width=WIDTH, file=io.StringIO())
    console.print(comparison_tables(comparisons))
    return console.export_html(inline_styles=True, code_format="<pre>{code}</pre>")
