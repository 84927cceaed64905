"""The figures of Dumont (2002) for any case: displacement, phase portrait, contact, shear, delayed portrait, spectrum.

In the paper's symbols: u(1, t) is the tip, u_t its velocity, sigma the shear stress at the stop, which is the contact
force, T the period of the drive and a its angular frequency; k^2, kappa, d and h = 1/cells are ``stiffness``,
``stops.stiffness``, ``viscosity`` and the mesh size of the case.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError, near
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.frequencies import amplitude_spectrum, drive_frequency
from ..references import best_reference
from ..trajectory.trajectory import Reference, Trajectory
from .panels import log_scale, new_figure, shared_legend, short, tip_name, tip_symbol
from .runs import draw_stops, first_contact, line_of, zoom_on_stop

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..model.system import System

PANELS = ("displacement", "portrait", "contact", "shear", "delayed", "spectrum")
FINE, DELAYED, MULTIPLES = 8000, 6000, 15


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
        By default all that the system has: "contact", the first impacts in close-up, and "shear" for each contact;
        "delayed", u(t + T) over u(t), for a driven system.
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
    if isinstance(runs, Case):
        system, case = runs.system(), runs
        marched = [integrate(system, x, case.dt, case.t_end) for x, form in case.runs if form == system.form]
        runs = [best_reference(system, case.t_end), *marched]
    solutions = [runs] if isinstance(runs, Trajectory) else list(runs)
    system = solutions[0].system if solutions else None
    if system is None:
        raise InputError("runs", "no system", "come with their system", "read them with sb.load(file, system)")
    drive, end = drive_frequency(system), min(float(x.t[-1]) for x in solutions)
    start, end = (0.0, end) if span is None else span
    if not 0.0 <= start < end <= float(solutions[0].t[-1]):
        raise InputError("span", span, "be two increasing times of the runs", f"for example (0.0, {end:g})")
    delay = 2.0 * np.pi / drive if drive else np.inf
    missing = {"contact": not system.contacts, "shear": not system.contacts, "delayed": delay >= end - start}
    names = [x for x in PANELS if not missing.get(x)] if panels is None else list(panels)
    for name in names:
        if name not in PANELS:
            raise InputError("panels", name, "name a panel", near(name, PANELS))
        if missing.get(name):
            remedy = "leave it out"
            raise InputError("panels", name, "be one that the system has: a stop, or a drive's period", remedy)
    time, tip = system.units.label("time $t$", "time"), f"{tip_name(system.problem)} displacement"
    length = system.units.label(f"{tip} {tip_symbol(system.problem)}", "length")
    draw = {
        "displacement": partial(_displacement, start=start, end=end),
        "portrait": partial(_portrait, start=start, end=end),
        "delayed": partial(_delayed, start=start, end=end - delay, delay=delay),
        "spectrum": partial(_spectrum, drive=drive),
    }
    plan = [(name, i) for name in names for i in (range(len(system.contacts)) if name in ("contact", "shear") else [0])]
    lines = (len(plan) + 1) // 2
    figure = new_figure(3.7 * lines + 0.6, width=10.5 if len(plan) > 1 else 5.6)
    axes = figure.subplots(lines, min(2, len(plan)), squeeze=False).ravel()
    for axis in axes[len(plan) :]:
        axis.remove()
    for axis, letter, (name, i) in zip(axes, ascii_lowercase, plan, strict=False):
        axis.set(xlabel=time, ylabel=length)
        if name == "contact":
            _contact(axis, solutions, system, i, end)
        elif name == "shear":
            _shear(axis, solutions, system, i, start, end)
        else:
            draw[name](axis, solutions, system)
        place = f" at contact {i + 1}" if len(system.contacts) > 1 and name in ("contact", "shear") else ""
        axis.set_title(f"({letter}) {TITLES[name]}{place}", loc="left")
    shared_legend(figure, 3)
    return figure


TITLES = {
    "displacement": "displacement", "portrait": "phase portrait", "contact": "the first contacts",
    "shear": r"shear stress $\sigma$", "delayed": "delayed portrait", "spectrum": "spectrum",
}  # fmt: skip


def _path(run: Trajectory, start: float, end: float, contact: int | None = None) -> tuple[Array, Array, Array]:
    """Times in [start, end], position and velocity of the tip or a contact."""
    if isinstance(run, Reference) and run.solution is not None:
        t = np.linspace(start, end, FINE)
        return t, *run.at(t, contact)
    u, v = (run.tip, run.tip_velocity) if contact is None else (
        run.contacts[contact].position, run.contacts[contact].velocity
    )  # fmt: skip
    inside = (run.t >= start) & (run.t <= end)
    return run.t[inside], u[inside], v[inside]


def _draw(axis: Axes, run: Trajectory, x: Array, y: Array, lw: float = 0.9) -> None:
    exact = isinstance(run, Reference)
    style: dict[str, Any] = {"alpha": 0.4, "lw": 1.8 * lw, "zorder": 1} if exact else {"lw": lw, "zorder": 2}
    axis.plot(x, y, label=short(run.provenance["method"]), **line_of(run) | style)


def _horizon(axis: Axes, runs: Sequence[Trajectory], start: float, end: float) -> None:
    """The span and, where the reference becomes one realisation, a dashed line."""
    axis.set_xlim(start, end)
    for run in runs:
        if isinstance(run, Reference) and run.horizon < end:
            axis.axvline(run.horizon, color="0.4", lw=0.9, ls="--")


def _tip_stops(axis: Axes, system: System, horizontal: bool) -> None:
    for i, contact in enumerate(system.contacts):
        if system.reads_tip(i):
            draw_stops(axis, contact.stops, horizontal)


def _displacement(axis: Axes, runs: Sequence[Trajectory], system: System, start: float, end: float) -> None:
    for run in runs:
        t, u, _ = _path(run, start, end)
        _draw(axis, run, t, u)
    _tip_stops(axis, system, horizontal=True)
    _horizon(axis, runs, start, end)


def _portrait(axis: Axes, runs: Sequence[Trajectory], system: System, start: float, end: float) -> None:
    for run in runs:
        _, u, v = _path(run, start, end)
        _draw(axis, run, u, v, 0.6)
    _tip_stops(axis, system, horizontal=False)
    axis.locator_params(axis="x", nbins=6)
    symbol = tip_symbol(system.problem)
    axis.set_xlabel(axis.get_ylabel())
    velocity = f"{tip_name(system.problem)} velocity {symbol.replace('u(', 'u_t(')}"
    axis.set_ylabel(system.units.label(velocity, "velocity"))


def _contact(axis: Axes, runs: Sequence[Trajectory], system: System, contact: int, end: float) -> None:
    begin, until = first_contact(runs[0], system, end, contact)
    for run in runs:
        t, u, _ = _path(run, begin, until, contact)
        _draw(axis, run, t, u)
    axis.set_xlim(begin, until)
    draw_stops(axis, system.contacts[contact].stops, horizontal=True)
    zoom_on_stop(axis, runs[0], begin, until, contact)
    axis.set_ylabel(system.units.label("displacement relative to the stops", "length"))


def _shear(axis: Axes, runs: Sequence[Trajectory], system: System, contact: int, start: float, end: float) -> None:
    stops = system.contacts[contact].stops
    for run in runs:
        if stops.rigid:
            inside = (run.t >= start) & (run.t <= end)
            t, force = run.t[inside], run.contacts[contact].force[inside]
        else:
            t, u, v = _path(run, start, end, contact)
            force = stops.force(u, v)
        _draw(axis, run, t, force)
    _horizon(axis, runs, start, end)
    axis.set_ylabel(system.units.label(r"$\sigma$ at the stop", "force"))


def _delayed(
    axis: Axes, runs: Sequence[Trajectory], system: System, start: float, end: float, delay: float
) -> None:  # fmt: skip
    t = np.linspace(start, end, DELAYED)
    for run in runs:
        now, later = (run.at(x)[0] if isinstance(run, Reference) and run.solution is not None
                      else np.interp(x, run.t, run.tip) for x in (t, t + delay))  # fmt: skip
        label, colour = short(run.provenance["method"]), line_of(run)["color"]
        axis.plot(now, later, ls="", marker=".", ms=1.6, mew=0.0, label=label, color=colour)
    axis.locator_params(axis="x", nbins=6)
    for horizontal in (False, True):
        _tip_stops(axis, system, horizontal)
    symbol = tip_symbol(system.problem)
    axis.set(xlabel=axis.get_ylabel(), ylabel=system.units.label(symbol.replace("t)", "t + T)"), "length"))


def _spectrum(axis: Axes, runs: Sequence[Trajectory], system: System, drive: float) -> None:
    top = 0.0
    for run in runs:
        t, u, v = run.t, run.tip, run.tip_velocity
        if isinstance(run, Reference) and run.solution is not None and not isinstance(runs[-1], Reference):
            t = runs[-1].t[runs[-1].t <= run.t[-1]]  # the instants of a scheme
            u, v = run.at(t)
        omega, amplitude = amplitude_spectrum(t, u, drive, v)
        shown = (omega > 0.0) & ((omega <= (MULTIPLES + 0.5) * drive) | (not drive))
        _draw(axis, run, system.units.cycles(omega[shown])[0], amplitude[shown])
        top = max(top, float(np.max(amplitude[shown], initial=0.0)))
    log_scale(axis, x=False)
    if top:
        axis.set_ylim(1e-5 * top, 2.0 * top)
    at, label, quantity = system.units.cycles(drive)
    words = f"{label}, drive a = {system.units.measure(float(at), quantity, '.4g')}" if drive else label
    axis.set_xlabel(words if drive else system.units.label(label, quantity))
    axis.set_ylabel(f"amplitude of {axis.get_ylabel()}")
