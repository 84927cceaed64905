"""The solution in many digits: against float64 inside the horizon, against itself past it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from oracles import damped_bounces
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references import solve
from stiffbeam.references.horizon import time_tolerance
from stiffbeam.references.multiprecision.multiprecision import carry

pytest.importorskip("flint")


@pytest.mark.slow
def test_past_it_float64_parts_from_it_and_the_digits_confirm_themselves(table10):
    system = sb.semidiscretise(table10, 25)
    many = sb.reference(system, 1.0, "multiprecision")
    double = sb.reference(system, 1.0, t_eval=many.t)
    assert many.horizon == 1.0
    # Table 10 loses about 33 digits per time unit.
    assert 40 < many.provenance["digits_confirmed_with"] < many.provenance["digits"] < 200
    inside = many.t <= double.horizon
    scale = np.max(np.abs(many.tip))
    assert np.max(np.abs(many.tip - double.tip)[inside]) < 1e-3 * scale
    assert np.max(np.abs(many.tip - double.tip)[~inside]) > 0.1 * scale
    # An independent number of digits gives the same switches over the whole span.
    other, *_ = carry(system, 1.0, 150)
    assert np.array_equal(other.sides, many.solution.sides)
    assert np.max(np.abs(other.times - many.solution.times)) < 1e-14
    # The energy ledger closes as it does in float64: the pieces are one solution.
    assert np.max(np.abs(many.energy.loss)) < 1e-10 * np.max(np.abs(many.energy.input))


@pytest.mark.slow
def test_too_few_digits_show_as_a_horizon(table10):
    system = sb.semidiscretise(table10, 25)
    few = sb.reference(system, 2.0, "multiprecision", digits=25)
    assert few.provenance["digits_confirmed_with"] == 25
    assert 0.3 < few.horizon < 2.0


@pytest.mark.slow
def test_a_damped_mass_between_stops_bounces_as_the_closed_form_in_mpmath_past_the_float64_horizon():
    pytest.importorskip("mpmath")
    system = one_mass(1.0, sb.Stops(-0.5, 0.8, stiffness=400.0), damping=0.02, load=sb.Harmonic(5.0, 2.8), v=1.0)
    many, double = sb.reference(system, 110.0, "multiprecision"), sb.reference(system, 110.0)
    expected = damped_bounces(1.0, 0.02, 400.0, (-0.5, 0.8), 5.0, 2.8, 0.0, 1.0, 110.0)
    times, sides = (np.array(x) for x in zip(*expected, strict=True))
    assert many.horizon == 110.0 > double.horizon + 20.0
    assert np.array_equal(many.solution.sides[1:, 0], sides)
    assert np.max(np.abs(many.solution.times[1:] - times)) < 1e-13  # rounding of the times to float64
    # float64 has it to its horizon.
    n = min(double.impacts.count, many.impacts.count)
    apart = np.abs(double.impacts.times[:n] - many.impacts.times[:n])
    assert np.max(apart[many.impacts.times[:n] < double.horizon]) < time_tolerance(system)


@pytest.mark.slow
@pytest.mark.parametrize("viscosity", [0.05, 20.0])
def test_a_viscous_beam_in_two_precisions_and_in_float64(viscosity, table10):
    """At d = 20 most modes are overdamped and lie within 1e-7 of each other."""
    system = sb.semidiscretise(dataclasses.replace(table10, viscosity=viscosity), 12)
    many = sb.reference(system, 0.3, "multiprecision")
    double = solve(system, 0.3, "exact", many.t, 0.0, None)
    assert many.horizon == 0.3
    assert many.impacts.count == double.impacts.count > 1
    assert np.max(np.abs(many.tip - double.tip)) < 1e-10
    assert np.max(np.abs(many.contact_force - double.contact_force)) < 1e-10 * 5e6  # stop stiffness times that
    other, *_ = carry(system, 0.3, 80)
    assert np.array_equal(other.sides, many.solution.sides)
    assert np.max(np.abs(other.times - many.solution.times)) < 1e-14
    assert np.max(np.abs(many.energy.loss)) < 1e-10 * np.max(many.energy.energy)


@pytest.mark.slow
def test_two_contacts_with_a_moving_stop_past_the_float64_horizon():
    from systems import two_contacts

    system = two_contacts()
    many, double = sb.reference(system, 50.0, "multiprecision"), sb.reference(system, 50.0)
    assert many.horizon == 50.0
    assert 20.0 < double.horizon < 40.0
    inside, scale = many.t <= double.horizon, np.max(np.abs(many.tip))
    assert np.max(np.abs(many.tip - double.tip)[inside]) < 1e-3 * scale
    assert np.max(np.abs(many.tip - double.tip)[~inside]) > 0.1 * scale
    assert all(record.impacts.count > 50 for record in many.contacts)
    other, *_ = carry(system, 50.0, 120)
    assert np.array_equal(other.sides, many.solution.sides)
    assert np.max(np.abs(other.times - many.solution.times)) < 1e-13
    # The moving stop's work is in the ledger.
    assert np.max(np.abs(many.energy.loss)) < 1e-10 * np.max(many.energy.energy)


@pytest.mark.parametrize(
    ("stiffness", "damping"),
    [
        (np.diag([4.0, 4.0, 4.0]), None),
        (np.diag([4.0, 4.0, 4.0]), 0.1 * np.eye(3)),
        (np.diag([4.0, 4.0 * (1 + 1e-15), 4.0]) + 1e-15, None),
        (np.diag([4.0, 4.0 * (1 + 1e-15), 4.0]) + 1e-15, 0.1 * np.eye(3)),
        (np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]]), None),
        (np.zeros((1, 1)), None),
    ],
    ids=["equal", "equal damped", "nearly equal", "nearly equal damped", "rigid-body mode", "free mass"],
)
@pytest.mark.fast(1)
def test_frequencies_that_coincide_or_vanish(stiffness, damping):
    n = len(stiffness)
    system = sb.System.from_matrices(
        np.eye(n), stiffness, damping,
        loads=[(np.ones(n), sb.Harmonic(1.0, 1.7))],
        contacts=[sb.Contact(np.eye(n)[0], sb.Stops(-0.5, 0.3, stiffness=50.0))],
        initial_velocity=np.arange(1.0, n + 1.0),
    )  # fmt: skip
    many = sb.reference(system, 20.0, "multiprecision")
    double = sb.reference(system, 20.0)
    assert many.horizon == double.horizon == 20.0
    assert many.impacts.count == double.impacts.count > 5
    assert np.max(np.abs(many.tip - double.tip)) < 1e-11


def test_what_it_cannot_take_is_refused(table10):
    pushed = dataclasses.replace(table10, loads=(sb.PointLoad(0.5, lambda t: 0 * t),))
    with pytest.raises(sb.InputError, match="Harmonic, Constant and Sampled"):
        sb.reference(sb.semidiscretise(pushed, 6), 0.1, "multiprecision")
    with pytest.raises(sb.InputError, match="digits"):
        sb.reference(sb.semidiscretise(table10, 6), 0.1, "multiprecision", digits=5)
