"""The paper's figures: its four panels, one picture each, with the exact solution and the horizon drawn in."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffbeam.basics.arrays import Array
from stiffbeam.basics.whole_file import write_whole
from stiffbeam.figures.comparison import draw_stops, first_contact, zoom_on_stop
from stiffbeam.figures.panels import new_figure
from stiffbeam.figures.style import COLOURS, DASHES, look_of_name
from stiffbeam.measures.peaks import MULTIPLES
from stiffbeam.measures.spectrum import amplitude_spectrum
from stiffbeam.trajectory.trajectory import Reference, Trajectory

from .table import Made

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Look = tuple[str, tuple[float, ...]]  # colour and dashes
EXACT: dict[str, Look] = {"displacement": ("black", ()), "velocity-curvature": ("black", (4, 1.5))}
ONE: dict[str, Any] = {"color": "0.55", "dashes": (1, 1.5), "alpha": 0.8}  # what float64 makes of it past the horizon
# A scheme has the colour it has everywhere; on another discretisation it has the same hue, darker or lighter.
SCHEME_OF = {
    "(4.13)": ("hht", 0), "(4.11)": ("bdf2", 0), "(4.5)": ("bdf2", 1), "(4.14)": ("sdirk", 0), "(4.10)": ("sdirk", 1),
    "(4.12)": ("sdirk", 2),
}  # fmt: skip
SHADES = ((1.0, 0.0), (0.55, 0.0), (0.6, 0.4))  # share of the colour, share of white


def look_of(equation: str) -> Look:
    """Colour and dashes of one of the paper's equations, those of its scheme."""
    name, variant = SCHEME_OF[equation]
    colour, dashes, _ = look_of_name(name)
    own, white = SHADES[variant]
    channels = (int(COLOURS[colour][k : k + 2], 16) for k in (1, 3, 5))
    shaded = "".join(f"{round(own * channel + white * 255):02X}" for channel in channels)
    return f"#{shaded}", DASHES[(dashes + 2 * variant) % len(DASHES)]


STYLE = {equation: look_of(equation) for equation in SCHEME_OF}
PERIODS = 2.0  # of the drive that panels a and b show; three near resonance, where they are short
DPI, PALETTE = 200, 48


@dataclass(frozen=True)
class Panel:
    """letter: the paper's. title: what is drawn. draw: puts it on an axis."""

    letter: str
    title: str
    draw: Callable[[Axes], None]


def panels(made: Made) -> list[Panel]:
    """The panels of the figure that belongs to a table, in the paper's order.

    Tables 15 to 17 have the shear stress in c; table 17 has the portrait twice, since the one printed
    as delayed is not.
    """
    periods = PERIODS + (made.drive > 30.0)
    end = min(made.case.t_end, periods * 2.0 * np.pi / made.drive)
    found = [
        Panel("a", f"tip displacement to t = {end:.3g}", lambda axis: _displacement(axis, made, end)),
        Panel("b", _portrait_title(made, end), lambda axis: _portrait(axis, made, end)),
    ]
    if made.number == 17:
        found.append(Panel("b′", "delayed by one drive period T", lambda axis: _delayed(axis, made)))
    if made.number in (15, 16, 17):
        found.append(Panel("c", f"shear stress at the tip to t = {end:.3g}", lambda axis: _stress(axis, made, end)))
    else:
        found.append(Panel("c", "the first contacts", lambda axis: _first_contact(axis, made)))
    found.append(Panel("d", f"spectrum of the tip to t = {made.case.t_end:g}", lambda axis: _spectrum(axis, made)))
    return found


def picture(panel: Panel) -> Figure:
    """One panel as a picture of its own, of a size that a phone shows without shrinking."""
    figure = new_figure(3.5, width=5.0)
    axis = figure.subplots()
    panel.draw(axis)
    axis.set_title(f"({panel.letter}) {panel.title}", loc="left", fontsize=10)
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
        panel.draw(axis)
        axis.set_title(f"({panel.letter}) {panel.title}", loc="left", fontsize=10)
    for axis in axes[len(parts) :]:
        axis.set_visible(False)
    figure.suptitle(f"Table {made.number}: {made.case.title}")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _curves(made: Made, end: float, start: float = 0.0) -> Iterator[tuple[str, dict[str, Any], Array, Array, Array]]:
    """(label, style, t, u, v) of the exact motions, then of the runs, over [start, end].

    A motion that is known to its horizon only goes on from there as dots: one realisation.
    """
    fine = np.linspace(start, end, 8000)
    for form, exact in made.references.items():
        style = _exact_style(form) | {"alpha": 0.5, "lw": 1.6, "zorder": 1}
        horizon = end if made.known(form) else made.horizons[form]
        known, past = fine[fine <= horizon], fine[fine > horizon]
        if len(known):
            yield exact_label(made, form), style, known, *exact.at(known)
        if len(past):
            yield f"one realisation, {form}", style | ONE | {"lw": 1.0}, past, *exact.at(past)
    for order, (equation, run) in enumerate(made.runs.items()):
        here = (run.t >= start) & (run.t <= end)
        yield f"{equation} {run.label}", _style(equation, order), run.t[here], run.tip[here], run.tip_velocity[here]


def exact_label(made: Made, form: str) -> str:
    """True where the whole span is known, else exact."""
    return f"{'true' if made.known(form) else 'exact to the horizon'}, {form}"


def _exact_style(form: str) -> dict[str, Any]:
    colour, dashes = EXACT[form]
    return {"color": colour, "dashes": dashes or (None, None)}


def _style(equation: str, order: int) -> dict[str, Any]:
    colour, dashes = STYLE[equation]
    return {"color": colour, "dashes": dashes or (None, None), "lw": 1.0, "zorder": 2 + order}


def _line(axis: Axes, x: Array, y: Array, label: str, style: dict[str, Any]) -> None:
    axis.plot(x, y, label=label, **style)


def _displacement(axis: Axes, made: Made, end: float) -> None:
    for label, style, t, u, _ in _curves(made, end):
        _line(axis, t, u, label, style | {"lw": 0.8})  # thin: the exact motion is fast
    _stops(axis, made, horizontal=True)
    _horizon(axis, made, end)
    axis.set(xlabel="time $t$", ylabel="tip displacement $u(1, t)$", xlim=(0.0, end))


def _horizon(axis: Axes, made: Made, end: float) -> None:
    """Past the earliest horizon a float64 computation has lost the exact motion."""
    horizon = min(made.horizons.values())
    if horizon >= end:
        return
    axis.axvspan(horizon, end, color="0.5", alpha=0.10, lw=0, zorder=0)
    axis.axvline(horizon, color="0.3", lw=0.8, zorder=0)
    axis.annotate(
        f"horizon {horizon:.2g}", (horizon, 0.5), xycoords=("data", "axes fraction"), xytext=(4, 0),
        textcoords="offset points", va="center", fontsize=8, color="0.2", zorder=9,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5},
    )  # fmt: skip


def _portrait_span(made: Made, end: float) -> tuple[float, float]:
    """The first periods; of the single runs the last ones, where the start has died away."""
    return (made.case.t_end - end, made.case.t_end) if len(made.case.runs) == 1 else (0.0, end)


def _portrait_title(made: Made, end: float) -> str:
    start, end = _portrait_span(made, end)
    return f"phase portrait, t in [{start:.3g}, {end:.3g}]"


def _portrait(axis: Axes, made: Made, end: float) -> None:
    start, end = _portrait_span(made, end)
    for label, style, _, u, v in _curves(made, end, start):
        thin = style | {"lw": 0.5, "alpha": 0.3 if style["zorder"] == 1 else 0.85}
        if not label.startswith("one realisation"):
            thin["dashes"] = (None, None)
        _line(axis, u, v, label, thin)
    _stops(axis, made, horizontal=False)
    axis.set(xlabel="tip displacement $u(1, t)$", ylabel="tip velocity $u_t(1, t)$")
    axis.locator_params(axis="x", nbins=6)


def _delayed(axis: Axes, made: Made) -> None:
    """(u(1, t), u(1, t + T)): on the diagonal for a motion of period T. Every twentieth step, as points."""
    period, end = 2.0 * np.pi / made.drive, made.case.t_end
    t = np.arange(0.0, end - period, 20.0 * made.case.dt)
    motions: list[tuple[str, dict[str, Any], Callable[..., Any]]] = []
    for form, exact in made.references.items():
        label = exact_label(made, form) if made.known(form) else f"one realisation, {form}"
        motions.append((label, {"color": "black", "alpha": 0.35, "zorder": 1}, _tip_of(exact)))
    for equation, run in made.runs.items():
        motions.append((f"{equation} {run.label}", {"color": STYLE[equation][0], "zorder": 2}, _tip_of(run)))
    for label, style, tip in motions:
        axis.plot(tip(t), tip(t + period), ".", ms=1.6, mew=0, label=label, **style)
    _stops(axis, made, horizontal=False)
    _stops(axis, made, horizontal=True)
    axis.set(xlabel="$u(1, t)$", ylabel="$u(1, t + T)$", aspect="equal")


def _tip_of(run: Trajectory) -> Callable[[Array], Array]:
    if isinstance(run, Reference):
        return lambda t: run.at(t)[0]
    return lambda t: np.interp(t, run.t, run.tip)


def _stress(axis: Axes, made: Made, end: float) -> None:
    """sigma(1, t) = -kappa [(u - g2)_+ - (g1 - u)_+] of the exact motion and of the runs."""
    stops = made.case.problem.one_stops("case")
    for label, style, t, u, _ in _curves(made, end):
        _line(axis, t, stops.force(u), label, style | {"lw": 0.9})
    _horizon(axis, made, end)
    axis.set(xlabel="time $t$", ylabel=r"shear stress $\sigma(1, t)$", xlim=(0.0, end))


def _first_contact(axis: Axes, made: Made) -> None:
    main = next(iter(made.references.values()))
    assert main.system is not None
    start, end = first_contact(main, main.system, made.case.t_end)
    for label, style, t, u, _ in _curves(made, end, start):
        _line(axis, t, u, label, style)
    draw_stops(axis, main.contacts[0].stops, horizontal=True)
    zoom_on_stop(axis, main, start, end)
    _horizon(axis, made, end)
    axis.set(xlabel="time $t$", ylabel="tip displacement $u(1, t)$", xlim=(start, end))


def _stops(axis: Axes, made: Made, horizontal: bool) -> None:
    draw_stops(axis, made.case.problem.one_stops("case"), horizontal)


def _spectrum(axis: Axes, made: Made) -> None:
    """Amplitudes over the multiples of the drive; of the exact motion at the same instants as of the runs."""
    t = np.arange(round(made.case.t_end / made.case.dt) + 1) * made.case.dt
    lines = []
    for form, exact in made.references.items():
        style = _exact_style(form) | {"alpha": 0.45, "lw": 2.0, "zorder": 1}
        label = exact_label(made, form)
        if not made.known(form):
            label, style = f"one realisation, {form}", style | ONE | {"lw": 1.2}
        lines.append((label, style, exact.at(t)[0]))
    for order, (equation, run) in enumerate(made.runs.items()):
        lines.append((f"{equation} {run.label}", _style(equation, order) | {"lw": 0.9}, run.tip))
    top = 0.0
    for label, style, u in lines:
        omega, amplitude = amplitude_spectrum(t, u, made.drive)
        multiple = omega / made.drive
        here = (multiple > 0.0) & (multiple <= MULTIPLES + 0.5)
        _line(axis, multiple[here], amplitude[here], label, style)
        top = max(top, float(np.max(amplitude[here])))
    ticks = range(1, MULTIPLES + 1, 2)
    axis.set_xticks(list(ticks), [f"{k}a" if k > 1 else "a" for k in ticks])
    axis.set(
        xlim=(0.0, MULTIPLES + 0.5), yscale="log", ylim=(top * 1e-4, top * 2.0),
        xlabel=f"angular frequency, a = {made.drive:g}", ylabel="amplitude of $u(1, t)$",
    )  # fmt: skip
