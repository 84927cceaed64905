"""Work and precision: error against seconds and against work, schemes and adaptive solvers in one run."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from ..arrays import Array
from ..cases import Case
from ..march.integrate import integrate
from ..measures.impacts import match
from ..solvers import solve
from ..system import System
from ..trajectory import Reference, Trajectory
from ..validation import InputError, integer, near
from .common import first_impacts, scheme_labels, scheme_of, solve_once, system_of
from .study import Point, Row, Rows, Study

METHODS = ("exact", "cvode", "cvode-adams", "ida", "dop853", "radau", "kvaerno5")
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
SLOW = ("radau", "kvaerno5")  # dense linear algebra: only the two loosest tolerances unless they are asked for
REPEATS = 3  # the fastest counts: what else the machine did is not the method's cost
ENOUGH = 0.2  # seconds, after which a run is not repeated
SAMPLES = 1000


def points(
    case: Case,
    schemes: list[str] | None = None,
    methods: list[str] | None = None,
    form: str = "displacement",
    dt: float | None = None,
    halvings: int = 10,
    tolerances: list[float] | None = None,
    impacts: int = 4,
) -> list[Point]:
    """Schemes at ``dt`` (the case's), dt/2, ...; solvers at rtol 1e-4 .. 1e-10 (the dense ones at two).

    The error is taken until the first ``impacts`` impacts are over (half the horizon without contact),
    where it is not yet amplified by chaos; the time tracked on the whole horizon.
    """
    integer("halvings", halvings, 1)
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
    for method in METHODS if methods is None else methods:
        chosen = [0.0] if method == "exact" else tolerances or TOLERANCES[: 2 if method in SLOW else None]
        found += [{"method": method, "dt": 0.0, "rtol": rtol} | rest for rtol in chosen]
    return found


def evaluate(case: Case, point: Point) -> list[Row]:
    system = system_of(case, point["form"])
    exact = solve_once(system, case.t_end)
    measure = _scheme if point["dt"] else _solver
    seconds, work, error = measure(system, exact, point, point["t_end"])
    tracked = _tracked(system, exact, point)
    return [{"seconds": seconds, "work": work, "error": error} | tracked]


def _scheme(system: System, exact: Reference, point: Point, end: float) -> tuple[float, int, float]:
    """(seconds of the march, linear solves, error)."""
    scheme, steps = scheme_of(point["method"]), round(end / point["dt"])
    run = _fastest(lambda: integrate(system, scheme, end / steps, end, every=max(1, steps // SAMPLES)))
    return run.work.march_seconds, steps * len(scheme.nodes), _error(exact, run.t, run.tip)


def _solver(system: System, exact: Reference, point: Point, end: float) -> tuple[float, int, float]:
    """(seconds, evaluations of the right-hand side or of the search, error)."""
    times = np.linspace(0.0, end, SAMPLES + 1)
    run = _fastest(lambda: solve(system, end, point["method"], times, point["rtol"] or 1e-10, None))
    error = 0.0 if point["method"] == "exact" else _error(exact, times, run.tip)
    return run.work.march_seconds, max(run.work.counters.values(), default=0), error


def _fastest(run: Callable[[], Trajectory]) -> Trajectory:
    """The fastest of up to REPEATS runs."""
    found = [run()]
    while len(found) < REPEATS and sum(one.work.seconds for one in found) < ENOUGH:
        found.append(run())
    return min(found, key=lambda one: one.work.march_seconds)


def _error(exact: Reference, t: Array, tip: Array) -> float:
    u, _ = exact.at(t)
    return float(np.sqrt(np.mean((tip - u) ** 2)) / np.max(np.abs(u)))


def _tracked(system: System, exact: Reference, point: Point) -> Row:
    """How long the impacts follow the exact ones, and what it costs to get there; schemes only."""
    if not point["dt"] or not system.contacts:
        return {"tracked": float("nan"), "tracked_seconds": float("nan")}
    steps = round(point["horizon"] / point["dt"])
    run = integrate(system, scheme_of(point["method"]), point["horizon"] / steps, point["horizon"], every=steps)
    until = match(run.impacts, exact.impacts, point["horizon"]).matched_until
    return {"tracked": until, "tracked_seconds": run.work.march_seconds * until / point["horizon"]}


def cheapest(rows: Rows, error: float, cost: str) -> list[tuple[float, str]]:
    """(cost, method), the cheapest first, of reaching ``error``; interpolated between neighbouring points."""
    found = []
    for method in dict.fromkeys(r["method"] for r in rows):
        own = sorted((r for r in rows if r["method"] == method), key=lambda r: r[cost])
        for coarse, fine in pairwise(own):
            if fine["error"] <= error < coarse["error"]:
                share = np.log(coarse["error"] / error) / np.log(coarse["error"] / fine["error"])
                found.append((float(coarse[cost] * (fine[cost] / coarse[cost]) ** share), method))
                break
    return sorted(found)


def answer(rows: Rows) -> str:
    exact = next((r for r in rows if r["method"] == "exact"), None)
    sentences = []
    for error in (1e-3, 1e-5):
        ranked = cheapest([r for r in rows if r["method"] != "exact"], error, "seconds")
        if ranked:
            parts = [f"{method} {1e3 * cost:.2g} ms" for cost, method in ranked]
            sentences.append(f"A tip error of {error:g} costs {', '.join(parts)}.")
    best: dict[str, Row] = {}
    for row in rows:
        so_far = best.get(row["method"], {"tracked": -1.0})["tracked"]
        if np.isfinite(row["tracked"]) and row["tracked"] > so_far:
            best[row["method"]] = row
    if best:
        order = sorted(best.values(), key=lambda r: -r["tracked"])
        parts = [f"{r['method']} to t = {r['tracked']:.3g} with dt = {r['dt']:.2g}" for r in order]
        sentences.append(f"Impacts are followed, of {rows[0]['horizon']:.3g}, by {', '.join(parts)}.")
    if exact is not None:
        sentences.append(f"The exact solution takes {1e3 * exact['seconds']:.2g} ms.")
    return " ".join(sentences) or "No method reached an error of 0.001 or followed an impact."


STUDY = Study(
    name="precision",
    question="Which method reaches a given error at least cost, and which tracks the solution longest for its cost?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={
        "schemes": ["bdf2", "sdirk(gamma=0.4359)"],
        "methods": ["exact", "cvode-adams"],
        "halvings": 3,
        "tolerances": [1e-6],
        "impacts": 2,
    },
    timed=True,
)
