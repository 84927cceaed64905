"""Picture of the study ``errata``: the error of what is printed beside that of what is right."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

from ..schemes import SCHEMES, make
from ..schemes.errata import forms_of
from ..studies.errata import groups
from ..studies.study import Records, Row
from . import MARKERS, column, dashed, found_rows, log_scale, look, mark_order, say_empty, short

EXTRAPOLATED = "extrapolated contact"
ERRATA = [erratum for name in SCHEMES for erratum in forms_of(make(name))]


def draw(records: Records) -> Figure:
    """(a) errors without contact; (b) to (d) the factor by which each reading changes the error."""
    rows = found_rows(records)
    refused = {key: len(own) for key, own in groups(records.failures).items()}
    found = groups(rows)
    smooth = {key: own for key, own in found.items() if key[2] == "smooth"}
    printed = {key: own for key, own in found.items() if key[2] == "contact" and key[1] != EXTRAPOLATED}
    predicted = {key: own for key, own in found.items() if key[2] == "contact" and key[1] == EXTRAPOLATED}
    figure = Figure(figsize=(11.0, 8.6), layout="constrained")
    figure.suptitle(f"{records.case.name}: what misprints and the linearised contact cost")
    axes = figure.subplots(2, 2).ravel()
    _errors(axes[0], smooth)
    axes[0].set_title("(a) without contact: right (full) and as printed (dashed)", loc="left")
    panels = (
        (smooth, "(b) without contact: error as printed over right"),
        (printed, "(c) first impacts: error as printed over right"),
        (predicted, "(d) first impacts: error extrapolated over implicit"),
    )
    for axis, (own, title) in zip(axes[1:], panels, strict=True):
        _factors(axis, own, refused)
        axis.set_title(title, loc="left")
    for axis in axes:
        axis.grid(color="0.92")
        log_scale(axis, y=axis is axes[0] or axis.get_ylim()[1] > 5.0)
        axis.set(xlabel=r"step $\Delta t$")
        if axis.get_legend_handles_labels()[0]:
            axis.legend(frameon=False, fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2,
                        columnspacing=1.0)  # fmt: skip
        else:
            say_empty(axis, "no such reading")
    if smooth:
        mark_order(axes[0], (3, 2, 1))
    return figure


def _name(scheme: str, reading: str) -> str:
    inner = "" if reading == EXTRAPOLATED else " " + reading.removeprefix("printed(").removesuffix(")")
    return short(scheme) + inner


def _printed(reading: str) -> dict[str, Any]:
    """Hollow, with dashes and marker of the erratum, the same in every panel."""
    i = ERRATA.index(reading.removeprefix("printed(").removesuffix(")"))
    return {"mfc": "white", "linestyle": dashed(1 + i), "marker": MARKERS[i % len(MARKERS)]}


def _errors(axis, found: dict[tuple[str, str, str], list[Row]]) -> None:
    for i, ((scheme, reading, _), own) in enumerate(found.items()):
        style = look(scheme) | {"ms": 4.5, "lw": 1.1}
        dt = column(own, "dt")
        if scheme not in {key[0] for key in list(found)[:i]}:
            axis.plot(dt, column(own, "error"), label=f"{short(scheme)}, right", **style | {"linestyle": "-"})
        axis.plot(dt, column(own, "error_printed"), label=_name(scheme, reading), **style | _printed(reading))
    axis.set_ylabel("tip error, rms, relative")


def _factors(axis, found: dict[tuple[str, str, str], list[Row]], refused: dict[tuple[str, str, str], int]) -> None:
    for (scheme, reading, kind), own in found.items():
        style = look(scheme) | {"ms": 4.5, "lw": 1.1}
        if reading != EXTRAPOLATED:
            style |= _printed(reading)
        missing = refused.get((scheme, reading, kind), 0)
        text = _name(scheme, reading) + (f" ({missing} steps failed)" if missing else "")
        axis.plot(column(own, "dt"), column(own, "error_printed") / column(own, "error"), label=text, **style)
    for (scheme, reading, kind), missing in refused.items():
        same = found and (kind, reading == EXTRAPOLATED) in {(key[2], key[1] == EXTRAPOLATED) for key in found}
        if same and (scheme, reading, kind) not in found:
            axis.plot([], [], "x", color=look(scheme)["color"], label=f"{_name(scheme, reading)}: all {missing} failed")
    axis.axhline(1.0, color="0.3", lw=0.9, ls=":")
    axis.set_ylabel("times the error")
