"""Random systems that start, rest or meet exactly on their stops, and a solver that knows nothing of them.

The witness integrates M q'' + C q' + K q = loads + sum row F(row q + o) with DOP853 on the force law as it
stands, penetration by clipping: no regimes, no events, nothing of the package but the matrices.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

import stiffbeam as sb

KINDS = (
    "stop at zero, constant load",
    "on the stop, moving off",
    "at rest on the stop",
    "stop equal to the offset",
    "two contacts, one row, one stop",
    "two contacts that close at once",
    "a thousandth of a billionth apart",
    "in equilibrium on the stop",
    "stop that moves with the mass",
    "far mass loaded",
)


def edge_system(seed: int) -> sb.System:
    """A system of one to four masses of one of the KINDS, by turns; the rest of it is random."""
    rng = np.random.default_rng([11, seed])
    kind = KINDS[seed % len(KINDS)]
    n = int(rng.integers(1, 5)) if kind != "far mass loaded" else int(rng.integers(2, 5))
    unit = np.eye(n)
    mass = np.diag(rng.uniform(0.5, 2.0, n))
    springs = rng.uniform(20.0, 200.0, n)
    stiffness = np.diag(springs + np.append(springs[1:], 0.0)) - np.diag(springs[1:], 1) - np.diag(springs[1:], -1)
    damping = rng.choice([0.0, 2e-3]) * stiffness
    kappa = 10.0 ** rng.uniform(2.0, 4.5)
    push = float(rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 20.0))
    wave = sb.Harmonic(rng.uniform(1.0, 10.0), rng.uniform(1.0, 9.0), rng.choice([0.0, rng.uniform(0.0, 6.0)]))
    loads = [(unit[-1], sb.Constant(push))]
    if rng.random() < 0.5:
        loads.append((unit[int(rng.integers(n))], wave))
    q0, v0 = np.zeros(n), np.zeros(n)
    one_side = rng.random() < 0.5
    row = unit[-1]

    def stops(lower: float, kappa: float = kappa) -> sb.Stops:
        """At ``lower`` from below, or mirrored."""
        return sb.Stops(lower, None, stiffness=kappa) if one_side else sb.Stops(None, -lower, stiffness=kappa)

    if kind == "stop at zero, constant load":
        contacts = [sb.Contact(row, stops(0.0))]
        v0 = rng.choice([0.0, 1.0]) * rng.standard_normal(n)
    elif kind == "on the stop, moving off":
        loads = [(row, sb.Constant(-abs(push) if one_side else abs(push))), *loads[1:]]
        contacts = [sb.Contact(row, stops(0.0))]
        v0[-1] = (1.0 if one_side else -1.0) * rng.uniform(0.01, 2.0)
    elif kind == "at rest on the stop":
        level = rng.uniform(-0.1, 0.1)
        q0[-1] = level if one_side else -level
        contacts = [sb.Contact(row, stops(level))]
    elif kind == "stop equal to the offset":
        level = rng.uniform(-0.2, 0.2)
        contacts = [sb.Contact(row, stops(level), sb.Constant(level if one_side else -level))]
    elif kind == "two contacts, one row, one stop":
        level = rng.choice([0.0, -0.05])
        contacts = [sb.Contact(row, stops(level)), sb.Contact(row, stops(level, 2.0 * kappa))]
        v0[-1] = rng.standard_normal()
    elif kind == "two contacts that close at once":
        level = -rng.uniform(0.0, 0.05)
        contacts = [sb.Contact(row, stops(level)), sb.Contact(2.0 * row, stops(2.0 * level))]
        v0[-1] = -np.sign(1.0 if one_side else -1.0) * rng.uniform(0.5, 3.0)
    elif kind == "a thousandth of a billionth apart":
        level = -rng.uniform(0.0, 0.05)
        contacts = [sb.Contact(row, stops(level)), sb.Contact(-row, sb.Stops(None, 1e-12 - level, stiffness=kappa))]
        contacts[1:] = [sb.Contact(row, stops(level - 1e-12))]
        v0[-1] = rng.standard_normal()
    elif kind == "in equilibrium on the stop":
        loads = [(unit[-1], sb.Constant(push))]
        q0 = np.linalg.solve(stiffness, push * unit[-1])
        level = float(q0[-1]) if one_side else -float(q0[-1])
        contacts = [sb.Contact(row, stops(level))]
        if n > 1 and rng.random() < 0.5:
            v0[0] = rng.standard_normal()
    elif kind == "stop that moves with the mass":
        moving = sb.Harmonic(rng.uniform(0.01, 0.1), rng.uniform(1.0, 9.0))
        contacts = [sb.Contact(row, stops(0.0), moving)]
    else:
        loads = [(unit[0], sb.Constant(push))]
        contacts = [sb.Contact(row, stops(0.0))]
    return sb.System.from_matrices(
        mass, stiffness, damping, loads, contacts, initial_displacement=q0, initial_velocity=v0
    )


def witness(system: sb.System, times: np.ndarray, rtol: float = 1e-13) -> np.ndarray:
    """q (k, n) at ``times``."""
    inverse, n = np.linalg.inv(system.mass), system.size
    functions = [(inverse @ p, _scalar(f)) for p, f in system.loads]
    contacts = [(c.row, inverse @ c.row, c.stops, _scalar(c.offset)) for c in system.contacts]
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ system.stiffness, -inverse @ system.damping]])

    def rhs(t, y):
        rate = A @ y
        for p, f in functions:
            rate[n:] += p * f(t)
        for row, push, stops, o in contacts:
            u = row @ y[:n] + o(t)
            rate[n:] -= push * stops.stiffness * (max(u - stops.upper_bound, 0.0) - max(stops.lower_bound - u, 0.0))
        return rate

    closed = system.stiffness + sum(c.stops.stiffness * np.outer(c.row, c.row) for c in system.contacts)
    fastest = np.sqrt(np.max(np.linalg.eigvals(inverse @ closed).real))
    start = np.concatenate([system.q0, system.v0])
    found = solve_ivp(
        rhs, (0.0, times[-1]), start, "DOP853", t_eval=times, rtol=rtol, atol=1e-14, max_step=0.5 / fastest
    )
    return found.y[:n].T


def _scalar(f):
    if f is None:
        return lambda t: 0.0
    if isinstance(f, sb.Constant):
        return lambda t: f.level
    return lambda t: f.amplitude * np.sin(f.frequency * t + f.phase)
