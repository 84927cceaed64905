"""The compiled kernel against the same in plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from systems import two_contacts
from test_march import SCHEMES

import stiffbeam as sb

CHAOS = 0.05  # time in which rounding grows less than a hundredfold on Table 10 with its first impacts


@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.parametrize("contact", ["implicit", "extrapolated"])
@pytest.mark.parametrize("viscosity", [0.0, 0.05])
@pytest.mark.fast(37)
def test_both_kernels_are_one_march(scheme, contact, viscosity, table10, in_numpy):
    problem = sb.BeamProblem(stiffness=300.0, viscosity=viscosity, stops=sb.Stops(-0.06, 0.05, stiffness=5e6),
                             base=table10.base)  # fmt: skip
    system = sb.semidiscretise(problem, 16)
    run = sb.integrate(system, scheme, 1e-4, CHAOS, contact, every=3)
    assert run.impacts.count > 0
    with in_numpy():
        assert_equal(
            run, sb.integrate(system, scheme, 1e-4, CHAOS, contact, every=3), 1e-11 if contact == "implicit" else 1e-8
        )


def assert_equal(a, b, tolerance):
    scale, speed = np.max(np.abs(a.tip)), np.max(np.abs(a.tip_velocity))
    assert np.max(np.abs(a.tip - b.tip)) < tolerance * scale
    assert np.max(np.abs(a.tip_velocity - b.tip_velocity)) < 1e3 * tolerance * speed
    assert np.max(np.abs(a.states[0] - b.states[0])) < tolerance * scale
    for x, y in zip(a.contacts, b.contacts, strict=True):
        assert list(x.impacts.stops) == list(y.impacts.stops)
        assert np.max(np.abs(x.impacts.times - y.impacts.times), initial=0.0) < 1e3 * tolerance
        for name in ("peaks", "impulses"):
            assert np.allclose(getattr(x.impacts, name), getattr(y.impacts, name), rtol=1e5 * tolerance, equal_nan=True)
        assert x.fraction == y.fraction
        assert np.isclose(x.peak_force, y.peak_force, rtol=1e5 * tolerance)
        assert np.isclose(x.impulse, y.impulse, rtol=1e5 * tolerance)


@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.1), sb.SDIRK()], ids=str)
def test_both_kernels_agree_on_two_contacts_moving_stops_and_sampled_loads(scheme, in_numpy):
    system = two_contacts(load=lambda t: 15.0 * np.sin(4.0 * t))
    run = sb.integrate(system, scheme, 2e-3, 3.0)
    assert all(contact.impacts.count > 0 for contact in run.contacts)
    with in_numpy():
        assert_equal(run, sb.integrate(system, scheme, 2e-3, 3.0), 1e-10)


def test_stretches_leave_no_trace(table10, monkeypatch, kernel):
    """Impacts that are open between two stretches go on, a list of impacts that is too short is lengthened."""
    from stiffbeam.march import block_march

    system = sb.semidiscretise(table10, 12)
    whole = sb.integrate(system, sb.HHT(-0.1), 1e-4, 0.2)
    monkeypatch.setattr(block_march, "STEPS_PER_CALL", 1)
    monkeypatch.setattr(block_march, "STEPS_REPLAYED", 32)
    other = sb.integrate(system, sb.HHT(-0.1), 1e-4, 0.2)
    assert whole.impacts.count > 10
    assert np.array_equal(whole.impacts.stops, other.impacts.stops)
    assert np.array_equal(whole.tip, other.tip)
    for name in ("times", "peaks", "impulses"):
        assert np.allclose(getattr(whole.impacts, name), getattr(other.impacts, name), rtol=1e-12, equal_nan=True)
    assert np.max(np.abs(whole.states[0][:, -1] - whole.tip)) < 1e-12


def test_a_diverging_run_is_named_by_both_kernels(kernel):
    case = sb.paper_case(11)
    system = sb.semidiscretise(case.problem, case.cells)
    with pytest.raises(sb.Diverged) as caught:
        sb.integrate(system, sb.BDF2(), 2.5e-4, 0.5, "extrapolated")
    assert 0.0 < caught.value.t < 0.5
