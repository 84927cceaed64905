"""Time functions: values, rates, accelerations and shapes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpmath import mp

import stiffbeam as sb
from stiffbeam.model.time_functions import Drive, evaluate

AMPLITUDES = st.one_of(st.floats(-10.0, -1e-3), st.floats(1e-3, 10.0))  # relative tolerances need normal numbers


FREQUENCIES = st.floats(0.1, 50.0)


PHASES, TIMES = st.floats(-7.0, 7.0), st.floats(-5.0, 5.0)


def test_a_harmonic_is_its_amplitude_times_a_sine():
    f = sb.Harmonic(2.0, 3.0, np.pi / 6)
    assert abs(f.value(0.0) - 1.0) < 1e-15
    assert abs(f.rate(0.0) - 3.0 * math.sqrt(3.0)) < 1e-14
    assert abs(f.acceleration(0.0) + 9.0) < 1e-14
    crest = np.pi / 9  # 3 t + pi/6 = pi/2
    assert abs(f.value(crest) - 2.0) < 1e-15
    assert abs(f.rate(crest)) < 1e-14
    assert abs(f.acceleration(crest) + 18.0) < 1e-13


@given(AMPLITUDES, FREQUENCIES, PHASES, TIMES)
def test_a_harmonic_splits_into_its_sine_and_cosine(a, w, p, t):
    f = sb.Harmonic(a, w, p)
    split = f.sine * math.sin(w * t) + f.cosine * math.cos(w * t)
    assert abs(f.value(t) - split) <= 4e-16 * abs(a) * (4.0 + abs(w * t))  # rounding of the argument


@given(AMPLITUDES, FREQUENCIES, PHASES, TIMES)
def test_rate_and_acceleration_of_a_harmonic_are_its_derivatives(a, w, p, t):
    f = sb.Harmonic(a, w, p)
    h = 1e-4 / w
    before, after = t - h, t + h
    # Truncation (w h)^2/6 = 2e-9, rounding of the argument eps (|w t| + 7)/(w h) = 6e-10, relative.
    tolerance = 1e-8 * abs(a) * w
    assert abs((f.value(after) - f.value(before)) / (after - before) - f.rate(t)) <= tolerance
    assert abs((f.rate(after) - f.rate(before)) / (after - before) - f.acceleration(t)) <= tolerance * w


@pytest.mark.parametrize("function", [sb.Harmonic(1.0, 2.0), sb.Constant(3)], ids=str)
@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_time_functions_give_floats_of_the_shape_of_the_times(function, shape):
    t = np.linspace(0.0, 1.0, math.prod(shape)).reshape(shape) if shape else 0.5
    for values in (function.value(t), function.rate(t), function.acceleration(t)):
        assert np.shape(values) == shape
        assert np.asarray(values).dtype == float


def test_a_constant_keeps_its_level_and_has_no_derivatives():
    f, t = sb.Constant(-2.5), np.linspace(-1.0, 1.0, 4)
    assert np.all(f.value(t) == -2.5)
    assert not np.any(f.rate(t))
    assert not np.any(f.acceleration(t))


def test_a_bare_load_function_may_be_scalar_but_not_of_another_shape():
    t = np.linspace(0.0, 1.0, 3)
    assert np.array_equal(evaluate(lambda t: 2.0, t), [2.0, 2.0, 2.0])
    with pytest.raises(sb.InputError, match="one value per time"):
        evaluate(lambda t: np.zeros(2), t)


@pytest.mark.parametrize("frequencies", [(), (10.0,), (0.3, 6.0, 1e4)])
@pytest.mark.parametrize(("first", "count"), [(0, 1), (7, 33), (10**7, 1000)])
def test_sines_at_steps_are_those_of_many_digits(frequencies, first, count):
    """Within eps (w t + 4) of sin and cos of the step's time, first + k times the double dt."""
    dt, drive = 1.1e-4, Drive(frequencies)
    g = drive.at_steps(first, count, dt)
    assert g.shape == (count, drive.size)
    assert np.all(g[:, 0] == 1.0)
    with mp.workdps(40):
        for k in {0, 1, count // 2, count - 1} & set(range(count)):
            for i, w in enumerate(frequencies):
                phase = w * mp.mpf(dt) * (first + k)
                bound = np.finfo(float).eps * (float(phase) + 4.0)
                assert abs(g[k, 1 + 2 * i] - mp.sin(phase)) < bound
                assert abs(g[k, 2 + 2 * i] - mp.cos(phase)) < bound
