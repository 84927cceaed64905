"""Film of runs side by side: the beam between its stops, schemes beside the exact motion, a flash at each impact."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.progress import Show, silent
from ..basics.storage import write_whole
from ..basics.units import with_unit
from ..basics.validation import InputError, file_path, instance, integer, positive
from ..model.system import System
from ..model.time_functions import offset_values
from ..trajectory.trajectory import Reference, Trajectory
from .chart import look, new_figure, short, tip_name, tip_symbol

SUFFIXES = (".gif", ".mp4")
POINTS = 80  # along a beam
TRACE = 1500  # times of the tip's curve
FADE = 0.6  # of a flash that is left in the next frame
DIM = 0.03  # a flash below which none is drawn


def animate(
    runs: Sequence[Trajectory],
    file: str | Path,
    seconds: float = 8.0,
    frames_per_second: int = 20,
    t_end: float | None = None,
    show: Show = silent,
    dpi: int = 90,
) -> Path:
    """Write the motion of ``runs``, all of one system, as .gif or .mp4, ``seconds`` long.

    Above: the beam, or for matrices every contact point, between its stops. A flash marks a run that is on a stop
    during the frame; its size is the root of the impact's peak force, on one scale for all runs. Below: the tip over
    time. Past the horizon of a reference its curve is grey: from there on it is one realisation. t_end: by default that
    of the run that ends first. dpi: 90 makes frames of 720 x 504. Raises InputError for runs of several systems or
    without theirs, and if no writer is installed.
    """
    path = file_path("file", file)
    system = _system(runs)
    end = min(float(run.t[-1]) for run in runs)
    end = end if t_end is None else min(end, positive("t_end", t_end))
    count = max(2, round(positive("seconds", seconds) * integer("frames_per_second", frames_per_second, 1)))
    writer = _writer(path, frames_per_second)
    t = np.linspace(0.0, end, count)
    strongest = max((float(np.nanmax(c.impacts.peaks, initial=0.0)) for run in runs for c in run.contacts), default=0.0)
    films = [_Film(run, system, t, strongest) for run in runs]
    figure, draw = _stage(system, films, t)

    with tempfile.TemporaryDirectory() as folder:  # the writers take names of files only
        film_file = Path(folder) / f"film{path.suffix}"
        try:
            with writer.saving(figure, str(film_file), dpi=integer("dpi", dpi, 10)):
                for k in range(count):
                    show(f"animating {path.name}", k, count)
                    draw(k)
                    writer.grab_frame()
        except IndexError as error:  # Pillow's writer cannot end a film of no frames, and hides why there are none
            raise error.__context__ or error from None
        return write_whole(path, film_file.read_bytes())


def _system(runs: Sequence[Trajectory]) -> System:
    for run in runs:
        instance("runs", run, Trajectory, "make runs with integrate and reference")
    if len({run.fingerprint for run in runs}) != 1:
        raise InputError("runs", f"{len(runs)} runs", "be of one system", "make every run with the same System object")
    system = next((run.system for run in runs if run.system is not None), None)
    if system is None:
        raise InputError("runs", "loaded files", "have their system", "read them with it: sb.load(file, system)")
    return system


def _writer(path: Path, frames_per_second: int) -> Any:
    from matplotlib.animation import FFMpegWriter, PillowWriter

    if path.suffix.lower() not in SUFFIXES:
        raise InputError("file", str(path), f"end in {' or '.join(SUFFIXES)}", f"name it {path.stem}.gif")
    kind = PillowWriter if path.suffix.lower() == ".gif" else FFMpegWriter
    if not kind.isAvailable():
        remedy = f"install ffmpeg, or name it {path.stem}.gif" if kind is FFMpegWriter else "pip install pillow"
        raise InputError("file", str(path), "be of a kind for which a writer is installed", remedy)
    return kind(fps=frames_per_second)


class _Film:
    """The data of one run: shape (frames, points) or contact positions (frames, channels), flashes by contact, and the
    tip at ``fine`` times."""

    def __init__(self, run: Trajectory, system: System, t: Array, strongest: float) -> None:
        self.method, self.color = short(run.provenance["method"]), look(run.provenance["method"])["color"]
        self.exact = isinstance(run, Reference)
        self.horizon = run.horizon if isinstance(run, Reference) else np.inf
        self.fine = np.linspace(0.0, t[-1], TRACE)
        index, indices = (np.searchsorted(run.t, x - 1e-9 * t[-1]).clip(0, len(run.t) - 1) for x in (t, self.fine))
        if isinstance(run, Reference) and run.state_at is not None:
            times, (q, _) = t, run.state_at(t)
            self.tip = run.at(self.fine)[0]
        else:
            times, q = run.t[index], run.states[0][index]
            self.tip = run.tip[indices]
        if system.problem is not None:
            self.x = np.linspace(0.0, system.problem.length, POINTS)
            self.shape = system.displacement(times, q, self.x)
        else:
            self.x = np.arange(len(system.channels), dtype=float)
            self.shape = system.positions(times, q)
        self.flashes = np.zeros((len(t), len(run.contacts), 2))  # of the lower and the upper stop
        before = np.append(-np.inf, t[:-1])
        for i, contact in enumerate(run.contacts):
            impacts = contact.impacts
            for begin, over, side, peak in zip(impacts.times, impacts.ends, impacts.stops, impacts.peaks, strict=True):
                # Every frame that overlaps the contact, so that one shorter than a frame shows too.
                here = (t >= begin) & (before < (over if np.isfinite(over) else t[-1]))
                size = np.sqrt(peak / strongest) if np.isfinite(peak) and strongest else 1.0
                upper = int(side > 0)
                self.flashes[here, i, upper] = np.maximum(self.flashes[here, i, upper], size)
        # A flash fades in the frames after its impact.
        for k in range(1, len(t)):
            self.flashes[k] = np.maximum(self.flashes[k], FADE * self.flashes[k - 1])


def _stage(system: System, films: list[_Film], t: Array) -> tuple[Any, Any]:
    """The figure and a function that puts it to frame k."""
    units, beam = system.units, system.problem
    figure = new_figure(5.6, width=8.0)
    above, below = figure.subplots(2, 1, height_ratios=(1.6, 1.0))
    symbol = tip_symbol(beam)
    top = max(float(np.max(np.abs(film.shape))) for film in films)
    stops = [_stop_marks(system, i, t) for i in range(len(system.contacts))]
    known = [np.max(np.abs(line[np.isfinite(line)]), initial=0.0) for _, lines in stops for line in lines]
    reach = 1.15 * max([top, *known])
    lines, lights = [], []
    for film in films:
        alone = (
            {"color": "black", "lw": 3.0, "alpha": 0.45, "zorder": 1}
            if film.exact
            else {"color": film.color, "lw": 1.4}
        )
        style = alone | ({} if beam else {"marker": "o", "ls": "", "ms": 13 if film.exact else 6})
        lines.append((above.plot([], [], label=film.method, **style)[0], below.plot([], [], **alone)[0]))
        lights.append(above.scatter([], [], color=film.color, alpha=0.55, lw=0, zorder=3))
    marks = [[above.plot([], [], color="0.25", lw=5.0, solid_capstyle="butt")[0] for _ in range(2)] for _ in stops]
    length = float(films[0].x[-1]) or 1.0
    above.set(xlim=(-0.04 * length, 1.06 * length), ylim=(-reach, reach))
    if beam is None:
        names = [f"contact {i + 1}" for i in range(len(system.contacts))] + ["tip"] * (system.observe is not None)
        above.set_xticks(films[0].x, names)
        above.set(ylabel=with_unit(units, "position", "length"))
    else:
        place, moved = with_unit(units, "place along the beam $x$", "length"), with_unit(units, "$u(x, t)$", "length")
        above.set(xlabel=place, ylabel=moved)
    high = 1.1 * max(float(np.max(np.abs(film.tip))) for film in films) or 1.0
    below.set(xlim=(0.0, t[-1]), ylim=(-high, high))
    below.set(
        xlabel=with_unit(units, "time $t$", "time"), ylabel=with_unit(units, f"{tip_name(beam)} {symbol}", "length")
    )
    above.legend(loc="upper left", frameon=False, ncols=len(films))
    clock = above.text(0.99, 0.97, "", transform=above.transAxes, ha="right", va="top")
    cursor = below.axvline(0.0, color="0.5", lw=0.8)
    width = 0.022 * length * max(1.0, 0.5 * len(films))

    def draw(k: int) -> None:
        for n, (film, (line, trace), light) in enumerate(zip(films, lines, lights, strict=True)):
            beside = 0.8 * width * (n - 0.5 * (len(films) - 1))  # flashes of several runs stand side by side
            line.set_data(film.x, film.shape[k])
            gone = np.searchsorted(film.fine, t[k], "right")
            trace.set_data(film.fine[:gone], film.tip[:gone])
            if t[k] > film.horizon:
                line.set_color("0.6")
            flashes = [
                (x + beside, edges[side][k], film.flashes[k, i, side])
                for i, (x, edges) in enumerate(stops)
                for side in (0, 1)
                if film.flashes[k, i, side] > DIM
            ]
            light.set_offsets(np.array([point[:2] for point in flashes]).reshape(-1, 2))
            light.set_sizes([900.0 * size for *_, size in flashes])
        for (x, edges), pair in zip(stops, marks, strict=True):
            for mark, edge in zip(pair, edges, strict=True):
                mark.set_data([x - width, x + width], [edge[k], edge[k]])
        past = " (past the horizon)" if any(t[k] > film.horizon for film in films) else ""
        clock.set_text(f"$t$ = {t[k]:.4g}{past}")
        cursor.set_xdata([t[k], t[k]])

    draw(0)
    figure.draw_without_rendering()  # laid out once, and then nothing moves any more but what should
    figure.set_layout_engine("none")
    return figure, draw


def _stop_marks(system: System, i: int, t: Array) -> tuple[float, list[Array]]:
    """(place, [lower, upper] stop over time) of contact i; NaN where that side is free."""
    bounds = system.contacts[i].stops.lower_bound, system.contacts[i].stops.upper_bound
    edges = [np.full(len(t), x if np.isfinite(x) else np.nan) for x in bounds]
    if system.problem is None:
        return float(i), edges
    stops = system.problem.all_stops[i]
    return float(system.problem.place(stops)), [offset_values(stops.motion, t) + edge for edge in edges]
