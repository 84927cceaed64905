"""Picture of the study ``converge``: error over the step, and which points the slope is made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ..studies.converge import envelope, orders
from ..studies.study import Records, Row
from . import column, found_rows, log_scale, look, mark_order, say_empty, short

TITLES = {"smooth": "without contact, slow motion", "contact": "through the first impacts"}
OVERFLOWN = 1e3  # an error that no longer says anything
REASONS = {"impacts part": "o", "error above 10 %": "^", "motion not resolved": "s", "rounding": "v",
           "past the horizon": "D", "its octave has one of these": "p"}  # fmt: skip


def draw(records: Records) -> Figure:
    """Filled markers enter the slope; hollow ones do not, their shape says why."""
    rows = found_rows(records)
    kinds = [kind for kind in TITLES if any(row["kind"] == kind for row in rows)] or ["smooth"]
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    figure.suptitle(f"{records.case.name}: convergence in time, slopes with their 95 % intervals")
    axes = figure.subplots(1, len(kinds), squeeze=False)[0]
    found = orders(rows)
    for axis, kind, letter in zip(axes, kinds, "ab", strict=False):
        own = [row for row in rows if row["kind"] == kind]
        reasons: dict[str, None] = {}
        for label in dict.fromkeys(row["scheme"] for row in own):
            order = found[kind, label]
            slope = str(order) if np.isfinite(order.slope) else "too few points"
            reasons |= _curve(axis, [row for row in own if row["scheme"] == label], f"{short(label)}: {slope}", order)
        for reason in sorted(reasons, key=list(REASONS).index):
            axis.plot([], [], REASONS[reason], ms=4.5, mfc="white", mec="0.35", label=f"left out: {reason}")
        log_scale(axis)
        axis.set(xlabel=r"step $\Delta t$", ylabel="tip error, rms, relative")
        axis.grid(color="0.92")
        axis.set_title(f"({letter}) {TITLES[kind]}", loc="left")
        if own:
            axis.margins(x=0.06, y=0.04)
            if axis.get_yscale() == "log":
                axis.set_ylim(top=min(axis.get_ylim()[1], OVERFLOWN))
            mark_order(axis, (3, 2, 1))
            axis.legend(frameon=False, fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)
        else:
            say_empty(axis)
    return figure


def _curve(axis, own: Sequence[Row], text: str, order) -> dict[str, None]:
    """Points and slope of one scheme; returns the reasons met."""
    own = sorted(own, key=lambda row: row["dt"])
    style = look(own[0]["scheme"])
    counted = set(envelope(own)[0])
    octaves = {row["octave"] for row in own if row["dt"] in counted}
    reasons: dict[str, None] = {}
    axis.plot(column(own, "dt"), column(own, "error_rms"), lw=0.5, alpha=0.6, **style | {"marker": ""})
    axis.plot([], [], lw=1.3, ms=4.5, label=text, **style)
    for row in own:
        reason = row["left_out"] or ("" if row["octave"] in octaves else "its octave has one of these")
        fill = {} if not reason else {"mfc": "white", "mec": style["color"], "marker": REASONS[reason]}
        axis.plot(row["dt"], row["error_rms"], ms=4.0, mew=0.9, **style | {"linestyle": ""} | fill)
        if reason:
            reasons[reason] = None
    if np.isfinite(order.slope) and counted:
        x = np.array([min(counted), max(counted)])
        axis.plot(x, order.constant * x**order.slope, lw=1.5, **style | {"marker": ""})
    return reasons
