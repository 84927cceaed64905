"""The score: errors and orders of integrators on problems with known answers, one flag with its reason."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator

from ..basics.arrays import Array
from ..basics.resources import Show, working
from ..basics.storage import write_whole
from ..basics.text import plain
from ..basics.validation import InputError, sequence
from ..figures import chart
from ..figures.chart import Figure
from ..files.columns import TIMES, bare, read_columns, time_of
from ..integrators import FUNCTION, RECORDED, SCHEME, SOLVER, Integrator, finite_run
from ..integrators import integrators as integrators_of
from ..measures.errors import Order, observed_order
from ..measures.report import DASH, Report, Reported, short
from ..references.registry import BEST
from ..schemes import RIGID, SCHEMES
from ..trajectory.records import ContactRecord
from ..trajectory.trajectory import Diverged, Reference, SolverFailure, Trajectory
from .problem import VERSION, Problem, problem
from .problem import problems as all_problems

DEFAULT = (*SCHEMES, *RIGID, *BEST)  # a solver of each kind; others by name
TOLERANCES = (1e-4, 1e-6, 1e-8)
SMOOTH = "free-oscillator"
CONVERGES, STAYS, LOW_ORDER, MISSED = "converges", "error does not fall", "order too low", "impact missing"
FAILED, NOT_TAKEN, NOT_JUDGED = "failed", "not taken", "not judged"
SPAN = 0.26  # of the longest step, what the shortest is at most where it is judged how errors fall
SHORTER = 3  # steps that are added, each half of the one before
FLOOR = 1e-9  # of max |u|: below it rounding hides how an error falls
STEADY = 1.25  # what an error that no longer falls may scatter by
FALL = 0.5  # of an error: what is left of it at a quarter of the step where a method is of order 1/2
ORDER_SLACK = 0.5  # of an observed order: where an impact lies within its step scatters the errors
TIMES_TOLERANCE = 1e4  # an adaptive solver through contact stays within so many times its relative tolerance
QUANTITIES = {
    "tip_error": "tip", "velocity_error": "velocity", "impact_time_error": "impact times",
    "peak_force_error": "peak force", "energy_error": "energy",
}  # fmt: skip
COARSE = 0.04  # of max |v|: below it the velocity's error may fall slowly in problems without an order limit
SMALL = 2  # unknowns; in bars and beams fronts limit the order of the velocity
PAIRED = 8  # impacts that are compared with the known ones
NAN = float("nan")
NONE = Order(NAN, NAN, NAN, 0)


@dataclass(frozen=True)
class Entry:
    """Result of one integrator on one problem.

    runs: one row a run, the coarsest first: level (steps, or relative tolerance), cost (stages, evaluations, or steps
    of a function), seconds, and the columns of ``errors_of``. outcome: "converges", "error does not fall", "order too
    low", "impact missing", "failed", "not taken" or "not judged"; reason: a sentence, "" where it converges. order:
    observed, of the error of the tip, or of the velocity where that is too low, see ``order_of``. expected: the smaller
    of the order on smooth motion and the problem's limit, NaN if unknown.
    """

    integrator: str
    problem: Problem = field(repr=False)
    runs: tuple[dict[str, float], ...]
    adaptive: bool
    outcome: str = ""
    reason: str = ""
    order: Order = NONE
    expected: float = NAN
    order_of: str = "tip"

    @property
    def flagged(self) -> bool:
        """True if the outcome is a fault of the integrator."""
        return self.outcome in (STAYS, LOW_ORDER, MISSED, FAILED)

    @property
    def best(self) -> dict[str, float]:
        """The row of the finest run, {} where there is none."""
        return self.runs[-1] if self.runs else {}

    def order_in(self, column: str) -> Order:
        """The order of a column of ``runs``, through the errors that rounding does not hide."""
        rows = [run for run in self.runs if FLOOR < abs(run[column]) < np.inf]
        return observed_order([1.0 / run["level"] for run in rows], [abs(run[column]) for run in rows])

    def row(self) -> dict[str, Any]:
        """Outcome, orders and the errors of the finest run."""
        return {
            "integrator": self.integrator, "problem": self.problem.name, "outcome": self.outcome,
            "order": self.order.slope, "order_interval": self.order.interval, "expected_order": self.expected,
            "order_of": self.order_of,
            **self.best, "reason": self.reason,
        }  # fmt: skip


@dataclass(frozen=True, repr=False)
class Scorecard(Reported):
    """Entries of a score, integrator by integrator and problem by problem.

    Parameters
    ----------
    entries : sequence of Entry
    """

    entries: tuple[Entry, ...]

    @property
    def flagged(self) -> tuple[Entry, ...]:
        """The entries with wrong results, or that broke off."""
        return tuple(entry for entry in self.entries if entry.flagged)

    @property
    def integrators(self) -> list[str]:
        """The names of the integrators, in the order of the entries."""
        return list(dict.fromkeys(entry.integrator for entry in self.entries))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and texts, for JSON."""
        entries = [e.row() | {"runs": list(e.runs)} for e in self.entries]
        return plain({"measured": ["entries.seconds", "entries.runs.seconds"], "test_set": VERSION,
                      "entries": entries})  # fmt: skip

    def to_dataframe(self) -> pd.DataFrame:
        """One line per run."""
        names = ["integrator", "problem", "outcome"]
        return pd.DataFrame([{k: e.row()[k] for k in names} | run for e in self.entries for run in e.runs])

    def summary(self) -> str:
        """Number of entries for each outcome, as a sentence."""
        outcomes = Counter(e.outcome for e in self.entries)
        return ", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common())

    def table(self) -> pd.DataFrame:
        """Texts to print: of one integrator all errors, of several the tip error of each, by problem."""
        if len(self.integrators) > 1:
            cells: dict[str, dict[str, str]] = {short(name): {} for name in self.integrators}
            for e in self.entries:
                known = _number(e.best.get("tip_error", np.nan)) + " !" * e.flagged
                cells[short(e.integrator)][e.problem.name] = FAILED if e.outcome == FAILED else known or DASH
            return pd.DataFrame(cells).rename_axis("problem").reset_index()
        lines = [
            {
                "problem": e.problem.name,
                "order": f"{e.order_of}: {e.order}".removeprefix("tip: ") if np.isfinite(e.order.interval) else "",
                "expected": f"{e.expected:.3g}" if np.isfinite(e.expected) else "",
                **{name: _number(abs(e.best.get(column, np.nan))) for column, name in QUANTITIES.items()},
                "outcome": e.outcome,
            }
            for e in self.entries
        ]
        table: Any = pd.DataFrame(lines)
        return table[[x for x in table if x in ("problem", "outcome") or any(table[x] != "")]]

    def report(self) -> Report:
        """The summary, the table, and every reason, once for all problems and integrators that share it."""
        who = self.integrators[0] if len(self.integrators) == 1 else f"test set {VERSION}"
        head = "Errors are those of the finest run; of the tip the rms over its largest displacement."
        if len(self.integrators) > 1:
            head = f"Tip error of the finest run. !: see below. {DASH}: {NOT_TAKEN}."
        alike: dict[tuple[str, ...], list[Entry]] = {}
        for e in sorted((e for e in self.entries if e.reason), key=lambda e: not e.flagged):
            # Refusals name the value of the problem, which is another one in each.
            reason = e.reason.partition(" must ")[0] if e.outcome == NOT_TAKEN else e.reason
            alike.setdefault((e.integrator, e.outcome, reason), []).append(e)
        notes = [
            f"{short(each[0].integrator)} on {', '.join(e.problem.name for e in each)}: {outcome}, {each[0].reason}"
            for (_, outcome, _), each in alike.items()
        ]
        return Report([f"{who}: {self.summary()}"], [("", self.table())], [head, *notes])

    def __repr__(self) -> str:
        return f"<Scorecard of {', '.join(self.integrators)}: {self.summary()}>"

    def figure(self, problem: str) -> Figure:
        """Error of the tip on a problem over the cost."""
        entries = [e for e in self.entries if e.problem.name == problem and e.runs]
        figure = chart.new_figure(4.2, entries[0].problem.title, width=7.0)
        axis = figure.subplots()
        for e in entries:
            errors = np.maximum([run["tip_error"] for run in e.runs], 1e-16)
            style: Any = chart.look(e.integrator) | {"ms": 4, "lw": 1.2}
            axis.plot([run["cost"] for run in e.runs], errors, label=short(e.integrator), **style)
        axis.set(xlabel="stages, or right-hand sides", ylabel="rms error of u over max |u|")
        chart.log_scale(axis)
        chart.mark_order(axis, [-2.0], y=0.95)  # errors fall to the right: above them is room
        chart.shared_legend(figure, 6)
        return figure

    def save(self, folder: str | Path) -> list[Path]:
        """Write score.txt, score.csv, score.json and a picture of each problem that an integrator has run."""
        folder = Path(folder)
        texts = {
            "score.txt": f"{self}\n", "score.csv": self.to_dataframe().to_csv(index=False),
            "score.json": json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n",
        }  # fmt: skip
        written = [write_whole(folder / name, text) for name, text in texts.items()]
        run = dict.fromkeys(e.problem.name for e in self.entries if e.runs)
        return written + [chart.save_figure(self.figure(name), folder / f"{name}.png") for name in run]


def _number(x: float) -> str:
    """An error with two digits, empty if it is not known."""
    return "" if not np.isfinite(x) else "0" if x == 0.0 else f"{x:.1e}"


def score(
    integrators: Any = None,
    problems: str | Problem | Iterable[str | Problem] | None = None,
    progress: bool | Show = False,
) -> Scorecard:
    """Return the errors of integrators on problems with known answers, with orders and a verdict each.

    A fixed-step integrator makes one run at each of the problem's ``steps``, and shorter ones if it overflows or misses
    impacts there; an adaptive one runs at relative tolerances of 1e-4, 1e-6 and 1e-8. An integrator that refuses a
    problem or returns arrays of another shape is "not taken", one that breaks off or raises is "failed".

    Parameters
    ----------
    integrators : one or a sequence, optional
        A Scheme; the label of a scheme or reference solver ("HHT(alpha=-0.1)", "cvode"); a function
        solve(system, dt, t_end) -> (t, u) or (t, u, v), where u and v are the tip (k,) or all unknowns (k, n) at the
        times t (k,); or runs recorded on the problems' systems (``Trajectory.from_arrays``), those of one name as one
        integrator. By default all schemes and a solver of each kind.
    problems : str, Problem or a sequence, optional
        By default all. With ``free-oscillator`` among them, the order measured there is expected of a function on the
        others.
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
    >>> sb.score(sb.HHT(alpha=-0.1), "free-oscillator").summary()
    '1 converges'
    """
    chosen = list(all_problems().values())
    if problems is not None:
        given = [problems] if isinstance(problems, (str, Problem)) else problems
        asked = sequence("problems", given, "be names of problems")
        chosen = sorted((x if isinstance(x, Problem) else problem(x) for x in asked), key=lambda x: x.number)
    those = DEFAULT if integrators is None else integrators
    runners = integrators_of(those if isinstance(those, (list, tuple)) else [those])
    entries = []
    with working("score", progress) as show:
        for i, runner in enumerate(runners):
            smooth = runner.order
            for k, each in enumerate(chosen):
                show(f"{runner.label}: {each.name}", i * len(chosen) + k, len(runners) * len(chosen))
                entry = _entry(runner, each, smooth)
                if each.name == SMOOTH and entry.order.points >= 3:
                    # Its order with contact follows from that without, even if it states a lower one.
                    smooth = float(np.nanmax([smooth, entry.order_in("tip_error").slope]))
                    entry = verdict(entry, smooth)
                entries.append(entry)
    return Scorecard(tuple(entries))


def score_trajectories(name: str | Problem, runs: Sequence[tuple[Any, ...]], label: str = "trajectory") -> Scorecard:
    """The score of runs of one problem by any program: each (t, u) or (t, u, v), t (k,), u and v the tip (k,) or all
    unknowns (k, n). Several runs with different steps have an order; a single run has only errors.

    Raises InputError for arrays that do not fit the problem.
    """
    chosen = name if isinstance(name, Problem) else problem(name)
    try:
        those = [_of_problem(chosen, finite_run(run, chosen.system, label)) for run in runs]
    except Diverged as error:
        raise InputError("the run", str(error), "be finite", "end the run before it overflows") from None
    return score([those], chosen)


def _of_problem(each: Problem, run: Trajectory) -> Trajectory:
    """``run``. Raises InputError where its times do not cover those of the problem."""
    least = 1.0 - 2.0**-23  # single precision may end before it
    if run.t[-1] < each.t_end * least or np.count_nonzero(run.t <= each.t_end * (2.0 - least)) < 4:
        rule = f"reach t_end = {each.t_end:g} in four steps or more"
        raise InputError("the run's times", (run.t[0], run.t[-1]), rule, "are they in another unit?")
    return run


def _entry(runner: Integrator, each: Problem, smooth: float) -> Entry:
    """All runs of an integrator on a problem, judged."""
    entry = Entry(runner.label, each, (), runner.kind == SOLVER)
    try:
        runs, reason = _runs(runner, each)
    except InputError as error:
        return replace(entry, outcome=NOT_TAKEN, reason=str(error))
    except (Diverged, SolverFailure) as error:
        return replace(entry, outcome=FAILED, reason=str(error))
    return verdict(replace(entry, runs=tuple(runs), reason=reason, outcome=FAILED if reason else ""), smooth)


def _runs(runner: Integrator, each: Problem) -> tuple[list[dict[str, float]], str]:
    """One row per level, and the reason why a run broke off although one with longer steps did not.

    Raises Diverged where no run holds.
    """
    levels, rows, lost = list[float](each.steps), list[dict[str, float]](), 0.0
    if runner.kind == SOLVER:
        levels = list(TOLERANCES if runner.adaptive else TOLERANCES[-1:])
    if runner.kind == RECORDED:
        steps = (len(run.t) - 1 for run in runner.source if run.fingerprint == each.system.fingerprint)
        levels = list[float](sorted(steps))
    if not levels:
        raise InputError("recorded runs", runner.label, "be of this problem", "record them with its system")
    shorter = SHORTER if runner.kind in (SCHEME, FUNCTION) else 0
    error: Diverged | None = None
    while levels:
        level = levels.pop(0)
        try:
            if runner.kind == SOLVER:
                run = runner.solve(each.system, level, np.append(0.0, each.times), each.t_end)
            else:
                run = runner.run(each.system, each.t_end / level, each.t_end)
            row = {"level": level, "cost": runner.work(run)} | errors_of(each, _of_problem(each, run))
            if not np.isfinite(row["tip_error"]):
                raise Diverged(runner.label, float(run.t[np.argmax(np.abs(run.tip))]), "more steps may help")
            rows.append(row)
        except Diverged as failure:
            error, lost = failure, level
            if rows:
                return rows, f"in {level:g} steps {failure}"
        missing = bool(rows) and 0 <= rows[-1]["impacts"] < len(known_impacts(each))
        if not levels and shorter and rows and (missing or rows[0]["level"] > SPAN * max(lost, rows[-1]["level"])):
            shorter -= 1
            levels.append(2 * level)
    if error is not None and not rows:
        raise error
    return rows, ""


def verdict(entry: Entry, smooth: float) -> Entry:
    """``entry`` with its observed order, outcome and reason.

    smooth: the order of the integrator on smooth motion. Every error of a fixed-step integrator must fall with the step
    (``_stays``); those of impact times, and of a velocity that jumps, may also be less than the shortest step. The
    finest run must have the first impacts. The orders of the tip and, for one or two masses, of its velocity, with
    their 95 % intervals, must come within ``ORDER_SLACK`` of what is expected. The error of an adaptive solver must
    stay within ``TIMES_TOLERANCE`` times its tolerance. Steps that span less than a factor of four are not judged.
    """
    if entry.outcome in (NOT_TAKEN, FAILED) or not entry.runs:
        return entry
    levels, error = np.array([run["level"] for run in entry.runs]), entry.best["tip_error"]
    if entry.adaptive and error <= max(TIMES_TOLERANCE * levels[-1], FLOOR):
        return replace(entry, outcome=CONVERGES)
    if entry.adaptive:
        return replace(entry, outcome=STAYS, reason=f"a tip error of {error:.1e} at rtol {levels[-1]:.0e}")
    if np.min(levels) > SPAN * np.max(levels):
        return replace(entry, outcome=NOT_JUDGED, reason="its steps span less than a factor of four")
    limit = entry.problem.order_limit
    # Whatever converges is of first order at least where the motion is smooth.
    expected = min(float(np.fmax(smooth, 1.0)), limit) if limit > 0.0 else NAN
    judged = {"order": entry.order_in("tip_error"), "expected": expected, "order_of": "tip"}
    entry = replace(entry, **judged, outcome=CONVERGES, reason="")
    return replace(entry, **next(_faults(entry, levels, smooth), {}))


def _faults(entry: Entry, levels: Array, smooth: float) -> Iterator[dict[str, Any]]:
    """Outcome and reason of each fault of fixed-step runs, the worst first, with the order that is judged."""
    limit = entry.problem.order_limit
    least = {
        "impact_time_error": entry.problem.t_end / levels[-1],
        "velocity_error": COARSE if limit <= 0.0 else 1.0 / levels[-1] if limit <= 1.0 else FLOOR,
    }
    for name in QUANTITIES:
        of = np.abs([run[name] for run in entry.runs])
        if np.all(np.isfinite(of)) and of[-1] > least.get(name, FLOOR) and (last := _stays(levels, of)):
            steps = f"in {levels[-last]:g} to {levels[-1]:g} steps"
            yield {"outcome": STAYS, "reason": f"{QUANTITIES[name]} from {of[-last]:.1e} to {of[-1]:.1e} {steps}"}
    most, seen = len(known_impacts(entry.problem)), entry.best["impacts"]
    if 0 <= seen < most:
        yield {"outcome": MISSED, "reason": f"the finest run has {seen} of the first {most} impacts"}
    if seen > 0 and "impacts" in entry.problem.answers and not most:
        yield {"outcome": STAYS, "reason": f"the finest run has {seen} impacts where there are none"}
    for name in ("tip_error", "velocity_error") if entry.problem.system.size <= SMALL else ("tip_error",):
        order, expected = entry.order_in(name), entry.expected
        if name == "velocity_error" and not np.isfinite(smooth):
            expected = min(entry.order.slope, limit)
        if order.points >= 4 and order.slope + order.interval < expected - ORDER_SLACK:
            reason = f"{QUANTITIES[name]}: {order}, {expected:.3g} expected"
            judged = {"order": order, "expected": expected, "order_of": QUANTITIES[name]}
            yield {"outcome": LOW_ORDER, "reason": reason} | judged


def _stays(levels: Array, errors: Array) -> int:
    """Number of the finest runs whose errors do not fall with the step, 0 where errors fall. They fall if the median of
    the finest errors is below ``FALL`` times that of steps four times as long, or if the order through the finer half
    of the runs may be 1/2 or more, its 95 % interval included. Without such an order the errors of the finest third
    must differ.

    Medians over a third of the runs each: one error may be small by chance, and those of impacts scatter as these lie
    within their steps.
    """
    count = max(1, len(errors) // 3)
    before = np.flatnonzero(levels <= SPAN * np.max(levels))
    fine, coarse = np.median(errors[-count:]), np.median(errors[before[-count:]])
    if fine <= FLOOR:
        return 0

    def most(runs: int) -> float:
        """The largest order that the finest runs allow; NaN for two."""
        order = observed_order(1.0 / levels[-runs:], np.maximum(errors[-runs:], FLOOR))
        return order.slope + order.interval

    # The finest errors are nearly equal and leave no room for an order of 1/2: they no longer fall.
    last = errors[-max(3, count) :]
    if np.max(last) < STEADY * np.min(last) and most(len(last)) < 0.5:
        return len(last)
    half = min(len(errors), max(4, len(errors) // 2))
    return 0 if fine <= FALL * coarse or most(half) >= 0.5 else half


# ---------------------------------------------------------------- errors of a run


@np.errstate(over="ignore", invalid="ignore")  # a run may have grown to 1e200
def errors_of(problem: Problem, run: Trajectory) -> dict[str, float]:
    """Seconds and errors of a run against the answers of a problem, NaN where run or problem lack the quantity.

    tip_error, tip_error_max: rms and largest |u - u_known| at the sample times, over max |u_known|. velocity_error:
    median of |v - v_known| there, over max |v_known|, which a jump at a sample does not spoil. impacts: number of
    impacts, -1 if unknown. impact_time_error: largest error of the first ``PAIRED`` impact times. peak_force_error:
    relative. energy_error: at t_end, over the energy that the system has had; > 0 is a gain.
    """
    known = problem.answers["tip"].value
    off = np.abs(_at(problem.times, run.t, run.tip, run.tip_velocity) - known) / np.max(np.abs(known))
    velocity = NAN
    if "tip_velocity" in problem.answers and "tip_velocity" not in run.provenance:
        rates = problem.answers["tip_velocity"].value
        velocity = float(np.median(np.abs(_at(problem.times, run.t, run.tip_velocity) - rates)))
        velocity /= float(np.max(np.abs(rates)))
    impacts, late = run.impacts.until(problem.t_end * (1 + 1e-9)), NAN
    times = known_impacts(problem)
    if 0 < len(times) <= impacts.count:
        late = float(np.max(np.abs(impacts.times[: len(times)] - times)))
    return {
        "seconds": run.work.seconds,
        "tip_error": float(np.sqrt(np.mean(off**2))), "tip_error_max": float(np.max(off)), "velocity_error": velocity,
        "impacts": -1 if impacts.kind == "unknown" else impacts.count, "impact_time_error": late,
        "peak_force_error": _peak(problem, run), "energy_error": _energy(problem, run),
    }  # fmt: skip


def known_impacts(problem: Problem) -> Array:
    """The first known impact times, at most PAIRED."""
    return problem.answers["impacts"].value[:PAIRED] if "impacts" in problem.answers else np.zeros(0)


def _at(times: Array, t: Array, u: Array, v: Array | None = None) -> Array:
    """u at the sample times: the run's own values where it has these times, else by cubics."""
    nearest = np.clip(np.searchsorted(t, times), 1, len(t) - 1)
    nearest -= np.abs(t[nearest - 1] - times) < np.abs(t[nearest] - times)
    if np.all(np.abs(t[nearest] - times) <= 1e-9 * times[-1]):
        return u[nearest]
    spline = CubicSpline(t, u) if v is None else CubicHermiteSpline(t, u, v)
    return spline(np.minimum(times, t[-1]))


def _peak(problem: Problem, run: Trajectory) -> float:
    """Relative error of the largest force on the first contact."""
    record = run.contacts[0]
    if "peak_force" not in problem.answers or record.impacts.kind == "unknown" or record.stops.rigid:
        return NAN
    if isinstance(run, Reference):
        peak = record.peak_force
    elif record.stops.law.damps and "tip_velocity" in run.provenance:
        return NAN  # the force needs the velocity
    else:
        peak = _peak_between(run, record)
    return peak / problem.answers["peak_force"].value - 1.0


def _peak_between(run: Trajectory, record: ContactRecord) -> float:
    """Largest force at the steps and, by cubics, between them: where the contact turns and beside the largest forces.

    The largest at the steps alone is less by up to (w dt)^2/8.
    """
    t, u, v = run.t, record.position, record.velocity
    spline = CubicHermiteSpline(t, u, v)
    force = np.abs(record.stops.force(u, v))
    high = np.flatnonzero(force >= 0.9 * np.max(force))  # a damped stop may have its peak where nothing turns
    ends = np.unique(np.clip(np.concatenate([high - 1, high]), 0, len(t) - 2))
    fine = (t[ends, None] + np.diff(t)[ends, None] * np.linspace(0.0, 1.0, 33)[1:-1]).ravel()
    turns = spline.derivative().roots(extrapolate=False)
    fine = np.concatenate([t, fine, turns[np.isfinite(turns)]])
    # The velocity by cubics of its own: the derivative of those of u has the rounding of u over dt.
    return float(np.max(np.abs(record.stops.force(spline(fine), PchipInterpolator(t, v)(fine)))))


def _energy(problem: Problem, run: Trajectory) -> float:
    """Energy at t_end less the known one, over the energy that the system has had."""
    system = problem.system
    unknown = run.pieces is None and not isinstance(run, Reference)
    if "energy" not in problem.answers or unknown or any(c.offset is not None for c in system.contacts):
        return NAN
    last = int(np.argmin(np.abs(run.t - problem.t_end)))
    q, v = (x[last] for x in run.states)
    energy = float(sum(system.free_energies(q, v) if system.rigid else system.energies(run.t[last], q, v)))
    return (energy - problem.answers["energy"].value) / problem.answers["energy_scale"].value


COLUMNS: dict[int | str, str] = {  # t, u or v by name, and by position where there are no names
    **dict(enumerate("tuv")), **dict.fromkeys(TIMES, "t"), **dict.fromkeys(("u", "tip", "displacement"), "u"),
    **dict.fromkeys(("v", "velocity", "tip_velocity"), "v"),
}  # fmt: skip


def read_trajectory(file: Path) -> tuple[Array, ...]:
    """(t, u), or (t, u, v) where there is a third column, see ``read_columns``.

    A first line may name them in any order: t or time; u, tip or displacement; v, velocity or tip_velocity. Without
    names that is the order. Raises InputError for other names, and for less than four rows.
    """
    table = read_columns(file, "--trajectory")
    names = [COLUMNS.get(x if isinstance(x, int) else bare(x)[0], str(x)) for x in table.columns]
    if sorted(names) not in (["t", "u"], ["t", "u", "v"]):
        written = f"{file}: {' '.join(map(str, table.columns))!r}"
        raise InputError("--trajectory", written, "name t, u and perhaps v, each once", "write for example t,u,v")
    if len(table) < 4:
        found, remedy = f"{file}: {len(table)} lines of numbers", "write the run out at more times"
        raise InputError("--trajectory", found, "hold at least 4 of them", remedy)
    time_of(file, "--trajectory", table, "s")
    return tuple(table.iloc[:, names.index(name)].to_numpy(float) for name in "tuv" if name in names)
