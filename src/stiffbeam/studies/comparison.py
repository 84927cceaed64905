"""Comparison of the schemes of a case with SUNDIALS and the exact solution: ``stiffbeam compare``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..basics.resources import current
from ..basics.validation import InputError, one_of, step_count
from ..files.cases import Case, compared
from ..files.store import cached_reference
from ..integrators import SCHEME, SOLVER, fastest, integrators
from ..march.treatment import TREATMENTS
from ..measures.comparison import Comparison, compare
from ..measures.report import Report, report_of
from ..model.system import System
from ..references import substitute
from ..references.registry import BUDGET, COMPARED, COMPARED_RIGID, method_of
from ..trajectory.trajectory import Diverged, Reference, SolverFailure, Trajectory


@dataclass(frozen=True, repr=False)
class CaseComparison:
    """A comparison of the runs of a case, see ``run``, and what it has so far.

    form: None for that of the case's first run. budget: CPU seconds of each reference, which ends earlier where it
    needs more. failures: ("failed" or, of what cannot be asked of the case, "refused", label, message).
    """

    case: Case
    form: str | None = None
    contact: str = "implicit"
    budget: float = BUDGET
    runs: list[Trajectory] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)  # the main one first
    comparisons: list[Comparison] = field(default_factory=list)  # one for each run and further reference
    failures: list[tuple[str, str, str]] = field(default_factory=list)

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
            self.failures.clear()
            raise refused[0]  # nothing was run: the fault is in the input, not in a scheme
        main: Reference | None = None
        for method in dict.fromkeys([*references, *(x.source for x in chosen if x.kind == SOLVER)]):
            try:
                solution = self._solve(system, method, main)
            except (InputError, SolverFailure) as error:
                self._note(f"{method}@{system.form}", error)
                continue
            if solution is None:
                return
            self.references.append(solution)
            for run in self.runs if main is None else [solution]:
                show(f"measuring {run.label}", 0, 0)
                try:
                    self.comparisons.append(compare(run, main or solution))
                except InputError as error:  # one run that cannot be compared does not end the others
                    self.failures.append(("failed", run.label, str(error)))
            main = main or solution
            yield solution

    def _solve(self, system: System, method: str, main: Reference | None) -> Reference | None:
        """The main reference to the end of the case, or another one to its horizon; None where that is no two steps."""
        case, steps, label = self.case, round(self.case.t_end / self.case.dt), f"{method}@{system.form}"
        if main is not None:
            steps = int(np.floor(min(float(main.t[-1]), main.horizon) / case.dt * (1 + 1e-12)))
            label += f" to the horizon {steps * case.dt:.3g}"
            if steps < 2:
                return None
        current()(label, 0, 0)
        times = np.arange(steps + 1) * case.dt
        # Stored and adaptive solutions answer at the times they were asked for: the runs' own steps.
        asked = None if main is None and method == "exact" else times
        end = case.t_end if main is None else float(times[-1])
        return cached_reference(system, end, method, asked, progress=False, seconds=self.budget)

    def _note(self, label: str, error: Exception) -> None:
        """A run or reference that there is not, and why."""
        kind = "refused" if isinstance(error, InputError) else "failed"
        self.failures.append((kind, label, str(error)))

    def report(self) -> Report:
        """The tables of what has been compared."""
        return report_of(self.comparisons, self.failures)

    def to_dict(self) -> dict[str, Any]:
        """Case, comparisons and failures as plain numbers and texts, for JSON."""
        references = [
            {"label": r.label, "horizon": r.horizon, "seconds": r.work.seconds, "provenance": r.provenance}
            for r in self.references
        ]
        case = self.case
        return {
            "measured": ["references.seconds", "comparisons.seconds", "comparisons.ns_per_step"],
            "case": case.name, "title": case.title, "units": list(case.units), "dt": case.dt, "t_end": case.t_end,
            "cells": case.cells or None, "inferred": list(case.notes), "references": references,
            "comparisons": [c.to_dict() for c in self.comparisons],
            "failures": [{"run": label, "message": message} for _, label, message in self.failures],
        }  # fmt: skip
