"""Agreement of two solutions of one system: the time to which they agree, at the tip and at every contact."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..basics.arrays import Array
from ..trajectory.impacts import Impacts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..trajectory.trajectory import Trajectory

DISPLACEMENT_TOLERANCE = 1e-3  # of max |u|
STILL = 1e-9  # of the motion: that of a point which stands still is rounding
LOOKS = 64  # output times at which the size of the whole motion is looked at


class Watched(NamedTuple):
    """Data that define the horizon: positions at the times t (k,), of the tip and then of every contact, and the
    impacts of each contact."""

    t: Array
    paths: tuple[Array, ...]
    impacts: tuple[Impacts, ...]


def agreement(a: Trajectory, b: Trajectory, tolerance: float, part: float = 1.0) -> float:
    """The time to which a and b agree: |du| <= 1e-3 max|u| at output times, impact times to ``tolerance``.

    u is the position of the tip and, each by itself, of every contact, see ``scales_of``. Impacts are paired in order,
    see ``impacts_match_until``, and must differ by less than a twentieth of the mean time between those of their
    contact too. Both must have the same output times. max|u| is the smaller of the two: past the horizon, one that has
    diverged may move further than the system does. part: of the tolerances.
    """
    return agree_until(watched(a), watched(b), tolerance, list(np.fmin(scales_of(a), scales_of(b))), part)


def watched(run: Trajectory) -> Watched:
    """The data of a run that define the horizon, at its output times."""
    return Watched(run.t, (run.tip, *(c.position for c in run.contacts)), tuple(c.impacts for c in run.contacts))


def scales_of(run: Trajectory) -> list[float]:
    """Scale of 1e-3 for every path of ``watched``: max|u|, of a contact at least the gap to its nearer stop and STILL
    of the tip's; of all of them at least STILL of what the whole motion could move the point by."""
    largest = float(np.max(np.abs(run.tip)))
    scales = [largest, *(max(c.scale, STILL * largest) for c in run.contacts)]
    return np.maximum(scales, STILL * _reach(run)).tolist()


def _reach(run: Trajectory) -> Array:
    """sqrt(row M^-1 row) max |q|_M >= max|row q| of the tip's row and every contact's; 0 of a run without states."""
    system, state_at = run.system, getattr(run, "state_at", None)
    if system is None or state_at is None:
        return np.zeros(1 + len(run.contacts))
    q, _ = state_at(run.t[:: -(-len(run.t) // LOOKS)])
    length = np.sqrt(np.max(np.sum(q * (q @ system.mass), axis=1)))
    rows = np.array([system.channels[i][0] for i in (system.tip_channel, *range(len(run.contacts)))])
    return length * np.sqrt(np.sum(rows * np.linalg.solve(system.mass, rows.T).T, axis=1))


def agree_until(
    a: Watched, b: Watched, tolerance: float, scales: Sequence[float], part: float = 1.0, chatters: bool = False
) -> float:
    """See ``agreement``; part: of the tolerances; chatters: see ``impacts_match_until``."""
    end = float(min(a.t[-1], b.t[-1]))
    horizon = end
    for u, other, scale in zip(a.paths, b.paths, scales, strict=True):
        close = np.abs(u - other) <= part * DISPLACEMENT_TOLERANCE * scale  # NaN is not
        if not np.all(close):
            horizon = min(horizon, float(a.t[max(0, int(np.argmin(close)) - 1)]))
    for c, d in zip(a.impacts, b.impacts, strict=True):
        least = min(tolerance, apart(max(c.count, d.count), end))
        horizon = min(horizon, impacts_match_until(c, d, part * least, end, chatters))
    return horizon


def impacts_match_until(a: Impacts, b: Impacts, tolerance: float, end: float, chatters: bool = False) -> float:
    """The time of the first impact that does not match, else ``end``.

    The i-th impacts of a and b match where they are on the same stop with times that differ by ``tolerance``
    at most. Impacts within the tolerance of the start do not count: a motion that starts on a stop may enter
    it or be in it already. Nor do those within the tolerance of ``end``, whose partner may come just after.
    chatters: nor those without a partner that come at once after the last one with a partner.
    """
    a, b = (_after(tolerance, x) for x in (a, b))
    n = min(a.count, b.count)
    bad = (a.stops[:n] != b.stops[:n]) | (np.abs(a.times[:n] - b.times[:n]) > tolerance)
    if np.any(bad):
        k = int(np.argmax(bad))
        return float(min(a.times[k], b.times[k]))
    unpaired = np.concatenate([a.times[n:], b.times[n:]])
    unpaired = unpaired[unpaired < end - tolerance]
    if chatters and n:
        unpaired = unpaired[unpaired > a.times[n - 1] + tolerance]
    return float(np.min(unpaired)) if len(unpaired) else end


def _after(t: float, impacts: Impacts) -> Impacts:
    return impacts.take(impacts.times > t)


def apart(count: int, end: float) -> float:
    """A twentieth of the mean time between ``count`` impacts in [0, end]: corresponding impacts of two solutions must
    differ by less, however slow the motion is."""
    return 0.05 * end / max(1, count)
