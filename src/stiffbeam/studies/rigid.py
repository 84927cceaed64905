"""Towards rigid stops: the compliant solution against the Signorini limit as kappa grows.

The tip turns round on its spring in half a period, which a rigid stop takes away: kappa^(-1/2) is the rate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..cases import Case
from ..measures.regression import observed_order
from ..solvers.rigid import rigid_limit
from ..validation import InputError, positive
from .common import solve_once, system_of
from .study import Point, Row, Rows, Study

SAMPLES = 4000


def points(case: Case, form: str = "displacement", factors: list[float] | None = None, impacts: int = 3) -> list[Point]:
    """The case's kappa times 4^0 .. 4^9, until the rigid solution's first ``impacts`` impacts are over."""
    if case.problem.stops is None:
        raise InputError("case", case.name, "have stops")
    positive("impacts", impacts)
    chosen = [4.0**k for k in range(10)] if factors is None else factors
    return [{"form": form, "factor": float(factor), "impacts": impacts} for factor in chosen]


def evaluate(case: Case, point: Point) -> list[Row]:
    stops = case.problem.stops
    assert stops is not None
    kappa = stops.stiffness * point["factor"]
    rigid = rigid_limit(system_of(case, point["form"]), case.t_end)
    n = point["impacts"]
    if rigid.impacts.count <= n:
        raise InputError("impacts", n, f"be fewer than the {rigid.impacts.count} of the rigid stops")
    times = rigid.impacts.times
    end = 0.5 * float(times[n - 1] + times[n])
    compliant = replace(case, problem=replace(case.problem, stops=replace(stops, stiffness=kappa)))
    # The window is short against the horizon, and the same for every kappa.
    found = solve_once(system_of(compliant, point["form"]), min(case.t_end, 2.0 * end))
    t = np.linspace(0.0, end, SAMPLES)
    difference = found.at(t)[0] - rigid.at(t)[0]
    scale = float(np.max(np.abs(rigid.at(t)[0])))
    inside = found.impacts.until(end)
    pairs = min(n, inside.count)
    return [
        {
            "kappa": kappa,
            "end": end,
            "tip_error": float(np.max(np.abs(difference))) / scale,
            "tip_error_rms": float(np.sqrt(np.mean(difference**2))) / scale,
            "impacts": inside.count,
            "rigid_impacts": n,
            "impact_time_error": float(np.max(np.abs(inside.times[:pairs] - times[:pairs]), initial=0.0)),
            "penetration": float(np.max(inside.peaks[np.isfinite(inside.peaks)], initial=0.0)) / kappa,
            "peak_force": float(np.max(inside.peaks[np.isfinite(inside.peaks)], initial=0.0)),
            "impulse_error": _impulse_error(inside.impulses[:pairs], rigid.impacts.impulses[:pairs]),
        }
    ]


def _impulse_error(found, wanted) -> float:
    """Of the first impact whose impulse is known, relative."""
    known = np.isfinite(found)
    return float(abs(found[known][0] / wanted[known][0] - 1.0)) if np.any(known) else float("nan")


def same_impacts(rows: Rows) -> list[Row]:
    """The rows with as many impacts as the rigid stops: from there on the limit is being approached."""
    return [r for r in rows if r["impacts"] == r["rigid_impacts"]]


def answer(rows: Rows) -> str:
    near = same_impacts(rows)
    if len(near) < 2:
        return "At no stiffness tried does the compliant contact have as many impacts as rigid stops have."
    order = observed_order([1.0 / r["kappa"] for r in near], [r["tip_error"] for r in near])
    own = min(rows, key=lambda r: r["kappa"])
    which = "the case's kappa" if own["factor"] == 1.0 else "kappa"
    return (
        f"The tip approaches that of rigid stops like kappa^-({order}) (theory: 1/2), from kappa = "
        f"{near[0]['kappa']:.2g} on; at {which} = {own['kappa']:.2g} the first {own['rigid_impacts']} rigid "
        f"impacts are {own['impacts']} and the tip is {100 * own['tip_error']:.2g} % of its largest displacement off."
    )


STUDY = Study(
    name="rigid",
    question="How stiff must a stop be before it acts like a rigid one, and how fast is that limit approached?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"factors": [16.0, 256.0, 4096.0], "impacts": 2},
)
