"""Members with varied parameters against systems built by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import stiffbeam as sb

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
    problem = sb.BeamProblem.from_physical(
        length=1.0, bending_stiffness=bending, mass_per_length=1.0, bending_viscosity=1.0, stops=stops,
        loads=(sb.PointLoad(0.7, force),),
    )  # fmt: skip
    return sb.semidiscretise(problem, 6)


def assert_alike(many: sb.Ensemble, i: int, run: sb.Trajectory, rtol: float) -> None:
    """Member i is the run of a system built by hand."""
    for seen, record in zip(many.contacts, run.contacts, strict=True):
        assert seen.impact_count[i] == record.impacts.count
        assert seen.peak_force[i] == pytest.approx(record.peak_force, rel=rtol)
        assert seen.impulse[i] == pytest.approx(record.impulse, rel=rtol)


def test_members_with_other_matrices_are_the_beams_built_by_hand():
    system = tube()
    values = {"stiffness": 300.0 * SHARES, "stops.stiffness": 1e4 * SHARES[::-1], "loads[0].time.scale": SHARES}
    members = sb.varied_members(system, values)
    many = sb.integrate_ensemble(system, HHT, 2e-4, 0.5, members, every=1)
    assert members.separate
    assert len({m.stiffness.tobytes() for m in members}) == 5
    assert all(np.sum(c.impact_count) > 0 for c in many.contacts)
    for i, (bending, kappa, level) in enumerate(zip(*values.values(), strict=True)):
        hand = tube(bending, (kappa, kappa), level)
        run = sb.integrate(hand, HHT, 2e-4, 0.5)
        assert_alike(many, i, run, 1e-6)
        np.testing.assert_allclose(many.tip[i], run.tip, rtol=0.0, atol=1e-6 * np.max(np.abs(run.tip)))
        assert many.ledger(i).supplied[-1] == pytest.approx(run.energy.supplied[-1], rel=1e-6)


@pytest.mark.slow
def test_the_exact_members_are_the_exact_beams_built_by_hand():
    system = tube()
    values = {"stiffness": [290.0, 310.0], "stops[0].position": [0.51, 0.58]}
    exact = sb.reference_ensemble(system, 0.2, sb.varied_members(system, values))
    for i, (bending, place) in enumerate(zip(*values.values(), strict=True)):
        assert_alike(exact, i, sb.reference(tube(bending, place=place), 0.2), 1e-6)


def test_members_that_share_their_matrices_march_side_by_side():
    system = tube()
    members = sb.varied_members(system, {"stops[1].upper": 2e-4 * SHARES, "stops[0].stiffness": 1e4 * SHARES})
    assert not members.separate
    many = sb.integrate_ensemble(system, HHT, 5e-4, 0.5, members)
    for i, member in enumerate(members):
        assert_alike(many, i, sb.integrate(member, HHT, 5e-4, 0.5), 1e-12)
    assert members[0].contacts[1].stops.upper == 2e-4 * SHARES[0]


@pytest.mark.slow
def test_a_factor_on_a_record_is_that_of_each_member():
    """The record is one object in all members: a march that looked at it alone gave all the load of the first."""
    system = tube()
    members = sb.varied_members(system, {"loads[0].time.scale": [0.5, 1.0, 2.0]})
    many = sb.integrate_ensemble(system, HHT, 5e-4, 0.5, members)
    exact = sb.reference_ensemble(system, 0.1, members)
    for i, level in enumerate((0.5, 1.0, 2.0)):
        assert_alike(many, i, sb.integrate(tube(level=level), HHT, 5e-4, 0.5), 1e-6)
        assert_alike(exact, i, sb.reference(tube(level=level), 0.1), 1e-6)


def test_a_name_of_a_case_file_is_a_path(tmp_path: Path):
    """A file states the stiffness as bending_stiffness, and its range too."""
    (tmp_path / "tube.toml").write_text(
        """[[case]]
name = "tube"
cells = 4
dt = 1e-4
t_end = 0.1
[case.problem]
length = 1.2
bending_stiffness = 668.0
mass_per_length = 0.647
bending_viscosity = 0.15
[case.uncertain]
bending_stiffness = [661, 675]
"""
    )
    case = sb.load_cases(tmp_path / "tube.toml")["tube"]
    system = case.system()
    (changed,) = sb.varied_members(system, {"bending_stiffness": [700.0]}).systems()
    assert changed.problem.stiffness == 700.0
    assert case.uncertain == {"bending_stiffness": (661.0, 675.0)}
