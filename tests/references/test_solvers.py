"""The reference solvers against each other, and how far each can be trusted."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest
from law_systems import Witness
from systems import SYSTEMS, one_mass, rotor

import stiffbeam as sb
from stiffbeam.references import solve
from stiffbeam.references.horizon import agreement, impacts_match_until
from stiffbeam.references.registry import REFERENCES
from stiffbeam.trajectory.records import Impacts

ADAPTIVE = [method for method in REFERENCES.values() if method.kind == "adaptive"]
FOLLOWING = [method for method in ADAPTIVE if method.name != "kvaerno3"]  # which takes minutes at 1e-9


def relative(a, b):
    return np.max(np.abs(a.tip - b.tip)) / np.max(np.abs(b.tip))


WITHOUT_EXACT = ("Hertz", "Hunt-Crossley", "damped stop that moves by a record")  # have no exact solution
SLOW = ("radau", "kvaerno5")


@pytest.mark.fast(14, slow=26)
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize(
    "method", [x.name if x.name not in SLOW else pytest.param(x.name, marks=pytest.mark.slow) for x in FOLLOWING]
)
def test_every_solver_follows_every_system(method, name):
    """Motion, events, forces and energies at rtol 1e-9. Its errors grow by 1e4 at most in these times."""
    make, t_end = SYSTEMS[name]
    system, times = make(), np.linspace(0.0, t_end, 121)
    witness, rtol = ("exact", 0.0) if name not in WITHOUT_EXACT else ("cvode-adams", 1e-12)
    if witness == method:
        witness = "dop853"
    truth, run = solve(system, t_end, witness, times, rtol, None), solve(system, t_end, method, times, 1e-9, None)
    assert relative(run, truth) < 1e-5
    for mine, its in zip(run.states, truth.states, strict=True):
        assert np.max(np.abs(mine - its)) < 1e-4 * np.max(np.abs(its))
    for a, b in zip(run.contacts, truth.contacts, strict=True):
        assert a.impacts.kind == "event"
        assert list(a.impacts.stops) == list(b.impacts.stops)
        assert np.allclose(a.impacts.times, b.impacts.times, rtol=0.0, atol=1e-6 * t_end)
        assert np.allclose(a.impacts.ends, b.impacts.ends, rtol=0.0, atol=1e-6 * t_end, equal_nan=True)
        assert np.allclose(a.impacts.peaks, b.impacts.peaks, rtol=1e-4, equal_nan=True)
        assert np.allclose(a.impacts.impulses, b.impacts.impulses, rtol=1e-4, equal_nan=True)
        assert np.allclose([a.fraction, a.peak_force, a.impulse], [b.fraction, b.peak_force, b.impulse], rtol=1e-4)
    # Integrals of the solver, which do not depend on the outputs.
    most = np.max(truth.energy.energy)
    for field in ("energy", "input", "viscous", "stop_dissipation"):
        assert np.max(np.abs(getattr(run.energy, field) - getattr(truth.energy, field))) < 1e-5 * most
    assert np.max(np.abs(run.energy.loss)) < 1e-5 * most


def test_the_time_to_which_impact_sequences_match():
    def impacts(times, stops):
        return Impacts.at(times, stops, "event")

    a = impacts([1.0, 2.0, 3.0], [1, -1, 1])
    assert impacts_match_until(a, a, 1e-4, 5.0) == 5.0
    assert impacts_match_until(a, impacts([1.0, 2.00005, 3.0], [1, -1, 1]), 1e-4, 5.0) == 5.0
    assert impacts_match_until(a, impacts([1.0, 2.1, 3.0], [1, -1, 1]), 1e-4, 5.0) == np.nextafter(2.0, 0.0)
    assert impacts_match_until(a, impacts([1.0, 2.0, 3.0], [1, 1, 1]), 1e-4, 5.0) == np.nextafter(2.0, 0.0)
    assert impacts_match_until(a, impacts([1.0, 2.0], [1, -1]), 1e-4, 5.0) == 3.0
    assert impacts_match_until(impacts([1.0], [1]), impacts([1.0, 4.99999], [1, 1]), 1e-4, 5.0) == 5.0


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


def test_a_solution_that_is_not_a_number_agrees_with_nothing(table10):
    ref = solve(sb.semidiscretise(table10, 8), 0.05, "exact", None, 0.0, None)
    broken = replace(ref, tip=np.where(ref.t > 0.02, np.nan, ref.tip))
    assert agreement(ref, broken, 1e-4) < 0.0201


@pytest.mark.slow
def test_kvaerno_keeps_its_program_on_disk(table10):
    system, t = sb.semidiscretise(table10, 8), np.linspace(0.0, 0.03, 31)
    ref = solve(system, 0.03, "kvaerno3", t, 1e-5, None)
    assert relative(ref, solve(system, 0.03, "exact", t, 0.0, None)) < 1e-3
    assert jax.config.jax_compilation_cache_dir


# ------------------------------------------------------------------ damping that is not symmetric or gives energy


TIMES = np.linspace(0.0, 3.0, 301)


def test_the_exact_solution_follows_the_rotor():
    run, truth = sb.reference(rotor(), 3.0, t_eval=TIMES), Witness(rotor()).solve(TIMES)[0]
    assert sum(c.impacts.count for c in run.contacts) == 19
    assert np.max(np.abs(run.tip - truth)) < 1e-6 * np.max(np.abs(truth))
    assert np.max(np.abs(run.energy.loss)) < 1e-6 * np.max(run.energy.energy)  # gyroscopic forces do no work


def test_what_needs_a_symmetric_damping_refuses_another():
    free = replace(rotor(), contacts=(), loads=())
    from stiffbeam.measures.amplification import free_mode_errors

    with pytest.raises(sb.InputError, match=r"damping must have a symmetric .*for the errors of each mode"):
        free_mode_errors(sb.integrate(free, sb.HHT(), 1e-3, 1.0))


def test_damping_that_gives_energy_is_marched_and_solved():
    """x'' - .2 x' + 40 x = 0 grows until it meets both stops: the adaptive solvers agree, and so do the schemes."""
    system = one_mass(40.0, sb.Stops(-0.1, 0.1, stiffness=500.0), damping=-0.2, v=0.5)
    assert not system.passive
    ref = sb.reference(system, 3.0, "dop853", t_eval=TIMES)
    assert ref.impacts.count > 0
    assert ref.horizon == 3.0
    assert ref.energy.viscous[-1] < 0.0
    run = sb.integrate(system, sb.HHT(), 1e-3, 3.0, every=10)
    assert np.max(np.abs(run.tip - ref.tip)) < 1e-3 * np.max(np.abs(ref.tip))
    assert run.energy.viscous[-1] == pytest.approx(ref.energy.viscous[-1], rel=1e-2)
