"""Kelvin-Voigt stops in the exact solution and in many digits: a closed form, another solver, and the tangent flow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from law_systems import Witness, free_system, kelvin_voigt_system
from mpmath import mp, mpf
from systems import one_mass

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.references import horizon
from stiffbeam.references.exact.motion import LET_GO, Solver

TIMES = np.linspace(0.0, 3.0, 61)


def offset_of(system: sb.System) -> np.ndarray:
    offset = system.contacts[0].offset
    return np.zeros(len(TIMES)) if offset is None else offset.value(TIMES)


def _agrees(system: sb.System) -> None:
    """With DOP853 from switch to switch, and with the package's own adaptive solver in what that measures."""
    want, _ = Witness(system).solve(TIMES)
    run = sb.reference(system, 3.0, t_eval=TIMES)
    # The witness steps at rtol 1e-12 and places its switches to 1e-14; perturbations grow by e^3 at most in this time.
    assert np.max(np.abs(run.contacts[0].position - offset_of(system) - want)) < 1e-9 * np.max(np.abs(want))
    scale = np.max(run.energy.energy)
    assert np.max(np.abs(run.energy.loss)) < 1e-11 * scale
    assert np.all(np.diff(run.energy.stop_dissipation) > -1e-13 * scale)
    other = sb.reference(system, 3.0, method="dop853", t_eval=TIMES, rtol=1e-11)
    assert abs(run.energy.stop_dissipation[-1] - other.energy.stop_dissipation[-1]) < 1e-8 * scale
    for a, b in zip(run.contacts, other.contacts, strict=True):
        assert a.impacts.count == b.impacts.count
        for name in ("times", "ends", "stops", "peaks", "impulses"):
            x, y = getattr(a.impacts, name), getattr(b.impacts, name)
            assert np.allclose(x, y, rtol=1e-6, atol=1e-7, equal_nan=True), name


@pytest.mark.parametrize("seed", range(408))
@pytest.mark.fast(1, slow=27)
def test_random_systems_against_another_solver(seed):
    _agrees(kelvin_voigt_system(seed))


@pytest.mark.parametrize("seed", range(403))
@pytest.mark.fast(1, slow=27)
def test_bodies_that_nothing_holds_against_another_solver(seed):
    system = free_system(seed)
    _agrees(system)
    run, many = (sb.reference(system, 3.0, method=m, t_eval=TIMES) for m in ("exact", "multiprecision"))
    assert run.horizon == many.horizon == 3.0
    assert np.max(np.abs(many.tip - run.tip)) < 1e-12 * np.max(np.abs(run.tip))
    assert np.array_equal(many.solution.sides, run.solution.sides)


@pytest.mark.fast(4)
@pytest.mark.parametrize("method", ["exact", "multiprecision"])
@pytest.mark.parametrize("zeta", [0.01, 0.1, 0.5, 1.0, 3.0])
def test_a_free_mass_on_a_kelvin_voigt_wall(method, zeta):
    """d'' + 2 zeta d' + d = 0 from (0, 1) till d + 2 zeta d' = 0, at d = 2 zeta e, d' = -e."""
    with mp.workdps(40):
        z = mpf(zeta)
        root = mp.sqrt(mp.mpc(1 - z * z))
        if zeta == 1.0:  # d = t exp(-t)
            t, e = mpf(2), mp.exp(-2)
        else:  # (1 + 2 zeta a) exp(a t) = (1 + 2 zeta b) exp(b t)
            a, b = -z + 1j * root, -z - 1j * root
            t = (mp.log(1 + 2 * z * b) - mp.log(1 + 2 * z * a)) / (a - b)
            t = t.real + (mp.pi / root.real if t.real <= 0 else 0)
            e = -((a * mp.exp(a * t) - b * mp.exp(b * t)) / (a - b)).real
        t, e, x = float(t), float(e), float(2 * z * e)
    stops = sb.Stops(upper=0.25, stiffness=1.0, damping=2.0 * zeta)
    system = sb.System.from_matrices([[1.0]], [[0.0]], contacts=[sb.Contact([1.0], stops)], initial_velocity=[1.0])
    run = sb.reference(system, 8.0, method=method, t_eval=[0.0, 8.0])
    assert run.impacts.times == pytest.approx([0.25], abs=1e-15)
    assert run.impacts.ends == pytest.approx([0.25 + t], abs=1e-14)
    assert run.tip_velocity[-1] == pytest.approx(-e, abs=1e-14)
    assert run.tip[-1] == pytest.approx(0.25 + x - e * (7.75 - t), abs=1e-13)
    assert run.impacts.impulses == pytest.approx([1.0 + e], rel=1e-13)


def closed_form(kappa, c, gap, t_end):
    """x'' + x = 0 from 0 at speed 1, the stop at ``gap``: (x, x') at t_end and (entry, release) times, in mp."""
    with mp.workdps(50):
        kappa, c, gap = mpf(kappa), mpf(c), mpf(gap)
        entry = mp.asin(gap)
        v = mp.cos(entry)
        k, s = 1 + kappa, c / 2  # d'' + c d' + k d = -gap: about -gap/k
        w = mp.sqrt(k - s * s)
        a, b = gap / k, (v + s * gap / k) / w

        def depth(t):
            return mp.exp(-s * t) * (a * mp.cos(w * t) + b * mp.sin(w * t)) - gap / k

        rate = lambda t: mp.diff(depth, t)  # noqa: E731
        force = lambda t: kappa * depth(t) + c * rate(t)  # noqa: E731
        release = mp.findroot(force, (mp.pi / w * 0.95, mp.pi / w))
        x, v = gap + depth(release), rate(release)
        free = mpf(t_end) - entry - release
        end = x * mp.cos(free) + v * mp.sin(free), v * mp.cos(free) - x * mp.sin(free)
        return [float(y) for y in end], float(entry), float(entry + release)


@pytest.mark.parametrize(("method", "error"), [("exact", 1e-13), ("multiprecision", 4e-16)])
def test_one_impact_in_closed_form(method, error):
    stops = sb.Stops(upper=0.5, stiffness=100.0, damping=2.0)
    system = sb.System.from_matrices([[1.0]], [[1.0]], contacts=[sb.Contact([1.0], stops)], initial_velocity=[1.0])
    (x, v), entry, release = closed_form(100, 2, 0.5, 2.0)
    run = sb.reference(system, 2.0, method=method, t_eval=[0.0, 2.0])
    assert abs(run.tip[-1] - x) < error
    assert abs(run.tip_velocity[-1] - v) < error
    assert abs(run.impacts.times[0] - entry) < 4e-16
    assert abs(run.impacts.ends[0] - release) < 1e-15
    assert run.horizon == 2.0
    assert abs(run.energy.stop_dissipation[-1] - 0.5 * (1.0 - x**2 - v**2)) < 1e-14
    # The force is largest at the entry, where it jumps to c v, or inside, as here: above it.
    assert run.impacts.peaks[0] > 2.0 * np.sqrt(0.75)


def test_a_force_that_is_largest_where_it_jumps():
    stops = sb.Stops(upper=0.5, stiffness=1.0, damping=2.0)
    system = sb.System.from_matrices([[1.0]], [[1.0]], contacts=[sb.Contact([1.0], stops)], initial_velocity=[1.0])
    run = sb.reference(system, 4.0)
    assert abs(run.impacts.peaks[0] - 2.0 * np.sqrt(0.75)) < 1e-14
    assert run.contacts[0].peak_force == run.impacts.peaks[0]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.fast(2)
def test_many_digits_agree_with_float64(seed):
    system = kelvin_voigt_system(seed)
    precise, run = (sb.reference(system, 3.0, method=m, t_eval=TIMES) for m in ("multiprecision", "exact"))
    assert precise.horizon == 3.0
    # Rounding of 1e-16 grows by 20 or less.
    assert np.max(np.abs(precise.tip - run.tip)) < 1e-12 * np.max(np.abs(run.tip))
    assert np.array_equal(precise.solution.sides, run.solution.sides)
    assert np.allclose(precise.impacts.times, run.impacts.times, rtol=0.0, atol=1e-12)
    assert np.max(np.abs(precise.energy.loss)) < 1e-12 * np.max(run.energy.energy)


@pytest.mark.parametrize("seed", [0, 1, 3, 7])
def test_tangent_vectors_turn_at_an_entry(seed):
    system, step = kelvin_voigt_system(seed), 1e-7
    growth = sb.lyapunov(system, 3.0, rng=3)
    base = Solver(system).solve(3.0)
    dq, dv = horizon._vectors(system, 3)

    def size(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.sqrt(np.sum(v * (system.mass @ v), axis=0) + np.sum(q * (system.stiffness @ q), axis=0))

    dq, dv = (x / size(dq, dv) for x in (dq, dv))
    assert np.any(base.sides[:, 0])
    assert LET_GO in np.abs(base.sides)
    q, v = (x[-1] for x in base.states(growth.t))
    for j in range(dq.shape[1]):
        moved = replace(system, q0=system.q0 + step * dq[:, j], v0=system.v0 + step * dv[:, j])
        there = [x[-1] for x in Solver(moved).solve(3.0).states(growth.t)]
        grown = size((there[0] - q)[:, None] / step, (there[1] - v)[:, None] / step)[0]
        assert abs(np.log(grown) - growth.log_growth[-1, j]) < 2e-6  # the step times second derivatives


@pytest.mark.slow
def test_a_recorded_load_and_an_ensemble():
    t = np.linspace(0.0, 3.0, 40)
    record = sb.Sampled(t, np.sin(7.0 * t) * np.exp(-t), kind="cubic")
    stops = sb.Stops(-0.05, 0.08, stiffness=80.0, damping=0.7)
    system = sb.System.from_matrices(
        np.eye(2), [[5.0, -2.0], [-2.0, 4.0]], loads=[([2.0, 1.0], record)], contacts=[sb.Contact([1.0, 0.0], stops)]
    )
    run = sb.reference(system, 3.0, t_eval=TIMES)
    for method, error in (("dop853", 1e-9), ("multiprecision", 1e-13)):
        other = sb.reference(system, 3.0, method=method, t_eval=TIMES)
        assert other.impacts.count == run.impacts.count > 1
        assert np.max(np.abs(run.tip - other.tip)) < error * np.max(np.abs(run.tip))
    assert np.max(np.abs(run.energy.loss)) < 1e-12 * np.max(run.energy.energy)
    members = sb.perturbed_members(system, 3, 1e-3)
    every = sb.reference_ensemble(system, 3.0, members, t_eval=TIMES)
    for i, member in enumerate(members):
        assert np.array_equal(every.tip[i], sb.reference(member, 3.0, t_eval=TIMES).tip)


def test_the_paper_beam_between_damped_stops(table10):
    """HHT's error against the exact solution before the third impact falls with the step."""
    problem = replace(table10, stops=sb.Stops(-0.1, 0.1, stiffness=5e6, damping=200.0))
    system = sb.semidiscretise(problem, 8)
    run = sb.reference(system, 0.1)
    assert run.horizon == 0.1
    assert run.impacts.count > 2
    end = float(run.impacts.times[2])
    errors = []
    for dt in (1e-5, 1.25e-6):
        march = sb.integrate(system, sb.Trapezoidal(), dt, 0.1, every=round(1e-4 / dt))
        here = march.t < end
        errors.append(np.max(np.abs(march.tip - run.at(march.t)[0])[here]))
    assert errors[1] < 0.3 * errors[0]
    other = sb.reference(system, 0.1, method="cvode-adams", t_eval=run.t)
    early = run.t < end
    assert np.max(np.abs(other.tip - run.tip)[early]) < 1e-7


def test_a_damped_stop_that_moves_by_samples_is_refused():
    t = np.linspace(0.0, 3.0, 10)
    stops = sb.Stops(upper=0.1, stiffness=9.0, damping=1.0)
    system = one_mass(1.0, stops, offset=sb.Sampled(t, 0.1 * t**2, kind="cubic"), v=1.0)
    with pytest.raises(InputError, match=r"Harmonic and Constant.*solver cvode"):
        sb.reference(system, 3.0)
    assert sb.reference(system, 3.0, method="cvode-adams").impacts.count
