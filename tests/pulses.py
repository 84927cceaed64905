"""Random systems under short pulses, and their motion by SciPy's RK45 from kink to kink."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

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


def witness(description: tuple, t_end: float, outputs: int) -> tuple[np.ndarray, np.ndarray]:
    """Contact position at outputs + 1 equidistant times, and the times of entry: RK45 from kink to kink."""
    mass, stiffness, damping, row, lower, upper, kappa, velocity, pulses = description
    n, times, entries = len(mass), np.linspace(0.0, t_end, outputs + 1), []
    edges = np.unique(
        np.clip([0.0, t_end, *(x for _, _, a, w, _ in pulses for x in (a, a + 0.5 * w, a + w))], 0, t_end)
    )
    z, tip, t, side = np.concatenate([np.zeros(n), velocity]), [0.0], 0.0, 0
    for last in edges[1:]:
        acting = [p for p in pulses if p[0] == 3 or p[2] <= 0.5 * (t + last) <= p[2] + p[3]]
        while t < last:
            spring = kappa if side else 0.0
            stop = upper if side > 0 else lower if side < 0 else 0.0

            def rates(t, z, acting=acting, spring=spring, stop=stop):
                force = -stiffness @ z[:n] - damping @ z[n:] - spring * (row @ z[:n] - stop) * row
                for shape, size, begin, width, node in acting:
                    s = (t - begin) / width
                    form = (np.sin(np.pi * s), 1.0 - abs(2.0 * s - 1.0), 1.0, np.exp(-((10.0 * (s - 0.5)) ** 2)))
                    force[int(node)] += size * form[int(shape)]
                return np.concatenate([z[n:], force / mass])

            gaps = [lambda t, z, g=g: row @ z[:n] - g for g in (upper, lower) if np.isfinite(g)]
            for gap, g in zip(gaps, [g for g in (upper, lower) if np.isfinite(g)], strict=True):
                gap.terminal = True
                gap.direction = -side if side else (1.0 if g == upper else -1.0)
            size = np.maximum(np.abs(z), 1e-9)
            done = solve_ivp(
                rates, (t, last), z, rtol=1e-9, atol=1e-12 * float(np.max(size)), events=gaps, dense_output=True
            )
            inside = times[(times > t) & (times <= done.t[-1])]
            tip += list(row @ done.sol(inside)[:n]) if len(inside) else []
            t, z = float(done.t[-1]), done.y[:, -1]
            if done.status == 1:
                hit = next(
                    g
                    for g, x in zip([g for g in (upper, lower) if np.isfinite(g)], done.t_events, strict=True)
                    if len(x)
                )
                side = 0 if side else (1 if hit == upper else -1)
                entries += [t] if side else []
    return np.array(tip), np.array(entries)
