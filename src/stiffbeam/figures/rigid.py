"""Picture of the study ``rigid``: the distance from rigid stops as the compliant ones grow stiffer."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..measures.regression import observed_order
from ..studies.rigid import same_impacts
from ..studies.study import Records
from . import COLOURS, MARKERS, column, dashed, found_rows, log_scale, say_empty

PANELS = (
    ("error of the tip", "relative to the largest displacement",
     (("tip_error", "largest"), ("tip_error_rms", "rms"))),
    ("error of the impacts", "time; share of the impulse",
     (("impact_time_error", "largest error in time"), ("impulse_error", "relative error of the first impulse"))),
    ("what the stop feels", "force; displacement",
     (("peak_force", "peak force"), ("penetration", "largest penetration"))),
)  # fmt: skip


def draw(records: Records) -> Figure:
    """Hollow markers: as yet another number of impacts than rigid stops have. Lines: fits to the others."""
    rows = sorted(found_rows(records), key=lambda row: row["kappa"])
    near = same_impacts(rows)
    figure = Figure(figsize=(11.0, 4.9), layout="constrained")
    impacts = f"first {rows[0]['rigid_impacts']} impacts, " if rows else ""
    figure.suptitle(f"{records.case.name}, {impacts}towards rigid stops: slopes in 1/κ; theory for the tip is 1/2")
    stops = records.case.problem.stops
    for axis, (title, unit, names), letter in zip(figure.subplots(1, 3), PANELS, "abc", strict=True):
        for i, (name, words) in enumerate(names):
            style = {"color": COLOURS[i], "marker": MARKERS[i], "ms": 5, "ls": ""}
            positive = [row for row in rows if row[name] > 0.0]  # false for NaN
            other = [row for row in positive if row not in near]
            own = [row for row in positive if row in near]
            axis.plot(column(other, "kappa"), column(other, name), mfc="white", **style)
            order = observed_order(1.0 / column(own, "kappa"), column(own, name))
            text = f"{words}: {order}" if np.isfinite(order.slope) else words
            axis.plot(column(own, "kappa"), column(own, name), label=text, **style)
            if np.isfinite(order.slope):
                kappa = column(own, "kappa")[[0, -1]]
                axis.plot(kappa, order.constant * kappa**-order.slope, color=COLOURS[i], lw=1.0, ls=dashed(i))
        if rows and len(near) < len(rows):
            axis.plot([], [], "o", ms=5, mfc="white", mec="0.35", label="fewer or more impacts than rigid")
        if stops is not None:
            axis.axvline(stops.stiffness, color="0.55", lw=0.9, ls=":", label="κ of the case")
        log_scale(axis)
        axis.set(xlabel="stiffness of the stops κ", ylabel=unit)
        axis.grid(color="0.92")
        axis.set_title(f"({letter}) {title}", loc="left")
        axis.legend(frameon=False, fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, -0.16))
        if not rows:
            say_empty(axis)
    return figure
