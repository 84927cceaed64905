"""The solution in many digits: against float64 inside the horizon, against itself past it."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.solvers import solve
from stiffbeam.solvers.multiprecision import _march

pytest.importorskip("flint")


def test_inside_the_horizon_it_is_the_float64_solution(table10_system):
    times = np.linspace(0.0, 0.1, 401)
    many = sb.reference(table10_system, 0.1, "multiprecision", t_eval=times, digits=50)
    double = solve(table10_system, 0.1, "exact", times, 0.0, None)
    assert many.horizon == 0.1
    assert np.max(np.abs(many.tip - double.tip)) < 1e-12
    assert np.allclose(many.impacts.times, double.impacts.times, rtol=0, atol=1e-12)
    assert np.max(np.abs(many.states[0] - double.states[0])) < 1e-12


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
    other = _march(system, 1.0, 150)
    assert np.array_equal(other.regime, many.solution.regime)
    assert np.max(np.abs(other.times - many.solution.times)) < 1e-14
    # The energy ledger closes as it does in float64: the pieces are one solution.
    assert np.max(np.abs(many.energy.loss)) < 1e-10 * np.max(np.abs(many.energy.input))


def test_too_few_digits_show_as_a_horizon(table10):
    system = sb.semidiscretise(table10, 25)
    few = sb.reference(system, 2.0, "multiprecision", digits=25)
    assert few.provenance["digits_confirmed_with"] == 25
    assert 0.3 < few.horizon < 2.0


@pytest.mark.parametrize("seed", [1, 2])
def test_matrices_of_ones_own_with_a_moving_stop(seed):
    from test_solvers import bouncing_chain

    system = bouncing_chain()
    many = sb.reference(system, 6.0, "multiprecision", digits=40 + seed)
    double = solve(system, 6.0, "exact", many.t, 0.0, None)
    assert many.impacts.count == double.impacts.count > 5
    assert np.max(np.abs(many.tip - double.tip)) < 1e-9


def test_one_stop_contact_at_the_start_and_no_contact_at_all():
    pressed = sb.System.from_matrices(
        [[1.0]],
        [[1.0]],
        contacts=[sb.Contact([1.0], sb.Stops(-0.5, None, stiffness=99.0))],
        initial_displacement=[-0.6],
    )
    free = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, loads=(sb.PointLoad(0.3, sb.Harmonic(2.0, 7.0)),)), 6)
    for system, t_end in ((pressed, 9.0), (free, 0.5)):
        many = sb.reference(system, t_end, "multiprecision")
        double = solve(system, t_end, "exact", many.t, 0.0, None)
        assert many.horizon == t_end
        assert many.impacts.count == double.impacts.count
        assert np.max(np.abs(many.tip - double.tip)) < 1e-11


def test_what_it_cannot_take_is_refused(table10):
    import dataclasses

    with pytest.raises(sb.InputError, match="undamped"):
        sb.reference(sb.semidiscretise(dataclasses.replace(table10, viscosity=1.0), 6), 0.1, "multiprecision")
    with pytest.raises(sb.InputError, match="digits"):
        sb.reference(sb.semidiscretise(table10, 6), 0.1, "multiprecision", digits=5)


def test_digits_that_cannot_be_reached_end_with_a_clear_error(table10, monkeypatch):
    from stiffbeam.solvers import multiprecision

    monkeypatch.setattr(multiprecision, "MAX_DIGITS", 60)
    with pytest.raises(sb.SolverFailure, match="digits are not enough"):
        sb.reference(sb.semidiscretise(table10, 25), 2.0, "multiprecision")
