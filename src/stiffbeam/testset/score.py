"""The score: errors of integrators on the problems with known answers, and verdicts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..basics.progress import Show, working
from ..basics.validation import InputError, sequence
from ..trajectory.trajectory import Diverged, SolverFailure
from .integrators import DEFAULT, FUNCTION, RECORDED, SCHEME, Integrator, Made
from .integrators import integrators as integrators_of
from .measure import (
    FAILED,
    NOT_FALLING,
    NOT_TAKEN,
    SPAN,
    Entry,
    Run,
    errors_of,
    impacts_of,
    lost_to_digits,
    motion_of,
    verdict,
    with_digits,
)
from .problem import Problem, problem
from .problem import problems as all_problems
from .scorecard import Scorecard

SMOOTH = "free-oscillator"
OFF_GRID = 1.23, 1.52, 1.87  # times the most steps, to confirm that an error does not fall


def score(
    integrators: Any = None,
    problems: str | Problem | Iterable[str | Problem] | None = None,
    order: float | None = None,
    statistics: bool = True,
    progress: bool | Show = False,
) -> Scorecard:
    """Return the errors of integrators on problems with known answers: against cost, with orders, impacts and forces.

    A fixed-step integrator makes one run at each of the problem's ``steps``, and three at shorter steps if an error
    does not fall; an adaptive one runs at relative tolerances of 1e-4, 1e-6 and 1e-8. An integrator that refuses a
    problem is "not taken". One that breaks off, raises or returns a wrong shape is "failed", with the reason, and the
    others go on. A step at which it overflows is left out if shorter ones do not overflow; shorter ones are added,
    until those that hold span a factor of four.

    Parameters
    ----------
    integrators : one or a sequence, optional
        A Scheme; the label of a scheme or reference solver ("HHT(alpha=-0.1)", "cvode"); a function
        solve(system, dt, t_end) -> (t, u), (t, u, v) or (t, u, v, gradients), where u and v are the tip (k,) or all
        unknowns (k, n) at the times t (k,), and gradients the derivatives of the tip at t_end by paths such as
        "q0[0]", see ``Problem.derivatives``; or runs recorded on the problems' systems (``Trajectory.from_arrays``),
        those of one name as one integrator. By default all schemes and solvers of the package.
    problems : str, Problem or a sequence, optional
        By default all.
    order : float, optional
        Order of the functions on smooth motion. Where ``free-oscillator`` is among the problems, the order measured
        there counts if it is higher.
    statistics : bool
        Also measure past the horizon.
    progress : bool or callable
        True shows a bar; a function is called as show(what, done, total).

    Returns
    -------
    Scorecard

    Raises
    ------
    InputError
        For anything that is neither an integrator nor a problem.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> card = sb.score(sb.HHT(alpha=-0.1), "free-oscillator")
    >>> len(card.entries)
    1
    """
    chosen = _problems(problems)
    given = DEFAULT if integrators is None else integrators
    runners = integrators_of(given if isinstance(given, (list, tuple)) else [given], order)
    entries = []
    with working("score", progress) as show:
        for i, runner in enumerate(runners):
            smooth = runner.order
            for k, each in enumerate(chosen):
                show(f"{runner.label}: {each.name}", i * len(chosen) + k, len(runners) * len(chosen))
                entry = _entry(runner, each, smooth, statistics)
                if each.name == SMOOTH and entry.order.points >= 3:
                    # What is seen here is expected with contact too, whatever less a scheme states.
                    smooth = float(np.nanmax([smooth, entry.order.slope]))
                    entry = verdict(entry, smooth)
                entries.append(entry)
    return Scorecard(tuple(entries))


def score_trajectories(name: str | Problem, runs: Sequence[tuple[Any, ...]], label: str = "trajectory") -> Scorecard:
    """The score of runs of one problem by any program: each (t, u) or (t, u, v), t (k,), u and v the tip (k,) or all
    unknowns (k, n). Several runs with different steps have an order; a single run has only errors. Errors that do not
    fall because the numbers have too few digits are marked as such.

    Raises InputError for arrays that do not fit the problem.
    """
    chosen = name if isinstance(name, Problem) else problem(name)
    motions = sorted((motion_of(chosen, *run) for run in runs), key=lambda motion: len(motion.t))
    made = [Made(len(m.t) - 1, len(m.t) - 1, float("nan"), m) for m in motions]
    known = tuple(_run(chosen, one) for one in made)
    reason = next((why for one, run in zip(made, known, strict=True) if (why := _uncounted(chosen, one, run))), "")
    entry = verdict(Entry(label, chosen, known, "", reason, float("nan"), False), float("nan"))
    return Scorecard((with_digits(entry, max(lost_to_digits(chosen, motion) for motion in motions)),))


def _uncounted(each: Problem, made: Made, run: Run) -> str:
    """Reason why impacts are not judged although the problem has some; empty if they are."""
    known = each.answers.get("impacts")
    if run.errors.impacts >= 0 or known is None or not len(known.value):
        return ""
    if made.motion.position is None:
        return "the contact is not at the tip: give all unknowns, (k, n), or its impacts are not counted"
    return "positions only, and steps too long for impacts that follow each other: they are not counted"


def _problems(given: Any) -> list[Problem]:
    if given is None:
        return list(all_problems().values())
    chosen = [given] if isinstance(given, (str, Problem)) else sequence("problems", given, "be names of problems")
    problems = [x if isinstance(x, Problem) else problem(x) for x in chosen]
    return sorted(problems, key=lambda x: x.number)  # the smooth one first


def _entry(runner: Integrator, each: Problem, smooth: float, statistics: bool) -> Entry:
    runs: list[Run] = []
    overflowed: list[float] = []  # the steps at which it does
    outcome = reason = ""
    past: tuple[dict[str, float], ...] = ()
    try:
        if not (levels := list(runner.levels(each))):
            raise InputError("recorded runs", runner.label, "be of this problem", "record them with its system")
        while levels:
            level = levels.pop(0)
            try:
                made = runner.solve(each, level, each.t_end)
                run = _run(each, made)
                if not np.isfinite(run.errors.tip_rms):
                    raise Diverged("it", made.motion.t[np.argmax(np.abs(made.motion.u))], "more steps may help")
                runs.append(run)
                reason = reason or _uncounted(each, made, runs[-1])
            except Diverged as error:  # in so few steps, or where fewer went through in steps too short for it
                overflowed.append(level)
                reason, outcome = f"in {_range(overflowed)} steps {error}", FAILED if runs else ""
            # Shorter steps in the place of those that overflowed, so that the others can be judged.
            more = runner.kind in (SCHEME, FUNCTION) and not (levels or outcome)
            if overflowed and runs and more and runs[0].level > SPAN * level:
                levels.append(2 * level)
        if overflowed and runs and not outcome:
            reason += f"; judged by {_range([run.level for run in runs])} steps"
        if not runs:
            outcome = FAILED
        if statistics and each.statistics is not None and not runner.adaptive and runner.kind != RECORDED:
            past = _past(runner, each)
    except InputError as error:
        outcome, reason = NOT_TAKEN, str(error)
    except SolverFailure as error:
        outcome, reason = FAILED, str(error)
    except Exception as error:  # of a function of anyone's: one problem that it breaks on is a result
        outcome, reason = FAILED, f"{type(error).__name__}: {error}"
    entry = Entry(runner.label, each, tuple(runs), outcome, reason, runner.order, runner.adaptive, past)
    judged = verdict(entry, smooth)
    return _confirmed(runner, judged, smooth) if judged.outcome == NOT_FALLING and not outcome else judged


def _confirmed(runner: Integrator, entry: Entry, smooth: float) -> Entry:
    """``entry``, whose error does not fall, or its verdict with shorter steps that share no grid with the others: an
    impact that nested steps move to the same time has the same error in all of them."""
    if runner.kind not in (SCHEME, FUNCTION) or runner.adaptive:
        return entry
    try:
        more = [_run(entry.problem, runner.solve(entry.problem, round(f * entry.runs[-1].level), entry.problem.t_end))
                for f in OFF_GRID]  # fmt: skip
    except Exception:  # what the other steps show stands
        return entry
    again = verdict(replace(entry, runs=(*entry.runs, *more), outcome="", missed=()), smooth)
    return entry if again.outcome == NOT_FALLING else again


def _range(levels: Sequence[float]) -> str:
    """The least to the largest of ``levels``."""
    return " to ".join(f"{x:g}" for x in dict.fromkeys((min(levels), max(levels))))


def _run(each: Problem, made: Made) -> Run:
    with np.errstate(over="ignore", invalid="ignore"):  # it may have grown to 1e200
        return Run(made.level, made.cost, made.seconds, errors_of(each, made.motion))


def _past(runner: Integrator, each: Problem) -> tuple[dict[str, float], ...]:
    """Deviation of the statistics of one run from those of the exact ensemble, in standard deviations, at each of the
    steps."""
    known, rows = each.statistics, []
    assert known is not None
    stops = each.system.contacts[0].stops
    for steps in known.steps:
        try:
            motion = runner.solve(each, steps, known.t_end).motion
        except Diverged:
            continue
        impacts = impacts_of(each, motion, known.t_end)
        if impacts is None or motion.position is None:
            return ()
        seen = {
            "impacts": float(impacts.count),
            "contact_fraction": float(np.mean(stops.state(motion.position, motion.velocity) != 0)),
            "median_peak": impacts.median_peak,
        }
        off = {name: (seen[name] - mean) / deviation for name, (mean, deviation) in known.values.items()}
        rows.append({"steps": float(steps), **off})
    return tuple(rows)
