"""A body under gravity on a rigid floor that swings, z = z0 sin(w t + phase), never as fast as to throw it off.

h'' = -g - z''   in flight,   h'+ = -e h'-   where h = 0;   e < 1: impacts end, and it rides on the floor
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import brentq

import stiffbeam as sb

G, T_END = 10.0, 1.0


def floor(seed):
    rng = np.random.default_rng(seed)
    w = rng.uniform(0.5, 6.0)
    z0, phase = rng.uniform(0.05, 0.9) * 9.0 / w**2, rng.choice([0.0, rng.uniform(0.0, 6.0)])
    e = rng.choice([0.0, rng.uniform(0.05, 0.9)])
    apart = rng.choice([0.0, 10 ** rng.uniform(-6.0, -0.5)])  # h' at the start
    return float(w), float(z0), float(phase), float(e), float(apart)


def system_of(w, z0, phase, e, apart, stiffness=0.0):
    stops = sb.Stops(lower=0.0, stiffness=np.inf, restitution=e)
    return sb.System.from_matrices(
        [[1.0]],
        [[stiffness]],
        loads=[([1.0], sb.Constant(-G))],
        contacts=[sb.Contact([1.0], stops, offset=sb.Harmonic(-z0, w, phase))],
        initial_displacement=[z0 * np.sin(phase)],
        initial_velocity=[z0 * w * np.cos(phase) + apart],
    )


def flights(t, w, z0, phase, e, speed):
    """h at the times t and the times of the impacts, flight by flight, while they are faster than 1e-7."""

    def z(t):
        return z0 * np.sin(w * t + phase)

    def rate(t):
        return z0 * w * np.cos(w * t + phase)

    h, impacts, begun = np.zeros(len(t)), [], 0.0
    while speed > 1e-7:

        def gap(s, begun=begun, speed=speed):
            return (speed + rate(begun)) * s - 0.5 * G * s**2 + z(begun) - z(begun + s)

        first = 2.0 * speed / (G + z0 * w**2)  # it cannot come down sooner
        last = first
        while gap(last) > 0.0:
            last *= 1.1
        flight = brentq(gap, 0.9 * first, last, xtol=1e-16, rtol=1e-15)
        up = (t >= begun) & (t < begun + flight)
        h[up] = gap(t[up] - begun)
        speed = -e * (speed + rate(begun) - G * flight - rate(begun + flight))
        begun += flight
        if begun > T_END:
            break
        impacts.append(begun)
    return h, impacts


@pytest.mark.parametrize("seed", range(30))
def test_the_exact_solution_rides_and_bounces_on_the_floor(seed):
    w, z0, phase, e, apart = floor(seed)
    t = np.linspace(0.0, T_END, 201)
    run = sb.reference(system_of(w, z0, phase, e, apart), T_END, t_eval=t)
    found = run.contacts[0]
    assert run.horizon == T_END
    h, impacts = flights(t, w, z0, phase, e, apart)
    assert np.max(np.abs(found.position - h)) < 1e-12
    impacts = [x for x, after in pairwise(impacts) if after - x > 1e-6]
    assert np.allclose(found.impacts.times[: len(impacts)], impacts, rtol=0.0, atol=1e-7)
    assert found.position[-1] == found.velocity[-1] == 0.0


@pytest.mark.parametrize("stiffness", [1e-9, 1.0])
@pytest.mark.parametrize("e", [0.0, 0.5, 0.9])
def test_every_scheme_stays_on_a_floor_that_it_starts_with(e, stiffness):
    """To what a step falls before the stop is felt, g dt^2."""
    system = system_of(1.0, 0.5, 0.0, e, 0.0, stiffness)
    for dt in (1e-2, 1e-3, 1e-4):
        for scheme in (sb.PaoliSchatzman(), sb.MoreauJean(), sb.NonsmoothGeneralisedAlpha(0.8)):
            seen = sb.integrate(system, scheme, dt, 0.5).contacts[0]
            assert np.max(np.abs(seen.position)) < 1.1 * G * dt**2, scheme
            assert seen.impacts.count == 0, scheme
