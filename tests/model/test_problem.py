"""The validation of beam problems, point loads and initial data."""

from __future__ import annotations

import math

import numpy as np
import pytest

import stiffbeam as sb

REST = {"stiffness": 300.0}


@pytest.mark.parametrize(
    ("fields", "field", "rule"),
    [
        ({"stiffness": 0.0}, "stiffness", "be > 0"),
        ({"stiffness": -1.0}, "stiffness", "be > 0"),
        ({"stiffness": math.nan}, "stiffness", "be finite"),
        ({"stiffness": math.inf}, "stiffness", "be finite"),
        ({"stiffness": "three"}, "stiffness", "be a number in the range of float64"),
        ({"stiffness": True}, "stiffness", "be a number"),
        ({**REST, "viscosity": -1e-9}, "viscosity", "be >= 0"),
        ({**REST, "viscosity": None}, "viscosity", "be a number"),
        ({**REST, "stops": (-0.1, 0.1)}, "stops", "be a Stops or a list of them"),
        ({**REST, "base": np.sin}, "base", "have value, rate and acceleration"),
        ({**REST, "base": 0.2}, "base", "have value, rate and acceleration"),
        ({**REST, "loads": (sb.Constant(1.0),)}, "loads", "hold PointLoad and DistributedLoad only"),
    ],
)
def test_each_rule_of_a_problem_names_field_value_and_rule(fields, field, rule):
    with pytest.raises(sb.InputError) as caught:
        sb.BeamProblem(**fields)
    value = fields[field] if field != "loads" else fields["loads"][0]
    assert caught.value.field == field
    assert caught.value.value is value
    assert str(caught.value).startswith(f"{field} must {rule}, got {value!r}")


def test_an_input_error_is_a_value_error():
    with pytest.raises(ValueError, match="stiffness must be > 0, got 0"):
        sb.BeamProblem(stiffness=0)


@pytest.mark.parametrize(
    ("profile", "rule"),
    [
        (lambda x: 0.2 + 0.0 * x, r"equal the base motion phi\(0\) = 0.1 at x = 0"),
        (lambda x: 0.1 + 0.5 * x, "have zero slope at the clamp x = 0"),
        (lambda x: np.where(x > 0.6, np.nan, 0.1), "return one finite value per x"),
        (lambda x: 0.1, "return one finite value per x"),
        (lambda x: np.zeros((len(x), 2)), "return one finite value per x"),
    ],
)
def test_initial_displacements_that_leave_the_clamp_are_refused(profile, rule):
    with pytest.raises(sb.InputError, match=f"^initial_displacement must {rule}, got "):
        sb.BeamProblem(stiffness=1.0, base=sb.Constant(0.1), initial_displacement=profile)


@pytest.mark.parametrize("profile", [lambda x: 0.1 + 0.0 * x, lambda x: 0.1 + x**2, lambda x: 0.1 - 3 * x**2 + x**3])
def test_initial_displacements_that_meet_the_clamp_are_accepted(profile):
    problem = sb.BeamProblem(stiffness=1.0, base=sb.Constant(0.1), initial_displacement=profile)
    x = np.array([0.25, 0.5, 0.75, 1.0])
    expected = profile(x) - 0.1 * (1.0 - x**2)  # v = u - phi (1 - x^2)
    assert np.max(np.abs(sb.semidiscretise(problem, 4).q0 - expected)) < 1e-15 * 4


@pytest.mark.parametrize("position", [0.0, -0.1, math.nan])
def test_a_point_load_refuses_a_position_that_is_on_no_beam(position):
    with pytest.raises(sb.InputError, match=r"^load\.position must be"):
        sb.PointLoad(position, sb.Constant(1.0))


def test_a_point_load_beyond_the_tip_is_refused_by_the_problem():
    load = sb.PointLoad(1.25, sb.Constant(1.0))
    with pytest.raises(sb.InputError, match=r"^load\.position must lie on the beam, 0 < position <= 1, got 1\.25"):
        sb.BeamProblem(stiffness=1.0, loads=(load,))


def test_loads_refuse_what_is_no_function():
    with pytest.raises(sb.InputError, match=r"^load\.time must be a Harmonic, a Constant or a function of time, got 3"):
        sb.PointLoad(0.5, 3.0)
    with pytest.raises(sb.InputError, match=r"^load\.shape must be a function of x, got 1\.0"):
        sb.DistributedLoad(1.0, sb.Constant(1.0))
    with pytest.raises(sb.InputError, match=r"^load\.time must"):
        sb.DistributedLoad(lambda x: x, "cos")


@pytest.mark.parametrize("position", [0.03, 0.23, 0.5, 0.7, 0.999, 1.0])
@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
def test_a_point_load_keeps_its_moment_about_the_clamp_between_nodes(position, form):
    problem = sb.BeamProblem(stiffness=1.0, loads=[sb.PointLoad(position, sb.Constant(7.0))])
    assert isinstance(problem.loads, tuple)
    load = sb.semidiscretise(problem, 25, form).load(0.0)
    x = np.arange(1, 26) / 25
    assert abs(load @ x - 7.0 * position) < 7.0 * 1e-14
    assert np.count_nonzero(load) <= 2
