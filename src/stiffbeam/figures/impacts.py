"""Picture of the study ``impacts``: what each scheme counts as its step shrinks, and what it hangs on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ..studies.common import scheme_of
from ..studies.impacts import EXACT, TRUE
from ..studies.study import Records, Row
from . import MARKERS, column, dashed, found_rows, log_scale, look, say_empty, shared_legend, short

OVER_STEP = (
    ("count", "impacts counted", "how many", 1.0),
    ("fraction", "time in contact, per cent", "how long", 100.0),
    ("peak_force", "largest contact force", "how hard", 1.0),
)
PARAMETERS = {"hht": ("alpha", "HHT over -α", -1.0), "sdirk": ("gamma", "SDIRK-OS over γ", 1.0)}


def draw(records: Records) -> Figure:
    """Above: over the step, with the true values in black. Below: how long the impacts are the true ones,
    and at the coarsest step what parameters and the treatment of the contact do."""
    rows = found_rows(records)
    runs = [row for row in rows if row["purpose"] == "step" and row["scheme"] not in (TRUE, EXACT)]
    true = [row for row in rows if row["scheme"] == TRUE]
    figure = Figure(figsize=(11.0, 7.8), layout="constrained")
    span = f" to t = {rows[0]['t_end']:g}" if rows else ""
    digits = max((row["true_digits"] for row in runs), default=0)
    known = f"{digits} digits" if digits else "float64, one realisation"
    figure.suptitle(f"{records.case.name}{span}: means over perturbed runs; the true motion in black ({known})")
    axes = figure.subplots(2, 3)
    for axis, (name, words, title, factor), letter in zip(axes[0], OVER_STEP, "abc", strict=True):
        _over_step(axis, runs, name, factor)
        _true_values(axis, runs, true, name, factor)
        _exact_ensemble(axis, [row for row in rows if row["scheme"] == EXACT], name, factor)
        axis.set(ylabel=words)
        axis.set_title(f"({letter}) {title}", loc="left")
        axis.set_ylim(0.0, 1.05 * axis.get_ylim()[1])
    _over_step(axes[1, 0], runs, "matched_until", 1.0)
    axes[1, 0].set(ylabel="true impacts followed to $t$")
    axes[1, 0].set_title("(d) how far they are true", loc="left")
    if runs:
        axes[1, 0].axhline(runs[0]["horizon"], color="black", lw=1.2, ls=":", label="horizon of float64")
    shared_legend(figure, 5)
    count = runs[0]["true_count"] if runs else float("nan")
    _over_parameters(axes[1, 1], [row for row in rows if row["purpose"] == "parameter"], count)
    treated = [row for row in records.rows if row["purpose"] == "contact"]
    _treatments(axes[1, 2], runs, treated, count)
    for axis in axes.ravel():
        if not axis.get_lines() and not axis.patches:
            say_empty(axis, "not asked for" if runs else "no point could be evaluated")
    return figure


def _over_step(axis, runs: Sequence[Row], name: str, factor: float) -> None:
    for label in dict.fromkeys(row["scheme"] for row in runs):
        own = sorted((row for row in runs if row["scheme"] == label), key=lambda row: row["dt"])
        axis.plot(column(own, "dt"), factor * column(own, name), ms=4.5, lw=1.1, label=short(label), **look(label))
    log_scale(axis, y=False)
    axis.set(xlabel=r"step $\Delta t$")
    axis.grid(color="0.92")


def _true_values(axis, runs: Sequence[Row], true: Sequence[Row], name: str, factor: float) -> None:
    own = sorted(true, key=lambda row: row["dt"])
    if name == "count":
        axis.plot(column(own, "dt"), column(own, name), ms=6, lw=1.1, label="true, seen at the steps", **look(TRUE))
        value = runs[0]["true_count"] if runs else float("nan")
    else:
        value = factor * column(own, name)[0] if own else float("nan")
    if np.isfinite(value):
        axis.axhline(value, color="black", lw=1.6, label="true")


def _exact_ensemble(axis, exact: Sequence[Row], name: str, factor: float) -> None:
    """The mean over exact members as a dotted line, with the spread of the count as a band."""
    for row in exact:
        mean = factor * row[name]
        if name == "count":
            low, high = mean - row["count_spread"], mean + row["count_spread"]
            axis.axhspan(low, high, color="0.85", lw=0, zorder=0, label="exact members, mean ± spread")
        axis.axhline(mean, color="0.3", lw=1.2, ls=":", zorder=1)


def _over_parameters(axis, rows: Sequence[Row], count: float) -> None:
    for i, (name, (parameter, text, sign)) in enumerate(PARAMETERS.items()):
        own = [row for row in rows if scheme_of(row["scheme"]).name == name]
        points = sorted((sign * scheme_of(row["scheme"]).parameters[parameter], row["count"]) for row in own)
        if points:
            k = list(PARAMETERS).index(name)
            axis.plot(*np.array(points).T, marker=MARKERS[2 - k], ms=4.5, lw=1.1, ls=dashed(i), label=text,
                      color=look(name)["color"])  # fmt: skip
    if rows:
        axis.axhline(count, color="black", lw=1.6)
        axis.set(xlabel=f"parameter, at Δt = {rows[0]['dt']:g}", ylabel="impacts counted", ylim=(0.0, None))
        axis.set_title("(e) over the parameter", loc="left")
        axis.grid(color="0.92")
        axis.legend(frameon=False, fontsize=8.5)


def _treatments(axis, runs: Sequence[Row], treated: Sequence[Row], count: float) -> None:
    """Implicit beside extrapolated contact at the same step, a cross where it overflowed."""
    schemes = [row["scheme"] for row in treated]
    if not schemes:
        return
    dt = treated[0]["dt"]
    implicit = {row["scheme"]: row["count"] for row in runs if row["dt"] == dt}
    places = np.arange(len(schemes))
    axis.bar(places - 0.2, [implicit.get(s, np.nan) for s in schemes], 0.38, color="0.3", label="implicit")
    axis.bar(places + 0.2, column(treated, "count"), 0.38, color="0.75", hatch="///", edgecolor="white",
             label="extrapolated")  # fmt: skip
    failed = [i for i, row in enumerate(treated) if "failed" in row]
    if failed:
        bottom = np.zeros(len(failed))
        axis.plot(places[failed] + 0.2, bottom, "x", ms=8, mew=2, color="black", clip_on=False, label="overflowed")
    axis.axhline(count, color="black", lw=1.6)
    axis.set_xticks(places, [short(s) for s in schemes], rotation=35, ha="right", fontsize=8.5)
    counts = [bar.get_height() for bar in axis.patches] + [count]
    axis.set(ylabel="impacts counted", ylim=(0.0, 1.45 * max((c for c in counts if np.isfinite(c)), default=1.0)))
    axis.set_title(f"(f) contact, at Δt = {dt:g}", loc="left")
    axis.legend(frameon=False, fontsize=8.5)
