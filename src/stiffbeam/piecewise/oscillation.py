"""Motion of one mode: freely, under a constant force, and from rest under a drive close to its own frequency.

In forms that do not cancel: the answer from rest stays regular at resonance, where a particular solution grows
without bound and the free motion beside it takes all of it away again.
"""

from __future__ import annotations

import math

from ..basics.arrays import Array
from ..basics.compiled import compiled, in_order

# pi/2 in three parts, the first of 33 bits: k times it is exact for |k| < 2^20.
QUARTER, QUARTER_2, QUARTER_3 = 1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624871116645580e-21
MOST_RADIANS = 1.6e6  # that many quarters


@compiled
def oscillation(omega: float, tau: float) -> tuple[float, float, float]:
    """cos(omega tau), sin(omega tau)/omega, (1 - cos(omega tau))/omega^2, regular at omega = 0."""
    x = omega * tau
    if x > 1e-4:
        s = math.sin(x)
        c = math.cos(x)
        versine = 1.0 - c if c < 0.5 else s * s / (1.0 + c)
        return c, s / omega, versine / (omega * omega)
    return 1.0 - 0.5 * x * x, tau * (1.0 - x * x / 6.0), 0.5 * tau * tau * (1.0 - x * x / 12.0)


@in_order
def oscillations(omega: Array, tau: float, c: Array, s: Array, v: Array) -> None:
    """``oscillation`` of all modes omega (n,) at tau >= 0 into c, s, v (n,), in vector registers.

    Sine and cosine by the minimax polynomials of fdlibm on [-pi/4, pi/4], 1 ulp each.
    """
    fastest = 0.0
    for j in range(omega.size):
        fastest = max(fastest, omega[j])
    if not fastest * tau < MOST_RADIANS:
        for j in range(omega.size):
            c[j], s[j], v[j] = oscillation(omega[j], tau)
        return
    for j in range(omega.size):
        x = omega[j] * tau
        k = math.floor(x * (2.0 / math.pi) + 0.5)
        r = ((x - k * QUARTER) - k * QUARTER_2) - k * QUARTER_3
        z = r * r
        sine = r + r * z * (
            -1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * (
            2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))))
        )  # fmt: skip
        cosine = 1.0 - 0.5 * z + z * z * (
            4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * (
            -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11))))
        )  # fmt: skip
        turn = k - 4.0 * math.floor(0.25 * k)  # quarters: 0, 1, 2 or 3
        even = turn == 0.0 or turn == 2.0
        a = cosine if even else sine
        b = sine if even else cosine
        a = a if turn == 0.0 or turn == 3.0 else -a
        b = b if turn < 2.0 else -b
        slow = x <= 1e-4
        w = 1.0 if slow else omega[j]
        versine = 1.0 - a if a < 0.5 else b * b / (1.0 + a)
        c[j] = a
        s[j] = tau * (1.0 - x * x / 6.0) if slow else b / w
        v[j] = 0.5 * tau * tau * (1.0 - x * x / 12.0) if slow else versine / (w * w)


@compiled
def from_rest(omega: float, frequency: float, tau: float) -> tuple[float, float]:
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
def pair(
    w: float, frequency: float, force_sine: float, force_cosine: float, start: float, tau: float
) -> tuple[float, float, float]:
    """eta, eta', eta'' at start + tau of a close pair: a mode w that answers a drive from rest at ``start``."""
    s = math.sin(frequency * start)
    c = math.cos(frequency * start)
    a = force_sine * s + force_cosine * c
    b = force_sine * c - force_cosine * s
    cosine, sine = from_rest(w, frequency, tau)
    over = math.sin(w * tau) / w if w * tau > 1e-9 else tau
    eta = a * cosine + b * sine
    force = a * math.cos(frequency * tau) + b * math.sin(frequency * tau)
    return eta, a * (over - frequency * sine) + b * frequency * cosine, force - w * w * eta


@compiled
def pair_sizes(
    w: float, frequency: float, force_sine: float, force_cosine: float, rest: float
) -> tuple[float, float, float]:
    """Bounds of eta and eta' of a close pair within ``rest``, and its force.

    The answer to a force of size one is at most rest^2/2, rest/omega and 4/|omega^2 - Omega^2|.
    """
    gain = abs(w * w - frequency * frequency)
    size = 0.5 * rest * rest
    speed = rest
    if w * size > rest:
        size = rest / w
    if gain * size > 4.0:
        size = 4.0 / gain
    if gain * speed > 4.0 * max(w, frequency):
        speed = 4.0 * max(w, frequency) / gain
    force = math.hypot(force_sine, force_cosine)
    return force * size, force * speed, force
