"""What is read of the pieces of a solution without damping: states, rows of them, growth, how far it presses."""

from __future__ import annotations

import math

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.compiled import compiled
from ...piecewise.oscillation import oscillation, oscillations
from ...piecewise.pressing import area, peak
from ...piecewise.terms import layout
from ...piecewise.touching import EPS
from .following import Regimes, advance, change, drive, see

RUN = 16  # times that are answered from one of them


@compiled
def amplitudes(
    regimes: Regimes, times: Array, sides: IntArray, h: Array, rate: Array, t: Array, piece: IntArray, q: Array,
    v: Array,
) -> None:  # fmt: skip
    """The modal amplitudes and their rates at times t inside the given pieces into q, v (k, n)."""
    c, s, versine = np.empty(h.shape[1]), np.empty(h.shape[1]), np.empty(h.shape[1])
    for i in range(t.size):
        k = piece[i]
        advance(regimes, sides[k], h[k], rate[k], times[k], t[i] - times[k], q[i], v[i], c, s, versine)
        drive(regimes, sides[k], t[i], 1.0, q[i], v[i])


@compiled
def observe(
    regimes: Regimes, times: Array, sides: IntArray, h: Array, rate: Array, rows: Array, waves: Array, t: Array,
    piece: IntArray, u: Array, v: Array,
) -> None:  # fmt: skip
    """row . q and its rate at times t inside the given pieces into u and v (k,).

    times, sides, h, rate: of all pieces. rows: (2, n), the row in the modes of the free system and of that in contact.
    waves: (3, d), what it sees of the particular solutions. Up to RUN times at equal distances in one piece are
    answered from the first of them, by the turns that every mode and drive makes until the others; distances are equal
    where they differ by the rounding of the times, and that difference counts to first order.
    """
    n, F = h.shape[1], regimes.frequencies.size
    q, w, c, s, versine = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    x, y, pull, bend, turned = np.empty((5, n + F))
    distance = t[1] - t[0] if t.size > 1 and regimes.close.shape[0] == 0 else 0.0
    turns, known = np.empty((2, RUN, 3, n + F)), np.zeros(2, np.int64)
    i = 0
    while i < t.size:
        k = piece[i]
        side = sides[k]
        own = 0 if side == 0 else 1
        advance(regimes, side, h[k], rate[k], times[k], t[i] - times[k], q, w, c, s, versine)
        for j in range(n):
            x[j], y[j] = rows[own, j] * q[j], rows[own, j] * w[j]
        for j in range(F):
            frequency = regimes.frequencies[j]
            sine, cosine = math.sin(frequency * t[i]), math.cos(frequency * t[i])
            a, b = waves[side, 1 + 2 * j], waves[side, 2 + 2 * j]
            x[n + j], y[n + j] = a * sine + b * cosine, frequency * (a * cosine - b * sine)
        position, velocity = waves[side, 0], 0.0
        for j in range(n + F):
            position += x[j]
            velocity += y[j]
        u[i], v[i] = position, velocity
        count = 1
        while distance > 0.0 and count < RUN and i + count < t.size and piece[i + count] == k:
            if abs(t[i + count] - t[i] - count * distance) > 4.0 * EPS * t[i + count]:
                break
            count += 1
        if count > 1 and known[own] == 0:
            known[own] = 1
            for m in range(1, RUN):
                own_turns = turns[own, m]
                oscillations(regimes.omegas[own], m * distance, c, s, versine)
                for j in range(n):
                    own_turns[0, j], own_turns[1, j], own_turns[2, j] = c[j], s[j], versine[j]
                for j in range(F):
                    own_turns[0, n + j], own_turns[1, n + j], own_turns[2, n + j] = oscillation(
                        regimes.frequencies[j], m * distance
                    )
        if count > 1:
            for j in range(n):
                pull[j] = rows[own, j] * regimes.levels[side, j]
                square = regimes.omegas[own, j] ** 2
                bend[j], turned[j] = pull[j] - square * x[j], -square * y[j]
            for j in range(n, n + F):
                square = regimes.frequencies[j - n] ** 2
                pull[j], bend[j], turned[j] = 0.0, -square * x[j], -square * y[j]
        for m in range(1, count):
            position, velocity, acceleration = waves[side, 0], 0.0, 0.0
            for j in range(n + F):
                C, S, V = turns[own, m, 0, j], turns[own, m, 1, j], turns[own, m, 2, j]
                position += x[j] * C + y[j] * S + pull[j] * V
                velocity += y[j] * C + bend[j] * S
                acceleration += bend[j] * C + turned[j] * S
            late = t[i + m] - t[i] - m * distance
            u[i + m], v[i + m] = position + velocity * late, velocity + acceleration * late
        i += count


@compiled
def energy_norm(regimes: Regimes, own: int, q: Array, v: Array, x: Array, y: Array) -> float:
    """sqrt(v^T M v + q^T K q) without contact of modal q, v (n,) of the free system, own 0, or of that in contact."""
    if own == 1:
        change(regimes.cross[1], q, v, x, y)
        q, v = x, y
    total = 0.0
    for j in range(q.size):
        total += v[j] * v[j] + (regimes.omegas[0, j] * q[j]) ** 2
    return math.sqrt(total)


@compiled
def grow(
    regimes: Regimes,
    sides: IntArray,
    piece: IntArray,
    widths: Array,
    q: Array,
    v: Array,
    enough: float,
    logs: Array,
) -> int:
    """Carry tangent vectors q, v (vectors, n), modal in the regime of the first piece and of length 1, through the
    pieces of the given widths, (k,) each, and add up ln of their growth in logs (k + 1, vectors). Ended where a growth
    is above ``enough``; returns how many of the widths were passed, less where a vector vanishes or overflows."""
    n = q.shape[1]
    c, s, versine, x, y = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    own = 0 if sides[piece[0]] == 0 else 1
    for i in range(widths.size):
        new = 0 if sides[piece[i]] == 0 else 1
        oscillations(regimes.omegas[new], widths[i], c, s, versine)
        over = False
        for k in range(q.shape[0]):
            if new != own:
                change(regimes.cross[own], q[k], v[k], x, y)
                for j in range(n):
                    q[k, j], v[k, j] = x[j], y[j]
            for j in range(n):
                w = regimes.omegas[new, j]
                q[k, j], v[k, j] = q[k, j] * c[j] + v[k, j] * s[j], v[k, j] * c[j] - w * w * s[j] * q[k, j]
            size = energy_norm(regimes, new, q[k], v[k], x, y)
            if not 1e-150 < size < 1e150:
                return i
            for j in range(n):
                q[k, j] /= size
                v[k, j] /= size
            logs[i + 1, k] = logs[i, k] + math.log(size)
            over |= logs[i + 1, k] > enough
        own = new
        if over:
            return i + 1
    return widths.size


@compiled
def press(
    regimes: Regimes, times: Array, sides: IntArray, h: Array, rate: Array, starts: Array, ends: Array,
    first: IntArray, deepest: Array, depths: Array,
) -> None:  # fmt: skip
    """How far the contact is at most beyond its stop in [starts, ends] (k,), and the integral of how far it is.

    first: (k,), the pieces that the starts lie in.
    """
    speeds, terms, seen, pairs = layout(1, h.shape[1] + regimes.frequencies.size, regimes.close.shape[0])
    for i in range(starts.size):
        k = first[i]
        while k < times.size and times[k] < ends[i]:
            until = times[k + 1] if k + 1 < times.size else math.inf
            if sides[k] != 0 and until > starts[i]:
                stop = regimes.g2 if sides[k] > 0 else regimes.g1
                see(regimes, sides[k], h[k], rate[k], times[k], speeds, terms, seen, pairs)
                a, b = max(0.0, starts[i] - times[k]), min(until, ends[i]) - times[k]
                deepest[i] = max(deepest[i], peak(speeds, terms, seen, pairs, times[k], a, b, float(sides[k]), stop))
                depths[i] += sides[k] * area(speeds, terms, seen, pairs, times[k], a, b, stop)
            k += 1
