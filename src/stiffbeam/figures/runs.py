"""Pictures of runs: one run, and several beside their reference. The exact motion is black."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.text import Units, several, with_unit
from ..measures.comparison import Comparison, contact_name
from ..measures.report import largest, verdict
from ..model.contact import Stops
from ..model.scales import scales
from ..model.system import System
from ..trajectory.records import ContactRecord
from ..trajectory.trajectory import Reference, Trajectory
from .chart import COLOURS, Axes, Figure, finish, look, new_figure, say_empty, shared_legend, short, tip_text


def comparison_figure(results: Sequence[Comparison], title: str = "") -> Figure:
    """Displacement, error, close-up of the first impacts and contact force of runs beside one reference.

    Each contact that is touched has a close-up, see ``shown_contacts``; the force is that of the contact with the
    largest one. All show the time inside the horizon of the reference. Other solvers are thin and lie beneath the
    schemes. The error is the largest |u - u_ref|/max |u_ref| so far, with a dot where the impacts cease to match.
    title: by default it states how far the runs agree.
    """
    runs, main = [c.pair[0] for c in results], results[0].pair[1]
    names = ", ".join(short(run.provenance["method"]) for run in runs)
    title = title or f"{names} against {short(main.provenance['method'])}: {verdict(results)}"
    system = main.system
    assert system is not None
    window, contacts = min(main.horizon, float(main.t[-1])), shown_contacts([main, *runs])
    count = 2 + len(contacts) + bool(contacts)
    lines = (count + 1) // 2
    figure = new_figure(4.1 * lines)
    grid = figure.add_gridspec(lines, 2)

    def panel(name: str) -> Axes:
        k = len(figure.axes)
        axis = figure.add_subplot(grid[k // 2, :] if k == count - 1 and k % 2 == 0 else grid[k // 2, k % 2])
        axis.set(title=name, xlabel=with_unit(system.units, "time $t$", "time"))
        return axis

    _draw_positions(panel(f"displacement to t = {window:.3g}"), main, runs, 0.0, window)
    _draw_errors(panel("error"), results, window)
    for i in contacts:
        axis, (start, end) = panel(f"first impact at {contact_name(system, i)}"), first_contact(main, system, window, i)
        _draw_positions(axis, main, runs, start, end, i)
        zoom_on_stop(axis, main.contacts[i])
    if contacts:
        hardest = max(contacts, key=lambda i: np.nan_to_num(main.contacts[i].peak_force))
        _draw_forces(panel(f"force of {contact_name(system, hardest)} to the horizon"), main, runs, window, hardest)
    shared_legend(figure)
    finish(figure, title)
    return figure


def _draw_positions(
    axis: Axes, main: Reference, runs: Sequence[Trajectory], start: float, end: float, contact: int | None = None
) -> None:
    """The observed displacement, or the position at a contact, between its stops."""
    system = main.system
    assert system is not None
    for run, t, (u, _) in _curves(main, runs, end, contact, start):
        axis.plot(t, u, **_style(run, main))
    for i, each in enumerate(system.contacts):
        if i == contact or (contact is None and system.reads_tip(i)):
            draw_stops(axis, each.stops, horizontal=True)
    label = tip_label(system) if contact is None else position_label(system, contact)
    axis.set(xlim=(start, end), ylabel=label)


def _draw_forces(axis: Axes, main: Reference, runs: Sequence[Trajectory], window: float, contact: int) -> None:
    """The force of a contact over time; of a rigid stop the impulse of every impact."""
    stops = main.contacts[contact].stops
    for run, t, (u, v) in _curves(main, runs, window, contact):
        if stops.rigid:
            impacts = run.contacts[contact].impacts.until(window)
            dots = _style(run, main, linestyle="", marker="o", markersize=5.0 if run is main else 3.0)
            axis.plot(impacts.times, np.abs(impacts.impulses), **dots)
        else:
            axis.plot(t, stops.force(u, v), **_style(run, main))
    name = ("impulse", "impulse") if stops.rigid else (r"contact force $\sigma$", "force")
    axis.set(xlim=(0.0, window), ylabel=with_unit(main.units, *name))


def shown_contacts(runs: Sequence[Trajectory]) -> list[int]:
    """Numbers of the contacts that a picture shows: the first six that a run touches."""
    records = [i for run in runs for i, x in enumerate(run.contacts) if x.impacts.count or x.fraction]
    return sorted(set(records))[:6]


def tip_label(system: System | None, units: Units | None = None) -> str:
    """Label of the displacement of the tip, with its unit: of the system, if not passed."""
    beam, units = system and system.problem, units or (system and system.units) or ()
    return with_unit(units, tip_text(beam, "displacement"), "length")


def position_label(system: System, contact: int) -> str:
    """Label of the position at a contact, with its unit."""
    if system.reads_tip(contact):
        return tip_label(system)
    return with_unit(system.units, f"position between the stops of {contact_name(system, contact)}", "length")


def _curves(
    main: Reference, runs: Sequence[Trajectory], end: float, contact: int | None = None, start: float = 0.0
) -> Iterator[tuple[Trajectory, Array, tuple[Array, Array]]]:
    """(run, t, (u, u')) of the reference and of the runs, at the tip or a contact, from ``start`` to ``end``."""
    # An exact solution has values between its outputs too.
    if main.solution is not None:
        fine = np.linspace(start, end, 6000)
        yield main, fine, main.at(fine, contact)
    for run in runs if main.solution is not None else (main, *runs):
        here = (run.t >= start) & (run.t <= end)
        record = None if contact is None else run.contacts[contact]
        motion = (run.tip, run.tip_velocity) if record is None else (record.position, record.velocity)
        yield run, run.t[here], (motion[0][here], motion[1][here])


def _style(run: Trajectory, main: Reference, **other: Any) -> dict[str, Any]:
    """Line of a run: the reference broad and pale below the others, other solvers thin below the schemes."""
    label = {"label": short(run.provenance["method"])}
    if run is main:
        return label | {"color": "black", "lw": 2.6, "alpha": 0.38, "zorder": 1} | other
    drawn = {"lw": 0.7, "zorder": 2} if isinstance(run, Reference) else {"lw": 1.2, "zorder": 3}
    return label | line_of(run) | drawn | other


def _draw_errors(axis: Axes, comparisons: Sequence[Comparison], window: float) -> None:
    """The largest error so far of every run, on a logarithmic axis, and a dot where its impacts cease to match."""
    for c in comparisons:
        run, main = c.pair
        error = np.maximum.accumulate(np.abs(c.error))
        axis.plot(c.times[error > 0.0], error[error > 0.0], **_style(run, main))
        if c.matched_until < c.window:
            value = error[max(0, np.searchsorted(c.times, c.matched_until, side="right") - 1)]
            axis.plot(c.matched_until, value, "o", ms=5.0, mfc="white", color=line_of(run)["color"], zorder=30)
    axis.set(yscale="log", xlim=(0.0, window), ylabel="largest error so far / max |u|")
    low, high = axis.get_ylim()
    axis.set_ylim(max(low, 1e-12), min(10.0, high))
    if any(c.matched_until < c.window for c in comparisons):
        (dot,) = axis.plot([], [], "o", ms=5.0, mfc="white", color="black")
        axis.legend([dot], ["impacts differ"], frameon=False, fontsize=8.5, loc="lower right")


def line_of(run: Trajectory) -> dict[str, Any]:
    """Colour and dashes of a method, the same in every picture."""
    return {name: look(run.provenance["method"])[name] for name in ("color", "linestyle")}


def first_contact(reference: Trajectory, system: System, window: float, contact: int = 0) -> tuple[float, float]:
    """A span around the first impact of a contact, three times as long, or of a hundredth of the longest time scale."""
    impacts = reference.contacts[contact].impacts if reference.contacts else reference.impacts
    length = 0.01 * scales(system).period
    if impacts.count and impacts.durations[0] > 0.0:
        length = min(8.0 * length, float(impacts.durations[0]))
    first = float(impacts.times[0]) if impacts.count else length
    return max(0.0, first - length), min(window, first + 2.0 * length)


def zoom_on_stop(axis: Axes, record: ContactRecord) -> None:
    """Scale the zoom to the depth of what is drawn in the stop that is hit first; nothing is inside a rigid one."""
    if not record.impacts.count or record.stops.rigid:
        return
    side, (low, high) = int(record.impacts.stops[0]), axis.dataLim.intervaly
    stop = record.stops.sides[side]
    depth = side * ((high if side > 0 else low) - stop)
    if depth > 0.0:
        axis.set_ylim(*sorted((stop - 4.0 * side * depth, stop + 2.0 * side * depth)))


def draw_stops(axis: Axes, stops: Stops, horizontal: bool) -> None:
    """Dotted lines at the stops."""
    for stop in stops.sides.values():
        line = axis.axhline if horizontal else axis.axvline
        line(stop, color="0.45", lw=0.9, ls=":", zorder=0.9)  # above the grid


def run_figure(run: Trajectory) -> Figure:
    """(a) tip, (b) contact forces, (c) phase portrait, (d) energies where the run has its ledger.

    The whole span of the run; of a reference its horizon is marked. The stops are drawn where they act on the tip.
    """
    units, beam, colour = run.units, run.system.problem if run.system else None, line_of(run)["color"]
    figure = new_figure(7.6)
    tip, force, portrait, energy = figure.subplots(2, 2).ravel()
    for axis, title in ((tip, "displacement"), (force, "contact"), (energy, "energy")):
        axis.set(title=title, xlabel=with_unit(units, "time $t$", "time"))
        if isinstance(run, Reference) and run.horizon < run.t[-1]:
            axis.axvline(run.horizon, color="0.4", lw=0.9, ls="--")
    tip.plot(run.t, run.tip, color=colour, lw=0.9)
    tip.set_ylabel(tip_label(run.system, units))
    portrait.plot(run.tip, run.tip_velocity, color=colour, lw=0.9)
    velocity = tip_text(beam, "velocity").replace("u(", "u_t(")
    portrait.set(title="phases", xlabel=tip_label(run.system, units), ylabel=with_unit(units, velocity, "velocity"))
    for record in run.contacts:
        if np.array_equal(record.position, run.tip):
            draw_stops(tip, record.stops, horizontal=True)
            draw_stops(portrait, record.stops, horizontal=False)
    shown = shown_contacts([run])
    for colour, i in zip(COLOURS, shown, strict=False):
        label = f"contact {i}: {several(run.contacts[i].impacts.count, 'impact')}"
        force.plot(run.t, run.contacts[i].force, lw=0.9, color=colour, label=label)
    if shown:
        force.legend(frameon=False, fontsize=8.5)
    else:
        say_empty(force, "no contact")
    label = r"contact force $\sigma$"
    if any(record.stops.rigid for record in run.contacts):
        label += ", without impulses" if isinstance(run, Reference) else ", mean per step"
    force.set_ylabel(with_unit(units, label, "force"))
    energy.set_ylabel(with_unit(units, "energy", "energy"))
    if run.has_energy:
        _draw_energies(energy, run)
    else:
        say_empty(energy, "not saved with the run")
    finish(figure, f"{short(run.provenance['method'])}, {run.provenance['form']}: {largest(run)}")
    return figure


def _draw_energies(axis: Axes, run: Trajectory) -> None:
    """The energies of a run, and the work that is not zero."""
    names = ["kinetic", "elastic", "stops", "input", "loss"]
    names += [name for name in ("viscous", "stop_dissipation") if np.any(getattr(run.energy, name))]
    for name, colour in zip(names, (*COLOURS[:3], "0.35", "black", *COLOURS[3:5]), strict=False):
        label = name.replace("stop_dissipation", "taken by stops")
        line = "--" if name in ("viscous", "stop_dissipation") else "-"
        axis.plot(run.t, getattr(run.energy, name), lw=0.9, ls=line, color=colour, label=label)
    axis.legend(frameon=False, fontsize=8.5, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.16))
