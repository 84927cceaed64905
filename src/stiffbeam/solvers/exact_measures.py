"""What the exact solution tells of its contacts and its energy, to rounding."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..contact import Stops
from ..ledger import Ledger
from ..system import System
from ..trajectory import ContactRecord, Impacts

if TYPE_CHECKING:
    from .piecewise import Solution


def contact_record(system: System, solution: Solution, i: int, t: Array, t_end: float) -> ContactRecord:
    """Contact history by events: impacts are the switches from free to a stop."""
    contact = system.contacts[i]
    offset = solution.offset(system, i)

    def path(times: Array) -> tuple[Array, Array]:
        u, v = solution.observed(times, contact.row)
        shift, shift_rate = offset(times)
        return u + shift, v + shift_rate

    starts, ends = solution.times, np.append(solution.times[1:], t_end)
    closed = np.flatnonzero((solution.regime != 0) & (ends > starts))
    peaks, impulses = _episodes(solution, starts[closed], ends[closed], path, contact.stops)
    counted = closed > 0  # contact at t = 0 is no impact
    ended = ends[closed] < t_end
    position, velocity = path(t)
    return ContactRecord(
        stops=contact.stops,
        position=position,
        velocity=velocity,
        force=contact.stops.force(position),
        impacts=Impacts(
            times=starts[closed][counted],
            stops=solution.regime[closed][counted],
            peaks=np.where(ended, peaks, np.nan)[counted],
            impulses=np.where(ended, impulses, np.nan)[counted],
            kind="event",
        ),
        fraction=float(np.sum((ends - starts)[closed]) / t_end),
        peak_force=float(np.max(peaks, initial=0.0)),
        impulse=float(np.sum(impulses)),
    )


def _episodes(
    solution: Solution, starts: Array, ends: Array, path: Callable[[Array], tuple[Array, Array]], stops: Stops
) -> tuple[Array, Array]:
    """Peak |sigma| and impulse, the integral of |sigma|, of contact pieces [starts, ends].

    |sigma| is smooth inside a piece: Gauss-Legendre panels no longer than the shortest period integrate
    it to rounding; the peak is where u' changes sign beside the largest sample, found by bisection.
    """
    if not len(starts):
        return np.zeros(0), np.zeros(0)
    nodes, weights = np.polynomial.legendre.leggauss(10)
    index, left, width = _panels(solution, starts, ends)
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
    for _ in range(50):
        middle = 0.5 * (low + high)
        rising = side * path(middle)[1] > 0.0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    peaks = np.maximum(values[best], np.abs(stops.force(path(low)[0])))
    return peaks, impulses


def _runs(owner: NDArray[np.int64]) -> list[tuple[int, int]]:
    """The half-open ranges of equal values in a sorted array."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(owner)) + 1, [len(owner)]])
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _panels(solution: Solution, starts: Array, ends: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Panels no longer than the shortest period: owner, left end and width of each."""
    shortest = 2.0 * np.pi / max(float(r.omega[-1]) for r in solution.regimes.values())
    panels = np.maximum(1, np.ceil((ends - starts) / shortest)).astype(int)
    index = np.repeat(np.arange(len(starts)), panels)
    inside = np.arange(len(index)) - np.repeat(np.cumsum(panels) - panels, panels)
    width = ((ends - starts) / panels)[index]
    return index, starts[index] + inside * width, width


def exact_ledger(system: System, solution: Solution, times: Array) -> Ledger:
    """The exact flow's ledger at increasing times: input = int sum_k f_k p_k^T q' dt, piece by piece.

    Gauss-Legendre quadrature on panels no longer than the shortest period is exact to rounding, so the
    loss left over is the error of the solution itself.
    """
    nodes, weights = np.polynomial.legendre.leggauss(10)
    edges = np.unique(np.concatenate([solution.times[solution.times < times[-1]], times, [0.0]]))
    index, left, width = _panels(solution, edges[:-1], edges[1:])
    basis, _ = solution.drive.split(system.loads, system.size)
    work = np.zeros(len(left))
    for part in np.array_split(np.arange(len(left)), max(1, len(left) // 20_000)):
        t = left[part][:, None] + width[part][:, None] * (nodes + 1.0) / 2.0
        _, v = solution.states(t.ravel())
        power = np.sum((solution.drive.coefficients(t.ravel()) @ basis) * v, axis=1).reshape(t.shape)
        work[part] = power @ weights * width[part] / 2.0
    cumulative = np.concatenate([[0.0], np.cumsum(np.bincount(index, work, len(edges) - 1))])
    total = cumulative[np.searchsorted(edges, times)]
    start, energy = (system.energy(t, *solution.states(t)) for t in (np.zeros(1), times))
    loss = start[0] - energy + total
    zero = np.zeros(len(times))
    return Ledger(times, energy, total, zero, loss, zero, loss)
