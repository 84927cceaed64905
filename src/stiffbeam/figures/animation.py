"""Film of runs side by side: the beam between its stops, schemes beside the exact motion."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.resources import current, working
from ..basics.storage import write_whole
from ..basics.text import with_unit
from ..basics.validation import InputError, file_path, instance, integer
from ..model.time_functions import evaluate
from ..trajectory.trajectory import Reference, Trajectory
from .chart import new_figure, short
from .runs import line_of, tip_label

POINTS = 80  # along a beam
RATE = 20  # frames per second


@working("animating")
def animate(runs: Sequence[Trajectory], file: str | Path, frames: int) -> Path:
    """Write the motion of ``runs``, all of one beam, as .gif or .mp4, to the end of the shortest.

    Above: the beam between its stops, at the nearest output times. Below: the tip over time. Raises InputError for runs
    of several systems, of matrices or of a loaded file, and if no writer is installed.
    """
    from matplotlib.animation import FuncAnimation, writers

    path, t_end = file_path("file", file), min(instance("runs", run, Trajectory, "integrate").t[-1] for run in runs)
    writer = {".gif": "pillow", ".mp4": "ffmpeg"}.get(path.suffix.lower(), "")
    if not writers.is_available(writer):
        rule = "end in .gif, or in .mp4 where ffmpeg is installed"
        raise InputError("file", str(path), rule, f"name it {path.stem}.gif")
    figure, draw = _stage(runs, np.linspace(0.0, t_end, integer("frames", frames, 2)))
    with tempfile.TemporaryDirectory() as folder:  # the writers take names of files only
        whole = Path(folder) / path.name
        step = partial(current(), f"animating {path.name}")
        FuncAnimation(figure, draw, frames=frames).save(whole, writer, RATE, dpi=90, progress_callback=step)
        return write_whole(path, whole.read_bytes())


def _stage(runs: Sequence[Trajectory], t: Array) -> tuple[Any, Any]:
    """The figure and a function that puts it to frame k."""
    system = runs[0].system
    beam = system and system.problem
    if system is None or beam is None or len({run.fingerprint for run in runs}) != 1:
        rule, remedy = "be of one beam, the first not loaded from a file", "draw others by run.plot()"
        raise InputError("runs", f"those of {system!r}", rule, remedy)
    figure = new_figure(5.6, width=8.0)
    above, below = figure.subplots(2, 1, height_ratios=(1.6, 1.0))
    x = np.linspace(0.0, beam.length, POINTS)
    curves = list[tuple[Any, Array, Any, Array]]()
    for run in runs:
        style = {"lw": 3.0, "alpha": 0.45, "zorder": 1} if isinstance(run, Reference) else {"lw": 1.4}
        style |= {"color": line_of(run)["color"], "label": short(run.provenance["method"])}
        index = np.searchsorted(run.t, t - 1e-9 * t[-1]).clip(0, len(run.t) - 1)
        shape, tip = system.displacement(run.t[index], run.states[0][index], x), run.tip[index]
        curves.append((above.plot(x, shape[0], **style)[0], shape, below.plot(t, tip, **style)[0], tip))
    stops = [
        (beam.place(each), bound + evaluate(each.motion, t))
        for each in beam.all_stops for bound in each.sides.values()
    ]  # fmt: skip
    (marks,) = above.plot([place for place, _ in stops], [0.0] * len(stops), "_", color="0.25", ms=18.0, mew=5.0)
    reach = 1.15 * max(
        float(np.max(np.abs(y))) for y in (*(shape for _, shape, *_ in curves), *(edge for _, edge in stops))
    )
    above.set(ylim=(-reach, reach), xlabel=with_unit(system.units, "place along the beam $x$", "length"))
    above.set_ylabel(with_unit(system.units, "$u(x, t)$", "length"))
    below.set(xlim=(0.0, t[-1]), xlabel=with_unit(system.units, "time $t$", "time"), ylabel=tip_label(system))
    above.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, ncols=len(runs))
    clock = above.set_title(" ", loc="right", fontsize=10)
    figure.draw_without_rendering()  # laid out once, and then nothing moves any more but what should
    figure.set_layout_engine("none")

    def draw(k: int) -> None:
        for line, shape, trace, tip in curves:
            line.set_ydata(shape[k])
            trace.set_data(t[: k + 1], tip[: k + 1])
        marks.set_ydata([edge[k] for _, edge in stops])
        past = any(isinstance(run, Reference) and t[k] > run.horizon for run in runs)
        clock.set_text(f"$t$ = {t[k]:.4g}{' (past the horizon)' * past}")

    return figure, draw
