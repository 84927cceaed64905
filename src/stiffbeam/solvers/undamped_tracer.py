"""Following the exact solution without damping from switch to switch: three regimes, all of it compiled."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..contact import Stops
from ..drive import Drive
from ..modal import Modes, modes
from ..system import System
from ..validation import InputError
from .switching import follow
from .undamped import Regime, Solution

RESONANCE = 1e-8  # |Omega^2 - omega^2|/omega^2 below which a drive counts as resonant
EVENTS_PER_CALL = 4096


class Perturbation(NamedTuple):
    """A relative change of every frequency and of the initial data, for a twin of the solution.

    frequency: size of the change of each omega relative to the largest; state: of each initial modal
    amplitude relative to the largest in energy; seed: of the random signs and sizes.
    """

    frequency: float
    state: float
    seed: int


class Tracer:
    """Follows solutions of one system; its modes are made once. ``compile_seconds``: spent compiling.

    known: modes by the stiffness of the stop, 0 for the free system; used and added to.
    """

    def __init__(
        self, system: System, perturbation: Perturbation | None = None, known: dict[float, Modes] | None = None
    ) -> None:
        self.system, self.drive, self.perturbation = system, Drive.of(system), perturbation
        self.bases, self.regimes = _regimes(system, self.drive, perturbation, {} if known is None else known)
        self.stops = system.contacts[0].stops if system.contacts else None
        free, contact = self.bases[0], self.bases.get(1, self.bases[0])
        to_contact = free.shapes.T @ system.mass @ contact.shapes  # eta_contact = eta_free @ this
        self.search = search_arguments(self.regimes, to_contact, self.drive, self.stops)
        compiling = time.perf_counter()
        none = np.zeros((1, system.size))
        index = np.zeros(1, np.int64)
        follow(none[0].copy(), none[0].copy(), 0, 0.0, 0.0, True, *self.search, np.zeros(1), index, none, none)
        self.compile_seconds = time.perf_counter() - compiling

    def solve(self, t_end: float) -> Solution:
        """The solution on [0, t_end] from the initial data."""
        basis = self.bases[0]
        eta, rate = basis.to_modal(self.system.q0), basis.to_modal(self.system.v0)
        if self.perturbation is not None:
            fastest = max(float(b.omega[-1]) for b in self.bases.values()) or 1.0
            eta, rate = _perturbed(eta, rate, fastest, self.regimes[0], self.drive, self.perturbation)
        q, v = basis.to_nodal(eta), basis.to_nodal(rate)
        u = float(q @ self.system.channels[0][0] + self.drive.coefficients(0.0) @ self.regimes[0].offset)
        sides = (int(self.stops.state(u)),) if self.stops else ()
        return self.trace(0.0, sides, q, v, -1, t_end)

    def trace(self, t: float, sides: tuple[int, ...], q: Array, v: Array, resting: int, t_end: float) -> Solution:
        """The solution from (q, q') at time t with the contact on the given side; resting: the contact
        whose gap is exactly zero there, or -1."""
        regime, at_switch = (sides[0] if sides else 0), resting >= 0
        law, g = self.regimes[regime], self.drive.coefficients(t)
        h = self.bases[regime].to_modal(q) - law.particular @ g
        rate = self.bases[regime].to_modal(v) - law.particular @ (self.drive.derivative() @ g)
        found = [(np.array([t]), np.array([regime]), h[None].copy(), rate[None].copy())]
        evaluations, count = 0, EVENTS_PER_CALL
        while count == EVENTS_PER_CALL:
            times, chi = np.empty(EVENTS_PER_CALL), np.empty(EVENTS_PER_CALL, np.int64)
            hs, rates = np.empty((EVENTS_PER_CALL, len(h))), np.empty((EVENTS_PER_CALL, len(h)))
            count, used = follow(h, rate, regime, t, t_end, at_switch, *self.search, times, chi, hs, rates)
            evaluations += used
            found.append((times[:count], chi[:count], hs[:count], rates[:count]))
            if count:
                t, regime, at_switch = float(times[count - 1]), int(chi[count - 1]), True
                h, rate = hs[count - 1].copy(), rates[count - 1].copy()
        times, chi, hs, rates = (np.concatenate(x) for x in zip(*found, strict=True))
        return Solution(self.drive, self.bases, self.regimes, times, chi, hs, rates, evaluations)


def search_arguments(regimes: dict[int, Regime], to_contact: Array, drive: Drive, stops: Stops | None) -> tuple:
    """The arrays over regimes that ``switching.follow`` takes, from omegas to g2."""
    free, contact = regimes[0], regimes.get(1, regimes[0])
    lower = regimes.get(-1, regimes[0])
    return (
        np.stack([free.omega, contact.omega]),
        np.stack([lower.level, free.level, contact.level]),
        np.stack([lower.particular, free.particular, contact.particular]),
        np.stack([free.row, contact.row]),
        free.offset,
        np.ascontiguousarray(to_contact),
        np.array(drive.frequencies),
        stops.g1 if stops else -math.inf,
        stops.g2 if stops else math.inf,
    )


def _regimes(
    system: System, drive: Drive, perturbation: Perturbation | None, known: dict[float, Modes]
) -> tuple[dict[int, Modes], dict[int, Regime]]:
    basis, _ = drive.split(system.loads, system.size)
    offsets, _ = drive.offsets(system)
    row, offset = system.channels[0][0], offsets[:, 0]
    bases, regimes = {}, {}
    for regime in (0, 1, -1) if system.contacts else (0,):
        total = basis.copy()
        springs: tuple = ()
        if regime:
            stops = system.contacts[0].stops
            gap = stops.g2 if regime > 0 else stops.g1
            if not math.isfinite(gap):
                gap = 0.0  # a side without a stop: never entered
            springs = ((row, stops.stiffness),)
            # sigma = kappa (gap - row q - offset): the first term is a load, the second in the matrix.
            total[0] += stops.stiffness * gap * row
            total -= stops.stiffness * np.outer(offset, row)
        stiffness = springs[0][1] if springs else 0.0
        base = bases[1] if regime == -1 else known.get(stiffness) or modes(system, springs)
        assert base is not None
        known.setdefault(stiffness, base)
        if perturbation is not None and regime != -1:
            base = _perturbed_basis(base, perturbation, regime)
        bases[regime] = base
        force = base.force(total)  # (d, n)
        gain = base.omega**2 - (drive.rates**2)[:, None]
        gain[0] = 1.0
        refuse_resonance(gain, force, base.omega, drive.rates)
        particular = (force / gain).T
        particular[:, 0] = 0.0  # the constant stays with h, regular at omega = 0
        regimes[regime] = Regime(
            np.ascontiguousarray(base.omega), force[0].copy(), np.ascontiguousarray(particular), base.force(row), offset
        )
    return bases, regimes


def refuse_resonance(gain: Array, force: Array, omega: Array, rates: Array) -> None:
    """Raise where a drive forces a mode at its own frequency; where it leaves that mode alone, say so.

    gain = omega^2 - Omega^2 and force: one row per drive coefficient of the angular frequencies
    ``rates``, the constant first.
    Changes both in place, so that force/gain is 0 for a resonant mode that is not forced.
    """
    resonant = np.abs(gain) < RESONANCE * omega**2
    resonant[0] = False
    forced = np.abs(force) > 1e-14 * np.max(np.abs(force), initial=1e-300)
    if np.any(resonant & forced):
        row, mode = np.argwhere(resonant & forced)[0]
        raise InputError(
            "frequency of a load or of the base",
            float(rates[row]),
            f"differ from the natural frequency of mode {mode + 1}, {omega[mode]:.9g}, by {RESONANCE:g} relative",
            "move it, or use method='cvode-adams'",
        )
    gain[resonant], force[resonant] = 1.0, 0.0


def _perturbed_basis(base: Modes, perturbation: Perturbation, regime: int) -> Modes:
    rng = np.random.default_rng([perturbation.seed, regime])
    change = perturbation.frequency * base.omega[-1] * rng.uniform(-1.0, 1.0, base.omega.size)
    return Modes(np.abs(base.omega + change), base.shapes, base.damping, base.mass)


def _perturbed(
    eta: Array, rate: Array, fastest: float, law: Regime, drive: Drive, perturbation: Perturbation
) -> tuple[Array, Array]:
    """Initial modal data changed in proportion to the motion: amplitudes of the start and of the drive."""
    rng = np.random.default_rng([perturbation.seed, 99])
    start = np.hypot(law.omega * eta, rate)
    driven = np.sum(np.abs(law.particular) * np.maximum(drive.rates, 1.0), axis=1)
    size = perturbation.state * max(float(np.max(start)), float(np.max(driven)))
    noise = rng.uniform(-1.0, 1.0, (2, eta.size))
    scale = np.maximum(law.omega, fastest * 1e-8)
    return eta + size * noise[0] / scale, rate + size * noise[1]
