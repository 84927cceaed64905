"""How fast neighbouring motions part: Lyapunov exponents of the exact flow and of the schemes, and the portrait.

The horizon is shorter than a period of the drive, so one run from t = 0 sees one phase of it only. Pairs
are therefore started at many times along the exact motion and followed while their distance is small. The
tangent flow along the exact motion is the witness: it needs no distance that is small enough.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..cases import Case
from ..drive import Drive
from ..march.ensemble import Ensemble, integrate_ensemble, reference_ensemble
from ..modal import modes
from ..solvers.tangent import lyapunov
from ..validation import InputError, integer
from .common import later, scheme_labels, scheme_of, solve_once, system_of
from .study import Point, Row, Rows, Study

LINEAR = 1e-4  # of the motion's size: a pair farther apart no longer grows in proportion
SEGMENTS = 20  # of the span, for the scatter of the tangent flow's rate
PORTRAIT = 6000  # samples of the delayed portrait


def points(
    case: Case,
    schemes: list[str] | None = None,
    form: str = "displacement",
    dt: float | None = None,
    starts: int = 48,
    size: float = 1e-11,
    span: float | None = None,
) -> list[Point]:
    """The exact flow and every scheme at ``dt`` (the case's): ``starts`` pairs a distance ``size`` apart,
    followed for ``span`` (half the case's horizon); and the exact motion's portraits."""
    integer("starts", starts, 1)
    exact = solve_once(system_of(case, form), case.t_end)
    dt = case.dt if dt is None else dt
    span = min(exact.horizon, case.t_end) / 2.0 if span is None else span
    rest = {"form": form, "dt": dt, "starts": starts, "size": size, "span": dt * max(10, round(span / dt))}
    pairs = [{"kind": "pairs", "method": method} | rest for method in ["exact", *scheme_labels(case, schemes)]]
    drive = max(Drive.of(exact.system or system_of(case, form)).frequencies, default=0.0)
    tangent = {"kind": "tangent", "method": "tangent flow", "form": form}
    portrait = {"kind": "portrait", "method": "exact", "form": form, "drive": drive}
    long_enough = not drive or 0.9 * case.t_end > 2.0 * np.pi / drive  # for a portrait delayed by a period
    return [*pairs, tangent, *([portrait] if long_enough else [])]


def evaluate(case: Case, point: Point) -> list[Row]:
    return {"pairs": _pairs, "tangent": _tangent, "portrait": _portrait}[point["kind"]](case, point)


def _pairs(case: Case, point: Point) -> list[Row]:
    system = system_of(case, point["form"])
    basis = modes(system)
    if basis is None:
        raise InputError("damping", "a matrix that couples the modes", "decouple for a study of chaos")
    exact = solve_once(system, case.t_end)
    dt, span = point["dt"], point["span"]
    times = np.linspace(0.1, 0.9, point["starts"]) * case.t_end
    assert exact.state_at is not None
    q, v = exact.state_at(times)
    # A direction of its own for every pair, of the same size in every mode's velocity.
    scale = float(np.max(np.hypot(basis.omega * basis.to_modal(q), basis.to_modal(v))))
    noise = np.random.default_rng(1).uniform(-1.0, 1.0, (2, *q.shape)) * point["size"] * scale
    dq = basis.to_nodal(noise[0] / np.maximum(basis.omega, basis.omega[basis.omega > 0.0][0]))
    dv = basis.to_nodal(noise[1])
    systems = [later(system, t, *state) for t, *state in zip(times, q, v, strict=True)]
    systems += [later(system, t, *state) for t, *state in zip(times, q + dq, v + dv, strict=True)]
    steps = round(span / dt)
    if point["method"] == "exact":
        many = reference_ensemble(systems[0], span, systems, np.arange(steps + 1) * dt)
    else:
        many = integrate_ensemble(systems[0], scheme_of(point["method"]), dt, span, systems, every=1)
    omega = float(basis.omega[basis.omega > 0.0][0])
    distance = _distance(many, point["starts"], omega)
    largest = float(np.max(omega * np.abs(many.tip)))
    rows: list[Row] = [
        {"pair": k, "start": float(times[k]), "exponent": growth(many.t, distance[k], LINEAR * largest)}
        for k in range(point["starts"])
    ]
    keep = np.unique(np.linspace(1, steps, 100).astype(int))
    mean = np.exp(np.mean(np.log(np.maximum(distance, 1e-300)), axis=0)) / largest
    return rows + [{"t": float(many.t[k]), "distance": float(mean[k])} for k in keep]


def _distance(many: Ensemble, pairs: int, omega: float) -> Array:
    """(pairs, k): how far apart the two tips of every pair are, position and velocity together."""
    du, dv = many.tip[pairs:] - many.tip[:pairs], many.tip_velocity[pairs:] - many.tip_velocity[:pairs]
    return np.hypot(omega * du, dv)


def growth(t: Array, distance: Array, limit: float) -> float:
    """The slope of ln distance over t while it stays below ``limit``; NaN where that is too short."""
    beyond = distance > limit
    end = int(np.argmax(beyond)) if np.any(beyond) else len(t)
    here = np.flatnonzero(distance[:end] > 0.0)
    return float(np.polyfit(t[here], np.log(distance[here]), 1)[0]) if len(here) >= 10 else float("nan")


def _tangent(case: Case, point: Point) -> list[Row]:
    """The growth rate of tangent vectors in each of SEGMENTS parts of the span, the first left out."""
    grown = lyapunov(system_of(case, point["form"]), case.t_end)
    edges = np.linspace(0.0, case.t_end, SEGMENTS + 1)
    logs = np.interp(edges, grown.t, np.mean(grown.log_growth, axis=1))
    rates = np.diff(logs) / np.diff(edges)
    return [{"pair": k, "start": float(edges[k]), "exponent": float(rates[k])} for k in range(1, SEGMENTS)]


def _portrait(case: Case, point: Point) -> list[Row]:
    """(u(t), u'(t), u(t + T)) of the exact motion with T the drive's period, after a first tenth of the span."""
    exact = solve_once(system_of(case, point["form"]), case.t_end)
    delay = 2.0 * np.pi / point["drive"] if point["drive"] else 0.1 * case.t_end
    t = np.linspace(0.1 * case.t_end, case.t_end - delay, PORTRAIT)
    u, v = exact.at(t)
    ahead, _ = exact.at(t + delay)
    return [
        {"t": float(a), "u": float(b), "v": float(c), "u_delayed": float(d)}
        for a, b, c, d in zip(t, u, v, ahead, strict=True)
    ]


def exponents(rows: Rows) -> dict[str, tuple[float, float]]:
    """Mean exponent of every method and the half-width of its 95 % interval."""
    found = {}
    for method in dict.fromkeys(r["method"] for r in rows):
        own = np.array([r["exponent"] for r in rows if r["method"] == method and "exponent" in r], float)
        own = own[np.isfinite(own)]
        if len(own) > 1:
            found[method] = float(np.mean(own)), float(1.96 * np.std(own, ddof=1) / np.sqrt(len(own)))
    return found


def answer(rows: Rows) -> str:
    found = exponents(rows)
    if not found:
        return "No pair could be followed long enough."
    parts = [f"{method} {mean:.3g} ± {interval:.2g}" for method, (mean, interval) in found.items()]
    mean, interval = (x / np.log(10.0) for x in found.get("tangent flow", (float("nan"), float("nan"))))
    return (
        f"Neighbouring motions part like exp(lambda t) with lambda = {', '.join(parts)} (mean over the starts, 95 %); "
        f"by the tangent flow the exact motion loses {mean:.2g} ± {interval:.2g} digits per unit of time."
    )


STUDY = Study(
    name="chaos",
    question="How fast do neighbouring motions part, and do the schemes part as fast as the exact flow?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"schemes": ["hht(alpha=-0.1)"], "starts": 6},
)
