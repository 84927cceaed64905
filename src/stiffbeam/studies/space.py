"""Convergence in space, against finer grids."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from ..basics.validation import InputError
from ..figures.chart import Figure, log_scale, mark_order, panel_legend, style_of
from ..files.cases import Case
from ..measures.errors import Order, impact_times, tip_error
from ..measures.frequencies import steady_state, without_contact
from ..model.modes import undamped_modes
from ..model.system import System
from ..model.time_functions import Harmonic
from . import base
from .base import Answer, Row, Study, Table, option

SAMPLES = 2000
TITLES = {"frequency": "natural frequencies", "response": "driven tip, no contact"}


@dataclass(frozen=True, kw_only=True)
class Space(Study):
    """How fast do the discretisations converge to the beam, and does the contact converge too?

    Without contact the grids are compared with ``finest`` cubic elements, at least twice as many as their cells. In
    contact they are compared with the grid of ``finest`` cells until its first ``impacts`` impacts are over, and not
    past the horizon of either grid.
    """

    cells: base.Integers = option(None, "numbers of cells, comma-separated; default: 10 to 80", least=2)
    forms: base.Labels = option(None, "comma-separated; default: all that the case supports")
    finest: int = option(160, "cells of the grid that others are compared with", least=4)
    impacts: int = option(1, "number of impacts in the time window", least=1)
    modes: int = option(3, "number of natural frequencies to compare", least=1)

    height: ClassVar = 9.4
    labels: ClassVar = {
        "width": ("width of a cell, a share of the beam's length", ""),
        "error": ("error, relative", ""),
    }

    def points(self, case: Case) -> list[Row]:
        """Every grid in every form: frequencies, the linear response to a moving base, the first impacts."""
        grids, forms = self.cells or (10, 14, 20, 28, 40, 56, 80), self.forms or case.forms
        kinds = ["frequency"]
        if isinstance(case.beam.base, Harmonic) and not case.beam.loads:
            kinds.append("response")
        plan: list[Row] = [{"kind": kind, "form": f, "cells": n} for kind in kinds for f in forms for n in grids]
        if case.has_stops:
            plan += [{"kind": "contact", "form": f, "cells": n} for f in forms for n in grids if n < self.finest]
        return plan

    def run(self, case: Case, kind: str, form: str, cells: int) -> list[Row]:
        """One row for each quantity and grid: frequencies, the linear response, or the first impacts."""
        coarse = replace(case, cells=cells)
        if kind == "contact":
            return self._contact(case, coarse, form)
        fine = replace(case, cells=max(self.finest, 2 * cells)).system("hermite")  # of fourth order
        systems = [without_contact(x) for x in (coarse.system(form), fine)]
        if kind == "response":
            value, exact = (_response(system, case) for system in systems)
            error = abs(value - exact) / abs(exact)
            return [{"quantity": "tip response", "value": abs(value), "error": error}]
        natural = (undamped_modes(system).omega for system in systems)
        pairs = zip(*(omega[omega > 0.0].tolist()[: self.modes] for omega in natural), strict=False)
        return [_row(f"frequency {i}", value, exact) for i, (value, exact) in enumerate(pairs, 1)]

    def _contact(self, case: Case, coarser: Case, form: str) -> list[Row]:
        n, finest = self.impacts, replace(case, cells=self.finest).system(form)
        # Half as long again as the case's own grid needs: the other grids meet the stop at other times.
        span = min(case.t_end, 1.5 * base.first_impacts(case, form, n))
        fine = base.solve_once(finest, span)
        while len(impact_times(fine)) <= n and span < case.t_end:
            span = min(case.t_end, 2.0 * span)
            fine = base.solve_once(finest, span)
        coarse = base.solve_once(coarser.system(form), span)
        there = min(len(impact_times(fine)), len(impact_times(coarse)))
        if there < n:
            remedy = "ask for fewer, or lengthen t_end"
            raise InputError("impacts", n, f"be at most the {there} that both grids have by t = {span:g}", remedy)
        times = impact_times(fine)
        # Half-way between impacts, so that rounding does not decide whether the last one is inside.
        end = 0.5 * float(times[n - 1] + times[n]) if len(times) > n else span
        end = min(end, fine.horizon, coarse.horizon)
        t = np.linspace(0.0, end, SAMPLES)
        _, error = tip_error(coarse.at(t)[0], fine.at(t)[0])
        rows: list[Row] = [{"quantity": "tip to the end of the first impacts", "value": end, "error": error}]
        for i, (a, b) in enumerate(zip(coarse.contacts, fine.contacts, strict=True)):
            place = f" at contact {i}" if len(fine.contacts) > 1 else ""
            for name, column in (("time", "times"), ("peak force", "peaks"), ("impulse", "impulses")):
                x, y = getattr(a.impacts, column), getattr(b.impacts, column)
                if len(x) and len(y):
                    rows.append(_row(f"first impact's {name}{place}", float(x[0]), float(y[0])))
        return rows

    def answer(self, table: Table, case: Case) -> Answer:
        """The observed orders in h, form by form, and the errors on the grid that is next to the case's."""
        observed = orders(table)
        near = min(table.cells, key=lambda n: (abs(np.log(n / case.cells)), -n))
        at = table[table.cells == near].set_index(["quantity", "form"]).error.to_dict()
        small: dict[str, Row] = {}
        for (quantity, form), order in observed.items():
            error = f" ({at[quantity, form]:.1g})" if (quantity, form) in at else ""
            small.setdefault(quantity, {"order in h of": quantity})[form] = f"{order}{error}"
        parts = []
        for words, impact in (("without contact", False), ("in contact", True)):
            group = {f"{q}, {form}": order for (q, form), order in observed.items() if ("impact" in q) == impact}
            parts += [f"{base.clear_orders(group)} {words}"] if group else []
        notes = f"In brackets the relative error on {near:g} cells (the case has {case.cells}), in contact against the "
        notes += f"grid of {self.finest}. ± holds with 95 %, an interval wider than 1.5 or than the order is no "
        notes += "clear rate."
        return Answer(f"Observed orders in h: {', '.join(parts)}.", pd.DataFrame(list(small.values())), notes)

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """One panel for the frequencies, one for the driven tip, one for the contact in each form."""
        groups = [(TITLES[kind], table[table.kind == kind]) for kind in TITLES if kind in set(table.kind)]
        for form, group in table[table.kind == "contact"].groupby("form", sort=False):
            groups.append((f"first impacts, {form}, against {self.finest} cells", group))
        labels = table.attrs["labels"]
        for place, (title, group) in enumerate(groups, 1):
            axis = figure.add_subplot((len(groups) + 1) // 2, min(2, len(groups)), place)
            quantities, forms = list(group.quantity.unique()), list(group.form.unique())
            for (quantity, form), order in orders(group).items():  # the colour tells the quantity, dashes the form
                mine = group[(group.quantity == quantity) & (group.form == form) & (group.error > 0.0)]
                i, j = quantities.index(quantity), forms.index(form)
                name = f"{quantity}, {form}" if len(forms) > 1 else quantity
                slope = str(order) if np.isfinite(order.slope) else "too few grids"
                style: Any = style_of(i, j) if len(quantities) > 1 else style_of(j, j)
                axis.plot(1.0 / mine.cells, mine.error, label=f"{name}: {slope}", lw=1.1, ms=4.5, **style)
            log_scale(axis)
            cells = sorted(group.cells.unique())
            axis.set_xticks([1.0 / n for n in cells], [f"1/{n}" for n in cells], fontsize=8.5)
            axis.minorticks_off()
            axis.set(title=title, xlabel=labels["width"], ylabel=labels["error"])
            mark_order(axis, (2, 1))
            panel_legend(axis)


def orders(table: Table) -> dict[tuple[str, str], Order]:
    """The observed order in h by (quantity, form)."""
    parts = table.groupby(["quantity", "form"], sort=False)
    return {key: base.order_over(1.0 / part.cells, part.error) for key, part in parts}


def _row(quantity: str, value: float, exact: float) -> Row:
    return {"quantity": quantity, "value": value, "error": abs(value / exact - 1.0)}


def _response(system: System, case: Case) -> complex:
    """u(L, t) per base in the steady motion, with the phase."""
    drive = case.beam.base
    assert isinstance(drive, Harmonic)
    sine, cosine = (steady_state(system) @ system.channels[system.tip_channel][0])[1:3]
    # u = sine sin(a t) + cosine cos(a t) = Im((sine + i cosine) e^{i a t}).
    return complex(sine, cosine) / (drive.amplitude * np.exp(1j * drive.phase))
