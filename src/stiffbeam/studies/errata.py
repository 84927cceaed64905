"""What each misprint that runs costs: its error beside the corrected scheme's, smooth and through contact."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ..basics.validation import InputError
from ..figures import (
    MARKERS,
    column,
    dashed,
    heading,
    log_scale,
    look,
    mark_order,
    new_figure,
    numeric,
    say_empty,
    short,
)
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.errors import observed_order, tip_error
from ..measures.smooth_motion import smooth_motion
from ..model.system import System
from ..schemes import SCHEMES, Scheme, make
from ..schemes.misprints import forms_of
from ..trajectory.trajectory import Reference
from .common import (
    Dt,
    Form,
    Halvings,
    ImpactCount,
    Schemes,
    afford_halvings,
    first_impacts,
    scheme_labels,
    scheme_of,
    solve_once,
    system_of,
    takes,
    takes_extrapolation,
)
from .converge import ROUNDING, smooth_end
from .engine.study import Answer, Point, Records, Row, Rows, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SAMPLES = 1000
COARSER = 16  # times dt to start from without contact, where smaller steps soon reach rounding


def points(
    case: Case,
    schemes: Schemes = None,
    form: Form = "displacement",
    dt: Dt = None,
    halvings: Halvings = 10,
    impacts: ImpactCount = 4,
) -> list[Point]:
    """Every misprint of the case's schemes, and the paper's extrapolated contact, at steps from ``dt`` downwards."""
    afford_halvings(case, halvings, dt, None)
    start = case.dt if dt is None else dt
    window = first_impacts(case, form, impacts) if case.has_stops else 0.0
    smooth = smooth_end(system_of(case, form), case.t_end)
    found: list[Point] = []
    labels = scheme_labels(case, schemes)
    if schemes is None:  # without contact, a misprint costs the same whatever the stops are
        have = {scheme_of(label).name for label in labels}
        labels += [name for name in SCHEMES if name not in have and forms_of(make(name))]
    for label in labels:
        readings = [(f"printed({name})", "implicit") for name in forms_of(scheme_of(label))]
        touches = window and takes(case, scheme_of(label))
        if touches and takes_extrapolation(case):
            readings.append(("extrapolated contact", "extrapolated"))
        kinds = [kind for kind, span in (("smooth", smooth), ("contact", touches)) if span]
        for reading, contact in readings:
            for kind in kinds:
                if kind == "smooth" and contact == "extrapolated":
                    continue  # there is none to extrapolate
                end, first = window, start
                if kind != "contact":
                    end, first = smooth, COARSER * start
                found += [
                    {"scheme": label, "reading": reading, "kind": kind, "form": form, "t_end": end,
                     "steps": max(4, round(end / first * 2.0**k))}
                    for k in range(halvings)
                ]  # fmt: skip
    if not found:
        remedy = "take sdirk, or stops whose force depends on the position alone"
        raise InputError("schemes", ", ".join(labels), "have a misprint that runs", remedy)
    return found


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row: the errors of the corrected and of the printed scheme at one step."""
    system = system_of(case, point["form"])
    if point["kind"] == "smooth":
        system = smooth_motion(system)
    exact = solve_once(system, point["t_end"])
    scheme = scheme_of(point["scheme"])
    right = _error(system, scheme, point, exact, "implicit")
    row: Row = {"dt": point["t_end"] / point["steps"], "error": right}
    if point["reading"] == "extrapolated contact":
        return [row | {"error_printed": _error(system, scheme, point, exact, "extrapolated")}]
    name = point["reading"].removeprefix("printed(").removesuffix(")")
    return [row | {"error_printed": _error(system, scheme.printed(name), point, exact, "implicit")}]


def _error(system: System, scheme: Scheme, point: Point, exact: Reference, contact: str) -> float:
    """The rms tip error over the span, relative to the largest displacement."""
    steps, end = point["steps"], point["t_end"]
    run = integrate(system, scheme, end / steps, end, contact, every=max(1, steps // SAMPLES))
    return tip_error(run.tip, exact.at(run.t)[0]).rms


def groups(rows: Rows) -> dict[tuple[str, str, str], list[Row]]:
    """The rows by (scheme, reading, kind)."""
    keys = dict.fromkeys((r["scheme"], r["reading"], r["kind"]) for r in rows)
    return {key: [r for r in rows if (r["scheme"], r["reading"], r["kind"]) == key] for key in keys}


def answer(rows: Rows, case: Case) -> str:
    """The ratio of both errors at the largest and the smallest step, and both orders without contact."""
    units = case.units
    parts, table = [], []
    for (scheme, reading, kind), own in groups(rows).items():
        first, last = own[0], own[-1]
        counted = [r for r in own if r["error"] > ROUNDING * r["steps"]]
        right = observed_order([r["dt"] for r in counted], [r["error"] for r in counted])
        printed = observed_order([r["dt"] for r in counted], [r["error_printed"] for r in counted])
        coarse, fine = (units.measure(f"{r['dt']:.2g}", "time") for r in (first, last))
        parts.append(
            f"{scheme} {reading}, {kind}: {first['error_printed'] / first['error']:.3g} times the error at "
            f"dt = {coarse} and {last['error_printed'] / last['error']:.3g} times at {fine}"
            + (f", order {printed.slope:.2f} for {right.slope:.2f}" if kind == "smooth" else "")
        )
        orders = kind == "smooth" and math.isfinite(printed.slope)
        table.append({
            "error, times the right scheme's": f"{short(scheme)} {reading}, {kind}",
            "at the coarsest dt": f"{first['error_printed'] / first['error']:.3g} ({coarse})",
            "at the finest": f"{last['error_printed'] / last['error']:.3g} ({fine})",
            "order": f"{printed.slope:.2f} for {right.slope:.2f}" if orders else "–",
        })  # fmt: skip
    rest = "" if any(kind == "contact" for _, _, kind in groups(rows)) else NO_IMPACTS
    return Answer("; ".join(parts) + "." + rest, table, rest.strip())


EXTRAPOLATED = "extrapolated contact"
NO_IMPACTS = " No first impacts were compared: what a misprint costs in contact is not known."
MISPRINTS = [misprint for name in SCHEMES for misprint in forms_of(make(name))]


def draw(records: Records) -> Figure:
    """(a) errors without contact; (b) to (d) the factor by which each reading changes the error."""
    rows = numeric(records.found)
    refused = {key: len(own) for key, own in groups(records.failures + records.refusals).items()}
    found = groups(rows)
    smooth = {key: own for key, own in found.items() if key[2] == "smooth"}
    printed = {key: own for key, own in found.items() if key[2] == "contact" and key[1] != EXTRAPOLATED}
    predicted = {key: own for key, own in found.items() if key[2] == "contact" and key[1] == EXTRAPOLATED}
    figure = new_figure(8.6, heading(records.case, "what misprints and the linearised contact cost"))
    axes = figure.subplots(2, 2).ravel()
    _errors(axes[0], smooth)
    axes[0].set_title("(a) without contact: right (full) and as printed (dashed)", loc="left")
    panels = (
        (smooth, "(b) without contact: error as printed over right"),
        (printed, "(c) first impacts: error as printed over right"),
        (predicted, "(d) first impacts: error extrapolated over implicit"),
    )
    for axis, (own, title) in zip(axes[1:], panels, strict=True):
        _factors(axis, own, refused)
        axis.set_title(title, loc="left")
    for axis in axes:
        axis.grid(color="0.92")
        log_scale(axis, y=axis is axes[0] or axis.get_ylim()[1] > 5.0)
        axis.set(xlabel=records.case.units.label(r"step $\Delta t$", "time"))
        if axis.get_legend_handles_labels()[0]:
            axis.legend(frameon=False, fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2,
                        columnspacing=1.0)  # fmt: skip
        else:
            say_empty(axis, "no such reading")
    if smooth:
        mark_order(axes[0], (3, 2, 1))
    return figure


def _name(scheme: str, reading: str) -> str:
    inner = "" if reading == EXTRAPOLATED else " " + reading.removeprefix("printed(").removesuffix(")")
    return short(scheme) + inner


def _printed(reading: str) -> dict[str, Any]:
    """Hollow, with dashes and marker of the misprint, the same in every panel."""
    i = MISPRINTS.index(reading.removeprefix("printed(").removesuffix(")"))
    return {"mfc": "white", "linestyle": dashed(1 + i), "marker": MARKERS[i % len(MARKERS)]}


def _errors(axis: Axes, found: dict[tuple[str, str, str], list[Row]]) -> None:
    for i, ((scheme, reading, _), own) in enumerate(found.items()):
        style = dict(look(scheme), ms=4.5, lw=1.1)
        dt = column(own, "dt")
        if scheme not in {key[0] for key in list(found)[:i]}:
            axis.plot(dt, column(own, "error"), label=f"{short(scheme)}, right", **dict(style, linestyle="-"))
        axis.plot(dt, column(own, "error_printed"), label=_name(scheme, reading), **style | _printed(reading))
    axis.set_ylabel("tip error, rms, relative")


def _factors(
    axis: Axes, found: dict[tuple[str, str, str], list[Row]], refused: dict[tuple[str, str, str], int]
) -> None:
    for (scheme, reading, kind), own in found.items():
        style = dict(look(scheme), ms=4.5, lw=1.1)
        if reading != EXTRAPOLATED:
            style |= _printed(reading)
        missing = refused.get((scheme, reading, kind), 0)
        text = _name(scheme, reading) + (f" ({missing} steps left out)" if missing else "")
        axis.plot(column(own, "dt"), column(own, "error_printed") / column(own, "error"), label=text, **style)
    for (scheme, reading, kind), missing in refused.items():
        same = found and (kind, reading == EXTRAPOLATED) in {(key[2], key[1] == EXTRAPOLATED) for key in found}
        if same and (scheme, reading, kind) not in found:
            axis.plot(
                [], [], "x", color=look(scheme)["color"], label=f"{_name(scheme, reading)}: all {missing} left out"
            )
    axis.axhline(1.0, color="0.3", lw=0.9, ls=":")
    axis.set_ylabel("times the error")


STUDY = Study(
    name="errata",
    question="What does each misprint that runs cost, and what does the paper's linearised contact?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    needs_motion=True,
    smoke={"schemes": ["hht(alpha=-0.1)"], "halvings": 3, "impacts": 2},
)
