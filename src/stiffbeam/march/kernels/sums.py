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

from ...basics.arrays import Array
from ...basics.compiled import compiled, inlined
from ...model.contact_law import G1, G2
from ...trajectory.sampling import first_crossing

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
    """Where c1 + 2 c2 l + 3 c3 l^2 = 0; NaN or far away where there is none."""
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
    """Whether a position that is ``now`` stays between ``low`` and ``high`` for L steps, after which it is ``then``.

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
