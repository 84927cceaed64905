"""Runs from arrays: what they allow is what the package's own run of the same numbers gives."""

from __future__ import annotations

import json
import pickle
import re
from dataclasses import asdict, astuple, replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from systems import two_contacts

import stiffbeam as sb


@pytest.fixture(scope="module")
def measured(table10):
    system = sb.semidiscretise(table10, 10)
    return system, sb.integrate(system, sb.HHT(-0.1), 1e-4, 0.2), sb.reference(system, 0.2)


def test_arrays_with_states_give_every_measure_of_the_run_itself(measured):
    system, run, ref = measured
    own = sb.Trajectory.from_arrays(run.t, *run.states, system, name="mine")
    a, b = sb.compare(run, ref).to_dict(), sb.compare(own, ref).to_dict()
    assert b["label"] == "mine@displacement"
    assert b["missing"] == []
    different = {"label", "steps", "seconds", "ns_per_step", "missing"}
    for name in a.keys() - different:
        for x, y in zip(numbers(a[name]), numbers(b[name]), strict=True):
            assert x == y or abs(x - y) <= 1e-9 * abs(x), name  # the ledger is added up in another order
    assert np.array_equal(own.displacement(1.0), run.displacement(1.0))
    assert np.max(np.abs(own.tip - run.tip)) < 1e-12 * np.max(np.abs(run.tip))
    assert sb.compare([run.t, *run.states], ref).to_dict() == b | {"label": "own@displacement"}


def test_thinned_times_are_told_from_the_impacts_that_they_cannot_show(measured):
    _, run, ref = measured
    whole, thin = (sb.compare((run.t[::n], run.tip[::n], run.tip_velocity[::n]), ref) for n in (1, 200))
    say = [[note for note in c.missing if "at the run's times" in note] for c in (whole, thin)]
    assert say[0] == []
    assert re.search(r"shows \d+ of its \d+ impacts; pass every step", say[1][0])


def numbers(value):
    if isinstance(value, (dict, list)):
        return [x for item in (value.values() if isinstance(value, dict) else value) for x in numbers(item)]
    return [value] if isinstance(value, (int, float)) and not isinstance(value, bool) else []


def test_the_tip_alone_gives_what_it_allows_and_says_what_it_does_not(measured):
    _, run, ref = measured
    whole, bare = sb.compare(run, ref), sb.compare((run.t, run.tip), ref)
    assert bare.tip_error_rms == whole.tip_error_rms
    (found,), own = bare.contacts, whole.contacts[0]
    for name in ("run", "run_totals", "reference"):  # sums over the same steps in another order
        assert asdict(getattr(found, name)) == pytest.approx(asdict(getattr(own, name)), rel=1e-11)
    assert found.matching.matched == own.matching.matched
    # Crossing times by the spline's slope: of the order dt^2 u''/u'.
    assert abs(found.matching.median_delay - own.matching.median_delay) < 1e-5
    assert np.isnan(bare.energy_lost)
    assert [m.partition(":")[0] for m in bare.missing] == ["energy", "tip velocity"]
    assert "came without states" in str(bare)
    assert json.loads(json.dumps(bare.to_dict(), allow_nan=False))["energy_lost"] is None
    with_velocity = sb.compare((run.t, run.tip, run.tip_velocity), ref)
    assert astuple(with_velocity.contacts[0].matching) == pytest.approx(astuple(own.matching), rel=1e-9, abs=1e-14)
    assert with_velocity.phase.undefined == whole.phase.undefined


def thinned(run):
    """Rows that stay: every step beside a stop, where sampled impacts need them, and one to eight elsewhere."""
    near = np.abs(np.abs(run.tip) - 0.1) < 0.02
    near |= np.convolve(near, np.ones(3), "same") > 0.0
    kept = np.random.default_rng(1).random(len(run.t)) < 0.2
    kept[::8] = True
    return near | kept


def with_events(t, u, v, events):
    """The rows and, at each event, two more: the second at the same time, or later by rounding."""
    at = CubicHermiteSpline(t, u, v)
    again = np.nextafter(events, np.inf)
    again[::2] = events[::2]
    times = np.concatenate([t, events, again])
    order = np.argsort(times, kind="stable")
    return (
        times[order],
        np.append(u, at(np.append(events, events)))[order],
        np.append(v, at(np.append(events, events), 1))[order],
    )


@pytest.mark.parametrize("kind", ["thinned", "events", "single precision", "digits"])
def test_a_run_at_times_of_its_own_gives_the_measures_of_its_equidistant_steps(measured, kind):
    """Times off by r move u by at most r max |u'|, and an impact by r beside the cubic's own error."""
    system, run, ref = measured
    if kind == "digits":
        run = sb.integrate(system, sb.HHT(-0.1), 0.2 / 2400, 0.2)
    rows = thinned(run)
    t, u, v = run.t[rows], run.tip[rows], run.tip_velocity[rows]
    moved, largest, fastest = 0.0, np.max(np.abs(run.tip)), np.max(np.abs(run.tip_velocity))
    if kind == "events":
        t, u, v = with_events(t, u, v, run.impacts.times)
    elif kind == "single precision":
        t, u, v = (x.astype(np.float32) for x in (t, u, v))
        moved = 2.0**-24 * (run.t[-1] + largest / fastest)
    elif kind == "digits":
        t = np.round(t, 5)
        moved = 5e-6
    whole, own = sb.compare(run, ref), sb.compare((t, u, v), ref)
    assert own.window == whole.window
    assert np.all(np.diff(own.pair[0].t) > 0.0)
    assert own.tip_error_max <= whole.tip_error_max * (1 + 1e-9) + moved * fastest / largest
    # The mean over time by steps of up to 8e-4: the trapezoid of e^2, whose shortest waves last some 1e-2.
    assert own.tip_error_rms == pytest.approx(whole.tip_error_rms, rel=0.02, abs=moved * fastest / largest)
    assert own.tip_error_to(0.1) == pytest.approx(whole.tip_error_to(0.1), rel=0.02, abs=moved * fastest / largest)
    (a,), (b,) = whole.contacts, own.contacts
    assert b.run.impacts == a.run.impacts > 3
    between = CubicHermiteSpline(run.t, run.tip, run.tip_velocity)(np.linspace(0.0, whole.window, 400001))
    force = np.abs(run.contacts[0].stops.force(between))
    # The trapezoid under a half sine from zero to zero over m steps is less than its integral by pi^2/(12 m^2) of it.
    share = np.mean(force > 0.0)
    steps = share * whole.window / a.run.impacts / 1e-4
    trapezoid = np.pi**2 / (12.0 * steps**2)
    assert b.run.impulse == pytest.approx(np.mean(force) * whole.window, rel=trapezoid)
    # A row at an event is on the stop but for rounding: the piece of a step before it is in contact or is not.
    events = run.impacts.times if kind == "events" else np.zeros(0)
    pieces = np.sum(events - run.t[np.searchsorted(run.t, events) - 1]) / whole.window
    assert share * (1.0 - trapezoid) - pieces <= b.run.fraction <= share * (1.0 + trapezoid)
    assert b.run.peak_force == pytest.approx(a.run.peak_force, rel=1e-3)
    assert np.max(np.abs(own.pair[0].impacts.times - run.impacts.times)) <= 1e-9 + 2.0 * moved
    assert b.matching.matched == a.matching.matched
    assert b.matching.median_delay == pytest.approx(a.matching.median_delay, abs=1e-6 + 2.0 * moved)


@pytest.mark.fast(4)
@pytest.mark.parametrize("given", ["velocity", "states"])
@pytest.mark.parametrize("whose", ["scheme", "exact", "uneven"])
def test_a_run_against_rigid_stops_has_its_impacts_read_from_its_steps(given, whose):
    """A ball bounces five times. Of the exact motion's arrays they are its impacts; a scheme's are late by its own half
    step and less."""
    system = sb.problem("bouncing-ball").system
    ref, run = sb.reference(system, 1.3), sb.integrate(system, sb.MoreauJean(0.5), 1e-3, 1.3)
    t = run.t if whose != "uneven" else np.cumsum(np.append(0.0, np.random.default_rng(2).uniform(2e-4, 1.8e-3, 1400)))
    t = np.append(t[t < 1.2999], 1.3)
    q, v = (x[: len(t)] for x in run.states) if whose == "scheme" else ref.state_at(t)
    own = sb.Trajectory.from_arrays(t, *((q, v) if given == "states" else (q[:, 0], v[:, 0])), system)
    times = own.impacts.times
    found = sb.compare(own, ref)
    assert len(times) == found.contacts[0].run.impacts == found.contacts[0].reference.impacts == 5
    assert set(own.impacts.stops) == {-1}
    late = np.max(np.abs(times - ref.impacts.times))
    # 1.5 a steps^2/v in a step of free fall.
    assert late < (5e-3 if whose == "scheme" else 5e-5)
    assert found.matched_until == 1.3
    assert found.tip_error_rms < (3e-3 if whose == "scheme" else 1e-12)
    assert np.isnan([found.contacts[0].run.impulse, found.contacts[0].run.fraction, found.energy_lost]).all()
    assert any("nor impulse of a rigid stop" in note for note in found.missing)
    assert any(note.startswith("energy: ") for note in found.missing)
    assert json.dumps(found.to_dict(), allow_nan=False)
    assert found.figure().axes


def test_a_rigid_contact_away_from_the_tip_is_unknown_without_states():
    stops = [sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.5)] * 2
    contacts = [sb.Contact(row, stop) for row, stop in zip(np.eye(2), stops, strict=True)]
    fall = [([-9.81, -9.81], sb.Constant(1.0))]
    system = sb.System.from_matrices(np.eye(2), np.zeros((2, 2)), None, fall, contacts, initial_displacement=[1.0, 0.4])
    ref = sb.reference(system, 0.6)
    t = np.linspace(0.0, 0.6, 601)
    own = sb.compare((t, *ref.at(t)), ref)
    assert [c.run.impacts for c in own.contacts] == [1, -1]
    bare = sb.compare((t, ref.at(t)[0]), ref)  # whose velocities, a spline's, have no jump
    assert [c.run.impacts for c in bare.contacts] == [-1, -1]
    assert any("velocities at a rigid stop" in note for note in bare.missing)
    assert np.isnan(own.matched_until)
    whole = sb.compare(sb.Trajectory.from_arrays(t, *ref.state_at(t), system), ref)
    assert [c.run.impacts for c in whole.contacts] == [1, 2]


def test_states_at_times_of_ones_own_give_their_ledger(measured):
    """The ledger of a part of the steps, from its definition: a free oscillation loses what the scheme takes."""
    system, run, _ = measured
    rows = thinned(run)
    q, v = (x[rows] for x in run.states)
    own = sb.Trajectory.from_arrays(run.t[rows], q, v, system)
    assert np.array_equal(own.states[0], q)
    assert np.array_equal(own.energy.t, run.t[rows])
    assert np.allclose(own.energy.energy, run.energy.energy[rows], rtol=1e-12)
    dq, load = np.diff(q, axis=0), system.load(run.t[rows])
    work = np.cumsum(0.5 * np.sum((load[1:] + load[:-1]) * dq, axis=1))
    assert np.allclose(own.energy.input[1:], work, rtol=1e-9, atol=1e-12 * np.max(np.abs(work)))


def test_a_contact_that_the_tip_does_not_show_is_unknown_and_not_free():
    system = two_contacts()
    elsewhere = replace(system, observe=np.eye(system.size)[0] + 0.5 * np.eye(system.size)[-1])
    ref = sb.reference(elsewhere, 2.0)
    t = np.linspace(0.0, 2.0, 2001)
    found = sb.compare((t, ref.at(t)[0]), ref)
    assert found.tip_error_rms < 1e-12
    assert np.isnan(found.matched_until)
    assert "right to" not in str(found)  # an empty column is left out
    for contact in found.contacts:
        assert contact.run.impacts == -1
        assert np.isnan(contact.run.fraction)
        assert np.isnan(contact.matching.median_delay)
    assert any(m.startswith("contact") for m in found.missing)
    whole = sb.compare(sb.Trajectory.from_arrays(t, *ref.state_at(t), elsewhere), ref)
    assert whole.matched_until == whole.window


def test_a_run_of_ones_own_travels_and_is_saved(measured, tmp_path):
    system, run, ref = measured
    own = pickle.loads(pickle.dumps(sb.Trajectory.from_arrays(run.t, run.tip, run.tip_velocity, system)))
    assert own.impacts.count == run.impacts.count
    again = sb.load(own.save(tmp_path / "own.nc"))
    assert np.array_equal(again.tip, run.tip)
    assert sb.compare(again, ref).tip_error_rms == sb.compare(run, ref).tip_error_rms
    for quantity in ("energy", "states"):
        with pytest.raises(sb.InputError, match="pass q and v"):
            getattr(own, quantity)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (([0.0, 0.2, 0.1], [0.0, 1.0, 2.0]), "t"),
        (([0.0, 0.1, 0.1, 0.2], [0.0, 1.0, 2.0, 3.0]), "t"),
        (([0.0, 0.1, 0.1], [0.0, 1.0, 1.0]), "t"),
        (([0.1, 0.2, 0.3], [0.0, 1.0, 2.0]), "t"),
        (([0.0, 0.1, 0.2], [0.0, 1.0]), "tip"),
        (([0.0, 0.1, 0.2], [0.0, np.nan, 1.0]), "tip"),
        (([0.0, 0.1, 0.2], [0.0, 0.0, 1.0], [0.0]), "tip_velocity"),
        (([0.0, 0.1, 0.2], None), "tip"),
        (([0.0, 0.1, 0.2], "abc"), "tip"),
        (([0.0, 0.1, 0.2], [0.0, 0.0, 1.0], None, "system"), "system"),
        (([0.0, 0.1, 0.2], np.zeros((3, 2))), "tip"),
    ],
)
def test_what_is_no_run_is_refused(arguments, field):
    with pytest.raises(sb.InputError) as caught:
        sb.Trajectory.from_arrays(*arguments)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("change", "differs"),
    [
        ({"stiffness": 2.0}, "stiffness, loads"), ({"viscosity": 0.1}, "damping, loads"), ({"tip_mass": 0.1}, "mass"),
        ({"base": sb.Harmonic(0.2, 10.0)}, "initial data, loads"),
        ({"stops": sb.Stops(-0.2, 0.1, stiffness=100.0)}, "contacts"),
        ({"initial_velocity": sb.PolynomialProfile((0.0, 0.0, 1.0))}, "initial data"),
        ({"stiffness": "1.1"}, "exact parameters"), ({}, r"unknowns \(8 and 6\)"),
    ],
)  # fmt: skip
def test_the_refusal_of_another_system_says_what_differs(change, differs):
    given = {"stiffness": 1.1 if "exact" in differs else 1.0, "base": sb.Harmonic(0.1, 10.0)}
    given["stops"] = sb.Stops(-0.1, 0.1, stiffness=100.0)
    one, other = (
        sb.semidiscretise(sb.BeamProblem(**problem), cells)
        for problem, cells in ((given, 8), (given | change, 8 if change else 6))
    )
    run, exact = sb.integrate(one, sb.HHT(), 1e-3, 0.01), sb.reference(other, 0.01)
    with pytest.raises(sb.InputError, match=f"same system as .*; they differ in: {differs}"):
        sb.compare(run, exact)


def test_the_only_unknown_is_the_tip_and_its_arrays_are_states():
    """No spline is put through the tip, and the energy is known."""
    system = sb.System.from_matrices([[1.0]], [[9.0]], observe=[1.0], initial_velocity=[1.0])
    t = np.linspace(0.0, 2.0, 9)  # far too few for a spline
    q, v = np.sin(3.0 * t) / 3.0, np.cos(3.0 * t)
    for columns in ((q, v), (q[:, None], v[:, None])):
        run = sb.Trajectory.from_arrays(t, *columns, system)
        assert np.array_equal(run.tip_velocity, v)
        assert "tip_velocity" not in run.provenance
        assert np.allclose(run.energy.energy, 0.5 * (v**2 + 9.0 * q**2))


def test_what_compare_cannot_take_comes_with_a_remedy(measured):
    _, run, ref = measured
    for wrong, words in (
        ("run.csv", r"load\(\) reads a saved run"),
        (np.column_stack([run.t, run.tip]), r"its arrays \[t, tip\]"),
        ([1e6 * run.t, run.tip], "times in the unit of the reference"),
    ):
        with pytest.raises(sb.InputError, match=words):
            sb.compare(wrong, ref)  # type: ignore[arg-type]
