"""The compiled search for the next event: long steps (leaps) that provably contain none, from one event to the next.

In every regime the gap is the distance to the stop (free) or the penetration (in contact), so gap >= 0 and the
regime ends when it closes. Between the ends of a leap the gap is a cubic to

    error = sum_k |x_k''''| h^4/384 (terms that a cubic over h follows) + sum_k |x_k| (all others),

so where the least of the cubic exceeds that, the gap has not closed: the next leap is longer. Where it does not,
the leap ends before the cubic comes that close, or is made shorter. A gap that is about to close is followed by
steps that are safe by a lower bound, gap + gap' s - B2 s^2/2, and where it is zero to rounding its Taylor polynomial
decides.

A gap counts as zero where rounding could have made it: |gap| <= N, N the rounding in the terms it is the
sum of. Inside that band both regimes have the same forces to rounding, and the first derivative that
rises above its own rounding says to which side the gap leaves it:

    gap(tau + s) = P(s) + R,   P(s) = sum_{k<8} d_k s^k/k!,   |R| <= b_8 s^8/8!,   N(s) = nu sum_k b_k s^k/k!

with b_k >= |d_k|, and >= |gap^(8)| on the rest of the piece for k = 8. The gap leaves the band at the first
s with |P| > 2 (N + R), to the side of P's sign. Where R overtakes N before, it stays in the band so far.

The search terminates. A contact has at most one event at any instant of float64, so time goes on after as many events
as there are contacts. Since forces are continuous, true events do not accumulate. If the search needs more evaluations
than any such motion, it raises SolverFailure with the time.
"""

from __future__ import annotations

import math

import numpy as np

from ..basics.arrays import Array, IntArray
from ..basics.compiled import compiled, inner
from ..trajectory.trajectory import SolverFailure
from .terms import (
    B0,
    B2,
    B3,
    BENT,
    OMEGA,
    ORDER,
    RATE,
    SIGMA,
    U,
    bounds,
    carry,
    cubic,
    curvature,
    derivatives,
    measure,
    resolved,
)

EPS = 2.220446049250313e-16
ROUNDINGS = 16.0  # of one term, that a sum and the state it starts from may have gathered

OPEN, CLOSES, UNCLEAR = 1, -1, 0

STALLED = 100_000  # evaluations without an event, beside ...
PER_RADIAN = 2_000  # ... so many for each radian of the fastest motion, as long as it has not died out
MOST = 1e12  # evaluations to the end, as it goes: a day of a small system
DECAYED = 750.0  # exp(-that) is no number any more
FAINT = 10_000  # evaluations of a gap that moves, but never out of its own rounding
SHORTEST = 1e-30  # step, of t_end: so that time goes on at t = 0 too
REMEDY = "check the stops and stiffnesses for sizes that float64 cannot hold together, or use cvode-adams"


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


# ---------------------------------------------------------------- leaps


@inner
def least(p0: float, p1: float, p2: float, p3: float, step: float) -> float:
    """The least value of a cubic on [0, step]."""
    low = min(p0, p0 + step * (p1 + step * (p2 + step * p3)))
    discriminant = p2 * p2 - 3.0 * p1 * p3
    if discriminant > 0.0:
        # Zeros q/(3 p3) and p1/q of the derivative: q adds terms of one sign, so that neither zero cancels.
        q = -(p2 + math.copysign(math.sqrt(discriminant), p2))
        s = q / (3.0 * p3) if p3 != 0.0 else -1.0
        if 0.0 < s < step:
            low = min(low, p0 + s * (p1 + s * (p2 + s * p3)))
        s = p1 / q if q != 0.0 else -1.0
        if 0.0 < s < step:
            low = min(low, p0 + s * (p1 + s * (p2 + s * p3)))
    return low


@inner
def reached(p0: float, p1: float, p2: float, p3: float, step: float) -> float:
    """An s <= ``step`` before which a cubic with p0 > 0 stays positive, close to where it does not."""
    s = 0.0
    value = p0
    for _ in range(12):
        # Nowhere on [s, step] more curved than at one of the two.
        curve = max(0.0, -2.0 * p2 - 6.0 * p3 * (s if p3 > 0.0 else step))
        move = safe_step(value, p1 + s * (2.0 * p2 + s * 3.0 * p3), curve)
        s += move
        if not s < step:
            return step
        value = p0 + s * (p1 + s * (p2 + s * p3))
        if value <= 1e-8 * p0 or move <= 1e-8 * s:
            break
    return s


LONGER = 4.0  # a leap than the one before, at most
AHEAD = 1.0  # as far as a gap goes on closing as it does, a leap
SAFELY = 0.9  # of the longest leap that its error would have allowed
CLEAR, CROSSES, UNKNOWN = 1, -1, 0


@inner
def side_of(chi: int, side: int) -> int:
    """The sign with which u - stop is the gap of a contact in state ``chi`` from the stop on ``side``, 0 for none."""
    sign = 0
    if chi == 0:
        sign = -side
    elif chi == side:
        sign = side
    return sign


@inner
def first_leap(terms: Array, seen: Array, chi: IntArray, g1: Array, g2: Array, resting: IntArray, rest: float) -> float:
    """A step whose cubic errs by half of what every gap allows; a guess."""
    step = rest
    for i in range(terms.shape[0]):
        bend = 1e-300
        for k in range(terms.shape[2]):
            bend += terms[i, BENT, k]
        u, rate = seen[i, U], abs(seen[i, RATE])
        upper, lower = abs(u - g2[i]), abs(u - g1[i])
        if resting[i] != 0:
            # gap/s is compared with bend s^3/162, see ``off`` in ``search``: 40 allows a quarter of the rate.
            step = min(step, (40.0 * rate / bend) ** (1.0 / 3.0))
        # The nearer stop of a contact that has just switched has gap zero: only the other one limits by distance.
        gap = max(upper, lower) if resting[i] != 0 else min(upper, lower)
        if (chi[i] == 0 or resting[i] == 0) and gap < math.inf:
            # The error bend h^4/384 is half of the gap at h^4 = 192 gap/bend.
            step = min(step, math.sqrt(math.sqrt(190.0 * gap / bend)))
    return step


@inner
def pin(
    speeds: Array, terms: Array, seen: Array, pairs: Array, damped: bool, start: float, tau: float, until: float,
    sign: float, stop: float, end: int, i: int,
) -> tuple[float, int]:  # fmt: skip
    """(s, evaluations): the gap of contact i, which falls all the way from tau to tau + until, is zero at tau + s.

    Newton's method, the first step with u'' as well, inside the bracket.
    """
    gap, rate, b2 = sign * (seen[i, U + end] - stop), sign * seen[i, RATE + end], seen[i, B2]
    # The first step: the zero of the parabola through gap, rate and curvature, in the form that does not cancel.
    curve = sign * curvature(speeds, terms, pairs, start, tau, end, i)
    root = math.sqrt(max(0.0, rate * rate - 2.0 * curve * gap))
    # The gap is positive at low and negative at high; steps that leave the bracket become bisections.
    low, high = 0.0, until
    s = 2.0 * gap / (root - rate)
    evaluations = 0
    while evaluations < 60:
        evaluations += 1
        s = min(max(s, low), high)
        carry(speeds, terms, seen, pairs, damped, start, tau + s, 1 - end)
        gap, rate = sign * (seen[i, U + 1 - end] - stop), sign * seen[i, RATE + 1 - end]
        if gap > 0.0:
            low = s
        else:
            high = s
        move = -gap / rate if rate < 0.0 else math.inf
        if not low <= s + move <= high:
            move = 0.5 * (low + high) - s
        # The next Newton step would be b2 move^2/(2 |rate|), less than the rounding of the time.
        enough = EPS * (start + tau + s)
        s += move
        if abs(move) <= enough or b2 * move * move <= -rate * enough:
            break
    return s, evaluations


@compiled
def search(
    speeds: Array, terms: Array, seen: Array, pairs: Array, chi: IntArray, g1: Array, g2: Array, resting: IntArray,
    start: float, t_end: float,
) -> tuple[float, int, int, int]:  # fmt: skip
    """The first event of m contacts with the terms ``terms`` (see there) from the time ``start`` on.

    chi, g1, g2: (m,). resting: (m,), not 0 for a contact that has switched
    at ``start``, so that its gap is exactly zero. Returns (tau, contact, side, evaluations); contact -1: none before
    t_end. Every gap that is open or closed is kept positive, see ``gap_step``. Raises SolverFailure where the motion
    overflows or the search stands still.
    """
    m, K = terms.shape[0], terms.shape[2]
    # Rounding of a gap per unit of its terms; the errors of K terms add up like sqrt(K).
    nu = EPS * (ROUNDINGS + 2.0 * math.sqrt(K))
    rest = t_end - start
    damped = False
    for k in range(K):
        damped |= speeds[SIGMA, k] != 0.0
    end = 0
    tau = 0.0
    # State, bounds and first leap at the start. Without damping these bounds hold for the whole segment.
    carry(speeds, terms, seen, pairs, damped, start, tau, end)
    measure(speeds, terms, damped, end)
    for i in range(m):
        bounds(speeds, terms, seen, pairs, damped, rest, end, i)
    leap = first_leap(terms, seen, chi, g1, g2, resting, rest)
    evaluations = 1
    faint = 0
    near = True  # at the start a gap may be zero, and where it is not known that it is the lower bounds decide
    for i in range(m):
        near &= resting[i] == 0
    while True:
        if stands_still(evaluations, speeds[SIGMA], speeds[OMEGA], tau, rest):
            raise SolverFailure("exact", start + tau, "the search for the next event stands still", REMEDY)
        # A leap: the gaps between its ends are cubics with bounded errors.
        if not near:
            # No shorter than the rounding of the time, so that time goes on.
            step = min(max(leap, EPS * (start + tau), SHORTEST * t_end), rest - tau)
            last = step >= rest - tau
            carry(speeds, terms, seen, pairs, damped, start, tau + step, 1 - end)
            evaluations += 1
            slow = resolved(speeds, step)
            verdict = CLEAR
            # The error grows like step^4: a larger ratio than this cannot lengthen the next leap.
            ratio = LONGER**4
            first = target = step
            soon = math.inf
            for i in range(m):
                p0, p1, p2, p3, error = cubic(
                    speeds, terms, seen, pairs, damped, start, tau, step, slow, end, i
                )  # fmt: skip
                # The stop whose gap is exactly zero if the contact has switched at the start.
                nearest = 1 if abs(seen[i, U + end] - g2[i]) <= abs(seen[i, U + end] - g1[i]) else -1
                for side in (1, -1):
                    sign = side_of(chi[i], side)
                    stop = g2[i] if side > 0 else g1[i]
                    if sign == 0 or math.isinf(stop):
                        continue
                    band = nu * (abs(stop) + seen[i, B0])
                    if tau == 0.0 and resting[i] != 0 and side == nearest:
                        # This gap is zero at s = 0, so gap/s is tested. The cubic errs by M s^2 (step - s)^2/24 with
                        # M >= |x''''|; divided by s that is M step^3/162 at most. The error of fast terms does not
                        # vanish at s = 0: they need a shorter step.
                        off = 384.0 * error / (162.0 * step) + 8.0 * band / step
                        if slow < K or not least(sign * p1, sign * p2, sign * p3, 0.0, step) > off:
                            verdict = UNKNOWN
                            target = min(target, 0.6 * reached(sign * p1, sign * p2, sign * p3, 0.0, step))
                            if off > 0.0:
                                # off grows like step^3: the next step keeps it at a quarter of the rate.
                                target = min(target, step * (max(0.0, 0.25 * sign * p1 / off)) ** (1.0 / 3.0))
                        continue
                    # Open during all of the leap if the least of the cubic exceeds its error.
                    wrong = error + 2.0 * band
                    gap = sign * (p0 - stop)
                    low = least(gap, sign * p1, sign * p2, sign * p3, step)
                    if low > wrong:
                        # The band does not shrink with the leap: where it is most of what is wrong, it is left out.
                        ratio = min(ratio, low / wrong if error > 2.0 * band else (low - 2.0 * band) / error)
                        # A closing gap limits the next leap to the time of its zero at the present rate.
                        gap, rate = sign * (seen[i, U + 1 - end] - stop), sign * seen[i, RATE + 1 - end]
                        if rate < 0.0:
                            soon = min(soon, -AHEAD * gap / rate)
                        continue
                    # The cubic may close: at ``crossing`` it is zero, until ``ahead`` the gap is provably open.
                    crossing = reached(gap, sign * p1, sign * p2, sign * p3, step)
                    ahead = reached(gap - wrong, sign * p1, sign * p2, sign * p3, step) if gap > wrong else 0.0
                    # It crosses zero, and its error matters only shortly before: go to ``ahead``.
                    if low <= 0.0 and ahead > 0.7 * crossing:
                        first = min(first, ahead)
                        target = min(target, 2.0 * (crossing - ahead))
                        verdict = CROSSES if verdict == CLEAR else verdict
                        continue
                    # Too coarse to decide. The error falls like step^4, so that a shorter leap decides.
                    verdict = UNKNOWN
                    share = math.sqrt(math.sqrt(max(low, 0.5 * gap) / wrong))
                    target = min(target, 0.75 * crossing, SAFELY * step * share)
            if verdict == CLEAR:
                if last:
                    return rest, -1, 0, evaluations
                tau += step
                end = 1 - end
                leap = min(soon, step * min(LONGER, SAFELY * math.sqrt(math.sqrt(ratio))))
                if damped:
                    measure(speeds, terms, damped, end)
                continue
            # Shorter each time, but no single estimate cuts a leap to less than a fiftieth of the step.
            leap = min(0.7 * step, max(0.02 * step, target))
            if verdict == CROSSES and first > 0.0:
                leap = max(target, 0.02 * step)
                # Every gap is open up to ``first``: go there. The steps below complete the crossing.
                tau += first
                carry(speeds, terms, seen, pairs, damped, start, tau, end)
                evaluations += 1
                if damped:
                    measure(speeds, terms, damped, end)
        # Steps by lower bounds, where the gap is small against its motion.
        near = False
        step = closing = math.inf
        closer = toward = 0
        for i in range(m):
            if damped:
                bounds(speeds, terms, seen, pairs, damped, rest, end, i)
            b0, b2, b3 = seen[i, B0], seen[i, B2], seen[i, B3]
            # Infinite or NaN bounds prove nothing.
            if not b0 + b2 + b3 < math.inf:
                raise SolverFailure("exact", start + tau, "the motion overflows float64", REMEDY)
            u, speed = seen[i, U + end], seen[i, RATE + end]
            nearest = 1 if abs(u - g2[i]) <= abs(u - g1[i]) else -1
            for side in (1, -1):
                sign = side_of(chi[i], side)
                stop = g2[i] if side > 0 else g1[i]
                if sign == 0 or math.isinf(stop):
                    continue
                zero = tau == 0.0 and resting[i] != 0 and side == nearest
                gap, rate = 0.0 if zero else sign * (u - stop), sign * speed
                band = nu * (abs(stop) + b0)
                safe, verdict = gap_step(gap, rate, b2, b3, band, start + tau)
                if verdict == UNCLEAR:
                    series, sizes = np.empty(ORDER + 1), np.empty(ORDER + 1)
                    # A leap has left C, S and V of its far end in ``speeds``; ``derivatives`` needs those at tau.
                    carry(speeds, terms, seen, pairs, damped, start, tau, end)
                    derivatives(speeds, terms, seen, pairs, start, tau, rest, end, i, series, sizes)
                    as_gap(series, sizes, sign, stop, zero)
                    safe, verdict = taylor_step(series, sizes, nu, zero)
                    if verdict == UNCLEAR and abs(series[1]) > 2.0 * nu * sizes[1]:
                        faint += 1
                if verdict == CLOSES and not zero:
                    return tau + safe, i, side, evaluations
                near |= verdict != OPEN
                left = rate * rate - 2.0 * b2 * (gap + band)
                if verdict == OPEN and rate < 0.0 and left > 0.0 and gap > band and closing == math.inf:
                    # It falls until it is through, at the latest by then.
                    closing, closer, toward = 2.0 * (gap + band) / (math.sqrt(left) - rate), i, side
                else:
                    step = min(step, safe)
        # All other gaps are open until this one is through: its zero is the first event.
        if closing < step:
            sign, stop = side_of(chi[closer], toward), g2[closer] if toward > 0 else g1[closer]
            s, used = pin(speeds, terms, seen, pairs, damped, start, tau, closing, sign, stop, end, closer)
            return tau + s, closer, toward, evaluations + used
        if closing < math.inf:  # another may be first
            near = True
            u, speed = seen[closer, U + end], seen[closer, RATE + end]
            sign, stop = side_of(chi[closer], toward), g2[closer] if toward > 0 else g1[closer]
            step = min(step, safe_step(sign * (u - stop), sign * speed, seen[closer, B2]))
        if not near and step < 0.5 * leap:
            continue  # a leap is longer
        # A short safe step, again no shorter than the rounding of the time.
        step = max(step, EPS * (start + tau), SHORTEST * t_end)
        if start + tau + step >= t_end:
            return rest, -1, 0, evaluations
        tau += step
        leap = max(leap, 2.0 * step)
        carry(speeds, terms, seen, pairs, damped, start, tau, end)
        evaluations += 1
        if damped:
            measure(speeds, terms, damped, end)
        if faint > FAINT:
            raise SolverFailure("exact", start + tau, "a contact moves by less than its rounding", REMEDY)
