"""Energy balance of every scheme in every form, and of the exact flow, which closes to rounding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd

from ..figures.chart import Axes, Figure, lines, name_lines, shared_legend, short, signed_log
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.report import DASH, extremes, percent
from ..trajectory.trajectory import Trajectory
from . import base
from .base import Answer, Row, Study, Table, option

OUTPUTS = 200  # times at which the energy balance is kept
MOST = 100.0  # per cent: a longer bar ends here, beside its number
ROUNDING = 1e-9  # of the largest energy: less is no loss
PARTS = (("lost_in_contact", "in contact", "0.3", -0.18), ("lost_free", "between impacts", "0.65", 0.18))
REGAINED = " Above 100 %: the scheme regains energy in the first steps after a contact, which still use its force."


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
        table["lost_fraction"] = [float(ledger.lost_fraction(int(k))) for k in keep]
        table["lost_in_contact"] = np.where(table.sure, ledger.loss_in_contact[keep], np.nan)
        table["lost_free"] = np.where(table.sure, ledger.loss_without_contact[keep], np.nan)
        return table.to_dict("records")

    def answer(self, table: Table, case: Case) -> Answer:
        """Energy lost at the end of every run, as a share of the energy supplied, and its part in contact."""
        last = table.groupby(["scheme", "form"], sort=False).tail(1)
        closed = [
            f"{abs(row.lost_fraction):.0e} ({row.form}, to t = {row.t:.3g})"
            for row in last[last.scheme == "exact"].itertuples()
        ]
        schemes = last[(last.scheme != "exact") & (last.form == table.form.iloc[0])]
        resolved, unknown = schemes[schemes.sure], not schemes.sure.all()
        lost = resolved.set_index("scheme").lost_fraction.dropna().to_dict()
        shares = (resolved.lost_in_contact / resolved.loss.where(resolved.loss != 0.0)).set_axis(resolved.scheme)
        small = pd.DataFrame({
            "scheme": schemes.scheme, "energy lost": schemes.scheme.map(lost).map(percent),
            "of it in contact": schemes.scheme.map(shares).map(percent),
        })  # fmt: skip
        end = f"{(schemes if len(schemes) else last).t.max():g}"
        verdict = f"Schemes lose {extremes(lost, percent)} of the energy supplied to t = {end}, the exact flow none."
        if not lost and unknown:
            verdict = f"The steps do not resolve the work of dampers to t = {end}, and losses are not known."
        notes = (
            "Supplied: initial energy plus the most work of the loads. Single runs. The energy balance of the exact "
            f"flow closes to {', '.join(closed) or DASH}."
        )
        notes += f" {DASH}: the steps do not resolve the work of dampers." * unknown
        return Answer(verdict, small, notes + REGAINED * bool((shares > 1.005).any()))

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
        shared_legend(figure)
        names, left = [x for x in table.scheme.unique() if x != "exact"], None
        for j, form in enumerate(forms):
            left = figure.add_subplot(grid[1, 2 * j : 2 * j + 2], sharey=left)
            end = f"{table[table.form == form].t.max():g}"
            _shares(left, table[table.form == form], names)
            left.set(title=f"{form} to t = {end}", xlabel="per cent of the energy supplied")
            left.tick_params(labelleft=not j)


def _shares(axis: Axes, rows: Table, names: list[str]) -> None:
    """Shares in contact and between impacts, a bar each in the line of its scheme."""
    last = rows.groupby("scheme").last().reindex(names)
    for part, words, colour, place in PARTS:
        share = last[part] / last.supplied.where(last.supplied > 0.0)
        bars = axis.barh(np.arange(len(names)) + place, (100.0 * share).clip(-MOST, MOST), 0.3, color=colour)
        bars.set_label(words)
        texts = ["0" if abs(x) < ROUNDING else percent(x) for x in share]
        axis.bar_label(bars, texts, padding=3, fontsize=7.5, color="0.3")
    axis.axvline(0.0, color="0.5", lw=0.9)
    axis.margins(x=0.25)
    name_lines(axis, [short(name) for name in names])
    if names:
        axis.legend(fontsize=8, loc="lower left")
