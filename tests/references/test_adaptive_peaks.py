"""Peak forces of the adaptive solvers where stops move, loads have kinks and other contacts switch.

Witnesses: the exact solution, and the forces at the solver's own outputs, which no peak may be less than.
"""

import numpy as np
import pytest

import stiffbeam as sb

SLOW = pytest.param("radau", marks=pytest.mark.slow)  # in Python throughout
METHODS = ["cvode", "cvode-adams", "ida", "dop853", SLOW, "lsoda"]
T = np.linspace(0.0, 3.0, 6001)
RECORD = sb.Sampled(np.linspace(0.0, 3.0, 7), [0.0, 1.0, -1.0, 2.0, 0.0, 1.0, 0.0])


def mass(load, *contacts, speed=0.0, stiffness=4.0):
    loads = [([1.0], load)]
    return sb.System.from_matrices([[1.0]], [[stiffness]], None, loads, contacts, initial_velocity=[speed])


def at_least_the_outputs(run):
    for contact in run.contacts:
        largest = np.max(np.abs(contact.force))
        assert largest * (1.0 - 1e-9) <= contact.peak_force <= largest * 1.01
    return run


@pytest.mark.fast(1)
@pytest.mark.parametrize("method", METHODS)
def test_a_stop_with_a_recorded_motion(method):
    """Its position at the peak is asked for then, not when the solver has gone on to another piece."""
    times = np.linspace(0.0, 3.0, 13)
    motion = sb.Sampled(times, 0.05 * np.sin(2.0 * times + 0.4), kind="cubic")
    system = mass(sb.Harmonic(1.0, 2.0), sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=100.0), motion), speed=1.0)
    run, exact = sb.reference(system, 3.0, method, t_eval=T), sb.reference(system, 3.0)
    assert run.contacts[0].peak_force == pytest.approx(exact.contacts[0].peak_force, rel=1e-6)
    assert np.allclose(run.impacts.peaks, exact.impacts.peaks, rtol=1e-6)


@pytest.mark.parametrize("law", [{"exponent": 1.5}, {"damping": 2.0}, {"dissipation": 0.3}], ids=str)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.fast(3)
def test_moving_stops_of_every_law_under_a_load_in_pieces(method, law):
    stops = sb.Stops(upper=0.1, stiffness=100.0, **law)
    system = mass(RECORD, sb.Contact([1.0], stops, sb.Harmonic(0.05, 2.0, 0.4)), speed=1.0)
    at_least_the_outputs(sb.reference(system, 3.0, method, t_eval=T))


@pytest.mark.parametrize("method", METHODS)
def test_another_contact_turns_the_force_of_a_damped_stop(method):
    """No rate of the force is zero: it jumps from above to below where the second stop is met."""
    near, far = sb.Stops(upper=0.05, stiffness=0.5, damping=0.5), sb.Stops(upper=0.15, stiffness=1e3, damping=80.0)
    system = mass(sb.Constant(4.0), sb.Contact([1.0], far), sb.Contact([1.0], near), stiffness=1.0)
    run, exact = sb.reference(system, 1.5, method, t_eval=T[:3001]), sb.reference(system, 1.5)
    assert run.contacts[1].peak_force == pytest.approx(exact.contacts[1].peak_force, rel=1e-5)
    assert exact.contacts[1].peak_force == pytest.approx(0.57125, rel=1e-4)


@pytest.mark.fast(1)
@pytest.mark.parametrize("method", METHODS)
def test_a_load_that_drops_turns_the_force_of_a_damped_stop(method):
    def drop(t):
        return np.where(np.asarray(t) < 0.2, 10.0, -5.0)

    drop.breakpoints = (0.2,)
    stop = sb.Contact([1.0], sb.Stops(upper=0.05, stiffness=10.0, damping=10.0))
    run = at_least_the_outputs(sb.reference(mass(drop, stop, stiffness=1.0), 3.0, method, t_eval=T))
    assert run.impacts.peaks[0] == pytest.approx(run.contacts[0].peak_force)


@pytest.mark.parametrize("method", METHODS)
def test_a_stop_that_halts(method):
    """It comes towards the mass and goes back: the peak of a linear law is at the kink of its motion."""
    motion = sb.Sampled([0.0, 0.3, 0.5, 3.0], [0.0, 0.5, -0.2, 0.0])
    system = mass(sb.Constant(0.0), sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=100.0), motion), speed=1.0)
    run, exact = sb.reference(system, 1.5, method, t_eval=T[:3001]), sb.reference(system, 1.5)
    assert exact.contacts[0].peak_force == pytest.approx(26.340479244, rel=1e-9)
    assert run.contacts[0].peak_force == pytest.approx(exact.contacts[0].peak_force, rel=1e-6)
