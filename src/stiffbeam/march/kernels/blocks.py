"""The compiled march: members of an ensemble one after another, each in blocks of K steps.

A run is an ensemble of one and ``run`` is the only entry, so a member has the bits of its solo run.
Loop shapes matter here: eight rows at a time, dotted or added, and no loop that is shorter than it
need be. That is what the padding to eight is for.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.compiled import compiled, inlined
from ...model.contact_law import G1, G2, KAPPA, law_of, stage_force, stage_stiffness, state
from ...model.stage import MEAN, solve_node, solve_stage
from ...trajectory.sampling import (
    CONTACT,
    END,
    MEMBER,
    ROW,
    SIDE,
    STOP,
    TIME,
    scan,
    scan_by_law,
    switch_time,
)

# A position beyond this ends the run. Its square, in an energy, is still a float64.
OVERFLOW = 1e100


class Block(NamedTuple):
    """K steps as one linear map, see Propagator; the same for every member.

    N force nodes, R entries (the nodes first) and D state components, each padded to eight with zeros;
    C channels. A row of R + D numbers acts on the entries and on the new state together. A state of a
    components and n modes is held as z (D + (a - 1) n,), component by component and from the start
    again, so that z[e n + d] is what is e components after z[d].
    """

    reading: Array  # (R, D)
    transition: Array  # (a, D): z_new[d] = sum_e transition[e, d] z[e n + d]
    push: Array  # (N, R + D)
    compliance: Array  # (K S m, m): of the contacts of a node on each other
    end_first: Array  # (C,) integers: the entry that holds a channel at the end of the first step,
    end_stride: Array  # (C,) and how many entries later the next one is
    velocity: Array  # (K, C, D): the channels' velocities at the ends of the steps
    velocity_push: Array  # (K, C, N)
    rates: Array  # (N,) integers: the entry that holds the velocity at a node; none where no force depends on it
    rule: int  # how a node finds its force, see stage


class Forcing(NamedTuple):
    """Response of a block to the drive g = (1, sin w1 t, cos w1 t, ...) at its start; V = 1 or one per member."""

    constant: float  # 1, or 0 where nothing is constant in time
    frequencies: Array  # (V, F)
    rows: Array  # (V, d, R + D)
    velocity: Array  # (V, K, C, d)


class Inflow(NamedTuple):
    """Share of sampled loads and offsets in the blocks of a range of steps; no rows without any."""

    rows: Array  # (B, R + D)
    velocity: Array  # (B, K, C)


class Marchers(NamedTuple):
    """State of all ensemble members and their contact statistics. Updated in place."""

    z: Array  # (M, D + (a - 1) n)
    position: Array  # (M, C) at the last step
    velocity: Array  # (M, C)
    tally: Array  # (M, m, 8), see sampling
    diverged: Array  # (M,) integers: the step that overflowed, 0 for none


class Kept(NamedTuple):
    """Output buffers for a range of steps. An empty array disables that output."""

    times: Array  # (outputs,)
    positions: Array  # (M, outputs, C) at every ``every``-th step
    velocities: Array  # (M, outputs, C)
    node_forces: Array  # (M, outputs, m): the forces that nodes found, NaN where the end of a step is no node
    contact_forces: Array  # (M, outputs, m): the forces of linear stops
    starts: Array  # (B, D + (a - 1) n): the state of the only member at the start of each block
    forces: Array  # (B, N)


@compiled
def resolve_several(push: Array, compliance: Array, law: Array, out: Array, forces: Array) -> bool:
    """Forces of the stops of m contacts, the m entries of a node together. Returns True if any stop is touched.

    Where one is met alone, and the force on it leaves the others open, that is all; else see ``solve_node``.
    """
    m = law.shape[0]
    met = False
    # Node after node: the force at one moves the positions at all later ones.
    for first in range(0, compliance.shape[0], m):
        beyond, last = 0, 0
        for c in range(m):
            forces[first + c] = 0.0
            if state(out[first + c], law[c, G1], law[c, G2]) != 0.0:
                beyond, last = beyond + 1, c
        if beyond == 0:
            continue
        met = True
        i = first + last
        # Most contacts are met one at a time. The closed form of a single contact then solves the node, unless its
        # force closes another one.
        stiff = stage_stiffness(law[last, KAPPA], compliance[i, last])
        force = stage_force(out[i], stiff, law[last, G1], law[last, G2])
        alone = beyond == 1
        for c in range(m):
            if c != last:
                u = out[first + c] + force * compliance[i, c]
                alone = alone and state(u, law[c, G1], law[c, G2]) == 0.0
        if alone:
            forces[i] = force
            for j in range(np.uint64(first), np.uint64(out.size)):
                out[j] += force * push[i, j]
        else:
            # The contacts move each other within the node. Which of them press is a complementarity problem.
            together = solve_node(out[first : first + m], compliance[first : first + m], law)
            for c in range(m):
                forces[first + c] = together[c]
                if together[c] != 0.0:
                    for j in range(np.uint64(first), np.uint64(out.size)):
                        out[j] += together[c] * push[first + c, j]
    return met


@compiled
def resolve_by_law(
    push: Array, compliance: Array, rates: IntArray, rule: int, law: Array, before: Array, out: Array,
    forces: Array,
) -> int:  # fmt: skip
    """The stops under any law, node by node; ``before`` (m,): the positions one node ago, advanced in place.

    0 where none is met, 1 where one is, -1 - i where the forces of node i were not found.
    """
    m = law.shape[0]
    rated = rates.size > 0
    r, w, S, S_rate = np.zeros(m), np.zeros(m), np.zeros((m, m)), np.zeros((m, m))
    met = 0
    for first in range(0, compliance.shape[0], m):
        # A node is left out only if no force can act at it. The mean over a step depends on both of its ends.
        touched = False
        for c in range(m):
            u = out[first + c]
            forces[first + c] = 0.0
            touched = touched or state(u, law[c, G1], law[c, G2]) != 0.0
            touched = touched or (rule == MEAN and state(before[c], law[c, G1], law[c, G2]) != 0.0)
        if touched:
            met = 1
            for c in range(m):
                r[c] = out[first + c]
                w[c] = out[rates[first + c]] if rated else 0.0
                for e in range(m):
                    S[c, e] = compliance[first + e, c]
                    S_rate[c, e] = push[first + e, rates[first + c]] if rated else 0.0
            force = solve_stage(r, w, S, S_rate, before, rule, law)
            for c in range(m):
                # The iteration failed. If the position itself is NaN, `run` reports an overflow.
                if math.isnan(force[c]) and not math.isnan(r[c]):
                    return -1 - first
                forces[first + c] = force[c]
                if force[c] != 0.0:
                    for j in range(out.size):
                        out[j] += force[c] * push[first + c, j]
        for c in range(m):
            before[c] = out[first + c]
    return met


@inlined
def read(reading: Array, z: Array, w: Array) -> None:
    """w = reading z."""
    R, D = reading.shape
    for r in range(0, R, 8):
        s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
        for d in range(D):
            x = z[d]
            s0 += x * reading[r, d]
            s1 += x * reading[r + 1, d]
            s2 += x * reading[r + 2, d]
            s3 += x * reading[r + 3, d]
            s4 += x * reading[r + 4, d]
            s5 += x * reading[r + 5, d]
            s6 += x * reading[r + 6, d]
            s7 += x * reading[r + 7, d]
        w[r] = s0
        w[r + 1] = s1
        w[r + 2] = s2
        w[r + 3] = s3
        w[r + 4] = s4
        w[r + 5] = s5
        w[r + 6] = s6
        w[r + 7] = s7


@inlined
def speed(
    velocity: Array, velocity_push: Array, forced: Array, inflow: Array, v: int, b: int, k: int, c: int, z: Array,
    g: Array, forces: Array,
) -> float:  # fmt: skip
    """The velocity of channel c at the end of step k of a block."""
    total = 0.0
    for d in range(velocity.shape[2]):
        total += z[d] * velocity[k, c, d]
    for i in range(forces.size):
        total += forces[i] * velocity_push[k, c, i]
    for e in range(g.size):
        total += g[e] * forced[v, k, c, e]
    if inflow.shape[0]:
        total += inflow[b, k, c]
    return total


@inlined
def keep_speeds(
    effects: Array, x: Array, pressed: bool, base: int, per_step: int, inflow: Array, blocks: IntArray, waiting: int,
    i: int, first: int, steps: int, every: int, speeds: Array, velocities: Array,
) -> None:  # fmt: skip
    """Write the velocities of member i at the outputs in up to four ``blocks``, as many as are ``waiting``.

    x (4, W): state and drive of each, ``base`` numbers, then its forces, ``per_step`` of each step. effects (C, K, W):
    what velocities read of x. It takes longer to load than to multiply: four blocks share it. speeds: memory, (4, K).
    """
    C, K, W = effects.shape
    low, high = 0, K
    if waiting == 1:  # from its first output to its last
        at = first + blocks[0] * K
        low = every - 1 - at % every
        high = low + (min(K, steps - blocks[0] * K) - 1 - low) // every * every + 1
    for c in range(C):
        for k in range(low, high, 2):
            after = min(k + 1, K - 1)
            # No force moves a step before its own.
            length = np.uint64(min(W, base + 8 * (((after + 1) * per_step + 7) // 8)) if pressed else base)
            s0 = s1 = s2 = s3 = t0 = t1 = t2 = t3 = 0.0
            for w in range(length):
                one, two = effects[c, k, w], effects[c, after, w]
                s0 += x[0, w] * one
                t0 += x[0, w] * two
                s1 += x[1, w] * one
                t1 += x[1, w] * two
                s2 += x[2, w] * one
                t2 += x[2, w] * two
                s3 += x[3, w] * one
                t3 += x[3, w] * two
            speeds[0, k], speeds[1, k], speeds[2, k], speeds[3, k] = s0, s1, s2, s3
            speeds[0, after], speeds[1, after], speeds[2, after], speeds[3, after] = t0, t1, t2, t3
        for j in range(waiting):
            b, at = blocks[j], first + blocks[j] * K
            if inflow.shape[0]:
                for k in range(low, high):
                    speeds[j, k] += inflow[b, k, c]
            o = np.uint64(at // every + 1)
            for k in range(np.uint64(every - 1 - at % every), np.uint64(min(K, steps - b * K)), np.uint64(every)):
                velocities[i, o, c] = speeds[j, k]
                o += np.uint64(1)


@inlined
def advance(transition: Array, n: int, z: Array, z_new: Array) -> None:
    """z_new = transition z, the first D numbers of it."""
    a, D = transition.shape
    for d in range(D):
        z_new[d] = transition[0, d] * z[d]
    for e in range(1, a):
        shift = np.uint64(e * n)  # unsigned: no vector code for indices that might be counted from the end
        for d in range(np.uint64(D)):
            z_new[d] += transition[e, d] * z[shift + d]


@inlined
def force_by_drive(constant: float, frequencies: Array, rows: Array, v: int, t: float, g: Array, out: Array) -> None:
    """g (d,) at time t, and out += g rows[v]."""
    g[0] = constant
    if constant != 0.0:
        for j in range(out.size):
            out[j] += constant * rows[v, 0, j]
    for f in range(frequencies.shape[1]):
        phase = frequencies[v, f] * t
        s, c = math.sin(phase), math.cos(phase)
        g[1 + 2 * f], g[2 + 2 * f] = s, c
        for j in range(out.size):
            out[j] += s * rows[v, 1 + 2 * f, j] + c * rows[v, 2 + 2 * f, j]


@inlined
def add_eight(force: Array, first: int, rows: Array, out: Array) -> None:
    """out += force[first : first + 8] @ rows[first : first + 8] beyond the eight entries of these forces."""
    f0, f1, f2, f3 = force[first], force[first + 1], force[first + 2], force[first + 3]
    f4, f5, f6, f7 = force[first + 4], force[first + 5], force[first + 6], force[first + 7]
    for j in range(np.uint64(first + 8), np.uint64(out.size)):
        out[j] += (
            f0 * rows[first, j]
            + f1 * rows[first + 1, j]
            + f2 * rows[first + 2, j]
            + f3 * rows[first + 3, j]
            + f4 * rows[first + 4, j]
            + f5 * rows[first + 5, j]
            + f6 * rows[first + 6, j]
            + f7 * rows[first + 7, j]
        )


@inlined
def stop_eight(i: int, push: Array, g1: float, g2: float, stiff: Array, w: Array, forces: Array) -> None:
    """The forces of eight nodes, each pushing the later ones; their entries as far as these push."""
    a, b, c, d, e, f, g, h = i, i + 1, i + 2, i + 3, i + 4, i + 5, i + 6, i + 7
    r0 = w[a]
    f0 = stage_force(r0, stiff[a], g1, g2)
    r1 = w[b] + f0 * push[a, b]
    f1 = stage_force(r1, stiff[b], g1, g2)
    r2 = w[c] + f0 * push[a, c] + f1 * push[b, c]
    f2 = stage_force(r2, stiff[c], g1, g2)
    r3 = w[d] + f0 * push[a, d] + f1 * push[b, d] + f2 * push[c, d]
    f3 = stage_force(r3, stiff[d], g1, g2)
    r4 = w[e] + f0 * push[a, e] + f1 * push[b, e] + f2 * push[c, e] + f3 * push[d, e]
    f4 = stage_force(r4, stiff[e], g1, g2)
    r5 = w[f] + f0 * push[a, f] + f1 * push[b, f] + f2 * push[c, f] + f3 * push[d, f] + f4 * push[e, f]
    f5 = stage_force(r5, stiff[f], g1, g2)
    r6 = (
        w[g] + f0 * push[a, g] + f1 * push[b, g] + f2 * push[c, g] + f3 * push[d, g] + f4 * push[e, g] + f5 * push[f, g]
    )
    f6 = stage_force(r6, stiff[g], g1, g2)
    r7 = (
        w[h] + f0 * push[a, h] + f1 * push[b, h] + f2 * push[c, h] + f3 * push[d, h] + f4 * push[e, h] + f5 * push[f, h]
    ) + f6 * push[g, h]
    f7 = stage_force(r7, stiff[h], g1, g2)
    forces[a], forces[b], forces[c], forces[d] = f0, f1, f2, f3
    forces[e], forces[f], forces[g], forces[h] = f4, f5, f6, f7
    w[a], w[b], w[c], w[d] = r0 + f0 * push[a, a], r1 + f1 * push[b, b], r2 + f2 * push[c, c], r3 + f3 * push[d, d]
    w[e], w[f], w[g], w[h] = r4 + f4 * push[e, e], r5 + f5 * push[f, f], r6 + f6 * push[g, g], r7 + f7 * push[h, h]


@inlined
def stage_stiffnesses(compliance: Array, kappa: float, stiff: Array) -> None:
    """Stage stiffness of every node of one contact, 0 for padding."""
    for i in range(stiff.size):
        stiff[i] = 0.0
    for i in range(compliance.shape[0]):
        stiff[i] = stage_stiffness(kappa, compliance[i, 0])


@inlined
def resolve(push: Array, g1: float, g2: float, stiff: Array, out: Array, forces: Array) -> bool:
    """Forces of the stops of one contact, node by node: eight push each other, then all that follow. Returns True if a
    stop is touched."""
    touched = False
    for first in range(0, forces.size, 8):
        # Contacts are rare: comparisons without a branch decide whether any of eight forces is needed.
        beyond = 0
        for i in range(first, first + 8):
            beyond += (out[i] > g2) | (out[i] < g1)
            forces[i] = 0.0
        if beyond:
            stop_eight(first, push, g1, g2, stiff, out, forces)
            add_eight(forces, first, push, out)
            touched = True
    return touched


@compiled
def run(
    block: Block, law: Array, forcing: Forcing, inflow: Inflow, marchers: Marchers, kept: Kept, events: Array,
    first: int, steps: int, dt: float, every: int, cursor: IntArray, linear: int | None = 1,
    by_law: int | None = None,
) -> bool:  # fmt: skip
    """Compute ``steps`` steps of every member from step ``first``. Returns True if all are done.

    law: (M, m, 6), the laws of every contact, see contact_law. events: the list of impacts, see sampling.
    cursor: (member, block, free row of events), advanced in place; where the list may not hold another
    block's impacts, False is returned and the call can be made again with a longer one. linear, by_law: 1 and None for
    a block of rule LINEAR, None and 1 for the others: numba leaves out what stands behind an argument that is None.
    """
    # Fields are taken out once: every use of one would be counted, and no loop with it vectorised.
    reading, transition, push, compliance = block[:4]
    end_first, end_stride, velocity, velocity_push, rates, rule = block[4:]
    constant, frequencies, forced, forced_velocity = forcing
    inflow_rows, inflow_velocity = inflow
    states, position, last_velocity, tally, diverged = marchers
    times, positions, velocities, node_forces, contact_forces, starts, all_forces = kept
    (R, D), a, N, m = reading.shape, transition.shape[0], push.shape[0], law.shape[1]
    K, C = velocity.shape[0], velocity.shape[1]
    n = (states.shape[1] - D) // max(1, a - 1)
    z, out, forces, g = np.empty(states.shape[1]), np.empty(R + D), np.zeros(N), np.empty(forced.shape[1])
    z_new = out[R:]
    z_last, g_last, forces_last = np.empty(D), np.empty(g.size), np.empty(N)
    u, v_all, f_all, stiff, before = np.empty(K), np.empty(K), np.full(K, np.nan), np.empty(N), np.empty(m)
    blocks = (steps + K - 1) // K
    # Velocities at outputs are computed for several blocks at once, see ``keep_speeds``.
    wanted = K if positions.shape[1] else 0
    used, per_step = a * n if a > 1 else D, compliance.shape[0] // K
    base = 8 * ((used + g.size + 7) // 8)
    several = 4 if every < 8 else 1
    effects, x = np.zeros((C, wanted, base + N)), np.zeros((4, base + N))
    speeds, of_block = np.empty((4, K)), np.zeros(4, np.int64)
    for c in range(C):
        for k in range(wanted):
            for d in range(used):
                effects[c, k, d] = velocity[k, c, d]
            for e in range(N):
                effects[c, k, base + e] = velocity_push[k, c, e]
    rows = cursor[2]
    for i in range(cursor[0], states.shape[0]):
        # A member that overflowed stays where it is; the others go on.
        if diverged[i] != 0:
            cursor[1] = 0
            continue
        v = min(i, forced.shape[0] - 1)
        g1 = g2 = 0.0
        if m == 1:
            stage_stiffnesses(compliance, law[i, 0, KAPPA], stiff)
            g1, g2 = law[i, 0, G1], law[i, 0, G2]
        for e in range(z.size):
            z[e] = states[i, e]
        for c in range(C):
            for k in range(wanted):
                for e in range(g.size):
                    effects[c, k, used + e] = forced_velocity[v, k, c, e]
        waiting, pressed = 0, False
        resumed = cursor[1]
        at = count = 0
        full = ended = False
        for b in range(resumed, blocks + 1):
            # Every contact may close at every step of a block. A kernel cannot lengthen the list: the caller does, and
            # calls again from this block on.
            if b < blocks and not ended and rows + m * K > events.shape[0]:
                full = True
                cursor[1] = b
            ended = ended or full or b == blocks
            if waiting == several or (ended and waiting > 0):
                keep_speeds(
                    effects, x, pressed, base, per_step, inflow_velocity, of_block, waiting, i, first, steps, every,
                    speeds, velocities,
                )  # fmt: skip
                waiting, pressed = 0, False
            if ended:
                break
            at = first + b * K
            count = min(K, steps - b * K)
            # The block without contact forces: positions at all nodes, and the state at its end.
            read(reading, z, out)
            advance(transition, n, z, z_new)
            force_by_drive(constant, frequencies, forced, v, at * dt, g, out)
            if inflow_rows.shape[0]:
                for j in range(out.size):
                    out[j] += inflow_rows[b, j]
            touched = True
            # Then the forces of the stops, each of which moves what comes after it.
            if linear is not None:
                if m == 1:
                    touched = resolve(push, g1, g2, stiff, out, forces)
                elif m > 1:
                    touched = resolve_several(push, compliance, law[i], out, forces)
            if by_law is not None:
                for c in range(m):
                    before[c] = position[i, c]
                solved = resolve_by_law(push, compliance, rates, rule, law[i], before, out, forces)
                touched = solved != 0
                if solved < 0:
                    diverged[i] = -(at + (-1 - solved) * K // compliance.shape[0] + 1)
                    break
            # The energy balance repeats the steps from these states and forces.
            if starts.shape[0]:
                for e in range(z.size):
                    starts[b, e] = z[e]
                for e in range(N):
                    all_forces[b, e] = forces[e]
            # Overflow, outputs and impacts of every channel; the first m channels are the contacts.
            for c in range(C):
                entry, stride = np.uint64(end_first[c]), np.uint64(end_stride[c])
                u_end = out[entry + np.uint64(count - 1) * stride]
                if not abs(u_end) < OVERFLOW:
                    # So far only the end of the block was looked at. Which step was the first beyond the bound?
                    for k in range(count - 1, -1, -1):
                        if not abs(out[end_first[c] + k * end_stride[c]]) < OVERFLOW:
                            diverged[i] = at + k + 1
                    ended = True
                    break
                if wanted:
                    o, outputs = np.uint64(at // every + 1), np.uint64((at + count) // every - at // every)
                    k, apart = entry + np.uint64(every - 1 - at % every) * stride, np.uint64(every) * stride
                    for j in range(outputs):
                        positions[i, o + j, c] = out[k + j * apart]
                    if times.size and c == 0:
                        for j in range(outputs):
                            times[o + j] = float((o + j) * np.uint64(every)) * dt
                    if node_forces.shape[1] and c < m and end_first[c] < N:
                        for j in range(outputs):
                            node_forces[i, o + j, c] = forces[k + j * apart]
                    if contact_forces.shape[1] and c < m:
                        kappa, low, high = law[i, c, KAPPA], law[i, c, G1], law[i, c, G2]
                        for j in range(outputs):
                            here = out[k + j * apart]
                            contact_forces[i, o + j, c] = kappa * (min(max(here, low), high) - here)
                # What is not at a node may be beyond a stop although no node is.
                if c < m and (touched or tally[i, c, SIDE] != 0.0 or end_first[c] >= N):
                    for k in range(np.uint64(count)):
                        u[k] = out[entry + k * stride]
                    opened = int(tally[i, c, ROW])
                    new = rows
                    if linear is not None:
                        new = scan(u, count, law, dt, tally, i, c, events, rows, at)
                    if by_law is not None:
                        if rule == MEAN:
                            for k in range(count):
                                v_all[k] = forces[k * m + c]
                            new = scan_by_law(u, v_all, v_all, True, count, law, dt, tally, i, c, events, rows, at)
                        else:
                            for k in range(count):
                                v_all[k] = speed(
                                    velocity, velocity_push, forced_velocity, inflow_velocity, v, b, k, c, z, g, forces
                                )
                                if end_first[c] < N:
                                    f_all[k] = forces[entry + k * stride]
                            new = scan_by_law(u, v_all, f_all, False, count, law, dt, tally, i, c, events, rows, at)
                    # The end of the impact that was open before, then times and ends of the new ones.
                    for change in range(2 * rows - 1, 2 * new):
                        row, column = change // 2, END if change % 2 else TIME
                        if row < rows:
                            row = opened
                        k = int(events[row, column]) if row >= 0 else -1
                        if k < 0:
                            continue
                        # The crossing lies between the steps k - 1 and k; their positions and velocities give its time.
                        # The step before a block belongs to the block before, or to the call before.
                        u0 = u[k - 1] if k > 0 else position[i, c]
                        if k > 0:
                            v0 = speed(
                                velocity, velocity_push, forced_velocity, inflow_velocity, v, b, k - 1, c, z, g, forces
                            )
                        elif b > resumed:
                            v0 = speed(
                                velocity, velocity_push, forced_velocity, inflow_velocity, v, b - 1, K - 1, c,
                                z_last, g_last, forces_last,
                            )  # fmt: skip
                        else:
                            v0 = last_velocity[i, c]
                        v1 = speed(velocity, velocity_push, forced_velocity, inflow_velocity, v, b, k, c, z, g, forces)
                        inside = switch_time(u0, v0, u[k], v1, events[row, STOP], law_of(law[i], c), dt)
                        events[row, column] = (at + k + inside) * dt
                        events[row, MEMBER] = i
                        events[row, CONTACT] = c
                    rows = new
                position[i, c] = u_end
            if ended:
                continue
            if wanted and at // every != (at + count) // every:
                for e in range(used):
                    x[waiting, e] = z[e]
                for e in range(g.size):
                    x[waiting, used + e] = g[e]
                for e in range(N):
                    x[waiting, base + e] = forces[e]
                of_block[waiting] = b
                waiting, pressed = waiting + 1, pressed or touched
            for e in range(D):
                z_last[e] = z[e]
                z[e] = z_new[e]
            # z is held from its start again, see Block.
            for e in range((a - 1) * n):
                z[a * n + e] = z[e]
            for e in range(N):
                forces_last[e] = forces[e]
            for e in range(g.size):
                g_last[e] = g[e]
        if diverged[i] != 0:
            positions[i, at // every + 1 :] = 0.0
            velocities[i, at // every + 1 :] = 0.0
        if count > 0:
            last = (cursor[1] if full else blocks) - 1
            for c in range(C):
                last_velocity[i, c] = speed(
                    velocity, velocity_push, forced_velocity, inflow_velocity, v, last, count - 1, c,
                    z_last, g_last, forces_last,
                )  # fmt: skip
        for e in range(z.size):
            states[i, e] = z[e]
        if full:
            cursor[0], cursor[2] = i, rows
            return False
        cursor[1] = 0
    cursor[0], cursor[2] = 0, rows
    return True
