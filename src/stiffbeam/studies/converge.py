"""Every integrator at every resolution: error, work, time, impacts and energy lost are columns of one table.

A row enters an observed order only if the motion is resolved, the error is above rounding, and (in contact) every
impact in the window matches one of the exact motion. Through contact errors vary irregularly with the step: the worst
of an octave of steps counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from ..basics.validation import number, positive
from ..figures.chart import Axes, Figure, lines, log_scale, look, mark_order, shared_legend, short
from ..files.cases import Case
from ..integrators import SCHEME, SOLVER, Integrator, fastest
from ..measures.comparison import lost_fractions
from ..measures.errors import Order, matched_until, observed_order, tip_error
from ..measures.frequencies import smooth_motion, smooth_period
from ..measures.report import DASH, energy_share
from ..model.scales import scales
from ..model.system import System
from ..references import takes
from ..references.registry import ADAPTIVE, COMPARED, REFERENCES
from ..trajectory.trajectory import Reference, Trajectory
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
STEPS = "steps"  # unit of the work of a function that counts nothing
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

    Work of an implicit scheme: linear solves. Of an explicit one: evaluations of the force. Of a solver: evaluations of
    the right-hand side or linear solves, whichever are more. Of a function: the largest of ``work.counters`` of the
    Trajectory that it returns, for example {"rhs": 4 * steps}; else its steps, which are marked as such.

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
    budget: float = option(600.0, "seconds after which no further run begins; coarse runs come first")
    impacts: int = option(4, "number of impacts in the time window", least=1)
    form: str | None = option(*base.FORM)
    contact: str = option(*base.TREATMENT)

    height: ClassVar = 8.4
    labels: ClassVar = {
        "dt": (r"time step $\Delta t$", "time"), "tip_error": ("tip error, rms, relative", ""),
        "solves": ("linear solves, evaluations or steps", ""), "seconds": ("seconds of stepping", ""),
        "impacts": ("impacts counted", ""), "matched_until": ("exact impacts followed to $t$", "time"),
        "energy_lost": ("share of the energy supplied", ""),
    }  # fmt: skip

    @property
    def measured(self) -> tuple[str, ...]:
        """Seconds, where the view "time" asks for them."""
        return ("seconds",) if "time" in (self.views or ()) else ()

    def require(self, case: Case) -> None:
        """Raise InputError for more steps than a computer can take."""
        super().require(case)
        positive("budget", self.budget)
        remedy = f"the last run has 2^{self.halvings - 1} times the steps of the first"
        number("halvings", self.halvings, least=1, most=MOST_HALVINGS, remedy=remedy)

    def chosen(self, case: Case) -> dict[str, Integrator]:
        """Integrators by label."""
        picked = base.chosen(case, self.integrators)
        if self.integrators is None:
            system = case.system(self.form)
            here = [m for m in SOLVERS if takes(m, system, case.t_end)]
            picked |= base.chosen(case, here)
        return picked

    def points(self, case: Case) -> list[Row]:
        """Each integrator at each step or tolerance, without contact and in contact."""
        system, plan = case.system(self.form), list[Row]()
        for kind in self.kinds or (SMOOTH, CONTACT):
            if kind == CONTACT and not system.contacts:
                continue
            end = base.first_impacts(case, self.form or case.forms[0], self.impacts) if kind == CONTACT else 0.0
            if kind == SMOOTH and not (end := smooth_period(system, case.t_end)):
                continue
            for label, one in self.chosen(case).items():
                shared = {"kind": kind, "integrator": label, "t_end": end}
                if one.kind == SOLVER:
                    levels = self.tolerances or () if REFERENCES[label].kind == "adaptive" else ()
                    plan += [shared | {"rtol": float(rtol)} for rtol in levels]
                    continue
                plan += [shared | each for each in self._steps(case, one, kind, end)]
        # All coarse runs first: a budget that is over leaves out the fine ones of every integrator.
        return sorted(plan, key=lambda point: point.get("octave", 0))

    def _steps(self, case: Case, one: Integrator, kind: str, end: float) -> list[Row]:
        """Numbers of steps, each with its octave."""
        per = PER_OCTAVE if kind == CONTACT and one.kind == SCHEME else 1
        counts = [max(4, round(end / case.dt * 2.0 ** (k / per))) for k in range(self.halvings * per)]
        # Steps that round to one number are one point, of the coarser octave.
        return [{"steps": n, "octave": counts.index(n) // per} for n in dict.fromkeys(counts)]

    def run(
        self, case: Case, kind: str, integrator: str, t_end: float, rtol: float = 0.0, steps: int = 0, octave: int = 0
    ) -> Row:
        """Error, work and time to t_end, and impacts to the horizon; the reason why it does not count in an order."""
        system, one = case.system(self.form), self.chosen(case)[integrator]
        if kind == SMOOTH:
            system = smooth_motion(system)
        exact = base.solve_once(system, case.t_end if kind == CONTACT else t_end)
        timed = fastest if self.measured else lambda run: run()
        if rtol:
            times = np.linspace(0.0, t_end, SAMPLES + 1)
            run = timed(lambda: one.solve(system, rtol, times, t_end))
            error, _ = tip_error(run.tip, exact.at(times)[0])
            if "stages" in run.work.counters:  # it steps to every output, which a user may not ask for
                bare = np.array([0.0, t_end])
                run = timed(lambda: one.solve(system, rtol, bare, t_end))
            return _cost(one, run) | {"tip_error": error, "left_out": "solver"}
        dt = t_end / steps
        every = max(1, steps // SAMPLES)
        run = timed(lambda: one.run(system, dt, t_end, self.contact, every))
        error, largest = tip_error(run.tip, exact.at(run.t)[0])
        row = _cost(one, run) | {"dt": dt, "tip_error": error, "tip_error_max": largest}
        row["left_out"] = _left_out(case, system, exact, run, kind == CONTACT, dt, steps, error)
        if kind == CONTACT:
            row |= self._followed(case, one, exact, dt)
        if "loss" in (self.views or ()) and one.kind == SCHEME:
            (row["energy_lost"],) = lost_fractions(run.energy, system)
        return row

    def _followed(self, case: Case, one: Integrator, exact: Reference, dt: float) -> Row:
        """Impacts of a run and of the exact motion to its horizon, and the time to which they match."""
        steps = max(1, int(min(exact.horizon, case.t_end) / dt * (1 + 1e-9)))  # whole ones: samples may end there
        run = one.run(case.system(self.form), dt, steps * dt, self.contact, every=steps)
        until = min(steps * dt, exact.horizon)
        pairs = list(zip(run.contacts, exact.contacts, strict=True))
        return {
            "impacts": sum(ours.impacts.until(until).count for ours, _ in pairs),
            "exact_impacts": sum(theirs.impacts.until(until).count for _, theirs in pairs),
            "matched_until": matched_until(run, exact, until), "horizon": float(until),
        }  # fmt: skip

    def answer(self, table: Table, case: Case) -> Answer:
        """Orders of every integrator, the work for one error, the step from which on impacts are right."""
        observed = orders(table)
        columns: dict[str, dict[str, str]] = {"integrator": {x: short(x) for x in table.integrator.unique()}}
        words, parts = {SMOOTH: "without contact", CONTACT: "through the first impacts"}, []
        for kind in (x for x in words if x in set(table.kind)):
            of_kind = {label: order for (k, label), order in observed.items() if k == kind}
            if kind == CONTACT and not _touches(table):
                end = table[table.kind == CONTACT].t_end.max()
                words[CONTACT] = f"as the motion starts, without impacts to t = {end:g}"
            columns[f"order {words[kind]}"] = {
                label: str(order) if np.isfinite(order.slope) else "too few points" for label, order in of_kind.items()
            }
            parts += [f"{base.clear_orders(of_kind)} {words[kind]}"] if of_kind else []
        at = table[(table.kind == CONTACT) if CONTACT in set(table.kind) else (table.kind == SMOOTH)]
        costs, right = cheapest(at, ERROR, "solves"), right_from(at)
        by_integrator = at.groupby("integrator")
        unit, met = by_integrator.unit.first(), by_integrator.tip_error.max() <= ERROR
        # Three digits, without a power of ten. Where even the coarsest run meets the error a coarser one may as well.
        work = {x: f"{'at most ' if met[x] else ''}{float(f'{cost:.3g}'):.0f} {unit[x]}" for x, cost in costs.items()}
        columns[f"work for {ERROR:g}"] = work
        columns["impacts right from dt"] = {x: f"{dt:.2g}" if np.isfinite(dt) else DASH for x, dt in right.items()}
        if "energy_lost" in at:
            lost = at[at.energy_lost.notna()].groupby("integrator").energy_lost.first()
            columns["energy lost at dt"] = lost.map(energy_share).to_dict()
        small = pd.DataFrame({name: column for name, column in columns.items() if column})
        verdict = f"Observed orders: {', '.join(parts)}." if parts else ""
        counted = [x for x in costs if unit[x] != STEPS]
        if counted:
            best = min(counted, key=costs.__getitem__)
            verdict += f" Least work for a tip error of {ERROR:g}: {work[best]} ({short(best)})."
        notes = "Order: ± holds with 95 %; through impacts the worst of each octave of steps counts. Work: for a tip "
        notes += f"error of {ERROR:g} that all finer runs keep, interpolated between runs."
        if len(counted) < len(costs):
            notes += " Steps: a function whose Trajectory has no work.counters, not comparable with the others."
        if right:
            notes += f" Impacts right: as many as the exact motion to its horizon, t = {at.horizon.max():.3g}."
        if "energy_lost" in at and any(name not in columns["energy lost at dt"] for name in by_integrator.groups):
            notes += " Energy lost: only of states with energy, and where dt resolves the dissipation of dampers."
        return Answer(verdict.strip(), small, notes)

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """A panel for each view; errors over the step have one for each kind of motion."""
        kinds = [kind for kind in (SMOOTH, CONTACT) if kind in set(table.kind)]
        main = table[table.kind == kinds[-1]]
        panels = [(view, kind) for view in self.views or ("order",)
                  for kind in (kinds if view == "order" else [kinds[-1]])
                  if set(VIEWS[view][:2]) <= set(main)]  # fmt: skip
        columns = 2 if len(panels) in (2, 4) else min(3, len(panels))
        axes = figure.subplots(-(-len(panels) // columns), columns, squeeze=False).ravel()
        figure.set_figheight(1.4 + 3.9 * (len(axes) // columns))
        for axis, (view, kind) in zip(axes, panels, strict=False):
            rows = table[table.kind == kind] if view == "order" else main
            x, y, title = VIEWS[view]
            if view == "order":
                title = "without contact" if kind == SMOOTH else "through the first impacts"
                _orders(axis, rows, {label: order for (k, label), order in orders(rows).items() if k == kind})
            else:
                _curves(axis, rows, x, y)
            log_scale(axis, y=y == "tip_error")
            if y == "tip_error":
                axis.set_ylim(top=min(axis.get_ylim()[1], 1e3))
                mark_order(axis, (3, 2, 1) if x == "dt" else (-2, -1), y=0.05 if x == "dt" else 0.95)
            axis.set(title=title, xlabel=table.attrs["labels"][x], ylabel=table.attrs["labels"][y])
        for axis in axes[len(panels) :]:
            axis.remove()
        shared_legend(figure, 4)


def _cost(one: Integrator, run: Trajectory) -> Row:
    unit = "solves" if one.implicit else "evaluations" if one.kind == SCHEME or run.work.counters else STEPS
    return {"solves": one.work(run), "unit": unit, "seconds": float(run.work.march_seconds)}


def _left_out(
    case: Case, system: System, exact: Reference, run: Trajectory, touches: bool, dt: float, steps: int, error: float
) -> str:
    """Reason that keeps a row out of its order, "" for none."""
    end = float(run.t[-1])
    fastest_rate = max([*system.drive.frequencies, 2.0 * np.pi / scales(system, case.t_end).period])
    reasons = {
        "impacts differ": touches and matched_until(run, exact, end) < end,
        "error above 10 %": error > ASYMPTOTIC,
        "motion not resolved": fastest_rate * dt > RESOLVED,
        "rounding": error < max(ROUNDING * steps, REFERENCE * float(exact.provenance.get("rtol", 0.0))),
        "past the horizon": end > exact.horizon,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def _touches(table: Table) -> bool:
    return "exact_impacts" in table and bool((table.exact_impacts > 0).any())


def envelope(rows: Table) -> tuple[list[float], list[float]]:
    """(dt, error) of the worst point of every octave whose points all count."""
    kept = [group for _, group in rows.groupby("octave") if (group.left_out == "").all()]
    return [group.dt.max() for group in kept], [group.tip_error.max() for group in kept]


def orders(table: Table) -> dict[tuple[str, str], Order]:
    """The observed order by (kind, integrator), of those that run in steps."""
    groups = table[table.left_out != "solver"].groupby(["kind", "integrator"], sort=False)
    return {(str(kind), str(label)): observed_order(*envelope(group)) for (kind, label), group in groups}


def cheapest(table: Table, error: float, cost: str) -> dict[str, float]:
    """Cost of an ``error`` that all dearer points keep as well, interpolated from the point before, by integrator.

    A coarse point may be right by chance. Where all points are below ``error`` it is the least of all costs.
    """
    costs: dict[str, float] = {}
    for label, rows in table[np.isfinite(table[cost])].groupby("integrator", sort=False):
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
    """The largest step from which on all smaller ones count the exact number of impacts, NaN for none."""
    if not _touches(table):
        return {}
    steps: dict[str, float] = {}
    for label, rows in table[table.impacts.notna()].groupby("integrator", sort=False):
        wrong = rows[rows.impacts != rows.exact_impacts].dt.min()
        steps[str(label)] = float(rows[~(rows.dt >= wrong)].dt.max())
    return steps


def _curves(axis: Axes, rows: Table, x: str, y: str) -> None:
    rows = rows[rows[y].notna()]
    if "octave" in rows and y == "tip_error":
        rows = rows[rows.octave.isna() | ~rows.duplicated(["integrator", "octave"])]
    lines(axis, rows, x, y, "integrator", ms=4.0)
    if y == "impacts":
        exact = rows.exact_impacts.max()
        axis.axhline(exact, color="black", lw=1.6, label="exact")
        low, high = (np.clip(end, 0.0, 2.0 * exact) for end in (rows.impacts.min(), rows.impacts.max()))
        axis.set_ylim(min(low, exact) - 1.5, max(high, exact) + 1.5)
        axis.yaxis.get_major_locator().set_params(integer=True)  # type: ignore[attr-defined]
    if y == "matched_until":
        axis.axhline(rows.horizon.max(), color="black", ls=":", label="horizon")


def _orders(axis: Axes, rows: Table, observed: dict[str, Order]) -> None:
    """Filled markers enter the slope, hollow ones do not; the line is the observed order."""
    for label, group in rows[rows.left_out != "solver"].groupby("integrator", sort=False):
        style: Any = look(str(label)) | {"ms": 4.0}
        group = group.sort_values("dt")
        counted = group.groupby("octave").left_out.transform(lambda each: (each == "").all())
        axis.plot(group.dt, group.tip_error, **style | {"marker": "", "lw": 0.5, "alpha": 0.6})
        for which, fill in ((counted, {}), (~counted, {"mfc": "white"})):
            axis.plot(group.dt[which], group.tip_error[which], **style | {"linestyle": ""} | fill)
        axis.plot([], [], label=short(str(label)), **style)
        order = observed.get(str(label))
        if order is not None and np.isfinite(order.slope):
            ends = np.array([group.dt[counted].min(), group.dt[counted].max()])
            axis.plot(ends, order.constant * ends**order.slope, **style | {"marker": "", "lw": 1.4})
