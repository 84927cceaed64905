"""The compiled march: members of an ensemble one after another, each in blocks of K steps.

A run is an ensemble of one and ``run`` is the only entry, so a member has the bits of its solo run.
Loop shapes matter here: eight rows are dotted at a time, and a push runs over the whole row, its
leading zeros included, because a loop from a variable start does not vectorise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .arrays import Array
from .compiled import compiled
from .sampling import CONTACT, MEMBER, STOP, TIME, crossing, scan

OVERFLOW = 1e100


class Block(NamedTuple):
    """K steps as one linear map, see Propagator; the same for every member. Rows are padded to eight.

    N = K S m force nodes, R entries, D state components, C channels.
    """

    reading: Array  # (R, D)
    transition: Array  # (a, a, n)
    push: Array  # (N, R)
    push_state: Array  # (N, D)
    compliance: Array  # (N, m): of the contacts of a node on each other
    end_entry: Array  # (K, C) integers: the entry that holds a channel at the end of a step
    velocity: Array  # (K, C, D): the channels' velocities at the ends of the steps
    velocity_push: Array  # (K, C, N)


class Forcing(NamedTuple):
    """What the drive g = (1, sin w1 t, cos w1 t, ...) at a block's start does; V = 1 or one per member."""

    frequencies: Array  # (V, F)
    entries: Array  # (V, d, R)
    state: Array  # (V, d, D)
    velocity: Array  # (V, K, C, d)


class Inflow(NamedTuple):
    """What sampled loads and offsets add to the blocks of a stretch; no rows without any."""

    entries: Array  # (B, R)
    state: Array  # (B, D)
    velocity: Array  # (B, K, C)


class Marchers(NamedTuple):
    """Where the members are and what they have seen; advanced in place."""

    z: Array  # (M, D)
    position: Array  # (M, C) at the last step
    velocity: Array  # (M, C)
    tally: Array  # (M, m, 8), see sampling
    diverged: Array  # (M,) integers: the step that overflowed, 0 for none


class Kept(NamedTuple):
    """What is kept of a stretch of steps. Empty arrays are not wanted."""

    positions: Array  # (M, outputs, C) at every ``every``-th step
    velocities: Array  # (M, outputs, C)
    starts: Array  # (B, D): the state of the only member at the start of each block
    forces: Array  # (B, N)


@compiled
def read(reading, z, w):
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


@compiled
def advance(transition, z, z_new):
    """z_new = transition z, mode by mode."""
    a, n = transition.shape[0], transition.shape[2]
    for d in range(a * n, z.size):
        z_new[d] = 0.0
    for c in range(a):
        for j in range(n):
            z_new[c * n + j] = transition[c, 0, j] * z[j]
        for e in range(1, a):
            for j in range(n):
                z_new[c * n + j] += transition[c, e, j] * z[e * n + j]


@compiled
def drive(forcing, v, t, g):
    """g (d,) at time t."""
    g[0] = 1.0
    for f in range(forcing.frequencies.shape[1]):
        phase = forcing.frequencies[v, f] * t
        g[1 + 2 * f] = math.sin(phase)
        g[2 + 2 * f] = math.cos(phase)


@compiled
def resolve(block, law, w, z_new, forces):
    """The stops, node by node: F = kappa/(1 + kappa s) (clip(r, g1, g2) - r), see Stops.solve."""
    N, R = block.push.shape
    kappa, g1, g2 = law[0, 0], law[0, 1], law[0, 2]
    for i in range(N):
        r = w[i]
        force = 0.0
        if r > g2 or r < g1:
            force = kappa / (1.0 + kappa * block.compliance[i, 0]) * (min(max(r, g1), g2) - r)
            for j in range(R):
                w[j] += force * block.push[i, j]
            for d in range(z_new.size):
                z_new[d] += force * block.push_state[i, d]
        forces[i] = force


@compiled
def resolve_several(block, law, w, z_new, forces):
    """``resolve`` for m contacts: the m entries of a node are solved together."""
    N, R = block.push.shape
    m = law.shape[0]
    for first in range(0, N - m + 1, m):
        touched = False
        for c in range(m):
            forces[first + c] = 0.0
            touched = touched or w[first + c] > law[c, 2] or w[first + c] < law[c, 1]
        if touched:
            force = solve_node(
                w[first : first + m], block.compliance[first : first + m], law[:, 0], law[:, 1], law[:, 2]
            )
            for c in range(m):
                forces[first + c] = force[c]
                for j in range(R):
                    w[j] += force[c] * block.push[first + c, j]
                for d in range(z_new.size):
                    z_new[d] += force[c] * block.push_state[first + c, d]


@compiled
def speed(block, forcing, inflow, v, b, k, c, z, g, forces):
    """The velocity of channel c at the end of step k of a block."""
    total = 0.0
    for d in range(z.size):
        total += z[d] * block.velocity[k, c, d]
    for i in range(forces.size):
        total += forces[i] * block.velocity_push[k, c, i]
    for e in range(g.size):
        total += g[e] * forcing.velocity[v, k, c, e]
    if inflow.velocity.shape[0]:
        total += inflow.velocity[b, k, c]
    return total


@compiled
def run(block, law, forcing, inflow, marchers, kept, events, first, steps, dt, every, cursor):
    """``steps`` steps of every member from step ``first``; whether all are done.

    law: (M, m, 3), kappa, g1 and g2 of every contact. events: the list of impacts, see sampling.
    cursor: (member, block, free row of events), advanced in place; where the list may not hold another
    block's impacts, False is returned and the call can be made again with a longer one.
    """
    M, D = marchers.z.shape
    K, C = block.end_entry.shape
    N, R = block.push.shape
    m = law.shape[1]
    d = forcing.entries.shape[1]
    z, z_new, w, forces, g = np.empty(D), np.empty(D), np.empty(R), np.zeros(N), np.empty(d)
    u = np.empty(K)
    blocks = (steps + K - 1) // K
    rows = cursor[2]
    for i in range(cursor[0], M):
        if marchers.diverged[i] > 0:
            cursor[1] = 0
            continue
        v = min(i, forcing.entries.shape[0] - 1)
        z[:] = marchers.z[i]
        for b in range(cursor[1], blocks):
            if rows + m * K > events.shape[0]:
                marchers.z[i] = z
                cursor[0], cursor[1], cursor[2] = i, b, rows
                return False
            at = first + b * K
            drive(forcing, v, at * dt, g)
            read(block.reading, z, w)
            advance(block.transition, z, z_new)
            for e in range(d):
                for r in range(R):
                    w[r] += g[e] * forcing.entries[v, e, r]
                for j in range(D):
                    z_new[j] += g[e] * forcing.state[v, e, j]
            if inflow.entries.shape[0]:
                for r in range(R):
                    w[r] += inflow.entries[b, r]
                for j in range(D):
                    z_new[j] += inflow.state[b, j]
            if m == 1:
                resolve(block, law[i], w, z_new, forces)
            elif m > 1:
                resolve_several(block, law[i], w, z_new, forces)
            count = min(K, steps - b * K)
            if kept.starts.shape[0]:
                kept.starts[b] = z
                kept.forces[b] = forces
            finite = True
            for c in range(C):
                for k in range(count):
                    u[k] = w[block.end_entry[k, c]]
                if not abs(u[count - 1]) < OVERFLOW:
                    for k in range(count - 1, -1, -1):
                        if not abs(u[k]) < OVERFLOW:
                            marchers.diverged[i] = at + k + 1
                    finite = False
                    break
                if kept.positions.shape[1]:
                    for n in range(at // every + 1, (at + count) // every + 1):
                        k = n * every - at - 1
                        kept.positions[i, n, c] = u[k]
                        kept.velocities[i, n, c] = speed(block, forcing, inflow, v, b, k, c, z, g, forces)
                if c < m:
                    new = scan(u, count, law[i, c], dt, marchers.tally[i, c], events, rows)
                    for row in range(rows, new):
                        k = int(events[row, TIME])
                        stop = law[i, c, 2] if events[row, STOP] > 0.0 else law[i, c, 1]
                        if k > 0:
                            u0, v0 = u[k - 1], speed(block, forcing, inflow, v, b, k - 1, c, z, g, forces)
                        else:
                            u0, v0 = marchers.position[i, c], marchers.velocity[i, c]
                        v1 = speed(block, forcing, inflow, v, b, k, c, z, g, forces)
                        events[row, TIME] = (at + k + crossing(u0, v0, u[k], v1, stop, dt)) * dt
                        events[row, MEMBER] = i
                        events[row, CONTACT] = c
                    rows = new
                marchers.position[i, c] = u[count - 1]
                marchers.velocity[i, c] = speed(block, forcing, inflow, v, b, count - 1, c, z, g, forces)
            if not finite:
                break
            z[:] = z_new
        marchers.z[i] = z
        cursor[1] = 0
    cursor[0], cursor[2] = 0, rows
    return True


@compiled
def solve_node(r, compliance, kappa, g1, g2):
    """The forces F (m,) with v = r + S F and F_c = F_c(v_c), S symmetric positive semidefinite.

    They minimise 1/2 F^T S F + r^T F + sum_c (F_c^2/(2 kappa_c) - g_c F_c), g_c the stop that F_c comes
    from. Lawson and Hanson's active set: close the contact that penetrates most, solve for the closed
    ones, and go only as far as no force changes sign, opening those that reach zero. It ends because
    the minimum over the closed contacts falls at every turn.
    """
    m = r.size
    force = np.zeros(m)
    side = np.zeros(m)  # +1 on the upper stop, -1 on the lower, 0 open
    for _ in range(20 * m):
        worst = 0.0
        entering = -1
        stop = 0.0
        for c in range(m):
            if side[c] == 0.0:
                v = r[c]
                for e in range(m):
                    v += compliance[e, c] * force[e]
                depth = max(v - g2[c], g1[c] - v)
                if depth > 1e-15 * abs(v) and kappa[c] * depth > worst:
                    worst = kappa[c] * depth
                    entering = c
                    stop = 1.0 if v > g2[c] else -1.0
        if entering < 0:
            break
        side[entering] = stop
        while True:
            # (1/kappa + S) F = g - r on the closed contacts, the others left at zero.
            matrix = np.eye(m)
            right = np.zeros(m)
            for c in range(m):
                if side[c] != 0.0:
                    right[c] = (g2[c] if side[c] > 0.0 else g1[c]) - r[c]
                    matrix[c, c] = 1.0 / kappa[c] + compliance[c, c]
                    for e in range(m):
                        if e != c and side[e] != 0.0:
                            matrix[c, e] = compliance[e, c]
            target = np.linalg.solve(matrix, right)
            way = 1.0
            opening = -1
            for c in range(m):
                if side[c] != 0.0 and target[c] * side[c] >= 0.0:  # the force opposes its side
                    part = force[c] / (force[c] - target[c]) if force[c] != target[c] else 0.0
                    if opening < 0 or part < way:
                        way = part
                        opening = c
            if opening < 0:
                force = target
                break
            for c in range(m):
                force[c] += way * (target[c] - force[c])
            force[opening] = 0.0
            side[opening] = 0.0
    return force


@compiled
def fill(z, transition, push_state, forces, g, drive_state, inflow_state, states):
    """The states at the ends of single steps, from the forces a block march has found.

    z: (D,), advanced in place. transition, push_state (S m, D), drive_state (d, D): of the one-step
    propagator. forces: (steps, S m). g: (steps, d). inflow_state: (steps, D) or no rows. Out: states
    (steps, D).
    """
    for k in range(forces.shape[0]):
        new = states[k]
        advance(transition, z, new)
        for e in range(g.shape[1]):
            for j in range(z.size):
                new[j] += g[k, e] * drive_state[e, j]
        if inflow_state.shape[0]:
            for j in range(z.size):
                new[j] += inflow_state[k, j]
        for i in range(forces.shape[1]):
            force = forces[k, i]
            if force != 0.0:
                for j in range(z.size):
                    new[j] += force * push_state[i, j]
        z[:] = new
