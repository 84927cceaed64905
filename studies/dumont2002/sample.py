"""One number for every member of an ensemble, and statistical tests on it.

A statement about the mean holds, fails, or cannot be decided: True, False or None. It is decided where the
difference is outside what the spread of the members explains in all but CHANCE of the cases (Student's t).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from stiffbeam.basics.arrays import Array

CHANCE = 0.00135  # one-sided: three standard deviations of a normal distribution


@dataclass(frozen=True, eq=False)
class Sample:
    """values: (members,)."""

    values: Array

    @property
    def mean(self) -> float:
        """The mean over the members."""
        return float(np.mean(self.values))

    @property
    def sd(self) -> float:
        """The standard deviation over the members; 0 for one."""
        return float(np.std(self.values, ddof=1)) if len(self.values) > 1 else 0.0

    def written(self, scale: float = 1.0, unit: str = "") -> str:
        """Mean ± standard deviation over the members, to the digits that the deviation leaves, four at most.

        The same whole number of all members is written as one, and what is below 1e-4 in powers of ten.
        """
        mean, sd = scale * self.mean, scale * self.sd
        if not sd and mean == round(mean):
            return f"{mean:.0f}{unit}"
        if _magnitude(mean) < -4:
            return f"{mean:.1e}" + (f" ± {sd:.1e}" if sd else "") + unit
        places = 3 - _magnitude(mean)
        if sd:
            places = min(places, (0 if sd >= 3.0 else 1) - _magnitude(sd))
        places = max(0, places)
        spread = f"{sd:.{places}f}"
        return f"{mean:.{places}f}" + (f" ± {spread}" if float(spread) else "") + unit


def of_members(row: Mapping[str, Any], what: str) -> Sample:
    """Measure of all members of a row of numbers, of every set of seeds."""
    return Sample(np.array([x for members in row["ensemble"].values() for x in members[what] if x is not None]))


def _magnitude(value: float) -> int:
    """The power of ten of the first digit, 0 of nothing."""
    return int(np.floor(np.log10(abs(value)))) if value else 0


def above(a: Sample, b: Sample | float) -> bool | None:
    """Compare means: True where that of ``a`` is above ``b``, None where the spread decides nothing."""
    if isinstance(b, Sample):
        error = np.hypot(a.sd / np.sqrt(len(a.values)), b.sd / np.sqrt(len(b.values)))
        gap, freedom = a.mean - b.mean, len(a.values) + len(b.values) - 2
    else:
        error, gap, freedom = a.sd / np.sqrt(len(a.values)), a.mean - b, len(a.values) - 1
    if error == 0.0:
        return gap > 0.0
    if freedom < 1 or abs(gap) <= stats.t.isf(CHANCE, freedom) * error:
        return None
    return gap > 0.0


def below(a: Sample, b: Sample | float) -> bool | None:
    """Compare means: True where that of ``a`` is below ``b``, None where the spread decides nothing."""
    return no(above(a, b))


def no(statement: bool | None) -> bool | None:
    """The negation; None stays None."""
    return None if statement is None else not statement


def every(statements: Iterable[bool | None]) -> bool | None:
    """Conjunction: True if all hold, False if one fails, else None."""
    found = list(statements)
    return False if False in found else None if None in found else True


def some(statements: Iterable[bool | None]) -> bool | None:
    """Disjunction: True if one holds, False if all fail, else None."""
    return no(every(map(no, statements)))
