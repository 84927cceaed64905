"""Picture of the study ``precision``: what an error costs, and how long the impacts are followed for it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ..studies.study import Records, Row
from . import column, found_rows, log_scale, look, say_empty, shared_legend, short

COSTS = (("seconds", "seconds of marching", "error against time"),
         ("work", "linear solves or evaluations", "error against work"))  # fmt: skip


def draw(records: Records) -> Figure:
    """Lower left is better in (a) and (b), upper left in (c), whose lines join the best so far."""
    found = found_rows(records)
    rows = [row for row in found if row["method"] != "exact"]
    exact = [row for row in found if row["method"] == "exact"]
    figure = Figure(figsize=(11.0, 6.2), layout="constrained")
    figure.suptitle(f"{records.case.name}: work and precision; the exact solution's cost is the vertical line")
    axes = figure.subplots(1, 3)
    for axis, (cost, words, title), letter in zip(axes, COSTS, "ab", strict=False):
        _curves(axis, rows, cost, "error")
        for row in exact:
            axis.axvline(row[cost], color="black", lw=1.8, label="exact")
        log_scale(axis)
        axis.set(xlabel=words, ylabel="tip error, rms, relative")
        axis.set_title(f"({letter}) {title}", loc="left")
    _failed(axes[0], records.rows)
    tracked = [row for row in rows if np.isfinite(column([row], "tracked")[0])]
    for label in dict.fromkeys(row["method"] for row in tracked):
        own = sorted((row for row in tracked if row["method"] == label), key=lambda row: row["tracked_seconds"])
        seconds, until, style = column(own, "tracked_seconds"), column(own, "tracked"), look(label)
        axes[2].plot(seconds, until, ms=4.5, **style | {"linestyle": ""})
        axes[2].step(seconds, np.maximum.accumulate(until), where="post", lw=1.1, **style | {"marker": ""})
    if tracked:
        axes[2].axhline(tracked[0]["horizon"], color="black", lw=1.2, ls=":", label="horizon of float64")
        log_scale(axes[2], y=False)
        axes[2].set(ylim=(0.0, None))
    else:
        say_empty(axes[2], "no contact to follow")
    axes[2].set(xlabel="seconds of marching to get there", ylabel="true impacts followed to $t$")
    axes[2].set_title("(c) tracked time against time", loc="left")
    for axis in axes:
        axis.grid(color="0.92")
    shared_legend(figure, 5)
    return figure


def _curves(axis, rows: Sequence[Row], cost: str, result: str) -> None:
    for label in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == label]
        own.sort(key=lambda row: (row["dt"], row["rtol"]))
        y = column(own, result)
        y = np.where(y > 0.0, y, np.nan)
        axis.plot(column(own, cost), y, ms=4.5, lw=1.1, label=short(label), **look(label))


def _failed(axis, rows: Sequence[Row]) -> None:
    """Crosses along the top edge, one a method, above its name and how many of its points failed."""
    counts = Counter(row["method"] for row in rows if "failed" in row)
    tried = Counter(row["method"] for row in rows)
    for i, (method, failed) in enumerate(counts.items()):
        x = (i + 0.5) / len(counts)
        axis.plot(x, 1.0, "x", ms=8, mew=2, color=look(method)["color"], transform=axis.transAxes, clip_on=False)
        text = f"{short(method)}: {failed} of {tried[method]} failed"
        axis.annotate(text, (x, 0.97), xycoords="axes fraction", rotation=90, ha="center", va="top", fontsize=8)
