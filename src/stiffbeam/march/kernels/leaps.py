"""The compiled leaping march: one member, from one change of regime to the next; see leap.

The step in which a contact closes or opens, at whichever node, is an ordinary one, that of the block march with
one step to a block. Between them as many steps are taken at once as can be shown to leave every position at every
node on its side, see sums: twice as many after every success, half as many where that is not shown.
"""

from __future__ import annotations

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.compiled import compiled
from ...model.contact_law import G1, G2, KAPPA
from ...trajectory.sampling import IMPACT_IMPULSE, IMPACT_PEAK, IMPULSE, PEAK, ROW, SIDE, TOUCHING
from .blocks import run
from .layout import Block, Forcing, Inflow, Kept, Marchers
from .sums import (
    CROSSED,
    SURE,
    Regimes,
    cubic,
    deepest,
    emit,
    enter,
    error_of,
    extent,
    farthest,
    keeps,
    leave,
    reached,
    sizes,
    turn,
    value,
    walk,
    whole_level,
)

# How a call ended.
DONE, PAUSED, FULL, UNKNOWN, ABANDONED, OVERFLOWED = range(6)
# cursor: the step, the free row of events, whether the last step had one regime, leaps tried, ordinary steps.
STEP, FREE_ROW, SETTLED, TRIED, ORDINARY = range(5)
REMEMBERED = 64  # leaps of a contact phase whose greatest depth is looked for at its end
PATIENCE = 3e5  # ns spent before it is asked whether leaping pays


@compiled
def advance(
    one: Block, law: Array, forcing: Forcing, regimes: Regimes, regime_of: IntArray, marchers: Marchers,
    kept: tuple[Array, Array, Array], events: Array, cursor: IntArray, side: Array, guess: IntArray, steps: int,
    dt: float, every: int, since: int, limit: int, costs: Array,
) -> int:  # fmt: skip
    """March one member from step cursor[STEP] to ``steps``, or so far as it can; how it ended.

    one: the block of a single step. law: (1, m, 6). regime_of: (2^m,), by the closed contacts as bits, -1 for one
    that has not been made, -2 for none. side: (m,), those of the last step; guess: (2^m,), the level at which a
    regime was last leapt in first. kept: positions, velocities (1, outputs, C) and packed states (outputs, D) at
    every ``every``-th step, or no outputs.

    It pauses at ``limit``, is full where the events may not hold another step's, and asks for the regime of ``side``
    where that is unknown; the call can then be made again, and what it has done does not depend on that. costs: ns
    of a leap tried, of an ordinary step with what goes with it, and of a step of the block march.
    """
    transition, compliance, velocity = one[1], one[3], one[6]
    frequencies = forcing[1]
    z, position, last_velocity, tally, diverged = marchers
    positions, velocities, states = kept
    D, a, C, m = transition.shape[1], transition.shape[0], velocity.shape[1], law.shape[1]
    n_modes = (z.shape[1] - D) // max(1, a - 1)
    nodes, N = compliance.shape[0] // max(1, m), regimes.powers.shape[3]
    start_of, forces, at = np.empty((1, z.shape[1])), np.zeros((1, one[2].shape[0])), np.zeros(3, np.int64)
    beside, inflow = (
        Kept(positions, velocities, positions[:, :0], start_of, forces),
        Inflow(np.zeros((0, 1)), np.zeros((0, 1, C))),
    )
    y, new, old, size = np.zeros((2, N)), np.zeros((2, N)), np.zeros((2, N)), np.zeros(N)
    work = np.zeros((5, 2, N))
    phase, phase_top = np.zeros((REMEMBERED, 2, N)), np.zeros((REMEMBERED, m))
    phase_level, phase_alive = np.zeros(REMEMBERED, np.int64), np.zeros(REMEMBERED, np.int64)
    depth, low_end, high_end = np.zeros(m), np.zeros(m), np.zeros(m)
    levels = regimes.powers.shape[2] - 1
    n, rows = cursor[STEP], cursor[FREE_ROW]
    settled, tried, ordinary = cursor[SETTLED] != 0, cursor[TRIED], cursor[ORDINARY]
    ended = DONE
    while n < steps:
        if n >= limit:
            ended = PAUSED
            break
        if rows + m > events.shape[0]:
            ended = FULL
            break
        spent = tried * costs[0] + ordinary * costs[1]
        if spent > PATIENCE and spent > n * costs[2]:
            ended = ABANDONED
            break
        r = -2
        if settled:
            mask = 0
            for c in range(m):
                if side[c] != 0.0:
                    mask |= 1 << c
            r = regime_of[mask]
            if r == -1:
                ended = UNKNOWN
                break
        if r >= 0:
            enter(regimes, r, z[0], side, law, frequencies, n * dt, y)
            alive = before = N
            sizes(y, size, N)
            start, last, stored = n, -1, 0
            # It is known to cross at ``wall``; ``near`` is where the cubic says that it does.
            q, grows, wall, near, rest, first = guess[r], True, steps + 1, steps + 1, 0, True
            for c in range(m):
                depth[c] = 0.0
            while n < steps:
                stop = since if n < since else steps
                if n >= wall:  # it came back between two steps
                    near = wall = steps + 1
                if n >= near:  # from here on over no more steps than twice those that seem to be left
                    near, q, grows = wall, min(q, whole_level(2 * rest) if rest > 2 else 0), False
                # As many steps as that, and no more than to where it is known or thought to end.
                count = max(1, min(1 << q, stop - n, wall - 1 - n, near - n))
                level = whole_level(count)
                L = float(count)
                slow = min(alive, regimes.slow[r, level])
                turn(regimes.powers, r, level, y, new, alive)
                if count > 1 << level:
                    walk(regimes.powers, r, count - (1 << level), new, work[0], alive)
                verdict = SURE
                tried += 1
                for k in range(nodes * m):
                    c = k % m
                    w0 = value(regimes.nodes, r, k, y, 0, slow)
                    low = high = w0
                    error = c1 = c2 = c3 = d0 = d1 = 0.0
                    at_end = w0
                    if count > 1:
                        error = error_of(regimes.large, regimes.bent, r, c, slow, alive, size, L)
                        d0 = value(regimes.steps, r, k, y, 0, slow)
                        at_end = value(regimes.nodes, r, k, new, 0, slow)
                        d1 = value(regimes.steps, r, k, new, 0, slow)
                        c1, c2, c3 = cubic(w0, d0, at_end, d1, L)
                        low, high = extent(w0, c1, c2, c3, L)
                    verdict = max(verdict, keeps(side[c], low, high, error, law[0, c, G1], law[0, c, G2]))
                    if verdict != SURE:
                        if verdict == CROSSED and count > 1:
                            wall = min(wall, n + count)
                            ahead, beyond = reached(side[c], w0, d0, at_end, d1, L, error, law[0, c, G1], law[0, c, G2])
                            near, rest = n + ahead, beyond - ahead
                        break
                    if side[c] != 0.0 and k >= (nodes - 1) * m:
                        sign, place = side[c], law[0, c, G2] if side[c] > 0.0 else law[0, c, G1]
                        low_end[c] = sign * (w0 - place) - error
                        if count > 1:
                            low_end[c] = farthest(sign, w0, c1, c2, c3, L - 1.0) - sign * place - error
                        high_end[c] = (high if sign > 0.0 else -low) + error - sign * place
                if verdict != SURE:
                    first = False
                    if count == 1:
                        break
                    grows = False
                    q = whole_level(near - n) + 1 if verdict == CROSSED else whole_level(count - 1)
                    continue
                if last < 0:
                    guess[r] = min(level + 1, levels - 1) if first else level
                left = count
                while left > 0:  # in parts of 2^p steps, whose sums are known
                    p = whole_level(left)
                    if positions.shape[1] or states.shape[0]:
                        emit(regimes, r, n, 1 << p, every, y, alive, work, kept)
                    if n >= since:
                        closed = False
                        for c in range(m):
                            if side[c] != 0.0:
                                closed = True
                                place, kappa = law[0, c, G2] if side[c] > 0.0 else law[0, c, G1], law[0, c, KAPPA]
                                k = (nodes - 1) * m + c
                                total = 0.0
                                for i in range(alive):
                                    gr, gi = regimes.geometric[0, r, p, i], regimes.geometric[1, r, p, i]
                                    cr, ci = regimes.nodes[0, r, k, i], regimes.nodes[1, r, k, i]
                                    total += (cr * gr - ci * gi) * y[0, i] - (cr * gi + ci * gr) * y[1, i]
                                impulse = kappa * side[c] * (total - float(1 << p) * place) * dt
                                tally[0, c, TOUCHING] += float(1 << p)
                                tally[0, c, IMPULSE] += impulse
                                row = int(tally[0, c, ROW])
                                if row >= 0:
                                    events[row, IMPACT_IMPULSE] += impulse
                                depth[c] = max(depth[c], low_end[c])
                                phase_top[stored, c] = high_end[c]
                        if closed:
                            for i in range(N):
                                phase[stored, 0, i], phase[stored, 1, i] = y[0, i], y[1, i]
                            phase_level[stored], phase_alive[stored] = p, alive
                            stored += 1
                            if stored == REMEMBERED:
                                look_deeper(
                                    regimes, r, nodes, side, law, tally, events, phase, phase_level, phase_alive,
                                    phase_top, stored, depth, work,
                                )  # fmt: skip
                                stored = 0
                    if count > 1 << level:
                        turn(regimes.powers, r, p, y, new, alive)
                    last, before = p, alive
                    old, y, new = y, new, old
                    alive = min(alive, regimes.alive[r, p])
                    n += 1 << p
                    left -= 1 << p
                sizes(y, size, alive)
                if grows and q + 1 < levels:
                    q += 1
                grows = True
            if stored:
                look_deeper(
                    regimes, r, nodes, side, law, tally, events, phase, phase_level, phase_alive, phase_top,
                    stored, depth, work,
                )  # fmt: skip
            if n > start:
                leave(regimes, r, y, alive, z[0])
                for e in range((a - 1) * n_modes):
                    z[0, a * n_modes + e] = z[0, e]
                walk(regimes.powers, r, (1 << last) - 1, old, work[0], before)  # to the step before this
                for c in range(C):
                    position[0, c] = value(regimes.ends, r, c, old, 0, before)
                    last_velocity[0, c] = value(regimes.rates, r, c, old, 0, before)
            if n >= steps:
                break
        ordinary += 1
        at[0], at[1], at[2] = 0, 0, rows
        # A literal 1 would have the whole kernel compiled once more, for that number.
        run(one, law, forcing, inflow, marchers, beside, events, n, np.int64(1), dt, every, at)
        rows = at[2]
        if diverged[0] > 0:
            ended = OVERFLOWED
            break
        n += 1
        settled = True
        for c in range(m):
            side[c] = tally[0, c, SIDE]
            for s in range(nodes):  # a force is zero where its contact is open
                if forces[0, s * m + c] * side[c] >= 0.0 and (forces[0, s * m + c] != 0.0 or side[c] != 0.0):
                    settled = False
        if states.shape[0] and n % every == 0:
            for d in range(D):
                states[n // every, d] = z[0, d]
    cursor[STEP], cursor[FREE_ROW], cursor[TRIED], cursor[ORDINARY] = n, rows, tried, ordinary
    cursor[SETTLED] = 1 if settled else 0
    return ended


@compiled
def look_deeper(
    regimes: Regimes, r: int, nodes: int, side: Array, law: Array, tally: Array, events: Array, phase: Array,
    phase_level: IntArray, phase_alive: IntArray, phase_top: Array, stored: int, depth: Array, work: Array,
) -> None:  # fmt: skip
    """Bring the greatest depths of the closed contacts up to date with the leaps remembered."""
    m = side.size
    for c in range(m):
        if side[c] != 0.0:
            place = law[0, c, G2] if side[c] > 0.0 else law[0, c, G1]
            best = depth[c]
            first = 0  # the one that may go deepest: after it most of the others need no look
            for s in range(stored):
                first = s if phase_top[s, c] > phase_top[first, c] else first
            for turned in range(stored):
                s = (first + turned) % stored
                if phase_top[s, c] > best:
                    k = (nodes - 1) * m + c
                    best = deepest(
                        regimes, r, k, c, side[c], place, phase[s], phase_level[s], phase_alive[s], best, work
                    )
            depth[c] = best
            force = law[0, c, KAPPA] * best
            tally[0, c, PEAK] = max(tally[0, c, PEAK], force)
            row = int(tally[0, c, ROW])
            if row >= 0:
                events[row, IMPACT_PEAK] = max(events[row, IMPACT_PEAK], force)
