"""Comparison of the schemes of a case with SUNDIALS and the exact solution: ``stiffbeam compare``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.progress import Show, silent
from ..basics.validation import InputError, one_of, positive, step_count
from ..files.cases import Case
from ..files.reference_cache import cached_reference
from ..march.integrate import integrate
from ..march.treatment import TREATMENTS
from ..measures.comparison import Comparison, compare
from ..model.system import System
from ..references import reference, substitute
from ..references.registry import BUDGET, COMPARED, COMPARED_RIGID, method_of
from ..testset.integrators import RECORDED, SCHEME, SOLVER, Integrator, fastest, integrators
from ..trajectory.trajectory import Diverged, Reference, SolverFailure, Trajectory


@dataclass(frozen=True)
class _Solver:
    """References of a comparison, each within a budget of seconds; with ``cache`` kept for the next time."""

    cache: bool
    budget: float

    def __call__(self, system: System, t_end: float, method: str, times: Array | None) -> Reference:
        """Solve as far as the budget allows. times: None for any time."""
        # The exact solution takes no longer than reading a file.
        solve = cached_reference if self.cache and method != "exact" else reference
        return solve(system, t_end, method, times, progress=False, seconds=self.budget)


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
    truths: dict[str, Reference] = field(default_factory=dict)  # by form, where one was given

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
    dt: float | None = None,
    t_end: float | None = None,
    progress: Show = silent,
    keep: Callable[[Trajectory], None] = lambda trajectory: None,
    cache: bool = False,
    budget: float = BUDGET,
    truth: Callable[[Case, str, float], Reference | None] = lambda case, form, t_end: None,
) -> CaseComparison:
    """Run every scheme over the case's time span and hold it against a reference of the same form.

    runs: (integrator, form); None for the case's own. The integrator is a Scheme, a function, a recorded run or the
    label of one (``testset.integrators``); the name of a solver makes it a further reference. references: methods; None
    for those of ``COMPARED`` that take the system.

    The first of ``references`` that can take the system is the main reference, over the whole span; the
    others run to its horizon only and are compared like the schemes. A run that fails is reported and
    the others go on. ``keep`` is called with every trajectory as soon as it is finished. cache: keep the references
    for the next time, and read those of an earlier one. budget: CPU seconds that a further reference may take, the main
    one four times as many; one that would take more ends earlier. ``truth`` is asked, with case, form and t_end, for a
    solution that holds over the whole span.
    """
    case = replace(case, dt=dt or case.dt, t_end=t_end or case.t_end)
    step_count(case.dt, case.t_end)
    one_of("contact", contact, TREATMENTS)
    positive("budget", budget)
    solver = _Solver(cache, budget)
    first = case.system()
    rigid = first.rigid
    if references is None:
        references = COMPARED_RIGID if rigid else COMPARED[1:] if substitute(first, case.t_end) else COMPARED
    for name in references:
        method_of(name, "references")
    result = CaseComparison(case)
    pairs = list(case.runs if runs is None else runs)
    chosen = {
        form: integrators(x for x, of_run in pairs if of_run == form) for form in dict.fromkeys(f for _, f in pairs)
    }
    solvers = [one.source for several in chosen.values() for one in several if one.kind == SOLVER]
    references = list(dict.fromkeys([*references, *solvers]))
    refused: list[Diverged | InputError | SolverFailure] = []
    for form, several in chosen.items():
        system = case.system(form)
        solved = []
        for one in _references(system, case, references, result, progress, solver):
            keep(one)
            solved.append(one)
        main = solved[0] if solved else None
        for one in several:
            if one.kind == SOLVER:
                continue
            label = f"{one.label}@{form}"
            try:
                run = _run(one, system, case, contact, partial(progress, label))
            except (Diverged, InputError, SolverFailure) as error:
                refused.append(error)
                result.note(label, error)
                continue
            result.runs.append(run)
            keep(run)
            if main is not None:
                progress(f"measuring {label}", 0, 0)
                _measure(result, run, main)
        if main is not None:
            for other in solved[1:]:
                _measure(result, other, main)
            if main.horizon < case.t_end and (true := truth(case, form, case.t_end)) is not None:
                result.truths[form] = true
    if not result.runs and refused and all(isinstance(error, InputError) and error.field != "dt" for error in refused):
        raise refused[0]  # nothing was run: the fault is in the input, not in a scheme
    return result


def _run(one: Integrator, system: System, case: Case, contact: str, show: Callable[[int, int], None]) -> Trajectory:
    """Return the run of an integrator that chooses no steps itself: of a scheme with its progress, a recorded one."""
    steps = round(case.t_end / case.dt)
    if one.kind == SCHEME:
        arguments = (system, one.source, case.dt, case.t_end, contact)
        return fastest(lambda: integrate(*arguments, progress=lambda done: show(done, steps)))
    show(0, 0)
    if one.kind == RECORDED and len(one.source) == 1:
        return one.source[0]
    return one.run(system, case.dt, case.t_end)


def _references(
    system: System, case: Case, methods: Sequence[str], result: CaseComparison, progress: Show, solver: _Solver
) -> Iterator[Reference]:
    """Yield the main reference, the first of ``methods`` that can take the system, then the others to its horizon."""
    main, window = None, case.t_end
    steps = round(case.t_end / case.dt)
    for method in dict.fromkeys(methods):
        label = f"{method}@{system.form}"
        try:
            if main is None:
                progress(label, 0, 0)
                # The adaptive solvers answer at the times they were asked for: the runs' own steps.
                times = None if method in ("exact", "multiprecision") else np.arange(steps + 1) * case.dt
                solution = replace(solver, budget=4.0 * solver.budget)(system, case.t_end, method, times)
            else:
                progress(f"{label} to the horizon {window:.3g}", 0, 0)
                times = np.arange(steps + 1) * case.dt
                solution = solver(system, float(times[-1]), method, times)
        except (InputError, SolverFailure) as error:
            result.note(label, error)
            continue
        if main is None:
            main, window = solution, min(float(solution.t[-1]), solution.horizon)
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
