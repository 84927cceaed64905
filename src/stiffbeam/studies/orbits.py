"""Periodic orbits over a parameter: stable and unstable ones, with their bifurcations, over the sweep's diagram.

    orbit: q(t + m T) = q(t), m periods of the drive (references/exact/orbit.py); branch: continuation.py

The orbit at which the branch starts is looked for from the motion after many periods, at several values of the
parameter. At a flip the branch of twice the period is followed too. The section of the exact solution or of a scheme,
once a period, lies below (sweep.py): it shows what is attracting, the branch also what is not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd

from ..basics.arrays import Array
from ..basics.validation import InputError, near, number
from ..figures.chart import panel_legend, tip_name, tip_symbol
from ..files.cases import Case
from ..model.system import System
from ..references.exact.continuation import Bifurcation, Branch, continuation
from ..references.exact.orbit import ALONE, Orbit, PeriodMap, periodic_orbit, require_periodic
from ..trajectory.trajectory import SolverFailure
from . import common
from .base import Answer, Row, Study, Table, option
from .parameters import (
    EXACT,
    PARAMETERS,
    Coupling,
    couplings,
    drive_period,
    is_path,
    named,
    quantity_of,
    setup_of,
)
from .sweep import Sweep

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SETTLE, AGAIN = 60, 7  # periods before an orbit is looked for, and between the starts
VALUES = 3  # of the parameter at which it is looked for
STEPS = (20, 50)  # least and most of a branch over the range, to start with
DOUBLED = 2  # branches of twice the period that are followed
PORTRAIT, PORTRAITS = 1200, 3  # samples of a portrait, and how many
LINES, TOLD = 24, 4  # bifurcations in the table, in the verdict
COLOUR = {"stable": "#0072B2", "marginal": "#7F7F7F", "unstable": "#D55E00"}
MARKER = {"fold": "s", "flip": "D", "torus": "o", "branching": "^", "grazing": "|"}


@dataclass(frozen=True, kw_only=True)
class Orbits(Study):
    """Which periodic orbits are there over a parameter, stable or not, and where do they change?

    The branch of periodic orbits over the range of ``values``, and below it the bifurcation diagram at these values.
    The ``values`` of ``parameter`` are in the units of the case; by default they are ``count`` drive frequencies from
    0.7 to 1.3 of the case's. Orbits are those of the exact solution, so stops must be linear and loads periodic. By
    ``couple`` other parameters follow the first: each is a formula in x, the value of ``parameter``.
    """

    parameter: str = option(
        "frequency",
        "frequency, amplitude, clearance, stop-stiffness, stiffness, viscosity, or a path: stops[0].damping",
    )
    values: common.Values = option(None, common.VALUES)
    couple: common.Couple = option(None, common.COUPLE)
    length: int = option(1, "periods of the drive after which the orbit repeats itself", least=1)
    method: str = option(EXACT, "method of the diagram below the branch: exact, or a scheme")
    form: str | None = common.form()
    contact: str = common.treatment()
    periods: int = option(16, "periods of the drive in the diagram", least=1)
    transient: int = option(32, "periods of the drive before those of the diagram", least=0)
    count: int = option(40, "number of drive frequencies if no values are given", least=1)
    orbits: int = option(200, "largest number of orbits of a branch, in each direction from its start", least=2)
    starts: int = option(
        3, "states of a long run from which the search for an orbit starts, at each of 3 values", least=1
    )
    grazings: bool = option(False, "locate where a stop is touched for the first or last time")

    smoke: ClassVar = {"count": 4, "periods": 3, "transient": 1, "orbits": 10, "starts": 1}
    named_by: ClassVar = ("parameter",)
    height: ClassVar = 8.8

    def points(self, case: Case) -> list[Row]:
        """The branch, and the points of the diagram."""
        if drive_period(case.system(self.form), self.parameter) is None:
            remedy = "drive it by one Harmonic, or name a parameter of one of several: loads[0].time.amplitude"
            raise InputError("case", case.name, "have one drive frequency, for an orbit to repeat", remedy)
        if self.parameter not in PARAMETERS and not is_path(self.parameter):
            rule = "be one of the system, a branch is one of the exact solution"
            raise InputError("parameter", self.parameter, rule, near(self.parameter, PARAMETERS))
        texts = _texts(self.couple)
        diagram = self._diagram().points(case)
        along = [float(each[0]) for part in diagram for each in part["values"]]
        if min(along) == max(along):
            raise InputError("values", along, "span a range", "for example 8:14:60")
        branch: Row = {
            "kind": "branch", "parameter": self.parameter, "couple": texts, "form": self.form or case.forms[0],
            "length": self.length, "limits": [min(along), max(along)], "steps": int(np.clip(len(along), *STEPS)),
            "orbits": self.orbits, "starts": self.starts, "grazings": self.grazings,
        }  # fmt: skip
        make, period = _maker(case, branch)
        for end in (min(along), max(along)):
            require_periodic(make(end), period(end))
        return [branch, *diagram]

    def _diagram(self) -> Sweep:
        return Sweep(
            parameter=self.parameter, values=self.values, couple=_texts(self.couple) or None, method=self.method,
            form=self.form, contact=self.contact, count=self.count, periods=self.periods, transient=self.transient,
        )  # fmt: skip

    def run(self, case: Case, **point: Any) -> list[Row]:
        """Rows of the branches with their bifurcations and portraits, or the section at some values."""
        if point.get("kind") != "branch":
            rows = self._diagram().run(case, **point)
            return [row for row in rows if row.get("kind") == "section" or "lost" in row]
        return _branches(case, point)

    def answer(self, table: Table, case: Case) -> Answer:
        """The bifurcations at which the orbit gains or loses its stability, and a table of all."""
        orbits, ends, bifurcations = (_rows(table, kind) for kind in ("orbit", "end", "bifurcation"))
        if not orbits:
            reasons = dict.fromkeys(row["reason"] for row in ends)
            return Answer(f"No orbit was found{''.join(f': {reason}' for reason in reasons)}.")
        name = self.parameter
        units, quantity = case.units, quantity_of(case, name)
        at: list[Row] = sorted(bifurcations, key=lambda row: (row["length"], row["what"] == "grazing", row[name]))
        # Mirrored branches of a symmetric system have their bifurcations at the same values.
        alike: dict[Any, list[Row]] = {}
        for row in at:
            alike.setdefault((row["length"], row["what"], f"{row[name]:.9g}", _said(row)), []).append(row)
        at = [
            same[0] | ({"branches": f", on {len(same)} branches"} if len(same) > 1 else {}) for same in alike.values()
        ]

        def value(row: Row, form: str) -> str:
            return units.measure(f"{row[name]:{form}}", quantity)

        small = [
            {"bifurcation": row["what"], name: value(row, ".10g"), "orbit of": _periods(row["length"]),
             "orbits": _said(row)}
            for row in at[:LINES]
        ]  # fmt: skip
        main = min(row["length"] for row in orbits)
        first = [row for row in orbits if row["length"] == main and row["phase"] == 0]
        shares = [sum(row["stability"] == kind for row in first) for kind in COLOUR]
        low, high = (pick(row[name] for row in first) for pick in (min, max))
        ranges = units.measure(f"{low:g} to {high:g}", quantity)
        changes = [
            row for row in at if row["length"] == main and row["below"] != row["above"] and row["what"] != "grazing"
        ]
        changes.sort(key=lambda row: "stable" not in (row["below"], row["above"]))  # those of unstable orbits last
        told = "; ".join(f"{row['what']} at {value(row, '.6g')}: {_said(row)}" for row in changes[:TOLD])
        rest = len(changes) - TOLD
        more = f"; {rest} more change{'s' if rest > 1 else ''}" if rest > 0 else ""
        if not told:
            kind = max(zip(shares, COLOUR, strict=True))[1]
            told = (
                f"{kind} all along" if max(shares) == len(first) else "no located bifurcation changes their stability"
            )
        notes = []
        for length in dict.fromkeys(row["length"] for row in ends):
            group = [row for row in ends if row["length"] == length]
            stops = dict.fromkeys(row["reason"] for row in group)
            notes.append(
                f"Orbits of {_periods(length)}: {sum(row['count'] for row in group):g}; ends: {', '.join(stops)}."
            )
        if len(at) > LINES:
            notes.append(f"The table has {LINES} of {len(at)} bifurcations; all are in the records.")
        return Answer(
            f"Orbits of {_periods(main)} over {named_plainly(name)} {ranges}: {told}{more}.",
            pd.DataFrame(small),
            " ".join(notes),
        )

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """The branches over the section; the multipliers in the complex plane; portraits of a few orbits."""
        name, orbits, section = self.parameter, table[table.kind == "orbit"], table[table.kind == "section"]
        grid = figure.add_gridspec(2, 2, height_ratios=(1.35, 1.0))
        axis = figure.add_subplot(grid[0, :])
        if len(section):
            label = f"section, {section.method.iloc[0]}"
            axis.plot(section[name], section.tip, ".", ms=3.4, mew=0.0, color="0.35", alpha=0.6, label=label)
        _lines(axis, orbits, name)
        for what, rows in table[table.kind == "bifurcation"].groupby("what", sort=False) if "what" in table else ():
            axis.plot(rows[name], rows.tip, MARKER[str(what)], color="black", ms=6, mfc="none", zorder=4, label=what)
        tip = case.units.label(f"{tip_name(case.beam)} {tip_symbol(case.beam, 'nT')}", "length")
        title = "orbits and the tip once a period $T$ of the drive"
        axis.set(title=title, xlabel=named(case, name), ylabel=tip)
        panel_legend(axis, below=True)
        plane, portraits = (figure.add_subplot(grid[1, i]) for i in range(2))
        plane.set(title="two leading multipliers", xlabel="real part", ylabel="imaginary part")
        if len(orbits):
            angle = np.linspace(0.0, 2.0 * np.pi, 181)
            plane.plot(np.cos(angle), np.sin(angle), color="0.5", lw=0.9)
            for kind, rows in orbits[orbits.phase == 0].groupby("stability"):
                for part in ("", "second_"):
                    plane.plot(rows[f"{part}real"], rows[f"{part}imag"], ".", ms=4, color=COLOUR[str(kind)], alpha=0.7)
            plane.set(xlim=(-1.8, 1.8), ylim=(-1.2, 1.2), aspect="equal")
        paths = table[table.kind == "portrait"]
        for (length, value, kind), rows in paths.groupby(["length", name, "stability"]) if len(paths) else ():
            text = case.units.measure(f"{value:.5g}", quantity_of(case, name))
            portraits.plot(rows.u, rows.v, color=COLOUR[kind], lw=1.0, ls="--" if kind == "unstable" else "-",
                           alpha=1.0 if length == 1 else 0.6, label=f"{_periods(length)}, {text}, {kind}")  # fmt: skip
        u = tip_symbol(case.beam)
        speed = case.units.label(u.replace("u(", "u_t("), "velocity")
        portraits.set(title="portraits", xlabel=case.units.label(u, "length"), ylabel=speed)
        panel_legend(portraits, below=True)


def _rows(table: Table, kind: str) -> list[Row]:
    rows = table[table.kind == kind]
    return rows.dropna(axis="columns", how="all").to_dict("records")


def _texts(couple: Mapping[str, Coupling] | Sequence[str] | None) -> list[str]:
    """Couplings as texts "name=text": points are plain."""
    if isinstance(couple, Mapping):
        for name, rule in couple.items():
            if not isinstance(rule, str):
                raise InputError(f"couple {name}", rule, "be a text here", 'for example "0.01*x**2"')
        return [f"{name}={rule}" for name, rule in couple.items()]
    return [couple] if isinstance(couple, str) else list(couple or ())


def _maker(case: Case, point: Row) -> tuple[Callable[[float], System], Callable[[float], float]]:
    """The system and the period of the orbit as functions of the parameter."""
    system, rules = case.system(point["form"]), couplings(point["couple"])
    shared = {"parameter": point["parameter"], "second": None, "coupled": list(rules), "method": EXACT, "dt": None}

    def setup(x: float) -> Any:
        return setup_of(system, shared, [x, *(number(name, rule(x)) for name, rule in rules.items())], None)

    low, high = (setup(x).period for x in point["limits"])
    m, (first, last) = point["length"], point["limits"]
    # A constant period, or one that is 2 pi/x, is known without a setup at every value.
    if low == high:
        return lambda x: setup(x).system, lambda _: m * low
    if abs(low * first - high * last) < 1e-12 * abs(low * first):  # T = 2 pi/x
        return lambda x: setup(x).system, lambda x: m * low * first / x
    return lambda x: setup(x).system, lambda x: m * setup(x).period


def _branches(case: Case, point: Row) -> list[Row]:
    """Rows of the branches with their bifurcations and portraits."""
    make, period = _maker(case, point)
    name, (low, high) = point["parameter"], point["limits"]
    rows: list[Row] = []
    branches: list[tuple[int, Branch]] = []
    grid = np.linspace(low, high, point["steps"])
    # An orbit from which neither branch leaves is left for the next start.
    for value, orbit in _starts(make, period, point):
        if isinstance(orbit, str):
            rows = rows or [_end(0, point["length"], 0, orbit)]
            continue
        rows = []
        # From the first orbit to both ends of the range.
        for part, end in enumerate((high, low)):
            if value != end:
                along = [value, *(grid if end == high else grid[::-1])]
                try:
                    branch = continuation(
                        make, name, along, period, orbit, grazings=point["grazings"], most=point["orbits"]
                    )
                except SolverFailure as failure:
                    rows.append(_end(part, point["length"], 0, failure.reason))
                    continue
                branches.append((point["length"], branch))
        if branches:
            break
    rows += [row for i, (length, branch) in enumerate(branches) for row in _branch(i, length, branch, period)]
    # Branches of twice the period leave the first ones at flips, each flip once.
    mains, followed = list(branches), list[float]()
    for _, branch in mains:
        for i, flip in enumerate(branch.flips):
            if len(branches) - len(mains) == DOUBLED or any(abs(flip - x) < 1e-3 * (high - low) for x in followed):
                continue  # a branch that left another flip has come back here
            number, length = len(branches), 2 * point["length"]
            try:
                doubled = branch.doubled(i)
            except SolverFailure as failure:
                rows.append(_end(number, length, 0, f"at {flip:.10g} {failure.reason}"))
                continue
            followed += [float(flip), *doubled.values[-1:].tolist()]
            branches.append((length, doubled))
            rows += _branch(number, length, doubled, period)
    return rows + _portraits(branches)


def _starts(
    make: Callable[[float], System], period: Callable[[float], float], point: Row
) -> Iterator[tuple[float, Orbit | str]]:
    """Values and orbits at which a branch may start, or the reason why there is none."""
    low, high = point["limits"]
    # The middle of the range first, then its ends.
    for value in np.linspace(high, low, VALUES)[[1, 0, 2]].tolist():
        system, T = make(value), period(value)
        try:
            # The transient dies out first; then several states of the motion serve as starts.
            mapping, n = PeriodMap(system, T), system.size
            z = np.concatenate([system.q0, system.v0])
            for i in range(point["starts"]):
                z = mapping.ahead(z, AGAIN if i else SETTLE)
                try:
                    found: Orbit | str = periodic_orbit(system, T, (z[:n], z[n:]))
                except SolverFailure as failure:
                    found = failure.reason
                yield value, found
        except (SolverFailure, ArithmeticError, np.linalg.LinAlgError) as failure:
            yield value, getattr(failure, "reason", str(failure))


def _end(branch: int, length: int, count: int, reason: str) -> Row:
    return {"kind": "end", "branch": branch, "length": length, "count": count, "reason": reason}


def _stability(leading: complex) -> str:
    size = abs(leading)
    return "marginal" if abs(size - 1.0) <= ALONE else "stable" if size < 1.0 else "unstable"


def _tip(system: System, q: Array) -> float:
    return float(system.positions(0.0, q)[system.tip_channel])


def _branch(i: int, length: int, branch: Branch, period: Callable[[float], float]) -> list[Row]:
    """Rows of the orbits of a branch, one for each period of the drive, of its bifurcations and of its end."""
    rows: list[Row] = []
    name, make = branch.parameter, branch.follower.make_system
    states = np.hstack([branch.q, branch.v])
    for k, value in enumerate(branch.values.tolist()):
        system, z, m = make(value), states[k], branch.multipliers[k]
        tips = [_tip(system, z[: system.size])]
        whole = branch.follower.period(value)
        for _ in range(1, round(whole / period(value))):
            z = PeriodMap(system, period(value)).flow(z)[0]
            tips.append(_tip(system, z[: system.size]))
        second = m[1] if len(m) > 1 else np.nan
        rows += [
            {"kind": "orbit", "branch": i, "length": length, "place": k, "phase": phase, name: value, "tip": tip,
             "stability": _stability(m[0]), "events": int(branch.events[k]), "real": float(m[0].real),
             "imag": float(m[0].imag), "second_real": float(second.real), "second_imag": float(second.imag)}
            for phase, tip in enumerate(tips)
        ]  # fmt: skip
    rows += [_bifurcation(i, length, branch, x) for x in branch.bifurcations]
    return [*rows, _end(i, length, len(branch.values), branch.end)]


def _bifurcation(i: int, length: int, branch: Branch, at: Bifurcation) -> Row:
    """Row of a bifurcation, with the stability of the orbits below and above it, or on both sides of a fold."""
    k = min(max(at.place, 1), len(branch.values) - 1)
    sides = [(branch.values[j], _stability(branch.multipliers[j, 0])) for j in (k - 1, k)]
    if at.kind != "fold":
        sides.sort()
    system = branch.follower.make_system(at.value)
    return {
        "kind": "bifurcation", "branch": i, "length": length, branch.parameter: at.value, "what": at.kind,
        "below": sides[0][1], "above": sides[1][1], "tip": _tip(system, at.z[: system.size]),
    }  # fmt: skip


def _portraits(branches: list[tuple[int, Branch]]) -> list[Row]:
    """Phase portraits of orbits in the middle of the stable and unstable parts of the branches, a few."""
    rows: list[Row] = []
    chosen: list[tuple[int, Branch, int]] = []
    for length, branch in branches:
        for what in (branch.stable, ~branch.stable):
            here = np.flatnonzero(what)
            if len(here):
                chosen.append((length, branch, int(here[len(here) // 2])))
    seen: set[tuple[int, str]] = set()
    for length, branch, k in chosen:
        key = length, _stability(branch.multipliers[k, 0])
        if key in seen or len(seen) == PORTRAITS:
            continue
        try:
            orbit = branch.orbit(k)
            run = orbit.reference(1.0, np.linspace(0.0, orbit.period, PORTRAIT))
        except (SolverFailure, InputError):
            continue
        seen.add(key)
        rows += [
            {"kind": "portrait", "length": length, branch.parameter: float(branch.values[k]), "stability": key[1],
             "t": float(t), "u": float(u), "v": float(v)}
            for t, u, v in zip(run.t, run.tip, run.tip_velocity, strict=True)
        ]  # fmt: skip
    return rows


def _periods(length: float) -> str:
    return f"{length:g} period{'s' if length != 1 else ''}"


def _said(row: Row) -> str:
    """The orbits on both sides of a bifurcation, in words."""
    below, above, branches = row["below"], row["above"], row.get("branches", "")
    if row["what"] == "fold":
        both = "two unstable" if below == above == "unstable" else " and ".join(sorted((below, above)))
        return f"{both} orbits meet{branches}"
    return (f"{below} on both sides" if below == above else f"{below} below, {above} above") + branches


def named_plainly(name: str) -> str:
    """A parameter in a sentence."""
    return name if is_path(name) else name.replace("-", " ")


def _lines(axis: Axes, orbits: Table, name: str) -> None:
    """A line for each part of a branch of one stability, which ends in the next part."""
    labelled: set[str] = set()
    main = orbits.length.min() if len(orbits) else 1
    for (_, length, _), group in orbits.groupby(["branch", "length", "phase"]) if len(orbits) else ():
        group = group.sort_values("place")
        x, y, kind = (group[column].to_numpy() for column in (name, "tip", "stability"))
        begins = [0, *(np.flatnonzero(kind[1:] != kind[:-1]) + 1).tolist(), len(group)]
        for i, j in pairwise(begins):
            label = f"{kind[i]}, {_periods(length)}"
            style: dict[str, Any] = {"color": COLOUR[kind[i]], "lw": 1.6, "alpha": 1.0 if length == main else 0.65}
            style |= {"ls": "--" if kind[i] == "unstable" else "-", "marker": "" if j - i > 1 else "."}
            axis.plot(x[i : j + 1], y[i : j + 1], label=None if label in labelled else label, **style)
            labelled.add(label)
