"""Convergence in space: frequencies and driven motion against the beam itself, contact against a finer grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..cases import Case
from ..closed_form import natural_frequencies, tip_response
from ..measures.regression import Order, observed_order
from ..modal import modes
from ..semidiscretisation import FORMS
from ..time_functions import Harmonic
from ..validation import InputError
from .common import first_impacts, solve_once, steady_state, system_of, without_contact
from .study import Point, Row, Rows, Study

SAMPLES = 2000


def points(
    case: Case,
    cells: list[int] | None = None,
    forms: list[str] | None = None,
    finest: int = 160,
    impacts: int = 1,
    modes: int = 3,
) -> list[Point]:
    """Grids of 10 to 80 cells (at least three), against closed forms and against ``finest`` in contact.

    The contact is compared until the first ``impacts`` impacts of the finest grid are over, and never
    past the horizon of either.
    """
    grids = cells or [10, 14, 20, 28, 40, 56, 80]
    kinds = forms or [f for f in FORMS if f == "displacement" or case.problem.viscosity == 0.0]
    found: list[Point] = [{"kind": "frequency", "form": f, "cells": n, "modes": modes} for f in kinds for n in grids]
    base, loads = case.problem.base, case.problem.loads
    if isinstance(base, Harmonic) and not loads:
        found += [{"kind": "response", "form": f, "cells": n} for f in kinds for n in grids]
    if case.problem.stops is not None:
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
    fine = solve_once(system_of(replace(case, cells=point["finest"]), point["form"]), point["t_end"])
    own = solve_once(system_of(replace(case, cells=point["cells"]), point["form"]), point["t_end"])
    n = point["impacts"]
    if fine.impacts.count <= n or own.impacts.count <= n:
        raise InputError("impacts", n, f"be fewer than the {min(fine.impacts.count, own.impacts.count)} there are")
    end = 0.5 * float(fine.impacts.times[n - 1] + fine.impacts.times[n])
    end = min(end, fine.horizon, own.horizon)
    t = np.linspace(0.0, end, SAMPLES)
    u, wanted = own.at(t)[0], fine.at(t)[0]
    scale = float(np.max(np.abs(wanted)))
    first, fine_first = own.impacts, fine.impacts
    return [
        {
            "quantity": "tip to the end of the first impacts",
            "value": end,
            "error": float(np.max(np.abs(u - wanted))) / scale,
        },
        *(
            {"quantity": f"first impact's {name}", "value": float(x[0]), "error": float(abs(x[0] / y[0] - 1.0))}
            for name, x, y in (
                ("time", first.times, fine_first.times),
                ("peak force", first.peaks, fine_first.peaks),
                ("impulse", first.impulses, fine_first.impulses),
            )
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


def answer(rows: Rows) -> str:
    found = orders(rows)
    smooth = [f"{q} {o} ({form})" for (q, form), o in found.items() if "impact" not in q]
    contact = [f"{q} {o} ({form})" for (q, form), o in found.items() if "impact" in q]
    tail = f" In contact, against the finest grid: {', '.join(contact)}." if contact else ""
    return f"Observed orders in h: {', '.join(smooth)}.{tail}"


STUDY = Study(
    name="space",
    question="How fast do both discretisations approach the beam itself, and does the contact follow?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"cells": [6, 8, 12], "finest": 20},
)
