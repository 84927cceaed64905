"""Contacts and energy of the exact solution, to rounding. An energy balance that does not close raises an error.

    E - E_0 = input - dissipation,   E = 1/2 q'^T M q' + 1/2 q^T K q + sum_c U_c

Inside a segment the closed form keeps the balance of its own regime, in which U_c = kappa gap^2/2 wherever chi is not 0
for contact c. The balance of the whole can therefore fail in three places only: at the start; at an event, by the
energies on its two sides and by the energy of a jump between them; and inside a segment whose gap is not on the side of
chi, by the error of U_c there. All of these are added up.

A motion far smaller than the amplitudes it is the difference of has lost its digits with the balance intact:
there the observed positions do not start where they should.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..basics.resources import afford
from ..model.system import System
from ..trajectory.records import ContactRecord, Impacts, Ledger
from ..trajectory.trajectory import SolverFailure
from .follow import LET_GO, peak_between, pressed, pressure
from .search import EPS, REMEDY

if TYPE_CHECKING:
    from .motion import Motion

NODES, WEIGHTS = np.polynomial.legendre.leggauss(10)
PEAK_STEPS = 8  # of the Illinois method, from a bracket of two samples: to 1e-12 on Table 10
RIVAL = 0.96  # of the largest sample: nodes lie within 0.48 radians of the fastest motion, cos 0.24 = 0.972


def path_of(system: System, solution: Motion, times: Array, channel: int) -> tuple[Array, Array]:
    """Position and velocity of a channel at any times."""
    row, offset = system.channels[channel]
    u, v = solution.observed(times, row)
    if offset is not None:
        shift, shift_rate = solution.offset(system, channel)(times)
        u, v = u + shift, v + shift_rate
    return solution.settled(system, times, channel, u, v)


def entries(solution: Motion, i: int, t_end: float) -> Impacts:
    """Impacts of contact i: entries into a stop, without peaks and impulses."""
    starts, _, sides = _closed(solution, i, t_end)
    counted = starts > 0.0
    return Impacts.at(starts[counted], sides[counted], "event")


def contact_between(
    system: System, solution: Motion, span: tuple[float, float], records: Sequence[ContactRecord],
    start: float, end: float, i: int,
) -> ContactRecord:  # fmt: skip
    """``record_of`` for [start, end], a part of the solution's span, of which all contacts have ``records``."""
    if (start, end) == span:
        return records[i]
    pieces = solution.first(max(1, int(np.searchsorted(solution.times, end))))
    return record_of(system, pieces, i, path_of(system, pieces, np.array([start, end]), i), end, start)


def record_of(
    system: System, solution: Motion, i: int, seen: tuple[Array, Array], t_end: float, since: float
) -> ContactRecord:
    """Contact history in [since, t_end] by events, with given position and velocity at the output times. Impacts are
    the events from free to a stop."""
    contact = system.contacts[i]
    # Spans of contact in [since, t_end].
    starts, ends, sides = _closed(solution, i, t_end)
    late = ends > since
    starts, ends, sides = starts[late], ends[late], sides[late]
    counted = starts > since  # contact that is there at the start is no impact
    # A contact that exists at t = 0 has a row too, flagged as open at the start.
    listed = counted | (starts == 0.0)
    starts = np.maximum(starts, since)
    peaks, impulses = solution.press(system, i, starts, ends, sides) if len(starts) else np.zeros((2, 0))
    # A span that t_end cuts has no peak and impulse yet.
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
    """Start, end and side of every interval in which the contact stays on one stop.

    Pieces of no length, where it touches and turns straight back, do not count; pieces in which only
    other contacts have events belong together.
    """
    ends = np.concatenate([solution.times[1:], [t_end]])
    real = ends > solution.times
    starts, ends, side = solution.times[real], ends[real], pressed(solution.sides[real, i])
    # Segments on one side belong to one span: only other contacts have events between them.
    new = np.concatenate([[True], side[1:] != side[:-1]])
    first = np.flatnonzero(new)
    last = np.concatenate([first[1:], [len(side)]]) - 1
    closed = side[first] != 0
    return starts[first][closed], ends[last][closed], side[first][closed]


def pressed_by(
    system: System, solution: Motion, i: int, starts: Array, ends: Array, sides: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Peak |sigma| and impulse, the integral of |sigma|, of contact i in the spans [starts, ends] on ``sides``.

    |sigma| is smooth between two events, of any contact: Gauss-Legendre panels no longer than the shortest
    period, and graded towards the event where a part dies out faster, integrate it to rounding; the peak is
    where u' changes sign beside one of the largest samples, found by the Illinois method; of a damped stop,
    whose force may be largest where it jumps, by the golden section.
    """
    # Panels of every part between two events.
    path, stops = partial(path_of, system, solution, channel=i), system.contacts[i].stops
    part, cuts, until = _between(solution.times, starts, ends)
    index, left, width = panels(solution.shortest_period, cuts, until, solution.fastest_decay)
    index = part[index]
    t = left[:, None] + width[:, None] * (NODES + 1.0) / 2.0

    def press(t: Array, owner: NDArray[np.int64]) -> Array:
        u, v = path(t)
        return pressure(stops, sides[owner], u, v) if stops.dissipative else np.abs(stops.force(u))

    # Impulses by quadrature on these.
    sigma = press(t.ravel(), np.repeat(index, len(NODES))).reshape(t.shape)
    impulses = np.bincount(index, sigma @ WEIGHTS * width / 2.0, len(starts))
    # Every span's samples in order and the largest of those around them; with both ends of every part, since the force
    # of a stop that moves by a polygon has corners at its samples.
    samples = np.concatenate([t.ravel(), cuts, until])
    both = np.tile(part, 2)
    values = np.concatenate([sigma.ravel(), press(np.concatenate([cuts, until]), both)])
    owner = np.concatenate([np.repeat(index, len(NODES)), both])
    order = np.lexsort((samples, owner))
    samples, values, owner = samples[order], values[order], owner[order]
    first = np.diff(owner, prepend=-1) != 0
    last = np.roll(first, -1)
    largest = np.maximum.reduceat(values, np.flatnonzero(first))
    # Samples that no neighbour exceeds and that are nearly the largest; the neighbours bracket a peak.
    ahead, behind = np.roll(values, -1), np.roll(values, 1)
    top = (first | (values >= behind)) & (last | (values >= ahead)) & (values >= RIVAL * largest[owner])
    best = np.flatnonzero(top)
    low, high = samples[best - ~first[best]], samples[best + ~last[best]]
    peaks = np.zeros(len(starts))
    # The force of a damped stop may be largest where it jumps, and its rate is not zero there.
    if stops.dissipative:
        inner = peak_between(lambda t: press(t, owner[best]), low, high)
        np.maximum.at(peaks, owner[best], np.maximum(values[best], inner))
        return peaks, impulses
    side = np.sign(path(samples[best])[0] - np.clip(path(samples[best])[0], stops.lower_bound, stops.upper_bound))
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
    # A span with k times inside has k + 1 parts, numbered by ``place``.
    first = np.searchsorted(times, starts, "right")
    inside = np.maximum(np.searchsorted(times, ends, "left") - first, 0)
    owner = np.repeat(np.arange(len(starts)), inside + 1)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(inside + 1) - inside - 1, inside + 1)
    cut = np.append(times, np.inf)
    after = np.repeat(first, inside + 1) + place  # the cut at which a part ends, the one before begins it
    begins = np.where(place == 0, starts[owner], cut[np.maximum(after - 1, 0)])
    return owner, begins, np.minimum(cut[after], ends[owner])


def panels(
    longest: float, starts: Array, ends: Array, decay: float = 0.0, events: Array | None = None
) -> tuple[NDArray[np.int64], Array, Array]:
    """Panels no longer than half of ``longest``, since products have twice the frequency, of the intervals
    [starts, ends]: owner, left end and width of each.

    The first of an interval is cut at 1/decay from the event before it, and at twice, four times that and so on: on
    each part exp(-decay s) is smooth or nothing. events: the times of these, by default the starts.
    """
    # Equal panels in every interval, refused first if there are too many.
    count = np.maximum(1, np.ceil(2.0 * (ends - starts) / longest))
    total = float(np.sum(count))
    afford("t_end", float(np.max(ends, initial=0.0)), "shorten t_end", floats=8.0 * total)
    count = count.astype(int)
    index = np.repeat(np.arange(len(starts)), count)
    inside = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    width = ((ends - starts) / count)[index]
    left = starts[index] + inside * width
    # Without fast decay in a panel they suffice.
    longest_first = float(np.max((ends - starts) / count, initial=0.0))
    if decay * longest_first <= 1.0:
        return index, left, width
    passed = np.zeros(len(starts)) if events is None else starts - events
    cuts = 2.0 ** np.arange(np.ceil(np.log2(decay * (longest_first + np.max(passed))))) / decay
    owners, cut = (x.ravel() for x in np.broadcast_arrays(np.arange(len(starts))[:, None], cuts - passed[:, None]))
    inner = (cut > 0.0) & (cut < ((ends - starts) / count)[owners])
    index, left = np.append(index, owners[inner]), np.append(left, (starts[owners] + cut)[inner])
    order = np.lexsort((left, index))
    index, left = index[order], left[order]
    last = np.append(index[1:] != index[:-1], True)
    return index, left, np.where(last, ends[index], np.append(left[1:], 0.0)) - left


def integrated(
    solution: Motion, edges: Array, densities: Callable[[Array, NDArray[np.int64]], tuple[Array, Array]]
) -> tuple[Array, Array]:
    """Integrals of two densities between consecutive edges, which include every event.

    By Gauss-Legendre quadrature, exact to rounding, on panels that are short behind every edge, see ``panels``.
    densities: at times t (k,) in the given intervals.
    """
    events = solution.times[solution.piece_at(edges[:-1])]
    owner, left, width = panels(solution.shortest_period, edges[:-1], edges[1:], solution.fastest_decay, events)
    totals = np.zeros((2, len(edges) - 1))
    # Some 20 000 panels at a time, so that the states at their nodes fit into memory.
    for part in np.array_split(np.arange(len(left)), max(1, len(left) // 20_000)):
        t = (left[part][:, None] + width[part][:, None] * (NODES + 1.0) / 2.0).ravel()
        for total, values in zip(totals, densities(t, owner[part].repeat(len(NODES))), strict=True):
            np.add.at(total, owner[part], values.reshape(-1, len(NODES)) @ WEIGHTS * width[part] / 2.0)
    return totals[0], totals[1]


def work_of_damping(system: System, solution: Motion, edges: Array) -> tuple[Array, Array]:
    """Work between consecutive edges, which include every event: input of moving stops by -c d', and dissipation of
    stops.

        input = -int F_c o' dt, F_c = -c u' where pressed      taken = int c u'^2 dt where pressed, U where let go
    """
    damped = [(i, c) for i, c in enumerate(system.contacts) if c.stops.damping > 0.0]
    if not damped:
        return np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
    sides = solution.sides[solution.piece_at(edges[:-1])]

    def powers(t: Array, owner: NDArray[np.int64]) -> tuple[Array, Array]:
        given, taken = np.zeros((2, len(t)))
        for i, contact in damped:
            side = np.abs(sides[owner, i])
            u, v = solution.observed(t, contact.row)
            o, rate = solution.offset(system, i)(t)
            u, v = u + o, v + rate
            drag = np.where(side == 1, float(contact.stops.damping) * v, 0.0)
            # Beyond a stop that has let go, U = kappa d^2/2 falls with d and no force works: it counts as dissipated.
            spring = np.where(side == LET_GO, -float(contact.stops.stiffness) * contact.stops.penetration(u), 0.0)
            given, taken = given + drag * rate, taken + (drag + spring) * v
        return given, taken

    return integrated(solution, edges, powers)


def exact_ledger(system: System, solution: Motion, times: Array) -> Ledger:
    """Energy balance of the exact flow at increasing times.

    input = int (sum_k f_k p_k^T q' - sum_c F_c o_c') dt and viscous = int q'^T C q' dt are exact to
    rounding, so the loss left over is the error of the solution itself.
    """
    # From t = 0, where the balance starts.
    edges = np.unique(np.concatenate([solution.times[solution.times < times[-1]], times, [0.0]]))
    where = np.searchsorted(edges, times)
    works = *solution.work(system, edges), *work_of_damping(system, solution, edges)
    given, taken, moved, stops = (np.concatenate([[0.0], np.cumsum(x)])[where] for x in works)
    given = given + moved
    energies = system.energies(times, *solution.states(times))
    start = np.zeros(1)
    loss = system.energy(start, *solution.states(start))[0] - sum(energies) + given - taken - stops
    return Ledger(times, *energies, given, taken, loss, np.zeros(len(times)), loss, stops)


ROUNDINGS = 64.0  # that an event may cost, each as large as the stiffest mode makes it
SEEN, LOST = 1e-6, 1e-3  # of the largest energy so far: less is not held against it, more is never rounding
NOTHING = 1e-20  # of the largest energy of all: what rounding makes of none
START = 1e-3  # of the largest displacement: what a start may be off


@contextmanager
def within_float64(solver: str, t_end: float) -> Generator[None, None, None]:
    """Turn overflows, NaN and matrices without eigenvectors into SolverFailure, so that every result is finite."""
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        if isinstance(error, OverflowError) or "overflow" in str(error):
            raise SolverFailure(solver, t_end, f"the motion overflows float64 ({error})", REMEDY) from None
        reason = f"float64 has no result for a step of the calculation ({error})"
        raise SolverFailure(solver, t_end, reason, "use the method multiprecision") from None


def audit(system: System, solution: Motion, t_end: float, start: tuple[Array, Array] | None = None) -> None:
    """Raise SolverFailure with the first time at which the energy balance of [0, t_end] does not close.

    It is open where the sum of its openings exceeds what rounding explains, for every switch ROUNDINGS eps
    (w |q|_M sqrt(2 E) + 2 E) with the fastest frequency w, though not less than SEEN nor more than LOST of
    the energy, and the rounding of the terms of q^T K q, which cancel where a body moves as a whole. Pieces are
    looked at in the middle. start: q, q' (n,) at t = 0, None for those of the system.
    """
    # States on both sides of every event.
    q0, v0 = (system.q0, system.v0) if start is None else start
    times, sides = solution.times, solution.sides
    count, ends = len(times), np.concatenate([times[1:], [t_end]])
    pieces, when = np.arange(count), np.concatenate([times, ends])
    q, v = solution.states_in(when, np.concatenate([pieces, pieces]))
    finite = np.isfinite(q) & np.isfinite(v)
    if not finite.all():
        raise SolverFailure("exact", float(np.min(when[~finite.all(axis=1)])), "the motion is not finite", REMEDY)
    _start(system, solution, t_end, q0, (when, q))
    after, before = slice(0, count), slice(count, 2 * count - 1)
    # The states, the jumps at the events, and the given start.
    kinetic, elastic = system.free_energies(*(np.vstack([x, x[1:count] - x[before], y]) for x, y in ((q, q0), (v, v0))))
    free = kinetic + elastic
    # How far the balance is open: at the start, at every event, and inside segments.
    stops, inside, held = _stops(system, solution, q, ends, sides)
    energy = free[: 2 * count] + stops
    opening = np.zeros(count + 1)  # at the start, and at the end of every piece
    if times[0] == 0.0:
        opening[0] = abs(energy[0] - free[-1] - system.contact_energy(times[:1], q0[None])[0])
    opening[1:-1] = np.abs(energy[after][1:] - energy[before]) + free[2 * count : -1]
    opening[1:] += inside
    # What rounding explains at every end of a segment, added up over the motion so far.
    length = np.sqrt(np.sum(q * (q @ system.mass), axis=1))
    positive = np.maximum(energy, 0.0)
    rounding = 2.0 * np.pi / solution.shortest_period * length * np.sqrt(2.0 * positive) + 2.0 * positive
    terms = EPS * np.sum(np.abs(q) * (np.abs(q) @ np.abs(system.stiffness)), axis=1)
    sums = np.zeros((2, count + 1))
    for total, x in zip(sums, (rounding, terms), strict=True):
        total[:-1] += x[after]
        total[1:] += x[count:]
    allowed, cancelled = np.cumsum(sums, axis=1)
    # The largest energy so far, between events too: a body squeezed from both sides may have none at them.
    largest = np.maximum.accumulate(np.maximum(np.maximum(energy[after], energy[count:]), held))
    largest = np.concatenate([largest, largest[-1:]])
    allowed = np.clip(ROUNDINGS * EPS * np.sqrt(system.size) * allowed, SEEN * largest, LOST * largest)
    allowed += cancelled
    # The first time at which the balance is further open than rounding explains.
    total = np.cumsum(opening)
    open_at = np.flatnonzero(total > allowed + NOTHING * largest[-1])
    if len(open_at):
        k = int(open_at[0])
        share = total[k] / max(largest[k], 1e-300)
        reason = f"the energy balance is open, by {share:.2g} of the energy"
        raise SolverFailure("exact", float(np.append(0.0, ends)[k]), reason, REMEDY)


def _start(system: System, solution: Motion, t_end: float, q0: Array, ends: tuple[Array, Array]) -> None:
    """Raise SolverFailure where an observed position starts off by more than START of its largest value; ends: the
    times (k,) and q (k, n) of the ends of all pieces, the start first."""
    if solution.times[0] != 0.0:
        return
    for channel, (row, _) in enumerate(system.channels):
        given = float(row @ q0 + solution.offset(system, channel)(np.zeros(1))[0][0])
        positions = _looks(system, solution, t_end, channel, ends)
        # Lazy: a finer look is computed only if the start is off against the coarser ones.
        if all(abs(u[0] - given) > START * max(abs(given), float(np.max(np.abs(u)))) for u in positions):
            reason = "the motion is smaller than the rounding of the amplitudes it is the difference of"
            raise SolverFailure("exact", 0.0, reason, "use multiprecision")


def _looks(system: System, solution: Motion, t_end: float, channel: int, ends: tuple[Array, Array]) -> Iterator[Array]:
    """Positions of a channel to check, its start first: at the events, between them, and at times of fast decay."""
    row, shift = system.channels[channel][0], solution.offset(system, channel)
    yield ends[1] @ row + shift(ends[0])[0]
    t = np.linspace(0.0, t_end, 33)
    yield solution.observed(t, row)[0] + shift(t)[0]
    t = np.append(0.0, np.geomspace(min(solution.shortest_period, t_end) / 8.0, t_end, 64))
    yield solution.observed(t, row)[0] + shift(t)[0]


def _stops(
    system: System, solution: Motion, q: Array, ends: Array, sides: NDArray[np.int64]
) -> tuple[Array, Array, Array]:
    """sum_c U_c of the regimes at the starts and then the ends of all pieces, how much it is wrong in the middle of
    each, and how large it is there: what moving stops press into a body at rest is nothing at every switch."""
    times, count = solution.times, len(ends)
    when, middle = np.concatenate([times, ends]), 0.5 * (times + ends)
    total, wrong, held = np.zeros(2 * count), np.zeros(count), np.zeros(count)
    for i, contact in enumerate(system.contacts):
        shift, stops, chi = solution.offset(system, i), contact.stops, sides[:, i]
        stop = np.where(chi > 0, stops.upper_bound, np.where(chi < 0, stops.lower_bound, 0.0))
        closed = np.where(chi != 0, 0.5 * stops.spring(1)[0], 0.0)
        u = q @ contact.row + shift(when)[0]
        total += np.tile(closed, 2) * (u - np.tile(stop, 2)) ** 2
        # In the middle the law and the regime must have the same energy.
        u = solution.observed(middle, contact.row)[0] + shift(middle)[0]
        held += stops.energy(u)
        wrong += np.abs(closed * (u - stop) ** 2 - stops.energy(u))
    return total, wrong, held
