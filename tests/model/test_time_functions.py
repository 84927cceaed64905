"""Functions of time: closed forms, records as loads, base motions and stop motions."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from systems import chain, one_mass, stop

import stiffbeam as sb
from stiffbeam.model.time_functions import evaluate

AMPLITUDES = st.one_of(st.floats(-10.0, -1e-3), st.floats(1e-3, 10.0))  # relative tolerances need normal numbers
TIMES = np.array([0.0, 0.1, 0.25, 0.3, 0.7, 1.0])
VALUES = np.array([0.0, 1.0, -0.5, 0.2, 0.3, -1.0])


@given(AMPLITUDES, st.floats(0.1, 50.0), st.floats(-7.0, 7.0), st.floats(-5.0, 5.0))
def test_a_harmonic_is_its_sine_and_cosine_and_has_its_derivatives(a, w, p, t):
    f, h = sb.Harmonic(a, w, p), 1e-4 / w
    assert f.value(t) == pytest.approx(a * math.sin(w * t + p), rel=1e-15, abs=4e-16 * abs(a) * (4.0 + abs(w * t)))
    split = a * (math.cos(p) * math.sin(w * t) + math.sin(p) * math.cos(w * t))
    assert abs(f.value(t) - split) <= 4e-16 * abs(a) * (4.0 + abs(w * t))  # rounding of the argument
    # Truncation (w h)^2/6 = 2e-9, rounding of the argument eps (|w t| + 7)/(w h) = 6e-10, relative.
    before, after, tolerance = t - h, t + h, 1e-8 * abs(a) * w
    assert abs((f.value(after) - f.value(before)) / (after - before) - f.rate(t)) <= tolerance
    assert abs((f.rate(after) - f.rate(before)) / (after - before) - f.acceleration(t)) <= tolerance * w


def test_a_bare_load_function_may_be_scalar_but_not_of_another_shape():
    t = np.linspace(0.0, 1.0, 3)
    assert np.array_equal(evaluate(lambda t: 2.0, t), [2.0, 2.0, 2.0])
    with pytest.raises(sb.InputError, match="one value per time"):
        evaluate(lambda t: np.zeros(2), t)


# ------------------------------------------------------------------ records


def test_a_polygon_goes_through_its_samples_and_the_spline_is_scipys():
    t = np.random.default_rng(1).uniform(0.0, 1.0, 200)
    polygon, spline, scipys = sb.Sampled(TIMES, VALUES), sb.Sampled(TIMES, VALUES, "cubic"), CubicSpline(TIMES, VALUES)
    assert np.max(np.abs(polygon.value(t) - np.interp(t, TIMES, VALUES))) < 1e-15
    for order, mine in enumerate((spline.value, spline.rate, spline.acceleration)):
        # A derivative of order k divides rounding by the least spacing, 0.05, k times.
        for found in (mine(t), spline.derived(order).value(t)):
            assert np.max(np.abs(found - scipys(t, order))) < 100 * 2.2e-16 * 20.0**order
    assert np.array_equal(polygon.value(TIMES), VALUES)
    assert np.shape(spline.value(0.5)) == ()


def test_a_sum_adds_values_rates_and_accelerations():
    f, g, t = sb.Harmonic(2.0, 3.0, 0.1), sb.Sampled(TIMES, VALUES, "cubic"), np.linspace(0.0, 1.0, 11)
    total = sb.Superposition(f, sb.Superposition(g, sb.Constant(1.0)))
    assert np.array_equal(total.value(t), f.value(t) + g.value(t) + 1.0)
    assert np.array_equal(total.rate(t), f.rate(t) + g.rate(t))
    assert np.array_equal(total.acceleration(t), f.acceleration(t) + g.acceleration(t))
    # Factors of sums in sums multiply.
    weighted = sb.Superposition(terms=[(2.0, sb.Superposition(terms=[(3.0, sb.Constant(1.0)), (0.5, f)]))])
    loads = (weighted, sb.Constant(6.0), f)
    load, one, other = (sb.reference(one_mass(1.0, load=x), 2.0, t_eval=[0.0, 2.0]).tip[-1] for x in loads)
    assert load == pytest.approx(one + other, abs=1e-13)


def hammered(load):
    return chain(3, stop(), [(np.ones(3), load)])


def test_records_are_equal_by_their_numbers_in_any_process():
    a = sb.Sampled(TIMES, VALUES, "cubic")
    b = pickle.loads(pickle.dumps(a))
    assert a == b
    assert hash(a) == hash(b)
    assert not b.values.flags.writeable
    assert a not in (sb.Sampled(TIMES, VALUES), sb.Sampled(TIMES, VALUES + 1e-16, "cubic"))
    systems = [hammered(f) for f in (a, b, sb.Superposition(a), sb.Sampled(TIMES, 2 * VALUES, "cubic"))]
    assert systems[0].fingerprint == systems[1].fingerprint
    assert len({s.fingerprint for s in systems}) == 3
    assert len(repr(a)) < 120


def test_outside_its_samples_a_record_is_refused_and_not_extended():
    f = sb.Sampled(TIMES, VALUES)
    system = hammered(f)
    for call in (
        *(lambda t=t: f.value(t) for t in (-0.01, 1.01, [0.5, 1.01])),
        *(lambda m=m: sb.reference(system, 1.5, m) for m in ("exact", "cvode")),
        lambda: sb.integrate(system, sb.HHT(), 0.01, 1.5),
        lambda: sb.integrate_ensemble(system, sb.HHT(), 0.01, 1.5, members=sb.perturbed_members(system, 2)),
    ):
        with pytest.raises(sb.InputError, match="within its samples"):
            call()


def test_a_polygon_has_no_acceleration_and_is_no_base_motion():
    polygon = sb.Sampled(TIMES, VALUES)
    mixed = sb.Superposition(sb.Harmonic(0.1, 3.0), polygon)
    beams = [lambda base=base: sb.BeamProblem(stiffness=300.0, base=base) for base in (polygon, mixed)]
    for call in (lambda: polygon.acceleration(0.5), *beams):
        with pytest.raises(sb.InputError, match="cubic"):
            call()
