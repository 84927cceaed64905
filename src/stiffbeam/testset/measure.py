"""The errors of a motion, from arrays or a file of any program, against the answers of a problem, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.text import plain
from ..basics.validation import InputError, unmasked
from ..files.columns import TIMES, bare, read_columns, time_of
from ..measures.errors import Order, observed_order
from ..model.contact import channel_motion, channel_position
from ..trajectory.recorder import distinct_times, one_position, rebounds, sampled_impacts
from ..trajectory.records import Impacts
from .problem import Problem

PAIRED = 8  # impacts that are held against the known ones
TINY = 1e-300  # a velocity that changes by less is constant
ALIKE = 0.05  # of a motion: what may be left of it where it is another one but for a factor
UNSHIFTED = 0.2  # of the error of a motion: what may be left of it where it is a shift in time
SLACK = 2.0**-23  # of t_end: single precision may end before it
CLOCKS = (1e3, 1e6, 1e9)  # milliseconds, microseconds, nanoseconds in place of seconds


@dataclass(frozen=True, eq=False)
class Motion:
    """Output of an integrator at times t (k,): the tip u and its velocity v, None if it has none.

    states: (q, q') at t_end, (n,) each. position, velocity: of the first contact relative to its stops, at t. impacts:
    the integrator's own impact times if it has them; else those of position and velocity. gradients: derivatives of the
    tip at t_end by the path of a parameter.
    """

    t: Array
    u: Array
    v: Array | None = None
    states: tuple[Array, Array] | None = None
    position: Array | None = None
    velocity: Array | None = None
    impacts: Impacts | None = None
    peak_force: float | None = None
    gradients: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Errors:
    """tip_rms, tip_max: of u - u_known at the sample times over max |u_known|. velocity: the median of |v - v_known|
    over max |v_known|, which a jump at a sample does not spoil. impacts: how many. impact_time: the largest error of
    the first ``PAIRED`` impact times, NaN where one is missing. peak_force: relative. energy: at t_end, over the energy
    the system has had; > 0 gained. factor: that of u over u_known, where u is the known motion but for it, NaN where it
    is 1 or there is none. clock: its times over those of the known motion, where it is that but for them, NaN else.
    rate: what the tip's velocity has to be multiplied by to be the rate of its position, less 1. lag: the steps by
    which the velocity is behind that rate. gradient: the largest relative error of the derivatives of the tip at t_end.
    shift: the steps by which u as a whole is behind u_known, NaN where that is not most of its error.
    What the motion does not give is NaN, or -1 impacts.
    """

    tip_rms: float
    tip_max: float
    impacts: int = -1
    impact_time: float = float("nan")
    peak_force: float = float("nan")
    energy: float = float("nan")
    factor: float = float("nan")
    velocity: float = float("nan")
    rate: float = float("nan")
    clock: float = float("nan")
    gradient: float = float("nan")
    lag: float = float("nan")
    shift: float = float("nan")


def motion_of(problem: Problem, t: Any, u: Any, v: Any = None, t_end: float | None = None) -> Motion:
    """Arrays of any program as a Motion: t (k,) increasing to t_end, u and v the tip (k,), or all unknowns (k, n).

    Of rows at one time, as at an event, the last counts.

    t_end: the problem's by default.
    Raises InputError for other shapes, numbers that are not finite, and times that do not cover the samples.
    """
    system, n = problem.system, problem.system.size
    unmasked("the run", t, u, v)
    t, u = np.asarray(t, float), np.asarray(u, float)
    v = None if v is None else np.asarray(v, float)
    if t.ndim != 1 or len(t) < 4 or u.shape not in ((len(t),), (len(t), n)) or (v is not None and v.shape != u.shape):
        shapes = (t.shape, u.shape, None if v is None else v.shape)
        remedy = "give at least 4 times, and one position per time"
        raise InputError("the run", shapes, f"be times (k,) and positions, and velocities, (k,) or (k, {n})", remedy)
    if not all(np.all(np.isfinite(x)) for x in (t, u, v) if x is not None):
        raise InputError("the run", "a number that is not finite", "be finite", "end the run before it overflows")
    t_end = problem.t_end if t_end is None else t_end
    t, rows = distinct_times("the run's times", given := t)
    one_position("the run's times", given, rows, u)
    u, v = u[rows], None if v is None else v[rows]
    slack = SLACK * t_end
    if t[0] > problem.times[0] + slack or t[-1] < t_end - slack:
        remedy = "start at the first time that is asked for, and end no earlier than t_end"
        raise InputError("the run's times", (t[0], t[-1]), f"reach t_end = {t_end:g}", remedy)
    if np.count_nonzero(t <= t_end + slack) < 4:
        rule = f"hold four steps at least to t_end = {t_end:g}"
        raise InputError("the run's times", (t[0], t[-1]), rule, "are they in another unit?")
    contact, row = system.contacts[0], system.channels[system.tip_channel][0]
    last, states, position, velocity = int(np.argmin(np.abs(t - t_end))), None, None, None
    if n == 1 and u.ndim == 1:
        u, v = u[:, None], None if v is None else v[:, None]
    if u.ndim == 2:
        states = None if v is None else (u[last], v[last])
        position = channel_position(contact.row, contact.offset, t, u)
        velocity = None if v is None else channel_motion(contact.row, contact.offset, t, u, v)[1]
        u, v = u @ row, None if v is None else v @ row
    # The tip is the contact: its positions serve as both.
    elif np.array_equal(row, contact.row) and contact.offset is None:
        position, velocity = u, v
    return Motion(t, u, v, states, position, velocity)


def errors_of(problem: Problem, motion: Motion) -> Errors:
    """The errors of a motion against the answers of ``problem``."""
    known = problem.answers["tip"].value
    seen = _at(problem.times, motion)
    off = np.abs(seen - known) / np.max(np.abs(known))
    count, late, peak = -1, float("nan"), float("nan")
    impacts = impacts_of(problem, motion)
    if impacts is not None:
        count, late = impacts.count, _late(problem, impacts.times)
        peak = _peak(problem, motion)
    rms = float(np.sqrt(np.mean(off**2)))
    return Errors(rms, float(np.max(off)), count, late, peak, _energy_error(problem, motion),
                  _factor(seen, known), _velocity_error(problem, motion), _rate(motion),
                  _clock(problem, motion) if rms > ALIKE else float("nan"), _gradient(problem, motion),
                  _lag(motion), _shift(problem, motion, seen))  # fmt: skip


def _velocity_error(problem: Problem, motion: Motion) -> float:
    if motion.v is None or "tip_velocity" not in problem.answers:
        return float("nan")
    known = problem.answers["tip_velocity"].value
    seen = _at(problem.times, replace(motion, u=motion.v, v=None))
    return float(np.median(np.abs(seen - known)) / np.max(np.abs(known)))


def _gradient(problem: Problem, motion: Motion) -> float:
    """The largest relative error of the derivatives that are known."""
    known, found = problem.derivatives.get("tip", {}), motion.gradients or {}
    return max((abs(found[path] / known[path].value - 1.0) for path in known.keys() & found), default=float("nan"))


def _rate(motion: Motion) -> float:
    """a - 1, a of least squares in u(t_k+1) - u(t_k) = a times the trapezoid under v."""
    if motion.v is None:
        return float("nan")
    moved, under = np.diff(motion.u), 0.5 * (motion.v[1:] + motion.v[:-1]) * np.diff(motion.t)
    return float(moved @ under / (under @ under)) - 1.0 if np.any(under) else float("nan")


def _lag(motion: Motion) -> float:
    """Median over the steps of the s in u(t_k+1) - u(t_k) = dt ((v_k + v_k+1)/2 + s (v_k+1 - v_k))."""
    if motion.v is None:
        return float("nan")
    gained, dt = np.diff(motion.v), np.diff(motion.t)
    moving = np.abs(gained) >= max(float(np.median(np.abs(gained))), TINY)
    off = np.diff(motion.u) - 0.5 * (motion.v[1:] + motion.v[:-1]) * dt
    return float(np.median((off / dt)[moving] / gained[moving])) if np.any(moving) else float("nan")


def _shift(problem: Problem, motion: Motion, seen: Array) -> float:
    """The s of least squares in u_known(t) - u(t) = s dt v_known(t), dt a step of equal ones; NaN where that leaves
    more than ``UNSHIFTED`` of the difference."""
    off, steps = problem.answers["tip"].value - seen, np.diff(motion.t)
    if "tip_velocity" not in problem.answers or np.ptp(steps) > 1e-6 * np.max(steps) or not np.any(off):
        return float("nan")
    rate = problem.answers["tip_velocity"].value * np.median(steps)
    s = float(off @ rate / (rate @ rate))
    return s if np.linalg.norm(off - s * rate) < UNSHIFTED * np.linalg.norm(off) else float("nan")


def _factor(seen: Array, known: Array) -> float:
    """The a of least squares in seen = a known, where that leaves less than ``ALIKE`` of seen and a is not about 1."""
    a = float(seen @ known / (known @ known))
    alike = np.linalg.norm(seen - a * known) < ALIKE * np.linalg.norm(seen)
    return a if alike and abs(a - 1.0) > 2.0 * ALIKE else float("nan")


def _clock(problem: Problem, motion: Motion) -> float:
    """The c of CLOCKS for which u(c t) is the known motion to less than ``ALIKE``; NaN if there is none."""
    known = problem.answers["tip"].value
    for c in CLOCKS:
        if motion.t[0] <= c * problem.times[0] and c * problem.times[-1] <= motion.t[-1] * (1.0 + 1e-9):
            off = _at(c * problem.times, replace(motion, v=None)) - known
            if np.sqrt(np.mean(off**2)) < ALIKE * np.max(np.abs(known)):
                return c
    return float("nan")


def _at(times: Array, motion: Motion) -> Array:
    """u at the sample times: the run's own values where it has these times, else cubic interpolation."""
    from scipy.interpolate import CubicHermiteSpline, CubicSpline

    nearest = np.clip(np.searchsorted(motion.t, times), 1, len(motion.t) - 1)
    nearest -= np.abs(motion.t[nearest - 1] - times) < np.abs(motion.t[nearest] - times)
    if np.all(np.abs(motion.t[nearest] - times) <= 1e-9 * times[-1]):
        return motion.u[nearest]
    spline = CubicSpline(motion.t, motion.u) if motion.v is None else CubicHermiteSpline(motion.t, motion.u, motion.v)
    return spline(np.minimum(times, motion.t[-1]))


def impacts_of(problem: Problem, motion: Motion, t_end: float | None = None) -> Impacts | None:
    """The impacts of the first contact to t_end: the motion's own, or by the rule for steps. None if there are neither,
    or only positions with steps too long for rebounds that follow each other."""
    if motion.impacts is not None:
        return motion.impacts
    u, v, t = motion.position, motion.velocity, motion.t
    if u is None:
        return None
    inside = t <= (problem.t_end if t_end is None else t_end) * (1 + 1e-9)
    t, u, v = t[inside], u[inside], None if v is None else v[inside]
    stops = problem.system.contacts[0].stops
    if stops.rigid:
        known = _known_impacts(problem)
        # From positions alone, impacts that follow each other within three steps cannot be told apart.
        told_apart = v is not None or 3.0 * np.max(np.diff(t)) < np.min(np.diff(known), initial=np.inf)
        return rebounds(t, u, v, stops) if told_apart else None
    if v is None:
        from scipy.interpolate import CubicSpline

        v = np.asarray(CubicSpline(t, u)(t, 1))
    return sampled_impacts(t, u, v, stops)


def _known_impacts(problem: Problem) -> Array:
    """The first known impact times, up to PAIRED of them."""
    return problem.answers["impacts"].value[:PAIRED] if "impacts" in problem.answers else np.zeros(0)


def _late(problem: Problem, times: Array) -> float:
    """The largest error of the first impact times; NaN where none is known, or one is missing."""
    known = _known_impacts(problem)
    if not 0 < len(known) <= len(times):
        return float("nan")
    return float(np.max(np.abs(times[: len(known)] - known)))


def _peak(problem: Problem, motion: Motion) -> float:
    if "peak_force" not in problem.answers:
        return float("nan")
    known = problem.answers["peak_force"].value
    if motion.peak_force is not None:
        return motion.peak_force / known - 1.0
    if motion.position is None:
        return float("nan")
    stops = problem.system.contacts[0].stops
    if stops.dissipative and motion.velocity is None:
        return float("nan")
    u, v = _between_steps(motion, np.abs(stops.force(motion.position, motion.velocity)))
    return float(np.max(np.abs(stops.force(u, v)))) / known - 1.0


def _between_steps(motion: Motion, force: Array) -> tuple[Array, Array]:
    """Position and velocity of the contact at the steps, and by cubics where it turns between them and, of damped
    stops, beside the largest forces.

    The largest of the steps alone is less by up to (w dt)^2/8, and as much again with half the steps where they share
    the one next to the peak.
    """
    from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator

    t, u, v = motion.t, motion.position, motion.velocity
    assert u is not None
    spline = CubicSpline(t, u) if v is None else CubicHermiteSpline(t, u, v)
    # A damped stop may have its peak where the position does not turn: look beside the largest forces too.
    high = np.flatnonzero(force >= 0.9 * np.max(force))
    ends = np.unique(np.clip(np.concatenate([high - 1, high]), 0, len(t) - 2))
    fine = (t[ends, None] + np.diff(t)[ends, None] * np.linspace(0.0, 1.0, 33)[1:-1]).ravel()
    turns = spline.derivative().roots(extrapolate=False)
    fine = np.concatenate([fine, turns[np.isfinite(turns)]])
    rate = spline.derivative() if v is None else PchipInterpolator(t, v)  # not the cubic's: rounding of u over dt
    return np.concatenate([u, spline(fine)]), np.concatenate([rate(t), rate(fine)])


def _energy_error(problem: Problem, motion: Motion) -> float:
    if motion.states is None or "energy" not in problem.answers:
        return float("nan")
    q, v = motion.states
    energy = float(sum(problem.system.free_energies(q, v)))
    for contact in () if problem.rigid else problem.system.contacts:
        if contact.offset is not None:
            return float("nan")
        stops, (u, rate) = contact.stops, channel_motion(contact.row, None, 0.0, q, v)
        if stops.state(u, rate):  # what a damped stop holds when it has let go is dissipated
            energy += float(stops.energy(u))
    return (energy - problem.answers["energy"].value) / problem.answers["energy_scale"].value


SAMPLE = 200  # numbers that are looked at
DIGITS = range(3, 10)  # that are few
SINGLE, NEAR = 2.0**-23, 5e-9  # the spacing of single precision; what a decimal of one is off by, relative


def lost_to_digits(problem: Problem, motion: Motion) -> float:
    """Largest error of the tip from rounding of the positions, and of times that are not equidistant, over its largest
    displacement; 0 for doubles."""
    rounding = _spacing(motion.u)
    if rounding and np.ptp(np.diff(motion.t)) > 1e-9 * problem.t_end and "tip_velocity" in problem.answers:
        largest, fastest = (np.max(np.abs(problem.answers[name].value)) for name in ("tip", "tip_velocity"))
        rounding += _spacing(motion.t) * float(motion.t[-1] * fastest / largest)
    return rounding


def _spacing(x: Array) -> float:
    """Between the numbers that x was rounded to, over the largest |x|; 0 where no rounding shows."""
    numbers = x[x != 0.0]
    numbers = numbers[:: max(1, len(numbers) // SAMPLE)]
    if not len(numbers):
        return 0.0
    single = numbers.astype(np.float32).astype(float)
    if np.all(np.abs(numbers - single) <= NEAR * np.abs(numbers)):
        return SINGLE
    largest = float(np.max(np.abs(numbers)))
    # Few significant digits, or few decimal places.
    for digits in DIGITS:
        if all(float(f"{v:.{digits - 1}e}") == v for v in numbers):
            return 10.0 ** (1 - digits)
        places = digits - 1 - int(np.floor(np.log10(largest)))
        if places >= 0 and all(float(f"{v:.{places}f}") == v for v in numbers):
            return 10.0**-places / largest
    return 0.0


NAMES = {"u": ("u", "tip", "displacement"), "v": ("v", "velocity", "tip_velocity")}
COLUMNS = (["t", "u"], ["t", "u", "v"])


def read_trajectory(file: Path) -> tuple[Array, ...]:
    """(t, u), or (t, u, v) where there is a third column, see ``read_columns``.

    A first line may name them in any order: t or time; u, tip or displacement; v, velocity or tip_velocity. Without
    names that is the order. Raises InputError for other names, and for less than four rows.
    """
    table = read_columns(file, "--trajectory")
    names = ["tuv"[x] if isinstance(x, int) and x < 3 else _known(x) for x in table.columns]
    if sorted(names) not in COLUMNS:
        written = f"{file}: {' '.join(map(str, table.columns))!r}"
        raise InputError("--trajectory", written, "name t, u and perhaps v, each once", "write for example t,u,v")
    if len(table) < 4:
        found, remedy = f"{file}: {len(table)} lines of numbers", "write the run out at more times"
        raise InputError("--trajectory", found, "hold at least 4 of them", remedy)
    time_of(file, "--trajectory", table)
    return tuple(table.iloc[:, names.index(name)].to_numpy(float) for name in "tuv" if name in names)


def _known(name: object) -> str:
    """t, u or v for one of its names, else the name itself."""
    return "t" if bare(name) in TIMES else next((x for x, names in NAMES.items() if bare(name) in names), str(name))


NOT_TAKEN, FAILED = "not taken", "failed"
CONVERGES, NOT_FALLING, LOW_ORDER = "converges", "error does not fall", "order too low"
ONE_RUN, TOO_ALIKE, FEW_DIGITS = "one run", "steps too alike", "too few digits"
SPAN = 0.26  # of the longest step, what the shortest is at most where it is judged how errors fall
FLOOR = 1e-9  # of max |u|: below it rounding hides how an error falls
STEADY = 1.25  # what an error that has come to stay may scatter by
FALL = 0.5  # of an error: what is left of it at a quarter of the step where a method is of order 1/2
ORDER_SLACK = 0.5  # of an observed order: where an impact lies within its step scatters the errors
COARSE = 0.1  # of max |v|: below it the velocity's median error may fall slowly in problems without an order limit
LATE, STAGGERED = 0.75, 0.25  # steps that a velocity may be behind at order 1, as in Euler's methods, and at order 2
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
    standard deviations of the exact ensemble. missed: errors besides the tip's that do not converge; "motion" where it
    is late as a whole.
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
    through all steps, its 95 % interval included, come within ``ORDER_SLACK`` of what is expected; the errors of impact
    times, peak force, energy and velocity must fall as well (``_missed``), and velocity and tip must be those of their
    time (``_late_by``). The error of an adaptive solver must stay within ``TIMES_TOLERANCE`` times its tolerance. Steps
    that span less than a factor of four are not judged.
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
    above = (errors > FLOOR) & np.isfinite(errors)
    order = observed_order(1.0 / levels[above], errors[above])
    expected = min(smooth, entry.problem.order_limit) if entry.problem.order_limit > 0.0 else float("nan")
    entry = replace(entry, order=order, expected=expected)
    if not _falls(levels, errors):
        return replace(entry, outcome=NOT_FALLING)
    if missed := _missed(entry, levels):
        return replace(entry, outcome=NOT_FALLING, missed=missed)
    low = np.count_nonzero(above) >= 4 and order.slope + order.interval < expected - ORDER_SLACK
    # Half a step is the rule for methods of order 1, and on rigid stops, where all are of order 1.
    second = entry.problem.order_limit >= 2.0 and order.slope - order.interval > 1.0 + STAGGERED
    reasons, late = [entry.reason] if entry.reason else [], list[str]()
    for name, what, allowed in (("lag", "velocity", STAGGERED if second else LATE), ("shift", "motion", STAGGERED)):
        if abs(steps := _late_by(entry, name)) > allowed:
            reasons.append(
                f"the {what} is that of {abs(steps):.2f} steps {'before' if steps > 0.0 else 'after'} its time"
            )
            late += [what] if what == "velocity" or low or abs(steps) > LATE else []
    if 0 <= (seen := entry.runs[-1].errors.impacts) < (most := len(_known_impacts(entry.problem))):
        reasons.append(f"the finest run has {seen} of the first {most} impacts")
    outcome = LOW_ORDER if low or late else CONVERGES
    return replace(entry, outcome=outcome, missed=tuple(late), reason="; ".join(dict.fromkeys(reasons)))


def _late_by(entry: Entry, name: str) -> float:
    """Steps by which the finest runs are late, by ``lag`` or ``shift`` of their errors; 0 unless all are late alike."""
    lags = np.array([getattr(run.errors, name) for run in entry.runs[-max(3, len(entry.runs) // 3) :]])
    return float(lags[-1]) if np.ptp(lags) < (STEADY - 1.0) * np.min(np.abs(lags)) else 0.0


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
    stays = np.max(last) < STEADY * np.min(last) and most(len(last)) < 0.5
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
