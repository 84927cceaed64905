"""Rigid stops: random systems and records against frozen solutions in many digits, and impacts at known times."""

from __future__ import annotations

import numpy as np
import pytest
import rigid_solutions
import rigid_witness

import stiffbeam as sb

INF = float("inf")


def agrees(system, name):
    """Float64 within its rounding of many digits."""
    known = rigid_solutions.known(name)
    run = sb.reference(system, known.t_end, t_eval=np.linspace(0.0, known.t_end, 41))
    assert run.horizon == known.horizon == known.t_end
    assert np.max(np.abs(run.tip - known.tip)) < 1e-12 * np.max(np.abs(known.tip))  # at most 2e-14 in the first 62
    for mine, other in zip(run.contacts, known.contacts, strict=True):
        assert mine.impacts.times == pytest.approx(other.times, abs=1e-12)
        assert np.array_equal(mine.impacts.stops, other.stops)
        assert mine.impacts.ends == pytest.approx(other.ends, abs=1e-12, nan_ok=True)
        assert mine.impacts.impulses == pytest.approx(other.impulses, rel=1e-8, abs=1e-12, nan_ok=True)
        assert mine.fraction == pytest.approx(other.fraction, abs=1e-6)  # that the end of chatter takes
        assert mine.impulse == pytest.approx(other.impulse, rel=1e-12, abs=1e-12)
    assert np.max(np.abs(run.energy.loss)) < 1e-12 * (1.0 + np.max(run.energy.energy))
    return run


@pytest.mark.parametrize(
    "seed", [seed if seed < 12 else pytest.param(seed, marks=pytest.mark.slow) for seed in rigid_solutions.RANDOM]
)
def test_random_systems(seed):
    """Of one to three unknowns, damped, pressed, with moving stops."""
    system = rigid_witness.random_system(seed)
    run = agrees(system, f"random {seed}")
    gave = rigid_witness.signed_impulses(system, run, 3.0)
    for contact, each in zip(gave, run.contacts, strict=True):
        if len(set(each.impacts.stops)) < 2:  # else it was pushed both ways
            assert each.impulse == pytest.approx(abs(contact), rel=1e-10, abs=1e-10)  # by quadrature across releases


@pytest.mark.parametrize("kind", ["linear", "cubic"])
def test_sampled_loads_and_a_sampled_stop(kind):
    t = np.linspace(0.0, 2.0, 26)
    load = ([1.0, 0.0], sb.Sampled(t, 20.0 * np.sin(5.0 * t), kind=kind))
    moving = sb.Contact([0.0, 1.0], sb.Stops(upper=0.2, stiffness=INF, restitution=0.3), sb.Sampled(t, t**2, "cubic"))
    contacts = [sb.Contact([1.0, 0.0], sb.Stops(-0.1, 0.1, stiffness=INF, restitution=0.6)), moving]
    run = agrees(
        sb.System.from_matrices(np.eye(2), [[5.0, -2.0], [-2.0, 4.0]], None, [load], contacts), f"samples, {kind}"
    )
    assert run.contacts[1].fraction > 0.1


def test_the_impact_oscillator_repeats_itself():
    """x'' + x = A cos(2 t + pi/2), x <= 0, e = 1/2: V = 8 A/3 at every impact, one each period."""
    contact = sb.Contact([1.0], sb.Stops(upper=0.0, stiffness=INF, restitution=0.5))
    load = ([1.0], sb.Harmonic(0.375, 2.0, "pi"))
    system = sb.System.from_matrices([[1.0]], [[1.0]], loads=[load], contacts=[contact], initial_velocity=[-0.5])
    run = sb.reference(system, 13.0)
    assert run.impacts.times == pytest.approx(np.pi * np.arange(1, 5), rel=1e-13)
    assert run.impacts.impulses == pytest.approx([1.5] * 4, rel=1e-12)


def test_a_flat_bar_on_two_stops_stays_flat():
    """Impacts at one time are one problem: with inertia between them, one after the other would turn the bar."""
    stops = sb.Stops(lower=0.0, stiffness=INF, restitution=0.5)
    bar = sb.System.from_matrices(
        np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0, np.zeros((2, 2)), loads=[([-4.0, -4.0], sb.Constant(1.0))],
        contacts=[sb.Contact(x, stops) for x in np.eye(2)], initial_displacement=[1.0, 1.0],
    )  # fmt: skip
    run = sb.reference(bar, 2.0)
    one, other = (contact.impacts for contact in run.contacts)
    assert one.times[:20] == pytest.approx(other.times[:20], abs=1e-14)
    assert np.nanmax(one.times) == pytest.approx(1.5, abs=1e-6)  # at rest from then on; t_1 = 1/2
    assert run.contacts[0].fraction == pytest.approx(0.25, abs=1e-6)
