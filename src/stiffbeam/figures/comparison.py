"""Pictures: the paper's four panels with the reference drawn beside the schemes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..arrays import Array
from ..drive import Drive
from ..measures.spectrum import amplitude_spectrum
from ..trajectory import Reference, Trajectory
from . import look, short


def four_panels(title: str, runs: Sequence[Trajectory], references: Sequence[Reference], length: str = "") -> Figure:
    """(a) tip displacement, (b) phase portrait, (c) zoom on the first contact, (d) amplitude spectrum.

    All of one form: another form is another system. Panels a to c show the time inside the horizon of
    the first reference, where one solution exists to compare with; panel d shows the schemes over their
    whole span. The other references, black and thin, are drawn in a and c only, where they follow the
    first. ``length`` names the unit of displacement, where it has one.
    """
    main = references[0]
    system = main.system
    assert system is not None
    window = min(main.horizon, float(main.t[-1]))
    figure = Figure(figsize=(11.0, 8.2), layout="constrained")
    figure.suptitle(title)
    axes = figure.subplots(2, 2)
    displacement, portrait, zoom, spectrum = axes.ravel()
    fine = np.linspace(0.0, window, 6000)

    def draw(axis, x, y, index, run) -> None:
        name = short(run.provenance["method"])
        if index is None:
            width = 0.9 if axis is portrait else 2.6  # the portrait crosses itself too often for a broad line
            axis.plot(x, y, color="black", lw=width, alpha=0.38, label=name, zorder=1)
        else:
            axis.plot(x, y, lw=1.1, label=name, zorder=2 + index, **line_of(run))

    curves: list[tuple[int | None, Trajectory, Array, Array, Array]] = []
    u, v = main.at(fine) if main.solution is not None else (main.tip, main.tip_velocity)
    curves.append((None, main, fine if main.solution is not None else main.t, u, v))
    schemes = len(runs)
    runs = [*runs, *references[1:]]
    for i, run in enumerate(runs):
        here = run.t <= window
        curves.append((i, run, run.t[here], run.tip[here], run.tip_velocity[here]))

    start, end = first_contact(main, system, window)
    for index, run, t, u, v in curves:
        draw(displacement, t, u, index, run)
        if index is None or index < schemes:
            draw(portrait, u, v, index, run)  # the other solvers follow the reference: left out for clarity
        near = (t >= start) & (t <= end)
        draw(zoom, t[near], u[near], index, run)
    for axis in (displacement, zoom):
        draw_stops(axis, system, horizontal=True)
        axis.set(xlabel="time $t$", ylabel=f"tip displacement $u(1, t)${length}")
    displacement.set_title(f"(a) displacement to the horizon t = {window:.3g}", loc="left")
    draw_stops(portrait, system, horizontal=False)
    portrait.set(xlabel=f"tip displacement $u(1, t)${length}", ylabel="tip velocity $u_t(1, t)$")
    portrait.locator_params(axis="x", nbins=6)
    portrait.set_title("(b) phase portrait to the horizon", loc="left")
    zoom.set_xlim(start, end)
    if system.contacts:
        zoom.set_title("(c) first contact", loc="left")
        zoom_on_stop(zoom, main, system, start, end)
    else:
        zoom.set_title("(c) first oscillations", loc="left")
    _draw_spectra(spectrum, runs, references, Drive.of(system).frequencies)
    handles, labels = displacement.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, handlelength=3.2)
    return figure


def line_of(run: Trajectory) -> dict[str, Any]:
    """Colour and dashes: a scheme's own, black for a solver, which is grey elsewhere, as it lies on the reference."""
    style = look(run.provenance["method"])
    return {"color": "black" if isinstance(run, Reference) else style["color"], "linestyle": style["linestyle"]}


def first_contact(reference: Reference, system, window: float) -> tuple[float, float]:
    """A span around the first group of impacts: an eighth of the lowest natural period."""
    from ..modal import modes

    basis = modes(system)
    omega = basis.omega[basis.omega > 0.0] if basis is not None else np.zeros(0)
    length = min(window, 2.0 * np.pi / float(omega[0]) / 8.0) if len(omega) else window / 8.0
    times = reference.impacts.times
    first = float(times[0]) if len(times) and times[0] < window else 0.1 * length
    return max(0.0, first - 0.1 * length), min(window, first + 0.9 * length)


def zoom_on_stop(axis, reference: Reference, system, start: float, end: float) -> None:
    """Scale the zoom to what happens at the stop that is hit."""
    stops = system.contacts[0].stops
    if not reference.impacts.count:
        return
    side = int(reference.impacts.stops[0])
    stop = stops.g2 if side > 0 else stops.g1
    t = reference.t[(reference.t >= start) & (reference.t <= end)]
    u, _ = reference.at(np.linspace(start, end, 800) if reference.solution is not None else t)
    outside = float(np.max(side * (u - stop)))
    drop = float(np.max(side * (stop - u[len(u) // 10 :])))
    reach = max(2.0 * outside, min(drop, 12.0 * outside), 1e-12)
    low, high = sorted((stop - side * reach, stop + side * 2.5 * outside))
    axis.set_ylim(low, high)


def draw_stops(axis, system, horizontal: bool) -> None:
    for contact in system.contacts[:1]:
        for stop in (contact.stops.g1, contact.stops.g2):
            if np.isfinite(stop):
                line = axis.axhline if horizontal else axis.axvline
                line(stop, color="0.45", lw=0.9, ls=":", zorder=0)


def _draw_spectra(axis, runs, references, frequencies) -> None:
    drive = max(frequencies, default=0.0)
    whole = np.inf
    for i, run in enumerate(runs):
        if isinstance(run, Reference):
            continue  # ends at the horizon
        omega, amplitude = amplitude_spectrum(run.t, run.tip, drive)
        axis.plot(omega, amplitude, lw=0.9, label=short(run.provenance["method"]), zorder=2 + i, **line_of(run))
        whole = min(whole, float(run.t[-1]))
    if runs and references:
        t = runs[0].t
        if references[0].solution is not None and float(references[0].provenance["t_end"]) >= t[-1] * (1 - 1e-9):
            omega, amplitude = amplitude_spectrum(t, references[0].at(t)[0], drive)
            axis.plot(omega, amplitude, color="black", lw=2.2, alpha=0.38, zorder=1)
    if drive:
        axis.set_xlim(0.0, 15.5 * drive)
        axis.set_xticks([k * drive for k in (1, 3, 5, 7, 9, 11, 13, 15)])
        axis.set_xticklabels([f"{k}a" if k > 1 else "a" for k in (1, 3, 5, 7, 9, 11, 13, 15)])
        axis.set_xlabel(f"angular frequency, in multiples of the drive a = {drive:g}")
    else:
        axis.set_xlabel("angular frequency")
    visible = [line.get_ydata()[line.get_xdata() <= axis.get_xlim()[1]] for line in axis.get_lines()]
    top = max((float(np.max(y)) for y in visible), default=0.0)
    if top > 0.0:  # a beam that stays at rest has no logarithm
        axis.set_yscale("log")
        axis.set_ylim(top * 1e-4, top * 2.0)
    axis.set_ylabel("amplitude of $u(1, t)$")
    title = f"(d) spectrum to t = {whole:g}, one realisation each" if np.isfinite(whole) else "(d) spectrum"
    axis.set_title(title, loc="left")
