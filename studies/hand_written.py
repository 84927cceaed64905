"""What one would write by hand: the programs that the block march is measured against."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

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


def _modal(system: sb.System, steps: int) -> tuple[Any, ...]:
    """omega^2, row, sine and cosine of the load in modes, its frequency, and room for the tip."""
    basis, drive = modes(system), Drive.of(system)
    assert basis is not None
    force = basis.force(drive.split(system.loads, system.size)[0])
    row = basis.force(system.contacts[0].row)
    return basis.omega**2, row, force[1].copy(), force[2].copy(), drive.frequencies[0], np.empty(steps + 1)


def _at_rest(system: sb.System, squares: np.ndarray, cosine: np.ndarray) -> tuple[np.ndarray, ...]:
    """q, v, a and the net force of the modes at t = 0."""
    basis = modes(system)
    assert basis is not None
    q, v = basis.to_modal(system.q0), basis.to_modal(system.v0)
    net = cosine - squares * q
    return q, v, net.copy(), net


def by_hand(
    system: sb.System, dt: float, steps: int, clock: Callable[[], float] = time.perf_counter
) -> tuple[Timed, np.ndarray]:
    """The hand-written modal HHT kernel, and the tip (steps + 1,) it leaves."""
    squares, row, sine, cosine, frequency, tip = _modal(system, steps)
    stops = system.contacts[0].stops

    def run() -> float:
        state = _at_rest(system, squares, cosine)
        tip[0] = row @ state[0]
        begun = clock()
        _by_hand(*state, squares, row, sine, cosine, frequency, -0.1, dt, stops.stiffness, stops.g1, stops.g2, tip)
        return clock() - begun

    return run, tip


def in_c(system: sb.System, dt: float, steps: int) -> tuple[Timed, np.ndarray]:
    """The same in C, hand_written.c. Raises OSError where there is no compiler."""
    squares, row, sine, cosine, frequency, tip = _modal(system, steps)
    stops, source = system.contacts[0].stops, Path(__file__).with_suffix(".c")
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise OSError("no C compiler")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "hand_written.so"
        flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC"]
        subprocess.run([compiler, *flags, str(source), "-o", str(library), "-lm"], check=True)
        march = ctypes.CDLL(str(library)).march
    work = np.empty(2 * len(squares))

    def run() -> float:
        state = _at_rest(system, squares, cosine)
        tip[0] = row @ state[0]
        arrays = [np.ctypeslib.as_ctypes(x) for x in (*state, squares, row, sine, cosine)]
        numbers = [ctypes.c_double(x) for x in (frequency, -0.1, dt, stops.stiffness, stops.g1, stops.g2)]
        sizes = [ctypes.c_long(x) for x in (len(squares), steps)]
        begun = time.process_time()
        march(*sizes, *arrays, *numbers, np.ctypeslib.as_ctypes(work), np.ctypeslib.as_ctypes(tip))
        return time.process_time() - begun

    return run, tip


@numba.njit(fastmath=FASTMATH, error_model="numpy")
def _solve(L, x):
    """x becomes (L D L^T)^-1 x; L (n, w + 1): D, then the first sub-diagonals."""
    n, w = L.shape[0], L.shape[1] - 1
    for i in range(n):
        for k in range(1, min(w, i) + 1):
            x[i] -= L[i - k, k] * x[i - k]
    for i in range(n - 1, -1, -1):
        x[i] /= L[i, 0]
        for k in range(1, min(w, n - 1 - i) + 1):
            x[i] -= L[i, k] * x[i + k]


@numba.njit(fastmath=FASTMATH, error_model="numpy")
def _net(K, load, S, C, q, net):
    """The load less K q; K (n, w + 1), the diagonal and the first sub-diagonals."""
    n, w = K.shape[0], K.shape[1] - 1
    for i in range(n):
        net[i] = load[0, i] * S + load[1, i] * C - K[i, 0] * q[i]
    for k in range(1, w + 1):
        for i in range(n - k):
            net[i + k] -= K[i, k] * q[i]
            net[i] -= K[i, k] * q[i + k]


@numba.njit(fastmath=FASTMATH, error_model="numpy")
def _banded(q, v, a, net, K, L, push, load, frequency, alpha, dt, kappa, g1, g2, tip):
    n = q.size
    beta, gamma = (1 - alpha) ** 2 / 4, 0.5 - alpha
    s = beta * dt * dt * push[n - 1]
    stiff, ahead, known = kappa / (1.0 + kappa * s), np.empty(n), np.empty(n)
    for k in range(1, tip.size):
        S, C = math.sin(frequency * k * dt), math.cos(frequency * k * dt)
        for j in range(n):
            ahead[j] = q[j] + dt * v[j] + dt * dt * (0.5 - beta) * a[j]
            v[j] += dt * (1.0 - gamma) * a[j]
        _net(K, load, S, C, ahead, known)
        for j in range(n):
            known[j] = (1.0 + alpha) * known[j] - alpha * net[j]
        _solve(L, known)
        r, force = ahead[n - 1] + beta * dt * dt * known[n - 1], 0.0
        if r > g2 or r < g1:
            force = stiff * (min(max(r, g1), g2) - r)
        for j in range(n):
            a[j] = known[j] + push[j] * force
            q[j] = ahead[j] + dt * dt * beta * a[j]
            v[j] += dt * gamma * a[j]
        _net(K, load, S, C, q, net)
        net[n - 1] += force
        tip[k] = q[n - 1]


def banded(system: sb.System, dt: float, steps: int, alpha: float = -0.1) -> tuple[Timed, np.ndarray]:
    """HHT-alpha on the unknowns themselves, factor and stiffness by their bands, for a contact at the last one."""
    M, K, stops, n = system.mass, system.stiffness, system.contacts[0].stops, system.size
    drive, tip = Drive.of(system), np.empty(steps + 1)
    load, width = drive.split(system.loads, n)[0][1:], int(np.ptp(np.nonzero(K)[0] - np.nonzero(K)[1])) // 2
    effective = M + (1 + alpha) * (1 - alpha) ** 2 / 4 * dt**2 * K
    lower, D, _ = scipy.linalg.ldl(effective)

    def bands(x: np.ndarray) -> np.ndarray:
        return np.array([np.pad(np.diagonal(x, -k), (0, k)) for k in range(width + 1)]).T.copy()

    L = bands(lower)
    L[:, 0] = np.diag(D)
    push = (1 + alpha) * np.linalg.solve(effective, system.contacts[0].row)

    def run() -> float:
        q, v = system.q0.copy(), system.v0.copy()
        net = load[1] - K @ q
        a = np.linalg.solve(M, net)
        tip[0] = q[-1]
        begun = time.process_time()
        _banded(q, v, a, net, bands(K), L, push, load, drive.frequencies[0], alpha, dt, *stops.law[:3], tip)
        return time.process_time() - begun

    return run, tip


def jax_scan(system: sb.System, dt: float, steps: int, alpha: float = -0.1) -> tuple[Timed, np.ndarray]:
    """The modal kernel as a JAX scan. Raises ImportError without JAX."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    squares, row, sine, cosine, frequency, tip = _modal(system, steps)
    stops, beta, gamma = system.contacts[0].stops, (1 - alpha) ** 2 / 4, 0.5 - alpha
    inverse = 1.0 / (1.0 + (1.0 + alpha) * beta * dt**2 * squares)
    push = (1.0 + alpha) * inverse * row
    stiff = stops.stiffness / (1.0 + stops.stiffness * beta * dt**2 * (push @ row))

    def step(state, k):
        q, v, a, net = state
        load = sine * jnp.sin(frequency * k * dt) + cosine * jnp.cos(frequency * k * dt)
        ahead = q + dt * v + dt**2 * (0.5 - beta) * a
        free = inverse * ((1.0 + alpha) * (load - squares * ahead) - alpha * net)
        r = row @ (ahead + dt**2 * beta * free)
        force = stiff * (jnp.clip(r, stops.g1, stops.g2) - r)
        a_new = free + push * force
        q = ahead + dt**2 * beta * a_new
        v = v + dt * ((1.0 - gamma) * a + gamma * a_new)
        return (q, v, a_new, load - squares * q + force * row), row @ q

    march = jax.jit(lambda state: jax.lax.scan(step, state, jnp.arange(1, steps + 1))[1])

    def run() -> float:
        state = _at_rest(system, squares, cosine)
        tip[0] = row @ state[0]
        begun = time.process_time()
        tip[1:] = march(state)
        return time.process_time() - begun

    return run, tip
