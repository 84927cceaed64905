"""The right-hand side in JAX, from the numbers that C reads: one program for each shape of systems."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..basics.validation import InputError
from ..kernels.rhs import THROUGH, Equations
from .contact_law import Law, damps, pressure


class Numbers(NamedTuple):
    """Arrays of ``Equations`` for JAX.

    All that is linear stands in one matrix, since JAX takes longer to start a small product than to compute it. Its
    columns are the state, the functions of time and their rates; its rows are the state's rate, position, velocity and
    offset's rate of every contact, and the powers of the loads.
    """

    linear: Any  # (n + 3 m + d, n + 2 d)
    damping: Any  # (n, n), or no rows
    frequencies: Any
    edges: Any
    records: Any  # (edges, R, P)
    pushes: Any
    law: Any
    regime: Any
    window: Any


class Kind(NamedTuple):
    """Constants of a compiled program beside the shapes: the exponent of every contact, and whether stops damp."""

    exponents: tuple[float, ...]
    damped: bool


def numbers_of(e: Equations) -> tuple[Kind, Numbers]:
    """Kind and numbers of a right-hand side, its regime and window those of now.

    Raises InputError for functions of time that JAX cannot trace, and for one with a mass.
    """
    if e.called:
        rule = "be made of Harmonic, Constant and Sampled for JAX"
        raise InputError("time function", "a callable", rule, "use the adaptive solver cvode")
    (m, n), d = e.pushes.shape, len(e.loads)
    linear = np.zeros((n + 3 * m + d, n + 2 * d))
    rate, positions, velocities, offset_rates, power = np.split(linear, np.cumsum([n, m, m, m]))
    rate[:, :n], rate[:, n : n + d] = e.matrix, e.loads.T
    positions[:, :n], positions[:, n : n + d] = e.positions, e.offsets.T
    velocities[:, :n], velocities[:, n + d :] = e.velocities, e.offsets.T
    offset_rates[:, n + d :], power[:, :n] = e.offsets.T, e.power
    kind = Kind(tuple(float(p) for p in e.law[:, 3]), e.damped)
    arrays = (e.frequencies, e.edges, e.records, e.pushes, e.law)
    return kind, Numbers(linear, e.damping, *arrays, e.regime.copy(), e.window.copy())


def functions_of_time(t: Any, numbers: Numbers) -> tuple[Any, Any]:
    """1, sin w_1 t, cos w_1 t, ..., the records, (d,); and their rates."""
    import jax.numpy as jnp

    w = numbers.frequencies
    # Sines and cosines in the order of ``Drive.coefficients``, with their rates.
    s, c = jnp.sin(w * t), jnp.cos(w * t)
    g, rate = jnp.stack([s, c], axis=1).ravel(), jnp.stack([w * c, -w * s], axis=1).ravel()
    values = rates = jnp.zeros(numbers.records.shape[1])
    if numbers.records.size:
        edges = numbers.edges
        inside = jnp.clip(t, numbers.window[0], numbers.window[1])
        # At the end of a window the polynomial before it holds.
        before = jnp.minimum(inside, jnp.nextafter(numbers.window[1], -jnp.inf))
        k = jnp.clip(jnp.searchsorted(edges, before, side="right") - 1, 0, len(edges) - 2)
        tau = inside - edges[k]
        for j in range(numbers.records.shape[2] - 1, -1, -1):  # Horner's scheme
            rates = rates * tau + values
            values = values * tau + numbers.records[k, :, j]
    return jnp.concatenate([jnp.ones(1), g, values]), jnp.concatenate([jnp.zeros(1), rate, rates])


def contact_force(u: Any, v: Any, regime: Any, stop: Law) -> Any:
    """F at a position and velocity relative to the stops, after a regime or the law."""
    import jax.numpy as jnp

    force: Any = 0.0
    # The regime is data, not structure: one compiled program computes both sides and selects.
    for side in (1, -1):
        bound: Any = stop.g2 if side > 0 else stop.g1
        # A side without a stop counts as open, its infinite bound outside the arithmetic.
        there = jnp.isfinite(bound)
        depth = jnp.where(there, side * (u - jnp.where(there, bound, 0.0)), -1.0)
        pressed = pressure(depth, side * v, stop)
        by_law = jnp.where(depth > 0.0, jnp.maximum(0.0, pressed), 0.0)
        force = force - side * jnp.where(regime == THROUGH, by_law, jnp.where(regime == side, pressed, 0.0))
    return force


def rate_with_integrals(kind: Kind, t: Any, z: Any, numbers: Numbers) -> Any:
    """z' of ``RightHandSide``: y' with the rates of the ledger's integrals; of z only its first n entries count."""
    import jax.numpy as jnp

    m, n = numbers.pushes.shape
    y, (g, g_rate) = z[:n], functions_of_time(t, numbers)
    rows = numbers.linear @ jnp.concatenate([y, g, g_rate])
    rate, u, v, offset_rates, power = jnp.split(rows, np.cumsum([n, m, m, m]))
    given, absorbed, pushes = g @ power, 0.0, []
    for c, p in enumerate(kind.exponents):
        stop: Any = Law(*numbers.law[c])
        force = contact_force(u[c], v[c], numbers.regime[c], stop._replace(p=p))  # p is a constant of the program
        rate = rate + numbers.pushes[c] * force
        given = given - force * offset_rates[c]
        absorbed = absorbed - jnp.where(damps(stop), force * v[c], 0.0)
        pushes.append(-force)
    viscous = y @ numbers.damping @ y if numbers.damping.shape[0] else 0.0 * given
    return jnp.concatenate([rate, jnp.stack([given, viscous, *pushes, *([absorbed] if kind.damped else [])])])
