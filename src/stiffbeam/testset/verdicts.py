"""Verdict on one integrator and one problem: its runs, its observed order, and the outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.text import plain
from ..measures.errors import Order, observed_order
from .measure import Errors
from .problem import Problem

NOT_TAKEN, FAILED = "not taken", "failed"
CONVERGES, NOT_FALLING, LOW_ORDER = "converges", "error does not fall", "order too low"
ONE_RUN, TOO_ALIKE, FEW_DIGITS = "one run", "steps too alike", "too few digits"
SPAN = 0.26  # of the longest step, what the shortest is at most where it is judged how errors fall
FLOOR = 1e-9  # of max |u|: below it rounding hides how an error falls
ALIKE = 1.25  # what an error that has come to stay may scatter by
FALL = 0.5  # of an error: what is left of it at a quarter of the step where a method is of order 1/2
SLACK = 0.5  # of an observed order: where an impact lies within its step scatters the errors
COARSE = 0.1  # of max |v|: below it the velocity's median error may fall slowly in problems without an order limit
RATE = 0.02  # what the velocity may be off by as a whole from the rate of the position
MAGNIFIED = 100.0  # times what its digits make of the tip may be lost in the rest of a motion
TIMES_TOLERANCE = 1e4  # an adaptive solver through contact stays within so many times its relative tolerance
NONE = Order(float("nan"), float("nan"), float("nan"), 0)


@dataclass(frozen=True)
class Run:
    """level: steps, or the relative tolerance; cost: stages, right-hand sides, or steps of a function."""

    level: float
    cost: float
    seconds: float
    errors: Errors


@dataclass(frozen=True)
class Entry:
    """Result of one integrator on one problem. outcome: a verdict, "not taken" or "failed" with a ``reason``.

    order: observed, through the errors above rounding. expected: the lesser of its order on smooth motion and the
    ``order_limit`` of the problem; NaN if it is unknown. past: past the horizon, the deviation at each of the steps in
    standard deviations of the exact ensemble. missed: errors besides the tip's that do not converge.
    """

    integrator: str
    problem: Problem = field(repr=False)
    runs: tuple[Run, ...]
    outcome: str
    reason: str
    stated: float
    adaptive: bool
    past: tuple[dict[str, float], ...] = ()
    order: Order = NONE
    expected: float = float("nan")
    missed: tuple[str, ...] = ()

    @property
    def flagged(self) -> bool:
        """True if the outcome is a fault of the integrator."""
        return self.outcome in (NOT_FALLING, LOW_ORDER, FAILED)

    @property
    def best(self) -> Errors | None:
        """The errors of the finest run."""
        return self.runs[-1].errors if self.runs else None

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and texts; NaN becomes None."""
        return plain({
            "integrator": self.integrator, "problem": self.problem.name, "outcome": self.outcome, "reason": self.reason,
            "order": self.order.slope, "order_interval": self.order.interval, "expected_order": self.expected,
            "missed": list(self.missed),
            "runs": [{"rtol" if self.adaptive else "steps": r.level, "cost": r.cost, "seconds": r.seconds,
                      **asdict(r.errors)} for r in self.runs],
            "past_horizon": list(self.past),
        })  # fmt: skip


def verdict(entry: Entry, smooth: float) -> Entry:
    """``entry`` with its observed order and, unless it was not taken or failed, its outcome.

    smooth: the order of the integrator on smooth motion. A fixed-step error must fall (``_falls``), and the order
    through all steps, its 95 % interval included, come within ``SLACK`` of what is expected; the errors of impact
    times, peak force, energy and velocity must fall as well (``_missed``); the error of an adaptive solver must stay
    within ``TIMES_TOLERANCE`` times its tolerance. Steps that span less than a factor of four are not judged.
    """
    levels = np.array([run.level for run in entry.runs])
    errors = np.array([run.errors.tip_rms for run in entry.runs])
    if entry.outcome in (NOT_TAKEN, FAILED) or not len(errors):
        return entry
    # Steps within a factor of four do not show how errors fall.
    if not entry.adaptive and np.min(levels) > SPAN * np.max(levels):
        return replace(entry, outcome=TOO_ALIKE if np.ptp(levels) else ONE_RUN)
    if entry.adaptive:
        limit = TIMES_TOLERANCE * levels[-1]
        good = errors[-1] <= max(limit, FLOOR)
        return replace(entry, outcome=CONVERGES if good else NOT_FALLING)
    # The order through the errors that rounding does not hide.
    seen = errors > FLOOR
    order = observed_order(1.0 / levels[seen], errors[seen])
    expected = min(smooth, entry.problem.order_limit) if entry.problem.order_limit > 0.0 else float("nan")
    entry = replace(entry, order=order, expected=expected)
    if not _falls(levels, errors):
        return replace(entry, outcome=NOT_FALLING)
    if missed := _missed(entry, levels):
        return replace(entry, outcome=NOT_FALLING, missed=missed)
    low = np.count_nonzero(seen) >= 4 and order.slope + order.interval < expected - SLACK
    return replace(entry, outcome=LOW_ORDER if low else CONVERGES)


def _missed(entry: Entry, levels: Array) -> tuple[str, ...]:
    """Names of the errors besides the tip's that do not converge. An impact that only one of run and answer has counts
    as late by t_end."""
    errors = [run.errors for run in entry.runs]
    known = entry.problem.answers
    late = np.array([e.impact_time for e in errors]) / entry.problem.t_end
    counts = np.array([e.impacts for e in errors])
    if "impacts" in known:
        missing = np.isnan(late) & (counts >= 0)
        late[missing] = 1.0 if len(known["impacts"].value) else counts[missing] > 0
    judged = {
        "impact times": late,
        "peak force": np.abs([e.peak_force for e in errors]),
        "energy": np.abs([e.energy for e in errors]),
        "gradient": np.array([e.gradient for e in errors]),
    }
    off_names = [name for name, x in judged.items() if np.all(np.isfinite(x)) and not _falls(levels, x)]
    velocity, rate = np.array([[e.velocity, abs(e.rate)] for e in errors]).T
    coarse = COARSE if entry.problem.order_limit == 0.0 else 0.0
    off = [np.all(np.isfinite(x)) and x[-1] > least and not _falls(levels, x)
           for x, least in ((velocity, coarse), (rate, RATE))]  # fmt: skip
    if any(off):
        off_names.append("velocity")
    return tuple(off_names)


def _falls(levels: Array, errors: Array) -> bool:
    """Return True if errors fall with the step. Either the median of the finest errors is below ``FALL`` times that of
    steps four times as long, or the order through the finer half of the runs may be 1/2 or more, its 95 % interval
    included. Without such an order the errors of the finest third must differ.

    Medians over a third of the runs each. One error may be small by chance, and those of impacts scatter as these lie
    within their steps; an error that has come to stay does neither, however much coarser steps add to it.
    """
    count = max(1, len(errors) // 3)
    before = np.flatnonzero(levels <= SPAN * np.max(levels))
    fine, coarse = np.median(errors[-count:]), np.median(errors[before[-count:]])
    if fine <= FLOOR:
        return True

    def most(runs: int) -> float:
        """The largest order that the finest runs allow; NaN for two."""
        order = observed_order(1.0 / levels[-runs:], np.maximum(errors[-runs:], FLOOR))
        return order.slope + order.interval

    # The finest errors are nearly equal and leave no room for an order of 1/2: they have come to stay.
    last = errors[-max(3, count) :]
    stays = np.max(last) < ALIKE * np.min(last) and most(len(last)) < 0.5
    return not stays and bool(fine <= FALL * coarse or most(max(4, len(errors) // 2)) >= 0.5)


def with_digits(entry: Entry, lost: float) -> Entry:
    """``entry`` without a verdict if errors that do not fall are no larger than ``lost``, the error of the tip from the
    rounding of its numbers."""
    if entry.outcome != NOT_FALLING or not entry.best:
        return entry
    last = entry.best
    others = {
        "impact times": last.impact_time / entry.problem.t_end, "peak force": last.peak_force, "energy": last.energy,
        "velocity": last.velocity, "gradient": last.gradient,
    }  # fmt: skip
    if not (last.tip_rms <= lost and all(abs(others[name]) <= MAGNIFIED * lost for name in entry.missed)):
        return entry
    reason = f"rounding of its numbers alone causes errors of up to {shown_error(lost)}: write more digits"
    return replace(entry, outcome=FEW_DIGITS, reason=reason, missed=())


def shown_error(x: float) -> str:
    """An error with two digits, empty if it is not known."""
    return "" if not np.isfinite(x) else "0" if x == 0.0 else f"{x:.1e}"


def summary(entries: Sequence[Entry]) -> str:
    """Number of entries for each outcome, as a sentence."""
    outcomes = [CONVERGES, ONE_RUN, TOO_ALIKE, FEW_DIGITS, LOW_ORDER, NOT_FALLING, FAILED, NOT_TAKEN]
    counts = {outcome: sum(entry.outcome == outcome for entry in entries) for outcome in outcomes}
    return ", ".join(f"{count} {outcome}" for outcome, count in counts.items() if count)
