"""How one mode moves: freely, under a constant force, and from rest under a drive close to its own frequency.

In forms that do not cancel: the answer from rest stays regular at resonance, where a particular solution grows
without bound and the free motion beside it takes all of it away again.
"""

from __future__ import annotations

import math

from ...basics.compiled import compiled


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
def from_rest(omega, frequency, tau):
    """C, S with C'' + omega^2 C = cos(frequency tau) and S'' + omega^2 S = sin(frequency tau), at rest at 0.

    With m, d = (omega +- frequency)/2: C = sin(m tau)/m sin(d tau)/d / 2, and near resonance S = (sin(m tau)/m
    cos(d tau) - cos(m tau) sin(d tau)/d)/(2 omega), else (sin(frequency tau) - frequency sin(omega tau)/omega)/
    (omega^2 - frequency^2). Both cancel at the start: there the series, frequency tau^3 sum_n (-1)^n h_n/(2n + 3)!
    with h_n = sum_i x^(2i) y^(2n - 2i), x = omega tau, y = frequency tau. Rates: C' = sin(omega tau)/omega -
    frequency S and S' = frequency C.
    """
    m = 0.5 * (omega + frequency)
    d = 0.5 * (omega - frequency)
    over_m = math.sin(m * tau) / m
    over_d = math.sin(d * tau) / d if abs(d * tau) > 1e-9 else tau
    cosine = 0.5 * over_m * over_d
    if (omega + frequency) * tau > 1.0:
        if abs(d) > 0.25 * m:
            over = math.sin(omega * tau) / omega if omega * tau > 1e-9 else tau
            return cosine, 0.25 * (math.sin(frequency * tau) - frequency * over) / (m * d)
        return cosine, 0.5 * (over_m * math.cos(d * tau) - math.cos(m * tau) * over_d) / omega
    x = (omega * tau) ** 2
    y = (frequency * tau) ** 2
    power = 1.0
    symmetric = 1.0
    factor = 1.0 / 6.0
    total = factor
    for n in range(1, 9):
        power *= y
        symmetric = x * symmetric + power
        factor /= -(2.0 * n + 2.0) * (2.0 * n + 3.0)
        total += factor * symmetric
    return cosine, frequency * tau**3 * total


@compiled
def responses(omega, frequency, tau, cosine, sine):
    """``from_rest`` at times tau (k,) into cosine and sine (k,)."""
    for i in range(tau.size):
        cosine[i], sine[i] = from_rest(omega, frequency, tau[i])


@compiled
def pair(i, close, close_force, omega, frequencies, start, tau):
    """eta, eta', eta'' at start + tau of the i-th close pair, a mode that answers a drive from rest at ``start``."""
    w = omega[close[i, 0]]
    frequency = frequencies[close[i, 1]]
    s = math.sin(frequency * start)
    c = math.cos(frequency * start)
    a = close_force[i, 0] * s + close_force[i, 1] * c
    b = close_force[i, 0] * c - close_force[i, 1] * s
    cosine, sine = from_rest(w, frequency, tau)
    over = math.sin(w * tau) / w if w * tau > 1e-9 else tau
    eta = a * cosine + b * sine
    force = a * math.cos(frequency * tau) + b * math.sin(frequency * tau)
    return eta, a * (over - frequency * sine) + b * frequency * cosine, force - w * w * eta


@compiled
def pair_sizes(i, close, close_force, omega, frequencies, rest):
    """How large eta and eta' of the i-th close pair can get within ``rest``, and its force.

    The answer to a force of size one is at most rest^2/2, rest/omega and 4/|omega^2 - Omega^2|.
    """
    w = omega[close[i, 0]]
    frequency = frequencies[close[i, 1]]
    gain = abs(w * w - frequency * frequency)
    size = 0.5 * rest * rest
    speed = rest
    if w * size > rest:
        size = rest / w
    if gain * size > 4.0:
        size = 4.0 / gain
    if gain * speed > 4.0 * max(w, frequency):
        speed = 4.0 * max(w, frequency) / gain
    force = math.hypot(close_force[i, 0], close_force[i, 1])
    return force * size, force * speed, force
