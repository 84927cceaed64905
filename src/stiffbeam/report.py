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


def number(value: float, digits: int = 3) -> str:
    """A short decimal, a dash for NaN."""
    return DASH if not np.isfinite(value) else f"{value:.{digits}g}"


def percent(value: float) -> str:
    """Per cent with one digit, or in powers of ten where that would be a long number."""
    if not np.isfinite(value):
        return DASH
    return f"{100 * value:.1e} %" if abs(value) > 1e3 else f"{100 * value + 0.0:.1f} %".replace("-0.0 ", "0.0 ")


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
    """The measures inside the horizon, the totals beyond it in a block of their own, the failures."""
    forms = {c.label.partition("@")[2] for c in comparisons}
    common = f"@{forms.pop()}" if len(forms) == 1 else ""

    def name(label: str) -> str:
        return label.removesuffix(common)

    title = f"Inside the horizon{f', {common[1:]} form' if common else ''}"
    inside = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", title_style="bold")
    inside.add_column("run", no_wrap=True)
    for heading in (
        "to t =", "steps", "seconds", "ns/step", "tip error\nrms", "phase\nlag", "energy\nlost",
        "impacts", "in\ncontact", "impacts\npart at",
    ):  # fmt: skip
        inside.add_column(heading, justify="right", no_wrap=True)
    seen: set[str] = set()
    for c in comparisons:
        if c.reference not in seen:
            seen.add(c.reference)
            inside.add_row(
                f"{name(c.reference)}  (reference)", number(c.window), *[DASH] * 6,
                f"{c.reference_contacts.impacts} [{c.reference_events}]", percent(c.reference_contacts.fraction), DASH,
                style="bold",
            )  # fmt: skip
        inside.add_row(
            name(c.label),
            number(c.window),
            str(c.steps) if c.steps else DASH,
            number(c.seconds),
            f"{c.ns_per_step:.0f}" if c.steps else DASH,
            percent(c.tip_error_rms) if c.tip_error_rms > 1e-3 else number(c.tip_error_rms, 2),
            _lag(c),
            percent(c.energy_lost),
            str(c.contacts.impacts),
            percent(c.contacts.fraction),
            number(c.matching.matched_until) if c.matching.matched_until < c.window else "horizon",
        )
    parts: list[RenderableType] = [inside]
    note = Text(style="dim")
    for reference in references:
        against = reference.provenance.get("horizon_against", "")
        note.append(
            f"Reference {reference.label}: horizon {number(reference.horizon)} (against {against}), "
            f"{number(reference.work.seconds)} s.\n"
        )
    note.append(
        "Tip error over max |u|. Phase lag > 0: late; in brackets the median impact delay where the lag is undefined. "
        "Energy lost: numerical loss over input.\nImpacts: sampled at the run's steps, [by events]. "
        "Steps, seconds, ns/step (the march alone): of the whole run, to t_end; all else to the horizon."
    )
    parts.append(note)
    schemes = [c for c in comparisons if c.t_end > c.window * (1 + 1e-9)]
    if schemes:
        end = schemes[0].t_end
        totals = Table(
            box=box.SIMPLE_HEAD,
            title=f"Totals to t = {end:g}: one realisation each, not comparable past the horizon",
            title_justify="left",
            title_style="bold",
        )
        totals.add_column("run", no_wrap=True)
        for heading in ("impacts", "in contact", "peak force", "impulse", "energy lost"):
            totals.add_column(heading, justify="right")
        seen.clear()
        for c in schemes:
            if c.reference not in seen:
                seen.add(c.reference)
                r = c.reference_totals
                totals.add_row(
                    f"{name(c.reference)}, sampled", str(r.impacts), percent(r.fraction), number(r.peak_force, 4),
                    number(r.impulse, 4), DASH,
                )  # fmt: skip
                totals.add_row(f"{name(c.reference)}, events", str(c.reference_totals_events), DASH, DASH, DASH, DASH)
            totals.add_row(
                name(c.label), str(c.totals.impacts), percent(c.totals.fraction), number(c.totals.peak_force, 4),
                number(c.totals.impulse, 4), percent(c.totals_energy_lost),
            )  # fmt: skip
        parts.append(totals)
    for label, message in failures:
        parts.append(Text.assemble(("failed  ", "bold red"), (label, "bold"), f"  {message}"))
    return Group(*parts)


def comparison_text(comparisons: Sequence[Comparison]) -> str:
    """The tables as plain text."""
    stream = io.StringIO()
    Console(file=stream, width=160, color_system=None).print(comparison_tables(comparisons))
    return stream.getvalue()


def comparison_html(comparisons: Sequence[Comparison]) -> str:
    """The tables for a notebook."""
    console = Console(record=True, width=160, file=io.StringIO())
    console.print(comparison_tables(comparisons))
    return console.export_html(inline_styles=True, code_format="<pre>{code}</pre>")
