"""Random systems under short pulses, and a Runge-Kutta loop of its own that shares no code with the package."""

from __future__ import annotations

import numba
import numpy as np

import stiffbeam as sb

SHAPES = ("sine", "triangle", "box", "gauss")


def pulse(shape: str, amplitude: float, start: float, width: float):
    """A bare callable that is zero, or for "gauss" next to it, outside (start, start + width). It states where it
    begins, turns and ends."""

    def load(t):
        s = (np.asarray(t) - start) / width
        inside = (s > 0.0) & (s < 1.0)
        if shape == "sine":
            return np.where(inside, amplitude * np.sin(np.pi * s), 0.0)
        if shape == "triangle":
            return np.where(inside, amplitude * (1.0 - np.abs(2.0 * s - 1.0)), 0.0)
        if shape == "box":
            return np.where(inside, amplitude, 0.0)
        return amplitude * np.exp(-((10.0 * (s - 0.5)) ** 2))

    load.breakpoints = (start, start + 0.5 * width, start + width)
    return load


def random_system(seed: int) -> tuple[sb.System, tuple]:
    """One to three masses at rest or not, damped or not, one or two stops, one to three pulses of 0.1 to 30 ms.

    The description beside it is what ``witness`` takes: plain arrays.
    """
    rng = np.random.default_rng([2711, seed])
    n = int(rng.integers(1, 4))
    mass = rng.uniform(0.5, 2.0, n)
    springs = 10.0 ** rng.uniform(2.5, 4.5, n)
    stiffness = np.diag(springs) + np.diag(np.append(springs[1:], 0.0))
    stiffness -= np.diag(springs[1:], 1) + np.diag(springs[1:], -1)
    damping = rng.choice([0.0, 1e-4, 1e-3]) * stiffness
    row = np.eye(n)[-1] if rng.random() < 0.7 else rng.uniform(-1.0, 1.0, n)
    reach = 10.0 ** rng.uniform(-4.0, -2.0)
    kappa = 10.0 ** rng.uniform(4.0, 6.0)
    lower, upper = (-reach if rng.random() < 0.7 else -np.inf), reach * rng.uniform(0.5, 2.0)
    velocity = rng.choice([0.0, 1.0]) * rng.normal(size=n) * reach * np.sqrt(springs.min() / mass.max())
    pulses = []
    for _ in range(int(rng.integers(1, 4))):
        shape = int(rng.integers(4))
        # An even number of the witness's steps of 2^-18: its ends, and its middle, lie between two.
        width = np.ceil(2**17 * 10.0 ** rng.uniform(-4.0, -1.5)) / 2**17
        start = np.round(2**18 * rng.uniform(0.05, 0.7)) / 2**18
        # A speed that takes the slowest of the springs a few times as far as the stop.
        amplitude = (
            rng.uniform(0.5, 5.0) * reach * np.sqrt(springs.min() * mass.max()) / width * rng.choice([-1.0, 1.0])
        )
        pulses.append((shape, amplitude, start, width, int(rng.integers(n))))
    stops = sb.Stops(None if np.isinf(lower) else lower, upper, stiffness=kappa)
    system = sb.System.from_matrices(
        np.diag(mass),
        stiffness,
        damping,
        loads=[(np.eye(n)[node], pulse(SHAPES[shape], a, start, width)) for shape, a, start, width, node in pulses],
        contacts=[sb.Contact(row, stops)],
        initial_velocity=velocity,
    )
    return system, (mass, stiffness, damping, row, lower, upper, kappa, velocity, np.array(pulses, float))


def witness(description: tuple, t_end: float, steps: int, outputs: int) -> tuple[np.ndarray, np.ndarray]:
    """Contact position at outputs + 1 equidistant times, and the times of entry, linear inside a step."""
    return _march(*description, t_end, steps, outputs)


@numba.njit
def _rates(t, inside, mass, stiffness, damping, row, lower, upper, kappa, pulses, q, v, out):
    u = np.sum(row * q)
    contact = -kappa * max(u - upper, 0.0) + kappa * max(lower - u, 0.0)
    for i in range(q.size):
        total = contact * row[i]
        for j in range(q.size):
            total -= stiffness[i, j] * q[j] + damping[i, j] * v[j]
        out[i] = total
    for k in range(pulses.shape[0]):
        s = (t - pulses[k, 2]) / pulses[k, 3]
        middle = (inside - pulses[k, 2]) / pulses[k, 3]  # the step's middle tells on which side of a jump it lies
        shape = int(pulses[k, 0])
        value = 0.0
        if shape == 3:
            value = np.exp(-((10.0 * (s - 0.5)) ** 2))
        elif 0.0 < middle < 1.0:
            value = np.sin(np.pi * s) if shape == 0 else (1.0 - abs(2.0 * s - 1.0) if shape == 1 else 1.0)
        out[int(pulses[k, 4])] += pulses[k, 1] * value
    out /= mass


@numba.njit
def _march(mass, stiffness, damping, row, lower, upper, kappa, velocity, pulses, t_end, steps, outputs):
    n = mass.size
    h = t_end / steps
    q, v = np.zeros(n), velocity.copy()
    a = np.empty((4, n))
    tip = np.zeros(outputs + 1)
    entries = []
    every = steps // outputs
    u = 0.0
    for step in range(steps):
        t = step * h
        middle = t + 0.5 * h
        _rates(t, middle, mass, stiffness, damping, row, lower, upper, kappa, pulses, q, v, a[0])
        q2, v2 = q + 0.5 * h * v, v + 0.5 * h * a[0]
        _rates(middle, middle, mass, stiffness, damping, row, lower, upper, kappa, pulses, q2, v2, a[1])
        q3, v3 = q + 0.5 * h * v2, v + 0.5 * h * a[1]
        _rates(middle, middle, mass, stiffness, damping, row, lower, upper, kappa, pulses, q3, v3, a[2])
        q4, v4 = q + h * v3, v + h * a[2]
        _rates(t + h, middle, mass, stiffness, damping, row, lower, upper, kappa, pulses, q4, v4, a[3])
        q = q + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
        v = v + h / 6.0 * (a[0] + 2.0 * a[1] + 2.0 * a[2] + a[3])
        before, u = u, np.sum(row * q)
        if before <= upper < u:
            entries.append(t + h * (upper - before) / (u - before))
        if before >= lower > u:
            entries.append(t + h * (before - lower) / (before - u))
        if (step + 1) % every == 0:
            tip[(step + 1) // every] = u
    return tip, np.array(entries)
