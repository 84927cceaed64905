"""Following a damped solution or one with several contacts from switch to switch, in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...basics.resources import Forecast
from ...model.drive import Drive
from ...model.modes import undamped_modes
from ...model.system import System
from .chains import seen_by
from .damped_stops import LET_GO, next_side, pressed, side_of, watched
from .exponential import ExponentialSolution
from .exponential_regime import Complex, Regime, phasors, regime_of, spin_of
from .exponential_search import search
from .rounding import Perturbation, rounded_sum
from .switching import search as leap
from .terms import OMEGA, SIGMA, SQUARE, X, Y, layout
from .touching import ORDER
from .undamped_tracer import EVENTS_PER_CALL, refuse_accumulation


class ExponentialTracer:
    """Follows solutions of one system; its regimes are made as they are met and kept."""

    def __init__(self, system: System, perturbation: Perturbation | None = None) -> None:
        self.system, self.drive, self.perturbation = system, Drive.of(system), perturbation
        self.gaps = Gaps(system, self.drive)
        self.regimes: dict[tuple[int, ...], Regime] = {}

    def solve(self, t_end: float) -> ExponentialSolution:
        """The solution on [0, t_end] from the initial data."""
        q, v = _start(self.system, self.perturbation)
        sides = []
        for i, contact in enumerate(self.system.contacts):
            o, rate = self.drive.offset(self.system, i)(np.zeros(1))
            sides.append(side_of(contact.stops, float(contact.row @ q + o[0]), float(contact.row @ v + rate[0])))
        return self.trace(0.0, tuple(sides), q, v, -1, t_end)

    def trace(
        self, t: float, sides: tuple[int, ...], q: Array, v: Array, resting: int, t_end: float
    ) -> ExponentialSolution:
        """The solution from (q, q') at time t with the contacts on the given sides; resting: the contact
        whose gap is exactly zero there, or -1. A piece ends at a switch, and where a record has a sample."""
        system, drive = self.system, self.drive
        drive_rates = np.array([0.0, *drive.frequencies])
        chi, evaluations = list(sides), 0
        switched = np.arange(len(chi)) == resting  # at this very instant
        rng = None if self.perturbation is None else np.random.default_rng([self.perturbation.seed, 98])
        times, keys, coefficients, carried = [], [], [], None  # c, where a piece has only gone on
        switches, since, forecast = 0, t, Forecast(t_end)
        while True:
            key = tuple(chi)
            if key not in self.regimes:
                closed = tuple(pressed(key).tolist())
                made = self.regimes.get(closed) or regime_of(system, drive, closed, t_end, self.perturbation)
                self.regimes[key] = made
            regime = self.regimes[key]
            spin = spin_of(drive, np.array([t]))[0]
            if carried is None:
                c = regime.coefficients(q, v, spin)
                if rng is not None and self.perturbation is not None:
                    # The time and every term of the sums above are rounded.
                    c *= 1.0 + regime.eigenvalues * t * self.perturbation.state * rng.uniform(-1.0, 1.0)
                    terms = rounded_sum(regime.from_q, np.abs(q) + np.abs(regime.response).sum(1))
                    terms += rounded_sum(regime.from_v, np.abs(v) + np.abs(regime.response_rate).sum(1))
                    c += self.perturbation.state * terms * (rng.uniform(-1.0, 1.0, (2, len(c))).T @ [1.0, 1j])
            else:
                c = carried
            times.append(t)
            keys.append(key)
            coefficients.append(c)
            force, edge = regime.push @ drive.polynomials(t), drive.next_edge(t, t_end)
            tau, contact, side, used = self.gaps.next_switch(regime, c, np.array(key, np.int64), switched, t, edge)
            evaluations += used
            if contact < 0 or t + tau >= edge:
                if edge >= t_end:
                    break
                carried = self._carried(regime, c, spin, force, edge - t, rng)
                t, switched = edge, np.zeros(len(chi), bool)
                continue
            moving, carried = regime.ahead(c[None], spin[None], force[None], np.array([tau]))[0], None
            q, v = regime.state(moving, spin * np.exp(1j * drive_rates * tau))
            chi[contact] = side
            if t + tau > t:
                switched[:] = False
            switched[contact] = True
            t += tau
            switches += 1
            forecast.check(t, switches * (2.0 * len(c) + 40.0))
            if switches % EVENTS_PER_CALL == 0:
                fastest = [float(np.max(np.abs(met.eigenvalues))) for met in self.regimes.values()]
                refuse_accumulation(since, t, max(*fastest, *drive.frequencies, 0.0))
                since = t
        sides_array = np.array(keys, np.int64).reshape(len(times), len(chi))
        return ExponentialSolution(drive, self.regimes, np.array(times), sides_array, coefficients, evaluations)

    def _carried(
        self, regime: Regime, c: Complex, spin: Complex, force: Complex, tau: float, rng: np.random.Generator | None
    ) -> Complex:
        """The coefficients at the end of a piece that goes on in the same regime."""
        ahead = regime.ahead(c[None], spin[None], force[None], np.array([tau]))[0]
        if rng is not None and self.perturbation is not None:
            forces = np.sum(np.abs(force) * tau ** np.arange(1, 1 + force.shape[1]), axis=1)  # without cancellation
            size = self.perturbation.state * (np.abs(ahead) + np.minimum(forces, np.abs(c) + np.abs(ahead)))
            ahead = ahead + size * (rng.uniform(-1.0, 1.0, (2, len(c))).T @ [1.0, 1j])
        return ahead


class Gaps:
    """The contacts as the search sees them: rows (m, n), their offsets as phasors and as amplitudes of the records."""

    def __init__(self, system: System, drive: Drive) -> None:
        m = len(system.contacts)
        self.drive, self.rates = drive, 1j * np.array([0.0, *drive.frequencies])
        self.rows = np.array([contact.row for contact in system.contacts]).reshape(m, system.size)
        shifts, rest = drive.offsets(system)
        self.offsets = phasors(shifts)[:, :m].T  # (m, 1 + F)
        self.recorded = drive.recorded(rest, shifts.shape[1])[:, :m].T  # (m, R)
        self.g1, self.g2 = (np.array([getattr(c.stops, side) for c in system.contacts]) for side in ("g1", "g2"))
        self.lags = np.array([float(c.stops.damping) / float(c.stops.stiffness) for c in system.contacts])

    def next_switch(
        self, regime: Regime, c: Complex, chi: NDArray[np.int64], switched: NDArray[np.bool_], t: float, t_end: float
    ) -> tuple[float, int, int, int]:
        """(tau, contact, its new side, evaluations) of the first switch after t, contact -1 where there is none.

        c: the coefficients at t. chi: the sides now. switched: (m,), the contacts that have switched at t. Up to t_end
        every record is one polynomial.
        """
        spin, records = spin_of(self.drive, np.array([t]))[0], self.drive.polynomials(t)
        alone = regime.single
        W = (self.rows @ regime.W) * alone
        rates: Complex = np.concatenate([regime.eigenvalues, self.rates])
        a: Complex = np.concatenate([W * c, (self.rows @ regime.response + self.offsets) * spin], axis=1)
        force = regime.push @ records
        seen, shift = W[:, :, None] * force, self.recorded @ records
        nodes, counts, chained = seen_by(regime.chains, self.rows @ regime.W, c, spin, force, ORDER + 1)
        at, lags, sides, g1, g2, resting = np.arange(len(chi)), np.zeros(len(chi)), chi, self.g1, self.g2, switched
        if np.any(self.lags):  # what is watched of a damped stop is d or the sign of its force
            at, lags, sides, own = (np.array(x) for x in zip(*watched(chi.tolist(), self.lags), strict=True))
            now = chained[:, :, :2, :1].sum((1, 3)).real  # what chains add to u and u'
            d = a.real.sum(1)[at] + now[at, 0] - np.where(chi[at] > 0, g2[at], g1[at])
            y = d + lags * ((a * rates).real.sum(1)[at] + now[at, 1])
            resting = switched[at] & np.where(np.abs(chi[at]) == LET_GO, own, (lags == 0.0) | (np.abs(y) < np.abs(d)))
            a, seen, shift = a[at] * (1.0 + np.outer(lags, rates)), seen[at], shift[at]
            seen = seen * (1.0 + np.outer(lags, regime.eigenvalues))[:, :, None]
            chained = chained[at] + lags[:, None, None, None] * np.roll(chained[at], -1, axis=2)
            g1, g2 = np.where(own & (chi[at] > 0), -np.inf, g1[at]), np.where(own & (chi[at] < 0), np.inf, g2[at])
        gaps = np.ascontiguousarray(sides), g1, g2, resting.astype(np.int64), t, t_end
        if self.drive.records or regime.chains:
            parts = (np.ascontiguousarray(x) for x in (np.minimum(rates.real, 0.0), rates.imag, a.real, a.imag))
            tau, which, met, used = search(*parts, *gaps, regime.eigenvalues, seen, shift, nodes, counts, chained)
        else:
            tau, which, met, used = _leap(rates, a, gaps)
        if which < 0:
            return tau, -1, 0, used
        contact = int(at[which])
        return tau, contact, next_side(int(chi[contact]), met, bool(lags[which])), used


def _leap(rates: Complex, a: Complex, gaps: tuple[Any, ...]) -> tuple[float, int, int, int]:
    """``search`` among the exponentials Re sum_k a_ck exp(rates_k tau) alone, by leaps."""
    order = np.argsort(np.abs(rates), kind="stable")
    speeds, terms, seen, pairs = layout(len(a), len(rates), 0)
    speeds[SIGMA], speeds[OMEGA] = np.minimum(rates.real, 0.0)[order], rates.imag[order]
    speeds[SQUARE] = speeds[OMEGA] ** 2
    terms[:, X], terms[:, Y] = a.real[:, order], -speeds[OMEGA] * a.imag[:, order]
    return leap(speeds, terms, seen, pairs, *gaps)


def _start(system: System, perturbation: Perturbation | None) -> tuple[Array, Array]:
    q, v = system.q0.copy(), system.v0.copy()
    if perturbation is not None:
        rng = np.random.default_rng([perturbation.seed, 99])
        place, speed = (perturbation.state * float(np.max(np.abs(x))) for x in (q, v))
        omega = undamped_modes(system).omega
        if np.any(omega > 0.0):  # a speed for every place and force, whatever times are counted in
            slowest = float(omega[omega > 0.0][0])
            load = np.max(np.abs(np.linalg.solve(system.mass, system.load(0.0))))
            speed = max(speed, slowest * place, perturbation.state * float(load) / slowest)
            place = speed / slowest
        q, v = q + place * rng.uniform(-1, 1, len(q)) / len(q) ** 2, v + speed * rng.uniform(-1, 1, len(v))
    return q, v
