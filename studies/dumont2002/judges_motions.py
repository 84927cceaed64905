"""Judges of statements about motions: measures of the ensembles held against numbers and against each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from .evidence import Evidence
from .sample import Sample, above, below, every
from .verdicts import FAILS, HOLDS, Finding, of_both, shared_verdict


@dataclass(frozen=True)
class Measure:
    """what: of ``Evidence.sample``. label: as the sentence begins. Values are written times scale with a unit."""

    what: str
    label: str
    scale: float = 1.0
    unit: str = ""

    def of(self, e: Evidence, table: int, motion: str) -> Sample:
        """Members of one motion."""
        return e.sample(table, motion, self.what)

    def written(self, e: Evidence, table: int, motion: str) -> str:
        """Mean and spread of one motion, as the page prints them."""
        text = self.of(e, table, motion).written(self.scale, self.unit)
        row = e.row(table, motion)
        if row.get("digits") and self.what in ("impacts", "fraction"):  # the frozen solution knows these over T
            text += f" (true to T: {self.scale * row[self.what]:.4g}{self.unit})"
        return text

    def sentence(self, e: Evidence, table: int, named: bool = False) -> str:
        """Measure of every motion of a table as one sentence; ``named``: it begins with the table."""
        label = f"Table {table}, {self.label[0].lower()}{self.label[1:]}" if named else self.label
        return f"{label}: " + ", ".join(f"{e.name(table, m)} {self.written(e, table, m)}" for m in motions_of(e, table))


MEASURES = {
    measure.what: measure
    for measure in (
        Measure("fraction", "Share of time in contact", 100.0, " %"),
        Measure("impacts", "Impacts to T"),
        Measure("depth", "Deepest deflection of a stop over the clearance", 100.0, " %"),
    )
}
IMPACTS = MEASURES["impacts"]


def motions_of(e: Evidence, table: int) -> list[str]:
    """Runs of a table, then its exact motions."""
    return [*e.runs(table), *e.forms(table)]


def of_every(e: Evidence, table: int, said: str, holds: Callable[[str], bool | None]) -> Finding:
    """Finding where ``holds`` is asked of every run, and of the exact motion in every form."""
    return of_both(said, every(map(holds, e.runs(table))), every(map(holds, e.forms(table))))


def motions(
    e: Evidence, table: int, *, measure: str, more_than: float = 0.0, less_than: float | None = None, beside: str = ""
) -> Finding:
    """The measure is above or below a number. beside: another measure that the sentence adds."""
    said = ". ".join(MEASURES[name].sentence(e, table) for name in (measure, beside) if name)

    def holds(motion: str) -> bool | None:
        sample = MEASURES[measure].of(e, table, motion)
        return above(sample, more_than) if less_than is None else below(sample, less_than)

    return of_every(e, table, f"{said}.", holds)


def between_tables(e: Evidence, base: int, *others: int, measure: str, less: bool = False) -> Finding:
    """Every motion has more (or less) of the measure on the other tables than on ``base``."""
    chosen, order = MEASURES[measure], below if less else above
    said = ". ".join(chosen.sentence(e, table, True) for table in (base, *others))
    return of_every(
        e, base, f"{said}.", lambda m: every(order(chosen.of(e, t, m), chosen.of(e, base, m)) for t in others)
    )


def runs_differ(e: Evidence, table: int, *, measure: str, beside: str) -> Finding:
    """The measure of two runs differs. beside: another measure that the sentence adds."""
    samples = [MEASURES[measure].of(e, table, name) for name in e.runs(table)]
    apart = any(above(a, b) is not None for a, b in combinations(samples, 2))
    said = ". ".join(MEASURES[name].sentence(e, table) for name in (measure, beside))
    return Finding(f"{said}.", HOLDS if apart else FAILS)


def counts_differ(e: Evidence, *tables: int) -> Finding:
    """Both runs count other impacts on every table; in part on some."""
    parts, apart = [], []
    for table in tables:
        a, b = (IMPACTS.of(e, table, name) for name in e.runs(table))
        apart.append(above(a, b) is not None)
        gap = abs(a.mean - b.mean) / max(np.hypot(a.sd, b.sd), 1e-300)
        parts.append(f"Table {table}: {IMPACTS.sentence(e, table).partition(': ')[2]}, {gap:.0f} deviations apart")
    return Finding(f"Impacts to T. {'; '.join(parts)}.", shared_verdict(all(apart), any(apart)))
