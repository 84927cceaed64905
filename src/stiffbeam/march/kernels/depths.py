"""How deep a contact goes in a stretch of leaps, and what it gives: sums over steps, and their greatest; see sums."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.compiled import compiled
from ...model.contact_law import G1, G2, KAPPA
from ...trajectory.sampling import IMPACT_IMPULSE, IMPACT_PEAK, IMPULSE, PEAK, ROW, TOUCHING
from .sums import Cubic, Regimes, bounds, greatest, sizes, slow_part, turn, turning_points, value, walk, whole_level

REMEMBERED = 64  # leaps of a stretch whose greatest depth is looked for together
TINY = 2e-15  # rounding of a position, relative


class Phase(NamedTuple):
    """The leaps of a stretch in contact that may hold its greatest depth."""

    y: Array  # (REMEMBERED, 2, N): coordinates at their starts
    top: Array  # (REMEMBERED, m): what no contact goes deeper than
    steps: IntArray  # (REMEMBERED,): how many they take
    alive: IntArray  # (REMEMBERED,): see Regimes
    depth: Array  # (m,): the greatest known


@compiled
def remember(
    regimes: Regimes, r: int, nodes: int, side: Array, law: Array, tally: Array, events: Array, phase: Phase,
    stored: int, y: Array, count: int, alive: int, begun: Array, top: Array, dt: float, work: Array,
) -> None:  # fmt: skip
    """Add the impulses of ``count`` steps from y, and keep them as leap ``stored``.

    begun, top (m,): how deep the contacts are in the first of them, and are not in any.
    """
    for c in range(side.size):
        if side[c] != 0.0:
            place, kappa = law[0, c, G2] if side[c] > 0.0 else law[0, c, G1], law[0, c, KAPPA]
            total = summed(regimes, r, (nodes - 1) * side.size + c, count, y, alive, work)
            impulse = kappa * side[c] * (total - float(count) * place) * dt
            tally[0, c, TOUCHING] += float(count)
            tally[0, c, IMPULSE] += impulse
            row = int(tally[0, c, ROW])
            if row >= 0:
                events[row, IMPACT_IMPULSE] += impulse
            phase.depth[c], phase.top[stored, c] = max(phase.depth[c], begun[c]), top[c]
    for i in range(alive):
        phase.y[stored, 0, i], phase.y[stored, 1, i] = y[0, i], y[1, i]
    phase.steps[stored], phase.alive[stored] = count, alive


@compiled
def summed(regimes: Regimes, r: int, k: int, count: int, y: Array, alive: int, work: Array) -> float:
    """Position k summed over ``count`` steps from y, in parts of 2^q whose sums are known."""
    here, other, total = work[0], work[1], 0.0
    for i in range(alive):
        here[0, i], here[1, i] = y[0, i], y[1, i]
    while True:
        q = whole_level(count)
        for i in range(alive):
            gr, gi = regimes.geometric[0, r, q, i], regimes.geometric[1, r, q, i]
            cr, ci = regimes.nodes[0, r, k, i], regimes.nodes[1, r, k, i]
            total += (cr * gr - ci * gi) * here[0, i] - (cr * gi + ci * gr) * here[1, i]
        count -= 1 << q
        if count == 0:
            return total
        turn(regimes.powers, r, q, here, other, alive)
        here, other = other, here


@compiled
def look_deeper(
    regimes: Regimes, r: int, nodes: int, side: Array, law: Array, tally: Array, events: Array, phase: Phase,
    stored: int, work: Array,
) -> None:  # fmt: skip
    """Bring the greatest depths of the closed contacts up to date with the ``stored`` leaps."""
    m = side.size
    for c in range(m):
        if side[c] != 0.0:
            place = law[0, c, G2] if side[c] > 0.0 else law[0, c, G1]
            best = phase.depth[c]
            first = 0  # the one that may go deepest: after it most of the others need no look
            for s in range(stored):
                first = s if phase.top[s, c] > phase.top[first, c] else first
            for turned in range(stored):
                s = (first + turned) % stored
                if phase.top[s, c] > best:
                    best = deepest(
                        regimes, r, (nodes - 1) * m + c, c, side[c], place, phase.y[s], phase.steps[s],
                        phase.alive[s], best, work,
                    )  # fmt: skip
            phase.depth[c] = best
            force = law[0, c, KAPPA] * best
            tally[0, c, PEAK] = max(tally[0, c, PEAK], force)
            row = int(tally[0, c, ROW])
            if row >= 0:
                events[row, IMPACT_PEAK] = max(events[row, IMPACT_PEAK], force)


@compiled
def deepest(
    regimes: Regimes, r: int, k: int, c: int, side: float, g: float, y: Array, steps: int, alive: int, best: float,
    work: Array,
) -> float:  # fmt: skip
    """The greatest depth of position k in ``steps`` steps from y, or ``best`` where that is greater.

    The cubic and its bound leave few steps at which that can be; over those the bound is less by the fourth power of
    how many they are, and is soon rounding. Where they leave more than half of a stretch, it is halved.
    """
    here, new, size, stop = work[0], work[1], work[2, 0], side * g
    for i in range(alive):
        here[0, i], here[1, i] = y[0, i], y[1, i]
    at, total, part = 0, steps, steps
    while at < total:
        count = min(part, total - at)
        now = value(regimes.nodes, r, k, here, 0, alive)
        best = max(best, side * now - stop)
        if count > 1:
            L, level = float(count), whole_level(count)
            slow = min(alive, regimes.slow[r, level])
            sizes(here, size, alive)
            bend, flat = bounds(regimes.large, regimes.bent, r, c, slow, alive, size, L)
            turn(regimes.powers, r, level, here, new, alive)
            walk(regimes.powers, r, count - (1 << level), new, work[3], alive)
            p, _ = slow_part(regimes, r, k, here, new, slow, L)
            rounding, error = TINY * abs(now), 0.25 * bend * L * L + flat
            if greatest(side, p, bend, L, 0.0, L - 1.0) + flat - stop > best + rounding:
                far = farthest(side, p, L - 1.0) - stop
                best = max(best, far if error <= rounding else far - error)
                known = stop - flat + best + rounding  # what is less goes no deeper
                if error > rounding and greatest(side, p, bend, L, 0.0, L - 1.0) > known:
                    first, last = around_top(side, p, error, L - 1.0)
                    if at + count == total and greatest(side, p, bend, L, float(last), L - 1.0) <= known:
                        total = at + last
                    if first > 0 and greatest(side, p, bend, L, 0.0, float(first)) <= known:
                        walk(regimes.powers, r, first, here, work[3], alive)
                        at += first
                    else:
                        first = 0
                    part = min(last - first, (count + 1) // 2)
                    continue
        else:
            turn(regimes.powers, r, 0, here, new, alive)
        here, new = new, here
        at += count
        part = total - at
    return best


@compiled
def farthest(sign: float, p: Cubic, last: float) -> float:
    """The greatest sign p(l) at the whole numbers l = 0 .. last."""
    far = max(sign * p.w0, sign * (p.w0 + last * (p.c1 + last * (p.c2 + last * p.c3))))
    for point in turning_points(p.c1, p.c2, p.c3):
        if point > 0.0 and point < last:
            for at in (math.floor(point), math.ceil(point)):
                far = max(far, sign * (p.w0 + at * (p.c1 + at * (p.c2 + at * p.c3))))
    return far


@compiled
def around_top(sign: float, p: Cubic, error: float, last: float) -> tuple[int, int]:
    """From which step to which of 0 .. last sign p(l) may be within twice its error of its top: a guess."""
    top = height = 0.0
    one, two = turning_points(p.c1, p.c2, p.c3)
    for point in (last, one, two):
        if point > 0.0 and point <= last and sign * point * (p.c1 + point * (p.c2 + point * p.c3)) > height:
            top, height = point, sign * point * (p.c1 + point * (p.c2 + point * p.c3))
    slope, bent = abs(p.c1 + top * (2.0 * p.c2 + top * 3.0 * p.c3)), abs(p.c2 + top * 3.0 * p.c3)
    # slope x + bent x^2 = 2 error, and a step more
    wide = 1.0 + 4.0 * error / (slope + math.sqrt(slope * slope + 8.0 * bent * error))
    return int(max(0.0, np.floor(top - wide))), int(min(last, np.ceil(top + wide)))
