"""Orders and lags measured from runs: those put into them are found."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.measures.amplification import free_mode_errors
from stiffbeam.measures.errors import observed_order
from stiffbeam.model.modes import modes
from stiffbeam.trajectory.trajectory import Trajectory, Work

PLAIN = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(-0.1, 0.1, stiffness=5e4), base=sb.Harmonic(0.2, 10.0))


def test_an_observed_order_has_its_slope_constant_and_interval():
    steps = 0.1 / 2.0 ** np.arange(6)
    for slope in (0.5, 2.0, 3.0):
        order = observed_order(steps, 7.0 * steps**slope)
        assert (order.slope, order.constant) == (pytest.approx(slope, abs=1e-12), pytest.approx(7.0, rel=1e-11))
        assert order.interval < 1e-10
        assert order.points == 6
    for few in ([], [0.1], [0.1, 0.1]):
        assert np.isnan(observed_order(few, np.ones(len(few))).slope)
    two = observed_order([0.1, 0.05], [4.0, 1.0])
    assert np.isnan(two.interval)
    assert str(two) == "2.00 (two points)"
    rng, inside = np.random.default_rng(7), 0
    for _ in range(400):  # trials at 95 %: the share has the standard deviation 1.1 %, three of them are allowed
        order = observed_order(steps, 3.0 * steps**2 * np.exp(rng.normal(0.0, 0.3, len(steps))))
        inside += abs(order.slope - 2.0) <= order.interval
    assert abs(inside / 400 - 0.95) < 0.033


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_a_lag_and_a_decay_put_into_a_run_are_found_within_the_stated_error(noise, damping):
    """Mode j turns by late_j too slowly and decays decay_j too fast, with a ripple upon it."""
    stiffness = np.array([[500.0, -200.0], [-200.0, 300.0]])
    system = sb.System.from_matrices(np.diag([1.0, 2.0]), stiffness, damping=damping * stiffness, observe=[0.0, 1.0])
    basis, t = modes(system), np.arange(0.0, 4.0, 0.005)
    late, decay, own = np.array([0.11, -0.3]), np.array([0.02, 0.3]), 0.5 * basis.damping
    turning = np.sqrt(basis.omega**2 - own**2)
    z = np.exp(np.outer(t, -(own + decay) + 1j * (turning - late)))
    z = z * (1.0 + noise * np.cos(37.0 * t)[:, None]) * (1.0 + noise * 1j * np.sin(41.0 * t)[:, None])
    c = z.imag / turning  # z = c' - conj(lambda) c with lambda = -own + i turning
    q, v = (x @ basis.shapes.T for x in (c, z.real - own * c))
    found = free_mode_errors(Trajectory(
        t=t, tip=q[:, -1], tip_velocity=v[:, -1], contacts=(), work=Work(), provenance={"dt": 0.005}, system=system,
        pieces=lambda: iter([(t, q, v, np.zeros((len(t), 0)))]),
    ))  # fmt: skip
    elongation = turning / (turning - late) - 1.0
    ratio = (own + decay) / np.hypot(own + decay, turning - late)
    np.testing.assert_allclose(found.period_elongation, elongation, rtol=1e-9 if noise == 0.0 else 0.1)
    np.testing.assert_allclose(found.damping_ratio, ratio, rtol=1e-9 if noise == 0.0 else 0.1)
    with pytest.raises(sb.InputError, match="free"):
        free_mode_errors(sb.integrate(sb.semidiscretise(PLAIN, 6), sb.HHT(), 1e-3, 0.1))
