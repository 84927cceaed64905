"""Work and precision: error against work and against seconds, schemes and adaptive solvers in one run."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np

from ..basics.validation import InputError, near
from ..figures import column, heading, log_scale, look, new_figure, numeric, say_empty, shared_legend, short
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.errors import tip_error
from ..measures.impacts import matched_until
from ..model.system import System
from ..references import solve, takes
from ..references.adaptive.rhs import RightHandSide
from ..references.registry import MULTIPRECISION, REFERENCES
from ..references.request import Steps
from ..trajectory.trajectory import Reference, Trajectory
from .common import (
    Dt,
    Form,
    Halvings,
    ImpactCount,
    Schemes,
    afford_halvings,
    first_impacts,
    scheme_labels,
    scheme_of,
    solve_once,
    system_of,
)
from .engine.study import Answer, Point, Records, Row, Rows, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SLOW, TOO_SLOW = 1.0, 10.0  # seconds in the registry: only the two loosest tolerances, not at all, unless asked for
METHODS = [m.name for m in REFERENCES.values() if m.kind != MULTIPRECISION]  # which has no error to be seen
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
REPEATS = 3  # the fastest counts: what else the machine did is not the method's cost
ENOUGH = 0.2  # seconds, after which a run is not repeated
SAMPLES = 1000
CALLS = 500


def points(
    case: Case,
    schemes: Schemes = None,
    methods: Annotated[list[str] | None, "reference solvers, with commas between them"] = None,
    form: Form = "displacement",
    dt: Dt = None,
    halvings: Halvings = 10,
    tolerances: Annotated[list[float] | None, "rtol of the solvers, with commas between them"] = None,
    impacts: ImpactCount = 4,
) -> list[Point]:
    """Schemes at ``dt`` (the case's), dt/2, ...; solvers at rtol 1e-4 .. 1e-10 (the dense ones at two).

    The error is taken until the first impacts are over, as many as ``impacts`` says (half the horizon without contact),
    where it is not yet amplified by chaos; the time tracked on the whole horizon.

    work: linear solves of a scheme; of a solver evaluations of the right-hand side, for an implicit one as
    many linear solves; implicit stages of Kvaerno's, at least (diffrax does not count what Newton's method
    needs in each); of the exact solution evaluations in the search for switches.

    seconds: of stepping, without setup, which is a column of its own. Impacts are not recorded, except by
    solvers that start anew at each; a scheme's steps include the search for them. python: the part of the
    seconds that a solver spends in Python's calls of the compiled right-hand side, at least: SUNDIALS in C
    would not have it. All columns but seconds, setup, python and tracked_seconds are the same in every run.
    """
    afford_halvings(case, halvings, dt, None)
    for method in methods or ():
        if method not in METHODS:
            raise InputError("method", method, "be a reference solver", near(method, METHODS))
    dt = case.dt if dt is None else dt
    end = first_impacts(case, form, impacts)
    horizon = min(solve_once(system_of(case, form), case.t_end).horizon, case.t_end)
    rest = {"form": form, "t_end": end, "horizon": horizon}
    found: list[Point] = [
        {"method": label, "dt": end / max(4, round(end / dt * 2**k)), "rtol": 0.0} | rest
        for label in scheme_labels(case, schemes)
        for k in range(halvings)
    ]
    system = system_of(case, form)
    fast = [m for m in METHODS if REFERENCES[m].seconds < TOO_SLOW and takes(m, system, case.t_end)]
    for method in fast if methods is None else methods:
        affordable = TOLERANCES[: 2 if REFERENCES[method].seconds >= SLOW else None]
        chosen = [0.0] if method == "exact" else tolerances or affordable
        found += [{"method": method, "dt": 0.0, "rtol": rtol} | rest for rtol in chosen]
    return found


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row: work, seconds and tip error of one method at one step or tolerance."""
    system = system_of(case, point["form"])
    exact = solve_once(system, case.t_end)
    measured = (_scheme if point["dt"] else _solver)(system, exact, point, point["t_end"])
    return [measured | _tracked(system, exact, point)]


def _scheme(system: System, exact: Reference, point: Point, end: float) -> Row:
    scheme, steps = scheme_of(point["method"]), round(end / point["dt"])
    run = _fastest(lambda: integrate(system, scheme, end / steps, end, every=max(1, steps // SAMPLES)))
    return _cost(run, steps * len(scheme.nodes)) | {"error": tip_error(run.tip, exact.at(run.t)[0]).rms, "python": 0.0}


def _solver(system: System, exact: Reference, point: Point, end: float) -> Row:
    times, method = np.linspace(0.0, end, SAMPLES + 1), point["method"]
    steps = Steps() if method == "exact" else Steps(events=False)
    run = _fastest(lambda: solve(system, end, method, times, point["rtol"] or 1e-10, None, steps=steps))
    error = 0.0 if method == "exact" else tip_error(run.tip, exact.at(times)[0]).rms
    work = max(run.work.counters.values(), default=0)
    python = run.work.counters["rhs"] * _call(system) if "rhs" in run.work.counters else 0.0
    return _cost(run, work) | {"error": error, "python": min(python, run.work.march_seconds)}


def _cost(run: Trajectory, work: int) -> Row:
    stepping = run.work.march_seconds
    return {"work": work, "seconds": stepping, "setup": max(0.0, run.work.seconds - stepping)}


def _call(system: System) -> float:
    """Seconds of one call of the right-hand side from Python: the least of several hundred."""
    rhs = RightHandSide(system.first_order())
    z, out, least = rhs.z0, np.empty(rhs.size), np.inf
    for _ in range(CALLS):
        begun = time.perf_counter()
        rhs(0.0, z, out)
        least = min(least, time.perf_counter() - begun)
    return least


def _fastest(run: Callable[[], Trajectory]) -> Trajectory:
    """The fastest of up to REPEATS runs."""
    found = [run()]
    while len(found) < REPEATS and sum(one.work.seconds for one in found) < ENOUGH:
        found.append(run())
    return min(found, key=lambda one: one.work.march_seconds)


def _tracked(system: System, exact: Reference, point: Point) -> Row:
    """How long the impacts follow the exact ones, and what it costs to get there; schemes only, and where there are."""
    if not point["dt"] or not any(record.impacts.until(point["horizon"]).count for record in exact.contacts):
        return {"tracked": float("nan"), "tracked_seconds": float("nan")}
    steps = round(point["horizon"] / point["dt"])
    run = integrate(system, scheme_of(point["method"]), point["horizon"] / steps, point["horizon"], every=steps)
    until = matched_until(run, exact, point["horizon"])
    return {"tracked": until, "tracked_seconds": run.work.march_seconds * until / point["horizon"]}


def cheapest(rows: Rows, error: float, cost: str) -> list[tuple[float, str]]:
    """(cost, method), the cheapest first, of an ``error`` that all dearer points keep as well: through contact a coarse
    one may be right by chance. Interpolated from the point before.

    A method whose points are all below ``error`` stands with the cost of the cheapest and "at most".
    """
    found = []
    for method in dict.fromkeys(r["method"] for r in rows):
        own = sorted((r for r in rows if r["method"] == method), key=lambda r: r[cost])
        missed = [i for i, r in enumerate(own) if not r["error"] <= error]
        if not missed:
            found.append((float(own[0][cost]), f"{method} at most"))
        elif missed[-1] + 1 < len(own):
            coarse, fine = own[missed[-1]], own[missed[-1] + 1]
            share = np.log(coarse["error"] / error) / np.log(coarse["error"] / fine["error"])
            found.append((float(coarse[cost] * (fine[cost] / coarse[cost]) ** share), method))
    return sorted(found)


def answer(rows: Rows, case: Case) -> str:
    """What each method needs for a given error, and how long the impacts match."""
    units = case.units
    exact = next((r for r in rows if r["method"] == "exact"), None)
    others = [r for r in rows if r["method"] != "exact"]

    def time(value: float, form: str) -> str:
        return units.measure(format(value, form), "time")

    sentences, table = [], defaultdict[str, dict[str, str]](dict)
    for error in (1e-3, 1e-5):
        for cost, method in cheapest(others, error, "work"):
            table[method][f"solves for {error:g}"] = f"{cost:.3g}"
        for cost, method in cheapest(others, error, "seconds"):
            table[method][f"ms for {error:g}"] = f"{1e3 * cost:.2g}"
        work = [f"{method} {cost:.3g}" for cost, method in cheapest(others, error, "work")]
        seconds = [f"{method} {1e3 * cost:.2g} ms" for cost, method in cheapest(others, error, "seconds")]
        if work:
            sentences.append(
                f"A tip error of {error:g} that all finer runs keep costs, interpolated between runs, in linear solves "
                f"or evaluations, {', '.join(work)};"
            )
            sentences.append(f"in time, all without their set-up, {', '.join(seconds)}.")
    shares = {r["method"]: r["python"] / r["seconds"] for r in rows if r["python"] > 0.0}
    if shares:
        parts = [f"{method} {100 * share:.0f} %" for method, share in shares.items()]
        sentences.append(f"Python's calls of the right-hand side take at least this part of it: {', '.join(parts)}.")
    best: dict[str, Row] = {}
    for row in rows:
        so_far = best.get(row["method"], {"tracked": -1.0})["tracked"]
        if np.isfinite(row["tracked"]) and row["tracked"] > so_far:
            best[row["method"]] = row
    if best:
        order = sorted(best.values(), key=lambda r: -r["tracked"])
        for r in order:
            table[r["method"]]["impacts followed to"] = time(r["tracked"], ".3g")
        parts = [f"{r['method']} to t = {time(r['tracked'], '.3g')} with dt = {time(r['dt'], '.2g')}" for r in order]
        sentences.append(f"Impacts are followed, of {time(rows[0]['horizon'], '.3g')}, by {', '.join(parts)}.")
    if exact is not None:
        sentences.append(f"The exact solution takes {1e3 * exact['seconds']:.2g} ms.")
    lines = [{"method": method} | cells for method, cells in table.items()]
    rest = " ".join(text for text in sentences if text.startswith(("Python", "The exact")))
    return Answer(
        " ".join(sentences) or "No method reached an error of 0.001 or followed an impact.",
        lines,
        "Tip errors 0.001 and 1e-05 that all finer runs keep, without set-up; interpolated between runs: a step "
        f"between two may do worse; solves: linear solves or evaluations. {rest}",
    )


COSTS = (("work", "linear solves or evaluations", "error against work"),
         ("seconds", "seconds of stepping", "error against time"))  # fmt: skip


def draw(records: Records) -> Figure:
    """Lower left is better in (a) and (b), upper left in (c), whose lines join the best so far.

    A whisker in (b) reaches left to the time without Python's calls of the right-hand side, right to the
    time with the set-up.
    """
    found = numeric(records.found)
    rows = [row for row in found if row["method"] != "exact"]
    exact = [row for row in found if row["method"] == "exact"]
    figure = new_figure(
        6.2, heading(records.case, "work and precision; the exact solution's cost is the vertical line")
    )
    axes = figure.subplots(1, 3)
    for axis, (cost, words, title), letter in zip(axes, COSTS, "ab", strict=False):
        _curves(axis, rows, cost, "error")
        if cost == "seconds":
            _whiskers(axis, rows)
        for row in exact:
            axis.axvline(row[cost], color="black", lw=1.8, label="exact")
        log_scale(axis)
        axis.set(xlabel=words, ylabel="tip error, rms, relative")
        axis.set_title(f"({letter}) {title}", loc="left")
    _failed(axes[0], records.rows)
    tracked = [row for row in rows if np.isfinite(column([row], "tracked")[0])]
    for label in dict.fromkeys(row["method"] for row in tracked):
        own = sorted((row for row in tracked if row["method"] == label), key=lambda row: row["tracked_seconds"])
        seconds, until, style = column(own, "tracked_seconds"), column(own, "tracked"), look(label)
        axes[2].plot(seconds, until, ms=4.5, **style | {"linestyle": ""})
        axes[2].step(seconds, np.maximum.accumulate(until), where="post", lw=1.1, **style | {"marker": ""})
    if tracked:
        axes[2].axhline(tracked[0]["horizon"], color="black", lw=1.2, ls=":", label="horizon of float64")
        log_scale(axes[2], y=False)
        axes[2].set(ylim=(0.0, None))
    else:
        say_empty(axes[2], "no contact to follow")
    axes[2].set(
        xlabel="seconds of stepping to get there",
        ylabel=records.case.units.label("exact impacts followed to $t$", "time"),
    )
    axes[2].set_title("(c) tracked time against time", loc="left")
    for axis in axes:
        axis.grid(color="0.92")
    shared_legend(figure, 5)
    return figure


def _curves(axis: Axes, rows: Sequence[Row], cost: str, result: str) -> None:
    for label in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == label]
        own.sort(key=lambda row: (row["dt"], row["rtol"]))
        y = column(own, result)
        y = np.where(y > 0.0, y, np.nan)
        axis.plot(column(own, cost), y, ms=4.5, lw=1.1, label=short(label), **look(label))


def _whiskers(axis: Axes, rows: Sequence[Row]) -> None:
    for row in rows:
        seconds, error = row["seconds"], row["error"]
        ends = [max(seconds - row["python"], 0.02 * seconds), seconds + row["setup"]]
        axis.plot(ends, [error, error], lw=0.8, alpha=0.7, color=look(row["method"])["color"])
    axis.text(
        0.02, 0.02, "whiskers: left without Python's calls of the\nright-hand side, right with the set-up",
        transform=axis.transAxes, fontsize=8, color="0.3",
    )  # fmt: skip


def _failed(axis: Axes, rows: Sequence[Row]) -> None:
    """Crosses along the top edge, one a method, above its name and how many of its points failed."""
    counts = Counter(row["method"] for row in rows if "failed" in row or "refused" in row)
    tried = Counter(row["method"] for row in rows)
    for i, (method, failed) in enumerate(counts.items()):
        x = (i + 0.5) / len(counts)
        axis.plot(x, 1.0, "x", ms=8, mew=2, color=look(method)["color"], transform=axis.transAxes, clip_on=False)
        text = f"{short(method)}: {failed} of {tried[method]} failed"
        axis.annotate(text, (x, 0.97), xycoords="axes fraction", rotation=90, ha="center", va="top", fontsize=8)


STUDY = Study(
    name="precision",
    question="Which method reaches a given error at least cost, and which tracks the solution longest for its cost?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    needs_motion=True,
    smoke={
        "schemes": ["bdf2", "sdirk(gamma=0.4359)"],
        "methods": ["exact", "cvode-adams"],
        "halvings": 3,
        "tolerances": [1e-6],
        "impacts": 2,
    },
    measured=("seconds", "setup", "python", "tracked_seconds"),
)
