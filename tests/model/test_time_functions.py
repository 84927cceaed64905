"""Functions of time: closed forms, records as loads, base motions and stop motions."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpmath import mp
from scipy.interpolate import CubicSpline
from systems import one_mass

import stiffbeam as sb
from stiffbeam.model.time_functions import Drive, evaluate
from stiffbeam.references import solve

AMPLITUDES = st.one_of(st.floats(-10.0, -1e-3), st.floats(1e-3, 10.0))  # relative tolerances need normal numbers
TIMES = np.array([0.0, 0.1, 0.25, 0.3, 0.7, 1.0])
VALUES = np.array([0.0, 1.0, -0.5, 0.2, 0.3, -1.0])


@given(AMPLITUDES, st.floats(0.1, 50.0), st.floats(-7.0, 7.0), st.floats(-5.0, 5.0))
def test_a_harmonic_is_its_sine_and_cosine_and_has_its_derivatives(a, w, p, t):
    f, h = sb.Harmonic(a, w, p), 1e-4 / w
    assert f.value(t) == pytest.approx(a * math.sin(w * t + p), rel=1e-15, abs=4e-16 * abs(a) * (4.0 + abs(w * t)))
    split = f.sine * math.sin(w * t) + f.cosine * math.cos(w * t)
    assert abs(f.value(t) - split) <= 4e-16 * abs(a) * (4.0 + abs(w * t))  # rounding of the argument
    # Truncation (w h)^2/6 = 2e-9, rounding of the argument eps (|w t| + 7)/(w h) = 6e-10, relative.
    before, after, tolerance = t - h, t + h, 1e-8 * abs(a) * w
    assert abs((f.value(after) - f.value(before)) / (after - before) - f.rate(t)) <= tolerance
    assert abs((f.rate(after) - f.rate(before)) / (after - before) - f.acceleration(t)) <= tolerance * w


@pytest.mark.parametrize("function", [sb.Harmonic(1.0, 2.0), sb.Constant(3)], ids=str)
@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_time_functions_give_floats_of_the_shape_of_the_times(function, shape):
    t = np.linspace(0.0, 1.0, math.prod(shape)).reshape(shape) if shape else 0.5
    for values in (function.value(t), function.rate(t), function.acceleration(t)):
        assert np.shape(values) == shape
        assert np.asarray(values).dtype == float
    if isinstance(function, sb.Constant):
        assert np.all(function.value(t) == 3.0)
        assert not np.any(function.rate(t))


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
                for found, wanted in zip(g[k, 1 + 2 * i : 3 + 2 * i], (mp.sin(phase), mp.cos(phase)), strict=True):
                    assert abs(found - wanted) < np.finfo(float).eps * (float(phase) + 4.0)


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
    assert np.array_equal(spline.breakpoints, TIMES)
    # Taylor's polynomial at t holds up to the next sample.
    for x in (0.02, 0.26, 0.5):
        s = np.linspace(0.0, 0.03, 4)
        assert np.polyval(spline.taylor(x)[::-1], s) == pytest.approx(scipys(x + s), abs=1e-13)


def test_a_sum_adds_values_rates_and_accelerations():
    f, g, t = sb.Harmonic(2.0, 3.0, 0.1), sb.Sampled(TIMES, VALUES, "cubic"), np.linspace(0.0, 1.0, 11)
    total = sb.Superposition(f, sb.Superposition(g, sb.Constant(1.0)))
    assert np.array_equal(total.value(t), f.value(t) + (g.value(t) + 1.0))
    assert np.array_equal(total.rate(t), f.rate(t) + g.rate(t))
    assert np.array_equal(total.acceleration(t), f.acceleration(t) + g.acceleration(t))
    assert np.array_equal(total.breakpoints, TIMES)
    # Factors of sums in sums multiply.
    weighted = sb.Superposition.weighted([(2.0, sb.Superposition.weighted([(3.0, sb.Constant(1.0)), (0.5, f)]))])
    load = sb.reference(one_mass(1.0, load=weighted), 2.0, t_eval=[0.0, 2.0]).tip[-1]
    one, other = (sb.reference(one_mass(1.0, load=x), 2.0, t_eval=[0.0, 2.0]).tip[-1] for x in (sb.Constant(6.0), f))
    assert load == pytest.approx(one + other, abs=1e-13)


def hammered(load, damping=0.0, contacts=1, offset=None):
    """A chain of three masses between stops, with one load on two of them."""
    stiffness = np.array([[40.0, -20.0, 0.0], [-20.0, 50.0, -30.0], [0.0, -30.0, 30.0]])
    stops = [sb.Stops(-0.2, 0.2 + 0.1 * i, stiffness=3000.0) for i in range(contacts)]
    return sb.System.from_matrices(
        np.diag([1.0, 2.0, 1.5]), stiffness, damping * stiffness + 0.1 * bool(damping) * np.diag([1.0, 0.0, 0.0]),
        loads=[([1.0, 0.0, 1.0], load)],
        contacts=[sb.Contact(np.eye(3)[2 - i], stop, offset) for i, stop in enumerate(stops)],
    )  # fmt: skip


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
        *(lambda m=m: sb.reference(system, 1.5, m) for m in ("exact", "cvode", "multiprecision")),
        lambda: sb.integrate(system, sb.HHT(), 0.01, 1.5),
        lambda: sb.integrate_ensemble(system, sb.HHT(), 0.01, 1.5, members=sb.perturbed_members(system, 2)),
    ):
        with pytest.raises(sb.InputError, match="within its samples"):
            call()


def test_a_polygon_has_no_acceleration_and_is_no_base_motion():
    polygon = sb.Sampled(TIMES, VALUES)
    mixed = sb.Superposition(sb.Harmonic(0.1, 3.0), polygon)
    for call, words in (
        (lambda: polygon.acceleration(0.5), "cubic"), (lambda: sb.BeamProblem(stiffness=300.0, base=polygon), "cubic"),
        (lambda: sb.BeamProblem(stiffness=300.0, base=mixed), "cubic"),
    ):  # fmt: skip
        with pytest.raises(sb.InputError, match=words):
            call()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["linear", "cubic"])
@pytest.mark.parametrize(("damping", "contacts"), [(0.0, 1), (0.01, 2)])
def test_multiprecision_takes_records_and_the_exact_solution_is_its_own_to_rounding(kind, damping, contacts):
    rng, t = np.random.default_rng(5), np.linspace(0.0, 6.0, 31)
    load, move = sb.Sampled(t, 5.0 * rng.normal(size=31), kind), sb.Sampled(t, 0.05 * rng.normal(size=31), kind)
    system = hammered(sb.Superposition(load, sb.Harmonic(2.0, 3.0)), damping, contacts, move)
    exact, precise = sb.reference(system, 6.0), sb.reference(system, 6.0, "multiprecision")
    assert precise.horizon == 6.0
    assert exact.impacts.count == precise.impacts.count > 5
    inside = precise.t <= exact.horizon
    assert np.max(np.abs(exact.tip - precise.tip)[inside]) < 1e-6 * np.max(np.abs(precise.tip))
    assert precise.provenance["between"] < 1e-12


@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.1), sb.SDIRK(), sb.Trapezoidal()], ids=str)
def test_every_scheme_takes_a_record_and_keeps_its_order(scheme):
    """No contact, a cubic record whose samples lie on steps: halving the step divides the error by 2^order."""
    t = np.linspace(0.0, 2.0, 17)
    load = sb.Superposition(sb.Sampled(t, np.sin(3.0 * t) * t, "cubic"), sb.Harmonic(1.0, 2.0))
    system = replace(hammered(load), contacts=(), observe=np.array([0.0, 0.0, 1.0]))
    exact, errors = sb.reference(system, 2.0), []
    for dt in (1 / 256, 1 / 1024):
        run = sb.integrate(system, scheme, dt, 2.0)
        errors.append(np.max(np.abs(run.tip - exact.at(run.t)[0])))
    assert abs(np.log2(errors[0] / errors[1]) / 2.0 - scheme.order) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
def test_a_measured_base_motion_moves_the_beam_as_its_harmonic_does(form):
    """A spline through a sine at spacing h is off by (w h)^4/384, its acceleration by (w h)^2/12 of its own."""
    w, t = 10.0, np.linspace(0.0, 0.25, 1001)
    stops = sb.Stops(-0.1, 0.1, stiffness=5e4)
    bases = sb.Harmonic(0.2, w), sb.Sampled(t, 0.2 * np.sin(w * t), "cubic")
    systems = [sb.semidiscretise(sb.BeamProblem(stiffness=300.0, stops=stops, base=b), 8, form) for b in bases]
    a, b = (sb.reference(s, 0.25) for s in systems)
    assert a.impacts.count == b.impacts.count > 3
    assert np.max(np.abs(a.tip - b.tip)) < 1e-5 * np.max(np.abs(a.tip))
    precise = sb.reference(systems[1], 0.05, "multiprecision", t_eval=np.linspace(0.0, 0.05, 51))
    assert np.max(np.abs(precise.tip - b.at(precise.t)[0])) < 1e-10


@pytest.mark.usefixtures("own_cache")
def test_a_measured_run_travels_is_cached_frozen_and_repeated():
    system = hammered(sb.Sampled(np.linspace(0, 2, 9), [0, 9, 0, -7, 5, 0, 0, 3, 0]), 0.01)
    one, copy = sb.cached_reference(system, 2.0, "multiprecision"), pickle.loads(pickle.dumps(system))
    two = sb.cached_reference(copy, 2.0, "multiprecision")  # from the frozen file, re-marched from sample to sample
    assert one.impacts.count == two.impacts.count > 0
    assert np.max(np.abs(one.tip - two.tip)) < 1e-9 * np.max(np.abs(one.tip))


CASE = """
[[case]]
name = "measured"
cells = 8
dt = 1e-3
t_end = 0.1
[case.problem]
stiffness = 300
stops = {{ lower = -0.1, upper = 0.1, stiffness = 5e4 }}
base = {{ sum = [{{ {base}, kind = "cubic" }}, {{ amplitude = 0.01, frequency = 50.0 }}] }}
loads = [{{ position = 0.5, {load} }}]
"""


def test_a_case_file_names_records_beside_it_or_holds_them(tmp_path):
    (tmp_path / "table.csv").write_text("# shaking table\n0,0\n0.05,0.1\n0.1,0\n0.15,0.2\n", encoding="utf-8")
    hammer, texts = "time;force;gain\n0;0;1\n0.01;30;1\n0.2;0;1\n", {
        "named": CASE.format(base='sampled = "table.csv"', load='sampled = "hammer.csv", column = "force"'),
        "held": CASE.format(
            base="sampled = { t = [0, 0.05, 0.1, 0.15], values = [0, 0.1, 0, 0.2] }",
            load="sampled = { t = [0, 0.01, 0.2], values = [0, 30, 0] }",
        ),
    }  # fmt: skip

    def system(name, force):
        (tmp_path / "hammer.csv").write_text(force, encoding="utf-8")
        (tmp_path / f"{name}.toml").write_text(texts[name], encoding="utf-8")
        return sb.load_cases(tmp_path / f"{name}.toml")["measured"].system()

    named, held = system("named", hammer), system("held", hammer)
    assert named.fingerprint == held.fingerprint != system("named", hammer.replace("30", "31")).fingerprint
    assert np.array_equal(named.problem.loads[0].time.values, [0.0, 30.0, 0.0])


@pytest.mark.parametrize(
    ("content", "load", "words"),
    [
        ("0,0\n1,a\n", 'sampled = "h.csv"', "line 2: 'a'"),
        ("0,0\n1,1,1\n", 'sampled = "h.csv"', "line 2: 3 columns"),
        ("t,a,b\n0,0,0\n1,1,1\n", 'sampled = "h.csv"', "column = 'a' or 'b'"),
        ("t,a,b\n0,0,0\n1,1,1\n", 'sampled = "h.csv", column = "c"', "first line"),
        ("0,0\n0,1\n", 'sampled = "h.csv"', "increase"), ("", 'sampled = "h.csv"', "two or more lines"),
        ("0,0\n1,1\n", 'sampled = "no.csv"', "readable file"),
        ("0,0\n1,1\n", 'sampled = "h.csv", kind = "cubicle"', "linear"),
        ("0,0\n1,1\n", "sampled = { t = [0, 1] }", "values"),
    ],
)  # fmt: skip
def test_a_record_that_cannot_be_read_is_refused_with_file_and_line(tmp_path, content, load, words):
    (tmp_path / "h.csv").write_text(content, encoding="utf-8")
    base = "sampled = { t = [0, 1, 2], values = [0, 0, 0] }"
    (tmp_path / "case.toml").write_text(CASE.format(base=base, load=load), encoding="utf-8")
    with pytest.raises(sb.InputError, match=words):
        sb.load_cases(tmp_path / "case.toml")


@pytest.mark.fast(1)
@pytest.mark.parametrize("held", [1.0, 0.0], ids=["held", "free"])  # free bodies: two eigenvalues are zero
@pytest.mark.parametrize("dashpot", [0.0, 0.05], ids=["elastic", "damped"])
def test_samples_on_a_straight_line_change_nothing(dashpot, held):
    """Four samples are crossed one by one, 400 in chunks of cells: the load is the same."""
    corners, heights, runs = np.array([0.0, 2.0, 5.0, 9.0]), np.array([0.0, 6.0, -7.0, 1.0]), []
    for t in (corners, np.unique(np.concatenate([corners, np.linspace(0.0, 9.0, 400)]))):
        load = sb.Superposition(sb.Sampled(t, np.interp(t, corners, heights)), sb.Harmonic(2.0, 3.0))
        near = sb.Contact([1.0, 0.0], sb.Stops(-0.1, 0.15, stiffness=300.0, damping=dashpot))
        far = sb.Contact([0.0, 1.0], sb.Stops(upper=0.2, stiffness=200.0))
        K = 10.0 * np.array([[1.0, -1.0], [-1.0, 1.0]]) + held * np.diag([20.0, 10.0])
        system = sb.System.from_matrices(np.eye(2), K, 0.004 * K, [([1.0, 2.0], load)], [near, far])
        runs.append(sb.reference(system, 9.0, t_eval=np.linspace(0.0, 9.0, 181)))
    few, more = runs
    assert few.impacts.count == more.impacts.count > 10
    for before, after in zip(few.contacts, more.contacts, strict=True):
        np.testing.assert_allclose(after.impacts.times, before.impacts.times, atol=1e-11)
        np.testing.assert_allclose(after.impacts.peaks, before.impacts.peaks, rtol=1e-9)
    np.testing.assert_allclose(more.tip, few.tip, atol=1e-11)
    assert more.horizon == few.horizon == 9.0


@pytest.mark.parametrize("kind", ["linear", "cubic"])
@pytest.mark.parametrize("seed", [29, pytest.param(3, marks=pytest.mark.slow)])
def test_a_damped_stop_lets_go_where_its_force_ends_beside_a_slow_mode_under_a_record(seed, kind):
    """Two masses, one between a damped stop and a spring, the other held back by a strong dashpot: one mode is slow
    beside the span. The rate of a contact lacked the forces on the others: releases came .06 too early."""
    rng, t = np.random.default_rng(seed), np.linspace(0.0, 10.0, 21)
    x, y = 5.0 * rng.normal(size=(2, 21))
    stop = sb.Contact([1.0, 0.0], sb.Stops(upper=0.1, stiffness=50.0, damping=10.0))
    loads = [([1.0, 0.0], sb.Sampled(t, x, kind)), ([0.0, 1.0], sb.Sampled(t, 4.0 * y, kind))]
    system = sb.System.from_matrices(np.eye(2), [[2.0, -1.0], [-1.0, 2.0]], np.diag([0.1, 30.0]), loads, [stop])
    exact, other = sb.reference(system, 10.0), solve(system, 10.0, "dop853", None, 1e-11, None)
    mine, theirs = exact.contacts[0].impacts, other.contacts[0].impacts
    assert mine.count == theirs.count > 2
    assert mine.times == pytest.approx(theirs.times, abs=1e-6)
    assert mine.ends == pytest.approx(theirs.ends, abs=1e-6, nan_ok=True)
    # At every release the force of spring and dashpot is zero.
    q, v = exact.state_at(mine.ends[np.isfinite(mine.ends)] - 1e-9)
    assert np.max(np.abs(50.0 * (q[:, 0] - 0.1) + 10.0 * v[:, 0])) < 1e-5


def test_the_force_of_a_stop_that_a_polygon_moves_may_be_largest_at_a_sample():
    """A heavy mass at rest: the depth follows the polygon, whose corner is the peak."""
    polygon = sb.Sampled([0.0, 0.9, 2.0, 3.0], [0.0, 1.0, 0.0, 0.0])
    heavy = one_mass(1.0, sb.Stops(upper=0.5, stiffness=20.0), mass=100.0, offset=polygon)
    seen = sb.reference(heavy, 3.0, t_eval=np.unique(np.append(np.linspace(0.0, 3.0, 3001), 0.9))).contacts[0]
    assert seen.peak_force == pytest.approx(20.0 * (1.0 - 0.5), rel=0.01)
    assert seen.peak_force == pytest.approx(np.max(np.abs(seen.force)), rel=1e-12)
    assert seen.impacts.peaks[0] == seen.peak_force


def test_samples_are_no_events():
    """Ten thousand samples within the shortest period: events that accumulate are refused, samples are not."""
    t = np.linspace(0.0, 1.0, 10_001)
    system = one_mass(4.0, sb.Stops(upper=0.1, stiffness=4.0), damping=0.1, load=sb.Sampled(t, 2.0 * np.sin(3.0 * t)))
    assert sb.reference(system, 1.0).impacts.count == 1
