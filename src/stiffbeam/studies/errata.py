"""Error of each misprint that runs compared with the corrected scheme, without contact and through contact."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..basics.validation import InputError
from ..figures.chart import MARKERS, Axis, Curve, Level, Mark, Panel, Picture, column, dashed, groups, look, short
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.errors import observed_order, tip_error
from ..measures.frequencies import smooth_motion
from ..measures.report import DASH
from ..model.system import System
from ..schemes import SCHEMES, Scheme
from ..schemes.labels import make
from ..schemes.misprints import forms_of
from ..trajectory.trajectory import Reference
from . import common
from .converge import ROUNDING, smooth_end
from .interface import Answer, Point, Records, Row, Rows, declared

SAMPLES = 1000
PHASES = {"smooth": "without impacts", "contact": "first impacts"}  # of each kind of points, in words
EXTRAPOLATED = "extrapolated contact"
COARSER = 16  # times dt to start from without contact, where smaller steps soon reach rounding


def points(
    case: Case,
    *,
    schemes: common.Schemes = None,
    form: common.Form,
    dt: common.Dt,
    halvings: common.Halvings = 10,
    impacts: common.ImpactCount = 4,
) -> list[Point]:
    """Every misprint of the case's schemes, and the paper's extrapolated contact, at ``dt`` (the case's), dt/2, ..."""
    window = common.first_impacts(case, form, impacts) if case.has_stops else 0.0
    smooth = smooth_end(case.system(form), case.t_end)
    plan: list[Point] = []
    labels = common.scheme_labels(case, schemes)
    if schemes is None:  # without contact, a misprint costs the same whatever the stops are
        have = {common.scheme_of(label).name for label in labels}
        labels += [name for name in SCHEMES if name not in have and forms_of(make(name))]
    for label in labels:
        readings = [(f"printed({name})", "implicit") for name in forms_of(common.scheme_of(label))]
        touches = window and common.takes(case, common.scheme_of(label))
        if touches and common.takes_extrapolation(case):
            readings.append((EXTRAPOLATED, "extrapolated"))
        kinds = [kind for kind, span in (("smooth", smooth), ("contact", touches)) if span]
        for reading, contact in readings:
            for kind in kinds:
                if kind == "smooth" and contact == "extrapolated":
                    continue  # there is none to extrapolate
                end, first = (window, dt) if kind == "contact" else (smooth, COARSER * dt)
                plan += [
                    {"scheme": label, "reading": reading, "kind": kind, "form": form, "t_end": end, "steps": steps}
                    for steps in common.halved(end, first, halvings)
                ]
    if not plan:
        remedy = "take SDIRK, or stops whose force depends on the position alone"
        raise InputError("schemes", ", ".join(labels), "have a misprint that runs", remedy)
    return plan


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row: the errors of the corrected and of the printed scheme at one step."""
    system = case.system(point["form"])
    if point["kind"] == "smooth":
        system = smooth_motion(system)
    exact = common.solve_once(system, point["t_end"])
    scheme = common.scheme_of(point["scheme"])
    right = _error(system, scheme, point, exact, "implicit")
    if point["reading"] == EXTRAPOLATED:
        printed = _error(system, scheme, point, exact, "extrapolated")
    else:
        name = point["reading"].removeprefix("printed(").removesuffix(")")
        printed = _error(system, scheme.printed(name), point, exact, "implicit")
    return [{"dt": point["t_end"] / point["steps"], "error": right, "error_printed": printed}]


def _error(system: System, scheme: Scheme, point: Point, exact: Reference, contact: str) -> float:
    """The rms tip error over the span, relative to the largest displacement."""
    steps, end = point["steps"], point["t_end"]
    run = integrate(system, scheme, end / steps, end, contact, every=max(1, steps // SAMPLES))
    return tip_error(run.tip, exact.at(run.t)[0]).rms


def answer(rows: Rows, case: Case) -> Answer:
    """The ratio of both errors at the largest and the smallest step, and both orders without contact."""
    table, ratios = [], {}
    for (scheme, reading, kind), group in groups(rows, "scheme", "reading", "kind").items():
        counted = [r for r in group if r["error"] > ROUNDING * r["steps"]]
        right, printed = (observed_order(column(counted, "dt"), column(counted, name)) for name in ERRORS)
        coarse, fine = (
            f"{row['error_printed'] / row['error']:.3g} (dt = {case.units.measure(row['dt'], 'time', '.2g')})"
            for row in (group[0], group[-1])
        )
        ratios[f"{short(scheme)} {reading}, {PHASES[kind]}"] = group[-1]["error_printed"] / group[-1]["error"]
        orders = kind == "smooth" and np.isfinite(printed.slope)
        table.append({
            "error, times the right scheme's": f"{short(scheme)} {reading}, {PHASES[kind]}",
            "at the coarsest dt": coarse,
            "at the finest": fine,
            "order": f"{printed.slope:.2f} for {right.slope:.2f}" if orders else DASH,
        })  # fmt: skip
    compared = any(row["kind"] == "contact" for row in rows)
    return Answer(
        f"At the finest dt a misprint or extrapolated contact multiplies the error by "
        f"{common.extremes(ratios, '{:.3g}'.format)}.",
        table,
        "Order: of the misprinted scheme for that of the corrected one."
        + ("" if compared else " No first impacts were compared: the cost of a misprint in contact is not known."),
    )


ERRORS = ("error", "error_printed")
MISPRINTS = [misprint for name in SCHEMES for misprint in forms_of(make(name))]
PANELS = (  # the kind, whether the contact is extrapolated, and the title
    ("smooth", False, "without contact: error as printed over right"),
    ("contact", False, "first impacts: error as printed over right"),
    ("contact", True, "first impacts: error extrapolated over implicit"),
)


def picture(records: Records) -> Picture:
    """First the errors without contact, then the factor by which each reading changes the error."""
    evaluated = groups(records.numbers, "scheme", "reading", "kind")
    left_out = groups(records.failures + records.refusals, "scheme", "reading", "kind")
    smooth = {key: rows for key, rows in evaluated.items() if key[2] == "smooth"}
    errors: list[Mark] = []
    for scheme, rows in {key[0]: rows for key, rows in reversed(smooth.items())}.items():
        right = look(scheme) | {"linestyle": "-"}
        errors.append(Curve.over(rows, "dt", "error", f"{short(scheme)}, right", right))
    errors += [Curve.over(rows, "dt", "error_printed", _name(*key[:2]), look(key[0]) | _printed(key[1]))
               for key, rows in smooth.items()]  # fmt: skip
    error, none = Axis("tip error, rms, relative", scale="log"), "no such reading"
    title = "without contact: right (full) and as printed (dashed)"
    panels = [Panel(title, common.STEP, error, errors, (3, 2, 1), "below", none)]
    for kind, extrapolated, title in PANELS:
        marks: list[Mark] = [Level(1.0)]
        largest = 0.0
        for key in [*evaluated, *(key for key in left_out if key not in evaluated)]:
            scheme, reading, rows = key[0], key[1], evaluated.get(key, [])
            if (key[2], reading == EXTRAPOLATED) != (kind, extrapolated):
                continue
            missing = len(left_out.get(key, ()))
            text = _name(scheme, reading) + (f" ({missing} time steps left out)" if missing else "")
            factors = column(rows, "error_printed") / column(rows, "error")
            largest = max([largest, *factors[np.isfinite(factors)]])
            style = look(scheme) | ({} if extrapolated else _printed(reading))
            marks.append(Curve(column(rows, "dt"), factors, text, style))
        factor = Axis("times the error", scale="log" if largest > 5.0 else "linear")
        panels.append(Panel(title, common.STEP, factor, marks, legend="below", empty=none))
    return Picture([panels[:2], panels[2:]], 8.6)


def _name(scheme: str, reading: str) -> str:
    inner = "" if reading == EXTRAPOLATED else " " + reading.removeprefix("printed(").removesuffix(")")
    return short(scheme) + inner


def _printed(reading: str) -> dict[str, Any]:
    """Hollow, with dashes and marker of the misprint, the same in every panel."""
    i = MISPRINTS.index(reading.removeprefix("printed(").removesuffix(")"))
    return {"mfc": "white", "linestyle": dashed(1 + i), "marker": MARKERS[i % len(MARKERS)]}


STUDY = declared(
    __name__,
    "How large is the error of each misprint that runs, and of the paper's linearised contact?",
    needs_motion=True,
    smoke={"schemes": ["HHT(alpha=-0.1)"], "halvings": 3, "impacts": 2},
)
