"""Pictures: the paper's panels with exact motion and horizon, contact in close-up, shares of contact, the film."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffbeam.basics.storage import write_whole
from stiffbeam.figures.animation import animate
from stiffbeam.figures.chart import COLOURS, DASHES, look_of_name, new_figure
from stiffbeam.figures.runs import draw_stops
from stiffbeam.references import reference

from .panels import Trace, delayed, displacement, first_contacts, portrait, shear, spectrum
from .sample import of_members
from .table import Made

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Look = tuple[str, tuple[float, ...]]  # colour and dashes
EXACT: dict[str, Look] = {"displacement": ("black", ()), "velocity-curvature": ("black", (4, 1.5))}
ONE: dict[str, Any] = {"color": "0.55", "dashes": (1, 1.5)}  # of REALISATION, for a legend


@dataclass(frozen=True)
class Equation:
    """scheme: its name in the registry. shade: one for each discretisation. label, marker: in a legend of all six."""

    scheme: str
    shade: int
    label: str
    marker: str


EQUATIONS = {
    "(4.13)": Equation("hht", 0, "HHT", "o"),
    "(4.11)": Equation("bdf2", 0, "BDF2 on (3.5)", "^"),
    "(4.5)": Equation("bdf2", 1, "BDF2 on (3.12)", "s"),
    "(4.14)": Equation("sdirk", 0, "SDIRK (4.14)", "X"),
    "(4.10)": Equation("sdirk", 1, "SDIRK on (3.12)", "P"),
    "(4.12)": Equation("sdirk", 2, "SDIRK on (3.5)", "v"),
}
SHADES = ((1.0, 0.0), (0.55, 0.0), (0.6, 0.4))  # share of the colour, share of white


def look_of(equation: str) -> Look:
    """Colour and dashes of an equation: its scheme has the colour it has everywhere, each discretisation a shade."""
    scheme, shade = EQUATIONS[equation].scheme, EQUATIONS[equation].shade
    colour, dashes, _ = look_of_name(scheme)
    share, white = SHADES[shade]
    channels = (int(COLOURS[colour][k : k + 2], 16) for k in (1, 3, 5))
    shaded = "".join(f"{round(share * channel + white * 255):02X}" for channel in channels)
    return f"#{shaded}", DASHES[(dashes + 2 * shade) % len(DASHES)]


def name_of(equation: str) -> str:
    """Name of an equation in a sentence: HHT, of which there is one, or such as BDF2 (4.5)."""
    scheme = EQUATIONS[equation].scheme.upper()
    return scheme if scheme == "HHT" else f"{scheme} {equation}"


STYLE = {equation: look_of(equation) for equation in EQUATIONS}
PERIODS = 2.0  # of the drive that panels a and b show; three near resonance, where they are short
DPI, PALETTE = 200, 48
TIP = "tip displacement $u(1, t)$"
PAST = 1.25  # horizons: long enough to see where the exact motion is one among many
SECONDS, FRAMES_PER_SECOND, FILM_DPI = 8.0, 10, 60  # about a megabyte


@dataclass(frozen=True)
class Panel:
    """letter: the paper's. title: what is drawn. draw: puts it on an axis."""

    letter: str
    title: str
    draw: Callable[[Axes], None]

    def on(self, axis: Axes) -> None:
        """Draw it with its title."""
        self.draw(axis)
        axis.set_title(f"({self.letter}) {self.title}", loc="left", fontsize=10)


def panels(made: Made) -> list[Panel]:
    """The panels of the figure that belongs to a table, in the paper's order.

    Tables 15 to 17 have the shear stress in c; table 17 has the portrait twice, since the one printed
    as delayed is not.
    """
    periods = PERIODS + (made.drive > 30.0)
    whole = made.case.t_end
    end = min(whole, periods * 2.0 * np.pi / made.drive)
    # The portrait of a single run is that of its last periods, where the start has died away.
    start = whole - end if len(made.case.runs) == 1 else 0.0
    traces, system = _traces(made), next(iter(made.systems.values()))
    period = 2.0 * np.pi / made.drive

    def drawn(draw: Callable[..., None], *numbers: float) -> Callable[[Axes], None]:
        return lambda axis: draw(axis, traces, system, *numbers)

    found = [
        Panel("a", f"tip displacement to t = {end:.3g}", drawn(displacement, 0.0, end)),
        Panel("b", f"phase portrait, t in [{start:.3g}, {start + end:.3g}]", drawn(portrait, start, start + end)),
    ]
    if made.number == 17:
        found.append(Panel("b′", "delayed by one drive period T", drawn(delayed, 0.0, whole - period, period)))
    if made.number in (15, 16, 17):
        found.append(Panel("c", f"shear stress at the tip to t = {end:.3g}", drawn(shear, 0, 0.0, end)))
    else:
        found.append(Panel("c", "the first contacts", drawn(first_contacts, 0, whole)))
    found.append(Panel("d", f"spectrum of the tip to t = {whole:g}", drawn(spectrum, made.drive)))
    return found


def picture(panel: Panel) -> Figure:
    """One panel as a picture of its own, of a size that a phone shows without shrinking."""
    figure = new_figure(3.5, width=5.0)
    panel.on(figure.subplots())
    return figure


def save_small(figure: Figure, file: Path) -> Path:
    """PNG with a palette: a quarter of the size, and seventy of them go into one page."""
    from PIL import Image

    content, small = BytesIO(), BytesIO()
    figure.savefig(content, format="png", dpi=DPI)
    Image.open(content).convert("RGB").quantize(PALETTE).save(small, format="png", optimize=True)
    return write_whole(file, small.getvalue())


def together(made: Made) -> Figure:
    """All panels in one picture with a legend, for a page of print."""
    parts = panels(made)
    rows = (len(parts) + 1) // 2
    figure = new_figure(3.7 * rows + 0.5, width=10.5)
    axes = figure.subplots(rows, 2).ravel()
    for axis, panel in zip(axes, parts, strict=False):
        panel.on(axis)
    for axis in axes[len(parts) :]:
        axis.set_visible(False)
    figure.suptitle(f"Table {made.number}: {made.case.title}")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _traces(made: Made) -> list[Trace]:
    """The exact motions, then the runs. A motion that is known to its horizon only goes on from there as dots."""
    traces = []
    for form, exact in made.references.items():
        past = "" if made.known(form) else f"one realisation, {form}"
        style = _style(EXACT[form]) | {"alpha": 0.5}
        traces.append(Trace(exact, exact_label(made, form), style, made.horizons[form], past))
    for equation, run in made.runs.items():
        traces.append(Trace(run, f"{equation} {run.label}", _style(STYLE[equation])))
    return traces


def exact_label(made: Made, form: str) -> str:
    """Label of the exact motion: true where it is known over the whole span."""
    return f"{'true' if made.known(form) else 'exact to the horizon'}, {form}"


def _style(look: Look) -> dict[str, Any]:
    """Keywords of ``plot`` for a look."""
    return {"color": look[0], "linestyle": (0, look[1]) if look[1] else "-"}


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
        label = f"{EQUATIONS[equation].scheme.upper()} {equation}"
        axis.plot(run.t[here], run.tip[here], color=STYLE[equation][0], lw=1.6, label=label)
    draw_stops(axis, made.stops, horizontal=True)
    stop = made.stops.upper_bound
    axis.set(xlim=(start, end), ylim=(0.6 * stop, 1.03 * stop), xlabel="time $t$", ylabel=TIP)
    axis.annotate("stop", (end, stop), xytext=(-2, 3), textcoords="offset points", ha="right", fontsize=8)
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
            exact, hollow = name in EXACT, name == "velocity-curvature"
            label = f"exact{', velocity-curvature form' * hollow}" if exact else EQUATIONS[name].label
            found, colour = of_members(row, "fraction"), EXACT[name][0] if exact else STYLE[name][0]
            marker, size = ("D", 6) if exact else (EQUATIONS[name].marker, 6.5)
            axis.errorbar(
                found.mean, y, xerr=found.sd, fmt=marker, ms=size, color=colour,
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


def film(made: Made, file: Path) -> Path:
    """Write the film of the runs on the displacement form beside the exact motion, to a quarter past the horizon."""
    system = made.systems["displacement"]
    end = min(made.case.t_end, PAST * made.horizons["displacement"])
    runs = [run for run in made.runs.values() if run.fingerprint == system.fingerprint]
    return animate([reference(system, end), *runs], file, SECONDS, FRAMES_PER_SECOND, end, dpi=FILM_DPI)
