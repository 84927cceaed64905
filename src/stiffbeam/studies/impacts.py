"""Impacts of each scheme over the time step: counts, forces and durations, compared with the exact ones.

Past the horizon one count is one realisation of a chaotic motion. Counts are therefore means over perturbed members,
for the schemes and for the exact solution. The single exact motion is one realisation as well; a multiprecision
solution gives it to the end.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from ..basics.text import several
from ..basics.units import Units
from ..figures.chart import (
    Axis,
    Band,
    Curve,
    Level,
    Mark,
    Panel,
    Picture,
    column,
    curves,
    look,
    numeric,
    short,
    style_of,
)
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.errors import longest_delay, match
from ..measures.report import percent
from ..model.members import SPREAD, perturbed_members
from ..schemes import HHT, SDIRK
from ..trajectory.ensemble import Ensemble
from ..trajectory.trajectory import Reference
from . import common
from .interface import Answer, Point, Records, Row, Rows, by_contact, declared
from .references import frozen

REFERENCE = "reference"  # in the place of a scheme: the exact motion, sampled
EXACT = "exact"  # the ensemble of exact solutions


def points(
    case: Case,
    *,
    schemes: common.Schemes = None,
    form: common.Form,
    dt: common.Dt,
    halvings: common.Halvings = 7,
    t_end: common.End,
    members: common.Members = 24,
    sensitivity: Annotated[bool, "also over alpha, gamma and the contact treatment"] = True,
    references: Annotated[
        str | None, "folder of frozen references; default: ./reference, else those of the package"
    ] = None,
) -> list[Point]:
    """Every scheme at ``dt`` (the case's), dt/2, ..., in ``members`` perturbed runs each, and the exact solution in
    eight times as many. With ``sensitivity`` also HHT over alpha, SDIRK-OS over gamma and the extrapolated contact, at
    ``dt``. The exact count of the single motion is that of a multiprecision solution in the folder ``references``, or
    of float64 if there is none.
    """
    shared = {"form": form, "t_end": t_end, "references": references, "members": members}
    labels = common.scheme_labels(case, schemes)
    plan = [{"scheme": EXACT, "contact": "implicit", "dt": 0.0, "purpose": "step"} | shared]
    plan += [
        {"scheme": label, "contact": "implicit", "dt": dt / 2**k, "purpose": "step"} | shared
        for label in [REFERENCE, *labels]
        for k in range(halvings)
    ]
    if sensitivity:
        family = [*(HHT(a) for a in (0.0, -0.05, -0.1, -0.2, -0.3)), *(SDIRK(g) for g in (0.2, 0.35, 0.4359, 0.8, 1.0))]
        family = [scheme for scheme in family if common.takes(case, scheme)]
        plan += [{"scheme": str(s), "contact": "implicit", "dt": dt, "purpose": "parameter"} | shared for s in family]
        moved = labels if common.takes_extrapolation(case) else []
        plan += [{"scheme": s, "contact": "extrapolated", "dt": dt, "purpose": "contact"} | shared for s in moved]
    return plan


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row for each contact: counts, forces and impulses of one scheme, of the exact ensemble or of a reference."""
    system = case.system(point["form"])
    dt, t_end = point["dt"], point["t_end"]
    count = point["members"] * (8 if point["scheme"] == EXACT else 1)
    members = perturbed_members(system, count, SPREAD, t_end=t_end)
    if point["scheme"] == EXACT:
        return _statistics(common.run_members(EXACT, members, dt, t_end))
    exact = reference_solution(case, point)
    if point["scheme"] == REFERENCE:
        # What a perfect scheme would count with this step: the sampled rule on the exact position, which never
        # passes a rigid stop.
        return [
            {
                "contact_number": i + 1,
                "count": np.nan if record.stops.rigid else exact.impacts_sampled(dt, t_end, i).count,
                "fraction": record.fraction, "peak_force": record.peak_force, "impulse": record.impulse,
            }
            for i, record in enumerate(exact.contacts)
        ]  # fmt: skip
    many = common.run_members(point["scheme"], members, dt, t_end, point["contact"])
    # Impacts are matched to the horizon only; counts are those of the whole span.
    horizon = min(t_end, common.solve_once(system, t_end).horizon)
    steps = max(2, round(horizon / dt))
    run = integrate(system, common.scheme_of(point["scheme"]), dt, steps * dt, point["contact"], every=steps)
    rows = _statistics(many)
    for row, contact, record in zip(rows, run.contacts, exact.contacts, strict=True):
        row |= asdict(match(contact.impacts, record.impacts, horizon, longest_delay(system, horizon)))
        row |= {
            "horizon": horizon,
            "reference_count": record.impacts.until(t_end).count,
            "reference_fraction": record.fraction,
            "reference_digits": exact.provenance.get("digits") or 0,
        }
    return rows


def _statistics(many: Ensemble) -> list[Row]:
    """At each contact means over the members, the spread of the count, and the median peak of all impacts."""
    return [
        {
            "contact_number": i,
            "count": float(np.mean(seen.impact_count)),
            "count_spread": float(np.std(seen.impact_count, ddof=1)) if len(many) > 1 else float("nan"),
            "fraction": float(np.mean(seen.fraction)),
            "peak_force": float(np.mean(seen.peak_force)),
            "impulse": float(np.mean(seen.impulse)),
            "median_peak": seen.impacts.median_peak,
        }
        for i, seen in enumerate(many.contacts, 1)
    ]


def reference_solution(case: Case, point: Point) -> Reference:
    """The stored multiprecision solution if there is one over the span, else the exact solution in float64."""
    if point["references"] is not None:
        solution = frozen(Path(point["references"]), case, point["form"], point["t_end"])
        if solution is not None:
            return solution
    return common.solve_once(case.system(point["form"]), point["t_end"])


def right_from(rows: Rows, scheme: str, tolerance: float = 0.05) -> float:
    """The largest time step from which on the count is right to ``tolerance`` and the 95 % interval; NaN if there is
    none."""
    exact = next((r for r in rows if r["scheme"] == EXACT), None)
    if exact is None:
        return float("nan")
    group = sorted((r for r in rows if r["scheme"] == scheme and r["purpose"] == "step"), key=lambda r: r["dt"])
    largest = float("nan")
    for row in group:
        # The variance of the difference of two means; the exact ensemble has eight times as many members. A single run
        # has no spread: that of the exact motions stands for it.
        spread = row["count_spread"] if row["members"] > 1 else exact["count_spread"]
        spreads = spread**2 / row["members"] + exact["count_spread"] ** 2 / (8 * exact["members"])
        if abs(row["count"] - exact["count"]) > tolerance * exact["count"] + 1.96 * np.sqrt(spreads):
            break
        largest = row["dt"]
    return largest


def answer(rows: Rows, case: Case) -> Answer:
    """The counts at one contact at the largest step, and from which step on each scheme is right."""
    units = case.units
    steps = [r for r in rows if r["purpose"] == "step" and r["scheme"] not in (REFERENCE, EXACT)]
    exact = next((r for r in rows if r["scheme"] == EXACT), None)
    if not steps or exact is None:
        lacking, points = "schemes" if exact else "exact members", several(len(rows), "point")
        return Answer(f"Without {lacking} there is nothing to compare at {points}.")
    if not any(row["count"] for row in (exact, *steps)):
        return Answer("No impact, neither of the exact motion nor of a run: there is nothing to count.")
    coarse, first = max(r["dt"] for r in steps), steps[0]
    table, counts = [], {}
    for row in (r for r in steps if r["dt"] == coarse):
        largest = right_from(rows, row["scheme"])
        right = np.isfinite(largest)
        limit = largest if right else min(r["dt"] for r in steps if r["scheme"] == row["scheme"])
        at = f"dt = {units.measure(limit, 'time', '.2g')}"
        counts[row["scheme"]] = row["count"]
        table.append({"scheme": short(row["scheme"]), "impacts": f"{row['count']:.4g}",
                      "in contact": percent(row["fraction"]),
                      "right to 5 %": f"from {at} on" if right else f"not yet at {at}"})  # fmt: skip
    end, step = (units.measure(x, "time", "g") for x in (first["t_end"], coarse))
    members = first["members"]
    runs = f"means over {members:g} runs whose starts differ by {SPREAD:g}" if members > 1 else "one run each"
    return Answer(
        f"At dt = {step} schemes count {common.extremes(counts, '{:.4g}'.format)} impacts to t = {end}; exact motions "
        f"have {exact['count']:.4g} ± {exact['count_spread']:.2g}.",
        table,
        f"The exact motions are in contact {percent(exact['fraction'])} of the time; a single one, by "
        f"{_precision(rows)}, has {first['reference_count']:g} impacts. Schemes: {runs}.",
    )


def _precision(rows: Rows) -> str:
    """The precision of the single exact motion in words."""
    digits = max((row["reference_digits"] for row in rows if row.get("reference_digits", 0) > 0), default=0)
    if digits:
        return f"{digits:g} digits and parameters as written"
    ends = [row["t_end"] <= row["horizon"] for row in rows if np.isfinite(row.get("horizon", np.nan))]
    return "float64 inside its horizon" if ends and all(ends) else "float64 past its horizon"


OVER_STEP = (
    ("count", "how many", 1.0, Axis("impacts counted", limits=(0.0, None))),
    ("fraction", "how long", 100.0, Axis("time in contact, per cent", limits=(0.0, None))),
    ("peak_force", "how hard", 1.0, Axis("largest contact force", "force", limits=(0.0, None))),
)
PARAMETERS = {"hht": ("alpha", "HHT over -α", -1.0), "sdirk": ("gamma", "SDIRK-OS over γ", 1.0)}
SAMPLED = {"color": "0.45", "marker": "*", "ms": 6, "linestyle": ":"}


def picture(records: Records) -> Picture:
    """For each contact, above: over the step, with the exact ensemble in black. Below: how long the impacts are
    the exact ones, and at the coarsest step what parameters and the treatment of the contact do."""
    treated = by_contact([row for row in numeric(records.rows) if row["purpose"] == "contact"])
    blocks = by_contact(records.numbers)
    lines = []
    for place, rows in blocks.items():
        lines += _block(rows, treated.get(place, []), records.case.units, place)
    return Picture(lines, 7.8 * len(blocks), 4, heights=(1.4, 1.0) * len(blocks), widths=(1.5, 1.0, 1.0))


def _block(rows: Rows, treated: Rows, units: Units, place: str) -> list[list[Panel]]:
    """The six panels of one contact."""
    runs = [row for row in rows if row["purpose"] == "step" and row["scheme"] not in (REFERENCE, EXACT)]
    single = sorted((row for row in rows if row["scheme"] == REFERENCE), key=lambda row: row["dt"])
    truth = {name: [mark for row in rows if row["scheme"] == EXACT for mark in _exact(row, name, scale)]
             for name, _, scale, _ in OVER_STEP}  # fmt: skip
    upper = [
        Panel(title + place, common.STEP, axis, [*curves(runs, "dt", name, "scheme", scale), *truth[name]])
        for name, title, scale, axis in OVER_STEP
    ]
    sampled = Curve.over(single, "dt", "count", "one exact motion at the time steps", SAMPLED)
    upper[0] = replace(upper[0], marks=[*upper[0].marks, sampled])
    unnamed = [replace(mark, label="") for mark in truth["count"]]  # the picture's legend has them
    horizon = Level(runs[0]["horizon"] if runs else np.nan, "horizon of float64", look={"color": "k"})
    over = [row for row in rows if row["purpose"] == "parameter"]
    at_dt = f"at Δt = {units.measure((over or treated or [{'dt': np.nan}])[0]['dt'], 'time', 'g')}"
    counted, nothing = Axis("impacts counted", limits=(0.0, None)), "not asked for" if runs else ""
    names = list(dict.fromkeys(row["scheme"] for row in treated))
    lines = Axis(names=[short(name) for name in names])
    lower = [
        Panel(f"how far they match{place}", common.STEP, Axis("exact impacts followed to $t$", "time"),
              [*curves(runs, "dt", "matched_until", "scheme"), horizon]),
        Panel(f"over the parameter{place}", Axis(f"parameter, {at_dt}"), counted,
              [*_over_parameters(over), *unnamed], legend="inside", empty=nothing),
        Panel(f"how treated{place}", Axis(f"impacts, {at_dt}", limits=(0.0, None)), lines,
              _treatments(runs, treated, names), empty=nothing),
    ]  # fmt: skip
    return [upper, lower]


def _exact(row: Row, name: str, scale: float) -> list[Mark]:
    """The mean over the exact members, of the count with their spread."""
    mean, spread = scale * row[name], row["count_spread"]
    band = [Band(mean - spread, mean + spread, label="spread of the exact members")] if name == "count" else []
    return [*band, Level(mean, "exact, mean over members", look={"color": "black", "ls": "-", "lw": 1.6})]


def _over_parameters(rows: Rows) -> list[Mark]:
    marks: list[Mark] = []
    for i, (name, (parameter, text, sign)) in enumerate(PARAMETERS.items()):
        group = [row for row in rows if common.scheme_of(row["scheme"]).name == name]
        points = sorted((sign * common.scheme_of(row["scheme"]).parameters[parameter], row["count"]) for row in group)
        x, y = np.array(points).reshape(-1, 2).T
        marks.append(Curve(x, y, text, style_of(i, i) | {"color": look(name)["color"]}))
    return marks


def _treatments(runs: Rows, treated: Rows, names: list[str]) -> list[Mark]:
    """Implicit beside extrapolated contact at the same step in the line of each scheme, a cross where it overflowed."""
    implicit = {(row["scheme"], row["dt"]): row["count"] for row in runs}
    at = np.array([names.index(row["scheme"]) for row in treated], float)
    failed = at[["failed" in row for row in treated]] if len(at) else at
    dots = {"linestyle": "", "color": "black", "ms": 6}
    counts = [implicit.get((row["scheme"], row["dt"]), np.nan) for row in treated]
    return [
        Curve(counts, at, "implicit contact", dots | {"marker": "o"}),
        Curve(column(treated, "count"), at, "extrapolated contact", dots | {"marker": "s", "mfc": "white"}),
        *([Curve(0.0 * failed, failed, "overflowed", dots | {"marker": "x", "mew": 2})] if len(failed) else []),
    ]


STUDY = declared(
    __name__,
    "How many impacts does each scheme count, and from which time step on is the count right?",
    needs_motion=True,
    needs_stops=True,
    each_contact=True,
    smoke={"schemes": ["HHT(alpha=-0.1)"], "halvings": 2, "t_end": 0.2, "members": 3, "sensitivity": False},
)
