"""Pictures of a sweep: the bifurcation diagram over impacts and forces, or a map of two parameters."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from ..arrays import Array
from ..studies.study import Records, Rows
from . import COLOURS, column, found_rows, say_empty

NAMES = {
    "frequency": "drive frequency $a$", "amplitude": "drive amplitude $E$", "clearance": "clearance $g$",
    "stop-stiffness": r"stop stiffness $\kappa$", "stiffness": "bending stiffness $k^2$", "viscosity": "viscosity $d$",
    "dt": r"time step $\Delta t$", "alpha": r"$\alpha$", "gamma": r"$\gamma$", "rho": r"$\rho_\infty$",
}  # fmt: skip


def draw(records: Records) -> Figure:
    """One parameter: sections, impacts, forces on one axis. Two: a map of each quantity."""
    rows = found_rows(records)
    contacts = [row for row in rows if row["kind"] == "contact"]
    if rows and isinstance(rows[0]["second"], str):
        figure = Figure(figsize=(11.0, 4.2), layout="constrained")
        _maps(figure, contacts)
    else:
        figure = Figure(figsize=(11.0, 8.2), layout="constrained")
        _diagram(figure, [row for row in rows if row["kind"] == "section"], contacts)
    title = records.case.name
    if rows:
        one = rows[0]
        title += f": {one['method']}, {one['form']}, {one['periods']} periods of the drive after {one['transient']}"
    figure.suptitle(title)
    return figure


def _diagram(figure: Figure, points: Rows, contacts: Rows) -> None:
    section, count, force = figure.subplots(3, 1, sharex=True, height_ratios=[3.0, 1.0, 1.0])
    name = (points or contacts)[0]["parameter"] if points or contacts else "parameter"
    section.set(ylabel="tip $u(1, nT)$")
    section.set_title("(a) the tip once in every period $T$ of the drive", loc="left")
    if points:
        # The fainter the more points there are, so that dense bands and single curves can be told apart.
        alpha = float(np.clip(2e4 / len(points), 0.15, 0.9))
        section.plot(
            column(points, name), column(points, "tip"), ls="none", marker=".", ms=3.0, mew=0.0, color=COLOURS[0],
            alpha=alpha, rasterized=True,
        )  # fmt: skip
    else:
        say_empty(section)
    along = column(contacts, name)
    order = np.argsort(along)
    per_period = column(contacts, "count") / column(contacts, "periods")
    for axis, values, label, title, colour in (
        (count, per_period, "impacts per period", "(b) impacts", COLOURS[1]),
        (force, column(contacts, "peak_force"), r"peak $|\sigma|$", "(c) largest contact force", COLOURS[2]),
    ):
        axis.set(ylabel=label)
        axis.set_title(title, loc="left")
        if contacts:
            line = 0.7 if len(along) <= 400 else 0.0  # more points than that are a band, lines would fill it
            axis.plot(along[order], values[order], lw=line, marker=".", ms=3.0 if line else 1.5, color=colour)
            axis.set_ylim(bottom=0.0)
        else:
            say_empty(axis, "no contact")
    _log_where_even(force.set_xscale, column([*points, *contacts], name))
    force.set(xlabel=NAMES.get(name, name))
    figure.align_ylabels()


def _maps(figure: Figure, contacts: Rows) -> None:
    x_name, y_name = contacts[0]["parameter"], contacts[0]["second"]
    x, y = column(contacts, x_name), column(contacts, y_name)
    here = np.isfinite(x) & np.isfinite(y)
    axes: list[Axes] = list(figure.subplots(1, 3, sharex=True, sharey=True))
    for axis, values, label in (
        (axes[0], column(contacts, "count") / column(contacts, "periods"), "impacts per period"),
        (axes[1], column(contacts, "fraction"), "share of time in contact"),
        (axes[2], column(contacts, "peak_force"), r"peak force $|\sigma|$"),
    ):
        axis.set_title(label, loc="left")
        axis.set(xlabel=NAMES.get(x_name, x_name))
        known = values[here & np.isfinite(values)]
        if not len(known):
            say_empty(axis)
            continue
        across, up = np.unique(x[here]), np.unique(y[here])
        grid = np.full((len(up), len(across)), np.nan)
        grid[np.searchsorted(up, y[here]), np.searchsorted(across, x[here])] = values[here]
        wide = 0.0 < 30.0 * np.min(known) < np.max(known)
        drawn = axis.pcolormesh(
            across, up, grid, cmap="cividis", shading="nearest", norm=LogNorm() if wide else None, rasterized=True
        )
        figure.colorbar(drawn, ax=axis, label=label)
        _log_where_even(axis.set_xscale, across)
        _log_where_even(axis.set_yscale, up)
    axes[0].set(ylabel=NAMES.get(y_name, y_name))


def _log_where_even(set_scale, values: Array) -> None:
    """A logarithmic axis for values that are spaced by a factor."""
    values = np.unique(values[np.isfinite(values)])
    if len(values) < 3 or values[0] <= 0.0:
        return
    ratios, steps = np.diff(np.log(values)), np.diff(values)
    if np.ptp(ratios) < 1e-6 * np.max(ratios) and np.ptp(steps) > 1e-3 * np.max(steps):
        set_scale("log")
