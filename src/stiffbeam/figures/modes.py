"""Picture of the study ``modes``: what a run shows of each mode, upon what theory says."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..studies.study import Records
from . import column, found_rows, log_scale, look, say_empty, shared_legend, short, signed_log

QUANTITIES = (  # with the size below which the axis is linear
    ("period_elongation", "relative period elongation", 1e-11),
    ("damping_ratio", "damping ratio", 1e-10),
)
SAME = 1e-10  # an absolute difference that is rounding, not the fit


def draw(records: Records) -> Figure:
    """Above: lines are theory, markers the fit to a run with its error. Below: their distance in errors."""
    rows = found_rows(records)
    figure = Figure(figsize=(11.0, 7.6), layout="constrained")
    figure.suptitle(f"{records.case.name} without contact, mode by mode: markers fitted to a run, lines are theory")
    axes = figure.subplots(2, 2, sharex=True, height_ratios=(2.4, 1.0))
    for (upper, lower), (name, words, threshold), letter in zip(axes.T, QUANTITIES, "ab", strict=True):
        for label in dict.fromkeys(row["scheme"] for row in rows):
            own = sorted((row for row in rows if row["scheme"] == label), key=lambda row: row["dt_over_period"])
            x, style = column(own, "dt_over_period"), look(label)
            measured, theory, error = (column(own, name + end) for end in ("", "_theory", "_error"))
            upper.plot(x, theory, lw=0.9, **style | {"marker": ""})
            upper.errorbar(x, measured, error, ms=4.5, capsize=2.5, elinewidth=0.8, lw=1.0, label=short(label),
                           **style | {"linestyle": ""})  # fmt: skip
            lower.plot(x, np.abs(measured - theory) / (error + SAME), ms=3.5, **style | {"linestyle": ""})
        log_scale(upper, y=False)
        log_scale(lower)
        upper.set(ylabel=words)
        upper.set_title(f"({letter}) {words}", loc="left")
        lower.axhline(1.0, color="0.3", lw=0.9, ls=":")
        lower.set(xlabel=r"$\Delta t/T$ of the mode", ylabel="distance from theory\nover the fit's error")
        lower.set_ylim(1e-4, 10.0)
        for axis in (upper, lower):
            axis.grid(color="0.92")
        if not rows:
            say_empty(upper)
        signed_log(upper, (column(rows, name), column(rows, f"{name}_theory")), threshold)
    shared_legend(figure, 4)
    return figure
