"""What the exact solution tells of its contacts and its energy, to rounding."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..contact import Stops
from ..ledger import Ledger
from ..system import System
from ..trajectory import ContactRecord, Impacts

PEAK_STEPS = 8  # of the Illinois method, from a bracket of two samples: to 1e-12 on Table 10


class Solution(Protocol):
    """What the exact solutions offer, whichever way they are represented."""

    @property
    def times(self) -> Array: ...  # the starts of the pieces
    @property
    def sides(self) -> NDArray[np.int64]: ...  # chi of every contact in every piece, (pieces, m)
    @property
    def evaluations(self) -> int: ...
    @property
    def shortest_period(self) -> float: ...
    @classmethod
    def joined(cls, parts: Any, /) -> Any: ...  # of consecutive parts
    def first(self, count: int, /) -> Any: ...  # the first pieces
    def state_at_start(self, piece: int, /) -> tuple[Array, Array]: ...  # q, q' (1, n)
    def flow(self, piece: int, tau: float, dq: Array, dv: Array, /) -> tuple[Array, Array]: ...  # homogeneous
    def states(self, t: Array, /) -> tuple[Array, Array]: ...  # q, q' (k, n)
    def observed(self, t: Array, row: Array, /) -> tuple[Array, Array]: ...  # row @ q and its rate
    def offset(self, system: System, channel: int, /) -> Callable[[Array], tuple[Array, Array]]: ...
    def work(self, system: System, edges: Array, /) -> tuple[Array, Array]: ...  # input, viscous per interval


def contact_record(
    system: System, solution: Solution, i: int, t: Array, t_end: float, since: float = 0.0
) -> ContactRecord:
    """Contact history in [since, t_end] by events: impacts are the switches from free to a stop."""
    contact = system.contacts[i]
    offset = solution.offset(system, i)

    def path(times: Array) -> tuple[Array, Array]:
        u, v = solution.observed(times, contact.row)
        shift, shift_rate = offset(times)
        return u + shift, v + shift_rate

    starts, ends, sides = _closed(solution, i, t_end)
    late = ends > since
    starts, ends, sides = starts[late], ends[late], sides[late]
    counted = starts > since  # contact that is there at the start is no impact
    starts = np.maximum(starts, since)
    peaks, impulses = _episodes(solution, starts, ends, path, contact.stops)
    ended = ends < t_end
    position, velocity = path(t)
    return ContactRecord(
        stops=contact.stops,
        position=position,
        velocity=velocity,
        force=contact.stops.force(position),
        impacts=Impacts(
            times=starts[counted],
            stops=sides[counted],
            peaks=np.where(ended, peaks, np.nan)[counted],
            impulses=np.where(ended, impulses, np.nan)[counted],
            kind="event",
        ),
        fraction=float(np.sum(ends - starts) / (t_end - since)),
        peak_force=float(np.max(peaks, initial=0.0)),
        impulse=float(np.sum(impulses)),
    )


def _closed(solution: Solution, i: int, t_end: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Start, end and side of every span in which the contact stays on one stop.

    Pieces of no length, where it touches and turns straight back, do not count; pieces in which only
    other contacts switch belong together.
    """
    ends = np.append(solution.times[1:], t_end)
    real = ends > solution.times
    starts, ends, side = solution.times[real], ends[real], solution.sides[real, i]
    new = np.concatenate([[True], side[1:] != side[:-1]])
    first = np.flatnonzero(new)
    last = np.append(first[1:], len(side)) - 1
    closed = side[first] != 0
    return starts[first][closed], ends[last][closed], side[first][closed]


def _episodes(
    solution: Solution, starts: Array, ends: Array, path: Callable[[Array], tuple[Array, Array]], stops: Stops
) -> tuple[Array, Array]:
    """Peak |sigma| and impulse, the integral of |sigma|, of contact pieces [starts, ends].

    |sigma| is smooth inside a piece: Gauss-Legendre panels no longer than the shortest period integrate
    it to rounding; the peak is where u' changes sign beside the largest sample, found by the Illinois method.
    """
    if not len(starts):
        return np.zeros(0), np.zeros(0)
    nodes, weights = np.polynomial.legendre.leggauss(10)
    index, left, width = panels(solution.shortest_period, starts, ends)
    t = left[:, None] + width[:, None] * (nodes + 1.0) / 2.0
    sigma = np.abs(stops.force(path(t.ravel())[0])).reshape(t.shape)
    impulses = np.bincount(index, sigma @ weights * width / 2.0, len(starts))
    # Every piece's samples in order, its ends included, and the largest of them.
    samples = np.concatenate([t.ravel(), starts, ends])
    values = np.concatenate([sigma.ravel(), np.abs(stops.force(path(np.concatenate([starts, ends]))[0]))])
    owner = np.concatenate([np.repeat(index, len(nodes)), np.arange(len(starts)), np.arange(len(starts))])
    order = np.lexsort((samples, owner))
    samples, values, owner = samples[order], values[order], owner[order]
    best = np.array([np.argmax(values[a:b]) + a for a, b in _runs(owner)])
    first, last = (np.array(x) for x in zip(*_runs(owner), strict=True))
    low, high = samples[np.maximum(best - 1, first)], samples[np.minimum(best + 1, last - 1)]
    side = np.sign(path(samples[best])[0] - np.clip(path(samples[best])[0], stops.g1, stops.g2))
    # The force is flat at its peak: a time to half the digits gives it to all of them.
    rise, fall, before = side * path(low)[1], side * path(high)[1], np.full(len(low), -1)
    for _ in range(PEAK_STEPS):
        inside = (rise > 0.0) & (fall < 0.0)
        share = np.where(inside, rise / np.where(inside, rise - fall, 1.0), 0.0)
        middle = low + share * (high - low)
        rate = side * path(middle)[1]
        rising = rate > 0.0
        # Illinois: an end that stays a second time counts half.
        stays = np.where(rising == before, 0.5, 1.0)
        rise, fall, before = np.where(rising, rate, stays * rise), np.where(rising, stays * fall, rate), rising * 1
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    peaks = np.maximum(values[best], np.maximum(*(np.abs(stops.force(path(x)[0])) for x in (low, high))))
    return peaks, impulses


def _runs(owner: NDArray[np.int64]) -> list[tuple[int, int]]:
    """The half-open ranges of equal values in a sorted array."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(owner)) + 1, [len(owner)]])
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def panels(longest: float, starts: Array, ends: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Panels no longer than half of ``longest``, since products have twice the frequency, of the intervals
    [starts, ends]: owner, left end and width of each."""
    count = np.maximum(1, np.ceil(2.0 * (ends - starts) / longest)).astype(int)
    index = np.repeat(np.arange(len(starts)), count)
    inside = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    width = ((ends - starts) / count)[index]
    return index, starts[index] + inside * width, width


def exact_ledger(system: System, solution: Solution, times: Array) -> Ledger:
    """The exact flow's ledger at increasing times.

    input = int (sum_k f_k p_k^T q' - sum_c F_c o_c') dt and viscous = int q'^T C q' dt are exact to
    rounding, so the loss left over is the error of the solution itself.
    """
    edges = np.unique(np.concatenate([solution.times[solution.times < times[-1]], times, [0.0]]))
    where = np.searchsorted(edges, times)
    given, taken = (np.concatenate([[0.0], np.cumsum(x)])[where] for x in solution.work(system, edges))
    energies = system.energies(times, *solution.states(times))
    start = np.zeros(1)
    loss = system.energy(start, *solution.states(start))[0] - sum(energies) + given - taken
    return Ledger(times, *energies, given, taken, loss, contact=np.zeros(len(times)), free=loss)
