"""Loads, base motions and stop motions as measured: values, who takes them, and what is refused."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references import solve

TIMES = np.array([0.0, 0.1, 0.25, 0.3, 0.7, 1.0])
VALUES = np.array([0.0, 1.0, -0.5, 0.2, 0.3, -1.0])


def test_a_polygon_goes_through_its_samples_and_the_spline_is_scipys():
    rng = np.random.default_rng(1)
    t = rng.uniform(0.0, 1.0, 200)
    polygon, spline, scipys = sb.Sampled(TIMES, VALUES), sb.Sampled(TIMES, VALUES, "cubic"), CubicSpline(TIMES, VALUES)
    assert np.max(np.abs(polygon.value(t) - np.interp(t, TIMES, VALUES))) < 1e-15
    for order, mine in enumerate((spline.value, spline.rate, spline.acceleration)):
        # A derivative of order k divides rounding by the least spacing, 0.05, k times.
        assert np.max(np.abs(mine(t) - scipys(t, order))) < 100 * 2.2e-16 * 20.0**order
        assert np.max(np.abs(spline.derived(order).value(t) - scipys(t, order))) < 100 * 2.2e-16 * 20.0**order
    assert np.array_equal(polygon.value(TIMES), VALUES)
    assert np.shape(spline.value(0.5)) == ()
    assert np.array_equal(spline.breakpoints, TIMES)


def test_a_sum_adds_values_rates_and_accelerations():
    f, g, t = sb.Harmonic(2.0, 3.0, 0.1), sb.Sampled(TIMES, VALUES, "cubic"), np.linspace(0.0, 1.0, 11)
    total = sb.Superposition(f, sb.Superposition(g, sb.Constant(1.0)))
    assert np.array_equal(total.value(t), f.value(t) + (g.value(t) + 1.0))
    assert np.array_equal(total.rate(t), f.rate(t) + g.rate(t))
    assert np.array_equal(total.acceleration(t), f.acceleration(t) + g.acceleration(t))
    assert np.array_equal(total.breakpoints, TIMES)


def test_records_are_equal_by_their_numbers_in_any_process():
    a = sb.Sampled(TIMES, VALUES, "cubic")
    b = pickle.loads(pickle.dumps(a))
    assert a == b
    assert hash(a) == hash(b)
    assert not b.values.flags.writeable
    assert a != sb.Sampled(TIMES, VALUES)
    assert a != sb.Sampled(TIMES, VALUES + 1e-16, "cubic")
    systems = [hammered(f) for f in (a, b, sb.Superposition(a), sb.Sampled(TIMES, 2 * VALUES, "cubic"))]
    assert systems[0].fingerprint == systems[1].fingerprint
    assert len({s.fingerprint for s in systems}) == 3
    assert len(repr(a)) < 120


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: sb.Sampled([0.0, 1.0, 1.0], [0.0, 1.0, 2.0]), "sampled.t"),
        (lambda: sb.Sampled([0.0, math.nan], [0.0, 1.0]), "sampled.t"),
        (lambda: sb.Sampled([0.0], [0.0]), "sampled.t"),
        (lambda: sb.Sampled([0.0, 1.0], [0.0, 1.0, 2.0]), "sampled.values"),
        (lambda: sb.Sampled([0.0, 1.0], ["a", "b"]), "sampled.values"),
        (lambda: sb.Sampled([0.0, 1e-320], [0.0, 1.0]), "sampled.values"),
        (lambda: sb.Sampled(TIMES, VALUES, "cubics"), "kind"),
        (lambda: sb.Sampled(TIMES, VALUES, derivative=2), "derivative"),
        (lambda: sb.Superposition(), "Superposition"),
        (lambda: sb.Superposition(np.sin), "Superposition"),
    ],
)
def test_what_is_no_record_is_refused(make, field):
    with pytest.raises(sb.InputError) as caught:
        make()
    assert caught.value.field == field


def test_outside_its_samples_a_record_is_refused_and_not_extended():
    f = sb.Sampled(TIMES, VALUES)
    for t in (-0.01, 1.01, [0.5, 1.01]):
        with pytest.raises(sb.InputError, match="within its samples"):
            f.value(t)
    system = hammered(f)
    for solver in (
        lambda: sb.integrate(system, sb.HHT(), 0.01, 1.5),
        lambda: sb.reference(system, 1.5),
        lambda: sb.reference(system, 1.5, "cvode"),
        lambda: sb.reference(system, 1.5, "multiprecision"),
        lambda: sb.integrate_ensemble(system, sb.HHT(), 0.01, 1.5, members=sb.perturbed_members(system, 2)),
    ):
        with pytest.raises(sb.InputError, match="within its samples"):
            solver()


def test_a_polygon_has_no_acceleration_and_is_no_base_motion():
    polygon = sb.Sampled(TIMES, VALUES)
    with pytest.raises(sb.InputError, match="cubic"):
        polygon.acceleration(0.5)
    for base in (polygon, sb.Superposition(sb.Harmonic(0.1, 3.0), polygon)):
        with pytest.raises(sb.InputError, match="cubic"):
            sb.BeamProblem(stiffness=300.0, base=base)


def hammered(load, damping=0.0, contacts=1, offset=None):
    """A chain of three masses between stops, with one load on two of them."""
    mass = np.diag([1.0, 2.0, 1.5])
    stiffness = np.array([[40.0, -20.0, 0.0], [-20.0, 50.0, -30.0], [0.0, -30.0, 30.0]])
    stops = [sb.Stops(-0.2, 0.2 + 0.1 * i, stiffness=3000.0) for i in range(contacts)]
    return sb.System.from_matrices(
        mass, stiffness, damping * stiffness + 0.1 * bool(damping) * np.diag([1.0, 0.0, 0.0]),
        loads=[([1.0, 0.0, 1.0], load)],
        contacts=[sb.Contact(np.eye(3)[2 - i], stop, offset) for i, stop in enumerate(stops)],
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["linear", "cubic"])
@pytest.mark.parametrize(("damping", "contacts"), [(0.0, 1), (0.01, 2)])
def test_multiprecision_takes_records_and_the_exact_solution_is_its_own_to_rounding(kind, damping, contacts):
    rng = np.random.default_rng(5)
    t = np.linspace(0.0, 6.0, 31)
    load, move = sb.Sampled(t, 5.0 * rng.normal(size=31), kind), sb.Sampled(t, 0.05 * rng.normal(size=31), kind)
    system = hammered(sb.Superposition(load, sb.Harmonic(2.0, 3.0)), damping, contacts, move)
    exact, precise = sb.reference(system, 6.0), sb.reference(system, 6.0, "multiprecision")
    assert precise.horizon == 6.0
    assert exact.impacts.count == precise.impacts.count > 5
    scale = np.max(np.abs(precise.tip))
    inside = precise.t <= exact.horizon
    assert np.max(np.abs(exact.tip - precise.tip)[inside]) < 1e-6 * scale
    assert precise.provenance["between"] < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("method", ["cvode", "cvode-adams", "ida", "kvaerno5", "dop853", "radau"])
def test_every_solver_takes_a_record_as_load_and_as_stop_motion(method):
    t = np.linspace(0.0, 2.0, 9)
    load = sb.Sampled(t, [0, 9, 0, -7, 5, 0, 0, 3, 0], "linear")
    move = sb.Superposition(sb.Sampled(t, [0, 0.02, -0.02, 0, 0.03, 0, 0, 0, 0.01], "cubic"), sb.Harmonic(0.01, 5.0))
    system, times = hammered(load, 0.01, 2, move), np.linspace(0.0, 2.0, 101)
    exact, other = solve(system, 2.0, "exact", times, 0.0, None), solve(system, 2.0, method, times, 1e-10, None)
    assert exact.impacts.count > 1
    scale = np.max(np.abs(exact.tip))
    assert np.max(np.abs(exact.tip - other.tip)) < 1e-6 * scale
    assert np.max(np.abs(exact.energy.input - other.energy.input)) < 1e-5 * np.max(np.abs(exact.energy.input))
    assert np.max(np.abs(other.contacts[1].velocity - exact.contacts[1].velocity)) < 1e-4


@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.1), sb.SDIRK(), sb.Trapezoidal()], ids=str)
def test_every_scheme_takes_a_record_and_keeps_its_order(scheme):
    """No contact, a cubic record whose samples lie on steps: halving the step divides the error by 2^order."""
    t = np.linspace(0.0, 2.0, 17)
    load = sb.Superposition(sb.Sampled(t, np.sin(3.0 * t) * t, "cubic"), sb.Harmonic(1.0, 2.0))
    system = replace(hammered(load), contacts=(), observe=np.array([0.0, 0.0, 1.0]))
    exact = sb.reference(system, 2.0)
    errors = []
    for dt in (1 / 256, 1 / 512, 1 / 1024):
        run = sb.integrate(system, scheme, dt, 2.0)
        errors.append(np.max(np.abs(run.tip - exact.at(run.t)[0])))
    slope = np.log2(errors[0] / errors[2]) / 2.0
    assert abs(slope - scheme.order) < 0.1


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
    one = sb.cached_reference(system, 2.0, "multiprecision")
    copy = pickle.loads(pickle.dumps(system))
    two = sb.cached_reference(copy, 2.0, "multiprecision")  # from the frozen file, re-marched from sample to sample
    assert one.impacts.count == two.impacts.count > 0
    assert np.max(np.abs(one.tip - two.tip)) < 1e-9 * np.max(np.abs(one.tip))
    ensemble = sb.integrate_ensemble(copy, sb.HHT(), 1e-3, 2.0, members=sb.perturbed_members(system, 3))
    run = sb.integrate(system, sb.HHT(), 1e-3, 2.0)
    assert np.all(np.abs(ensemble.contacts[0].impact_count - run.impacts.count) <= 1)


@pytest.mark.slow
def test_many_samples_cost_little_and_many_pieces_are_no_accumulation():
    """A thousand samples in each shortest period: pieces that follow each other closely are not switches."""
    t = np.linspace(0.0, 0.5, 10001)
    system = hammered(sb.Sampled(t, 30.0 * np.sin(40.0 * t)), 0.0)
    exact = solve(system, 0.5, "exact", None, 0.0, None)
    harmonic = solve(hammered(sb.Harmonic(30.0, 40.0)), 0.5, "exact", None, 0.0, None)
    # A polygon with spacing h is off by (w h)^2/8 of the amplitude.
    assert np.max(np.abs(exact.tip - harmonic.tip)) < 1e-6 * np.max(np.abs(harmonic.tip))


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
    (tmp_path / "hammer.csv").write_text("time;force;gain\n0;0;1\n0.01;30;1\n0.2;0;1\n", encoding="utf-8")
    named = CASE.format(base='sampled = "table.csv"', load='sampled = "hammer.csv", column = "force"')
    held = CASE.format(
        base="sampled = { t = [0, 0.05, 0.1, 0.15], values = [0, 0.1, 0, 0.2] }",
        load="sampled = { t = [0, 0.01, 0.2], values = [0, 30, 0] }",
    )
    systems = []
    for name, text in (("named", named), ("held", held)):
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
        case = sb.load_cases(tmp_path / f"{name}.toml")["measured"]
        systems.append(sb.semidiscretise(case.problem, case.cells))
    assert systems[0].fingerprint == systems[1].fingerprint
    assert np.array_equal(systems[0].problem.loads[0].time.values, [0.0, 30.0, 0.0])
    other = (tmp_path / "hammer.csv").read_text(encoding="utf-8").replace("30", "31")
    (tmp_path / "hammer.csv").write_text(other, encoding="utf-8")
    case = sb.load_cases(tmp_path / "named.toml")["measured"]
    assert sb.semidiscretise(case.problem, case.cells).fingerprint != systems[0].fingerprint  # the numbers count


@pytest.mark.parametrize(
    ("content", "load", "says"),
    [
        ("0,0\n1,a\n", 'sampled = "h.csv"', "line 2: 'a'"),
        ("0,0\n1,1,1\n", 'sampled = "h.csv"', "line 2: 3 columns"),
        ("t,a,b\n0,0,0\n1,1,1\n", 'sampled = "h.csv"', "column = 'a' or 'b'"),
        ("t,a,b\n0,0,0\n1,1,1\n", 'sampled = "h.csv", column = "c"', "first line"),
        ("0,0\n0,1\n", 'sampled = "h.csv"', "increase"),
        ("", 'sampled = "h.csv"', "two or more lines"),
        ("0,0\n1,1\n", 'sampled = "no.csv"', "readable file"),
        ("0,0\n1,1\n", 'sampled = "h.csv", kind = "cubicle"', "linear"),
        ("0,0\n1,1\n", "sampled = { t = [0, 1] }", "values"),
    ],
)
def test_a_record_that_cannot_be_read_is_refused_with_file_and_line(tmp_path, content, load, says):
    (tmp_path / "h.csv").write_text(content, encoding="utf-8")
    base = "sampled = { t = [0, 1, 2], values = [0, 0, 0] }"
    (tmp_path / "case.toml").write_text(CASE.format(base=base, load=load), encoding="utf-8")
    with pytest.raises(sb.InputError, match=says):
        sb.load_cases(tmp_path / "case.toml")


@pytest.mark.fast(1)
@pytest.mark.parametrize("held", [1.0, 0.0], ids=["held", "free"])  # free bodies: two eigenvalues are zero
@pytest.mark.parametrize("dashpot", [0.0, 0.05], ids=["elastic", "damped"])
def test_samples_on_a_straight_line_change_nothing(dashpot, held):
    # Four samples are crossed one by one, 400 in the compiled loop, in chunks of cells: the load is the same.
    corners, heights = np.array([0.0, 2.0, 5.0, 9.0]), np.array([0.0, 6.0, -7.0, 1.0])
    many = np.unique(np.concatenate([corners, np.linspace(0.0, 9.0, 400)]))
    runs = []
    for t in (corners, many):
        load = sb.Superposition(sb.Sampled(t, np.interp(t, corners, heights)), sb.Harmonic(2.0, 3.0))
        near, far = (
            sb.Contact([1.0, 0.0], sb.Stops(-0.1, 0.15, stiffness=300.0, damping=dashpot)),
            sb.Contact([0.0, 1.0], sb.Stops(upper=0.2, stiffness=200.0)),
        )
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


def dashed(load, drive=None, damping=30.0):
    """Two masses, one between a damped stop and a spring, the other held back by a strong dashpot: one mode is slow
    beside the span and belongs to a chain, the others do not."""
    stop = sb.Contact([1.0, 0.0], sb.Stops(upper=0.1, stiffness=50.0, damping=10.0))
    loads = [([1.0, 0.0], load), *([([0.0, 1.0], drive)] if drive else [])]
    return sb.System.from_matrices(
        np.eye(2), [[2.0, -1.0], [-1.0, 2.0]], [[0.1, 0.0], [0.0, damping]], loads=loads, contacts=[stop]
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["linear", "cubic"])
@pytest.mark.parametrize("seed", [29, pytest.param(3, marks=pytest.mark.slow)])
def test_a_damped_stop_lets_go_where_its_force_ends_beside_a_slow_mode_under_a_record(seed, kind):
    """The rate of a contact lacked the forces on modes outside of the chain: releases came .06 too early."""
    rng, t = np.random.default_rng(seed), np.linspace(0.0, 10.0, 21)
    x, y = 5.0 * rng.normal(size=(2, 21))
    system = dashed(sb.Sampled(t, x, kind), sb.Sampled(t, 4.0 * y, kind))
    exact, other = sb.reference(system, 10.0), solve(system, 10.0, "dop853", None, 1e-11, None)
    mine, theirs = exact.contacts[0].impacts, other.contacts[0].impacts
    assert mine.count == theirs.count > 2
    assert mine.times == pytest.approx(theirs.times, abs=1e-6)
    assert mine.ends == pytest.approx(theirs.ends, abs=1e-6, nan_ok=True)
    # At every release the force of spring and dashpot is zero.
    ends = mine.ends[np.isfinite(mine.ends)] - 1e-9
    q, v = exact.state_at(ends)
    assert np.max(np.abs(50.0 * (q[:, 0] - 0.1) + 10.0 * v[:, 0])) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 4, 6, 16, 20, 26, 47, 1054])
def test_random_systems_with_slow_and_overdamped_modes_under_records(seed):
    """One to three masses, one or two stops, most with dampers, dashpots over five powers of ten, uneven samples."""
    g = np.random.default_rng(seed)
    samples = int(g.integers(11, 61))
    uneven = g.random() < 0.5
    t = np.sort(np.append(g.uniform(0.0, 10.0, samples), [0.0, 10.0])) if uneven else np.linspace(0.0, 10.0, samples)
    kind, n = ["linear", "cubic"][int(g.integers(2))], int(g.integers(1, 4))
    record = sb.Sampled(t, 5.0 * g.normal(size=len(t)), kind=kind)
    B = g.normal(size=(n, n))
    K = B @ B.T * 10.0 ** g.uniform(-0.5, 1.5) + (g.random() < 0.7) * np.eye(n)
    K = 0.0 * K if g.random() < 0.2 else K
    b = g.normal(size=n)
    dashpots = [0.2 * np.eye(n), 10.0 ** g.uniform(0.5, 2.5) * np.outer(b, b), np.diag(10.0 ** g.uniform(-1.0, 2.5, n))]
    C = [0.0 * K, *dashpots, 30.0 * B @ B.T][int(g.integers(5))]
    loads = [(g.normal(size=n), record)]
    loads += [(g.normal(size=n), sb.Harmonic(3.0, 2.5))] if g.random() < 0.4 else []
    loads += [(g.normal(size=n), sb.Constant(1.0))] if g.random() < 0.2 else []
    contacts = []
    for _ in range(int(g.integers(1, 3))):
        row, damping = g.normal(size=n), float(g.uniform(0.5, 10.0)) * (g.random() < 0.8)
        contacts.append(sb.Contact(row, sb.Stops(-0.15, 0.1, stiffness=60.0, damping=damping)))
    system = sb.System.from_matrices(np.eye(n), K, C, loads=loads, contacts=contacts)
    exact, other = sb.reference(system, 10.0), solve(system, 10.0, "dop853", None, 1e-11, None)
    inside, end = exact.t <= exact.horizon, exact.horizon - 1e-3
    assert np.max(np.abs(exact.tip - other.tip)[inside]) < 1e-6 * np.max(np.abs(other.tip))
    for a, b in zip(exact.contacts, other.contacts, strict=True):
        assert a.impacts.until(end).count == b.impacts.until(end).count


@pytest.mark.slow
def test_a_free_body_with_a_dashpot_inside_has_its_motion():
    """K = 0 and a dashpot between two masses: eigenvalues 0 that meet, with eigenvectors that are one."""
    t = np.linspace(0.0, 10.0, 21)
    stop = sb.Contact([-0.8, -0.5], sb.Stops(-0.15, 0.1, stiffness=60.0, damping=8.0))
    load = ([1.0, 0.3], sb.Sampled(t, 5.0 * np.random.default_rng(1).normal(size=21)))
    b = np.array([0.5543, 0.39775])
    system = sb.System.from_matrices(np.eye(2), np.zeros((2, 2)), np.outer(b, b), loads=[load], contacts=[stop])
    exact, other = sb.reference(system, 10.0), solve(system, 10.0, "dop853", None, 1e-11, None)
    assert exact.provenance["method"] == "exact"
    inside = exact.t <= exact.horizon
    assert np.max(np.abs(exact.tip - other.tip)[inside]) < 1e-7 * np.max(np.abs(other.tip))
    assert exact.impacts.until(exact.horizon).count == other.impacts.until(exact.horizon).count > 0


def test_the_force_of_a_stop_that_a_polygon_moves_may_be_largest_at_a_sample():
    """A heavy mass at rest: the depth follows the polygon, whose corner is the peak."""
    stop = sb.Contact(
        [1.0], sb.Stops(upper=0.5, stiffness=20.0), sb.Sampled([0.0, 0.9, 2.0, 3.0], [0.0, 1.0, 0.0, 0.0])
    )
    contact = sb.reference(sb.System.from_matrices([[100.0]], [[1.0]], contacts=[stop]), 3.0).contacts[0]
    at_corner = 20.0 * (1.0 - 0.5)
    assert contact.peak_force == pytest.approx(at_corner, rel=0.01)
    times = np.append(np.linspace(0.0, 3.0, 3001), 0.9)
    seen = sb.reference(sb.System.from_matrices([[100.0]], [[1.0]], contacts=[stop]), 3.0, t_eval=np.unique(times))
    assert contact.peak_force == pytest.approx(np.max(np.abs(seen.contacts[0].force)), rel=1e-12)
    assert contact.impacts.peaks[0] == contact.peak_force


def test_samples_are_no_events():
    """Ten thousand samples within the shortest period: events that accumulate are refused, samples are not."""
    t = np.linspace(0.0, 1.0, 10_001)
    system = one_mass(4.0, sb.Stops(upper=0.1, stiffness=4.0), damping=0.1, load=sb.Sampled(t, 2.0 * np.sin(3.0 * t)))
    assert sb.reference(system, 1.0).impacts.count == 1
