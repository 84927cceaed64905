"""Do the references agree, how long, and at what cost?"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Array
from ..plain import plain
from ..semidiscretisation import semidiscretise
from ..solvers import METHODS, solve
from ..solvers.agreement import agreement, time_tolerance
from ..trajectory import Reference, SolverFailure
from ..validation import InputError, positive

if TYPE_CHECKING:
    from ..cases import Case

PRECISION = ("multiprecision", "exact")  # who is held to be right, the most precise first
REFUTED = 1e3  # times rtol before the first impact: more than that is not what the tolerance claims
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Agreement:
    """References by method; differences[i][j]: largest |du| over max |u| of methods i and j before
    either's horizon; impact_differences likewise in time; horizons against the most precise; refuted:
    methods whose claimed tolerance another refutes; skipped: method and reason."""

    judge: str
    references: dict[str, Reference]
    differences: Array
    impact_differences: Array
    horizons: dict[str, float]
    refuted: dict[str, str]
    skipped: dict[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        names = list(self.references)
        return {
            "judge": self.judge,
            "horizons": self.horizons,
            "refuted": self.refuted,
            "skipped": self.skipped,
            "seconds": {name: r.work.march_seconds for name, r in self.references.items()},
            "work": {name: r.work.counters for name, r in self.references.items()},
            "differences": plain(_by_name(self.differences, names)),
            "impact_differences": plain(_by_name(self.impact_differences, names)),
        }


def agree(
    case: Case,
    form: str = "displacement",
    t_end: float | None = None,
    methods: Sequence[str] = METHODS,
    budget: float = 60.0,
    rtol: float = 1e-10,
    progress: Progress = lambda what, done, total: None,
) -> Agreement:
    """Run every method that fits into ``budget`` seconds and hold all against the most precise.

    The cost of a method is estimated from a pilot run over a twentieth of the span; the methods that
    would not finish within what is left are named as skipped, with the estimate.
    """
    t_end = positive("t_end", case.t_end if t_end is None else t_end)
    budget = positive("budget", budget)
    system = semidiscretise(case.problem, case.cells, form)
    times = np.linspace(0.0, t_end, 401)
    references: dict[str, Reference] = {}
    skipped: dict[str, str] = {}
    left = budget
    for done, method in enumerate(sorted(methods, key=_cost)):
        progress(method, done, len(methods))
        begun = time.perf_counter()
        try:
            if method not in PRECISION:
                pilot = solve(system, t_end / 20.0, method, times[:21] / 20.0, rtol, None)
                estimate = 20.0 * pilot.work.march_seconds
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
    judge = next((name for name in PRECISION if name in references), next(iter(references)))
    tolerance = time_tolerance(system)
    horizons = {name: agreement(references[judge], r, tolerance) for name, r in references.items()}
    names = list(references)
    differences = np.zeros((len(names), len(names)))
    impacts = np.zeros_like(differences)
    scale = float(np.max(np.abs(references[judge].tip))) or 1.0
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            end = min(horizons[a], horizons[b])
            inside = times <= end
            differences[i, j] = np.max(np.abs(references[a].tip - references[b].tip)[inside]) / scale
            impacts[i, j] = _impact_difference(references[a], references[b], end - tolerance)
    return Agreement(judge, references, differences, impacts, horizons, _refuted(references, judge, rtol), skipped)


def _cost(method: str) -> int:
    """Cheap ones first."""
    order = ("exact", "cvode-adams", "multiprecision", "cvode", "dop853", "ida", "kvaerno5", "radau", "kvaerno3")
    return order.index(method) if method in order else len(order)


def _impact_difference(a: Reference, b: Reference, end: float) -> float:
    """Largest difference of paired impact times to ``end``; NaN where one does not see them by events."""
    if "sampled" in (a.impacts.kind, b.impacts.kind):
        return float("nan")
    n = min(a.impacts.until(end).count, b.impacts.until(end).count)
    return float(np.max(np.abs(a.impacts.times[:n] - b.impacts.times[:n]), initial=0.0))


def _refuted(references: dict[str, Reference], judge: str, rtol: float) -> dict[str, str]:
    """Who is further off before the first impact than its tolerance says."""
    refuted = {}
    best = references[judge]
    first = float(best.impacts.times[0]) if best.impacts.count else float(best.t[-1])
    inside = best.t <= first
    scale = float(np.max(np.abs(best.tip[inside]))) or 1.0
    for name, r in references.items():
        error = float(np.max(np.abs(r.tip - best.tip)[inside])) / scale
        claim = 1e-11 if name in PRECISION else REFUTED * rtol
        if not error <= claim:
            refuted[name] = f"{error:.1e} off before the first impact, claimed {claim:.0e}"
    return refuted


def _by_name(matrix: Array, names: list[str]) -> dict[str, dict[str, float]]:
    return {a: dict(zip(names, row, strict=True)) for a, row in zip(names, matrix, strict=True)}
