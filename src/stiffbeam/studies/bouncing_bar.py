"""The elastic bar that bounces on a rigid wall under gravity, and its solution in rational numbers.

E = 900, rho = 1, L = 10, so that c = 30; gravity 10, dropped at rest from 5: it lands at t = 1 with speed 10, stays
for 2L/c = 2/3 and flies again, with period 16/3. Source: Doyen, Ern and Piperno, SIAM J. Sci. Comput. 33 (2011)
223-249, their second test.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache

import numpy as np

from ..basics.arrays import Array
from ..model.contact import Contact, Stops
from ..model.system import System
from ..model.time_functions import Constant

SPEED, LENGTH, MODULUS, GRAVITY, HEIGHT = 30, 10, 900, 10, 5
PERIOD = Fraction(16, 3)
ENERGY = 500.0  # M g h, all that there is
PIECE = Fraction(1, 3)  # between changes of the contact or of the waves' slope


def bar(cells: int, stops: Stops, fallen: float = 0.0) -> System:
    """Linear elements with lumped masses over stops at 0, falling for the time ``fallen`` already."""
    dx = LENGTH / cells
    mass = np.full(cells + 1, dx)
    mass[[0, -1]] *= 0.5
    ends = np.r_[1.0, np.full(cells - 1, 2.0), 1.0]
    stiffness = MODULUS / dx * (np.diag(ends) - np.eye(cells + 1, k=1) - np.eye(cells + 1, k=-1))
    return System.from_matrices(
        np.diag(mass),
        stiffness,
        loads=[(-GRAVITY * mass, Constant(1.0))],
        contacts=[Contact(np.eye(cells + 1)[0], stops, Constant(float(HEIGHT)))],
        initial_displacement=np.full(cells + 1, -0.5 * GRAVITY * fallen**2),
        initial_velocity=np.full(cells + 1, -GRAVITY * fallen),
    )


def foot(t: Array) -> Array:
    """The exact height of the foot at times t >= 0."""
    s, (wave, slope, closed, height) = _at(t)
    return np.where(closed, 0.0, height + wave * s + 0.5 * slope * s**2)


def pressure(t: Array) -> Array:
    """The exact force on the wall."""
    s, (wave, slope, closed, _) = _at(t)
    return np.where(closed, -(MODULUS / SPEED) * (wave + slope * s), 0.0)


def _at(t: Array) -> tuple[Array, Array]:
    t = np.asarray(t, float)
    k = np.floor(t / float(PIECE) + 1e-12).astype(int)
    return t - k * float(PIECE), np.array(pieces(int(np.max(k, initial=0)) + 1), float)[k].T


@lru_cache
def pieces(count: int) -> tuple[tuple[Fraction, Fraction, bool, Fraction], ...]:
    """(wave, slope, closed, height) at the starts k/3 of the pieces, by characteristics.

    ``wave`` is v + c u_x, which comes down to the foot: what went up 2L/c before, turned round at the free top, less
    2L/c g. Free, the foot moves by it, v = wave, and sends it up again; on the wall v = 0, it sends up -wave, and the
    force is -(E/c) wave, as long as that presses.
    """
    found: list[tuple[Fraction, Fraction, bool, Fraction]] = []
    height = Fraction(HEIGHT)
    for k in range(count):
        wave, slope = -GRAVITY * PIECE * k, Fraction(-GRAVITY)
        if k >= 2:
            before, slope_before, was_closed, _ = found[k - 2]
            sign = -1 if was_closed else 1
            wave, slope = sign * before - Fraction(2 * LENGTH * GRAVITY, SPEED), sign * slope_before
        closed = height == 0 and (wave < 0 or (wave == 0 and slope < 0))
        found.append((wave, slope, closed, height))
        if not closed:
            height += wave * PIECE + slope * PIECE**2 / 2
    return tuple(found)
