"""Towards rigid stops: the compliant solution against restitution 1 on the node's own mass, as kappa grows.

A compliant stop turns the tip round in half a period of the spring, a rigid one at once: the rate is kappa^(-1/2).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..figures import Axis, Curve, Level, Mark, Panel, Picture, column, dashed, style_of
from ..files.cases import Case
from ..measures.errors import observed_order, tip_error
from ..measures.report import percent
from ..model.members import varied_members
from ..references.exact.rigid_reference import rigid_limit
from .common import Form, ImpactCount, fit, solve_once, system_of
from .engine.study import Answer, Point, Records, Row, Rows, Study

SAMPLES = 4000


def points(
    case: Case,
    *,
    form: Form,
    factors: Annotated[list[float] | None, "of the stops' stiffness, with commas between them"] = None,
    impacts: ImpactCount = 3,
) -> list[Point]:
    """The case's kappa times 4^0 .. 4^9, until the first impacts of the rigid solution are over, as many as
    ``impacts`` says."""
    system = system_of(case, form)
    if len(system.contacts) != 1:
        found = f"{len(system.contacts)} contacts"
        remedy = "keep the stops at one place"
        raise InputError("case", found, "have stops at one place, neither none nor several", remedy)
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
    system = system_of(case, point["form"])
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
    found = solve_once(compliant, min(case.t_end, 2.0 * end))
    t = np.linspace(0.0, end, SAMPLES)
    error = tip_error(found.at(t)[0], rigid.at(t)[0])
    inside = found.impacts.until(end)
    pairs = min(n, inside.count)
    return [
        {
            "kappa": kappa,
            "end": end,
            "tip_error": error.max,
            "tip_error_rms": error.rms,
            "impacts": inside.count,
            "rigid_impacts": n,
            "impact_time_error": float(np.max(np.abs(inside.times[:pairs] - times[:pairs]), initial=0.0)),
            "penetration": float(np.max(inside.peaks[np.isfinite(inside.peaks)], initial=0.0)) / kappa,
            "peak_force": float(np.max(inside.peaks[np.isfinite(inside.peaks)], initial=0.0)),
            "impulse_error": _impulse_error(inside.impulses[:pairs], rigid.impacts.impulses[:pairs]),
        }
    ]


def _impulse_error(found: Array, wanted: Array) -> float:
    """Of the first impact whose impulse is known, relative."""
    known = np.isfinite(found)
    return float(abs(found[known][0] / wanted[known][0] - 1.0)) if np.any(known) else float("nan")


def same_impacts(rows: Rows) -> list[Row]:
    """The rows with as many impacts as the rigid stops: from there on the limit is being approached."""
    return [r for r in rows if r["impacts"] == r["rigid_impacts"]]


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
        return Answer("At no stiffness tried are there as many impacts as on rigid stops.", table)
    order = observed_order([1.0 / r["kappa"] for r in near], [r["tip_error"] for r in near])
    own = min(rows, key=lambda r: r["kappa"])
    which = "the case's kappa" if own["factor"] == 1.0 else "kappa"
    first, here = (units.measure(f"{r['kappa']:.2g}", "stop stiffness") for r in (near[0], own))
    return Answer(
        f"The tip approaches that of rigid stops like kappa^-({order}) (theory: 1/2), from kappa = {first} on.",
        table,
        f"At {which} = {here} the first {own['rigid_impacts']:g} rigid impacts are {own['impacts']:g} and the tip is "
        f"{percent(own['tip_error'])} of its largest displacement off.",
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
    """Hollow markers: as yet another number of impacts than rigid stops have. Lines: fits to the others."""
    rows = sorted(records.numbers, key=lambda row: row["kappa"])
    kappa = Axis("stiffness of the stops κ", "stop stiffness", "log")
    own = records.case.system().contacts[0].stops.stiffness
    panels = []
    for title, axis, names in PANELS:
        marks: list[Mark] = [Level(own, "κ of the case", "x")]
        for i, (name, words) in enumerate(names):
            near, other = (
                [row for row in rows if row[name] > 0.0 and (row in same_impacts(rows)) == same]
                for same in (True, False)
            )
            style = style_of(i) | {"linestyle": "", "ms": 5}
            order = observed_order(1.0 / column(near, "kappa"), column(near, name))
            label = f"{words} in 1/κ: {order}" if np.isfinite(order.slope) else words
            marks.append(Curve(column(near, "kappa"), column(near, name), label, style))
            if other:
                hollow = "other impacts than rigid stops"
                marks.append(Curve(column(other, "kappa"), column(other, name), hollow, style | {"mfc": "white"}))
            line = fit(1.0 / column(near, "kappa"), order, style | {"linestyle": dashed(i)})
            marks += [Curve(1.0 / curve.x, curve.y, look=curve.look) for curve in line]
        panels.append(Panel(title, kappa, axis, marks, legend="inside"))
    return Picture([panels[:3], panels[3:]], 8.0)


STUDY = Study(
    name="rigid",
    question="How stiff must a stop be before it acts like a rigid one, and how fast is that limit approached?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    picture=picture,
    needs_motion=True,
    needs_stops=True,
    marches=False,
    smoke={"factors": [16.0, 256.0, 4096.0], "impacts": 2},
)
