"""From physical quantities to the dimensionless beam and back."""

from __future__ import annotations

import math

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.modal import modes


class Parabola:
    """0.01 (1 + 3 t - 2 t^2): a time function of the user's own."""

    def value(self, t):
        return 0.01 * (1.0 + 3.0 * np.asarray(t) - 2.0 * np.asarray(t) ** 2)

    def rate(self, t):
        return 0.01 * (3.0 - 4.0 * np.asarray(t))

    def acceleration(self, t):
        return np.full(np.shape(t), -0.04)


LENGTH, WIDTH, HEIGHT = 2.0, 0.05, 0.01  # a steel strip (m)


BENDING = 2.1e11 * WIDTH * HEIGHT**3 / 12  # EI


MASS = 7850.0 * WIDTH * HEIGHT  # rho A


FIRST = 1.8751040687119612**2 * math.sqrt(BENDING / (MASS * LENGTH**4))  # rad/s


STRIP = {"length": LENGTH, "bending_stiffness": BENDING, "mass_per_length": MASS}


TIP_STIFFNESS = 3.0 * BENDING / LENGTH**3  # N/m under a force at the tip


@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
@pytest.mark.parametrize("time_unit", [1.0, 0.05])
def test_a_steel_cantilever_has_the_textbooks_first_frequency(form, time_unit):
    problem = sb.BeamProblem.from_physical(**STRIP, time_unit=time_unit)
    coarse, fine = (modes(sb.semidiscretise(problem, M, form)).omega[0] / problem.units.time for M in (20, 40))
    assert abs(coarse / FIRST - 1.0) < 1.0 / 20**2
    assert 3.9 < (coarse - FIRST) / (fine - FIRST) < 4.1  # second order in h
    # What Richardson's extrapolation leaves is of order h^4 = 6e-6 at M = 20.
    assert abs((4.0 * fine - coarse) / 3.0 / FIRST - 1.0) < 6e-6


def test_the_units_scale_displacement_velocity_time_and_force_back():
    problem = sb.BeamProblem.from_physical(**STRIP, time_unit=0.05)
    units = problem.units
    assert units.displacement(0.25) == 0.5
    assert abs(units.velocity(0.25) - 0.25 * 2.0 / 0.05) < 1e-14
    assert np.allclose(units.seconds([0.0, 2.0]), [0.0, 0.1], rtol=1e-15)
    # A force is counted in rho A L^2/t0^2.
    assert abs(units.newtons(1.0) - MASS * 4.0 / 0.0025) < 1e-12 * units.force
    assert sb.BeamProblem(stiffness=1.0).units is None


def tip_deflection(problem, M):
    """Metres at the tip under the constant loads of ``problem``."""
    system = sb.semidiscretise(problem, M)
    return float(problem.units.displacement(np.linalg.solve(system.stiffness, system.load(0.0))[-1]))


@pytest.mark.parametrize("time_unit", [1.0, 0.02])
def test_a_tip_force_in_newtons_bends_the_strip_as_in_the_textbook(time_unit):
    loads = (sb.PointLoad(LENGTH, sb.Constant(5.0)),)
    problem = sb.BeamProblem.from_physical(**STRIP, loads=loads, time_unit=time_unit)
    assert abs(tip_deflection(problem, 20) / (5.0 / TIP_STIFFNESS) - 1.0) < 1.0 / 20**2


@pytest.mark.parametrize("time_unit", [1.0, 0.02])
def test_a_force_inside_the_span_bends_the_strip_as_in_the_textbook(time_unit):
    a = 1.2
    loads = (sb.PointLoad(a, sb.Constant(5.0)),)
    problem = sb.BeamProblem.from_physical(**STRIP, loads=loads, time_unit=time_unit)
    exact = 5.0 * a**2 * (3.0 * LENGTH - a) / (6.0 * BENDING)
    assert abs(tip_deflection(problem, 20) / exact - 1.0) < 3.0 / 20**2  # h is 1.7 times coarser on [0, a]


@pytest.mark.parametrize("time_unit", [1.0, 0.02])
def test_a_load_in_newtons_per_metre_takes_x_in_metres(time_unit):
    """A load growing to w0 at the tip deflects it by 11 w0 L^4/(120 EI)."""
    loads = (sb.DistributedLoad(lambda X: X, lambda t: 3.0),)
    problem = sb.BeamProblem.from_physical(**STRIP, loads=loads, time_unit=time_unit)
    exact = 11.0 * (3.0 * LENGTH) * LENGTH**4 / (120.0 * BENDING)
    assert abs(tip_deflection(problem, 20) / exact - 1.0) < 2.0 / 20**2


@pytest.mark.parametrize("time_unit", [1.0, 0.02])
def test_the_stop_stiffness_in_newtons_per_metre_balances_the_tip_force(time_unit):
    gap, kappa = 0.004, 2e4
    force = 2.0 * TIP_STIFFNESS * gap  # twice what closes the gap
    problem = sb.BeamProblem.from_physical(
        **STRIP,
        stops=sb.Stops(-gap, gap, stiffness=kappa),
        loads=(sb.PointLoad(LENGTH, sb.Constant(force)),),
        time_unit=time_unit,
    )
    system = sb.semidiscretise(problem, 20)
    row, stops = system.contacts[0].row, system.contacts[0].stops
    free, compliance = (np.linalg.solve(system.stiffness, f)[-1] for f in (system.load(0.0), row))
    sigma = stops.solve(free, compliance)
    # kappa (U - gap) + TIP_STIFFNESS U = force; the tip stiffness has the error h^2/2, so has the force.
    U = (force + kappa * gap) / (TIP_STIFFNESS + kappa)
    assert abs(problem.units.newtons(sigma) / (-kappa * (U - gap)) - 1.0) < 1.0 / 20**2
    assert abs(problem.units.displacement(free + compliance * sigma) / U - 1.0) < 1.0 / 20**2


@pytest.mark.parametrize("time_unit", [1.0, 0.02])
def test_the_bending_viscosity_damps_each_mode_by_eta_over_ei_times_its_frequency_squared(time_unit):
    problem = sb.BeamProblem.from_physical(**STRIP, bending_viscosity=0.4, time_unit=time_unit)
    basis = modes(sb.semidiscretise(problem, 12))
    omega, damping = basis.omega / time_unit, basis.damping / time_unit  # rad/s and 1/s
    # The damping is a product of matrices: eps w_max^2 in each, 1e-11 of the first.
    assert np.max(np.abs(damping - 0.4 / BENDING * omega**2)) < 1e-13 * damping[-1]
    assert abs(damping[0] / (0.4 / BENDING * FIRST**2) - 1.0) < 2.5 / 12**2  # omega has the error h^2


@pytest.mark.parametrize(
    "base", [sb.Harmonic(0.01, 30.0, 0.4), sb.Constant(0.02), Parabola()], ids=lambda base: type(base).__name__
)
def test_the_base_moves_by_the_same_metres_at_the_same_seconds(base):
    problem = sb.BeamProblem.from_physical(**STRIP, base=base, time_unit=0.05)
    t = np.linspace(0.0, 3.0, 7)
    seconds = problem.units.seconds(t)
    assert np.allclose(problem.units.displacement(problem.base.value(t)), base.value(seconds), rtol=1e-13, atol=1e-16)
    assert np.allclose(problem.units.velocity(problem.base.rate(t)), base.rate(seconds), rtol=1e-13, atol=1e-15)
    metres_per_square_second = problem.base.acceleration(t) * LENGTH / 0.05**2
    assert np.allclose(metres_per_square_second, base.acceleration(seconds), rtol=1e-13, atol=1e-13)


def test_the_physical_initial_state_is_read_in_metres():
    problem = sb.BeamProblem.from_physical(
        **STRIP, initial_displacement=lambda X: 0.01 * X**2, initial_velocity=lambda X: 0.3 * X, time_unit=0.05
    )
    x = np.linspace(0.0, 1.0, 5)
    assert np.allclose(problem.units.displacement(problem.initial_displacement(x)), 0.01 * (2.0 * x) ** 2, rtol=1e-15)
    assert np.allclose(problem.units.velocity(problem.initial_velocity(x)), 0.3 * 2.0 * x, rtol=1e-14)


@pytest.mark.parametrize("scheme", [sb.HHT(-0.1), sb.SDIRK()], ids=str)
def test_the_time_unit_changes_nothing_in_metres_newtons_and_seconds(scheme):
    def solve(time_unit):
        problem = sb.BeamProblem.from_physical(
            **STRIP,
            bending_viscosity=0.1,
            stops=sb.Stops(-0.004, 0.004, stiffness=1e6),
            base=sb.Harmonic(0.01, 60.0, 0.3),
            loads=(sb.PointLoad(1.3, sb.Harmonic(20.0, 35.0)),),
            initial_displacement=lambda X: 0.01 * np.sin(0.3) - 1e-3 * X**2,
            initial_velocity=lambda X: 0.2 * X,
            time_unit=time_unit,
        )
        dt = 2e-5 / time_unit
        run = sb.integrate(sb.semidiscretise(problem, 16), scheme, dt, 1000 * dt)
        units = problem.units
        return (
            units.seconds(run.t), units.displacement(run.tip), units.velocity(run.tip_velocity),
            units.newtons(run.contact_force), units.seconds(run.impacts.times),
        )  # fmt: skip

    one, other = solve(1.0), solve(0.037)
    assert len(one[-1]) == len(other[-1]) > 0
    # Rounding only; a few impacts amplify it, far from 1e-9 in 1000 steps.
    for a, b in zip(one, other, strict=True):
        assert np.max(np.abs(a - b)) < 1e-9 * np.max(np.abs(a))


@pytest.mark.parametrize("field", ["length", "bending_stiffness", "mass_per_length", "time_unit"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, "2"])
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
    u0 = problem.units.displacement(problem.initial_displacement(np.array([0.0, 1.0])))
    assert np.max(np.abs(u0 - amplitude * np.sin(phase))) < 1e-15
