"""The beam without stops in closed form: frequencies, modes, the driven tip, the steady motion of its grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles import beam_roots

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.measures.errors import observed_order
from stiffbeam.measures.frequencies import steady_state
from stiffbeam.model import beam
from stiffbeam.model.time_functions import Drive


def test_the_roots_solve_the_frequency_equation():
    found = beam.roots(12)
    assert np.allclose(found[:3], [1.875104068711961, 4.694091132974175, 7.854757438237613], rtol=1e-15)
    assert np.all(np.diff(found) > 2.5)
    assert np.max(np.abs(np.cos(found) + 1.0 / np.cosh(found))) < 1e-14
    assert np.allclose(found, beam_roots(12), rtol=1e-14)


def tip_ratio(problem: sb.BeamProblem, cells: int) -> complex:
    """(-a^2 M + i a C + K) q = p by a dense solve, the load's complex amplitude p from its two phases."""
    system = sb.semidiscretise(problem, cells)
    a = problem.base.frequency
    # load(t) = Im(p e^{i a t}): p = load(quarter period) + i load(0)
    p = system.load(0.5 * np.pi / a) + 1j * system.load(0.0)
    q = np.linalg.solve(-(a**2) * system.mass + 1j * a * system.damping + system.stiffness, p)
    row, _ = system.channels[system.tip_channel]
    return complex(row @ q) / (problem.base.amplitude * np.exp(1j * problem.base.phase))


@pytest.mark.parametrize("viscosity", [0.0, 2.0])
@pytest.mark.parametrize("frequency", [10.0, 100.0])
def test_the_driven_tip_is_what_a_fine_grid_approaches(viscosity, frequency):
    base = sb.Harmonic(amplitude=0.2, frequency=frequency, phase=0.4)
    problem = sb.BeamProblem(stiffness=300.0, viscosity=viscosity, base=base)
    exact = beam.tip_response(problem)
    cells = np.array([40, 57, 80])
    errors = [abs(tip_ratio(problem, int(n)) - exact) for n in cells]
    assert errors[-1] < 3e-3 * abs(exact)
    assert abs(observed_order(1.0 / cells, errors).slope - 2.0) < 0.1


def test_a_slow_clamp_carries_the_tip_along():
    slow = sb.BeamProblem(stiffness=300.0, base=sb.Harmonic(amplitude=0.2, frequency=1e-3))
    # ratio = 1 + O(a^2/k^2)
    assert abs(beam.tip_response(slow) - 1.0) < 1e-3**2 / 300.0
    with pytest.raises(InputError, match="harmonic base"):
        beam.tip_response(replace(slow, base=None))
    load = sb.PointLoad(position=0.5, time=sb.Constant(1.0))
    with pytest.raises(InputError, match="no loads"):
        beam.tip_response(replace(slow, loads=(load,)))


@pytest.mark.parametrize("viscosity", [0.0, 0.05])
def test_the_steady_motion_solves_the_equation_of_motion(viscosity):
    loads = (sb.PointLoad(0.5, sb.Harmonic(3.0, 40.0, 0.3)), sb.DistributedLoad(lambda x: 1.0 + x, sb.Constant(2.0)))
    problem = sb.BeamProblem(stiffness=300.0, viscosity=viscosity, base=sb.Harmonic(0.2, 10.0), loads=loads)
    system = sb.semidiscretise(problem, 8)
    y, start = steady_state(system)
    drive = Drive.of(system)
    assert np.array_equal(start, drive.coefficients(0.0))
    rate = drive.derivative()
    for t in (0.0, 0.37, 2.0):
        g = drive.coefficients(t)
        q, v, a = (x @ y for x in (g, rate @ g, rate @ rate @ g))
        residual = system.mass @ a + system.damping @ v + system.stiffness @ q - system.load(t)
        assert np.max(np.abs(residual)) < 1e-10 * np.max(np.abs(system.load(t)))
