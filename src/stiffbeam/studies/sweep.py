"""Sweeps: the tip once a period against any parameter; impacts and forces over one or two of them.

    section: u(1, n T), n = transient + 1 .. transient + periods, T the period of the drive

The step is the one nearest to the given dt that divides T. So the section consists of steps of the
scheme: an interpolation between steps would smear its periodic motions. The contact is recorded over the
same periods. Values that leave step and linear part alone (amplitude, clearance, stop stiffness) march as
one ensemble. Without damping the exact motion depends on its initial data for ever; a scheme's section also depends on
its numerical dissipation.

A case has no period without a drive, with several frequencies, and if samples drive it. It runs once from 0 to its
t_end at every value, with impacts per unit of time and without sections.

With ``start="last"`` every value begins with the state in which the motion at the value before ended, through the
values and back. The drive is in the same phase there, since a run lasts whole periods; drives of other frequencies
begin anew. Coexisting motions then appear as two branches, one for each direction.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Annotated, Any

import numpy as np

from ..basics.arrays import Array, content
from ..basics.validation import InputError, integer, near, number, one_of, positive
from ..figures.chart import COLOURS, Axis, Curve, Map, Panel, Picture, column, dashed, look, tip_name, tip_symbol
from ..files.cases import Case
from ..march.ensemble import integrate_ensemble
from ..march.integrate import Plan
from ..measures.report import percent
from ..model.members import paths_of
from ..model.natural_modes import modes
from ..model.system import System
from ..model.time_functions import Drive, covered
from ..references import best_reference, substitute
from ..references.ensemble import reference_ensemble
from ..references.exact.piecewise import refuse
from ..schemes.scheme import RigidScheme
from ..trajectory.ensemble import Ensemble
from ..trajectory.trajectory import Diverged, SolverFailure
from .common import Form, Treatment, label_of, scheme_of
from .interface import Answer, Point, Records, Row, Rows, Selection, by_contact, declared
from .parameters import (
    EXACT,
    IN_STEP,
    Couple,
    Setup,
    Values,
    couplings,
    drive_period,
    is_path,
    method_of,
    named,
    names_of,
    parameters_of,
    quantity_of,
    setup_of,
)

LONGEST = 8  # periods of the drive that a motion may take to repeat itself and still be called periodic
SAME = 1e-3  # of the motion's size at each value: section points closer than this are one
REST = 1e-6  # of the largest motion: a smaller one has this size
BATCHES = 16  # at least, so that processes end together
# Seconds with 25 cells on one core: what a batch is cut to, so that a kill loses little; setting a scheme
# up, a step, a period of the drive of the exact solution, the last two for compliant and for rigid stops.
BATCH, SETTING_UP, STEP, EXACT_PERIOD = 1.0, 0.02, (3e-8, 3e-7), (6e-3, 3e-2)
EXACT_SAMPLE = 3e-4  # of the exact solution, for every sample of a record
PERIODS, TRANSIENT, BUDGET = 60, 100, 20.0  # by default; as many as about so many seconds allow, LEAST of each
LEAST = LONGEST + 2
STARTS = ("case", "last")
LAST, WAYS = "last", ("there", "back")


def points(
    case: Case,
    *,
    parameter: Annotated[
        str,
        "frequency, amplitude, clearance, stop-stiffness, stiffness, viscosity, cells, dt, alpha, or a path: "
        "stops[0].damping",
    ] = "frequency",
    values: Values = None,
    second: Annotated[str | None, "another parameter: impacts and forces on a grid"] = None,
    second_values: Annotated[Sequence[float] | None, "as --values"] = None,
    couple: Couple = None,
    method: Annotated[
        str | None, "a scheme, or exact; default: the case's first scheme that has a law for its stops"
    ] = None,
    form: Form,
    contact: Treatment = "implicit",
    dt: Annotated[float, "time step, rounded to one that divides the period; default: the case's"],
    periods: Annotated[int | None, "periods of the drive to record; default: 60, fewer if these take long"] = None,
    transient: Annotated[int | None, "periods of the drive before the recorded ones; default: 100, or fewer"] = None,
    count: Annotated[int, "number of drive frequencies if no values are given"] = 200,
    start: Annotated[
        str, 'first state at each value: "case", or "last", that of the value before, through the values and back'
    ] = "case",
) -> list[Point]:
    """One motion for each value of ``parameter``; with ``second`` impacts and forces on a grid, without a diagram.

    The ``values`` are in the units of the case; by default they are ``count`` drive frequencies from 0.7 to 1.3 of the
    case's. Of each motion ``periods`` of the drive are recorded, after ``transient`` periods. By default these are 60
    after 100, or as many as take about 20 s of processor time, at least 10 after 10. If several frequencies drive the
    system, the period is that of the drive whose parameter is varied. By ``couple`` other parameters follow the first:
    each is a formula in x, the value of ``parameter``. With ``start`` "last" one process goes through the values in
    their order and back, each from the last state of the one before. Limitation: drives of other frequencies begin anew
    at every value.
    """
    one_of("start", start, STARTS)
    if method is None:
        runs = [label_of(run) for run, *_ in case.runs]
        rigid = case.system(form).rigid
        method = next((run for run in runs if not rigid or isinstance(scheme_of(run), RigidScheme)), EXACT)
    method = method if method == EXACT else label_of(method)
    for name, periods_given, least in (("periods", periods, 1), ("transient", transient, 0)):
        if periods_given is not None:
            integer(name, periods_given, least)
    # Without a period of the drive, every value is one run from 0 to t_end, without sections.
    period = drive_period(case.system(form), parameter)
    once = period is None
    if once:
        covered(case.system(form).time_functions, case.t_end)
        for name, stated in (("periods", periods), ("transient", transient)):
            if stated is not None:
                remedy = f"it runs once from 0 to the case's t_end = {case.t_end:g}"
                raise InputError(name, stated, "be left out for a case without a period", remedy)
        if parameter == "frequency" and values is None:
            paths = sorted(paths_of(case.system(form)), key=lambda path: "[" not in path)  # loads and contacts
            known = ", ".join(paths[:3])
            remedy = f"name it with its values, --parameter NAME --values 0.5:2:16, such as {known}"
            raise InputError("parameter", parameter, "be another one for a case without a period", remedy)
    if values is None and parameter == "frequency":
        assert period is not None  # refused above
        drive = 2.0 * np.pi / period
        values = np.linspace(0.7 * drive, 1.3 * drive, count).tolist()
    if second is None and second_values is not None:
        raise InputError("second_values", second_values, "be left out without second", "name the second parameter")
    axes = {parameter: values} if second is None else {parameter: values, second: second_values}
    if second is not None and not case.has_stops:
        remedy = "vary one parameter only, or give the case stops"
        raise InputError("case", case.name, "have stops for a grid of two parameters", remedy)
    if start == LAST and (second is not None or once or parameter == "cells"):
        rule = "be used with one parameter of a driven case, on one grid"
        raise InputError("start", start, rule, f"leave it out, or start={STARTS[0]}")
    if second == parameter:
        raise InputError("second", second, "be another parameter", "give the grid two different parameters")
    follow = couplings(couple)
    if twice := [name for name in follow if name in axes]:
        raise InputError("couple", twice[0], "be another parameter than those varied", "leave it out of couple")
    known = parameters_of(method)
    for name in (*axes, *follow):
        if name not in known and not is_path(name):
            remedy = f"{near(name, known)}, or a path such as stops[0].upper"
            raise InputError("parameter", name, f"be one of the case or of {method}", remedy)
    for name, along in axes.items():
        if along is None or not len(along):
            raise InputError("values", along, f"be given for {name}", "for example 8:14:400 or 8,9,10.5")
    grid = [[number(name, x) for x in along] for name, along in axes.items() if along is not None]
    shared = {
        "parameter": parameter, "second": second, "coupled": list(follow), "method": method,
        "form": form, "contact": contact,
        "dt": None if method == EXACT else positive("dt", dt),
    } | ({"t_end": case.t_end} if once else {})  # fmt: skip
    # Bad values are refused here, at the ends of the ranges; what a scheme refuses in between is a row.
    base = case.system(form)

    def whole(value: Sequence[float]) -> list[float]:
        return [*value, *(number(name, rule(value[0])) for name, rule in follow.items())]

    scheme = method_of(shared)
    ends = [
        setup_of(base, shared, whole(value), scheme) for value in product(*([min(axis), max(axis)] for axis in grid))
    ]
    together = all(name in IN_STEP for name in names_of(shared))
    # Fewer periods by default where all values together would take longer than BUDGET.
    whole_cost = len(list(product(*grid))) * max(_seconds(setup, PERIODS + TRANSIENT) for setup in ends)
    share = min(1.0, BUDGET / whole_cost)
    if once:
        periods, transient = 1, 0
    periods = max(LEAST, int(share * PERIODS)) if periods is None else periods
    transient = max(LEAST, int(share * TRANSIENT)) if transient is None else transient
    if scheme is None and transient and all(substitute(x.system, transient * x.period) for x in ends):
        try:
            refuse(ends[0].system, transient * ends[0].period)
        except InputError as error:
            remedy = "name a scheme as method, or transient=0: an adaptive solver records contacts from the start only"
            raise InputError(error.field, error.value, error.rule, remedy) from None
    shared |= {"periods": periods, "transient": transient}
    seconds = max(_seconds(setup, periods + transient) + (0.0 if together else SETTING_UP) for setup in ends)
    if second is not None and parameter in IN_STEP:  # what marches together stands together
        wanted = [whole([x, y]) for y in grid[1] for x in grid[0]]
    else:
        wanted = [whole(value) for value in product(*grid)]
    if start == LAST:
        return [{**shared, "values": [*wanted, *wanted[::-1]], "start": LAST}]
    # Batches of about BATCH seconds, and at least BATCHES of them.
    size = max(1, min(int(BATCH / seconds), -(-len(wanted) // BATCHES)))
    return [{**shared, "values": wanted[i : i + size]} for i in range(0, len(wanted), size)]


def _seconds(setup: Setup, periods: int) -> float:
    rigid = setup.system.rigid
    if setup.scheme is None:
        samples = int(np.sum(Drive.of(setup.system).edges < setup.period))
        return (EXACT_PERIOD[rigid] + EXACT_SAMPLE * samples) * periods
    return STEP[rigid] * periods * setup.period / setup.dt * max(1.0, setup.system.size / 25)


def evaluate(case: Case, point: Point) -> list[Row]:
    """Rows of every value and method of this point; a value that is refused gives a row with the reason."""
    rows: list[Row] = []
    groups: dict[tuple[Any, ...], list[tuple[Row, Setup]]] = {}
    system, scheme = case.system(point["form"]), method_of(point)
    if point.get("start") == LAST:
        return _continued(system, point)
    decays: dict[tuple[Any, ...], float] = {}
    for value in point["values"]:
        named = dict(zip(names_of(point), value, strict=True))
        try:
            setup = setup_of(system, point, value, scheme)
            row = named | ({"dt": setup.dt} if setup.scheme else {}) | _free(setup, point, decays)
            groups.setdefault(setup.kind, []).append((row, setup))
        except InputError as error:
            rows.append(named | {"refused": str(error)})
    for group in groups.values():
        try:
            many = _march(point, [setup for _, setup in group])
            rows += [row for i, (named, _) in enumerate(group) for row in _rows(point, named, many, i)]
        except (InputError, SolverFailure) as error:
            word = "refused" if isinstance(error, InputError) else "failed"
            rows += [named | {word: str(error)} for named, _ in group]
    return rows


def _continued(system: System, point: Point) -> list[Row]:
    """Rows of the values one after the other, each from the last state of the one before."""
    rows: list[Row] = []
    decays: dict[tuple[Any, ...], float] = {}
    state: tuple[Array, Array] | None = None
    for k, value in enumerate(point["values"]):
        row: Row = dict(zip(names_of(point), value, strict=True)) | {"direction": WAYS[2 * k >= len(point["values"])]}
        try:
            setup = setup_of(system, point, value, method_of(point))
            # The state is that at the end of the value before; the first value starts as the case does.
            if state is not None:
                setup = replace(setup, system=replace(setup.system, q0=state[0], v0=state[1], origin=None))
            row |= ({"dt": setup.dt} if setup.scheme else {}) | _free(setup, point, decays)
            many = _march(point, [setup])
            rows += _rows(point, row, many, 0)
            if np.isnan(many.diverged[0]):
                state = _last(point, setup, float(many.t[-1]))
        except (InputError, SolverFailure) as error:
            rows.append(row | {"refused" if isinstance(error, InputError) else "failed": str(error)})
    return rows


def _free(setup: Setup, point: Point, decays: dict[tuple[Any, ...], float]) -> Row:
    """Entries of a row on free motions: ``lossless`` where nothing damps the system, and ``left``, the share of the
    amplitude of the slowest that is left after the transient, 0 where no motion is damped.

    ``decays`` keeps the slowest decay of each linear part."""
    if "t_end" in point:
        return {}
    system, stops = setup.system, [contact.stops for contact in setup.system.contacts]
    lossy = any(x.damping or x.dissipation or x.restitution not in (None, 1.0) for x in stops)
    if not system.damped:
        return {"lossless": not lossy, "left": 0.0}
    linear = tuple(content(matrix) for matrix in (system.mass, system.damping, system.stiffness))
    if linear not in decays:
        natural = modes(system)
        ratio = np.maximum(natural.damping_ratio, 0.0)  # NaN for a rigid motion
        over = np.sqrt(np.maximum(ratio**2 - 1.0, 0.0))
        # Of an overdamped motion the slower of its two decays.
        decay = natural.omega * np.where(over > 0.0, 1.0 / (ratio + over), ratio)
        decays[linear] = float(np.min(decay[np.isfinite(decay)], initial=np.inf))
    return {"lossless": False, "left": float(np.exp(-decays[linear] * setup.period * point["transient"]))}


def _last(point: Point, setup: Setup, end: float) -> tuple[Array, Array]:
    """(q, q') at the end of the run of a setup."""
    if setup.scheme is None:
        state_at = best_reference(setup.system, end).state_at
        assert state_at is not None
        q, v = state_at(np.array([end]))
        return q[0], v[0]
    plan = Plan.of(setup.system, setup.scheme, setup.dt, end, point["contact"], 1)
    *_, (_, q, v, _) = plan.states(setup.system)
    return q[-1], v[-1]


def _march(point: Point, setups: list[Setup]) -> Ensemble:
    """Setups of one kind, with the tip at every period."""
    first, systems = setups[0], [setup.system for setup in setups]
    t = first.period * np.arange(point["transient"] + point["periods"] + 1)
    since = float(t[point["transient"]])
    if first.scheme is None:
        return reference_ensemble(first.system, float(t[-1]), systems, t, since=since)
    every = round(first.period / first.dt)
    contact = point["contact"]
    return integrate_ensemble(first.system, first.scheme, first.dt, float(t[-1]), systems, contact, every, since=since)


def _rows(point: Point, named: Row, many: Ensemble, i: int) -> list[Row]:
    """Return the rows of member i after the transient."""
    if np.isfinite(many.diverged[i]):
        return [named | {"failed": str(Diverged(point["method"], many.diverged[i], "use a smaller dt"))}]
    rows: list[Row] = []
    for place, seen in enumerate(many.contacts, 1):
        statistics = {"count": seen.impact_count[i], "fraction": seen.fraction[i], "peak_force": seen.peak_force[i]}
        rows.append(named | {"kind": "contact", "contact_number": place} | {n: x.item() for n, x in statistics.items()})
    if point["second"] is None and "t_end" not in point:
        tips, speeds = (x[i, point["transient"] + 1 :] for x in (many.tip, many.tip_velocity))
        # u alone may be near 0 at these times: the response to a sine without damping is.
        named = named | {"size": float(np.max(np.hypot(tips, speeds * float(many.t[1]) / (2.0 * np.pi))))}
        section = enumerate(tips.tolist(), point["transient"] + 1)
        rows += [named | {"kind": "section", "period": n, "tip": tip} for n, tip in section]
    return rows


def _rigid(system: System, contacts: Rows) -> bool:
    """True for the rows of a rigid stop, which has impulses and no largest force: 0 where nothing touches it."""
    return bool(contacts) and system.contacts[int(contacts[0]["contact_number"]) - 1].stops.rigid


def _ways(rows: Rows) -> Mapping[str, Rows]:
    """The rows of each direction of a continued sweep; all of them under "" otherwise."""
    ways = {way: [row for row in rows if row.get("direction") == way] for way in WAYS}
    return ways if any(ways.values()) else {"": rows}


def sections(rows: Rows) -> dict[float, Array]:
    """The section of every value of the parameter, in order of value."""
    tips: dict[float, array[float]] = {}
    for row in rows:
        if row["kind"] == "section":
            tips.setdefault(row[row["parameter"]], array("d")).append(row["tip"])
    return {value: np.array(tips[value]) for value in sorted(tips)}


def sizes(rows: Rows) -> dict[float, float]:
    """The size of the motion at every value: the largest of |u| and |u'|/w in its section, w the drive's frequency."""
    every: dict[float, float] = {}
    for row in rows:
        if row["kind"] == "section":
            size = row["size"] if "size" in row else abs(row["tip"])  # journals of former versions
            every[row[row["parameter"]]] = max(size, every.get(row[row["parameter"]], 0.0))
    least = REST * max(every.values(), default=0.0)
    return {value: max(size, least) for value, size in every.items()}


def repeats_after(section: Array, size: float) -> int | None:
    """The least p <= LONGEST with u(n + p) = u(n) to SAME of ``size`` all along the section; 0 for none, None where the
    section has too few points to rule out one."""
    for p in range(1, min(LONGEST, len(section) - 1) + 1):
        if np.max(np.abs(section[p:] - section[:-p])) <= SAME * size:
            return p
    return 0 if len(section) > LONGEST else None


def answer(rows: Rows, case: Case) -> Answer:
    """The range of impact counts and peak forces over the values, and where the motion is periodic."""
    units, first = case.units, rows[0]
    names = [name for name in (first["parameter"], first["second"]) if isinstance(name, str)]

    def value(name: str, text: str) -> str:
        return f"{name} {units.measure(text, quantity_of(case, name))}"

    counted, over = _rate(rows, case)
    columns = (
        ("count", counted, "", over),
        ("fraction", "time in contact, %", "", 0.01),
        ("peak_force", "largest force", "force", 1.0),
    )
    table, system = [], case.system(first["form"])
    for place, contacts in by_contact([r for r in rows if r["kind"] == "contact"]).items():
        for name, words, quantity, scale in columns[: 2 if _rigid(system, contacts) else 3]:
            known = [r for r in contacts if np.isfinite(r[name])]
            ends = [pick(known, key=lambda r: r[name]) for pick in (min, max)] if known else []
            texts = [
                f"{units.measure(row[name] / scale, quantity, '.4g')} at "
                + ", ".join(value(varied, f"{row[varied]:.5g}") for varied in names)
                for row in ends
            ]
            table += [{"over all values": words + place, "least": texts[0], "most": texts[1]}] if texts else []
    notes = f"{first['periods']:g} periods of the drive after {first['transient']:g}."
    if "t_end" in first:
        notes = f"Single runs, t = 0 to {units.measure(first['t_end'], 'time', 'g')}."
    free = {tuple(row[name] for name in names): (row.get("lossless"), row.get("left", 0.0)) for row in rows}
    lossless, left = (list(x) for x in zip(*free.values(), strict=True))
    if any(lossless):
        where = "" if all(lossless) else f" at {sum(map(bool, lossless))} of {len(free)} values"
        notes += f" Nothing damps this system{where}, so its transient never ends: another start gives another answer."
    if max(left) > SAME:
        notes += (
            f" Without contact {percent(max(left))} of a free vibration is left after that transient, so slow changes"
            " may look like longer periods: raise transient."
        )
    most = [f"most {x['over all values']}: {x['most']}" for x in table if "impacts" in x["over all values"]]
    ranges = (value(x, f"{min(r[x] for r in rows):g} to {max(r[x] for r in rows):g}") for x in names)
    verdict = "; ".join(_periodicity(rows) or most) or "no contact"
    return Answer(f"{first['method']} over {' and '.join(ranges)}: {verdict}.", table, notes)


def _periodicity(rows: Rows) -> list[str]:
    """Sentence with the number of values at which the tip repeats itself; empty without sections."""
    if len(ways := _ways(rows)) > 1:
        up, down = (sections(ways[way]) for way in WAYS)
        both = [value for value in up if value in down]
        size = sizes(rows)
        apart = sum(_apart(up[value], down[value]) > SAME * size[value] for value in both)
        words = f"there and back the last periods differ at {apart} of {len(both)} values"
        return [words, *(f"{way}: {text}" for way in WAYS for text in _periodicity(_bare(ways[way])))]
    by_value = sections(rows)
    if not by_value:
        return []
    size = sizes(rows)
    repeats = [repeats_after(section, size[value]) for value, section in by_value.items()]
    several, short = sum(p is not None and p > 1 for p in repeats), repeats.count(None)
    words = [
        f"the tip repeats itself every period of the drive at {repeats.count(1)} of {len(by_value)} values, every 2 to "
        f"{LONGEST} periods at {several}, and not at all at {repeats.count(0)} (to {SAME:g})"
    ]
    if short:
        words.append(f"{rows[0]['periods']:g} periods are too few to tell at {short}: {LONGEST + 1} would do")
    return words


def _bare(rows: Rows) -> list[Row]:
    return [{name: x for name, x in row.items() if name != "direction"} for row in rows]


def _apart(one: Array, other: Array) -> float:
    """Largest distance of a point of either section to the nearest of the other."""
    distance = np.abs(one[:, None] - other)
    return float(max(np.max(np.min(distance, axis=0)), np.max(np.min(distance, axis=1))))


def _rate(rows: Rows, case: Case) -> tuple[str, float]:
    """Words for a rate of impacts, and the number of periods or the time that a count is divided by."""
    if "t_end" not in rows[0]:
        return "impacts per period", rows[0]["periods"]
    return f"impacts per {case.units.time if case.units.known else 'unit of time'}", rows[0]["t_end"]


def picture(records: Records) -> Picture:
    """One parameter: sections, impacts, forces on one axis. Two: a map of each quantity."""
    rows, case = records.numbers, records.case
    contacts = [row for row in rows if row["kind"] == "contact"]
    if isinstance(rows[0]["second"], str):
        lines = [_maps(group, place, case) for place, group in by_contact(contacts).items()]
        return Picture(lines, 4.4 * len(lines))
    name, colour = rows[0]["parameter"], look(rows[0]["method"])["color"]
    points = Selection(rows, lambda row: row["kind"] == "section")
    across = Axis(named(case, name), scale=_scale(column(rows, name)))
    # The fainter the more points there are, so that dense bands and single curves can be told apart.
    faint = {"alpha": float(np.clip(2e4 / max(1, len(points)), 0.15, 0.9)), "rasterized": True}
    dots = {"linestyle": "", "marker": ".", "ms": 3.0, "mew": 0.0, "color": colour}
    colours = [colour, *(other for other in COLOURS if other != colour)]
    section = [
        Curve.over(group, name, "tip", way, look=dots | faint | {"color": colours[i]})
        for i, (way, group) in enumerate(_ways(points).items())
    ]
    tip = Axis(f"{tip_name(case.beam)} {tip_symbol(case.beam, 'nT')}", "length")
    line = 0.7 if len({row[name] for row in contacts}) <= 400 else 0.0  # more points than that are a band
    once, (counted, over) = "t_end" in rows[0], _rate(rows, case)
    legend = "inside" if len(section) > 1 else ""
    title = "the tip once in every period $T$ of the drive"
    panels = [] if once else [[Panel(title, across, tip, section, legend=legend)]]
    rigid = all(contact.stops.rigid for contact in case.system(rows[0]["form"]).contacts)
    measures = [("count", counted, "", "impacts")]
    measures += [("fraction", "share of the time", "", "time in contact")] if once else []
    measures += [] if rigid else [("peak_force", r"peak $|\sigma|$", "force", "largest contact force")]
    for quantity, label, unit, title in measures:
        marks = []
        lines = [
            (f"{place} {way}", part)
            for place, group in by_contact(contacts).items()
            for way, part in _ways(group).items()
        ]
        for i, (place, group) in enumerate(lines):
            ordered = sorted(group, key=lambda row: row[name])
            style = {"lw": line, "linestyle": dashed(i), "marker": ".", "ms": 3.0 if line else 1.5}
            marks.append(Curve(column(ordered, name), _measured(ordered, quantity, over), place.strip(),
                               style | {"color": colours[i % len(colours)]}))  # fmt: skip
        panels.append([Panel(title, across, Axis(label, unit, limits=(0.0, None)), marks, empty="no contact",
                             legend="inside" if len(marks) > 1 else "")])  # fmt: skip
    return Picture(panels, 8.2, heights=(1.0 if once else 3.0, *[1.0] * (len(panels) - 1)), shared_x=True)


def _maps(group: list[Row], place: str, case: Case) -> list[Panel]:
    names = (group[0]["parameter"], group[0]["second"])
    x, y = (column(group, name) for name in names)
    across, up = (Axis(named(case, name), scale=_scale(values)) for name, values in zip(names, (x, y), strict=True))
    force = case.units.label(r"peak force $|\sigma|$", "force")
    counted, over = _rate(group, case)
    quantities = [("count", counted), ("fraction", "share of time in contact")]
    quantities += [] if _rigid(case.system(group[0]["form"]), group) else [("peak_force", force)]
    return [
        Panel(label + place, across, up, [Map(x, y, _measured(group, quantity, over), label)])
        for quantity, label in quantities
    ]


def _measured(rows: Rows, quantity: str, over: float) -> Array:
    """A column of the contact's rows, impacts divided by ``over``."""
    return column(rows, quantity) / (over if quantity == "count" else 1.0)


def _scale(values: Array) -> str:
    """Logarithmic for values that are spaced by a factor."""
    values = np.unique(values[np.isfinite(values)])
    if len(values) < 3 or values[0] <= 0.0:
        return "linear"
    ratios, steps = np.diff(np.log(values)), np.diff(values)
    even = np.ptp(ratios) < 1e-6 * np.max(ratios) and np.ptp(steps) > 1e-3 * np.max(steps)
    return "log" if even else "linear"


STUDY = declared(
    __name__,
    "How does the motion change with a parameter: periodicity, number of impacts, forces?",
    named_by=("parameter", "second"),
    smoke={"count": 4, "periods": 3, "transient": 1},
)
