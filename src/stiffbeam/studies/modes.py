"""Phase lag and dissipation mode by mode, measured on runs without contact and compared with theory."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from ..figures import column, log_scale, look, new_figure, numeric, say_empty, shared_legend, short, signed_log
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.amplification import amplification, free_mode_errors
from ..measures.smooth_motion import without_contact
from ..model.modes import undamped_modes
from ..model.natural_modes import modes
from .common import Dt, Form, Schemes, scheme_labels, scheme_of, system_of
from .engine.study import Answer, Point, Records, Row, Rows, Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def points(
    case: Case,
    schemes: Schemes = None,
    form: Form = "displacement",
    dt: Dt = None,
    steps: Annotated[int, "length of the runs"] = 4000,
) -> list[Point]:
    """One point a scheme: ``steps`` steps of ``dt`` (the case's) from initial data that excite every mode.

    Modes of fewer than two steps a period are left out: a rotation by more than half a turn per step looks like one
    backwards.
    """
    dt = case.dt if dt is None else dt
    return [{"scheme": label, "form": form, "dt": dt, "steps": steps} for label in scheme_labels(case, schemes)]


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row for each mode with omega dt < pi: elongation and damping, measured and in theory."""
    system = replace(without_contact(system_of(case, point["form"])), loads=())
    basis, natural = undamped_modes(system), modes(system)
    if not np.any(natural.omega):
        return [{"refused": "no mode oscillates: without its stops the system has no stiffness"}]
    dt, scheme = point["dt"], scheme_of(point["scheme"])
    # Every mode starts with the same energy.
    amplitudes = np.where(basis.omega > 0.0, 1.0, 0.0) / np.where(basis.omega > 0.0, basis.omega, 1.0)
    system = replace(system, q0=basis.to_nodal(amplitudes), v0=np.zeros(system.size))
    found = free_mode_errors(integrate(system, scheme, dt, point["steps"] * dt))
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
        rows.append(
            {
                "mode": j + 1,
                "omega": float(omega),
                "dt_over_period": float(omega * dt / (2.0 * np.pi)),
                "period_elongation": float(found.period_elongation[j]),
                "period_elongation_error": float(found.elongation_error[j]),
                "period_elongation_theory": float(theory.period_elongation[0]),
                "damping_ratio": float(found.damping_ratio[j]),
                "damping_ratio_error": float(found.damping_error[j]),
                "damping_ratio_theory": float(theory.damping_ratio[0]),
            }
        )
    return rows


def answer(rows: Rows, _: Case) -> str:
    """How many of the measured values agree with theory, and lag and damping of the first mode of each scheme."""
    measured = [r for r in rows if np.isfinite(r["period_elongation"])]
    inside = [
        abs(r[name] - r[f"{name}_theory"]) <= r[f"{name}_error"] + 1e-10
        for r in measured
        for name in ("period_elongation", "damping_ratio")
    ]
    if not measured:
        return "No mode is told of: each dies too soon, or is followed for less than half a period. Take more steps."
    parts, table = [], []
    for scheme in dict.fromkeys(r["scheme"] for r in measured):
        own = [r for r in measured if r["scheme"] == scheme]
        late, damped, mode = 100 * own[0]["period_elongation"], own[0]["damping_ratio"], own[0]["mode"]
        parts.append(f"{scheme} {late:.2g} % late and damped by {damped:.1e} in mode {mode}")
        table.append({f"mode {mode}": scheme, "late": f"{late:.2g} %", "damping ratio": f"{damped:.1e}"})
    head = (
        f"{sum(inside)} of {len(inside)} measured elongations and damping ratios lie within the fit's error of theory"
    )
    if len(measured) < len(rows):
        untold = f"{len(rows) - len(measured)} modes are not told of"
        head += f"; {untold}, which die too soon or are followed for less than half a period"
    return Answer(f"{head}; {'; '.join(parts)}.", table, f"{head}.")


QUANTITIES = (  # with the size below which the axis is linear
    ("period_elongation", "relative period elongation", 1e-11),
    ("damping_ratio", "damping ratio", 1e-10),
)
SAME = 1e-10  # an absolute difference that is rounding, not the fit


def draw(records: Records) -> Figure:
    """Above: lines are theory, markers the fit to a run with its error. Below: their distance in errors."""
    rows = numeric(records.found)
    figure = new_figure(
        7.6, f"{records.case.name} without contact, mode by mode: markers fitted to a run, lines are theory"
    )
    axes = figure.subplots(2, 2, sharex=True, height_ratios=(2.4, 1.0))
    for (upper, lower), (name, words, threshold), letter in zip(axes.T, QUANTITIES, "ab", strict=True):
        for label in dict.fromkeys(row["scheme"] for row in rows):
            own = sorted((row for row in rows if row["scheme"] == label), key=lambda row: row["dt_over_period"])
            x, style = column(own, "dt_over_period"), look(label)
            measured, theory, error = (column(own, name + end) for end in ("", "_theory", "_error"))
            upper.plot(x, theory, lw=0.9, **style | {"marker": ""})
            upper.errorbar(x, measured, error, ms=4.5, capsize=2.5, elinewidth=0.8, lw=1.0, label=short(label),
                           **style | {"linestyle": ""})  # fmt: skip
            lower.plot(x, np.abs(measured - theory) / (error + SAME), ms=3.5, **style | {"linestyle": ""})
        log_scale(upper, y=False)
        log_scale(lower)
        upper.set(ylabel=words)
        upper.set_title(f"({letter}) {words}", loc="left")
        lower.axhline(1.0, color="0.3", lw=0.9, ls=":")
        lower.set(xlabel=r"$\Delta t/T$ of the mode", ylabel="distance from theory\nover the fit's error")
        lower.set_ylim(1e-4, 10.0)
        for axis in (upper, lower):
            axis.grid(color="0.92")
        if not rows:
            say_empty(upper)
        signed_log(upper, (column(rows, name), column(rows, f"{name}_theory")), threshold)
    shared_legend(figure, 4)
    return figure


STUDY = Study(
    name="modes",
    question="How late and how damped does each scheme make each mode of a beam without contact, and is that theory?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    smoke={"schemes": ["bdf2", "hht(alpha=-0.1)"], "steps": 400},
)
