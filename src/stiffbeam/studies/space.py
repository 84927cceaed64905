"""Convergence in space: frequencies and driven motion against the beam itself, contact against a finer grid."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from ..basics.validation import InputError
from ..figures.chart import Axis, Curve, Panel, Picture, column, groups, style_of
from ..files.cases import Case
from ..measures.errors import Order, impact_times, tip_error
from ..measures.frequencies import steady_state, without_contact
from ..model.beam import natural_frequencies, tip_response
from ..model.modes import modes
from ..model.time_functions import Harmonic
from .common import Cells, Forms, ImpactCount, extremes, first_impacts, order_over, solve_once
from .interface import Answer, Point, Records, Row, Rows, declared

SAMPLES = 2000


def points(
    case: Case,
    cells: Cells = None,
    forms: Forms = None,
    finest: Annotated[int, "cells of the grid that contact is compared with"] = 160,
    impacts: ImpactCount = 1,
    modes: Annotated[int, "number of natural frequencies to compare"] = 3,
) -> list[Point]:
    """Grids of 10 to 80 cells, at least three. Without contact they are compared with closed forms.

    In contact they are compared with the grid of ``finest`` cells until its first ``impacts`` impacts are over, and
    not past the horizon of either grid.
    """
    grids = cells or [10, 14, 20, 28, 40, 56, 80]
    kinds = forms or list(case.forms)
    plan: list[Point] = [{"kind": "frequency", "form": f, "cells": n, "modes": modes} for f in kinds for n in grids]
    base, loads = case.problem.base, case.problem.loads
    if isinstance(base, Harmonic) and not loads:
        plan += [{"kind": "response", "form": f, "cells": n} for f in kinds for n in grids]
    if case.has_stops:
        # Half as long again as the case's own grid needs: the other grids meet the stop at other times.
        spans = {f: min(case.t_end, 1.5 * first_impacts(case, f, impacts)) for f in kinds}
        plan += [
            {"kind": "contact", "form": f, "cells": n, "finest": finest, "impacts": impacts, "t_end": spans[f]}
            for f in kinds
            for n in grids
            if n < finest
        ]
    return plan


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row for each quantity and grid: frequencies, the linear response, or the first impacts."""
    return {"frequency": _frequencies, "response": _response, "contact": _contact}[point["kind"]](case, point)


def _frequencies(case: Case, point: Point) -> list[Row]:
    system = replace(case, cells=point["cells"]).system(point["form"])
    basis = modes(replace(without_contact(system), damping=np.zeros_like(system.damping)))
    assert basis is not None
    exact = natural_frequencies(case.problem, point["modes"])
    return [
        {"quantity": f"frequency {i + 1}", "value": float(w), "error": float(abs(w / wanted - 1.0))}
        for i, (w, wanted) in enumerate(zip(basis.omega, exact, strict=False))
    ]


def _response(case: Case, point: Point) -> list[Row]:
    """The amplitude of u(1, t) per amplitude of the base in the steady motion."""
    system = without_contact(replace(case, cells=point["cells"]).system(point["form"]))
    base = case.problem.base
    assert isinstance(base, Harmonic)
    y, _ = steady_state(system)
    sine, cosine = (y @ system.channels[system.tip_channel][0])[1:3]
    # u = sine sin(a t) + cosine cos(a t) = Im((sine + i cosine) e^{i a t}).
    ratio = complex(sine, cosine) / (base.amplitude * np.exp(1j * base.phase))
    exact = tip_response(case.problem)
    return [{"quantity": "tip response", "value": abs(ratio), "error": abs(ratio - exact) / abs(exact)}]


def _contact(case: Case, point: Point) -> list[Row]:
    n, span = point["impacts"], point["t_end"]
    finest = replace(case, cells=point["finest"]).system(point["form"])
    fine = solve_once(finest, span)
    while len(impact_times(fine)) <= n and span < case.t_end:  # the finest grid may meet the stop later
        span = min(case.t_end, 2.0 * span)
        fine = solve_once(finest, span)
    coarse = solve_once(replace(case, cells=point["cells"]).system(point["form"]), span)
    there = min(len(impact_times(fine)), len(impact_times(coarse)))
    if there < n:
        remedy = "ask for fewer, or lengthen t_end"
        raise InputError("impacts", n, f"be at most the {there} that both grids have by t = {span:g}", remedy)
    times = impact_times(fine)
    # Half-way between impacts, so that rounding does not decide whether the last one is inside.
    end = 0.5 * float(times[n - 1] + times[n]) if len(times) > n else span
    end = min(end, fine.horizon, coarse.horizon)
    t = np.linspace(0.0, end, SAMPLES)
    return [
        {"quantity": "tip to the end of the first impacts", "value": end,
         "error": tip_error(coarse.at(t)[0], fine.at(t)[0]).max},
        *(
            {"quantity": f"first impact's {name}{f' at contact {i}' if len(fine.contacts) > 1 else ''}",
             "value": float(x[0]), "error": float(abs(x[0] / y[0] - 1.0))}
            for i, (a, b) in enumerate(zip(coarse.contacts, fine.contacts, strict=True), 1)
            for name, column in (("time", "times"), ("peak force", "peaks"), ("impulse", "impulses"))
            for x, y in [(getattr(a.impacts, column), getattr(b.impacts, column))]
            if len(x) and len(y)
        ),
    ]  # fmt: skip


def orders(rows: Rows) -> dict[tuple[str, str], Order]:
    """The observed order in h by (quantity, form)."""
    parts = groups(rows, "quantity", "form").items()
    return {key: order_over(part, lambda row: 1.0 / row["cells"], "error") for key, part in parts}


def answer(rows: Rows, case: Case) -> Answer:
    """The observed orders in h, form by form, and the errors on the grid that is next to the case's."""
    observed = orders(rows)
    near = min((row["cells"] for row in rows), key=lambda n: (abs(np.log(n / case.cells)), -n))
    errors = {(row["quantity"], row["form"]): f" ({row['error']:.1g})" for row in rows if row["cells"] == near}
    table = [
        {"order in h of": q}
        | {form: str(order) + errors.get((q, form), "") for (other, form), order in observed.items() if other == q}
        for q in dict.fromkeys(q for q, _ in observed)
    ]
    said = []
    for words, impact in (("without contact", False), ("in contact", True)):
        group = {f"{q}, {form}": order for (q, form), order in observed.items() if ("impact" in q) == impact}
        slopes = {name: order.slope for name, order in group.items() if not order.unclear}
        said += [f"{extremes(slopes, '{:.2f}'.format) if slopes else 'no clear rate'} {words}"] if group else []
    return Answer(
        f"Observed orders in h: {', '.join(said)}.",
        table,
        f"In brackets the relative error on {near:g} cells (the case has {case.cells}), in contact against the finest "
        "grid. ± holds with 95 %, an interval wider than 1.5 is no clear rate.",
    )


NAMES = {"tip to the end of the first impacts": "tip, largest", "first impact's time": "time of the first",
         "first impact's peak force": "its peak force", "first impact's impulse": "its impulse",
         "tip response": "tip", "velocity-curvature": "vel.-curv."}  # fmt: skip


def picture(records: Records) -> Picture:
    """One panel for the frequencies, one for the driven tip, one for the contact in each form."""
    rows, titles = records.numbers, {"frequency": "natural frequencies, against the beam",
                                     "response": "driven tip, no contact"}  # fmt: skip
    panels = [_panel(titles[kind], group) for kind, group in groups(rows, "kind").items() if kind in titles]
    for form, group in groups([row for row in rows if row["kind"] == "contact"], "form").items():
        panels.append(_panel(f"first impacts, {NAMES.get(form, form)}, against {group[0]['finest']} cells", group))
    return Picture([panels[i : i + 2] for i in range(0, len(panels), 2)], 4.7 * (1 + (len(panels) > 2)))


def _panel(title: str, group: Rows) -> Panel:
    """A curve for every quantity and form; the colour tells the quantity, dashes the form."""
    quantities, forms = (list(groups(group, name)) for name in ("quantity", "form"))
    marks = []
    for (quantity, form), order in orders(group).items():
        mine = [row for row in group if (row["quantity"], row["form"]) == (quantity, form) and row["error"] > 0.0]
        i, j = quantities.index(quantity), forms.index(form)
        words, at, place = quantity.partition(" at contact ")
        name = NAMES.get(words, words) + at + place + (f", {NAMES.get(form, form)}" if len(forms) > 1 else "")
        slope = str(order) if np.isfinite(order.slope) else "too few grids"
        style = style_of(i, j) if len(quantities) > 1 else style_of(j, j)
        marks += [Curve(1.0 / column(mine, "cells"), column(mine, "error"), f"{name}: {slope}", style)] if mine else []
    cells = sorted({row["cells"] for row in group})
    across = Axis(
        "width of a cell, a share of the beam's length", scale="log", ticks={1.0 / n: f"1/{n}" for n in cells}
    )
    return Panel(title, across, Axis("error, relative", scale="log"), marks, (2, 1), "below")


STUDY = declared(
    __name__,
    "How fast do both discretisations converge to the beam, and does the contact converge too?",
    marches=False,
    smoke={"cells": [6, 8, 12], "finest": 20},
)
