"""Motion between compliant stops in many digits, from switch to switch: z' = G z, in blocks (splitting.py).

Float64 finds the next switch from the state there, Newton's method doubles its digits, and one evaluation of the
exponentials is made with all of them. Digits that the motion has used up are not carried on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...basics.resources import Forecast
from ...model.drive import Drive
from ...model.system import System
from ...piecewise.events import pressed, side_of, switched_by_force
from ...piecewise.linear import Regime, spin_of
from ...piecewise.motion import Motion
from ...piecewise.regimes import Regimes, Source
from ...piecewise.touching import REMEDY
from ...piecewise.tracer import Gaps
from ...trajectory.trajectory import SolverFailure
from .grazes import Sampler, Switch
from .linear_flow import DERIVATIVES, LinearFlow
from .rational import carried
from .splitting import Block, Split, with_drives

GUARD_BITS = 100  # below the digits that are lost: two doubles' worth for the outputs
KNOWN_BITS = 28  # what float64 knows of a time between two switches


Known = dict[tuple[int, ...], Split]


class PreciseRegime:
    """The flow with contacts ``closed``, and the same regime in float64, ``rounded``.

    known: splits by the contacts that are closed, on either side; this one is added.
    """

    def __init__(self, flow: LinearFlow, closed: tuple[int, ...], rounded: Regime, known: Known) -> None:
        self.flow, self.G = flow, flow.closed(closed)
        self.rounded = rounded
        contacts = tuple(map(abs, closed))
        if contacts in known:
            self.split = known[contacts].again(self.G)
        else:
            self.split = Split(self.G, *_by_float64(self.rounded, flow), drives=2 * flow.n)
        known[contacts] = self.split
        self._rows: dict[tuple[int, int, bool], Any] = {}

    @cached_property
    def channels(self) -> Any:
        """Rows of all channels and their rates on y (2 channels, N)."""
        return self._seen(*self.flow.forms, *self.flow.rates)

    def gap(self, contact: int, side: int, lagging: bool) -> Any:
        """Rows of u - g of a contact, or of u - g + (c/kappa) u', and of its rate on y (2, N)."""
        key = contact, side, lagging
        if key not in self._rows:
            form = self.flow.beyond(contact, side)
            if lagging:
                form += self.flow.rates[contact] * self.flow.problem.contacts[contact].lag
            self._rows[key] = self._seen(form, form * self.G)
        return self._rows[key]

    def _seen(self, *forms: Any) -> Any:
        return (arb_mat([form.entries() for form in forms]) * self.split.V).mid()

    def coefficients(self, z: Any, t: float) -> Any:
        """Values of ``rounded`` where z (N, 1) is at t."""
        n = self.flow.n
        values = np.array([float(x) for x in z.entries()[: 2 * n]])
        return self.rounded.coefficients(values[:n], values[n:], spin_of(self.flow.drive, np.array([t]))[0])


class Piece(NamedTuple):
    """A regime from time t on, the coordinates y there and the bits carried."""

    regime: PreciseRegime
    t: Any
    y: Any
    bits: int

    def ahead(self, t: float) -> Any:
        """y at time t."""
        return self.regime.split.ahead(self.y, arb(t) - self.t)

    def state(self, t: float) -> Any:
        """z (N, 1) at time t."""
        return (self.regime.split.V * self.ahead(t)).mid()


@dataclass(frozen=True, eq=False)
class Unrounded(Motion):
    """A motion with the states of its ``precise`` pieces, for motions that are small differences of
    large amplitudes: of these only the values are rounded."""

    precise: list[Piece]

    def states_in(self, t: Array, piece: NDArray[np.int64]) -> tuple[Array, Array]:
        """q, q' (k, n) as the given segments have them at times t, which may be the ends of those."""
        n, z = self.precise[0].regime.flow.n, np.empty((len(t), self.precise[0].regime.flow.N))
        for i, (k, when) in enumerate(zip(piece.tolist(), t.tolist(), strict=True)):
            with carried(self.precise[k].bits):
                z[i] = [float(x) for x in self.precise[k].state(when).entries()]
        return z[:, :n], z[:, n : 2 * n]

    def observed(self, t: Array, row: Array) -> tuple[Array, Array]:
        """row @ q and its rate at any times, (k,)."""
        q, v = self.states(t)
        return q @ row, v @ row


def follow(
    system: System, t_end: float, full: int, guard: int, told: Sequence[Switch], known: Known
) -> tuple[Motion, Sampler, Unrounded]:
    """The solution on [0, t_end] carried with ``full`` bits at the start and ``guard`` at the end, rounded to
    float64, what samples its channels before it is rounded, and itself unrounded; ctx.prec has room to spare.

    told: switches that float64 does not see, in order. known: see ``PreciseRegime``.
    """
    room, drive = ctx.prec, Drive.of(system)
    flow, gaps = LinearFlow(system, full), Gaps(system, drive)
    float64 = Regimes(Source(system, span=t_end))
    float64.source.damped = True  # exponentials in every regime
    regimes: dict[tuple[int, ...], PreciseRegime] = {}
    t, z = arb(0), flow.start()
    chi = [
        side_of(contact.stops, *(float((form * z)[0, 0]) for form in forms))
        for contact, *forms in zip(system.contacts, flow.forms, flow.rates, strict=False)
    ]
    times, sides, coefficients, resting, evaluations = [], [], [], -1, 0
    pieces: list[Piece] = []
    forecast, untold = Forecast(t_end), list(told)
    fastest, turning = 1.0 / t_end, max(1.0 / t_end, *drive.frequencies, 0.0)  # of all regimes met
    while True:
        key = tuple(chi)
        if key not in regimes:
            with carried(room):
                closed = tuple(pressed(key).tolist())
                rounded = float64.made[float64.at(closed, t_end)].exponentials  # refuses what float64 refuses
                assert rounded is not None
                regimes[key] = regimes.get(closed) or PreciseRegime(flow, closed, rounded, known)
            values = regimes[key].rounded.eigenvalues
            fastest = max(fastest, float(np.max(np.abs(values))))
            turning = max(turning, float(np.max(np.abs(values.imag))))
        regime, begun = regimes[key], float(t)
        ctx.prec = max(guard, math.ceil(full - (full - guard) * min(1.0, begun / t_end))) + 30
        times.append(begun)
        sides.append(list(chi))
        coefficients.append(regime.coefficients(z, begun))
        pieces.append(Piece(regime, t, (regime.split.L * z).mid(), ctx.prec))
        edge = drive.next_edge(begun, t_end)
        start, contact, side, used = gaps.next_switch(
            regime.rounded, coefficients[-1], np.array(chi, np.int64), np.arange(len(chi)) == resting, begun, edge
        )
        evaluations += used
        if untold and untold[0].t < (begun + start if contact >= 0 else edge):
            start, contact, side = untold[0].t - begun, untold[0].contact, untold[0].side
            side = 0 if chi[contact] else side
            del untold[0]
        if contact >= 0 and begun + start < edge:
            forecast.check(begun, len(times) * (full / 32.0 + 20.0) * system.size)
            gap = regime.gap(contact, side or chi[contact], switched_by_force(chi[contact], side))
            tau, shift, ahead = _locate(partial(_at, pieces[-1], gap), start, fastest, 2.0 * np.pi / turning, begun)
            when = (t + tau + shift).mid()
            if not drive.records or t <= when < edge:
                t, chi[contact], resting = when, side, contact
                z = (regime.split.V * regime.split.ahead(ahead, shift)).mid()
                continue
            if when < t:
                raise SolverFailure("multiprecision", begun, "a switch at a sample that float64 cannot place", REMEDY)
        if edge >= t_end:
            break
        t, z, resting = arb(edge), flow.at_edge(pieces[-1].state(edge), arb(edge)), -1
    numbers = [float64.number[tuple(pressed(line).tolist())] for line in sides]
    x, y = np.zeros((2, len(times), float64.table.sigma.shape[1]))
    for i, (r, c) in enumerate(zip(numbers, coefficients, strict=True)):
        x[i, : len(c)], y[i, : len(c)] = float64.made[r].pairs(c)
    on = np.array(sides, np.int64).reshape(len(times), len(chi))
    motion = float64, np.array(times), on, np.array(numbers, np.int64), x, y, evaluations
    return Motion(*motion), partial(_sample, times, pieces), Unrounded(*motion, pieces)


def _by_float64(regime: Regime, flow: LinearFlow) -> tuple[Any, list[Block]]:
    """Columns V (N, N) and blocks of a float64 regime and of the drives behind it: the constant, sine and cosine of
    every frequency, and the derivatives of every record."""
    n, V = flow.n, np.eye(flow.N)
    chains = [chain.modes.tolist() for chain in regime.chains if len(chain.T) > 1]
    alone = set(range(len(regime.eigenvalues))) - {k for modes in chains for k in modes}
    columns: list[Array] = []
    modes = []
    for group in (*([k] for k in sorted(alone)), *chains):
        values = regime.eigenvalues[group]
        both, first = np.concatenate([regime.W, regime.W_rate])[:, group].T, len(columns)
        columns += [x.real for x in both]
        if paired := bool(np.all(values.imag > 0.0)):
            columns += [-x.imag for x in both]
            values = np.append(values, values.conj())
        modes.append(Block(list(range(first, len(columns))), values.tolist(), paired and len(group) == 1))
    V[: 2 * n, : 2 * n] = np.transpose(columns)
    drives = [Block([2 * n], [0.0], False)]
    for k, frequency in enumerate(flow.drive.frequencies):
        places = [2 * n + 1 + 2 * k, 2 * n + 2 + 2 * k]
        drives.append(Block(places, [1j * frequency, -1j * frequency], True))
    for first in range(2 * n + flow.drive.size, flow.N, DERIVATIVES):
        drives.append(Block(list(range(first, first + DERIVATIVES)), [0.0], False))
    return arb_mat([[arb(x) for x in line] for line in V.tolist()]), with_drives(modes, drives)


def _sample(
    times: list[float], pieces: list[Piece], t: Array, rounded: Callable[[Any], Any] = float
) -> tuple[Array, Array]:
    """Positions and velocities (k, channels) at any times, ``rounded``."""
    found = []
    for when, k in zip(t.tolist(), np.maximum(np.searchsorted(times, t, "right") - 1, 0).tolist(), strict=True):
        with carried(pieces[k].bits):
            seen = pieces[k].regime.channels * pieces[k].ahead(when)
            found.append([rounded(x) for x in seen.entries()])
    u, v = np.array(found).reshape(len(t), 2, -1).transpose(1, 0, 2)
    return u, v


def _at(piece: Piece, gap: Any, tau: Any) -> tuple[Any, Any, Any]:
    """A gap and its rate at tau after the start of a piece, and y there."""
    y = piece.regime.split.ahead(piece.y, tau)
    return *(gap * y).mid().entries(), y  # type: ignore[return-value]


def _locate(
    gap_at: Callable[[Any], tuple[Any, Any, Any]], start: float, fastest: float, shortest: float, t: float
) -> tuple[Any, Any, Any]:
    """(tau, shift, y at tau): the gap closes at tau + shift, by so little later that y is known there as well.

    gap_at(tau) -> (gap, gap', y). Newton's method from the float64 time ``start``, the precision doubled at each turn,
    so that only one evaluation is made at full precision. Where the gap is zero as the piece begins, at rest on its
    stop and pressed, that is the switch. Raises SolverFailure where Newton's method leads further than a fiftieth of
    the ``shortest`` period away: two crossings so close to each other that float64 cannot tell them apart.
    """
    near = 0.02 * shortest
    if start < near:
        (gap, speed, y), soon = gap_at(arb(0)), arb(0.5 * near)
        if max(abs(gap), abs(speed) * soon) < arb(2) ** (-ctx.prec // 2) * abs(gap_at(soon)[0]):
            return arb(0), arb(0), y
    full, tau, accurate = ctx.prec, arb(start), KNOWN_BITS
    while accurate < full // 2:
        accurate = 2 * accurate - 8  # the ratio of gap'' to gap' costs a few bits at each turn
        with carried(min(full, accurate + 70)):
            gap, speed, _ = gap_at(tau)
            tau = (tau - gap / speed).mid()
    for _ in range(64):
        gap, speed, y = gap_at(tau)
        shift = (-gap / speed).mid()
        if not abs(float(tau + shift) - start) < near:
            break
        if abs(shift) * fastest < arb(2) ** (-full // 3):
            return tau, shift, y
        tau = (tau + shift).mid()
    remedy = f"end before t = {t + start:.6g}" if t + start > near else "start a little off the stop"
    raise SolverFailure("multiprecision", t + start, "the switch is a graze that float64 cannot place", remedy)
