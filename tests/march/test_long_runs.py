"""Long runs: what rounding leaves of energy, phase and impact times."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb

EPS = np.finfo(float).eps

pytestmark = pytest.mark.slow


def test_the_trapezoidal_rule_keeps_its_energy_without_contact_over_1e7_steps():
    """Each step rounds the energy by less than a bit, and all of them may go one way."""
    start = sb.PolynomialProfile((0.0, 0.0, 1.0))
    beam = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, initial_velocity=start), 8)
    run = sb.integrate(beam, sb.Trapezoidal(), 1e-3, 1e4, every=10**5)
    energy = run.energy.energy
    assert np.max(np.abs(energy / energy[0] - 1.0)) < EPS * 1e7


@pytest.mark.parametrize("method", ["trapezoidal", "exact"])
def test_the_phase_of_the_drive_is_right_at_a_million(method):
    """q'' + 0.4 q' + 25 q = 3 sin(4 t + 0.3) has settled to Im 3 e^(i (4 t + 0.3))/(25 - W^2 + 0.4 i W), W = 4, and for
    the trapezoidal rule W = (2/dt) tan(4 dt/2). A time in float64 has a phase known to eps 4 t/2."""
    dt, end = 1e-2, 1e6
    system = one_mass(25.0, damping=0.4, load=sb.Harmonic(3.0, 4.0, 0.3))
    t = np.linspace(0.0, end, 101)
    with mpmath.workdps(40):
        if method == "exact":
            tip, W = sb.reference(system, end, t_eval=t).tip, mpmath.mpf(4)
        else:
            tip, W = sb.integrate(system, sb.Trapezoidal(), dt, end, every=10**6).tip, 2 / dt * mpmath.tan(2 * dt)
        gain = 3 / (25 - W**2 + 0.4j * W)
        steady = [float((gain * mpmath.expj(4 * mpmath.mpf(float(when)) + mpmath.mpf(0.3))).imag) for when in t[1:]]
    assert np.max(np.abs(tip[1:] - steady)) < float(abs(gain)) * EPS * 0.5 * 4.0 * end


def test_1e5_events_of_the_exact_solution_close_their_ledger_and_say_what_is_lost():
    """u = 2 sin t to the stop at 1/2, there 0.495 + A cos(10 s - phi): impacts every 2 (asin(1/4) + phi/10)."""
    system = one_mass(1.0, sb.Stops(-0.5, 0.5, stiffness=99.0), v=2.0)
    end = 41000.0
    found = sb.reference(system, end)
    assert len(found.solution.times) > 100_000
    with mpmath.workdps(40):
        flight = mpmath.asin(mpmath.mpf(1) / 4)
        half = 2 * (flight + mpmath.atan2(mpmath.sqrt(mpmath.mpf(15) / 4) / 10, mpmath.mpf("0.005")) / 10)
        wanted = np.array([float(flight + i * half) for i in range(found.impacts.count)])
    error = np.abs(found.impacts.times - wanted)
    lost = 10.0 ** sb.lyapunov(system, end).digits
    assert 1e4 < lost < 1e7  # what a neighbour is magnified by: the frequency depends on the energy
    assert np.max(error) < EPS * lost * len(found.solution.times)  # a rounding at each switch, all of them one way
    assert found.horizon == end
    assert len(found.impacts.times) == math.floor((end - float(flight)) / float(half)) + 1
    ledger = found.energy
    assert np.max(np.abs(ledger.energy - 2.0)) < 100 * EPS * 2.0
    assert np.max(np.abs(ledger.loss)) < 100 * EPS * 2.0
