"""Impacts: how many each scheme counts as its step shrinks, how hard, how long, against the true ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..cases import Case
from ..march import integrate
from ..measures.impacts import match
from ..schemes import HHT, SDIRK
from ..trajectory import Reference, Trajectory
from ..validation import InputError
from .common import scheme_labels, scheme_of, solve_once, system_of
from .references import frozen
from .study import Point, Row, Rows, Study

TRUE = "true"  # in the place of a scheme: the reference, sampled


def points(
    case: Case,
    schemes: list[str] | None = None,
    form: str = "displacement",
    dt: float | None = None,
    halvings: int = 7,
    t_end: float | None = None,
    sensitivity: bool = True,
    references: str | None = None,
) -> list[Point]:
    """Every scheme at ``dt`` (the case's), dt/2, ...; with ``sensitivity`` also HHT over alpha, SDIRK-OS
    over gamma and the extrapolated contact, at ``dt``. references: a folder of frozen multiprecision
    solutions, from which the true counts are taken; else they are float64's, one realisation past the
    horizon.
    """
    if case.problem.stops is None:
        raise InputError("case", case.name, "have stops")
    dt, t_end = case.dt if dt is None else dt, case.t_end if t_end is None else t_end
    rest = {"form": form, "t_end": t_end, "references": references}
    labels = scheme_labels(case, schemes)
    found = [
        {"scheme": label, "contact": "implicit", "dt": dt / 2**k, "purpose": "step"} | rest
        for label in [TRUE, *labels]
        for k in range(halvings)
    ]
    if sensitivity:
        family = [*(HHT(a) for a in (0.0, -0.05, -0.1, -0.2, -0.3)), *(SDIRK(g) for g in (0.2, 0.35, 0.4359, 0.8, 1.0))]
        found += [{"scheme": str(s), "contact": "implicit", "dt": dt, "purpose": "parameter"} | rest for s in family]
        found += [{"scheme": s, "contact": "extrapolated", "dt": dt, "purpose": "contact"} | rest for s in labels]
    return found


def evaluate(case: Case, point: Point) -> list[Row]:
    truth = true_solution(case, point)
    if point["scheme"] == TRUE:
        # What a perfect scheme would count with this step: the sampled rule on the true tip.
        sampled = truth.impacts_sampled(point["dt"], point["t_end"])
        return [{"count": sampled.count} | _contact(truth, point["t_end"])]
    system = system_of(case, point["form"])
    dt, t_end = point["dt"], point["t_end"]
    steps = round(t_end / dt)
    run = integrate(system, scheme_of(point["scheme"]), dt, t_end, point["contact"], every=steps)
    horizon = min(t_end, solve_once(system, t_end).horizon)
    matching = match(run.impacts, truth.impacts, horizon)
    return [
        {
            "count": run.impacts.count,
            **_contact(run, t_end),
            "matched": matching.matched,
            "matched_until": matching.matched_until,
            "horizon": horizon,
            "first_error": matching.first_error,
            "median_delay": matching.median_delay,
            "true_count": truth.impacts.until(t_end).count,
            "true_fraction": truth.contacts[0].fraction,
            "true_digits": truth.provenance.get("digits") or 0,
        }
    ]


def _contact(run: Trajectory, t_end: float) -> Row:
    """Share of time in contact, peak force, impulse and the median peak of an impact."""
    record, peaks = run.contacts[0], run.impacts.until(t_end).peaks
    peaks = peaks[np.isfinite(peaks)]
    return {
        "fraction": record.fraction,
        "peak_force": record.peak_force,
        "impulse": record.impulse,
        "median_peak": float(np.median(peaks)) if len(peaks) else float("nan"),
    }


def true_solution(case: Case, point: Point) -> Reference:
    """The frozen multiprecision solution where there is one over the span, else float64's exact one."""
    if point["references"] is not None:
        found = frozen(Path(point["references"]), case, point["form"], point["t_end"])
        if found is not None:
            return found
    return solve_once(system_of(case, point["form"]), point["t_end"])


def right_from(rows: Rows, scheme: str, tolerance: float = 0.05) -> float:
    """The largest step from which on every finer one counts the true impacts to ``tolerance``; NaN: none."""
    own = sorted((r for r in rows if r["scheme"] == scheme and r["purpose"] == "step"), key=lambda r: r["dt"])
    largest = float("nan")
    for row in own:
        if abs(row["count"] - row["true_count"]) > tolerance * row["true_count"]:
            break
        largest = row["dt"]
    return largest


def answer(rows: Rows) -> str:
    steps = [r for r in rows if r["purpose"] == "step" and r["scheme"] != TRUE]
    coarse, true = max(r["dt"] for r in steps), steps[0]
    known = f"{true['true_digits']} digits" if true["true_digits"] else "float64, one realisation past the horizon"
    parts = []
    for row in (r for r in steps if r["dt"] == coarse):
        largest = right_from(rows, row["scheme"])
        right = f"right to 5 % from dt = {largest:.2g} on" if np.isfinite(largest) else "never right to 5 %"
        parts.append(f"{row['scheme']} {row['count']} and {100 * row['fraction']:.2g} %, {right}")
    return (
        f"True are {true['true_count']} impacts ({known}) and {100 * true['true_fraction']:.2g} % of the time in "
        f"contact; at dt = {coarse:g}: {'; '.join(parts)}. The finest step tried is {min(r['dt'] for r in steps):.2g}."
    )


STUDY = Study(
    name="impacts",
    question="How many impacts does each scheme count, and from which step on is the count right?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"schemes": ["hht(alpha=-0.1)"], "halvings": 2, "t_end": 0.2, "sensitivity": False},
)
