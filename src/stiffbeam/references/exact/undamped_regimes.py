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
from ...piecewise.rounding import Correction, Perturbation, correction, rounded_sum
from .following import Regimes

CLOSE = 0.125  # |Omega - omega|/(Omega + omega) below which the particular solution is not used

SIDES = (0, 1, -1)  # free, upper, lower: the order of ``Regimes``, each its own index there
Pair = tuple[Modes, Modes]  # of the free system and on a stop; so a side is its index too
_KNOWN: WeakKeyDictionary[System, dict[float, Modes]] = WeakKeyDictionary()


class Parts:
    """What the solution and its perturbed copies are made of.

    bases: the modes of the free system and of that on a stop. totals: what acts on the system without contact, on the
    upper stop and on the lower, (3, d, n) by the drive coefficients; forces: the same in its modes. cross: free
    shapes^T M contact shapes.
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
        self.springs: list[tuple[tuple[Array, float], ...]] = [()]
        self.totals = np.stack([basis, basis, basis])
        for side in (1, -1) if system.contacts else ():
            kappa, constant = system.contacts[0].stops.spring(side)
            self.springs[1:] = [((self.row, kappa),)]
            # sigma = kappa (gap - row q - offset): the first term is a load, the second in the matrix.
            self.totals[side] -= kappa * np.outer(self.offset, self.row)
            self.totals[side, 0] += constant * self.row
        for spring in self.springs:
            stiffness = spring[0][1] if spring else 0.0
            if stiffness not in known:
                known[stiffness] = undamped_modes(system, spring)
        found = [known[spring[0][1] if spring else 0.0] for spring in self.springs]
        self.bases = found[0], found[-1]
        self.forces = self._forces(self.bases)
        self.close = close_pairs([base.omega for base in self.bases], np.array(self.drive.frequencies), span)
        self.cross = self._cross(self.bases)

    def _forces(self, bases: Pair) -> Array:
        return np.stack([bases[side].force(self.totals[side]) for side in SIDES])

    def _cross(self, bases: Pair) -> Array:
        return bases[0].shapes.T @ (self.system.mass @ bases[1].shapes)

    @cached_property
    def rounding(self) -> tuple[list[Correction], Array, Array]:
        """How wrong the modes are, and what rounding takes from the forces and from ``cross``, in units of eps."""
        bases, system = self.bases, self.system
        wrong = [correction(system, spring, base) for spring, base in zip(self.springs, bases, strict=False)]
        forces = np.stack([rounded_sum(self.totals[side], bases[side].shapes) for side in SIDES])
        turned = rounded_sum(system.mass, bases[1].shapes)
        return wrong, forces, rounded_sum(bases[0].shapes.T, turned)

    def perturbed(self, perturbation: Perturbation, noise: np.random.Generator) -> tuple[Pair, Array, Array]:
        """bases, forces and cross of a perturbed copy."""
        wrong, of_forces, of_cross = self.rounding
        found = [each.perturbed(perturbation.frequency, noise) for each in wrong]
        bases, size = (found[0], found[-1]), perturbation.state
        forces = self._forces(bases) + size * of_forces * noise.uniform(-1.0, 1.0, of_forces.shape)
        cross = self._cross(bases)
        return bases, forces, cross + size * of_cross * noise.uniform(-1.0, 1.0, cross.shape)

    def regimes(self, bases: Pair, forces: Array, cross: Array) -> Regimes:
        """The regimes of these modes and modal forces."""
        mode, sine = self.close[:, 0], 1 + 2 * self.close[:, 1]
        omegas = np.stack([base.omega for base in bases])
        gain = omegas[:, None] ** 2 - (self.drive.rates**2)[:, None]
        gain[:, sine, mode] = gain[:, sine + 1, mode] = np.inf
        gain[:, 0] = np.inf  # the constant stays with h, regular at omega = 0
        return assembled(
            omegas=omegas,
            rows=np.stack([base.force(self.row) for base in bases]),
            levels=np.ascontiguousarray(forces[:, 0]),
            particulars=np.ascontiguousarray((forces / gain[[0, 1, 1]]).transpose(0, 2, 1)),
            close=self.close,
            close_forces=np.stack([forces[:, sine, mode], forces[:, sine + 1, mode]], axis=2),
            cross=cross,
            offset=self.offset,
            drive=self.drive,
            stops=self.system.contacts[0].stops if self.system.contacts else None,
        )


def close_pairs(omegas: Sequence[Array], frequencies: Array, span: float) -> NDArray[np.int64]:
    """(p, 2): the modes and drive frequencies that in one regime at least lie close to each other, or are
    both slow against ``span``."""
    close = np.zeros((len(omegas[0]), len(frequencies)), bool)
    for omega in omegas:
        total = omega[:, None] + frequencies
        close |= (np.abs(omega[:, None] - frequencies) < CLOSE * total) | (total * span < 0.9)
    return np.argwhere(close)


def assembled(
    omegas: Array, rows: Array, levels: Array, particulars: Array, close: NDArray[np.int64], close_forces: Array,
    cross: Array, offset: Array, drive: Drive, stops: Stops | None,
) -> Regimes:  # fmt: skip
    """Regimes with what follows from these; cross: (n, n), free shapes^T M contact shapes. offset: (d,)."""
    frequencies = np.array(drive.frequencies)
    speeds = np.concatenate([omegas, np.broadcast_to(frequencies, (2, len(frequencies)))], axis=1)
    order = np.argsort(speeds, axis=1, kind="stable")
    return Regimes(
        omegas, rows, levels, particulars,
        waves=np.stack([offset + rows[abs(side)] @ particulars[side] for side in SIDES]),
        constant=float(offset[0]),
        cross=np.stack([cross.T, cross]),
        frequencies=frequencies,
        close=close,
        close_forces=close_forces,
        order=order,
        speeds=np.take_along_axis(speeds, order, axis=1),
        g1=stops.g1 if stops else -math.inf,
        g2=stops.g2 if stops else math.inf,
    )  # fmt: skip
