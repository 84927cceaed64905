"""Sweeps: the tip once a period against any parameter; impacts and forces over one or two of them.

    section: u(1, n T), n = transient + 1 .. transient + periods, T the period of the drive

The step is the one nearest to the given dt that divides T. So the section consists of steps of the
scheme: an interpolation between steps would smear its periodic motions. The contact is recorded over the
same periods. Values that leave step and linear part alone (amplitude, clearance, stop stiffness) march as
one ensemble. Without damping the exact motion depends on its initial data for ever; a scheme's section also depends on
its numerical dissipation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError, integer, near, number, positive
from ..figures import COLOURS, column, dashed, heading, look, new_figure, numeric, say_empty, tip_name, tip_symbol
from ..files.cases import Case
from ..march.ensemble import integrate_ensemble
from ..references.ensemble import reference_ensemble
from ..schemes.rigid_scheme import RigidScheme
from ..trajectory.ensemble import Ensemble
from ..trajectory.trajectory import Diverged, SolverFailure
from .common import Form, Treatment, by_contact, label_of, scheme_of, system_of
from .engine.study import Point, Records, Row, Rows, Study
from .parameters import (
    EXACT,
    IN_STEP,
    Coupling,
    Setup,
    couplings,
    drive_period,
    is_path,
    named,
    names_of,
    parameters_of,
    quantity_of,
    setup_of,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LONGEST = 8  # periods of the drive that a motion may take to repeat itself and still be called periodic
SAME = 1e-3  # of the largest |u|: section points closer than this are one
BATCHES = 16  # at least, so that processes end together
# Seconds with 25 cells on one core: what a batch is cut to, so that a kill loses little; setting a scheme
# up, a step, a period of the drive of the exact solution, the last two for compliant and for rigid stops.
BATCH, SETTING_UP, STEP, EXACT_PERIOD = 1.0, 0.02, (3e-8, 3e-7), (6e-3, 3e-2)
PERIODS, TRANSIENT, BUDGET = 60, 100, 20.0  # by default; as many as about so many seconds allow, LEAST of each
LEAST = LONGEST + 2


def points(
    case: Case,
    parameter: Annotated[
        str,
        "frequency, amplitude, clearance, stop-stiffness, stiffness, viscosity, dt, alpha, or a path: stops[0].damping",
    ] = "frequency",
    values: Annotated[
        Sequence[float] | None,
        "start:stop:count, start:stop:count:log, or with commas between them; in the case's units",
    ] = None,
    second: Annotated[str | None, "another parameter: impacts and forces on a grid"] = None,
    second_values: Annotated[Sequence[float] | None, "as --values"] = None,
    couple: Annotated[
        Mapping[str, Coupling] | Sequence[str] | None,
        'parameters that follow x, the value of the first: "loads[0].time.amplitude=0.01*x**2"',
    ] = None,
    method: Annotated[
        str | None, "a scheme, or exact; default: the case's first scheme that has a law for its stops"
    ] = None,
    form: Form = "displacement",
    contact: Treatment = "implicit",
    dt: Annotated[float | None, "the nearest step that divides the period is taken"] = None,
    periods: Annotated[int | None, "of the drive, that are looked at; default: 60, fewer where these take long"] = None,
    transient: Annotated[int | None, "periods of the drive before them; default: 100, or fewer as well"] = None,
    count: Annotated[int, "drive frequencies where no values are given"] = 200,
) -> list[Point]:
    """Batches of values, each a line of the journal; with ``second`` a grid, without sections.

    values: of ``parameter``, in the case's own units; by default ``count`` drive
    frequencies from 0.7 to 1.3 of the case's. method: a scheme's label or "exact", by default the case's
    first scheme. transient: periods of the drive before the ``periods`` that are looked at; by default 60 after 100, or
    as many as take about 20 s of processor time, at least 10 after 10. Where several
    frequencies drive the system, the period is that of the drive whose parameter is varied.
    couple: arithmetic of x, the value of ``parameter``, for each parameter that follows it.
    """
    if method is None:
        runs = [label_of(run) for run, *_ in case.runs]
        rigid = any(contact.stops.rigid for contact in system_of(case, form).contacts)
        method = next((run for run in runs if not rigid or isinstance(scheme_of(run), RigidScheme)), EXACT)
    method = method if method == EXACT else label_of(method)
    for name, periods_given, least in (("periods", periods, 1), ("transient", transient, 0)):
        if periods_given is not None:
            integer(name, periods_given, least)
    if values is None and parameter == "frequency":
        own = 2.0 * np.pi / drive_period(system_of(case, form))
        values = np.linspace(0.7 * own, 1.3 * own, count).tolist()
    if second is None and second_values is not None:
        raise InputError("second_values", second_values, "be left out without second", "name the second parameter")
    axes = {parameter: values} if second is None else {parameter: values, second: second_values}
    if second is not None and not case.has_stops:
        remedy = "vary one parameter only, or give the case stops"
        raise InputError("case", case.name, "have stops for a grid of two parameters", remedy)
    if second == parameter:
        raise InputError("second", second, "be another parameter", "give the grid two different parameters")
    follow = couplings(couple)
    if twice := [name for name in follow if name in axes]:
        raise InputError("couple", twice[0], "be another parameter than those varied", "leave it out of couple")
    known = parameters_of(method)
    for name in (*axes, *follow):
        if name not in known and not is_path(name):
            raise InputError("parameter", name, f"be one that {method} has", near(name, known))
    for name, along in axes.items():
        if along is None or not len(along):
            raise InputError("values", along, f"be given for {name}", "for example 8:14:400 or 8,9,10.5")
    grid = [[number(name, x) for x in along] for name, along in axes.items() if along is not None]
    rest = {
        "parameter": parameter, "second": second, "coupled": list(follow), "method": method,
        "form": form, "contact": contact,
        "dt": None if method == EXACT else positive("dt", case.dt if dt is None else dt),
    }  # fmt: skip
    # Bad values are refused here, at the ends of the ranges; what a scheme refuses in between is a row.
    base = system_of(case, form)

    def whole(value: Sequence[float]) -> list[float]:
        return [*value, *(number(name, rule(value[0])) for name, rule in follow.items())]

    ends = [setup_of(base, rest, whole(value)) for value in product(*([min(axis), max(axis)] for axis in grid))]
    together = all(name in IN_STEP for name in names_of(rest))
    whole_cost = len(list(product(*grid))) * max(_seconds(setup, PERIODS + TRANSIENT) for setup in ends)
    share = min(1.0, BUDGET / whole_cost)
    periods = max(LEAST, int(share * PERIODS)) if periods is None else periods
    transient = max(LEAST, int(share * TRANSIENT)) if transient is None else transient
    rest |= {"periods": periods, "transient": transient}
    seconds = max(_seconds(setup, periods + transient) + (0.0 if together else SETTING_UP) for setup in ends)
    if second is not None and parameter in IN_STEP:  # what marches together stands together
        wanted = [whole([x, y]) for y in grid[1] for x in grid[0]]
    else:
        wanted = [whole(value) for value in product(*grid)]
    size = max(1, min(int(BATCH / seconds), -(-len(wanted) // BATCHES)))
    return [{**rest, "values": wanted[i : i + size]} for i in range(0, len(wanted), size)]


def _seconds(setup: Setup, periods: int) -> float:
    rigid = any(contact.stops.rigid for contact in setup.system.contacts)
    if setup.scheme is None:
        return EXACT_PERIOD[rigid] * periods
    return STEP[rigid] * periods * setup.period / setup.dt * max(1.0, setup.system.size / 25)


def evaluate(case: Case, point: Point) -> list[Row]:
    """Rows of every value and method of this point; a value that is refused gives a row with the reason."""
    rows: list[Row] = []
    groups: dict[tuple[Any, ...], list[tuple[Row, Setup]]] = {}
    system = system_of(case, point["form"])
    for value in point["values"]:
        named = dict(zip(names_of(point), value, strict=True))
        try:
            setup = setup_of(system, point, value)
            groups.setdefault(setup.kind, []).append((named | ({"dt": setup.dt} if setup.scheme else {}), setup))
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
    """What member i has shown after the transient."""
    if np.isfinite(many.diverged[i]):
        return [named | {"failed": str(Diverged(point["method"], many.diverged[i], "use a smaller dt"))}]
    rows: list[Row] = []
    for place, seen in enumerate(many.contacts, 1):
        found = {"count": seen.impact_count[i], "fraction": seen.fraction[i], "peak_force": seen.peak_force[i]}
        rows.append(named | {"kind": "contact", "contact_number": place} | {n: x.item() for n, x in found.items()})
    if point["second"] is None:
        section = enumerate(many.tip[i, point["transient"] + 1 :].tolist(), point["transient"] + 1)
        rows += [named | {"kind": "section", "period": n, "tip": tip} for n, tip in section]
    return rows


def sections(rows: Rows) -> dict[float, Array]:
    """The section of every value of the parameter, in order of value."""
    found: dict[float, list[float]] = {}
    for row in rows:
        if row["kind"] == "section":
            found.setdefault(row[row["parameter"]], []).append(row["tip"])
    return {value: np.array(found[value]) for value in sorted(found)}


def repeats_after(section: Array, size: float) -> int | None:
    """The least p <= LONGEST with u(n + p) = u(n) to SAME of ``size`` all along the section; 0 for none, None where the
    section has too few points to rule out one."""
    for p in range(1, min(LONGEST, len(section) - 1) + 1):
        if np.max(np.abs(section[p:] - section[:-p])) <= SAME * size:
            return p
    return 0 if len(section) > LONGEST else None


def answer(rows: Rows, case: Case) -> str:
    """The range of impact counts and peak forces over the values, and where the motion is periodic."""
    units = case.units
    first, parts = rows[0], []
    names = [name for name in (first["parameter"], first["second"]) if name is not None]
    quantities = {name: quantity_of(case, name) for name in names}

    def value(name: str, x: str) -> str:
        return units.measure(x, quantities[name]) if quantities[name] else x

    def at(row: Row) -> str:
        return ", ".join(f"{name} {value(name, f'{row[name]:.5g}')}" for name in names)

    ranges = [
        f"{name} {value(name, f'{min(r[name] for r in rows):g} to {max(r[name] for r in rows):g}')}" for name in names
    ]
    found = sections(rows)
    if found:
        size = max(float(np.max(np.abs(section))) for section in found.values())
        repeats = [repeats_after(section, size) for section in found.values()]
        several, untold = sum(p is not None and p > 1 for p in repeats), repeats.count(None)
        text = (
            f"the tip repeats itself every period of the drive at {repeats.count(1)} of {len(found)} values, every "
            f"2 to {LONGEST} periods at {several}, and not at {repeats.count(0)} (to {SAME:g} of the largest)"
        )
        more = f"; {first['periods']} periods are too few to tell at {untold}: {LONGEST + 1} would do"
        parts.append(text + (more if untold else ""))
    for place, contacts in by_contact([r for r in rows if r["kind"] == "contact"]).items():
        if not contacts:
            continue
        for name, words, scale in (("count", "impacts a period", first["periods"]), ("peak_force", "largest force", 1)):
            known = [r for r in contacts if np.isfinite(r[name])]  # a rigid stop has impulses, no peak forces
            if not known:
                continue
            low, high = (pick(known, key=lambda r: r[name]) for pick in (min, max))
            least, most = (f"{r[name] / scale:.4g}" for r in (low, high))
            if name == "peak_force":
                least, most = (units.measure(x, "force") for x in (least, most))
            parts.append(f"{words}{place} from {least} at {at(low)} to {most} at {at(high)}")
        parts.append(f"in contact{place} at most {100 * max(r['fraction'] for r in contacts):.3g} % of the time")
    system = case.system(first["form"])
    lossy = [c.stops.damping or c.stops.dissipation or c.stops.restitution not in (None, 1.0) for c in system.contacts]
    if not system.damped and not any(lossy):
        parts.append("nothing damps this system, so its transient never ends: another start gives another answer")
    method = f"{first['method']} over {' and '.join(ranges)}, {first['periods']} periods after {first['transient']}"
    return f"{method}: {'; '.join(parts)}."


def draw(records: Records) -> Figure:
    """One parameter: sections, impacts, forces on one axis. Two: a map of each quantity."""
    rows = numeric(records.found)
    contacts = [row for row in rows if row["kind"] == "contact"]
    if rows and isinstance(rows[0]["second"], str):
        figure = new_figure(4.2 * len(by_contact(contacts)))
        _maps(figure, contacts, records.case)
    else:
        figure = new_figure(8.2)
        _diagram(figure, [row for row in rows if row["kind"] == "section"], contacts, records.case)
    text = "no point could be evaluated"
    if rows:
        one = rows[0]
        text = f"{one['method']}, {one['form']}, {one['periods']} periods of the drive after {one['transient']}"
    figure.suptitle(heading(records.case, text))
    return figure


def _diagram(figure: Figure, points: Rows, contacts: Rows, case: Case) -> None:
    units = case.units
    section, count, force = figure.subplots(3, 1, sharex=True, height_ratios=[3.0, 1.0, 1.0])
    first = next(iter([*points, *contacts]), {"parameter": "parameter", "method": EXACT})
    name, colour = first["parameter"], look(first["method"])["color"]
    colours = [colour, *(other for other in COLOURS if other != colour)]
    section.set(ylabel=units.label(f"{tip_name(case.beam)} {tip_symbol(case.beam, 'nT')}", "length"))
    section.set_title("(a) the tip once in every period $T$ of the drive", loc="left")
    if points:
        # The fainter the more points there are, so that dense bands and single curves can be told apart.
        alpha = float(np.clip(2e4 / len(points), 0.15, 0.9))
        section.plot(
            column(points, name), column(points, "tip"), ls="none", marker=".", ms=3.0, mew=0.0, color=colour,
            alpha=alpha, rasterized=True,
        )  # fmt: skip
    else:
        say_empty(section)
    line = 0.7 if len({row[name] for row in contacts}) <= 400 else 0.0  # more points than that are a band
    for axis, quantity, label, title in (
        (count, "count", "impacts per period", "(b) impacts"),
        (force, "peak_force", units.label(r"peak $|\sigma|$", "force"), "(c) largest contact force"),
    ):
        axis.set(ylabel=label)
        axis.set_title(title, loc="left")
        for i, (place, own) in enumerate(by_contact(contacts).items()):
            own = sorted(own, key=lambda row: row[name])
            values = column(own, quantity) / (column(own, "periods") if quantity == "count" else 1.0)
            axis.plot(column(own, name), values, lw=line, ls=dashed(i), marker=".", ms=3.0 if line else 1.5,
                      color=colours[i % len(colours)], label=place.strip())  # fmt: skip
        if len(by_contact(contacts)) > 1:
            axis.legend(frameon=False, fontsize=8.5)
        if contacts:
            axis.set_ylim(bottom=0.0)
        else:
            say_empty(axis, "no contact")
    _log_where_even(force.set_xscale, column([*points, *contacts], name))
    force.set(xlabel=named(case, name))
    figure.align_ylabels()


def _maps(figure: Figure, contacts: Rows, case: Case) -> None:
    from matplotlib.colors import LogNorm

    x_name, y_name = contacts[0]["parameter"], contacts[0]["second"]
    blocks = by_contact(contacts)
    axes = figure.subplots(len(blocks), 3, sharex=True, sharey=True, squeeze=False)
    quantities = (
        ("count", "impacts per period"),
        ("fraction", "share of time in contact"),
        ("peak_force", case.units.label(r"peak force $|\sigma|$", "force")),
    )
    for line, (place, own) in zip(axes, blocks.items(), strict=True):
        x, y = column(own, x_name), column(own, y_name)
        here = np.isfinite(x) & np.isfinite(y)
        across, up = np.unique(x[here]), np.unique(y[here])
        for axis, (quantity, label) in zip(line, quantities, strict=True):
            values = column(own, quantity) / (column(own, "periods") if quantity == "count" else 1.0)
            axis.set_title(label + place, loc="left")
            axis.set(xlabel=named(case, x_name))
            known = values[here & np.isfinite(values)]
            if not len(known):
                say_empty(axis)
                continue
            grid = np.full((len(up), len(across)), np.nan)
            grid[np.searchsorted(up, y[here]), np.searchsorted(across, x[here])] = values[here]
            wide = 0.0 < 30.0 * np.min(known) < np.max(known)
            norm = LogNorm() if wide else None
            drawn = axis.pcolormesh(across, up, grid, cmap="cividis", shading="nearest", norm=norm, rasterized=True)
            figure.colorbar(drawn, ax=axis, label=label)
            _log_where_even(axis.set_xscale, across)
            _log_where_even(axis.set_yscale, up)
        line[0].set(ylabel=named(case, y_name))


def _log_where_even(set_scale: Callable[[str], None], values: Array) -> None:
    """A logarithmic axis for values that are spaced by a factor."""
    values = np.unique(values[np.isfinite(values)])
    if len(values) < 3 or values[0] <= 0.0:
        return
    ratios, steps = np.diff(np.log(values)), np.diff(values)
    if np.ptp(ratios) < 1e-6 * np.max(ratios) and np.ptp(steps) > 1e-3 * np.max(steps):
        set_scale("log")


STUDY = Study(
    name="sweep",
    question="How does the motion change with a parameter: periodic or not, how many impacts, how hard?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    named_by=("parameter", "second"),
    smoke={"count": 4, "periods": 3, "transient": 1},
)
