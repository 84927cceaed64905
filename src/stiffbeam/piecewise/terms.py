"""Gaps in a segment: sums of terms in closed form, their derivatives and bounds.

    u_c(tau) = constant_c + sum_k x_ck(tau) + the answers of close pairs,

    x(tau) = x C + y S + level V,   y(tau) = y C + (level - omega^2 x) S,   u' = sum_k sigma x + y

    C = exp(sigma tau) cos(omega tau),  S = exp(sigma tau) sin(omega tau)/omega,  V = (1 - cos(omega tau))/omega^2

Without damping x is a mode's share and y its rate, sigma = 0; else x = Re a and y = -omega Im a of a term
a exp((sigma + i omega) tau), sigma <= 0 and level 0. A drive is such a term too.

Compiled functions count references to every array they are given, so these are few (``layout``):
``speeds`` (6, K), ``terms`` (m, 9, K) for m contacts and K terms, ``seen`` (m, SEEN), ``pairs`` (p, 4 + m).

A close pair is a mode that answers a drive of almost its own frequency from rest. Its forms do not cancel: they stay
regular at resonance, where a particular solution grows without bound and the free motion beside it would take all of
it away again.
"""

from __future__ import annotations

import math

import numpy as np

from ..basics.arrays import Array
from ..basics.compiled import compiled, in_order, inner

ORDER = 8  # of the highest derivative of a gap
# pi/2 in three parts, the first of 33 bits: k times it is exact for |k| < 2^20.
QUARTER, QUARTER_2, QUARTER_3 = 1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624871116645580e-21
# Below 2^20 pi/2 = 1.647e6, so that k stays below 2^20.
MOST_RADIANS = 1.6e6  # that many quarters


@inner
def oscillation(omega: float, tau: float) -> tuple[float, float, float]:
    """cos(omega tau), sin(omega tau)/omega, (1 - cos(omega tau))/omega^2, regular at omega = 0."""
    x = omega * tau
    # At 1e-4 the next terms of the three series are below 5e-18.
    if x > 1e-4:
        s = math.sin(x)
        c = math.cos(x)
        # 1 - cos cancels near cos = 1: there sin^2/(1 + cos).
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
        # One argument beyond the exact reduction sends all to the library.
        for j in range(omega.size):
            c[j], s[j], v[j] = oscillation(omega[j], tau)
        return
    for j in range(omega.size):
        # No branches, so that the loop goes into vector registers: both cases are computed, then one is chosen.
        x = omega[j] * tau
        k = math.floor(x * (2.0 / math.pi) + 0.5)
        # k QUARTER is exact, and the later parts restore what it leaves out of k pi/2: in this order only.
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
        # The quarter decides which polynomial is the cosine, and both signs.
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
        # 4 m d = omega^2 - frequency^2, without the cancellation of the squares.
        if abs(d) > 0.25 * m:
            over = math.sin(omega * tau) / omega if omega * tau > 1e-9 else tau
            return cosine, 0.25 * (math.sin(frequency * tau) - frequency * over) / (m * d)
        return cosine, 0.5 * (over_m * math.cos(d * tau) - math.cos(m * tau) * over_d) / omega
    # The series: the first term left out, n = 9, is below 6/21! = 1e-19 of the leading one.
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


@inner
def pair(
    w: float, frequency: float, force_sine: float, force_cosine: float, start: float, tau: float
) -> tuple[float, float, float]:
    """eta, eta', eta'' at start + tau of a close pair: a mode w that answers a drive from rest at ``start``."""
    # The force in time since the start: a cos(frequency tau) + b sin(frequency tau).
    s = math.sin(frequency * start)
    c = math.cos(frequency * start)
    a = force_sine * s + force_cosine * c
    b = force_sine * c - force_cosine * s
    cosine, sine = from_rest(w, frequency, tau)
    over = math.sin(w * tau) / w if w * tau > 1e-9 else tau
    eta = a * cosine + b * sine
    force = a * math.cos(frequency * tau) + b * math.sin(frequency * tau)
    return eta, a * (over - frequency * sine) + b * frequency * cosine, force - w * w * eta


@inner
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


RESOLVED = 4.4  # radians of a step up to which its cubic, with an error (omega h)^4/384, is better than none
# Rows of ``speeds``, the slow terms first, and in the last three what they make at one tau.
SIGMA, OMEGA, SQUARE, C, S, V = range(6)
# Rows of ``terms``: at tau = 0, at the two ends of a step, and bounds of a term but for its level and of x''''.
X, Y, LEVEL, END, LARGE, BENT = 0, 1, 2, 3, 7, 8
# Columns of ``seen``: the constant, u and u' at the two ends, bounds of |u|, |u''| and |u'''|.
CONSTANT, U, RATE, B0, B2, B3, SEEN = 0, 1, 3, 5, 6, 7, 8


@compiled
def layout(m: int, K: int, p: int) -> tuple[Array, Array, Array, Array]:
    """Empty speeds, terms, seen and pairs; a pair is its omega, frequency, the force on it of the drive's sine and
    cosine (see ``oscillation.pair``), and what every contact sees of it."""
    return np.zeros((6, K)), np.zeros((m, 9, K)), np.zeros((m, SEEN)), np.zeros((p, 4 + m))


@inner
def hypotenuse(a: float, b: float) -> float:
    """sqrt(a^2 + b^2), or where that is not safe in float64 the larger |a| + |b|; for vector registers."""
    square = a * a + b * b
    return math.sqrt(square) if 1e-280 < square < 1e280 else abs(a) + abs(b)


@inner
def read(
    speeds: Array,
    terms: Array,
    seen: Array,
    pairs: Array,
    damped: bool,
    start: float,
    tau: float,
    end: int,
    i: int,
) -> None:
    """u and u' of contact i at tau from the terms at ``end``."""
    u = seen[i, CONSTANT]
    rate = 0.0
    for k in range(speeds.shape[1]):
        u += terms[i, END + 2 * end, k]
        rate += terms[i, END + 2 * end + 1, k]
    if damped:
        for k in range(speeds.shape[1]):
            rate += speeds[SIGMA, k] * terms[i, END + 2 * end, k]
    for k in range(pairs.shape[0]):
        eta, eta_rate, _ = pair(pairs[k, 0], pairs[k, 1], pairs[k, 2], pairs[k, 3], start, tau)
        u += pairs[k, 4 + i] * eta
        rate += pairs[k, 4 + i] * eta_rate
    seen[i, U + end], seen[i, RATE + end] = u, rate


@compiled
def carry(
    speeds: Array, terms: Array, seen: Array, pairs: Array, damped: bool, start: float, tau: float, end: int
) -> None:
    """All terms, the positions and their rates at tau, written to ``end``. start: the time at which tau = 0."""
    oscillations(speeds[OMEGA], tau, speeds[C], speeds[S], speeds[V])
    K, x, y = speeds.shape[1], END + 2 * end, END + 2 * end + 1
    if damped:
        for k in range(K):
            decay = math.exp(speeds[SIGMA, k] * tau)
            speeds[C, k] *= decay
            speeds[S, k] *= decay
    for i in range(terms.shape[0]):
        # Loops that write to one place each: these go into vector registers.
        for k in range(K):
            terms[i, x, k] = terms[i, X, k] * speeds[C, k] + terms[i, Y, k] * speeds[S, k]
        for k in range(K):
            terms[i, y, k] = terms[i, Y, k] * speeds[C, k] - terms[i, X, k] * speeds[SQUARE, k] * speeds[S, k]
        # With damping every level is 0.
        if not damped:
            for k in range(K):
                terms[i, x, k] += terms[i, LEVEL, k] * speeds[V, k]
            for k in range(K):
                terms[i, y, k] += terms[i, LEVEL, k] * speeds[S, k]
        read(speeds, terms, seen, pairs, damped, start, tau, end, i)


@inner
def bounds(speeds: Array, terms: Array, seen: Array, pairs: Array, damped: bool, rest: float, end: int, i: int) -> None:
    """Into B0, B2 >= |u''| and B3 >= |u'''| of contact i, from the terms at ``end`` on; B0: the size of u.

    rest: how long the piece may last, which bounds the answers of close pairs.
    """
    b0 = abs(seen[i, CONSTANT])
    b2 = 0.0
    b3 = 0.0
    for k in range(speeds.shape[1]):
        w = speeds[OMEGA, k]
        x, y = terms[i, END + 2 * end, k], terms[i, END + 2 * end + 1, k]
        # Amplitudes of the term and of its second derivative, which no later phase exceeds.
        size = hypotenuse(x, y / w) if w > 0.0 else abs(x)
        curve = hypotenuse(terms[i, LEVEL, k] - w * w * x, w * y)
        fast = w
        if damped and speeds[SIGMA, k] != 0.0:
            fast = hypotenuse(speeds[SIGMA, k], w)
            curve = size * fast * fast
        b0 += size
        b2 += curve
        b3 += curve * fast
    # Close pairs grow from rest: bounds over the whole rest of the segment.
    for k in range(pairs.shape[0]):
        w, frequency, weight = pairs[k, 0], pairs[k, 1], abs(pairs[k, 4 + i])
        size, speed, force = pair_sizes(w, frequency, pairs[k, 2], pairs[k, 3], rest)
        b0 += weight * size
        b2 += weight * (force + w * w * size)
        b3 += weight * (frequency * force + w * w * speed)
    # Rounding in the sums above.
    seen[i, B0], seen[i, B2], seen[i, B3] = b0, b2 * (1.0 + 1e-12) + 1e-300, b3 * (1.0 + 1e-12) + 1e-300


@compiled
def measure(speeds: Array, terms: Array, damped: bool, end: int) -> None:
    """LARGE and BENT from the terms at ``end`` on. |a| + |b| is not far above their hypotenuse."""
    x, y = END + 2 * end, END + 2 * end + 1
    for i in range(terms.shape[0]):
        for k in range(speeds.shape[1]):
            curve = abs(terms[i, LEVEL, k] - speeds[SQUARE, k] * terms[i, x, k])
            terms[i, BENT, k] = curve + abs(speeds[OMEGA, k] * terms[i, y, k])
        for k in range(speeds.shape[1]):
            square = speeds[SQUARE, k]
            # The amplitude about the mean level/omega^2; a term with sigma = omega = 0 is always resolved.
            terms[i, LARGE, k] = terms[i, BENT, k] / (square if square > 0.0 else 1.0)
        for k in range(speeds.shape[1]):
            terms[i, BENT, k] *= speeds[SQUARE, k]
        if damped:
            for k in range(speeds.shape[1]):
                sigma, w = speeds[SIGMA, k], speeds[OMEGA, k]
                if sigma != 0.0:
                    large = abs(terms[i, x, k]) + (abs(terms[i, y, k]) / w if w > 0.0 else 0.0)
                    terms[i, LARGE, k], terms[i, BENT, k] = large, large * (w * w + sigma * sigma) ** 2


@compiled
def resolved(speeds: Array, step: float) -> int:
    """Number of the terms that a cubic over ``step`` follows."""
    # From the end, since the terms are sorted from slow to fast.
    count = speeds.shape[1]
    while count and hypotenuse(speeds[SIGMA, count - 1], speeds[OMEGA, count - 1]) * step > RESOLVED:
        count -= 1
    return count


@compiled
def cubic(
    speeds: Array, terms: Array, seen: Array, pairs: Array, damped: bool, start: float, tau: float, step: float,
    slow: int, end: int, i: int,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """(p0, p1, p2, p3, error): contact i at tau + s is p0 + p1 s + p2 s^2 + p3 s^3 to ``error`` for s in [0, step].

    The terms from ``slow`` on count with all they can be. Those at tau are at ``end``, those at tau + step at the
    other.
    """
    x, x1 = END + 2 * end, END + 2 * (1 - end)
    bend = 0.0
    rest = 0.0
    u0, u1, v0, v1 = seen[i, U + end], seen[i, U + 1 - end], seen[i, RATE + end], seen[i, RATE + 1 - end]
    for k in range(slow):
        bend += terms[i, BENT, k]
    for k in range(np.uint64(slow), np.uint64(speeds.shape[1])):  # an index that might be negative is read by gathers
        # A fast term leaves its mean in the cubic; its amplitude is error.
        sigma, square = speeds[SIGMA, k], speeds[SQUARE, k]
        level = terms[i, LEVEL, k] / (square if square > 0.0 else 1.0)
        rest += terms[i, LARGE, k]
        u0 += level - terms[i, x, k]
        u1 += level - terms[i, x1, k]
        v0 -= sigma * terms[i, x, k] + terms[i, x + 1, k]
        v1 -= sigma * terms[i, x1, k] + terms[i, x1 + 1, k]
    for k in range(pairs.shape[0]):
        w, frequency = pairs[k, 0], pairs[k, 1]
        eta, speed, _ = pair(w, frequency, pairs[k, 2], pairs[k, 3], start, tau)
        # Two bounds of |eta| in the step, from eta and its rate at tau; the second one is for a fast mode.
        force = abs(pairs[k, 2]) + abs(pairs[k, 3])
        size = abs(eta) + (abs(speed) + 0.5 * force * step) * step
        if w * step > 1.0:
            size = min(size, abs(eta) + (abs(speed) + force * step) / w)
        # eta'''' by its equation, differentiated twice: f'' - w^2 (f - w^2 eta).
        bend += abs(pairs[k, 4 + i]) * (frequency**2 * force + w * w * (force + w * w * size))
    # Hermite's cubic through both ends.
    slope = (u1 - u0) / step
    p2, p3 = (3.0 * slope - 2.0 * v0 - v1) / step, (v0 + v1 - 2.0 * slope) / (step * step)
    return u0, v0, p2, p3, bend * step**4 / 384.0 + rest


@inner
def curvature(speeds: Array, terms: Array, pairs: Array, start: float, tau: float, end: int, i: int) -> float:
    """u'' of contact i at tau, the terms there at ``end``."""
    total = 0.0
    for k in range(speeds.shape[1]):
        x, y, sigma = terms[i, END + 2 * end, k], terms[i, END + 2 * end + 1, k], speeds[SIGMA, k]
        total += sigma * (sigma * x + 2.0 * y) - speeds[SQUARE, k] * x + terms[i, LEVEL, k]
    for k in range(pairs.shape[0]):
        total += pairs[k, 4 + i] * pair(pairs[k, 0], pairs[k, 1], pairs[k, 2], pairs[k, 3], start, tau)[2]
    return total


@inner
def derivatives(
    speeds: Array, terms: Array, seen: Array, pairs: Array, start: float, tau: float, rest: float, end: int, i: int,
    d: Array, b: Array,
) -> None:  # fmt: skip
    """u and its derivatives at tau into d (ORDER + 1,), and into b those of the terms they are sums of; speeds
    and the terms at ``end`` are those at tau. rest: as in ``bounds``."""
    d[:] = 0.0
    b[:] = 0.0
    d[0] = seen[i, CONSTANT]
    b[0] = abs(d[0])
    for k in range(speeds.shape[1]):
        w, sigma, level = speeds[OMEGA, k], speeds[SIGMA, k], terms[i, LEVEL, k]
        x, y = terms[i, END + 2 * end, k], terms[i, END + 2 * end + 1, k]
        x0, y0 = terms[i, X, k], terms[i, Y, k]
        d[0] += x
        d[1] += sigma * x + y
        # A mode's parts may cancel in x: rounding is that of the parts.
        if sigma == 0.0:
            b[0] += abs(x0 * speeds[C, k]) + abs(y0 * speeds[S, k]) + abs(level * speeds[V, k])
            b[1] += abs(y0 * speeds[C, k]) + abs((level - w * w * x0) * speeds[S, k])
            size = hypotenuse(level - w * w * x, w * y)
            fast = w
        else:
            size = hypotenuse(x, y / w) if w > 0.0 else abs(x)
            fast = hypotenuse(sigma, w)
            b[0] += size
            b[1] += size * fast
            size *= fast * fast
        # The level acts in the first derivative of y, and in no later one.
        x, y = sigma * x + y, sigma * y - w * w * x + level
        for j in range(2, ORDER + 1):
            x, y = sigma * x + y, sigma * y - w * w * x
            d[j] += x
            b[j] += size
            size *= fast
    for k in range(pairs.shape[0]):
        w, frequency, weight = pairs[k, 0], pairs[k, 1], pairs[k, 4 + i]
        even, odd, _ = pair(w, frequency, pairs[k, 2], pairs[k, 3], start, tau)
        # The force at tau, and its rate over the frequency.
        s = math.sin(frequency * (start + tau))
        c = math.cos(frequency * (start + tau))
        force, turned = pairs[k, 2] * s + pairs[k, 3] * c, pairs[k, 2] * c - pairs[k, 3] * s
        even_size, odd_size, force_size = pair_sizes(w, frequency, pairs[k, 2], pairs[k, 3], rest)
        for j in range(ORDER + 1):  # eta^(j + 2) = f^(j) - w^2 eta^(j)
            d[j] += weight * even
            b[j] += abs(weight) * even_size
            even, odd = odd, force - w * w * even
            even_size, odd_size = odd_size, force_size + w * w * even_size
            force, turned = frequency * turned, -frequency * force
            force_size *= frequency
