"""The beam between stops from soft to rigid: what compliant stops tend to, scheme by scheme, beside rigid ones.

From the first touch on, over a hundredth of a time unit, in which the tip bounces as the mesh lets it: the number of
impacts converges neither with the mesh nor with kappa. What can be compared is the impulse, int |sigma| dt, the time in
contact, and the energy that is lost. Beyond kappa = K_bb, what the grid itself puts behind its contact node
(``System.massless_contacts``), a stop's stiffness changes the bouncing of one node and nothing of the beam.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..basics.validation import InputError, integer, positive
from ..figures import (
    column,
    heading,
    log_scale,
    look,
    new_figure,
    numeric,
    say_empty,
    shared_legend,
)
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.report import percent
from ..measures.smooth_motion import without_contact
from ..model.closed_form import natural_frequencies
from ..model.semidiscretisation import semidiscretise
from ..references import solve
from ..references.exact.rigid_reference import solve_rigid
from ..trajectory.trajectory import Trajectory
from .common import Dt, label_of, scheme_of
from .engine.study import Answer, Point, Records, Row, Rows, Study
from .first_impact import LOOK, first_crossing, look_span

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXACT, CONSERVING = "exact", "trapezoidal conserving"
COMPLIANT = (EXACT, CONSERVING, "trapezoidal", "hht(alpha=-0.1)", "bdf2", "sdirk")
MASSLESS, NODE = "massless node", "node with mass"
# What is asked at kappa = inf: method, node, restitution.
RIGID: tuple[tuple[str, str, float | None], ...] = (
    (EXACT, MASSLESS, None), (CONSERVING, MASSLESS, None), (EXACT, NODE, 0.0), (EXACT, NODE, 1.0),
    ("trapezoidal", NODE, None), ("hht(alpha=-0.1)", NODE, None), ("bdf2", NODE, None), ("sdirk", NODE, None),
    ("moreau-jean", NODE, 0.0), ("moreau-jean", NODE, 1.0), ("paoli-schatzman", NODE, 0.0),
    ("nonsmooth-alpha(rho=0.8)", NODE, 0.0), ("contact-stabilised", NODE, None),
)  # fmt: skip
KAPPAS = (1e5, 3e5, 1e6, 5e6, 2e7, 1e8, 1e9)
WINDOW = 0.01  # after the first touch
NEARBY = (-0.02, -0.01, 0.01, 0.02)  # shares by which further runs have more steps: what these change is chance
RANGED = ("impulse", "impacts", "lost")


def points(
    case: Case,
    kappas: Annotated[list[float] | None, "stiffnesses of the stops, with commas between them"] = None,
    cells: Annotated[list[int] | None, "grids; default: the case's and twice as many"] = None,
    dt: Dt = None,
    divide: Annotated[list[int] | None, "the step is dt and dt over these; default: 1,10"] = None,
) -> list[Point]:
    """Every method at every stiffness and at inf, to the same time, which every step divides."""
    if case.beam is None or len(case.problem.all_stops) != 1:
        raise InputError("case", case.name, "be a beam with stops at one place", "for example table10")
    stops = case.problem.all_stops[0]
    if stops.motion is not None or stops.position not in (None, case.problem.length):
        remedy = "move them to the tip and leave their motion out"
        raise InputError("case", case.name, "have stops at rest at the tip", remedy)
    natural_frequencies(case.problem, 1)
    dt = case.dt if dt is None else positive("dt", dt)
    values = KAPPAS if kappas is None else [positive("kappas", kappa) for kappa in kappas]
    parts = [integer("divide", part, 1) for part in divide or [1, 10]]
    found: list[Point] = []
    for number in cells or [case.cells, 2 * case.cells]:
        integer("cells", number, 2)
        end = dt * np.ceil((first_touch(case, number) + WINDOW) / dt)
        asked = [(method, NODE, None, float(kappa)) for kappa in values for method in COMPLIANT]
        asked += [(*entry, None) for entry in RIGID]
        for method, node, e, kappa in asked:
            rest = {"node": node, "restitution": e, "kappa": kappa, "cells": int(number), "t_end": float(end)}
            label = method if method in (EXACT, CONSERVING) else label_of(method)
            steps = [0.0] if method == EXACT else [dt / part for part in parts]
            found += [{"method": label, "dt": step} | rest for step in steps]
    return found


def first_touch(case: Case, cells: int) -> float:
    """When the tip first reaches a stop, whatever that is made of."""
    span = look_span(case.problem)
    free = solve(
        without_contact(semidiscretise(case.problem, cells)), span, EXACT, np.linspace(0.0, span, LOOK + 1), 0.0, None
    )
    stops = case.problem.all_stops[0]
    return first_crossing(lambda t: free.at(np.array([t]))[0][0], free.t, free.tip, stops.g1, stops.g2)


def evaluate(case: Case, point: Point) -> list[Row]:
    """What is found at one point."""
    kappa = np.inf if point["kappa"] is None else point["kappa"]
    stops = replace(case.problem.all_stops[0], stiffness=kappa, restitution=point["restitution"])
    system = semidiscretise(replace(case.problem, stops=stops), point["cells"])
    system = system.massless_contacts() if point["node"] == MASSLESS else system
    end, method = point["t_end"], point["method"]
    if method == EXACT:
        rigid = any(contact.stops.rigid for contact in system.contacts)
        ends = np.array([0.0, end])
        run = solve_rigid(system, end, ends, trusted=False) if rigid else solve(system, end, EXACT, ends, 0.0, None)
        return [_with_ranges([_found(run, end)])]
    scheme = scheme_of(method.removesuffix(" conserving"))
    treatment = "conserving" if method == CONSERVING else "implicit"
    steps = round(end / point["dt"])
    asked = [steps, *(max(1, round((1.0 + share) * steps)) for share in NEARBY)]
    return [_with_ranges([_found(integrate(system, scheme, end / n, end, treatment, every=n), end) for n in asked])]


def _with_ranges(found: list[Row]) -> Row:
    """The first of some runs, and the least and the most that any of them gives."""
    ends = (("low", min), ("high", max))
    return found[0] | {f"{name}_{word}": pick(row[name] for row in found) for name in RANGED for word, pick in ends}


def _found(run: Trajectory, end: float) -> Row:
    """What a run has done in [0, end]."""
    record, energy = run.contacts[0], run.energy
    most = float(energy.given[-1])
    return {
        "impulse": record.impulse,
        "contact_time": record.fraction * end,
        "impacts": record.impacts.count,
        "lost": float((energy.loss[-1] + energy.stop_dissipation[-1]) / most)
        if most > 0.0 and energy.sure()
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
    return f"{row['method']}{law}" + (f", {MASSLESS}" if row["node"] == MASSLESS else "")


def _stiff(row: Row) -> float:
    kappa = row["kappa"]
    return np.inf if kappa is None or np.isnan(kappa) else float(kappa)


def answer(rows: Rows, case: Case) -> str:
    """Impulse of the exact motion at every stiffness; impulse, impacts and loss of all at rigid stops."""
    found, units = numeric(rows), case.units
    sentences, table = [], []
    finest = min((row["dt"] for row in found if row["dt"]), default=0.0)
    step = f"dt = {units.measure(f'{finest:.2g}', 'time')}"
    for cells in sorted({row["cells"] for row in found}):
        own = [row for row in found if row["cells"] == cells]
        exact = {
            _stiff(row): row for row in own if row["method"] == EXACT and row["node"] == NODE and _stiff(row) < np.inf
        }
        rigid = [row for row in own if _stiff(row) == np.inf and row["dt"] in (0.0, finest)]
        soft = ", ".join(f"{r['impulse']:.3g} at {k:.2g}" for k, r in sorted(exact.items()))
        said = [
            f"{name_of(r)} {_ranged(r, 'impulse', '{:.3g}'.format)} in {_ranged(r, 'impacts', '{:g}'.format)} impacts, "
            f"{_ranged(r, 'lost', percent)} lost"
            for r in rigid
        ]
        head = f"On {cells} cells the impulse is {soft} exactly; at kappa = inf, dt = {finest:.2g}"
        sentences.append(f"{head}: {', '.join(said)}.")
        for kappa, row in [*sorted(exact.items()), *((np.inf, row) for row in rigid)]:
            table.append({
                "motion": name_of(row), units.label("kappa", "stop stiffness"): f"{kappa:.2g}", "cells": f"{cells}",
                units.label("impulse", "impulse"): _ranged(row, "impulse", "{:.3g}".format),
                "impacts": _ranged(row, "impacts", "{:g}".format), "lost": _ranged(row, "lost", percent),
            })  # fmt: skip
    return Answer(
        " ".join(sentences),
        table,
        f"Schemes at {step}, with the range over steps within 2 % of it." if sentences else "",
    )


PANELS = (
    ("impulse", "impulse", "impulse"),
    ("contact_time", "time in contact", "time"),
    ("impacts", "impacts", ""),
    ("lost", "energy lost, share", ""),
)
SMALL, LARGE = 3.0, 5.5  # marks of the finest grid and of the case's


def draw(records: Records) -> Figure:
    """Above: over the stiffness of the stops, the case's grid; below: rigid stops, an entry a line.

    Black: exact. Filled: the finest step, or none; hollow: the case's; lines: what steps near the finest give.
    Small: the finest grid, of exact motions only.
    """
    rows, units = numeric(records.found), records.case.units
    title = f"{WINDOW:g} after the first touch; above: compliant stops, below: rigid ones"
    figure = new_figure(8.4, heading(records.case, title))
    axes = figure.subplots(2, 4)
    grids = sorted({row["cells"] for row in rows})
    steps = sorted({row["dt"] for row in rows if row["dt"]}, reverse=True)
    rigid = [row for row in rows if _stiff(row) == np.inf]
    names = list(dict.fromkeys(name_of(row) for row in rigid))
    runs: dict[tuple[Any, ...], list[Row]] = {}
    for row in sorted(rows, key=_stiff):
        if row["cells"] == grids[0] or row["method"] == EXACT:
            runs.setdefault((row["method"], row["cells"], row["dt"]), []).append(row)
    for k, (key, words, quantity) in enumerate(PANELS):
        label = units.label(words, quantity) if quantity else words
        for (method, grid, step), own in runs.items():
            soft = [row for row in own if _stiff(row) < np.inf]
            whole, style = step in (0.0, *steps[-1:]), _mark(method, grid == grids[0])
            style |= {} if whole else {"mfc": "white"}
            name = method if whole and grid == grids[0] else None
            line = {"lw": 1.6 if method == EXACT else 0.9, "ls": "-" if whole else ":"}
            axes[0, k].plot([_stiff(row) for row in soft], column(soft, key), **style | line, label=name)
            hard = [row for row in own if _stiff(row) == np.inf]
            at = [names.index(name_of(row)) for row in hard]
            axes[1, k].plot(column(hard, key), at, **style, ls="")
            if key in RANGED and whole and method != EXACT:
                low, high = (column(hard, f"{key}_{word}") for word in ("low", "high"))
                axes[1, k].hlines(at, low, high, color=style["color"], lw=1.6, alpha=0.5)
        axes[0, k].set(xlabel=units.label("stiffness of the stops κ", "stop stiffness"), ylabel=label)
        axes[1, k].set(xlabel=label)
        if k:
            axes[1, k].sharey(axes[1, 0])
            axes[1, k].tick_params(labelleft=False)
        for axis, letter in zip(axes[:, k], ("abcd"[k], "efgh"[k]), strict=True):
            axis.set_title(f"({letter}) {words}", loc="left", fontsize=10)
            axis.grid(color="0.92")
            if not rows:
                say_empty(axis)
        if rows:
            log_scale(axes[0, k], y=key == "impacts")
    axes[1, 0].set_yticks(range(len(names)), names, fontsize=8)
    axes[1, 0].set_ylim(len(names) - 0.4, -0.6)
    for words, style in (
        ("finest step", {"marker": "o"}), ("steps near it", {"ls": "-", "lw": 1.6, "alpha": 0.5}),
        ("the case's step", {"marker": "o", "mfc": "white"}),
        (f"{grids[-1]} cells" if grids else "finest grid", {"marker": "o", "ms": SMALL}),
    ):  # fmt: skip
        axes[0, 0].plot([], [], color="0.4", **{"ls": "", "ms": LARGE} | style, label=words)
    shared_legend(figure, 5, axes[0])
    return figure


def _mark(method: str, of_the_case: bool) -> dict[str, Any]:
    """The look of a method: that of its scheme, with a square for contact that conserves."""
    found = look(method.removesuffix(" conserving"))
    found |= {"marker": "s"} if method == CONSERVING else {"marker": "o"} if method == EXACT else {}
    return {name: found[name] for name in ("color", "marker")} | {"ms": LARGE if of_the_case else SMALL}


STUDY = Study(
    name="rigid_beam",
    question="From soft stops to rigid ones: what do the schemes make of a beam's impulse, contact and energy?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    needs_motion=True,
    needs_stops=True,
    smoke={"kappas": [1e6], "cells": [6], "divide": [1]},
)
