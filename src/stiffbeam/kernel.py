"""The compiled loops: blocks of any scheme, the states inside them, and the sampled impacts.

Loop shapes matter here: eight rows are dotted at a time, and a push runs over the whole row, its
leading zeros included, because a loop from a variable start does not vectorise.
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import compiled


@compiled
def advance(z, transition, drive, drive_state, b, z_new):
    """z_new = transition z + g drive_state with g = drive[b]: a block without contact."""
    a, n = transition.shape[0], transition.shape[2]
    for d in range(z.size):
        z_new[d] = 0.0
    for k in range(drive.shape[1]):
        g = drive[b, k]
        for d in range(z.size):
            z_new[d] += g * drive_state[k, d]
    for c in range(a):
        for e in range(a):
            for j in range(n):
                z_new[c * n + j] += transition[c, e, j] * z[e * n + j]


@compiled
def march(
    z, reading, transition, push, push_state, kappa, g1, g2,
    drive, drive_state, inflow, inflow_state, entries, forces, starts,
):  # fmt: skip
    """Blocks of K steps with at most one contact, see Propagator.

    z: (D,), advanced in place. drive: (B, d), the coefficients g at the start of each block. inflow:
    (B, R) and inflow_state: (B, D), or no rows. Out: entries (B, R), forces (B, N) at the nodes,
    starts (B, D), x = (z, g) at the start of each block.
    """
    blocks, R = entries.shape
    D = z.size
    N = push.shape[0]
    modal = transition.shape[0] * transition.shape[2]  # x = (z, g, padding), z the first of them
    z_new = np.empty(D)
    for b in range(blocks):
        w = entries[b]
        for k in range(drive.shape[1]):
            z[modal + k] = drive[b, k]
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
        advance(z, transition, drive, drive_state, b, z_new)
        if inflow.shape[0]:
            for r in range(R):
                w[r] += inflow[b, r]
            for d in range(D):
                z_new[d] += inflow_state[b, d]
        for i in range(N):
            r = w[i]
            force = 0.0
            if r > g2 or r < g1:
                force = kappa / (1.0 + kappa * push[i, i]) * (min(max(r, g1), g2) - r)
                for j in range(R):
                    w[j] += force * push[i, j]
                for j in range(D):
                    z_new[j] += force * push_state[i, j]
            forces[b, i] = force
        for d in range(D):
            starts[b, d] = z[d]
            z[d] = z_new[d]


@compiled
def march_several(
    z, reading, transition, push, push_state, kappa, g1, g2,
    drive, drive_state, inflow, inflow_state, entries, forces, starts,
):  # fmt: skip
    """``march`` for m contacts; kappa, g1, g2: (m,). The m entries of a node are solved together."""
    blocks, R = entries.shape
    D = z.size
    N = push.shape[0]
    m = kappa.size
    modal = transition.shape[0] * transition.shape[2]
    z_new = np.empty(D)
    for b in range(blocks):
        w = entries[b]
        for k in range(drive.shape[1]):
            z[modal + k] = drive[b, k]
        for r in range(R):
            total = 0.0
            for d in range(D):
                total += z[d] * reading[r, d]
            w[r] = total
        advance(z, transition, drive, drive_state, b, z_new)
        if inflow.shape[0]:
            for r in range(R):
                w[r] += inflow[b, r]
            for d in range(D):
                z_new[d] += inflow_state[b, d]
        for first in range(0, N, m):
            touched = False
            for c in range(m):
                forces[b, first + c] = 0.0
                touched = touched or w[first + c] > g2[c] or w[first + c] < g1[c]
            if touched:
                force = solve_node(w[first : first + m], push[first : first + m, first : first + m], kappa, g1, g2)
                for c in range(m):
                    forces[b, first + c] = force[c]
                    for j in range(R):
                        w[j] += force[c] * push[first + c, j]
                    for j in range(D):
                        z_new[j] += force[c] * push_state[first + c, j]
        for d in range(D):
            starts[b, d] = z[d]
            z[d] = z_new[d]


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
def fill(z, transition, push_state, forces, drive, drive_state, inflow_state, states):
    """The states at the ends of single steps, from the forces a block march has found.

    z: (D,), advanced in place. transition, push_state (S m, D), drive_state (d, D): of the one-step
    propagator. forces: (steps, S m). drive: (steps, d). inflow_state: (steps, D) or no rows. Out:
    states (steps, D).
    """
    D = z.size
    for k in range(forces.shape[0]):
        new = states[k]
        advance(z, transition, drive, drive_state, k, new)
        if inflow_state.shape[0]:
            for d in range(D):
                new[d] += inflow_state[k, d]
        for i in range(forces.shape[1]):
            force = forces[k, i]
            if force != 0.0:
                for j in range(D):
                    new[j] += force * push_state[i, j]
        for d in range(D):
            z[d] = new[d]


@compiled
def scan(u, g1, g2, kappa, dt, chi, steps, sides, peaks, impulses):
    """The sampled impacts in u_0..u_n: chi_k != 0 and chi_k != chi_{k-1}, u_0 itself not counted.

    u: (n + 1,) positions; chi: contact state at u_0. Out, from index 1 on: ``steps`` k, ``sides``
    chi_k, ``peaks`` max |sigma| and ``impulses`` sum |sigma| dt of each impact; index 0 holds peak and
    impulse of the contact that was open at u_0. Returns (impacts, steps in contact, chi at the end).
    """
    count = 0
    touching = 0
    peaks[0] = 0.0
    impulses[0] = 0.0
    for k in range(1, u.size):
        new = 0
        depth = 0.0
        if u[k] > g2:
            new = 1
            depth = u[k] - g2
        elif u[k] < g1:
            new = -1
            depth = g1 - u[k]
        if new != 0:
            touching += 1
            if new != chi:
                count += 1
                steps[count] = k
                sides[count] = new
                peaks[count] = 0.0
                impulses[count] = 0.0
            peaks[count] = max(peaks[count], kappa * depth)
            impulses[count] += kappa * depth * dt
        chi = new
    return count, touching, chi


@compiled
def first_crossing(gap0, rate0, gap1, rate1):
    """The least s in (0, 1] at which the cubic Hermite interpolant of a gap reaches zero.

    gap0 > 0 >= gap1 at s = 0 and 1; rate0, rate1: d gap/ds there. Bisection on the first sign change
    between the extrema of the cubic.
    """
    # p(s) = c0 + c1 s + c2 s^2 + c3 s^3
    c0, c1 = gap0, rate0
    c2 = 3.0 * (gap1 - gap0) - 2.0 * rate0 - rate1
    c3 = 2.0 * (gap0 - gap1) + rate0 + rate1
    points = np.array([0.0, 1.0, 1.0, 1.0])
    # p'(s) = c1 + 2 c2 s + 3 c3 s^2
    discriminant = c2 * c2 - 3.0 * c1 * c3
    if discriminant > 0.0:
        q = -(c2 + math.copysign(math.sqrt(discriminant), c2))
        for i, (top, bottom) in enumerate(((q, 3.0 * c3), (c1, q))):
            if bottom != 0.0 and 0.0 < top / bottom < 1.0:
                points[1 + i] = top / bottom
    points.sort()
    low = 0.0
    for high in points[1:]:
        if c0 + high * (c1 + high * (c2 + high * c3)) <= 0.0 or high == 1.0:
            for _ in range(60):
                middle = 0.5 * (low + high)
                if c0 + middle * (c1 + middle * (c2 + middle * c3)) > 0.0:
                    low = middle
                else:
                    high = middle
            return high
        low = high
    return 1.0


@compiled
def crossing_times(u, before, after, steps, sides, g1, g2, dt, times):
    """When in its step (0 to 1) each sampled impact crosses its stop, by the cubic Hermite interpolant.

    u: (n + 1,) positions; steps, sides: (count,) as ``scan`` finds them; before, after: (count,) u' at
    both ends of the step. Out: times (count,), in steps from u_0.
    """
    for i in range(steps.size):
        k = steps[i]
        side = sides[i]
        stop = g2 if side > 0 else g1
        gap0 = side * (stop - u[k - 1])
        gap1 = side * (stop - u[k])
        times[i] = k - 1 + first_crossing(gap0, -side * before[i] * dt, gap1, -side * after[i] * dt)
