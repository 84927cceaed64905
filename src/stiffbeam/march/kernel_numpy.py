"""``kernel.run`` in plain NumPy: its oracle in the tests, and its stand-in while nothing is compiled.

Written from the definitions (Propagator, sampling), not from the compiled loops: positions of a whole
stretch first, then impacts by array operations.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..active_set import solve_node
from ..arrays import Array
from ..sampling import (
    CONTACT,
    EVENT,
    IMPACT_IMPULSE,
    IMPACT_PEAK,
    IMPULSE,
    MEMBER,
    PEAK,
    ROW,
    SIDE,
    SINCE,
    STOP,
    TIME,
    TOUCHING,
    first_crossing,
)
from .layout import OVERFLOW, Block, Forcing, Inflow, Kept, Marchers


def run(
    block: Block,
    law: Array,
    forcing: Forcing,
    inflow: Inflow,
    marchers: Marchers,
    kept: Kept,
    events: Array,
    first: int,
    steps: int,
    dt: float,
    every: int,
    cursor: Array,
) -> bool:
    """See ``kernel.run``."""
    K = block.velocity.shape[0]
    blocks = -(-steps // K)
    t = (first + K * np.arange(blocks)) * dt
    for i in range(cursor[0], len(marchers.z)):
        if marchers.diverged[i]:
            continue
        v = min(i, len(forcing.rows) - 1)
        phase = np.multiply.outer(t, forcing.frequencies[v])
        g = np.full((blocks, forcing.rows.shape[1]), forcing.constant)
        g[:, 1::2], g[:, 2::2] = np.sin(phase), np.cos(phase)
        # Not as a matrix product, whose rounding depends on the number of blocks.
        given = inflow.rows if len(inflow.rows) else np.zeros((blocks, forcing.rows.shape[2]))
        for e in range(g.shape[1]):
            given = given + np.multiply.outer(g[:, e], forcing.rows[v, e])
        with np.errstate(over="ignore", invalid="ignore"):  # an overflow is found below
            entries, starts, forces, z = _march(block, law[i], given, marchers.z[i])
        ends = block.end_first + np.arange(K)[:, None] * block.end_stride
        u = entries[:, ends].reshape(blocks * K, -1)[:steps]
        bad = ~np.all(np.abs(u) < OVERFLOW, axis=1)
        if np.any(bad):
            marchers.diverged[i] = first + int(np.argmax(bad)) + 1
            continue

        velocities = partial(_velocities, block, forcing.velocity[v], inflow, starts, forces, g)
        path = np.concatenate([marchers.position[i : i + 1], u])
        found = [_sample(path[:, c], law[i, c], dt, marchers.tally[i, c], first) for c in range(law.shape[1])]
        if cursor[2] + sum(len(rows) for rows, _ in found) > len(events):
            cursor[0] = i
            return False
        for c, (rows, tally) in enumerate(found):
            k = rows[:, TIME].astype(int)
            after, before = velocities(k)[:, c], velocities(np.maximum(k - 1, 0))[:, c]
            before = np.where(k > 0, before, marchers.velocity[i, c])
            for row, j, v0, v1 in zip(rows, k, before, after, strict=True):
                sign = row[STOP]
                gap = sign * ((law[i, c, 2] if sign > 0 else law[i, c, 1]) - path[j : j + 2, c])
                inside = first_crossing.py_func(gap[0], -sign * v0 * dt, gap[1], -sign * v1 * dt)
                row[TIME], row[MEMBER], row[CONTACT] = (first + j + inside) * dt, i, c
            open_before = int(marchers.tally[i, c, ROW])
            if open_before >= 0:  # the impact that was open goes on
                events[open_before, IMPACT_PEAK] = max(events[open_before, IMPACT_PEAK], tally[-2])
                events[open_before, IMPACT_IMPULSE] += tally[-1]
            events[cursor[2] : cursor[2] + len(rows)] = rows
            if tally[ROW] >= 0:
                tally[ROW] += cursor[2]
            elif tally[SIDE] and not len(rows):
                tally[ROW] = open_before
            marchers.tally[i, c], marchers.tally[i, c, 6:] = tally, 0.0
            cursor[2] += len(rows)
        if kept.positions.shape[1]:
            n = np.arange(first // every + 1, (first + steps) // every + 1)
            kept.positions[i, n], kept.velocities[i, n] = u[n * every - first - 1], velocities(n * every - first - 1)
        if len(kept.starts):
            kept.starts[:], kept.forces[:] = starts, forces
        marchers.z[i], marchers.position[i] = z, u[-1]
        marchers.velocity[i] = velocities(np.array([steps - 1]))[0]
    cursor[0] = 0
    return True


def _velocities(
    block: Block, driven: Array, inflow: Inflow, starts: Array, forces: Array, g: Array, k: NDArray[np.int64]
) -> Array:
    """(len(k), C) at the ends of the steps k, 0 the first."""
    b, inside = np.divmod(k, len(block.velocity))
    speeds = np.einsum("kd,kcd->kc", starts[b, : block.velocity.shape[2]], block.velocity[inside])
    speeds += np.einsum("kn,kcn->kc", forces[b], block.velocity_push[inside])
    speeds += np.einsum("ke,kce->kc", g[b], driven[inside])
    return speeds + (inflow.velocity[b, inside] if len(inflow.rows) else 0.0)


def _march(block: Block, law: Array, given: Array, z: Array) -> tuple[Array, Array, Array, Array]:
    """Entries (B, R), states at the starts (B, ...), forces (B, N) and the state after the last block.

    given: (B, R + D), what loads add to every block.
    """
    R, D = block.reading.shape
    a, (nodes, m) = len(block.transition), block.compliance.shape
    n = (len(z) - D) // max(1, a - 1)
    shifts = np.arange(a)[:, None] * n + np.arange(D)
    stiff = law[0, 0] / (1.0 + law[0, 0] * block.compliance[:, 0]) if m == 1 else np.zeros(0)
    g1, g2 = np.tile(law[:, 1], nodes // max(1, m)), np.tile(law[:, 2], nodes // max(1, m))
    entries, starts = np.empty((len(given), R)), np.empty((len(given), len(z)))
    forces = np.zeros((len(given), len(block.push)))
    for b, row in enumerate(np.array(given)):
        row[:R] += block.reading @ z[:D]
        row[R:] += np.sum(block.transition * z[shifts], axis=0)
        if np.any((row[:nodes] > g2) | (row[:nodes] < g1)):
            for node in range(0, nodes, m):
                r = row[node : node + m]
                if m > 1:
                    force = solve_node.py_func(r, block.compliance[node : node + m], *law.T)
                    forces[b, node : node + m] = force
                    row += force @ block.push[node : node + m]
                elif not g1[0] <= r[0] <= g2[0]:
                    forces[b, node] = stiff[node] * ((g2[0] if r[0] > g2[0] else g1[0]) - r[0])
                    row += forces[b, node] * block.push[node]
        entries[b], starts[b] = row[:R], z
        z = np.concatenate([row[R:], np.zeros(len(z) - D)])
        z[a * n : (2 * a - 1) * n] = z[: (a - 1) * n]
    return entries, starts, forces, z


def _sample(path: Array, law: Array, dt: float, before: Array, first: int) -> tuple[Array, Array]:
    """The impacts that begin in u_1.. of ``path`` (steps + 1,) as rows of events, and the tally after.

    first: the step of path[0]. TIME holds the step, ROW the row of the open one among these or -1; the
    last two numbers of the tally are peak and impulse that belong to the impact that was open before.
    """
    kappa, g1, g2 = law
    u = path[1:]
    chi = (u > g2) * 1.0 - (u < g1) * 1.0
    counted = first + np.arange(len(u)) >= before[SINCE]
    force = np.where(counted, kappa * np.abs(u - np.clip(u, g1, g2)), 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[before[SIDE]], chi])))  # chi changes with these steps
    spans = np.concatenate([[0], edges, [len(u)]])
    begun = edges[(chi[edges] != 0.0) & counted[edges]]
    rows = np.zeros((len(begun), EVENT))
    ends = spans[np.searchsorted(spans, begun, side="right")]
    rows[:, TIME], rows[:, STOP] = begun, chi[begun]
    for row, start, end in zip(rows, begun, ends, strict=True):
        row[IMPACT_PEAK], row[IMPACT_IMPULSE] = np.max(force[start:end]), np.sum(force[start:end]) * dt
    tally = before.copy()
    tally[SIDE] = chi[-1]
    tally[TOUCHING] += np.count_nonzero(chi[counted])
    tally[PEAK], tally[IMPULSE] = max(before[PEAK], np.max(force)), before[IMPULSE] + np.sum(force) * dt
    tally[ROW] = len(rows) - 1 if chi[-1] and len(rows) else -1.0
    carried = force[: spans[1]]  # of the impact open before, where there is one
    tally[-2:] = (np.max(carried, initial=0.0), np.sum(carried) * dt)
    return rows, tally
