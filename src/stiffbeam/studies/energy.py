"""Energy balance of every scheme in every form, and of the exact flow, which closes to rounding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from ..figures.chart import Figure, lines, name_lines, shared_legend, short, signed_log
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.comparison import lost_fractions
from ..measures.report import DASH, ROUNDING, energy_share, extremes
from ..trajectory.trajectory import Trajectory
from . import base
from .base import Answer, Row, Study, Table, option

OUTPUTS = 200  # times at which the energy balance is kept
MOST = 100.0  # per cent: a longer bar ends here, beside its number
PARTS = (("lost_in_contact", "in contact", "0.3", -0.18), ("lost_free", "between impacts", "0.65", 0.18))


@dataclass(frozen=True, kw_only=True)
class Energy(Study):
    """How much energy does each scheme lose, in contact and between impacts?

    Every scheme and the exact solution run in every form that the case supports. The exact solution ends at its
    horizon.
    """

    schemes: base.Labels = option(*base.SCHEME_LABELS)
    forms: base.Labels = option(None, "comma-separated; default: all that the case supports")
    contact: str = option(*base.TREATMENT)

    needs_motion: ClassVar = True
    height: ClassVar = 8.2
    labels: ClassVar = {"t": ("time $t$", "time"), "lost_in_contact": ("energy lost so far", "energy"),
                        "lost_free": ("energy lost so far", "energy")}  # fmt: skip

    def points(self, case: Case) -> list[Row]:
        """The exact solution and every scheme in every form."""
        schemes = base.chosen_schemes(case, self.schemes)
        return [{"scheme": name, "form": form} for form in self.forms or case.forms for name in ("exact", *schemes)]

    def run(self, case: Case, scheme: str, form: str) -> list[Row]:
        """Energy balance of one run at some times; that of the exact flow ends at its horizon."""
        system = case.system(form)
        if scheme == "exact":
            run: Trajectory = base.solve_once(system, case.t_end)
            last = int(np.searchsorted(run.energy.t, run.horizon, side="right"))
            keep = np.unique(np.linspace(0, max(0, last - 1), OUTPUTS).astype(int))
        else:
            every = max(1, round(case.t_end / case.dt) // OUTPUTS)
            made = base.chosen_schemes(case, self.schemes)[scheme]
            run = integrate(system, made, case.dt, case.t_end, self.contact, every)
            keep = np.arange(len(run.energy.t))
        ledger, names = run.energy, ("t", "kinetic", "elastic", "stops", "energy", "input", "supplied", "viscous")
        table = pd.DataFrame({name: getattr(ledger, name)[keep] for name in (*names, "loss")})
        table["sure"] = [bool(ledger.is_resolved(int(k))) for k in keep]
        table["lost_fraction"] = lost_fractions(ledger, system, keep)
        table["lost_in_contact"] = np.where(table.sure, ledger.loss_in_contact[keep], np.nan)
        table["lost_free"] = np.where(table.sure, ledger.loss_without_contact[keep], np.nan)
        return table.to_dict("records")

    def answer(self, table: Table, case: Case) -> Answer:
        """Energy lost at the end of every run, as a share of the energy supplied, and its part in contact."""
        last = table.groupby(["scheme", "form"], sort=False).tail(1)
        closed = [
            f"{abs(row.lost_fraction):.0e} ({row.form}, to t = {row.t:.3g})"
            for row in last[last.lost_fraction.notna() & (last.scheme == "exact")].itertuples()
        ]
        schemes = last[(last.scheme != "exact") & (last.form == table.form.iloc[0])]
        lost = schemes.set_index("scheme").lost_fraction.dropna().to_dict()
        small = pd.DataFrame(
            {"scheme": schemes.scheme, "energy lost": schemes.lost_fraction.map(energy_share)}
            | {words: _share(schemes, part).map(energy_share) for part, words, *_ in PARTS}
        )
        end = f"{(schemes if len(schemes) else last).t.max():g}"
        exact = ", the exact flow none" if closed else ""
        verdict = f"Schemes lose {extremes(lost, energy_share)} of the energy supplied to t = {end}{exact}."
        why = "almost no energy is supplied" if schemes.sure.all() else "the steps do not resolve the work of dampers"
        if not lost and len(schemes):
            verdict = f"No loss of a scheme is known to t = {end}: {why}."
        notes = "Shares of the energy supplied: initial energy plus the most work of the loads. Single runs."
        notes += f" The energy balance of the exact flow closes to {', '.join(closed)}." if closed else ""
        return Answer(verdict, small, notes + f" {DASH}: {why}." * (len(lost) < len(schemes)))

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """Above: energy lost over time. Below: for each form the shares of the supplied energy lost at the end."""
        labels, forms = table.attrs["labels"], list(table.form.unique())
        grid = figure.add_gridspec(2, 2 * len(forms), height_ratios=(1.0, 1.15))
        main = table[table.form == forms[0]]
        largest = float((main.energy.abs() + main.input.abs()).max())
        for i, (name, words, *_) in enumerate(PARTS):
            axis = figure.add_subplot(grid[0, i * len(forms) : (i + 1) * len(forms)])
            lines(axis, main, "t", name, "scheme", marker="")
            values = main[name].to_numpy(float)
            if np.nanmax(np.abs(values), initial=0.0) > ROUNDING * largest:
                signed_log(axis, 1e-3 * float(np.nanmax(np.abs(values))))
            elif largest:
                axis.set_ylim(-largest, largest)
            axis.set(title=f"lost {words}, {forms[0]} form", xlabel=labels["t"], ylabel=labels[name])
        names, left = [x for x in table.scheme.unique() if x != "exact"], None
        for j, form in enumerate(forms):
            left = figure.add_subplot(grid[1, 2 * j : 2 * j + 2], sharey=left)
            end = f"{table[table.form == form].t.max():g}"
            last = table[table.form == form].groupby("scheme").tail(1).set_index("scheme").reindex(names)
            for part, words, colour, place in PARTS:
                share, y = _share(last, part), np.arange(len(names)) + place
                bars = left.barh(y, (100.0 * share).clip(-MOST, MOST), 0.3, color=colour, label=words)
                left.bar_label(bars, [energy_share(x) for x in share], padding=3, fontsize=7.5, color="0.3")
            left.axvline(0.0, color="0.5", lw=0.9)
            left.margins(x=0.25)
            name_lines(left, [short(name) for name in names])
            left.set(title=f"{form} to t = {end}", xlabel="per cent of the energy supplied")
            left.tick_params(labelleft=not j)
        shared_legend(figure)


def _share(rows: Table, part: str) -> Any:
    """A part of the loss over the energy supplied, NaN where the share of the loss is."""
    return rows[part] / rows.supplied.where(rows.lost_fraction.notna())
