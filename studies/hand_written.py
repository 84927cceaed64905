"""HHT-alpha as one writes it by hand: the programs that the block march is measured against.

Each maker takes (system, dt, steps) and returns (run, tip): ``run()`` marches once and returns seconds of processor
time, ``tip`` (steps + 1,) is what it leaves. All but the NumPy loop march in modes, where a step without contact is one
linear map, prepared once, and the force on the stop is one division.
"""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import scipy.linalg

import stiffbeam as sb
from stiffbeam.basics.compiled import FASTMATH
from stiffbeam.model.modes import modes
from stiffbeam.model.time_functions import Drive

Timed = Callable[[], float]  # runs once, returns seconds
ALPHA = -0.1
BETA, GAMMA = (1 - ALPHA) ** 2 / 4, 0.5 - ALPHA


def timed(work: Callable[[], object], threads: int = 1) -> Timed:
    """``work`` in processor time over threads."""

    def run() -> float:
        begun = time.process_time()
        work()
        return (time.process_time() - begun) / threads

    return run


def numpy_loop(system: sb.System, dt: float, steps: int) -> tuple[Timed, np.ndarray]:
    """On the unknowns themselves, with a prefactored LU."""
    M, K, row, stops = system.mass, system.stiffness, system.contacts[0].row, system.contacts[0].stops
    lu = scipy.linalg.lu_factor(M + (1 + ALPHA) * BETA * dt**2 * K)
    push = (1 + ALPHA) * scipy.linalg.lu_solve(lu, row)
    compliance = BETA * dt**2 * push[-1]
    stiff = stops.stiffness / (1 + stops.stiffness * compliance)
    loads = system.load(np.arange(steps + 1) * dt)
    tip = np.empty(steps + 1)

    def march() -> None:
        q, v = system.q0.copy(), system.v0.copy()
        net = loads[0] - K @ q
        a = np.linalg.solve(M, net)
        tip[0] = q[-1]
        for n in range(1, steps + 1):
            q_ahead = q + dt * v + dt**2 * (0.5 - BETA) * a
            v_ahead = v + dt * (1 - GAMMA) * a
            free = scipy.linalg.lu_solve(lu, (1 + ALPHA) * (loads[n] - K @ q_ahead) - ALPHA * net, check_finite=False)
            r = q_ahead[-1] + BETA * dt**2 * free[-1]
            force = stiff * (min(max(r, stops.lower_bound), stops.upper_bound) - r)
            a = free + push * force
            q = q_ahead + BETA * dt**2 * a
            v = v_ahead + GAMMA * dt * a
            net = loads[n] - K @ q
            net[-1] += force
            tip[n] = q[-1]

    return timed(march), tip


class Modal(NamedTuple):
    """The step in modes. tables: (8, n), what q, v, a, sine, cosine and the last force add to the new dt^2 q'', what a
    force adds at once, and the contact's row. start: (3, n). stiff: force over the depth that there is without it."""

    tables: np.ndarray
    start: np.ndarray
    frequency: float
    stiff: float
    compliance: float
    lower: float
    upper: float

    @classmethod
    def of(cls, system: sb.System, dt: float) -> Modal:
        basis, drive, contact = modes(system), Drive.of(system), system.contacts[0]
        assert basis is not None
        _, sine, cosine = basis.force(drive.split(system.loads, system.size)[0])[:3]
        squares, row, w = basis.omega**2, basis.force(contact.row), drive.frequencies[0]
        inverse = dt**2 / (1 + (1 + ALPHA) * BETA * dt**2 * squares)
        of_v, push = -(1 + ALPHA) * inverse * squares, (1 + ALPHA) * inverse * row
        S, C = math.sin(w * dt), math.cos(w * dt)
        of_sine = inverse * ((1 + ALPHA) * sine - ALPHA * (sine * C + cosine * S))
        of_cosine = inverse * ((1 + ALPHA) * cosine - ALPHA * (cosine * C - sine * S))
        of_force = -ALPHA * inverse * row
        tables = np.array([-inverse * squares, of_v, (0.5 - BETA) * of_v, of_sine, of_cosine, of_force, push, row])
        q = basis.to_modal(system.q0)
        start = np.array([q, dt * basis.to_modal(system.v0), dt**2 * (cosine - squares * q)])
        compliance = BETA * float(push @ row)
        stiff = contact.stops.stiffness / (1 + contact.stops.stiffness * compliance)
        return cls(tables, start, w, stiff, compliance, contact.stops.lower_bound, contact.stops.upper_bound)


@numba.njit(fastmath=FASTMATH, error_model="numpy")
def _numba_loop(tables, state, frequency, dt, beta, gamma, stiff, compliance, lower, upper, tip):
    of_q, of_v, of_a, of_sine, of_cosine, of_force, push, row = tables
    q, v, a = state
    turn_sine, turn_cosine = math.sin(frequency * dt), math.cos(frequency * dt)
    sine, cosine, force = 0.0, 1.0, 0.0
    for k in range(1, tip.size):
        if k % 64:
            sine, cosine = sine * turn_cosine + cosine * turn_sine, cosine * turn_cosine - sine * turn_sine
        else:
            sine, cosine = math.sin(frequency * k * dt), math.cos(frequency * k * dt)
        r = 0.0
        for j in range(q.size):
            ahead = of_q[j] * q[j] + of_v[j] * v[j] + of_a[j] * a[j]
            ahead += of_sine[j] * sine + of_cosine[j] * cosine + of_force[j] * force
            q[j] += v[j] + (0.5 - beta) * a[j] + beta * ahead
            v[j] += (1.0 - gamma) * a[j] + gamma * ahead
            a[j] = ahead
            r += row[j] * q[j]
        force = 0.0
        if r > upper or r < lower:
            force = stiff * ((upper if r > upper else lower) - r)
            for j in range(q.size):
                a[j] += force * push[j]
                v[j] += gamma * force * push[j]
                q[j] += beta * force * push[j]
            r += compliance * force
        tip[k] = r


def numba_loop(system: sb.System, dt: float, steps: int) -> tuple[Timed, np.ndarray]:
    """In modes, compiled by numba."""
    (tables, start, w, *rest), tip = Modal.of(system, dt), np.empty(steps + 1)
    tip[0] = tables[-1] @ start[0]
    march: Any = _numba_loop
    return timed(lambda: march(tables, start.copy(), w, dt, BETA, GAMMA, *rest, tip)), tip


def in_c(
    system: sb.System, dt: float, steps: int, fixed: bool = False, writes: str = "tip"
) -> tuple[Timed, np.ndarray]:
    """In modes, hand_written.c; ``fixed``: their number is known to the compiler. OSError without a compiler.

    writes: to a new array in every run, "tip" its position, "outputs" also its velocity, force and time as
    ``integrate`` does, "ledger" the energy balance of every step; then the array returned is the loss.
    """
    tables, start, w, *rest = Modal.of(system, dt)
    tip, source = np.empty(steps + 1), Path(__file__).with_suffix(".c")
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise OSError("no C compiler")
    n, pointer = start.shape[1], np.ctypeslib.as_ctypes
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "hand_written.so"
        flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC", *([f"-DMODES={n}"] if fixed else [])]
        flags += [] if writes == "tip" else [f"-D{writes.upper()}"]
        subprocess.run([compiler, *flags, str(source), "-o", str(library), "-lm"], check=True)
        march = ctypes.CDLL(str(library)).march
    numbers = [ctypes.c_double(x) for x in (w, dt, BETA, GAMMA, *rest)]
    tip[0] = tables[-1] @ start[0]

    def marched(tip: np.ndarray, *more: Any) -> None:
        arguments = (pointer(tables.ravel()), pointer(start.ravel().copy()), *numbers, pointer(tip), *more)
        march(ctypes.c_long(n), ctypes.c_long(steps), *arguments)

    def outputs() -> np.ndarray:
        written = np.empty((4, steps + 1))
        written[:, 0] = tip[0], tables[-1] @ start[1] / dt, 0.0, 0.0
        marched(written[0], ctypes.c_double(GAMMA * float(tables[-2] @ tables[-1])), *map(pointer, written[1:]))
        return written[0]

    def ledger() -> np.ndarray:
        balance = np.empty((steps + 1, 7))
        balance[0] = *system.energies(0.0, system.q0, system.v0), 0.0, 0.0, 0.0, 0.0
        marched(
            tip, pointer(modal.ravel()), ctypes.c_double(system.contacts[0].stops.stiffness), pointer(balance.ravel())
        )
        return balance[:, 4]

    if writes == "tip":
        return timed(lambda: marched(tip)), tip
    basis, drive = modes(system), Drive.of(system)
    assert basis is not None
    assert not system.damped
    modal = np.array([basis.omega**2, *basis.force(drive.split(system.loads, system.size)[0])[1:3]])
    work = outputs if writes == "outputs" else ledger
    return timed(work), work()


def jax_scan(system: sb.System, dt: float, steps: int) -> tuple[Timed, np.ndarray]:
    """In modes, as a JAX scan. ImportError without JAX."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    modal, tip = Modal.of(system, dt), np.empty(steps + 1)
    of_q, of_v, of_a, of_sine, of_cosine, of_force, push, row = modal.tables
    tip[0] = row @ modal.start[0]

    def step(state, k):
        q, v, a, force = state
        sine, cosine = jnp.sin(modal.frequency * k * dt), jnp.cos(modal.frequency * k * dt)
        free = of_q * q + of_v * v + of_a * a + of_sine * sine + of_cosine * cosine + of_force * force
        r = row @ (q + v + (0.5 - BETA) * a + BETA * free)
        force = modal.stiff * (jnp.clip(r, modal.lower, modal.upper) - r)
        ahead = free + push * force
        q = q + v + (0.5 - BETA) * a + BETA * ahead
        return (q, v + (1 - GAMMA) * a + GAMMA * ahead, ahead, force), r + modal.compliance * force

    scan = jax.jit(lambda state: jax.lax.scan(step, state, jnp.arange(1, steps + 1))[1])

    def march() -> None:
        tip[1:] = scan((*modal.start, 0.0))

    return timed(march), tip
