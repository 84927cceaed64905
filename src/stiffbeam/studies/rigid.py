"""Convergence to rigid stops: the compliant solution against restitution 1 on the node's own mass, as kappa grows.

A compliant stop reverses the tip in half a period of the spring, a rigid one at once: the rate is kappa^(-1/2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from ..basics.text import with_unit
from ..basics.validation import InputError
from ..figures.chart import Figure, log_scale, style_of
from ..files.cases import Case
from ..measures.errors import tip_error
from ..measures.report import percent
from ..references.exact.solution import solve_exact
from . import base
from .base import Answer, Row, Study, Table, option

SAMPLES = 4000
PANELS = {"tip_error": "the tip", "impact_time_error": "impact times", "impulse_error": "the first impulse"}


@dataclass(frozen=True, kw_only=True)
class Rigid(Study):
    """How stiff must a stop be before it acts like a rigid one, and how fast is that limit approached?

    Stops of the case's stiffness times ``factors``, until the first ``impacts`` impacts on rigid stops are over. The
    case has linear stops at one place.
    """

    factors: base.Values = option(tuple(4.0**k for k in range(10)), "factors on the stiffness, comma-separated")
    impacts: int = option(3, "number of impacts in the time window", least=1)
    form: str | None = option(*base.FORM)

    needs_stops: ClassVar = True
    needs_motion: ClassVar = True
    height: ClassVar = 4.6
    labels: ClassVar = {
        "kappa": ("stiffness of the stops κ", "stop stiffness"),
        "tip_error": ("largest error over the largest displacement", ""),
        "impact_time_error": ("largest error, time", "time"), "impulse_error": ("relative error", ""),
    }  # fmt: skip

    def points(self, case: Case) -> list[Row]:
        """A point for each stiffness."""
        system = case.system(self.form)
        if len(system.contacts) != 1:
            rule, remedy = "have stops at one place, neither none nor several", "keep the stops at one place"
            raise InputError("case", f"{len(system.contacts)} contacts", rule, remedy)
        system.contacts[0].stops.require_linear("a limit of rigid stops")
        return [{"factor": float(factor)} for factor in self.factors or ()]

    def run(self, case: Case, factor: float) -> Row:
        """Distance of the compliant motion at one stiffness from the rigid one."""
        system, n = case.system(self.form), self.impacts
        (contact,) = system.contacts
        stops = contact.stops
        kappa, hard = stops.stiffness * factor, replace(stops, stiffness=np.inf, restitution=1.0)
        rigid = solve_exact(replace(system, contacts=(replace(contact, stops=hard),)), case.t_end)
        if rigid.impacts.count <= n:
            remedy = "ask for fewer, or lengthen t_end"
            raise InputError("impacts", n, f"be fewer than the {rigid.impacts.count} of the rigid stops", remedy)
        times = rigid.impacts.times
        end = 0.5 * float(times[n - 1] + times[n])
        compliant = replace(system, contacts=(replace(contact, stops=replace(stops, stiffness=kappa)),))
        # The window is short against the horizon, and the same for every kappa.
        exact = base.solve_once(compliant, min(case.t_end, 2.0 * end))
        t = np.linspace(0.0, end, SAMPLES)
        _, error = tip_error(exact.at(t)[0], rigid.at(t)[0])
        inside = exact.impacts.until(end)
        pairs = min(n, inside.count)
        ratios = inside.impulses[:pairs] / rigid.impacts.impulses[:pairs]
        known = ratios[np.isfinite(ratios)]
        return {
            "kappa": kappa, "end": end, "tip_error": error, "impacts": inside.count, "rigid_impacts": n,
            "impact_time_error": float(np.max(np.abs(inside.times[:pairs] - times[:pairs]), initial=0.0)),
            "impulse_error": float(abs(known[0] - 1.0)) if len(known) else np.nan,
        }  # fmt: skip

    def answer(self, table: Table, case: Case) -> Answer:
        """The observed order in 1/kappa, and the errors at every stiffness."""
        units, near, rows = case.units, same_impacts(table), table.sort_values("kappa")
        small = pd.DataFrame({
            with_unit(units, "kappa", "stop stiffness"): rows.kappa.map("{:.2g}".format),
            "impacts": rows.impacts.astype(str) + " of " + rows.rigid_impacts.astype(str),
            "tip off by": rows.tip_error.map(percent),
            "first impulse off by": rows.impulse_error.map(percent) if "impulse_error" in rows else "–",
        })  # fmt: skip
        if len(near) < 2:
            return Answer(
                f"{len(near)} of {len(rows)} stops have the impacts of rigid ones: take larger factors.", small
            )
        order, first = base.order_over(1.0 / near.kappa, near.tip_error), near.kappa.iloc[0]
        verdict = (
            f"The tip approaches that of rigid stops like kappa^-({order}) (theory: 1/2), from kappa = {first:.2g} on."
        )
        return Answer(verdict, small)

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """Hollow markers: other impacts than on rigid stops. The others give the order in the legend."""
        labels, near, kappa = table.attrs["labels"], same_impacts(table), case.system().contacts[0].stops.stiffness
        style: Any = style_of(0) | {"linestyle": "", "ms": 5}
        for axis, (name, title) in zip(figure.subplots(1, len(PANELS)), PANELS.items(), strict=True):
            axis.set(title=title, xlabel=labels["kappa"], ylabel=labels[name])
            if name not in table:
                continue
            axis.axvline(kappa, color="0.5", lw=0.9, ls=":", label="κ of the case")
            kept = near[near[name] > 0.0]
            order = base.order_over(1.0 / kept.kappa, kept[name])
            label = f"in 1/κ: {order}" if np.isfinite(order.slope) else "as many impacts as rigid stops"
            axis.plot(kept.kappa, kept[name], label=label, **style)
            others = table[(table[name] > 0.0) & ~table.index.isin(near.index)]
            axis.plot(others.kappa, others[name], label="other impacts than rigid stops", **style | {"mfc": "white"})
            log_scale(axis)
            axis.legend(frameon=False, fontsize=8)


def same_impacts(table: Table) -> Table:
    """The rows, softest first, from which on all have as many impacts as the rigid stops: the solution approaches the
    limit there. A softer one may have as many by chance."""
    others = table.kappa[table.impacts != table.rigid_impacts].max()
    return table[table.kappa > (0.0 if np.isnan(others) else others)].sort_values("kappa")
