"""Convergence in time: the order of each scheme, without contact and through contact.

A point enters the slope only if the motion is resolved, the error is above rounding, and (in contact) every impact
inside the window matches one of the reference.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from ..basics.validation import InputError
from ..figures.chart import Axis, Curve, Panel, Picture, groups, look, short
from ..files.cases import Case
from ..measures.errors import Order, impact_times, matched_until, observed_order, tip_error
from ..measures.frequencies import slowest_period, smooth_motion, without_contact
from ..measures.report import DASH
from ..model.scales import scales
from ..model.system import System
from ..model.time_functions import Drive
from ..testset.integrators import RECORDED, SOLVER
from . import common
from .interface import Answer, Point, Records, Row, Rows, declared

KINDS = ("smooth", "contact")
PER_OCTAVE = 4  # steps per halving through contact, where the error varies irregularly: the worst of an octave counts
SAMPLES = 1000  # outputs on which the error is measured
RESOLVED = 0.5  # largest (omega dt)
ASYMPTOTIC = 0.1  # largest relative error
ROUNDING = 10.0 * np.finfo(float).eps  # times the number of steps: what rounding may have added


def points(
    case: Case,
    *,
    schemes: common.Integrators = None,
    kinds: Annotated[list[str] | None, "smooth, contact, or both"] = None,
    form: common.Form,
    dt: common.Dt,
    halvings: common.Halvings = 10,
    impacts: common.ImpactCount = 4,
    contact: common.Treatment = "implicit",
) -> list[Point]:
    """Every scheme at ``dt`` (the case's), dt/2, ..., ``halvings`` steps in all.

    smooth: the slow motion of the case without stops, over one period of the drive or of the lowest mode, whichever is
    longer. contact: the case itself until the first ``impacts`` impacts are over.
    """
    system, chosen = case.system(form), common.integrators_of(case, schemes)
    for one in chosen:
        if one.kind == SOLVER:
            remedy = "stiffbeam precision shows its error against its work"
            raise InputError("schemes", one.label, "have a time step that can be halved, not a tolerance", remedy)
    plan: list[Point] = []
    for kind in KINDS if kinds is None else kinds:
        if kind == "smooth":
            end, per_octave = smooth_end(system, case.t_end), 1
            if not end:
                continue
        elif kind == "contact":
            if not system.contacts:
                continue
            end, per_octave = common.first_impacts(case, form, impacts), PER_OCTAVE
        else:
            raise InputError("kinds", kind, f"be among {KINDS}", "for example ('smooth',)")
        for one in chosen:
            shared = {"kind": kind, "scheme": one.label, "form": form, "contact": contact, "t_end": end}
            if one.kind == RECORDED:  # of the case itself, which is no smooth motion
                runs = common.recorded_points(one, system) if kind == "contact" else []
                plan += [
                    shared | {"steps": round(end / run["dt"]), "recorded": run["recorded"],
                            "octave": round(float(np.log2(runs[0]["dt"] / run["dt"])))}
                    for run in runs
                ]  # fmt: skip
                continue
            plan += [
                shared | {"steps": steps, "octave": k // per_octave}
                for k, steps in enumerate(common.halved(end, dt, halvings, per_octave))
            ]
    if not plan and any(one.kind == RECORDED for one in chosen):
        rule = "be asked about contact: recorded runs are of the case itself"
        raise InputError("kinds", kinds, rule, "give a function, which runs on the smooth motion too")
    # Steps that round to one number are one point.
    return list({(p["kind"], p["scheme"], p["steps"]): p for p in plan}.values())


def smooth_end(system: System, t_end: float) -> float:
    """The end of a run without contact: the longest period, or 0 where the body flies freely away from its stops.

    Raises InputError where there are no stops either.
    """
    try:
        return slowest_period(without_contact(system), t_end)
    except InputError:
        if not system.contacts:
            raise
        return 0.0


def evaluate(case: Case, point: Point) -> list[Row]:
    """Row with the tip error at one step, the reason why it does not count in the slope, or "", and the impacts of the
    exact motion."""
    system = case.system(point["form"])
    if point["kind"] == "smooth":
        system = smooth_motion(system)
    steps, t_end = point["steps"], point["t_end"]
    exact = common.solve_once(system, t_end)
    dt = t_end / steps
    run = common.run_of(
        point["scheme"], point.get("recorded"), system, dt, t_end, point["contact"], max(1, steps // SAMPLES)
    )
    error = tip_error(run.tip, exact.at(run.t)[0])
    fastest = max([*Drive.of(system).frequencies, 2.0 * np.pi / scales(system, case.t_end).period])
    # Reasons that keep a point out of the slope.
    reasons = {
        "impacts differ": point["kind"] == "contact" and matched_until(run, exact, t_end) < t_end,
        "error above 10 %": error.rms > ASYMPTOTIC,
        "motion not resolved": fastest * dt > RESOLVED,
        "rounding": error.rms < max(ROUNDING * steps, 10.0 * float(exact.provenance.get("rtol", 0.0))),
        "past the horizon": t_end > exact.horizon,
    }
    left_out = next((reason for reason, holds in reasons.items() if holds), "")
    impacts = int(np.sum(impact_times(exact) <= t_end))
    return [{"dt": dt, "error_rms": error.rms, "error_max": error.max, "left_out": left_out, "impacts": impacts}]


def envelope(rows: Rows) -> tuple[list[float], list[float]]:
    """(dt, error) of the worst point of every octave whose points all count."""
    steps, errors = [], []
    for octave in sorted({r["octave"] for r in rows}):
        group = [r for r in rows if r["octave"] == octave]
        if all(not r["left_out"] for r in group):
            steps.append(max(r["dt"] for r in group))
            errors.append(max(r["error_rms"] for r in group))
    return steps, errors


def orders(rows: Rows) -> dict[tuple[str, str], Order]:
    """The observed order by (kind, scheme)."""
    keys = dict.fromkeys((r["kind"], r["scheme"]) for r in rows)
    return {key: observed_order(*envelope([r for r in rows if (r["kind"], r["scheme"]) == key])) for key in keys}


def answer(rows: Rows, case: Case) -> Answer:
    """The observed orders, without contact and through the first impacts, or as the motion starts without any."""
    observed = orders(rows)
    start = next((row for row in rows if row["kind"] == "contact" and not row["impacts"]), None)
    through, column = "through the first impacts", "order through the first impacts"
    notes = "Through the first impacts"
    if start is not None:
        through, column = "as the motion starts", "order without impacts, as it starts"
        end = case.units.measure(start["t_end"], "time", "g")
        notes = f"No impacts to t = {end}, the motion as it starts"
    words = {"smooth": ("without contact", "order without contact"), "contact": (through, column)}
    kinds = [kind for kind in words if any(k == kind for k, _ in observed)]
    slopes = {kind: {s: o.slope for (k, s), o in observed.items() if k == kind and not o.unclear} for kind in kinds}
    said = [
        f"{common.extremes(group, '{:.2f}'.format) if group else 'no clear rate'} {words[kind][0]}"
        for kind, group in slopes.items()
    ]
    table = [
        {"scheme": scheme} | {words[kind][1]: _shown(observed.get((kind, scheme))) for kind in kinds}
        for scheme in dict.fromkeys(scheme for _, scheme in observed)
    ]
    remark = f"{notes}: the worst of each octave of time steps counts. " if "contact" in kinds else ""
    return Answer(f"Observed orders: {', '.join(said)}.", table, f"{remark}± holds with 95 %.")


def _shown(order: Order | None) -> str:
    return DASH if order is None else str(order) if np.isfinite(order.slope) else "too few points"


REASONS = {"impacts differ": "o", "error above 10 %": "^", "motion not resolved": "s", "rounding": "v",
           "past the horizon": "D", "beside one of these, in its octave": "p"}  # fmt: skip


def picture(records: Records) -> Picture:
    """Picture of errors over time steps. Filled markers enter the slope; hollow ones do not, and their shape gives the
    reason."""
    rows = records.numbers
    observed, panels = orders(rows), []
    for kind, group in groups(rows, "kind").items():
        through = "through the first impacts" if any(row["impacts"] for row in group) else "as it starts, no impacts"
        title = "without contact, slow motion" if kind == "smooth" else through
        marks = [
            mark for label, mine in groups(group, "scheme").items() for mark in _points(mine, observed[kind, label])
        ]
        met = [reason for reason in REASONS if any(reason == reason_of(row, group) for row in group)]
        marks += [Curve([], [], f"left out: {reason}", {"linestyle": "", "marker": REASONS[reason], "mfc": "white",
                                                         "mec": "0.35"}) for reason in met]  # fmt: skip
        error = Axis("tip error, rms, relative", scale="log", cap=1e3)
        panels.append(Panel(title, common.STEP, error, marks, (3, 2, 1), "below"))
    return Picture([panels], 6.4)


def reason_of(row: Row, rows: Rows) -> str:
    """Reason why a point does not enter the slope of its scheme; "" if it does."""
    octave = [r for r in rows if (r["scheme"], r["octave"]) == (row["scheme"], row["octave"])]
    return row["left_out"] or ("beside one of these, in its octave" if any(r["left_out"] for r in octave) else "")


def _points(group: Rows, order: Order) -> list[Curve]:
    """Points and slope of one scheme; in its look those that count."""
    group = sorted(group, key=lambda row: row["dt"])
    style = look(group[0]["scheme"])
    label = f"{short(group[0]['scheme'])}: {_shown(order)}"
    marks = [Curve.over(group, "dt", "error_rms", look=style | {"marker": "", "lw": 0.5, "alpha": 0.6}),
             Curve([], [], label, style)]  # fmt: skip
    for reason, mine in {
        reason: [r for r in group if reason_of(r, group) == reason] for reason in ["", *REASONS]
    }.items():
        fill = {"mfc": "white", "marker": REASONS[reason]} if reason else {}
        marks.append(Curve.over(mine, "dt", "error_rms", look=style | {"linestyle": "", "ms": 4} | fill))
    return marks + common.fit(np.array(envelope(group)[0]), order, style)


STUDY = declared(
    __name__,
    "At which rate does each scheme converge to the exact solution, without contact and through it?",
    smoke={"schemes": ["BDF2", "SDIRK(gamma=0.4359, nystrom=True)"], "halvings": 4, "impacts": 2},
)
