"""What one would write by hand: the programs that the block march is measured against."""

from __future__ import annotations

import math
import time

import numba
import numpy as np
import scipy.linalg
from timing import Timed

import stiffbeam as sb
from stiffbeam.basics.compiled import FASTMATH
from stiffbeam.model.drive import Drive
from stiffbeam.model.modes import modes


def numpy_loop(system: sb.System, dt: float, steps: int, alpha: float = -0.1) -> tuple[Timed, np.ndarray]:
    """HHT-alpha with a prefactored LU and closed-form contact, and the tip (steps + 1,) it leaves."""
    M, K, row, stops = system.mass, system.stiffness, system.contacts[0].row, system.contacts[0].stops
    g1, g2, kappa = stops.g1, stops.g2, stops.stiffness
    beta, gamma = (1 - alpha) ** 2 / 4, 0.5 - alpha
    lu = scipy.linalg.lu_factor(M + (1 + alpha) * beta * dt**2 * K)
    push = (1 + alpha) * scipy.linalg.lu_solve(lu, row)
    compliance = beta * dt**2 * push[-1]
    stiff = kappa / (1 + kappa * compliance)
    loads = system.load(np.arange(steps + 1) * dt)
    tip = np.empty(steps + 1)

    def run() -> float:
        q, v = system.q0.copy(), system.v0.copy()
        net = loads[0] - K @ q
        a = np.linalg.solve(M, net)
        tip[0] = q[-1]
        begun = time.process_time()
        for n in range(1, steps + 1):
            q_ahead = q + dt * v + dt**2 * (0.5 - beta) * a
            v_ahead = v + dt * (1 - gamma) * a
            free = scipy.linalg.lu_solve(lu, (1 + alpha) * (loads[n] - K @ q_ahead) - alpha * net, check_finite=False)
            r = q_ahead[-1] + beta * dt**2 * free[-1]
            force = stiff * (min(max(r, g1), g2) - r)
            a = free + push * force
            q = q_ahead + beta * dt**2 * a
            v = v_ahead + gamma * dt * a
            net = loads[n] - K @ q
            net[-1] += force
            tip[n] = q[-1]
        return time.process_time() - begun

    return run, tip


@numba.njit(fastmath=FASTMATH, error_model="numpy")
def _by_hand(q, v, a, net, squares, row, sine, cosine, frequency, alpha, dt, kappa, g1, g2, tip):
    n = q.size
    beta, gamma = (1 - alpha) ** 2 / 4, 0.5 - alpha
    inverse, push = np.empty(n), np.empty(n)
    s = 0.0
    for j in range(n):
        inverse[j] = 1.0 / (1.0 + (1.0 + alpha) * beta * dt * dt * squares[j])
        push[j] = (1.0 + alpha) * inverse[j] * row[j]
        s += beta * dt * dt * push[j] * row[j]
    stiff = kappa / (1.0 + kappa * s)
    for k in range(1, tip.size):
        S, C = math.sin(frequency * k * dt), math.cos(frequency * k * dt)
        r = 0.0
        for j in range(n):
            ahead = q[j] + dt * v[j] + dt * dt * (0.5 - beta) * a[j]
            v[j] += dt * (1.0 - gamma) * a[j]
            a[j] = inverse[j] * ((1.0 + alpha) * (sine[j] * S + cosine[j] * C - squares[j] * ahead) - alpha * net[j])
            q[j] = ahead + dt * dt * beta * a[j]
            r += row[j] * q[j]
        force = 0.0
        if r > g2 or r < g1:
            force = stiff * (min(max(r, g1), g2) - r)
            for j in range(n):
                a[j] += push[j] * force
                q[j] += dt * dt * beta * push[j] * force
            r += s * force
        for j in range(n):
            v[j] += dt * gamma * a[j]
            net[j] = sine[j] * S + cosine[j] * C - squares[j] * q[j] + force * row[j]
        tip[k] = r


def by_hand(system: sb.System, dt: float, steps: int) -> tuple[Timed, np.ndarray]:
    """The hand-written modal HHT kernel, and the tip (steps + 1,) it leaves."""
    basis, drive, stops = modes(system), Drive.of(system), system.contacts[0].stops
    assert basis is not None
    force = basis.force(drive.split(system.loads, system.size)[0])
    row, tip = basis.force(system.contacts[0].row), np.empty(steps + 1)

    def run() -> float:
        q, v = basis.to_modal(system.q0), basis.to_modal(system.v0)
        net = force[0] + force[2] - basis.omega**2 * q
        tip[0] = row @ q
        begun = time.perf_counter()
        _by_hand(
            q, v, net.copy(), net, basis.omega**2, row, force[1].copy(), force[2].copy(), drive.frequencies[0],
            -0.1, dt, stops.stiffness, stops.g1, stops.g2, tip,
        )  # fmt: skip
        return time.perf_counter() - begun

    return run, tip
