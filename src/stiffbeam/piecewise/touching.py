"""Steps along a gap that provably miss no crossing, and the direction of a gap that is zero.

A gap counts as zero where rounding could have made it: |gap| <= N, N the rounding in the terms it is the
sum of. Inside that band both regimes have the same forces to rounding, and the first derivative that
rises above its own rounding says to which side the gap leaves it:

    gap(tau + s) = P(s) + R,   P(s) = sum_{k<8} d_k s^k/k!,   |R| <= b_8 s^8/8!,   N(s) = nu sum_k b_k s^k/k!

with b_k >= |d_k|, and >= |gap^(8)| on the rest of the piece for k = 8. The gap leaves the band at the first
s with |P| > 2 (N + R), to the side of P's sign. Where R overtakes N before, it stays in the band so far.
"""

from __future__ import annotations

import math

from ..basics.arrays import Array
from ..basics.compiled import inner

EPS = 2.220446049250313e-16
ORDER = 8
ROUNDINGS = 16.0  # of one term, that a sum and the state it starts from may have gathered

OPEN, CLOSES, UNCLEAR = 1, -1, 0

STALLED = 100_000  # evaluations without an event, beside ...
PER_RADIAN = 2_000  # ... so many for each radian of the fastest motion, as long as it has not died out
MOST = 1e12  # evaluations to the end, as it goes: a day of a small system
DECAYED = 750.0  # exp(-that) is no number any more
FAINT = 10_000  # evaluations of a gap that moves, but never out of its own rounding
SHORTEST = 1e-30  # step, of t_end: so that time goes on at t = 0 too
REMEDY = "check the stops and stiffnesses for sizes that float64 cannot hold together"


@inner
def stands_still(evaluations: int, sigma: Array, omega: Array, tau: float, rest: float) -> bool:
    """True if so many ``evaluations`` on [0, tau] exceed the need of any sum of exp((sigma_k + i omega_k) s), or would
    at that pace exceed it on [0, rest]."""
    if evaluations <= STALLED:
        return False
    # At the mean pace on [0, tau] the rest would take more than MOST; tau = 0 is no progress at all.
    if evaluations * rest > MOST * tau:
        return True
    radians = 0.0
    for k in range(sigma.size):
        # A decayed term needs no evaluations: decay rates of 1e70 would else allow an endless search.
        alive = min(tau, DECAYED / max(abs(sigma[k]), 1e-300))
        radians = max(radians, math.hypot(sigma[k], omega[k]) * alive)
    return evaluations > STALLED + PER_RADIAN * radians


@inner
def safe_step(gap: float, rate: float, b2: float) -> float:
    """The positive root of gap + rate s - b2 s^2/2 = 0, gap >= 0: the gap cannot close before."""
    # Each form adds terms of one sign, so that neither cancels.
    root = math.sqrt(rate * rate + 2.0 * b2 * gap)
    return (rate + root) / b2 if rate > 0.0 else (2.0 * gap / (root - rate) if root > rate else 0.0)


@inner
def gap_step(gap: float, rate: float, b2: float, b3: float, band: float, t: float) -> tuple[float, int]:
    """(s, verdict) for a gap with its rate: OPEN, it stays positive for s; CLOSES at s; or UNCLEAR.

    b2 >= |gap''|, b3 >= |gap'''| on the rest of the piece. band: below it a gap may be zero. It crosses
    for certain where even gap'' = b2 could not turn it before it is through the band.
    """
    if b2 <= 1e-290 and rate >= 0.0 and gap > band:
        return math.inf, OPEN  # nothing moves
    # Braked by b2 the gap turns after rate^2/(2 b2): more than gap + band, and it passes through the band for certain.
    turn = 2.0 * b2 * (max(gap, 0.0) + band)
    certain = rate * rate > turn
    if certain and rate < 0.0:
        if t == 0.0 and gap <= band:
            return 0.0, CLOSES  # contact that is there at the start, however the sum was rounded
        # A zero closer than the rounding of the time is the event itself.
        safe = safe_step(max(gap, 0.0), rate, b2)
        return safe, CLOSES if safe <= 4.0 * EPS * (t + safe) or gap <= band else OPEN
    # Open, or inside the band and fast enough to leave it upwards.
    if gap > band or (certain and gap >= -band):
        safe = safe_step(max(gap, 0.0), rate, b2)
        # b2/b3 is a time scale of the motion. Shorter steps make little progress: the Taylor polynomial decides.
        if safe > 1e-5 * b2 / b3:
            return safe, OPEN
        if certain and safe > 4.0 * EPS * (t + safe):
            return safe, OPEN
    return 0.0, UNCLEAR


@inner
def taylor_step(d: Array, b: Array, nu: float, switched: bool) -> tuple[float, int]:
    """(s, verdict) from the derivatives d (ORDER + 1,) of a gap and their sizes b.

    OPEN or UNCLEAR: no crossing before s. CLOSES at s = 0: the gap leaves its zero downwards; or where
    it has just ``switched``, so that it may not again, the s by which it has.
    """
    if not b[ORDER] < math.inf:
        return 0.0, UNCLEAR  # frequencies whose eighth power overflows
    # The first s, 1e-10 of a time scale: of the highest derivatives, or of the lowest where the motion is a polynomial.
    if b[ORDER] > 0.0 and b[ORDER - 1] > 0.0:
        s = 1e-10 * b[ORDER - 1] / b[ORDER]
    elif b[2] > 0.0:
        s = 1e-10 * (b[1] / b[2] if b[1] > 0.0 else math.sqrt(b[0] / b[2]) if b[0] > 0.0 else 1e-10)
    elif b[1] > 0.0:
        s = 1e-10 * (b[0] / b[1] if b[0] > 0.0 else 1e-10)
    else:
        # Nothing moves: the constant gap alone decides.
        if d[0] < -2.0 * nu * b[0]:
            return 0.0, CLOSES
        return math.inf, OPEN if d[0] > 2.0 * nu * b[0] else UNCLEAR
    if d[0] > 2.0 * nu * b[0] and b[2] > 0.0:
        s = min(s, safe_step(d[0], d[1], b[2]))  # a motion may be through the gap long before it turns
    last = 0.0
    verdict = UNCLEAR
    # 200 steps of a quarter each: from 1e-10 to 2e9 of that time scale.
    for _ in range(200):
        value = low = noise = 0.0
        term = earlier = 1.0
        for k in range(ORDER):
            value += d[k] * term
            low += d[k] * (earlier if d[k] > 0.0 else term)  # not above P on [last, s]
            noise += nu * b[k] * term
            term *= s / (k + 1)
            earlier *= last / (k + 1)
        # First until P leaves the band, then on for as long as the gap provably stays positive.
        rest = b[ORDER] * term
        if verdict == UNCLEAR:
            if abs(value) > 2.0 * (noise + rest):
                if value < 0.0:
                    return (s if switched else 0.0), CLOSES
                verdict = OPEN
            elif rest > noise:
                # The remainder exceeds the rounding and grows faster: a longer s decides nothing.
                return last, UNCLEAR
        elif low <= noise + rest:
            return last, OPEN
        last = s
        s *= 1.25
    return last, verdict


@inner
def as_gap(d: Array, b: Array, sign: float, stop: float, zero: bool) -> None:
    """Derivatives of the gap sign (u - stop) from those of a position; ``zero``: the gap is exactly zero."""
    d[0] = 0.0 if zero else d[0] - stop
    # The stop is one more term of the sum.
    b[0] += abs(stop)
    for k in range(ORDER + 1):
        d[k] *= sign
