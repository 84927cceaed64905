"""Sums of powers: reading them, turning them by many steps at once, and what they do in between, proven.

    w(l) = Re sum_i c_i y_i lambda_i^l,     |lambda_i| <= 1,

is the position at a node of step l of a stretch, see regimes. For whole l from 0 to L

    |w(l) - p(l)| <= bend l (L - l) + flat
    bend = L^2/96 sum_{i slow} |c_i y_i| |lambda_i - 1|^4,    flat = sum_{i fast} |c_i y_i|

with p the cubic through the slow part of w at l = 0, 1, L, L + 1. By Newton's formula the error of p is
l (l - 1)(l - L)(l - L - 1) times a fourth divided difference of the slow part, which is a mean of its fourth
differences over 24; the fourth difference of c y lambda^l is c y (lambda - 1)^4 lambda^l, and (l - 1)(L + 1 - l) is at
most L^2/4. A coordinate is fast where its whole amplitude is less than its share in the middle would be, L^4/384 times
its fourth difference. p less its bound is a cubic again, and so is p with it: their least and their greatest value say
what no step in between does. Both meet p at its ends, so that a stretch may begin and end beside a stop.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.compiled import compiled, inlined
from ...model.contact_law import G1, G2, KAPPA
from ...trajectory.sampling import IMPACT_IMPULSE, IMPACT_PEAK, IMPULSE, PEAK, ROW, TOUCHING, first_crossing

# Of a leap: all of it is on its side, that is not known, it ends beyond, its first step is beyond.
SURE, OPEN, CROSSED, OVER = range(4)


class Regimes(NamedTuple):
    """Sums of powers, see regimes.Sum; R regimes, N coordinates sorted by |lambda - 1|, padded.

    Complex arrays are held as two, real and imaginary parts first. Level q < Q is 2^q steps, level Q ``every``.
    """

    slow: Array  # (R, Q) integers: how many coordinates the cubic holds
    alive: Array  # (R, Q) integers: how many are not damped to nothing by 2^q steps
    powers: Array  # (2, R, Q + 1, N): lambda^L
    geometric: Array  # (2, R, Q, N): the sum of lambda^l for l < L
    nodes: Array  # (2, R, S m, N): c of the contacts at the nodes
    steps: Array  # (2, R, S m, N): c (lambda - 1)
    large: Array  # (R, m, N): the greatest |c| at a node
    bent: Array  # (R, m, N): that times |lambda - 1|^4/96
    ends: Array  # (2, R, C, N): c of the channels at the ends of the steps
    rates: Array  # (2, R, C, N): of their velocities
    enter: Array  # (2, R, N, D): y = enter z + held g,
    held: Array  # (2, R, N, d): g = (1, places of closed stops, cosines, sines)
    leave: Array  # (2, R, N, D): z = Re leave^T y


class Cubic(NamedTuple):
    """p(l) = w0 + c1 l + c2 l^2 + c3 l^3."""

    w0: float
    c1: float
    c2: float
    c3: float


@inlined
def value(c: Array, r: int, k: int, y: Array, first: int, last: int) -> float:
    """Re sum c y over coordinates first to last."""
    total = 0.0
    for i in range(np.uint64(first), np.uint64(last)):  # an index that might be negative is read by gathers
        total += c[0, r, k, i] * y[0, i] - c[1, r, k, i] * y[1, i]
    return total


@inlined
def turn(powers: Array, r: int, q: int, y: Array, new: Array, alive: int) -> None:
    """new = lambda^L y, of the first ``alive`` coordinates."""
    for i in range(alive):
        new[0, i] = powers[0, r, q, i] * y[0, i] - powers[1, r, q, i] * y[1, i]
        new[1, i] = powers[0, r, q, i] * y[1, i] + powers[1, r, q, i] * y[0, i]


@compiled
def walk(powers: Array, r: int, count: int, y: Array, other: Array, alive: int) -> None:
    """y turned by ``count`` steps in place; ``other`` is scratch of its shape."""
    q = 0
    while count > 0:
        if count & 1:
            turn(powers, r, q, y, other, alive)
            for i in range(alive):
                y[0, i], y[1, i] = other[0, i], other[1, i]
        count >>= 1
        q += 1


@inlined
def sizes(y: Array, size: Array, alive: int) -> None:
    """|y|."""
    for i in range(alive):
        size[i] = math.sqrt(y[0, i] * y[0, i] + y[1, i] * y[1, i])


@inlined
def bounds(
    large: Array, bent: Array, r: int, c: int, slow: int, alive: int, size: Array, L: float
) -> tuple[float, float]:
    """bend and flat of the module's docstring."""
    bend = flat = 0.0
    for i in range(slow):
        bend += bent[r, c, i] * size[i]
    for i in range(np.uint64(slow), np.uint64(alive)):
        flat += large[r, c, i] * size[i]
    return L * L * bend, flat


@inlined
def slow_part(regimes: Regimes, r: int, k: int, y: Array, new: Array, slow: int, L: float) -> tuple[Cubic, float]:
    """p of the module's docstring, of position k from y to ``new``, L > 1 steps later, and p(L)."""
    w0, d0 = value(regimes.nodes, r, k, y, 0, slow), value(regimes.steps, r, k, y, 0, slow)
    w1, d1 = value(regimes.nodes, r, k, new, 0, slow), value(regimes.steps, r, k, new, 0, slow)
    mean = (w1 - w0 - d0) / (L - 1.0)
    second = (mean - d0) / L
    third = ((d1 - mean) / L - second) / (L + 1.0)
    return Cubic(w0, d0 - second + third * L, second - third * (L + 1.0), third), w1


@compiled
def turning_points(c1: float, c2: float, c3: float) -> tuple[float, float]:
    """Root of c1 + 2 c2 l + 3 c3 l^2; NaN or far away where there is none."""
    root = math.sqrt(c2 * c2 - 3.0 * c1 * c3)
    q = -(c2 + math.copysign(root, c2))
    return q / (3.0 * c3), c1 / q


@compiled
def greatest(sign: float, p: Cubic, bend: float, L: float, first: float, last: float) -> float:
    """The greatest value of sign p(l) + bend l (L - l) on [first, last]."""
    w0, c1, c2, c3 = sign * p.w0, sign * p.c1 + bend * L, sign * p.c2 - bend, sign * p.c3
    most = max(w0 + first * (c1 + first * (c2 + first * c3)), w0 + last * (c1 + last * (c2 + last * c3)))
    for point in turning_points(c1, c2, c3):
        if point > first and point < last:
            most = max(most, w0 + point * (c1 + point * (c2 + point * c3)))
    return most


@compiled
def keeps(side: float, g1: float, g2: float) -> tuple[float, float]:
    """Between which numbers, themselves included, a contact on ``side`` is as long as it stays there."""
    if side == 0.0:
        return g1, g2
    return (np.nextafter(g2, np.inf), np.inf) if side > 0.0 else (-np.inf, np.nextafter(g1, -np.inf))


@compiled
def judge(
    low: float, high: float, now: float, then: float, p: Cubic, bend: float, flat: float, L: float
) -> tuple[int, int, int]:
    """True where a position that is ``now`` stays between ``low`` and ``high`` for L steps, after which it is ``then``.

    With it over how many of them it should be possible to show, and after how many it seems to leave, 0 for not in L.
    """
    verdict, ahead, left = SURE, 0, 0
    for sign, stop in ((-1.0, low), (1.0, high)):
        if not math.isinf(stop):
            gap0, gap1 = sign * (stop - now), sign * (stop - then)
            if not gap0 >= 0.0:
                return OVER, 0, 0
            if gap1 < 0.0:
                left = int(L)
            if not greatest(sign, p, bend, L, 0.0, L - 1.0) + flat <= sign * stop:
                if gap1 < 0.0:
                    ahead, left = reached(sign, p, gap0, gap1, bend, flat, L)
                    return CROSSED, ahead, left
                verdict = OPEN
    return verdict, ahead, left


@compiled
def reached(sign: float, p: Cubic, gap0: float, gap1: float, bend: float, flat: float, L: float) -> tuple[int, int]:
    """ahead and left of ``judge``, where it crosses: the cubic's, and its bound's as far as that, which is less."""
    rate0, rate1 = -sign * p.c1, -sign * (p.c1 + L * (2.0 * p.c2 + L * 3.0 * p.c3))
    left = L * first_crossing(gap0, rate0 * L, gap1, rate1 * L)
    rate1 = -sign * (p.c1 + left * (2.0 * p.c2 + left * 3.0 * p.c3))
    slope = bend * (left / L) ** 2 * left
    kept = max(gap0 - flat, 0.5 * gap0)
    ahead = left * first_crossing(kept, (rate0 - slope) * left, -flat, (rate1 + slope) * left)
    return max(1, int(min(math.ceil(ahead), 0.75 * L))), max(1, math.ceil(left))


@compiled
def whole_level(count: int) -> int:
    """The largest q with 2^q <= count, 0 for count < 1."""
    q = 0
    while count > 1:
        count >>= 1
        q += 1
    return q


@inlined
def leave(regimes: Regimes, r: int, y: Array, alive: int, z: Array) -> None:
    """The packed state of coordinates y, its first D numbers."""
    D = np.uint64(regimes.leave.shape[3])
    for d in range(D):
        z[d] = 0.0
    for i in range(alive):
        real, imag = y[0, i], y[1, i]
        for d in range(D):
            z[d] += real * regimes.leave[0, r, i, d] - imag * regimes.leave[1, r, i, d]


@compiled
def enter(regimes: Regimes, r: int, z: Array, side: Array, law: Array, frequencies: Array, t: float, y: Array) -> None:
    """The coordinates y of the state z at time t."""
    N, D = regimes.enter.shape[2], regimes.enter.shape[3]
    m, F = law.shape[1], frequencies.shape[1]
    for i in range(N):
        real = imag = 0.0
        for d in range(D):
            real += regimes.enter[0, r, i, d] * z[d]
            imag += regimes.enter[1, r, i, d] * z[d]
        y[0, i], y[1, i] = real + regimes.held[0, r, i, 0], imag + regimes.held[1, r, i, 0]
    for c in range(m):
        if side[c] != 0.0:
            g = law[0, c, G2] if side[c] > 0.0 else law[0, c, G1]
            for i in range(N):
                y[0, i] += g * regimes.held[0, r, i, 1 + c]
                y[1, i] += g * regimes.held[1, r, i, 1 + c]
    for f in range(F):
        phase = frequencies[0, f] * t
        cosine, sine = math.cos(phase), math.sin(phase)
        for i in range(N):
            y[0, i] += cosine * regimes.held[0, r, i, 1 + m + f] + sine * regimes.held[0, r, i, 1 + m + F + f]
            y[1, i] += cosine * regimes.held[1, r, i, 1 + m + f] + sine * regimes.held[1, r, i, 1 + m + F + f]


@compiled
def emit(
    regimes: Regimes, r: int, n: int, L: int, every: int, y: Array, alive: int, work: Array,
    kept: tuple[Array, Array, Array],
) -> None:  # fmt: skip
    """Outputs at the multiples of ``every`` among the L steps after n."""
    positions, velocities, states = kept
    o = n // every + 1
    if o * every > n + L:
        return
    here, other = work[0], work[1]
    for i in range(alive):
        here[0, i], here[1, i] = y[0, i], y[1, i]
    walk(regimes.powers, r, o * every - 1 - n, here, other, alive)
    while True:
        for c in range(positions.shape[2] if positions.shape[1] else 0):
            positions[0, o, c] = value(regimes.ends, r, c, here, 0, alive)
            velocities[0, o, c] = value(regimes.rates, r, c, here, 0, alive)
        if states.shape[0]:
            turn(regimes.powers, r, 0, here, other, alive)
            leave(regimes, r, other, alive, states[o])
        o += 1
        if o * every > n + L:
            return
        turn(regimes.powers, r, regimes.powers.shape[2] - 1, here, other, alive)
        here, other = other, here


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
