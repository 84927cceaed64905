"""The main job: the schemes of a case beside SUNDIALS and the exact solution."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..cases import Case, paper_cases
from ..march.integrate import CONTACTS, integrate
from ..measures.comparison import Comparison, compare
from ..schemes import BDF2, HHT, SDIRK, Scheme
from ..semidiscretisation import semidiscretise
from ..solvers import METHODS, reference
from ..system import System
from ..trajectory import Diverged, Reference, SolverFailure, Trajectory
from ..validation import InputError, near, step_count

DEFAULT_REFERENCES = ("exact", "cvode", "cvode-adams")
Progress = Callable[[str, int, int], None]  # (what is running, done, total); total 0: unknown


@dataclass(frozen=True)
class CaseComparison:
    """The outcome: one comparison per run and per further reference; failures as (label, message)."""

    case: Case
    runs: list[Trajectory] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)  # the yardstick of each form first
    comparisons: list[Comparison] = field(default_factory=list)
    failures: list[tuple[str, str]] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        return {
            "case": self.case.name,
            "title": self.case.title,
            "dt": self.case.dt,
            "t_end": self.case.t_end,
            "cells": self.case.cells,
            "inferred": list(self.case.notes),
            "references": [
                {"label": r.label, "horizon": r.horizon, "seconds": r.work.seconds, "provenance": r.provenance}
                for r in self.references
            ],
            "comparisons": [c.to_dict() for c in self.comparisons],
            "failures": [{"run": label, "message": message} for label, message in self.failures],
        }


def default_runs(case: Case) -> list[tuple[Scheme, str]]:
    """The case's own runs; for a table of the paper also whichever of its three schemes is missing."""
    runs = list(case.runs)
    if case.name not in paper_cases() or case.runs != paper_cases()[case.name].runs:
        return runs
    names = {scheme.name for scheme, _ in runs}
    for scheme in (BDF2(), SDIRK(nystrom=True), HHT()):
        if scheme.name not in names:
            runs.append((scheme, "displacement"))
    return runs


def compare_case(
    case: Case,
    runs: Sequence[tuple[Scheme, str]] | None = None,
    references: Sequence[str] = DEFAULT_REFERENCES,
    contact: str = "implicit",
    dt: float | None = None,
    t_end: float | None = None,
    progress: Progress = lambda what, done, total: None,
    keep: Callable[[Trajectory], None] = lambda trajectory: None,
    solve: Callable[..., Reference] = reference,
) -> CaseComparison:
    """Run every scheme over the case's time span and hold it against a reference of the same form.

    The first of ``references`` that can take the system is the yardstick over the whole span; the
    others run to its horizon only and are compared like the schemes. A run that fails is reported and
    the others go on. ``keep`` is called with every trajectory as soon as it is finished. ``solve`` makes
    the references: ``cached_reference`` keeps them for the next time.
    """
    case = replace(case, dt=dt or case.dt, t_end=t_end or case.t_end)
    step_count(case.dt, case.t_end)
    if contact not in CONTACTS:
        raise InputError("contact", contact, f"be one of {CONTACTS}")
    for name in references:
        if name not in METHODS:
            raise InputError("references", name, "be a reference method", near(name, METHODS))
    result = CaseComparison(case)
    chosen = list(default_runs(case) if runs is None else runs)
    for form in dict.fromkeys(form for _, form in chosen):
        system = semidiscretise(case.problem, case.cells, form)
        yardstick = _yardstick(system, case, references, result, progress, solve)
        for scheme, _ in (pair for pair in chosen if pair[1] == form):
            label = f"{scheme}@{form}"
            try:
                run = integrate(
                    system, scheme, case.dt, case.t_end, contact,
                    progress=lambda done, label=label: progress(label, done, round(case.t_end / case.dt)),
                )  # fmt: skip
            except (Diverged, InputError) as error:
                if isinstance(error, InputError) and error.field != "dt":  # dt: an erratum refused on this system
                    raise
                result.failures.append((label, str(error)))
                continue
            result.runs.append(run)
            keep(run)
            if yardstick is not None:
                progress(f"measuring {label}", 0, 0)
                _measure(result, run, yardstick)
        if yardstick is not None:
            keep(yardstick)
            for further in _further_references(system, case, references, yardstick, result, progress, solve):
                keep(further)
    return result


def _yardstick(
    system: System,
    case: Case,
    references: Sequence[str],
    result: CaseComparison,
    progress: Progress,
    solve: Callable[..., Reference],
) -> Reference | None:
    for method in references:
        progress(f"{method}@{system.form}", 0, 0)
        steps = round(case.t_end / case.dt)
        try:
            # The adaptive solvers answer at the times they were asked for: the runs' own steps.
            times = None if method in ("exact", "multiprecision") else np.arange(steps + 1) * case.dt
            yardstick = solve(system, case.t_end, method, times)
        except (InputError, SolverFailure) as error:
            result.failures.append((f"{method}@{system.form}", str(error)))
            continue
        result.references.append(yardstick)
        return yardstick
    return None


def _further_references(
    system: System,
    case: Case,
    references: Sequence[str],
    yardstick: Reference,
    result: CaseComparison,
    progress: Progress,
    solve: Callable[..., Reference],
) -> Iterator[Reference]:
    window = min(case.t_end, yardstick.horizon)
    steps = int(np.floor(window / case.dt * (1 + 1e-12)))
    if steps < 2:
        return
    times = np.arange(steps + 1) * case.dt
    tried = {label.partition("@")[0] for label, _ in result.failures} | {yardstick.provenance["method"]}
    for method in references:
        if method in tried:
            continue
        label = f"{method}@{system.form}"
        progress(f"{label} to the horizon {window:.3g}", 0, 0)
        try:
            further = solve(system, float(times[-1]), method, times)
        except (InputError, SolverFailure) as error:
            result.failures.append((label, str(error)))
            continue
        result.references.append(further)
        _measure(result, further, yardstick)
        yield further


def _measure(result: CaseComparison, run: Trajectory, yardstick: Reference) -> None:
    """Compare, or note why it cannot be: one run that cannot be compared does not end the others."""
    try:
        result.comparisons.append(compare(run, yardstick))
    except InputError as error:
        result.failures.append((run.label, str(error)))
