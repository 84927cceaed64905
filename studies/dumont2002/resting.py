"""How much of the resting on the stop is numerical: one contact in close-up, and every table's share of contact."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffbeam.figures.comparison import draw_stops
from stiffbeam.figures.panels import new_figure

from .figures import EXACT, STYLE, exact_label
from .sample import Sample
from .table import Made

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = {"(4.13)": "HHT (4.13)", "(4.14)": "SDIRK (4.14)"}


def close_up(made: Made) -> Figure:
    """The tip at its stop, to the horizon: the exact motion bounces where the schemes rest."""
    exact = made.references["displacement"]
    end = made.horizons["displacement"]
    start = 0.9 * float(exact.impacts.times[0])
    end = min(end, float(exact.impacts.times[exact.impacts.stops < 0][0]) - 0.02)  # the first visit to one stop
    t = np.linspace(start, end, 6000)
    figure = new_figure(3.4, width=5.0)
    axis = figure.subplots()
    axis.plot(t, exact.at(t)[0], color=EXACT["displacement"][0], lw=1.0, label=exact_label(made, "displacement"))
    for equation, run in made.runs.items():
        here = (run.t >= start) & (run.t <= end)
        axis.plot(run.t[here], run.tip[here], color=STYLE[equation][0], lw=1.6, label=NAMES.get(equation, equation))
    stops = made.case.problem.one_stops("case")
    draw_stops(axis, stops, horizontal=True)
    axis.set(
        xlim=(start, end), ylim=(0.6 * stops.g2, 1.03 * stops.g2), xlabel="time $t$",
        ylabel="tip displacement $u(1, t)$",
    )  # fmt: skip
    axis.annotate("stop", (end, stops.g2), xytext=(-2, 3), textcoords="offset points", ha="right", fontsize=8)
    axis.legend(loc="lower center", frameon=False, fontsize=9)
    return figure


def shares(numbers: Mapping[int, Mapping[str, Any]]) -> Figure:
    """Share of time in contact, table by table: means and deviations of the ensembles, exact and of every run."""
    from matplotlib.ticker import PercentFormatter

    figure = new_figure(0.3 * len(numbers) + 1.5, width=5.0)
    axis = figure.subplots()
    rows = sorted(numbers)
    seen: set[str] = set()
    for y, table in enumerate(rows):
        drawn = []
        for name, row in (*numbers[table]["exact"].items(), *numbers[table]["runs"].items()):
            if not row["ensemble"]:
                continue
            exact = name in EXACT
            label = _EXACT_NAMES[name] if exact else _family(name)
            found = share_of(row)
            hollow = name == "velocity-curvature"
            colour = EXACT[name][0] if exact else STYLE[name][0]
            axis.errorbar(
                found.mean, y, xerr=found.sd, fmt="D" if exact else _MARKS[label], ms=6 if exact else 6.5, color=colour,
                mfc="white" if hollow else None, mec=colour if exact else "white", mew=1.0 if exact else 0.5,
                elinewidth=1.0, zorder=3 if exact else 2, label=None if label in seen else label,
            )  # fmt: skip
            seen.add(label)
            drawn.append(found.mean)
        if drawn:
            axis.plot([min(drawn), max(drawn)], [y, y], color="0.85", lw=3, zorder=0, solid_capstyle="round")
    axis.set_yticks(range(len(rows)), [f"Table {table}" for table in rows])
    axis.invert_yaxis()
    axis.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axis.set(xlim=(-0.02, 1.02), xlabel="share of time in contact")
    axis.grid(axis="x", color="0.92", lw=0.8)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure


def share_of(row: Mapping[str, Any]) -> Sample:
    """The share of time in contact of all members of a row of numbers."""
    return Sample(np.array([x for members in row["ensemble"].values() for x in members["fraction"]]))


_EXACT_NAMES = {"displacement": "exact", "velocity-curvature": "exact, velocity-curvature form"}
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
