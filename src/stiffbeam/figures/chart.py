"""Pictures declared as data, marks on named axes, and the one function that draws them all."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import lcm
from string import ascii_letters
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ..basics.arrays import Array
from ..basics.units import Units
from .panels import (
    COLOURS,
    MARKERS,
    column,
    dashed,
    log_scale,
    look,
    mark_order,
    new_figure,
    panel_legend,
    say_empty,
    shared_legend,
    short,
    signed_log,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    figure.suptitle("\n".join(textwrap.wrap(title, width, break_on_hyphens=False)), fontsize=11)
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
