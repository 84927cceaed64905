"""Observed orders by regression: exact power laws, the interval, and points that are too few."""

from __future__ import annotations

import numpy as np
import pytest

from stiffbeam.measures.errors import observed_order


@pytest.mark.parametrize("slope", [0.5, 2.0, 3.0])
def test_an_exact_power_law_gives_its_slope_and_constant(slope):
    steps = 0.1 / 2.0 ** np.arange(6)
    order = observed_order(steps, 7.0 * steps**slope)
    assert order.slope == pytest.approx(slope, abs=1e-12)
    assert order.constant == pytest.approx(7.0, rel=1e-11)
    assert order.interval < 1e-10
    assert order.points == 6


@pytest.mark.slow
def test_the_interval_covers_the_slope_as_often_as_it_says():
    """2000 trials at 95 %: the share has the standard deviation 0.5 %, three of them are allowed."""
    rng = np.random.default_rng(7)
    steps = 0.1 / 2.0 ** np.arange(7)
    inside = 0
    for _ in range(2000):
        order = observed_order(steps, 3.0 * steps**2 * np.exp(rng.normal(0.0, 0.3, len(steps))))
        inside += abs(order.slope - 2.0) <= order.interval
    assert abs(inside / 2000 - 0.95) < 0.015


def test_too_few_points_have_no_slope_or_no_interval():
    assert np.isnan(observed_order([], []).slope)
    assert np.isnan(observed_order([0.1], [1.0]).slope)
    two = observed_order([0.1, 0.05], [4.0, 1.0])
    assert two.slope == pytest.approx(2.0)
    assert np.isnan(two.interval)
    assert str(two) == "2.00 (two points)"


def test_one_step_tried_twice_has_no_order():
    assert np.isnan(observed_order([0.1, 0.1], [1e-3, 1e-3]).slope)
