"""The validation of beam problems, point loads and initial data."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb


@pytest.mark.parametrize("profile", [lambda x: 0.1 + 0.0 * x, lambda x: 0.1 + x**2, lambda x: 0.1 - 3 * x**2 + x**3])
def test_initial_displacements_that_meet_the_clamp_are_accepted(profile):
    problem = sb.BeamProblem(stiffness=1.0, base=sb.Constant(0.1), initial_displacement=profile)
    x = np.array([0.25, 0.5, 0.75, 1.0])
    expected = profile(x) - 0.1 * (1.0 - x**2)  # v = u - phi (1 - x^2)
    assert np.max(np.abs(sb.semidiscretise(problem, 4).q0 - expected)) < 1e-15 * 4


@pytest.mark.parametrize("position", [0.03, 0.23, 0.5, 0.7, 0.999, 1.0])
@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
def test_a_point_load_keeps_its_moment_about_the_clamp_between_nodes(position, form):
    problem = sb.BeamProblem(stiffness=1.0, loads=[sb.PointLoad(position, sb.Constant(7.0))])
    assert isinstance(problem.loads, tuple)
    load = sb.semidiscretise(problem, 25, form).load(0.0)
    x = np.arange(1, 26) / 25
    assert abs(load @ x - 7.0 * position) < 7.0 * 1e-14
    assert np.count_nonzero(load) <= 2
