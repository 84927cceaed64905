"""Line styles of the methods, axes, legends and titles.

The functions that draw load matplotlib.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path
from string import ascii_letters
from typing import TYPE_CHECKING, Any
from zlib import crc32

import numpy as np

from ..basics.storage import write_whole
from ..measures.report import point_name, short
from ..references.registry import REFERENCES
from ..schemes import RIGID, SCHEMES

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.axis import XAxis, YAxis
    from matplotlib.figure import Figure

    from ..files.cases import Case
    from ..model.problem import BeamProblem
else:
    Axes = Figure = Any  # names for annotations, also of the modules that import them from here


# Okabe and Ito's palette, distinguishable with any colour vision, and two more; black is the exact motion.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#5E3C99", "#7F5A1D")
OWN = ("#117733", "#B0003A", "#1B1F6B", "#FF5FA2")  # of classes and functions of one's own, none of a scheme here
# Thirteen, one for each scheme of the package, so that they can be told apart in grey.
DASHES = (
    (), (5, 1.5), (1.5, 1.2), (6, 1.5, 1.5, 1.5), (3, 1), (8, 2), (1, 3), (6, 1.5, 1.5, 1.5, 1.5, 1.5),
    (4, 4), (10, 2, 3, 2), (3, 1, 1, 1, 1, 1, 1, 1), (8, 5), (3, 3, 1, 3),
)  # fmt: skip
SOLVERS = ("0.25", "#999933", "#882255", "#44AA99", "#AA4499", "#332288")  # muted, none of a scheme
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
EXACT = ("exact", "multiprecision", "reference")  # what stands for the exact motion
# Colour, dashes and marker of the schemes that state them; any other name takes one of the free pairs.
LOOKS = {name: scheme.look for name, scheme in (SCHEMES | RIGID).items()}
_TAKEN = {(dashes, marker) for _, dashes, marker in LOOKS.values()}
_FREE = [(d, m) for d in range(len(DASHES)) for m in range(len(MARKERS)) if (d, m) not in _TAKEN]
_OTHERS: dict[str, int] = {}  # number of each other name, as this process has drawn them


def look(label: str) -> dict[str, Any]:
    """Colour, dashes and marker of a method, the same in every picture; arguments of ``Axes.plot``.

    The exact motion is black. A scheme has its colour by name; other parameters than its default's change
    dashes and marker. The Nyström form of SDIRK-OS is the same scheme and looks the same. Adaptive solvers
    have muted colours. A user's scheme has the next look that no other label has in this process.
    """
    if label in EXACT:
        return {"color": "black", "linestyle": "-", "marker": "*"}
    if label in REFERENCES:
        k = REFERENCES[label].look
        return _style(SOLVERS[k % len(SOLVERS)], k, k)
    name = re.split(r"[(.@]", label)[0]
    if name not in LOOKS:  # a user's class is named after its module
        k = _OTHERS.setdefault(label, len(_OTHERS))
        return _style(OWN[k % len(OWN)], *_FREE[8 * k % len(_FREE)])  # dashes and marker both change with k
    colour, dashes, marker = LOOKS[name]
    pairs = len(DASHES) * len(MARKERS)  # coprime, so that every shift is another pair
    other = 0 if short(label) == short(name) else 1 + crc32(short(label).encode()) % (pairs - 1)
    return _style(COLOURS[colour], dashes + other, marker + other)


def _style(colour: str, dashes: int, marker: int) -> dict[str, Any]:
    return {"color": colour, "linestyle": dashed(dashes), "marker": MARKERS[marker % len(MARKERS)]}


def dashed(i: int) -> Any:
    """The i-th line style of the palette."""
    dashes = DASHES[i % len(DASHES)]
    return (0, dashes) if dashes else "-"


WIDE = 34  # letters in an entry of a legend below a panel from which on it fills a line
FLAT = 0.07  # share of the axis that the steepest triangle of mark_order rises at least


def new_figure(height: float, title: str = "", width: float = 11.0) -> Figure:
    """An empty picture, in inches, that makes room for what is put around its axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    # IPython learns to draw bare figures only from pyplot, which this package does not load.
    figure._repr_png_ = partial(rendered, figure, "png", 100)  # type: ignore[attr-defined]
    if title:
        figure.suptitle(title)
    return figure


def rendered(figure: Figure, kind: str, dpi: int) -> bytes:
    """The picture as the content of a file."""
    content = BytesIO()
    figure.savefig(content, format=kind, dpi=dpi)
    return content.getvalue()


def log_scale(axis: Axes, x: bool = True, y: bool = True) -> None:
    """Logarithmic axes wherever what is drawn so far holds anything positive."""
    if x and np.isfinite(axis.dataLim.minposx):
        axis.set_xscale("log", nonpositive="mask")
        _few_ticks(axis.xaxis, axis.dataLim.minposx, axis.dataLim.x1, 10.0)
    if y and np.isfinite(axis.dataLim.minposy):
        axis.set_yscale("log", nonpositive="mask")
        _few_ticks(axis.yaxis, axis.dataLim.minposy, axis.dataLim.y1, 50.0)


def _few_ticks(axis: XAxis | YAxis, low: float, high: float, most: float) -> None:
    """Over less than ``most``, ticks at 1, 2 and 5 only, over less than a hundred at 1 and 3: all nine would be written
    over each other. Numbers that need no power of ten have none."""
    from matplotlib.ticker import FuncFormatter, LogFormatterSciNotation, LogLocator, NullFormatter

    if 1.0 < high / low < 100.0:
        powers = LogFormatterSciNotation(labelOnlyBase=False, minor_thresholds=(np.inf, np.inf))
        plain = FuncFormatter(lambda x, _: f"{x:g}")
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < most else (1.0, 3.0)))
        axis.set_major_formatter(plain if low >= 1e-3 and high <= 1e4 else powers)
        axis.set_minor_formatter(NullFormatter())


def mark_order(axis: Axes, orders: Sequence[float], y: float = 0.05) -> None:
    """Triangles of slope p on a log-log axis, the first at the right, to hold lines against; p < 0 for lines that fall.

    y: of the base of the first one, as a share of the axis. They are wider where the axis spans so many decades that
    they would be flat. Call when the limits are final.
    """
    if (axis.get_xscale(), axis.get_yscale()) != ("log", "log"):
        return
    (left, right), (low, high) = np.log10(axis.get_xlim()), np.log10(axis.get_ylim())
    steepest = max(map(abs, orders)) * abs(right - left) / (high - low)
    width = min(max(0.09, FLAT / steepest), 0.7 / len(orders))
    run, x = width * abs(right - left), 0.96
    for order in orders:
        rise = order * run / (high - low)
        corners = np.array([[x - width, y], [x, y], [x, y + rise]])
        axis.plot(*corners[[0, 1, 2, 0]].T, transform=axis.transAxes, color="0.35", lw=0.8)
        axis.annotate(f"{abs(order):g}", (x, y + rise / 2), xycoords="axes fraction", xytext=(2, -3),
                      textcoords="offset points", fontsize=8, color="0.25")  # fmt: skip
        x -= width + 0.05


def signed_log(axis: Axes, threshold: float) -> None:
    """A logarithmic y axis; where some of what is drawn lies below ``threshold``, linear around zero."""
    threshold = 10.0 ** np.floor(np.log10(threshold))  # a power of ten, where a tick is
    low, high = axis.dataLim.y0, axis.dataLim.y1
    if low > threshold:
        log_scale(axis, x=False)
        return
    decades = np.log10(max(-low, high, threshold) / threshold)
    # The linear part is as wide as a twelfth of all decades, so that the ticks at its ends stay apart from zero's.
    axis.set_yscale("symlog", linthresh=threshold, linscale=max(1.0, decades / 6.0))
    axis.set_ylim(min(2.0 * low, -threshold), max(2.0 * high, threshold))
    locator: Any = axis.yaxis.get_major_locator()
    locator.set_params(numticks=7)


def say_empty(axis: Axes, text: str = "no point could be evaluated") -> None:
    """Text in a panel without curves."""
    axis.text(0.5, 0.5, text, transform=axis.transAxes, ha="center", va="center", color="0.35", in_layout=False)
    axis.set(xticks=[], yticks=[])


def legend_entries(axes: Iterable[Axes]) -> dict[str, Any]:
    """Entries of a legend by their text, each text once."""
    entries: dict[str, Any] = {}
    for axis in axes:
        for handle, text in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(text, handle)
    return entries


def panel_legend(axis: Axes) -> None:
    """The legend of one panel below it, with every text once."""
    if entries := legend_entries([axis]):
        columns = 2 if max(map(len, entries)) < WIDE else 1
        axis.legend(entries.values(), entries.keys(), frameon=False, fontsize=8.5, loc="upper center",
                    bbox_to_anchor=(0.5, -0.14), ncols=columns, columnspacing=1.0)  # fmt: skip


def shared_legend(figure: Figure, columns: int = 4, axes: Iterable[Axes] | None = None) -> None:
    """One legend below all panels, with every label of ``axes`` once, of all of them by default."""
    entries = legend_entries(figure.axes if axes is None else axes)
    for number in range(columns if entries else 0, 0, -1):  # as many columns as the picture is wide
        legend = figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=number,
                               frameon=False, fontsize=9, handlelength=3.2)  # fmt: skip
        if number == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


def heading(case: Case, text: str) -> str:
    """A picture's title: the case and ``text``."""
    name = case.name.replace("$", r"\$")  # no formula of matplotlib's
    return f"{name}: {text}"


def tip_text(problem: BeamProblem | None, quantity: str = "", t: str = "t") -> str:
    """Name, quantity and symbol of the observed displacement: u(L, t) of a beam, mid-span u(L/2, t) where its end is
    held, u(t) of matrices."""
    name = point_name(problem)
    place = {"": "", "tip": "L, ", "mid-span": "L/2, "}[name]
    return " ".join(filter(None, [name, quantity, f"$u({place}{t})$"]))


def save_figure(figure: Figure, file: str | Path) -> Path:
    """Write PNG (200 dpi) or SVG by the file's ending."""
    return write_whole(file, rendered(figure, Path(file).suffix.removeprefix("."), 200))


LINE = 118  # letters in a line of a title


def lines(axis: Axes, table: pandas.DataFrame, x: str, y: str, by: str, **style: Any) -> None:
    """Draw column y over column x, a curve in its look for each method that column ``by`` names."""
    for label, rows in table.groupby(by, sort=False):
        looks: Any = {"lw": 1.1, "ms": 4.5} | look(str(label)) | style
        axis.plot(rows[x], rows[y], label=short(str(label)), **looks)


def name_lines(axis: Axes, labels: Sequence[str]) -> None:
    """Give each method a line of its own on the vertical axis, the first on top."""
    axis.set_yticks(range(len(labels)), labels, fontsize=8.5)
    axis.set_ylim(len(labels) - 0.4, -0.6)


def style_of(i: int, j: int = 0) -> dict[str, Any]:
    """Line style of a curve that belongs to no method: the first number gives the colour, the second the dashes, both
    the marker."""
    return _style(COLOURS[i % len(COLOURS)], j, i + 3 * j)


def finish(figure: Figure, title: str) -> None:
    """Letters, grids and ticks of all panels, and the title in lines above them.

    A panel without data states that no point could be evaluated, or the text that its study has put there.
    """
    from matplotlib.ticker import AutoLocator

    figure.suptitle(textwrap.fill(title, LINE, break_on_hyphens=False), fontsize=11)
    panels = [axis for axis in figure.axes if axis.get_label() != "<colorbar>"]
    for letter, axis in zip(ascii_letters, panels, strict=False):
        name = f"({letter}) " * (len(panels) > 1) + axis.get_title(loc="center")
        axis.set_title(name, loc="left", fontsize=10.5)
        axis.set_title("", loc="center")
        if not _drawn(axis):
            axis.set(xlabel="", ylabel="")
            if not axis.texts:
                say_empty(axis)
            continue
        axis.grid(color="0.92")
        axis.set_axisbelow(True)
        if isinstance(axis.xaxis.get_major_locator(), AutoLocator):  # more ticks would overlap
            axis.locator_params(axis="x", nbins=5)


def _drawn(axis: Axes) -> bool:
    """True for a panel that shows a finite number, lines through the whole panel left out."""
    lines = [line for line in axis.lines if line.get_transform() == axis.transData]
    return bool(axis.collections or axis.images or axis.patches) or any(
        np.any(np.isfinite(x.get_xydata()).all(1)) for x in lines
    )
