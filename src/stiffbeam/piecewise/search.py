"""The compiled search for the next event: long steps (leaps) that provably contain none, from one event to the next.

In every regime the gap is the distance to the stop (free) or the penetration (in contact), so gap >= 0 and the
regime ends when it closes. Between the ends of a leap the gap is a cubic to

    error = sum_k |x_k''''| h^4/384 (terms that a cubic over h follows) + sum_k |x_k| (all others),

so where the least of the cubic exceeds that, the gap has not closed: the next leap is longer. Where it does not,
the leap ends before the cubic comes that close, or is made shorter. A gap that is about to close is followed by
steps that are safe by a lower bound, gap + gap' s - B2 s^2/2, and where it is zero to rounding its Taylor polynomial
decides (touching.py).

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
from .touching import (
    CLOSES,
    EPS,
    FAINT,
    OPEN,
    ORDER,
    REMEDY,
    ROUNDINGS,
    SHORTEST,
    UNCLEAR,
    as_gap,
    gap_step,
    safe_step,
    stands_still,
    taylor_step,
)


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
                        ratio = min(ratio, low / wrong)
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
