"""Following the exact solution without damping from switch to switch: three regimes, all of it compiled."""

from __future__ import annotations

import math

import numpy as np

from ...basics.arrays import Array
from ...basics.resources import Forecast
from ...model.drive import Drive
from ...trajectory.trajectory import SolverFailure
from .following import Regimes, follow
from .rounding import Perturbation, rounded_sum
from .touching import REMEDY
from .undamped import Solution
from .undamped_regimes import Parts

EVENTS_PER_CALL, FIRST_EVENTS = 4096, 16
QUIET = np.zeros((0, 3, 0))  # no noise


class Tracer:
    """Follows solutions of one system, or of a perturbed copy of it, made of the same ``parts``."""

    def __init__(self, parts: Parts, perturbation: Perturbation | None = None) -> None:
        self.system, self.drive, self.perturbation = parts.system, parts.drive, perturbation
        self.noise = np.random.default_rng(None if perturbation is None else [perturbation.seed, 98])
        self.bases, forces, cross = parts.bases, parts.forces, parts.cross
        if perturbation is not None:
            self.bases, forces, cross = parts.perturbed(perturbation, self.noise)
        self.stops = self.system.contacts[0].stops if self.system.contacts else None
        self.offset, self.regimes = parts.offset, parts.regimes(self.bases, forces, cross)
        self.fastest = max(float(np.max(self.regimes.omegas)), *self.drive.frequencies, 0.0)

    def solve(self, t_end: float, start: tuple[Array, Array] | None = None) -> Solution:
        """The solution on [0, t_end] from q, q' at the ``start``, None for the initial data of the system."""
        basis, (q0, v0) = self.bases[0], (self.system.q0, self.system.v0) if start is None else start
        eta, rate = basis.to_modal(q0), basis.to_modal(v0)
        if self.perturbation is not None:
            fastest = float(np.max(self.regimes.omegas)) or 1.0
            turned = basis.mass @ basis.shapes
            terms = rounded_sum(q0, turned), rounded_sum(v0, turned)
            drive, size = self.drive, self.perturbation.state
            eta, rate = _perturbed(eta, rate, terms, fastest, self.regimes, drive, size, self.noise)
        q, v = basis.to_nodal(eta), basis.to_nodal(rate)
        u = float(q @ self.system.channels[0][0] + self.drive.coefficients(0.0) @ self.offset)
        sides = (int(self.stops.state(u)),) if self.stops else ()
        return self.trace(0.0, sides, q, v, -1, t_end)

    def trace(self, t: float, sides: tuple[int, ...], q: Array, v: Array, resting: int, t_end: float) -> Solution:
        """The solution from (q, q') at time t with the contact on the given side; resting: the contact
        whose gap is exactly zero there, or -1."""
        regime, at_switch = (sides[0] if sides else 0), resting >= 0
        P, g = self.regimes.particulars[regime], self.drive.coefficients(t)
        h = self.bases[regime].to_modal(q) - P @ g
        rate = self.bases[regime].to_modal(v) - P @ (self.drive.derivative() @ g)
        found = [(np.array([t]), np.array([regime]), h[None].copy(), rate[None].copy())]
        evaluations, forecast, kept = 0, Forecast(t_end), 0
        noise, size = QUIET, 0.0 if self.perturbation is None else self.perturbation.state
        count = room = FIRST_EVENTS
        while count == room:
            room = min(4 * count, EVENTS_PER_CALL)
            times, chi, (hs, rates) = np.empty(room), np.empty(room, np.int64), np.empty((2, room, len(h)))
            if size:
                noise = self.noise.uniform(-1.0, 1.0, (room, 3, len(h)))
            count, used = follow(self.regimes, regime, h, rate, t, t_end, at_switch, noise, size, times, chi, hs, rates)
            evaluations += used
            found.append((times[:count], chi[:count], hs[:count], rates[:count]))
            kept += count
            if count:
                if count == EVENTS_PER_CALL:
                    refuse_accumulation(float(times[0]), float(times[-1]), self.fastest)
                forecast.check(float(times[count - 1]), 2.0 * kept * (len(h) + 1))
                t, regime, at_switch = float(times[count - 1]), int(chi[count - 1]), True
                h, rate = hs[count - 1], rates[count - 1]
        times, chi, hs, rates = (np.concatenate(x) for x in zip(*found, strict=True))
        return Solution(self.drive, self.bases, self.regimes, times, chi, hs, rates, evaluations)


def refuse_accumulation(start: float, end: float, fastest: float) -> None:
    """Raise SolverFailure where EVENTS_PER_CALL switches follow each other within a period of the fastest
    motion: forces are continuous, so none does that, and what does is rounding."""
    if (end - start) * fastest < 2.0 * math.pi:
        raise SolverFailure("exact", end, f"{EVENTS_PER_CALL} switches within the shortest period", REMEDY)


def _perturbed(
    eta: Array,
    rate: Array,
    terms: tuple[Array, Array],
    fastest: float,
    regimes: Regimes,
    drive: Drive,
    size: float,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Initial modal data changed in proportion to the motion, amplitudes of the start and of the drive, and to
    the ``terms`` that they are sums of."""
    omega = regimes.omegas[0]
    start = np.hypot(omega * eta, rate)
    slowest = omega[omega > 0.0][:1]  # what a constant load moves, it moves at natural frequencies
    rates = np.where(drive.rates > 0.0, drive.rates, slowest[0] if len(slowest) else 0.0)
    driven = np.sum(np.abs(regimes.particulars[0]) * rates, axis=1)
    least = max(float(np.max(start)), float(np.max(driven)))
    noise = rng.uniform(-1.0, 1.0, (2, eta.size))
    scale = np.maximum(omega, fastest * 1e-8)
    return eta + size * (least / scale + terms[0]) * noise[0], rate + size * (least + terms[1]) * noise[1]
