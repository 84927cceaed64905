"""What rigid stops do to neighbouring motions, members and sampled loads: each against runs of their own."""

from __future__ import annotations

import numpy as np
import pytest
from law_systems import RigidWitness, rigid_system
from systems import one_mass

import stiffbeam as sb


def held() -> sb.System:
    """A mass that a load presses on its stop, and another on a spring that a drive moves beside it."""
    stops = sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.5)
    loads = [([-5.0, 0.0], sb.Constant(1.0)), ([0.0, 3.0], sb.Harmonic(1.0, 2.0))]
    stiffness, contacts = [[50.0, -20.0], [-20.0, 40.0]], [sb.Contact([1.0, 0.0], stops)]
    return sb.System.from_matrices(
        np.diag([1.0, 2.0]), stiffness, None, loads, contacts, initial_displacement=[0.0, 0.1], observe=[0.0, 1.0]
    )


def test_neighbours_of_a_body_that_is_held_are_held_too():
    """What is left to them is the free motion of the other, which keeps its energy."""
    assert np.max(np.abs(sb.lyapunov(held(), 1.0).log_growth)) < 1e-12


def test_two_impacts_at_one_time_have_no_neighbours():
    """Each of the tangent vectors hits one stop before the other; apart by 1e-9 they do so one after the other."""
    for start, together in ((1.0, True), (1.0 + 1e-9, False)):
        contacts = [sb.Contact(row, sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.9)) for row in np.eye(2)]
        loads, given = [([-1.0, -1.0], sb.Constant(1.0))], {"initial_displacement": [1.0, start]}
        system = sb.System.from_matrices(np.eye(2), 4.0 * np.eye(2), None, loads, contacts, **given)
        if together:
            with pytest.raises(sb.SolverFailure, match="two contacts are hit at one time"):
                sb.lyapunov(system, 5.0)
        else:
            assert np.all(np.isfinite(sb.lyapunov(system, 5.0).log_growth))
    # A stop that moves hits one of two contacts at the start: the order of the blows decides.
    pair, given = sb.Contact([1.0, -1.0], sb.Stops(upper=0.0, stiffness=np.inf, restitution=0.5)), np.full(2, 0.3)
    hit = sb.Contact([-1.0, 0.0], sb.Stops(upper=-0.3, stiffness=np.inf, restitution=0.5), sb.Harmonic(1.0, 1.0))
    pushed = sb.System.from_matrices(np.eye(2), np.eye(2), contacts=[hit, pair], initial_displacement=given)
    assert sb.reference(pushed, 0.5).horizon == 0.0


@pytest.mark.slow
def test_pairs_start_before_their_rigid_stops():
    found = sb.study("chaos", held(), dt=1e-3, t_end=2.0, span=0.5, starts=6, schemes=["moreau-jean"], jobs=1)
    assert not found.lost
    assert set(found.table.method[found.table.pair.notna()]) == {"exact", "MoreauJean(theta=0.5)"}


@pytest.mark.parametrize(
    ("mass", "stiffness", "force", "row", "stop"),
    [(1.0, 0.0, 9.81, 1.0, 0.0), (0.35, 4.0, 10.0, 1.0, 0.5), (0.35, 4.0, 10.0, 1.1, 0.55)],
)
def test_a_mass_that_is_held_has_no_neighbours(mass, stiffness, force, row, stop):
    """What its projection leaves of them is rounding, whatever the row is: no exponent is made of that."""
    contact = sb.Contact([row], sb.Stops(upper=stop, stiffness=np.inf, restitution=0.3))
    system = sb.System.from_matrices([[mass]], [[stiffness]], None, [([1.0], sb.Constant(force))], [contact])
    with pytest.raises(sb.SolverFailure, match=r"neighbouring motions become equal .*vanish"):
        sb.lyapunov(system, 8.0)


def test_a_stop_that_moves_by_a_record_pushes_a_mass_along():
    t = np.linspace(0.0, 3.0, 25)
    stops = sb.Stops(upper=0.2, stiffness=np.inf, restitution=0.5)
    run = sb.reference(one_mass(1.0, stops, offset=sb.Sampled(t, 0.3 * t**2, kind="cubic")), 3.0)
    assert run.contacts[0].fraction > 0.0  # once the impacts are over
    assert abs(run.energy.loss[-1]) < 1e-12
    riding = one_mass(1.0, stops, offset=sb.Sampled(t, 0.2 + 0.1 * np.sin(3.0 * t), kind="cubic"))
    assert sb.reference(riding, 1.0).horizon == 1.0  # so do copies, whose stops start where their contacts do


# Two contacts that share mass throw each other off in turns without end: the turns come to rest, or go on for ever.
COME_TO_REST = (101, 133, 189)
THROWN = 389  # two contacts hit each other in turns at one time, each blow a thirtieth of the one before
PASSED_THROUGH = 377  # the witness lets a contact that has come to rest through its stop


@pytest.mark.parametrize("seed", [x for x in range(406) if x not in (*COME_TO_REST, THROWN, PASSED_THROUGH)])
@pytest.mark.fast(6, slow=22)
def test_random_systems_against_another_solver(seed):
    """Bounces slower than SLOW are left out by the witness: 2 SLOW/(a (1 - e)) of time, and as much of position."""
    system, times = rigid_system(seed), np.linspace(0.0, 3.0, 61)
    run = sb.reference(system, 3.0, t_eval=times)
    want = RigidWitness(system).solve(times)[0]
    assert np.max(np.abs(run.contacts[0].position - want)) < 1e-4 * np.max(np.abs(want))
    assert np.max(np.abs(run.energy.loss)) < 1e-9 * np.max(run.energy.energy)


@pytest.mark.parametrize("seed", COME_TO_REST)
@pytest.mark.slow
def test_contacts_that_throw_each_other_off_come_to_rest(seed):
    """Speeds fall by a factor in every turn, below rounding at one time: then both are held, and the last impact of
    each has what it presses. Moreau and Jean's scheme, of order 1, goes there too."""
    system, steps = rigid_system(seed), 40_000
    run = sb.reference(system, 3.0, t_eval=np.linspace(0.0, 3.0, 401))
    other = sb.integrate(system, sb.MoreauJean(), 3.0 / steps, 3.0, every=steps // 400)
    assert run.horizon == 3.0
    for record, near in zip(run.contacts, other.contacts, strict=True):
        assert np.max(np.abs(record.stops.penetration(record.position))) < 1e-12
        assert np.max(np.abs(record.position - near.position)) < 1e-3 * np.max(np.abs(record.position))
        assert record.impulse == pytest.approx(near.impulse, rel=1e-3)
        if not np.any(np.isnan(record.impacts.ends)):
            assert np.sum(record.impacts.impulses) == pytest.approx(record.impulse, rel=1e-12)
