"""Following a damped solution or one with several contacts from switch to switch, in float64."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..drive import Drive
from ..modal import modes
from ..system import System
from ..validation import InputError
from .exponential import Complex, ExponentialSolution, Regime, phasors, spin_of
from .switching import search
from .undamped_tracer import Perturbation, refuse_resonance

CONDITION_LIMIT = 1e8  # of the eigenvectors: beyond it eight digits are lost


class ExponentialTracer:
    """Follows solutions of one system; its regimes are made as they are met and kept.

    ``compile_seconds``: spent compiling.
    """

    def __init__(self, system: System, perturbation: Perturbation | None = None) -> None:
        self.system, self.drive, self.perturbation = system, Drive.of(system), perturbation
        self.regimes: dict[tuple[int, ...], Regime] = {}
        compiling = time.perf_counter()
        one, none = np.zeros(1), np.zeros((0, 1))
        search(one, one, none, none, np.zeros(0, np.int64), np.zeros(0), np.zeros(0), -1, 0.0, 0.0)
        self.compile_seconds = time.perf_counter() - compiling

    def solve(self, t_end: float) -> ExponentialSolution:
        """The solution on [0, t_end] from the initial data."""
        q, v = _start(self.system, self.perturbation)
        u = self.system.positions(0.0, q)
        sides = tuple(int(c.stops.state(x)) for c, x in zip(self.system.contacts, u, strict=False))
        return self.trace(0.0, sides, q, v, -1, t_end)

    def trace(
        self, t: float, sides: tuple[int, ...], q: Array, v: Array, resting: int, t_end: float
    ) -> ExponentialSolution:
        """The solution from (q, q') at time t with the contacts on the given sides; resting: the contact
        whose gap is exactly zero there, or -1."""
        system, drive = self.system, self.drive
        drive_rates = np.array([0.0, *drive.frequencies])
        chi, evaluations = list(sides), 0
        times, keys, coefficients = [], [], []
        while True:
            key = tuple(chi)
            if key not in self.regimes:
                self.regimes[key] = regime_of(system, drive, key, self.perturbation)
            regime = self.regimes[key]
            response = regime.response * spin_of(drive, np.array([t]))[0]
            c = regime.from_q @ (q - response.real.sum(1))
            c += regime.from_v @ (v - (1j * drive_rates * response).real.sum(1))
            times.append(t)
            keys.append(key)
            coefficients.append(c)
            tau, contact, side, used = next_switch(system, drive, regime, c, np.array(key, np.int64), resting, t, t_end)
            evaluations += used
            if contact < 0 or t + tau >= t_end:
                break
            moving = c * np.exp(regime.eigenvalues * tau)
            ahead = response * np.exp(1j * drive_rates * tau)
            q = (regime.W @ moving).real + ahead.real.sum(1)
            v = (regime.W @ (regime.eigenvalues * moving)).real + (1j * drive_rates * ahead).real.sum(1)
            chi[contact] = side if chi[contact] == 0 else 0
            t, resting = t + tau, contact
        sides_array = np.array(keys, np.int64).reshape(len(times), len(chi))
        return ExponentialSolution(drive, self.regimes, np.array(times), sides_array, coefficients, evaluations)


def next_switch(
    system: System,
    drive: Drive,
    regime: Regime,
    c: Complex,
    chi: NDArray[np.int64],
    resting: int,
    t: float,
    t_end: float,
) -> tuple[float, int, int, int]:  # fmt: skip
    """(tau, contact, side, evaluations) of the first switch after t, contact -1 where there is none;
    c: the coefficients at t."""
    m = len(system.contacts)
    rows = np.array([contact.row for contact in system.contacts]).reshape(m, system.size)
    offsets = phasors(drive.offsets(system)[0])[:, :m]  # (1 + F, m)
    g1, g2 = (np.array([getattr(contact.stops, side) for contact in system.contacts]) for side in ("g1", "g2"))
    spin = spin_of(drive, np.array([t]))[0]
    rates: Complex = np.concatenate([regime.eigenvalues, 1j * np.array([0.0, *drive.frequencies])])
    a: Complex = np.concatenate([(rows @ regime.W) * c, (rows @ regime.response + offsets.T) * spin], axis=1)
    parts = (np.ascontiguousarray(x) for x in (np.minimum(rates.real, 0.0), rates.imag, a.real, a.imag))
    return search(*parts, chi, g1, g2, resting, t, t_end)


def _start(system: System, perturbation: Perturbation | None) -> tuple[Array, Array]:
    q, v = system.q0.copy(), system.v0.copy()
    if perturbation is not None:
        rng = np.random.default_rng([perturbation.seed, 99])
        load = np.linalg.solve(system.mass, system.load(0.0))
        size = perturbation.state * max(np.max(np.abs(q)), np.max(np.abs(v)), np.max(np.abs(load)), 1e-300)
        q, v = q + size * rng.uniform(-1, 1, len(q)) / len(q) ** 2, v + size * rng.uniform(-1, 1, len(v))
    return q, v


def regime_of(system: System, drive: Drive, chi: tuple[int, ...], perturbation: Perturbation | None = None) -> Regime:
    """The regime with every contact on the given side, 0 free. Raises InputError where its eigenvectors
    do not span the motion: a rigid-body motion, critical damping, a resonant drive."""
    closed = [(i, c, side) for i, (c, side) in enumerate(zip(system.contacts, chi, strict=True)) if side]
    springs = tuple((c.row, c.stops.stiffness) for _, c, _ in closed)
    basis = modes(replace(system, damping=np.zeros_like(system.damping)), springs)
    assert basis is not None
    omega, shapes = basis.omega, basis.shapes
    if omega[0] <= 1e-12 * omega[-1]:
        raise InputError(
            "stiffness",
            f"a rigid-body motion with contacts {chi}",
            "hold the system in every regime",
            "use method='cvode'",
        )
    if perturbation is not None:
        rng = np.random.default_rng([perturbation.seed, *(side + 1 for side in chi)])
        omega = omega + perturbation.frequency * omega[-1] * rng.uniform(-1.0, 1.0, omega.size)
    force = drive.split(system.loads, system.size)[0]
    offsets = drive.offsets(system)[0]
    for i, contact, side in closed:
        # sigma = kappa (gap - row q - offset): the first term is a load, the second in the matrix.
        force = force - contact.stops.stiffness * np.outer(offsets[:, i], contact.row)
        force[0] += contact.stops.stiffness * (contact.stops.g2 if side > 0 else contact.stops.g1) * contact.row
    modal_force = phasors(force) @ shapes  # (1 + F, n)
    damping = shapes.T @ system.damping @ shapes
    response = np.empty((system.size, len(modal_force)), complex)
    gains = np.tile(omega**2, (len(modal_force), 1)) - np.array([0.0, *drive.frequencies])[:, None] ** 2
    if not system.damped:
        refuse_resonance(gains, modal_force, omega, np.array([0.0, *drive.frequencies]))
    for k, frequency in enumerate([0.0, *drive.frequencies]):
        matrix = np.diag(gains[k]) + 1j * frequency * damping
        # Row by row to size one, so that the stiff modes do not drown the soft ones.
        response[:, k] = shapes @ np.linalg.solve(matrix / omega[:, None] ** 2, modal_force[k] / omega**2)
    to_modal = shapes.T @ system.mass
    if not system.damped:
        return Regime(
            1j * omega, shapes.astype(complex), to_modal.astype(complex), -1j / omega[:, None] * to_modal, response
        )
    # (omega eta, eta')' = [[0, Omega], [-Omega, -damping]] (omega eta, eta'), normal without damping.
    n = system.size
    A = np.block([[np.zeros((n, n)), np.diag(omega)], [-np.diag(omega), -damping]])
    eigenvalues: Complex
    vectors: Complex
    eigenvalues, vectors = (x.astype(complex) for x in np.linalg.eig(A))
    condition = float(np.linalg.cond(vectors))
    if condition > CONDITION_LIMIT:
        raise InputError(
            "damping", f"eigenvectors of condition {condition:.1g}", f"keep it below {CONDITION_LIMIT:g}",
            "a mode is critically damped to rounding: change the damping a little or use method='cvode'",
        )  # fmt: skip
    inverse = np.linalg.inv(vectors)
    keep = eigenvalues.imag >= 0.0
    weight = np.where(eigenvalues.imag > 0.0, 2.0, 1.0)[keep]
    eigenvalues = np.minimum(eigenvalues.real, 0.0)[keep] + 1j * eigenvalues.imag[keep]
    W = shapes @ (vectors[:n, keep] / omega[:, None]) * weight
    from_q = inverse[keep, :n] @ (omega[:, None] * to_modal)
    return Regime(eigenvalues, W, from_q, inverse[keep, n:] @ to_modal, response)
