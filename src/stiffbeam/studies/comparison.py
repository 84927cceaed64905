"""Comparison of the schemes of a case with SUNDIALS and the exact solution: ``stiffbeam compare``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..basics.progress import current
from ..basics.validation import InputError, one_of, positive, step_count
from ..files.cases import Case, compared
from ..files.store import cached_reference
from ..integrators import SCHEME, SOLVER, fastest, integrators
from ..march.treatment import TREATMENTS
from ..measures.comparison import Comparison, compare
from ..measures.report import Report
from ..model.system import System
from ..references import reference, substitute
from ..references.registry import BUDGET, COMPARED, COMPARED_RIGID, MAIN, method_of
from ..trajectory.trajectory import Diverged, Reference, SolverFailure, Trajectory


@dataclass(frozen=True)
class CaseComparison:
    """A comparison of the runs of a case, see ``run``, and what it has so far.

    form: None for that of the case's first run. budget: CPU seconds that a further reference may take, the main one
    eight times as many; one that would take more ends earlier. cache: store the references, and use stored ones.
    failures: ("failed" or, of what cannot be asked of the case, "refused", label, message).
    """

    case: Case
    form: str | None = None
    contact: str = "implicit"
    budget: float = BUDGET
    cache: bool = False
    runs: list[Trajectory] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)  # the main one first
    comparisons: list[Comparison] = field(default_factory=list)  # one for each run and further reference
    failures: list[tuple[str, str, str]] = field(default_factory=list)

    def __repr__(self) -> str:
        return f"<CaseComparison {self.case.name}: {len(self.comparisons)} compared, {len(self.failures)} failed>"

    def run(
        self, schemes: Sequence[Any] | None = None, references: Sequence[str] | None = None
    ) -> Iterator[Trajectory]:
        """Run every scheme over the case's time span and compare it with a reference.

        The schemes run first, then the main reference, the first of ``references`` that supports the system, over the
        whole span, then the others to its horizon; they are compared like the schemes. A run that fails is reported and
        the others go on. Yields each scheme when it is finished, the main reference when all schemes are compared, and
        each other reference when it is compared.

        schemes: each a Scheme, a function, a recorded run or the label of one (``integrators``), the name of a solver
        makes it a further reference; None for those of ``compared``. references: methods; None for those of
        ``COMPARED`` that support the system.
        """
        case, show = self.case, current()
        step_count(case.dt, case.t_end)
        one_of("contact", self.contact, TREATMENTS)
        positive("budget", self.budget)
        form = self.form or (case.runs[0][1] if case.runs else case.forms[0])
        system = case.system(form)
        if references is None:
            exact = not substitute(system, case.t_end)
            references = COMPARED_RIGID if system.rigid else COMPARED if exact else COMPARED[1:]
        for name in references:
            method_of(name, "references")
        chosen = integrators(compared(case, form) if schemes is None else schemes)
        refused = list[Exception]()
        for one in (x for x in chosen if x.kind != SOLVER):
            label = f"{one.label}@{system.form}"
            show(label, 0, 0)
            repeat = fastest if one.kind == SCHEME else lambda march: march()
            try:
                self.runs.append(repeat(lambda one=one: one.run(system, case.dt, case.t_end, self.contact)))
                yield self.runs[-1]
            except (Diverged, InputError, SolverFailure) as error:
                self._note(label, error)
                refused.append(error)
        if not self.runs and refused and all(isinstance(x, InputError) and x.field != "dt" for x in refused):
            raise refused[0]  # nothing was run: the fault is in the input, not in a scheme
        methods, main = dict.fromkeys([*references, *(x.source for x in chosen if x.kind == SOLVER)]), None
        for solution in self._references(system, list(methods)):
            for run in self.runs if main is None else [solution]:
                show(f"measuring {run.label}", 0, 0)
                try:
                    self.comparisons.append(compare(run, main or solution))
                except InputError as error:  # one run that cannot be compared does not end the others
                    self.failures.append(("failed", run.label, str(error)))
            main = main or solution
            yield solution

    def _references(self, system: System, methods: Sequence[str]) -> Iterator[Reference]:
        """Yield the main reference, the first of ``methods`` that can take the system, then the others to its
        horizon."""
        main, case, show = None, self.case, current()
        steps, seconds = round(case.t_end / case.dt), MAIN * self.budget
        for method in methods:
            label = f"{method}@{system.form}"
            show(label if main is None else f"{label} to the horizon {steps * case.dt:.3g}", 0, 0)
            # The exact solution takes no longer than reading a file.
            solve = cached_reference if self.cache and method != "exact" else reference
            # Stored and adaptive solutions answer at the times they were asked for: the runs' own steps.
            whole = main is None and method == "exact"
            times = np.arange(steps + 1) * case.dt
            t_end = case.t_end if main is None else float(times[-1])
            try:
                solution = solve(system, t_end, method, None if whole else times, progress=False, seconds=seconds)
            except (InputError, SolverFailure) as error:
                self._note(label, error)
                continue
            if main is None:
                main, seconds = solution, self.budget
                window = min(float(solution.t[-1]), solution.horizon)
                steps = int(np.floor(window / case.dt * (1 + 1e-12)))
            self.references.append(solution)
            yield solution
            if steps < 2:
                return

    def _note(self, label: str, error: Exception) -> None:
        """A run or reference that there is not, and why."""
        kind = "refused" if isinstance(error, InputError) else "failed"
        self.failures.append((kind, label, str(error)))

    def report(self) -> Report:
        """The tables of what has been compared."""
        return Report(self.comparisons, self.references, self.failures)

    def to_dict(self) -> dict[str, Any]:
        """Case, comparisons and failures as plain numbers and texts, for JSON."""
        return {
            "measured": ["references.seconds", "comparisons.seconds", "comparisons.ns_per_step"],
            "case": self.case.name,
            "title": self.case.title,
            "units": list(self.case.units),
            "dt": self.case.dt,
            "t_end": self.case.t_end,
            "cells": self.case.cells or None,
            "inferred": list(self.case.notes),
            "references": [
                {"label": r.label, "horizon": r.horizon, "seconds": r.work.seconds, "provenance": r.provenance}
                for r in self.references
            ],
            "comparisons": [c.to_dict() for c in self.comparisons],
            "failures": [{"run": label, "message": message} for _, label, message in self.failures],
        }
