"""Measures recover what synthetic signals were made with; compare prints and draws what its parts say."""

from __future__ import annotations

import dataclasses
import json
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from oracles import beam_mode, beam_roots
from PIL import Image
from systems import bouncing_chain, one_mass, two_contacts

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.measures.amplification import free_mode_errors
from stiffbeam.measures.comparison import AT_REST, phase_lag
from stiffbeam.measures.errors import first_impacts_end, impact_times, match, matched_until, observed_order
from stiffbeam.measures.report import common_window
from stiffbeam.model.modes import modes
from stiffbeam.model.scales import scales
from stiffbeam.pytest_plugin import within_reference
from stiffbeam.trajectory.records import Impacts
from stiffbeam.trajectory.trajectory import Work


def impacts(times, stops):
    return Impacts.at(times, stops, "sampled")


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
@pytest.mark.parametrize("lag", [-0.031, 0.0, 0.0004, 0.05])
def test_a_known_lag_is_recovered_in_any_unit_of_time(lag, unit):
    """u_run(t) = u_ref(t - lag): a late run has a positive lag. Hermite interpolation is good to dt^4."""
    t = np.arange(0.0, 3.0 + 1e-9, 1e-3)
    u_ref = lambda s: np.sin(7.0 * s / unit) + 0.3 * np.sin(19.0 * s / unit + 1.0)  # noqa: E731
    v = (7.0 * np.cos(7.0 * (t - lag)) + 5.7 * np.cos(19.0 * (t - lag) + 1.0)) / unit
    found = phase_lag(unit * t, u_ref(unit * (t - lag)), v, u_ref(unit * t), 3.0 * unit, 7.0 / unit, 4.0 / unit)
    assert not found.undefined
    assert abs(found.lag / unit - lag) < 1e-7
    assert found.residual < 1e-6


@pytest.mark.parametrize("uneven", [0.0, 0.12])
def test_a_decayed_run_has_its_lag_and_a_residual(uneven):
    """Over whole half periods the loss of amplitude does not bias the lag, nor do steps that are finer in places."""
    t = np.linspace(0.0, np.pi, 7001)
    t += uneven * np.sin(3.0 * t + 1.0) - uneven * np.sin(1.0) * np.cos(t)
    u_ref = lambda s: np.sin(7.0 * s)  # noqa: E731
    found = phase_lag(t, 0.8 * u_ref(t - 0.01), 5.6 * np.cos(7.0 * (t - 0.01)), u_ref(t), np.pi, drive=7.0, first=4.0)
    assert abs(found.lag - 0.01) < 1e-5
    assert abs(found.residual - 0.2) < 1e-5


def test_a_lag_is_undefined_in_a_window_too_short_or_without_a_minimum():
    t = np.arange(0.0, 3.0 + 1e-9, 1e-3)
    zero = np.zeros_like(t)
    assert "shorter" in phase_lag(t, zero, zero, np.sin(t), 0.5, drive=7.0, first=4.0).undefined
    ramp = phase_lag(t, t, zero + 1.0, t + 5.0, 3.0, drive=7.0, first=4.0)
    assert "no best shift" in ramp.undefined
    assert np.isnan(ramp.lag)


def test_the_step_at_the_end_of_the_window_counts_whatever_its_rounding():
    """Seven steps of 0.1 end at 0.7000000000000001, beyond a window of 0.7 that the impacts match."""
    system = sb.System.from_matrices([[1.0]], [[4.0]], observe=[1.0], initial_velocity=[1.0])
    run, reference = sb.integrate(system, sb.BDF2(), 0.1, 0.7), sb.reference(system, 0.7)
    result = sb.compare(run, reference)
    assert run.t[-1] > result.matched_until == result.window == 0.7
    assert result.tip_error_to(result.matched_until) == result.tip_error_rms


def test_a_minimum_that_is_flat_to_rounding_is_no_error():
    t, mean = np.linspace(0.0, 50.0, 2001), 1e15
    found = phase_lag(t, mean + np.cos(t), -np.sin(t), mean + np.cos(t + 1e-3), 50.0, 1.0, 1.0)
    assert abs(found.lag) < 2.0 * np.pi / 401


@pytest.mark.parametrize("end", [3.0, np.nextafter(3.0, 0.0)])
def test_a_drift_that_is_as_long_as_the_window_has_its_lag_whatever_the_rounding(end):
    t = np.linspace(0.0, 3.0, 3001)
    u_ref = lambda s: np.sin(7.0 * s)  # noqa: E731
    late = phase_lag(t, u_ref(t - 0.01), 7.0 * np.cos(7.0 * (t - 0.01)), u_ref(t), end, 0.0, 2.0 * np.pi / 3.0)
    assert late.lag == pytest.approx(0.01, rel=1e-6)


def test_matching_pairs_impacts_in_order_until_the_first_that_does_not_fit():
    reference = impacts([1.0, 2.0, 2.4, 4.0], [1, -1, 1, -1])
    same = match(reference, reference, 5.0)
    assert (same.matched, same.matched_until, same.median_delay) == (4, 5.0, 0.0)
    late = match(impacts([1.1, 2.1, 2.45, 4.1], [1, -1, 1, -1]), reference, 5.0)
    assert late.matched == 4
    assert late.median_delay == pytest.approx(0.1)
    # the second may be off by half the gap of 0.4 to the third, no more
    assert match(impacts([1.0, 2.21, 2.45], [1, -1, 1]), reference, 5.0).matched_until == 2.0
    assert match(impacts([1.0, 2.0, 2.4], [1, -1, -1]), reference, 5.0).matched_until == 2.4
    assert match(impacts([1.0, 2.0], [1, -1]), reference, 5.0).matched_until == 2.4  # one is missing
    assert match(impacts([1, 2, 2.4, 4, 4.5], [1, -1, 1, -1, 1]), reference, 5.0).matched_until == 4.5  # one too many
    assert match(impacts([1, 2, 2.4, 4, 4.5], [1, -1, 1, -1, 1]), reference, 3.0).matched_until == 3.0
    # A single one has no neighbour: what is later than a quarter of the longest natural period follows nothing.
    assert match(impacts([18.2], [1]), impacts([2.65], [1]), 40.0).matched_until == 40.0
    assert match(impacts([18.2], [1]), impacts([2.65], [1]), 40.0, longest=np.pi / 2).matched_until == 2.65
    nothing = match(impacts([], []), impacts([], []), 2.0)
    assert (nothing.matched, nothing.matched_until) == (0, 2.0)
    assert np.isnan(nothing.median_delay)


@pytest.mark.parametrize("bound", ["lower", "upper"])
def test_a_contact_crosses_the_stop_it_rests_on_by_rounding_until_the_motion_arrives(bound):
    """The tip of a beam on a stop without gap is moved through all cells. Its first crossings, of depth 1e-18 or of
    1e-11 of the motion, parted run and reference at t = 0.0046: the table compared nothing."""
    stops = sb.Stops(**{bound: 0.0}, stiffness=1e4)
    system = sb.semidiscretise(sb.BeamProblem(stiffness=1.0, stops=stops, base=sb.Harmonic(0.2, 10.0)), 25)
    run, exact = sb.integrate(system, sb.HHT(-0.1), 1e-4, 1.0), sb.reference(system, 1.0)
    # The crossings are there in both.
    resting = np.abs(run.tip) < 1e-9 * np.max(np.abs(run.tip))
    assert run.t[np.argmin(resting)] > 0.003
    result = sb.compare(run, exact)
    contact = result.contacts[0]
    assert result.matched_until == matched_until(run, exact, 1.0) == 1.0
    assert contact.run.impacts == contact.reference.impacts == contact.matching.matched >= 5
    assert abs(result.phase.lag) < 1e-3


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
    found = free_mode_errors(sb.Trajectory(
        t=t, tip=q[:, -1], tip_velocity=v[:, -1], contacts=(), work=Work(), provenance={"dt": 0.005}, system=system,
        pieces=lambda: iter([(t, q, v, np.zeros((len(t), 0)))]),
    ))  # fmt: skip
    elongation = turning / (turning - late) - 1.0
    ratio = (own + decay) / np.hypot(own + decay, turning - late)
    np.testing.assert_allclose(found.period_elongation, elongation, rtol=1e-9 if noise == 0.0 else 0.1)
    np.testing.assert_allclose(found.damping_ratio, ratio, rtol=1e-9 if noise == 0.0 else 0.1)


@pytest.fixture(scope="module")
def compared(table10):
    system = sb.semidiscretise(table10, 12)
    ref = sb.reference(system, 0.6)
    # A step short enough for the impacts to match for a while.
    run = sb.integrate(system, sb.SDIRK(), 5e-6, 0.6)
    return system, ref, run, sb.compare(run, ref)


def test_compare_says_what_its_definitions_say(compared, table10):
    _, ref, run, c = compared
    assert c.window == min(0.6, ref.horizon)
    inside = run.t <= c.window * (1 + 1e-12)
    u, _ = ref.at(run.t[inside])
    error = run.tip[inside] - u
    assert c.tip_error_max == pytest.approx(np.max(np.abs(error)) / np.max(np.abs(u)))
    assert c.tip_error_rms == pytest.approx(np.sqrt(np.mean(error**2)) / np.max(np.abs(u)))
    chi = table10.stops.state(run.tip[inside])
    (contact,) = c.contacts
    assert contact.run.impacts == np.count_nonzero((chi[1:] != 0) & (chi[1:] != chi[:-1]))
    assert contact.run.fraction == pytest.approx(np.mean(chi[1:] != 0))
    assert contact.run.peak_force == pytest.approx(np.max(np.abs(table10.stops.force(run.tip[inside]))))
    assert contact.reference.event_impacts == np.count_nonzero(ref.impacts.times <= c.window)
    assert contact.reference.impacts == ref.impacts_sampled(5e-6, c.window).count
    last = np.flatnonzero(inside)[-1]
    most = run.energy.energy[0] + np.max(run.energy.input[: last + 1])
    assert c.energy_lost == pytest.approx(run.energy.loss[last] / most)
    assert 0 < contact.matching.matched_until == c.matched_until <= c.window
    assert contact.matching.matched > 3


@pytest.mark.slow
def test_a_reference_compared_with_itself_has_no_error(compared):
    system, ref, run, _ = compared
    same = sb.reference(system, 0.6, t_eval=run.t)
    c = sb.compare(same, ref)
    assert c.tip_error_max < 1e-12  # a motion that is read at other times has other roundings
    assert c.matched_until == c.window
    run_side, ref_side = (dataclasses.astuple(side) for side in (c.contacts[0].run, c.contacts[0].reference))
    assert run_side == pytest.approx(ref_side, rel=1e-12)
    assert abs(c.phase.lag) < 1e-9
    assert abs(c.energy_lost) < 1e-9


def test_a_late_run_shows_a_positive_lag():
    """BDF2 elongates the period by (w dt)^2/3: it is late, four times as late with twice the step."""
    first = beam_roots(1)[0]
    problem = sb.BeamProblem(stiffness=300.0, initial_velocity=lambda x: beam_mode(first, x))
    system = sb.semidiscretise(problem, 8)
    ref = sb.reference(system, 0.5)
    compared = [sb.compare(sb.integrate(system, sb.BDF2(), dt, 0.5), ref) for dt in (1e-4, 2e-4)]
    lags = [c.phase.lag for c in compared]
    assert 0 < lags[0] < lags[1]
    assert lags[1] / lags[0] == pytest.approx(4.0, rel=0.15)
    # Half the final delay on average: BDF2's phase error is (w dt)^2/3 per w t, w = 59.8.
    assert lags[1] == pytest.approx((59.8 * 2e-4) ** 2 / 3 * 0.25, rel=0.15)
    assert compared[0].contacts == ()
    compared[0].figure().canvas.draw()


def test_the_comparison_prints_and_goes_to_json(compared):
    c = compared[3]
    text = str(c)
    assert "SDIRK(gamma=0.4359)" in text
    assert "one realisation" in text
    assert "<table" in c._repr_html_()
    assert c.to_latex().count("\\toprule") == c.to_latex().count("\\begin{table}") == 2
    plain = json.loads(json.dumps(c.to_dict(), allow_nan=False))
    assert plain["contacts"][0]["run"]["impacts"] == c.contacts[0].run.impacts


def test_what_cannot_be_compared_is_refused(compared, table10):
    system, ref, _, comparison = compared
    other = sb.integrate(sb.semidiscretise(table10, 10), sb.HHT(), 1e-4, 0.1)
    with pytest.raises(sb.InputError, match="same system"):
        sb.compare(other, ref)
    with pytest.raises(sb.InputError, match="free"):
        free_mode_errors(other)
    with pytest.raises(sb.InputError, match="every"):
        sb.compare(sb.integrate(system, sb.HHT(), 1e-4, 0.1, every=10), ref)
    for time in (-np.inf, 0.0, np.nan, 1.0):
        with pytest.raises(sb.InputError, match="window"):
            comparison.tip_error_to(time)


def test_several_runs_are_one_table(compared):
    system, ref, run, c = compared
    runs = [run, sb.integrate(system, sb.BDF2(), 5e-6, 0.6)]
    both = sb.compare(runs, ref)
    assert len(both) == 2
    assert both[0].to_dict() == c.to_dict()
    assert both.to_dataframe().label.to_list() == [x.label for x in runs]
    assert both.to_dataframe().attrs["units"] == []
    lines = str(both).splitlines()
    assert sum(line.startswith("SDIRK(gamma=0.4359) ") for line in lines) == 2
    assert sum(line.startswith("BDF2 ") for line in lines) == 2
    assert len(both.figure().axes[0].get_lines()) >= 3


# ---------------------------------------------------------------- what does not move or touch

STILL = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(lower=-0.1, upper=0.1, stiffness=5e6))
FAR = dataclasses.replace(STILL, stops=sb.Stops(lower=-1.0, upper=1.0, stiffness=5e6), base=sb.Harmonic(0.2, 10.0))
NEAR = dataclasses.replace(FAR, stops=STILL.stops)
PULSE = sb.Sampled([0.0, 0.1, 0.2, 1.0], [0.0, 1.0, 0.0, 0.0])


@pytest.mark.parametrize(("change", "still"), [
    ({}, True), ({"base": sb.Harmonic(0.0, 10.0)}, True), ({"base": sb.Harmonic(1e-9, 10.0)}, False),
    ({"loads": sb.PointLoad(position=0.5, time=sb.Constant(0.0))}, True),
    ({"loads": sb.PointLoad(position=0.5, time=sb.Sampled([0.0, 1.0], [0.0, 0.0]))}, True),
    ({"loads": sb.PointLoad(position=0.5, time=PULSE)}, False), ({"initial_velocity": lambda x: 1e-9 + 0 * x}, False),
    ({"stops": sb.Stops(lower=0.0, upper=0.1, stiffness=5e6)}, True),
    ({"stops": sb.Stops(lower=0.01, upper=0.1, stiffness=5e6)}, False),  # pressed at the start
    ({"stops": sb.Stops(lower=-0.1, stiffness=5e6, motion=sb.Harmonic(0.2, 10.0))}, False),
])  # fmt: skip
def test_what_stays_at_rest_is_known(change: dict[str, object], still: bool) -> None:
    system = sb.semidiscretise(dataclasses.replace(STILL, **change), cells=4)
    assert (scales(system, 0.5).speed == 0.0) == still
    assert np.any(sb.reference(system, t_end=0.5).tip) != still


@pytest.mark.parametrize(
    ("problem", "said"), [(STILL, AT_REST), (FAR, "No impacts: the motion reaches no stop to t = 0.2."), (NEAR, "")]
)
def test_compare_and_advise_say_that_nothing_moves_or_touches(problem: sb.BeamProblem, said: str) -> None:
    system = sb.semidiscretise(problem, cells=6)
    reference = sb.reference(system, t_end=0.2)
    assert bool(sum(len(c.impacts.times) for c in reference.contacts)) == (said == "")
    found = sb.compare(sb.integrate(system, sb.HHT(alpha=-0.1), dt=1e-3, t_end=0.2), reference)
    assert found.remark == found.to_dict()["remark"] == said
    assert " ".join(str(found).split()).startswith(said or "To the horizon")
    records = sb.study("advise", system, t_end=0.2, want={"tip": 0.5}, schemes=[sb.BDF2()])
    assert said in records.answer.notes
    assert records.answer.verdict.startswith("BDF2")


# ---------------------------------------------------------------- tables in notebooks, pictures

PNG = b"\x89PNG\r\n\x1a\n"


def cells(thing) -> list[list[str]]:
    """The cells of every table, row by row; elements that are not closed are errors."""
    text = thing._repr_html_()
    assert "<pre" not in text
    rows = ElementTree.fromstring(f"<div>{text}</div>").iter("tr")
    return [["".join(cell.itertext()) for cell in row] for row in rows]


def test_runs_are_pictures_and_what_is_said_of_them_is_a_table_in_a_notebook():
    system = two_contacts()
    run, reference = sb.integrate(system, sb.HHT(-0.1), 1e-3, 2.0), sb.reference(system, 2.0)
    for thing, black in ((run, False), (reference, True)):
        figure = thing.plot()
        assert figure._repr_png_().startswith(PNG)
        line = figure.axes[0].lines[0]
        assert np.array_equal(line.get_ydata(), thing.tip)
        assert (line.get_color() == "black") == black
        assert all(axis.get_ylabel() for axis in figure.axes)
    comparison = sb.compare(run, reference)
    assert cells(comparison)
    figure = comparison.figure()
    assert figure.axes[0].get_title(loc="left").startswith("(a) displacement to t = ")
    # Of matrices no tip is known.
    assert "tip" not in f"{comparison} {comparison!r} {comparison.to_latex()} {figure.get_suptitle()}"
    assert cells(sb.score([sb.HHT(-0.1)], ["mass-on-a-stop"]))


def test_a_reaction_of_a_rigid_stop_is_no_force_of_an_impact():
    """Its mean over a step grows like 1/dt: the axis states it."""
    system = one_mass(100.0, sb.Stops(upper=0.5, stiffness=np.inf, restitution=0.8), v=10.0)
    run, exact = sb.integrate(system, sb.MoreauJean(), 1e-3, 1.0), sb.reference(system, 1.0)
    for thing, label in ((run, "mean per step"), (exact, "without impulses")):
        figure = thing.plot()
        assert figure.axes[1].get_ylabel().endswith(label)


@pytest.mark.slow
def test_records_of_a_study_show_their_table_and_picture():
    records = sb.study("modes", schemes=["BDF2"], steps=400)
    rows = cells(records)
    assert rows[0] == list(records.answer.table)
    assert len(rows) == 1 + len(records.answer.table)
    assert records.figure()._repr_png_().startswith(PNG)


# ---------------------------------------------------------------- nothing false is certified


@pytest.fixture(scope="module")
def reference() -> sb.Reference:
    stop = sb.Contact([1.0], sb.Stops(None, 0.3, stiffness=100.0))
    return sb.reference(sb.System.from_matrices([[1.0]], [[4.0]], contacts=[stop], initial_velocity=[1.0]), 5.0)


def test_the_reference_itself_passes_and_an_error_does_not(reference):
    within_reference((reference.t, reference.tip), reference, 1e-12)
    with pytest.raises(AssertionError, match="off by"):
        within_reference((reference.t, 1.01 * reference.tip), reference, 1e-3)


@pytest.mark.parametrize(
    ("t", "u"),
    [
        ([0.0, 4.0, 0.0], [0.0, 99.0, 0.0]),  # the last time is no end: the 99 was never looked at
        ([5.0, 0.0], [99.0, 0.0]),
        ([0.0, np.nan, 1.0], [0.0, 99.0, 0.0]),
        ([0.0, 1.0, 2.0], [0.0, np.nan, 0.0]),
        ([0.0, 1.0, 2.0], [0.0, 5.0j, 0.0]),  # the imaginary part was dropped
        ([], []),
    ],
)
def test_runs_that_prove_nothing_are_refused(reference, t, u):
    with pytest.raises(sb.InputError):
        within_reference((np.array(t), np.array(u)), reference, 1e-3)


@pytest.mark.parametrize(("tolerance", "until"), [
    (np.inf, None), (np.nan, None), (0.0, None), (-1.0, None), (1e-3, np.nan), (1e-3, -1.0), (1e-3, 6.0),
])  # fmt: skip
def test_numbers_that_prove_nothing_are_refused(reference, tolerance, until):
    with pytest.raises(sb.InputError, match="tolerance" if until is None else "until"):
        within_reference((reference.t, reference.tip + 9.0), reference, tolerance, until=until)


def test_other_systems_and_unknown_horizons_certify_nothing(reference):
    """Even where the motions are close."""
    unknown = dataclasses.replace(reference, horizon=float("nan"))
    with pytest.raises(sb.InputError, match="horizon"):
        within_reference((reference.t, reference.tip), unknown, 1e-3)
    other = dataclasses.replace(reference.system, v0=np.array([1.0 + 1e-9]))
    with pytest.raises(sb.InputError, match="same system"):
        within_reference(sb.integrate(other, sb.HHT(), 1e-3, 5.0), reference, 0.1)
    within_reference(sb.integrate(reference.system, sb.HHT(), 1e-3, 5.0), reference, 0.1)


# ---------------------------------------------------------------- several contacts


def test_windows_and_matching_hold_for_all_contacts():
    system = two_contacts()
    exact, run = sb.reference(system, 6.0), sb.integrate(system, sb.HHT(), 1e-3, 6.0)
    each = [contact.impacts.times for contact in exact.contacts]
    assert all(len(times) for times in each)
    assert np.array_equal(impact_times(exact), np.sort(np.concatenate(each)))
    n = 5
    end = first_impacts_end(exact, n)
    assert sum(int(np.sum(times < end)) for times in each) == n
    apart = [match(a.impacts, b.impacts, 6.0).matched_until for a, b in zip(run.contacts, exact.contacts, strict=True)]
    assert matched_until(run, exact, 6.0) == min(apart)


@pytest.mark.parametrize("impacts", [1, 2, 3, 4])
def test_a_window_ends_between_impacts_of_several_contacts_at_one_time(impacts):
    """Three equal stops at one unknown are hit together: an end at their impact would be decided by rounding."""
    load, stop = ([1.0], sb.Harmonic(amplitude=1.0, frequency=2.0)), sb.Stops(upper=0.2, stiffness=50.0)
    contacts = [sb.Contact([1.0], stop)] * 3
    system = sb.System.from_matrices([[1.0]], [[1.0]], [[0.05]], loads=[load], contacts=contacts)
    exact = sb.reference(system, 30.0)
    distinct = exact.contacts[0].impacts.times
    last = -(-impacts // 3)
    assert first_impacts_end(exact, impacts) == pytest.approx(0.5 * (distinct[last - 1] + distinct[last]), rel=1e-9)


@pytest.mark.fast(1)
@pytest.mark.parametrize("method", ["exact", "multiprecision", "cvode"])
def test_a_body_that_two_stops_squeeze_from_both_sides_stays_where_it_is(method):
    """Both press 0.1 sin 2t - 0.05 deep, and q = 0: no energy at any switch, 0.25 between them."""
    wave = sb.Harmonic(0.1, 2.0), sb.Harmonic(-0.1, 2.0)
    stops = sb.Stops(upper=0.05, stiffness=100.0), sb.Stops(lower=-0.05, stiffness=100.0)
    pair = [sb.Contact([1.0], stop, offset) for stop, offset in zip(stops, wave, strict=True)]
    system = sb.System.from_matrices([[1.0]], [[1.0]], contacts=pair)
    ref = sb.reference(system, 1.5, method)
    begin = np.arcsin(0.5) / 2.0
    end = np.pi / 2.0 - begin
    impulse = 5.0 * (np.cos(2.0 * begin) - np.cos(2.0 * end)) - 5.0 * (end - begin)
    assert np.max(np.abs(ref.states[0])) < 1e-14
    assert np.max(np.abs(ref.energy.energy)) == pytest.approx(0.25, rel=1e-5)
    assert np.max(np.abs(ref.energy.loss)) < 1e-7
    for record, side in zip(ref.contacts, (1, -1), strict=True):
        assert record.impacts.stops.tolist() == [side]
        assert record.impacts.times == pytest.approx([begin], abs=1e-9)
        assert record.impacts.impulses == pytest.approx([impulse], rel=1e-8)
        assert record.peak_force == pytest.approx(5.0, rel=1e-8)


def row_of_masses(uppers):
    """Masses on springs of their own, each before a stop."""
    n = len(uppers)
    contacts = [sb.Contact(np.eye(n)[i], sb.Stops(upper=u, stiffness=100.0)) for i, u in enumerate(uppers)]
    springs = np.diag(np.arange(2.0, n + 2.0) ** 2)
    return sb.System.from_matrices(np.eye(n), springs, contacts=contacts, initial_velocity=np.ones(n))


def test_the_table_leaves_out_the_contacts_that_nothing_touches():
    system = row_of_masses((0.3, 9.0, 9.0, 0.1, 9.0))
    text = str(sb.compare(sb.integrate(system, sb.Trapezoidal(), 1e-3, 4.0), sb.reference(system, 4.0)))
    lines = [line.strip() for line in text.splitlines()]
    for i in (0, 3):  # of reference and run, to the horizon and in all
        assert sum(line.startswith(f"contact {i}, row ") for line in lines) == 4
    assert "Never touched: 3 of 5 contacts." in lines
    free = row_of_masses((9.0, 9.0))
    lines = str(sb.compare(sb.integrate(free, sb.Trapezoidal(), 1e-3, 4.0), sb.reference(free, 4.0))).splitlines()
    assert not any("contact 0" in line or "Never touched" in line for line in lines)
    assert lines[0] == "No impacts: the motion reaches no stop to t = 4."


def test_a_solver_that_ends_early_cuts_no_other_error_short():
    system = two_contacts()
    exact, run = sb.reference(system, 6.0), sb.integrate(system, sb.HHT(), 1e-4, 6.0)
    early = sb.reference(system, 0.5, "dop853")
    whole, short = sb.compare(run, exact), sb.compare(early, exact)
    assert short.window < 0.6 < whole.matched_until
    assert common_window([whole, short]) == common_window([whole])


# ---------------------------------------------------------------- arguments of another type


CHAIN = bouncing_chain()
MOTION = sb.reference(CHAIN, 0.1)
EYE = np.eye(3)
STIFF = np.diag([1.0, 2.0, 3.0])
CALLS = {
    "want": lambda x: sb.study("advise", CHAIN, t_end=1.0, want=x),
    "schemes": lambda x: sb.study("advise", CHAIN, t_end=1.0, want={"tip": 1e-2}, schemes=x),
    "contacts": lambda x: sb.study("advise", CHAIN, t_end=1.0, want={"tip": 1e-2}, contacts=x),
    "case": lambda x: sb.study("doubt", x, dt=1e-2, t_end=1.0, uncertain={"stiffness": (2.9, 3.1)}),
    "period": lambda x: sb.periodic_orbit(CHAIN, x),
    "mass": lambda x: sb.modal_damping(x, EYE, 0.02),
    "t_end": lambda x: sb.perturbed_members(CHAIN, 2, t_end=x),
    "parameters": lambda x: sb.varied_members(CHAIN, x),
    "run": sb.contact_rates,
    "tangents": lambda x: sb.contact_rates(MOTION, tangents=x),
    "problems": lambda x: sb.score("hht", x),
    "tip": lambda x: sb.Trajectory.from_arrays([0.0, 0.1, 0.2], x, x, CHAIN),
    "wrt": MOTION.derivative,
    "file": lambda x: MOTION.animate(x),
    "beside": lambda x: MOTION.animate("film.gif", x),
    "loads": lambda x: sb.reduce_model(EYE, STIFF, loads=x, modes=1),
    "contacts of a model": lambda x: sb.reduce_model(EYE, STIFF, contacts=x, modes=1),
    "observe": lambda x: sb.reduce_model(EYE, STIFF, observe=x, modes=1),
    "stiffness": lambda x: sb.reduce_model(EYE, x, modes=1),
    "damping": lambda x: sb.reduce_model(EYE, STIFF, x, modes=1),
    "initial_velocity": lambda x: sb.reduce_model(EYE, STIFF, initial_velocity=x, modes=1),
}
WRONG = [-1.0, [1j, "x"], object()]


@pytest.mark.parametrize("argument", CALLS)
@pytest.mark.parametrize("wrong", WRONG, ids=["number", "list", "object"])
def test_an_argument_of_another_type_is_named(argument, wrong):
    with pytest.raises(sb.InputError) as error:
        CALLS[argument](wrong)
    first = {
        "beside": ("beside", "runs"),
        "problems": ("problems", "problem"),
        "schemes": ("schemes", "integrator"),
        "observe": ("observe", "loads, contacts and observe"),
    }
    assert error.value.field.partition(".")[0] in first.get(argument, (argument.partition(" ")[0],))
    assert error.value.remedy


# ---------------------------------------------------------------- films


@pytest.mark.slow
def test_a_film_has_its_frames_and_they_move(tmp_path, table10):
    system = sb.semidiscretise(table10, 8)
    run, exact = sb.integrate(system, sb.HHT(alpha=-0.1), 1e-4, 0.1), sb.reference(system, 0.1)
    file = exact.animate(tmp_path / "beam.gif", [run], frames=4)
    with Image.open(file) as film:
        assert film.n_frames == 4
        frames = [np.asarray((film.seek(k), film.convert("L"))[1], float) for k in range(4)]
    changed = [np.mean(np.abs(a - b) > 20.0) for a, b in pairwise(frames)]
    assert all(0.0 < share < 0.2 for share in changed)  # curves move, axes stand still
    assert [path.name for path in tmp_path.iterdir()] == ["beam.gif"]


def test_what_cannot_be_filmed_is_refused(tmp_path, monkeypatch, table10):
    run = sb.integrate(sb.semidiscretise(table10, 8), sb.HHT(), 1e-3, 0.02)
    with pytest.raises(InputError, match="where ffmpeg is installed"):
        run.animate(tmp_path / "beam.avi")
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda _: False))
    with pytest.raises(InputError, match=r"name it beam\.gif"):
        run.animate(tmp_path / "beam.mp4")
    for others in ([sb.integrate(sb.semidiscretise(table10, 9), sb.HHT(), 1e-3, 0.02)], []):
        one = run if others else sb.integrate(two_contacts(), sb.BDF2(), 1e-2, 2.0)
        with pytest.raises(InputError, match="one beam"):
            one.animate(tmp_path / "beam.gif", others)
    assert not list(tmp_path.iterdir())
