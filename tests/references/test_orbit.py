"""Periodic orbits of exact motions against closed forms, Liouville's formula and differences of the flow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references.exact.orbit import PeriodMap


def differences(mapping: PeriodMap, z: np.ndarray, width: float) -> np.ndarray:
    """Derivative of the period map by differences of order 4."""
    columns = []
    for j, size in enumerate(np.where(np.arange(len(z)) < len(z) // 2, width, width * 10.0)):
        e = np.eye(len(z))[j] * size
        ends = {k: mapping.flow(z + k * e)[0] for k in (1, -1, 2, -2)}
        columns.append((8.0 * (ends[1] - ends[-1]) - (ends[2] - ends[-2])) / (12.0 * size))
    return np.column_stack(columns)


@pytest.mark.parametrize("damping", [0.0, 3.0])
def test_an_orbit_of_one_mass_on_a_damped_stop(damping):
    """Its monodromy by differences and, of the conservative stop, its determinant exp(-c T/m)."""
    c, frequency = 0.4, 2.2
    stops = sb.Stops(upper=0.2, stiffness=300.0, damping=damping)
    system = one_mass(4.0, stops, damping=c, load=sb.Harmonic(2.0, frequency, phase=0.3))
    period = 2.0 * np.pi / frequency
    orbit = sb.periodic_orbit(system, period)
    assert orbit.closure < 1e-13
    assert len(orbit.events) >= 2
    z = np.concatenate([orbit.q, orbit.v])
    assert np.allclose(differences(PeriodMap(system, period), z, 1e-5), orbit.monodromy, atol=1e-8)
    assert damping or abs(np.linalg.det(orbit.monodromy) - np.exp(-c * period)) < 1e-9
    # as the exact motion of another solver: CVODE comes back to its start
    moved = replace(system, q0=orbit.q, v0=orbit.v)
    run = sb.reference(moved, period, method="cvode", t_eval=[0.0, period], rtol=1e-11, atol=1e-13)
    assert abs(run.tip[-1] - orbit.q[0]) < 1e-7


def test_what_a_periodic_orbit_refuses():
    system, period = one_mass(1.0, load=sb.Harmonic(1.0, 2.8)), 2.0 * np.pi / 2.8
    with pytest.raises(sb.InputError, match=r"be a multiple of 2 pi/2\.8"):
        sb.periodic_orbit(system, 1.1 * period)
    with pytest.raises(sb.InputError, match="be an Orbit or a pair"):
        sb.periodic_orbit(system, period, [1.0, 2.0, 3.0])


@pytest.mark.parametrize(("c", "k"), [(0.0, 1.0), (0.1, 0.0)])
def test_a_drive_in_resonance_and_a_free_mass_have_no_orbit_of_their_own(c, k):
    with pytest.raises(sb.SolverFailure, match=r"a multiplier is 1|Singular"):
        sb.periodic_orbit(one_mass(k, damping=c, load=sb.Harmonic(1.0, 1.0)), 2.0 * np.pi)


@pytest.mark.parametrize(
    ("fold", "z", "inside"),
    [
        (1.3179006294954156, (-1.9138595275260408, -1.1479427616807307), -1.0),
        (1.2564950975691516, (-0.12174418167014284, -0.6395509957087694), 1.0),
    ],
)
def test_an_orbit_at_a_fold_closes_or_raises(fold, z, inside):
    """At a fold the equations of the event times are singular: their solution was 6e-5 from an orbit.

    The folds were found once by pseudo-arclength continuation.
    """

    def softly_stopped(w: float) -> sb.System:
        return one_mass(1.0, sb.Stops(upper=0.5, stiffness=4.0), damping=0.1, load=sb.Harmonic(0.3, w))

    with pytest.raises(sb.SolverFailure, match="a multiplier is 1 but for rounding: a fold"):
        sb.periodic_orbit(softly_stopped(fold), 2.0 * np.pi / fold, (z[:1], z[1:]))
    # The multiplier is 1 - c sqrt(distance): three decades below, a factor of 10^1.5.
    gaps = []
    for distance in (1e-9, 1e-6):
        w = fold + inside * distance
        orbit = sb.periodic_orbit(softly_stopped(w), 2.0 * np.pi / w, (z[:1], z[1:]))
        assert orbit.closure < 1e-13
        gaps.append(1.0 - orbit.multipliers[0].real)
    assert gaps[1] / gaps[0] == pytest.approx(10.0**1.5, rel=0.1)


@pytest.mark.parametrize("stops", [{"stiffness": np.inf, "restitution": 0.5}, {"stiffness": 50.0, "damping": 3.0}])
def test_an_orbit_that_grazes_has_no_multipliers(stops):
    """The amplitude of the response without contact is the gap: neighbours hit, or do not."""
    w = 0.5
    response = 1.0 / (1.0 - w**2 + 0.1j * w)
    start = [response.imag], [w * response.real]
    for gap, grazes in ((abs(response), True), (abs(response) * 1.001, False)):
        system = one_mass(1.0, sb.Stops(upper=gap, **stops), damping=0.1, load=sb.Harmonic(1.0, w))
        if grazes:
            with pytest.raises(sb.SolverFailure, match="grazes its stop"):
                sb.periodic_orbit(system, 2.0 * np.pi / w, start)
        else:
            orbit = sb.periodic_orbit(system, 2.0 * np.pi / w, start)
            np.testing.assert_allclose(np.abs(orbit.multipliers), np.exp(-0.05 * 2.0 * np.pi / w), rtol=1e-9)


def test_an_equilibrium_is_an_orbit():
    system = one_mass(1.0, damping=0.1, load=sb.Constant(1.0))
    np.testing.assert_allclose(sb.periodic_orbit(system, 2.0).q, 1.0, rtol=1e-12)


@pytest.mark.parametrize("turned", [0.0, 0.5 * np.pi])
def test_a_period_may_start_at_a_zero_of_position_or_velocity(turned):
    """Without events the start alone does not show the size of a motion. x'' + 0.3 x' + 2 x = sin(w t + phase) passes
    zero, or turns, at t = 0 for w = 1.2; its multipliers are exp(T (-0.15 +- i w_d))."""

    def driven(w: float) -> sb.System:
        load = sb.Harmonic(1.0, w, phase=turned + np.arctan2(0.3 * 1.2, 2.0 - 1.44))
        return one_mass(2.0, sb.Stops(upper=9.0, stiffness=4.0), damping=0.3, load=load)

    T, size = 2.0 * np.pi / 1.2, 1.0 / np.hypot(2.0 - 1.44, 0.36)
    orbit = sb.periodic_orbit(driven(1.2), T, ([0.0], [0.0]) if turned else ([0.0], [1.0]))
    np.testing.assert_allclose([*orbit.q, *orbit.v], [size * np.sin(turned), 1.2 * size * np.cos(turned)], atol=1e-13)
    assert np.min(np.abs(orbit.multipliers - np.exp(T * (-0.15 + 1j * np.sqrt(2.0 - 0.15**2))))) < 1e-13
