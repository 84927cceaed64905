"""The panels of the paper's figures: displacement, phase portrait, contact, shear, delayed portrait, spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffbeam.basics.arrays import Array
from stiffbeam.basics.units import with_unit
from stiffbeam.basics.validation import InputError
from stiffbeam.figures.chart import log_scale, tip_name, tip_symbol
from stiffbeam.figures.runs import (
    draw_stops,
    drive_axis,
    first_contact,
    position_label,
    tip_label,
    zoom_on_stop,
)  # fmt: skip
from stiffbeam.measures.frequencies import amplitude_spectrum
from stiffbeam.trajectory.trajectory import Reference, Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from stiffbeam.model.system import System

FINE, DELAYED, MULTIPLES = 8000, 6000, 15


@dataclass(frozen=True)
class Trace:
    """A run with the look of its curves.

    Parameters
    ----------
    run : Trajectory
    label : str
    style : dict
        Keywords of ``Axes.plot``, without the width.
    horizon : float
        The time to which float64 follows the exact motion.
    past : str
        Label of the later part, which is one realisation; "" if the run is exact there too.
    """

    run: Trajectory
    label: str
    style: dict[str, Any]
    horizon: float = np.inf
    past: str = ""

    @property
    def exact(self) -> bool:
        """True for a reference."""
        return isinstance(self.run, Reference)

    @property
    def whole(self) -> str:
        """Label of a curve over the whole span."""
        return self.past if self.past and self.horizon < float(self.run.t[-1]) else self.label

    def at(self, t: Array, contact: int | None = None) -> tuple[Array, Array] | None:
        """Position and velocity of the tip or a contact at any times; None where the run has its output times only."""
        if not isinstance(self.run, Reference):
            return None
        try:
            return self.run.at(t, contact)
        except InputError:
            return None

    def path(self, start: float, end: float, contact: int | None = None) -> tuple[Array, Array, Array]:
        """Times in [start, end], position and velocity of the tip or a contact."""
        fine, run = np.linspace(start, end, FINE), self.run
        found = self.at(fine, contact)
        if found is not None:
            return fine, *found
        record = None if contact is None else run.contacts[contact]
        u, v = (run.tip, run.tip_velocity) if record is None else (record.position, record.velocity)
        inside = (run.t >= start) & (run.t <= end)
        return run.t[inside], u[inside], v[inside]

    def line(self, lw: float) -> dict[str, Any]:
        """Width and order: an exact motion is broad and lies below."""
        return {"lw": 1.8 * lw, "zorder": 1} if self.exact else {"lw": lw, "zorder": 2}

    def draw(self, axis: Axes, t: Array, x: Array, y: Array, lw: float = 0.9, **changes: Any) -> None:
        """Draw y over x, of which the part past the horizon is dotted and grey."""
        style: dict[str, Any] = self.style | self.line(lw) | changes
        late = (t > self.horizon) & bool(self.past)
        for here, label, look in ((~late, self.label, {}), (late, self.past, REALISATION)):
            if np.any(here):
                axis.plot(x[here], y[here], label=label, **style | look)


REALISATION: dict[str, Any] = {"color": "0.55", "linestyle": (0, (1, 1.5)), "alpha": 0.8, "lw": 1.0}


def mark_horizon(axis: Axes, traces: Sequence[Trace], end: float) -> None:
    """Shade the times past the earliest horizon: there float64 has lost the exact motion."""
    horizon = min((trace.horizon for trace in traces), default=np.inf)
    if horizon >= end:
        return
    axis.axvspan(horizon, end, color="0.5", alpha=0.10, lw=0, zorder=0)
    axis.axvline(horizon, color="0.3", lw=0.8, zorder=0)
    axis.annotate(
        f"horizon {horizon:.2g}", (horizon, 0.5), xycoords=("data", "axes fraction"), xytext=(4, 0),
        textcoords="offset points", va="center", fontsize=8, color="0.2", zorder=9,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5},
    )  # fmt: skip


def _tip_stops(axis: Axes, system: System, horizontal: bool) -> None:
    for i, contact in enumerate(system.contacts):
        if system.reads_tip(i):
            draw_stops(axis, contact.stops, horizontal)


def displacement(axis: Axes, traces: Sequence[Trace], system: System, start: float, end: float) -> None:
    """The tip over time, between its stops."""
    for trace in traces:
        t, u, _ = trace.path(start, end)
        trace.draw(axis, t, t, u)
    _tip_stops(axis, system, horizontal=True)
    mark_horizon(axis, traces, end)
    axis.set(xlabel=with_unit(system.units, "time $t$", "time"), ylabel=tip_label(system), xlim=(start, end))


def portrait(axis: Axes, traces: Sequence[Trace], system: System, start: float, end: float) -> None:
    """The velocity of the tip over its displacement."""
    for trace in traces:
        t, u, v = trace.path(start, end)
        trace.draw(axis, t, u, v, 0.4, **{"linestyle": "-", "alpha": 0.3} if trace.exact else {})
    _tip_stops(axis, system, horizontal=False)
    velocity = f"{tip_name(system.problem)} velocity {tip_symbol(system.problem).replace('u(', 'u_t(')}"
    axis.set(xlabel=tip_label(system), ylabel=with_unit(system.units, velocity, "velocity"))


def first_contacts(axis: Axes, traces: Sequence[Trace], system: System, contact: int, end: float) -> None:
    """The first impacts at a contact in close-up."""
    main = traces[0].run
    begin, until = first_contact(main, system, end, contact)
    for trace in traces:
        t, u, _ = trace.path(begin, until, contact)
        trace.draw(axis, t, t, u)
    draw_stops(axis, system.contacts[contact].stops, horizontal=True)
    zoom_on_stop(axis, main, begin, until, contact)
    label = position_label(system, contact)
    axis.set(xlabel=with_unit(system.units, "time $t$", "time"), ylabel=label, xlim=(begin, until))
    mark_horizon(axis, traces, until)


def shear(axis: Axes, traces: Sequence[Trace], system: System, contact: int, start: float, end: float) -> None:
    """The contact force at a stop, in the paper the shear stress, -kappa [(u - g2)_+ - (g1 - u)_+] for a linear one."""
    for trace in traces:
        run = trace.run
        stops = run.contacts[contact].stops
        if stops.rigid:
            inside = (run.t >= start) & (run.t <= end)
            t, force = run.t[inside], run.contacts[contact].force[inside]
        else:
            t, u, v = trace.path(start, end, contact)
            force = stops.force(u, v)
        trace.draw(axis, t, t, force)
    mark_horizon(axis, traces, end)
    sigma = with_unit(system.units, r"contact force $\sigma$", "force")
    axis.set(xlabel=with_unit(system.units, "time $t$", "time"), ylabel=sigma, xlim=(start, end))


def delayed(axis: Axes, traces: Sequence[Trace], system: System, start: float, end: float, delay: float) -> None:
    """u(t + T) over u(t), as points: on the diagonal for a motion of period T."""
    t = np.linspace(start, end, DELAYED)
    for trace in traces:
        now, later = (
            np.interp(x, trace.run.t, trace.run.tip) if (found := trace.at(x)) is None else found[0]
            for x in (t, t + delay)
        )
        look = {name: trace.style[name] for name in ("color", "alpha") if name in trace.style}
        axis.plot(
            now, later, ls="", marker=".", ms=1.6, mew=0.0, label=trace.whole, zorder=1 + (not trace.exact), **look
        )
    for horizontal in (False, True):
        _tip_stops(axis, system, horizontal)
    later_label = with_unit(system.units, tip_symbol(system.problem).replace("t)", "t + T)"), "length")
    axis.set(xlabel=tip_label(system), ylabel=later_label)


def spectrum(axis: Axes, traces: Sequence[Trace], system: System, drive: float) -> None:
    """Amplitudes of the tip; of an exact motion at the instants of the first scheme."""
    sampled = next((trace.run.t for trace in traces if not trace.exact), None)
    top = 0.0
    for trace in traces:
        t, u, v = trace.run.t, trace.run.tip, trace.run.tip_velocity
        if trace.exact and sampled is not None:
            instants = sampled[sampled <= t[-1]]
            found = trace.at(instants)
            t, (u, v) = (t, (u, v)) if found is None else (instants, found)
        omega, amplitude = amplitude_spectrum(t, u, drive, v)
        shown = (omega > 0.0) & ((omega <= (MULTIPLES + 0.5) * drive) | (not drive))
        look = {} if trace.whole == trace.label else REALISATION
        style: dict[str, Any] = trace.style | trace.line(0.9) | look
        axis.plot(omega[shown], amplitude[shown], label=trace.whole, **style)
        top = max(top, float(np.max(amplitude[shown], initial=0.0)))
    axis.set_xlabel(drive_axis(axis, system.units, drive))
    log_scale(axis, x=False)
    if top:
        axis.set_ylim(1e-4 * top, 2.0 * top)
    axis.set_ylabel(f"amplitude of {tip_label(system)}")
