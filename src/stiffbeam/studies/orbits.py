"""Periodic orbits over a parameter, stable or not, and where their stability changes.

    orbit: q(t + m T) = q(t), m periods of the drive (references/exact/orbit.py)

Natural continuation: the parameter is stepped through its range, and Newton's method starts from the line through the
last two orbits. Where it fails or finds an orbit far from there, the step is halved. A branch that turns back, at a
fold, ends so. The first orbit is looked for from the motion after many periods, at several values of the parameter.
The study ``sweep`` shows what is attracting.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import ClassVar, cast

import numpy as np
import pandas as pd

from ..basics.text import several, with_unit
from ..basics.validation import InputError
from ..figures.chart import Figure, panel_legend, say_empty, tip_text
from ..files.cases import Case
from ..model.system import System
from ..references.exact.orbit import ALONE, Orbit, PeriodMap, periodic_orbit, require_periodic
from ..trajectory.trajectory import SolverFailure
from . import base
from .base import Answer, Row, Study, Table, option
from .sweep import drive_period, named, setup_of, values_of

SETTLE, AGAIN, STARTS = 60, 7, 3  # periods before the first search, between searches; searches at a value
STEPS = (20, 50)  # least and most values of a branch
FAR = 0.5  # of the last step: an orbit further from its prediction belongs to another branch
JUMP = 0.05  # of the motion: as far may an orbit be from the first one
LEAST = 1e-5  # of the range: a shorter step ends a branch
FOLD = 0.1  # distance of a multiplier from 1 at the end of a branch that turns back
TOLD = 4  # changes of stability in the verdict
COLOUR = {"stable": "#0072B2", "marginal": "#7F7F7F", "unstable": "#D55E00"}
FAILURES = (SolverFailure, InputError, ArithmeticError, np.linalg.LinAlgError)  # of the search for an orbit
MARKER = {"flip": "D", "torus": "o", "branching": "^", "grazing": "|"}

Maker = Callable[[float], tuple[System, float]]  # system and period of the orbit at a value
Branch = list[tuple[float, Orbit]]


@dataclass(frozen=True, kw_only=True)
class Orbits(Study):
    """Which periodic orbits are there over a parameter, stable or not, and where do they change?

    The ``values`` of ``parameter`` are in the units of the case; by default they are 40 drive frequencies from 0.7 to
    1.3 of the case's. Orbits are those of the exact solution, so stops must be linear and loads periodic.
    Limitation: a branch ends where it turns back, at a fold.
    """

    parameter: str = option(
        "frequency", "frequency, amplitude, clearance, stiffness, viscosity, or a path: stops.stiffness"
    )
    values: base.Values = option(None, base.VALUES)
    length: int = option(1, "periods of the drive after which the orbit repeats itself", least=1)
    form: str | None = option(*base.FORM)

    height: ClassVar = 8.8

    def points(self, case: Case) -> list[Row]:
        """The branch."""
        period = drive_period(case.system(self.form))
        if period is None:
            rule = "have one drive frequency, for an orbit to repeat"
            raise InputError("case", case.name, rule, "drive it by one Harmonic")
        along = values_of(self.parameter, self.values, 40, period)
        if min(along) == max(along):
            raise InputError("values", along, "span a range", "for example 8:14:60")
        limits = [min(along), max(along)]
        for end in limits:
            require_periodic(*self._at(case.system(self.form), end))
        return [{"limits": limits, "count": int(np.clip(len(along), *STEPS))}]

    def _at(self, system: System, value: float) -> tuple[System, float]:
        """System and period of the orbit at a value."""
        varied, period, _ = setup_of(system, self.parameter, value)
        return varied, self.length * period

    def run(self, case: Case, limits: list[float], count: int) -> list[Row]:
        """Rows of the branch with its changes of stability."""
        make, name, (low, high) = partial(self._at, case.system(self.form)), self.parameter, limits
        grid, reason = np.linspace(low, high, count).tolist(), ""
        for value, first in _starts(make, np.linspace(low, high, 3)[[1, 0, 2]].tolist()):
            if isinstance(first, str):
                reason = reason or first
                continue
            # From the first orbit to both ends of the range.
            down, *ends = follow(make, [value, *(x for x in reversed(grid) if x < value)], first)
            up, end = follow(make, [value, *(x for x in grid if x > value)], first)
            branch = [*reversed(down[1:]), *up]
            rows = [row for k, (x, orbit) in enumerate(branch) for row in _rows(name, k, x, orbit, self.length)]
            rows += [{"kind": "change", name: x, **rest} for x, rest in _changes(make, branch)]
            return rows + [{"kind": "end", "reason": text} for text in (*ends, end) if text]
        return [{"kind": "end", "reason": reason}]

    def answer(self, table: Table, case: Case) -> Answer:
        """The values at which the orbit gains or loses its stability, where the branch ends, and a table of them."""
        orbits, changes, ends = (table[table.kind == kind] for kind in ("orbit", "change", "end"))
        reasons = list(ends.reason) if len(ends) else []
        if not len(orbits):
            return Answer(f"No orbit was found: {'; '.join(reasons)}.")
        name, small = self.parameter, list[Row]()
        for _, row in changes.iterrows():
            place = f"at {row[name]:.6g}" if row["located"] else f"near {row[name]:.4g}"
            small.append({"bifurcation": row["what"], name: place, "orbits": row["sides"]})
        said = "; ".join(f"{row['bifurcation']} {row[name]}: {row['orbits']}" for row in small[:TOLD])
        said += f"; {len(small) - TOLD} more changes" if len(small) > TOLD else ""
        span = f"{name} {orbits[name].min():g} to {orbits[name].max():g}"
        return Answer(
            f"Orbits of {several(self.length, 'period')} over {span}: "
            f"{said or orbits.stability.iloc[0] + ' all along'}.",
            pd.DataFrame(small),
            " ".join(f"The branch ends {reason}." for reason in reasons),
        )

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """The branch; the multipliers in the complex plane."""
        name, orbits = self.parameter, table[table.kind == "orbit"]
        if not len(orbits):
            figure.set_figheight(2.0)
            return say_empty(figure.subplots(), "no orbit was found")
        above, plane = figure.subplots(2, 1, height_ratios=(1.35, 1.0))
        for kind, rows in orbits.groupby("stability", sort=False):
            above.plot(rows[name], rows.tip, ".", ms=5, color=COLOUR[str(kind)], label=kind)
        for what, rows in table[table.kind == "change"].groupby("what", sort=False) if "what" in table else ():
            above.plot(rows[name], rows.tip, MARKER[str(what)], color="black", ms=6, mfc="none", zorder=4, label=what)
        tip = with_unit(case.units, tip_text(case.problem, t="nT"), "length")
        title = "orbits and the tip once a period $T$ of the drive"
        above.set(title=title, xlabel=named(case, name), ylabel=tip)
        panel_legend(above)
        angle = np.linspace(0.0, 2.0 * np.pi, 181)
        plane.plot(np.cos(angle), np.sin(angle), color="0.5", lw=0.9)
        for kind, rows in orbits[orbits.phase == 0].groupby("stability"):
            for part in ("", "second_"):
                plane.plot(rows[f"{part}real"], rows[f"{part}imag"], ".", ms=4, color=COLOUR[str(kind)], alpha=0.7)
        plane.set(
            title="two leading multipliers", xlabel="real part", ylabel="imaginary part", xlim=(-1.8, 1.8),
            ylim=(-1.2, 1.2), aspect="equal",
        )  # fmt: skip


def _starts(make: Maker, values: Sequence[float]) -> Iterator[tuple[float, Orbit | str]]:
    """Values and orbits at which a branch may start, or the reason why there is none."""
    for value in values:
        system, period = make(value)
        mapping, n, z = PeriodMap(system, period), system.size, np.concatenate([system.q0, system.v0])
        # The transient dies out first; then several states of the motion serve as starts.
        for periods in (SETTLE, *[AGAIN] * (STARTS - 1)):
            try:
                z = mapping.ahead(z, periods)
                yield value, periodic_orbit(system, period, (z[:n], z[n:]))
            except FAILURES as failure:
                yield value, _reason(failure)


def _reason(failure: Exception) -> str:
    return getattr(failure, "reason", str(failure))


def follow(make: Maker, values: Sequence[float], orbit: Orbit) -> tuple[Branch, str]:
    """Return the orbits along ``values`` from the one at the first, and the reason where they end before the last."""
    branch, least = [(values[0], orbit)], LEAST * abs(values[-1] - values[0])
    for target in values[1:]:
        step = target - branch[-1][0]
        while branch[-1][0] != target:
            ahead = branch[-1][0] + step
            value = target if abs(target - ahead) < least else ahead
            try:
                found = _next(make, branch, value)
            except FAILURES as failure:
                step *= 0.5
                if abs(step) < least:
                    last, orbit = branch[-1]
                    fold = np.min(np.abs(orbit.multipliers - 1.0)) < FOLD
                    met = "a fold, where two orbits meet and the branch turns back" if fold else _reason(failure)
                    return branch, f"at {last:.6g}: {met}"
                continue
            branch.append((value, found))
            step = np.copysign(min(2.0 * abs(step), abs(target - value)), step)
    return branch, ""


def _next(make: Maker, branch: Branch, value: float) -> Orbit:
    """Return the orbit at the next value; raise SolverFailure for one far from the line through the last two."""
    states = [np.concatenate([orbit.q, orbit.v]) for _, orbit in branch[-2:]]
    last, scale = branch[-1][0], branch[-1][1].sizes
    ahead = (value - last) / (last - branch[-2][0]) * (states[1] - states[0]) if len(states) > 1 else 0.0 * states[0]
    predicted, n = states[-1] + ahead, len(states[0]) // 2
    found = periodic_orbit(*make(value), (predicted[:n], predicted[n:]))
    away = float(np.max(np.abs(np.concatenate([found.q, found.v]) - predicted) / scale))
    if away > max(FAR * float(np.max(np.abs(ahead) / scale)), JUMP if len(states) == 1 else 1e-2 * JUMP):
        reason = "no orbit is close to the last one, as past a fold or a grazing"
        raise SolverFailure("periodic_orbit", found.period, reason, "take closer values")
    return found


def _unstable(orbit: Orbit) -> int:
    return int(np.sum(np.abs(orbit.multipliers) > 1.0 + ALONE))


def _changes(make: Maker, branch: Branch) -> Iterator[tuple[float, Row]]:
    """Values at which a multiplier crosses the unit circle, with the kind of the bifurcation and the tip."""
    from scipy.optimize import brentq

    for (low, one), (high, other) in pairwise(branch):
        if _unstable(one) == _unstable(other):
            continue
        k, known = min(_unstable(one), _unstable(other)), {low: one, high: other}

        def size(x: float, k: int = k, known: dict[float, Orbit] = known) -> float:
            if x not in known:
                known[x] = periodic_orbit(*make(x), known[min(known, key=lambda y: abs(y - x))])
            return float(np.log(np.abs(known[x].multipliers[k])) - np.log1p(ALONE))

        try:
            value = cast(float, brentq(size, low, high, xtol=1e-10 * abs(high - low)))
            located = abs(size(value)) < 1e-3  # else the multipliers jump
        except SolverFailure:  # no orbit, or a multiplier of 1 but for rounding
            value, located = min(known, key=lambda x: abs(size(x))), False
        m = complex(known[value].multipliers[k])
        kind = "torus" if abs(m.imag) > 1e-6 else "flip" if m.real < 0.0 else "branching"
        kind = kind if abs(abs(m) - 1.0) < 0.05 else "grazing"
        below, above = _stability(one), _stability(other)
        sides = f"{below} on both sides" if below == above else f"{below} below, {above} above"
        yield value, {"what": kind, "located": located, "tip": _tips(known[value], 1)[0], "sides": sides}


def _stability(orbit: Orbit) -> str:
    size = abs(orbit.multipliers[0])
    return "marginal" if abs(size - 1.0) <= ALONE else "stable" if size < 1.0 else "unstable"


def _tips(orbit: Orbit, length: int) -> list[float]:
    """The tip once a period of the drive."""
    return orbit.reference(1.0, np.linspace(0.0, orbit.period, length + 1)).tip[:-1].tolist()


def _rows(name: str, place: int, value: float, orbit: Orbit, length: int) -> list[Row]:
    """Rows of an orbit, one for each period of the drive."""
    m = np.append(orbit.multipliers, np.nan)
    shared = {
        "kind": "orbit", "length": length, "place": place, name: value, "stability": _stability(orbit),
        "events": len(orbit.events), "real": float(m[0].real), "imag": float(m[0].imag),
        "second_real": float(m[1].real), "second_imag": float(m[1].imag),
    }  # fmt: skip
    return [shared | {"phase": phase, "tip": tip} for phase, tip in enumerate(_tips(orbit, length))]
