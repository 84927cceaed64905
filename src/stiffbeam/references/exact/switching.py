"""The compiled switch search: follow a piecewise-linear solution without missing a crossing.

In every regime the gap is the distance to the stop (free) or the penetration (in contact), so gap >= 0
and the regime ends when it closes. A step of length s is safe when a lower bound of the gap stays
positive on it, gap + gap' s - B2 s^2/2; where the gap is zero to rounding its Taylor polynomial decides
(touching.py).

The search ends: a contact switches at most once at any instant of float64, so time goes on after as many
switches as there are contacts, and since forces are continuous, true switches do not accumulate. Where
it needs more evaluations than any such motion does, it raises SolverFailure with the time.
"""

from __future__ import annotations

import math

import numpy as np

from ...basics.compiled import compiled
from ...trajectory.trajectory import SolverFailure
from .oscillation import oscillation, pair, pair_sizes
from .touching import (
    CLOSES,
    EPS,
    FAINT,
    ORDER,
    PER_RADIAN,
    REMEDY,
    ROUNDINGS,
    SHORTEST,
    STALLED,
    UNCLEAR,
    as_gap,
    gap_step,
    taylor_step,
)


@compiled
def bounds(h, rate, omega, level, particular, row, offset, frequencies, close, close_force, rest):
    """B0, B2 >= |u''| and B3 >= |u'''| for the rest of a piece, u the contact position; B0: its size, for rounding."""
    b0 = abs(offset[0])
    b2 = 0.0
    b3 = 0.0
    for j in range(h.size):
        amplitude = abs(row[j]) * math.hypot(level[j] - omega[j] * omega[j] * h[j], omega[j] * rate[j])
        b0 += abs(row[j]) * (math.hypot(h[j], rate[j] / omega[j]) if omega[j] > 0.0 else abs(h[j]))
        b2 += amplitude
        b3 += amplitude * omega[j]
    for k in range(frequencies.size):
        s = offset[1 + 2 * k]
        c = offset[2 + 2 * k]
        for j in range(h.size):
            s += row[j] * particular[j, 1 + 2 * k]
            c += row[j] * particular[j, 2 + 2 * k]
        amplitude = math.hypot(s, c) * frequencies[k] ** 2
        b0 += math.hypot(s, c)
        b2 += amplitude
        b3 += amplitude * frequencies[k]
    for i in range(close.shape[0]):
        j = close[i, 0]
        w = omega[j]
        size, speed, force = pair_sizes(i, close, close_force, omega, frequencies, rest)
        b0 += abs(row[j]) * size
        b2 += abs(row[j]) * (force + w * w * size)
        b3 += abs(row[j]) * (frequencies[close[i, 1]] * force + w * w * speed)
    # Rounding in the sums above.
    return b0, b2 * (1.0 + 1e-12) + 1e-300, b3 * (1.0 + 1e-12) + 1e-300


@compiled
def derivatives(h, rate, omega, level, particular, row, offset, frequencies, close, close_force, tau, t, rest, d, b):
    """u and its derivatives at tau into d (ORDER + 1,), and into b the sizes of the terms they are sums of.

    rest: how long the piece may last, which bounds the answers of close pairs."""
    d[:] = 0.0
    b[:] = 0.0
    d[0] = offset[0]
    b[0] = abs(offset[0])
    for j in range(h.size):
        w = omega[j]
        size = abs(row[j])
        c, s_over, level_part = oscillation(w, tau)
        start = level[j] - w * w * h[j]
        d[0] += row[j] * (h[j] * c + rate[j] * s_over + level[j] * level_part)
        b[0] += size * (abs(h[j] * c) + abs(rate[j] * s_over) + abs(level[j] * level_part))
        odd = rate[j] * c + start * s_over
        d[1] += row[j] * odd
        b[1] += size * (abs(rate[j] * c) + abs(start * s_over))
        even = start * c - rate[j] * w * w * s_over
        amplitude = size * math.hypot(start, w * rate[j])
        for k in range(2, ORDER + 1):
            d[k] += row[j] * even
            b[k] += amplitude
            amplitude *= w
            odd, even = even, -w * w * odd
    for k in range(frequencies.size):
        w = frequencies[k]
        ps = offset[1 + 2 * k]
        pc = offset[2 + 2 * k]
        size = abs(ps) + abs(pc)
        for j in range(h.size):
            ps += row[j] * particular[j, 1 + 2 * k]
            pc += row[j] * particular[j, 2 + 2 * k]
            size += abs(row[j]) * (abs(particular[j, 1 + 2 * k]) + abs(particular[j, 2 + 2 * k]))
        s = math.sin(w * t)
        c = math.cos(w * t)
        value, other = ps * s + pc * c, ps * c - pc * s
        for i in range(ORDER + 1):
            d[i] += value
            b[i] += size
            value, other = w * other, -w * value
            size *= w
    for i in range(close.shape[0]):
        w = omega[close[i, 0]]
        frequency = frequencies[close[i, 1]]
        weight = row[close[i, 0]]
        even, odd, _ = pair(i, close, close_force, omega, frequencies, t - tau, tau)
        s = math.sin(frequency * t)
        c = math.cos(frequency * t)
        force, turned = close_force[i, 0] * s + close_force[i, 1] * c, close_force[i, 0] * c - close_force[i, 1] * s
        even_size, odd_size, force_size = pair_sizes(i, close, close_force, omega, frequencies, rest)
        for k in range(ORDER + 1):  # eta^(k + 2) = f^(k) - w^2 eta^(k)
            d[k] += weight * even
            b[k] += abs(weight) * even_size
            even, odd = odd, force - w * w * even
            even_size, odd_size = odd_size, force_size + w * w * even_size
            force, turned = frequency * turned, -frequency * force
            force_size *= frequency


@compiled
def position(h, rate, omega, level, particular, row, offset, frequencies, close, close_force, tau, t):
    """u, u', u'' of the contact position at tau after the start of a piece, t = its absolute time."""
    u = offset[0]
    v = 0.0
    a = 0.0
    for j in range(h.size):
        w = omega[j]
        c, s_over, level_part = oscillation(w, tau)
        u += row[j] * (h[j] * c + rate[j] * s_over + level[j] * level_part)
        v += row[j] * (rate[j] * c + (level[j] - w * w * h[j]) * s_over)
        a += row[j] * ((level[j] - w * w * h[j]) * c - rate[j] * w * w * s_over)
    for k in range(frequencies.size):
        w = frequencies[k]
        s = math.sin(w * t)
        c = math.cos(w * t)
        ps = offset[1 + 2 * k]
        pc = offset[2 + 2 * k]
        for j in range(h.size):
            ps += row[j] * particular[j, 1 + 2 * k]
            pc += row[j] * particular[j, 2 + 2 * k]
        u += ps * s + pc * c
        v += w * (ps * c - pc * s)
        a -= w * w * (ps * s + pc * c)
    for i in range(close.shape[0]):
        eta, eta_rate, curve = pair(i, close, close_force, omega, frequencies, t - tau, tau)
        u += row[close[i, 0]] * eta
        v += row[close[i, 0]] * eta_rate
        a += row[close[i, 0]] * curve
    return u, v, a


@compiled
def follow_row(t, piece, starts, h, rate, omega, level, row, wave, frequencies, close, close_force, u, v):
    """row . eta and its rate at times t inside the given pieces, all of one regime, into u and v (k,).

    starts, h, rate: of all pieces. row: modal. wave: (d,), what row sees of the particular solution.
    close, close_force: see ``Regime``.
    """
    for i in range(t.size):
        own_h, own_rate = h[piece[i]], rate[piece[i]]
        tau = t[i] - starts[piece[i]]
        position = velocity = 0.0
        for j in range(omega.size):
            c, s_over, level_part = oscillation(omega[j], tau)
            position += row[j] * (own_h[j] * c + own_rate[j] * s_over + level[j] * level_part)
            velocity += row[j] * (own_rate[j] * c + (level[j] - omega[j] * omega[j] * own_h[j]) * s_over)
        for k in range(frequencies.size):
            s, c = math.sin(frequencies[k] * t[i]), math.cos(frequencies[k] * t[i])
            position += wave[1 + 2 * k] * s + wave[2 + 2 * k] * c
            velocity += frequencies[k] * (wave[1 + 2 * k] * c - wave[2 + 2 * k] * s)
        for k in range(close.shape[0]):
            eta, eta_rate, _ = pair(k, close, close_force, omega, frequencies, starts[piece[i]], tau)
            position += row[close[k, 0]] * eta
            velocity += row[close[k, 0]] * eta_rate
        u[i], v[i] = position, velocity


@compiled
def follow(
    h, rate, regime, t_start, t_end, at_switch,
    omegas, levels, particulars, rows, offset, to_contact, frequencies, close, close_forces, g1, g2,
    out_t, out_regime, out_h, out_rate,
):  # fmt: skip
    """Follow the solution from (h, h') at t_start in ``regime`` until t_end or until the output is full.

    Arrays over regimes: omegas, rows (free, contact); levels, particulars, close_forces (lower, free, upper).
    at_switch: the start is a switch, its gap exactly 0. Returns (switches written, evaluations). Raises
    SolverFailure where the motion overflows or the search stands still.
    """
    n = h.size
    waves = frequencies.size
    count = 0
    evaluations = 0
    q = np.empty(n)
    v = np.empty(n)
    new_h = np.empty(n)
    new_rate = np.empty(n)
    series, sizes = np.empty(ORDER + 1), np.empty(ORDER + 1)
    nu = EPS * (ROUNDINGS + 2.0 * math.sqrt(n))
    while count < out_t.size:
        own = 0 if regime == 0 else 1
        omega = omegas[own]
        row = rows[own]
        level = levels[regime + 1]
        particular = particulars[regime + 1]
        close_force = close_forces[regime + 1]
        rest = t_end - t_start
        b0, b2, b3 = bounds(h, rate, omega, level, particular, row, offset, frequencies, close, close_force, rest)
        if not b0 + b2 + b3 < math.inf:
            raise SolverFailure("exact", t_start, "the motion overflows float64", REMEDY)
        fastest = omega[n - 1]
        for k in range(waves):
            fastest = max(fastest, frequencies[k])
        tau = 0.0
        target = 0
        steps = faint = 0
        resting = at_switch  # the gap of the stop just left or met is exactly zero
        while target == 0:
            u, speed, _ = position(
                h, rate, omega, level, particular, row, offset, frequencies, close, close_force, tau, t_start + tau
            )
            steps += 1
            step = math.inf
            nearest = 1 if abs(u - g2) <= abs(u - g1) else -1
            for side in (1, -1):
                stop = g2 if side > 0 else g1
                if math.isinf(stop) or (regime != 0 and regime != side):
                    continue
                # gap >= 0 in the present regime: distance to the stop when free, penetration in contact.
                sign = -side if regime == 0 else side
                zero = resting and side == nearest
                gap = 0.0 if zero else sign * (u - stop)
                safe, verdict = gap_step(gap, sign * speed, b2, b3, nu * (abs(stop) + b0), t_start + tau)
                if verdict == UNCLEAR:
                    derivatives(
                        h, rate, omega, level, particular, row, offset, frequencies, close, close_force, tau,
                        t_start + tau, rest, series, sizes,
                    )  # fmt: skip
                    as_gap(series, sizes, sign, stop, zero)
                    safe, verdict = taylor_step(series, sizes, nu, zero)
                    if verdict == UNCLEAR and abs(series[1]) > 2.0 * nu * sizes[1]:
                        faint += 1
                if verdict == CLOSES and not zero:
                    target = side
                    step = safe
                    break
                step = min(step, safe)
            if target != 0:
                tau += step
                break
            resting = False
            step = max(step, EPS * (t_start + tau), SHORTEST * t_end)
            if t_start + tau + step >= t_end:
                return count, evaluations + steps
            tau += step
            if faint > FAINT:
                raise SolverFailure("exact", t_start + tau, "a contact moves by less than its rounding", REMEDY)
            if steps > STALLED + PER_RADIAN * fastest * tau:
                raise SolverFailure("exact", t_start + tau, "the search for the next switch stands still", REMEDY)
        evaluations += steps
        t = t_start + tau
        if t >= t_end:
            return count, evaluations
        # The state at the switch, in the modes of the regime that ends.
        for j in range(n):
            w = omega[j]
            c, s_over, level_part = oscillation(w, tau)
            q[j] = h[j] * c + rate[j] * s_over + level[j] * level_part
            v[j] = rate[j] * c + (level[j] - w * w * h[j]) * s_over
        for i in range(close.shape[0]):
            eta, eta_rate, _ = pair(i, close, close_force, omega, frequencies, t_start, tau)
            q[close[i, 0]] += eta
            v[close[i, 0]] += eta_rate
        new_regime = target if regime == 0 else 0
        old_particular = particular
        new_particular = particulars[new_regime + 1]
        for k in range(waves):
            w = frequencies[k]
            s = math.sin(w * t)
            c = math.cos(w * t)
            for j in range(n):
                ps = old_particular[j, 1 + 2 * k]
                pc = old_particular[j, 2 + 2 * k]
                q[j] += ps * s + pc * c
                v[j] += w * (ps * c - pc * s)
        for j in range(n):
            a = 0.0
            b = 0.0
            if regime == 0:
                for i in range(n):
                    a += to_contact[i, j] * q[i]
                    b += to_contact[i, j] * v[i]
            else:
                for i in range(n):
                    a += to_contact[j, i] * q[i]
                    b += to_contact[j, i] * v[i]
            for k in range(waves):
                w = frequencies[k]
                s = math.sin(w * t)
                c = math.cos(w * t)
                ps = new_particular[j, 1 + 2 * k]
                pc = new_particular[j, 2 + 2 * k]
                a -= ps * s + pc * c
                b -= w * (ps * c - pc * s)
            new_h[j] = a
            new_rate[j] = b
        for j in range(n):
            h[j] = new_h[j]
            rate[j] = new_rate[j]
        regime = new_regime
        t_start = t
        at_switch = True
        out_t[count] = t
        out_regime[count] = regime
        for j in range(n):
            out_h[count, j] = h[j]
            out_rate[count, j] = rate[j]
        count += 1
    return count, evaluations
