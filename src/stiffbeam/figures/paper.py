"""The figures of Dumont (2002) for any case: displacement, phase portrait, contact, shear, delayed portrait, spectrum.

In the paper's symbols: u(1, t) is the tip, u_t its velocity, sigma the shear stress at the stop, which is the contact
force, T the period of the drive and a its angular frequency; k^2, kappa, d and h = 1/cells are ``stiffness``,
``stops.stiffness``, ``viscosity`` and the mesh size of the case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from string import ascii_letters
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.units import with_unit
from ..basics.validation import InputError, instance, numbers, one_of, sequence
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.frequencies import amplitude_spectrum, drive_frequency
from ..references import best_reference
from ..trajectory.trajectory import Reference, Trajectory
from .chart import heading, in_lines, log_scale, new_figure, shared_legend, short, tip_name, tip_symbol
from .runs import (
    TICKS,
    draw_stops,
    drive_axis,
    first_contact,
    line_of,
    position_label,
    shown_contacts,
    tip_label,
    zoom_on_stop,
)  # fmt: skip

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..model.system import System

PANELS = ("displacement", "portrait", "contact", "shear", "delayed", "spectrum")
AT_CONTACT = ("contact", "shear")
FINE, DELAYED, MULTIPLES, MOST = 8000, 6000, 15, 12


def paper_figure(
    runs: Case | Trajectory | Sequence[Trajectory],
    panels: Sequence[str] | None = None,
    span: tuple[float, float] | None = None,
) -> Figure:
    """The panels of the paper's figures for runs and references of one system, or for a case.

    Parameters
    ----------
    runs : Case, Trajectory or sequence of Trajectory
        Of a case its reference and its runs in the first form; past the horizon the reference is one realisation.
    panels : sequence of {"displacement", "portrait", "contact", "shear", "delayed", "spectrum"}, optional
        By default all that the system has: "contact", the first impacts in close-up, and "shear", the contact force,
        for each of the first six contacts that a run touches; "delayed", u(t + T) over u(t), for a driven system. Named
        panels show the first twelve contacts.
    span : (float, float), optional
        Times that displacement, portraits and shear show; by default the whole run.

    Returns
    -------
    Figure
        With one panel (or one for each contact) for each name.

    Raises
    ------
    InputError
        For runs without their system, unknown panels, and panels that the system does not have.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import stiffbeam as sb
    >>> figure = sb.paper_figure(replace(sb.paper_case(10), t_end=0.7), ["displacement", "spectrum"])
    >>> len(figure.axes)
    2
    """
    case: Case | None = None
    if isinstance(runs, Case):
        system, case = runs.system(), runs
        marched = [integrate(system, x, case.dt, case.t_end) for x, form in case.runs if form == system.form]
        runs = [best_reference(system, case.t_end), *marched]
    rule = "be a case, a run, or a list of runs"
    solutions = [runs] if isinstance(runs, Trajectory) else sequence("runs", runs, rule, "for example [reference, run]")
    for each in solutions:
        instance("runs", each, Trajectory, "make runs with integrate and reference")
    system = solutions[0].system if solutions else None
    if system is None:
        raise InputError("runs", "no system", "come with their system", "read them with sb.load(file, system)")
    drive, end = drive_frequency(system), min(float(x.t[-1]) for x in solutions)
    rule, remedy = "be two increasing times of the runs", f"for example (0.0, {end:g})"
    times = [0.0, end] if span is None else numbers("span", span, rule, remedy).ravel().tolist()
    if len(times) != 2 or not 0.0 <= times[0] < times[1] <= float(solutions[0].t[-1]):
        raise InputError("span", span, rule, remedy)
    start, end = times
    delay = 2.0 * np.pi / drive if drive else np.inf
    missing = {"contact": not system.contacts, "shear": not system.contacts, "delayed": delay >= end - start}
    names = [x for x in PANELS if not missing.get(x)] if panels is None else sequence("panels", panels, "be names")
    if not names:
        raise InputError("panels", panels, "be one or more names", f"known: {', '.join(PANELS)}")
    for name in names:
        one_of("panels", name, PANELS, "name a panel")
        if missing.get(name):
            remedy = "leave it out"
            raise InputError("panels", name, "be one that the system has: a stop, or a drive's period", remedy)
    draw = {
        "displacement": partial(displacement, start=start, end=end),
        "portrait": partial(portrait, start=start, end=end),
        "contact": partial(first_contacts, end=end),
        "shear": partial(shear, start=start, end=end),
        "delayed": partial(delayed, start=start, end=end - delay, delay=delay),
        "spectrum": partial(spectrum, drive=drive),
    }
    contacts = (shown_contacts(solutions) or [0]) if panels is None else range(len(system.contacts))[:MOST]
    plan = [(name, i) for name in names for i in (contacts if name in AT_CONTACT else [0])]
    lines = (len(plan) + 1) // 2
    width = 10.5 if len(plan) > 1 else 5.6
    methods = dict.fromkeys(short(x.provenance["method"]) for x in solutions)
    title = f"{', '.join(methods)}, t = {start:g} to {end:g}"
    title = title if case is None else heading(case, title)
    figure = new_figure(3.7 * lines + 0.6, in_lines(title, round(9 * width)), width)
    axes = figure.subplots(lines, min(2, len(plan)), squeeze=False).ravel()
    # An odd number of panels leaves one place empty.
    for axis in axes[len(plan) :]:
        axis.remove()
    for axis, letter, (name, i) in zip(axes, ascii_letters, plan, strict=False):
        draw[name](axis, traces_of(solutions), system, **{"contact": i} if name in AT_CONTACT else {})
        place = f" at contact {i + 1}" if len(system.contacts) > 1 and name in AT_CONTACT else ""
        axis.set_title(f"({letter}) {TITLES[name]}{place}", loc="left")
        if name != "spectrum":
            axis.locator_params(axis="x", nbins=TICKS)
    shared_legend(figure, 3)
    return figure


TITLES = {
    "displacement": "displacement", "portrait": "phase portrait", "contact": "the first contacts",
    "shear": r"contact force $\sigma$", "delayed": "delayed portrait", "spectrum": "spectrum",
}  # fmt: skip


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


def traces_of(runs: Sequence[Trajectory]) -> list[Trace]:
    """The traces of runs and references in the looks that they have in every picture."""
    traces = []
    for run in runs:
        label, style = short(run.provenance["method"]), line_of(run)
        if isinstance(run, Reference):
            past = f"{label}, one realisation"
            traces.append(Trace(run, label, style | {"alpha": 0.4}, run.horizon, past))
        else:
            traces.append(Trace(run, label, style))
    return traces


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
