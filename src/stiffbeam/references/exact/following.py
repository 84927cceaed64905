"""From switch to switch without damping: one contact, three regimes, all of it compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...basics.compiled import compiled
from .oscillation import oscillations, pair
from .pressing import area, peak
from .switching import TURNS, search
from .terms import CONSTANT, LEVEL, OMEGA, SQUARE, X, Y, layout, tabulate
from .touching import EPS


class Regimes(NamedTuple):
    """What differs between the regimes, in arrays: of (free, contact) or of (lower, free, upper).

    omegas: (2, n). rows: (2, n), the contact position's modal row. levels: (3, n). particulars: (3, n, d), see
    ``Regime``. waves: (3, d), what the row sees of these, the offset included; constant: the offset's own. cross:
    (2, n, n), from the modes of each into those of the other. frequencies: (F,).
    close: (p, 2), close_forces: (3, p, 2), see ``Regime``. order, speeds: (2, n + F), modes and then drives by their
    frequency, and that. g1, g2: the stops.
    """

    omegas: Array
    rows: Array
    levels: Array
    particulars: Array
    waves: Array
    constant: float
    cross: Array
    frequencies: Array
    close: NDArray[np.int64]
    close_forces: Array
    order: NDArray[np.int64]
    speeds: Array
    g1: float
    g2: float


@compiled
def see(regimes, regime, h, rate, start, speeds, terms, seen, pairs):
    """What the contact sees of a piece that begins at ``start`` with the homogeneous part h, h', see terms.py."""
    n = h.size
    own = 0 if regime == 0 else 1
    seen[0, CONSTANT] = regimes.constant
    for k in range(speeds.shape[1]):
        j = regimes.order[own, k]
        w = regimes.speeds[own, k]
        speeds[OMEGA, k], speeds[SQUARE, k] = w, w * w
        if j < n:
            row = regimes.rows[own, j]
            terms[0, X, k], terms[0, Y, k] = row * h[j], row * rate[j]
            terms[0, LEVEL, k] = row * regimes.levels[regime + 1, j]
        else:
            a, b = regimes.waves[regime + 1, 1 + 2 * (j - n)], regimes.waves[regime + 1, 2 + 2 * (j - n)]
            s, c = math.sin(w * start), math.cos(w * start)
            terms[0, X, k], terms[0, Y, k], terms[0, LEVEL, k] = a * s + b * c, w * (a * c - b * s), 0.0
    for i in range(regimes.close.shape[0]):
        j = regimes.close[i, 0]
        pairs[i, 0], pairs[i, 1] = regimes.omegas[own, j], regimes.frequencies[regimes.close[i, 1]]
        pairs[i, 2], pairs[i, 3] = regimes.close_forces[regime + 1, i, 0], regimes.close_forces[regime + 1, i, 1]
        pairs[i, 4] = regimes.rows[own, j]


@compiled
def advance(regimes, regime, h, rate, start, tau, q, v, c, s, versine):
    """The homogeneous part and the answers of close pairs at start + tau into q, v (n,); c, s, versine: work, (n,)."""
    own = 0 if regime == 0 else 1
    omega, level = regimes.omegas[own], regimes.levels[regime + 1]
    oscillations(omega, tau, c, s, versine)
    for j in range(h.size):
        q[j] = h[j] * c[j] + rate[j] * s[j] + level[j] * versine[j]
    for j in range(h.size):
        v[j] = rate[j] * c[j] + (level[j] - omega[j] * omega[j] * h[j]) * s[j]
    for i in range(regimes.close.shape[0]):
        j = regimes.close[i, 0]
        force = regimes.close_forces[regime + 1, i]
        eta, eta_rate, _ = pair(omega[j], regimes.frequencies[regimes.close[i, 1]], force[0], force[1], start, tau)
        q[j] += eta
        v[j] += eta_rate


@compiled
def drive(regimes, regime, t, sign, q, v):
    """Add the particular solution, ``sign`` times, to q and v (n,)."""
    particular = regimes.particulars[regime + 1]
    for k in range(regimes.frequencies.size):
        w = regimes.frequencies[k]
        s, c = sign * math.sin(w * t), sign * math.cos(w * t)
        for j in range(q.size):
            a, b = particular[j, 1 + 2 * k], particular[j, 2 + 2 * k]
            q[j] += a * s + b * c
            v[j] += w * (a * c - b * s)


@compiled
def change(cross, q, v, h, rate):
    """cross q and cross v into h, rate (n,): from the modes of one contact state to those of the other."""
    n = q.size
    for j in range(n):
        a = 0.0
        b = 0.0
        for i in range(n):
            a += cross[j, i] * q[i]
            b += cross[j, i] * v[i]
        h[j] = a
        rate[j] = b


@compiled
def unsettle(regimes, old, h, rate, start, new, t, noise, size, new_h, new_rate):
    """Change h and h' of a piece that begins at t in the regime ``new`` by what is lost there: the rounding of t, and
    of the sums that carry the amplitudes of the ``old`` regime, h and rate at its ``start``, over to the new one.
    noise: (3, n)."""
    n = h.size
    own, other = (0, 1) if old == 0 else (1, 0)
    omega, level, particular = regimes.omegas[own], regimes.levels[old + 1], regimes.particulars[old + 1]
    place, speed = np.empty(n), np.empty(n)
    for j in range(n):
        w = omega[j]
        reach = min(1.0 / max(w, 1e-300), t - start)  # |sin(omega tau)/omega| at most
        place[j] = abs(h[j]) + abs(rate[j]) * reach
        speed[j] = abs(rate[j]) + abs(level[j] - w * w * h[j]) * reach
        for k in range(regimes.frequencies.size):
            driven = abs(particular[j, 1 + 2 * k]) + abs(particular[j, 2 + 2 * k])
            place[j] += driven
            speed[j] += regimes.frequencies[k] * driven
    late = size * noise[0, 0] * t
    new_level, new_omega = regimes.levels[new + 1], regimes.omegas[other]
    for j in range(n):
        a = 0.0
        b = 0.0
        for i in range(n):
            a += (regimes.cross[own, j, i] * place[i]) ** 2
            b += (regimes.cross[own, j, i] * speed[i]) ** 2
        new_h[j] += late * new_rate[j] + size * noise[1, j] * math.sqrt(a)
        new_rate[j] += late * (new_level[j] - new_omega[j] ** 2 * new_h[j]) + size * noise[2, j] * math.sqrt(b)


@compiled
def follow(regimes, regime, h, rate, t_start, t_end, at_switch, noise, size, out_t, out_regime, out_h, out_rate):
    """Follow the solution from (h, h') at t_start in ``regime`` until t_end or until the output is full.

    at_switch: the start is a switch, its gap exactly 0. noise: (switches, 3, n) in [-1, 1], what ``unsettle`` takes
    ``size`` times at every switch; none for size 0. Returns (switches written, evaluations). Raises SolverFailure
    where the motion overflows or the search stands still.
    """
    n = h.size
    speeds, terms, seen, pairs = layout(1, n + regimes.frequencies.size, regimes.close.shape[0])
    chi, resting = np.empty(1, np.int64), np.empty(1, np.int64)
    g1, g2 = np.array([regimes.g1]), np.array([regimes.g2])
    q, v, c, s, versine = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    speeds[OMEGA] = regimes.speeds[0]
    free, free_steps = tabulate(speeds, False)
    speeds[OMEGA] = regimes.speeds[1]
    held, held_steps = tabulate(speeds, False)
    count = 0
    evaluations = 0
    while count < out_t.size:
        see(regimes, regime, h, rate, t_start, speeds, terms, seen, pairs)
        chi[0], resting[0] = regime, at_switch
        own = 0 if regime == 0 else 1
        powers, steps = (free, free_steps) if regime == 0 else (held, held_steps)
        tau, contact, side, used = search(
            speeds, terms, seen, pairs, powers, steps, chi, g1, g2, resting, t_start, t_end
        )  # fmt: skip
        evaluations += used
        t = t_start + tau
        if contact < 0 or t >= t_end:
            break
        new = side if regime == 0 else 0
        advance(regimes, regime, h, rate, t_start, tau, q, v, c, s, versine)
        drive(regimes, regime, t, 1.0, q, v)
        new_h, new_rate = out_h[count], out_rate[count]
        change(regimes.cross[own], q, v, new_h, new_rate)
        drive(regimes, new, t, -1.0, new_h, new_rate)
        if size > 0.0:
            unsettle(regimes, regime, h, rate, t_start, new, t, noise[count], size, new_h, new_rate)
        out_t[count], out_regime[count] = t, new
        h, rate, regime, t_start, at_switch = new_h, new_rate, new, t, True
        count += 1
    return count, evaluations


@compiled
def amplitudes(regimes, times, sides, h, rate, t, piece, q, v):
    """The modal amplitudes and their rates at times t inside the given pieces into q, v (k, n)."""
    c, s, versine = np.empty(h.shape[1]), np.empty(h.shape[1]), np.empty(h.shape[1])
    for i in range(t.size):
        k = piece[i]
        advance(regimes, sides[k], h[k], rate[k], times[k], t[i] - times[k], q[i], v[i], c, s, versine)
        drive(regimes, sides[k], t[i], 1.0, q[i], v[i])


@compiled
def observe(regimes, times, sides, h, rate, rows, waves, t, piece, u, v):
    """row . q and its rate at times t inside the given pieces into u and v (k,).

    times, sides, h, rate: of all pieces. rows: (2, n), the row in the modes of the free system and of that in contact.
    waves: (3, d), what it sees of the particular solutions. Where t is equidistant all turns by the same angles.
    """
    n, waves_seen = h.shape[1], regimes.frequencies.size
    q, w, c, s, versine = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    x, c1, s1, v1 = np.empty(n), np.empty((2, n)), np.empty((2, n)), np.empty((2, n))
    now, turn = np.empty((2, waves_seen)), np.empty((2, waves_seen))
    even, turned = t.size > 4 and regimes.close.shape[0] == 0, 0
    step = (t[t.size - 1] - t[0]) / (t.size - 1) if even else 0.0
    for i in range(1, t.size):
        even &= abs(t[i] - t[0] - i * step) <= 2.0 * EPS * t[t.size - 1]
    if even:
        for j in range(2):
            oscillations(regimes.omegas[j], step, c1[j], s1[j], v1[j])
        for j in range(waves_seen):
            turn[0, j], turn[1, j] = math.sin(regimes.frequencies[j] * step), math.cos(regimes.frequencies[j] * step)
    for i in range(t.size):
        k = piece[i]
        side = sides[k]
        own = 0 if side == 0 else 1
        if even and i > 0 and piece[i - 1] == k and turned < TURNS:
            turned += 1
            for j in range(n):
                x[j] = q[j] * c1[own, j] + w[j] * s1[own, j] + regimes.levels[side + 1, j] * v1[own, j]
            for j in range(n):
                pull = regimes.levels[side + 1, j] - regimes.omegas[own, j] * regimes.omegas[own, j] * q[j]
                w[j] = w[j] * c1[own, j] + pull * s1[own, j]
            for j in range(n):
                q[j] = x[j]
            for j in range(waves_seen):
                a, b = now[0, j], now[1, j]
                now[0, j], now[1, j] = a * turn[1, j] + b * turn[0, j], b * turn[1, j] - a * turn[0, j]
        else:
            turned = 0
            advance(regimes, side, h[k], rate[k], times[k], t[i] - times[k], q, w, c, s, versine)
            for j in range(waves_seen):
                now[0, j], now[1, j] = math.sin(regimes.frequencies[j] * t[i]), math.cos(regimes.frequencies[j] * t[i])
        position, velocity = waves[side + 1, 0], 0.0
        for j in range(n):
            position += rows[own, j] * q[j]
            velocity += rows[own, j] * w[j]
        for j in range(waves_seen):
            a, b = waves[side + 1, 1 + 2 * j], waves[side + 1, 2 + 2 * j]
            position += a * now[0, j] + b * now[1, j]
            velocity += regimes.frequencies[j] * (a * now[1, j] - b * now[0, j])
        u[i], v[i] = position, velocity


@compiled
def energy_norm(regimes, own, q, v, x, y):
    """sqrt(v^T M v + q^T K q) without contact of modal q, v (n,) of the free system, own 0, or of that in contact."""
    if own == 1:
        change(regimes.cross[1], q, v, x, y)
        return energy_norm_free(regimes.omegas[0], x, y)
    return energy_norm_free(regimes.omegas[0], q, v)


@compiled
def energy_norm_free(omega, q, v):
    """See ``energy_norm``."""
    total = 0.0
    for j in range(q.size):
        total += v[j] * v[j] + (omega[j] * q[j]) ** 2
    return math.sqrt(total)


@compiled
def grow(regimes, sides, piece, widths, q, v, enough, logs):
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
                q[k], v[k] = x, y
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
def press(regimes, times, sides, h, rate, starts, ends, deepest, depths):
    """How far the contact is at most beyond its stop in [starts, ends] (k,), and the integral of how far it is."""
    speeds, terms, seen, pairs = layout(1, h.shape[1] + regimes.frequencies.size, regimes.close.shape[0])
    for i in range(starts.size):
        k = np.searchsorted(times, starts[i], side="right") - 1
        while k < times.size and times[k] < ends[i]:
            until = times[k + 1] if k + 1 < times.size else math.inf
            if sides[k] != 0 and until > starts[i]:
                stop = regimes.g2 if sides[k] > 0 else regimes.g1
                see(regimes, sides[k], h[k], rate[k], times[k], speeds, terms, seen, pairs)
                a, b = max(0.0, starts[i] - times[k]), min(until, ends[i]) - times[k]
                deepest[i] = max(deepest[i], peak(speeds, terms, seen, pairs, times[k], a, b, float(sides[k]), stop))
                depths[i] += sides[k] * area(speeds, terms, seen, pairs, times[k], a, b, stop)
            k += 1
