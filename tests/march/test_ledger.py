"""The energy ledger: its definition, and the compiled sums in modal coordinates against it."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from systems import one_mass, two_contacts

import stiffbeam as sb
from stiffbeam.model.semidiscretisation import FORMS
from stiffbeam.schemes import registered
from stiffbeam.trajectory.records import Ledger, step_ledger


@pytest.mark.parametrize("scheme", [sb.HHT(-0.1), sb.SDIRK(), sb.BDF2()], ids=str)
def test_the_ledger_of_a_step_by_step_sum(scheme, table10):
    """E, input and loss recomputed from the run's states by the definition."""
    system = sb.semidiscretise(table10, 12)
    run = sb.integrate(system, scheme, 1e-4, 0.3)
    q, v = run.states
    E = 0.5 * np.einsum("ki,ij,kj->k", v, system.mass, v) + 0.5 * np.einsum("ki,ij,kj->k", q, system.stiffness, q)
    E += table10.stops.energy(q[:, -1])
    f = system.load(run.t)
    d_input = 0.5 * np.sum((f[1:] + f[:-1]) * np.diff(q, axis=0), axis=1)
    assert np.allclose(run.energy.energy, E, rtol=1e-10)
    assert np.allclose(run.energy.input[1:], np.cumsum(d_input), rtol=1e-9)
    assert np.allclose(run.energy.loss, E[0] - E + run.energy.input, rtol=0, atol=1e-10 * E.max())
    assert np.allclose(
        run.energy.loss_in_contact + run.energy.loss_without_contact, run.energy.loss, rtol=0, atol=1e-10 * E.max()
    )


def test_the_trapezoidal_rule_loses_energy_at_the_kink_only(table10):
    """In free flight the ledger's input is the trapezoidal rule's own work."""
    run = sb.integrate(sb.semidiscretise(table10, 12), sb.HHT(0.0), 1e-4, 0.3)
    assert run.impacts.count > 3
    assert np.max(np.abs(run.energy.loss_without_contact)) < 1e-9 * np.max(run.energy.energy)
    assert np.max(np.abs(run.energy.loss_in_contact)) > 1e-3 * np.max(run.energy.energy)


def test_an_energy_beyond_float64_is_said_and_not_returned():
    """The motion is held still by a viscosity whose dissipation overflows."""
    beam = sb.BeamProblem(stiffness=300.0, viscosity=1.3e115, base=sb.Harmonic(0.2, 10.0))
    run = sb.integrate(sb.semidiscretise(beam, 4), sb.HHT(alpha=-0.1), 1e-3, 1e-2)
    assert np.all(np.isfinite(run.tip))
    with pytest.raises(sb.Diverged, match="energy is beyond float64"):
        _ = run.energy


def test_viscous_loss_is_what_the_dashpots_take():
    """Free decay of one damped mode by the trapezoidal rule: E0 - E = viscous, to rounding."""
    system = sb.System.from_matrices([[1.0]], [[9.0]], [[0.4]], observe=[1.0], initial_displacement=[1.0])
    run = sb.integrate(system, sb.HHT(0.0), 0.01, 5.0)
    assert np.allclose(run.energy.viscous, run.energy.energy[0] - run.energy.energy, rtol=0, atol=1e-12)
    assert abs(run.energy.viscous[-1] - 4.5) > 0.1


@pytest.mark.parametrize("scheme", [sb.HHT(-0.1), sb.ExponentialFlow(), sb.BDF2()], ids=str)
def test_a_loss_that_unresolved_dashpots_leave_open_is_not_told(scheme):
    """A mass on a dashpot, c dt/m = 100 and 0.01: what the dashpot takes within a step is not loss of the scheme."""
    for c, known in ((1e4, False), (1.0, True)):
        system = one_mass(1.0, sb.Stops(upper=9.0, stiffness=10.0), damping=c, v=1.0)
        ledger = sb.integrate(system, scheme, 1e-2, 1.0).energy
        assert ledger.is_resolved() == known
        assert np.isfinite(ledger.lost_fraction()) == known
        other = sb.reference(system, 1.0).energy
        assert other.is_resolved()
        if known:
            off = ledger.viscous[-1] - other.viscous[-1]
            assert abs(off) < 1e-3


@pytest.mark.parametrize("law", [{"damping": 30.0}, {"dissipation": 1.0}], ids=str)
def test_a_loss_that_unresolved_damped_stops_leave_open_is_not_told(law):
    """The trapezoidal rule at 28 and 2800 steps a contact: what is said to be lost is what the stop takes."""
    system = one_mass(25.0, sb.Stops(upper=0.1, stiffness=1e4, **law), v=2.0)
    coarse, fine = (sb.integrate(system, sb.Trapezoidal(), dt, 3.0).energy for dt in (1e-3, 1e-5))
    assert not coarse.is_resolved()
    assert fine.is_resolved()
    assert abs(fine.lost_fraction()) < 1e-4 < coarse.loss[-1] / coarse.supplied[-1]
    assert abs(coarse.stop_dissipation[-1] - fine.stop_dissipation[-1]) < coarse.spread[-1]


def assert_the_same_ledger(run: sb.Trajectory) -> None:
    """The run's own, compiled and in modal coordinates, and that of its states by the definition.

    Each entry is a sum over at most ``steps`` terms of the size of the energy, each with a few roundings
    for each coordinate; those of a scheme that goes round in the same rounding errors add up linearly.
    """
    system, own = run.system, run.energy
    assert system is not None
    assert run.pieces is not None
    other = step_ledger(system, run.pieces(), run.t)
    size = np.max(np.abs(other.energy)) + np.max(np.abs(other.input))
    rounding = np.finfo(float).eps * 10 * system.size * run.work.steps * size
    assert np.array_equal(own.t, other.t)
    for field in fields(Ledger)[1:]:
        difference = np.max(np.abs(getattr(own, field.name) - getattr(other, field.name)))
        assert difference <= rounding, (field.name, difference, rounding)
    assert np.max(np.abs(other.loss_in_contact)) > 1e6 * rounding


@pytest.mark.parametrize("scheme", list(registered()), ids=str)
@pytest.mark.parametrize("contact", ["implicit", "extrapolated"])
def test_the_compiled_ledger_is_that_of_the_states(scheme, contact, table10_system):
    assert_the_same_ledger(sb.integrate(table10_system, scheme, 1e-4, 0.15, contact, every=3))


@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.1), sb.SDIRK()], ids=str)
def test_the_compiled_ledger_takes_dashpots_moving_stops_and_sampled_loads(scheme, table10):
    viscous = sb.BeamProblem(stiffness=300.0, viscosity=0.05, stops=table10.stops, base=table10.base)
    assert_the_same_ledger(sb.integrate(sb.semidiscretise(viscous, 16), scheme, 1e-4, 0.2))
    assert_the_same_ledger(sb.integrate(two_contacts(), scheme, 2e-3, 3.0))
    sampled = two_contacts(load=lambda t: 15.0 * np.sin(4.0 * t), offset=lambda t: 0.05 * np.sin(3.0 * t))
    assert_the_same_ledger(sb.integrate(sampled, scheme, 2e-3, 3.0))


def test_the_ledger_does_not_depend_on_where_stretches_end(table10, monkeypatch):
    from stiffbeam.march import block_march

    run = sb.integrate(sb.semidiscretise(table10, 12), sb.BDF2(), 1e-4, 0.3, every=7)
    monkeypatch.setattr(block_march, "STEPS_REPLAYED", 96)
    assert_the_same_ledger(run)


@pytest.mark.parametrize("scheme", list(registered()), ids=str)
@pytest.mark.parametrize("every", [1, 50, 64, 307])
@pytest.mark.fast(8)
def test_blocks_that_no_contact_meets_are_passed_over_without_a_difference(scheme, every, monkeypatch):
    """Against the definition; and both ways against each other where outputs lie at the ends of blocks and between."""
    from stiffbeam.march import replay

    passed, free_block = [], replay.free_block
    monkeypatch.setattr(replay, "SHORT", 1)
    monkeypatch.setattr(replay, "free_block", lambda *given: passed.append(1) or free_block(*given))
    run = sb.integrate(two_contacts(), scheme, 2e-3, 8.0, every=every)
    assert_the_same_ledger(run)
    assert passed
    monkeypatch.setattr(replay, "SHORT", 10**9)
    assert_the_same_ledger(sb.integrate(two_contacts(), scheme, 2e-3, 8.0, every=every))


@pytest.mark.parametrize("scheme", [sb.HHT(-0.1), sb.BDF2(), sb.SDIRK()], ids=str)
@pytest.mark.parametrize(
    "stops", [{"damping": 300.0}, {"damping": 2e3}, {"dissipation": 1.0}, {"exponent": 1.5}], ids=str
)
@pytest.mark.fast(4)
def test_the_ledger_of_a_long_run_on_stops_of_other_laws_is_that_of_the_states(scheme, stops, table10):
    """A damped stop lets go before the gap opens: it holds energy then, and its block is not one without contact."""
    problem = replace(table10, stops=sb.Stops(-0.1, 0.1, stiffness=1e6, **stops))
    assert_the_same_ledger(sb.integrate(sb.semidiscretise(problem, 8), scheme, 1e-4, 1.0, every=1000))


def test_the_ledger_needs_no_particular_kernel(kernel, table10):
    assert_the_same_ledger(sb.integrate(sb.semidiscretise(table10, 12), sb.HHT(), 1e-4, 0.2))


@pytest.fixture(scope="module", params=("displacement", "velocity-curvature", "damped"))
def small(request, table10):
    """A small beam in contact at once, in each form."""
    problem = replace(table10, stops=sb.Stops(-0.002, 0.002, stiffness=1e5))
    if request.param == "damped":
        problem = replace(problem, viscosity=0.01)
    return sb.semidiscretise(problem, 5, request.param if request.param in FORMS else "displacement")


@pytest.mark.fast(20)
@pytest.mark.parametrize("scheme", list(registered()), ids=str)
def test_the_ledger_of_every_scheme_and_form_balances(scheme, small):
    system, run = small, sb.integrate(small, scheme, 1e-3, 0.2)
    ledger, (q, v) = run.energy, run.states
    assert run.contacts[0].fraction > 0.1
    assert np.max(ledger.stops) > 0.0
    scale = np.max(np.abs(ledger.energy)) + np.max(np.abs(ledger.input))
    rounding = len(run.t) * np.finfo(float).eps * scale
    total = ledger.kinetic + ledger.elastic + ledger.stops
    assert np.max(np.abs(total - system.energy(run.t, q, v))) <= rounding
    balance = ledger.energy - ledger.energy[0] - ledger.input + ledger.viscous + ledger.loss
    assert np.max(np.abs(balance)) <= rounding
    assert np.max(np.abs(ledger.loss - ledger.loss_in_contact - ledger.loss_without_contact)) <= rounding
    # Input, viscous loss and energy once more, straight from the states of every step.
    dq, force = np.diff(q, axis=0), np.array([system.load(t) for t in run.t])
    work = np.cumsum([0.5 * (force[n] + force[n + 1]) @ dq[n] for n in range(len(dq))])
    viscous = np.cumsum([d @ system.damping @ d / 1e-3 for d in dq])
    assert np.max(np.abs(ledger.input[1:] - work)) <= 10 * rounding
    assert np.max(np.abs(ledger.viscous[1:] - viscous)) <= 10 * rounding
    kinetic = 0.5 * np.einsum("ki,ij,kj->k", v, system.mass, v)
    assert np.max(np.abs(ledger.kinetic - kinetic)) <= 10 * rounding
    if system.damped:
        assert ledger.viscous[-1] > 1e-3 * scale
