"""Value and derivative of every scheme against the exact ones, and the orders of both.

    y(x) = tip at the end of the window from the start x,   dy = y'(x) d

The direction d is a change of all velocities along the slowest mode. The exact derivative is that of the flow
(``reference.derivative``). A scheme's derivative is that of its map, by a central difference of width 1e-7 of the
motion. Automatic differentiation of its steps gives the same, except where two of these runs differ in contact. Errors
are root mean squares over several starts, relative to the exact values. Implicit contact has a slope of 0 or of the
stop's for a whole step. The slopes of averaged and of conserving contact are the share of the step in contact, and so
the derivative keeps the order of the value.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from ..basics.arrays import Array
from ..basics.resources import afford
from ..basics.validation import InputError
from ..figures.chart import Axis, Panel, Picture, curves, groups, short
from ..files.cases import Case
from ..march.choice import takes_contact
from ..march.integrate import integrate
from ..model.modes import undamped_modes
from ..model.system import System
from ..references import reference, takes
from ..trajectory.trajectory import SolverFailure
from . import common
from .interface import Answer, Point, Records, Row, Rows, declared

WIDTH = 1e-7  # of the starts' velocities: differences are of rounding below, of the next impact above
SPREAD = 0.1  # of the largest velocity: the starts
CONTACTS = ("averaged", "conserving")  # after a method's label, implicit contact without
SETTLED = 0.5  # relative error of a value or derivative below which its order is observed
FLOOR = 2e-6  # relative error below which rounding of differences shows
FINEST = 5  # steps at most from which an order is observed


def points(
    case: Case,
    *,
    schemes: common.Schemes = None,
    form: common.Form,
    dt: common.Dt,
    halvings: common.Halvings = 9,
    impacts: common.ImpactCount = 4,
    starts: Annotated[int, "number of starts near that of the case"] = 16,
) -> list[Point]:
    """Every scheme at ``dt`` (the case's), dt/2, ..., until the first ``impacts`` impacts are over.

    Schemes that accept averaged or conserving contact run with these too."""
    system = case.system(form)
    if not takes("exact", system, case.t_end):
        rule = "have an exact solution: linear stops, and functions of time in closed form"
        remedy = "take stops without exponent and dissipation, and Harmonic, Constant or cubic Sampled functions"
        raise InputError("case", case.name, rule, remedy)
    end = common.first_impacts(case, form, impacts)
    afford("starts", starts, "take fewer", seconds=6e-8 * starts * end / dt * 2.0**halvings * system.size)
    labels = common.scheme_labels(case, schemes)
    others = [
        f"{label} {contact}"
        for contact in CONTACTS
        for label in labels
        if common.takes_extrapolation(case) and takes_contact(common.scheme_of(label), contact)
    ]
    return [
        {"method": label, "dt": end / steps, "form": form, "t_end": end, "starts": starts}
        for label in [*labels, *others]
        for steps in common.halved(end, dt, halvings)
    ]


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row: relative errors of value and derivative, rms over the starts."""
    system, end = case.system(point["form"]), point["t_end"]
    direction = undamped_modes(system).shapes[:, 0]
    direction = direction / np.max(np.abs(direction))
    moved, size = starts_of(system, end, point["starts"], direction)
    exact, slopes = exact_values(system, end, moved, direction)
    label, contact = parted(point["method"])
    scheme, steps = common.scheme_of(label), round(end / point["dt"])

    def tip(velocity: Array) -> float:
        run = integrate(replace(system, v0=velocity), scheme, end / steps, end, contact=contact, every=steps)
        return float(run.tip[-1])

    h = WIDTH * size
    values = np.array([tip(v) for v in moved])
    derived = np.array([(tip(v + h * direction) - tip(v - h * direction)) / (2.0 * h) for v in moved])
    return [{"value_error": relative(values, exact), "derivative_error": relative(derived, slopes)}]


def relative(values: Array, exact: Array) -> float:
    """Root mean square of values - exact over that of the exact values, of those that are known."""
    known = np.isfinite(exact)
    return float(np.sqrt(np.mean((values - exact)[known] ** 2) / np.mean(exact[known] ** 2)))


def starts_of(system: System, end: float, count: int, direction: Array) -> tuple[list[Array], float]:
    """Initial velocities (count of (n,)), and the largest velocity of the motion."""
    size = float(np.max(np.abs(reference(system, end, t_eval=np.linspace(0.0, end, 101)).states[1])))
    shifts = np.random.default_rng(1).uniform(-1.0, 1.0, count)
    return [system.v0 + SPREAD * size * x * direction for x in shifts], size


def exact_values(system: System, end: float, velocities: list[Array], direction: Array) -> tuple[Array, Array]:
    """Tip at the end from every start and its derivative in the direction; NaN where there is none."""
    key = (system.fingerprint, end, len(velocities))
    if key not in _EXACT:
        values, slopes = np.full((2, len(velocities)), np.nan)
        for k, velocity in enumerate(velocities):
            try:
                exact = reference(replace(system, v0=velocity), end, t_eval=np.array([0.0, end]))
            except SolverFailure:
                continue
            values[k] = exact.tip[-1]
            slopes[k] = exact.derivative(["initial_velocity"]).tip[-1] @ direction
        if not np.any(np.isfinite(slopes)):
            raise SolverFailure(
                "exact", end, "no start has a derivative at the end of the window", "take fewer impacts"
            )
        # Only the last window is kept: the points of a study share it.
        _EXACT.clear()
        _EXACT[key] = np.where(np.isfinite(slopes), values, np.nan), slopes
    return _EXACT[key]


_EXACT: dict[tuple[str, float, int], tuple[Array, Array]] = {}


def answer(rows: Rows, case: Case) -> Answer:
    """Orders of value and derivative side by side, and both errors at the case's step and at the finest."""
    table: list[dict[str, str]] = []
    orders: dict[str, dict[str, float]] = {"value": {}, "derivative": {}}
    finest = min(row["dt"] for row in rows)
    for method, group in groups(rows, "method").items():
        group.sort(key=lambda row: -row["dt"])
        line = {"method": named(method)}
        for what in orders:
            settled = tail([row for row in group if row[f"{what}_error"] > FLOOR], f"{what}_error")
            order = common.order_over(settled, lambda row: row["dt"], f"{what}_error")
            line[f"order of the {what}"] = str(order) if np.isfinite(order.slope) else "not settled"
            if np.isfinite(order.slope) and not order.unclear:
                orders[what][method] = order.slope
        for what in orders:
            line[f"{what} off by"] = f"{group[0][f'{what}_error']:.2g}"
        for what in orders:
            line[f"{what}, finest"] = f"{group[-1][f'{what}_error']:.2g}"
        table.append(line)
    ranges = {what: common.extremes(order_of, lambda x: f"{x:.2f}") for what, order_of in orders.items()}
    verdict = f"Order of the value: {ranges['value']}; of its derivative: {ranges['derivative']}."
    starts = rows[0]["starts"]
    step = case.units.measure(finest, "time", ".2g")
    notes = (
        f"Errors relative to the exact values, rms over {starts} starts. Orders with 95 % intervals, over the {FINEST} "
        f"finest steps as far as errors are between {FLOOR:g} and {SETTLED:g}. Finest step {step}."
    )
    return Answer(verdict, table, notes)


def tail(rows: list[Row], error: str) -> list[Row]:
    """The finest of rows from coarse to fine, as far as their errors are settled."""
    rough = [k for k, row in enumerate(rows) if not row[error] < SETTLED]
    return rows[max([k + 1 for k in rough] + [len(rows) - FINEST, 0]) :]


def named(method: str) -> str:
    """Short name of a method and its contact."""
    label, contact = parted(method)
    return short(label) + ("" if contact == "implicit" else f" {contact}")


def parted(method: str) -> tuple[str, str]:
    """Label of the scheme of a method, and its contact."""
    label, _, contact = method.rpartition(" ")
    return (label, contact) if contact in CONTACTS else (method, "implicit")


def picture(records: Records) -> Picture:
    """Errors of value and derivative over the step; a row of panels for every contact."""
    lines = []
    for contact in ("implicit", *CONTACTS):
        title = "" if contact == "implicit" else f", {contact} contact"
        rows = [row | {"method": parted(row["method"])[0]} for row in records.numbers
                if parted(row["method"])[1] == contact]  # fmt: skip
        rows.sort(key=lambda row: row["dt"])
        panels = [
            Panel(f"{what}{title}", common.STEP, Axis(f"relative error of the {what}, rms", scale="log"),
                  curves(rows, "dt", f"{what}_error", "method"))
            for what in ("value", "derivative")
        ]  # fmt: skip
        lines += [panels] if rows else []
    return Picture(lines, 5.2 * len(lines), 5)


STUDY = declared(
    __name__,
    "How accurate are the value and the derivative of each scheme?",
    needs_motion=True,
    needs_stops=True,
    smoke={"schemes": ["trapezoidal"], "halvings": 3, "impacts": 2, "starts": 2},
)
