"""From switch to switch without damping: one contact, three regimes, all of it compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array, IntArray
from ...basics.compiled import compiled
from ...piecewise.oscillation import oscillations, pair
from ...piecewise.search import search
from ...piecewise.terms import CONSTANT, LEVEL, OMEGA, SQUARE, X, Y, layout


class Regimes(NamedTuple):
    """eta'' + omega^2 eta = level + harmonics,  eta = h + P g(t),  in each of the three contact regimes.

    Of (free, contact), the stops have one stiffness: omegas (2, n); rows (2, n), the contact position's modal row;
    cross (2, n, n), from the modes of each into those of the other. Of (free, upper, lower), so that a side is its own
    index: levels (3, n); particulars (3, n, d), P, d-th drive coefficient to modal amplitude, its constant column zero;
    waves (3, d), what the row sees of P, the offset included. constant: the offset's own. frequencies: (F,).
    close: (p, 2), the pairs of a mode and a drive frequency so close that P would be large and h cancel it; P is zero
    there, and the mode answers that drive from rest at the start of every piece. close_forces: (3, p, 2), the modal
    force of a pair's sine and cosine. order, speeds: (2, n + F), modes and then drives by their frequency, and that.
    g1, g2: the stops.
    """

    omegas: Array
    rows: Array
    levels: Array
    particulars: Array
    waves: Array
    constant: float
    cross: Array
    frequencies: Array
    close: NDArray[np.int64]
    close_forces: Array
    order: NDArray[np.int64]
    speeds: Array
    g1: float
    g2: float


@compiled
def see(
    regimes: Regimes, regime: int, h: Array, rate: Array, start: float, speeds: Array, terms: Array, seen: Array,
    pairs: Array,
) -> None:  # fmt: skip
    """What the contact sees of a piece that begins at ``start`` with the homogeneous part h, h', see terms.py."""
    n = h.size
    own = 0 if regime == 0 else 1
    seen[0, CONSTANT] = regimes.constant
    for k in range(speeds.shape[1]):
        j = regimes.order[own, k]
        w = regimes.speeds[own, k]
        speeds[OMEGA, k], speeds[SQUARE, k] = w, w * w
        if j < n:
            row = regimes.rows[own, j]
            terms[0, X, k], terms[0, Y, k] = row * h[j], row * rate[j]
            terms[0, LEVEL, k] = row * regimes.levels[regime, j]
        else:
            a, b = regimes.waves[regime, 1 + 2 * (j - n)], regimes.waves[regime, 2 + 2 * (j - n)]
            s, c = math.sin(w * start), math.cos(w * start)
            terms[0, X, k], terms[0, Y, k], terms[0, LEVEL, k] = a * s + b * c, w * (a * c - b * s), 0.0
    for i in range(regimes.close.shape[0]):
        j = regimes.close[i, 0]
        pairs[i, 0], pairs[i, 1] = regimes.omegas[own, j], regimes.frequencies[regimes.close[i, 1]]
        pairs[i, 2], pairs[i, 3] = regimes.close_forces[regime, i, 0], regimes.close_forces[regime, i, 1]
        pairs[i, 4] = regimes.rows[own, j]


@compiled
def advance(
    regimes: Regimes, regime: int, h: Array, rate: Array, start: float, tau: float, q: Array, v: Array, c: Array,
    s: Array, versine: Array,
) -> None:  # fmt: skip
    """The homogeneous part and the answers of close pairs at start + tau into q, v (n,); c, s, versine: work, (n,)."""
    own = 0 if regime == 0 else 1
    omega, level = regimes.omegas[own], regimes.levels[regime]
    oscillations(omega, tau, c, s, versine)
    for j in range(h.size):
        q[j] = h[j] * c[j] + rate[j] * s[j] + level[j] * versine[j]
    for j in range(h.size):
        v[j] = rate[j] * c[j] + (level[j] - omega[j] * omega[j] * h[j]) * s[j]
    for i in range(regimes.close.shape[0]):
        j = regimes.close[i, 0]
        force = regimes.close_forces[regime, i]
        eta, eta_rate, _ = pair(omega[j], regimes.frequencies[regimes.close[i, 1]], force[0], force[1], start, tau)
        q[j] += eta
        v[j] += eta_rate


@compiled
def drive(regimes: Regimes, regime: int, t: float, sign: float, q: Array, v: Array) -> None:
    """Add the particular solution, ``sign`` times, to q and v (n,)."""
    particular = regimes.particulars[regime]
    for k in range(regimes.frequencies.size):
        w = regimes.frequencies[k]
        s, c = sign * math.sin(w * t), sign * math.cos(w * t)
        for j in range(q.size):
            a, b = particular[j, 1 + 2 * k], particular[j, 2 + 2 * k]
            q[j] += a * s + b * c
            v[j] += w * (a * c - b * s)


@compiled
def change(cross: Array, q: Array, v: Array, h: Array, rate: Array) -> None:
    """cross q and cross v into h, rate (n,): from the modes of one contact state to those of the other."""
    n = q.size
    for j in range(n):
        a = 0.0
        b = 0.0
        for i in range(n):
            a += cross[j, i] * q[i]
            b += cross[j, i] * v[i]
        h[j] = a
        rate[j] = b


@compiled
def unsettle(
    regimes: Regimes, old: int, h: Array, rate: Array, start: float, new: int, t: float, noise: Array, size: float,
    new_h: Array, new_rate: Array,
) -> None:  # fmt: skip
    """Change h and h' of a piece that begins at t in the regime ``new`` by what is lost there: the rounding of t, and
    of the sums that carry the amplitudes of the ``old`` regime, h and rate at its ``start``, over to the new one.
    noise: (3, n)."""
    n = h.size
    own, other = (0, 1) if old == 0 else (1, 0)
    omega, level, particular = regimes.omegas[own], regimes.levels[old], regimes.particulars[old]
    place, speed = np.empty(n), np.empty(n)
    for j in range(n):
        w = omega[j]
        reach = min(1.0 / max(w, 1e-300), t - start)  # |sin(omega tau)/omega| at most
        place[j] = abs(h[j]) + abs(rate[j]) * reach
        speed[j] = abs(rate[j]) + abs(level[j] - w * w * h[j]) * reach
        for k in range(regimes.frequencies.size):
            driven = abs(particular[j, 1 + 2 * k]) + abs(particular[j, 2 + 2 * k])
            place[j] += driven
            speed[j] += regimes.frequencies[k] * driven
    late = size * noise[0, 0] * t
    new_level, new_omega = regimes.levels[new], regimes.omegas[other]
    for j in range(n):
        a = 0.0
        b = 0.0
        for i in range(n):
            a += (regimes.cross[own, j, i] * place[i]) ** 2
            b += (regimes.cross[own, j, i] * speed[i]) ** 2
        new_h[j] += late * new_rate[j] + size * noise[1, j] * math.sqrt(a)
        new_rate[j] += late * (new_level[j] - new_omega[j] ** 2 * new_h[j]) + size * noise[2, j] * math.sqrt(b)


@compiled
def follow(
    regimes: Regimes, regime: int, h: Array, rate: Array, t_start: float, t_end: float, at_switch: bool, noise: Array,
    size: float, out_t: Array, out_regime: IntArray, out_h: Array, out_rate: Array,
) -> tuple[int, int]:  # fmt: skip
    """Follow the solution from (h, h') at t_start in ``regime`` until t_end or until the output is full.

    at_switch: the start is a switch, its gap exactly 0. noise: (switches, 3, n) in [-1, 1], what ``unsettle`` takes
    ``size`` times at every switch; none for size 0. Returns (switches written, evaluations). Raises SolverFailure
    where the motion overflows or the search stands still.
    """
    n = h.size
    speeds, terms, seen, pairs = layout(1, n + regimes.frequencies.size, regimes.close.shape[0])
    chi, resting = np.empty(1, np.int64), np.empty(1, np.int64)
    g1, g2 = np.array([regimes.g1]), np.array([regimes.g2])
    q, v, c, s, versine = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    count = 0
    evaluations = 0
    while count < out_t.size:
        see(regimes, regime, h, rate, t_start, speeds, terms, seen, pairs)
        chi[0], resting[0] = regime, at_switch
        tau, contact, side, used = search(speeds, terms, seen, pairs, chi, g1, g2, resting, t_start, t_end)
        evaluations += used
        t = t_start + tau
        if contact < 0 or t >= t_end:
            break
        new = side if regime == 0 else 0
        advance(regimes, regime, h, rate, t_start, tau, q, v, c, s, versine)
        drive(regimes, regime, t, 1.0, q, v)
        new_h, new_rate = out_h[count], out_rate[count]
        change(regimes.cross[0 if regime == 0 else 1], q, v, new_h, new_rate)
        drive(regimes, new, t, -1.0, new_h, new_rate)
        if size > 0.0:
            unsettle(regimes, regime, h, rate, t_start, new, t, noise[count], size, new_h, new_rate)
        out_t[count], out_regime[count] = t, new
        h, rate, regime, t_start, at_switch = new_h, new_rate, new, t, True
        count += 1
    return count, evaluations
