"""Budget of one quantity: its sources of uncertainty with 95 % intervals, and the largest of them.

Intervals are bootstrap intervals over the members (BCa). Mesh and span have a bracket besides, see ``doubt``. A source
is the largest if it is in 97.5 % of the resamples, in each of which all columns have the same members and are at the
unfavourable ends of their brackets. If none is, those that may be the largest are named together. Rounding need not
exceed data and span, which contain it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.stats

from ..basics.arrays import Array
from ..measures.rates import Mean
from ..measures.report import percent

RESAMPLES = 2000
SURE = 0.975  # of the resamples in which the source that is named is the largest
ORDERS = {"displacement": 2, "velocity-curvature": 2, "hermite": 4}  # in h, of smooth motions
BRACKET = (2 / 3, 3 / 2)  # of the extrapolated error of the mesh
MEASURED = (0.9, 1.1)  # of the distance to cubic elements
# Of the distance to a finer model, which is 1 of the error of one without error and 3/4 of one of half the width at
# order 2: from 1 to 4/3 of it, with a margin of 3/2 to either side.
FINER = (2 / 3, 2.0)
SPAN_BRACKET = (0.5, 2.0)  # of a deviation over the span: all members share their loads, so their scatter lacks it
CURES = {
    "rounding": "past the horizon only statistics mean something",
    "scheme": "take a smaller step",
    "mesh": "take a finer mesh",
    "data": "{parts} good enough",
    "span": "take a longer time span",
}


@dataclass(frozen=True)
class Share:
    """One column of a budget: a relative uncertainty with the ends of its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{percent(self.value)} ({percent(self.low)} to {percent(self.high)})" if self.high else "0"


NONE = Share(0.0, 0.0, 0.0)


def _contains(source: str, other: str) -> bool:
    return other == "rounding" and source in ("data", "span")


@dataclass(frozen=True)
class Budget:
    """Uncertainty of one quantity by its sources.

    Parameters
    ----------
    quantity : str
    mean : float
        Over the exact members; for the tip its largest |u|.
    shares : dict of str to Share
    largest : sequence of str
        The source that exceeds all others, or those that may be the largest.
    """

    quantity: str
    mean: float
    shares: dict[str, Share]
    largest: tuple[str, ...]

    @property
    def name(self) -> str:
        """The quantity without its contact."""
        return self.quantity.partition(" at contact")[0]

    @property
    def uncertain(self) -> bool:
        """True if any source is not 0."""
        return any(share.high for share in self.shares.values())

    @property
    def dominant(self) -> str:
        """The source that exceeds all others, "" if none does."""
        return self.largest[0] if len(self.largest) == 1 else ""

    @property
    def verdict(self) -> str:
        """Sentence with the largest source, or those that may be the largest, and a remedy."""
        if not self.uncertain:
            return f"{self.quantity}: no uncertainty, {self.mean:g} in all members for {', '.join(self.shares)}."
        sizes = {name: f"{name} ({percent(x.value)})" for name, x in self.shares.items()}
        if not (first := self.dominant):
            names = [sizes[name] for name in self.largest]
            return f"{self.quantity}: {', '.join(names[:-1])} and {names[-1]} may be the largest: improve all of them."
        rest = ", ".join(sizes[name] for name in self.shares if name != first and not _contains(name, first))
        parts = "the step and the mesh are" if "mesh" in self.shares else "the step is"
        return f"{self.quantity}: {sizes[first]} exceeds {rest}: {CURES[first].format(parts=parts)}."


Statistic = Callable[..., Array]  # of the values along an axis, by default the second


def resampled(statistic: Statistic, sample: Array) -> Array:
    """A statistic of RESAMPLES bootstrap resamples of a sample (M,), which are the same rows for every sample of its
    size."""
    return statistic(sample[np.random.default_rng(1).integers(0, len(sample), (RESAMPLES, len(sample)))])


def bootstrap(statistic: Statistic, sample: Array) -> tuple[float, float]:
    """Ends of the 95 % BCa interval of a statistic over a sample (M,). A sample whose values are all equal has an
    interval without width."""
    drawn = resampled(statistic, sample)
    ends = float(np.min(drawn)), float(np.max(drawn))
    if ends[0] == ends[1]:
        return ends
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a sample with all resamples on one side of the estimate
        interval = scipy.stats.bootstrap((sample,), statistic, n_resamples=RESAMPLES, rng=1).confidence_interval
    return (float(interval.low), float(interval.high)) if np.all(np.isfinite(interval)) else ends


def _means(x: Array, axis: int = 1) -> Array:
    return np.mean(x, axis=axis)


def _deviations(x: Array, axis: int = 1) -> Array:
    return np.std(x, axis=axis, ddof=1)


def _roots(x: Array, axis: int = 1) -> Array:
    return np.sqrt(np.mean(x**2, axis=axis))


@dataclass(frozen=True)
class Column:
    """A statistic and the members (M,) of which it is one; factors: of its size, and of the ends of its bracket."""

    statistic: Statistic
    sample: Array
    factors: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def size(self) -> float:
        """|statistic| of all members, times its factor."""
        return self.factors[0] * self.sample_size

    @property
    def sample_size(self) -> float:
        """|statistic| of all members, without a factor."""
        return abs(float(self.statistic(self.sample[None])[0]))

    def resampled(self, factor: float) -> Array:
        """|statistic| of every resample, times a factor."""
        return factor * np.abs(resampled(self.statistic, self.sample))

    def between(self, bracket: tuple[float, float], size: float = 1.0) -> Column:
        """The column times ``size``, with a bracket of that."""
        return replace(self, factors=(size, bracket[0] * size, bracket[1] * size))

    def on_twice_the_cells(self, form: str) -> Column:
        """The column of a mesh's error from that of its change on twice as many cells."""
        power = 2.0 ** ORDERS[form]
        return self.between(BRACKET, power / (power - 1.0))


def mean_of(distances: Array) -> Column:
    """The column of the mean of distances."""
    return Column(_means, distances)


def shift(values: Array, wanted: Array) -> Column:
    """The column of mean(values - wanted), member by member."""
    return mean_of(np.asarray(values, float) - np.asarray(wanted, float))


def scatter(values: Array) -> Column:
    """The column of the deviation of values."""
    return Column(_deviations, np.asarray(values, float))


def share(column: Column, scale: float) -> Share:
    """|statistic|/scale with its interval."""
    low, high = bootstrap(column.statistic, column.sample)
    # The interval of |statistic|, which begins at 0 where that of the statistic contains 0.
    low, high = (low, high) if low > 0.0 else (-high, -low) if high < 0.0 else (0.0, abs(max(-low, high)))
    low, high = column.factors[1] * low, column.factors[2] * high
    if scale == 0.0:
        return NONE if high == 0.0 else Share(np.inf, np.inf if low else 0.0, np.inf)
    return Share(column.size / scale, low / scale, high / scale)


def budget_of(quantity: str, mean: float, columns: dict[str, Column]) -> Budget:
    """The budget of a quantity from its columns, relative to |mean|."""
    return Budget(quantity, mean, {name: share(x, abs(mean)) for name, x in columns.items()}, ranked(columns))


def ranked(columns: Mapping[str, Column]) -> tuple[str, ...]:
    """The largest source, or those that may be the largest. Data and span, which contain the scatter of rounding, do
    not count against it."""
    # A source at the low end of its bracket is held against all others at their high ends.
    least, most = ({name: x.resampled(x.factors[end]) for name, x in columns.items()} for end in (1, 2))
    names = sorted(columns, key=lambda x: -columns[x].size)
    for name in names:
        rivals = [most[x] for x in names if x != name and not _contains(x, name)]
        if columns[name].size > 0.0 and np.mean(np.all([least[name] >= x for x in rivals], axis=0)) >= SURE:
            return (name,)
    # Rounding stands for data and span if they may be its scatter alone.
    rounding = most.get("rounding")
    names = [x for x in names if not _contains(x, "rounding") or rounding is None
             or np.mean(least[x] >= rounding) >= SURE]  # fmt: skip
    first = least[names[0]]
    return (names[0], *([x for x in names[1:] if np.mean(first >= most[x]) < SURE] or names[1:2]))


def of_span(rates: Sequence[Mean]) -> Column:
    """The column of the deviations of the members' rates over their span, see SPAN_BRACKET."""
    return Column(_roots, np.array([each.deviation for each in rates]), (1.0, *SPAN_BRACKET))
