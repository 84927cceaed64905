"""The paper's figures: its four panels, one picture each, with the true solution and the horizon drawn in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..arrays import Array
from ..measures.peaks import MULTIPLES
from ..measures.spectrum import amplitude_spectrum
from ..reproduce.table import Made
from ..trajectory import Reference, Trajectory
from . import COLOURS, DASHES
from .comparison import draw_stops, first_contact, zoom_on_stop

TRUTH = {"displacement": ("black", ()), "velocity-curvature": ("0.35", (4, 1.5))}
STYLE = {  # one look per scheme and discretisation, the same in every figure
    "(4.13)": (COLOURS[0], DASHES[0]),
    "(4.5)": (COLOURS[1], DASHES[1]),
    "(4.11)": (COLOURS[2], DASHES[2]),
    "(4.14)": (COLOURS[3], DASHES[3]),
    "(4.10)": (COLOURS[4], DASHES[4]),
    "(4.12)": (COLOURS[5], DASHES[5]),
}
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
        found.append(Panel("c", "the first contact", lambda axis: _first_contact(axis, made)))
    found.append(Panel("d", f"spectrum of the tip to t = {made.case.t_end:g}", lambda axis: _spectrum(axis, made)))
    return found


def picture(panel: Panel) -> Figure:
    """One panel as a picture of its own, of a size that a phone shows without shrinking."""
    figure = Figure(figsize=(5.0, 3.5), layout="constrained")
    axis = figure.subplots()
    panel.draw(axis)
    axis.set_title(f"({panel.letter}) {panel.title}", loc="left", fontsize=10)
    return figure


def save_small(figure: Figure, file: Path) -> Path:
    """PNG with a palette: a quarter of the size, and seventy of them go into one page."""
    from PIL import Image

    file.parent.mkdir(parents=True, exist_ok=True)
    content = BytesIO()
    figure.savefig(content, format="png", dpi=DPI)
    Image.open(content).convert("RGB").quantize(PALETTE).save(file, optimize=True)
    return file


def together(made: Made) -> Figure:
    """All panels in one picture with a legend, for a page of print."""
    parts = panels(made)
    rows = (len(parts) + 1) // 2
    figure = Figure(figsize=(10.5, 3.7 * rows + 0.5), layout="constrained")
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


def _curves(made: Made, end: float, start: float = 0.0):
    """(label, style, t, u, v) of the true motions, then of the runs, over [start, end]."""
    fine = np.linspace(start, end, 8000)
    for form, truth in made.references.items():
        colour, dashes = TRUTH[form]
        style = {"color": colour, "dashes": dashes or (None, None), "alpha": 0.5, "lw": 1.6, "zorder": 1}
        yield f"true, {form}", style, fine, *truth.at(fine)
    for order, (equation, run) in enumerate(made.runs.items()):
        here = (run.t >= start) & (run.t <= end)
        yield f"{equation} {run.label}", _style(equation, order), run.t[here], run.tip[here], run.tip_velocity[here]


def _style(equation: str, order: int) -> dict:
    colour, dashes = STYLE[equation]
    return {"color": colour, "dashes": dashes or (None, None), "lw": 1.0, "zorder": 2 + order}


def _line(axis: Axes, x: Array, y: Array, label: str, style: dict) -> None:
    axis.plot(x, y, label=label, **style)


def _displacement(axis: Axes, made: Made, end: float) -> None:
    for label, style, t, u, _ in _curves(made, end):
        _line(axis, t, u, label, style | {"lw": 0.8})  # thin: the true motion is fast
    _stops(axis, made, horizontal=True)
    _horizon(axis, made, end)
    axis.set(xlabel="time $t$", ylabel="tip displacement $u(1, t)$", xlim=(0.0, end))


def _horizon(axis: Axes, made: Made, end: float) -> None:
    """Past the earliest horizon a float64 computation has lost the true motion."""
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
        thin = style | {"lw": 0.5, "dashes": (None, None), "alpha": 0.3 if style["zorder"] == 1 else 0.85}
        _line(axis, u, v, label, thin)
    _stops(axis, made, horizontal=False)
    axis.set(xlabel="tip displacement $u(1, t)$", ylabel="tip velocity $u_t(1, t)$")
    axis.locator_params(axis="x", nbins=6)


def _delayed(axis: Axes, made: Made) -> None:
    """(u(1, t), u(1, t + T)): on the diagonal for a motion of period T. Every twentieth step, as points."""
    period, end = 2.0 * np.pi / made.drive, made.case.t_end
    t = np.arange(0.0, end - period, 20.0 * made.case.dt)
    motions: list[tuple[str, dict, Callable]] = []
    for form, truth in made.references.items():
        motions.append((f"true, {form}", {"color": "black", "alpha": 0.35, "zorder": 1}, _tip_of(truth)))
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
    """sigma(1, t) = -kappa [(u - g2)_+ - (g1 - u)_+] of the true motion and of the runs."""
    stops = made.case.problem.stops
    assert stops is not None
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
    draw_stops(axis, main.system, horizontal=True)
    zoom_on_stop(axis, main, main.system, start, end)
    _horizon(axis, made, end)
    axis.set(xlabel="time $t$", ylabel="tip displacement $u(1, t)$", xlim=(start, end))


def _stops(axis: Axes, made: Made, horizontal: bool) -> None:
    draw_stops(axis, next(iter(made.systems.values())), horizontal)


def _spectrum(axis: Axes, made: Made) -> None:
    """Amplitudes over the multiples of the drive; of the truth at the same instants as of the runs."""
    t = np.arange(round(made.case.t_end / made.case.dt) + 1) * made.case.dt
    lines = []
    for form, truth in made.references.items():
        colour, dashes = TRUTH[form]
        style = {"color": colour, "dashes": dashes or (None, None), "alpha": 0.45, "lw": 2.0, "zorder": 1}
        lines.append((f"true, {form}", style, truth.at(t)[0]))
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
