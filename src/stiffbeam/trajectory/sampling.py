"""Sampled impacts, step by step: chi_k != 0 and chi_k != chi_{k-1}, chi the contact state of u_k."""

from __future__ import annotations

import math

import numpy as np

from ..basics.arrays import Array
from ..basics.compiled import compiled, inlined
from ..model.contact import side_at_start
from ..model.contact_law import (
    Law,
    damps,
    force_of_node,
    law_force,
    law_of,
    pressure,
    state,
    state_of_node,
)

# A tally (..., 8) is what one contact has seen so far.
SIDE, TOUCHING, PEAK, IMPULSE, ROW, SINCE, LAST = range(7)
TALLY = 8
ON = 1e-14  # of a position: so near a stop a node is on it
# The steps up to SINCE are passed over; SIDE is followed from the start. LAST is |F| at the last step, of laws that are
# not linear.
# An impact is one row of a list of events; ROW is the row of the one that is open, or -1. A contact that is there at
# t = 0 has a row too, with TIME = AT_START.
MEMBER, CONTACT, TIME, STOP, IMPACT_PEAK, IMPACT_IMPULSE, END = range(7)
EVENT = 7
AT_START = -1.0


def new_tally(u0: Array, v0: Array, law: Array, since: int = 0) -> Array:
    """Tallies of the steps after ``since``, from positions u0 (...,) and velocities v0 under laws (..., 6).

    Contact before the first step is no impact.
    """
    tally = np.zeros((*np.shape(u0), TALLY))
    tally[..., ROW] = -1.0
    tally[..., SINCE] = since
    tally[..., SIDE] = side_at_start(u0, v0, law)
    return tally


@inlined
def scan(
    u: Array, count: int, law: Array, dt: float, tally: Array, i: int, c: int, events: Array, rows: int, first: int
) -> int:
    """Add the steps u (count,) to the tally of contact c of member i; new impacts are appended.

    law: (M, m, 6), linear, see contact_law. tally: (M, m, 8). first: the number of steps before u. Row ``rows`` of
    ``events`` is the first free one. Of a new impact TIME, and of one that ends END, hold the step before the
    crossing, 0 for the last one known; END is -1 of an impact that is still open. Returns the first free row.
    """
    kappa, g1, g2 = law_of(law[i], c)[:3]
    side = tally[i, c, SIDE]
    row = int(tally[i, c, ROW])
    passed = int(tally[i, c, SINCE]) - first  # so many of these steps are passed over
    # Peak and impulse of the open impact in local variables; the list is written when the impact ends.
    own_peak = events[row, IMPACT_PEAK] if row >= 0 else 0.0
    own_impulse = events[row, IMPACT_IMPULSE] if row >= 0 else 0.0
    touching = 0
    peak, impulse = tally[i, c, PEAK], tally[i, c, IMPULSE]
    k = 0
    while k < count:  # from one change of side to the next
        new = state(u[k], g1, g2)
        if new != side:
            if row >= 0:
                events[row, IMPACT_PEAK], events[row, IMPACT_IMPULSE] = own_peak, own_impulse
                events[row, END] = k
            row = -1
            if new != 0.0 and k >= passed:
                row = rows
                rows += 1
                events[row, TIME], events[row, STOP], events[row, END] = k, new, -1.0
                own_peak = own_impulse = 0.0
            side = new
        # Depths of a visit are summed first: the force is linear, so kappa and dt multiply the sum once.
        depths = deepest = 0.0
        while k < count and state(u[k], g1, g2) == side:
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
    # An impact that is still open goes on in the next call.
    if row >= 0:
        events[row, IMPACT_PEAK], events[row, IMPACT_IMPULSE] = own_peak, own_impulse
    tally[i, c, SIDE] = side
    tally[i, c, ROW] = row
    tally[i, c, TOUCHING] += touching
    tally[i, c, PEAK] = peak
    tally[i, c, IMPULSE] = impulse
    return rows


@compiled
def scan_by_law(
    u: Array, v: Array, forces: Array, means: bool, count: int, law: Array, dt: float, tally: Array, i: int, c: int,
    events: Array, rows: int, first: int,
) -> int:  # fmt: skip
    """``scan`` for any law, with the velocities v (count,) and the forces that nodes found, see ``force_of_node``:
    contact is where the stop presses.

    means: the forces are means over the steps. Impulses are theirs, the last one that of the step in which a contact
    ends; peaks and contact follow from u.
    """
    stop = law_of(law[i], c)
    side = tally[i, c, SIDE]
    row = int(tally[i, c, ROW])
    passed = int(tally[i, c, SINCE]) - first
    for k in range(count):
        new = state(u[k], stop.g1, stop.g2) if means else state_of_node(u[k], v[k], forces[k], stop)
        size = impulse = 0.0
        if new != 0.0:
            size = abs(law_force(u[k], 0.0, stop) if means else force_of_node(u[k], v[k], forces[k], stop))
        if k >= passed:
            impulse = (abs(forces[k]) if means else size) * dt
            tally[i, c, IMPULSE] += impulse
        if new != side:
            if row >= 0:
                events[row, END] = k
                # Of means: the step that leaves the stop has contact in part of it, and its impulse counts.
                events[row, IMPACT_IMPULSE] += impulse if new == 0.0 else 0.0
            row = -1
            if new != 0.0 and k >= passed:
                row = rows
                rows += 1
                events[row, TIME], events[row, STOP], events[row, END] = k, new, -1.0
                events[row, IMPACT_PEAK] = events[row, IMPACT_IMPULSE] = 0.0
            side = new
        if side != 0.0 and k >= passed:
            tally[i, c, TOUCHING] += 1.0
            tally[i, c, PEAK] = max(tally[i, c, PEAK], size)
            if row >= 0:
                events[row, IMPACT_PEAK] = max(events[row, IMPACT_PEAK], size)
                events[row, IMPACT_IMPULSE] += impulse
    tally[i, c, SIDE] = side
    tally[i, c, ROW] = row
    # ``with_ends`` counts the force at the last step half.
    if not means:
        tally[i, c, LAST] = abs(force_of_node(u[count - 1], v[count - 1], forces[count - 1], stop))
    return rows


@compiled
def switch_time(u0: float, v0: float, u1: float, v1: float, side: float, law: Law, dt: float) -> float:
    """Fraction of the step, 0 to 1, at which contact with the stop on ``side`` begins or ends: the crossing of the
    stop.

    At a damped stop that is penetrated, or held on to rounding, contact ends, and begins again, where the force
    changes sign.
    """
    stop = law.g2 if side > 0.0 else law.g1
    share = 0.0
    # At a damped stop that is reached, to rounding, the sign of the force dates the change, not the crossing.
    if damps(law) and side * (u0 - stop) > -ON * max(abs(u0), abs(stop)):
        before = pressure(side * (u0 - stop), side * v0, law)
        after = pressure(side * (u1 - stop), side * v1, law)
        if before * after < 0.0:
            share = before / (before - after)
        elif side * (u1 - stop) <= 0.0:
            share = crossing(u0, v0, u1, v1, stop, dt)
    else:
        share = crossing(u0, v0, u1, v1, stop, dt)
    return share


@compiled
def crossing(u0: float, v0: float, u1: float, v1: float, stop: float, dt: float) -> float:
    """Fraction of the step, 0 to 1, at which the cubic Hermite interpolant of (u, u') first reaches a stop beyond
    u0."""
    sign = 1.0 if u1 > u0 else -1.0
    # As a gap that falls through zero, whichever side the stop is on.
    return first_crossing(sign * (stop - u0), -sign * v0 * dt, sign * (stop - u1), -sign * v1 * dt)


@compiled
def first_crossing(gap0: float, rate0: float, gap1: float, rate1: float) -> float:
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
    # Both roots of p', without cancellation. Between extrema the cubic is monotone and has at most one zero.
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
    # Start from the secant, within the bracket.
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
            # Bisection only halves the error, so that it goes on to rounding.
            enough = 1e-16
        done = abs(new - s) < enough
        s = new
        if done:
            break
    return s
