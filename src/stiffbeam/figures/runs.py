"""Pictures of results: of runs beside their reference, and one for each kind of result.

A function ``plot_...`` draws into ``ax``, the axes of the caller, and returns them, or returns the new figure, which a
notebook shows. It takes arguments of ``Axes.plot``. The exact motion is black, a method has its look of every picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.text import several
from ..basics.units import Units, with_unit
from ..basics.validation import InputError, integer
from ..measures.comparison import Comparison, compare
from ..measures.frequencies import amplitude_spectrum, drive_frequency
from ..measures.report import largest, verdict
from ..model.contact import Stops
from ..model.natural_modes import modes
from ..model.scales import scales
from ..model.system import System
from ..trajectory.ensemble import Ensemble
from ..trajectory.records import Impacts
from ..trajectory.trajectory import Reference, Trajectory
from .chart import COLOURS, axes_for, look, new_figure, panel_legend, say_empty, short, tip_name, tip_symbol

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OMEGA = r"angular frequency $\omega$"
TICKS = 6  # of an axis of times: more would run into each other
CONTENT = 0.999  # of the power of a curve, where an axis of frequencies without a drive ends


def comparison_panels(
    title: str,
    runs: Sequence[Trajectory],
    references: Sequence[Reference],
    comparisons: Sequence[Comparison] | None = None,
) -> Figure:
    """Displacement, error, close-up of the first impacts, contact force and amplitude spectrum of runs of one system.

    Each contact that is touched has a close-up, see ``shown_contacts``; the force is that of the contact with the
    largest one. All but the spectrum show the time inside the horizon of the first reference; the spectrum shows the
    schemes over their whole span. The other references are thin and lie beneath the schemes. The error is the largest
    |u - u_ref|/max |u_ref| so far, with a dot where the impacts cease to match and a vertical line at a solver's own
    horizon; ``comparisons`` of the runs and the other references with the first, made if None.
    """
    main, runs = references[0], [*runs, *references[1:]]
    system = main.system
    assert system is not None
    window, contacts = min(main.horizon, float(main.t[-1])), shown_contacts([*references, *runs])
    hardest = max(contacts, key=lambda i: np.nan_to_num(main.contacts[i].peak_force), default=None)
    error = f"error{'; lines: horizons' * any(x.horizon < window for x in references[1:])}"
    panels: list[tuple[str, Callable[[Axes], None]]] = [
        (f"displacement to the horizon t = {window:.3g}", lambda axis: _motion(axis, main, runs, window)),
        (error, lambda axis: _draw_errors(axis, main, runs, comparisons, window)),
    ]
    for i in contacts or [None]:
        name = "first oscillations" if i is None else f"first impact at {contact_name(system, i)}"
        panels.append((name, partial(_zoom, main=main, runs=runs, window=window, contact=i)))
    if hardest is not None:
        name = f"force of {contact_name(system, hardest)} to the horizon"
        panels.append((name, partial(_forces, main=main, runs=runs, window=window, contact=hardest)))
    whole = min((float(run.t[-1]) for run in runs if not isinstance(run, Reference)), default=np.inf)
    span = f" to t = {whole:g}, one realisation each" if np.isfinite(whole) else ""
    panels.append((f"spectrum{span}", lambda axis: _draw_spectra(axis, runs, references, system)))
    lines = -(-len(panels) // 2)
    figure = new_figure(4.1 * lines, title)
    grid = figure.add_gridspec(lines, 2)
    for k, (name, draw) in enumerate(panels):
        last = k == len(panels) - 1
        axis = figure.add_subplot(grid[k // 2, :] if last and k % 2 == 0 else grid[k // 2, k % 2])
        if not last:
            axis.set_xlabel(with_unit(system.units, "time $t$", "time"))
            axis.locator_params(axis="x", nbins=TICKS)
        draw(axis)
        axis.set_title(f"({ascii_lowercase[k]}) {name}", loc="left")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, handlelength=3.2)
    return figure


def contact_name(system: System, i: int) -> str:
    """A contact with its place along the beam or, if it acts on one unknown, the row of that."""
    number = f"contact {i + 1}" if len(system.contacts) > 1 else "the contact"
    if system.problem is not None:
        return f"{number}, x = {float(system.problem.place(system.problem.all_stops[i])):g}"
    rows = np.flatnonzero(system.contacts[i].row)
    return f"{number}, row {rows[0] + 1}" if len(rows) == 1 and system.size > 1 else number


def _motion(axis: Axes, main: Reference, runs: Sequence[Trajectory], window: float) -> None:
    """The observed displacement between its stops."""
    system = main.system
    assert system is not None
    for index, run, t, (u, _) in _curves(main, runs, window):
        _draw(axis, t, u, index, run)
    for i, contact in enumerate(system.contacts):
        if system.reads_tip(i):
            draw_stops(axis, contact.stops, horizontal=True)
    axis.set(ylabel=tip_label(system), xlim=(0.0, window))


def _forces(axis: Axes, main: Reference, runs: Sequence[Trajectory], window: float, contact: int) -> None:
    """The force of a contact over time; of a rigid stop the impulse of every impact."""
    stops = main.contacts[contact].stops
    for index, run, t, (u, v) in _curves(main, runs, window, contact):
        if not stops.rigid:
            _draw(axis, t, stops.force(u, v), index, run)
        else:
            impacts = run.contacts[contact].impacts.until(window)
            _draw(axis, impacts.times, np.abs(impacts.impulses), index, run)
            axis.lines[-1].set(linestyle="", marker="o", markersize=5.0 if index is None else 3.0)
    name = ("impulse", "impulse") if stops.rigid else (r"contact force $\sigma$", "force")
    axis.set(xlim=(0.0, window), ylabel=with_unit(main.units, *name))


def shown_contacts(runs: Sequence[Trajectory]) -> list[int]:
    """Numbers of the contacts that a picture shows: the first six that a run touches."""
    records = [i for run in runs for i, x in enumerate(run.contacts) if x.impacts.count or x.fraction]
    return sorted(set(records))[:6]


def tip_label(system: System | None, units: Units | None = None) -> str:
    """Label of the displacement of the tip, with its unit: of the system, if not passed."""
    beam, units = system and system.problem, units or (system and system.units) or ()
    return with_unit(units, f"{tip_name(beam)} displacement {tip_symbol(beam)}".strip(), "length")


def position_label(system: System, contact: int) -> str:
    """Label of the position at a contact, with its unit."""
    if system.reads_tip(contact):
        return tip_label(system)
    moving = system.problem is not None and system.problem.all_stops[contact].motion is not None
    name = f"{'displacement relative to the moving stop' if moving else 'position'} at {contact_name(system, contact)}"
    return with_unit(system.units, name, "length")


def _curves(
    main: Reference, runs: Sequence[Trajectory], end: float, contact: int | None = None, start: float = 0.0
) -> Iterator[tuple[int | None, Trajectory, Array, tuple[Array, Array]]]:
    """(index, run, t, (u, u')) of the reference, whose index is None, and of the runs, at the tip or a contact, from
    ``start`` to ``end``."""
    # An exact solution has values between its outputs too.
    if main.solution is not None:
        fine = np.linspace(start, end, 6000)
        yield None, main, fine, main.at(fine, contact)
    else:
        yield None, main, main.t, _path(main, contact)
    for i, run in enumerate(runs):
        here = (run.t >= start) & (run.t <= end)
        u, v = _path(run, contact)
        yield i, run, run.t[here], (u[here], v[here])


def _path(run: Trajectory, contact: int | None) -> tuple[Array, Array]:
    """Position and velocity at the output times, at the tip or a contact."""
    if contact is None:
        return run.tip, run.tip_velocity
    return run.contacts[contact].position, run.contacts[contact].velocity


def _draw(axis: Axes, x: Array, y: Array, index: int | None, run: Trajectory) -> None:
    """A run's curve; the reference (index None) broad and pale below the others, other solvers thin below schemes."""
    name = short(run.provenance["method"])
    if index is None:
        axis.plot(x, y, color="black", lw=2.6, alpha=0.38, label=name, zorder=1)
    elif isinstance(run, Reference):
        axis.plot(x, y, lw=0.7, label=name, zorder=2, **line_of(run))
    else:
        axis.plot(x, y, lw=1.2, label=name, zorder=3 + index, **line_of(run))


def _draw_errors(
    axis: Axes, main: Reference, runs: Sequence[Trajectory], comparisons: Sequence[Comparison] | None, window: float
) -> None:
    """The largest error so far of every run, on a logarithmic axis."""
    by_label = {c.label: c for c in ([compare(x, main) for x in runs] if comparisons is None else comparisons)}
    for index, run in enumerate(runs):
        if run.label not in by_label:
            continue
        t, error, parted = _largest_so_far(by_label[run.label])
        _draw(axis, t, error, index, run)
        axis.plot(*parted, "o", ms=5.0, mfc="white", color=line_of(run)["color"], zorder=30)
        if isinstance(run, Reference) and run.horizon < window:
            axis.axvline(run.horizon, lw=0.6, zorder=0, **line_of(run))
    axis.set(yscale="log", xlim=(0.0, window))
    low, high = axis.get_ylim()
    axis.set_ylim(max(low, 1e-12), min(10.0, high))
    axis.set_ylabel(f"largest error so far / max |{tip_symbol(main.system and main.system.problem)}|")
    if any(x.matched_until < x.window for x in by_label.values()):
        (dot,) = axis.plot([], [], "o", ms=5.0, mfc="white", color="black")
        axis.legend([dot], ["impacts differ"], frameon=False, fontsize=8.5, loc="lower right")


def _largest_so_far(comparison: Comparison) -> tuple[Array, Array, tuple[list[float], list[float]]]:
    """Times and the largest error so far, where it is not 0, and the point at which the impacts cease to match."""
    t, error = comparison.times, np.maximum.accumulate(np.abs(comparison.error))
    seen, until = error > 0.0, comparison.matched_until
    if not until < comparison.window or not np.any(seen):
        return t[seen], error[seen], ([], [])
    return t[seen], error[seen], ([until], [error[max(0, np.searchsorted(t, until, side="right") - 1)]])


def _zoom(axis: Axes, main: Reference, runs: Sequence[Trajectory], window: float, contact: int | None) -> None:
    """The first impacts at a contact, or the first oscillations of the tip."""
    assert main.system is not None
    system = main.system
    axis.set_ylabel(tip_label(system) if contact is None else position_label(system, contact))
    start, end = first_contact(main, system, window, contact or 0)
    for index, run, t, (u, _) in _curves(main, runs, end, contact, start):
        _draw(axis, t, u, index, run)
    axis.set_xlim(start, end)
    if contact is not None:
        draw_stops(axis, main.system.contacts[contact].stops, horizontal=True)
        zoom_on_stop(axis, main, start, end, contact)


def line_of(run: Trajectory) -> dict[str, Any]:
    """Colour and dashes of a method, the same in every picture."""
    return {name: look(run.provenance["method"])[name] for name in ("color", "linestyle")}


def first_contact(reference: Trajectory, system: System, window: float, contact: int = 0) -> tuple[float, float]:
    """A span around the first group of impacts on one stop of a contact: an eighth of the longest time scale, less
    where the group is shorter."""
    length = min(window, scales(system).period / 8.0)
    times = reference.contacts[contact].impacts.times if reference.contacts else np.zeros(0)
    first = float(times[0]) if len(times) and times[0] < window else 0.1 * length
    start, end = max(0.0, first - 0.1 * length), min(window, first + 0.9 * length)
    if not len(times):
        return start, end
    impacts = reference.contacts[contact].impacts
    # The group ends with the last exit from the stop that is hit first.
    exits = (times + np.nan_to_num(impacts.durations))[(impacts.stops == impacts.stops[0]) & (times <= end)]
    last = float(np.max(exits, initial=first))
    return start, min(end, last + 0.3 * (last - first) + 0.1 * length)


def zoom_on_stop(axis: Axes, reference: Trajectory, start: float, end: float, contact: int = 0) -> None:
    """Scale the zoom to what happens at the stop of a contact that is hit first."""
    record = reference.contacts[contact]
    if not record.impacts.count:
        return
    side = int(record.impacts.stops[0])
    stop = record.stops.bound(side)
    if isinstance(reference, Reference) and reference.solution is not None:
        u, _ = reference.at(np.linspace(start, end, 800), contact)
    else:
        u = record.position[(reference.t >= start) & (reference.t <= end)]
    # The largest depth of the contact point in the stop, and its largest distance from it after a tenth of the span.
    outside = float(np.max(side * (u - stop)))
    drop = float(np.max(side * (stop - u[len(u) // 10 :])))
    # Nothing is inside a rigid stop: the zoom then shows all that is before it.
    room = 0.1 * drop if record.stops.rigid else 2.5 * outside
    reach = drop if record.stops.rigid else max(2.0 * outside, min(drop, 12.0 * outside))
    low, high = sorted((stop - side * max(reach, 1e-12 * float(np.max(np.abs(u)))), stop + side * room))
    axis.set_ylim(low, high)


def draw_stops(axis: Axes, stops: Stops, horizontal: bool) -> None:
    """Dotted lines at the stops."""
    for stop in (stops.lower_bound, stops.upper_bound):
        if np.isfinite(stop):
            line = axis.axhline if horizontal else axis.axvline
            line(stop, color="0.45", lw=0.9, ls=":", zorder=0)


def _draw_spectra(axis: Axes, runs: Sequence[Trajectory], references: Sequence[Reference], system: System) -> None:
    """The amplitudes of the schemes, and of the exact motion where it has their span."""
    drive, units = drive_frequency(system), system.units
    for i, run in enumerate(runs):
        if isinstance(run, Reference):
            continue  # ends at the horizon
        omega, amplitude = amplitude_spectrum(run.t, run.tip, drive, run.tip_velocity)
        label = short(run.provenance["method"])
        axis.plot(omega, amplitude, lw=0.9, label=label, zorder=2 + i, **line_of(run))
    if runs and references:
        t = runs[0].t
        if references[0].solution is not None and float(references[0].provenance["t_end"]) >= t[-1] * (1 - 1e-9):
            u, v = references[0].at(t)
            omega, amplitude = amplitude_spectrum(t, u, drive, v)
            axis.plot(omega, amplitude, color="black", lw=2.2, alpha=0.38, zorder=1)
    axis.set_xlabel(drive_axis(axis, units, drive))
    # The logarithmic axis shows four decades below the largest visible amplitude.
    curves = [(np.asarray(line.get_xdata()), np.asarray(line.get_ydata())) for line in axis.get_lines()]
    visible = [y[x <= axis.get_xlim()[1]] for x, y in curves]
    top = max((float(np.max(y)) for y in visible), default=0.0)
    if top > 0.0:  # a beam that stays at rest has no logarithm
        axis.set_yscale("log")
        axis.set_ylim(top * 1e-4, top * 2.0)
    axis.set_ylabel(with_unit(units, f"amplitude of {tip_symbol(system.problem)}", "length"))


def drive_axis(axis: Axes, units: Units, drive: float) -> str:
    """Label of an axis of frequencies: with ticks at the odd multiples of a drive, else as long as its curves have
    content."""
    if not drive:
        if end := _end_of_content(axis):
            axis.set_xlim(0.0, 1.5 * end)
        return with_unit(units, OMEGA, "frequency")
    odd = range(1, 16, 2)
    axis.set_xlim(0.0, 15.5 * drive)
    axis.set_xticks([k * drive for k in odd], [f"{k}a" if k > 1 else "a" for k in odd])
    return f"{OMEGA}, in multiples of the drive a = {drive:g}"


def _end_of_content(axis: Axes) -> float:
    """The frequency below which CONTENT of the power of every curve lies, without its mean; 0 without a curve."""
    ends = [0.0]
    for line in axis.get_lines():
        across, amplitude = (np.asarray(x, float) for x in (line.get_xdata(), line.get_ydata()))
        power = np.cumsum(np.where(across > 0.0, amplitude**2, 0.0))
        if len(power) and power[-1] > 0.0:
            ends.append(float(across[np.searchsorted(power, CONTENT * power[-1])]))
    return max(ends)


def run_figure(run: Trajectory, **kwargs: Any) -> Figure:
    """(a) tip, (b) contact forces, (c) phase portrait, (d) energies where the run has its ledger.

    The whole span of the run; of a reference its horizon is marked. The stops are drawn where they act on the tip.
    kwargs: of ``Axes.plot``, for the curves of the tip.
    """
    units, beam = run.units, run.system.problem if run.system else None
    method = run.provenance["method"]
    horizon = run.horizon if isinstance(run, Reference) else np.nan
    figure = new_figure(7.6, f"{short(method)}, {run.provenance['form']}: {largest(run)}")
    tip, force, portrait, energy = figure.subplots(2, 2).ravel()
    time, velocity = with_unit(units, "time $t$", "time"), f"velocity {tip_symbol(beam).replace('u(', 'u_t(')}"
    plot_run(run, tip, **kwargs)
    portrait.plot(run.tip, run.tip_velocity, **{"color": look(method)["color"], "lw": 0.9} | kwargs)
    for record in run.contacts:
        if np.array_equal(record.position, run.tip):
            draw_stops(portrait, record.stops, horizontal=False)
    if np.isfinite(horizon) and horizon < run.t[-1]:
        for axis in (force, energy):
            axis.axvline(horizon, color="0.4", lw=0.9, ls="--")
        tip.annotate("horizon", (horizon, 1.0), xycoords=("data", "axes fraction"), xytext=(3, -26),
                     textcoords="offset points", fontsize=8, color="0.3")  # fmt: skip
    shown = shown_contacts([run])
    for colour, record, i in zip(COLOURS, (run.contacts[i] for i in shown), shown, strict=False):
        label = f"contact {i + 1}: {several(record.impacts.count, 'impact')}"
        force.plot(run.t, record.force, lw=0.9, color=colour, label=label)
    if shown:
        force.legend(frameon=False, fontsize=8.5)
    else:
        force.text(0.5, 0.5, "no contact", transform=force.transAxes, ha="center", color="0.35")
    label = r"contact force $\sigma$"
    if any(record.stops.rigid for record in run.contacts):
        label += ", without impulses" if isinstance(run, Reference) else ", mean per step"
    force.set(xlabel=time, ylabel=with_unit(units, label, "force"))
    portrait.set_xlabel(tip_label(run.system, units))
    portrait.set_ylabel(with_unit(units, f"{tip_name(beam)} {velocity}".strip(), "velocity"))
    energy.set(xlabel=time, ylabel=with_unit(units, "energy", "energy"))
    if run.has_energy:
        names = ["kinetic", "elastic", "stops", "input", "loss"]
        names += [name for name in ("viscous", "stop_dissipation") if np.any(getattr(run.energy, name))]
        for name, colour in zip(names, (*COLOURS[:3], "0.35", "black", *COLOURS[3:5]), strict=False):
            line = "--" if name in ("viscous", "stop_dissipation") else "-"
            label = name.replace("stop_dissipation", "taken by stops")
            energy.plot(run.t, getattr(run.energy, name), lw=0.9, ls=line, color=colour, label=label)
        columns = 4 if len(names) > 5 else 5
        energy.legend(frameon=False, fontsize=8.5, ncols=columns, loc="upper center", bbox_to_anchor=(0.5, -0.16))
    else:
        energy.text(0.5, 0.5, "not saved with the run", transform=energy.transAxes, ha="center", color="0.35")
    titles = ("(a) displacement", "(b) contact", "(c) phases", "(d) energy")
    for axis, title in zip((tip, force, portrait, energy), titles, strict=True):
        axis.set_title(title, loc="left")
        axis.locator_params(axis="x", nbins=TICKS)
    return figure


def plot_comparisons(results: Sequence[Comparison]) -> Figure:
    """Runs beside one reference, in the panels of ``stiffbeam compare``; the title says how far they agree.

    Each comparison has its ``pair`` of run and reference.
    """
    pairs = [c.pair for c in results if c.pair is not None]
    if len(pairs) < len(results):
        raise InputError("plot", "a comparison without its runs", "be asked of what compare returned", "compare again")
    runs, reference = [run for run, _ in pairs], pairs[0][1]
    names = ", ".join(short(run.provenance["method"]) for run in runs)
    title = f"{names} against {short(reference.provenance['method'])}: {verdict(results)}"
    return comparison_panels(title, runs, [reference], results)


POINTS = 200  # along a beam


def plot_run(run: Trajectory, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """The tip against time with the stops that act on it; without ``ax`` the panels of ``run_figure``."""
    if ax is None:
        return run_figure(run, **kwargs)
    method, units = run.provenance["method"], run.units
    style: dict[str, Any] = {"color": look(method)["color"], "lw": 0.9, "label": short(method)} | kwargs
    ax.plot(run.t, run.tip, **style)
    for record in run.contacts:
        if np.array_equal(record.position, run.tip):
            draw_stops(ax, record.stops, horizontal=True)
    if isinstance(run, Reference) and run.horizon < run.t[-1]:
        ax.axvline(run.horizon, color="0.4", lw=0.9, ls="--")
    ax.set(xlabel=with_unit(units, "time $t$", "time"), ylabel=tip_label(run.system, units))
    return ax


def plot_system(system: System, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """The start of the motion between the stops: u(x, 0) of a beam, the unknowns of matrices by their numbers."""
    axis, returned = axes_for(ax, repr(system).strip("<>"))
    beam, units = system.problem, system.units
    style: dict[str, Any] = {"color": "black", "lw": 2.0, "label": "start"} | kwargs
    if beam is None:
        numbers = np.arange(1, system.size + 1)
        dots: dict[str, Any] = {"marker": "o", "ls": "-"} | style
        axis.plot(numbers, system.q0, **dots)
        places = [float(numbers[np.argmax(np.abs(contact.row))]) for contact in system.contacts]
        axis.set_xlabel("unknown")
    else:
        x = np.linspace(0.0, beam.length, 201)
        axis.plot(x, system.displacement([0.0], system.q0[None], x)[0], **style)
        places = [float(beam.place(stops)) for stops in beam.all_stops]
        axis.set_xlabel(with_unit(units, "position $x$", "length"))
    for i, (place, contact) in enumerate(zip(places, system.contacts, strict=True)):
        for stop, marker in ((contact.stops.upper, 7), (contact.stops.lower, 6)):  # carets that point at the beam
            if stop is not None and np.isfinite(stop):
                axis.plot([place], [stop], ls="", marker=marker, ms=11, color=COLOURS[1], label="stop")
        if len(places) > 1:
            axis.annotate(str(i + 1), (place, 0.0), xytext=(4, 4), textcoords="offset points", fontsize=8)
    panel_legend(axis)
    axis.set_ylabel(with_unit(units, "displacement", "length"))
    return returned


def plot_impacts(impacts: Impacts, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """Largest force of every impact against its time, of rigid stops the impulse; upper and lower stop by colour."""
    known = bool(np.any(np.isfinite(impacts.peaks)))
    heights, name = (impacts.peaks, "largest force") if known else (impacts.impulses, "impulse")
    seen = heights[np.isfinite(heights)]
    to = f", {name} up to {np.max(seen):.4g}" if len(seen) else ""
    axis, returned = axes_for(ax, f"{several(impacts.count, 'impact')}{to}")
    for side, stop, colour in ((1, "upper stop", COLOURS[0]), (-1, "lower stop", COLOURS[1])):
        of_side = impacts.stops == side
        if np.any(of_side):
            style: dict[str, Any] = {"ls": "", "marker": "o", "ms": 4, "color": colour, "label": stop} | kwargs
            axis.plot(impacts.times[of_side], heights[of_side], **style)
    if not np.any(np.isfinite(heights)):
        say_empty(axis, "no impacts" if not impacts.count else "forces and impulses of the impacts are not known")
    axis.set(xlabel="time of impact", ylabel=name)
    panel_legend(axis)
    return returned


def plot_ensemble(many: Ensemble, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """The tip of every member where it was kept; else what the first contact bears against the varied parameter."""
    axis, returned = axes_for(ax, f"{short(many.provenance['method'])}, {several(len(many), 'member')}")
    units = many.units
    style: dict[str, Any] = {"color": look(many.provenance["method"])["color"]}
    if len(many.t):
        style |= {"lw": 0.7, "alpha": max(0.1, len(many) ** -0.5)} | kwargs
        axis.plot(many.t, many.tip.T, **style)
        axis.set(xlabel=with_unit(units, "time $t$", "time"), ylabel=tip_label(many.members.system, units))
        return returned
    if not many.contacts:
        remedy = "integrate with every=, so that the tip is kept"
        raise InputError("plot", "an ensemble without contacts and outputs", "have something to draw", remedy)
    rigid = not np.any(np.isfinite(many.peak_force))
    values = np.arange(len(many)) if many.values is None else many.values
    bearing = many.impulse if rigid else many.peak_force
    style |= {"ls": "", "marker": "o", "ms": 4} | kwargs
    axis.plot(values, bearing, **style)
    axis.set_xlabel("member" if many.values is None else many.members.parameter)
    axis.set_ylabel(with_unit(units, "impulse", "impulse") if rigid else with_unit(units, "largest force", "force"))
    return returned


def plot_comparison(comparison: Comparison, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """The error of the tip against time, with a dot where the impacts cease to match; without ``ax`` the panels."""
    if ax is None:
        return plot_comparisons([comparison])
    method = comparison.label.partition("@")[0]
    t, error, parted = _largest_so_far(comparison)
    style: dict[str, Any] = {"color": look(method)["color"], "lw": 1.2, "label": short(method)} | kwargs
    ax.plot(t, error, **style)
    ax.plot(*parted, "o", ms=5.0, mfc="white", color=style["color"])
    if len(error):
        ax.set_yscale("log")
    ax.set_xlabel(with_unit(comparison.units, "time $t$", "time"))
    ax.set_ylabel("largest error so far / max |u|")
    return ax


def plot_advice(advice: Any, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """The worst error over the wanted one of every run that was tried, against its cost; the advised run is black."""
    axis, returned = axes_for(ax, f"Runs tried to t = {advice.t_end:g}")
    runs: dict[str, list[Any]] = {}
    for probe in advice.candidates:
        runs.setdefault(probe.label, []).append(probe)

    def worst(probe: Any) -> float:
        return max((probe.errors[name] / advice.want[name] for name in advice.attainable), default=np.nan)

    for label, probes in runs.items():
        probes.sort(key=lambda probe: probe.work)
        style: dict[str, Any] = look(str(probes[0].scheme)) | {"ms": 4, "lw": 1.0, "label": label} | kwargs
        axis.plot([p.work for p in probes], [worst(p) for p in probes], **style)
    axis.axhline(1.0, color="0.4", lw=0.9, ls="--")
    if (advised := advice.recommendation) is not None:
        axis.plot([advised.work], [worst(advised)], "o", ms=10, mfc="none", color="black", label="advised")
    axis.set(xscale="log", yscale="log", xlabel="linear solves", ylabel="worst error / wanted error")
    panel_legend(axis)
    return returned


def mode_shapes(system: System, count: int = 4) -> Figure:
    """Return a figure of the first natural mode shapes: of a beam v(x), of matrices the unknowns in their order.

    A complex shape belongs to damping that couples the modes. It is drawn in two phases a quarter of a period apart:
    the part in phase with its largest entry as a full line, the other dashed.

    Parameters
    ----------
    system : System
    count : int
        Number of shapes; all where the system has fewer.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        For a count that is not positive.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> figure = sb.mode_shapes(sb.paper_case(10).system(), count=3)
    >>> len(figure.axes[0].lines) >= 3
    True
    """
    natural, units = modes(system), system.units
    count = min(integer("count", count, 1), len(natural.omega))
    figure = new_figure(1.6 * count + 0.4, width=7.0)
    beam = system.problem
    axes = np.ravel(figure.subplots(count, 1, sharex=True, squeeze=False))
    places = [float(beam.place(stops)) for stops in beam.all_stops] if beam else []
    for j, axis in enumerate(axes):
        for part, style in ((np.real(natural.shapes[:, j]), "-"), (np.imag(natural.shapes[:, j]), "--")):
            if not np.any(part):
                continue
            if beam is None:
                x, y = np.arange(1, system.size + 1), part
            else:
                x = np.linspace(0.0, beam.length, POINTS)
                still = system.displacement([0.0], np.zeros((1, system.size)), x)  # the base alone
                y = (system.displacement([0.0], part[None], x) - still)[0]
            axis.plot(x, y, style, color=COLOURS[0], marker="" if beam else "o")
        axis.axhline(0.0, color="0.7", lw=0.8)
        for place in places:
            axis.axvline(place, color="0.7", lw=0.8, ls=":")
        ratio = natural.damping_ratio[j]
        damping = f", damping ratio {ratio:.3g}" if np.isfinite(ratio) and ratio else ""
        axis.set_title(f"mode {j + 1}: $\\omega$ = {natural.omega[j]:.5g}{damping}", loc="left", fontsize=9)
        axis.set_yticks([])
    label = "unknown" if beam is None else with_unit(units, "place along the beam $x$", "length")
    axes[-1].set_xlabel(f"{label}; dotted: stops" if places else label)
    return figure
