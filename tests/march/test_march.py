"""The march in blocks against a plain march: every scheme, form and contact treatment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import plain_march
import pytest
from oracles import exact_linear
from systems import linear_part, two_contacts

import stiffbeam as sb
from stiffbeam.kernels import march as kernel
from stiffbeam.kernels.march import LINEAR, Kept
from stiffbeam.march import block_march
from stiffbeam.march.probe import InModes, Together
from stiffbeam.march.propagator import build
from stiffbeam.march.treatment import TREATMENTS
from stiffbeam.model.modes import modes
from stiffbeam.schemes import registered

SCHEMES = [*registered(), sb.HHT(-0.1).printed(), sb.SDIRK().printed("sigma")]
T_SHORT = 0.056  # through the first contacts of Table 10; rounding has grown a thousandfold by 0.1


def assert_equal_runs(modal, other, tolerance, march="modal blocks"):
    scale = np.max(np.abs(other.tip))
    assert modal.provenance["march"] == march
    assert np.max(np.abs(modal.tip - other.tip)) < tolerance * scale
    assert np.max(np.abs(modal.tip_velocity - other.tip_velocity)) < 1e4 * tolerance * np.max(
        np.abs(other.tip_velocity)
    )
    assert np.max(np.abs(modal.states[0] - other.states[0])) < tolerance * scale
    for a, b in zip(modal.contacts, other.contacts, strict=True):
        assert list(a.impacts.stops) == list(b.impacts.stops)
        assert np.max(np.abs(a.impacts.times - b.impacts.times), initial=0.0) < 1e3 * tolerance


@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.parametrize("contact", ["implicit", "extrapolated"])
@pytest.mark.fast(6)
def test_modal_blocks_equal_the_plain_march(scheme, contact, table10_system):
    """Equal within eps (w_max/w_1)^2 = 1e-10 a step at worst; extrapolated contact amplifies it."""
    modal = sb.integrate(table10_system, scheme, 1e-4, T_SHORT, contact)
    other = plain_march.march(table10_system, scheme, 1e-4, T_SHORT, contact)
    assert modal.impacts.count > 0
    assert_equal_runs(modal, other, 1e-10 if contact == "implicit" else 1e-7)


def with_dashpots(system):
    """Dashpots at single nodes, which couple the modes."""
    damping = np.zeros((system.size, system.size))
    damping[3, 3], damping[10, 10], damping[3, 10], damping[10, 3] = 0.7, 0.4, -0.3, -0.3
    return replace(system, damping=damping)


DENSE = [(s, c) for s in SCHEMES for c in TREATMENTS if TREATMENTS[c].takes(s)]


@pytest.mark.parametrize(("scheme", "contact"), DENSE, ids=str)
@pytest.mark.fast(2)
def test_dense_blocks_equal_the_plain_march(scheme, contact, table10_system):
    """Of a damping that does not decouple; tolerances as for the modal blocks."""
    system = with_dashpots(table10_system)
    dense = sb.integrate(system, scheme, 1e-4, T_SHORT, contact)
    other = plain_march.march(system, scheme, 1e-4, T_SHORT, contact)
    assert dense.impacts.count > 0
    assert_equal_runs(dense, other, 1e-7 if contact == "extrapolated" else 1e-10, "dense blocks")
    assert np.max(np.abs(dense.energy.loss - other.energy.loss)) < 1e-6 * np.max(other.energy.input)


def test_a_short_run_is_not_worth_long_blocks(table10_system):
    """Ten steps of 25 unknowns are done before the powers of one are made, a million are not."""
    coordinates = Together(with_dashpots(table10_system))
    assert [block_march.block_length(coordinates, sb.HHT(-0.1), steps) for steps in (10, 1_000_000)] == [1, 32]


@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.1), sb.SDIRK(), sb.SDIRK(1.0, nystrom=True)], ids=str)
@pytest.mark.parametrize("contact", ["implicit", "extrapolated"])
@pytest.mark.fast(2)
def test_the_marches_agree_with_viscosity(scheme, contact, table10):
    problem = sb.BeamProblem(stiffness=300.0, viscosity=0.05, stops=table10.stops, base=table10.base)
    system = sb.semidiscretise(problem, 16)
    modal = sb.integrate(system, scheme, 1e-4, 0.08, contact)
    assert modal.impacts.count > 0
    assert_equal_runs(modal, plain_march.march(system, scheme, 1e-4, 0.08, contact), 1e-9)


@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.1), sb.SDIRK()], ids=str)
@pytest.mark.parametrize("contact", ["implicit", "extrapolated"])
@pytest.mark.fast(1)
def test_the_marches_agree_with_two_contacts_and_a_moving_stop(scheme, contact):
    system = two_contacts()
    modal = sb.integrate(system, scheme, 2e-3, 3.0, contact)
    assert all(c.impacts.count > 0 for c in modal.contacts)
    assert_equal_runs(modal, plain_march.march(system, scheme, 2e-3, 3.0, contact), 1e-9)


@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.1), sb.SDIRK()], ids=str)
def test_a_callable_load_and_a_callable_offset_equal_the_harmonic_ones(scheme):
    harmonic = sb.integrate(two_contacts(), scheme, 2e-3, 2.0)
    sampled = sb.integrate(
        two_contacts(load=lambda t: 15.0 * np.sin(4.0 * t), offset=lambda t: 0.05 * np.sin(3.0 * t)), scheme, 2e-3, 2.0
    )
    assert np.max(np.abs(harmonic.tip - sampled.tip)) < 1e-11
    # The velocity of the callable offset is a central difference, good to 1e-9.
    assert np.max(np.abs(harmonic.contacts[1].velocity - sampled.contacts[1].velocity)) < 1e-8
    assert np.max(np.abs(harmonic.energy.input - sampled.energy.input)) < 1e-10


@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.1), sb.SDIRK()], ids=str)
def test_blocks_of_any_length_are_the_same_scheme(scheme, table10, monkeypatch):
    system = sb.semidiscretise(table10, 25)
    whole = sb.integrate(system, scheme, 1e-4, T_SHORT)
    for length in (1, 3, 8):
        monkeypatch.setattr("stiffbeam.march.integrate.block_length", lambda *_, length=length: length)
        other = sb.integrate(system, scheme, 1e-4, T_SHORT)
        assert np.max(np.abs(whole.tip - other.tip)) < 1e-11 * np.max(np.abs(whole.tip))


def test_a_block_equals_its_definition_in_numpy(table10):
    """w = reading z + g entries, z' = transition z + g state, then the stops node by node."""
    system = sb.semidiscretise(table10, 25)
    basis = modes(system)
    assert basis is not None
    stepper = block_march.Stepper.of(InModes(system, basis), sb.HHT(-0.1), 1e-4, TREATMENTS["implicit"], 32, LINEAR)
    block, forcing = stepper.block.block, stepper.block.forcing([system])
    rng = np.random.default_rng(1)
    z = stepper.block.pack(rng.normal(size=(4, 1, 25)) * np.array([0.1, 1.0, 10.0, 10.0])[:, None, None])[0]
    t = 0.3
    g = np.array([1.0, np.sin(10.0 * t), np.cos(10.0 * t)])
    D, R = block.reading.shape
    row = np.concatenate([z[:D] @ block.reading, np.zeros(D)]) + g @ forcing.rows[0]
    for c in range(3):
        for e in range(3):
            diagonal = block.transition[(e - c) % 3, c * 25 : (c + 1) * 25]
            row[R + c * 25 : R + (c + 1) * 25] += diagonal * z[e * 25 : (e + 1) * 25]
    forces = np.zeros(32)
    for i in range(32):
        forces[i] = table10.stops.solve(row[i], block.push[i, i])
        row += forces[i] * block.push[i]
    w, expected = row[:R], row[R : R + 75]
    velocities = block.velocity[:, 0] @ z[:D] + block.velocity_push[:, 0] @ forces + forcing.velocity[0, :, 0] @ g
    march = stepper.start([system], 32, 1)
    state = march.state._replace(z=z[None].copy())
    cursor = np.zeros(3, np.int64)
    first = round(t / 1e-4)
    positions, times = np.zeros((1, first + 33, 1)), np.zeros(first + 33)
    outputs = times, positions, positions.copy(), march.node_forces, positions.copy()
    kept = Kept(*outputs, np.zeros((1, len(z))), np.zeros((1, 32)))
    inflow = stepper.block.inflow(np.zeros(1), 1.0)
    assert kernel.run(block, march.law, forcing, inflow, state, kept, march.events, first, 32, 1e-4, 1, cursor)
    assert np.count_nonzero(kept.forces) > 0
    assert np.allclose(positions[0, first + 1 :, 0], w, rtol=0, atol=1e-12 * np.max(np.abs(w)))
    speeds = kept.velocities[0, first + 1 :, 0]
    assert np.allclose(speeds, velocities, rtol=0, atol=1e-12 * np.max(np.abs(velocities)))
    assert np.array_equal(times[first + 1 :], np.arange(first + 1, first + 33) * 1e-4)
    assert np.array_equal(kept.contact_forces[0, :, 0], table10.stops.force(positions[0, :, 0]))
    assert np.allclose(kept.forces[0], forces, rtol=1e-10)
    assert np.allclose(state.z[0, :75], expected, rtol=0, atol=1e-12 * np.max(np.abs(expected)))


def test_components_that_only_add_to_others_are_left_out(table10):
    """HHT carries q + .. a, v + .. a and the net force; its a is gone. What is left goes on as before."""
    system = sb.semidiscretise(table10, 12)
    basis = modes(system)
    assert basis is not None
    kept = {
        "HHT(alpha=-0.1)": 3, "HHT(alpha=-0.3)": 3, "HHT(alpha=0.0)": 2, "bdf2": 4, "Theta(theta=0.5)": 2,
        "SDIRK(gamma=0.4359)": 2, "HHT(alpha=-0.1).printed(unweighted)": 3,
    }  # fmt: skip

    def reading(propagator, packed):
        return packed[0, : len(propagator.block.reading)] @ propagator.block.reading

    for scheme in SCHEMES:
        reduced, full = (
            build(scheme, InModes(system, basis), 1e-4, 8, TREATMENTS["implicit"], reduced=x) for x in (True, False)
        )
        if str(scheme) in kept:
            assert len(reduced.one.keep) == kept[str(scheme)]
        rng = np.random.default_rng(2)
        sizes = np.array([0.1, 1.0, 1e3, 1e3])[: full.one.mix.shape[1], None, None]
        z = rng.normal(size=(full.one.mix.shape[1], 1, 12)) * sizes
        entries = [reading(x, x.pack(z)) for x in (reduced, full)]
        assert np.allclose(*entries, rtol=0, atol=1e-12 * np.max(np.abs(entries[1])))
        again = full.pack(reduced.unpack(reduced.pack(z)))
        assert np.allclose(reading(full, again), entries[1], rtol=0, atol=1e-12 * np.max(np.abs(entries[1])))


def test_every_thins_the_output_and_nothing_else(table10):
    system = sb.semidiscretise(table10, 25)
    full = sb.integrate(system, sb.SDIRK(), 1e-4, 0.5)
    thin = sb.integrate(system, sb.SDIRK(), 1e-4, 0.5, every=7)
    assert np.array_equal(thin.t, full.t[::7])
    assert np.array_equal(thin.tip, full.tip[::7])
    assert np.allclose(thin.tip_velocity, full.tip_velocity[::7], rtol=0, atol=1e-12)
    assert np.array_equal(thin.impacts.times, full.impacts.times)
    assert thin.contacts[0].peak_force == full.contacts[0].peak_force
    assert np.array_equal(thin.energy.loss, full.energy.loss[::7])
    assert np.array_equal(thin.states[0], full.states[0][::7])


def test_a_run_is_the_same_to_the_bit_when_made_again(table10):
    system = sb.semidiscretise(table10, 25)
    runs = [sb.integrate(system, sb.HHT(), 1e-4, 1.0) for _ in range(2)]
    assert np.array_equal(runs[0].tip, runs[1].tip)
    # The states are made by a second march: they must be those of the first, through the chaos.
    assert np.max(np.abs(runs[0].states[0][:, -1] - runs[0].tip)) < 1e-12


def test_a_step_that_does_not_divide_the_end_is_refused_with_one_that_does(table10):
    with pytest.raises(sb.InputError, match=r"0\.0001$"):
        sb.integrate(sb.semidiscretise(table10, 8), sb.HHT(), 1.0001e-4, 0.1)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"dt": -1.0}, "dt"), ({"t_end": 0.0}, "t_end"), ({"every": 0}, "every"), ({"contact": "penalty"}, "contact"),
    ],
)  # fmt: skip
def test_bad_arguments_are_named(arguments, field, table10):
    with pytest.raises(sb.InputError, match=field):
        sb.integrate(sb.semidiscretise(table10, 8), sb.HHT(), **({"dt": 1e-4, "t_end": 0.01} | arguments))


def test_an_overflow_names_scheme_time_and_remedy():
    """Extrapolated contact overflows on Table 11 with dt = 2.5e-4, implicit contact does not."""
    case = sb.paper_case(11)
    system = sb.semidiscretise(case.problem, case.cells)
    for scheme in (sb.BDF2(), sb.HHT(-0.1), sb.SDIRK(nystrom=True)):
        with pytest.raises(sb.Diverged, match="implicit") as caught:
            sb.integrate(system, scheme, 2.5e-4, case.t_end, "extrapolated")
        assert 0.0 < caught.value.t < case.t_end
        assert str(scheme) in str(caught.value)
        assert np.all(np.isfinite(sb.integrate(system, scheme, 2.5e-4, case.t_end).tip))


def test_sampled_impacts_are_counted_by_the_papers_rule(table10):
    """An impact is a step in contact whose predecessor was not (or was on the other stop)."""
    run = sb.integrate(sb.semidiscretise(table10, 25), sb.HHT(), 1e-4, 2.0)
    chi = table10.stops.state(run.tip)
    counted = np.flatnonzero((chi[1:] != 0) & (chi[1:] != chi[:-1])) + 1
    assert run.impacts.count == len(counted) > 100
    assert np.array_equal(run.impacts.stops, chi[counted])
    # The time lies inside the step that ends in contact.
    assert np.all(run.impacts.times <= run.t[counted] + 1e-15)
    assert np.all(run.impacts.times >= run.t[counted - 1] - 1e-15)
    assert run.contacts[0].fraction == np.mean(chi[1:] != 0)
    force = np.abs(table10.stops.force(run.tip))
    assert np.isclose(run.contacts[0].peak_force, force.max(), rtol=1e-12)
    assert np.isclose(run.contacts[0].impulse, np.trapezoid(force, dx=1e-4), rtol=1e-9)
    closed = run.impacts.impulses[~np.isnan(run.impacts.impulses)]
    assert np.isclose(closed.sum(), force.sum() * 1e-4, rtol=1e-2)


def test_the_impact_time_is_where_the_hermite_cubic_crosses(table10):
    from scipy.interpolate import CubicHermiteSpline

    run = sb.integrate(sb.semidiscretise(table10, 25), sb.SDIRK(), 1e-4, 0.3)
    spline = CubicHermiteSpline(run.t, run.tip, run.tip_velocity)
    assert run.impacts.count > 10
    assert np.allclose(spline(run.impacts.times), 0.1 * run.impacts.stops, rtol=0, atol=1e-13)


def test_a_flight_over_the_whole_gap_inside_one_step_counts_the_second_stop():
    """u jumps from the upper to the lower stop: chi changes sign and the crossing of the lower is timed."""
    from stiffbeam.trajectory.recorder import sampled_impacts

    stops = sb.Stops(-1.0, 1.0, stiffness=1.0)
    t = np.arange(5) * 0.5
    u, v = 1.2 * np.cos(2 * np.pi * t), -2.4 * np.pi * np.sin(2 * np.pi * t)
    impacts = sampled_impacts(t, u, v, stops)
    assert list(impacts.stops) == [-1, 1, -1, 1]
    assert np.all((impacts.times > t[:-1]) & (impacts.times < t[1:]))


def test_displacement_at_the_tip_and_the_clamp(table10):
    run = sb.integrate(sb.semidiscretise(table10, 25), sb.HHT(), 1e-4, 0.05, every=50)
    u = run.displacement([0.0, 1.0])
    assert np.allclose(u[:, 1], run.tip, atol=1e-12)
    assert np.allclose(u[:, 0], 0.2 * np.sin(10 * run.t), atol=1e-12)


def test_every_one_step_scheme_solves_a_rigid_body_mode():
    """q'' = f with K = 0 on one coordinate: no division by the zero frequency."""
    system = sb.System.from_matrices(
        np.eye(2), [[1.0, -1.0], [-1.0, 1.0]], loads=[([1.0, 1.0], sb.Constant(2.0))], observe=[0.5, 0.5]
    )
    exact = exact_linear(*linear_part(system), np.array([1.5]), 1.0, np.zeros(2), np.zeros(2), np.full(2, 2.0))
    for scheme in (sb.HHT(-0.1), sb.SDIRK(), sb.Theta()):
        run = sb.integrate(system, scheme, 0.01, 1.5)
        assert np.isclose(run.tip[-1], exact[0][0].mean(), rtol=1e-4)


@pytest.mark.parametrize("damping", [None, [[0.3, 0.1], [0.1, 0.0445]]], ids=["modal", "dense"])
def test_a_node_beyond_the_step_sees_the_load_there_in_the_last_step_too(damping):
    """SDIRK(0.3) asks for loads at 2.67 dt: a run that ends at t = 2 is the start of one that goes on."""
    times = np.arange(0.0, 3.5, 0.5)
    for load in (sb.Sampled(times, [0.0, 1.0, -1.0, 2.0, 5.0, -20.0, 7.0]), lambda t: np.asarray(t) ** 2):
        system = sb.System.from_matrices(
            np.eye(2), [[4.0, -1.0], [-1.0, 3.0]], damping, [([1.0, 0.0], load)], observe=[1.0, 0.0]
        )
        with pytest.warns(UserWarning, match="beyond the step"):
            scheme = sb.SDIRK(0.3)
        short, long = (sb.integrate(system, scheme, 0.1, t_end) for t_end in (2.0, 2.5))
        assert np.allclose(short.tip, long.tip[:21], rtol=0.0, atol=1e-13)
    ends = sb.Sampled(times[:5], [0.0, 1.0, -1.0, 2.0, 5.0])
    system = sb.System.from_matrices(np.eye(2), np.eye(2), damping, [([1.0, 0.0], ends)], observe=[1.0, 0.0])
    with pytest.raises(sb.InputError, match="t"):
        sb.integrate(system, scheme, 0.1, 2.0)
