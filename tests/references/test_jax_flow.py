"""The exact solution as a JAX function: value, derivative in every direction, transformations, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from systems import beam_of, one_mass

import stiffbeam as sb

jax = pytest.importorskip("jax")
PATHS = ["stops.stiffness", "stops.upper", "base.amplitude"]
TIMES = np.linspace(0.0, 0.05, 26)
pytestmark = pytest.mark.usefixtures("jax_in_float64")


@pytest.fixture(scope="module")
def beam() -> sb.System:
    return beam_of("displacement")


@pytest.mark.slow
def test_value_and_derivative_are_those_of_the_reference(beam):
    flow = sb.jax_flow(beam, PATHS, TIMES)
    run = sb.reference(beam, TIMES[-1], t_eval=TIMES)
    assert np.array_equal(flow(flow.start), run.tip)
    exact = run.derivative(PATHS).tip
    assert np.allclose(jax.jacfwd(flow)(flow.start), exact, rtol=1e-12, atol=0.0)
    assert np.allclose(jax.jacrev(flow)(flow.start), exact, rtol=1e-12, atol=0.0)


def test_values_move_with_the_parameters_and_map_over_batches(beam):
    flow = sb.jax_flow(beam, PATHS, TIMES)
    batch = flow.start * np.array([[1.0], [1.01]])
    values = jax.vmap(flow)(batch)
    moved = sb.varied_members(beam, dict(zip(PATHS, batch[1:].T, strict=True)))[0]
    run = sb.reference(moved, TIMES[-1], t_eval=TIMES)
    assert np.array_equal(values[1], run.tip)
    assert not np.array_equal(values[0], values[1])
    assert np.array_equal(sb.jax_flow(beam, PATHS, TIMES, "tip_velocity")(batch[1]), run.tip_velocity)


@pytest.mark.slow
def test_past_the_end_of_a_chatter_the_derivative_is_not_a_number():
    stops = sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.5)
    ball = one_mass(0.0, stops, load=sb.Constant(-2.0), q=1.0)
    flow = sb.jax_flow(ball, ["q0[0]"], [0.5, 1.5, 3.5])  # bounces end at t = 3
    slope = jax.jacfwd(flow)(flow.start)
    assert slope[0, 0] == pytest.approx(1.0, rel=1e-13)
    assert np.isfinite(slope[1, 0])
    assert np.isnan(slope[2, 0])


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"wrt": ["stops.stifness"]}, "did you mean"),
        ({"wrt": "stops.upper"}, "list"),
        ({"quantity": "tips"}, "did you mean tip"),
        ({"t": [0.1, 0.05]}, "increasing"),
        ({"t": np.linspace(0.0, 1.0, 11)}, "horizon"),
    ],
)
def test_refusals(beam, change, match):
    with pytest.raises(sb.InputError, match=match):
        sb.jax_flow(**({"system": beam, "wrt": PATHS, "t": TIMES, "quantity": "tip"} | change))


def test_single_precision_and_wrong_shapes_are_refused(beam):
    flow = sb.jax_flow(beam, PATHS, TIMES)
    with pytest.raises(sb.InputError, match="shape"):
        flow(1.0)
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(sb.InputError, match="jax_enable_x64"):
        sb.jax_flow(beam, PATHS, TIMES)
