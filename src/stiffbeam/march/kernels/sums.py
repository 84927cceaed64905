"""Sums of powers: reading them, turning them by many steps at once, and what they do in between, proven.

    w(l) = Re sum_i c_i y_i lambda_i^l,     |lambda_i| <= 1,

is the position at a node of step l of a stretch, see regimes. For 1 <= l <= L

    |w(l) - p(l)| <= (L^2 - 1)^2/384 sum_{i slow} |c_i y_i| |lambda_i - 1|^4  +  sum_{i fast} |c_i y_i|

with p the cubic through the slow part of w at l = 0, 1, L, L + 1. By Newton's formula the error of p is
l (l - 1)(l - L)(l - L - 1) times a fourth divided difference of the slow part, which is a mean of its fourth
differences over 24; the fourth difference of c y lambda^l is c y (lambda - 1)^4 lambda^l, and the product is at
most (L^2 - 1)^2/16. At l = 0 p is the slow part itself. A coordinate is fast where its whole amplitude is less
than its share of the first sum would be. The least and the greatest value of p, the bound added, say what no step
in between does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...basics.arrays import Array
from ...basics.compiled import compiled, inlined
from ...model.contact_law import G1, G2
from ...trajectory.sampling import first_crossing

SURE, OPEN, CROSSED = range(3)
TINY = 2e-15  # rounding of a position, relative


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
    bent: Array  # (R, m, N): that times |lambda - 1|^4/384
    ends: Array  # (2, R, C, N): c of the channels at the ends of the steps
    rates: Array  # (2, R, C, N): of their velocities
    enter: Array  # (2, R, N, D): y = enter z + held g,
    held: Array  # (2, R, N, d): g = (1, places of closed stops, cosines, sines)
    leave: Array  # (2, R, N, D): z = Re leave^T y


@inlined
def value(c: Array, r: int, k: int, y: Array, first: int, last: int) -> float:
    """Re sum c y over coordinates first to last."""
    total = 0.0
    for i in range(first, last):
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
def error_of(large: Array, bent: Array, r: int, c: int, slow: int, alive: int, size: Array, L: float) -> float:
    """The bound of the module's docstring."""
    of_slow = of_fast = 0.0
    for i in range(slow):
        of_slow += bent[r, c, i] * size[i]
    for i in range(slow, alive):
        of_fast += large[r, c, i] * size[i]
    return (L * L - 1.0) * (L * L - 1.0) * of_slow + of_fast


@compiled
def cubic(w0: float, d0: float, w1: float, d1: float, L: float) -> tuple[float, float, float]:
    """c1, c2, c3 of p(l) = w0 + c1 l + c2 l^2 + c3 l^3 through w0, w0 + d0, w1, w1 + d1 at l = 0, 1, L, L + 1."""
    mean = (w1 - w0 - d0) / (L - 1.0)
    second = (mean - d0) / L
    third = ((d1 - mean) / L - second) / (L + 1.0)
    return d0 - second + third * L, second - third * (L + 1.0), third


@compiled
def turning_points(c1: float, c2: float, c3: float) -> tuple[float, float]:
    """Where c1 + 2 c2 l + 3 c3 l^2 = 0; NaN or far away where there is none."""
    root = math.sqrt(c2 * c2 - 3.0 * c1 * c3)
    q = -(c2 + math.copysign(root, c2))
    return q / (3.0 * c3), c1 / q


@compiled
def extent(w0: float, c1: float, c2: float, c3: float, L: float) -> tuple[float, float]:
    """The least and the greatest value of the cubic on [0, L]."""
    end = w0 + L * (c1 + L * (c2 + L * c3))
    low, high = min(w0, end), max(w0, end)
    one, two = turning_points(c1, c2, c3)
    if one > 0.0 and one < L:
        there = w0 + one * (c1 + one * (c2 + one * c3))
        low, high = min(low, there), max(high, there)
    if two > 0.0 and two < L:
        there = w0 + two * (c1 + two * (c2 + two * c3))
        low, high = min(low, there), max(high, there)
    return low, high


@compiled
def farthest(sign: float, w0: float, c1: float, c2: float, c3: float, last: float) -> float:
    """The greatest sign p(l) at the whole numbers l = 0 .. last."""
    far = max(sign * w0, sign * (w0 + last * (c1 + last * (c2 + last * c3))))
    for point in turning_points(c1, c2, c3):
        if point > 0.0 and point < last:
            for at in (math.floor(point), math.ceil(point)):
                far = max(far, sign * (w0 + at * (c1 + at * (c2 + at * c3))))
    return far


@compiled
def keeps(side: float, low: float, high: float, error: float, g1: float, g2: float) -> int:
    """Whether positions between ``low`` and ``high`` with an ``error`` are on their side."""
    if side == 0.0:
        sure = low - error >= g1 and high + error <= g2
        crossed = high - error > g2 or low + error < g1
    elif side > 0.0:
        sure, crossed = low - error > g2, low + error <= g2
    else:
        sure, crossed = high + error < g1, high - error >= g1
    return SURE if sure else (CROSSED if crossed else OPEN)


@compiled
def whole_level(count: int) -> int:
    """The largest q with 2^q <= count, 0 for count < 1."""
    q = 0
    while count > 1:
        count >>= 1
        q += 1
    return q


@compiled
def reached(
    side: float, w0: float, d0: float, w1: float, d1: float, L: float, error: float, g1: float, g2: float
) -> tuple[int, int]:
    """After how many of L steps a position comes as near to leaving its side as its ``error``, or half as near as it
    is, at least one, and after how many it leaves; none where it has left, half of them where it comes back."""
    if side == 0.0:
        sign, stop = (1.0, g2) if w1 > g2 else (-1.0, g1)
    else:
        sign, stop = (-1.0, g2) if side > 0.0 else (1.0, g1)
    gap0, gap1 = sign * (stop - w0), sign * (stop - w1)
    if gap0 < -error:
        return 0, 0
    near = min(error, 0.5 * gap0)  # closer than its error, which is less over fewer steps, nothing can be shown
    if not (gap0 > 0.0 and gap1 <= 0.0):
        return max(1, int(L) // 2), int(L)
    v0, v1 = -sign * d0 * L, -sign * d1 * L
    ahead = math.ceil(L * first_crossing(gap0 - near, v0, gap1 - near, v1)) - 1
    return max(1, ahead), max(1, ahead, math.ceil(L * first_crossing(gap0, v0, gap1, v1)))


@compiled
def deepest(
    regimes: Regimes, r: int, k: int, c: int, side: float, g: float, y: Array, q: int, alive: int, best: float,
    work: Array,
) -> float:  # fmt: skip
    """The greatest depth of position k in the 2^q steps from y, or ``best`` where that is greater.

    Halves the stretch until the cubic's bound says that a part holds nothing deeper, or is one to rounding.
    """
    here, new, size = work[0], work[1], work[2, 0]
    for i in range(alive):
        here[0, i], here[1, i] = y[0, i], y[1, i]
    at, level, total = 0, q, 1 << q
    while at < total:
        w0 = value(regimes.nodes, r, k, here, 0, alive)
        best = max(best, side * (w0 - g))
        if level > 0:
            L = float(1 << level)
            slow = min(alive, regimes.slow[r, level])
            sizes(here, size, alive)
            error = error_of(regimes.large, regimes.bent, r, c, slow, alive, size, L)
            turn(regimes.powers, r, level, here, new, alive)
            s0 = value(regimes.nodes, r, k, here, 0, slow)
            d0 = value(regimes.steps, r, k, here, 0, slow)
            s1 = value(regimes.nodes, r, k, new, 0, slow)
            d1 = value(regimes.steps, r, k, new, 0, slow)
            c1, c2, c3 = cubic(s0, d0, s1, d1, L)
            low, high = extent(s0, c1, c2, c3, L - 1.0)
            top, rounding = (high if side > 0.0 else -low) + error - side * g, TINY * abs(w0)
            if top > best + rounding:
                far = farthest(side, s0, c1, c2, c3, L - 1.0) - side * g
                best = max(best, far if error <= rounding else far - error)
                if top > best + rounding and error > rounding:
                    level -= 1
                    continue
        else:
            turn(regimes.powers, r, 0, here, new, alive)
        here, new = new, here
        at += 1 << level
        while level < q and at & ((1 << (level + 1)) - 1) == 0:
            level += 1
    return best


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
