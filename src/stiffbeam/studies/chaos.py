"""Divergence of neighbouring motions: Lyapunov exponents of the exact flow and of the schemes, and the portrait.

The horizon is shorter than a period of the drive, so one run from t = 0 sees one phase of it only. Pairs
are therefore started at many times along the exact motion and followed while their distance is small. Independent of
this, ``lyapunov`` measures the growth of tangent vectors along the exact motion.

Neighbours of a motion that is not chaotic diverge at most in proportion to t: twofold while t doubles. An impact that
one of them misses separates them once. An exponent is stated only if most pairs, with 95 %, diverge or approach more
than threefold in the second half of their time span, which fewer than 6 pairs cannot tell. A slope of ln distance alone
exists for any pair.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from scipy.stats import sem
from scipy.stats import t as student

from ..basics.arrays import Array
from ..basics.text import unit_of, with_unit
from ..basics.validation import InputError, positive
from ..figures.chart import Figure, lines, log_scale, look, name_lines, shared_legend, short
from ..files.cases import Case
from ..march.integrate import integrate_ensemble
from ..measures.report import extremes
from ..model.members import off_rigid_stops
from ..model.modes import undamped_modes
from ..model.scales import scales
from ..model.system import System
from ..model.time_functions import Harmonic, Sampled, Superposition
from ..references.ensemble import reference_ensemble
from . import base
from .base import Answer, Row, Study, Table, option

LINEAR = 1e-4  # of the motion's size: a pair farther apart no longer grows in proportion
ROUNDED = 1e-13  # of it: the distance of a closer pair is rounding
CLOSE, CLOSE_TO_TOLERANCE = 1e-11, 1e-7  # the distance of a pair: far above rounding, or an adaptive solver's errors
THREEFOLD = np.log(3.0)
STEPS = 10  # of a scheme in the span, at least
SURE = 6  # pairs, the fewest that can tell a median with 95 %: five alike have 1 chance in 16 to be so by chance


@dataclass(frozen=True, kw_only=True)
class Chaos(Study):
    """How fast do neighbouring motions diverge, and do the schemes diverge as fast as the exact flow?

    Pairs of neighbouring motions start along the exact motion, 1e-11 of it apart (1e-7 without an exact solution), and
    are followed for ``span``, by the exact solution and by every scheme.
    """

    schemes: base.Labels = option(*base.SCHEME_LABELS)
    form: str | None = option(*base.FORM)
    starts: int = option(48, "pairs of neighbouring motions", least=1)
    span: float | None = option(None, "time span of a pair; default: half the horizon")

    needs_motion: ClassVar = True
    all_cores: ClassVar = True
    height: ClassVar = 4.6
    labels: ClassVar = {
        "t": ("time since the start of the pair", "time"), "distance": ("distance over the motion's size", ""),
        "exponent": (r"exponent $\lambda$ in $e^{\lambda t}$", "rate"),
    }  # fmt: skip

    def points(self, case: Case) -> list[Row]:
        """Pairs by each method."""
        system = case.system(self.form)
        exact = base.solve_once(system, case.t_end)
        dt, span = case.dt, self.span
        most = (case.t_end if span is None else positive("span", span)) / STEPS
        if not dt <= most:
            raise InputError("dt", dt, f"be at most {most:.3g}, for {STEPS} steps of a span", "take a smaller one")
        ends = _recorded(system)
        if span is not None and span >= ends:
            remedy = "take a shorter span: each pair starts later than t = 0"
            raise InputError("span", span, f"end before the samples of the case, which reach t = {ends:g}", remedy)
        if span is None:  # a horizon may be shorter than some steps, or 0
            span = max(min(exact.horizon, case.t_end) / 2.0, STEPS * dt)
        known = exact.provenance["method"] == "exact"
        shared = {"size": CLOSE if known else CLOSE_TO_TOLERANCE, "span": dt * round(span / dt)}
        return [shared | {"method": method} for method in ("exact", *base.chosen_schemes(case, self.schemes))]

    def run(self, case: Case, method: str, size: float, span: float) -> list[Row]:
        """Exponent of every pair of neighbouring motions, and the mean distance over time."""
        system = case.system(self.form)
        basis, motion = undamped_modes(system), scales(system, case.t_end)
        exact = base.solve_once(system, case.t_end)
        dt, steps = case.dt, round(span / case.dt)
        # Starts all along the motion after its first tenth; samples of loads must cover the span of every pair.
        times = np.linspace(0.1, min(0.9, (_recorded(system) - span) / case.t_end), self.starts) * case.t_end
        assert exact.state_at is not None
        q, v = exact.state_at(times)
        # A direction of its own for every pair, of the same size in every mode's velocity.
        scale = float(np.max(np.hypot(basis.omega * basis.to_modal(q), basis.to_modal(v))))
        noise = np.random.default_rng(1).uniform(-1.0, 1.0, (2, *q.shape)) * size * scale
        omega = 2.0 * np.pi / motion.period
        dq = basis.to_nodal(noise[0] / motion.rates)
        dv = basis.to_nodal(noise[1])
        systems = [later(system, t, *state) for t, *state in zip(times, q, v, strict=True)]
        beside = [off_rigid_stops(one, x) for one, x in zip(systems, q + dq, strict=True)]
        systems += [later(system, t, *state) for t, *state in zip(times, beside, v + dv, strict=True)]
        if method == "exact":
            many = reference_ensemble(systems[0], span, systems, np.arange(steps + 1) * dt)
        else:
            scheme = base.chosen_schemes(case, self.schemes)[method]
            many = integrate_ensemble(systems[0], scheme, dt, span, systems, every=1)
        # (pairs, k): how far apart the two tips of every pair are, position and velocity together.
        distance = np.hypot(omega * np.subtract(*np.split(many.tip, 2)), np.subtract(*np.split(many.tip_velocity, 2)))
        largest = float(np.max(omega * np.abs(many.tip)))
        if largest <= ROUNDED * motion.speed:
            return [{"lost": "the motion at the observed point is rounding: its neighbours have no distance from it"}]
        rows: list[Row] = []
        for k, start in enumerate(times):
            exponent, late = growth(many.t, distance[k], max(ROUNDED, 1e-2 * size) * largest, LINEAR * largest)
            rows.append({"pair": k, "start": float(start), "exponent": exponent, "late": late})
        keep = np.unique(np.linspace(1, steps, 100).astype(int))
        # The geometric mean, since distances grow exponentially.
        mean = np.exp(np.mean(np.log(np.maximum(distance, np.finfo(float).tiny)), axis=0)) / largest
        return rows + [{"t": float(many.t[k]), "distance": float(mean[k])} for k in keep]

    def answer(self, table: Table, case: Case) -> Answer:
        """The exponents with their intervals, method by method."""
        means = exponents(table)
        known = {method: pair for method, pair in means.items() if pair is not None}
        if not means:
            return Answer(f"Fewer than {SURE} pairs could be followed long enough.")
        if not known:
            reason = "in the second half of the span the distance of most pairs changes by less than a factor of 3"
            return Answer(f"No exponential change of the distance is seen for {', '.join(means)}: {reason}.")
        cells = {x: "not exponential" if x in means else f"fewer than {SURE} pairs" for x in table.method.unique()}
        cells |= {method: f"{mean:.3g} ± {interval:.2g}" for method, (mean, interval) in known.items()}
        rates = {method: mean for method, (mean, _) in known.items() if method != "exact"}
        said = [f"{extremes(rates, '{:.3g}'.format)} for schemes"] if rates else []
        notes = "Means over the starts, ± 95 % by their scatter."
        if "exact" in known:
            said.insert(0, f"{cells['exact']} for the exact flow")
            time = unit_of(case.units, "time") or "unit of time"
            notes += f" The exact motion loses {known['exact'][0] / np.log(10.0):.2g} digits per {time}."
        rate = with_unit(case.units, "lambda", "rate")
        return Answer(
            f"Neighbouring motions diverge like exp(lambda t), lambda = {', '.join(said)}.",
            pd.DataFrame({"method": cells.keys(), rate: cells.values()}),
            notes,
        )

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """Mean distance of neighbouring motions, and their exponents."""
        labels, axes = table.attrs["labels"], figure.subplots(1, 2)
        distances = table[table.distance.notna()] if "distance" in table else table[:0]
        if len(distances):
            lines(axes[0], distances, "t", "distance", "method", marker="")
            axes[0].axhline(LINEAR, color="0.5", lw=0.9, ls=":")
            axes[0].text(distances.t.min(), 1.2 * LINEAR, "grows in proportion below", fontsize=8, color="0.3")
            log_scale(axes[0], x=False)
        axes[0].set(title="geometric mean over the pairs", xlabel=labels["t"], ylabel=labels["distance"])
        means, methods, axis = exponents(table), list(table.method.unique()), axes[1]
        values, jitter = [_finite(table, method, "exponent") for method in methods], np.random.default_rng(0)
        for i, (method, each) in enumerate(zip(methods, values, strict=True)):
            colour = look(method)["color"]
            axis.plot(each, i + jitter.uniform(-0.25, 0.25, len(each)), ".", ms=3, color=colour, alpha=0.5)
            if (known := means.get(method)) is not None:
                axis.errorbar(known[0], i, xerr=known[1], fmt="o", color=colour, lw=1.8)
        axis.axvline(0.0, color="0.5", lw=0.9)
        if any(map(len, values)):  # few starts are so far out that they would hide the others
            axis.set_xlim(*np.quantile(np.concatenate(values), [0.02, 0.98]))
        name_lines(axis, [short(method) for method in methods])
        axis.set(title="exponents: 96 % of the starts, mean, 95 % interval", xlabel=labels["exponent"])
        shared_legend(figure)


def _recorded(system: System) -> float:
    """The time at which the first of the system's samples ends, inf without any."""
    return min((float(record.t[-1]) for record in system.drive.records), default=np.inf)


def later(system: System, t: float, q: Array, v: Array) -> System:
    """The system from time ``t`` on, with t as its new zero and (q, v) as its initial data.

    Raises InputError for a function of time that cannot be moved.
    """
    system.drive.require_closed_form("a later start")

    def shift(function: Any) -> Any:
        if isinstance(function, Harmonic):
            return replace(function, phase=(function.phase + function.frequency * t) % (2.0 * np.pi))
        if isinstance(function, Sampled):
            return replace(function, t=function.t - t)
        if isinstance(function, Superposition):
            return Superposition(terms=[(factor, shift(f)) for factor, f in function.terms])
        return function

    return replace(
        system,
        q0=q,
        v0=v,
        loads=tuple((vector, shift(function)) for vector, function in system.loads),
        contacts=tuple(replace(c, offset=shift(c.offset)) for c in system.contacts),
    )


def growth(t: Array, distance: Array, least: float, limit: float) -> tuple[float, float]:
    """The slope of ln distance over t until the distance exceeds ``limit``, or falls again after it exceeded ``least``;
    and its growth in the second half of that time, NaN if that is too short."""
    seen = distance > least
    over = (distance > limit) | (np.logical_or.accumulate(seen) & ~seen)
    end = int(np.argmax(over)) if np.any(over) else len(t)
    here = np.flatnonzero(seen[:end])
    if len(here) < 10:
        return float("nan"), float("nan")
    late = here[t[here] >= 0.5 * (t[here[0]] + t[here[-1]])]
    slope, late_slope = (float(np.polyfit(t[part], np.log(distance[part]), 1)[0]) for part in (here, late))
    return slope, late_slope * float(t[late[-1]] - t[late[0]])


def exponents(table: Table) -> dict[str, tuple[float, float] | None]:
    """Mean exponent of every method of which SURE pairs or more were followed long enough, and the half-width of its
    95 % interval, by their scatter; None where the distances do not change exponentially."""
    means: dict[str, tuple[float, float] | None] = {}
    for method in table.method.unique():
        values, late = (_finite(table, method, name) for name in ("exponent", "late"))
        if len(late) < SURE:
            continue
        of_median = max(0, int(0.5 * len(late) - 0.98 * np.sqrt(len(late))))  # rank of its 95 % bound
        late = np.sort(late)
        grown = late[of_median] > THREEFOLD or late[-1 - of_median] < -THREEFOLD
        interval = float(student.ppf(0.975, len(values) - 1) * sem(values))
        means[method] = (float(np.mean(values)), interval) if grown else None
    return means


def _finite(table: Table, method: str, name: str) -> Array:
    return table[table.method == method].get(name, pd.Series(dtype=float)).dropna().to_numpy(float)
