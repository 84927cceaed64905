"""Comparison of the schemes of a case with SUNDIALS and the exact solution: ``stiffbeam compare``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.progress import current
from ..basics.validation import InputError, one_of, positive, step_count
from ..files.cases import Case
from ..files.reference_cache import cached_reference
from ..integrators import RECORDED, SCHEME, SOLVER, Integrator, fastest, integrators
from ..march.treatment import TREATMENTS
from ..measures.comparison import Comparison, compare
from ..model.system import System
from ..references import reference, substitute
from ..references.registry import BUDGET, COMPARED, COMPARED_RIGID, method_of
from ..trajectory.trajectory import Diverged, Reference, SolverFailure, Trajectory
from .references import frozen, shipped


@dataclass(frozen=True)
class CaseComparison:
    """The outcome: one comparison per run and per further reference; failures as (label, message), of which those
    ``refused`` cannot be asked of the case."""

    case: Case
    runs: list[Trajectory] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)  # the main one of each form first
    comparisons: list[Comparison] = field(default_factory=list)
    failures: list[tuple[str, str]] = field(default_factory=list)
    refused: set[str] = field(default_factory=set)
    truths: dict[str, Reference] = field(default_factory=dict)  # by form, of tables of the paper: stored solutions

    def __repr__(self) -> str:
        return f"<CaseComparison {self.case.name}: {len(self.comparisons)} compared, {len(self.failures)} failed>"

    def note(self, label: str, error: Exception) -> None:
        """A run or reference that there is not, and why."""
        self.failures.append((label, str(error)))
        if isinstance(error, InputError):
            self.refused.add(label)

    def to_dict(self) -> dict[str, Any]:
        """Case, comparisons and failures as plain numbers and texts, for JSON."""
        return {
            "measured": ["references.seconds", "comparisons.seconds", "comparisons.ns_per_step"],
            "case": self.case.name,
            "title": self.case.title,
            "units": list(self.case.units),
            "dt": self.case.dt,
            "t_end": self.case.t_end,
            "cells": self.case.cells if self.case.beam else None,
            "inferred": list(self.case.notes),
            "references": [
                {"label": r.label, "horizon": r.horizon, "seconds": r.work.seconds, "provenance": r.provenance}
                for r in self.references
            ],
            "comparisons": [c.to_dict() for c in self.comparisons],
            "truths": {form: truth.impacts.count for form, truth in self.truths.items()},
            "failures": [{"run": label, "message": message} for label, message in self.failures],
        }


def compare_case(
    case: Case,
    runs: Sequence[tuple[Any, str]] | None = None,
    references: Sequence[str] | None = None,
    contact: str = "implicit",
    keep: Callable[[Trajectory], None] = lambda trajectory: None,
    cache: bool = False,
    budget: float = BUDGET,
    measured: Callable[[CaseComparison, Trajectory | None], None] = lambda result, solution: None,
) -> CaseComparison:
    """Run every scheme over the case's time span and compare it with a reference of the same form.

    The schemes run first, then the main reference, the first of ``references`` that supports the system, over the whole
    span, then the others to its horizon, compared like the schemes. After a run that fails the others go on.

    runs: (integrator, form); None for the case's own. The integrator is a Scheme, a function, a recorded run or the
    label of one (``integrators``); the name of a solver makes it a further reference. references: methods; None for
    those of ``COMPARED`` that support the system. keep: called with every trajectory as soon as it is finished.
    measured: called with the result and None when all schemes are compared, then with each further reference. cache:
    store the references, and use stored ones. budget: CPU seconds that a further reference may take, the main one
    four times as many; one that would take more ends earlier.
    """
    step_count(case.dt, case.t_end)
    one_of("contact", contact, TREATMENTS)
    positive("budget", budget)
    references = _asked(case) if references is None else references
    for name in references:
        method_of(name, "references")
    result, pairs, progress = CaseComparison(case), list(case.runs if runs is None else runs), current()
    forms = dict.fromkeys(form for _, form in pairs)
    chosen = {form: integrators(x for x, of_run in pairs if of_run == form) for form in forms}
    solvers = [one.source for several in chosen.values() for one in several if one.kind == SOLVER]
    systems = {form: case.system(form) for form in chosen}
    refused, of_form = list[Exception](), dict[str, list[Trajectory]]()
    for form, several in chosen.items():
        begin = len(result.runs)
        errors = [_scheme(result, one, systems[form], contact, keep) for one in several if one.kind != SOLVER]
        refused += filter(None, errors)
        of_form[form] = result.runs[begin:]
    if not result.runs and refused and all(isinstance(error, InputError) and error.field != "dt" for error in refused):
        raise refused[0]  # nothing was run: the fault is in the input, not in a scheme
    methods, further = list(dict.fromkeys([*references, *solvers])), []
    for form, system in systems.items():
        solutions = _references(system, methods, result, cache, budget)
        main = next(solutions, None)
        if main is None:
            continue
        for run in of_form[form]:
            progress(f"measuring {run.label}", 0, 0)
            _measure(result, run, main)
        result.truths.update(_truth(case, form) if main.horizon < case.t_end else {})
        further.append((main, solutions))
    measured(result, None)
    for main, solutions in further:
        keep(main)  # its energy, which is saved with it, may take longer than the table
        for one in solutions:
            keep(one)
            _measure(result, one, main)
            measured(result, one)
    return result


def _asked(case: Case) -> Sequence[str]:
    """The references of ``COMPARED`` that support the case."""
    system = case.system()
    return COMPARED_RIGID if system.rigid else COMPARED[1:] if substitute(system, case.t_end) else COMPARED


def _truth(case: Case, form: str) -> dict[str, Reference]:
    """By form, of a table of the paper: the stored solution over the whole span."""
    folder = shipped()
    true = None if folder is None else frozen(folder, case, form, case.t_end)
    return {form: true} if true is not None and true.provenance["t_end"] == case.t_end else {}


def _scheme(
    result: CaseComparison, one: Integrator, system: System, contact: str, keep: Callable[[Trajectory], None]
) -> Diverged | InputError | SolverFailure | None:
    """Run an integrator that chooses no steps itself and add it to the result; returns the reason if that fails."""
    case, label, progress = result.case, f"{one.label}@{system.form}", current()
    steps = round(case.t_end / case.dt)
    progress(label, 0, steps)
    try:
        if one.kind == RECORDED and len(one.source) == 1:
            run = one.source[0]
        else:
            repeat = fastest if one.kind == SCHEME else lambda march: march()
            show = lambda done: progress(label, done, steps)  # noqa: E731
            run = repeat(lambda: one.run(system, case.dt, case.t_end, contact, show=show))
    except (Diverged, InputError, SolverFailure) as error:
        result.note(label, error)
        return error
    result.runs.append(run)
    keep(run)
    return None


def _references(
    system: System, methods: Sequence[str], result: CaseComparison, cache: bool, budget: float
) -> Iterator[Reference]:
    """Yield the main reference, the first of ``methods`` that can take the system, then the others to its horizon."""
    main, case, progress = None, result.case, current()
    steps, seconds = round(case.t_end / case.dt), 4.0 * budget
    for method in methods:
        label = f"{method}@{system.form}"
        progress(label if main is None else f"{label} to the horizon {steps * case.dt:.3g}", 0, 0)
        # The exact solution takes no longer than reading a file.
        solve = cached_reference if cache and method != "exact" else reference
        # The adaptive solvers answer at the times they were asked for: the runs' own steps.
        times: Array | None = np.arange(steps + 1) * case.dt
        t_end = case.t_end if main is None else float(times[-1])
        if main is None and method in ("exact", "multiprecision"):
            times = None
        try:
            solution = solve(system, t_end, method, times, progress=False, seconds=seconds)
        except (InputError, SolverFailure) as error:
            result.note(label, error)
            continue
        if main is None:
            main, seconds = solution, budget
            window = min(float(solution.t[-1]), solution.horizon)
            steps = int(np.floor(window / case.dt * (1 + 1e-12)))
        result.references.append(solution)
        yield solution
        if steps < 2:
            return


def _measure(result: CaseComparison, run: Trajectory, main: Reference) -> None:
    """Compare, or note why it cannot be: one run that cannot be compared does not end the others."""
    try:
        result.comparisons.append(compare(run, main))
    except InputError as error:
        result.failures.append((run.label, str(error)))
