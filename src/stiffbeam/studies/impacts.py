"""Impacts: how many each scheme counts as its step shrinks, how hard, how long, against the true ones.

Past the horizon one count is one realisation of a chaotic motion. Counts are therefore means over perturbed
members, of the schemes as of the exact solution; the true motion is one realisation as well, known to the end
where a multiprecision solution is given.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..cases import Case
from ..march.ensemble import Ensemble, integrate_ensemble, reference_ensemble
from ..march.integrate import integrate
from ..march.members import perturbed
from ..measures.impacts import match
from ..schemes import HHT, SDIRK
from ..trajectory import Diverged, Reference
from ..validation import InputError, integer
from .common import scheme_labels, scheme_of, solve_once, system_of
from .references import frozen
from .study import Point, Row, Rows, Study

TRUE = "true"  # in the place of a scheme: the reference, sampled
EXACT = "exact"  # the ensemble of exact solutions
SIZE = 1e-12  # of the perturbations, relative to the motion


def points(
    case: Case,
    schemes: list[str] | None = None,
    form: str = "displacement",
    dt: float | None = None,
    halvings: int = 7,
    t_end: float | None = None,
    members: int = 24,
    sensitivity: bool = True,
    references: str | None = None,
) -> list[Point]:
    """Every scheme at ``dt`` (the case's), dt/2, ...; with ``sensitivity`` also HHT over alpha, SDIRK-OS
    over gamma and the extrapolated contact, at ``dt``. members: perturbed runs of each, eight times as many of
    the exact solution. references: a folder of frozen multiprecision solutions, from which the true counts
    are taken; else they are float64's.
    """
    if case.problem.stops is None:
        raise InputError("case", case.name, "have stops")
    for name, value in (("halvings", halvings), ("members", members)):
        integer(name, value, 1)
    dt, t_end = case.dt if dt is None else dt, case.t_end if t_end is None else t_end
    rest = {"form": form, "t_end": t_end, "references": references, "members": members}
    labels = scheme_labels(case, schemes)
    found = [{"scheme": EXACT, "contact": "implicit", "dt": 0.0, "purpose": "step"} | rest]
    found += [
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
    system = system_of(case, point["form"])
    dt, t_end = point["dt"], point["t_end"]
    if point["scheme"] == EXACT:
        return [_statistics(reference_ensemble(system, t_end, perturbed(system, 8 * point["members"], SIZE)))]
    truth = true_solution(case, point)
    if point["scheme"] == TRUE:
        # What a perfect scheme would count with this step: the sampled rule on the true tip.
        record = truth.contacts[0]
        found = {"fraction": record.fraction, "peak_force": record.peak_force, "impulse": record.impulse}
        return [{"count": truth.impacts_sampled(dt, t_end).count} | found]
    scheme, members = scheme_of(point["scheme"]), perturbed(system, point["members"], SIZE)
    many = integrate_ensemble(system, scheme, dt, t_end, members, point["contact"])
    if np.any(np.isfinite(many.diverged)):
        raise Diverged(point["scheme"], float(np.nanmin(many.diverged)), "use contact='implicit' or a smaller dt")
    horizon = min(t_end, solve_once(system, t_end).horizon)
    steps = max(2, round(horizon / dt))
    run = integrate(system, scheme, dt, steps * dt, point["contact"], every=steps)
    matching = match(run.impacts, truth.impacts, horizon)
    return [
        _statistics(many)
        | {
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


def _statistics(many: Ensemble) -> Row:
    """Means over the members, the spread of the count, and the median peak of all impacts."""
    peaks = many.impacts.peaks[np.isfinite(many.impacts.peaks)]
    return {
        "count": float(np.mean(many.impact_count)),
        "count_spread": float(np.std(many.impact_count, ddof=1)) if len(many) > 1 else float("nan"),
        "fraction": float(np.mean(many.contact_fraction)),
        "peak_force": float(np.mean(many.peak_force)),
        "impulse": float(np.mean(many.impulse)),
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
    """The largest step from which on the mean count is the exact one to ``tolerance``; NaN: none.

    To ``tolerance`` of it and the 95 % interval of the difference of the two means.
    """
    exact = next((r for r in rows if r["scheme"] == EXACT), None)
    if exact is None:
        return float("nan")
    own = sorted((r for r in rows if r["scheme"] == scheme and r["purpose"] == "step"), key=lambda r: r["dt"])
    largest = float("nan")
    for row in own:
        spreads = row["count_spread"] ** 2 / row["members"] + exact["count_spread"] ** 2 / (8 * exact["members"])
        if abs(row["count"] - exact["count"]) > tolerance * exact["count"] + 1.96 * np.sqrt(spreads):
            break
        largest = row["dt"]
    return largest


def answer(rows: Rows) -> str:
    steps = [r for r in rows if r["purpose"] == "step" and r["scheme"] not in (TRUE, EXACT)]
    exact = next((r for r in rows if r["scheme"] == EXACT), None)
    if not steps or exact is None:
        return (
            f"Without {'schemes' if exact else 'the exact members'} there is nothing to compare at {len(rows)} points."
        )
    coarse, true = max(r["dt"] for r in steps), steps[0]
    digits = true["true_digits"]
    known = f"The true motion ({digits} digits)" if digits else "The exact motion in float64, one realisation,"
    parts = []
    for row in (r for r in steps if r["dt"] == coarse):
        largest = right_from(rows, row["scheme"])
        right = f"right to 5 % from dt = {largest:.2g} on" if np.isfinite(largest) else "never right to 5 %"
        parts.append(f"{row['scheme']} {row['count']:.4g} and {100 * row['fraction']:.2g} %, {right}")
    return (
        f"{known} has {true['true_count']} impacts to t = {rows[0]['t_end']:g}, the exact ensemble "
        f"{exact['count']:.4g} ± {exact['count_spread']:.2g} and {100 * exact['fraction']:.2g} % of the time in "
        f"contact; means at dt = {coarse:g}: {'; '.join(parts)}. The finest step tried is "
        f"{min(r['dt'] for r in steps):.2g}."
    )


STUDY = Study(
    name="impacts",
    question="How many impacts does each scheme count, and from which step on is the count right?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"schemes": ["hht(alpha=-0.1)"], "halvings": 2, "t_end": 0.2, "members": 3, "sensitivity": False},
)
