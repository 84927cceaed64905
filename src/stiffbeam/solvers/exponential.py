"""The exact solution with damping or several contacts: sums of complex exponentials, regime by regime.

    q(t_0 + tau) = Re [ W (c exp(lambda tau)) ] + Re [ X exp(i Omega (t_0 + tau)) ]

with the eigenvalues lambda of the regime's contact state, one of each conjugate pair, and the response
X to the drive. A contact state is in general not proportionally damped, hence the 2n eigenvalues.
Regimes (which contact is on which stop) are made as they are met, since there are 3^m of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..drive import Drive
from ..modal import modes
from ..system import System
from ..validation import InputError
from .switching import search
from .undamped import Perturbation, refuse_resonance

Complex = Any  # arrays of complex128
CONDITION_LIMIT = 1e8  # of the eigenvectors: beyond it eight digits are lost


@dataclass(frozen=True, eq=False)
class Regime:
    """lambda: (k,). W: (n, k). from_q, from_v: (k, n), c = from_q q + from_v q' of the homogeneous part.
    response: X (n, 1 + F) complex, to the constant and to exp(i Omega t) of every drive frequency."""

    eigenvalues: Complex
    W: Complex
    from_q: Complex
    from_v: Complex
    response: Complex


@dataclass(frozen=True, eq=False)
class ExponentialSolution:
    """The pieces: at times[i] the contacts are on the sides[i] (m,), homogeneous coefficients c[i]."""

    drive: Drive
    regimes: dict[tuple[int, ...], Regime]
    times: Array
    sides: NDArray[np.int64]
    c: list[Complex]
    evaluations: int

    @property
    def shortest_period(self) -> float:
        """Of the oscillating part; what is overdamped has decayed in a fraction of it."""
        fastest = [np.max(np.abs(r.eigenvalues.imag), initial=0.0) for r in self.regimes.values()]
        return 2.0 * np.pi / max(*fastest, *self.drive.frequencies, 1e-300)

    def side(self, contact: int) -> NDArray[np.int64]:
        """chi of the contact in every piece."""
        return self.sides[:, contact]

    def offset(self, system: System, channel: int) -> Callable[[Array], tuple[Array, Array]]:
        """o(t) and o'(t) of a channel."""
        return self.drive.offset(system, channel)

    def states(self, t: Array) -> tuple[Array, Array]:
        """q, q' (k, n) at any times."""
        return self.observed(t, np.eye(len(next(iter(self.regimes.values())).W)))

    def observed(self, t: Array, row: Array) -> tuple[Array, Array]:
        """row @ q and its rate at any times, (k,), or (k, rows) for several rows."""
        piece = np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)
        shape = (len(t), *np.shape(row)[:-1])
        u, v = np.empty(shape), np.empty(shape)
        spin = _spin(self.drive, t)
        rates = 1j * np.array([0.0, *self.drive.frequencies])
        for i in np.unique(piece):
            here = piece == i
            regime = self.regimes[tuple(self.sides[i].tolist())]
            W, X = row @ regime.W, row @ regime.response
            moving = self.c[i] * np.exp(np.multiply.outer(t[here] - self.times[i], regime.eigenvalues))
            u[here] = (moving @ W.T).real + (spin[here] @ X.T).real
            v[here] = ((moving * regime.eigenvalues) @ W.T).real + ((spin[here] * rates) @ X.T).real
        return u, v

    def work(self, system: System, edges: Array) -> tuple[Array, Array]:
        """Work of the loads and viscous loss between consecutive edges, which include every switch.

        Products of exponentials, integrated in closed form: int_0^h exp(z s) ds = h (exp(z h) - 1)/(z h).
        """
        force = _phasors(self.drive.split(system.loads, system.size)[0])  # (1 + F, n)
        offsets = _phasors(self.drive.offsets(system)[0])  # (1 + F, channels)
        drive_rates = 1j * np.array([0.0, *self.drive.frequencies])
        piece = np.maximum(np.searchsorted(self.times, edges[:-1], side="right") - 1, 0)
        given, taken = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
        for j, (a, h) in enumerate(zip(edges[:-1], np.diff(edges), strict=True)):
            regime = self.regimes[tuple(self.sides[piece[j]].tolist())]
            spin = _spin(self.drive, np.array([a]))[0]
            rates = np.concatenate([regime.eigenvalues, drive_rates])
            moving = regime.W * (self.c[piece[j]] * np.exp(regime.eigenvalues * (a - self.times[piece[j]])))
            v = np.concatenate([moving, regime.response * spin], axis=1) * rates  # (n, terms)
            given[j] = _integral(force.T * spin, drive_rates, v, rates, h)
            q = np.concatenate([moving, regime.response * spin], axis=1)
            for i, contact in enumerate(system.contacts):
                side = self.sides[piece[j], i]
                if side and contact.offset is not None:
                    # F = kappa (g - row q - o), a sum of exponentials with the constant among them
                    o = offsets[:, i] * spin
                    depth = contact.row @ q
                    depth[len(regime.eigenvalues) :] += o
                    depth[len(regime.eigenvalues)] -= contact.stops.g2 if side > 0 else contact.stops.g1
                    F = -contact.stops.stiffness * depth
                    given[j] -= _integral(F[None], rates, (o * drive_rates)[None], drive_rates, h)
            if system.damped:
                taken[j] = _integral(v, rates, system.damping @ v, rates, h)
        return given, taken


def _integral(x: Complex, x_rates: Complex, y: Complex, y_rates: Complex, h: float) -> float:
    """int_0^h Re(sum_k x_k exp(x_rates_k s)) . Re(sum_l y_l exp(y_rates_l s)) ds; x (n, k), y (n, l)."""
    total = 0.0
    for other, rates in ((y, y_rates), (y.conj(), y_rates.conj())):
        z = h * np.add.outer(x_rates, rates)
        safe = np.where(z == 0.0, 1.0, z)
        total += float(np.sum((x.T @ other) * np.where(z == 0.0, 1.0, np.expm1(z) / safe)).real)
    return 0.5 * h * total


def _spin(drive: Drive, t: Array) -> Complex:
    """(1, exp(i Omega t), ...), (k, 1 + F)."""
    return np.exp(1j * np.multiply.outer(t, np.array([0.0, *drive.frequencies])))


def _phasors(basis: Array) -> Complex:
    """Rows g(t) @ basis (d, ...) as complex amplitudes of (1, exp(i Omega t), ...): cosine - i sine."""
    return np.concatenate([basis[:1].astype(complex), basis[2::2] - 1j * basis[1::2]])


def exponential(system: System, t_end: float, perturbation: Perturbation | None) -> tuple[ExponentialSolution, float]:
    """The solution on [0, t_end] and the seconds spent compiling."""
    drive = Drive.of(system)
    m = len(system.contacts)
    rows = np.array([c.row for c in system.contacts]).reshape(m, system.size)
    offsets = _phasors(drive.offsets(system)[0])[:, :m]  # (1 + F, m)
    g1, g2 = (np.array([getattr(c.stops, side) for c in system.contacts]) for side in ("g1", "g2"))
    drive_rates = np.array([0.0, *drive.frequencies])
    regimes: dict[tuple[int, ...], Regime] = {}
    q, v = _start(system, perturbation)
    u = rows @ q + (_spin(drive, np.zeros(1)) @ offsets)[0].real if m else np.zeros(0)
    chi = [int(c.stops.state(x)) for c, x in zip(system.contacts, u, strict=True)]
    compiling = time.perf_counter()
    one, none = np.zeros(1), np.zeros((0, 1))
    search(one, one, none, none, np.zeros(0, np.int64), np.zeros(0), np.zeros(0), -1, 0.0, 0.0)
    compile_seconds = time.perf_counter() - compiling

    t, resting, evaluations = 0.0, -1, 0
    times, sides, coefficients = [], [], []
    while True:
        key = tuple(chi)
        if key not in regimes:
            regimes[key] = _regime(system, drive, key, perturbation)
        regime = regimes[key]
        spin = _spin(drive, np.array([t]))[0]
        response = regime.response * spin
        c = regime.from_q @ (q - response.real.sum(1)) + regime.from_v @ (v - (1j * drive_rates * response).real.sum(1))
        times.append(t)
        sides.append(list(chi))
        coefficients.append(c)
        rates: Complex = np.concatenate([regime.eigenvalues, 1j * drive_rates])
        a: Complex = np.concatenate([(rows @ regime.W) * c, rows @ response + offsets.T * spin], axis=1)
        tau, contact, side, used = search(
            np.ascontiguousarray(rates.real), np.ascontiguousarray(rates.imag),
            np.ascontiguousarray(a.real), np.ascontiguousarray(a.imag),
            np.array(chi, np.int64), g1, g2, resting, t, t_end,
        )  # fmt: skip
        evaluations += used
        if contact < 0 or t + tau >= t_end:
            break
        moving = c * np.exp(regime.eigenvalues * tau)
        ahead = response * np.exp(1j * drive_rates * tau)
        q = (regime.W @ moving).real + ahead.real.sum(1)
        v = (regime.W @ (regime.eigenvalues * moving)).real + (1j * drive_rates * ahead).real.sum(1)
        chi[contact] = side if chi[contact] == 0 else 0
        t, resting = t + tau, contact
    sides_array = np.array(sides, np.int64).reshape(len(times), m)
    return ExponentialSolution(drive, regimes, np.array(times), sides_array, coefficients, evaluations), compile_seconds


def _start(system: System, perturbation: Perturbation | None) -> tuple[Array, Array]:
    q, v = system.q0.copy(), system.v0.copy()
    if perturbation is not None:
        rng = np.random.default_rng([perturbation.seed, 99])
        load = np.linalg.solve(system.mass, system.load(0.0))
        size = perturbation.state * max(np.max(np.abs(q)), np.max(np.abs(v)), np.max(np.abs(load)), 1e-300)
        q, v = q + size * rng.uniform(-1, 1, len(q)) / len(q) ** 2, v + size * rng.uniform(-1, 1, len(v))
    return q, v


def _regime(system: System, drive: Drive, chi: tuple[int, ...], perturbation: Perturbation | None) -> Regime:
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
    modal_force = _phasors(force) @ shapes  # (1 + F, n)
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
