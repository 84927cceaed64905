"""Ensembles: a member is its single run, in any company, on any executor; perturbations have the stated size."""

from __future__ import annotations

from dataclasses import fields, replace

import joblib
import numpy as np
import pytest
from law_systems import rigid_system
from systems import one_mass, random_chain, two_contacts, with_stops

import stiffbeam as sb
from stiffbeam.basics import resources
from stiffbeam.march import block_march
from stiffbeam.model.modes import modes
from stiffbeam.references.exact.solution import solve_exact

ROUNDING = 1e-11  # of the largest value: what other orders of summation do before impacts magnify it
GROWTH = 100.0  # per unit of time: the beam of Table 10 has a Lyapunov exponent of 72 +- 11
SEEN = 1e-4  # of the largest value: larger differences are not looked at, since chaos has made them


@pytest.fixture(scope="module")
def system(table10) -> sb.System:
    return sb.semidiscretise(table10, 25)


def close(a, b, t, growth):
    """True where a and b (..., k) at times t (k,) differ by no more than rounding and its growth."""
    bound = ROUNDING * np.exp(growth * np.asarray(t))
    scale = np.nanmax(np.abs(b), initial=1e-300)
    return np.all((np.abs(a - b) <= bound * scale) | (bound > SEEN) | (np.isnan(a) & np.isnan(b)))


def assert_is_run(ensemble, i, run, growth=GROWTH):
    """Member i of an ensemble with outputs is a run of it alone, while rounding has not grown."""
    for name in ("tip", "tip_velocity"):
        assert close(getattr(ensemble, name)[i], getattr(run, name), run.t, growth)
    until = np.log(SEEN / ROUNDING) / growth
    for statistics, record in zip(ensemble.contacts, run.contacts, strict=True):
        own, other = statistics.impacts_of(i).until(until), record.impacts.until(until)
        assert np.array_equal(own.stops, other.stops)
        for name in ("times", "ends", "peaks", "impulses"):
            assert close(getattr(own, name), getattr(other, name), other.times, growth), name
        if until >= run.t[-1]:
            ours = statistics.fraction[i], statistics.peak_force[i], statistics.impulse[i]
            assert ours == pytest.approx((record.fraction, record.peak_force, record.impulse), rel=SEEN)
    ledger = ensemble.ledger(i)
    for field in fields(ledger):
        assert close(getattr(ledger, field.name), getattr(run.energy, field.name), run.energy.t, growth), field.name


RECORD = np.linspace(0.0, 1.0, 101)
KINDS = {
    "perturbed": lambda s: sb.perturbed_members(s, 9, 1e-10),
    "frequency": lambda s: sb.varied_members(s, {"frequency": np.linspace(9.0, 11.0, 9)}),
    "amplitude": lambda s: sb.varied_members(s, {"amplitude": np.linspace(0.15, 0.25, 9)}),
    "stops": lambda s: sb.varied_members(s, {
        "stops.lower": -np.linspace(0.08, 0.12, 9), "stops.upper": np.linspace(0.08, 0.12, 9),
        "stops.stiffness": np.geomspace(1e6, 1e7, 9),
    }),
    "records": lambda s: [
        replace(s, loads=(*s.loads, (s.contacts[0].row, sb.Sampled(RECORD, 20.0 * np.sin(RECORD * (30.0 + i))))))
        for i in range(9)
    ],
    # Laws of several kinds are marched apart, those of one kind together; they keep their places.
    "laws": lambda s: [
        with_stops(s, sb.Stops(-0.1, 0.1, stiffness=5e6, **law))
        for law in 3 * [{"exponent": 1.5}, {}, {"damping": 100.0}]
    ],
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scheme", [sb.HHT(-0.1), sb.BDF2(), sb.SDIRK(nystrom=True)], ids=str)
@pytest.mark.parametrize("contact", ["implicit", "extrapolated"])
@pytest.mark.fast(7)
def test_a_member_is_its_single_run(kind, scheme, contact, system):
    contact = "implicit" if kind == "laws" else contact
    members = KINDS[kind](system)
    whole = members[0] if kind == "records" else system  # of which the others differ in the samples alone
    ensemble = sb.integrate_ensemble(whole, scheme, 1e-4, 0.3, members, contact, every=10)
    assert np.min(ensemble.contacts[0].impact_count) > 10
    assert len(np.unique(ensemble.contacts[0].impulse)) == (3 if kind == "laws" else 9)
    for i in (0, 4, 8):
        if np.isnan(ensemble.diverged[i]):
            assert_is_run(ensemble, i, sb.integrate(members[i], scheme, 1e-4, 0.3, contact, every=10))


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.fast(10)
def test_members_of_a_random_chain(seed):
    """Several contacts, moving stops and samples; in modes, and in dense blocks where a dashpot couples them."""
    system, slow = random_chain(seed)
    members = sb.perturbed_members(system, 3, 1e-3, t_end=2.0 / slow)
    try:
        many = sb.integrate_ensemble(system, sb.HHT(-0.1), 0.02 / slow, 2.0 / slow, members, every=1)
    except sb.InputError:
        return
    for i in (0, 2):
        assert_is_run(many, i, sb.integrate(members[i], sb.HHT(-0.1), 0.02 / slow, 2.0 / slow), 7.0 * slow)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*list(KINDS)[:5], "rigid"])
def test_an_exact_member_is_its_single_run(kind, system):
    system = rigid_system(34) if kind == "rigid" else system
    t = np.linspace(0.0, 1.5 if kind == "rigid" else 0.5, 51)
    members = sb.perturbed_members(system, 9, 1e-3) if kind == "rigid" else KINDS[kind](system)
    ensemble = sb.reference_ensemble(system, t[-1], members, t)
    assert ensemble.label.startswith("exact@")
    for i in (0, 4, 8):
        assert_is_run(ensemble, i, solve_exact(members[i], t[-1], t))


def test_the_company_of_a_member_does_not_change_it(system, monkeypatch):
    """Slices and stretches of any size; some whose length no block divides."""
    members = sb.varied_members(system, {"frequency": np.linspace(9.0, 11.0, 28)})
    monkeypatch.setenv("STIFFBEAM_THREADS", "1")
    runs = {i: sb.integrate(members[i], sb.HHT(-0.1), 1e-4, 0.3, every=5) for i in (0, 6, 27)}
    for batch, steps, replayed in ((3, 1, 96), (7, 7 * 70, 64)):
        monkeypatch.setattr(resources, "BATCH", batch)
        monkeypatch.setattr(block_march, "STEPS_PER_CALL", steps)
        monkeypatch.setattr(block_march, "STEPS_REPLAYED", replayed)
        many = sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-4, 0.3, members, every=5)
        for i, run in runs.items():
            assert_is_run(many, i, run)


# ------------------------------------------------------------------ statistics


@pytest.mark.parametrize("scheme", [sb.HHT(-0.1), sb.BDF2(), sb.SDIRK(nystrom=True)], ids=str)
@pytest.mark.fast(1)
def test_contacts_recorded_from_a_time_on_are_those_of_every_step_after_it(scheme, system):
    """A window that begins inside a block and during a contact, against all steps of the same run."""
    dt, passed = 1e-4, 1203
    march = lambda since, every=None: sb.integrate_ensemble(  # noqa: E731
        system, scheme, dt, 0.4, [system], every=every, since=since
    )
    whole, stops = march(0.0, every=1), system.contacts[0].stops
    side, force = stops.state(whole.tip[0]), np.abs(stops.force(whole.tip[0]))
    passed += int(np.argmax(side[passed:] != 0)) + 1
    assert passed % 16
    assert side[passed - 1]
    late, force = side[passed:], force[passed + 1 :]
    window = march(passed * dt)
    assert window.contacts[0].fraction[0] == np.mean(late[1:] != 0)
    assert window.contacts[0].peak_force[0] == np.max(force)
    assert window.contacts[0].impulse[0] == pytest.approx(np.sum(force) * dt, rel=1e-12)
    assert window.contacts[0].impact_count[0] == np.sum((late[1:] != 0) & (late[1:] != late[:-1])) > 10
    begun = whole.contacts[0].impacts.times > passed * dt
    for name in ("times", "stops", "peaks"):
        given, wanted = getattr(window.contacts[0].impacts, name), getattr(whole.contacts[0].impacts, name)[begun]
        assert np.allclose(given, wanted, rtol=1e-12, equal_nan=True)


def test_the_exact_record_from_a_time_on(system):
    """From the middle of a contact: the two halves of the run add up to the whole."""
    whole = solve_exact(system, 0.5)
    contact, t = whole.contacts[0], float(whole.impacts.times[5]) + 1e-5
    assert contact.stops.state(whole.at(t, 0)[0])[0]
    early, late = solve_exact(system, t).contacts[0], sb.reference_ensemble(system, 0.5, [system], since=t)
    assert late.contacts[0].impact_count[0] == contact.impacts.count - 6
    assert late.contacts[0].impulse[0] + early.impulse == pytest.approx(contact.impulse, rel=1e-9)
    shares = late.contacts[0].fraction[0] * (0.5 - t) + early.fraction * t
    assert shares == pytest.approx(0.5 * contact.fraction, rel=1e-9)
    assert max(late.contacts[0].peak_force[0], early.peak_force) == pytest.approx(contact.peak_force, rel=1e-12)


@pytest.mark.parametrize("rigid", [False, True])
def test_members_whose_contact_is_there_at_the_start_are_flagged(rigid):
    law = {"stiffness": np.inf, "restitution": 0.5} if rigid else {"stiffness": 1e4}
    loads = [([-9.81], sb.Constant(1.0)), ([1.0], sb.Harmonic(30.0, 8.0))]
    pressed = sb.System.from_matrices([[1.0]], [[50.0]], None, loads, [sb.Contact([1.0], sb.Stops(lower=0.0, **law))])
    members, scheme = [pressed, replace(pressed, q0=np.array([0.02]))], sb.MoreauJean() if rigid else sb.HHT()
    for many in (
        sb.integrate_ensemble(pressed, scheme, 1e-3, 1.0, members), sb.reference_ensemble(pressed, 1.0, members),
    ):  # fmt: skip
        assert many.contacts[0].open_at_start.tolist() == [True, False]
        assert many.to_dataframe()["contact_open_at_start_0"].tolist() == [True, False]
        assert many.to_xarray()["contact_open_at_start"].values.tolist() == [[1, 0]]


# ------------------------------------------------------------------ perturbations


def test_perturbations_are_of_the_stated_size(system):
    """omega eta and eta' move by size V r, |r| <= 1, V the largest modal speed of start and drive."""
    basis, members = modes(system), sb.perturbed_members(system, 400, 1e-6, rng=3)
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
    again = sb.perturbed_members(system, 3, 1e-6, rng=3)
    assert all(np.array_equal(a.q0, b.q0) for a, b in zip(again, members[:3], strict=True))


def test_a_system_at_rest_at_zero_is_perturbed_in_proportion_to_its_load():
    small, large = (sb.perturbed_members(one_mass(4.0, load=sb.Harmonic(a, 3.0)), 1, 1e-3) for a in (1.0, 10.0))
    assert np.isclose(large[0].v0[0], 10.0 * small[0].v0[0], rtol=1e-12)
    assert 0.0 < abs(small[0].v0[0]) <= 1e-3 * 1.0 / 3.0
    unknown = one_mass(4.0, load=lambda t: np.sin(3.0 * t))
    assert sb.perturbed_members(unknown, 1, t_end=1.0)[0].v0[0] != 0.0
    # A function in Python has the scale of its samples.
    t = np.linspace(0.0, 7.0, 4001)  # as many as ``scales`` takes
    for f in (lambda t: np.sin(3.0 * t), lambda t: np.where(t < 2.0, 5.0 * t, 0.0)):
        one, other = (sb.perturbed_members(one_mass(4.0, load=g), 2, t_end=7.0) for g in (f, sb.Sampled(t, f(t))))
        assert np.array_equal(one[1].v0, other[1].v0)
        assert one[1].v0[0] != 0.0


# ------------------------------------------------------------------ refusals


SMALL = replace(sb.paper_case(10), cells=8).system()
SCHEME, DT, T_END = sb.HHT(alpha=-0.1), 1e-3, 0.4


def ensemble(s, members, *more, **given):
    return sb.integrate_ensemble(s, SCHEME, DT, T_END, members, *more, **given)


CALLS = [
    (lambda s: sb.perturbed_members(s, 0), "members"), (lambda s: sb.varied_members(s, None), "parameters must be"),
    (lambda s: sb.varied_members(s, {}), "one value or more"),
    (lambda s: sb.varied_members(s, {"frequency": [-1.0]}), "frequency"),
    (lambda s: ensemble(s, []), "members"),
    (lambda s: ensemble(s, [sb.semidiscretise(s.problem, 9)]), "members"),
    (lambda s: sb.varied_members(two_contacts(), {"frequency": [1.0]}), "frequency"),
    (lambda s: sb.perturbed_members(one_mass(4.0, load=lambda t: np.sin(3.0 * t)), 1), "speed"),
    *((lambda s, since=since: ensemble(s, [s], since=since), "since") for since in (-0.1, 0.6, 0.00015)),
]  # fmt: skip


@pytest.mark.parametrize(("call", "words"), CALLS)
def test_bad_arguments_are_named(call, words):
    with pytest.raises(sb.InputError, match=words):
        call(SMALL)


def test_the_threads_can_be_limited(monkeypatch):
    monkeypatch.setenv("STIFFBEAM_THREADS", "3")
    assert resources.cores() == 3


# ------------------------------------------------------------------ in the processes of joblib


LOADED = replace(SMALL, loads=(*SMALL.loads, (SMALL.contacts[0].row, lambda t: np.sin(t))))  # travels as well
SAMPLED = [
    replace(SMALL, loads=(*SMALL.loads, (SMALL.contacts[0].row, sb.Sampled([0.0, 0.2], [0.0, x])))) for x in (1, 2)
]


def same(one, other) -> None:
    np.testing.assert_allclose(one.tip, other.tip, rtol=0.0, atol=1e-9)
    for a, b in zip(one.contacts, other.contacts, strict=True):
        np.testing.assert_array_equal(a.impact_count, b.impact_count)
        np.testing.assert_allclose(a.impulse, b.impulse, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "members",
    [
        sb.perturbed_members(SMALL, 9),
        sb.perturbed_members(LOADED, 3, t_end=1.0),
        sb.varied_members(SMALL, {"stops.stiffness": np.linspace(1e4, 5e6, 5)}),
        SAMPLED,
    ],
    ids=["initial data", "function", "stiffness", "records"],
)
def test_processes_find_the_results_of_one(members):
    t, system = np.linspace(0.0, 0.2, 7), getattr(members, "system", SAMPLED[0])
    runs = [sb.integrate_ensemble(system, SCHEME, DT, 0.2, members, every=50, since=0.1)]
    exact = [sb.reference_ensemble(system, 0.2, members, t)]
    with joblib.parallel_config("loky", n_jobs=2):
        runs.append(sb.integrate_ensemble(system, SCHEME, DT, 0.2, members, every=50, since=0.1))
        exact.append(sb.reference_ensemble(system, 0.2, members, t))
    same(*runs)
    same(*exact)
    assert runs[1].ledger(1).energy.shape == runs[0].ledger(1).energy.shape


def test_an_error_of_a_member_ends_the_ensemble():
    members = sb.varied_members(SMALL, {"stops.damping": [0.0, 1.0]})
    with pytest.raises(sb.InputError, match="extrapolated"), joblib.parallel_config("threading", n_jobs=2):
        sb.integrate_ensemble(SMALL, SCHEME, DT, 0.2, members, "extrapolated")
