"""Sweeps: the tip once a period, impacts and forces against any parameter.

    section: u(1, n T), n = transient + 1 .. transient + periods, T the period of the drive

The step is the one nearest to dt that divides T: an interpolation between steps would smear periodic motions. The
contact is recorded over the same periods. Without damping the exact motion depends on its initial data for ever.

A case has no period without a drive, with several frequencies, and if samples drive it. It runs once from 0 to its
t_end at every value, with impacts per unit of time and without sections.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from ..basics.arrays import Array
from ..basics.text import unit_of, with_unit
from ..basics.validation import InputError, number
from ..figures.chart import Figure, dashed, log_scale, look, shared_legend, tip_text
from ..files.cases import Case
from ..march.integrate import integrate_ensemble
from ..measures.report import percent
from ..model.members import with_values
from ..model.modes import modes
from ..model.system import System
from ..references import substitute
from ..references.ensemble import reference_ensemble
from ..schemes import Scheme
from ..trajectory.ensemble import Ensemble
from ..trajectory.trajectory import Diverged, SolverFailure
from . import base
from .base import Answer, Row, Study, Table, option

EXACT = "exact"
LOG_RANGE = 30.0  # ratio of values from which on their axis is logarithmic
LONGEST = 8  # periods of the drive that a motion may take to repeat itself and still be called periodic
SAME = 1e-3  # of the motion's size at each value: section points closer than this are one
REST = 1e-6  # of the largest motion: a smaller one has this size
BATCHES = 16  # points of a sweep


@dataclass(frozen=True, kw_only=True)
class Sweep(Study):
    """How does the motion change with a parameter: periodicity, number of impacts, forces?

    One motion for each value of ``parameter``. The ``values`` are in the units of the case; by default they are 200
    drive frequencies from 0.7 to 1.3 of the case's. Of each motion ``periods`` of the drive are recorded, after
    ``transient`` periods.
    Limitation: each motion starts as the case does; a coexisting motion is not seen.

    Example: stiffbeam sweep table10 --parameter frequency --values 8:14:400
    """

    parameter: str = option(
        "frequency", "frequency, amplitude, clearance, stiffness, viscosity, or a path: stops.stiffness"
    )
    values: base.Values = option(None, base.VALUES)
    method: str | None = option(
        None, "a scheme, or exact; default: the case's first scheme that has a law for its stops"
    )
    form: str | None = option(*base.FORM)
    contact: str = option(*base.TREATMENT)
    periods: int = option(60, "periods of the drive to record", least=1)
    transient: int = option(100, "periods of the drive before the recorded ones", least=0)

    height: ClassVar = 9.4

    def points(self, case: Case) -> list[Row]:
        """Batches of values that march together, after the checks of the options."""
        parameter, nominal, (method, scheme) = self.parameter, case.system(self.form), self._chosen(case)
        values = values_of(parameter, self.values, 200, period := drive_period(nominal))
        shared: Row = {"method": method, "dt": case.dt if scheme else None}
        shared |= {"periods": self.periods, "transient": self.transient}
        if period is None:  # every value is one run from 0 to t_end, without sections
            nominal.drive.require_samples(case.t_end)
            shared |= {"periods": 1, "transient": 0, "t_end": case.t_end}
        for value in (min(values), max(values)):  # what a scheme refuses in between is a row
            system, T, _ = setup_of(nominal, parameter, value, shared["dt"], shared.get("t_end"))
            if scheme is None and shared["transient"] and substitute(system, shared["transient"] * T):
                remedy = "name a scheme as method, or transient=0: other solvers record contacts from the start only"
                raise InputError("method", EXACT, "be a scheme for a case without an exact solution", remedy)
        size = -(-len(values) // BATCHES)
        return [{**shared, "values": values[i : i + size]} for i in range(0, len(values), size)]

    def _chosen(self, case: Case) -> tuple[str, Scheme | None]:
        """Label and scheme of the method, None for the exact solution."""
        fitting = (run for run, *_ in case.runs if base.takes(case, run))
        method: Any = next(fitting, EXACT) if self.method is None else self.method
        return (EXACT, None) if method == EXACT else next(iter(base.chosen_schemes(case, [method]).items()))

    def run(self, case: Case, values: list[float], **point: Any) -> list[Row]:
        """Rows of all values; where one is refused, each runs by itself, and the row of that one has the reason."""
        system, (_, scheme), rows = case.system(self.form), self._chosen(case), list[Row]()
        groups: dict[tuple[float, float], list[tuple[Row, System]]] = {}  # of one period and step, which march together
        try:
            for value in values:
                varied, period, dt = setup_of(system, self.parameter, value, point["dt"], point.get("t_end"))
                named = {self.parameter: value} | ({"dt": dt} if scheme else {})
                groups.setdefault((period, dt), []).append((named, varied))
            for (period, dt), group in groups.items():
                systems, t = [x for _, x in group], period * np.arange(point["transient"] + point["periods"] + 1)
                end, since = float(t[-1]), float(t[point["transient"]])
                if scheme is None:
                    many = reference_ensemble(systems[0], end, systems, t, since=since)
                else:
                    every = round(period / dt)
                    many = integrate_ensemble(systems[0], scheme, dt, end, systems, self.contact, every, since=since)
                rows += [row for i, (named, _) in enumerate(group) for row in _rows(point, named, many, i)]
        except (InputError, SolverFailure) as error:
            if len(values) > 1:
                return [row for value in values for row in self.run(case, [value], **point)]
            return [{self.parameter: values[0], "lost": str(error)}]
        return rows

    def answer(self, table: Table, case: Case) -> Answer:
        """The range of impact counts and peak forces over the values, and where the motion is periodic."""
        first, small, parameter = table.iloc[0], list[Row](), self.parameter
        for place, contacts in _places(table[table.kind == "contact"]):
            for name, label, scale in self._measures(contacts, case):
                known = contacts[contacts[name].notna()]
                if len(known):
                    row: Row = {"over all values": label + place}
                    for end, k in (("least", known[name].idxmin()), ("most", known[name].idxmax())):
                        row[end] = f"{known[name][k] / scale:.4g} at {parameter} {table[parameter][k]:.5g}"
                    small.append(row)
        values, by_value = table[parameter], sections(table, parameter)
        notes = f"{self.periods} periods of the drive after {self.transient}."
        notes += _transient(case.system(self.form), self.transient)
        notes = f"Single runs, t = 0 to {first.t_end:g}." if "t_end" in table else notes
        most = [f"most {x['over all values']}: {x['most']}" for x in small if "impacts" in x["over all values"]]
        verdict = "; ".join(most) or "no contact"
        if by_value:
            # Of the motion at every value: the largest of |u| and |u'|/w in its section, w the drive's frequency.
            size = table[table.kind == "section"].groupby(parameter)["size"].max()
            found = [repeats_after(tips, max(size[value], REST * size.max())) for value, tips in by_value.items()]
            longer, short = sum(p is not None and p > 1 for p in found), found.count(None)
            verdict = f"the tip repeats itself every period of the drive at {found.count(1)} of {len(found)} values, "
            verdict += f"every 2 to {LONGEST} periods at {longer}, and not at all at {found.count(0)} (to {SAME:g})"
            verdict += f"; {first.periods:g} periods are too few to tell at {short}" if short else ""
        verdict = f"{first.method} over {parameter} {values.min():g} to {values.max():g}: {verdict}."
        return Answer(verdict, pd.DataFrame(small), notes)

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """Sections, impacts and forces on one axis."""
        contacts, sections = (table[table.kind == kind].sort_values(self.parameter) for kind in ("contact", "section"))
        measures = self._measures(contacts, case) if len(contacts) else []
        heights = ([3.0] if len(sections) else []) + [1.0] * len(measures)
        axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        method: dict[str, Any] = look(str(table.method.iloc[0])) | {"marker": ".", "ms": 3.0}
        if len(sections):
            # The fainter the more points there are, so that bands and curves can be told apart.
            dots = {"linestyle": "", "mew": 0.0, "alpha": float(np.clip(2e4 / len(sections), 0.15, 0.9))}
            axes[0].plot(sections[self.parameter], sections.tip, rasterized=True, **method | dots)
            tip = with_unit(case.units, tip_text(case.problem, t="nT"), "length")
            axes[0].set(title="the tip once in every period $T$ of the drive", ylabel=tip)
        for axis, (quantity, label, scale) in zip(axes[len(axes) - len(measures) :], measures, strict=True):
            for i, (place, rows) in enumerate(_places(contacts)):
                style = method | {"linestyle": dashed(i), "lw": 0.5, "label": place.strip()}
                axis.plot(rows[self.parameter], rows[quantity] / scale, **style)
            axis.set(title=label, ylim=(0.0, None))
        axes[-1].set_xlabel(named(case, self.parameter))
        if 0.0 < LOG_RANGE * table[self.parameter].min() < table[self.parameter].max():
            log_scale(axes[-1], y=False)
        shared_legend(figure)

    def _measures(self, contacts: Table, case: Case) -> list[tuple[str, str, float]]:
        """Columns of these contacts, each with its label and its scale: impacts, time in contact, largest force."""
        time, force = unit_of(case.units, "time"), with_unit(case.units, "largest force", "force")
        per, span = (time or "unit of time", "t_end") if "t_end" in contacts else ("period", "periods")
        measures = [("count", f"impacts per {per}", float(contacts[span].iloc[0])),
                    ("fraction", "time in contact, %", 0.01), ("peak_force", force, 1.0)]  # fmt: skip
        # A rigid stop has impulses and no largest force: 0 where nothing touches it.
        stops = [case.system(self.form).contacts[int(i)].stops for i in contacts.contact_number.unique()]
        return measures[: 2 if all(stop.rigid for stop in stops) else 3]


def _transient(system: System, periods: int) -> str:
    """A sentence where a free vibration of the case outlasts the transient; stops alone may damp as well."""
    stops = (contact.stops for contact in system.contacts)
    if not system.damped and any(x.damping or x.dissipation or x.restitution not in (None, 1.0) for x in stops):
        return ""
    natural = modes(system)
    half = 0.5 * natural.damping
    # Of an overdamped motion the slower of its two decays; a rigid motion has none.
    decay = np.maximum(half - np.sqrt(np.maximum(half**2 - natural.omega**2, 0.0)), 0.0)
    slowest = float(np.min(decay[natural.omega > 0.0], initial=np.inf))
    left = float(np.exp(-slowest * periods * (drive_period(system) or 0.0)))
    text = f" Without contact {percent(left)} of a free vibration outlasts that: another start gives another answer."
    return text if left > SAME else ""


def _rows(point: Row, named: Row, many: Ensemble, i: int) -> list[Row]:
    """Return the rows of member i after the transient."""
    if np.isfinite(many.diverged[i]):
        return [named | {"lost": str(Diverged(point["method"], many.diverged[i], "use a smaller dt"))}]
    rows = list[Row]()
    for place, seen in enumerate(many.contacts):
        numbers = {"count": seen.impact_count, "fraction": seen.fraction, "peak_force": seen.peak_force}
        rows.append(named | {"kind": "contact", "contact_number": place} | {x: y[i].item() for x, y in numbers.items()})
    if "t_end" not in point:
        tips, speeds = (x[i, point["transient"] + 1 :] for x in (many.tip, many.tip_velocity))
        # u alone may be near 0 at these times: the response to a sine without damping is.
        size = float(np.max(np.hypot(tips, speeds * float(many.t[1]) / (2.0 * np.pi))))
        section = named | {"kind": "section", "size": size}
        rows += [section | {"period": n, "tip": tip} for n, tip in enumerate(tips.tolist(), point["transient"] + 1)]
    return rows


def _places(contacts: Table) -> list[tuple[str, Table]]:
    """The rows of each contact under its place, "" for the only one."""
    groups = [(n, rows) for n, rows in contacts.groupby("contact_number")] if len(contacts) else []
    return [("" if len(groups) == 1 else f" at contact {n:g}", rows) for n, rows in groups]


def sections(table: Table, parameter: str) -> dict[float, Array]:
    """The section of every value of the parameter, in order of value."""
    rows = table[table.kind == "section"] if "kind" in table else table[:0]
    return {float(value): group.tip.to_numpy(float) for value, group in rows.groupby(parameter)}


def repeats_after(section: Array, size: float) -> int | None:
    """The least p <= LONGEST with u(n + p) = u(n) to SAME of ``size`` all along the section; 0 for none, None where the
    section has too few points to rule out one."""
    for p in range(1, min(LONGEST, len(section) - 1) + 1):
        if np.max(np.abs(section[p:] - section[:-p])) <= SAME * size:
            return p
    return 0 if len(section) > LONGEST else None


def values_of(parameter: str, values: Sequence[float] | None, count: int, period: float | None) -> list[float]:
    """The values of a parameter, by default ``count`` drive frequencies from 0.7 to 1.3 of the case's."""
    if values is None and parameter == "frequency" and period is not None:
        values = (np.linspace(0.7, 1.3, count) * 2.0 * np.pi / period).tolist()
    if not values:
        remedy = "for example 8:14:400 or 8,9,10.5; a case without a period has no frequency to vary"
        raise InputError("values", values, f"be given for {parameter}", remedy)
    return [number(parameter, x) for x in values]


def setup_of(
    system: System, name: str, value: float, dt: float | None = None, whole: float | None = None
) -> tuple[System, float, float]:
    """System with one value of a parameter, period T of its drive, and the step nearest to dt that divides it, 0 of the
    exact solution; whole: t_end of a case without a period, in its place. Raises InputError for a value that is not
    possible."""
    system = with_values(system, {name: value})
    period = drive_period(system) if whole is None else whole
    assert period is not None
    if dt and dt > 0.5 * period:
        rule = f"be at most {0.5 * period:.6g}, half a period of the drive or half the run"
        raise InputError("dt", dt, rule, "take a smaller dt")
    return system, period, period / round(period / dt) if dt else 0.0


def drive_period(system: System) -> float | None:
    """T = 2 pi/a of the frequency that drives the system; None for none or several, and where a record drives it."""
    drive = system.drive
    return 2.0 * np.pi / drive.frequencies[0] if len(drive.frequencies) == 1 and not drive.records else None


QUANTITIES = {  # of parameters, by their path without numbers or by its last name
    "stiffness": "bending stiffness", "viscosity": "bending viscosity", "stops.stiffness": "stop stiffness",
    "stops.damping": "stop damping", "stops.dissipation": "stop dissipation", "frequency": "frequency",
    "clearance": "length", "lower": "length", "upper": "length", "position": "length", "base.amplitude": "length",
    "mass_per_length": "mass per length",
}  # fmt: skip


def named(case: Case, path: str) -> str:
    """A parameter on an axis, with its unit where it is known."""
    plain = re.sub(r"\[\d+\]", "", path).removeprefix("contacts.")  # of any contact
    quantity = QUANTITIES.get(plain) or QUANTITIES.get(plain.rpartition(".")[2], "")
    if quantity.startswith("stop") and any(c.stops.exponent != 1.0 for c in case.system(case.forms[0]).contacts):
        quantity = ""  # a force per length to the exponent
    return with_unit(case.units, path, quantity)
