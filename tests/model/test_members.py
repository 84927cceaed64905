"""Members with varied parameters against systems built by hand; paths to parameters; the how-to scripts."""

from __future__ import annotations

from dataclasses import replace

import massless_contact
import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.model.members import march_apart
from stiffbeam.trajectory.ensemble import Ensemble

RECORD = sb.Sampled(np.linspace(0.0, 0.5, 51), 4.0 * np.sin(44.0 * np.linspace(0.0, 0.5, 51)), "cubic")
HHT = sb.HHT(-0.1)
SHARES = np.array([0.97, 1.02, 0.99, 1.04, 0.95])


def tube(bending: float = 300.0, kappa: tuple[float, float] = (1e4, 2e4), level: float = 1.0, place: float = 0.55):
    """A beam between two loose supports of different stiffness, under a record."""
    stops = [
        sb.Stops(-2e-4, 2e-4, stiffness=kappa[0], position=place),
        sb.Stops(-2e-4, 2e-4, stiffness=kappa[1], damping=0.5),
    ]
    force = sb.Sampled(RECORD.t, level * RECORD.values, "cubic")
    problem = sb.BeamProblem(
        length=1.0, stiffness=bending, mass_per_length=1.0, viscosity=1.0, stops=stops,
        loads=(sb.PointLoad(0.7, force),),
    )  # fmt: skip
    return sb.semidiscretise(problem, 6)


def assert_alike(many: Ensemble, i: int, run: sb.Trajectory, rtol: float) -> None:
    """Member i is the run of a system built by hand."""
    for seen, record in zip(many.contacts, run.contacts, strict=True):
        assert seen.impact_count[i] == record.impacts.count
        assert seen.peak_force[i] == pytest.approx(record.peak_force, rel=rtol)
        assert seen.impulse[i] == pytest.approx(record.impulse, rel=rtol)


def test_members_with_other_matrices_are_the_beams_built_by_hand():
    """A factor on a record, one object in all members, is that of each."""
    values = {"stiffness": 300.0 * SHARES, "stops.stiffness": 1e4 * SHARES[::-1], "loads[0].time.scale": SHARES}
    members = sb.varied_members(tube(), values)
    many = sb.integrate_ensemble(tube(), HHT, 2e-4, 0.5, members, every=1)
    assert march_apart(members)
    assert len({m.stiffness.tobytes() for m in members}) == 5
    assert all(np.sum(c.impact_count) > 0 for c in many.contacts)
    for i, (bending, kappa, level) in enumerate(zip(*values.values(), strict=True)):
        run = sb.integrate(tube(bending, (kappa, kappa), level), HHT, 2e-4, 0.5)
        assert_alike(many, i, run, 1e-6)
        np.testing.assert_allclose(many.tip[i], run.tip, rtol=0.0, atol=1e-6 * np.max(np.abs(run.tip)))
        assert many.ledger(i).supplied[-1] == pytest.approx(run.energy.supplied[-1], rel=1e-6)


# ------------------------------------------------------------------ parameters by path


def test_drives_of_one_frequency_go_together_with_their_phases():
    both = sb.Superposition(sb.Harmonic(1.0, 2.0), sb.Harmonic(3.0, 2.0, 0.5))
    system = one_mass(4.0, load=both)
    terms = [term for _, term in sb.varied_members(system, {"frequency": [5.0]})[0].loads[0][1].terms]
    assert terms == [sb.Harmonic(1.0, 5.0), sb.Harmonic(3.0, 5.0, 0.5)]
    with pytest.raises(sb.InputError, match="by its path"):
        sb.varied_members(system, {"amplitude": [5.0]})
    moving = one_mass(
        4.0, sb.Stops(None, 0.1, stiffness=50.0), load=sb.Harmonic(1.0, 2.0), offset=sb.Harmonic(0.01, 2.0)
    )
    with pytest.raises(sb.InputError, match="by its path"):
        sb.varied_members(moving, {"amplitude": [2.0]})


def test_a_clearance_is_the_distance_of_both_stops_from_zero():
    moved = sb.varied_members(sb.paper_case(10).system(), {"clearance": [0.07]})[0]
    assert (moved.contacts[0].stops.lower, moved.contacts[0].stops.upper) == (-0.07, 0.07)
    assert moved.problem.stops == moved.contacts[0].stops
    with pytest.raises(sb.InputError, match="case with stops"):
        sb.varied_members(sb.System.from_matrices([[1.0]], [[1.0]], observe=[1.0]), {"clearance": [0.07]})
    with pytest.raises(sb.InputError, match=r"be the only one to set its number"):
        sb.varied_members(sb.paper_case(10).system(), {"stops[0].upper": [0.2], "clearance": [0.07]})


def test_stops_bolted_to_the_base_go_with_the_drive():
    """A member is the beam that is built with the other drive; one that has an initial velocity is refused."""

    def rig(base, start=None):
        stops = [sb.Stops(-0.01, 0.01, stiffness=1e4, motion=base), sb.Stops(None, 0.008, stiffness=1e4, position=0.6)]
        return sb.semidiscretise(sb.BeamProblem(stiffness=3.0, stops=stops, base=base, initial_velocity=start), 8)

    for change, base in (({"amplitude": [0.03]}, (0.03, 5.0)), ({"frequency": [6.0]}, (0.02, 6.0))):
        changed = sb.varied_members(rig(sb.Harmonic(0.02, 5.0)), change)[0]
        assert changed.fingerprint == rig(sb.Harmonic(*base)).fingerprint
    started = rig(sb.Harmonic(0.02, 5.0), sb.PolynomialProfile((0.1, 1.0)))
    with pytest.raises(sb.InputError, match="kept where the beam has an initial velocity"):
        sb.varied_members(started, {"amplitude": [0.03]})


def test_paths_of_a_beam_change_its_problem():
    """Also that of the only stops, with an index and without; members with other matrices are the beams of theirs."""

    def beam(stiffness=3.0, drive=5.0, **damped):
        stops = [sb.Stops(-0.1, 0.1, stiffness=1e4), sb.Stops(upper=0.1, stiffness=1e4, position=0.5, **damped)]
        return sb.semidiscretise(sb.BeamProblem(stiffness=stiffness, stops=stops, base=sb.Harmonic(0.02, drive)), 6)

    changed = sb.varied_members(beam(), {"base.frequency": [7.0], "contacts[1].stops.damping": [2.0]})
    assert changed[0].fingerprint == beam(drive=7.0, damping=2.0).fingerprint
    stops = sb.Stops(-0.1, 0.1, stiffness=np.inf, restitution=0.5)
    only = sb.semidiscretise(sb.BeamProblem(stiffness=3.0, stops=stops, base=sb.Harmonic(0.02, 5.0)), 6)
    for path in ("contacts[0].stops.restitution", "stops[0].restitution", "stops.restitution"):
        assert sb.varied_members(only, {path: [0.7]})[0].contacts[0].stops == replace(stops, restitution=0.7)
    members = sb.varied_members(beam(), {"stiffness": [4.0, 3.0]})
    assert [m.fingerprint for m in members] == [beam(4.0).fingerprint, beam(3.0).fingerprint]
    many = sb.integrate_ensemble(beam(), HHT, 1e-3, 0.1, members, every=1)
    for tip, stiffness in zip(many.tip, (4.0, 3.0), strict=True):
        np.testing.assert_array_equal(tip, sb.integrate(beam(stiffness), HHT, 1e-3, 0.1).tip)
    started = sb.varied_members(
        one_mass(4.0), {"initial_displacement[0]": [1.0, 2.0], "initial_velocity[0]": [3.0, 4.0]}
    )
    assert [(m.q0[0], m.v0[0]) for m in started] == [(1.0, 3.0), (2.0, 4.0)]


def test_two_paths_to_one_number_are_refused():
    """The later one won, and the results had the values of both."""
    system = one_mass(1.0, sb.Stops(upper=0.2, stiffness=50.0), damping=0.1, load=sb.Harmonic(1.0, 2.0))
    for one, other in (
        ("stops[0].upper", "contacts[0].stops.upper"), ("stops.upper", "stops[0].upper"),
        ("initial_displacement[0]", "q0[0]"),
    ):  # fmt: skip
        with pytest.raises(sb.InputError, match="be the only one to set its number"):
            sb.varied_members(system, {one: [0.1], other: [0.3]})
        assert len(sb.varied_members(system, {one: [0.1], other: [0.1]})) == 1
    kept = sb.varied_members(system, {"damping.scale": [2.0], "damping[0][0]": [1.0], "stops[0].upper": [0.4]})
    assert kept[0].damping[0, 0] == 1.0


# ------------------------------------------------------------------ the how-to scripts


def test_a_rod_without_mass_at_its_end_rebounds_with_its_speed():
    """The impulse of a free rod on a wall is twice its momentum; the mass of the node sets the error, 1/(2 n)."""
    assert sb.reference(massless_contact.rod(40), 3.0).contacts[0].impulse == pytest.approx(2.0, rel=1 / 80)


def test_neighbours_of_a_start_on_a_rigid_stop_are_not_beyond_it():
    stops = sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.5)
    system = one_mass(10.0, stops, load=sb.Harmonic(5.0, 3.0))
    members = sb.perturbed_members(system, 8, 1e-7, t_end=3.0)
    assert min(float(x.q0[0]) for x in members) == 0.0
    assert len({float(x.v0[0]) for x in members}) == 8
    marched = sb.integrate_ensemble(system, sb.MoreauJean(), 1e-3, 3.0, members)
    assert np.array_equal(
        marched.contacts[0].impact_count, sb.reference_ensemble(system, 3.0, members).contacts[0].impact_count
    )
