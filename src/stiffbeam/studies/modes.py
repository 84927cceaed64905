"""Phase lag and dissipation mode by mode, measured on runs without contact and compared with theory."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from ..basics.arrays import Array
from ..basics.text import several
from ..figures.chart import Axis, Curve, Mark, Panel, Picture, column, groups, look, short
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.amplification import amplification, free_mode_errors
from ..measures.frequencies import without_contact
from ..model.modes import undamped_modes
from ..model.natural_modes import modes
from .common import Dt, Form, Schemes, extremes, scheme_labels, scheme_of, significant
from .interface import Answer, Point, Records, Row, Rows, declared


def points(
    case: Case,
    *,
    schemes: Schemes = None,
    form: Form,
    dt: Dt,
    steps: Annotated[int, "number of time steps of a run"] = 4000,
) -> list[Point]:
    """Every scheme runs ``steps`` time steps of ``dt`` (the case's) from initial data that excite every mode.

    Modes with fewer than two steps per period are left out, because their samples are aliased.
    """
    return [{"scheme": label, "form": form, "dt": dt, "steps": steps} for label in scheme_labels(case, schemes)]


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row for each mode with omega dt < pi: elongation and damping, measured and in theory."""
    system = replace(without_contact(case.system(point["form"])), loads=())
    basis, natural = undamped_modes(system), modes(system)
    if not np.any(natural.omega):
        return [{"refused": "no mode oscillates: without its stops the system has no stiffness"}]
    dt, scheme = point["dt"], scheme_of(point["scheme"])
    # Every mode starts with the same energy.
    amplitudes = np.where(basis.omega > 0.0, 1.0, 0.0) / np.where(basis.omega > 0.0, basis.omega, 1.0)
    system = replace(system, q0=basis.to_nodal(amplitudes), v0=np.zeros(system.size))
    errors = free_mode_errors(integrate(system, scheme, dt, point["steps"] * dt))
    rows = []
    for j, omega in enumerate(natural.omega):
        if omega == 0.0 or omega * dt >= np.pi:
            continue
        xi = float(natural.damping_ratio[j])
        if xi >= 1.0:
            reason = "a mode with damping ratio 1 or more does not oscillate: it has no period to be late by"
            rows.append({"mode": j + 1, "omega": float(omega), "refused": reason})
            continue
        theory = amplification(scheme, omega * dt / (2.0 * np.pi), xi)
        row = {"mode": j + 1, "omega": float(omega), "dt_over_period": float(omega * dt / (2.0 * np.pi))}
        for name, error in (("period_elongation", "elongation_error"), ("damping_ratio", "damping_error")):
            row |= {
                name: float(getattr(errors, name)[j]),
                f"{name}_error": float(getattr(errors, error)[j]),
                f"{name}_theory": float(getattr(theory, name)[0]),
            }
        rows.append(row)
    return rows


def answer(rows: Rows, _: Case) -> Answer:
    """Lag and damping of the first mode of each scheme, and the largest distance of all modes from theory."""
    measured = [r for r in rows if np.isfinite(r["period_elongation"])]
    if not measured:
        return Answer(
            "No mode is measured: each dies too soon, or is followed for less than half a period. Take more steps."
        )
    first = {scheme: group[0] for scheme, group in groups(measured, "scheme").items()}
    texts = {
        "period_elongation": ("late", lambda value: f"{significant(100.0 * value, '.2g')} %"),
        "damping_ratio": ("damping ratio", lambda value: significant(value, ".1e")),
    }
    table = [
        {f"mode {row['mode']}": scheme} | {words: text(row[name]) for name, (words, text) in texts.items()}
        for scheme, row in first.items()
    ]
    late, damped = (
        extremes({scheme: row[name] for scheme, row in first.items()}, text) for name, (_, text) in texts.items()
    )
    period, damping = (np.max(np.nan_to_num(_distances(measured, name))) for name, *_ in QUANTITIES)
    left = len(rows) - len(measured)
    return Answer(
        f"Mode {measured[0]['mode']} is late by {late}, with a damping ratio of {damped}. In all modes runs differ "
        f"from theory by at most {period:.1g} in the period and {damping:.1g} in the damping ratio.",
        table,
        f"Not measured: {several(left, 'mode')}, damped out too soon or followed for less than half a period."
        if left
        else "",
    )


QUANTITIES = (  # with the size below which the axis is linear
    ("period_elongation", "relative period elongation", 1e-11),
    ("damping_ratio", "damping ratio", 1e-10),
)


def _distances(rows: Rows, name: str) -> Array:
    """|measured - theory| of every row, a value of rounding where they are equal."""
    return np.maximum(np.abs(column(rows, name) - column(rows, f"{name}_theory")), np.finfo(float).eps)


def picture(records: Records) -> Picture:
    """Above: lines are theory, markers runs. Below: their distance."""
    upper, lower = [], []
    for name, words, threshold in QUANTITIES:
        above: list[Mark] = []
        below: list[Mark] = []
        for label, group in groups(records.numbers, "scheme").items():
            group.sort(key=lambda row: row["dt_over_period"])
            x, style = column(group, "dt_over_period"), look(label)
            dots = style | {"linestyle": ""}
            above += [Curve(x, column(group, f"{name}_theory"), short(label), style | {"marker": ""}),
                      Curve(x, column(group, name), short(label), dots)]  # fmt: skip
            below.append(Curve(x, _distances(group, name), short(label), dots | {"ms": 3.5}))
        x_axis = Axis(r"$\Delta t/T$ of the mode", scale="log")
        upper.append(Panel(f"{words}: markers runs, lines theory", x_axis,
                           Axis(words, scale="signed log", threshold=threshold), above))  # fmt: skip
        lower.append(Panel("distance of runs from theory", x_axis, Axis("|run - theory|", scale="log"), below))
    return Picture([upper, lower], 7.6, heights=(2.0, 1.0), shared_x=True)


STUDY = declared(
    __name__,
    "How late and how damped is each mode of a run without contact, and does theory predict that?",
    smoke={"schemes": ["BDF2", "HHT(alpha=-0.1)"], "steps": 400},
)
