"""Contacts that float64 cannot see: where a gap is almost zero as it turns, many digits say whether it is closed.

The switches are sought in float64, where a gap that turns at less than the rounding of its terms counts as open.
Near such a turn gap = d + a s^2/2, a > 0, s the time from it, and d in all the digits that are carried decides:

    d < 0    closed for 2 sqrt(-2 d/a): a contact, or a moment between two, that was passed over
    d > 0    open; where |d| is less than ``TOUCH`` of the motion it touches, and that is no contact

In contact the gap is the penetration. Of a damped stop that presses only the penetration is looked at, not the force.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from flint import arb
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...model.drive import Drive
from ...model.system import System
from ...piecewise.events import LET_GO
from ...piecewise.measures import Solution, path_of
from ...piecewise.touching import EPS
from ...trajectory.trajectory import SolverFailure
from .rational import exact_problem

PER_PERIOD = 16  # looks at a gap in the shortest period
AT_ONCE, MOST_LOOKS = 100_000, 30_000_000
CLOSE = 1e-9  # of the motion: deeper ones float64 sees
TOUCH = 1e-18
MOVES = 64.0 * EPS  # of the largest speed: a gap that turns more slowly rests
HALVINGS = 60
APART = 64.0 * EPS  # of the time: switches that are closer have one time in float64
MOST = 100  # that are passed over; each costs the whole solution once more


Sampler = Callable[..., tuple[Array, Array]]  # of the channels at any times, rounded by what it is given


class Switch(NamedTuple):
    """A switch that the search is told of: about when, of which contact, at the stop on which side."""

    t: float
    contact: int
    side: int


class Turn(NamedTuple):
    """A gap sign (u - stop) that turns at t with gap'' = curve > 0 within ``CLOSE`` of zero; size: of the motion."""

    t: float
    contact: int
    side: int
    sign: int
    curve: float
    size: float


def passed_over(system: System, solution: Solution, sample: Sampler, t_end: float, since: float) -> Switch | None:
    """The first switch after ``since`` that is not in ``solution``; ``sample`` gives its channels in many digits.

    None too for more than ``MOST_LOOKS``. Raises SolverFailure where it ends before float64 can tell its end from its
    beginning.
    """
    if np.sum(looks(solution, t_end)[0]) > MOST_LOOKS:
        return None
    turns = [turn for i in range(len(system.contacts)) for turn in _turns(system, solution, i, t_end)]
    contacts = exact_problem(system, Drive.of(system)).contacts if turns else []
    for turn in sorted(turn for turn in turns if turn.t > since):
        t, stop, least = turn.t, contacts[turn.contact].stop(turn.side), arb(0)
        for _ in range(3):  # to the double next to the turn
            (u,), (v,) = (x[:, turn.contact] for x in sample(np.array([t]), lambda x: x))
            least = turn.sign * (u - stop - v * v / (2 * arb(turn.sign * turn.curve)))
            t = min(max(0.0, t - turn.sign * float(v) / turn.curve), t_end)
        depth = -float(least)
        if depth <= TOUCH * turn.size:
            continue
        early = math.sqrt(2.0 * depth / turn.curve)
        if early <= APART * t:
            remedy = f"end before t = {t:.6g}"
            raise SolverFailure("multiprecision", t, "a contact begins and ends at one time of float64", remedy)
        return Switch(t - early, turn.contact, turn.side)
    return None


def looks(solution: Solution, t_end: float) -> tuple[NDArray[np.int64], Array]:
    """How often the gaps are looked at in every piece, and how far apart that is, (pieces,) each."""
    length = np.diff(np.append(solution.times, t_end))
    count = np.ceil(np.maximum(1.0, PER_PERIOD * length / np.minimum(solution.periods, t_end)))
    return count.astype(np.int64), length / count


def grazes_of(solution: Solution, t_end: float) -> str:
    """Which of them are decided, in words."""
    count = float(np.sum(looks(solution, t_end)[0]))
    if count > MOST_LOOKS:
        return f"by float64, to 1e-12 of the motion: {count:.1g} looks are more than {MOST_LOOKS:.0e}"
    return f"by many digits, to {TOUCH:g} of the motion"


def _turns(system: System, solution: Solution, contact: int, t_end: float) -> Iterator[Turn]:
    """Where the gaps of a contact turn close to zero, by float64."""
    stops, sides = system.contacts[contact].stops, solution.sides[:, contact]
    count, apart = looks(solution, t_end)
    before = np.concatenate([[0], np.cumsum(count)])

    def path(t: Array) -> tuple[Array, Array]:
        return path_of(system, solution, t, contact)

    for first in range(0, int(before[-1]), AT_ONCE):
        look = np.arange(first, min(first + AT_ONCE, before[-1]))
        piece = np.searchsorted(before, look, "right") - 1
        h, side = apart[piece], sides[piece]
        t = solution.times[piece] + (look - before[piece]) * h
        t = np.append(t, min(t[-1] + h[-1], t_end))
        u, v = path(t)
        size = float(np.max(np.abs(u)))
        moves = np.maximum(np.abs(v[:-1]), np.abs(v[1:])) > MOVES * np.max(np.abs(v))
        for which, stop in ((1, stops.upper_bound), (-1, stops.lower_bound)):
            if math.isinf(stop):
                continue
            looked_at = (side == LET_GO * which) | ((side == which) & (stops.damping == 0.0))
            sign = np.where(side == 0, -which, np.where(looked_at, which, 0))
            near = CLOSE * (size + abs(stop))
            gap, rate, gap_after, rate_after = (sign * x for x in (u[:-1] - stop, v[:-1], u[1:] - stop, v[1:]))
            lowest = np.minimum(gap + 2.0 * h * rate, gap_after - 2.0 * h * rate_after)
            (k,) = np.nonzero((rate < 0.0) & (rate_after >= 0.0) & (lowest <= near) & moves)
            if not len(k):
                continue
            low, high = t[k], t[k + 1]
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                falls = sign[k] * path(middle)[1] < 0.0
                low, high = np.where(falls, middle, low), np.where(falls, high, middle)
            left, right = np.maximum(high - 0.01 * h[k], 0.0), np.minimum(high + 0.01 * h[k], t_end)
            curve = sign[k] * (path(right)[1] - path(left)[1]) / (right - left)
            close = (np.abs(path(high)[0] - stop) <= near) & (curve > 0.0)
            for j in np.flatnonzero(close):
                yield Turn(float(high[j]), contact, which, int(sign[k[j]]), float(curve[j]), size + abs(stop))
