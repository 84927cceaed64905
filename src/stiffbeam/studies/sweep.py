"""Sweeps: the tip once a period against any parameter; impacts and forces over one or two of them.

    section: u(1, n T), n = transient + 1 .. transient + periods, T the period of the drive

The step is the one nearest to the given dt that divides T. So the section consists of steps of the
scheme: an interpolation between steps would smear its periodic motions. The contact is recorded over the
same periods. Values that leave step and linear part alone (amplitude, clearance, stop stiffness) march as
one ensemble. Without damping the exact motion does not forget its start: its section belongs to that
start, a scheme's to what the scheme's own dissipation leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..arrays import Array
from ..cases import Case, parse_run
from ..contact import Stops
from ..drive import Drive
from ..march.ensemble import Ensemble, integrate_ensemble, reference_ensemble
from ..march.members import varied
from ..schemes import Scheme, make
from ..semidiscretisation import semidiscretise
from ..system import System
from ..trajectory import Diverged, SolverFailure
from ..validation import InputError, integer, near, number, positive
from .common import scheme_of, system_of
from .study import Point, Row, Rows, Study

EXACT = "exact"
LONGEST = 8  # periods of the drive that a motion may take to repeat itself and still be called periodic
SAME = 1e-3  # of the largest |u|: section points closer than this are one
BATCHES = 16  # at least, so that processes end together
# Seconds with 25 cells on one core: what a batch is cut to, so that a kill loses little; setting a scheme
# up, a step, a unit of time of the exact solution.
BATCH, SETTING_UP, STEP, EXACT_TIME = 1.0, 0.02, 3e-8, 0.01


def _stops(system: System, change: Callable[[Stops], Stops]) -> System:
    if system.problem is None or system.problem.stops is None:
        raise InputError("parameter", "one of the stops", "be asked of a case with stops")
    return varied(system, stops=[change(system.problem.stops)])[0]


def _clearance(system: System, value: float) -> System:
    """Every stop the system has at this distance from zero."""
    positive("clearance", value)

    def move(stops: Stops) -> Stops:
        lower, upper = stops.lower is not None, stops.upper is not None
        return replace(stops, lower=-value if lower else None, upper=value if upper else None)

    return _stops(system, move)


def _beam(system: System, **changes: float) -> System:
    assert system.problem is not None
    return semidiscretise(replace(system.problem, **changes), system.size, system.form)


PARAMETERS: dict[str, Callable[[System, float], System]] = {
    "frequency": lambda system, value: varied(system, frequency=[value])[0],
    "amplitude": lambda system, value: varied(system, amplitude=[value])[0],
    "clearance": _clearance,
    "stop-stiffness": lambda system, value: _stops(system, lambda stops: replace(stops, stiffness=value)),
    "stiffness": lambda system, value: _beam(system, stiffness=value),
    "viscosity": lambda system, value: _beam(system, viscosity=value),
}
IN_STEP = ("amplitude", "clearance", "stop-stiffness")  # members of one ensemble


@dataclass(frozen=True)
class Setup:
    """One value of the parameters, ready to run. scheme: None for the exact solution. period: T."""

    system: System
    scheme: Scheme | None
    dt: float
    period: float

    @property
    def kind(self) -> tuple:
        """Equal for setups that can march together."""
        return str(self.scheme), self.dt, self.period, self.system.stiffness.tobytes(), self.system.damping.tobytes()


def parameters_of(method: str) -> list[str]:
    """The names that can be varied with this method."""
    if method == EXACT:
        return list(PARAMETERS)
    own = scheme_of(method).parameters
    return [*PARAMETERS, "dt", *(name for name, value in own.items() if not isinstance(value, bool))]


def points(
    case: Case,
    parameter: str = "frequency",
    values: Sequence[float] | None = None,
    second: str | None = None,
    second_values: Sequence[float] | None = None,
    method: str | None = None,
    form: str = "displacement",
    contact: str = "implicit",
    dt: float | None = None,
    periods: int = 60,
    transient: int = 100,
    count: int = 200,
) -> list[Point]:
    """Batches of values, each a line of the journal; with ``second`` a grid, without sections.

    values: of ``parameter``, see ``parameters_of``; by default ``count`` drive frequencies from 0.7 to 1.3
    of the case's. method: a scheme's label or "exact", by default the case's first scheme. transient:
    periods of the drive before the ``periods`` that are looked at.
    """
    method = str(case.runs[0][0]) if method is None else method if method == EXACT else str(parse_run(method)[0])
    for name, periods_given, least in (("periods", periods, 1), ("transient", transient, 0)):
        integer(name, periods_given, least)
    if values is None and parameter == "frequency":
        own = 2.0 * np.pi / _period(system_of(case, form))
        values = np.linspace(0.7 * own, 1.3 * own, count).tolist()
    axes = {parameter: values} if second is None else {parameter: values, second: second_values}
    if second is not None and case.problem.stops is None:
        raise InputError("case", case.name, "have stops for a grid of two parameters")
    if second == parameter:
        raise InputError("second", second, "be another parameter")
    known = parameters_of(method)
    for name, along in axes.items():
        if name not in known:
            raise InputError("parameter", name, f"be one that {method} has", near(name, known))
        if along is None or not len(along):
            raise InputError("values", along, f"be given for {name}", "for example 8:14:400 or 8,9,10.5")
    grid = [[number(name, x) for x in along or ()] for name, along in axes.items()]
    rest = {
        "parameter": parameter, "second": second, "method": method, "form": form, "contact": contact,
        "dt": None if method == EXACT else positive("dt", case.dt if dt is None else dt),
        "periods": periods, "transient": transient,
    }  # fmt: skip
    # Bad values are refused here, at the ends of the ranges; what a scheme refuses in between is a row.
    base = system_of(case, form)
    ends = [_setup(base, rest, value) for value in product(*([min(axis), max(axis)] for axis in grid))]
    together = parameter in IN_STEP and (second is None or second in IN_STEP)
    seconds = max(_seconds(setup, periods + transient) + (0.0 if together else SETTING_UP) for setup in ends)
    if second is not None and parameter in IN_STEP:  # what marches together stands together
        wanted = [[x, y] for y in grid[1] for x in grid[0]]
    else:
        wanted = [list(value) for value in product(*grid)]
    size = max(1, min(int(BATCH / seconds), -(-len(wanted) // BATCHES)))
    return [{**rest, "values": wanted[i : i + size]} for i in range(0, len(wanted), size)]


def _seconds(setup: Setup, periods: int) -> float:
    span = periods * setup.period
    return EXACT_TIME * span if setup.scheme is None else STEP * span / setup.dt * max(1.0, setup.system.size / 25)


def _setup(system: System, point: Point, value: Sequence[float]) -> Setup:
    """One value on the case's system. Raises InputError where a value cannot be."""
    dt = point["dt"]
    scheme = None if point["method"] == EXACT else scheme_of(point["method"])
    for name, x in zip((point["parameter"], point["second"]), value, strict=False):
        if name in PARAMETERS:
            system = PARAMETERS[name](system, x)
        elif name == "dt":
            dt = positive("dt", x)
        else:
            assert scheme is not None
            changed = make(scheme.name, **(scheme.parameters | {name: x}))
            scheme = changed.printed(scheme.erratum) if scheme.erratum else changed
    period = _period(system)
    if dt is None:
        return Setup(system, None, 0.0, period)
    if dt > 0.5 * period:
        raise InputError("dt", dt, f"be at most half a period of the drive, {0.5 * period:.6g}")
    return Setup(system, scheme, period / round(period / dt), period)


def _period(system: System) -> float:
    """T = 2 pi/a of the one frequency that drives the system."""
    frequencies = Drive.of(system).frequencies
    if len(frequencies) != 1:
        raise InputError("case", f"{len(frequencies)} drive frequencies", "have one, for a section once a period")
    return 2.0 * np.pi / frequencies[0]


def evaluate(case: Case, point: Point) -> list[Row]:
    rows: list[Row] = []
    groups: dict[tuple, list[tuple[Row, Setup]]] = {}
    system = system_of(case, point["form"])
    for value in point["values"]:
        named = {name: x for name, x in zip((point["parameter"], point["second"]), value, strict=False) if name}
        try:
            setup = _setup(system, point, value)
            groups.setdefault(setup.kind, []).append((named | ({"dt": setup.dt} if setup.scheme else {}), setup))
        except InputError as error:
            rows.append(named | {"failed": str(error)})
    for group in groups.values():
        try:
            many = _march(point, [setup for _, setup in group])
            rows += [row for i, (named, _) in enumerate(group) for row in _rows(point, named, many, i)]
        except (InputError, SolverFailure) as error:
            rows += [named | {"failed": str(error)} for named, _ in group]
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
    if many.contacts:
        seen = many.contact
        found = {"count": seen.impact_count[i], "fraction": seen.fraction[i], "peak_force": seen.peak_force[i]}
        rows.append(named | {"kind": "contact"} | {name: value.item() for name, value in found.items()})
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


def repeats_after(section: Array, size: float) -> int:
    """The least p <= LONGEST with u(n + p) = u(n) to SAME of ``size`` all along the section; 0 for none."""
    for p in range(1, min(LONGEST, len(section) - 1) + 1):
        if np.max(np.abs(section[p:] - section[:-p])) <= SAME * size:
            return p
    return 0


def answer(rows: Rows) -> str:
    first, parts = rows[0], []
    names = [name for name in (first["parameter"], first["second"]) if name is not None]
    ranges = [f"{name} {min(r[name] for r in rows):g} to {max(r[name] for r in rows):g}" for name in names]
    found = sections(rows)
    if found:
        size = max(float(np.max(np.abs(section))) for section in found.values())
        repeats = [repeats_after(section, size) for section in found.values()]
        several = sum(p > 1 for p in repeats)
        parts.append(
            f"the tip repeats itself every period of the drive at {repeats.count(1)} of {len(found)} values, every "
            f"2 to {LONGEST} periods at {several}, and not at {repeats.count(0)} (to {SAME:g} of the largest)"
        )
    contacts = [r for r in rows if r["kind"] == "contact"]
    if contacts:
        for name, unit, scale in (("count", "impacts a period", first["periods"]), ("peak_force", "largest force", 1)):
            low, high = (pick(contacts, key=lambda r: r[name]) for pick in (min, max))
            least, most = (f"{r[name] / scale:.4g} at {_at(r, names)}" for r in (low, high))
            parts.append(f"{unit} from {least} to {most}")
        parts.append(f"in contact at most {100 * max(r['fraction'] for r in contacts):.3g} % of the time")
    method = f"{first['method']} over {' and '.join(ranges)}, {first['periods']} periods after {first['transient']}"
    return f"{method}: {'; '.join(parts)}."


def _at(row: Row, names: list[str]) -> str:
    return ", ".join(f"{name} {row[name]:.5g}" for name in names)


STUDY = Study(
    name="sweep",
    question="How does the motion change with a parameter: periodic or not, how many impacts, how hard?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"count": 4, "periods": 3, "transient": 1},
)
