"""Following the exact solution without damping from switch to switch: three regimes, all of it compiled."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...basics.budget import Forecast
from ...model.contact import Stops
from ...model.drive import Drive
from ...model.modes import Modes, modes
from ...model.system import System
from ...trajectory.trajectory import SolverFailure
from .switching import follow
from .touching import REMEDY
from .undamped import Regime, Solution

CLOSE = 0.125  # |Omega - omega|/(Omega + omega) below which the particular solution is not used
EVENTS_PER_CALL = 4096
WIDE = 100  # modes up to which extended precision, which no library is fast in, is used for perturbed copies
TO_CONTACT = 5  # its place among the ``search_arguments``


class Perturbation(NamedTuple):
    """A change of the size of float64's rounding, for a perturbed copy of the solution.

    frequency: of the modes, see ``perturbed_modes``; state: of every initial modal amplitude
    relative to the largest in energy, of every modal force, of the change between modes and at every switch
    of every amplitude relative to the terms it is made of, and of the time of the switch; seed: of the random
    signs and sizes.
    """

    frequency: float
    state: float
    seed: int


class Tracer:
    """Follows solutions of one system; its modes are made once. ``compile_seconds``: spent compiling.

    known: modes by the stiffness of the stop, 0 for the free system; used and added to. span: the longest
    time that is asked for; over a short one the slow modes answer the drive from rest.
    """

    def __init__(
        self,
        system: System,
        perturbation: Perturbation | None = None,
        known: dict[float, Modes] | None = None,
        span: float = math.inf,
    ) -> None:
        self.system, self.drive, self.perturbation = system, Drive.of(system), perturbation
        self.noise = np.random.default_rng(None if perturbation is None else [perturbation.seed, 98])
        self.bases, self.regimes = _regimes(system, self.drive, perturbation, {} if known is None else known, span)
        self.stops = system.contacts[0].stops if system.contacts else None
        free, contact = self.bases[0], self.bases.get(1, self.bases[0])
        to_contact = free.shapes.T @ system.mass @ contact.shapes  # eta_contact = eta_free @ this
        if perturbation is not None:
            terms = rounded_sum(free.shapes.T, rounded_sum(system.mass, contact.shapes))
            to_contact += perturbation.state * terms * self.noise.uniform(-1.0, 1.0, terms.shape)
        self.search = search_arguments(self.regimes, to_contact, self.drive, self.stops)
        self.fastest = max(*(float(b.omega[-1]) for b in self.bases.values()), *self.drive.frequencies, 0.0)
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
            turned = basis.mass @ basis.shapes
            terms = rounded_sum(self.system.q0, turned), rounded_sum(self.system.v0, turned)
            eta, rate = _perturbed(eta, rate, terms, fastest, self.regimes[0], self.drive, self.perturbation)
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
        count = per_call = EVENTS_PER_CALL if self.perturbation is None else 1
        while count == per_call:
            times, chi = np.empty(per_call), np.empty(per_call, np.int64)
            hs, rates = np.empty((per_call, len(h))), np.empty((per_call, len(h)))
            count, used = follow(
                h.copy(), rate.copy(), regime, t, t_end, at_switch, *self.search, times, chi, hs, rates
            )
            evaluations += used
            if count and self.perturbation is not None:
                self._perturb(self.regimes[regime], h, rate, t, float(times[0]), int(chi[0]), hs[0], rates[0])
            found.append((times[:count], chi[:count], hs[:count], rates[:count]))
            kept += count
            if count:
                if count == EVENTS_PER_CALL:
                    refuse_accumulation(float(times[0]), float(times[-1]), self.fastest)
                forecast.check(float(times[count - 1]), 2.0 * kept * (len(h) + 1))
                t, regime, at_switch = float(times[count - 1]), int(chi[count - 1]), True
                h, rate = hs[count - 1].copy(), rates[count - 1].copy()
        times, chi, hs, rates = (np.concatenate(x) for x in zip(*found, strict=True))
        return Solution(self.drive, self.bases, self.regimes, times, chi, hs, rates, evaluations)

    def _perturb(
        self, old: Regime, h: Array, rate: Array, start: float, t: float, regime: int, new_h: Array, new_rate: Array
    ) -> None:
        """Change h and h' of a piece that begins at t by what is lost there: the rounding of t, and of the sums
        that carry the amplitudes of the ``old`` regime, h and rate at its ``start``, over to the new one."""
        assert self.perturbation is not None
        size, law = self.perturbation.state, self.regimes[regime]
        shift, *noise = size * self.noise.uniform(-1.0, 1.0, (3, len(h)))
        cross = self.search[TO_CONTACT] if regime == 0 else self.search[TO_CONTACT].T
        driven = np.abs(old.particular) @ np.ones(self.drive.size), np.abs(old.particular) @ self.drive.rates
        reach = np.minimum(1.0 / np.maximum(old.omega, 1e-300), t - start)  # |sin(omega tau)/omega| at most
        place = np.abs(h) + np.abs(rate) * reach + driven[0]
        speed = np.abs(rate) + np.abs(old.level - old.omega**2 * h) * reach
        shift = shift[0] * t
        new_h += shift * new_rate + noise[0] * rounded_sum(cross, place)
        new_rate += shift * (law.level - law.omega**2 * new_h) + noise[1] * rounded_sum(cross, speed + driven[1])


def refuse_accumulation(start: float, end: float, fastest: float) -> None:
    """Raise SolverFailure where EVENTS_PER_CALL switches follow each other within a period of the fastest
    motion: forces are continuous, so none does that, and what does is rounding."""
    if (end - start) * fastest < 2.0 * math.pi:
        raise SolverFailure("exact", end, f"{EVENTS_PER_CALL} switches within the shortest period", REMEDY)


def search_arguments(
    regimes: dict[int, Regime], to_contact: Array, drive: Drive, stops: Stops | None
) -> tuple[Any, ...]:
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
        free.close,
        np.stack([lower.close_force, free.close_force, contact.close_force]),
        stops.g1 if stops else -math.inf,
        stops.g2 if stops else math.inf,
    )


def _regimes(
    system: System, drive: Drive, perturbation: Perturbation | None, known: dict[float, Modes], span: float
) -> tuple[dict[int, Modes], dict[int, Regime]]:
    basis, _ = drive.split(system.loads, system.size)
    offsets, _ = drive.offsets(system)
    row, offset = system.channels[0][0], offsets[:, 0]
    bases, forces = {}, {}
    for regime in (0, 1, -1) if system.contacts else (0,):
        total = basis.copy()
        springs: tuple[Any, ...] = ()
        if regime:
            kappa, constant = system.contacts[0].stops.spring(regime)
            springs = ((row, kappa),)
            # sigma = kappa (gap - row q - offset): the first term is a load, the second in the matrix.
            total[0] += constant * row
            total -= kappa * np.outer(offset, row)
        stiffness = springs[0][1] if springs else 0.0
        base = bases[1] if regime == -1 else known.get(stiffness) or modes(system, springs)
        assert base is not None
        known.setdefault(stiffness, base)
        if perturbation is not None and regime != -1:
            rng = np.random.default_rng([perturbation.seed, regime])
            base = perturbed_modes(system, springs, base, perturbation.frequency, rng)
        bases[regime] = base
        forces[regime] = base.force(total)  # (d, n)
        if perturbation is not None:
            noise = np.random.default_rng([perturbation.seed, 2 + regime]).uniform(-1.0, 1.0, forces[regime].shape)
            forces[regime] += perturbation.state * noise * rounded_sum(total, base.shapes)
    close = close_pairs([base.omega for base in bases.values()], np.array(drive.frequencies), span)
    regimes = {}
    for regime, base in bases.items():
        force = forces[regime]
        close_force = np.column_stack([force[1 + k + close[:, 1] * 2, close[:, 0]] for k in (0, 1)])
        gain = base.omega**2 - (drive.rates**2)[:, None]
        for k in (0, 1):
            gain[1 + k + close[:, 1] * 2, close[:, 0]] = np.inf
        gain[0] = np.inf  # the constant stays with h, regular at omega = 0
        particular = (force / gain).T
        regimes[regime] = Regime(
            np.ascontiguousarray(base.omega), force[0].copy(), np.ascontiguousarray(particular), base.force(row),
            offset, close, close_force,
        )  # fmt: skip
    return bases, regimes


def close_pairs(omegas: Sequence[Array], frequencies: Array, span: float) -> NDArray[np.int64]:
    """(p, 2): the modes and drive frequencies that in one regime at least lie close to each other, or are
    both slow against ``span``."""
    close = np.zeros((len(omegas[0]), len(frequencies)), bool)
    for omega in omegas:
        total = omega[:, None] + frequencies
        close |= (np.abs(omega[:, None] - frequencies) < CLOSE * total) | (total * span < 0.9)
    return np.argwhere(close)


def rounded_sum(a: Array, b: Array) -> Array:
    """sqrt(sum_k (a_ik b_kj)^2): what rounding takes from the product a b, in units of eps."""
    return np.sqrt(np.abs(a) ** 2 @ np.abs(b) ** 2)


def perturbed_modes(
    system: System, springs: Sequence[tuple[Array, float]], base: Modes, size: float, rng: np.random.Generator
) -> Modes:
    """``base`` without what is wrong with it, and off by ``size``, and size/eps times what the correction loses.

    What is wrong shows in S = X^T K X and R = X^T M X in extended precision: with lambda_j = S_jj/R_jj the right
    shapes are X (I + E), E_ij = (S_ij - lambda_j R_ij)/(lambda_j - lambda_i), E_jj = (1 - R_jj)/2, and -R_ij/2
    between equal ones (Ogita and Aishima). A hard stop mixes the slow modes by eps w_max^2/w_1^2.
    """
    wide, n = np.longdouble if base.omega.size <= WIDE else np.float64, base.omega.size
    eps = float(np.finfo(float).eps)
    X = base.shapes.astype(wide)
    factor = system.stiffness_factor
    if factor is not None:
        bent = factor.astype(wide) @ X
        S, terms = bent.T @ bent, np.abs(bent).T @ (np.abs(factor) @ np.abs(X))
    else:
        S, terms = X.T @ (system.stiffness.astype(wide) @ X), np.abs(X).T @ (np.abs(system.stiffness) @ np.abs(X))
    for row, kappa in springs:
        seen = row.astype(wide) @ X
        S, terms = (
            S + wide(kappa) * np.outer(seen, seen),
            terms + kappa * np.outer(np.abs(seen), np.abs(row) @ np.abs(X)),
        )
    R = X.T @ (system.mass.astype(wide) @ X)
    squares = np.diag(S) / np.diag(R)
    lost = (float(np.finfo(wide).eps) / eps * size * (terms + terms.T)).astype(float) * rng.uniform(-1.0, 1.0, (n, n))
    apart = squares[None, :] - squares[:, None]
    near = np.abs(apart) <= 1e-8 * np.maximum(squares[None, :], squares[:, None])
    rigid = base.omega == 0.0  # any two rigid motions are as good as two others
    near |= rigid[:, None] & rigid[None, :]
    E = np.where(near, -R / 2, (S - squares * R + lost) / np.where(near, 1.0, apart))
    np.fill_diagonal(E, (1 - np.diag(R)) / 2)
    rounding = size * rng.uniform(-1.0, 1.0, base.omega.size)
    omega = np.sqrt(np.abs(squares.astype(float) * (1.0 + rounding) + np.diag(lost)))
    return replace(base, omega=omega, shapes=(X + X @ E).astype(float))


def _perturbed(
    eta: Array,
    rate: Array,
    terms: tuple[Array, Array],
    fastest: float,
    law: Regime,
    drive: Drive,
    perturbation: Perturbation,
) -> tuple[Array, Array]:
    """Initial modal data changed in proportion to the motion, amplitudes of the start and of the drive, and to
    the ``terms`` that they are sums of."""
    rng = np.random.default_rng([perturbation.seed, 99])
    start = np.hypot(law.omega * eta, rate)
    slowest = law.omega[law.omega > 0.0][:1]  # what a constant load moves, it moves at natural frequencies
    rates = np.where(drive.rates > 0.0, drive.rates, slowest[0] if len(slowest) else 0.0)
    driven = np.sum(np.abs(law.particular) * rates, axis=1)
    size = perturbation.state * max(float(np.max(start)), float(np.max(driven)))
    noise = rng.uniform(-1.0, 1.0, (2, eta.size))
    scale = np.maximum(law.omega, fastest * 1e-8)
    sizes = size / scale + perturbation.state * terms[0], size + perturbation.state * terms[1]
    return eta + sizes[0] * noise[0], rate + sizes[1] * noise[1]
