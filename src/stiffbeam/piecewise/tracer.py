"""Follow motions of a system in float64: the compiled loop, and segments by exponentials that the loop cannot
follow."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..basics.resources import afford, in_time
from ..model.system import System
from ..model.time_functions import Drive
from ..trajectory.trajectory import SolverFailure
from .exponential_search import Cells, pass_samples, search
from .follow import DONE, FULL, LET_GO, UNKNOWN, follow, next_side, pressed, side_of, watched
from .linear import Complex, Perturbation, Regime, phasors, spin_of
from .motion import Motion
from .regimes import Known, Regimes, Source
from .search import REMEDY
from .search import search as leap
from .spectrum import seen_by
from .terms import OMEGA, ORDER, SIGMA, SQUARE, X, Y, layout

EVENTS_PER_CALL, FIRST_EVENTS = 4096, 16
QUIET = np.zeros((0, 3, 0))  # no noise
FIRST = np.zeros(1, np.int64)


class Tracer:
    """Solver for one system, or for a perturbed copy of it, made of the same ``source``."""

    def __init__(self, source: Source, perturbation: Perturbation | None = None) -> None:
        self.source, self.system, self.drive = source, source.system, source.drive
        self.perturbation, self.regimes = perturbation, Regimes(source, perturbation)
        self.size = 0.0 if perturbation is None else perturbation.state
        self.gaps: Gaps | None = None

    @cached_property
    def noise(self) -> np.random.Generator:
        """The random numbers of a perturbed copy."""
        assert self.perturbation is not None
        return self.perturbation.random(98)

    def solve(self, t_end: float, start: tuple[Array, Array] | None = None) -> Motion:
        """The motion on [0, t_end] from q, q' at the ``start``, None for the initial data of the system."""
        # Amplitudes first: a perturbed copy starts on the sides of its changed state.
        eta, rate = self.regimes.start(*((self.system.q0, self.system.v0) if start is None else start), t_end, False)
        q, v = self.regimes.nodal(eta, rate)
        sides = []
        for i, contact in enumerate(self.system.contacts):
            o, moves = self.drive.offset(self.system, i)(np.zeros(1))
            sides.append(side_of(contact.stops, float(contact.row @ q + o[0]), float(contact.row @ v + moves[0])))
        return self._follow(0.0, sides, eta, rate, -1, t_end)

    def trace(self, t: float, sides: tuple[int, ...], q: Array, v: Array, resting: int, t_end: float) -> Motion:
        """The motion from (q, q') at time t with the contacts on the given sides; resting: the contact whose gap is
        exactly zero there, or -1. A segment ends at an event, and where a record has a sample."""
        return self._follow(t, list(sides), *self.regimes.start(q, v, t_end), resting, t_end)

    def _follow(self, t: float, sides: list[int], q: Array, v: Array, resting: int, t_end: float) -> Motion:
        """``trace`` from the amplitudes q of the free modes and their rates v."""
        n, m, here = self.system.size, len(sides), np.array(sides, np.int64)
        switched = (np.arange(m) == resting).astype(np.int64)
        places, speeds = np.abs(q), np.abs(v)
        parts: list[Motion] = []
        kept, since, events = 0, t, 0
        # Room for few events at first, four times as many whenever it is full: short motions allocate little.
        room, why = FIRST_EVENTS, UNKNOWN
        while True:
            # The loop stops at regimes that are new, which are added here, and at those that it cannot follow.
            r = self.regimes.at(tuple(pressed(here).tolist()), t_end)
            if not self.regimes.made[r].followed:
                why, part, t = self._alone(r, t, t_end, q, v, here, switched)
                events += 1  # its other segments end at samples
            else:
                why, part, t = self.ahead(t, t_end, q, v, places, speeds, here, switched, room)
                room = min(4 * room, EVENTS_PER_CALL) if why == FULL else room
                events += len(part.times)
            parts.append(part)
            kept += len(part.times)
            if why == DONE:
                return parts[0].joined(parts)
            in_time(t)
            afford("t_end", t_end, "shorten t_end", 2.0 * kept * (n + 1))
            if events >= EVENTS_PER_CALL:
                refuse_accumulation(since, t, max(x.fastest for x in self.regimes.made), self.drive)
                since, events = t, 0

    def ahead(
        self, t: float, t_end: float, q: Array, v: Array, places: Array, speeds: Array, sides: NDArray[np.int64],
        switched: NDArray[np.int64], room: int,
    ) -> tuple[int, Motion, float]:  # fmt: skip
        """``follow`` through at most ``room`` segments; why it ended, the motion, and the time of the last event."""
        table, K = self.regimes.table, self.regimes.table.sigma.shape[1]
        # Output arrays and noise of one call; the motion is what the call has filled.
        times, regime, chi = np.empty(room), np.empty(room, np.int64), np.empty((room, len(sides)), np.int64)
        x, y = np.zeros((2, room, K))
        noise = self.noise.uniform(-1.0, 1.0, (room, 3, K)) if self.size else QUIET
        why, count, used, t = follow(
            table, t, t_end, q, v, places, speeds, sides, switched, noise, self.size, times, regime, chi, x, y,
            1 if self.source.lagging else None,
        )  # fmt: skip
        return why, Motion(self.regimes, times[:count], chi[:count], regime[:count], x[:count], y[:count], used), t

    def _alone(
        self, r: int, t: float, t_end: float, q: Array, v: Array, sides: NDArray[np.int64], switched: NDArray[np.int64]
    ) -> tuple[int, Motion, float]:
        """The segments of one regime that is no pairs, up to an event, as ``follow`` would: q, v, sides and switched
        are those of the event in the end."""
        pairs, drive = self.regimes.made[r], self.drive
        regime = pairs.exponentials
        assert isinstance(regime, Regime)
        self.gaps = self.gaps or Gaps(self.system, drive)
        # Coefficients at the start.
        rates, key, size = np.array([0.0, *drive.frequencies]), sides.copy(), self.size
        times, kept, evaluations = [], [], 0
        nodal = self.regimes.nodal(q, v)
        c = regime.coefficients(*nodal, spin_of(drive, np.array([t]))[0])
        if size:  # the time and every term of the sums above are rounded
            c *= 1.0 + regime.eigenvalues * t * size * self.noise.uniform(-1.0, 1.0)
            terms = np.abs(regime.from_q) ** 2 @ (np.abs(nodal[0]) + np.abs(regime.response).sum(1)) ** 2
            terms += np.abs(regime.from_v) ** 2 @ (np.abs(nodal[1]) + np.abs(regime.response_rate).sum(1)) ** 2
            c += size * np.sqrt(terms) * (self.noise.uniform(-1.0, 1.0, (2, len(c))).T @ [1.0, 1j])
        while True:
            # One segment: up to the next event or the next sample of a record.
            times.append(t)
            kept.append(c)
            spin, force, edge = (
                spin_of(drive, np.array([t]))[0],
                regime.push @ drive.polynomials(t),
                drive.next_edge(t, t_end),
            )
            tau, contact, side, used = self.gaps.next_switch(regime, c, key, switched != 0, t, edge)
            evaluations += used
            event = contact >= 0 and t + tau < edge
            ahead = regime.ahead(c[None], spin[None], force[None], np.array([tau if event else edge - t]), FIRST)[0]
            if event or edge >= t_end:
                break
            # Rounding at a sample: of the coefficients, and of the answer to the records by the smaller of two bounds.
            if size:
                forces = np.sum(np.abs(force) * (edge - t) ** np.arange(1, 1 + force.shape[1]), axis=1)
                lost = size * (np.abs(ahead) + np.minimum(forces, np.abs(c) + np.abs(ahead)))
                ahead = ahead + lost * (self.noise.uniform(-1.0, 1.0, (2, len(c))).T @ [1.0, 1j])
            c, t, switched[:] = ahead, edge, 0
            passed, room = FIRST_EVENTS, FIRST_EVENTS
            while passed == room:  # the cells without an event are passed in compiled code
                room = min(4 * room, EVENTS_PER_CALL)
                noise = self.noise.uniform(-1.0, 1.0, (room, 2, len(c))) if size else QUIET
                passed, used, edges, ends = self.gaps.pass_samples(regime, c, key, t, t_end, noise, size, room)
                evaluations += used
                if passed:
                    times += edges[:passed]
                    kept += [c, *ends[: passed - 1]]
                    c, t = ends[passed - 1], edges[passed]
        # The segments, and where the last one ends with an event, the state behind it.
        x, y = pairs.pairs(np.array(kept))
        segments = np.full(len(times), r), x, y, evaluations
        part = Motion(self.regimes, np.array(times), np.tile(key, (len(times), 1)), *segments)
        if not event:
            return DONE, part, t
        q[:], v[:] = self.regimes.start(*regime.state(ahead, spin * np.exp(1j * rates * tau)), t_end)
        # As in ``follow``: one event of a contact at an instant.
        if t + tau > t:
            switched[:] = 0
        sides[contact], switched[contact] = side, 1
        return UNKNOWN, part, t + tau


def tracer_of(
    system: System, perturbation: Perturbation | None = None, known: Known | None = None, span: float = math.inf
) -> Tracer:
    """Solver that follows motions of the system in float64; known, span: see ``Source``."""
    return Tracer(Source(system, known, span), perturbation)


def refuse_accumulation(start: float, end: float, fastest: float, drive: Drive) -> None:
    """Raise SolverFailure if EVENTS_PER_CALL events follow each other within a period of the fastest motion. Forces are
    continuous, so only rounding can cause this."""
    if (end - start) * max(fastest, *drive.frequencies, 0.0) < 2.0 * math.pi:
        raise SolverFailure("exact", end, f"{EVENTS_PER_CALL} events within the shortest period", REMEDY)


class Gaps:
    """The contacts as input of the search: rows (m, n), their offsets as phasors and as amplitudes of the records."""

    def __init__(self, system: System, drive: Drive) -> None:
        m = len(system.contacts)
        self.drive, self.rates = drive, 1j * np.array([0.0, *drive.frequencies])
        self.rows = np.array([contact.row for contact in system.contacts]).reshape(m, system.size)
        shifts, rest = drive.offsets(system)
        self.offsets = phasors(shifts)[:, :m].T  # (m, 1 + F)
        self.recorded = drive.recorded(rest, shifts.shape[1])[:, :m].T  # (m, R)
        self.g1, self.g2 = (
            np.array([getattr(c.stops, side) for c in system.contacts]) for side in ("lower_bound", "upper_bound")
        )
        self.lags = np.array([float(c.stops.damping) / float(c.stops.stiffness) for c in system.contacts])

    def next_switch(
        self, regime: Regime, c: Complex, chi: NDArray[np.int64], switched: NDArray[np.bool_], t: float, t_end: float
    ) -> tuple[float, int, int, int]:
        """(tau, contact, its new side, evaluations) of the first event after t; contact -1 if there is none.

        c: the coefficients at t. chi: the sides now. switched: (m,), the contacts with an event at t. Up to t_end
        every record is one polynomial.
        """
        # Positions of the contacts: exponentials, drives, polynomials and chains.
        spin, records = spin_of(self.drive, np.array([t]))[0], self.drive.polynomials(t)
        alone = regime.single
        W = (self.rows @ regime.W) * alone
        rates: Complex = np.concatenate([regime.eigenvalues, self.rates])
        a: Complex = np.concatenate([W * c, (self.rows @ regime.response + self.offsets) * spin], axis=1)
        force = regime.push @ records
        seen, shift = W[:, :, None] * force, self.recorded @ records
        nodes, counts, chained = seen_by(regime.chains, self.rows @ regime.W, c, spin, force, ORDER + 1)
        at, lags, sides, beyond, g1, g2 = self._watched(chi)
        resting = switched
        # With damped stops d + lag d' is watched too; for what is zero at the start see ``follow.watched_of_damped``.
        if np.any(self.lags):
            now = chained[:, :, :2, :1].sum((1, 3)).real  # what chains add to u and u'
            # psi_j' = lambda psi_j + tau^j: the powers cancel over all coefficients, so that those outside of chains
            # have what those of the chains leave.
            chain = (self.rows[at] @ regime.W) * ~regime.single
            pushed = -lags[:, None] * (chain @ force).real
            d = a.real.sum(1)[at] + now[at, 0] - np.where(chi[at] > 0, self.g2[at], self.g1[at])
            y = d + lags * ((a * rates).real.sum(1)[at] + now[at, 1]) + pushed[:, :1].sum(1)
            resting = switched[at] & np.where(
                np.abs(chi[at]) == LET_GO, beyond, (lags == 0.0) | (np.abs(y) < np.abs(d))
            )
            a, seen, shift = a[at] * (1.0 + np.outer(lags, rates)), seen[at], shift[at] + pushed
            seen = seen * (1.0 + np.outer(lags, regime.eigenvalues))[:, :, None]
            # The next derivatives; ``seen_by`` has one more than the search reads, which wraps round.
            chained = chained[at] + lags[:, None, None, None] * np.roll(chained[at], -1, axis=2)
        gaps = np.ascontiguousarray(sides), g1, g2, resting.astype(np.int64), t, t_end
        # Leaps need terms that are exponentials alone.
        if self.drive.records or regime.chains:
            parts = (np.ascontiguousarray(x) for x in (np.minimum(rates.real, 0.0), rates.imag, a.real, a.imag))
            tau, which, met, used = search(*parts, *gaps, regime.eigenvalues, seen, shift, nodes, counts, chained)
        else:
            tau, which, met, used = _leap(rates, a, gaps)
        if which < 0:
            return tau, -1, 0, used
        contact = int(at[which])
        return tau, contact, next_side(int(chi[contact]), met, bool(lags[which])), used

    def pass_samples(
        self, regime: Regime, c: Complex, chi: NDArray[np.int64], t: float, t_end: float, noise: Array, size: float,
        most: int,
    ) -> tuple[int, int, list[float], Complex]:  # fmt: skip
        """Go on from the coefficients c at the sample t through up to ``most`` cells without an event
        that end before t_end.

        Returns (cells passed, evaluations, the times of the samples, the coefficients at the ends of the cells). noise,
        size: see ``pass_samples``.
        """
        drive = self.drive
        # The cells from t on, at most ``most`` and none beyond t_end.
        first = int(np.searchsorted(drive.edges, t))
        end = min(first + most + 1, int(np.searchsorted(drive.edges, t_end)))
        edges, ends = drive.edges[first:end], np.empty((max(end - first - 1, 0), len(c)), complex)
        if not len(ends):
            return 0, 0, [], ends
        cells = self._cells(regime, chi)
        return *pass_samples(cells, edges, drive.table[first : end - 1], noise, size, c, ends), edges.tolist(), ends

    def _cells(self, regime: Regime, chi: NDArray[np.int64]) -> Cells:
        """The regime and the gaps of contacts on the sides chi between samples."""
        at, lags, sides, _, g1, g2 = self._watched(chi)
        rows, recorded = (self.rows @ regime.W)[at], np.ascontiguousarray(self.recorded[at])
        waves = (self.rows @ regime.response + self.offsets)[at] * (1.0 + np.outer(lags, self.rates))
        # The frames of the chains, padded to one size.
        parts = [chain.frame(self.drive.order) for chain in regime.chains]
        counts = np.array([len(nodes) for _, nodes in parts], np.int64)
        b, K = len(parts), int(np.max(counts, initial=0))
        nodes, B, modes, drives = np.zeros((b, K), complex), np.zeros((b, K, K), complex), *np.zeros((2, b, K), int)
        sizes = np.zeros((b, 2), np.int64)
        for i, (chain, (matrix, mu)) in enumerate(zip(regime.chains, parts, strict=True)):
            nodes[i, : len(mu)], B[i, : len(mu), : len(mu)] = mu, matrix
            modes[i, : len(chain.modes)], drives[i, : len(chain.drives)] = chain.modes, chain.drives
            sizes[i] = len(chain.modes), len(chain.drives)
        return Cells(
            regime.eigenvalues, np.ascontiguousarray(regime.push), np.array(self.drive.frequencies, float), rows,
            rows * regime.single * (1.0 + np.outer(lags, regime.eigenvalues)), waves, recorded, lags,
            np.ascontiguousarray(sides), g1, g2, nodes, counts, B, modes, drives, sizes,
        )  # fmt: skip

    def _watched(
        self, chi: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], Array, NDArray[np.int64], NDArray[np.bool_], Array, Array]:
        """Contact, lag, side, flag and stops of every gap to watch, see ``watched``: of a damped stop d or the sign of
        its force."""
        m = len(chi)
        if not np.any(self.lags):
            return np.arange(m), np.zeros(m), chi, np.zeros(m, bool), self.g1, self.g2
        at, lags, sides, beyond = (np.array(x) for x in zip(*watched(chi.tolist(), self.lags), strict=True))
        # Of y only the stop counts that the contact is beyond.
        g1 = np.where(beyond & (chi[at] > 0), -np.inf, self.g1[at])
        return at, lags, sides, beyond, g1, np.where(beyond & (chi[at] < 0), np.inf, self.g2[at])


def _leap(rates: Complex, a: Complex, gaps: tuple[Any, ...]) -> tuple[float, int, int, int]:
    """``search`` among the exponentials Re sum_k a_ck exp(rates_k tau) alone, by leaps."""
    # From slow to fast, as pairs x = Re a, y = -omega Im a.
    order = np.argsort(np.abs(rates), kind="stable")
    speeds, terms, seen, pairs = layout(len(a), len(rates), 0)
    speeds[SIGMA], speeds[OMEGA] = np.minimum(rates.real, 0.0)[order], rates.imag[order]
    speeds[SQUARE] = speeds[OMEGA] ** 2
    terms[:, X], terms[:, Y] = a.real[:, order], -speeds[OMEGA] * a.imag[:, order]
    return leap(speeds, terms, seen, pairs, *gaps)
