"""Picture of the study ``space``: error over the width of a cell, against closed forms and a finer grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ..studies.space import orders
from ..studies.study import Records, Row
from . import COLOURS, MARKERS, column, dashed, found_rows, log_scale, mark_order, say_empty

NAMES = {"tip to the end of the first impacts": "tip, largest", "first impact's time": "time of the first",
         "first impact's peak force": "its peak force", "first impact's impulse": "its impulse",
         "tip response": "tip", "velocity-curvature": "vel.-curv."}  # fmt: skip


def draw(records: Records) -> Figure:
    """One panel for the frequencies, one for the driven tip, one for the contact in each form."""
    rows = found_rows(records)
    panels: list[tuple[str, list[Row]]] = []
    for kind, title in (("frequency", "natural frequencies, against the beam"), ("response", "driven tip, no contact")):
        panels.append((title, [row for row in rows if row["kind"] == kind]))
    contact = [row for row in rows if row["kind"] == "contact"]
    for form in dict.fromkeys(row["form"] for row in contact):
        title = f"first impacts, {NAMES.get(form, form)}, against {contact[0]['finest']} cells"
        panels.append((title, [row for row in contact if row["form"] == form]))
    panels = [panel for panel in panels if panel[1]] or [("nothing found", [])]
    figure = Figure(figsize=(11.0, 4.7 * (1 + (len(panels) > 2))), layout="constrained")
    figure.suptitle(f"{records.case.name}: convergence in space, slopes with their 95 % intervals")
    shape = (1 + (len(panels) > 2), min(2, len(panels)))
    axes = figure.subplots(*shape, squeeze=False).ravel()
    for axis, (title, own), letter in zip(axes, panels, "abcd", strict=False):
        _panel(axis, own)
        axis.set_title(f"({letter}) {title}", loc="left")
    for axis in axes[len(panels) :]:
        axis.remove()
    return figure


def _panel(axis, own: Sequence[Row]) -> None:
    """A curve for every quantity and form; the colour tells the quantity, dashes the form."""
    quantities = list(dict.fromkeys(row["quantity"] for row in own))
    forms = list(dict.fromkeys(row["form"] for row in own))
    for (quantity, form), order in orders(own).items():
        mine = [row for row in own if (row["quantity"], row["form"]) == (quantity, form) and row["error"] > 0.0]
        if not mine:
            continue
        i, j = quantities.index(quantity), forms.index(form)
        style = {"color": COLOURS[(i if len(quantities) > 1 else j) % len(COLOURS)], "marker": MARKERS[i + 3 * j],
                 "ms": 4.5, "lw": 1.0, "ls": dashed(j)}  # fmt: skip
        name = NAMES.get(quantity, quantity) + (f", {NAMES.get(form, form)}" if len(forms) > 1 else "")
        slope = str(order) if np.isfinite(order.slope) else "too few grids"
        axis.plot(1.0 / column(mine, "cells"), column(mine, "error"), label=f"{name}: {slope}", **style)
    log_scale(axis)
    axis.set(xlabel="width of a cell $h$", ylabel="error, relative")
    axis.grid(color="0.92", which="both")
    if not axis.get_lines():
        say_empty(axis)
        return
    cells = sorted({row["cells"] for row in own})
    axis.set_xticks([1.0 / n for n in cells], [f"1/{n}" for n in cells], fontsize=8.5)
    axis.minorticks_off()
    low, high = axis.get_ylim()
    axis.set_ylim(low * (low / high) ** 0.12, high)
    mark_order(axis, (2, 1))
    axis.legend(frameon=False, fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2,
                columnspacing=1.0)  # fmt: skip
