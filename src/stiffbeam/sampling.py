"""Sampled impacts, step by step: chi_k != 0 and chi_k != chi_{k-1}, chi the contact state of u_k."""

from __future__ import annotations

import math

import numpy as np

from .arrays import Array
from .compiled import compiled, inlined

# A tally (..., 8) is what one contact has seen so far.
SIDE, TOUCHING, PEAK, IMPULSE, ROW, SINCE = range(6)
TALLY = 8
# The steps up to SINCE are passed over; SIDE is followed from the start.
# An impact is one row of a list of events; ROW is the row of the one that is open, or -1.
MEMBER, CONTACT, TIME, STOP, IMPACT_PEAK, IMPACT_IMPULSE = range(6)
EVENT = 6


def new_tally(u0: Array, g1: Array, g2: Array, since: int = 0) -> Array:
    """Tallies of the steps after ``since``, at positions u0 (...,), between stops g1 and g2; contact that
    is there before is no impact."""
    tally = np.zeros((*np.shape(u0), TALLY))
    tally[..., ROW] = -1.0
    tally[..., SINCE] = since
    tally[..., SIDE] = (u0 > g2) * 1.0 - (u0 < g1) * 1.0
    return tally


@inlined
def side_of(u, g1, g2):
    """chi: +1 beyond g2, -1 beyond g1, else 0."""
    return 1.0 if u > g2 else (-1.0 if u < g1 else 0.0)


@inlined
def scan(u, count, law, dt, tally, i, c, events, rows, first):
    """Take the steps u (count,) into the tally of contact c of member i; impacts that begin are appended.

    law: (M, m, 3), kappa, g1, g2. tally: (M, m, 8). first: the number of steps before u. Row ``rows`` of
    ``events`` is the first free one; a new impact holds the step before its crossing, 0 for the last one
    known, in TIME. Returns the first free row.
    """
    kappa, g1, g2 = law[i, c, 0], law[i, c, 1], law[i, c, 2]
    side = tally[i, c, SIDE]
    row = int(tally[i, c, ROW])
    passed = int(tally[i, c, SINCE]) - first  # so many of these steps are passed over
    own_peak = events[row, IMPACT_PEAK] if row >= 0 else 0.0
    own_impulse = events[row, IMPACT_IMPULSE] if row >= 0 else 0.0
    touching = 0
    peak, impulse = tally[i, c, PEAK], tally[i, c, IMPULSE]
    k = 0
    while k < count:  # from one change of side to the next
        new = side_of(u[k], g1, g2)
        if new != side:
            if row >= 0:
                events[row, IMPACT_PEAK], events[row, IMPACT_IMPULSE] = own_peak, own_impulse
            row = -1
            if new != 0.0 and k >= passed:
                row = rows
                rows += 1
                events[row, TIME], events[row, STOP] = k, new
                own_peak = own_impulse = 0.0
            side = new
        depths = deepest = 0.0
        while k < count and side_of(u[k], g1, g2) == side:
            if side != 0.0 and k >= passed:
                depth = u[k] - g2 if side > 0.0 else g1 - u[k]
                depths += depth
                deepest = max(deepest, depth)
                touching += 1
            k += 1
        own_peak = max(own_peak, kappa * deepest)
        own_impulse += kappa * depths * dt
        peak = max(peak, kappa * deepest)
        impulse += kappa * depths * dt
    if row >= 0:
        events[row, IMPACT_PEAK], events[row, IMPACT_IMPULSE] = own_peak, own_impulse
    tally[i, c, SIDE] = side
    tally[i, c, ROW] = row
    tally[i, c, TOUCHING] += touching
    tally[i, c, PEAK] = peak
    tally[i, c, IMPULSE] = impulse
    return rows


@compiled
def observe(u, v, law, dt, first, position, velocity, tally, diverged, events, rows):
    """Take positions u and velocities v (M, steps, C) after step ``first`` of members that have not diverged.

    position, velocity: (M, C) at step ``first``, brought up to date as the tallies (M, m, 8) are. The
    impacts that begin are written to ``events`` from row ``rows`` on, which must have room. Returns the
    first free row.
    """
    M, steps, C = u.shape
    path = np.empty(steps)
    for i in range(M):
        if diverged[i]:
            continue
        for c in range(law.shape[1]):
            for k in range(steps):
                path[k] = u[i, k, c]
            new = scan(path, steps, law, dt, tally, i, c, events, rows, first)
            for row in range(rows, new):
                k = int(events[row, TIME])
                u0 = path[k - 1] if k > 0 else position[i, c]
                v0 = v[i, k - 1, c] if k > 0 else velocity[i, c]
                stop = law[i, c, 2] if events[row, STOP] > 0.0 else law[i, c, 1]
                events[row, TIME] = (first + k + crossing(u0, v0, path[k], v[i, k, c], stop, dt)) * dt
                events[row, MEMBER] = i
                events[row, CONTACT] = c
            rows = new
        for c in range(C):
            position[i, c] = u[i, steps - 1, c]
            velocity[i, c] = v[i, steps - 1, c]
    return rows


@inlined
def crossing(u0, v0, u1, v1, stop, dt):
    """When in its step, 0 to 1, the cubic Hermite interpolant of (u, u') first reaches a stop beyond u0."""
    sign = 1.0 if u1 > u0 else -1.0
    return first_crossing(sign * (stop - u0), -sign * v0 * dt, sign * (stop - u1), -sign * v1 * dt)


@inlined
def first_crossing(gap0, rate0, gap1, rate1):
    """The least s in (0, 1] at which the cubic Hermite interpolant of a gap reaches zero.

    gap0 > 0 >= gap1 at s = 0 and 1; rate0, rate1: d gap/ds there. Newton's method, kept inside the first
    sign change between the extrema of the cubic.
    """
    # p(s) = c0 + c1 s + c2 s^2 + c3 s^3
    c0, c1 = gap0, rate0
    c2 = 3.0 * (gap1 - gap0) - 2.0 * rate0 - rate1
    c3 = 2.0 * (gap0 - gap1) + rate0 + rate1
    low = 0.0
    high = 1.0
    # p'(s) = c1 + 2 c2 s + 3 c3 s^2
    discriminant = c2 * c2 - 3.0 * c1 * c3
    if discriminant > 0.0:
        q = -(c2 + math.copysign(math.sqrt(discriminant), c2))
        one = q / (3.0 * c3) if c3 != 0.0 else 1.0
        two = c1 / q if q != 0.0 else 1.0
        for point in (min(one, two), max(one, two)):
            if low < point < high:
                if c0 + point * (c1 + point * (c2 + point * c3)) <= 0.0:
                    high = point
                else:
                    low = point
    s = min(max(gap0 / (gap0 - gap1), low), high)
    for _ in range(100):
        gap = c0 + s * (c1 + s * (c2 + s * c3))
        rate = c1 + s * (2.0 * c2 + s * 3.0 * c3)
        if gap > 0.0:
            low = s
        else:
            high = s
        new = s - gap / rate if rate < 0.0 else math.inf
        enough = 1e-9  # Newton's next error is of the size of its square
        if not low <= new <= high:
            new = 0.5 * (low + high)
            enough = 1e-16
        done = abs(new - s) < enough
        s = new
        if done:
            break
    return s
