"""Errors of a motion and of its impacts against a reference, and the order in which they fall with the step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array, step_lengths
from ..basics.validation import InputError, positive
from ..model.scales import scales
from ..model.system import System
from ..trajectory.records import Impacts, at_rest_until
from ..trajectory.trajectory import Reference, Trajectory


def run_of(run: Any, reference: Any, asked: str) -> Trajectory:
    """``run``, or its arrays (t, tip), (t, tip, tip velocity) or (t, q, v) as a run of the reference's system.

    Raises InputError where they are something else or of two systems, with what differs, or without a horizon.
    """
    if isinstance(run, (tuple, list)) and len(run) in (2, 3) and isinstance(reference, Reference):
        run = Trajectory.from_arrays(*run, system=reference.system)
    if not isinstance(run, Trajectory) or not isinstance(reference, Reference):
        got = f"{type(run).__name__}, {type(reference).__name__}"
        rule = "be given a run, or its arrays [t, tip], [t, tip, tip velocity] or [t, q, v], and then a reference"
        raise InputError(asked, got, rule, "reference() makes one, load() reads a saved run")
    if run.fingerprint != reference.fingerprint:
        rule = f"be of the same system as {run.label}"
        if run.system is not None and reference.system is not None:
            rule += f"; they differ in: {', '.join(run.system.differences(reference.system))}"
        raise InputError("reference", reference.label, rule, "solve run.system")
    if not np.isfinite(reference.horizon):
        raise InputError("reference.horizon", reference.horizon, "be known", "make it with stiffbeam.reference")
    return run


def relative_error(u: Array, u_ref: Array) -> Array:
    """(u - u_ref)/max |u_ref|, (k,); u - u_ref itself for a reference at rest."""
    return (u - u_ref) / (float(np.max(np.abs(u_ref))) or 1.0)


def rms(error: Array, t: Array | None = None) -> float:
    """Root of the mean square of error (k,), at times t (k,) of the mean over time."""
    return float(np.sqrt(np.average(error**2, weights=None if t is None else step_lengths(t))))


def tip_error(u: Array, u_ref: Array) -> tuple[float, float]:
    """rms and largest size of the ``relative_error`` of u (k,) against u_ref (k,) at the same times, k >= 1."""
    error = relative_error(u, u_ref)
    return rms(error), float(np.max(np.abs(error)))


WIDEST = 1.5  # an interval wider than this cannot tell one order from the next


@dataclass(frozen=True)
class Order:
    """error = C step^slope by least squares; slope +- interval holds with 95 % (Student's t, n - 2)."""

    slope: float
    interval: float
    constant: float
    points: int

    @property
    def unclear(self) -> bool:
        """Return True if the interval is too wide for a convergence rate, or wider than the order itself."""
        return 2.0 * self.interval > min(WIDEST, abs(self.slope))

    def __str__(self) -> str:
        if self.unclear:
            return "no clear rate"
        return f"{self.slope:.2f} " + (f"± {self.interval:.2f}" if np.isfinite(self.interval) else "(two points)")


def observed_order(steps: ArrayLike, errors: ArrayLike) -> Order:
    """The Order through (steps, errors), all > 0; NaN for fewer than two steps, no interval for two points."""
    x, y = np.log(np.asarray(steps, float)), np.log(np.asarray(errors, float))
    n = len(x)
    nan = float("nan")
    if len(np.unique(x)) < 2:
        return Order(nan, nan, nan, n)
    from scipy import stats  # whose import takes as long as that of all the rest of SciPy

    fit: Any = stats.linregress(x, y)
    with np.errstate(over="ignore"):  # of a steep line through a run that overflowed
        constant = float(np.exp(fit.intercept))
    # A line through two points leaves no scatter to estimate.
    interval = float(stats.t.ppf(0.975, n - 2) * fit.stderr) if n > 2 else nan
    return Order(float(fit.slope), interval, constant, n)


@dataclass(frozen=True)
class ContactMeasures:
    """Measures of one contact of a trajectory over a span: sampled impacts, share of steps in contact, peak |sigma| and
    impulse, the sum of |sigma| dt. Of a solver with events: the share of time, the peak between the steps and the
    integral of |sigma|. event_impacts: the impacts of the trajectory itself; those of a reference are by events."""

    impacts: int = 0
    event_impacts: int = 0
    fraction: float = 0.0
    peak_force: float = 0.0
    impulse: float = 0.0


@dataclass(frozen=True)
class Matching:
    """The i-th impact of a run paired with the i-th of the reference, both sampled ``after_rest``, up to ``window``.

    A pair holds if both hit the same stop and |t_run - t_ref| is less than half the smaller gap to the
    neighbouring reference impacts, and no more than ``longest_delay``. matched_until: the reference time of
    the first pair that does not hold, the time of an impact without a partner, or the window.
    median_delay: the median of t_run - t_ref over all pairs that hold; > 0 means late, NaN where there is no pair.
    """

    matched: int
    matched_until: float
    median_delay: float


def longest_delay(system: System, t_end: float) -> float:
    """A quarter of the longest time scale of a run to t_end. Impacts that are later are no pair."""
    return 0.25 * scales(system, t_end).period


def match(run: Impacts, reference: Impacts, window: float, longest: float = np.inf) -> Matching:
    """Pair two impact sequences; both may reach past ``window``. longest: see ``longest_delay``."""
    n, times = min(run.count, reference.count), reference.times
    # Within half of the smaller gap an impact is nearer to this reference impact than to any other.
    gaps = np.diff(times, prepend=-np.inf, append=np.inf)
    nearer = 0.5 * np.minimum(gaps[1:], gaps[:-1])[:n]
    tolerance = np.minimum(np.where(np.isinf(nearer), window / 2.0, nearer), longest)  # a single one has no neighbour
    delay = run.times[:n] - times[:n]
    fails = (run.stops[:n] != reference.stops[:n]) | ~(np.abs(delay) < tolerance)
    # After the first pair that does not hold, equal numbers no longer mean the same impact.
    matched = int(np.argmax(fails)) if np.any(fails) else n
    # The match ends at the first impact without its partner.
    alone = (times if matched < reference.count else run.times)[matched : matched + 1]
    inside = delay[:matched][times[:matched] <= window]
    return Matching(
        matched=len(inside),
        matched_until=min(window, *alone.tolist()) if len(alone) else window,
        median_delay=float(np.median(inside)) if len(inside) else float("nan"),
    )


def after_rest(
    impacts: tuple[Impacts, Impacts], path: tuple[Array, Array], true_path: tuple[Array, Array]
) -> tuple[Impacts, Impacts]:
    """The impacts of run and reference after their contact has moved from its start; times and positions of both.

    A contact that begins at rest on its stop crosses it by rounding until a motion from elsewhere arrives.
    """
    scale = float(np.max(np.abs(true_path[1] - true_path[1][0])))
    begun = max(at_rest_until(*path, scale), at_rest_until(*true_path, scale))
    run, true = (each.take(each.times > begun) for each in impacts)
    return run, true


def matched_until(run: Trajectory, reference: Trajectory, window: float) -> float:
    """The time to which the impacts at every contact match, see Matching; ``window`` without contacts."""
    longest = (
        np.inf if reference.system is None else longest_delay(reference.system, float(reference.provenance["t_end"]))
    )
    until = window
    for a, b in zip(run.contacts, reference.contacts, strict=True):
        pair = after_rest((a.impacts, b.impacts), (run.t, a.position), (reference.t, b.position))
        until = min(until, match(*pair, window, longest).matched_until)
    return until


def impact_times(run: Trajectory) -> Array:
    """The times of the impacts at every contact of a run, in order."""
    return np.sort(np.concatenate([np.zeros(0), *(contact.impacts.times for contact in run.contacts)]))


ONE_TIME = 1e-9  # of the horizon: impacts that are closer are at one time


def first_impacts_end(exact: Reference, impacts: int) -> float:
    """The end of a window that holds ``impacts`` impacts of ``exact`` and stays far from its horizon.

    It ends half-way to the next impact, so that whether a scheme counts the last one does not depend on
    rounding, or half-way from the last impact to the horizon if there are no more; without impacts at half the horizon.
    Impacts at several contacts at one time belong together: the window holds all of them.
    """
    positive("impacts", impacts)
    times, horizon = impact_times(exact), min(exact.horizon, float(exact.provenance["t_end"]))
    if len(times) > impacts:
        held = np.searchsorted(times, times[impacts - 1] + ONE_TIME * horizon, "right")
        if held < len(times):
            return min(0.5 * horizon, 0.5 * float(times[held - 1] + times[held]))
    return 0.5 * (float(times[-1]) + horizon) if len(times) and times[-1] < horizon else 0.5 * horizon
