"""Film of runs side by side: the beam between its stops, schemes beside the exact motion."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.resources import Show, silent
from ..basics.storage import write_whole
from ..basics.text import with_unit
from ..basics.validation import InputError, file_path, instance, integer, positive
from ..measures.comparison import contact_name
from ..model.system import System
from ..model.time_functions import evaluate
from ..trajectory.trajectory import Reference, Trajectory
from .chart import new_figure, short, tip_text
from .runs import line_of

POINTS = 80  # along a beam


def animate(
    runs: Sequence[Trajectory],
    file: str | Path,
    seconds: float = 8.0,
    frames_per_second: int = 20,
    show: Show = silent,
) -> Path:
    """Write the motion of ``runs``, all of one system, as .gif or .mp4, ``seconds`` long, to the end of the shortest.

    Above: the beam, or for matrices every contact point, between its stops. Below: the tip over time. Raises
    InputError for runs of several systems or without theirs, and if no writer is installed.
    """
    path, system = file_path("file", file), _system(runs)
    end = min(float(run.t[-1]) for run in runs)
    count = max(2, round(positive("seconds", seconds) * integer("frames_per_second", frames_per_second, 1)))
    writer = {".gif": "pillow", ".mp4": "ffmpeg"}.get(path.suffix.lower())
    if writer is None:
        raise InputError("file", str(path), "end in .gif or .mp4", f"name it {path.stem}.gif")

    from matplotlib.animation import FuncAnimation, writers

    if not writers.is_available(writer):
        remedy = f"install {writer}, or name it {path.stem}.gif"
        raise InputError("file", str(path), "be of a kind for which a writer is installed", remedy)
    figure, draw = _stage(runs, system, np.linspace(0.0, end, count))
    with tempfile.TemporaryDirectory() as folder:  # the writers take names of files only
        whole = Path(folder) / f"film{path.suffix}"
        film = FuncAnimation(figure, draw, frames=count)
        step = partial(show, f"animating {path.name}")
        try:
            film.save(whole, writer, frames_per_second, dpi=90, progress_callback=step)
        except IndexError as error:  # Pillow's writer cannot end a film of no frames, and hides why there are none
            raise error.__context__ or error from None
        return write_whole(path, whole.read_bytes())


def _system(runs: Sequence[Trajectory]) -> System:
    """The system of all runs."""
    for run in runs:
        instance("runs", run, Trajectory, "make runs with integrate and reference")
    if len({run.fingerprint for run in runs}) != 1:
        raise InputError("runs", f"{len(runs)} runs", "be of one system", "make every run with the same System object")
    system = next((run.system for run in runs if run.system is not None), None)
    if system is None:
        raise InputError("runs", "loaded files", "have their system", "integrate again")
    return system


def motion_of(run: Trajectory, system: System, t: Array) -> tuple[Array, Array, Array]:
    """Places (points,) along the beam, or numbers of the contacts and the observed point; displacements there at the
    times t, (frames, points); and the tip at t."""
    if isinstance(run, Reference) and run.state_at is not None:
        times, (q, _), tip = t, run.state_at(t), run.at(t)[0]
    else:
        index = np.searchsorted(run.t, t - 1e-9 * t[-1]).clip(0, len(run.t) - 1)
        times, q, tip = run.t[index], run.states[0][index], run.tip[index]
    if system.problem is None:
        return np.arange(len(system.channels), dtype=float), system.positions(times, q), tip
    x = np.linspace(0.0, system.problem.length, POINTS)
    return x, system.displacement(times, q, x), tip


def _stage(runs: Sequence[Trajectory], system: System, t: Array) -> tuple[Any, Any]:
    """The figure and a function that puts it to frame k."""
    units, beam = system.units, system.problem
    figure = new_figure(5.6, width=8.0)
    above, below = figure.subplots(2, 1, height_ratios=(1.6, 1.0))
    moves = [motion_of(run, system, t) for run in runs]
    stops = [_stop_marks(system, i, t) for i in range(len(system.contacts))]
    edges = [np.max(np.abs(edge[np.isfinite(edge)]), initial=0.0) for _, both in stops for edge in both]
    reach = 1.15 * max([*(float(np.max(np.abs(shape))) for _, shape, _ in moves), *edges])
    length = float(moves[0][0][-1]) or 1.0
    width, curves = 0.022 * length, []
    for run in runs:
        style = {"lw": 3.0, "alpha": 0.45, "zorder": 1} if isinstance(run, Reference) else {"lw": 1.4}
        style |= {"color": line_of(run)["color"], "label": short(run.provenance["method"])}
        dots = {} if beam else {"marker": "o", "ls": "", "ms": 13 if isinstance(run, Reference) else 6}
        curves.append((above.plot([], [], **style | dots)[0], below.plot([], [], **style)[0]))
    marks = [[above.plot([], [], color="0.25", lw=5.0, solid_capstyle="butt")[0] for _ in range(2)] for _ in stops]
    above.set(xlim=(-0.04 * length, 1.06 * length), ylim=(-reach, reach))
    if beam is None:
        names = [contact_name(system, i) for i in range(len(stops))] + ["observed"] * (system.observe is not None)
        above.set_xticks(moves[0][0], names)
        above.set_ylabel(with_unit(units, "position", "length"))
    else:
        above.set_xlabel(with_unit(units, "place along the beam $x$", "length"))
        above.set_ylabel(with_unit(units, "$u(x, t)$", "length"))
    high = 1.1 * max(float(np.max(np.abs(tip))) for *_, tip in moves) or 1.0
    tip_label = with_unit(units, tip_text(beam), "length")
    below.set(xlim=(0.0, t[-1]), ylim=(-high, high), xlabel=with_unit(units, "time $t$", "time"), ylabel=tip_label)
    above.legend(loc="upper left", frameon=False, ncols=len(runs))
    clock = above.text(0.99, 0.97, "", transform=above.transAxes, ha="right", va="top")
    cursor = below.axvline(0.0, color="0.5", lw=0.8)

    def draw(k: int) -> None:
        for (x, shape, tip), (line, trace) in zip(moves, curves, strict=True):
            line.set_data(x, shape[k])
            trace.set_data(t[: k + 1], tip[: k + 1])
        for (place, both), pair in zip(stops, marks, strict=True):
            for mark, edge in zip(pair, both, strict=True):
                mark.set_data([place - width, place + width], [edge[k], edge[k]])
        past = any(isinstance(run, Reference) and t[k] > run.horizon for run in runs)
        clock.set_text(f"$t$ = {t[k]:.4g}{' (past the horizon)' * past}")
        cursor.set_xdata([t[k], t[k]])

    draw(0)
    figure.draw_without_rendering()  # laid out once, and then nothing moves any more but what should
    figure.set_layout_engine("none")
    return figure, draw


def _stop_marks(system: System, i: int, t: Array) -> tuple[float, list[Array]]:
    """(place, [lower, upper] stop over time) of contact i; NaN where that side is free."""
    edges = [np.full(len(t), system.contacts[i].stops.sides.get(side, np.nan)) for side in (-1, 1)]
    if system.problem is None:
        return float(i), edges
    stops = system.problem.all_stops[i]
    return float(system.problem.place(stops)), [evaluate(stops.motion, t) + edge for edge in edges]
