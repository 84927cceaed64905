"""Towards rigid stops: the compliant solution against restitution 1 on the node's own mass, as kappa grows.

A compliant stop turns the tip round in half a period of the spring, a rigid one at once: the rate is kappa^(-1/2).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError, positive
from ..figures import COLOURS, MARKERS, column, dashed, heading, log_scale, new_figure, numeric, say_empty
from ..files.cases import Case
from ..measures.errors import observed_order, tip_error
from ..measures.report import percent
from ..model.members import varied
from ..references.exact.rigid import rigid_limit
from .common import Form, ImpactCount, solve_once, system_of
from .engine.study import Point, Records, Row, Rows, Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAMPLES = 4000


def points(
    case: Case,
    form: Form = "displacement",
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
    positive("impacts", impacts)
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
    compliant = varied(system, stops=[replace(stops, stiffness=kappa)])[0]
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


def answer(rows: Rows, case: Case) -> str:
    """The observed order in 1/kappa, and the error at the smallest stiffness."""
    units = case.units
    near = same_impacts(rows)
    if len(near) < 2:
        return "At no stiffness tried does the compliant contact have as many impacts as rigid stops have."
    order = observed_order([1.0 / r["kappa"] for r in near], [r["tip_error"] for r in near])
    own = min(rows, key=lambda r: r["kappa"])
    which = "the case's kappa" if own["factor"] == 1.0 else "kappa"
    first, here = (units.measure(f"{r['kappa']:.2g}", "stop stiffness") for r in (near[0], own))
    return (
        f"The tip approaches that of rigid stops like kappa^-({order}) (theory: 1/2), from kappa = "
        f"{first} on; at {which} = {here} the first {own['rigid_impacts']} rigid "
        f"impacts are {own['impacts']} and the tip is {percent(own['tip_error'])} of its largest displacement off."
    )


PANELS = (  # one quantity an axis
    ("the tip", "error over the largest displacement", (("tip_error", "largest"), ("tip_error_rms", "rms"))),
    ("impact times", "largest error, {time}", (("impact_time_error", "slope"),)),
    ("the first impulse", "relative error", (("impulse_error", "slope"),)),
    ("peak force", "{force}", (("peak_force", "slope"),)),
    ("penetration", "{length}", (("penetration", "slope"),)),
)


def draw(records: Records) -> Figure:
    """Hollow markers: as yet another number of impacts than rigid stops have. Lines: fits to the others."""
    from matplotlib.lines import Line2D

    rows = sorted(numeric(records.found), key=lambda row: row["kappa"])
    near = same_impacts(rows)
    figure = new_figure(6.8)
    impacts = f"first {rows[0]['rigid_impacts']} impacts, " if rows else ""
    order = observed_order(1.0 / column(near, "kappa"), column(near, "tip_error"))
    found = f"the tip approaches that of rigid stops like κ^-{order.slope:.2f}" if np.isfinite(order.slope) else "κ → ∞"
    figure.suptitle(heading(records.case, f"{impacts}{found} (theory: 1/2); slopes in 1/κ"))
    units = records.case.units
    names_of = {
        name: units.label(text, name)
        for name, text in (("time", "time"), ("force", "force"), ("length", "penetration"))
    }
    stops = records.case.system().contacts[0].stops
    axes = figure.subplot_mosaic("abc;de.")
    for letter, (title, unit, names) in zip("abcde", PANELS, strict=True):
        axis = axes[letter]
        for i, (name, words) in enumerate(names):
            style: dict[str, Any] = {"color": COLOURS[i], "marker": MARKERS[i], "ms": 5, "ls": ""}
            positive = [row for row in rows if row[name] > 0.0]  # false for NaN
            other = [row for row in positive if row not in near]
            own = [row for row in positive if row in near]
            axis.plot(column(other, "kappa"), column(other, name), mfc="white", **style)
            order = observed_order(1.0 / column(own, "kappa"), column(own, name))
            text = f"{words}: {order}" if np.isfinite(order.slope) else words
            axis.plot(column(own, "kappa"), column(own, name), label=text, **style)
            if np.isfinite(order.slope):
                kappa = column(own, "kappa")[[0, -1]]
                axis.plot(kappa, order.constant * kappa**-order.slope, color=COLOURS[i], lw=1.0, ls=dashed(i))
        axis.axvline(stops.stiffness, color="0.55", lw=0.9, ls=":")
        log_scale(axis)
        axis.set(xlabel=units.label("stiffness of the stops κ", "stop stiffness"), ylabel=unit.format(**names_of))
        axis.grid(color="0.92")
        axis.set_title(f"({letter}) {title}", loc="left")
        axis.legend(frameon=False, fontsize=9)
        if not rows:
            say_empty(axis)
    marks = [Line2D([], [], color="0.55", lw=0.9, ls=":", label="κ of the case")]
    if len(near) < len(rows):
        hollow = Line2D(
            [], [], ls="", marker="o", ms=5, mfc="white", mec="0.35", label="other impacts than rigid stops"
        )
        marks.insert(0, hollow)
    figure.legend(handles=marks, loc="lower right", bbox_to_anchor=(0.95, 0.2), frameon=False, fontsize=9)
    return figure


STUDY = Study(
    name="rigid",
    question="How stiff must a stop be before it acts like a rigid one, and how fast is that limit approached?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    needs_motion=True,
    needs_stops=True,
    marches=False,
    smoke={"factors": [16.0, 256.0, 4096.0], "impacts": 2},
)
