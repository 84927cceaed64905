"""Pictures: the paper's panels with true motion and horizon, the tip at its stop in close-up, shares of contact."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

import stiffbeam as sb
from stiffbeam.basics.arrays import Array
from stiffbeam.figures.chart import COLOURS, Axes, Figure, dashed, log_scale, new_figure, shared_legend
from stiffbeam.figures.runs import draw_stops, first_contact, zoom_on_stop
from stiffbeam.schemes import SCHEMES

from .numbers import amplitude_spectrum, mean_and_deviation
from .table import Table

# Name and marker of a motion where all stand side by side: of the exact motion of a form, and of an equation.
NAMES = {
    "displacement": ("exact", "D"), "velocity-curvature": ("exact, velocity-curvature form", "D"),
    "(4.13)": ("HHT", "o"), "(4.11)": ("BDF2 on (3.5)", "^"), "(4.5)": ("BDF2 on (3.12)", "s"),
    "(4.14)": ("SDIRK (4.14)", "X"), "(4.10)": ("SDIRK on (3.12)", "P"), "(4.12)": ("SDIRK on (3.5)", "v"),
}  # fmt: skip
# Scheme of an equation, which has the colour that it has everywhere, and a shade for each of its discretisations.
LOOKS = {"(4.13)": ("HHT", 0), "(4.11)": ("BDF2", 0), "(4.5)": ("BDF2", 1), "(4.14)": ("SDIRK", 0),
         "(4.10)": ("SDIRK", 1), "(4.12)": ("SDIRK", 2)}  # fmt: skip
SHADES = ((1.0, 0.0), (0.55, 0.0), (0.6, 0.4))  # share of the colour, share of white
TRUE = {"displacement": "-", "velocity-curvature": (0, (4, 1.5))}  # line styles of the true motions, which are black
PERIODS = 2.0  # of the drive that panels a and b show; three near resonance, where they are short
TIME, TIP = "time $t$", "tip displacement $u(1, t)$"
FINE, DELAYED, MULTIPLES = 8000, 6000, 15  # points of a true motion; of a delayed one; of the drive, in a spectrum


def style(motion: str) -> dict[str, Any]:
    """Colour and line style of an equation, or of the true motion of a form."""
    from matplotlib.colors import to_rgb

    if motion in TRUE:
        return {"color": "black", "linestyle": TRUE[motion]}
    scheme, shade = LOOKS[motion]
    (colour, dashes, _), (share, white) = SCHEMES[scheme].look, SHADES[shade]
    shaded = tuple(share * x + white for x in to_rgb(COLOURS[colour]))
    return {"color": shaded, "linestyle": dashed(dashes + 2 * shade)}


def curves(
    table: Table, start: float, end: float, points: int = FINE
) -> Iterator[tuple[str, dict[str, Any], Array, Array, Array]]:
    """Form or equation, keywords of ``plot``, times in [start, end], displacement and velocity of the tip.

    True motions, which have as many points as asked for, are broad and lie below the runs, which have their steps.
    """
    for name, motion in {**table.references, **table.runs}.items():
        if isinstance(motion, sb.Reference):
            look: dict[str, Any] = {"label": f"true, {name}", "alpha": 0.5, "lw": 1.6, "zorder": 1}
            t = np.linspace(start, end, points)
            u, v = motion.at(t)
        else:
            look = {"label": f"{name} {motion.label}", "lw": 0.9, "zorder": 2}
            inside = (motion.t >= start) & (motion.t <= end)
            t, u, v = (x[inside] for x in (motion.t, motion.tip, motion.tip_velocity))
        yield name, style(name) | look, t, u, v


# ---------------------------------------------------------------- the panels of a figure


def _over_time(axis: Axes, table: Table, start: float, end: float, force: bool = False) -> None:
    """The tip over time, between its stops; or the contact force, in the paper the shear stress.

    Times past the earliest horizon are grey: there float64 has lost the true motion.
    """
    for _, look, t, u, v in curves(table, start, end):
        axis.plot(t, table.stops.force(u, v) if force else u, **look)
    if not force:
        draw_stops(axis, table.stops, horizontal=True)
    axis.set(xlabel=TIME, ylabel=r"contact force $\sigma$" if force else TIP, xlim=(start, end))
    if (horizon := min(table.horizons.values())) < end:
        axis.axvspan(horizon, end, color="0.5", alpha=0.10, lw=0, zorder=0)
        axis.axvline(horizon, color="0.3", lw=0.8, zorder=0)
        axis.annotate(
            f"horizon {horizon:.2g}", (horizon, 0.5), xycoords=("data", "axes fraction"), xytext=(4, 0),
            textcoords="offset points", va="center", fontsize=8, color="0.2", zorder=9,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5},
        )  # fmt: skip


def _portrait(axis: Axes, table: Table, start: float, end: float) -> None:
    """The velocity of the tip over its displacement."""
    for name, look, _, u, v in curves(table, start, end):
        look |= {"linestyle": "-", "alpha": 0.3, "lw": 0.7} if name in TRUE else {"lw": 0.4}
        axis.plot(u, v, **look)
    draw_stops(axis, table.stops, horizontal=False)
    axis.set(xlabel=TIP, ylabel="tip velocity $u_t(1, t)$")


def _first_contacts(axis: Axes, table: Table) -> None:
    """The first impacts in close-up."""
    form, main = next(iter(table.references.items()))
    begin, end = first_contact(main, table.systems[form], table.case.t_end)
    _over_time(axis, table, begin, end)
    zoom_on_stop(axis, main.contacts[0])


def _delayed(axis: Axes, table: Table, delay: float) -> None:
    """u(t + T) over u(t), as points: on the diagonal for a motion of period T."""
    lag, each = round(delay / table.case.dt), table.steps // DELAYED
    for _, look, _, u, _ in curves(table, 0.0, table.case.t_end, table.steps + 1):
        points = {"color": look["color"], "zorder": look["zorder"]}
        axis.plot(u[:-lag:each], u[lag::each], ".", ms=1.6, mew=0.0, **points)
    for horizontal in (False, True):
        draw_stops(axis, table.stops, horizontal)
    axis.set(xlabel=TIP, ylabel="tip displacement $u(1, t + T)$")


def _spectrum(axis: Axes, table: Table) -> None:
    """Amplitudes of the tip, at multiples of the table's time step."""
    drive, top = table.drive, 0.0
    for _, look, t, u, _ in curves(table, 0.0, table.case.t_end, table.steps + 1):
        omega, amplitude = amplitude_spectrum(t, u, drive)
        shown = (omega > 0.0) & (omega <= (MULTIPLES + 0.5) * drive)
        axis.plot(omega[shown], amplitude[shown], **look)
        top = max(top, float(np.max(amplitude[shown])))
    log_scale(axis, x=False)
    odd, limit = range(1, MULTIPLES + 1, 2), (MULTIPLES + 0.5) * drive
    axis.set_xticks([k * drive for k in odd], [f"{k}a" if k > 1 else "a" for k in odd])
    axis.set(xlim=(0.0, limit), ylim=(1e-4 * top, 2.0 * top), ylabel=f"amplitude of {TIP}",
             xlabel=rf"angular frequency $\omega$, in multiples of the drive a = {drive:g}")  # fmt: skip


def picture(table: Table) -> Figure:
    """The figure that belongs to a table, with the paper's panels in its order.

    Tables 15 to 17 have the shear stress in c; table 17 has the portrait twice, since the one printed as delayed is
    not.
    """
    whole, period = table.case.t_end, 2.0 * np.pi / table.drive
    end = min(whole, (PERIODS + (table.drive > 30.0)) * period)
    # The portrait of a single run is that of its last periods, where the start has died away.
    start = whole - end if len(table.case.runs) == 1 else 0.0
    panels: dict[str, Callable[[Axes, Table], None]] = {
        f"(a) tip displacement to t = {end:.3g}": partial(_over_time, start=0.0, end=end),
        f"(b) phase portrait, t in [{start:.3g}, {start + end:.3g}]": partial(_portrait, start=start, end=start + end),
    }
    if table.number == 17:
        panels["(b′) delayed by one drive period T"] = partial(_delayed, delay=period)
    if table.number in (15, 16, 17):
        panels[f"(c) shear stress at the tip to t = {end:.3g}"] = partial(_over_time, start=0.0, end=end, force=True)
    else:
        panels["(c) the first contacts"] = _first_contacts
    panels[f"(d) spectrum of the tip to t = {whole:g}"] = _spectrum
    rows = (len(panels) + 1) // 2
    figure = new_figure(3.7 * rows + 0.5, f"Table {table.number}: {table.case.title}", width=10.5)
    for place, (title, draw) in enumerate(panels.items(), 1):
        axis = figure.add_subplot(rows, 2, place)
        axis.set_title(title, loc="left", fontsize=10)
        axis.locator_params(axis="x", nbins=6)
        draw(axis, table)
    shared_legend(figure, columns=2)
    return figure


# ---------------------------------------------------------------- pictures of the main finding


def close_up(table: Table) -> Figure:
    """The tip at its stop, to the horizon: the true motion bounces where the schemes rest."""
    impacts = table.references["displacement"].impacts
    lower = impacts.times[impacts.stops < 0]  # the first visit to the upper stop ends before
    start, end = 0.9 * float(impacts.times[0]), min(table.horizons["displacement"], float(lower[0]) - 0.02)
    figure = new_figure(3.7, width=7.0)
    axis = figure.subplots()
    for name, look, t, u, _ in curves(table, start, end):
        axis.plot(t, u, color=look["color"], lw=1.0 if name in TRUE else 1.6, label=look["label"])
    draw_stops(axis, table.stops, horizontal=True)
    stop = table.stops.law.g2
    axis.set(xlim=(start, end), ylim=(0.6 * stop, 1.03 * stop), xlabel=TIME, ylabel=TIP)
    axis.annotate("stop", (end, stop), xytext=(-2, 3), textcoords="offset points", ha="right", fontsize=8)
    shared_legend(figure, columns=1)
    return figure


def shares(numbers: Mapping[int, Mapping[str, Any]]) -> Figure:
    """Share of time in contact, table by table: means and deviations of the ensembles, exact and of every run."""
    from matplotlib.ticker import PercentFormatter

    figure = new_figure(0.3 * len(numbers) + 1.5, width=7.0)
    axis = figure.subplots()
    for y, table in enumerate(numbers):
        rows = {**numbers[table]["exact"], **numbers[table]["runs"]}
        found = {name: row["members"]["fraction"] for name, row in rows.items() if row["members"]["fraction"]}
        means = [mean_and_deviation(values)[0] for values in found.values()]
        axis.plot([min(means), max(means)], [y, y], color="0.85", lw=3, zorder=0, solid_capstyle="round")
        for name, values in found.items():
            (mean, sd), colour, (label, marker) = mean_and_deviation(values), style(name)["color"], NAMES[name]
            edge: dict[str, Any] = {"mec": "white", "mew": 0.5, "zorder": 3 if name in TRUE else 2}
            if name == "velocity-curvature":
                edge |= {"mec": colour, "mew": 1.0, "mfc": "white", "zorder": 2}
            axis.errorbar(mean, y, xerr=sd, fmt=marker, ms=6.5, color=colour, label=label, elinewidth=1.0, **edge)
    axis.set_yticks(range(len(numbers)), [f"Table {table}" for table in numbers])
    axis.invert_yaxis()
    axis.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axis.set(xlim=(-0.02, 1.02), xlabel="share of time in contact")
    axis.grid(axis="x", color="0.92", lw=0.8)
    shared_legend(figure, columns=2)
    return figure
