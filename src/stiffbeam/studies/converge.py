"""Every integrator at every resolution: error, work, time, impacts and energy lost are columns of one table.

A row enters an observed order only if the motion is resolved, the error is above rounding, and (in contact) every
impact in the window matches one of the exact motion. Through contact errors vary irregularly with the step: the worst
of an octave of steps counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd

from ..basics.validation import number
from ..figures.chart import Figure, lines, log_scale, look, mark_order, shared_legend, short
from ..files.cases import Case
from ..integrators import SCHEME, SOLVER, Integrator, fastest
from ..measures.comparison import lost_fractions
from ..measures.errors import Order, matched_until, observed_order, tip_error
from ..measures.frequencies import smooth_motion, smooth_period
from ..measures.report import DASH
from ..model.scales import scales
from ..references import takes
from ..references.registry import ADAPTIVE, COMPARED, REFERENCES
from . import base
from .base import Answer, Row, Study, Table, option

SMOOTH, CONTACT = "smooth", "contact"
MOST_HALVINGS = 20
SOLVERS = tuple(m for m in COMPARED if REFERENCES[m].kind == ADAPTIVE)  # beside the schemes, unless others are named
PER_OCTAVE = 4  # steps per halving through contact
SAMPLES = 1000  # outputs on which the error is measured
RESOLVED = 0.5  # largest (omega dt)
ASYMPTOTIC = 0.1  # largest relative error
ROUNDING = 10.0 * np.finfo(float).eps  # times the number of steps: a bound of the error of rounding
REFERENCE = 100.0  # times its relative tolerance: a bound of the error of an adaptive reference
ERROR = 1e-3  # tip error at which costs are compared
VIEWS = {  # x, y, title
    "order": ("dt", "tip_error", "error over the time step"),
    "work": ("solves", "tip_error", "error over work"),
    "time": ("seconds", "tip_error", "error over time"),
    "impacts": ("dt", "impacts", "impacts to the horizon"),
    "matched": ("dt", "matched_until", "exact impacts followed"),
    "loss": ("dt", "energy_lost", "numerical dissipation"),
}


@dataclass(frozen=True, kw_only=True)
class Converge(Study):
    """How fast do the errors fall with the time step, at what cost, and from which step on are the impacts right?

    Schemes and functions run at dt, dt/2, ..., solvers at their tolerances. Without
    contact (smooth) they follow the slow motion of the case over its longest period. In contact errors are measured
    until the first ``impacts`` impacts are over; impacts are followed to the horizon of the exact motion.

    Work of a scheme: steps times stages, which are linear solves or, of an explicit scheme, evaluations of the force.
    Of a solver: evaluations of the right-hand side or linear solves, whichever are more. Of a function: the largest of
    ``work.counters`` of the Trajectory that it returns, for example {"rhs": 4 * steps}; without them it is not known.

    Example: stiffbeam converge table10 --integrators BDF2,cvode --views order,work
    """

    integrators: base.Labels = option(
        None,
        "comma-separated schemes, solvers and functions module:function; default: all schemes, cvode, ida, kvaerno5",
    )
    views: base.Labels = option(
        ("order", "work", "impacts"), "panels, comma-separated: order, work, time, impacts, matched, loss", known=VIEWS
    )
    kinds: base.Labels = option((SMOOTH, CONTACT), "smooth, contact, or both", known=(SMOOTH, CONTACT))
    halvings: int = option(10, "number of time steps dt, dt/2, dt/4, ...", least=1)
    tolerances: base.Values = option((1e-4, 1e-6, 1e-8, 1e-10), "relative tolerances of solvers, comma-separated")
    impacts: int = option(4, "number of impacts in the time window", least=1)
    form: str | None = option(*base.FORM)
    contact: str = option(*base.TREATMENT)

    height: ClassVar = 8.4
    labels: ClassVar = {
        "dt": (r"time step $\Delta t$", "time"), "tip_error": ("tip error, rms, relative", ""),
        "solves": ("linear solves or evaluations", ""), "seconds": ("seconds of stepping", ""),
        "impacts": ("impacts counted", ""), "matched_until": ("exact impacts followed to $t$", "time"),
        "energy_lost": ("share of the energy supplied", ""),
    }  # fmt: skip

    @property
    def measured(self) -> tuple[str, ...]:
        """Seconds, where the view "time" asks for them."""
        return ("seconds",) if "time" in (self.views or ()) else ()

    def chosen(self, case: Case) -> dict[str, Integrator]:
        """Integrators by label."""
        solvers = () if self.integrators else SOLVERS
        here = [x for x in solvers if takes(x, case.system(self.form), case.t_end)]
        return base.chosen(case, self.integrators) | base.chosen(case, here)

    def points(self, case: Case) -> list[Row]:
        """Each integrator at each step or tolerance, without contact and in contact."""
        remedy = f"the last run has 2^{self.halvings - 1} times the steps of the first"
        number("halvings", self.halvings, least=1, most=MOST_HALVINGS, remedy=remedy)
        system, plan = case.system(self.form), list[Row]()
        for kind in self.kinds or (SMOOTH, CONTACT):
            if kind == SMOOTH:
                end = smooth_period(system, case.t_end)
            else:
                end = base.first_impacts(case, self.form or case.forms[0], self.impacts) if system.contacts else 0.0
            for label, one in self.chosen(case).items() if end else ():
                if one.kind == SOLVER:
                    levels = [{"rtol": float(x)} for x in self.tolerances or () if one.adaptive]
                else:
                    per = PER_OCTAVE if kind == CONTACT and one.kind == SCHEME else 1
                    counts = [max(4, round(end / case.dt * 2.0 ** (k / per))) for k in range(self.halvings * per)]
                    # Steps that round to one number are one point, of the coarser octave.
                    levels = [{"steps": n, "octave": counts.index(n) // per} for n in dict.fromkeys(counts)]
                plan += [{"kind": kind, "integrator": label, "t_end": end} | level for level in levels]
        return plan

    def run(
        self, case: Case, kind: str, integrator: str, t_end: float, rtol: float = 0.0, steps: int = 0, octave: int = 0
    ) -> Row:
        """Error, work and time to t_end, and impacts to the horizon; the reason why it does not count in an order."""
        system, one = case.system(self.form), self.chosen(case)[integrator]
        if kind == SMOOTH:
            system = smooth_motion(system)
        exact = base.solve_once(system, case.t_end if kind == CONTACT else t_end)
        timed = fastest if self.measured else lambda run: run()
        dt = t_end / steps if steps else 0.0
        if rtol:
            times = np.linspace(0.0, t_end, SAMPLES + 1)
            run = timed(lambda: one.solve(system, rtol, times, t_end))
            error, left_out = tip_error(run.tip, exact.at(times)[0])[0], "solver"
            if "stages" in run.work.counters:  # it steps to every output, which a user may not ask for
                run = timed(lambda: one.solve(system, rtol, times[[0, -1]], t_end))
        else:
            run = timed(lambda: one.run(system, dt, t_end, self.contact, max(1, steps // SAMPLES)))
            error, _ = tip_error(run.tip, exact.at(run.t)[0])
            fastest_rate = max([*system.drive.frequencies, 2.0 * np.pi / scales(system, case.t_end).period])
            reasons = {  # that keep a row out of its order
                "impacts differ": kind == CONTACT and matched_until(run, exact, t_end) < t_end,
                "error above 10 %": error > ASYMPTOTIC,
                "motion not resolved": fastest_rate * dt > RESOLVED,
                "rounding": error < max(ROUNDING * steps, REFERENCE * float(exact.provenance.get("rtol", 0.0))),
                "past the horizon": t_end > exact.horizon,
            }
            left_out = next((reason for reason, holds in reasons.items() if holds), "")
        row: Row = {"dt": dt} if steps else {}
        if kind == CONTACT and steps:  # to the horizon in whole steps: samples may end there
            n = max(1, int(min(exact.horizon, case.t_end) / dt * (1 + 1e-9)))
            longer, until = one.run(system, dt, n * dt, self.contact, every=n), min(n * dt, exact.horizon)
            row |= {
                "impacts": sum(x.impacts.until(until).count for x in longer.contacts),
                "exact_impacts": sum(x.impacts.until(until).count for x in exact.contacts),
                "matched_until": matched_until(longer, exact, until), "horizon": float(until),
            }  # fmt: skip
        if "loss" in (self.views or ()) and one.kind == SCHEME:
            (row["energy_lost"],) = lost_fractions(run.energy, system)
        known = one.kind == SCHEME or run.work.counters
        return row | {
            "tip_error": error, "left_out": left_out, "solves": one.work(run) if known else np.nan,
            "seconds": float(run.work.march_seconds),
        }  # fmt: skip

    def answer(self, table: Table, case: Case) -> Answer:
        """Orders of every integrator, the work for one error, the step from which on impacts are right."""
        observed, parts = orders(table), list[str]()
        at = table[table.kind == (CONTACT if CONTACT in set(table.kind) else SMOOTH)]
        costs, right = cheapest(at, ERROR, "solves"), right_from(at)
        columns: dict[str, dict[str, str]] = {"integrator": {x: short(x) for x in table.integrator.unique()}}
        words = {SMOOTH: "without contact", CONTACT: "through the first impacts"}
        if not right:
            words[CONTACT] = f"as the motion starts, without impacts to t = {at.t_end.max():g}"
        for kind, place in words.items():
            of_kind = {label: order for (k, label), order in observed.items() if k == kind}
            columns[f"order {place}"] = {
                label: str(order) if np.isfinite(order.slope) else "too few points" for label, order in of_kind.items()
            }
            parts += [f"{base.clear_orders(of_kind)} {place}"] if of_kind else []
        met = at.groupby("integrator").tip_error.max() <= ERROR
        # Three digits, without a power of ten. Where even the coarsest run meets the error a coarser one may as well.
        work = {x: f"{'at most ' if met[x] else ''}{float(f'{cost:.3g}'):.0f}" for x, cost in costs.items()}
        columns[f"work for {ERROR:g}"] = work
        columns["impacts right from dt"] = {x: f"{dt:.2g}" if np.isfinite(dt) else DASH for x, dt in right.items()}
        verdict = f"Observed orders: {', '.join(parts)}." if parts else ""
        if costs:
            best = min(costs, key=costs.__getitem__)
            verdict += f" Least work for a tip error of {ERROR:g}: {work[best]} solves or evaluations ({short(best)})."
        notes = "Order: ± holds with 95 %; through impacts the worst of each octave of steps counts. Work: solves or "
        notes += f"evaluations for a tip error of {ERROR:g} that all finer runs keep, interpolated between runs."
        if right:
            notes += f" Impacts right: as many as the exact motion to its horizon, t = {at.horizon.max():.3g}."
        small = pd.DataFrame({name: column for name, column in columns.items() if column})
        return Answer(verdict.strip(), small, notes)

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """A panel for each view; errors over the step have one for each kind of motion."""
        kinds, labels = [kind for kind in (SMOOTH, CONTACT) if kind in set(table.kind)], table.attrs["labels"]
        panels = [(view, kind) for view in self.views or ("order",)
                  for kind in (kinds if view == "order" else kinds[-1:])
                  if set(VIEWS[view][:2]) <= set(table)]  # fmt: skip
        columns = 2 if len(panels) in (2, 4) else min(3, len(panels)) or 1
        rows = -(-len(panels) // columns)
        figure.set_figheight(1.4 + 3.9 * rows)
        for place, (view, kind) in enumerate(panels, 1):
            (x, y, title), ordered = VIEWS[view], view == "order"
            axis, shown = figure.add_subplot(rows, columns, place), table[(table.kind == kind) & table[y].notna()]
            if ordered:
                title = "without contact" if kind == SMOOTH else "through the first impacts"
                shown = shown[shown.left_out != "solver"].sort_values("dt")
            elif y == "tip_error" and "octave" in shown:  # one of an octave
                shown = shown[shown.octave.isna() | ~shown.duplicated(["integrator", "octave"])]
            lines(axis, shown, x, y, "integrator", ms=4.0, **{"mfc": "white", "lw": 0.5} if ordered else {})
            for (_, label), order in orders(shown).items() if ordered else ():
                # Filled markers enter the slope, hollow ones do not; the line is the observed order.
                group, style = shown[shown.integrator == label], look(label)
                kept = group[group.groupby("octave").left_out.transform(lambda each: (each == "").all())]
                axis.plot(kept.dt, kept.tip_error, style["marker"], ms=4.0, color=style["color"])
                if np.isfinite(order.slope):
                    ends = np.array([kept.dt.min(), kept.dt.max()])
                    fit = order.constant * ends**order.slope
                    axis.plot(ends, fit, lw=1.4, color=style["color"], linestyle=style["linestyle"])
            if y == "impacts":
                exact = shown.exact_impacts.max()
                axis.axhline(exact, color="black", lw=1.6, label="exact")
                axis.set_ylim(-0.02 * exact, 2.0 * exact + 1.0)  # a run that overflows would hide the others
            if y == "matched_until":
                axis.axhline(shown.horizon.max(), color="black", ls=":", label="horizon")
            log_scale(axis, y=y == "tip_error")
            if y == "tip_error":
                axis.set_ylim(top=min(axis.get_ylim()[1], 1e3))
                mark_order(axis, (3, 2, 1) if x == "dt" else (-2, -1), y=0.05 if x == "dt" else 0.95)
            axis.set(title=title, xlabel=labels[x], ylabel=labels[y])
        shared_legend(figure)


def orders(table: Table) -> dict[tuple[str, str], Order]:
    """The observed order by (kind, integrator), of those that run in steps, through the worst point of every octave
    whose points all count."""
    found = {}
    for (kind, label), rows in table[table.left_out != "solver"].groupby(["kind", "integrator"], sort=False):
        kept = [group for _, group in rows.groupby("octave") if (group.left_out == "").all()]
        steps, errors = [group.dt.max() for group in kept], [group.tip_error.max() for group in kept]
        found[str(kind), str(label)] = observed_order(steps, errors)
    return found


def cheapest(table: Table, error: float, cost: str) -> dict[str, float]:
    """Cost of an ``error`` that all dearer points keep as well, interpolated from the point before, by integrator.

    A coarse point may be right by chance. Where all points are below ``error`` it is the least of all costs.
    """
    costs, known = dict[str, float](), table[table[cost].notna()] if cost in table else table[:0]
    for label, rows in known.groupby("integrator", sort=False):
        rows = rows.sort_values(cost)
        value, off = rows[cost].to_numpy(float), rows.tip_error.to_numpy(float)
        missed = np.flatnonzero(~(off <= error))
        if not len(missed):
            costs[str(label)] = float(value[0])
        elif (i := missed[-1]) + 1 < len(rows):
            share = np.log(off[i] / error) / np.log(off[i] / off[i + 1])
            costs[str(label)] = float(value[i] * (value[i + 1] / value[i]) ** share)
    return costs


def right_from(table: Table) -> dict[str, float]:
    """The largest step from which on all smaller ones count the exact number of impacts, NaN for none; no entries for
    an exact motion without impacts."""
    if "exact_impacts" not in table or not (table.exact_impacts > 0).any():
        return {}
    rows = table[table.impacts.notna()]
    wrong = rows[rows.impacts != rows.exact_impacts].groupby("integrator").dt.min()
    right = rows[~(rows.dt >= rows.integrator.map(wrong))].groupby("integrator").dt.max()
    return right.reindex(rows.integrator.unique()).to_dict()
