"""How much faster than a plain NumPy loop is the block march, and what bounds it?

Table 10, M = 25, implicit contact. The yardstick is the loop a careful NumPy user writes: HHT-alpha with
a prefactored LU, one solve and two matrix-vector products a step. Times are the least of several
repetitions in one process, so the ratios hold when the machine drifts. Run:

    python studies/march_speed.py
"""

from __future__ import annotations

import time

import numpy as np
import scipy.linalg

import stiffbeam as sb
from stiffbeam.modal import modes
from stiffbeam.modal_march import block_length
from stiffbeam.propagator import build

REPETITIONS = 15


def numpy_hht_loop(system: sb.System, alpha: float, dt: float, steps: int) -> tuple[float, np.ndarray]:
    """Seconds per step and tip displacement of HHT-alpha with a prefactored LU and closed-form contact."""
    M, K, row, stops = system.mass, system.stiffness, system.contacts[0].row, system.contacts[0].stops
    g1, g2, kappa = stops.g1, stops.g2, stops.stiffness
    beta, gamma = (1 - alpha) ** 2 / 4, 0.5 - alpha
    lu = scipy.linalg.lu_factor(M + (1 + alpha) * beta * dt**2 * K)
    push = (1 + alpha) * scipy.linalg.lu_solve(lu, row)
    compliance = beta * dt**2 * push[-1]
    stiff = kappa / (1 + kappa * compliance)
    loads = system.load(np.arange(steps + 1) * dt)
    q, v = system.q0.copy(), system.v0.copy()
    net = loads[0] - K @ q
    a = np.linalg.solve(M, net)
    tip = np.empty(steps + 1)
    tip[0] = q[-1]
    begun = time.perf_counter()
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
    return (time.perf_counter() - begun) / steps, tip


def main() -> None:
    case = sb.paper_case(10)
    system = sb.semidiscretise(case.problem, case.cells)
    runs: list[tuple[str, sb.Scheme, int]] = [
        ("HHT(-0.1)", sb.HHT(-0.1), 300),
        ("BDF2", sb.BDF2(), 0),
        ("SDIRK-OS(0.4359)", sb.SDIRK(nystrom=True), 150),
    ]
    loop = np.inf
    best = {name: (np.inf, np.inf) for name, _, _ in runs}
    contact = {}
    for _ in range(REPETITIONS):
        seconds, tip = numpy_hht_loop(system, -0.1, case.dt, 4000)
        loop = min(loop, seconds)
        for name, scheme, _ in runs:
            every_step = sb.integrate(system, scheme, case.dt, case.t_end)
            thinned = sb.integrate(system, scheme, case.dt, case.t_end, every=100)
            now = (thinned.work.march_seconds, every_step.work.seconds)
            best[name] = tuple(min(a, b / thinned.work.steps) for a, b in zip(best[name], now, strict=True))
            contact[name] = every_step.contacts[0].fraction
    check = sb.integrate(system, sb.HHT(-0.1), case.dt, 0.06)
    assert np.max(np.abs(check.tip - tip[: len(check.tip)])) < 1e-9, "the loop and the march are one scheme"
    print(f"NumPy loop with prefactored LU, HHT: {1e6 * loop:.1f} us a step")
    print(
        f"{'scheme':18} {'march':>9} {'ratio':>7} {'whole run, every step kept':>27} {'ratio':>7}  multiply-adds a step"
    )
    for name, scheme, least in runs:
        march, whole = best[name]
        length = block_length(scheme, 1)
        block = build(scheme, system, modes(system), case.dt, length, "implicit")
        D, N, R = block.reading.shape[1], block.push.shape[0], block.reading.shape[0]
        work = (R * D + block.components**2 * 25 + contact[name] * N * (R + D)) / length
        wanted = f"  (wanted: {least})" if least else ""
        print(
            f"{name:18} {1e9 * march:6.1f} ns {loop / march:6.0f}x {1e9 * whole:25.1f} ns {loop / whole:6.0f}x"
            f"   {work:.0f}{wanted}"
        )


if __name__ == "__main__":
    main()
