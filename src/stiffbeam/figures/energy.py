"""Picture of the study ``energy``: what each scheme loses over time, in contact and free, and in the end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..arrays import Array
from ..studies.energy import FIRST_ORDER
from ..studies.study import Records, Row
from . import column, found_rows, look, say_empty, shared_legend, short

PARTS = (("lost_in_contact", "in contact"), ("lost_free", "between impacts"))
FORM_NAMES = {"displacement": "displacement", "velocity-curvature": "velocity-curvature",
              "displacement" + FIRST_ORDER: "first order"}  # fmt: skip


def draw(records: Records) -> Figure:
    """Energies over time, and in the end their share of all the run has had: E_0 and the work put in."""
    rows = found_rows(records)
    runs: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        runs.setdefault((row["form"], row["scheme"]), []).append(row)
    forms = list(dict.fromkeys(form for form, _ in runs))
    main = forms[0] if forms else "displacement"
    figure = Figure(figsize=(11.0, 8.2), layout="constrained")
    figure.suptitle(f"{records.case.name}: the energy that each scheme loses, in contact and between impacts")
    axes = figure.subplot_mosaic([["contact", "free"], ["bars", "bars"]], height_ratios=(1.0, 1.15))
    for (name, words), panel, letter in zip(PARTS, ("contact", "free"), "ab", strict=True):
        axis = axes[panel]
        for (form, scheme), own in runs.items():
            if form == main:
                style: dict[str, Any] = look(scheme) | {"marker": ""}
                label = "exact, to its horizon" if scheme == "exact" else short(scheme)
                (line,) = axis.plot(column(own, "t"), column(own, name), label=label, **style)
                line.set_linewidth(3.0 if scheme == "exact" else 1.3)
        axis.axhline(0.0, color="0.6", lw=0.7, zorder=0)
        axis.grid(color="0.92")
        axis.set(xlabel="time $t$", ylabel="energy lost so far")
        axis.set_title(f"({letter}) lost {words} ({FORM_NAMES.get(main, main)} form)", loc="left")
        if not rows:
            say_empty(axis)
    shared_legend(figure, 7)
    _bars(axes["bars"], runs)
    return figure


def _share(own: Sequence[Row], name: str) -> Array:
    """Per cent of E_0 + input; NaN where that is not positive."""
    had = column(own, "energy")[0] + column(own, "input")
    return 100.0 * column(own, name) / np.where(had > 0.0, had, np.nan)


def _bars(axis, runs: dict[tuple[str, str], list[Row]]) -> None:
    """The last share of every run, in contact and free side by side on either side of zero."""
    place, ticks, names = 0.0, [], []
    last_form = None
    for (form, scheme), own in runs.items():
        if scheme == "exact":
            continue
        if last_form not in (None, form):
            axis.axvline(place - 0.25, color="0.8", lw=0.8)
            place += 0.5
        end = own[-1]["t"]
        if form != last_form:
            axis.text(place - 0.5, 1.02, f"{FORM_NAMES.get(form, form)}, to t = {end:g}", fontsize=9, color="0.25",
                      transform=axis.get_xaxis_transform())  # fmt: skip
        last_form = form
        for k, ((name, words), colour, hatch) in enumerate(zip(PARTS, ("0.3", "0.75"), ("", "///"), strict=True)):
            height = _share(own, name)[-1]
            axis.bar(place + 0.4 * k - 0.2, height, 0.38, color=colour, hatch=hatch, edgecolor="white",
                     label=words if not ticks else None)  # fmt: skip
            if np.isfinite(height):
                axis.annotate(f"{round(height)}", (place + 0.4 * k - 0.2, height), (0, 2 if height > -0.5 else -10),
                              textcoords="offset points", ha="center", fontsize=8)  # fmt: skip
        ticks.append(place)
        names.append(short(scheme))
        place += 1.0
    axis.axhline(0.0, color="0.3", lw=0.8)
    axis.set_xticks(ticks, names, rotation=30, ha="right", fontsize=8.5)
    axis.set(ylabel="per cent of all energy had")
    axis.set_title("(c) lost in the end, of initial energy and work put in", loc="left", pad=20)
    axis.margins(y=0.12)
    if ticks:
        axis.legend(frameon=False, fontsize=9, loc="lower right", bbox_to_anchor=(1.0, 1.06), ncols=2)
    else:
        say_empty(axis)
