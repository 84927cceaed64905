"""``kernels.march.run`` in plain NumPy, a hundred times slower: its oracle.

Written from the definitions (Propagator, sampling), not from the compiled loops: positions of a whole
stretch first, then impacts by array operations.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stiffbeam.basics.arrays import Array
from stiffbeam.kernels.contact import solve_node, solve_stage
from stiffbeam.kernels.march import (
    EVENT,
    LINEAR,
    MEAN,
    OVERFLOW,
    Block,
    Forcing,
    Inflow,
    Kept,
    Marchers,
    switch_time,
)
from stiffbeam.model.contact import Stops
from stiffbeam.model.contact_law import G1, G2, KAPPA, all_laws, damps
from stiffbeam.trajectory.sampling import (
    CONTACT,
    END,
    IMPACT_IMPULSE,
    IMPACT_PEAK,
    IMPULSE,
    LAST,
    MEMBER,
    PEAK,
    ROW,
    SIDE,
    SINCE,
    STOP,
    TIME,
    TOUCHING,
)


def run(
    block: Block, law: Array, forcing: Forcing, inflow: Inflow, marchers: Marchers, kept: Kept, events: Array,
    first: int, steps: int, dt: float, every: int, cursor: Array,
) -> bool:  # fmt: skip
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
            entries, starts, forces, z = _march(block, law[i], given, marchers.z[i], marchers.position[i])
        ends = block.end_first + np.arange(K)[:, None] * block.end_stride
        u = entries[:, ends].reshape(blocks * K, -1)[:steps]
        bad = ~np.all(np.abs(u) < OVERFLOW, axis=1)
        unsolved = np.any(np.isnan(forces), axis=1)
        if np.any(unsolved) or np.any(bad):
            failed = first + int(np.argmax(bad)) + 1
            marchers.diverged[i] = -failed if np.any(unsolved) and not np.any(np.abs(u) >= OVERFLOW) else failed
            for outputs in (kept.positions, kept.velocities):
                outputs[i, first // every + 1 :] = 0.0
            continue

        velocities = partial(_velocities, block, forcing.velocity[v], inflow, starts, forces, g)
        path = np.concatenate([marchers.position[i : i + 1], u])
        damped = np.any(damps(all_laws(law[i])))
        means = np.full((steps, law.shape[1]), np.nan)  # the reactions, where they are means over the steps
        if block.rule == MEAN:
            means = forces[:, : K * law.shape[1]].reshape(blocks * K, -1)[:steps]
        speeds = velocities(np.arange(steps)) if damped else np.zeros((steps, law.shape[1]))
        m = law.shape[1]
        forced = np.full((steps, m), np.nan)  # what the nodes found at the ends of the steps
        if m and block.end_first[0] < forces.shape[1]:
            forced = forces[:, ends[:, :m]].reshape(blocks * K, m)[:steps]
        node_forces = [
            _sample(path[:, c], speeds[:, c], law[i, c], dt, marchers.tally[i, c], first, means[:, c], forced[:, c])
            for c in range(m)
        ]
        if cursor[2] + sum(len(rows) for rows, *_ in node_forces) > len(events):
            cursor[0] = i
            return False

        for c, (rows, tally, left, carried) in enumerate(node_forces):
            see = partial(_switch, path[:, c], velocities, marchers.velocity[i, c], law[i, c], c, dt)
            for row in rows:
                entered, ended = int(row[TIME]), int(row[END])
                row[TIME], row[MEMBER], row[CONTACT] = (first + see(row[STOP], entered)) * dt, i, c
                row[END] = (first + see(row[STOP], ended)) * dt if ended >= 0 else -1.0
            open_before = int(marchers.tally[i, c, ROW])
            if open_before >= 0:  # the impact that was open goes on
                events[open_before, IMPACT_PEAK] = max(events[open_before, IMPACT_PEAK], carried[0])
                events[open_before, IMPACT_IMPULSE] += carried[1]
                if left >= 0:
                    events[open_before, END] = (first + see(events[open_before, STOP], left)) * dt
            events[cursor[2] : cursor[2] + len(rows)] = rows
            if tally[ROW] >= 0:
                tally[ROW] += cursor[2]
            elif tally[SIDE] and not len(rows):
                tally[ROW] = open_before
            marchers.tally[i, c] = tally
            cursor[2] += len(rows)
        if kept.positions.shape[1]:
            n = np.arange(first // every + 1, (first + steps) // every + 1)
            kept.positions[i, n], kept.velocities[i, n] = u[n * every - first - 1], velocities(n * every - first - 1)
            if kept.node_forces.shape[1]:
                kept.node_forces[i, n] = forced[n * every - first - 1]
            if kept.contact_forces.shape[1]:
                here = kept.positions[i, n, :m]
                kept.contact_forces[i, n] = law[i, :, KAPPA] * (np.clip(here, law[i, :, G1], law[i, :, G2]) - here)
            if len(kept.times):
                kept.times[n] = n * every * dt
        if len(kept.starts):
            kept.starts[:], kept.forces[:] = starts, forces
        marchers.z[i], marchers.position[i] = z, u[-1]
        marchers.velocity[i] = velocities(np.array([steps - 1]))[0]
    cursor[0] = 0
    return True


def _switch(
    path: Array, velocities: Callable[[NDArray[np.int64]], Array], v_first: float, law: Array, c: int, dt: float,
    side: float, j: int,
) -> float:  # fmt: skip
    """Where in step j contact c, which moves along the path (steps + 1,), begins or ends on the stop of a side."""
    v0 = velocities(np.array([j - 1]))[0, c] if j > 0 else v_first
    v1 = velocities(np.array([j]))[0, c]
    return j + switch_time(path[j], v0, path[j + 1], v1, side, law, dt)


def _velocities(
    block: Block, driven: Array, inflow: Inflow, starts: Array, forces: Array, g: Array, k: NDArray[np.int64]
) -> Array:
    """(len(k), C) at the ends of the steps k, 0 the first."""
    b, inside = np.divmod(k, len(block.velocity))
    speeds = np.einsum("kd,kcd->kc", starts[b, : block.velocity.shape[2]], block.velocity[inside])
    speeds += np.einsum("kn,kcn->kc", forces[b], block.velocity_push[inside])
    speeds += np.einsum("ke,kce->kc", g[b], driven[inside])
    return speeds + (inflow.velocity[b, inside] if len(inflow.rows) else 0.0)


def _march(block: Block, law: Array, given: Array, z: Array, before: Array) -> tuple[Array, Array, Array, Array]:
    """Entries (B, R), states at the starts (B, ...), forces (B, N) and the state after the last block.

    given: (B, R + D), what loads add to every block. before: (C,), the channels' positions before the first.
    """
    (D, R), a, nodes, m = block.reading.shape, len(block.transition), block.nodes, len(law)
    compliance = block.compliance(m)
    n = (len(z) - D) // max(1, a - 1)
    shifts = np.arange(a)[:, None] * n + np.arange(D)
    g1, g2 = (np.tile(law[:, side], nodes // max(1, m)) for side in (G1, G2))
    entries, starts = np.empty((len(given), R)), np.empty((len(given), len(z)))
    forces = np.zeros((len(given), len(block.push)))
    before = before[:m].copy()
    for b, row in enumerate(np.array(given)):
        row[:R] += z[:D] @ block.reading
        row[R:] += np.sum(block.transition * z[shifts], axis=0)
        if block.rule != LINEAR:
            _by_law(block, law, before, row, forces[b])
        elif np.any((row[:nodes] > g2) | (row[:nodes] < g1)):
            for node in range(0, nodes, m):
                r = row[node : node + m]
                if m > 1:
                    force = solve_node(r, compliance[node : node + m], law)
                    forces[b, node : node + m] = force
                    row += force @ block.push[node : node + m]
                elif force := (np.clip(r[0], g1[0], g2[0]) - r[0]) / (1.0 / law[0, KAPPA] + compliance[node, 0]):
                    forces[b, node] = force
                    row += force * block.push[node]
        entries[b], starts[b] = row[:R], z
        z = np.concatenate([row[R:], np.zeros(len(z) - D)])
        z[a * n : (2 * a - 1) * n] = z[: (a - 1) * n]
    return entries, starts, forces, z


def _by_law(block: Block, law: Array, before: Array, row: Array, forces: Array) -> None:
    """The forces of a block under any law, node by node; ``row`` and ``before`` go along."""
    nodes, m, rates, compliance = block.nodes, len(law), block.rates, block.compliance(len(law))
    for node in range(0, nodes, m):
        here = np.arange(node, node + m)
        inside = (row[here] > law[:, G2]) | (row[here] < law[:, G1])
        if block.rule == MEAN:
            inside |= (before > law[:, G2]) | (before < law[:, G1])
        if np.any(inside):
            rate, S_rate = np.zeros(m), np.zeros((m, m))
            if len(rates):
                rate, S_rate = row[rates[here]], block.push[np.ix_(here, rates[here])].T
            S = compliance[here].T
            forces[here] = solve_stage(row[here], rate, S, S_rate, before, block.rule, law)
            row += forces[here] @ block.push[here]
        before[:] = row[here]


def _sample(
    path: Array, v: Array, law: Array, dt: float, before: Array, first: int, means: Array, node_forces: Array
) -> tuple[Array, Array, int, tuple[float, float]]:
    """The impacts that begin in u_1.. of ``path`` (steps + 1,) as rows of events, the tally after, the step in
    which the impact that was open before ends, or -1, and what of peak and impulse belongs to that one.

    first: the step of path[0]. TIME and END hold the step, ROW the row of the open one among these or -1. found: the
    forces of nodes at the ends of the steps, NaN for none.
    """
    stops, u = Stops.of_law(law), path[1:]
    chi, force = stops.state(u, v) * 1.0, stops.force(u, v)
    if stops.jumps and np.all(np.isfinite(node_forces)):  # on the stop the state does not tell the force
        chi, force = -np.sign(node_forces), node_forces
    last, counted = force[-1], first + np.arange(len(u)) >= before[SINCE]
    force = np.where(counted, np.abs(force), 0.0)
    pushed = np.where(counted, np.abs(means), 0.0) if np.all(np.isfinite(means)) else force  # what impulses are of
    edges = np.flatnonzero(np.diff(np.concatenate([[before[SIDE]], chi])))  # chi changes with these steps
    spans = np.concatenate([[0], edges, [len(u)]])
    begun = edges[(chi[edges] != 0.0) & counted[edges]]
    rows = np.zeros((len(begun), EVENT))
    ends = spans[np.searchsorted(spans, begun, side="right")]
    rows[:, TIME], rows[:, STOP], rows[:, END] = begun, chi[begun], np.where(ends < len(u), ends, -1)
    for row, start, end in zip(rows, begun, ends, strict=True):
        # A mean reaction is also there in the step in which the contact ends.
        until = end + 1 if pushed is not force and end < len(u) and chi[end] == 0.0 else end
        row[IMPACT_PEAK], row[IMPACT_IMPULSE] = np.max(force[start:end]), np.sum(pushed[start:until]) * dt
    tally = before.copy()
    tally[SIDE] = chi[-1]
    tally[TOUCHING] += np.count_nonzero(chi[counted])
    tally[PEAK], tally[IMPULSE] = max(before[PEAK], np.max(force)), before[IMPULSE] + np.sum(pushed) * dt
    tally[LAST] = 0.0 if stops.linear or np.all(np.isfinite(means)) else np.abs(last)
    tally[ROW] = len(rows) - 1 if chi[-1] and len(rows) else -1.0
    carried = spans[1]  # the steps of the impact open before, where there is one
    ends_open = pushed is not force and carried < len(u) and chi[carried] == 0.0
    before_it = float(np.max(force[:carried], initial=0.0)), float(np.sum(pushed[: carried + ends_open]) * dt)
    return rows, tally, int(edges[0]) if len(edges) else -1, before_it
