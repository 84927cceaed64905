"""How much of the resting on the stop is numerical: one contact in close-up, and the share of contact in every "
"table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from ..reproduce.table import Made
from .comparison import draw_stops
from .paper import STYLE, TRUTH

NAMES = {"(4.13)": "HHT (4.13)", "(4.14)": "SDIRK (4.14)"}


def close_up(made: Made) -> Figure:
    """The tip at its stop, to the horizon: the truth bounces where the schemes rest."""
    truth, system = made.references["displacement"], made.systems["displacement"]
    end = made.horizons["displacement"]
    start = 0.9 * float(truth.impacts.times[0])
    end = min(end, float(truth.impacts.times[truth.impacts.stops < 0][0]) - 0.02)  # the first visit to one stop
    t = np.linspace(start, end, 6000)
    figure = Figure(figsize=(7.2, 3.9), layout="constrained")
    axis = figure.subplots()
    axis.plot(t, truth.at(t)[0], color=TRUTH["displacement"][0], lw=1.0, label="true motion (multiprecision)")
    for equation, run in made.runs.items():
        here = (run.t >= start) & (run.t <= end)
        axis.plot(run.t[here], run.tip[here], color=STYLE[equation][0], lw=1.6, label=NAMES.get(equation, equation))
    draw_stops(axis, system, horizontal=True)
    stops = made.case.problem.stops
    assert stops is not None
    axis.set(
        xlim=(start, end), ylim=(0.6 * stops.g2, 1.03 * stops.g2), xlabel="time $t$",
        ylabel="tip displacement $u(1, t)$",
    )  # fmt: skip
    axis.annotate("stop", (end, stops.g2), xytext=(-2, 3), textcoords="offset points", ha="right", fontsize=8)
    axis.legend(loc="lower center", frameon=False, fontsize=9)
    return figure


def shares(numbers: Mapping[int, Mapping[str, Any]]) -> Figure:
    """Share of time in contact, table by table: the truth of each form, and every run."""
    figure = Figure(figsize=(7.2, 0.32 * len(numbers) + 1.3), layout="constrained")
    axis = figure.subplots()
    rows = sorted(numbers)
    seen: set[str] = set()
    for y, table in enumerate(rows):
        found = numbers[table]
        values = [row["fraction"] for row in (*found["runs"].values(), *found["true"].values())]
        axis.plot([min(values), max(values)], [y, y], color="0.85", lw=3, zorder=0, solid_capstyle="round")
        for form, row in found["true"].items():
            filled = form == "displacement"
            label = "true motion" if filled else "true motion, velocity-curvature form"
            axis.plot(
                row["fraction"], y, "D", ms=6, zorder=3, color=TRUTH[form][0], ls="", mfc=None if filled else "white",
                label=None if label in seen else label,
            )  # fmt: skip
            seen.add(label)
        for equation, row in found["runs"].items():
            label = _family(equation)
            axis.plot(
                row["fraction"], y, _MARKS[label], ms=6.5, alpha=0.9, mec="white", mew=0.5, ls="", zorder=2,
                color=STYLE[equation][0], label=None if label in seen else label,
            )  # fmt: skip
            seen.add(label)
    axis.set_yticks(range(len(rows)), [f"Table {table}" for table in rows])
    axis.invert_yaxis()
    axis.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axis.set(xlim=(-0.02, 1.02), xlabel="share of time in contact")
    axis.grid(axis="x", color="0.92", lw=0.8)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


_MARKS = {
    "HHT": "o", "BDF2 on (3.12)": "s", "BDF2 on (3.5)": "^", "SDIRK on (3.12)": "P", "SDIRK on (3.5)": "v",
    "SDIRK (4.14)": "X",
}  # fmt: skip


def _family(equation: str) -> str:
    names = {
        "(4.13)": "HHT", "(4.5)": "BDF2 on (3.12)", "(4.11)": "BDF2 on (3.5)", "(4.10)": "SDIRK on (3.12)",
        "(4.12)": "SDIRK on (3.5)", "(4.14)": "SDIRK (4.14)",
    }  # fmt: skip
    return names[equation]
