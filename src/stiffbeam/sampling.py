"""Sampled impacts, step by step: chi_k != 0 and chi_k != chi_{k-1}, chi the contact state of u_k."""

from __future__ import annotations

import math

import numpy as np

from .arrays import Array
from .compiled import compiled

# A tally (..., 8) is what one contact has seen so far.
SIDE, TOUCHING, PEAK, IMPULSE, ROW = range(5)
TALLY = 8
# An impact is one row of a list of events; ROW is the row of the one that is open, or -1.
MEMBER, CONTACT, TIME, STOP, IMPACT_PEAK, IMPACT_IMPULSE = range(6)
EVENT = 6


def new_tally(u0: Array, g1: Array, g2: Array) -> Array:
    """Tallies at positions u0 (...,), between stops g1 and g2; contact at the start is no impact."""
    tally = np.zeros((*np.shape(u0), TALLY))
    tally[..., ROW] = -1.0
    tally[..., SIDE] = (u0 > g2) * 1.0 - (u0 < g1) * 1.0
    return tally


@compiled
def scan(u, count, law, dt, tally, events, rows):
    """Take the steps u (count,) into one tally; impacts that begin are appended to ``events``.

    law: (kappa, g1, g2). Row ``rows`` of ``events`` is the first free one; a new impact holds the step
    before its crossing, 0 for the last one known, in TIME. Returns the first free row.
    """
    kappa, g1, g2 = law[0], law[1], law[2]
    side = tally[SIDE]
    row = int(tally[ROW])
    for k in range(count):
        new = 0.0
        depth = 0.0
        if u[k] > g2:
            new = 1.0
            depth = u[k] - g2
        elif u[k] < g1:
            new = -1.0
            depth = g1 - u[k]
        if new != side:
            row = -1
            if new != 0.0:
                row = rows
                rows += 1
                events[row, TIME] = k
                events[row, STOP] = new
                events[row, IMPACT_PEAK] = 0.0
                events[row, IMPACT_IMPULSE] = 0.0
            side = new
        if new != 0.0:
            force = kappa * depth
            tally[TOUCHING] += 1.0
            tally[PEAK] = max(tally[PEAK], force)
            tally[IMPULSE] += force * dt
            if row >= 0:
                events[row, IMPACT_PEAK] = max(events[row, IMPACT_PEAK], force)
                events[row, IMPACT_IMPULSE] += force * dt
    tally[SIDE] = side
    tally[ROW] = row
    return rows


@compiled
def crossing(u0, v0, u1, v1, stop, dt):
    """When in its step, 0 to 1, the cubic Hermite interpolant of (u, u') first reaches a stop beyond u0."""
    sign = 1.0 if u1 > u0 else -1.0
    return first_crossing(sign * (stop - u0), -sign * v0 * dt, sign * (stop - u1), -sign * v1 * dt)


@compiled
def first_crossing(gap0, rate0, gap1, rate1):
    """The least s in (0, 1] at which the cubic Hermite interpolant of a gap reaches zero.

    gap0 > 0 >= gap1 at s = 0 and 1; rate0, rate1: d gap/ds there. Bisection on the first sign change
    between the extrema of the cubic.
    """
    # p(s) = c0 + c1 s + c2 s^2 + c3 s^3
    c0, c1 = gap0, rate0
    c2 = 3.0 * (gap1 - gap0) - 2.0 * rate0 - rate1
    c3 = 2.0 * (gap0 - gap1) + rate0 + rate1
    points = np.array([0.0, 1.0, 1.0, 1.0])
    # p'(s) = c1 + 2 c2 s + 3 c3 s^2
    discriminant = c2 * c2 - 3.0 * c1 * c3
    if discriminant > 0.0:
        q = -(c2 + math.copysign(math.sqrt(discriminant), c2))
        for i, (top, bottom) in enumerate(((q, 3.0 * c3), (c1, q))):
            if bottom != 0.0 and 0.0 < top / bottom < 1.0:
                points[1 + i] = top / bottom
    points.sort()
    low = 0.0
    for high in points[1:]:
        if c0 + high * (c1 + high * (c2 + high * c3)) <= 0.0 or high == 1.0:
            for _ in range(60):
                middle = 0.5 * (low + high)
                if c0 + middle * (c1 + middle * (c2 + middle * c3)) > 0.0:
                    low = middle
                else:
                    high = middle
            return high
        low = high
    return 1.0
