"""Convergence in space: frequencies and driven motion against the beam itself, contact against a finer grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..basics.validation import InputError
from ..figures import COLOURS, MARKERS, column, dashed, heading, log_scale, mark_order, new_figure, numeric, say_empty
from ..files.cases import Case
from ..measures.errors import Order, observed_order, tip_error
from ..measures.impacts import impact_times
from ..measures.smooth_motion import steady_state, without_contact
from ..model.closed_form import natural_frequencies, tip_response
from ..model.modes import modes
from ..model.time_functions import Harmonic
from .common import Forms, ImpactCount, first_impacts, places, solve_once, system_of
from .engine.study import Answer, Point, Records, Row, Rows, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SAMPLES = 2000


def points(
    case: Case,
    cells: Annotated[list[int] | None, "grids, with commas between them"] = None,
    forms: Forms = None,
    finest: Annotated[int, "the grid that contact is compared with"] = 160,
    impacts: ImpactCount = 1,
    modes: Annotated[int, "natural frequencies that are compared"] = 3,
) -> list[Point]:
    """Grids of 10 to 80 cells (at least three), against closed forms and against ``finest`` in contact.

    The contact is compared until the first impacts of the finest grid are over, as many as ``impacts`` says, and never
    past the horizon of either.
    """
    grids = cells or [10, 14, 20, 28, 40, 56, 80]
    kinds = forms or list(case.forms)
    found: list[Point] = [{"kind": "frequency", "form": f, "cells": n, "modes": modes} for f in kinds for n in grids]
    base, loads = case.problem.base, case.problem.loads
    if isinstance(base, Harmonic) and not loads:
        found += [{"kind": "response", "form": f, "cells": n} for f in kinds for n in grids]
    if case.has_stops:
        # Half as long again as the case's own grid needs: the other grids meet the stop at other times.
        spans = {f: min(case.t_end, 1.5 * first_impacts(case, f, impacts)) for f in kinds}
        found += [
            {"kind": "contact", "form": f, "cells": n, "finest": finest, "impacts": impacts, "t_end": spans[f]}
            for f in kinds
            for n in grids
            if n < finest
        ]
    return found


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row for each quantity and grid: frequencies, the linear response, or the first impacts."""
    return {"frequency": _frequencies, "response": _response, "contact": _contact}[point["kind"]](case, point)


def _frequencies(case: Case, point: Point) -> list[Row]:
    system = system_of(replace(case, cells=point["cells"]), point["form"])
    basis = modes(replace(without_contact(system), damping=np.zeros_like(system.damping)))
    assert basis is not None
    exact = natural_frequencies(case.problem, point["modes"])
    return [
        {"quantity": f"frequency {i + 1}", "value": float(w), "error": float(abs(w / wanted - 1.0))}
        for i, (w, wanted) in enumerate(zip(basis.omega, exact, strict=False))
    ]


def _response(case: Case, point: Point) -> list[Row]:
    """The amplitude of u(1, t) per amplitude of the base in the steady motion."""
    system = without_contact(system_of(replace(case, cells=point["cells"]), point["form"]))
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
    finest = system_of(replace(case, cells=point["finest"]), point["form"])
    fine = solve_once(finest, span)
    while len(impact_times(fine)) <= n and span < case.t_end:  # the finest grid may meet the stop later
        span = min(case.t_end, 2.0 * span)
        fine = solve_once(finest, span)
    own = solve_once(system_of(replace(case, cells=point["cells"]), point["form"]), span)
    there = min(len(impact_times(fine)), len(impact_times(own)))
    if there < n:
        remedy = "ask for fewer, or lengthen t_end"
        raise InputError("impacts", n, f"be at most the {there} that both grids have by t = {span:g}", remedy)
    times = impact_times(fine)
    end = 0.5 * float(times[n - 1] + times[n]) if len(times) > n else span
    end = min(end, fine.horizon, own.horizon)
    t = np.linspace(0.0, end, SAMPLES)
    return [
        {
            "quantity": "tip to the end of the first impacts",
            "value": end,
            "error": tip_error(own.at(t)[0], fine.at(t)[0]).max,
        },
        *(
            {"quantity": f"first impact's {name}{place}", "value": float(x[0]), "error": float(abs(x[0] / y[0] - 1.0))}
            for place, a, b in zip(places(finest), own.contacts, fine.contacts, strict=True)
            for name, column in (("time", "times"), ("peak force", "peaks"), ("impulse", "impulses"))
            for x, y in [(getattr(a.impacts, column), getattr(b.impacts, column))]
            if len(x) and len(y)
        ),
    ]


def orders(rows: Rows) -> dict[tuple[str, str], Order]:
    """The observed order in h by (quantity, form)."""
    keys = dict.fromkeys((r["quantity"], r["form"]) for r in rows)
    found = {}
    for key in keys:
        own = [r for r in rows if (r["quantity"], r["form"]) == key and r["error"] > 0.0]
        found[key] = observed_order([1.0 / r["cells"] for r in own], [r["error"] for r in own])
    return found


def answer(rows: Rows, case: Case) -> str:
    """The observed orders in h, form by form, and the errors on the grid that is next to the case's."""
    found = orders(rows)
    smooth = [f"{q} {o} ({form})" for (q, form), o in found.items() if "impact" not in q]
    contact = [f"{q} {o} ({form})" for (q, form), o in found.items() if "impact" in q]
    kinds = (("", smooth), ("in contact, against the finest grid: ", contact))
    sentence = "; ".join(words + ", ".join(orders) for words, orders in kinds if orders)
    forms = list(dict.fromkeys(form for _, form in found))
    near = min((row["cells"] for row in rows), key=lambda n: (abs(np.log(n / case.cells)), -n), default=case.cells)
    errors = {(row["quantity"], row["form"]): f" ({row['error']:.1g})" for row in rows if row["cells"] == near}
    table = [
        {"order in h of": q}
        | {form: str(found[q, form]) + errors.get((q, form), "") for form in forms if (q, form) in found}
        for q in dict.fromkeys(q for q, _ in found)
    ]
    rest = (
        f"In brackets the relative error on {near} cells (the case has {case.cells}), in contact against the finest "
        "grid. ± holds with 95 %, an interval wider than 1.5 is no clear rate."
    )
    return Answer(f"Observed orders in h: {sentence}.", table, rest)


NAMES = {"tip to the end of the first impacts": "tip, largest", "first impact's time": "time of the first",
         "first impact's peak force": "its peak force", "first impact's impulse": "its impulse",
         "tip response": "tip", "velocity-curvature": "vel.-curv."}  # fmt: skip


def draw(records: Records) -> Figure:
    """One panel for the frequencies, one for the driven tip, one for the contact in each form."""
    rows = numeric(records.found)
    panels: list[tuple[str, list[Row]]] = []
    for kind, title in (("frequency", "natural frequencies, against the beam"), ("response", "driven tip, no contact")):
        panels.append((title, [row for row in rows if row["kind"] == kind]))
    contact = [row for row in rows if row["kind"] == "contact"]
    for form in dict.fromkeys(row["form"] for row in contact):
        title = f"first impacts, {NAMES.get(form, form)}, against {contact[0]['finest']} cells"
        panels.append((title, [row for row in contact if row["form"] == form]))
    panels = [panel for panel in panels if panel[1]] or [("nothing found", [])]
    figure = new_figure(
        4.7 * (1 + (len(panels) > 2)), heading(records.case, "convergence in space, slopes with their 95 % intervals")
    )
    shape = (1 + (len(panels) > 2), min(2, len(panels)))
    axes = figure.subplots(*shape, squeeze=False).ravel()
    for axis, (title, own), letter in zip(axes, panels, "abcd", strict=False):
        _panel(axis, own)
        axis.set_title(f"({letter}) {title}", loc="left")
    for axis in axes[len(panels) :]:
        axis.remove()
    return figure


def _panel(axis: Axes, own: Sequence[Row]) -> None:
    """A curve for every quantity and form; the colour tells the quantity, dashes the form."""
    quantities = list(dict.fromkeys(row["quantity"] for row in own))
    forms = list(dict.fromkeys(row["form"] for row in own))
    for (quantity, form), order in orders(own).items():
        mine = [row for row in own if (row["quantity"], row["form"]) == (quantity, form) and row["error"] > 0.0]
        if not mine:
            continue
        i, j = quantities.index(quantity), forms.index(form)
        style: dict[str, Any] = {"color": COLOURS[(i if len(quantities) > 1 else j) % len(COLOURS)], "ms": 4.5,
                 "marker": MARKERS[(i + 3 * j) % len(MARKERS)], "lw": 1.0, "ls": dashed(j)}  # fmt: skip
        words, at, place = quantity.partition(" at contact ")
        name = NAMES.get(words, words) + at + place + (f", {NAMES.get(form, form)}" if len(forms) > 1 else "")
        slope = str(order) if np.isfinite(order.slope) else "too few grids"
        axis.plot(1.0 / column(mine, "cells"), column(mine, "error"), label=f"{name}: {slope}", **style)
    log_scale(axis)
    axis.set(xlabel="width of a cell, a share of the beam's length", ylabel="error, relative")
    axis.grid(color="0.92", which="both")
    if not axis.get_lines():
        say_empty(axis)
        return
    cells = sorted({row["cells"] for row in own})
    axis.set_xticks([1.0 / n for n in cells], [f"1/{n}" for n in cells], fontsize=8.5)
    axis.minorticks_off()
    low, high = axis.get_ylim()
    axis.set_ylim(low * (low / high) ** 0.12, high)
    mark_order(axis, (2, 1))
    axis.legend(frameon=False, fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2,
                columnspacing=1.0)  # fmt: skip


STUDY = Study(
    name="space",
    question="How fast do both discretisations approach the beam itself, and does the contact follow?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    marches=False,
    smoke={"cells": [6, 8, 12], "finest": 20},
)
