"""Depth of a contact beyond its stop: largest and mean, in a segment without damping; compiled."""

from __future__ import annotations

import math

import numpy as np

from ..basics.arrays import Array
from ..basics.compiled import compiled
from .oscillation import pair
from .terms import CONSTANT, END, LEVEL, OMEGA, RATE, SQUARE, S, U, V, carry, curvature

NODES, WEIGHTS = np.polynomial.legendre.leggauss(10)
RADIANS = 1.5  # of the fastest motion between two samples: cubics through them err by a hundredth of it
RIVAL = 0.96  # of the largest sample: what is less does not hide the peak, cos(1.5/2) = 0.73 with its slopes


@compiled
def fastest_of(speeds: Array, pairs: Array) -> float:
    """The largest frequency among the terms and close pairs."""
    found = speeds[OMEGA, speeds.shape[1] - 1]
    for k in range(pairs.shape[0]):
        found = max(found, pairs[k, 0], pairs[k, 1])
    return found


@compiled
def top(
    speeds: Array, terms: Array, seen: Array, pairs: Array, start: float, tau: float, width: float, sign: float,
    stop: float, rise: float, fall: float,
) -> float:  # fmt: skip
    """The largest sign (u - stop) in [tau, tau + width], with rates ``rise`` > 0 at its start and ``fall`` < 0 at its
    end: Newton's method for u' = 0 inside the bracket. u is flat there: half the digits of the time give all of it."""
    low, high = tau, tau + width
    found = 0.0
    at = low + width * rise / (rise - fall)
    for _ in range(30):
        carry(speeds, terms, seen, pairs, False, start, at, 0)
        value, rate = sign * (seen[0, U] - stop), sign * seen[0, RATE]
        curve = sign * curvature(speeds, terms, pairs, start, at, 0, 0)
        found = max(found, value)
        if rate > 0.0:
            low = at
        else:
            high = at
        move = -rate / curve if curve < 0.0 else math.inf
        if not low <= at + move <= high:
            move = 0.5 * (low + high) - at
        elif abs(rate * move) <= 1e-9 * abs(value):  # the next such number is the square of this
            return max(found, value + 0.5 * rate * move)
        if abs(move) <= 1e-15 * (start + at):
            break
        at += move
    return found


@compiled
def peak(
    speeds: Array, terms: Array, seen: Array, pairs: Array, start: float, a: float, b: float, sign: float, stop: float
) -> float:
    """The largest sign (u - stop) for tau in [a, b], 0 at least."""
    count = 1 + int((b - a) * fastest_of(speeds, pairs) / RADIANS)
    width = (b - a) / count
    values, rates = np.empty(count + 1), np.empty(count + 1)
    found = 0.0
    for i in range(count + 1):
        carry(speeds, terms, seen, pairs, False, start, a + i * width, 0)
        values[i], rates[i] = sign * (seen[0, U] - stop), sign * seen[0, RATE]
        found = max(found, values[i])
    reach = RIVAL * found
    for i in range(count):
        # A cubic that rises at first and falls at last is not above where its ends' tangents meet.
        if rates[i] > 0.0 > rates[i + 1]:
            meet = (values[i + 1] - values[i] - rates[i + 1] * width) / (rates[i] - rates[i + 1])
            if values[i] + rates[i] * min(max(meet, 0.0), width) >= reach:
                at = a + i * width
                reached = top(speeds, terms, seen, pairs, start, at, width, sign, stop, rates[i], rates[i + 1])
                found = max(found, reached)
    return found


@compiled
def area(
    speeds: Array, terms: Array, seen: Array, pairs: Array, start: float, a: float, b: float, stop: float
) -> float:
    """The integral of u - stop over tau in [a, b]: of every term x S + y V + level T, T = (tau - S)/omega^2, and of
    close pairs by Gauss-Legendre quadrature."""
    carry(speeds, terms, seen, pairs, False, start, a, 1)
    carry(speeds, terms, seen, pairs, False, start, b - a, 0)  # for S and V alone
    tau = b - a
    total = (seen[0, CONSTANT] - stop) * tau
    for k in range(speeds.shape[1]):
        x = speeds[OMEGA, k] * tau
        z = x * x
        if x < 0.5:
            T = tau**3 / 6.0 * (1.0 - z / 20.0 * (1.0 - z / 42.0 * (1.0 - z / 72.0 * (1.0 - z / 110.0))))
        else:
            T = (tau - speeds[S, k]) / speeds[SQUARE, k]
        total += terms[0, END + 2, k] * speeds[S, k] + terms[0, END + 3, k] * speeds[V, k] + terms[0, LEVEL, k] * T
    for k in range(pairs.shape[0]):
        w, frequency = pairs[k, 0], pairs[k, 1]
        count = 1 + int(tau * (w + frequency) / 3.0)
        width = tau / count
        for i in range(count):
            for j in range(NODES.size):
                at = a + width * (i + 0.5 * (NODES[j] + 1.0))
                eta, _, _ = pair(w, frequency, pairs[k, 2], pairs[k, 3], start, at)
                total += pairs[k, 4] * eta * WEIGHTS[j] * 0.5 * width
    return total
