"""The energy ledger of a piecewise solution: where it opens there is no solution, but a failure with its time.

    E - E_0 = input - dissipation,   E = 1/2 q'^T M q' + 1/2 q^T K q + sum_c U_c

Inside a piece the closed form keeps the balance of its own regime, in which U_c = kappa gap^2/2 wherever
chi says that contact c is closed. So the ledger of the whole can open in three places only: at the start;
at a switch, by the energies on its two sides and by the energy of a jump between them; and inside a piece
whose gap is not on the side that chi says, by what is wrong with U_c there. All of it is added up.

A motion far smaller than the amplitudes it is the difference of has lost its digits with the balance intact:
there the observed positions do not start where they should.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..model.system import System
from ..trajectory.trajectory import SolverFailure
from .motion import Motion
from .touching import EPS, REMEDY

ROUNDINGS = 64.0  # that a switch may cost, each as large as the stiffest mode makes it
SEEN, LOST = 1e-6, 1e-3  # of the largest energy so far: less is not held against it, more is never rounding
NOTHING = 1e-20  # of the largest energy of all: what rounding makes of none
START = 1e-3  # of the largest displacement: what a start may be off


@contextmanager
def within_float64(solver: str, t_end: float) -> Generator[None, None, None]:
    """Turn overflows, NaN and matrices without eigenvectors into SolverFailure: nothing that is not finite gets out."""
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        if isinstance(error, OverflowError) or "overflow" in str(error):
            raise SolverFailure(solver, t_end, f"the motion overflows float64 ({error})", REMEDY) from None
        reason = f"float64 has no result for a step of the calculation ({error})"
        raise SolverFailure(solver, t_end, reason, "use the method multiprecision") from None


def audit(
    system: System,
    solution: Motion,
    t_end: float,
    solver: str = "exact",
    start: tuple[Array, Array] | None = None,
) -> None:
    """Raise SolverFailure with the first time by which the ledger of [0, t_end] has opened.

    It is open where the sum of its openings exceeds what rounding explains, for every switch ROUNDINGS eps
    (w |q|_M sqrt(2 E) + 2 E) with the fastest frequency w, though not less than SEEN nor more than LOST of
    the energy, and the rounding of the terms of q^T K q, which cancel where a body moves as a whole. Pieces are
    looked at in the middle. Rigid stops turn velocities: there energies are compared, not velocities. start: q, q' (n,)
    at t = 0, None for those of the system.
    """
    q0, v0 = (system.q0, system.v0) if start is None else start
    times, sides = solution.times, solution.sides
    count, ends = len(times), np.append(times[1:], t_end)
    pieces, when = np.arange(count), np.concatenate([times, ends])
    q, v = solution.states_in(when, np.concatenate([pieces, pieces]))
    finite = np.isfinite(q) & np.isfinite(v)
    if not finite.all():
        raise SolverFailure(solver, float(np.min(when[~finite.all(axis=1)])), "the motion is not finite", REMEDY)
    _start(system, solution, t_end, solver, q0, (when, q))
    after, before = slice(0, count), slice(count, 2 * count - 1)
    # The states, the jumps at the switches, and the start that is given.
    kinetic, elastic = system.free_energies(*(np.vstack([x, x[1:count] - x[before], y]) for x, y in ((q, q0), (v, v0))))
    free = kinetic + elastic
    stops, inside, held = _stops(system, solution, q, ends, sides)
    energy = free[: 2 * count] + stops
    opening = np.zeros(count + 1)  # at the start, and at the end of every piece
    if times[0] == 0.0:
        opening[0] = abs(energy[0] - free[-1] - system.contact_energy(times[:1], q0[None])[0])
    opening[1:-1] = np.abs(energy[after][1:] - energy[before])
    if solver != "rigid":
        opening[1:-1] += free[2 * count : -1]
        opening[1:] += inside
    length = np.sqrt(np.sum(q * (q @ system.mass), axis=1))
    positive = np.maximum(energy, 0.0)
    rounding = 2.0 * np.pi / solution.shortest_period * length * np.sqrt(2.0 * positive) + 2.0 * positive
    terms = EPS * np.sum(np.abs(q) * (np.abs(q) @ np.abs(system.stiffness)), axis=1)
    allowed, cancelled = (np.cumsum(np.append(x[after], 0.0) + np.append(0.0, x[count:])) for x in (rounding, terms))
    largest = np.maximum.accumulate(np.maximum(np.maximum(energy[after], energy[count:]), held))
    largest = np.append(largest, largest[-1])
    allowed = np.clip(ROUNDINGS * EPS * np.sqrt(system.size) * allowed, SEEN * largest, LOST * largest)
    allowed += cancelled
    total = np.cumsum(opening)
    open_at = np.flatnonzero(total > allowed + NOTHING * largest[-1])
    if len(open_at):
        k = int(open_at[0])
        share = total[k] / max(largest[k], 1e-300)
        reason = f"the energy balance is open, by {share:.2g} of the energy"
        raise SolverFailure(solver, float(np.append(0.0, ends)[k]), reason, REMEDY)


def _start(system: System, solution: Motion, t_end: float, solver: str, q0: Array, ends: tuple[Array, Array]) -> None:
    """Raise SolverFailure where an observed position starts off by more than START of its largest value; ends: the
    times (k,) and q (k, n) of the ends of all pieces, the start first."""
    if solution.times[0] != 0.0:
        return
    for channel, (row, _) in enumerate(system.channels):
        given = float(row @ q0 + solution.offset(system, channel)(np.zeros(1))[0][0])
        positions = _looks(system, solution, t_end, channel, ends)
        if all(abs(u[0] - given) > START * max(abs(given), float(np.max(np.abs(u)))) for u in positions):
            reason = "the motion is smaller than the rounding of the amplitudes it is the difference of"
            raise SolverFailure(solver, 0.0, reason, "use multiprecision")


def _looks(system: System, solution: Motion, t_end: float, channel: int, ends: tuple[Array, Array]) -> Iterator[Array]:
    """Positions of a channel, its start first: at the switches, between them, and of what soon dies out."""
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
        stop = np.where(chi > 0, stops.g2, np.where(chi < 0, stops.g1, 0.0))
        closed = np.where(chi != 0, 0.5 * stops.spring(1)[0], 0.0)
        u = q @ contact.row + shift(when)[0]
        total += np.tile(closed, 2) * (u - np.tile(stop, 2)) ** 2
        u = solution.observed(middle, contact.row)[0] + shift(middle)[0]
        held += stops.energy(u)
        wrong += np.abs(closed * (u - stop) ** 2 - stops.energy(u))
    return total, wrong, held
