"""Line styles of the methods, pictures declared as marks on named axes, and the function that draws them.

The functions that draw load matplotlib.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from math import lcm
from pathlib import Path
from string import ascii_letters
from typing import TYPE_CHECKING, Any, TypeVar
from zlib import crc32

import numpy as np

from ..basics.arrays import Array
from ..basics.storage import write_whole
from ..basics.units import Units
from ..measures.report import short
from ..references.registry import REFERENCES
from ..schemes import RIGID, SCHEMES
from ..schemes.labels import scheme_at_hand

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import XAxis, YAxis
    from matplotlib.figure import Figure

    from ..files.cases import Case
    from ..model.problem import BeamProblem


# Okabe and Ito's palette, distinguishable with any colour vision, and two more; black is the exact motion.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#5E3C99", "#7F5A1D")
# Thirteen, one for each scheme of the package, so that they can be told apart in grey.
DASHES = (
    (), (5, 1.5), (1.5, 1.2), (6, 1.5, 1.5, 1.5), (3, 1), (8, 2), (1, 3), (6, 1.5, 1.5, 1.5, 1.5, 1.5),
    (4, 4), (10, 2, 3, 2), (3, 1, 1, 1, 1, 1, 1, 1), (8, 5), (3, 3, 1, 3),
)  # fmt: skip
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
EXACT = ("exact", "multiprecision", "reference", "tangent flow")  # what stands for the exact motion
# Colour, dashes and marker of the schemes that state them; any other name takes one of the free pairs.
LOOKS = {name: scheme.look for name, scheme in (SCHEMES | RIGID).items() if scheme.look is not None}
_TAKEN = {(dashes, marker) for _, dashes, marker in LOOKS.values()}
_FREE = [(d, m) for d in range(len(DASHES)) for m in range(len(MARKERS)) if (d, m) not in _TAKEN]
_COLOUR_OF: dict[str, int] = {}  # of the other names that this process has drawn


def look(label: str) -> dict[str, Any]:
    """Colour, dashes and marker of a method, the same in every picture; arguments of ``Axes.plot``.

    The exact motion is black. A scheme has its colour by name; other parameters than its default's change
    dashes and marker. The Nyström form of SDIRK-OS is the same scheme and looks the same. Other solvers are
    grey. A user's scheme has a colour chosen by its label, or the next one that no other label has in this process.
    """
    if label in EXACT:
        return {"color": "black", "linestyle": "-", "marker": "*"}
    if label in REFERENCES:
        k = REFERENCES[label].look
        return {"color": ("0.6", "0.3")[k % 2], "linestyle": dashed(k), "marker": MARKERS[k % len(MARKERS)]}
    scheme = scheme_at_hand(label)
    # A class of one's own may have kept the name of the one it is made from.
    known = None if scheme is None or ":" in label else scheme.name
    colour, dashes, marker = look_of_name(known or label)
    other = 0
    if known and short(label) != short(known):
        pairs = len(DASHES) * len(MARKERS)  # coprime, so that every shift is another pair
        other = 1 + crc32(short(label).encode()) % (pairs - 1)
    return {
        "color": COLOURS[colour],
        "linestyle": dashed(dashes + other),
        "marker": MARKERS[(marker + other) % len(MARKERS)],
    }


def look_of_name(name: str) -> tuple[int, int, int]:
    """(colour, dashes, marker) of a scheme by its name: those in LOOKS, else by the name's checksum and _COLOUR_OF."""
    if name in LOOKS:
        return LOOKS[name]
    rest, colour = divmod(crc32(name.encode()), len(COLOURS))
    if name not in _COLOUR_OF:
        free = [c for c in range(len(COLOURS)) if c not in _COLOUR_OF.values()]
        _COLOUR_OF[name] = min(free or [colour], key=lambda c: (c - colour) % len(COLOURS))
    return _COLOUR_OF[name], *_FREE[rest % len(_FREE)]


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
    figure._repr_png_ = partial(png, figure)  # type: ignore[attr-defined]
    if title:
        figure.suptitle(title)
    return figure


def png(figure: Figure) -> bytes:
    """Return the picture as PNG of 100 dpi, as notebooks show it."""
    content = BytesIO()
    figure.savefig(content, format="png", dpi=100)
    return content.getvalue()


def numeric(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows with NaN instead of None."""
    return list(map(with_nan, rows))


def with_nan(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row with NaN instead of None."""
    return {key: np.nan if value is None else value for key, value in row.items()}


def column(rows: Iterable[Mapping[str, Any]], name: str) -> Array:
    """One entry of every row as numbers; NaN stands for what is missing."""
    return np.fromiter((np.nan if (value := row.get(name)) is None else value for row in rows), float)


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
    """Text in a panel without curves."""
    axis.text(0.5, 0.5, text, transform=axis.transAxes, ha="center", va="center", color="0.35", in_layout=False)
    axis.set(xticks=[], yticks=[])


def legend_entries(axes: Iterable[Axes], words: Callable[[str], str] = str) -> dict[str, Any]:
    """Entries of a legend by their text, each text once; curves of one panel with one text are one entry."""
    entries: dict[str, Any] = {}
    for axis in axes:
        by_words: dict[str, list[Any]] = {}
        for handle, text in zip(*axis.get_legend_handles_labels(), strict=True):
            by_words.setdefault(words(text), []).append(handle)
        for text, handles in by_words.items():
            entries.setdefault(text, handles[0] if len(handles) == 1 else tuple(handles))
    return entries


def panel_legend(axis: Axes, words: Callable[[str], str] = str, below: bool = False) -> None:
    """The legend of one panel, with every text once, inside it or ``below`` it."""
    if entries := legend_entries([axis], words):
        columns = 2 if max(map(len, entries)) < WIDE else 1
        place: Any = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "ncols": columns, "columnspacing": 1.0}
        axis.legend(entries.values(), entries.keys(), frameon=False, fontsize=8.5, **place if below else {})


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


def in_lines(title: str, width: int) -> str:
    """A title in lines of at most ``width`` letters, none of which begins with the % of a number or an equals sign."""
    held = title.replace(" = ", "\u00a0=\u00a0").replace(" %", "\u00a0%")
    return textwrap.fill(held, width, break_on_hyphens=False).replace("\u00a0", " ")


def tip_symbol(problem: BeamProblem | None, t: str = "t") -> str:
    """u(1, t) as in the paper, u(L, t) of a beam that is not of length 1, at L/2 where its end is held, u(t) of
    matrices."""
    if problem is None:
        return f"$u({t})$"
    end = "1" if problem.length == 1.0 and not problem.units.known else "L"
    return f"$u({end}, {t})$" if tip_name(problem) == "tip" else f"$u({end}/2, {t})$"


def tip_name(problem: BeamProblem | None) -> str:
    """Name of the observed point: the tip, or the middle of a beam whose end is held."""
    return "tip" if problem is None or problem.ends[1] == "free" else "mid-span"


def save_figure(figure: Figure, file: str | Path) -> Path:
    """Write PNG (200 dpi) or SVG by the file's ending."""
    content = BytesIO()
    figure.savefig(content, format=Path(file).suffix.removeprefix("."), dpi=200)
    return write_whole(file, content.getvalue())


Row = TypeVar("Row", bound=Mapping[str, Any])
LINE = 118  # letters in a line of a title
LOG_RANGE = 30.0  # ratio of the values of a map from which on its colours are logarithmic
NONE = np.zeros(0)


@dataclass(frozen=True)
class Axis:
    """Quantity, unit and scale along an axis.

    quantity: names its unit, see ``Units.of``. scale: "linear", "log", or "signed log", which is linear below
    ``threshold``, by default 1e-3 of the largest value. limits: None where the values decide. cap: the
    largest value to which they decide. names: the categories
    0, 1, ... of a vertical axis, the first on top. ticks: their texts by value.
    """

    label: str = ""
    quantity: str = ""
    scale: str = "linear"
    limits: tuple[float | None, float | None] = (None, None)
    threshold: float = 0.0
    cap: float = np.inf
    names: Sequence[str] = ()
    ticks: Mapping[float, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Curve:
    """Points (x, y), joined where ``look``, arguments of ``Axes.plot``, has a line."""

    x: Any
    y: Any
    label: str = ""
    look: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def over(
        cls, rows: Iterable[Mapping[str, Any]], x: str, y: str, label: str = "", look: dict[str, Any] | None = None
    ) -> Curve:
        """Return the curve of column y over column x."""
        rows = rows if isinstance(rows, Sequence) else list(rows)
        return cls(column(rows, x), column(rows, y), label, look or {})

    @property
    def values(self) -> Array:
        """The values along y that are drawn."""
        return np.where(np.isfinite(np.asarray(self.x, float)), np.asarray(self.y, float), np.nan)

    def draw(self, axis: Axes) -> None:
        """Draw it."""
        style: dict[str, Any] = {"lw": 1.1, "ms": 4.5, **self.look}
        axis.plot(self.x, self.y, label=self.label or None, **style)


@dataclass(frozen=True)
class Ranges:
    """Horizontal lines from ``low`` to ``high`` at heights ``at``."""

    at: Any
    low: Any
    high: Any
    label: str = ""
    look: dict[str, Any] = field(default_factory=dict)

    @property
    def values(self) -> Array:
        """The values along y that are drawn."""
        return np.asarray(self.at, float)

    def draw(self, axis: Axes) -> None:
        """Draw it."""
        axis.hlines(self.at, self.low, self.high, label=self.label, **self.look)


@dataclass(frozen=True)
class Level:
    """A horizontal or vertical line through the whole panel. It is hidden if the panel has no data."""

    value: float
    label: str = ""
    of: str = "y"
    look: dict[str, Any] = field(default_factory=dict)
    values = NONE

    def draw(self, axis: Axes) -> None:
        """Draw it."""
        if np.isfinite(self.value):
            style: dict[str, Any] = {"color": "0.5", "lw": 0.9, "ls": ":", "zorder": 1.2, **self.look}
            (axis.axhline if self.of == "y" else axis.axvline)(self.value, label=self.label or None, **style)


@dataclass(frozen=True)
class Band:
    """The area between ``low`` and ``high``, over ``x`` or right through the panel."""

    low: Any
    high: Any
    x: Any = None
    label: str = ""

    @property
    def values(self) -> Array:
        """The values along y that are drawn."""
        return NONE if self.x is None else np.append(self.low, self.high).astype(float)

    def draw(self, axis: Axes) -> None:
        """Draw it."""
        style: dict[str, Any] = {"color": "0.82", "lw": 0, "zorder": 0, "label": self.label or None}
        if self.x is not None:
            axis.fill_between(self.x, self.low, self.high, **style)
        elif np.isfinite(self.low) and np.isfinite(self.high):
            axis.axhspan(self.low, self.high, **style)


@dataclass(frozen=True)
class Note:
    """Text at (x, y), in data coordinates or, as named by "x", "y" or "xy", in shares of the panel."""

    text: str
    x: float
    y: float
    shares: str = ""
    look: dict[str, Any] = field(default_factory=dict)
    values = NONE

    def draw(self, axis: Axes) -> None:
        """Draw it."""
        where: Any = tuple("axes fraction" if name in self.shares else "data" for name in "xy")
        style: dict[str, Any] = {"fontsize": 8, "color": "0.3", **self.look}
        axis.annotate(self.text, (self.x, self.y), xycoords=where, **style)


@dataclass(frozen=True)
class Map:
    """Colours on a grid: a value for each pair (x, y); logarithmic where the values are decades apart."""

    x: Any
    y: Any
    colours: Any
    label: str

    @property
    def values(self) -> Array:
        """The values along y that are drawn."""
        return np.where(np.isfinite(np.asarray(self.colours, float)), np.asarray(self.y, float), np.nan)

    def draw(self, axis: Axes) -> None:
        """Draw it."""
        from matplotlib.colors import LogNorm

        x, y, colours = (np.asarray(values, float) for values in (self.x, self.y, self.colours))
        here = np.isfinite(x) & np.isfinite(y)
        across, up = np.unique(x[here]), np.unique(y[here])
        known = colours[here & np.isfinite(colours)]
        if not len(known):
            return
        grid = np.full((len(up), len(across)), np.nan)
        grid[np.searchsorted(up, y[here]), np.searchsorted(across, x[here])] = colours[here]
        norm = LogNorm() if 0.0 < LOG_RANGE * np.min(known) < np.max(known) else None
        drawn = axis.pcolormesh(across, up, grid, cmap="cividis", shading="nearest", norm=norm, rasterized=True)
        axis.figure.colorbar(drawn, ax=axis, label=self.label)


Mark = Curve | Ranges | Level | Band | Note | Map


@dataclass(frozen=True)
class Panel:
    """Marks on two axes. slopes: triangles to hold lines against. legend: "" for the picture's, "inside" the panel or
    "below" it. empty: the words in a panel without data. equal: both axes have one scale."""

    title: str
    x: Axis
    y: Axis
    marks: Sequence[Mark]
    slopes: Sequence[float] = ()
    legend: str = ""
    empty: str = "no point could be evaluated"
    equal: bool = False


@dataclass(frozen=True)
class Picture:
    """Panels line by line. height: in inches. heights, widths: the ratios of lines and columns. shared_x: panels that
    stand under each other have one horizontal axis. columns: of the legend below all panels."""

    lines: Sequence[Sequence[Panel]]
    height: float
    columns: int = 4
    heights: Sequence[float] | None = None
    widths: Sequence[float] | None = None
    shared_x: bool = False


def groups(rows: Iterable[Row], *names: str) -> dict[Any, list[Row]]:
    """The rows by the value of a column, or by the values of several."""
    rows_by_key: dict[Any, list[Row]] = {}
    for row in rows:
        key = tuple(row.get(name) for name in names)
        rows_by_key.setdefault(key if len(names) > 1 else key[0], []).append(row)
    return rows_by_key


def curves(
    rows: Iterable[Row], x: str, y: str, by: str, scale: float = 1.0, exact: float = 1.1, **style: Any
) -> list[Mark]:
    """A curve of column y over column x for each method that column ``by`` names, in its look.

    scale: of the values. exact: width of the line of the exact motion, which lies below the others.
    """
    below = {"exact": {"lw": exact, "zorder": 1.5}}
    return [
        Curve(column(group, x), scale * column(group, y), short(label), look(label) | below.get(label, {}) | style)
        for label, group in groups(rows, by).items()
    ]


def style_of(i: int, j: int = 0) -> dict[str, Any]:
    """Line style of a curve that belongs to no method: the first number gives the colour, the second the dashes, both
    the marker."""
    return {"color": COLOURS[i % len(COLOURS)], "marker": MARKERS[(i + 3 * j) % len(MARKERS)], "linestyle": dashed(j)}


def render(picture: Picture, title: str, units: Units, words: Callable[[str], str] = str) -> Figure:
    """Draw a picture. words: a function that every text passes through."""
    figure = new_figure(picture.height)
    width = len(title) // -(-len(title) // LINE) + 8  # lines of about one length
    figure.suptitle(in_lines(title, width), fontsize=11)
    # So many columns that each line of panels divides them evenly.
    columns = lcm(*map(len, picture.lines))
    grid = figure.add_gridspec(len(picture.lines), columns, height_ratios=picture.heights, width_ratios=picture.widths)
    letters = iter(ascii_letters)
    above: dict[int, Axes] = {}
    common = []  # the axes whose legend is the picture's
    for i, line in enumerate(picture.lines):
        width, left = columns // len(line), None
        for j, panel in enumerate(line):
            repeats = left is not None and panel.y.names and panel.y.names == line[j - 1].y.names
            axis = figure.add_subplot(
                grid[i, j * width : (j + 1) * width],
                sharex=above.get(j * width) if picture.shared_x else None,
                sharey=left if repeats else None,
            )
            _draw(axis, panel, next(letters, ""), units, words)
            if repeats:
                axis.tick_params(labelleft=False)
            if picture.shared_x and i + 1 < len(picture.lines):
                axis.tick_params(labelbottom=False)
                axis.set_xlabel("")
            if axis.get_xscale() == "linear" and not panel.x.ticks:  # more ticks would overlap
                axis.locator_params(axis="x", nbins=3 if len(line) > 3 else 6)
            above[j * width], left = axis, axis
            common += [] if panel.legend else [axis]
    shared_legend(figure, picture.columns, common, words)
    return figure


def _label(along: Axis, units: Units, words: Callable[[str], str]) -> str:
    return units.label(words(along.label), along.quantity)


def _draw(axis: Axes, panel: Panel, letter: str, units: Units, words: Callable[[str], str]) -> None:
    axis.set_title(f"({letter}) {words(panel.title)}", loc="left", fontsize=10.5)
    if not any(np.any(np.isfinite(mark.values)) for mark in panel.marks):
        say_empty(axis, words(panel.empty))
        return
    axis.set(xlabel=_label(panel.x, units, words), ylabel=_label(panel.y, units, words))
    for mark in panel.marks:
        mark.draw(axis)
    axis.grid(color="0.92")
    axis.set_axisbelow(True)
    log_scale(axis, panel.x.scale == "log", panel.y.scale == "log")
    if panel.y.scale == "signed log":
        values = np.concatenate([mark.values for mark in panel.marks if not isinstance(mark, Ranges)])
        threshold = panel.y.threshold or 1e-3 * float(np.nanmax(np.abs(values)))
        if threshold:
            signed_log(axis, [values], threshold)
    for name, along in (("x", panel.x), ("y", panel.y)):
        if along.ticks:
            axis.set(**{f"{name}ticks": list(along.ticks), f"{name}ticklabels": map(words, along.ticks.values())})
            axis.minorticks_off()
            (axis.xaxis if name == "x" else axis.yaxis).set_tick_params(labelsize=8.5)
    if max(map(len, panel.x.ticks.values()), default=0) > 6:
        axis.tick_params("x", labelrotation=30)
    if panel.y.names:
        axis.set_yticks(range(len(panel.y.names)), [*map(words, panel.y.names)], fontsize=8.5)
    axis.set_xlim(*panel.x.limits)
    axis.set_ylim(top=min(axis.get_ylim()[1], panel.y.cap))
    high = axis.get_ylim()[1]
    if panel.y.limits[0] is not None and panel.y.limits[1] is None:
        axis.set_ylim(top=high + 0.05 * (high - panel.y.limits[0]))
    axis.set_ylim(*((len(panel.y.names) - 0.4, -0.6) if panel.y.names else panel.y.limits))
    if panel.equal:
        axis.set_aspect("equal")
    if panel.slopes:
        mark_order(axis, panel.slopes)
    if panel.legend:
        panel_legend(axis, words, panel.legend == "below")
