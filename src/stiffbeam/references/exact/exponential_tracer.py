"""Following a damped solution or one with several contacts from switch to switch, in float64."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...basics.budget import Forecast
from ...basics.validation import InputError
from ...model.drive import Drive
from ...model.modes import undamped_modes
from ...model.system import System
from .exponential import Complex, ExponentialSolution, Regime, phasors, spin_of
from .exponential_search import search
from .polynomial_answer import forced
from .rounding import Perturbation, perturbed_modes, rounded_sum
from .switching import search as leap
from .terms import OMEGA, SIGMA, SQUARE, X, Y, layout, tabulate
from .undamped_tracer import EVENTS_PER_CALL, refuse_accumulation, refuse_resonance

CONDITION_LIMIT = 1e8  # of the eigenvectors: beyond it eight digits are lost


class ExponentialTracer:
    """Follows solutions of one system; its regimes are made as they are met and kept.

    ``compile_seconds``: spent compiling.
    """

    def __init__(self, system: System, perturbation: Perturbation | None = None) -> None:
        self.system, self.drive, self.perturbation = system, Drive.of(system), perturbation
        self.gaps = Gaps(system, self.drive)
        self.regimes: dict[tuple[int, ...], Regime] = {}
        compiling = time.perf_counter()
        one, none = np.zeros(1), np.zeros((0, 1))
        index = np.zeros(0, np.int64)
        nothing = np.zeros((0, 0, 0), complex), np.zeros((0, 0))
        blank = layout(1, 1, 0)
        leap(*blank, *tabulate(blank[0], False), np.zeros(1, np.int64), one, one, np.zeros(1, np.int64), 0.0, 0.0)
        search(one, one, none, none, index, np.zeros(0), np.zeros(0), index, 0.0, 0.0, one[:0] + 0j, *nothing)
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
                self.regimes[key] = regime_of(system, drive, key, self.perturbation)
            regime = self.regimes[key]
            response = regime.response * spin_of(drive, np.array([t]))[0]
            if carried is None:
                c = regime.from_q @ (q - response.real.sum(1))
                c += regime.from_v @ (v - (1j * drive_rates * response).real.sum(1))
                if rng is not None and self.perturbation is not None:
                    # The time and every term of the sums above are rounded.
                    c *= 1.0 + regime.eigenvalues * t * self.perturbation.state * rng.uniform(-1.0, 1.0)
                    terms = rounded_sum(regime.from_q, np.abs(q) + np.abs(response).sum(1))
                    terms += rounded_sum(regime.from_v, np.abs(v) + np.abs(drive_rates * response).sum(1))
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
                carried = self._carried(regime, c, force, edge - t, rng)
                t, switched = edge, np.zeros(len(chi), bool)
                continue
            moving, carried = answered(regime, c, force, tau), None
            ahead = response * np.exp(1j * drive_rates * tau)
            q = (regime.W @ moving).real + ahead.real.sum(1)
            v = (regime.W @ (regime.eigenvalues * moving)).real + (1j * drive_rates * ahead).real.sum(1)
            chi[contact] = side if chi[contact] == 0 else 0
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
        self, regime: Regime, c: Complex, force: Complex, tau: float, rng: np.random.Generator | None
    ) -> Complex:
        """The coefficients at the end of a piece that goes on in the same regime."""
        ahead = answered(regime, c, force, tau)
        if rng is not None and self.perturbation is not None:
            forces = np.sum(np.abs(force) * tau ** np.arange(1, 1 + force.shape[1]), axis=1)  # without cancellation
            size = self.perturbation.state * (np.abs(ahead) + np.minimum(forces, np.abs(c) + np.abs(ahead)))
            ahead = ahead + size * (rng.uniform(-1.0, 1.0, (2, len(c))).T @ [1.0, 1j])
        return ahead


def answered(regime: Regime, c: Complex, force: Complex, tau: float) -> Complex:
    """The coefficients (k,) at tau after c, under the ``force`` (k, P) of the records."""
    ahead = c * np.exp(regime.eigenvalues * tau)
    if force.shape[1]:
        answer = np.empty((1, len(c)), complex)
        forced(regime.eigenvalues, np.array([tau]), force[None], answer)
        ahead = ahead + answer[0]
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
        self.tables: dict[int, tuple] = {}  # by regime, which is kept beside its own
        self.g1, self.g2 = (np.array([getattr(c.stops, side) for c in system.contacts]) for side in ("g1", "g2"))

    def next_switch(
        self, regime: Regime, c: Complex, chi: NDArray[np.int64], switched: NDArray[np.bool_], t: float, t_end: float
    ) -> tuple[float, int, int, int]:
        """(tau, contact, side, evaluations) of the first switch after t, contact -1 where there is none.

        c: the coefficients at t. switched: (m,), the contacts that have switched at t. Up to t_end every record is
        one polynomial.
        """
        spin, records = spin_of(self.drive, np.array([t]))[0], self.drive.polynomials(t)
        W = self.rows @ regime.W
        rates: Complex = np.concatenate([regime.eigenvalues, self.rates])
        a: Complex = np.concatenate([W * c, (self.rows @ regime.response + self.offsets) * spin], axis=1)
        if not self.drive.records:
            return self._leap(regime, rates, a, chi, switched, t, t_end)
        parts = (np.ascontiguousarray(x) for x in (np.minimum(rates.real, 0.0), rates.imag, a.real, a.imag))
        pushed = regime.eigenvalues, W[:, :, None] * (regime.push @ records), self.recorded @ records
        return search(*parts, chi, self.g1, self.g2, switched.astype(np.int64), t, t_end, *pushed)

    def _leap(
        self,
        regime: Regime,
        rates: Complex,
        a: Complex,
        chi: NDArray[np.int64],
        switched: NDArray[np.bool_],
        t: float,
        t_end: float,
    ) -> tuple[float, int, int, int]:
        """``next_switch`` of the exponentials Re sum_k a_ck exp(rates_k tau) alone, see terms.py."""
        if id(regime) not in self.tables:
            order = np.argsort(np.abs(rates), kind="stable")
            speeds, terms, seen, pairs = layout(len(self.rows), len(rates), 0)
            speeds[SIGMA], speeds[OMEGA] = np.minimum(rates.real, 0.0)[order], rates.imag[order]
            speeds[SQUARE] = speeds[OMEGA] ** 2
            table = tabulate(speeds, bool(np.any(speeds[SIGMA])))
            self.tables[id(regime)] = regime, order, (speeds, terms, seen, pairs, *table)
        _, order, (speeds, terms, *rest) = self.tables[id(regime)]
        terms[:, X], terms[:, Y] = a.real[:, order], -speeds[OMEGA] * a.imag[:, order]
        return leap(speeds, terms, *rest, chi, self.g1, self.g2, switched.astype(np.int64), t, t_end)


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


def regime_of(system: System, drive: Drive, chi: tuple[int, ...], perturbation: Perturbation | None = None) -> Regime:
    """The regime with every contact on the given side, 0 free. Raises InputError where its eigenvectors
    do not span the motion: a rigid-body motion, critical damping, a resonant drive."""
    closed = [(i, c, side) for i, (c, side) in enumerate(zip(system.contacts, chi, strict=True)) if side]
    springs = tuple((c.row, c.stops.spring(side)[0]) for _, c, side in closed)
    basis = undamped_modes(system, springs)
    omega, shapes = basis.omega, basis.shapes
    if omega[0] <= 1e-12 * omega[-1]:
        raise InputError(
            "stiffness",
            f"a rigid-body motion with contacts {chi}",
            "hold the system in every regime",
            "use method='cvode'",
        )
    rng = None
    if perturbation is not None:
        rng = np.random.default_rng([perturbation.seed, *(side + 1 for side in chi)])
        basis = perturbed_modes(system, springs, basis, perturbation.frequency, rng)
        omega, shapes = basis.omega, basis.shapes
    force, rest = drive.split(system.loads, system.size)
    offsets, moving = drive.offsets(system)
    records, moved = drive.recorded(rest, system.size), drive.recorded(moving, offsets.shape[1])
    for i, contact, side in closed:
        # sigma = kappa (gap - row q - offset): the first term is a load, the second in the matrix.
        kappa, constant = contact.stops.spring(side)
        force = force - kappa * np.outer(offsets[:, i], contact.row)
        records = records - kappa * np.outer(moved[:, i], contact.row)
        force[0] += constant * contact.row
    modal_force = phasors(force) @ shapes  # (1 + F, n)
    push = records @ shapes  # (R, n)
    damping = shapes.T @ system.damping @ shapes
    to_modal = shapes.T @ system.mass
    order = np.arange(2 * system.size)
    if rng is not None and perturbation is not None:
        size = perturbation.state
        modal_force += size * rounded_sum(phasors(force), shapes) * rng.uniform(-1.0, 1.0, modal_force.shape)
        push += size * rounded_sum(records, shapes) * rng.uniform(-1.0, 1.0, push.shape)
        damping += (
            size * rounded_sum(shapes.T, rounded_sum(system.damping, shapes)) * rng.uniform(-1.0, 1.0, damping.shape)
        )
        # Shapes that are not quite inverse to the way into them err alike at every switch.
        to_modal += size * rounded_sum(shapes.T, system.mass) * rng.uniform(-1.0, 1.0, to_modal.shape)
        shapes = shapes * (1.0 + size * rng.uniform(-1.0, 1.0, shapes.shape))
        order = rng.permutation(order)  # the eigenvalue algorithm rounds otherwise
    response = np.empty((system.size, len(modal_force)), complex)
    gains = np.tile(omega**2, (len(modal_force), 1)) - np.array([0.0, *drive.frequencies])[:, None] ** 2
    if not system.damped:
        refuse_resonance(gains, modal_force, omega, np.array([0.0, *drive.frequencies]), chi)
    for k, frequency in enumerate([0.0, *drive.frequencies]):
        matrix = np.diag(gains[k]) + 1j * frequency * damping
        # Row by row to size one, so that the stiff modes do not drown the soft ones.
        response[:, k] = shapes @ np.linalg.solve(matrix / omega[:, None] ** 2, modal_force[k] / omega**2)
    if not system.damped:
        return Regime(
            1j * omega, shapes.astype(complex), to_modal.astype(complex), -1j / omega[:, None] * to_modal, response,
            -1j / omega[:, None] * push.T,
        )  # fmt: skip
    # (omega eta, eta')' = [[0, Omega], [-Omega, -damping]] (omega eta, eta'), normal without damping.
    n = system.size
    A = np.block([[np.zeros((n, n)), np.diag(omega)], [-np.diag(omega), -damping]])
    eigenvalues: Complex
    vectors: Complex
    eigenvalues, vectors = (x.astype(complex) for x in np.linalg.eig(A[np.ix_(order, order)]))
    vectors = vectors[np.argsort(order)]
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
    return Regime(eigenvalues, W, from_q, inverse[keep, n:] @ to_modal, response, inverse[keep, n:] @ push.T)
