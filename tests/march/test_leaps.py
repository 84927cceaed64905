"""The leaping march: equal to the block march on anything it takes, exact where it may not guess."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import extended_march
import numpy as np
import pytest
from leaping import SCHEMES, both, campaign

import stiffbeam as sb
from stiffbeam.march import leap
from stiffbeam.march.integrate import Plan
from stiffbeam.march.kernels import sums as kernel

pytestmark = pytest.mark.usefixtures("numpy_kernel")


@pytest.fixture
def always(monkeypatch):
    """Leaps pay whatever they cost."""
    monkeypatch.setattr(leap, "setup", lambda stepper: 0.0)
    monkeypatch.setattr(leap, "costs", lambda stepper: np.array([0.0, 0.0, 1.0]))


def sums_of_powers(cases: int):
    """Random sums of powers, slow and fast, undamped, damped and alternating, as a leap sees them, and their values.

    Yields (regimes, y, slow, w): one position of one regime, where it starts, how many coordinates the cubic holds,
    and w(l) for l = 0 .. L.
    """
    rng = np.random.default_rng(0)
    for _ in range(cases):
        N, L = int(rng.integers(1, 6)), int(rng.integers(2, 200))
        size = np.exp(-(10.0 ** rng.uniform(-6.0, 1.0, N)) * rng.integers(0, 2, N))
        powers = size * np.exp(1j * np.pi * 10.0 ** rng.uniform(-4.0, 0.0, N))
        powers = powers[np.argsort(np.abs(powers - 1.0))]
        c, y = rng.normal(size=N) + 1j * rng.normal(size=N), np.exp(2j * np.pi * rng.random(N))
        y *= 10.0 ** rng.uniform(-6.0, 0.0, N)
        slow = int(rng.integers(0, N + 1))
        levels = np.array([powers ** (2.0**q) for q in range(9)])
        large = np.abs(c)[None, None]
        nothing = np.zeros((2, 1, 1, N))
        regimes = kernel.Regimes(
            slow=np.full((1, 9), slow), alive=np.full((1, 9), N), powers=pair(levels), geometric=nothing,
            nodes=pair(c[None]), steps=pair((c * (powers - 1.0))[None]), large=large,
            bent=large * np.abs(powers - 1.0) ** 4 / 96.0, ends=nothing, rates=nothing, enter=nothing, held=nothing,
            leave=nothing,
        )  # fmt: skip
        yield regimes, y, slow, (powers ** np.arange(L + 1)[:, None] @ (c * y)).real


def pair(values: np.ndarray) -> np.ndarray:
    """(2, 1, ..): real and imaginary parts of one regime's."""
    return np.stack([values.real, values.imag])[:, None]


def coordinates(y: np.ndarray) -> np.ndarray:
    return np.stack([y.real, y.imag])


def leap_over(regimes: kernel.Regimes, y: np.ndarray, slow: int, L: int):
    """(p, bend, flat) of L steps, see the kernel's docstring, and the size that rounding is relative to."""
    after = y * (regimes.powers[0, 0, 0] + 1j * regimes.powers[1, 0, 0]) ** L
    p, _ = kernel.slow_part(regimes, 0, 0, coordinates(y), coordinates(after), slow, float(L))
    bend, flat = kernel.bounds(regimes.large, regimes.bent, 0, 0, slow, y.size, np.abs(y), float(L))
    return p, bend, flat, np.sum(regimes.large[0, 0] * np.abs(y))


def test_the_bound_holds_at_every_step():
    """Against sums of powers evaluated step by step."""
    worst = 0.0
    for regimes, y, slow, w in sums_of_powers(400):
        L = len(w) - 1
        p, bend, flat, size = leap_over(regimes, y, slow, L)
        n, rounding = np.arange(L + 1), 1e-13 * size
        found, bound = np.abs(w - np.polyval(p[::-1], n)), bend * n * (L - n) + flat
        assert np.all(found <= bound + rounding)
        for sign in (1.0, -1.0):
            highest = kernel.greatest(sign, p, bend, float(L), 0.0, float(L - 1)) + flat
            assert np.max(sign * w[:-1]) <= highest + rounding
        worst = max(worst, np.max(found / (bound + rounding)))
    assert worst > 0.3  # it is a bound, and not a generous one


def test_what_is_said_of_a_leap_is_so_at_every_step():
    """On its side at all of them where that is said, beyond at its end or at its start where that is."""
    rng, seen = np.random.default_rng(1), np.zeros(4, int)
    for regimes, y, slow, w in sums_of_powers(2000):
        L = len(w) - 1
        p, bend, flat, size = leap_over(regimes, y, slow, L)
        low, high = w[0] + np.array([-1.0, 1.0]) * size * 10.0 ** rng.uniform(-4.0, 0.5, 2)
        if rng.random() < 0.2:
            low, high = rng.choice([(-np.inf, high), (low, np.inf), (w[0] + 1e-3 * size, high)])
        verdict, ahead, left = kernel.judge(low, high, w[0], w[L], p, bend, flat, float(L))
        seen[verdict] += 1
        inside, rounding = (low <= w) & (w <= high), 1e-13 * size
        if verdict == kernel.SURE:
            assert np.all((low - rounding <= w[:-1]) & (w[:-1] <= high + rounding))
            assert left == (0 if inside[-1] else L)
        if verdict == kernel.CROSSED:
            assert inside[0]
            assert not inside[-1]
            assert 1 <= ahead < L
            assert 1 <= left <= L
        assert (verdict == kernel.OVER) == (not inside[0])
    assert np.all(seen > 50)


def test_the_greatest_depth_is_that_of_all_steps():
    """Against all of them; and no other than ``best`` where none goes deeper."""
    rng, deeper = np.random.default_rng(2), 0
    work = np.zeros((5, 2, 8))
    for regimes, y, _, w in sums_of_powers(600):
        side, steps, size = rng.choice([-1.0, 1.0]), len(w) - 1, np.sum(regimes.large[0, 0] * np.abs(y))
        g = w[0] - side * size * rng.uniform(0.0, 1.0)
        truth = np.max(side * (w[:-1] - g))
        best = truth + size * rng.choice([-1.0, -1e-3, 0.0, 1e-3])
        found = kernel.deepest(
            regimes, 0, 0, 0, side, g, coordinates(y), steps, y.size, best, work[:, :, : y.size].copy()
        )  # fmt: skip
        assert found == pytest.approx(max(best, truth), abs=1e-13 * size)
        deeper += truth > best
    assert deeper > 100


@pytest.mark.slow
def test_random_systems_in_leaps_and_in_blocks(always):
    campaign(range(15))


@pytest.mark.slow
def test_many_random_systems_in_leaps_and_in_blocks(always):
    campaign(range(15, 400))


@pytest.fixture(scope="module")
def beam() -> sb.System:
    case = sb.paper_case(10)
    return sb.semidiscretise(case.problem, case.cells)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
def test_every_scheme_leaps_and_is_no_less_accurate(always, beam, scheme):
    """Table 10 through its first impacts against the scheme's own steps in extended precision."""
    dt, steps, every = 2e-5, 3600, 12
    blocks, leaps = both(beam, scheme, dt, steps, every)
    assert leaps.kind == leap.LEAPS
    exact = extended_march.march(beam, scheme, dt, steps)[::every]
    own, other = (np.max(np.abs(march.positions[0] - exact)) for march in (blocks, leaps))
    assert blocks.seen(0).contacts[0].impacts.count >= 2
    assert other <= 10.0 * own + 1e-15
    x, y = (march.seen(0).contacts[0] for march in (blocks, leaps))
    assert x.fraction == y.fraction > 0.0
    np.testing.assert_allclose(y.impacts.times, x.impacts.times, rtol=1e-11)
    np.testing.assert_allclose(y.impacts.ends, x.impacts.ends, rtol=1e-11)
    assert np.all(x.impacts.ends[:-1] > x.impacts.times[:-1])
    np.testing.assert_allclose(y.impacts.peaks, x.impacts.peaks, rtol=1e-9)
    np.testing.assert_allclose(y.impacts.impulses, x.impacts.impulses, rtol=1e-9)


def test_a_closed_stop_is_no_spring_to_every_scheme(beam):
    """The printed HHT weighs the stiffness and not the contact: it goes on by ordinary steps, then in blocks."""
    plan = Plan.of(beam, sb.HHT(-0.1).printed("unweighted"), 2e-5, 0.08, "implicit", 1, "numba")
    assert plan.stepper is not None
    leaper = leap.Leaper(plan.stepper, beam)
    leaper.make(1)
    found = leaper.tables(4000, 4000, 0.1)
    assert found is not None
    assert found[1].tolist() == [0, -2]


@pytest.mark.parametrize("scheme", [sb.HHT(-0.1).printed("unweighted"), sb.SDIRK().printed("sigma")], ids=str)
def test_the_printed_schemes_leap_as_they_march(always, beam, scheme):
    blocks, leaps = both(beam, scheme, 2e-5, 3600, 50)
    np.testing.assert_allclose(leaps.positions, blocks.positions, atol=1e-10)


def test_a_run_says_that_it_leapt_and_outputs_do_not_change_it(beam):
    runs = [sb.integrate(beam, sb.HHT(-0.1), 1e-7, 0.08, every=every) for every in (1, 2000, 800_000)]
    assert [run.provenance["march"] for run in runs] == [leap.LEAPS] * 3
    for run in runs[1:]:
        assert np.array_equal(run.impacts.times, runs[0].impacts.times)
        assert np.array_equal(run.impacts.peaks, runs[0].impacts.peaks)
    assert np.max(np.abs(runs[1].tip - runs[0].tip[::2000])) < 1e-12
    assert np.max(np.abs(runs[1].tip_velocity - runs[0].tip_velocity[::2000])) < 1e-8
    q, _ = runs[1].states
    assert np.max(np.abs(beam.displacement(runs[1].t, q, 1.0) - runs[1].tip)) < 1e-12
    assert abs(runs[2].tip[-1] - runs[0].tip[-1]) < 1e-12


def test_states_and_ledger_follow_the_leaps_past_the_horizon(always, beam):
    """Where rounding has grown to the size of the motion a block march of its own would be another run."""
    run = sb.integrate(beam, sb.Trapezoidal(), 1e-5, 1.0, every=50)
    assert run.provenance["march"] == leap.LEAPS
    assert run.impacts.count > 100
    q, _ = run.states
    assert np.max(np.abs(beam.displacement(run.t, q, 1.0) - run.tip)) < 1e-9
    ledger = run.energy
    assert ledger.loss_without_contact[-1] == pytest.approx(0.0, abs=1e-6 * ledger.input[-1])


def test_members_of_an_ensemble_leap_as_they_do_alone(beam):
    for members in (sb.perturbed(beam, 3), sb.varied(beam, frequency=[9.0, 10.0, 11.0])):
        many = sb.integrate_ensemble(beam, sb.BDF2(), 1e-7, 0.06, members, every=1000)
        assert many.provenance["march"] == leap.LEAPS
        for i, member in enumerate(members):
            solo = sb.integrate(member, sb.BDF2(), 1e-7, 0.06, every=1000)
            assert np.array_equal(solo.tip, many.tip[i])
            assert np.array_equal(solo.impacts.times, many.contact.impacts_of(i).times)


def test_only_the_members_with_linear_stops_leap():
    """An ensemble says how all of them were marched, and each has the bits of its solo run."""
    system, curved = oscillator(viscous=0.1), oscillator(viscous=0.1, exponent=1.5)
    members = [system, replace(system, contacts=curved.contacts)]
    many = sb.integrate_ensemble(system, sb.HHT(-0.1), 4e-6, 20.0, members, every=5000)
    assert many.provenance["march"] == f"{leap.BLOCKS} and {leap.LEAPS}"
    for i, (member, march) in enumerate(zip(members, (leap.LEAPS, leap.BLOCKS), strict=True)):
        solo = sb.integrate(member, sb.HHT(-0.1), 4e-6, 20.0, every=5000)
        assert solo.provenance["march"] == march
        assert np.array_equal(solo.tip, many.tip[i])
        assert np.array_equal(solo.impacts.ends, many.contact.impacts_of(i).ends, equal_nan=True)
        assert solo.impacts.count > 0


def test_contacts_are_recorded_since_a_time_as_in_blocks(always, beam):
    blocks, leaps = both(beam, sb.HHT(-0.1), 1e-5, 10_000, None, 7013)
    x, y = (march.seen(0).contacts[0] for march in (blocks, leaps))
    assert 0 < x.impacts.count == y.impacts.count
    assert x.fraction == y.fraction
    np.testing.assert_allclose(y.impulse, x.impulse, rtol=1e-8)
    np.testing.assert_allclose(y.peak_force, x.peak_force, rtol=1e-8)


def oscillator(stiffness: float = 1.0, viscous: float = 0.0, load=None, **law: Any) -> sb.System:
    """A mass on a spring between stops."""
    contact = sb.Contact(np.array([1.0]), sb.Stops(upper=1.0, stiffness=100.0, **law))
    return sb.System.from_matrices(
        [[1.0]], [[stiffness]], [[viscous]], loads=[(np.array([1.0]), load or sb.Harmonic(0.5, 0.3))],
        contacts=[contact], initial_velocity=[1.5],
    )  # fmt: skip


@pytest.mark.parametrize(
    "system",
    [
        oscillator(viscous=2.0),  # two eigenvalues that are one
        oscillator(load=sb.Harmonic(0.1, 1.0)),  # in resonance
        oscillator(stiffness=0.0, load=sb.Constant(0.4)),  # a constant force on a free mass
    ],
    ids=["critically damped", "resonance", "free mass"],
)
def test_what_cannot_be_leapt_over_goes_in_blocks(always, system):
    blocks, leaps = both(system, sb.HHT(-0.1), 0.01, 5000, 10)
    assert np.max(np.abs(leaps.positions - blocks.positions)) <= 1e-8


@pytest.mark.parametrize("scheme", [sb.Trapezoidal(), sb.HHT(-0.1), sb.BDF2(), sb.SDIRK()], ids=str)
@pytest.mark.parametrize("stiffness", [0.0, 1e-14, 1e-11, 1e-8, 1e-4])
@pytest.mark.fast(8)
def test_what_drifts_is_not_leapt_over(always, scheme, stiffness):
    """A free mode is no sum of powers: runs came out as 0 or 1e252. One nearly free loses what it drifts by."""
    for viscous in (0.0, 1.0):
        for load in (sb.Harmonic(0.0, 1.0), sb.Constant(0.4), sb.Harmonic(1.0, 20.0)):
            blocks, leaps = both(oscillator(stiffness, viscous, load), scheme, 1e-4, 100_000, 10)
            size = np.max(np.abs(blocks.positions))
            assert np.max(np.abs(leaps.positions - blocks.positions)) <= 1e-8 * size


@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.fast(3)
def test_two_masses_that_nothing_holds_fly_on(scheme):
    """q_1 + q_2 = t, and q_1 - q_2 swings: 300 units of time in 3e6 steps, far more than leaps begin with."""
    system = sb.System.from_matrices(
        np.eye(2), [[100.0, -100.0], [-100.0, 100.0]], observe=[1.0, 1.0], initial_velocity=[1.0, 0.0]
    )
    run = sb.integrate(system, scheme, 1e-4, 300.0, every=1000)
    assert np.max(np.abs(run.tip - run.t)) < 1e-8 * 300.0


def test_what_may_leap_and_what_pays(beam):
    fine = Plan.of(beam, sb.HHT(-0.1), 1e-7, 0.1, "implicit", 1, "numba").stepper
    assert fine is not None
    assert leap.can_leap(fine, 1_000_000)
    assert not leap.can_leap(fine, 1000)
    for contact, engine in (("extrapolated", "numba"), ("implicit", "numpy")):
        other = Plan.of(beam, sb.HHT(-0.1), 1e-7, 0.1, contact, 1, engine).stepper
        assert other is not None
        assert not leap.can_leap(other, 1_000_000)
    for contact, stops in (("conserving", {}), ("implicit", {"exponent": 1.5}), ("implicit", {"damping": 0.1})):
        scheme = sb.Trapezoidal() if contact == "conserving" else sb.HHT(-0.1)
        other = Plan.of(oscillator(**stops), scheme, 1e-7, 10.0, contact, 1, "numba").stepper
        assert other is not None
        assert not leap.can_leap(other, 100_000_000)
    coarse = sb.integrate(beam, sb.HHT(-0.1), 1e-4, 100.0, every=1_000_000)
    assert coarse.provenance["march"] == leap.BLOCKS


def test_memory_does_not_grow_with_leapt_steps():
    """1e9 steps: what is held is the regimes and the impacts."""
    import tracemalloc

    system = oscillator(viscous=0.1)
    sb.integrate(system, sb.HHT(-0.1), 1e-7, 10.0, every=10**8)
    peaks = []
    for t_end in (10.0, 100.0):
        tracemalloc.start()
        run = sb.integrate(system, sb.HHT(-0.1), 1e-7, t_end, every=10**8)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert run.provenance["march"] == leap.LEAPS
    assert peaks[1] < 1.5 * peaks[0]


@pytest.mark.parametrize("driven", [True, False])
def test_a_beam_without_contacts_leaps_over_its_whole_run(driven):
    base = sb.Harmonic(0.2, 10.0) if driven else None
    beam = sb.BeamProblem(stiffness=300.0, base=base, initial_velocity=sb.PolynomialProfile((0.0, 0.0, 1.0)))
    blocks, leaps = both(sb.semidiscretise(beam, 25), sb.HHT(alpha=-0.1), 1e-6, 1_000_000, 1000)
    assert leaps.kind == leap.LEAPS
    # rounding of 1e6 steps, at most as if it all went one way
    assert np.max(np.abs(blocks.positions - leaps.positions)) < 1e-10 * np.max(np.abs(leaps.positions))


def test_a_step_with_two_equal_factors_is_marched(always):
    """Critical damping at which the eigenvectors of a step are one, to the bit in some: no regime, no traceback."""
    for index in range(40):
        omega = 10.0 ** np.random.default_rng(index).uniform(0.0, 2.5)
        system = sb.System.from_matrices(
            [[1.0]], [[omega**2]], [[2.0 * omega]], observe=[1.0], initial_displacement=[1.0]
        )
        blocks, leaps = both(system, SCHEMES[index % len(SCHEMES)], 0.3 / omega, 3000, 10)
        assert np.max(np.abs(leaps.positions - blocks.positions)) <= 1e-9
