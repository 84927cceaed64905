"""Pictures: one palette, one look for each method, one way to write a file, one module per kind of picture."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zlib import crc32

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter

from ..arrays import Array
from ..cases import parse_run
from ..schemes import SCHEMES, make
from ..solvers import METHODS
from ..validation import InputError

if TYPE_CHECKING:
    from ..studies.study import Records, Row

# Okabe and Ito's palette, distinguishable with any colour vision; black is the reference.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES = ((), (5, 1.5), (1.5, 1.2), (6, 1.5, 1.5, 1.5), (3, 1), (8, 2))
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
TRUTH = ("exact", "true")
_SHORT = {
    "bdf2": "BDF2", "sdirk": "SDIRK", "hht": "HHT", "generalised-alpha": "gen.-α", "bathe": "Bathe", "theta": "θ",
    "cvode": "CVODE BDF", "cvode-adams": "CVODE Adams", "ida": "IDA", "dop853": "DOP853", "radau": "Radau",
    "kvaerno3": "Kvaerno3", "kvaerno5": "Kvaerno5",
}  # fmt: skip


def look(label: str) -> dict[str, Any]:
    """Colour, dashes and marker of a method, the same in every picture; arguments of ``Axes.plot``.

    The truth is black. A scheme has its colour by name; other parameters than its default's change dashes
    and marker. The Nyström form of SDIRK-OS is the same scheme and looks the same. Other solvers are grey,
    a user's own scheme has the colour that its label falls on.
    """
    if label in TRUTH:
        return {"color": "black", "linestyle": "-", "marker": "*"}
    scheme = _scheme(label)
    if scheme is None:
        k = METHODS.index(label) if label in METHODS else crc32(label.encode())
        colours = ("0.6", "0.3") if label in METHODS else COLOURS
        return {"color": colours[k % len(colours)], "linestyle": dashed(k), "marker": MARKERS[k % len(MARKERS)]}
    i = list(SCHEMES).index(scheme.name)
    pairs = len(DASHES) * len(MARKERS)  # coprime, so that every shift is another pair
    other = 0 if short(label) == short(scheme.name) else 1 + crc32(short(label).encode()) % (pairs - 1)
    return {
        "color": COLOURS[i % len(COLOURS)],
        "linestyle": dashed(i + i // len(COLOURS) + other),
        "marker": MARKERS[(i + other) % len(MARKERS)],
    }


def dashed(i: int) -> Any:
    """The i-th line style of the palette."""
    dashes = DASHES[i % len(DASHES)]
    return (0, dashes) if dashes else "-"


def short(label: str) -> str:
    """A method's name for a legend: ``sdirk(gamma=0.4359, nystrom=true)`` is SDIRK(0.4359)."""
    scheme = _scheme(label)
    if scheme is None:
        return _SHORT.get(label, label)
    values = [f"{v:.4g}" for v in scheme.parameters.values() if not isinstance(v, bool)]
    name = _SHORT.get(scheme.name, scheme.name) + (f"({', '.join(values)})" if values else "")
    return f"{name} printed({scheme.erratum})" if scheme.erratum else name


def _scheme(label: str):
    try:
        return parse_run(label)[0]
    except InputError:
        return None


def default_label(name: str) -> str:
    """The label of a registered scheme with its default parameters."""
    return str(make(name))


def found_rows(records: Records) -> list[Row]:
    """The rows of the points that could be evaluated, NaN in the place of None."""
    found = (row for row in records.rows if "failed" not in row)
    return [{key: np.nan if value is None else value for key, value in row.items()} for row in found]


def column(rows: Iterable[Mapping[str, Any]], name: str) -> Array:
    """One entry of every row as numbers; NaN stands for what is missing."""
    return np.array([row.get(name, np.nan) for row in rows], float)


def log_scale(axis: Axes, x: bool = True, y: bool = True) -> None:
    """Logarithmic axes wherever what is drawn so far holds anything positive."""
    if x and np.isfinite(axis.dataLim.minposx):
        axis.set_xscale("log")
        _few_ticks(axis.xaxis, axis.dataLim.x1 / axis.dataLim.minposx)
    if y and np.isfinite(axis.dataLim.minposy):
        axis.set_yscale("log")
        _few_ticks(axis.yaxis, axis.dataLim.y1 / axis.dataLim.minposy)


def _few_ticks(axis, span: float) -> None:
    """Over less than a decade, ticks at 1, 2 and 5 only: all nine would be written over each other."""
    if 1.0 < span < 10.0:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(LogFormatterSciNotation(labelOnlyBase=False, minor_thresholds=(np.inf, np.inf)))
        axis.set_minor_formatter(NullFormatter())


def mark_order(axis: Axes, orders: Iterable[float], x: float = 0.96, y: float = 0.05, width: float = 0.09) -> None:
    """Triangles of slope p in the lower right corner of a log-log axis, to hold lines against.

    x, y: the corner nearest to the axis' own, as shares of it. Call when the limits are final.
    """
    if (axis.get_xscale(), axis.get_yscale()) != ("log", "log"):
        return
    (left, right), (low, high) = np.log10(axis.get_xlim()), np.log10(axis.get_ylim())
    run = width * abs(right - left)
    for order in orders:
        rise = order * run / (high - low)
        corners = np.array([[x - width, y], [x, y], [x, y + rise]])
        axis.plot(*corners[[0, 1, 2, 0]].T, transform=axis.transAxes, color="0.35", lw=0.8)
        axis.annotate(f"{order:g}", (x, y + rise / 2), xycoords="axes fraction", xytext=(2, -3),
                      textcoords="offset points", fontsize=8, color="0.25")  # fmt: skip
        x -= width + 0.05


def signed_log(axis: Axes, values: Iterable[Array], threshold: float) -> None:
    """A logarithmic y axis for ``values``; where some lie below ``threshold``, linear around zero and no
    further down than they go."""
    known = np.concatenate([*values, np.zeros(0)])
    known = known[np.isfinite(known)]
    if not known.size or np.min(known) > threshold:
        log_scale(axis, x=False)
        return
    axis.set_yscale("symlog", linthresh=threshold)
    low, high = float(np.min(known)), float(np.max(known))
    axis.set_ylim(min(2.0 * low, -threshold), max(2.0 * high, threshold))


def say_empty(axis: Axes, text: str = "no point could be evaluated") -> None:
    """Words in the place of curves that do not exist."""
    axis.text(0.5, 0.5, text, transform=axis.transAxes, ha="center", va="center", color="0.35", in_layout=False)
    axis.set(xticks=[], yticks=[])


def shared_legend(figure: Figure, columns: int = 4) -> None:
    """One legend below all panels, with every label once, where it hides nothing."""
    entries: dict[str, Any] = {}
    for axis in figure.axes:
        for handle, text in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(text, handle)
    if entries:
        figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=columns, frameon=False,
                      fontsize=9, handlelength=3.2)  # fmt: skip


def save_figure(figure: Figure, file: str | Path) -> Path:
    """Write PNG (200 dpi) or SVG by the file's ending."""
    path = Path(file)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=200)
    return path
