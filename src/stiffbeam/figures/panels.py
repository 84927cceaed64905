"""What several pictures need: axes, scales, legends, numbers of rows. matplotlib is loaded by what draws."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.whole_file import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

    from ..files.cases import Case
    from ..model.problem import BeamProblem

FLAT = 0.07  # share of the axis that the steepest triangle of mark_order rises at least


def new_figure(height: float, title: str = "", width: float = 11.0) -> Figure:
    """An empty picture, in inches, that makes room for what is put around its axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    if title:
        figure.suptitle(title)
    return figure


def numeric(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows with NaN in the place of None."""
    return [{key: np.nan if value is None else value for key, value in row.items()} for row in rows]


def column(rows: Iterable[Mapping[str, Any]], name: str) -> Array:
    """One entry of every row as numbers; NaN stands for what is missing."""
    return np.array([row.get(name, np.nan) for row in rows], float)


def log_scale(axis: Axes, x: bool = True, y: bool = True) -> None:
    """Logarithmic axes wherever what is drawn so far holds anything positive."""
    if x and np.isfinite(axis.dataLim.minposx):
        axis.set_xscale("log", nonpositive="mask")
        _few_ticks(axis.xaxis, axis.dataLim.x1 / axis.dataLim.minposx, 10.0)
    if y and np.isfinite(axis.dataLim.minposy):
        axis.set_yscale("log", nonpositive="mask")
        _few_ticks(axis.yaxis, axis.dataLim.y1 / axis.dataLim.minposy, 50.0)


def _few_ticks(axis: Axis, span: float, most: float) -> None:
    """Over less than ``most``, ticks at 1, 2 and 5 only: all nine would be written over each other."""
    from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter

    if 1.0 < span < most:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(LogFormatterSciNotation(labelOnlyBase=False, minor_thresholds=(np.inf, np.inf)))
        axis.set_minor_formatter(NullFormatter())


def mark_order(axis: Axes, orders: Iterable[float], x: float = 0.96, y: float = 0.05, width: float = 0.09) -> None:
    """Triangles of slope p on a log-log axis, the first at the right, to hold lines against; p < 0 for lines that fall.

    x, y: where the first one's upright meets its base, as shares of the axis; width: that of one, more where the axis
    spans so many decades that it would be flat. Call when the limits are final.
    """
    if (axis.get_xscale(), axis.get_yscale()) != ("log", "log"):
        return
    (left, right), (low, high) = np.log10(axis.get_xlim()), np.log10(axis.get_ylim())
    orders = list(orders)
    steepest = max(map(abs, orders)) * abs(right - left) / (high - low)
    width = min(max(width, FLAT / steepest), 0.7 / len(orders))
    run = width * abs(right - left)
    for order in orders:
        rise = order * run / (high - low)
        corners = np.array([[x - width, y], [x, y], [x, y + rise]])
        axis.plot(*corners[[0, 1, 2, 0]].T, transform=axis.transAxes, color="0.35", lw=0.8)
        axis.annotate(f"{abs(order):g}", (x, y + rise / 2), xycoords="axes fraction", xytext=(2, -3),
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
    from matplotlib.ticker import FixedLocator, NullLocator

    low, high = float(np.min(known)), float(np.max(known))
    down, up = (max(1.0, np.log10(max(abs(end), threshold) / threshold)) for end in (min(low, 0.0), high))
    # The linear part is as wide as a twelfth of all decades, so that the ticks at its ends stay apart from zero's.
    axis.set_yscale("symlog", linthresh=threshold, linscale=max(1.0, (down + up) / 12.0))
    axis.set_ylim(min(2.0 * low, -threshold), max(2.0 * high, threshold))
    ends = (int(np.floor(np.log10(threshold))), int(np.ceil(np.log10(max(-low, high, threshold)))))
    powers = 10.0 ** np.arange(ends[0] + 1, ends[1] + 1, max(1, (ends[1] - ends[0]) // 6))
    axis.yaxis.set_major_locator(FixedLocator([*-powers[::-1], 0.0, *powers]))
    axis.yaxis.set_minor_locator(NullLocator())


def say_empty(axis: Axes, text: str = "no point could be evaluated") -> None:
    """Words in the place of curves that do not exist."""
    axis.text(0.5, 0.5, text, transform=axis.transAxes, ha="center", va="center", color="0.35", in_layout=False)
    axis.set(xticks=[], yticks=[])


def legend_entries(axes: Iterable[Axes], words: Callable[[str], str] = str) -> dict[str, Any]:
    """What a legend shows by its text, each text once; what one panel draws under one text is one entry."""
    entries: dict[str, Any] = {}
    for axis in axes:
        own: dict[str, list[Any]] = {}
        for handle, text in zip(*axis.get_legend_handles_labels(), strict=True):
            own.setdefault(words(text), []).append(handle)
        for text, handles in own.items():
            entries.setdefault(text, handles[0] if len(handles) == 1 else tuple(handles))
    return entries


def shared_legend(
    figure: Figure, columns: int = 4, axes: Iterable[Axes] | None = None, words: Callable[[str], str] = str
) -> None:
    """One legend below all panels, with every label of ``axes`` once, of all of them by default."""
    entries = legend_entries(figure.axes if axes is None else axes, words)
    if entries:
        figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=columns, frameon=False,
                      fontsize=9, handlelength=3.2)  # fmt: skip


def heading(case: Case, text: str) -> str:
    """A picture's title: the case, the note on units where its axes name none, and ``text``."""
    note = case.units.note
    name = case.name.replace("$", r"\$")  # no formula of matplotlib's
    return f"{name}{f' ({note})' if note else ''}: {text}"


def tip_symbol(problem: BeamProblem | None, t: str = "t") -> str:
    """u(1, t) as in the paper, u(L, t) of a beam that is not of length 1, at L/2 where its end is held, u(t) of
    matrices."""
    if problem is None:
        return f"$u({t})$"
    end = "1" if problem.length == 1.0 and not problem.units.known else "L"
    return f"$u({end}, {t})$" if tip_name(problem) == "tip" else f"$u({end}/2, {t})$"


def tip_name(problem: BeamProblem | None) -> str:
    """What is observed: the tip, or the middle of a beam whose end is held."""
    return "tip" if problem is None or problem.ends[1] == "free" else "mid-span"


def save_figure(figure: Figure, file: str | Path) -> Path:
    """Write PNG (200 dpi) or SVG by the file's ending."""
    content = BytesIO()
    figure.savefig(content, format=Path(file).suffix.removeprefix("."), dpi=200)
    return write_whole(file, content.getvalue())
