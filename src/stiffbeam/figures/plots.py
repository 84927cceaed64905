"""One picture for each kind of result, into axes of the caller or into a new figure.

Every function takes ``ax=None`` and arguments of ``Axes.plot``. It returns the axes it was given, or the new figure,
which a notebook shows. The exact motion is black, a method has its look of every other picture.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.validation import InputError, integer
from ..measures.comparison import Comparison
from ..model.natural_modes import modes
from ..model.system import System
from ..trajectory.ensemble import Ensemble
from ..trajectory.impacts import Impacts
from ..trajectory.trajectory import Reference, Trajectory
from .panels import COLOURS, look, new_figure, say_empty, short, tip_name, tip_symbol
from .runs import comparison_figure, draw_stops, run_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 200  # along a beam
ONE = 3.6  # height of a picture of one panel, in inches


def _axes(ax: Axes | None, title: str) -> tuple[Axes, Axes | Figure]:
    """The axes to draw into, and the object to return."""
    if ax is not None:
        return ax, ax
    figure = new_figure(ONE, title, width=8.0)
    return figure.subplots(), figure


def plot_run(run: Trajectory, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """The tip against time with the stops that act on it; without ``ax`` the four panels of ``run_figure``."""
    if ax is None:
        return run_figure(run, **kwargs)
    method, units = run.provenance["method"], run.units
    beam = run.system.problem if run.system else None
    style: dict[str, Any] = {"color": look(method)["color"], "lw": 0.9, "label": short(method)} | kwargs
    ax.plot(run.t, run.tip, **style)
    for record in run.contacts:
        if np.array_equal(record.position, run.tip):
            draw_stops(ax, record.stops, horizontal=True)
    if isinstance(run, Reference) and run.horizon < run.t[-1]:
        ax.axvline(run.horizon, color="0.4", lw=0.9, ls="--")
    ax.set_xlabel(units.label("time $t$", "time"))
    ax.set_ylabel(units.label(f"{tip_name(beam)} displacement {tip_symbol(beam)}", "length"))
    return ax


def plot_system(system: System, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """The start of the motion between the stops: u(x, 0) of a beam, the unknowns of matrices by their numbers."""
    axis, returned = _axes(ax, repr(system).strip("<>"))
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
        places = [beam.length if s.position is None else float(s.position) for s in beam.all_stops]
        axis.set_xlabel(units.label("position $x$", "length"))
    for i, (place, contact) in enumerate(zip(places, system.contacts, strict=True)):
        for stop, marker in ((contact.stops.upper, 7), (contact.stops.lower, 6)):  # carets that point at the beam
            if stop is not None and np.isfinite(stop):
                axis.plot([place], [stop], ls="", marker=marker, ms=11, color=COLOURS[1], label="stop")
        if len(places) > 1:
            axis.annotate(str(i + 1), (place, 0.0), xytext=(4, 4), textcoords="offset points", fontsize=8)
    _legend_once(axis)
    axis.set_ylabel(units.label("displacement", "length"))
    return returned


def plot_impacts(impacts: Impacts, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """Largest force of every impact against its time, of rigid stops the impulse; upper and lower stop by colour."""
    axis, returned = _axes(ax, f"{impacts.count} impacts")
    known = bool(np.any(np.isfinite(impacts.peaks)))
    heights = impacts.peaks if known else impacts.impulses
    for side, name, colour in ((1, "upper stop", COLOURS[0]), (-1, "lower stop", COLOURS[1])):
        of_side = impacts.stops == side
        if np.any(of_side):
            style: dict[str, Any] = {"ls": "", "marker": "o", "ms": 4, "color": colour, "label": name} | kwargs
            axis.plot(impacts.times[of_side], heights[of_side], **style)
    if not np.any(np.isfinite(heights)):
        say_empty(axis, "no impacts" if not impacts.count else "forces and impulses of the impacts are not known")
    axis.set_xlabel("time of impact")
    axis.set_ylabel("largest force" if known else "impulse")
    _legend_once(axis)
    return returned


def plot_ensemble(many: Ensemble, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """The tip of every member where it was kept; else what the first contact bears against the varied parameter."""
    axis, returned = _axes(ax, f"{short(many.provenance['method'])}, {len(many)} members")
    units = many.units
    style: dict[str, Any] = {"color": look(many.provenance["method"])["color"]}
    if len(many.t):
        style |= {"lw": 0.7, "alpha": max(0.1, len(many) ** -0.5)} | kwargs
        axis.plot(many.t, many.tip.T, **style)
        axis.set_xlabel(units.label("time $t$", "time"))
        beam = many.members.system.problem
        axis.set_ylabel(units.label(f"{tip_name(beam)} displacement {tip_symbol(beam)}", "length"))
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
    axis.set_ylabel(units.label("impulse", "impulse") if rigid else units.label("largest force", "force"))
    return returned


def plot_comparison(comparison: Comparison, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """The error of the tip against time, with a dot where the impacts cease to match; without ``ax`` four panels."""
    if ax is None:
        if comparison.pair is None:
            remedy = "compare the run and the reference again"
            raise InputError("plot", "a comparison without its runs", "be asked of what compare returned", remedy)
        return comparison_figure(comparison)
    method = comparison.label.partition("@")[0]
    error = np.maximum.accumulate(np.abs(comparison.error))
    seen = error > 0.0
    style: dict[str, Any] = {"color": look(method)["color"], "lw": 1.2, "label": short(method)} | kwargs
    ax.plot(comparison.times[seen], error[seen], **style)
    if comparison.matched_until < comparison.window and np.any(seen):
        last = error[max(0, np.searchsorted(comparison.times, comparison.matched_until, side="right") - 1)]
        ax.plot([comparison.matched_until], [last], "o", ms=5.0, mfc="white", color=style["color"])
    if np.any(seen):
        ax.set_yscale("log")
    ax.set_xlabel(comparison.units.label("time $t$", "time"))
    ax.set_ylabel("largest error so far / max |u|")
    return ax


def plot_advice(advice: Any, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """The worst error over the wanted one of every run that was tried, against its cost; the advised run is black."""
    axis, returned = _axes(ax, f"Runs tried to t = {advice.system.units.measure(advice.t_end, 'time', 'g')}")
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
    if advice.recommendation is not None:
        axis.plot(
            [advice.recommendation.work],
            [worst(advice.recommendation)],
            "o",
            ms=10,
            mfc="none",
            color="black",
            label="advised",
        )
    axis.set(xscale="log", yscale="log", xlabel="linear solves", ylabel="worst error / wanted error")
    _legend_once(axis)
    return returned


def plot_scorecard(card: Any, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
    """The smallest error of the tip of every integrator, problem by problem."""
    axis, returned = _axes(ax, f"Test set {card.version}")
    problems = [problem.name for problem in card.problems]
    for integrator in card.integrators:
        best = []
        for name in problems:
            errors = [r.errors.tip_rms for e in card.entries
                      if (e.integrator, e.problem.name) == (integrator, name) for r in e.runs]  # fmt: skip
            best.append(min((x for x in map(abs, errors) if np.isfinite(x)), default=np.nan))
        style: dict[str, Any] = look(integrator) | {"ls": "", "ms": 5, "label": short(integrator)} | kwargs
        style.pop("linestyle", None)
        axis.plot(range(len(problems)), np.maximum(best, 1e-16), **style)
    axis.set_xticks(range(len(problems)), problems, rotation=60, ha="right", fontsize=8)
    axis.set_ylabel("smallest rms error of u over max |u|")
    if any(np.any(np.isfinite(np.asarray(line.get_ydata(), float))) for line in axis.lines):
        axis.set_yscale("log")
    _legend_once(axis)
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
    places = [beam.length if s.position is None else float(s.position) for s in beam.all_stops] if beam else []
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
        omega = units.measure(natural.omega[j], "frequency", ".5g")
        ratio = natural.damping_ratio[j]
        damping = f", damping ratio {ratio:.3g}" if np.isfinite(ratio) and ratio else ""
        axis.set_title(f"mode {j + 1}: $\\omega$ = {omega}{damping}", loc="left", fontsize=9)
        axis.set_yticks([])
    label = "unknown" if beam is None else units.label("place along the beam $x$", "length")
    axes[-1].set_xlabel(f"{label}; dotted: stops" if places else label)
    return figure


def _legend_once(axis: Axes) -> None:
    """A legend with every text once, where there is any."""
    entries = dict(zip(*axis.get_legend_handles_labels()[::-1], strict=True))
    if entries:
        axis.legend(entries.values(), entries.keys(), frameon=False, fontsize=8.5)
