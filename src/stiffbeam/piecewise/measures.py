"""Contacts and energy of the exact solution, to rounding."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..basics.resources import afford
from ..model.system import System
from ..trajectory.impacts import ContactRecord, Impacts
from ..trajectory.ledger import Ledger
from .events import LET_GO, peak_between, pressed, pressure

if TYPE_CHECKING:
    from .motion import Motion

NODES, WEIGHTS = np.polynomial.legendre.leggauss(10)
PEAK_STEPS = 8  # of the Illinois method, from a bracket of two samples: to 1e-12 on Table 10
RIVAL = 0.96  # of the largest sample: nodes lie within 0.48 radians of the fastest motion, cos 0.24 = 0.972


def path_of(system: System, solution: Motion, times: Array, channel: int) -> tuple[Array, Array]:
    """Position and velocity of a channel at any times."""
    row, offset = system.channels[channel]
    u, v = solution.observed(times, row)
    if offset is None:
        return u, v
    shift, shift_rate = solution.offset(system, channel)(times)
    return u + shift, v + shift_rate


def entries(solution: Motion, i: int, t_end: float) -> Impacts:
    """The impacts of contact i, entries into a stop, without what they measure."""
    starts, _, sides = _closed(solution, i, t_end)
    counted = starts > 0.0
    return Impacts.at(starts[counted], sides[counted], "event")


def contact_record(
    system: System, solution: Motion, i: int, t: Array, t_end: float, since: float = 0.0
) -> ContactRecord:
    """Contact history in [since, t_end] by events: impacts are the switches from free to a stop."""
    return record_of(system, solution, i, path_of(system, solution, t, i), t_end, since)


def contact_between(system: System, solution: Motion, start: float, end: float, i: int) -> ContactRecord:
    """``contact_record`` of [start, end], a part of the solution's span."""
    pieces = solution.first(max(1, int(np.searchsorted(solution.times, end))))
    return contact_record(system, pieces, i, np.array([start, end]), end, start)


def record_of(
    system: System, solution: Motion, i: int, seen: tuple[Array, Array], t_end: float, since: float
) -> ContactRecord:
    """``contact_record`` with the position and velocity that are ``seen`` at the output times."""
    contact = system.contacts[i]
    starts, ends, sides = _closed(solution, i, t_end)
    late = ends > since
    starts, ends, sides = starts[late], ends[late], sides[late]
    counted = starts > since  # contact that is there at the start is no impact
    listed = counted | (starts == 0.0)
    starts = np.maximum(starts, since)
    peaks, impulses = solution.press(system, i, starts, ends, sides) if len(starts) else np.zeros((2, 0))
    ended = ends < t_end
    position, velocity = seen
    return ContactRecord(
        stops=contact.stops,
        position=position,
        velocity=velocity,
        force=contact.stops.force(position, velocity),
        impacts=Impacts(
            times=starts[listed],
            ends=np.where(ended, ends, np.nan)[listed],
            stops=sides[listed],
            peaks=np.where(ended, peaks, np.nan)[listed],
            impulses=np.where(ended, impulses, np.nan)[listed],
            kind="event",
        ).started(~counted[listed]),
        fraction=float(np.sum(ends - starts) / (t_end - since)),
        peak_force=float(np.max(peaks, initial=0.0)),
        impulse=float(np.sum(impulses)),
    )


def _closed(solution: Motion, i: int, t_end: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Start, end and side of every span in which the contact stays on one stop.

    Pieces of no length, where it touches and turns straight back, do not count; pieces in which only
    other contacts switch belong together.
    """
    ends = np.append(solution.times[1:], t_end)
    real = ends > solution.times
    starts, ends, side = solution.times[real], ends[real], pressed(solution.sides[real, i])
    new = np.concatenate([[True], side[1:] != side[:-1]])
    first = np.flatnonzero(new)
    last = np.append(first[1:], len(side)) - 1
    closed = side[first] != 0
    return starts[first][closed], ends[last][closed], side[first][closed]


def pressed_by(
    system: System, solution: Motion, i: int, starts: Array, ends: Array, sides: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Peak |sigma| and impulse, the integral of |sigma|, of contact i in the spans [starts, ends] on ``sides``.

    |sigma| is smooth between two switches, of any contact: Gauss-Legendre panels no longer than the shortest
    period, and graded towards the switch where a part dies out faster, integrate it to rounding; the peak is
    where u' changes sign beside one of the largest samples, found by the Illinois method; of a damped stop,
    whose force may be largest where it jumps, by the golden section.
    """
    path, stops = partial(path_of, system, solution, channel=i), system.contacts[i].stops
    owner, cuts, until = _between(solution.times, starts, ends)
    index, left, width = panels(solution.shortest_period, cuts, until, solution.fastest_decay)
    index = owner[index]
    t = left[:, None] + width[:, None] * (NODES + 1.0) / 2.0

    def press(t: Array, owner: NDArray[np.int64]) -> Array:
        u, v = path(t)
        return pressure(stops, sides[owner], u, v) if stops.dissipative else np.abs(stops.force(u))

    sigma = press(t.ravel(), np.repeat(index, len(NODES))).reshape(t.shape)
    impulses = np.bincount(index, sigma @ WEIGHTS * width / 2.0, len(starts))
    # Every piece's samples in order, its ends included, and the largest of those around them.
    samples = np.concatenate([t.ravel(), starts, ends])
    both = np.tile(np.arange(len(starts)), 2)
    values = np.concatenate([sigma.ravel(), press(np.concatenate([starts, ends]), both)])
    owner = np.concatenate([np.repeat(index, len(NODES)), both])
    order = np.lexsort((samples, owner))
    samples, values, owner = samples[order], values[order], owner[order]
    first = np.diff(owner, prepend=-1) != 0
    last = np.roll(first, -1)
    largest = np.maximum.reduceat(values, np.flatnonzero(first))
    ahead, behind = np.roll(values, -1), np.roll(values, 1)
    top = (first | (values >= behind)) & (last | (values >= ahead)) & (values >= RIVAL * largest[owner])
    best = np.flatnonzero(top)
    low, high = samples[best - ~first[best]], samples[best + ~last[best]]
    peaks = np.zeros(len(starts))
    if stops.dissipative:
        inner = peak_between(lambda t: press(t, owner[best]), low, high)
        np.maximum.at(peaks, owner[best], np.maximum(values[best], inner))
        return peaks, impulses
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
    for x in (samples[best], low, high):
        np.maximum.at(peaks, owner[best], np.abs(stops.force(path(x)[0])))
    return peaks, impulses


def _between(times: Array, starts: Array, ends: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """The spans [starts, ends], apart and in order, cut at the ``times`` inside: owner, start and end of each part."""
    first = np.searchsorted(times, starts, "right")
    inside = np.maximum(np.searchsorted(times, ends, "left") - first, 0)
    owner = np.repeat(np.arange(len(starts)), inside + 1)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(inside + 1) - inside - 1, inside + 1)
    cut = np.append(times, np.inf)
    after = np.repeat(first, inside + 1) + place  # the cut at which a part ends, the one before begins it
    begins = np.where(place == 0, starts[owner], cut[np.maximum(after - 1, 0)])
    return owner, begins, np.minimum(cut[after], ends[owner])


def panels(longest: float, starts: Array, ends: Array, decay: float = 0.0) -> tuple[NDArray[np.int64], Array, Array]:
    """Panels no longer than half of ``longest``, since products have twice the frequency, of the intervals
    [starts, ends]: owner, left end and width of each.

    The first of an interval is cut at 1/decay from its start, and at twice, four times that and so on: on
    each part exp(-decay s) is smooth or nothing.
    """
    count = np.maximum(1, np.ceil(2.0 * (ends - starts) / longest))
    total = float(np.sum(count))
    afford("t_end", float(np.max(ends, initial=0.0)), "shorten t_end", floats=8.0 * total, seconds=1e-5 * total)
    count = count.astype(int)
    index = np.repeat(np.arange(len(starts)), count)
    inside = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    width = ((ends - starts) / count)[index]
    left = starts[index] + inside * width
    longest_first = float(np.max((ends - starts) / count, initial=0.0))
    if decay * longest_first <= 1.0:
        return index, left, width
    cuts = 2.0 ** np.arange(np.ceil(np.log2(decay * longest_first))) / decay
    owners, cut = (x.ravel() for x in np.broadcast_arrays(np.arange(len(starts))[:, None], cuts))
    inner = cut < ((ends - starts) / count)[owners]
    index, left = np.append(index, owners[inner]), np.append(left, (starts[owners] + cut)[inner])
    order = np.lexsort((left, index))
    index, left = index[order], left[order]
    last = np.append(index[1:] != index[:-1], True)
    return index, left, np.where(last, ends[index], np.append(left[1:], 0.0)) - left


def work_of_damping(system: System, solution: Motion, edges: Array) -> tuple[Array, Array]:
    """Between consecutive edges, which include every switch: what moving stops put in by -c d', and what stops take.

        input = -int F_c o' dt, F_c = -c u' where pressed      taken = int c u'^2 dt where pressed, U where let go

    By Gauss-Legendre quadrature, to rounding.
    """
    given, taken = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
    damped = [(i, c) for i, c in enumerate(system.contacts) if c.stops.damping > 0.0]
    if not damped:
        return given, taken
    sides = solution.sides[np.maximum(np.searchsorted(solution.times, edges[:-1], "right") - 1, 0)]
    owner, left, width = panels(solution.shortest_period, edges[:-1], edges[1:], solution.fastest_decay)
    for part in np.array_split(np.arange(len(left)), max(1, len(left) // 20_000)):
        t = (left[part][:, None] + width[part][:, None] * (NODES + 1.0) / 2.0).ravel()
        for i, contact in damped:
            side = sides[owner[part], i].repeat(len(NODES))
            u, v = solution.observed(t, contact.row)
            o, rate = solution.offset(system, i)(t)
            u, v = u + o, v + rate
            drag = np.where(np.abs(side) == 1, float(contact.stops.damping) * v, 0.0)
            spring = np.where(
                np.abs(side) == LET_GO, -float(contact.stops.stiffness) * contact.stops.penetration(u), 0.0
            )
            for total, power in ((given, drag * rate), (taken, (drag + spring) * v)):
                np.add.at(total, owner[part], power.reshape(-1, len(NODES)) @ WEIGHTS * width[part] / 2.0)
    return given, taken


def exact_ledger(system: System, solution: Motion, times: Array) -> Ledger:
    """The exact flow's ledger at increasing times.

    input = int (sum_k f_k p_k^T q' - sum_c F_c o_c') dt and viscous = int q'^T C q' dt are exact to
    rounding, so the loss left over is the error of the solution itself.
    """
    edges = np.unique(np.concatenate([solution.times[solution.times < times[-1]], times, [0.0]]))
    where = np.searchsorted(edges, times)
    works = *solution.work(system, edges), *work_of_damping(system, solution, edges)
    given, taken, moved, stops = (np.concatenate([[0.0], np.cumsum(x)])[where] for x in works)
    given = given + moved
    energies = system.energies(times, *solution.states(times))
    start = np.zeros(1)
    loss = system.energy(start, *solution.states(start))[0] - sum(energies) + given - taken - stops
    return Ledger(times, *energies, given, taken, loss, np.zeros(len(times)), loss, stops)
