"""The error curves of Section 5.1: the whole error, and the part of it that is the scheme's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ..reproduce.no_contact import GRIDS, ErrorCurve
from .paper import STYLE, TRUTH

WINDOW = 0.1  # the largest error within this time is drawn: it crosses zero with every oscillation


def whole(curves: Sequence[ErrorCurve]) -> Figure:
    """|u - exact| at the tip against time."""
    return _draw(curves, "error")


def in_time(curves: Sequence[ErrorCurve]) -> Figure:
    """|u - the same discretisation solved exactly in time| against time."""
    return _draw([curve for curve in curves if curve.name not in GRIDS], "in_time")


def _draw(curves: Sequence[ErrorCurve], what: str) -> Figure:
    figure = Figure(figsize=(5.0, 3.9), layout="constrained")
    axis = figure.subplots()
    for curve in curves:
        t, size = _envelope(curve, getattr(curve, what))
        if curve.name in GRIDS:
            axis.plot(t, size, color=TRUTH[curve.form][0], lw=3.0, alpha=0.3, label=curve.name)
        else:
            colour, dashes = STYLE[curve.name]
            axis.plot(t, size, color=colour, dashes=dashes or (None, None), lw=1.2, label=curve.name)
    axis.set(yscale="log", xlabel="time $t$", ylabel="error at the tip over $X_1(1)$", xlim=(0.0, curves[0].t[-1]))
    figure.legend(loc="outside lower center", frameon=False, fontsize=8, ncols=4)
    return figure


def _envelope(curve: ErrorCurve, error):
    """The largest error of every window."""
    steps = max(1, round(WINDOW / float(curve.t[1] - curve.t[0])))
    blocks = len(error) // steps
    largest = np.max(error[: blocks * steps].reshape(blocks, steps), axis=1)
    return curve.t[: blocks * steps : steps] + 0.5 * WINDOW, largest
