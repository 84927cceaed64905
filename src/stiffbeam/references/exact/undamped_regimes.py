"""The three regimes of an undamped system with at most one contact, and what rounding takes from them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...model.contact import Stops
from ...model.drive import Drive
from ...model.modes import Modes, undamped_modes
from ...model.system import System
from .following import Regimes
from .rounding import Correction, Perturbation, correction, rounded_sum
from .undamped import Regime

CLOSE = 0.125  # |Omega - omega|/(Omega + omega) below which the particular solution is not used

_KNOWN: WeakKeyDictionary[System, dict[float, Modes]] = WeakKeyDictionary()


class Parts:
    """What the solution and its perturbed copies are made of.

    bases: the modes of every regime, the stops sharing theirs. totals: what acts on the system in each of them, (d, n)
    by the drive coefficients; forces: the same in its modes. cross: free shapes^T M contact shapes.
    known: modes by the stiffness of the stop, 0 for the free system; used and added to, by default those that the
    system has been found to have. span: the longest time that is asked for; over a short one the slow modes answer
    the drive from rest.
    """

    def __init__(self, system: System, known: dict[float, Modes] | None = None, span: float = math.inf) -> None:
        known = _KNOWN.setdefault(system, {}) if known is None else known
        self.system, self.drive = system, Drive.of(system)
        basis, _ = self.drive.split(system.loads, system.size)
        offsets, _ = self.drive.offsets(system)
        self.row, self.offset = system.channels[0][0], offsets[:, 0]
        self.springs: dict[int, tuple[tuple[Array, float], ...]] = {0: ()}
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


def stacked(regimes: dict[int, Regime], cross: Array, drive: Drive, stops: Stops | None) -> Regimes:
    """The regimes as ``follow`` takes them; cross: (n, n), free shapes^T M contact shapes."""
    free, contact = regimes[0], regimes.get(1, regimes[0])
    three = [regimes.get(-1, free), free, contact]
    frequencies = np.array(drive.frequencies)
    speeds = np.stack([np.append(regime.omega, frequencies) for regime in (free, contact)])
    order = np.argsort(speeds, axis=1, kind="stable")
    speeds = np.take_along_axis(speeds, order, axis=1)
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
        speeds=speeds,
        g1=stops.g1 if stops else -math.inf,
        g2=stops.g2 if stops else math.inf,
    )
