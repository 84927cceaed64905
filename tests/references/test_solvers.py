"""The reference solvers against each other, and how far each can be trusted."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest
from systems import bouncing_chain

import stiffbeam as sb
from stiffbeam.basics import storage
from stiffbeam.references import solve
from stiffbeam.references.adaptive import diffrax
from stiffbeam.references.horizon import agreement, impacts_match_until, time_tolerance
from stiffbeam.references.registry import REFERENCES
from stiffbeam.trajectory.records import Impacts

ADAPTIVE = [method for method in REFERENCES.values() if method.kind == "adaptive"]
AFFORDABLE = [method.name for method in ADAPTIVE if method.name != "kvaerno3"]
OUTPUTS = np.linspace(0.0, 0.1, 401)


def relative(a, b):
    return np.max(np.abs(a.tip - b.tip)) / np.max(np.abs(b.tip))


@pytest.fixture(scope="module")
def exact_table10(table10_system):
    return solve(table10_system, 0.1, "exact", OUTPUTS, 0.0, None)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "bound"), [("cvode", 1e-8), ("cvode-adams", 1e-8), ("dop853", 2e-11)])
def test_at_tolerance_1e_12_the_solvers_agree_on_table_10(method, bound, exact_table10, table10_system):
    """Errors are amplified about a thousandfold over the ten impacts to T = 0.1."""
    other = solve(table10_system, 0.1, method, OUTPUTS, 1e-12, None)
    assert relative(other, exact_table10) < bound
    assert other.impacts.count == exact_table10.impacts.count >= 10
    assert np.max(np.abs(other.impacts.times - exact_table10.impacts.times)) < 1e-9
    assert list(other.impacts.stops) == list(exact_table10.impacts.stops)


@pytest.mark.campaign
def test_dop853_at_its_tightest_shows_the_exact_solution_good_to_1e_12(exact_table10, table10_system):
    from scipy.integrate import solve_ivp

    ode = table10_system.ode()
    # Steps short against the fastest period (1.5e-4): the dense output adds nothing at the kinks.
    result = solve_ivp(ode.rhs, (0.0, 0.1), ode.y0, "DOP853", OUTPUTS, rtol=3e-14, atol=1e-15, max_step=5e-6)
    tip = ode.displacement(result.y.T)[:, -1]
    assert np.max(np.abs(tip - exact_table10.tip)) < 3e-12 * np.max(np.abs(tip))


@pytest.mark.parametrize(
    "method",
    [
        pytest.param(m.name, marks=pytest.mark.campaign if m.name in ("kvaerno3", "radau") else pytest.mark.slow)
        for m in ADAPTIVE
    ],
)  # some take 15 s to a minute of steps
def test_at_tolerance_1e_8_the_solvers_agree_to_the_second_impact(method, table10_system):
    times = np.linspace(0.0, 0.054, 28)
    exact = solve(table10_system, 0.054, "exact", times, 0.0, None)
    other = solve(table10_system, 0.054, method, times, 1e-8, None)
    assert relative(other, exact) < 1e-5
    assert np.max(np.abs(other.states[0] - exact.states[0])) < 1e-5
    assert exact.impacts.count == other.impacts.count > 0


@pytest.mark.slow
@pytest.mark.parametrize("method", AFFORDABLE)
def test_the_solvers_agree_on_a_system_from_matrices(method):
    system, times = bouncing_chain(), np.linspace(0.0, 6.0, 121)
    exact = solve(system, 6.0, "exact", times, 0.0, None)
    other = solve(system, 6.0, method, times, 1e-9, None)
    assert exact.impacts.count > 5
    assert set(exact.impacts.stops) == {-1, 1}
    assert relative(other, exact) < 1e-5
    if other.impacts.kind == "event":
        assert exact.impacts.count == other.impacts.count
        assert np.max(np.abs(other.impacts.times - exact.impacts.times)) < 1e-5
    assert np.max(np.abs(other.tip_velocity - exact.tip_velocity)) < 1e-3


def test_the_horizon_of_table_10_is_what_perturbed_runs_show(table10):
    """Rounding grows by about 33 digits per time unit: the horizon lies between 0.3 and 0.45."""
    system = sb.semidiscretise(table10, 25)
    ref = sb.reference(system, 1.0)
    assert 0.3 < ref.horizon < 0.45
    moved = dataclasses.replace(system, v0=system.v0 * (1 + 1e-14))
    other = solve(moved, 1.0, "exact", ref.t, 0.0, None)
    parted = agreement(ref, other, time_tolerance(system))
    assert 0.3 < parted < 0.55
    assert parted > ref.horizon - 0.1
    assert abs(time_tolerance(system) - 1.03e-4) < 1e-6


@pytest.mark.slow
def test_the_horizon_of_an_adaptive_solver_grows_with_its_tolerance(table10):
    system = sb.semidiscretise(table10, 12)
    horizons = [sb.reference(system, 0.5, "cvode-adams", rtol=rtol).horizon for rtol in (1e-4, 1e-7, 1e-10)]
    assert horizons[0] < horizons[1] < horizons[2]


def test_the_time_to_which_impact_sequences_match():
    def impacts(times, stops):
        return Impacts.at(times, stops, "event")

    a = impacts([1.0, 2.0, 3.0], [1, -1, 1])
    assert impacts_match_until(a, a, 1e-4, 5.0) == 5.0
    assert impacts_match_until(a, impacts([1.0, 2.00005, 3.0], [1, -1, 1]), 1e-4, 5.0) == 5.0
    assert impacts_match_until(a, impacts([1.0, 2.1, 3.0], [1, -1, 1]), 1e-4, 5.0) == 2.0
    assert impacts_match_until(a, impacts([1.0, 2.0, 3.0], [1, 1, 1]), 1e-4, 5.0) == 2.0
    assert impacts_match_until(a, impacts([1.0, 2.0], [1, -1]), 1e-4, 5.0) == 3.0
    assert impacts_match_until(impacts([1.0], [1]), impacts([1.0, 4.99999], [1, 1]), 1e-4, 5.0) == 5.0


@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.1), sb.SDIRK(), sb.SDIRK(nystrom=True)], ids=str)
def test_the_schemes_with_viscosity_converge_to_cvode(scheme, table10):
    """Order 2 through contact: the kink of the compliance limits every fixed-step scheme to that."""
    problem = dataclasses.replace(table10, viscosity=2.0)
    system = sb.semidiscretise(problem, 10)
    ref = solve(system, 0.12, "cvode", np.array([0.04, 0.08, 0.12]), 1e-11, None)
    errors = []
    for dt in (1e-4, 5e-5, 2.5e-5, 1.25e-5):
        run = sb.integrate(system, scheme, dt, 0.12, every=round(0.04 / dt))
        errors.append(np.max(np.abs(run.tip[1:] - ref.tip)))
    assert ref.impacts.count > 0
    assert errors[-1] < 2e-5
    assert errors[-1] < errors[0] / 20  # 64 at order 2


@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
def test_cvode_takes_a_callable_load_like_a_harmonic_one(form):
    tips = []
    for load in (sb.Harmonic(3.0, 25.0), lambda t: 3.0 * np.sin(25.0 * t)):
        problem = sb.BeamProblem(stiffness=300.0, loads=(sb.PointLoad(0.5, load),))
        tips.append(solve(sb.semidiscretise(problem, 8, form), 0.2, "cvode-adams", None, 1e-9, None).tip)
    assert np.max(np.abs(tips[0] - tips[1])) < 1e-8


@pytest.mark.slow
def test_a_reference_without_an_exact_partner_is_held_against_itself(table10):
    pushed = dataclasses.replace(table10, viscosity=2.0, loads=(sb.PointLoad(0.5, lambda t: np.cos(9.0 * t)),))
    ref = sb.reference(sb.semidiscretise(pushed, 8), 0.1, "cvode", rtol=1e-9)
    assert "itself" in ref.provenance["horizon_against"]
    assert ref.horizon == 0.1


@pytest.mark.fast(1)
@pytest.mark.parametrize("method", ["cvode-adams", "dop853", "ida"])
def test_an_adaptive_reference_answers_at_any_time(method, table10):
    """At its outputs with these, elsewhere by solving once more: as near to the exact motion, in any order of times."""
    system = sb.semidiscretise(table10, 8)
    ref, exact = (solve(system, 0.1, x, np.linspace(0, 0.1, 5), 1e-10, None) for x in (method, "exact"))
    assert np.array_equal(ref.at([0.05])[0], ref.tip[2:3])
    times = np.array([0.0623, 0.004, 0.1, 0.0623])
    for contact in (None, 0):
        for found, wanted in zip(ref.at(times, contact), exact.at(times, contact), strict=True):
            assert np.max(np.abs(found - wanted)) < 1e-6 * np.max(np.abs(wanted))
    assert np.max(np.abs(ref.at([0.0777])[0] - exact.at([0.0777])[0])) < 1e-7  # one time alone
    assert ref.state_at is not None
    assert exact.state_at is not None
    q, wanted = ref.state_at(times)[0], exact.state_at(times)[0]
    assert np.max(np.abs(q - wanted)) < 1e-6 * np.max(np.abs(wanted))


def test_a_bad_method_lists_the_near_ones(table10):
    with pytest.raises(sb.InputError, match="cvode"):
        sb.reference(sb.semidiscretise(table10, 8), 0.1, "cvod")


@pytest.mark.parametrize("viscosity", [0.05, 2.0])
def test_the_exact_solution_with_viscosity_agrees_with_cvode_and_closes_its_ledger(viscosity, table10):
    """A contact state is not proportionally damped: complex eigenvalues; at d = 2 most modes are overdamped."""
    system = sb.semidiscretise(dataclasses.replace(table10, viscosity=viscosity), 16)
    times = np.linspace(0.0, 0.2, 201)
    exact = solve(system, 0.2, "exact", times, 0.0, None)
    other = solve(system, 0.2, "cvode", times, 1e-10, None)
    assert exact.impacts.count == other.impacts.count > 1
    assert relative(other, exact) < 1e-8
    assert np.max(np.abs(other.impacts.times - exact.impacts.times)) < 1e-9
    assert np.max(np.abs(other.states[1] - exact.states[1])) < 1e-5 * np.max(np.abs(exact.states[1]))
    assert exact.energy.viscous[-1] > 1.0
    assert np.max(np.abs(exact.energy.loss)) < 1e-10 * np.max(np.abs(exact.energy.input))


@pytest.mark.slow
@pytest.mark.parametrize("method", AFFORDABLE)
def test_the_solvers_agree_on_two_contacts_with_a_moving_stop(method):
    from systems import two_contacts

    system, times = two_contacts(), np.linspace(0.0, 4.0, 201)
    exact = solve(system, 4.0, "exact", times, 0.0, None)
    other = solve(system, 4.0, method, times, 1e-10, None)
    assert relative(other, exact) < 1e-6
    for a, b in zip(exact.contacts, other.contacts, strict=True):
        assert a.impacts.count > 3
        if b.impacts.kind == "event":
            assert a.impacts.count == b.impacts.count
            assert np.max(np.abs(a.impacts.times - b.impacts.times)) < 1e-6
    # The moving stop does work: without it the ledger would be off by its whole energy.
    assert np.max(np.abs(exact.energy.loss)) < 1e-10 * np.max(exact.energy.energy)


@pytest.mark.parametrize("method", ["exact", "cvode"])
def test_output_times_past_the_end_are_refused(method, table10):
    with pytest.raises(sb.InputError, match="t_eval"):
        sb.reference(sb.semidiscretise(table10, 8), 0.05, method, t_eval=np.linspace(0.0, 0.2, 11))


def test_a_solution_that_is_not_a_number_agrees_with_nothing(table10):
    ref = solve(sb.semidiscretise(table10, 8), 0.05, "exact", None, 0.0, None)
    broken = dataclasses.replace(ref, tip=np.where(ref.t > 0.02, np.nan, ref.tip))
    assert agreement(ref, broken, 1e-4) < 0.0201


@pytest.mark.slow
def test_a_later_process_reads_the_programs_of_jax_from_disk(table10, monkeypatch, tmp_path):
    monkeypatch.setattr(storage, "directory", lambda: tmp_path)
    system, compiled = sb.semidiscretise(table10, 4), []
    compile_of = jax.stages.Lowered.compile

    def counting(lowered):
        compiled.append(lowered)
        return compile_of(lowered)

    monkeypatch.setattr(jax.stages.Lowered, "compile", counting)

    def solution():
        monkeypatch.setattr(diffrax, "_PROGRAMS", {})  # as in a process that begins
        return solve(system, 0.02, "kvaerno3", np.linspace(0.0, 0.02, 21), 1e-5, None)

    first = solution()
    files = list((tmp_path / "jax").iterdir())
    assert len(compiled) == len(files) >= 2
    second = solution()
    assert len(compiled) == len(files)
    assert np.array_equal(first.tip, second.tip)
    # A file that is cut is compiled anew, and written.
    files[0].write_bytes(files[0].read_bytes()[:1000])
    assert np.array_equal(first.tip, solution().tip)
    assert len(compiled) == len(files) + 1
    assert files[0].stat().st_size > 10_000


@pytest.mark.slow
def test_kvaerno_takes_its_compilation_out_of_the_time_and_refuses_what_jax_cannot_trace(table10, monkeypatch):
    monkeypatch.setattr(diffrax, "_PROGRAMS", {})  # whatever test ran before in this process
    system = sb.semidiscretise(table10, 8)
    ref = solve(system, 0.03, "kvaerno3", np.linspace(0.0, 0.03, 31), 1e-5, None)
    assert ref.provenance["compile_seconds"] > 0.0
    again = solve(system, 0.03, "kvaerno3", np.linspace(0.0, 0.03, 31), 1e-5, None)
    assert "compile_seconds" not in again.provenance
    # By one clock: compilation on several threads must not be taken off twice.
    assert ref.work.march_seconds > 0.5 * again.work.march_seconds
    exact = solve(system, 0.03, "exact", np.linspace(0.0, 0.03, 31), 0.0, None)
    assert relative(ref, exact) < 1e-3
    pushed = dataclasses.replace(table10, loads=(sb.PointLoad(0.5, lambda t: 0 * t),))
    with pytest.raises(sb.InputError, match="Harmonic, Constant and Sampled"):
        solve(sb.semidiscretise(pushed, 8), 0.1, "kvaerno5", None, 1e-6, None)


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_kvaerno_finds_an_impact_between_two_outputs(exponent):
    """A free mass at speed 1 meets a stop at t = 1/2, stays pi/sqrt(1000) if it is linear, and takes 2 from it."""
    stops = sb.Stops(upper=0.5, stiffness=1000.0, exponent=exponent)
    one = np.ones((1, 1))
    system = sb.System.from_matrices(one, 0.0 * one, contacts=[sb.Contact([1.0], stops)], initial_velocity=[1.0])
    ref = sb.reference(system, 3.0, "kvaerno5", [0.0, 1.0, 2.0, 3.0], rtol=1e-8)
    depth = (0.5 * (exponent + 1.0) / 1000.0) ** (1.0 / (exponent + 1.0))
    stay = {1.0: np.pi / np.sqrt(1000.0), 1.5: 2.9432750587545 * depth}[exponent]  # Hertz (1882) for p = 3/2
    assert ref.horizon == 3.0
    assert ref.impacts.durations == pytest.approx([stay], rel=1e-5)
    assert ref.contacts[0].fraction == pytest.approx(stay / 3.0, rel=1e-5)
    assert ref.contacts[0].impulse == pytest.approx(2.0, rel=1e-6)
    assert ref.impacts.kind == "event"
    assert ref.impacts.times == pytest.approx([0.5], abs=1e-7)
