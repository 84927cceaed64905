"""Picture of the study ``chaos``: growth of a small distance, exponents, delayed and plain portrait."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..studies.chaos import LINEAR, exponents
from ..studies.study import Records
from . import column, found_rows, look, say_empty, shared_legend, short


def draw(records: Records) -> Figure:
    """(a) mean distance of neighbouring motions, (b) exponents, (c) u(t + T) over u(t), (d) phase portrait."""
    rows = found_rows(records)
    figure = Figure(figsize=(11.0, 8.6), layout="constrained")
    figure.suptitle(f"{records.case.name}: how fast neighbouring motions part")
    (distance, rates), (delayed, portrait) = figure.subplots(2, 2)
    _distances(distance, rows)
    _exponents(rates, rows)
    path = [row for row in rows if row["kind"] == "portrait"]
    for axis, x, y, xlabel, ylabel, title in (
        (delayed, "u", "u_delayed", "$u(1, t)$", "$u(1, t + T)$", "(c) delayed by a period T of the drive"),
        (portrait, "u", "v", "$u(1, t)$", "$u_t(1, t)$", "(d) phase portrait"),
    ):
        axis.plot(column(path, x), column(path, y), ls="", marker=".", ms=1.2, color="black", alpha=0.45)
        axis.set(xlabel=xlabel, ylabel=ylabel)
        axis.locator_params(axis="x", nbins=6)
        axis.set_title(f"{title}, exact, one realisation", loc="left")
        if not path:
            say_empty(axis)
    shared_legend(figure)
    return figure


def _distances(axis, rows) -> None:
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method and "distance" in row]
        if own:
            style = look(method)
            axis.plot(column(own, "t"), column(own, "distance"), color=style["color"], ls=style["linestyle"],
                      lw=2.0 if method == "exact" else 1.2, label=short(method))  # fmt: skip
    if axis.lines:
        axis.set_yscale("log")
        axis.axhline(LINEAR, color="0.5", lw=0.8, ls=":")
        axis.annotate("grows in proportion below", (0.02, LINEAR), xycoords=("axes fraction", "data"), ha="left",
                      xytext=(0, 3), textcoords="offset points", fontsize=8, color="0.35")  # fmt: skip
    else:
        say_empty(axis)
    axis.set(xlabel="time since the start of the pair", ylabel="distance over the motion's size")
    axis.set_title("(a) geometric mean over the pairs", loc="left")


def _exponents(axis, rows) -> None:
    """Every start a dot, mean and 95 % interval beside it."""
    found = exponents(rows)
    jitter = np.random.default_rng(0)
    for i, (method, (mean, interval)) in enumerate(found.items()):
        values = column([row for row in rows if row["method"] == method and "exponent" in row], "exponent")
        colour = look(method)["color"]
        axis.plot(
            values, i + jitter.uniform(-0.25, 0.25, len(values)), ls="", marker=".", ms=3, color=colour, alpha=0.5
        )
        axis.errorbar(mean, i, xerr=interval, fmt="o", color=colour, ms=5, capsize=4, lw=1.8)
    axis.axvline(0.0, color="0.8", lw=0.8, zorder=0)
    axis.set_yticks(range(len(found)), [short(method) for method in found])
    axis.invert_yaxis()
    axis.set(xlabel=r"exponent $\lambda$ in $e^{\lambda t}$")
    axis.set_title("(b) exponents: every start, mean, 95 % interval", loc="left")
