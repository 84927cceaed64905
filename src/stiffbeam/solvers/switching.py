"""The compiled switch search: follow a piecewise-linear solution without missing a crossing.

In every regime the gap is the distance to the stop (free) or the penetration (in contact), so gap >= 0
and the regime ends when it closes. A step of length s is safe when a lower bound of the gap stays
positive on it: gap + gap' s - B2 s^2/2, or at rest on a stop gap'' s^2/2 - B3 s^3/6.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import compiled

EPS = 2.220446049250313e-16


@compiled
def oscillation(omega, tau):
    """cos(omega tau), sin(omega tau)/omega, (1 - cos(omega tau))/omega^2, regular at omega = 0."""
    x = omega * tau
    if x > 1e-4:
        s = math.sin(x)
        c = math.cos(x)
        versine = 1.0 - c if c < 0.5 else s * s / (1.0 + c)
        return c, s / omega, versine / (omega * omega)
    return 1.0 - 0.5 * x * x, tau * (1.0 - x * x / 6.0), 0.5 * tau * tau * (1.0 - x * x / 12.0)


@compiled
def bounds(h, rate, omega, level, particular, row, offset, frequencies):
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
    # Rounding in the sums above.
    return b0, b2 * (1.0 + 1e-12) + 1e-300, b3 * (1.0 + 1e-12) + 1e-300


@compiled
def position(h, rate, omega, level, particular, row, offset, frequencies, tau, t):
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
    return u, v, a


@compiled
def follow_row(t, piece, starts, h, rate, omega, level, row, wave, frequencies, u, v):
    """row . eta and its rate at times t inside the given pieces, all of one regime, into u and v (k,).

    starts, h, rate: of all pieces. row: modal. wave: (d,), what row sees of the particular solution.
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
        u[i], v[i] = position, velocity


@compiled
def safe_step(gap, rate, b2):
    """The positive root of gap + rate s - b2 s^2/2 = 0, gap >= 0: the gap cannot close before."""
    root = math.sqrt(rate * rate + 2.0 * b2 * gap)
    return (rate + root) / b2 if rate > 0.0 else (2.0 * gap / (root - rate) if root > rate else 0.0)


@compiled
def gap_step(gap, rate, curve, b2, b3, scale, at_rest, t):
    """(s, closes) for a gap >= 0 with its two derivatives: it stays positive for s, or closes at s.

    at_rest: the gap of the stop just met or left is exactly zero and its speed never negative but for
    rounding; then gap >= gap' s + max(-b2 s^2/2, gap'' s^2/2 - b3 s^3/6). scale: a size for rounding.
    """
    if b2 <= 1e-290 and rate >= 0.0:
        return math.inf, False  # nothing moves
    if at_rest:
        noise = 1e-13 * math.sqrt(b2 * scale)
        safe = 2.0 * max(rate, 0.0) / b2
        if curve > 0.0 and rate > -noise:
            x = 0.5 * curve
            safe = max(safe, (x + math.sqrt(x * x + 2.0 * b3 / 3.0 * max(rate, 0.0))) * 3.0 / b3)
        return safe, safe == 0.0  # zero: it turns straight back, touching without penetration
    safe = safe_step(max(gap, 0.0), rate, b2)
    if safe <= 4.0 * EPS * (t + safe) or gap <= 0.0:
        if rate < 0.0 or curve < 0.0:
            return safe, True
        # Grazing: the gap closes without speed and opens again. Within eps^(1/3) b2/b3 it changes by less
        # than the fastest motion's rounding.
        safe = max(safe, 3.0 * curve / b3, 6e-6 * b2 / b3, 1e-15 * t + 1e-18)
    return safe, False


@compiled
def follow(
    h, rate, regime, t_start, t_end, at_switch,
    omegas, levels, particulars, rows, offset, to_contact, frequencies, g1, g2,
    out_t, out_regime, out_h, out_rate,
):  # fmt: skip
    """Follow the solution from (h, h') at t_start in ``regime`` until t_end or until the output is full.

    Arrays over regimes: omegas, rows (free, contact); levels, particulars (lower, free, upper).
    at_switch: the start is a switch, its gap exactly 0. Returns (switches written, evaluations).
    """
    n = h.size
    d = particulars.shape[2]
    count = 0
    evaluations = 0
    q = np.empty(n)
    v = np.empty(n)
    new_h = np.empty(n)
    new_rate = np.empty(n)
    while count < out_t.size:
        own = 0 if regime == 0 else 1
        omega = omegas[own]
        row = rows[own]
        level = levels[regime + 1]
        particular = particulars[regime + 1]
        b0, b2, b3 = bounds(h, rate, omega, level, particular, row, offset, frequencies)
        tau = 0.0
        target = 0
        found = False
        resting = at_switch  # the gap of the stop just left or met is exactly zero
        while True:
            u, speed, curve = position(h, rate, omega, level, particular, row, offset, frequencies, tau, t_start + tau)
            evaluations += 1
            step = math.inf
            target = 0
            nearest = 1 if abs(u - g2) <= abs(u - g1) else -1
            for side in (1, -1):
                stop = g2 if side > 0 else g1
                if math.isinf(stop) or (regime != 0 and regime != side):
                    continue
                # gap >= 0 in the present regime: distance to the stop when free, penetration in contact.
                sign = -side if regime == 0 else side
                safe, closes = gap_step(
                    sign * (u - stop), sign * speed, sign * curve, b2, b3, abs(stop) + b0,
                    resting and side == nearest, t_start + tau,
                )  # fmt: skip
                if closes:
                    target = side
                    step = safe
                    found = True
                    break
                if safe < step:
                    step = safe
            if found:
                tau += step
                break
            resting = False
            if t_start + tau + step >= t_end:
                return count, evaluations
            if step < 1e-17 * (t_start + tau):
                step = EPS * (t_start + tau)
            tau += step
        t = t_start + tau
        if t >= t_end:
            return count, evaluations
        # The state at the switch, in the modes of the regime that ends.
        for j in range(n):
            w = omega[j]
            c, s_over, level_part = oscillation(w, tau)
            q[j] = h[j] * c + rate[j] * s_over + level[j] * level_part
            v[j] = rate[j] * c + (level[j] - w * w * h[j]) * s_over
        new_regime = target if regime == 0 else 0
        old_particular = particular
        new_particular = particulars[new_regime + 1]
        for k in range((d - 1) // 2):
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
            for k in range((d - 1) // 2):
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


@compiled
def search(sigma, omega, real, imaginary, chi, g1, g2, resting, t_start, t_end):
    """The first switch of m contacts whose positions are u_c(tau) = Re sum_k a_ck exp((sigma_k + i omega_k) tau).

    a = real + i imaginary: (m, K); sigma <= 0. chi, g1, g2: (m,). resting: the contact whose gap is
    exactly zero at the start, or -1. Returns (tau, contact, side, evaluations); contact -1: none
    before t_end. Every gap that is open or closed is kept positive, see ``gap_step``.
    """
    m, K = real.shape
    tau = 0.0
    evaluations = 0
    while True:
        evaluations += 1
        step = math.inf
        for contact in range(m):
            u = 0.0
            speed = 0.0
            curve = 0.0
            b0 = 0.0
            b2 = 1e-300
            b3 = 1e-300
            for k in range(K):
                decay = math.exp(sigma[k] * tau)
                c = math.cos(omega[k] * tau)
                s = math.sin(omega[k] * tau)
                x = decay * (real[contact, k] * c - imaginary[contact, k] * s)
                y = decay * (real[contact, k] * s + imaginary[contact, k] * c)
                size = sigma[k] * sigma[k] + omega[k] * omega[k]
                u += x
                speed += sigma[k] * x - omega[k] * y
                curve += (sigma[k] * sigma[k] - omega[k] * omega[k]) * x - 2.0 * sigma[k] * omega[k] * y
                amplitude = size * decay * math.hypot(real[contact, k], imaginary[contact, k])
                b0 += decay * math.hypot(real[contact, k], imaginary[contact, k])
                b2 += amplitude
                b3 += amplitude * math.sqrt(size)
            b2 *= 1.0 + 1e-12  # rounding in the sums
            b3 *= 1.0 + 1e-12
            nearest = 1 if abs(u - g2[contact]) <= abs(u - g1[contact]) else -1
            for side in (1, -1):
                stop = g2[contact] if side > 0 else g1[contact]
                if math.isinf(stop) or (chi[contact] != 0 and chi[contact] != side):
                    continue
                sign = -side if chi[contact] == 0 else side
                safe, closes = gap_step(
                    sign * (u - stop), sign * speed, sign * curve, b2, b3, abs(stop) + b0,
                    contact == resting and side == nearest and tau == 0.0, t_start + tau,
                )  # fmt: skip
                if closes:
                    return tau + safe, contact, side, evaluations
                step = min(step, safe)
        if t_start + tau + step >= t_end:
            return t_end - t_start, -1, 0, evaluations
        tau += max(step, EPS * (t_start + tau))
