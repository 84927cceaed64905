"""Work and precision: error against work and against seconds, schemes and adaptive solvers in one run."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from typing import Annotated

import numpy as np

from ..basics.validation import InputError, near
from ..figures.chart import Axis, Curve, Level, Mark, Note, Panel, Picture, column, curves, groups, look, short
from ..files.cases import Case
from ..measures.errors import matched_until, tip_error
from ..model.right_hand_side import RightHandSide
from ..model.state_space import state_space
from ..model.system import System
from ..references import expected_seconds, solve, takes
from ..references.registry import MULTIPRECISION, REFERENCES, Steps
from ..testset.integrators import RECORDED, SCHEME, SOLVER, Integrator, fastest
from ..trajectory.trajectory import Reference, Trajectory
from . import common
from .interface import Answer, Point, Records, Row, Rows, declared

SLOW, TOO_SLOW = 1.0, 10.0  # seconds in the registry: only the two loosest tolerances, not at all, unless asked for
METHODS = [m.name for m in REFERENCES.values() if m.kind != MULTIPRECISION]  # which has no error to be seen
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
SAMPLES = 1000
CALLS = 500
AT_MOST = " at most"  # after the name of a method whose cheapest run has a smaller error


def points(
    case: Case,
    *,
    schemes: common.Integrators = None,
    methods: Annotated[list[str] | None, "reference solvers, comma-separated"] = None,
    form: common.Form,
    dt: common.Dt,
    halvings: common.Halvings = 10,
    tolerances: Annotated[list[float] | None, "relative tolerances of solvers, comma-separated"] = None,
    impacts: common.ImpactCount = 4,
) -> list[Point]:
    """Schemes and functions run at ``dt`` (the case's), dt/2, ...; recorded runs at their steps. Solvers run at
    ``tolerances``, by default rtol 1e-4 .. 1e-10, the slow ones at the first two. ``schemes`` and ``methods`` select
    schemes and solvers.

    The error is measured until the first ``impacts`` impacts are over (without contact to half the horizon), before
    chaos amplifies it. Impacts are followed to the horizon. A run that would take more than 10 seconds by an estimate
    is left out, unless it is of a scheme or of a solver that you name.

    Work of a scheme: linear solves. Of a solver: evaluations of the right-hand side, for an implicit one also as many
    linear solves. Of diffrax's solvers: stages, a lower bound, in a run without outputs. Of a function: what its
    Trajectory counts, else its steps. Of the exact solution: evaluations in the event search.

    Seconds are those of stepping, without set-up, which has its own column. They include the recording of impacts for
    schemes and for solvers that restart at each impact. The column python is the least part of the seconds that a
    solver spends in Python's calls of the compiled right-hand side. All columns but seconds, setup, python and
    tracked_seconds are the same in every run.
    """
    system = case.system(form)
    chosen = common.integrators_of(case, schemes)
    asked = [*(methods or ()), *(x.label for x in chosen if x.kind == SOLVER)]
    for method in asked:
        if method not in REFERENCES or REFERENCES[method].kind == MULTIPRECISION:
            raise InputError("method", method, "be a reference solver", near(method, METHODS))
    end = common.first_impacts(case, form, impacts)
    horizon = min(common.solve_once(system, case.t_end).horizon, case.t_end)
    shared = {"form": form, "t_end": end, "horizon": horizon, "budget": 0.0}
    plan: list[Point] = []
    for one in chosen:
        method = {"method": one.label, "rtol": 0.0} | shared
        if one.kind == RECORDED:
            plan += [method | entries for entries in common.recorded_points(one, system)]
        elif one.kind != SOLVER:
            counts = common.halved(end, dt, halvings)
            plan += [method | {"dt": end / steps} for steps in _affordable(one, system, end, horizon, counts)]
    fast = [m for m in METHODS if REFERENCES[m].seconds < TOO_SLOW and takes(m, system, case.t_end)]
    if methods is None and not asked:
        asked, shared = fast, shared | {"budget": TOO_SLOW}
    for method in dict.fromkeys(asked):
        affordable = TOLERANCES[: 2 if REFERENCES[method].seconds >= SLOW else None]
        levels = [0.0] if method == "exact" else tolerances or affordable
        plan += [{"method": method, "dt": 0.0, "rtol": rtol} | shared for rtol in levels]
    return plan


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row: work, seconds and tip error of one method at one step or tolerance."""
    system = case.system(point["form"])
    exact = common.solve_once(system, case.t_end)
    measured = (_steps if point["dt"] else _solver)(system, exact, point, point["t_end"])
    return [measured | _tracked(system, exact, point)]


def _affordable(one: Integrator, system: System, end: float, horizon: float, counts: list[int]) -> list[int]:
    """The numbers of steps in [0, end] of which a run of a function to the horizon takes TOO_SLOW seconds at most, by
    the time of the fewest; all of them for a scheme."""
    if one.kind == SCHEME:
        return counts
    try:
        seconds = min(common.run_of(one.label, None, system, end / counts[0], end).work.seconds for _ in range(2))
    except (ArithmeticError, InputError, RuntimeError, ValueError):
        return counts  # every point has its own reason
    seconds *= max(1.0, horizon / end) / counts[0]
    return [steps for steps in counts if steps * seconds <= TOO_SLOW] or counts[:1]


def _steps(system: System, exact: Reference, point: Point, end: float) -> Row:
    label, recorded, steps = point["method"], point.get("recorded"), round(end / point["dt"])

    def once() -> Trajectory:
        return common.run_of(label, recorded, system, end / steps, end, every=max(1, steps // SAMPLES))

    run = once() if recorded else fastest(once)
    error = tip_error(run.tip, exact.at(run.t)[0]).rms
    return _cost(run, common.evaluations_of(label, run)) | {"error": error, "python": 0.0}


def _solver(system: System, exact: Reference, point: Point, end: float) -> Row:
    times, method = np.linspace(0.0, end, SAMPLES + 1), point["method"]
    steps = Steps() if method == "exact" else Steps(events=False)
    rtol, budget = point["rtol"] or 1e-10, point["budget"]
    if budget:
        expected = expected_seconds(system, end, method, rtol, None, steps, budget, 1.0, SAMPLES)
        if expected > budget:
            rule = f"allow the {expected:.0f} s that {method} will take by an estimate"
            raise InputError("budget", budget, rule, f"name {method} among the methods to run it")
    run = fastest(lambda: solve(system, end, method, times, rtol, None, steps=steps))
    error = 0.0 if method == "exact" else tip_error(run.tip, exact.at(times)[0]).rms
    if "stages" in run.work.counters:  # it steps to every output, which a user may not ask for
        bare = np.array([0.0, end])
        run = fastest(lambda: solve(system, end, method, bare, point["rtol"], None, steps=steps))
    work = max(run.work.counters.values(), default=0)
    in_python = run.provenance.get("callbacks") == "Python" and "rhs" in run.work.counters
    python = run.work.counters["rhs"] * _call(system) if in_python else 0.0
    return _cost(run, work) | {"error": error, "python": min(python, run.work.march_seconds)}


def _cost(run: Trajectory, work: int) -> Row:
    stepping = run.work.march_seconds
    return {"work": work, "seconds": stepping, "setup": max(0.0, run.work.seconds - stepping)}


def _call(system: System) -> float:
    """Seconds of one call of the right-hand side from Python: the least of several hundred."""
    rhs = RightHandSide(state_space(system))
    z, out, least = rhs.z0, np.empty(rhs.size), np.inf
    for _ in range(CALLS):
        begun = time.perf_counter()
        rhs(0.0, z, out)
        least = min(least, time.perf_counter() - begun)
    return least


def _tracked(system: System, exact: Reference, point: Point) -> Row:
    """Time to which the impacts follow the exact ones, and its cost; NaN for solvers and without impacts."""
    if not point["dt"] or not any(record.impacts.until(point["horizon"]).count for record in exact.contacts):
        return {"tracked": float("nan"), "tracked_seconds": float("nan")}
    end, recorded = point["horizon"], point.get("recorded")
    if recorded:
        end = min(end, recorded[0][-1])
    steps = round(end / point["dt"])
    run = common.run_of(point["method"], recorded, system, end / steps, end, every=steps)
    until = matched_until(run, exact, end)
    return {"tracked": until, "tracked_seconds": run.work.march_seconds * until / end}


def cheapest(rows: Rows, error: float, cost: str) -> list[tuple[float, str]]:
    """(cost, method), the cheapest first, for an ``error`` that all more expensive points keep as well: through contact
    a coarse one may be right by chance. Interpolated from the point before.

    A method whose points are all below ``error`` stands with the cost of the cheapest and "at most".
    """
    costs = []
    for method in dict.fromkeys(r["method"] for r in rows):
        group = sorted((r for r in rows if r["method"] == method and np.isfinite(r[cost])), key=lambda r: r[cost])
        if not group:
            continue
        # The cheapest of the points that are dearer than every one that misses the error.
        missed = [i for i, r in enumerate(group) if not r["error"] <= error]
        if not missed:
            costs.append((float(group[0][cost]), method + AT_MOST))
        elif missed[-1] + 1 < len(group):
            coarse, fine = group[missed[-1]], group[missed[-1] + 1]
            share = np.log(coarse["error"] / error) / np.log(coarse["error"] / fine["error"])
            costs.append((float(coarse[cost] * (fine[cost] / coarse[cost]) ** share), method))
    return sorted(costs)


def answer(rows: Rows, case: Case) -> Answer:
    """The cost of a given error for each method, and how long the impacts match."""
    units = case.units
    heads = [f"{word} for {error:g}" for error in ERRORS for word in ("solves", "ms")]
    table = defaultdict[str, dict[str, str]](lambda: dict.fromkeys(heads, "–"))
    others = [r for r in rows if r["method"] != "exact"]
    best = []
    for error in ERRORS:
        for cost, word, digits, unit in (("work", "solves", 3, 1.0), ("seconds", "ms", 2, 1e3)):
            costs = cheapest(others, error, cost)
            for value, method in costs:
                name, bound = method.removesuffix(AT_MOST), "≤ " * method.endswith(AT_MOST)
                table[name][f"{word} for {error:g}"] = bound + _rounded(value * unit, digits)
            if costs and cost == "work":
                value, method = costs[0]
                bound = "at most " * method.endswith(AT_MOST)
                name = short(method.removesuffix(AT_MOST))
                best.append(f"{bound}{_rounded(value, 3)} for a tip error of {error:g} ({name})")
    tracked = {m: max(group, key=lambda r: r["tracked"])
               for m, group in groups([r for r in rows if np.isfinite(r["tracked"])], "method").items()}  # fmt: skip
    for method, row in sorted(tracked.items(), key=lambda item: -item[1]["tracked"]):
        table[method] |= {
            "impacts followed to": units.measure(row["tracked"], "time", ".3g"),
            "with dt": units.measure(row["dt"], "time", ".2g"),
        }
    notes = [
        f"Tip errors {ERRORS[0]:g} and {ERRORS[1]:g} that all finer runs keep, without set-up, interpolated between "
        "runs: a time step between two may do worse. Solves: linear solves or evaluations; steps of a function that "
        f"counts neither. Errors are taken to t = {units.measure(rows[0]['t_end'], 'time', '.3g')}."
    ]
    if tracked:
        notes.append(f"Impacts can be followed to t = {units.measure(rows[0]['horizon'], 'time', '.3g')}.")
    if shares := {r["method"]: r["python"] / r["seconds"] for r in rows if r["python"] > 0.0}:
        parts = [f"{short(method)} {100 * share:.0f} %" for method, share in shares.items()]
        notes.append(f"Python's calls of the right-hand side take at least these shares: {', '.join(parts)}.")
    notes += [f"The exact solution takes {1e3 * r['seconds']:.2g} ms." for r in rows if r["method"] == "exact"]
    verdict = f"Fewest solves or evaluations: {', '.join(best)}." if best else "No method reached a tip error of 0.001."
    return Answer(verdict, [{"method": short(method)} | cells for method, cells in table.items()], " ".join(notes))


def _rounded(value: float, digits: int) -> str:
    """A positive number with some digits, without a power of ten below a million."""
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+0" in text and value < 1e6 else text


ERRORS = (1e-3, 1e-5)


def picture(records: Records) -> Picture:
    """Lower left is better in the first two panels, upper left in the last, whose lines join the best so far."""
    rows = [row for row in records.numbers if row["method"] != "exact"]
    rows.sort(key=lambda row: (row["dt"], row["rtol"]))
    panels = []
    for cost, words, title in (("work", "linear solves or evaluations", "error against work"),
                               ("seconds", "seconds of stepping", "error against time")):  # fmt: skip
        marks = curves(rows, cost, "error", "method")
        marks += [Level(row[cost], "exact", "x", {"color": "black", "ls": "-", "lw": 1.8})
                  for row in records.numbers if row["method"] == "exact"]  # fmt: skip
        marks += _failed(records.rows) if cost == "work" else []
        panels.append(Panel(title, Axis(words, scale="log"), Axis("tip error, rms, relative", scale="log"), marks))
    tracked = [row for row in rows if np.isfinite(row["tracked"])]
    best: list[Mark] = []
    for label, group in groups(tracked, "method").items():
        group.sort(key=lambda row: row["tracked_seconds"])
        seconds, until, style = column(group, "tracked_seconds"), column(group, "tracked"), look(label)
        best += [Curve(seconds, until, look=style | {"linestyle": ""}),
                 Curve(seconds, np.maximum.accumulate(until), short(label),
                       style | {"marker": "", "drawstyle": "steps-post"})]  # fmt: skip
    best += [Level(tracked[0]["horizon"], "horizon of float64", look={"color": "black"})] if tracked else []
    panels.append(Panel("tracked time against time", Axis("seconds of stepping to get there", scale="log"),
                        Axis("exact impacts followed to $t$", "time", limits=(0.0, None)), best,
                        empty="no contact to follow"))  # fmt: skip
    return Picture([panels], 6.2, 5)


def _failed(rows: Rows) -> list[Mark]:
    """The names of the methods some of whose points failed, along the top edge."""
    counts = Counter(row["method"] for row in rows if "failed" in row or "refused" in row)
    tried = Counter(row["method"] for row in rows)
    return [
        Note(f"× {short(method)}: {failed} of {tried[method]} failed", (i + 0.5) / len(counts), 0.97, "xy",
             {"rotation": 90, "ha": "center", "va": "top", "color": look(method)["color"]})
        for i, (method, failed) in enumerate(counts.items())
    ]  # fmt: skip


STUDY = declared(
    __name__,
    "Which method reaches a given error at the least cost, and which follows the exact impacts longest?",
    needs_motion=True,
    smoke={
        "schemes": ["BDF2", "SDIRK(gamma=0.4359)"],
        "methods": ["exact", "cvode-adams"],
        "halvings": 3,
        "tolerances": [1e-6],
        "impacts": 2,
    },
    measured=("seconds", "setup", "python", "tracked_seconds"),
)
