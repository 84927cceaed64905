"""Agreement of the references: how long they agree, and their cost."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.text import plain
from ..basics.validation import InputError, positive
from ..measures.impacts import impact_times
from ..references import solve
from ..references.estimate import expected_seconds
from ..references.horizon import agreement, time_tolerance
from ..references.registry import BUDGET, EXACT, METHODS, MULTIPRECISION, REFERENCES, RTOL, Steps
from ..trajectory.trajectory import Reference, SolverFailure

if TYPE_CHECKING:
    from ..files.cases import Case

# Which method is the baseline: the most precise first.
PRECISION = [m.name for kind in (MULTIPRECISION, EXACT) for m in REFERENCES.values() if m.kind == kind]
INCONSISTENT = 1e3  # times rtol before the first impact: more than that is not what the tolerance claims
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Agreement:
    """References by method; differences[i][j]: largest |du| over max |u| of methods i and j before
    either's horizon; impact_differences likewise in time; horizons against the most precise; inconsistent:
    methods that are further off than the tolerance they claim; skipped: method and reason."""

    baseline: str
    references: dict[str, Reference]
    differences: Array
    impact_differences: Array
    horizons: dict[str, float]
    inconsistent: dict[str, str]
    skipped: dict[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """All results as plain numbers and texts, for JSON."""
        names = list(self.references)
        return {
            "measured": ["seconds"],
            "baseline": self.baseline,
            "units": str(self.references[self.baseline].units),
            "horizons": self.horizons,
            "inconsistent": self.inconsistent,
            "skipped": self.skipped,
            "seconds": {name: r.work.march_seconds for name, r in self.references.items()},
            "work": {name: r.work.counters for name, r in self.references.items()},
            "differences": plain(_by_name(self.differences, names)),
            "impact_differences": plain(_by_name(self.impact_differences, names)),
        }


def agree(
    case: Case,
    form: str | None = None,
    t_end: float | None = None,
    methods: Sequence[str] = METHODS,
    budget: float = 4.0 * BUDGET,
    rtol: float = RTOL,
    progress: Progress = lambda what, done, total: None,
) -> Agreement:
    """Run every method that fits into ``budget`` seconds and compare all with the most precise.

    Methods that would not finish within the seconds that are left are named as skipped, with the estimate.
    """
    t_end = positive("t_end", case.t_end if t_end is None else t_end)
    budget = positive("budget", budget)
    system = case.system(form)
    times = np.linspace(0.0, t_end, 401)
    references: dict[str, Reference] = {}
    skipped: dict[str, str] = {}
    left = budget
    for done, method in enumerate(sorted(methods, key=_cost)):
        progress(method, done, len(methods))
        begun = time.perf_counter()
        try:
            if method not in PRECISION:
                if left <= 0.0:
                    skipped[method] = "nothing left of the budget"
                    continue
                estimate = expected_seconds(system, t_end, method, rtol, None, Steps(), solve, left, solutions=1.0)
                if estimate > left:
                    skipped[method] = f"about {estimate:.0f} s, {left:.0f} s left of the budget"
                    continue
            references[method] = solve(system, t_end, method, times, rtol, None)
        except (InputError, SolverFailure) as error:
            skipped[method] = str(error)
        finally:
            left -= time.perf_counter() - begun
    if not references:
        raise InputError("budget", budget, "let at least one method run", "give more seconds")
    baseline = next((name for name in PRECISION if name in references), next(iter(references)))
    tolerance = time_tolerance(system, t_end)
    horizons = {name: agreement(references[baseline], r, tolerance) for name, r in references.items()}
    names = list(references)
    differences = np.zeros((len(names), len(names)))
    impacts = np.zeros_like(differences)
    scale = float(np.max(np.abs(references[baseline].tip))) or 1.0
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            end = min(horizons[a], horizons[b])
            inside = times <= end
            differences[i, j] = np.max(np.abs(references[a].tip - references[b].tip)[inside]) / scale
            impacts[i, j] = _impact_difference(references[a], references[b], end - tolerance)
    return Agreement(
        baseline, references, differences, impacts, horizons, _inconsistent(references, baseline, rtol), skipped
    )


def _cost(method: str) -> float:
    """Cheap ones first, what is not registered last."""
    return REFERENCES[method].seconds if method in REFERENCES else math.inf


def _impact_difference(a: Reference, b: Reference, end: float) -> float:
    """Largest difference of paired impact times to ``end``; NaN where one of them does not find impacts as events."""
    largest = 0.0
    for x, y in zip(a.contacts, b.contacts, strict=True):
        if "sampled" in (x.impacts.kind, y.impacts.kind):
            return float("nan")
        one, other = x.impacts.until(end).times, y.impacts.until(end).times
        n = min(len(one), len(other))
        largest = max(largest, float(np.max(np.abs(one[:n] - other[:n]), initial=0.0)))
    return largest


def _inconsistent(references: dict[str, Reference], baseline: str, rtol: float) -> dict[str, str]:
    """The methods whose error before the first impact exceeds their tolerance."""
    inconsistent = {}
    best = references[baseline]
    first = float(min([*impact_times(best)[:1], best.t[-1]]))
    inside = best.t <= first
    scale = float(np.max(np.abs(best.tip[inside]))) or 1.0
    for name, r in references.items():
        error = float(np.max(np.abs(r.tip - best.tip)[inside])) / scale
        claim = 1e-11 if name in PRECISION else INCONSISTENT * rtol
        if not error <= claim:
            inconsistent[name] = f"{error:.1e} off before the first impact, claimed {claim:.0e}"
    return inconsistent


def _by_name(matrix: Array, names: list[str]) -> dict[str, dict[str, float]]:
    return {a: dict(zip(names, row, strict=True)) for a, row in zip(names, matrix, strict=True)}
