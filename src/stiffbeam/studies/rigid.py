"""Convergence to rigid stops: the compliant solution against restitution 1 on the node's own mass, as kappa grows.

A compliant stop reverses the tip in half a period of the spring, a rigid one at once: the rate is kappa^(-1/2).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..figures.chart import Axis, Curve, Level, Mark, Panel, Picture, column, dashed, style_of
from ..files.cases import Case
from ..measures.errors import tip_error
from ..measures.report import percent
from ..model.members import varied_members
from ..references.exact.rigid_reference import rigid_limit
from .common import Form, ImpactCount, fit, order_over, solve_once
from .interface import Answer, Point, Records, Row, Rows, declared

SAMPLES = 4000


def points(
    case: Case,
    *,
    form: Form,
    factors: Annotated[list[float] | None, "factors on the stiffness of the stops, comma-separated"] = None,
    impacts: ImpactCount = 3,
) -> list[Point]:
    """Stops of the case's stiffness times 4^0 .. 4^9, until the first ``impacts`` impacts on rigid stops are over."""
    system = case.system(form)
    if len(system.contacts) != 1:
        count = f"{len(system.contacts)} contacts"
        remedy = "keep the stops at one place"
        raise InputError("case", count, "have stops at one place, neither none nor several", remedy)
    system.contacts[0].stops.require_linear("a limit of rigid stops")
    if system.contacts[0].offset is not None:
        raise InputError("stops", "moving ones", "be at rest for rigid stops", "their limit is known without motion")
    if system.damped:
        viscosity = 0.0 if case.beam is None else case.beam.viscosity
        name, value = ("viscosity", viscosity) if viscosity else ("damping", "a matrix that is not 0")
        raise InputError(name, value, "be 0 for rigid stops", "their limit is known without it")
    chosen = [4.0**k for k in range(10)] if factors is None else factors
    return [{"form": form, "factor": float(factor), "impacts": impacts} for factor in chosen]


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row: how far the compliant motion at one stiffness is from the rigid one."""
    system = case.system(point["form"])
    stops = system.contacts[0].stops
    kappa = stops.stiffness * point["factor"]
    rigid = rigid_limit(system, case.t_end)
    n = point["impacts"]
    if rigid.impacts.count <= n:
        remedy = "ask for fewer, or lengthen t_end"
        raise InputError("impacts", n, f"be fewer than the {rigid.impacts.count} of the rigid stops", remedy)
    times = rigid.impacts.times
    end = 0.5 * float(times[n - 1] + times[n])
    compliant = varied_members(system, stops=[replace(stops, stiffness=kappa)])[0]
    # The window is short against the horizon, and the same for every kappa.
    exact = solve_once(compliant, min(case.t_end, 2.0 * end))
    t = np.linspace(0.0, end, SAMPLES)
    error = tip_error(exact.at(t)[0], rigid.at(t)[0])
    inside = exact.impacts.until(end)
    pairs = min(n, inside.count)
    peak = float(np.max(inside.peaks[np.isfinite(inside.peaks)], initial=0.0))
    return [
        {
            "kappa": kappa,
            "end": end,
            "tip_error": error.max,
            "tip_error_rms": error.rms,
            "impacts": inside.count,
            "rigid_impacts": n,
            "impact_time_error": float(np.max(np.abs(inside.times[:pairs] - times[:pairs]), initial=0.0)),
            "penetration": peak / kappa,
            "peak_force": peak,
            "impulse_error": _impulse_error(inside.impulses[:pairs], rigid.impacts.impulses[:pairs]),
        }
    ]


def _impulse_error(impulses: Array, rigid: Array) -> float:
    """The relative error of the first impulse that is known."""
    known = np.isfinite(impulses)
    return float(abs(impulses[known][0] / rigid[known][0] - 1.0)) if np.any(known) else float("nan")


def same_impacts(rows: Rows) -> list[Row]:
    """The rows, softest first, from which on all have as many impacts as the rigid stops: the solution approaches the
    limit there. A softer one may have as many by chance."""
    others = max((r["kappa"] for r in rows if r["impacts"] != r["rigid_impacts"]), default=0.0)
    return sorted((r for r in rows if r["kappa"] > others), key=lambda r: r["kappa"])


def answer(rows: Rows, case: Case) -> Answer:
    """The observed order in 1/kappa, and the errors at every stiffness."""
    units, near = case.units, same_impacts(rows)
    stiffness = units.label("kappa", "stop stiffness")
    table = [
        {stiffness: f"{row['kappa']:.2g}", "impacts": f"{row['impacts']:g} of {row['rigid_impacts']:g}",
         "tip off by": percent(row["tip_error"]), "first impulse off by": percent(row["impulse_error"])}
        for row in sorted(rows, key=lambda r: r["kappa"])
    ]  # fmt: skip
    if len(near) < 2:
        return Answer("Fewer than two of the stiffest stops tried have as many impacts as rigid ones.", table)
    order = order_over(near, lambda row: 1.0 / row["kappa"], "tip_error")
    softest = min(rows, key=lambda r: r["kappa"])
    which = "the case's kappa" if softest["factor"] == 1.0 else "kappa"
    first, here = (units.measure(r["kappa"], "stop stiffness", ".2g") for r in (near[0], softest))
    return Answer(
        f"The tip approaches that of rigid stops like kappa^-({order}) (theory: 1/2), from kappa = {first} on.",
        table,
        f"At {which} = {here} the motion has {softest['impacts']:g} of the first {softest['rigid_impacts']:g} rigid "
        f"impacts, and its tip is {percent(softest['tip_error'])} of its largest displacement off.",
    )


PANELS = (  # one quantity an axis
    (
        "the tip",
        Axis("error over the largest displacement", scale="log"),
        (("tip_error", "largest"), ("tip_error_rms", "rms")),
    ),
    ("impact times", Axis("largest error, time", "time", "log"), (("impact_time_error", "slope"),)),
    ("the first impulse", Axis("relative error", scale="log"), (("impulse_error", "slope"),)),
    ("peak force", Axis("force", "force", "log"), (("peak_force", "slope"),)),
    ("penetration", Axis("penetration", "length", "log"), (("penetration", "slope"),)),
)


def picture(records: Records) -> Picture:
    """Hollow markers: not yet as many impacts as on rigid stops. Lines: fits to the others."""
    rows = sorted(records.numbers, key=lambda row: row["kappa"])
    kappa = Axis("stiffness of the stops κ", "stop stiffness", "log")
    kappa_of_case = records.case.system().contacts[0].stops.stiffness
    panels = []
    for title, axis, names in PANELS:
        marks: list[Mark] = [Level(kappa_of_case, "κ of the case", "x")]
        for i, (name, words) in enumerate(names):
            near, other = (
                [row for row in rows if row[name] > 0.0 and (row in same_impacts(rows)) == same]
                for same in (True, False)
            )
            style = style_of(i) | {"linestyle": "", "ms": 5}
            order = order_over(near, lambda row: 1.0 / row["kappa"], name)
            label = f"{words} in 1/κ: {order}" if np.isfinite(order.slope) else words
            marks.append(Curve.over(near, "kappa", name, label, style))
            if other:
                hollow = "not yet the impacts of rigid stops"
                marks.append(Curve.over(other, "kappa", name, hollow, style | {"mfc": "white"}))
            line = fit(1.0 / column(near, "kappa"), order, style | {"linestyle": dashed(i)})
            marks += [Curve(1.0 / curve.x, curve.y, look=curve.look) for curve in line]
        panels.append(Panel(title, kappa, axis, marks, legend="inside"))
    return Picture([panels[:2], panels[2:]], 8.0)


STUDY = declared(
    __name__,
    "How stiff must a stop be before it acts like a rigid one, and how fast is that limit approached?",
    needs_motion=True,
    needs_stops=True,
    marches=False,
    smoke={"factors": [16.0, 256.0, 4096.0], "impacts": 2},
)
