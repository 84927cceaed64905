"""One run drawn by itself: displacement, contact forces, phase portrait and energy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..trajectory.trajectory import Reference, Trajectory
from .comparison import draw_stops
from .panels import new_figure, tip_name, tip_symbol
from .style import COLOURS, look, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def run_figure(run: Trajectory) -> Figure:
    """(a) tip, (b) contact forces, (c) phase portrait, (d) energies where the run has its ledger.

    The whole span of the run; of a reference its horizon is marked. The stops are drawn where they act on the tip.
    """
    units, system = run.units, run.system
    method = run.provenance["method"]
    horizon = run.horizon if isinstance(run, Reference) else np.nan
    note = f" ({units.note})" if units.note else ""
    figure = new_figure(7.6, f"{short(method)}, {run.provenance['form']}{note}")
    tip, force, portrait, energy = figure.subplots(2, 2).ravel()
    beam = system.problem if system else None
    symbol, place = tip_symbol(beam), tip_name(beam)
    time, length = units.label("time $t$", "time"), units.label(f"{place} displacement {symbol}", "length")
    style = {"color": look(method)["color"], "lw": 0.9}
    tip.plot(run.t, run.tip, **style)
    portrait.plot(run.tip, run.tip_velocity, **style)
    for record in run.contacts:
        if np.array_equal(record.position, run.tip):
            draw_stops(tip, record.stops, horizontal=True)
            draw_stops(portrait, record.stops, horizontal=False)
    if np.isfinite(horizon) and horizon < run.t[-1]:
        for axis in (tip, force, energy):
            axis.axvline(horizon, color="0.4", lw=0.9, ls="--")
        tip.annotate("horizon", (horizon, 1.0), xycoords=("data", "axes fraction"), xytext=(3, -26),
                     textcoords="offset points", fontsize=8, color="0.3")  # fmt: skip
    for i, record in enumerate(run.contacts):
        label = f"contact {i + 1}: {record.impacts.count} impacts"
        force.plot(run.t, record.force, lw=0.9, color=COLOURS[i % len(COLOURS)], label=label)
    if run.contacts:
        force.legend(frameon=False, fontsize=8.5)
    else:
        force.text(0.5, 0.5, "no contact", transform=force.transAxes, ha="center", color="0.35")
    tip.set(xlabel=time, ylabel=length)
    force.set(xlabel=time, ylabel=units.label(r"contact force $\sigma$", "force"))
    portrait.set(xlabel=length, ylabel=units.label(f"{place} velocity {symbol.replace('u(', 'u_t(')}", "velocity"))
    energy.set(xlabel=time, ylabel=units.label("energy", "energy"))
    if run.ledger is not None or "energy" in vars(run):
        names = ["kinetic", "elastic", "stops", "input", "loss"]
        names += [name for name in ("viscous", "stop_dissipation") if np.any(getattr(run.energy, name))]
        for name, colour in zip(names, (*COLOURS[:3], "0.35", "black", *COLOURS[3:5]), strict=False):
            line = "--" if name in ("viscous", "stop_dissipation") else "-"
            label = name.replace("stop_dissipation", "taken by stops")
            energy.plot(run.t, getattr(run.energy, name), lw=0.9, ls=line, color=colour, label=label)
        energy.legend(
            frameon=False,
            fontsize=8.5,
            ncols=4 if len(names) > 5 else 5,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.16),
        )
    else:
        energy.text(0.5, 0.5, "not saved with the run", transform=energy.transAxes, ha="center", color="0.35")
    for axis, title in zip(
        (tip, force, portrait, energy), ("displacement", "contact", "phases", "energy"), strict=True
    ):
        axis.set_title(f"({'abcd'[(tip, force, portrait, energy).index(axis)]}) {title}", loc="left")
    return figure


def comparison_figure(run: Trajectory, reference: Reference) -> Figure:
    """A run beside its reference, in the four panels of ``stiffbeam compare``."""
    from .comparison import four_panels

    title = f"{short(run.provenance['method'])} beside {short(reference.provenance['method'])}"
    note = run.units.note
    return four_panels(f"{title} ({note})" if note else title, [run], [reference])
