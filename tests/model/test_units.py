"""A beam in metres, seconds and newtons, against the textbook: nothing is converted on the way."""

from __future__ import annotations

import math

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.model.modes import modes

LENGTH, WIDTH, HEIGHT = 2.0, 0.05, 0.01  # a steel strip (m)


BENDING = 2.1e11 * WIDTH * HEIGHT**3 / 12  # EI


MASS = 7850.0 * WIDTH * HEIGHT  # rho A


FIRST = 1.8751040687119612**2 * math.sqrt(BENDING / (MASS * LENGTH**4))  # rad/s


STRIP = {"length": LENGTH, "bending_stiffness": BENDING, "mass_per_length": MASS}


TIP_STIFFNESS = 3.0 * BENDING / LENGTH**3  # N/m under a force at the tip


@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
def test_a_steel_cantilever_has_the_textbooks_first_frequency(form):
    problem = sb.BeamProblem.from_physical(**STRIP)
    coarse, fine = (modes(sb.semidiscretise(problem, M, form)).omega[0] for M in (20, 40))
    assert abs(coarse / FIRST - 1.0) < 1.0 / 20**2
    assert 3.9 < (coarse - FIRST) / (fine - FIRST) < 4.1  # second order in h
    # What Richardson's extrapolation leaves is of order h^4 = 6e-6 at M = 20.
    assert abs((4.0 * fine - coarse) / 3.0 / FIRST - 1.0) < 6e-6


def tip_deflection(problem, M):
    """Metres at the tip under the constant loads of ``problem``."""
    system = sb.semidiscretise(problem, M)
    return float(np.linalg.solve(system.stiffness, system.load(0.0))[-1])


def test_a_tip_force_in_newtons_bends_the_strip_as_in_the_textbook():
    loads = (sb.PointLoad(LENGTH, sb.Constant(5.0)),)
    problem = sb.BeamProblem.from_physical(**STRIP, loads=loads)
    assert abs(tip_deflection(problem, 20) / (5.0 / TIP_STIFFNESS) - 1.0) < 1.0 / 20**2


def test_a_force_inside_the_span_bends_the_strip_as_in_the_textbook():
    a = 1.2
    loads = (sb.PointLoad(a, sb.Constant(5.0)),)
    problem = sb.BeamProblem.from_physical(**STRIP, loads=loads)
    exact = 5.0 * a**2 * (3.0 * LENGTH - a) / (6.0 * BENDING)
    assert abs(tip_deflection(problem, 20) / exact - 1.0) < 3.0 / 20**2  # h is 1.7 times coarser on [0, a]


def test_a_load_in_newtons_per_metre_takes_x_in_metres():
    """A load growing to w0 at the tip deflects it by 11 w0 L^4/(120 EI)."""
    loads = (sb.DistributedLoad(lambda X: X, lambda t: 3.0),)
    problem = sb.BeamProblem.from_physical(**STRIP, loads=loads)
    exact = 11.0 * (3.0 * LENGTH) * LENGTH**4 / (120.0 * BENDING)
    assert abs(tip_deflection(problem, 20) / exact - 1.0) < 2.0 / 20**2


def test_the_stop_stiffness_in_newtons_per_metre_balances_the_tip_force():
    gap, kappa = 0.004, 2e4
    force = 2.0 * TIP_STIFFNESS * gap  # twice what closes the gap
    problem = sb.BeamProblem.from_physical(
        **STRIP, stops=sb.Stops(-gap, gap, stiffness=kappa), loads=(sb.PointLoad(LENGTH, sb.Constant(force)),)
    )
    system = sb.semidiscretise(problem, 20)
    row, stops = system.contacts[0].row, system.contacts[0].stops
    free, compliance = (np.linalg.solve(system.stiffness, f)[-1] for f in (system.load(0.0), row))
    sigma = stops.solve(free, compliance)
    # kappa (U - gap) + TIP_STIFFNESS U = force; the tip stiffness has the error h^2/2, so has the force.
    U = (force + kappa * gap) / (TIP_STIFFNESS + kappa)
    assert abs(sigma / (-kappa * (U - gap)) - 1.0) < 1.0 / 20**2
    assert abs((free + compliance * sigma) / U - 1.0) < 1.0 / 20**2


def test_the_bending_viscosity_damps_each_mode_by_eta_over_ei_times_its_frequency_squared():
    problem = sb.BeamProblem.from_physical(**STRIP, bending_viscosity=0.4)
    basis = modes(sb.semidiscretise(problem, 12))
    omega, damping = basis.omega, basis.damping  # rad/s and 1/s
    # The damping is a product of matrices: eps w_max^2 in each, 1e-11 of the first.
    assert np.max(np.abs(damping - 0.4 / BENDING * omega**2)) < 1e-13 * damping[-1]
    assert abs(damping[0] / (0.4 / BENDING * FIRST**2) - 1.0) < 2.5 / 12**2  # omega has the error h^2


@pytest.mark.parametrize("field", ["length", "bending_stiffness", "mass_per_length"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, "two"])
def test_physical_quantities_that_are_not_positive_are_named(field, value):
    with pytest.raises(sb.InputError) as caught:
        sb.BeamProblem.from_physical(**STRIP | {field: value})
    assert caught.value.field == field
    assert caught.value.value is value


def test_a_negative_bending_viscosity_is_named():
    with pytest.raises(sb.InputError, match=r"^bending_viscosity must be >= 0, got -0\.1"):
        sb.BeamProblem.from_physical(**STRIP, bending_viscosity=-0.1)


@pytest.mark.parametrize("noise", [lambda X: 0.0 * X, lambda X: 2e-17 * (X > 0.0)], ids=["none", "last bits"])
def test_a_beam_that_starts_straight_and_level_with_its_clamp_is_accepted(noise):
    """phi(0) is the same number only up to rounding, for lengths that are no power of two."""
    amplitude, phase = 0.073, 1.63
    problem = sb.BeamProblem.from_physical(
        length=3.07,
        bending_stiffness=1.0,
        mass_per_length=1.0,
        base=sb.Harmonic(amplitude, 30.0, phase),
        initial_displacement=lambda X: amplitude * np.sin(phase) + noise(X),
    )
    system = sb.semidiscretise(problem, 8)
    assert np.max(np.abs(system.q0 - amplitude * np.sin(phase) * (np.arange(1, 9) / 8.0) ** 2)) < 1e-15
