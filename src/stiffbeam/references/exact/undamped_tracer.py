"""Following the exact solution without damping from switch to switch: three regimes, all of it compiled."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...basics.budget import Forecast
from ...basics.validation import InputError
from ...model.contact import Stops
from ...model.drive import Drive
from ...model.modes import Modes, undamped_modes
from ...model.system import System
from ...trajectory.trajectory import SolverFailure
from .following import Regimes, follow
from .rounding import Correction, Perturbation, correction, rounded_sum
from .touching import REMEDY
from .undamped import Regime, Solution

RESONANCE = 1e-8  # |Omega^2 - omega^2|/omega^2 below which a drive is resonant, where that is refused
CLOSE = 0.125  # |Omega - omega|/(Omega + omega) below which the particular solution is not used
EVENTS_PER_CALL, FIRST_EVENTS = 4096, 16
QUIET = np.zeros((0, 3, 0))  # no noise


class Tracer:
    """Follows solutions of one system; its modes are made once. ``compile_seconds``: spent compiling.

    known: modes by the stiffness of the stop, 0 for the free system; used and added to, by default those that the
    system has been found to have. span: the longest
    time that is asked for; over a short one the slow modes answer the drive from rest. ``perturbed`` makes others.
    """

    def __init__(self, system: System, known: dict[float, Modes] | None = None, span: float = math.inf) -> None:
        self._set(_Parts(system, _KNOWN.setdefault(system, {}) if known is None else known, span), None)
        compiling = time.perf_counter()
        none, index = np.zeros((1, system.size)), np.zeros(1, np.int64)
        follow(self.stacked, 0, none[0], none[0], 0.0, 0.0, True, QUIET, 0.0, np.zeros(1), index, none, none)
        self.compile_seconds = time.perf_counter() - compiling

    def perturbed(self, perturbation: Perturbation) -> Tracer:
        """One that follows a perturbed copy of the solution, made of the same parts."""
        copy = object.__new__(Tracer)
        copy._set(self.parts, perturbation)
        copy.compile_seconds = 0.0
        return copy

    def _set(self, parts: _Parts, perturbation: Perturbation | None) -> None:
        self.parts, self.system, self.drive, self.perturbation = parts, parts.system, parts.drive, perturbation
        self.noise = np.random.default_rng(None if perturbation is None else [perturbation.seed, 98])
        self.bases, forces, cross = parts.bases, parts.forces, parts.cross
        if perturbation is not None:
            self.bases, forces, cross = parts.perturbed(perturbation, self.noise)
        self.stops = self.system.contacts[0].stops if self.system.contacts else None
        self.regimes = parts.regimes(self.bases, forces)
        self.stacked = stacked(self.regimes, cross, self.drive, self.stops)
        self.fastest = max(*(float(b.omega[-1]) for b in self.bases.values()), *self.drive.frequencies, 0.0)

    def solve(self, t_end: float, start: tuple[Array, Array] | None = None) -> Solution:
        """The solution on [0, t_end] from q, q' at the ``start``, None for the initial data of the system."""
        basis, (q0, v0) = self.bases[0], (self.system.q0, self.system.v0) if start is None else start
        eta, rate = basis.to_modal(q0), basis.to_modal(v0)
        if self.perturbation is not None:
            fastest = max(float(b.omega[-1]) for b in self.bases.values()) or 1.0
            turned = basis.mass @ basis.shapes
            terms = rounded_sum(q0, turned), rounded_sum(v0, turned)
            drive, size = self.drive, self.perturbation.state
            eta, rate = _perturbed(eta, rate, terms, fastest, self.regimes[0], drive, size, self.noise)
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
        evaluations, forecast, kept = 0, Forecast(t_end), 0
        noise, size = QUIET, 0.0 if self.perturbation is None else self.perturbation.state
        count = room = FIRST_EVENTS
        while count == room:
            room = min(4 * count, EVENTS_PER_CALL)
            times, chi, (hs, rates) = np.empty(room), np.empty(room, np.int64), np.empty((2, room, len(h)))
            if size:
                noise = self.noise.uniform(-1.0, 1.0, (room, 3, len(h)))
            count, used = follow(self.stacked, regime, h, rate, t, t_end, at_switch, noise, size, times, chi, hs, rates)
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
        return Solution(self.drive, self.bases, self.regimes, self.stacked, times, chi, hs, rates, evaluations)


def refuse_accumulation(start: float, end: float, fastest: float) -> None:
    """Raise SolverFailure where EVENTS_PER_CALL switches follow each other within a period of the fastest
    motion: forces are continuous, so none does that, and what does is rounding."""
    if (end - start) * fastest < 2.0 * math.pi:
        raise SolverFailure("exact", end, f"{EVENTS_PER_CALL} switches within the shortest period", REMEDY)


def stacked(regimes: dict[int, Regime], cross: Array, drive: Drive, stops: Stops | None) -> Regimes:
    """The regimes as ``follow`` takes them; cross: (n, n), free shapes^T M contact shapes."""
    free, contact = regimes[0], regimes.get(1, regimes[0])
    three = [regimes.get(-1, free), free, contact]
    frequencies = np.array(drive.frequencies)
    speeds = np.stack([np.append(regime.omega, frequencies) for regime in (free, contact)])
    order = np.argsort(speeds, axis=1, kind="stable")
    return Regimes(
        omegas=np.stack([free.omega, contact.omega]),
        rows=np.stack([free.row, contact.row]),
        levels=np.stack([regime.level for regime in three]),
        particulars=np.stack([regime.particular for regime in three]),
        waves=np.stack([regime.offset + regime.row @ regime.particular for regime in three]),
        constant=float(free.offset[0]),
        cross=np.stack([cross.T, cross]),
        frequencies=frequencies,
        close=free.close,
        close_forces=np.stack([regime.close_force for regime in three]),
        order=order,
        speeds=np.take_along_axis(speeds, order, axis=1),
        g1=stops.g1 if stops else -math.inf,
        g2=stops.g2 if stops else math.inf,
    )


_KNOWN: WeakKeyDictionary[System, dict[float, Modes]] = WeakKeyDictionary()


class _Parts:
    """What the solution and its perturbed copies are made of.

    bases: the modes of every regime, the stops sharing theirs. totals: what acts on the system in each of them, (d, n)
    by the drive coefficients; forces: the same in its modes. cross: free shapes^T M contact shapes.
    """

    def __init__(self, system: System, known: dict[float, Modes], span: float) -> None:
        self.system, self.drive = system, Drive.of(system)
        basis, _ = self.drive.split(system.loads, system.size)
        offsets, _ = self.drive.offsets(system)
        self.row, self.offset = system.channels[0][0], offsets[:, 0]
        self.springs: dict[int, tuple] = {0: ()}
        self.bases: dict[int, Modes] = {}
        self.totals = {0: basis}
        for regime in (0, 1, -1) if system.contacts else (0,):
            if regime:
                kappa, constant = system.contacts[0].stops.spring(regime)
                self.springs[regime] = ((self.row, kappa),)
                # sigma = kappa (gap - row q - offset): the first term is a load, the second in the matrix.
                self.totals[regime] = basis - kappa * np.outer(self.offset, self.row)
                self.totals[regime][0] += constant * self.row
            stiffness = self.springs[regime][0][1] if regime else 0.0
            if stiffness not in known:
                known[stiffness] = undamped_modes(system, self.springs[regime])
            self.bases[regime] = known[stiffness]
        self.forces = {regime: base.force(self.totals[regime]) for regime, base in self.bases.items()}
        self.close = close_pairs([base.omega for base in self.bases.values()], np.array(self.drive.frequencies), span)
        self.cross = self._cross(self.bases)

    def _cross(self, bases: dict[int, Modes]) -> Array:
        return bases[0].shapes.T @ (self.system.mass @ bases.get(1, bases[0]).shapes)

    @cached_property
    def rounding(self) -> tuple[dict[int, Correction], dict[int, Array], Array]:
        """How wrong the modes are, and what rounding takes from the forces and from ``cross``, in units of eps."""
        bases, system = self.bases, self.system
        wrong = {side: correction(system, self.springs[side], bases[side]) for side in bases if side >= 0}
        forces = {side: rounded_sum(self.totals[side], base.shapes) for side, base in bases.items()}
        turned = rounded_sum(system.mass, bases.get(1, bases[0]).shapes)
        return wrong, forces, rounded_sum(bases[0].shapes.T, turned)

    def perturbed(
        self, perturbation: Perturbation, noise: np.random.Generator
    ) -> tuple[dict[int, Modes], dict[int, Array], Array]:
        """bases, forces and cross of a perturbed copy."""
        wrong, of_forces, of_cross = self.rounding
        bases = {side: each.perturbed(perturbation.frequency, noise) for side, each in wrong.items()}
        if -1 in self.bases:
            bases[-1] = bases[1]
        forces, size = {}, perturbation.state
        for side, base in bases.items():
            lost = of_forces[side]
            forces[side] = base.force(self.totals[side]) + size * lost * noise.uniform(-1.0, 1.0, lost.shape)
        cross = self._cross(bases)
        return bases, forces, cross + size * of_cross * noise.uniform(-1.0, 1.0, cross.shape)

    def regimes(self, bases: dict[int, Modes], forces: dict[int, Array]) -> dict[int, Regime]:
        """The regimes of these modes and modal forces."""
        found, close, rates = {}, self.close, self.drive.rates
        columns = 1 + 2 * close[:, 1]
        for regime, base in bases.items():
            force = forces[regime]
            close_force = np.stack([force[columns, close[:, 0]], force[columns + 1, close[:, 0]]], axis=1)
            gain = base.omega**2 - (rates**2)[:, None]
            gain[columns, close[:, 0]] = gain[columns + 1, close[:, 0]] = np.inf
            gain[0] = np.inf  # the constant stays with h, regular at omega = 0
            particular = np.ascontiguousarray((force / gain).T)
            found[regime] = Regime(
                base.omega, force[0], particular, base.force(self.row), self.offset, close, close_force
            )
        return found


def close_pairs(omegas: Sequence[Array], frequencies: Array, span: float) -> NDArray[np.int64]:
    """(p, 2): the modes and drive frequencies that in one regime at least lie close to each other, or are
    both slow against ``span``."""
    close = np.zeros((len(omegas[0]), len(frequencies)), bool)
    for omega in omegas:
        total = omega[:, None] + frequencies
        close |= (np.abs(omega[:, None] - frequencies) < CLOSE * total) | (total * span < 0.9)
    return np.argwhere(close)


def refuse_resonance(gain: Array, force: Array, omega: Array, rates: Array, chi: tuple[int, ...]) -> None:
    """Raise where a drive forces a mode at its own frequency, with the contacts on the sides ``chi``; where it
    leaves that mode alone, say so.

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
            f"differ from the natural frequency of mode {mode + 1} with contacts {chi}, {omega[mode]:.9g}, by "
            f"{RESONANCE:g} relative for the exact solution of several contacts without damping",
            "move it, add a little damping, or use method='cvode-adams'",
        )
    gain[resonant], force[resonant] = 1.0, 0.0


def _perturbed(
    eta: Array,
    rate: Array,
    terms: tuple[Array, Array],
    fastest: float,
    law: Regime,
    drive: Drive,
    size: float,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Initial modal data changed in proportion to the motion, amplitudes of the start and of the drive, and to
    the ``terms`` that they are sums of."""
    start = np.hypot(law.omega * eta, rate)
    slowest = law.omega[law.omega > 0.0][:1]  # what a constant load moves, it moves at natural frequencies
    rates = np.where(drive.rates > 0.0, drive.rates, slowest[0] if len(slowest) else 0.0)
    driven = np.sum(np.abs(law.particular) * rates, axis=1)
    least = max(float(np.max(start)), float(np.max(driven)))
    noise = rng.uniform(-1.0, 1.0, (2, eta.size))
    scale = np.maximum(law.omega, fastest * 1e-8)
    return eta + size * (least / scale + terms[0]) * noise[0], rate + size * (least + terms[1]) * noise[1]
