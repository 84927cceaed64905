"""What each misprint that runs costs: its error beside the corrected scheme's, smooth and through contact."""

from __future__ import annotations

import numpy as np

from ..cases import Case
from ..march.integrate import integrate
from ..measures.regression import observed_order
from ..schemes.errata import forms_of
from ..validation import integer
from .common import first_impacts, scheme_labels, scheme_of, smooth, solve_once, system_of
from .converge import ROUNDING
from .study import Point, Row, Rows, Study

SAMPLES = 1000
COARSER = 16  # times dt to start from without contact, where smaller steps soon reach rounding


def points(
    case: Case,
    schemes: list[str] | None = None,
    form: str = "displacement",
    dt: float | None = None,
    halvings: int = 10,
    impacts: int = 4,
) -> list[Point]:
    """Every erratum of the case's schemes, and the paper's extrapolated contact, at steps from ``dt`` downwards."""
    integer("halvings", halvings, 1)
    start = case.dt if dt is None else dt
    window = first_impacts(case, form, impacts) if case.problem.stops is not None else 0.0
    found: list[Point] = []
    for label in scheme_labels(case, schemes):
        readings = [(f"printed({name})", "implicit") for name in forms_of(scheme_of(label))]
        if window:
            readings.append(("extrapolated contact", "extrapolated"))
        for reading, contact in readings:
            for kind in ("smooth", "contact") if window else ("smooth",):
                if kind == "smooth" and contact == "extrapolated":
                    continue  # there is none to extrapolate
                end, first = (window, start) if kind == "contact" else (first_period(case), COARSER * start)
                found += [
                    {"scheme": label, "reading": reading, "kind": kind, "form": form, "t_end": end,
                     "steps": max(4, round(end / first * 2.0**k))}
                    for k in range(halvings)
                ]  # fmt: skip
    return found


def first_period(case: Case) -> float:
    """A period of the base or of the first load, or a tenth of the span where nothing is harmonic."""
    functions = [case.problem.base, *(load.time for load in case.problem.loads)]
    frequencies = [f for f in (getattr(function, "frequency", 0.0) for function in functions) if f]
    return 2.0 * np.pi / frequencies[0] if frequencies else 0.1 * case.t_end


def evaluate(case: Case, point: Point) -> list[Row]:
    system = system_of(case, point["form"])
    if point["kind"] == "smooth":
        system = smooth(system)
    exact = solve_once(system, point["t_end"])
    scheme = scheme_of(point["scheme"])
    right = _error(system, scheme, point, exact, "implicit")
    row: Row = {"dt": point["t_end"] / point["steps"], "error": right}
    if point["reading"] == "extrapolated contact":
        return [row | {"error_printed": _error(system, scheme, point, exact, "extrapolated")}]
    name = point["reading"].removeprefix("printed(").removesuffix(")")
    return [row | {"error_printed": _error(system, scheme.printed(name), point, exact, "implicit")}]


def _error(system, scheme, point: Point, exact, contact: str) -> float:
    """The rms tip error over the span, relative to the largest displacement."""
    steps, end = point["steps"], point["t_end"]
    run = integrate(system, scheme, end / steps, end, contact, every=max(1, steps // SAMPLES))
    u, _ = exact.at(run.t)
    return float(np.sqrt(np.mean((run.tip - u) ** 2)) / np.max(np.abs(u)))


def groups(rows: Rows) -> dict[tuple[str, str, str], list[Row]]:
    """The rows by (scheme, reading, kind)."""
    keys = dict.fromkeys((r["scheme"], r["reading"], r["kind"]) for r in rows)
    return {key: [r for r in rows if (r["scheme"], r["reading"], r["kind"]) == key] for key in keys}


def answer(rows: Rows) -> str:
    parts = []
    for (scheme, reading, kind), own in groups(rows).items():
        first, last = own[0], own[-1]
        counted = [r for r in own if r["error"] > ROUNDING * r["steps"]]
        right = observed_order([r["dt"] for r in counted], [r["error"] for r in counted])
        printed = observed_order([r["dt"] for r in counted], [r["error_printed"] for r in counted])
        parts.append(
            f"{scheme} {reading}, {kind}: {first['error_printed'] / first['error']:.3g} times the error at "
            f"dt = {first['dt']:.2g} and {last['error_printed'] / last['error']:.3g} times at {last['dt']:.2g}"
            + (f", order {printed.slope:.2f} for {right.slope:.2f}" if kind == "smooth" else "")
        )
    return "; ".join(parts) + "."


STUDY = Study(
    name="errata",
    question="What does each misprint that runs cost, and what does the paper's linearised contact?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"schemes": ["hht(alpha=-0.1)"], "halvings": 3, "impacts": 2},
)
