"""The beam between stops from soft to rigid: limit of compliant stops, scheme by scheme, compared with rigid ones.

The span is a tenth of the beam's first period from the first touch on, for Table 10 0.01 time units. The tip bounces in
a way that depends on the mesh: the number of impacts converges neither with the mesh nor with kappa. Comparable are the
impulse, int |sigma| dt, the time in contact, and the energy lost. Beyond kappa = K_bb, the stiffness of the grid behind
its contact node, a stop's stiffness changes only the bouncing of one node.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from ..basics.validation import positive
from ..figures.chart import COLOURS, Axis, Curve, Mark, Panel, Picture, Ranges, column, groups, look, short
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.report import percent
from ..model.problem import BeamProblem
from ..model.semidiscretisation import semidiscretise
from ..references import solve
from ..references.exact.rigid_reference import solve_rigid
from ..trajectory.trajectory import Trajectory
from .common import Cells, Dt, extremes, label_of, scheme_of, tip_stops
from .first_impact import flight
from .interface import Answer, Point, Records, Row, Rows, declared

EXACT, CONSERVING = "exact", "Trapezoidal conserving"
COMPLIANT = (EXACT, CONSERVING, "Trapezoidal", "HHT(alpha=-0.1)", "BDF2", "SDIRK")
NODE = "node with mass"
# What is asked at kappa = inf: method, node, restitution.
RIGID: tuple[tuple[str, str, float | None], ...] = (
    (EXACT, NODE, 0.0), (EXACT, NODE, 1.0),
    ("Trapezoidal", NODE, None), ("HHT(alpha=-0.1)", NODE, None), ("BDF2", NODE, None), ("SDIRK", NODE, None),
    ("MoreauJean", NODE, 0.0), ("MoreauJean", NODE, 1.0), ("PaoliSchatzman", NODE, 0.0),
    ("NonsmoothGeneralisedAlpha(rho=0.8)", NODE, 0.0), ("ContactStabilisedNewmark", NODE, None),
)  # fmt: skip
# For the beam of Table 10, others by ``units_of``: stiffnesses of the stops, and the span after the first touch.
KAPPAS, WINDOW, CURVATURE = (1e5, 3e5, 1e6, 5e6, 2e7, 1e8, 1e9), 0.01, 300.0
NEARBY = (-0.02, -0.01, 0.01, 0.02)  # shares by which further runs have more steps: what these change is chance
RANGED = ("impulse", "impacts", "lost")


def points(
    case: Case,
    *,
    kappas: Annotated[list[float] | None, "stiffnesses of the stops, comma-separated"] = None,
    cells: Cells = None,
    dt: Dt,
    divide: Annotated[list[int] | None, "divisors of dt, comma-separated; default: 1,10"] = None,
) -> list[Point]:
    """Every method at every stiffness of the stops, ``kappas``, and on rigid stops, all to the same time.

    By default on the cells of the case and on twice as many, and with stiffnesses from 333 EI/L^3 to 3.3e6 EI/L^3.
    """
    tip_stops(case)
    time, force = units_of(case.problem)
    scaled = [kappa * force for kappa in KAPPAS]
    values = scaled if kappas is None else [positive("kappas", kappa) for kappa in kappas]
    plan: list[Point] = []
    for number in cells or [case.cells, 2 * case.cells]:
        touch, _ = flight(semidiscretise(case.problem, number))
        end = dt * np.ceil((touch + WINDOW * time) / dt)
        asked = [(method, NODE, None, float(kappa)) for kappa in values for method in COMPLIANT]
        asked += [(*entry, None) for entry in RIGID]
        for method, node, e, kappa in asked:
            shared = {"node": node, "restitution": e, "kappa": kappa, "cells": int(number), "t_end": float(end)}
            label = method if method in (EXACT, CONSERVING) else label_of(method)
            steps = [0.0] if method == EXACT else [dt / part for part in divide or [1, 10]]
            plan += [{"method": label, "dt": step} | shared for step in steps]
    return plan


def units_of(problem: BeamProblem) -> tuple[float, float]:
    """Time and stiffness of a stop by which the motion of a beam is that of Table 10's, both 1 for that beam."""
    share = CURVATURE / problem.stiffness
    return float(problem.length**2 * np.sqrt(share * problem.mass_per_length)), 1.0 / (share * problem.length**3)


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row: impulse, time in contact, impacts and loss of one method at one stiffness."""
    kappa = np.inf if point["kappa"] is None else point["kappa"]
    stops = replace(case.problem.all_stops[0], stiffness=kappa, restitution=point["restitution"])
    system = semidiscretise(replace(case.problem, stops=stops), point["cells"])
    end, method = point["t_end"], point["method"]
    if method == EXACT:
        ends = np.array([0.0, end])
        rigid = system.rigid
        run = solve_rigid(system, end, ends, trusted=False) if rigid else solve(system, end, EXACT, ends, 0.0, None)
        return [_with_ranges([_figures(run, end)])]
    scheme = scheme_of(method.removesuffix(" conserving"))
    treatment = "conserving" if method == CONSERVING else "implicit"
    steps = round(end / point["dt"])
    asked = [steps, *(max(1, round((1.0 + share) * steps)) for share in NEARBY)]
    return [_with_ranges([_figures(integrate(system, scheme, end / n, end, treatment, every=n), end) for n in asked])]


def _with_ranges(rows: list[Row]) -> Row:
    """The first of some runs, with the least and the largest value of each quantity over all of them."""
    ends = (("low", min), ("high", max))
    return rows[0] | {f"{name}_{word}": pick(row[name] for row in rows) for name in RANGED for word, pick in ends}


def _figures(run: Trajectory, end: float) -> Row:
    """Impulse, time in contact, impacts and energy lost of a run in [0, end]."""
    record, energy = run.contacts[0], run.energy
    most = float(energy.supplied[-1])
    return {
        "impulse": record.impulse,
        "contact_time": record.fraction * end,
        "impacts": record.impacts.count,
        "lost": float((energy.loss[-1] + energy.stop_dissipation[-1]) / most)
        if most > 0.0 and energy.is_resolved()
        else float("nan"),
    }


def _ranged(row: Row, name: str, written: Callable[[float], str]) -> str:
    """A figure of a run, or the range of it where steps nearby give others."""
    low, high = (written(row[f"{name}_{word}"]) for word in ("low", "high"))
    return written(row[name]) if low == high or "nan" in (low, high) else f"{low} to {high}"


def name_of(row: Row) -> str:
    """Method and node in words."""
    e = row["restitution"]
    law = "" if e is None or np.isnan(e) else f", e = {e:g}"
    return f"{row['method']}{law}"


def _stiff(row: Row) -> float:
    kappa = row["kappa"]
    return np.inf if kappa is None or np.isnan(kappa) else float(kappa)


def answer(rows: Rows, case: Case) -> Answer:
    """Impulse of the exact motion at every stiffness; impulse, impacts and loss of all at rigid stops."""
    units, table = case.units, []
    finest = min((row["dt"] for row in rows if row["dt"]), default=0.0)
    impulses: dict[str, float] = {}
    for cells, group in sorted(groups(rows, "cells").items()):
        soft = [r for r in group if r["method"] == EXACT and r["node"] == NODE and _stiff(r) < np.inf]
        rigid = [row for row in group if _stiff(row) == np.inf and row["dt"] in (0.0, finest)]
        impulses |= {f"{name_of(row)}, {cells} cells": row["impulse"] for row in rigid}
        table += [
            {
                "motion": name_of(row),
                units.label("kappa", "stop stiffness"): f"{_stiff(row):.2g}",
                "cells": f"{cells}",
                units.label("impulse", "impulse"): _ranged(row, "impulse", "{:.3g}".format),
                "impacts": _ranged(row, "impacts", "{:g}".format),
                "lost": _ranged(row, "lost", percent),
            }
            for row in [*sorted(soft, key=_stiff), *rigid]
        ]
    impulse = extremes(impulses, lambda value: units.measure(value, "impulse", ".3g"))
    window, step = (units.measure(x, "time", ".2g") for x in (WINDOW * units_of(case.problem)[0], finest))
    return Answer(
        f"Within {window} of the first touch a rigid stop gives an impulse of {impulse}.",
        table,
        f"Schemes at dt = {step}, with the range over steps within 2 % of it.",
    )


PANELS = (
    ("impulse", "impulse", "impulse"),
    ("contact_time", "time in contact", "time"),
    ("impacts", "impacts", ""),
    ("lost", "energy lost, share", ""),
)


def picture(records: Records) -> Picture:
    """Above: the finest step over the stiffness of the stops. Below: rigid stops, a line for each method.

    Schemes on the case's grid, exact motions on all; thin lines: the range over steps near the finest.
    """
    rows = sorted(records.numbers, key=_stiff)
    coarse, finest = min(row["cells"] for row in rows), min((row["dt"] for row in rows if row["dt"]), default=0.0)
    names = list(dict.fromkeys(name_of(row) for row in records.numbers if _stiff(row) == np.inf))
    shown = [row for row in rows if row["cells"] == coarse or row["method"] == EXACT]
    soft = [row for row in shown if _stiff(row) < np.inf and row["dt"] in (0.0, finest)]
    hard = [row for row in shown if _stiff(row) == np.inf]
    upper, lower = [], []
    for name, words, quantity in PANELS:
        lines: list[Mark] = []
        for (method, grid), group in groups(soft, "method", "cells").items():
            style = _look(method) | ({} if grid == coarse else {"linestyle": "--", "ms": 3.5})
            label = short(method) + ("" if grid == coarse else f", {grid} cells")
            lines.append(Curve([_stiff(row) for row in group], column(group, name), label, style))
        dots: list[Mark] = []
        for (grid, step), group in groups(hard, "cells", "dt").items():
            at = np.array([names.index(name_of(row)) for row in group], float)
            style = _look(EXACT) if not step else {"color": COLOURS[0], "marker": "o"}
            style |= {"linestyle": "", "mfc": style["color"] if step in (0.0, finest) else "white"}
            label = (
                "exact" if not step else "schemes, finest time step" if step == finest else "schemes, case's time step"
            )
            label, size = (label, 5.5) if grid == coarse else (f"{label}, {grid} cells", 3.5)
            dots.append(Curve(column(group, name), at, label, style | {"ms": size}))
            if name in RANGED and step == finest:
                low, high = (column(group, f"{name}_{word}") for word in ("low", "high"))
                dots.append(Ranges(at, low, high, look={"color": COLOURS[0], "lw": 1.2}))
        up, title = Axis(words, quantity, "log" if name == "impacts" else "linear"), words.partition(",")[0]
        upper.append(Panel(title, Axis("stop stiffness κ", "stop stiffness", "log"), up, lines))
        lower.append(Panel("on rigid stops", Axis(words, quantity), Axis(names=names), dots))
    return Picture([upper, lower], 9.0, 4)


def _look(method: str) -> dict[str, Any]:
    """The look of a method: that of its scheme, with a square for contact that conserves."""
    return look(method.removesuffix(" conserving")) | ({"marker": "s"} if method == CONSERVING else {})


STUDY = declared(
    __name__,
    "From soft to rigid stops: how do the schemes change impulse, contact and energy of a beam?",
    needs_motion=True,
    needs_stops=True,
    smoke={"kappas": [1e6], "cells": [6], "divide": [1]},
)
