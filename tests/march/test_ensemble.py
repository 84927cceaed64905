"""Ensembles: every member is its solo run, to rounding."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from systems import two_contacts

import stiffbeam as sb
from stiffbeam.references.exact.solution import solve_exact


@pytest.fixture(scope="module")
def system(table10) -> sb.System:
    return sb.semidiscretise(table10, 25)


ROUNDING = 1e-11  # of the largest value: what other orders of summation do before impacts magnify it
GROWTH = 100.0  # per unit of time: the beam of Table 10 has a Lyapunov exponent of 72 +- 11
SEEN = 1e-4  # of the largest value: larger differences are not looked at, since chaos has made them


def close(a, b, t, growth=GROWTH):
    """True where a and b (..., k) at times t (k,) differ by no more than rounding and its growth."""
    bound = ROUNDING * np.exp(growth * np.asarray(t))
    scale = np.nanmax(np.abs(b), initial=1e-300)
    return np.all((np.abs(a - b) <= bound * scale) | (bound > SEEN) | (np.isnan(a) & np.isnan(b)))


def assert_is_run(ensemble, i, run, growth=GROWTH):
    """Member i of an ensemble with outputs is a run of it alone, while rounding has not grown."""
    assert close(ensemble.tip[i], run.tip, run.t, growth)
    assert close(ensemble.tip_velocity[i], run.tip_velocity, run.t, growth)
    until = np.log(SEEN / ROUNDING) / growth
    for statistics, record in zip(ensemble.contacts, run.contacts, strict=True):
        own, other = statistics.impacts_of(i).until(until), record.impacts.until(until)
        assert np.array_equal(own.stops, other.stops)
        for name in ("times", "peaks", "impulses"):
            assert close(getattr(own, name), getattr(other, name), other.times, growth), name
        if until >= run.t[-1]:
            ours = statistics.fraction[i], statistics.peak_force[i], statistics.impulse[i]
            assert ours == pytest.approx((record.fraction, record.peak_force, record.impulse), rel=SEEN)
    ledger = ensemble.ledger(i)
    for field in fields(ledger):
        assert close(getattr(ledger, field.name), getattr(run.energy, field.name), run.energy.t, growth), field.name


def members_of(kind: str, system: sb.System) -> sb.EnsembleMembers:
    if kind == "perturbed":
        return sb.perturbed_members(system, 9, 1e-10)
    if kind == "frequency":
        return sb.varied_members(system, {"frequency": np.linspace(9.0, 11.0, 9)})
    if kind == "amplitude":
        return sb.varied_members(system, {"amplitude": np.linspace(0.15, 0.25, 9)})
    gaps, stiffness = np.linspace(0.08, 0.12, 9), np.geomspace(1e6, 1e7, 9)
    return sb.varied_members(system, stops=[sb.Stops(-g, g, stiffness=k) for g, k in zip(gaps, stiffness, strict=True)])


KINDS = ("perturbed", "frequency", "amplitude", "stops")


def test_members_with_laws_of_several_kinds_keep_their_places(system):
    """They are marched apart, those of one kind together."""
    linear, hertz = sb.Stops(-0.1, 0.1, stiffness=5e6), sb.Stops(-0.1, 0.1, stiffness=1e7, exponent=1.5)
    damped = sb.Stops(-0.1, 0.1, stiffness=5e6, damping=100.0)
    members = sb.varied_members(system, stops=[hertz, linear, damped, linear, hertz, damped, linear])
    ensemble = sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-4, 0.3, members, every=10)
    assert len(set(ensemble.impact_count.tolist())) == 3
    for i in range(len(members)):
        assert_is_run(ensemble, i, sb.integrate(members[i], sb.HHT(-0.1), 1e-4, 0.3, every=10))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scheme", [sb.HHT(-0.1), sb.BDF2(), sb.SDIRK(nystrom=True)], ids=str)
@pytest.mark.parametrize("contact", ["implicit", "extrapolated"])
@pytest.mark.fast(8)
def test_a_member_is_its_solo_run(kind, scheme, contact, system):
    members = members_of(kind, system)
    ensemble = sb.integrate_ensemble(system, scheme, 1e-4, 1.0, members, contact, every=10)
    assert len(ensemble) == 9
    assert np.min(ensemble.impact_count) > 20
    assert len(np.unique(ensemble.impulse)) == 9
    for i in (0, 4, 8):
        if np.isnan(ensemble.diverged[i]):
            assert_is_run(ensemble, i, sb.integrate(members[i], scheme, 1e-4, 1.0, contact, every=10))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_an_exact_member_is_its_solo_run(kind, system):
    members = members_of(kind, system)
    t = np.linspace(0.0, 0.5, 51)
    ensemble = sb.reference_ensemble(system, 0.5, members, t)
    assert ensemble.label == "exact@displacement"
    for i in (0, 4, 8):
        assert_is_run(ensemble, i, solve_exact(members[i], 0.5, t))


@pytest.mark.parametrize("kind", KINDS)
def test_the_schemes_ensemble_converges_to_the_exact_one(kind, system):
    """Through the first impacts: half the step, a quarter of the error or less in the worst member."""
    members = members_of(kind, system)
    exact = sb.reference_ensemble(system, 0.08, members, np.linspace(0.0, 0.08, 801))
    assert np.min(exact.impact_count) > 1
    errors = []
    for dt in (5e-6, 2.5e-6):
        run = sb.integrate_ensemble(system, sb.SDIRK(nystrom=True), dt, 0.08, members, every=round(1e-4 / dt))
        errors.append(np.max(np.abs(run.tip - exact.tip)) / np.max(np.abs(exact.tip)))
    assert np.allclose(run.impulse, exact.impulse, rtol=1e-2)
    assert errors[1] < 5e-4
    assert errors[0] > 4.0 * errors[1]


def test_slices_and_stretches_of_any_size_give_the_same_runs(system, monkeypatch):
    from stiffbeam.march import block_march
    from stiffbeam.march import ensemble as module

    members = sb.perturbed_members(system, 20)
    whole = sb.integrate_ensemble(system, sb.BDF2(), 1e-4, 0.5, members, every=5)
    monkeypatch.setattr(module, "MEMBERS_PER_SLICE", 3)
    monkeypatch.setattr(block_march, "STEPS_PER_CALL", 1)
    monkeypatch.setattr(block_march, "STEPS_REPLAYED", 96)
    other = sb.integrate_ensemble(system, sb.BDF2(), 1e-4, 0.5, members, every=5)
    for i in (0, 3, 19):
        assert close(whole.tip[i], other.tip[i], whole.t)
        ours, theirs = (x.contacts[0].impacts_of(i).until(0.15) for x in (whole, other))
        assert ours.count == theirs.count > 0
        assert close(ours.times, theirs.times, theirs.times)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("contact", ["implicit", "extrapolated"])
def test_the_kernel_in_numpy_is_equal_to_rounding(kind, contact, system, in_numpy):
    """Through the first impacts, before chaos has made rounding visible."""
    members = members_of(kind, system)
    t_end = 0.06 if contact == "implicit" else 0.056
    for scheme in (sb.HHT(-0.1), sb.BDF2(), sb.SDIRK(nystrom=True)):
        ours = sb.integrate_ensemble(system, scheme, 1e-4, t_end, members, contact, every=7)
        with in_numpy():
            other = sb.integrate_ensemble(system, scheme, 1e-4, t_end, members, contact, every=7)
        assert np.sum(ours.impact_count) > 9
        assert np.array_equal(ours.impact_count, other.impact_count)
        tolerance = 1e-9 if contact == "implicit" else 1e-6
        for name in ("tip", "tip_velocity", "peak_force", "impulse", "contact_fraction"):
            a, b = getattr(ours, name), getattr(other, name)
            assert np.max(np.abs(a - b)) < 1e3 * tolerance * np.max(np.abs(a))
        assert np.max(np.abs(ours.tip - other.tip)) < tolerance * np.max(np.abs(ours.tip))
        assert np.allclose(ours.impacts.times, other.impacts.times, rtol=0, atol=tolerance)


def test_the_company_of_a_member_does_not_change_it(system, monkeypatch):
    """Seven marched together in stretches whose length no block divides."""
    from stiffbeam.march import block_march

    monkeypatch.setenv("STIFFBEAM_THREADS", "1")
    monkeypatch.setattr(block_march, "STEPS_REPLAYED", 64)
    monkeypatch.setattr(block_march, "STEPS_PER_CALL", 7 * 70)
    members = sb.varied_members(system, {"frequency": np.linspace(9.0, 11.0, 28)})  # four slices of seven
    many = sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-4, 0.6, members, every=5)
    for i in (0, 6, 27):
        assert_is_run(many, i, sb.integrate(members[i], sb.HHT(-0.1), 1e-4, 0.6, every=5))


@pytest.mark.parametrize("load", [None, lambda t: 15.0 * np.sin(4.0 * t)], ids=["harmonic", "sampled"])
def test_several_contacts_a_moving_stop_and_sampled_loads(load):
    system = two_contacts() if load is None else two_contacts(load=load)
    members = sb.perturbed_members(system, 5, 1e-8)
    ensemble = sb.integrate_ensemble(system, sb.HHT(-0.1), 2e-3, 3.0, members, every=1)
    for i in (0, 4):
        assert_is_run(ensemble, i, sb.integrate(members[i], sb.HHT(-0.1), 2e-3, 3.0), growth=5.0)
    assert all(np.all(c.impact_count > 0) for c in ensemble.contacts)


def test_damping_that_does_not_decouple_is_marched_in_dense_blocks():
    mass, stiffness = np.eye(2), np.array([[200.0, -100.0], [-100.0, 100.0]])
    system = sb.System.from_matrices(
        mass, stiffness, np.diag([0.0, 1.0]), loads=[([0.0, 1.0], sb.Harmonic(50.0, 6.0))],
        contacts=[sb.Contact([0.0, 1.0], sb.Stops(upper=0.1, stiffness=1e4))],
    )  # fmt: skip
    members = sb.varied_members(system, {"frequency": [5.0, 6.0, 7.0]})
    ensemble = sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-3, 2.0, members, every=4)
    assert ensemble.provenance["march"] == "dense blocks"
    assert_is_run(ensemble, 2, sb.integrate(members[2], sb.HHT(-0.1), 1e-3, 2.0, every=4), growth=7.0)


def test_perturbations_are_of_the_stated_size(system):
    """omega eta and eta' move by size V r, |r| <= 1, V the largest modal speed of start and drive."""
    from stiffbeam.model.modes import modes

    basis = modes(system)
    members = sb.perturbed_members(system, 400, 1e-6, seed=3)
    start = np.max(np.hypot(basis.omega * basis.to_modal(system.q0), basis.to_modal(system.v0)))
    drive = sum(
        np.abs(basis.force(p)) * abs(f.amplitude) / np.maximum(basis.omega, f.frequency) for p, f in system.loads
    )
    V = max(start, np.max(drive))
    eta = np.array([basis.to_modal(m.q0 - system.q0) for m in members]) * basis.omega / (1e-6 * V)
    rate = np.array([basis.to_modal(m.v0 - system.v0) for m in members]) / (1e-6 * V)
    for r in (eta, rate):
        assert 0.99 < np.max(np.abs(r)) < 1.0 + 1e-6
        assert np.allclose(np.mean(r, axis=0), 0.0, atol=5 * 3**-0.5 / 20)  # five standard errors
        assert np.allclose(np.std(r, axis=0), 3**-0.5, atol=0.1)
    again = sb.perturbed_members(system, 3, 1e-6, seed=3)
    assert all(np.array_equal(a.q0, b.q0) for a, b in zip(again, members[:3], strict=True))


def test_a_system_at_rest_at_zero_is_perturbed_in_proportion_to_its_load():
    def system(load):
        return sb.System.from_matrices([[1.0]], [[4.0]], loads=[([1.0], load)], observe=[1.0])

    small, large = (sb.perturbed_members(system(sb.Harmonic(a, 3.0)), 1, 1e-3) for a in (1.0, 10.0))
    assert np.isclose(large[0].v0[0], 10.0 * small[0].v0[0], rtol=1e-12)
    assert 0.0 < abs(small[0].v0[0]) <= 1e-3 * 1.0 / 3.0
    with pytest.raises(sb.InputError, match="scale"):
        sb.perturbed_members(system(lambda t: np.sin(3.0 * t)), 1)
    assert sb.perturbed_members(system(lambda t: np.sin(3.0 * t)), 1, scale=1.0)[0].v0[0] != 0.0


def test_a_function_in_python_has_the_scale_of_its_samples():
    """A load beside a constant one, and the motion of a stop: the members are those of the samples."""
    t = np.linspace(0.0, 7.0, 4001)  # as many as ``scales`` takes
    for f in (lambda t: np.sin(3.0 * t), lambda t: np.where(t < 2.0, 5.0 * t, 0.0)):
        pair = [f, sb.Sampled(t, f(t))]
        for arguments in (
            lambda g: {"loads": [([1.0], sb.Constant(2.0)), ([1.0], g)], "observe": [1.0]},
            lambda g: {"contacts": [sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=9.0), offset=g)]},
        ):
            systems = [sb.System.from_matrices([[1.0]], [[4.0]], **arguments(g)) for g in pair]
            one, other = (sb.perturbed_members(system, 2, t_end=7.0) for system in systems)
            assert np.array_equal(one[1].v0, other[1].v0)
            assert one[1].v0[0] != 0.0


def test_a_member_that_overflows_leaves_the_others_alone():
    case = sb.paper_case(11)
    system = sb.semidiscretise(case.problem, case.cells)
    stops = [case.problem.stops, sb.Stops(-10.0, 10.0, stiffness=2e7)]
    members = sb.varied_members(system, stops=stops)
    ensemble = sb.integrate_ensemble(system, sb.HHT(-0.1), 2.5e-4, case.t_end, members, "extrapolated")
    with pytest.raises(sb.Diverged) as caught:
        sb.integrate(members[0], sb.HHT(-0.1), 2.5e-4, case.t_end, "extrapolated")
    assert ensemble.diverged[0] == caught.value.t
    assert np.isnan(ensemble.diverged[1])
    assert ensemble.tip.shape == (2, 0)


def test_the_statistics_of_an_ensemble_are_those_of_its_impacts(system):
    ensemble = sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-4, 1.0, sb.perturbed_members(system, 6))
    peaks = [np.nanmax(ensemble.contact.impacts_of(i).peaks) for i in range(6)]
    assert np.all(peaks <= ensemble.peak_force)
    assert ensemble.impacts.count == np.sum(ensemble.impact_count)
    assert ensemble.work.steps == 60_000
    done = []
    sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-4, 0.1, sb.perturbed_members(system, 6), progress=done.append)
    assert done[-1] == 6000
    assert done == sorted(done)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda s: sb.perturbed_members(s, 0), "members"),
        (lambda s: sb.varied_members(s), "parameters"),
        (lambda s: sb.varied_members(s, {"frequency": [1.0]}, stops=[]), "varied"),
        (lambda s: sb.varied_members(s, {"frequency": [-1.0]}), "frequency"),
        (lambda s: sb.varied_members(s, stops=[0.1]), "stops"),
        (lambda s: sb.integrate_ensemble(s, sb.HHT(), 1e-4, 0.1, []), "members"),
        (lambda s: sb.integrate_ensemble(s, sb.HHT(), 1e-4, 0.1, [sb.semidiscretise(s.problem, 8)]), "members"),
        (lambda s: sb.varied_members(two_contacts(), {"frequency": [1.0]}), "frequency"),
    ],
)
def test_bad_arguments_are_named(make, field, system):
    with pytest.raises(sb.InputError, match=field):
        make(system)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", [sb.HHT(-0.1), sb.BDF2(), sb.SDIRK(nystrom=True)], ids=str)
def test_contacts_recorded_from_a_time_on_are_those_of_every_step_after_it(scheme, kernel, system):
    """A window that begins inside a block and during a contact, against all steps of the same run."""
    dt, t_end, passed = 1e-4, 0.4, 1203

    def march(since, every=None):
        return sb.integrate_ensemble(system, scheme, dt, t_end, [system], every=every, since=since)

    whole, stops = march(0.0, every=1), system.contacts[0].stops
    side, force = stops.state(whole.tip[0]), np.abs(stops.force(whole.tip[0]))
    passed += int(np.argmax(side[passed:] != 0)) + 1
    assert passed % 16
    assert side[passed - 1]
    late, force = side[passed:], force[passed + 1 :]
    window = march(passed * dt)
    assert window.contact_fraction[0] == np.mean(late[1:] != 0)
    assert window.peak_force[0] == np.max(force)
    assert window.impulse[0] == pytest.approx(np.sum(force) * dt, rel=1e-12)
    assert window.impact_count[0] == np.sum((late[1:] != 0) & (late[1:] != late[:-1])) > 10
    begun = whole.impacts.times > passed * dt
    assert np.array_equal(window.impacts.times, whole.impacts.times[begun])
    assert np.array_equal(window.impacts.stops, whole.impacts.stops[begun])
    assert np.allclose(window.impacts.peaks, whole.impacts.peaks[begun], rtol=1e-12, equal_nan=True)


def test_dense_blocks_record_from_a_time_on():
    """Two contacts and a damping that couples the modes."""
    system = replace(two_contacts(), damping=np.diag([0.0, 0.3, 0.0, 0.1]))
    run = sb.integrate(system, sb.HHT(-0.1), 2e-3, 3.0)
    many = sb.integrate_ensemble(system, sb.HHT(-0.1), 2e-3, 3.0, [system], since=1.0)
    assert many.provenance["march"] == "dense blocks"
    for statistics, record in zip(many.contacts, run.contacts, strict=True):
        assert statistics.fraction[0] == np.mean(record.force[501:] != 0.0)
        assert statistics.peak_force[0] == np.max(np.abs(record.force[501:]))
        assert statistics.impact_count[0] == np.sum(record.impacts.times > 1.0)


def test_the_exact_record_from_a_time_on(system):
    """From the middle of a contact: the two halves of the run add up to the whole."""
    whole = solve_exact(system, 0.5)
    contact, t = whole.contacts[0], float(whole.impacts.times[5]) + 1e-5
    assert contact.stops.state(whole.at(t, 0)[0])[0]
    early = solve_exact(system, t).contacts[0]
    late = sb.reference_ensemble(system, 0.5, [system], since=t)
    assert late.impact_count[0] == contact.impacts.count - 6
    assert late.impulse[0] + early.impulse == pytest.approx(contact.impulse, rel=1e-9)
    assert late.contact_fraction[0] * (0.5 - t) + early.fraction * t == pytest.approx(0.5 * contact.fraction, rel=1e-9)
    assert max(late.peak_force[0], early.peak_force) == pytest.approx(contact.peak_force, rel=1e-12)


@pytest.mark.parametrize("since", [-0.1, 0.6, 0.00015])
def test_a_time_to_record_from_that_is_none_is_refused(since, system):
    with pytest.raises(sb.InputError, match="since"):
        sb.integrate_ensemble(system, sb.HHT(), 1e-4, 0.6, [system], since=since)


def test_the_threads_can_be_limited(monkeypatch):
    from stiffbeam.basics.resources import cores

    monkeypatch.setenv("STIFFBEAM_THREADS", "3")
    assert cores() == 3
    monkeypatch.setenv("STIFFBEAM_THREADS", "none")
    with pytest.raises(sb.InputError, match="STIFFBEAM_THREADS"):
        cores()


@pytest.mark.parametrize("rigid", [False, True])
def test_members_whose_contact_is_there_at_the_start_are_flagged(rigid):
    law = {"stiffness": np.inf, "restitution": 0.5} if rigid else {"stiffness": 1e4}
    loads = [([-9.81], sb.Constant(1.0)), ([1.0], sb.Harmonic(30.0, 8.0))]
    contact = sb.Contact([1.0], sb.Stops(lower=0.0, **law))
    pressed = sb.System.from_matrices([[1.0]], [[50.0]], None, loads, [contact])
    members = [pressed, replace(pressed, q0=np.array([0.02]))]
    scheme = sb.MoreauJean() if rigid else sb.HHT()
    for many in (
        sb.integrate_ensemble(pressed, scheme, 1e-3, 1.0, members),
        sb.reference_ensemble(pressed, 1.0, members),
    ):
        assert many.contact.open_at_start.tolist() == [True, False]
        assert many.to_dataframe()["contact_open_at_start_0"].tolist() == [True, False]
        assert many.to_xarray()["contact_open_at_start"].values.tolist() == [[1, 0]]


@pytest.mark.parametrize("unknowns", [1, 4])
@pytest.mark.parametrize("scheme", [sb.Trapezoidal(), sb.Bathe(), sb.HHT(-0.1), sb.BDF2()], ids=str)
def test_members_start_with_the_bits_of_their_solo_runs(scheme, unknowns):
    """A product or a solve of all starts at once rounds otherwise than that of one."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        K, M = rng.normal(size=(2, unknowns, unknowns))
        system = sb.System.from_matrices(
            np.eye(unknowns) + 0.2 * M @ M.T, np.eye(unknowns) + K @ K.T, 0.1 * np.outer(K[0], K[0]),
            loads=[(rng.normal(size=unknowns), sb.Harmonic(1.0, 1.7, phase=2.0))], observe=rng.normal(size=unknowns),
            initial_displacement=rng.normal(size=unknowns), initial_velocity=rng.normal(size=unknowns),
        )  # fmt: skip
        ensemble = sb.integrate_ensemble(system, scheme, 0.05, 3.0, [system] * 3, every=1)
        run = sb.integrate(system, scheme, 0.05, 3.0)
        assert all(np.array_equal(tip, run.tip) for tip in ensemble.tip)
