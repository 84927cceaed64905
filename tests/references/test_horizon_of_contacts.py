"""The horizon holds for every contact, not for the tip alone: a fast contact beside a tip that hardly moves.

Witness: the solution in as many digits as it takes. The longest natural
period is 62 000 time units, of which a thousandth is no tolerance for impacts that follow each other every second.
"""

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references.horizon import agreement, apart


def slow_and_fast(observed, stiffness=3e4):
    stops = [sb.Stops(upper=upper, stiffness=stiffness) for upper in (5.0, -0.05)]
    contacts = [sb.Contact(row, stop) for row, stop in zip(np.eye(2), stops, strict=True)]
    load = [([0.0, 1.0], sb.Harmonic(amplitude=1.0, frequency=5.2, phase=1.0))]
    start = {"observe": np.eye(2)[observed], "initial_displacement": [1.0, -0.3]}
    return sb.System.from_matrices(np.eye(2), np.diag([1e-8, 1.0]), None, load, contacts, **start)


@pytest.mark.slow
def test_a_fast_contact_beside_a_slow_tip():
    """For rigid stops ``test_frozen_motions.py`` has every contact up to the horizon."""
    slow, fast = (sb.reference(slow_and_fast(i), 300.0) for i in (0, 1))
    assert slow.horizon == fast.horizon < 250.0
    many = sb.reference(slow_and_fast(0), 300.0, "multiprecision", t_eval=slow.t).contacts[1]
    position, times = many.position, many.impacts.times
    inside = slow.t <= slow.horizon
    mine = slow.contacts[1]
    off = np.abs(mine.position - position)
    assert np.max(off[inside]) < 1e-3 * mine.scale
    assert np.max(off) > 0.5 * mine.scale  # what was certified before
    before = [x[x < slow.horizon - 0.1] for x in (mine.impacts.times, times)]
    assert np.allclose(*before, rtol=0.0, atol=apart(len(times), 300.0))


def test_a_contact_that_stands_still_does_not_end_it():
    """Its position is rounding, beside a gap that it does not come near, or a stop that it rests on to rounding."""
    contacts = [sb.Contact([1.0, -1.0], sb.Stops(lower=-0.1, upper=0.1, stiffness=100.0))]
    load = [([1.0, 1.0], sb.Harmonic(amplitude=1.0, frequency=1.3))]
    system = sb.System.from_matrices(np.eye(2), [[2.0, -1.0], [-1.0, 2.0]], None, load, contacts, observe=[1.0, 0.0])
    assert sb.reference(system, 50.0).horizon == 50.0
    resting = sb.Contact([0.0, 1.0], sb.Stops(upper=0.0, stiffness=np.inf, restitution=0.5))
    push = [([1.0, 0.0], sb.Harmonic(amplitude=1.0, frequency=1.3)), ([0.0, 1.0], sb.Constant(5.0))]
    system = sb.System.from_matrices(np.eye(2), np.eye(2), None, push, [resting], observe=[1.0, 0.0])
    pressed = one_mass(1.0, sb.Stops(upper=0.3, stiffness=np.inf, restitution=1.0), load=sb.Constant(5.0), q=0.7 - 0.4)
    assert sb.reference(system, 50.0).horizon == sb.reference(pressed, 50.0).horizon == 50.0


def test_impacts_agree_by_their_own_distances():
    """A missing impact is seen however long the tolerance is that the slowest motion gives."""
    run = sb.reference(slow_and_fast(1), 30.0)
    assert agreement(run, run, 60.0) == 30.0
    other = sb.reference(slow_and_fast(1, 2.9e4), 30.0)
    assert agreement(run, other, 60.0) < 30.0


def test_a_diverged_run_does_not_widen_the_tolerance():
    """The run's error is 1.3e-3 of the motion from t = 10 on; it diverges after t = 20, to twice the motion."""
    t = np.linspace(0.0, 30.0, 301)
    motion = np.sin(t)
    run = sb.Trajectory.from_arrays(t, motion * np.where(t > 20.0, 2.0, np.where(t > 10.0, 1.0013, 1.0)))
    true = sb.Trajectory.from_arrays(t, motion)
    assert 10.0 <= agreement(run, true, 60.0) == agreement(true, run, 60.0) < 12.0


@pytest.mark.parametrize("method", ["exact", "cvode"])
def test_a_point_that_the_motion_has_not_reached_ends_no_horizon(method):
    """A load in the middle of a long chain: to t = 1/2 its ends move by rounding, as does the contact there."""
    n = 300
    K = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    load = (np.eye(n)[n // 2], sb.Harmonic(1.0, 1.0, np.pi / 2.0))
    contact = sb.Contact(np.eye(n)[-1], sb.Stops(upper=0.1, stiffness=100.0))
    system = sb.System.from_matrices(np.eye(n), K, loads=[load], contacts=[contact])
    run = sb.reference(system, 0.5, method, t_eval=np.linspace(0.0, 0.5, 51))
    assert run.horizon == 0.5
    assert abs(run.tip[-1]) < 1e-12


@pytest.mark.parametrize("method", ["exact", "cvode"])
def test_no_choice_of_outputs_moves_a_horizon(method):
    """Of a Poincare section without its transient, and of start and end: the motion was lost long before the end."""
    system = one_mass(1.0, sb.Stops(lower=-0.5, upper=0.5, stiffness=400.0), damping=0.05, load=sb.Harmonic(1.0, 0.55))
    period = 2.0 * np.pi / 0.55
    whole = sb.reference(system, 40 * period, method).horizon
    assert 8 * period < whole < 25 * period
    for t in (np.arange(1, 41) * period, np.arange(39, 41) * period, np.array([0.0, 40 * period])):
        few = sb.reference(system, 40 * period, method, t_eval=t)
        assert abs(few.horizon - whole) < 0.05 * period
        assert np.array_equal(few.t, t)
        assert len(few.contacts[0].force) == len(few.energy.t) == len(few.states[0]) == len(t)
