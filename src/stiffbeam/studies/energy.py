"""The energy ledger of every scheme in every form, beside the exact flow's, which closes to rounding."""

from __future__ import annotations

import numpy as np

from ..cases import Case
from ..ledger import Ledger
from ..march.integrate import integrate
from ..semidiscretisation import FORMS
from ..trajectory import Trajectory
from .common import scheme_labels, scheme_of, solve_once, system_of
from .study import Point, Row, Rows, Study

OUTPUTS = 200  # times at which the ledger is kept
FIRST_ORDER = ", first order"  # (3.5): the same system, marched in (v, v')


def points(
    case: Case,
    schemes: list[str] | None = None,
    forms: list[str] | None = None,
    dt: float | None = None,
    t_end: float | None = None,
    contact: str = "implicit",
) -> list[Point]:
    """The exact flow and every scheme on every form that the case can take; first-order marches for two schemes.

    The exact flow is followed to its horizon, where a float64 solution still is one.
    """
    dt, t_end = case.dt if dt is None else dt, case.t_end if t_end is None else t_end
    labels = scheme_labels(case, schemes)
    kinds = forms or [f for f in FORMS if f == "displacement" or case.problem.viscosity == 0.0]
    span = {"t_end": t_end, "contact": contact}
    found: list[Point] = []
    for form in kinds:
        found.append({"scheme": "exact", "form": form, "dt": 0.0} | span)
        found += [{"scheme": label, "form": form, "dt": dt} | span for label in labels]
    # The direct march of the paper's (3.5) is slow, and the same scheme to rounding: a tenth of the span shows it.
    first = [label for label in labels if not scheme_of(label).second_order_only][:1] if forms is None else []
    short = {"t_end": dt * max(2, round(0.1 * t_end / dt)), "contact": contact}
    found += [{"scheme": label, "form": "displacement" + FIRST_ORDER, "dt": dt} | short for label in first]
    return found


def evaluate(case: Case, point: Point) -> list[Row]:
    form = point["form"]
    system = system_of(case, form.removesuffix(FIRST_ORDER))
    if point["scheme"] == "exact":
        run: Trajectory = solve_once(system, point["t_end"])
        ledger = run.energy
        last = int(np.searchsorted(ledger.t, run.horizon, side="right"))
        keep = np.unique(np.linspace(0, max(0, last - 1), OUTPUTS).astype(int))
    else:
        steps = round(point["t_end"] / point["dt"])
        chosen = system.first_order() if form.endswith(FIRST_ORDER) else system
        every = max(1, steps // OUTPUTS)
        run = integrate(chosen, scheme_of(point["scheme"]), point["dt"], point["t_end"], point["contact"], every)
        ledger = run.energy
        keep = np.arange(len(ledger.t))
    return [_row(ledger, int(k)) for k in keep]


def _row(ledger: Ledger, k: int) -> Row:
    names = ("t", "kinetic", "elastic", "stops", "energy", "input", "viscous", "loss")
    row = {name: float(getattr(ledger, name)[k]) for name in names}
    row |= {"lost_in_contact": float(ledger.contact[k]), "lost_free": float(ledger.free[k])}
    return row | {"lost_fraction": ledger.lost_fraction(k)}


def last_rows(rows: Rows) -> list[Row]:
    """The last line of every run's ledger."""
    return list({(row["scheme"], row["form"]): row for row in rows}.values())


def answer(rows: Rows) -> str:
    parts, exact = [], []
    for row in last_rows(rows):
        if row["scheme"] == "exact":
            exact.append(f"{abs(row['lost_fraction']):.0e} ({row['form']}, to t = {row['t']:.3g})")
        elif row["form"] == "displacement":
            share = row["lost_in_contact"] / row["loss"] if row["loss"] else float("nan")
            parts.append(f"{row['scheme']} {100 * row['lost_fraction']:.2g} % ({100 * share:.0f} % of it in contact)")
    end = max(row["t"] for row in rows)
    return (
        f"Of all energy put in to t = {end:g}, one realisation each, lost: {', '.join(parts)}. "
        f"The exact flow closes to {', '.join(exact)}."
    )


STUDY = Study(
    name="energy",
    question="Where does the energy go: how much does each scheme lose, in contact and between impacts?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"schemes": ["hht(alpha=-0.1)", "bdf2"], "t_end": 0.05},
)
