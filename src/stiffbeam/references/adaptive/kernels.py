"""The compiled loops of the right-hand side: the law of contact, side by side with the linear part."""

from __future__ import annotations

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.compiled import compiled
from ...model.contact_law import G1, G2, damps, law_of, law_state, side_force


@compiled
def right_hand_side(
    t: float, z: Array, out: Array, n: int, indptr: IntArray, indices: IntArray, data: Array, damping_indptr: IntArray,
    damping_indices: IntArray, damping_data: Array, basis: Array, power: Array, columns: Array, frequencies: Array,
    rows: Array, velocity_rows: Array, offsets: Array, offset_rates: Array, law: Array, regime: IntArray,
    shifts: Array, shift_rates: Array,
) -> None:  # fmt: skip
    """out = dz/dt: A y with the loads and contact forces of the regime, then the rates of the ledger's integrals."""
    g = np.empty(1 + 2 * frequencies.size)
    g[0] = 1.0
    for k in range(frequencies.size):
        g[1 + 2 * k] = np.sin(frequencies[k] * t)
        g[2 + 2 * k] = np.cos(frequencies[k] * t)
    given = 0.0
    for i in range(n):
        total = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            total += data[k] * z[indices[k]]
        weight = 0.0
        for k in range(g.size):
            total += basis[k, i] * g[k]
            weight += power[k, i] * g[k]
        given += weight * z[i]
        out[i] = total
    taken = 0.0
    for i in range(damping_indptr.size - 1):
        total = 0.0
        for k in range(damping_indptr[i], damping_indptr[i + 1]):
            total += damping_data[k] * z[damping_indices[k]]
        taken += total * z[i]
    absorbed = 0.0
    for c in range(law.shape[0]):
        u = shifts[c]
        rate = shift_rates[c]
        for k in range(g.size):
            u += offsets[k, c] * g[k]
            rate += offset_rates[k, c] * g[k]
        for i in range(n):
            u += rows[c, i] * z[i]
        stop = law_of(law, c)
        damped = damps(stop)
        v = 0.0
        if damped:
            v = rate
            for i in range(n):
                v += velocity_rows[c, i] * z[i]
        chi = regime[c]
        if chi == 2:
            chi = int(law_state(u, v, stop))
        push = 0.0
        if chi != 0:
            force = side_force(u, v, chi, stop)
            for i in range(n):
                out[i] += columns[c, i] * force
            given -= force * rate
            push = -force
            if damped:
                absorbed -= force * v
        out[n + 2 + c] = push
    out[n] = given
    out[n + 1] = taken
    if out.size > n + 2 + law.shape[0]:
        out[n + 2 + law.shape[0]] = absorbed


@compiled
def gaps(
    t: float, z: Array, out: Array, n: int, frequencies: Array, rows: Array, velocity_rows: Array, offsets: Array,
    offset_rates: Array, law: Array, shifts: Array, shift_rates: Array,
) -> None:  # fmt: skip
    """out = (u - g2, g1 - u) of every stop, then their rates; switches are the roots of the first half."""
    half = out.size // 2
    k = 0
    for c in range(law.shape[0]):
        g1, g2 = law[c, G1], law[c, G2]
        u = shifts[c] + offsets[0, c]
        rate = shift_rates[c]
        for f in range(frequencies.size):
            sine, cosine = np.sin(frequencies[f] * t), np.cos(frequencies[f] * t)
            u += offsets[1 + 2 * f, c] * sine + offsets[2 + 2 * f, c] * cosine
            rate += offset_rates[1 + 2 * f, c] * sine + offset_rates[2 + 2 * f, c] * cosine
        for i in range(n):
            u += rows[c, i] * z[i]
            rate += velocity_rows[c, i] * z[i]
        if np.isfinite(g2):
            out[k], out[half + k] = u - g2, rate
            k += 1
        if np.isfinite(g1):
            out[k], out[half + k] = g1 - u, -rate
            k += 1
