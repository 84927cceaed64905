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
from ..figures.chart import Figure, dashed, log_scale, look, tip_text
from ..files.cases import Case
from ..march.integrate import integrate_ensemble
from ..measures.report import percent
from ..model.members import paths_of, value_at, with_values
from ..model.modes import modes
from ..model.problem import PointLoad
from ..model.system import System
from ..model.time_functions import Harmonic
from ..references import substitute
from ..references.ensemble import reference_ensemble
from ..references.exact.solution import refuse
from ..schemes import RigidScheme, Scheme
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

    One motion for each value of ``parameter``. The ``values`` are in the units of the case; by default they are
    ``count`` drive frequencies from 0.7 to 1.3 of the case's. Of each motion ``periods`` of the drive are recorded,
    after ``transient`` periods. By default these are 60 after 100. If several frequencies drive the system, the period
    is that of the drive whose parameter is varied.
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
    count: int = option(200, "number of drive frequencies if no values are given", least=1)

    height: ClassVar = 9.4

    def points(self, case: Case) -> list[Row]:
        """Batches of values that march together, after the checks of the options."""
        parameter, nominal, method = self.parameter, case.system(self.form), self.method
        if method is None:
            runs = [run for run, *_ in case.runs if not nominal.rigid or isinstance(run, RigidScheme)]
            method = runs[0] if runs else EXACT
        scheme = scheme_of(case, method)
        method = EXACT if scheme is None else next(iter(base.chosen(case, [method])))
        # Without a period of the drive, every value is one run from 0 to t_end, without sections.
        period = drive_period(nominal, parameter)
        once = period is None
        if once:
            nominal.drive.require_samples(case.t_end)
        if once and self.values is None:
            paths = sorted(paths_of(nominal), key=lambda path: "[" not in path)  # loads and contacts
            remedy = f"name it with its values, --parameter NAME --values 0.5:2:16, such as {', '.join(paths[:3])}"
            raise InputError("parameter", parameter, "be another one for a case without a period", remedy)
        values = values_of(parameter, self.values, self.count, period)
        transient = 0 if once else self.transient
        shared: Row = {"method": method, "dt": None if method == EXACT else case.dt,
                       "periods": 1 if once else self.periods, "transient": transient}  # fmt: skip
        shared |= {"t_end": case.t_end} if once else {}
        # Bad values are refused here, at the ends of the ranges; what a scheme refuses in between is a row.
        ends = [setup_of(nominal, parameter, x, shared["dt"], shared.get("t_end")) for x in (min(values), max(values))]
        if scheme is None and transient and all(substitute(system, transient * T) for system, T, _ in ends):
            try:
                refuse(ends[0][0], transient * ends[0][1])
            except InputError as error:
                remedy = "name a scheme as method, or transient=0: other solvers record contacts from the start only"
                raise InputError(error.field, error.value, error.rule, remedy) from None
        size = -(-len(values) // BATCHES)
        return [{**shared, "values": values[i : i + size]} for i in range(0, len(values), size)]

    def run(self, case: Case, values: list[float], **point: Any) -> list[Row]:
        """Rows of every value of this point; a value that is refused gives a row with the reason."""
        system, scheme = case.system(self.form), scheme_of(case, self.method or point["method"])
        rows: list[Row] = []
        groups: dict[tuple[float, float], list[tuple[Row, System]]] = {}
        for value in values:
            named: Row = {self.parameter: value}
            try:
                varied, period, dt = setup_of(system, self.parameter, value, point["dt"], point.get("t_end"))
                groups.setdefault((period, dt), []).append((named | ({"dt": dt} if scheme else {}), varied))
            except InputError as error:
                rows.append(named | {"lost": str(error)})
        return rows + [row for times, group in groups.items() for row in self._together(point, scheme, times, group)]

    def _together(
        self, point: Row, scheme: Scheme | None, times: tuple[float, float], group: list[tuple[Row, System]]
    ) -> list[Row]:
        """Rows of values of one period and step, which march together, with the tip at every period; where one fails,
        of each by itself."""
        (period, dt), systems = times, [system for _, system in group]
        t = period * np.arange(point["transient"] + point["periods"] + 1)
        end, since = float(t[-1]), float(t[point["transient"]])
        try:
            if scheme is None:
                many = reference_ensemble(systems[0], end, systems, t, since=since)
            else:
                every = round(period / dt)
                many = integrate_ensemble(systems[0], scheme, dt, end, systems, self.contact, every, since=since)
            return [row for i, (named, _) in enumerate(group) for row in _rows(point, named, many, i)]
        except (InputError, SolverFailure) as error:
            if len(group) > 1:
                return [row for one in group for row in self._together(point, scheme, times, [one])]
            return [group[0][0] | {"lost": str(error)}]

    def answer(self, table: Table, case: Case) -> Answer:
        """The range of impact counts and peak forces over the values, and where the motion is periodic."""
        first, small = table.iloc[0], list[Row]()
        for place, contacts in _places(table[table.kind == "contact"]):
            for name, label, scale in self._measures(contacts, case):
                known = contacts[contacts[name].notna()]
                if len(known):
                    least, most = (
                        f"{row[name] / scale:.4g} at {self.parameter} {row[self.parameter]:.5g}"
                        for row in (known.loc[known[name].idxmin()], known.loc[known[name].idxmax()])
                    )
                    small.append({"over all values": label + place, "least": least, "most": most})
        notes = f"{self.periods} periods of the drive after {self.transient}."
        if "t_end" in table:
            notes = f"Single runs, t = 0 to {first.t_end:g}."
        else:
            notes += _transient(case.system(self.form), self.transient, self.parameter)
        most = [f"most {x['over all values']}: {x['most']}" for x in small if "impacts" in x["over all values"]]
        values = table[self.parameter]
        verdict = "; ".join(_periodicity(table, self.parameter) or most) or "no contact"
        return Answer(
            f"{first.method} over {self.parameter} {values.min():g} to {values.max():g}: {verdict}.",
            pd.DataFrame(small),
            notes,
        )

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
        width, places = 0.7 if table[self.parameter].nunique() <= 400 else 0.0, _places(contacts)  # more are a band
        for axis, (quantity, label, scale) in zip(axes[len(axes) - len(measures) :], measures, strict=True):
            for i, (place, rows) in enumerate(places):
                style = method | {"linestyle": dashed(i), "lw": width, "label": place.strip()}
                axis.plot(rows[self.parameter], rows[quantity] / scale, **style)
            if len(places) > 1:
                axis.legend(frameon=False, fontsize=8)
            axis.set(title=label)
            axis.set_ylim(bottom=0.0)
        axes[-1].set_xlabel(named(case, self.parameter))
        if 0.0 < LOG_RANGE * table[self.parameter].min() < table[self.parameter].max():
            log_scale(axes[-1], y=False)

    def _measures(self, contacts: Table, case: Case) -> list[tuple[str, str, float]]:
        """Columns of these contacts, each with its label and its scale: impacts, time in contact, largest force."""
        per, over = "period", float(contacts.periods.iloc[0])
        if "t_end" in contacts:
            per, over = unit_of(case.units, "time") or "unit of time", float(contacts.t_end.iloc[0])
        measures = [("count", f"impacts per {per}", over), ("fraction", "time in contact, %", 0.01)]
        # A rigid stop has impulses and no largest force: 0 where nothing touches it.
        system = case.system(self.form)
        if not all(system.contacts[int(i)].stops.rigid for i in contacts.contact_number.unique()):
            measures.append(("peak_force", with_unit(case.units, "largest force", "force"), 1.0))
        return measures


def _transient(system: System, periods: int, parameter: str) -> str:
    """A sentence where a free vibration of the case outlasts the transient; stops alone may damp as well."""
    if not system.damped:
        stops = (contact.stops for contact in system.contacts)
        lossy = any(x.damping or x.dissipation or x.restitution not in (None, 1.0) for x in stops)
        return "" if lossy else " Nothing damps the case: another start gives another answer."
    natural = modes(system)
    ratio = np.maximum(natural.damping_ratio, 0.0)  # NaN for a rigid motion
    over = np.sqrt(np.maximum(ratio**2 - 1.0, 0.0))
    # Of an overdamped motion the slower of its two decays.
    decay = natural.omega * np.where(over > 0.0, 1.0 / (ratio + over), ratio)
    slowest = float(np.min(decay[np.isfinite(decay)], initial=np.inf))
    left = float(np.exp(-slowest * periods * (drive_period(system, parameter) or 0.0)))
    if left <= SAME:
        return ""
    return f" Without contact {percent(left)} of a free vibration is left after that transient: raise transient."


def _rows(point: Row, named: Row, many: Ensemble, i: int) -> list[Row]:
    """Return the rows of member i after the transient."""
    if np.isfinite(many.diverged[i]):
        return [named | {"lost": str(Diverged(point["method"], many.diverged[i], "use a smaller dt"))}]
    rows: list[Row] = []
    for place, seen in enumerate(many.contacts):
        statistics = {"count": seen.impact_count[i], "fraction": seen.fraction[i], "peak_force": seen.peak_force[i]}
        rows.append(named | {"kind": "contact", "contact_number": place} | {n: x.item() for n, x in statistics.items()})
    if "t_end" not in point:
        tips, speeds = (x[i, point["transient"] + 1 :] for x in (many.tip, many.tip_velocity))
        # u alone may be near 0 at these times: the response to a sine without damping is.
        named = named | {"size": float(np.max(np.hypot(tips, speeds * float(many.t[1]) / (2.0 * np.pi))))}
        section = enumerate(tips.tolist(), point["transient"] + 1)
        rows += [named | {"kind": "section", "period": n, "tip": tip} for n, tip in section]
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


def _periodicity(table: Table, parameter: str) -> list[str]:
    """Sentence with the number of values at which the tip repeats itself; empty without sections."""
    by_value = sections(table, parameter)
    if not by_value:
        return []
    # The size of the motion at every value: the largest of |u| and |u'|/w in its section, w the drive's frequency.
    size = table[table.kind == "section"].groupby(parameter)["size"].max()
    size = size.clip(lower=REST * size.max())
    repeats = [repeats_after(section, size[value]) for value, section in by_value.items()]
    several, short = sum(p is not None and p > 1 for p in repeats), repeats.count(None)
    words = [
        f"the tip repeats itself every period of the drive at {repeats.count(1)} of {len(by_value)} values, every 2 to "
        f"{LONGEST} periods at {several}, and not at all at {repeats.count(0)} (to {SAME:g})"
    ]
    if short:
        words.append(f"{table.periods.iloc[0]:g} periods are too few to tell at {short}: {LONGEST + 1} would do")
    return words


# ---------------------------------------------------------------- parameters, also of orbits


def values_of(parameter: str, values: Sequence[float] | None, count: int, period: float | None) -> list[float]:
    """The values of a parameter, by default ``count`` drive frequencies from 0.7 to 1.3 of the case's."""
    if values is None and parameter == "frequency" and period is not None:
        values = (np.linspace(0.7, 1.3, count) * 2.0 * np.pi / period).tolist()
    if not values:
        raise InputError("values", values, f"be given for {parameter}", "for example 8:14:400 or 8,9,10.5")
    return [number(parameter, x) for x in values]


def scheme_of(case: Case, method: Any) -> Scheme | None:
    """The scheme of a method, None for the exact solution."""
    return None if method == EXACT else next(iter(base.chosen_schemes(case, [method]).values()))


def setup_of(
    system: System, name: str, value: float, dt: float | None = None, whole: float | None = None
) -> tuple[System, float, float]:
    """System with one value of a parameter, period T of its drive, and the step nearest to dt that divides it, 0 of the
    exact solution; whole: t_end of a case without a period, in its place. Raises InputError for a value that is not
    possible."""
    system = with_values(system, {name: value})
    period = drive_period(system, name) if whole is None else whole
    assert period is not None
    if dt is None:
        return system, period, 0.0
    if dt > 0.5 * period:
        half = f"{'half a period of the drive' if whole is None else 'half the run'}, {0.5 * period:.6g}"
        raise InputError("dt", dt, f"be at most {half}", "take a smaller dt")
    return system, period, period / round(period / dt)


def drive_period(system: System, parameter: str = "frequency") -> float | None:
    """T = 2 pi/a of the frequency that drives the system; of several, that of the drive whose parameter is varied.

    None where no drive has a period, or none of several is meant; or where a record drives the system.
    """
    drive = system.drive
    if drive.records:
        return None
    if len(drive.frequencies) == 1:
        return 2.0 * np.pi / drive.frequencies[0]
    try:
        return 2.0 * np.pi / value_at(system, f"{parameter.rpartition('.')[0]}.frequency")
    except LookupError:
        return None


QUANTITIES = {  # of parameters, by their path without numbers or by its last name
    "stiffness": "bending stiffness", "viscosity": "bending viscosity", "stops.stiffness": "stop stiffness",
    "stops.damping": "stop damping", "stops.dissipation": "stop dissipation", "frequency": "frequency",
    "clearance": "length", "lower": "length", "upper": "length", "position": "length", "base.amplitude": "length",
    "stops.motion.amplitude": "length",
}  # fmt: skip


def named(case: Case, path: str) -> str:
    """A parameter on an axis, with its unit where it has one."""
    plain = re.sub(r"\[\d+\]", "", path).removeprefix("contacts.")  # of any contact
    quantity = QUANTITIES.get(plain) or QUANTITIES.get(plain.rpartition(".")[2], "")
    if plain.startswith("loads") and plain.endswith("amplitude") and case.problem is not None:
        point = {isinstance(load, PointLoad) for load in case.problem.loads if isinstance(load.time, Harmonic)}
        quantity = "force" if point == {True} else "force per length" if point == {False} else ""
    if quantity.startswith("stop") and any(c.stops.exponent != 1.0 for c in case.system(case.forms[0]).contacts):
        quantity = ""  # a force per length to the exponent
    return with_unit(case.units, path, quantity)
