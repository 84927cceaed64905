"""Pictures of the test set: the motion of a problem, and the errors of integrators on it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .chart import COLOURS, Axes, Figure, log_scale, look, mark_order, new_figure, say_empty, shared_legend, short


def motion(axis: Axes, problem: Any) -> None:
    """The known tip positions with the stops of the first contact, and the known impacts."""
    from scipy.interpolate import CubicHermiteSpline

    contact = problem.data["contacts"][0]
    t, u, v = problem.times, problem.answers["tip"].value, problem.answers["tip_velocity"].value
    # Impacts on rigid stops turn the velocity between samples, where a cubic would not.
    if "impacts" not in problem.answers or not problem.rigid:
        fine = np.linspace(t[0], t[-1], 1500)
        axis.plot(fine, CubicHermiteSpline(t, u, v)(fine), color="black", lw=1.0)
    axis.plot(t, u, "o", color="black", ms=2.5, label="known")
    if problem.data.get("observe", contact["row"]) == contact["row"] and "offset" not in contact:
        sides = [side for side in ("lower", "upper") if side in contact]
        for side in sides:
            axis.axhline(contact[side], color=COLOURS[1], lw=1.0, label="stop" if side == sides[0] else None)
    if "impacts" in problem.answers:
        when = problem.answers["impacts"].value
        axis.plot(when, np.full(len(when), 0.02), "|", color=COLOURS[1], ms=9, transform=axis.get_xaxis_transform(),
                  label="impacts")  # fmt: skip
    axis.set(xlabel="time $t$", ylabel="$u(t)$")


def score_picture(entries: Sequence[Any]) -> Figure:
    """The motion of the entries' problem, the error of the tip over the cost, and that of the impact times."""
    problem = entries[0].problem
    figure = new_figure(3.6, problem.title)
    left, middle, right = figure.subplots(1, 3)
    motion(left, problem)
    for e in (e for e in entries if e.runs):
        for axis, column in ((middle, "tip_error"), (right, "impact_time_error")):
            errors = np.abs([run[column] for run in e.runs])
            style = look(e.integrator) | {"ms": 4, "lw": 1.2}
            axis.plot([run["cost"] for run in e.runs], np.maximum(errors, 1e-16), **style, label=short(e.integrator))
    for axis, label in ((middle, "rms error of u over max |u|"), (right, "largest error of impact times")):
        axis.set(xlabel="stages, or right-hand sides", ylabel=label)
        if any(np.any(np.isfinite(np.asarray(line.get_ydata(), float))) for line in axis.lines):
            log_scale(axis)
        else:
            say_empty(axis, "no impact times are known")
    mark_order(middle, [-2.0], y=0.95)  # errors fall to the right: above them is room
    shared_legend(figure, 6)
    return figure
