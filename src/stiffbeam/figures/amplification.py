"""Picture of the study ``amplification``: the classic three plots, and the families over their parameter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ..schemes import SCHEMES
from ..studies.common import scheme_of
from ..studies.study import Records, Row
from . import column, default_label, found_rows, log_scale, look, say_empty, shared_legend, short, signed_log

TENTH = 0.1
FAMILIES = {"hht": ("alpha", "HHT over α"), "sdirk": ("gamma", "SDIRK-OS over γ"),
            "generalised-alpha": ("rho", "generalised-α over ρ")}  # fmt: skip
SYMBOLS = {"alpha": r"$\alpha$", "gamma": r"$\gamma$", "rho": r"$\rho_\infty$"}
HALF = 0.5  # of a period: beyond it the samples alias
NO_DAMPING = 1e-12
GAP = 0.05  # of a parameter: no line is drawn across a pole


def draw(records: Records) -> Figure:
    """Lines are the closed form, markers the kernel's own step; below, dt/T = 0.1 over the parameter."""
    rows = found_rows(records)
    families = {name: _family(rows, name) for name in FAMILIES}
    families = {name: own for name, own in families.items() if len(own) > 2}
    figure = Figure(figsize=(11.0, 7.4 if families else 4.6), layout="constrained")
    figure.suptitle("One step on a free oscillation: markers from the kernel, lines in closed form")
    grid = figure.add_gridspec(2 if families else 1, 3)
    axes = [figure.add_subplot(grid[0, i]) for i in range(3)]
    shown = _shown(records, rows)
    for label in shown:
        _curves(axes, label, [row for row in rows if row["scheme"] == label])
    radius, elongation, damping = axes
    for axis in axes:
        log_scale(axis, y=axis is axes[2])
        axis.set(xlabel=r"$\Delta t/T$")
        axis.grid(color="0.92")
        if not rows:
            say_empty(axis)
    largest = max(column(rows, "spectral_radius"), default=1.0)
    radius.set(ylim=(0.0, min(max(1.05, 1.05 * largest), 3.0)), ylabel=r"spectral radius $\rho$")
    radius.set_title("(a) below 1: high modes die", loc="left")
    signed_log(elongation, (np.asarray(line.get_ydata()) for line in elongation.get_lines()), 1e-11)
    elongation.set(xlim=(1e-3, HALF), ylabel="relative period elongation")
    elongation.set_title("(b) above 0: late", loc="left")
    damping.set(xlim=(1e-3, HALF), ylim=(1e-10, 1.0), ylabel="algorithmic damping ratio")
    damping.set_title("(c) the scheme's own damping", loc="left")
    undamped = [short(label) for label in shown if max(_of(rows, label, "damping_ratio")) <= NO_DAMPING]
    if undamped and rows:
        text = f"none: {', '.join(undamped)}"
        damping.annotate(text, (0.97, 0.03), xycoords="axes fraction", ha="right", fontsize=8.5)
    shared_legend(figure, 4)
    for i, (name, own) in enumerate(families.items()):
        _parameter(figure.add_subplot(grid[1, i]), name, own, "def"[i])
    return figure


def _shown(records: Records, rows: Sequence[Row]) -> list[str]:
    """The schemes asked for, else every registered one with its defaults."""
    labels = list(dict.fromkeys(row["scheme"] for row in rows))
    defaults = [default_label(name) for name in SCHEMES if name != "theta"]
    return labels if records.options.get("schemes") else [label for label in defaults if label in labels] or labels


def _of(rows: Sequence[Row], label: str, name: str) -> list[float]:
    return [row[name] for row in rows if row["scheme"] == label and row["dt_over_period"] < HALF]


def _curves(axes, label: str, own: Sequence[Row]) -> None:
    style = look(label)
    for axis, name in zip(axes, ("spectral_radius", "period_elongation", "damping_ratio"), strict=True):
        x, measured, theory = (column(own, key) for key in ("dt_over_period", name, f"{name}_theory"))
        if name == "period_elongation":
            x, measured, theory = (values[x <= HALF] for values in (x, measured, theory))
        line = np.where(np.isfinite(theory), theory, measured)
        if name == "damping_ratio":
            measured, line = (np.where(y > NO_DAMPING, y, np.nan) for y in (measured, line))  # a logarithm of none
        if not np.any(np.isfinite(line)):
            continue
        axis.plot(x, line, lw=1.0, **style | {"marker": ""})
        some = slice(len(x) // 48, None, max(1, len(x) // 24))
        axis.plot(x[some], measured[some], ms=3.6, **style | {"linestyle": ""})
    axes[0].plot([], [], lw=1.0, ms=4, label=short(label), **style)


def _family(rows: Sequence[Row], name: str) -> list[Row]:
    """The rows of a scheme at dt/T = 0.1, one for every value of its parameter, ascending."""
    parameter, _ = FAMILIES[name]
    own: dict[float, Row] = {}
    for row in rows:
        if row["name"] == name and row["dt_over_period"] == TENTH:
            own.setdefault(float(scheme_of(row["scheme"]).parameters[parameter]), row)
    return [own[value] | {"parameter": value} for value in sorted(own)]


def _parameter(axis, name: str, own: Sequence[Row], letter: str) -> None:
    parameter, title = FAMILIES[name]
    x = column(own, "parameter")
    breaks = np.flatnonzero(np.diff(x) > GAP) + 1 if name == "sdirk" else []
    for quantity, marker, dash, colour, text in (
        ("period_elongation", "o", "-", "black", "period elongation"),
        ("damping_ratio", "s", "--", "0.5", "damping ratio"),
    ):
        y = np.insert(100.0 * column(own, quantity), breaks, np.nan)
        axis.plot(np.insert(x, breaks, np.nan), y, marker=marker, ms=3.6, lw=1.0, ls=dash, color=colour, label=text)
    axis.axhline(0.0, color="0.6", lw=0.7, zorder=0)
    axis.grid(color="0.92")
    axis.set(xlabel=SYMBOLS[parameter], ylabel="per cent")
    axis.set_title(f"({letter}) {title}, Δt/T = 0.1", loc="left")
    axis.legend(frameon=False, fontsize=8.5)
