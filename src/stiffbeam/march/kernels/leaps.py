"""The compiled leaping march: one member, from one change of regime to the next; see leap.

The step in which a contact closes or opens, at whichever node, is an ordinary one, that of the block march with
one step to a block. Between them as many steps are taken at once as can be shown to leave every position at every
node on its side, see sums: twice as many after every success, half as many where that is not shown, and where one
ends on the other side as many as its cubic says that it keeps its own.
"""

from __future__ import annotations

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.compiled import compiled
from ...model.contact_law import G1, G2
from ...trajectory.sampling import SIDE
from .blocks import Block, Forcing, Inflow, Kept, Marchers, run
from .sums import (
    CROSSED,
    OPEN,
    OVER,
    REMEMBERED,
    SURE,
    Cubic,
    Phase,
    Regimes,
    bounds,
    emit,
    enter,
    greatest,
    judge,
    keeps,
    leave,
    look_deeper,
    remember,
    sizes,
    slow_part,
    turn,
    value,
    walk,
    whole_level,
)

# How a call ended.
DONE, PAUSED, FULL, UNKNOWN, ABANDONED, OVERFLOWED = range(6)
# cursor: the step, the free row of events, whether the last step had one regime, leaps tried, ordinary steps.
STEP, FREE_ROW, SETTLED, TRIED, ORDINARY = range(5)
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
    regime is leapt in first. kept: positions, velocities (1, outputs, C) and packed states (outputs, D) at
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
    phase = Phase(
        np.zeros((REMEMBERED, 2, N)), np.zeros((REMEMBERED, m)), np.zeros(REMEMBERED, np.int64),
        np.zeros(REMEMBERED, np.int64), np.zeros(m),
    )  # fmt: skip
    begun, top, low, high = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
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
            # A position is on the other side at step ``wall``, and seems to be ``rest`` steps after ``near``.
            q, grows, wall, near, rest = guess[r], True, steps + 1, steps + 1, 0
            closed = False
            for c in range(m):
                closed |= side[c] != 0.0
                phase.depth[c] = 0.0
                low[c], high[c] = keeps(side[c], law[0, c, G1], law[0, c, G2])
            while n < steps and n < wall:
                stop = since if n < since else steps
                if n >= near:
                    near, rest = n + rest if rest > 0 else wall, 0
                count = max(1, min(1 << q, stop - n, near - n))
                level = whole_level(count)
                L = float(count)
                slow = min(alive, regimes.slow[r, level]) if count > 1 else 0
                turn(regimes.powers, r, level, y, new, alive)
                if count > 1 << level:
                    walk(regimes.powers, r, count - (1 << level), new, work[0], alive)
                verdict = SURE
                tried += 1
                for k in range(nodes * m):
                    c = k % m
                    now = value(regimes.nodes, r, k, y, slow, alive)
                    then, bend, flat, p = now, 0.0, 0.0, Cubic(now, 0.0, 0.0, 0.0)
                    if count > 1:
                        bend, flat = bounds(regimes.large, regimes.bent, r, c, slow, alive, size, L)
                        p, then = slow_part(regimes, r, k, y, new, slow, L)
                        now += p.w0
                        then += value(regimes.nodes, r, k, new, slow, alive)
                    verdict, ahead, left = judge(low[c], high[c], now, then, p, bend, flat, L)
                    if left > 0:
                        wall = min(wall, n + count)
                    if verdict != SURE:
                        if verdict == CROSSED:
                            near, rest = n + ahead, left - ahead
                        break
                    if side[c] != 0.0 and k >= (nodes - 1) * m:
                        place = side[c] * (law[0, c, G2] if side[c] > 0.0 else law[0, c, G1])
                        begun[c] = side[c] * now - place
                        top[c] = greatest(side[c], p, bend, L, 0.0, L - 1.0) + flat - place
                if verdict == OVER:
                    break
                if last < 0 and grows:
                    guess[r] = max(0, min(q + 1 if verdict == SURE else q - 1 if verdict == OPEN else q, levels - 1))
                if verdict != SURE:
                    grows = False
                    q = whole_level(max(near - n, rest)) + 1 if verdict == CROSSED else whole_level(count - 1)
                    continue
                if positions.shape[1] or states.shape[0]:
                    emit(regimes, r, n, count, every, y, alive, work, kept)
                if closed and n >= since:
                    remember(
                        regimes, r, nodes, side, law, tally, events, phase, stored, y, count, alive, begun, top, dt,
                        work,
                    )  # fmt: skip
                    stored += 1
                    if stored == REMEMBERED:
                        look_deeper(regimes, r, nodes, side, law, tally, events, phase, stored, work)
                        stored = 0
                last, before, n = count, alive, n + count
                old, y, new = y, new, old
                alive = min(alive, regimes.alive[r, level])
                sizes(y, size, alive)
                if grows and q + 1 < levels:
                    q += 1
                grows = True
            if stored:
                look_deeper(regimes, r, nodes, side, law, tally, events, phase, stored, work)
            if n > start:
                leave(regimes, r, y, alive, z[0])
                for e in range((a - 1) * n_modes):
                    z[0, a * n_modes + e] = z[0, e]
                walk(regimes.powers, r, last - 1, old, work[0], before)  # to the step before this
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
