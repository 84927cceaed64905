"""Measures of a contact, and the comparison of two impact sequences: pairs, delays, the time to which they match."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import positive
from ..model.scales import scales
from ..model.system import System
from ..trajectory.impacts import Impacts
from ..trajectory.trajectory import Reference, Trajectory


@dataclass(frozen=True)
class ContactMeasures:
    """Measures of one contact of a trajectory over a span: sampled impacts, share of steps in contact, peak |sigma| and
    impulse, the sum of |sigma| dt. If by ``events``: the share of time, the peak between the steps and the integral of
    |sigma|. event_impacts: the impacts of the trajectory itself; those of a reference are by events."""

    impacts: int
    event_impacts: int
    fraction: float
    peak_force: float
    impulse: float
    events: bool = False


@dataclass(frozen=True)
class Matching:
    """The i-th impact of a run paired with the i-th of the reference, both sampled, up to ``window``.

    A pair holds if both hit the same stop and |t_run - t_ref| is less than half the smaller gap to the
    neighbouring reference impacts, and no more than ``longest_delay``. matched_until: the reference time of
    the first pair that does not hold, the time of an impact without a partner, or the window.
    first_error: t_run - t_ref of the first pair; median_delay: of all pairs that hold; > 0 means late, NaN
    where there is no pair.
    """

    matched: int
    matched_until: float
    first_error: float
    median_delay: float


def longest_delay(system: System, t_end: float) -> float:
    """A quarter of the longest time scale of a run to t_end. An impact that is later belongs to no impact of the
    reference."""
    return 0.25 * scales(system, t_end).period


def match(run: Impacts, reference: Impacts, window: float, longest: float = np.inf) -> Matching:
    """Pair two impact sequences; both may reach past ``window``. longest: see ``longest_delay``."""
    n = min(run.count, reference.count)
    times = reference.times
    # Within half of the smaller gap an impact is nearer to this reference impact than to any other.
    gaps = np.diff(times)
    after = np.append(gaps, np.inf)[: len(times)]
    before = np.insert(gaps, 0, np.inf)[: len(times)]
    tolerance = np.minimum(before, after) / 2.0
    tolerance[np.isinf(tolerance)] = window / 2.0  # a single impact has no neighbour
    tolerance = np.minimum(tolerance, longest)
    delay = run.times[:n] - times[:n]
    fails = (run.stops[:n] != reference.stops[:n]) | ~(np.abs(delay) < tolerance[:n])
    # After the first pair that does not hold, equal numbers no longer mean the same impact.
    matched = int(np.argmax(fails)) if np.any(fails) else n
    # The match ends at the first impact without its partner.
    until = window
    if matched < reference.count:
        until = float(times[matched])
    elif matched < run.count:
        until = float(run.times[matched])
    until = min(until, window)
    inside = delay[:matched][times[:matched] <= window]
    return Matching(
        matched=len(inside),
        matched_until=until,
        first_error=float(delay[0]) if n and times[0] <= window else float("nan"),
        median_delay=float(np.median(inside)) if len(inside) else float("nan"),
    )


def matched_until(run: Trajectory, reference: Trajectory, window: float) -> float:
    """The time to which the impacts at every contact match, see Matching; ``window`` without contacts."""
    pairs = zip(run.contacts, reference.contacts, strict=True)
    longest = (
        np.inf if reference.system is None else longest_delay(reference.system, float(reference.provenance["t_end"]))
    )
    return min((match(a.impacts, b.impacts, window, longest).matched_until for a, b in pairs), default=window)


def impact_times(run: Trajectory) -> Array:
    """The times of the impacts at every contact of a run, in order."""
    return np.sort(np.concatenate([np.zeros(0), *(contact.impacts.times for contact in run.contacts)]))


def first_impacts_end(exact: Reference, impacts: int) -> float:
    """The end of a window that holds ``impacts`` impacts of ``exact`` and stays far from its horizon.

    It ends half-way to the next impact, so that whether a scheme counts the last one does not depend on
    rounding, or half-way from the last impact to the horizon if there are no more; without impacts at half the horizon.
    """
    positive("impacts", impacts)
    times, horizon = impact_times(exact), min(exact.horizon, float(exact.provenance["t_end"]))
    if len(times) > impacts:
        return min(0.5 * horizon, 0.5 * float(times[impacts - 1] + times[impacts]))
    return 0.5 * (float(times[-1]) + horizon) if len(times) and times[-1] < horizon else 0.5 * horizon
