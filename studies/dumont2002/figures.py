"""Pictures: the paper's panels with exact motion and horizon, the tip at its stop in close-up, shares of contact."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffbeam.basics.arrays import Array
from stiffbeam.figures.chart import COLOURS, DASHES, log_scale, look_of_name, new_figure
from stiffbeam.figures.runs import draw_stops, first_contact, zoom_on_stop
from stiffbeam.trajectory.trajectory import Reference, Trajectory

from .numbers import Sample, amplitude_spectrum
from .table import Made

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Look = tuple[str, tuple[float, ...]]  # colour and dashes
EXACT: dict[str, Look] = {"displacement": ("black", ()), "velocity-curvature": ("black", (4, 1.5))}
REALISATION: dict[str, Any] = {"color": "0.55", "linestyle": (0, (1, 1.5)), "alpha": 0.8, "lw": 1.0}


@dataclass(frozen=True)
class Equation:
    """scheme: its name in the registry. shade: one for each discretisation. label, marker: in a legend of all six."""

    scheme: str
    shade: int
    label: str
    marker: str


EQUATIONS = {
    "(4.13)": Equation("HHT", 0, "HHT", "o"),
    "(4.11)": Equation("BDF2", 0, "BDF2 on (3.5)", "^"),
    "(4.5)": Equation("BDF2", 1, "BDF2 on (3.12)", "s"),
    "(4.14)": Equation("SDIRK", 0, "SDIRK (4.14)", "X"),
    "(4.10)": Equation("SDIRK", 1, "SDIRK on (3.12)", "P"),
    "(4.12)": Equation("SDIRK", 2, "SDIRK on (3.5)", "v"),
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


STYLE = {equation: look_of(equation) for equation in EQUATIONS}
PERIODS = 2.0  # of the drive that panels a and b show; three near resonance, where they are short
TIME, TIP, VELOCITY = "time $t$", "tip displacement $u(1, t)$", "tip velocity $u_t(1, t)$"
FINE, DELAYED, MULTIPLES = 8000, 6000, 15


@dataclass(frozen=True)
class Trace:
    """A run or the exact motion with the look of its curves.

    Parameters
    ----------
    run : Trajectory
    label : str
    look : tuple
        Colour and dashes.
    horizon : float
        The time to which float64 follows the exact motion.
    past : str
        Label of the later part, which is one realisation; "" if the run is exact there too.
    """

    run: Trajectory
    label: str
    look: Look
    horizon: float = np.inf
    past: str = ""

    @property
    def exact(self) -> bool:
        """True for a reference."""
        return isinstance(self.run, Reference)

    @property
    def style(self) -> dict[str, Any]:
        """Keywords of ``plot``: an exact motion is broad and lies below."""
        colour, dashes = self.look
        style = {"color": colour, "linestyle": (0, dashes) if dashes else "-"}
        return style | ({"alpha": 0.5, "lw": 1.6, "zorder": 1} if self.exact else {"lw": 0.9, "zorder": 2})

    @property
    def whole(self) -> str:
        """Label of a curve over the whole span."""
        return self.past or self.label

    def path(self, start: float, end: float) -> tuple[Array, Array, Array]:
        """Times in [start, end], displacement and velocity of the tip."""
        if isinstance(self.run, Reference):
            fine = np.linspace(start, end, FINE)
            return fine, *self.run.at(fine)
        inside = (self.run.t >= start) & (self.run.t <= end)
        return self.run.t[inside], self.run.tip[inside], self.run.tip_velocity[inside]

    def draw(self, axis: Axes, t: Array, x: Array, y: Array, **changes: Any) -> None:
        """Draw y over x, of which the part past the horizon is dotted and grey."""
        late = (t > self.horizon) & bool(self.past)
        for part, label, look in ((~late, self.label, {}), (late, self.past, REALISATION)):
            if np.any(part):
                axis.plot(x[part], y[part], label=label, **self.style | changes | look)


def traces_of(made: Made) -> list[Trace]:
    """The exact motions, then the runs. A motion known only to its horizon goes on from there as dots."""
    traces = []
    for form, exact in made.references.items():
        whole = made.known(form) or made.horizons[form] >= made.case.t_end
        past = "" if whole else f"one realisation, {form}"
        traces.append(Trace(exact, exact_label(made, form), EXACT[form], made.horizons[form], past))
    for equation, run in made.runs.items():
        traces.append(Trace(run, f"{equation} {run.label}", STYLE[equation]))
    return traces


def exact_label(made: Made, form: str) -> str:
    """Label of the exact motion: true where it is known over the whole span."""
    return f"{'true' if made.known(form) else 'exact to the horizon'}, {form}"


# ---------------------------------------------------------------- the panels of a figure


@dataclass(frozen=True)
class Panels:
    """The panels of the figure that belongs to a table. Each method draws one into an axis."""

    made: Made
    traces: list[Trace]

    def displacement(self, axis: Axes, end: float) -> None:
        """The tip over time, between its stops."""
        for trace in self.traces:
            t, u, _ = trace.path(0.0, end)
            trace.draw(axis, t, t, u)
        draw_stops(axis, self.made.stops, horizontal=True)
        self._mark_horizon(axis, end)
        axis.set(xlabel=TIME, ylabel=TIP, xlim=(0.0, end))

    def portrait(self, axis: Axes, start: float, end: float) -> None:
        """The velocity of the tip over its displacement."""
        for trace in self.traces:
            t, u, v = trace.path(start, end)
            look = {"linestyle": "-", "alpha": 0.3, "lw": 0.7} if trace.exact else {"lw": 0.4}
            trace.draw(axis, t, u, v, **look)
        draw_stops(axis, self.made.stops, horizontal=False)
        axis.set(xlabel=TIP, ylabel=VELOCITY)

    def first_contacts(self, axis: Axes) -> None:
        """The first impacts in close-up."""
        main, system = self.traces[0].run, next(iter(self.made.systems.values()))
        begin, end = first_contact(main, system, self.made.case.t_end)
        for trace in self.traces:
            t, u, _ = trace.path(begin, end)
            trace.draw(axis, t, t, u)
        draw_stops(axis, self.made.stops, horizontal=True)
        zoom_on_stop(axis, main, begin, end)
        axis.set(xlabel=TIME, ylabel=TIP, xlim=(begin, end))
        self._mark_horizon(axis, end)

    def shear(self, axis: Axes, end: float) -> None:
        """The contact force, in the paper the shear stress: -kappa [(u - g2)_+ - (g1 - u)_+]."""
        for trace in self.traces:
            t, u, v = trace.path(0.0, end)
            trace.draw(axis, t, t, self.made.stops.force(u, v))
        self._mark_horizon(axis, end)
        axis.set(xlabel=TIME, ylabel=r"contact force $\sigma$", xlim=(0.0, end))

    def delayed(self, axis: Axes, delay: float) -> None:
        """u(t + T) over u(t), as points: on the diagonal for a motion of period T."""
        t = np.linspace(0.0, self.made.case.t_end - delay, DELAYED)
        for trace in self.traces:
            run, colour = trace.run, trace.look[0]
            now, later = (
                run.at(x)[0] if isinstance(run, Reference) else np.interp(x, run.t, run.tip) for x in (t, t + delay)
            )
            axis.plot(now, later, ".", ms=1.6, mew=0.0, color=colour, label=trace.whole, zorder=trace.style["zorder"])
        for horizontal in (False, True):
            draw_stops(axis, self.made.stops, horizontal)
        axis.set(xlabel=TIP, ylabel="tip displacement $u(1, t + T)$")

    def spectrum(self, axis: Axes) -> None:
        """Amplitudes of the tip; of an exact motion at the instants of the first scheme."""
        drive, top = self.made.drive, 0.0
        sampled = next((trace.run.t for trace in self.traces if not trace.exact), self.traces[0].run.t)
        for trace in self.traces:
            run = trace.run
            u = run.at(sampled)[0] if isinstance(run, Reference) else run.tip
            omega, amplitude = amplitude_spectrum(sampled, u, drive)
            shown = (omega > 0.0) & (omega <= (MULTIPLES + 0.5) * drive)
            look = REALISATION if trace.past else {}
            axis.plot(omega[shown], amplitude[shown], label=trace.whole, **trace.style | look)
            top = max(top, float(np.max(amplitude[shown])))
        odd = range(1, 16, 2)
        axis.set(
            xlabel=rf"angular frequency $\omega$, in multiples of the drive a = {drive:g}", xlim=(0.0, 15.5 * drive)
        )
        axis.set_xticks([k * drive for k in odd], [f"{k}a" if k > 1 else "a" for k in odd])
        log_scale(axis, x=False)
        axis.set(ylim=(1e-4 * top, 2.0 * top), ylabel=f"amplitude of {TIP}")

    def _mark_horizon(self, axis: Axes, end: float) -> None:
        """Shade the times past the earliest horizon: there float64 has lost the exact motion."""
        horizon = min(trace.horizon for trace in self.traces)
        if horizon >= end:
            return
        axis.axvspan(horizon, end, color="0.5", alpha=0.10, lw=0, zorder=0)
        axis.axvline(horizon, color="0.3", lw=0.8, zorder=0)
        axis.annotate(
            f"horizon {horizon:.2g}", (horizon, 0.5), xycoords=("data", "axes fraction"), xytext=(4, 0),
            textcoords="offset points", va="center", fontsize=8, color="0.2", zorder=9,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5},
        )  # fmt: skip


def panels(made: Made) -> list[tuple[str, str, Callable[[Axes], None]]]:
    """(letter, title, function that draws into an axis) of the paper's panels, in its order.

    Tables 15 to 17 have the shear stress in c; table 17 has the portrait twice, since the one printed as delayed is
    not.
    """
    drawn, whole, period = Panels(made, traces_of(made)), made.case.t_end, 2.0 * np.pi / made.drive
    end = min(whole, (PERIODS + (made.drive > 30.0)) * period)
    # The portrait of a single run is that of its last periods, where the start has died away.
    start = whole - end if len(made.case.runs) == 1 else 0.0
    found: list[tuple[str, str, Callable[[Axes], None]]] = [
        ("a", f"tip displacement to t = {end:.3g}", lambda axis: drawn.displacement(axis, end)),
        ("b", f"phase portrait, t in [{start:.3g}, {start + end:.3g}]",
         lambda axis: drawn.portrait(axis, start, start + end)),
    ]  # fmt: skip
    if made.number == 17:
        found.append(("b′", "delayed by one drive period T", lambda axis: drawn.delayed(axis, period)))
    if made.number in (15, 16, 17):
        found.append(("c", f"shear stress at the tip to t = {end:.3g}", lambda axis: drawn.shear(axis, end)))
    else:
        found.append(("c", "the first contacts", drawn.first_contacts))
    return [*found, ("d", f"spectrum of the tip to t = {whole:g}", drawn.spectrum)]


def picture(made: Made) -> Figure:
    """The figure that belongs to a table: all its panels with one legend."""
    parts = panels(made)
    rows = (len(parts) + 1) // 2
    figure = new_figure(3.7 * rows + 0.5, width=10.5)
    axes = figure.subplots(rows, 2).ravel()
    for axis, (letter, title, draw) in zip(axes, parts, strict=False):
        draw(axis)
        axis.set_title(f"({letter}) {title}", loc="left", fontsize=10)
        if letter != "d":
            axis.locator_params(axis="x", nbins=6)
    for axis in axes[len(parts) :]:
        axis.set_visible(False)
    figure.suptitle(f"Table {made.number}: {made.case.title}")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    return figure


# ---------------------------------------------------------------- pictures of the main finding


def close_up(made: Made) -> Figure:
    """The tip at its stop, to the horizon: the exact motion bounces where the schemes rest."""
    exact = made.references["displacement"]
    start = 0.9 * float(exact.impacts.times[0])
    lower = exact.impacts.times[exact.impacts.stops < 0]  # the first visit to the upper stop ends before
    end = min(made.horizons["displacement"], float(lower[0]) - 0.02)
    figure = new_figure(3.7, width=7.0)
    axis = figure.subplots()
    for trace in traces_of(made):
        t, u, _ = trace.path(start, end)
        axis.plot(t, u, color=trace.look[0], lw=1.0 if trace.exact else 1.6, label=trace.label)
    draw_stops(axis, made.stops, horizontal=True)
    stop = made.stops.upper_bound
    axis.set(xlim=(start, end), ylim=(0.6 * stop, 1.03 * stop), xlabel=TIME, ylabel=TIP)
    axis.annotate("stop", (end, stop), xytext=(-2, 3), textcoords="offset points", ha="right", fontsize=8)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure


def shares(numbers: Mapping[int, Mapping[str, Any]]) -> Figure:
    """Share of time in contact, table by table: means and deviations of the ensembles, exact and of every run."""
    from matplotlib.ticker import PercentFormatter

    figure = new_figure(0.3 * len(numbers) + 1.5, width=7.0)
    axis = figure.subplots()
    rows, labelled = sorted(numbers), set[str]()
    for y, table in enumerate(rows):
        means = []
        for name, row in (*numbers[table]["exact"].items(), *numbers[table]["runs"].items()):
            if not row["members"]["fraction"]:
                continue
            exact, hollow = name in EXACT, name == "velocity-curvature"
            label = f"exact{', velocity-curvature form' * hollow}" if exact else EQUATIONS[name].label
            found, colour = Sample.of(row, "fraction"), EXACT[name][0] if exact else STYLE[name][0]
            marker, size = ("D", 6) if exact else (EQUATIONS[name].marker, 6.5)
            axis.errorbar(
                found.mean, y, xerr=found.sd, fmt=marker, ms=size, color=colour,
                mfc="white" if hollow else None, mec=colour if exact else "white", mew=1.0 if exact else 0.5,
                elinewidth=1.0, zorder=3 if exact else 2, label=None if label in labelled else label,
            )  # fmt: skip
            labelled.add(label)
            means.append(found.mean)
        if means:
            axis.plot([min(means), max(means)], [y, y], color="0.85", lw=3, zorder=0, solid_capstyle="round")
    axis.set_yticks(range(len(rows)), [f"Table {table}" for table in rows])
    axis.invert_yaxis()
    axis.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axis.set(xlim=(-0.02, 1.02), xlabel="share of time in contact")
    axis.grid(axis="x", color="0.92", lw=0.8)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure
