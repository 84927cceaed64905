"""Contacts that rest on rigid stops, or are hit, let go or brought to rest at one time: momentum, closed forms, and
frozen solutions in many digits."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb

COUPLED = np.linalg.inv([[1.0, 0.5], [0.5, 1.0]])  # M of which the inverse is this


def stop(row, restitution=0.5, **where):
    return sb.Contact(row=row, stops=sb.Stops(stiffness=np.inf, restitution=restitution, **where))


def bar(inertia, restitution, q0, weight=1.0, spring=0.0, v0=(0.0, 0.0)):
    """A rigid bar of mass 1 that falls on supports at both ends: its middle, downwards, and its turn."""
    contacts = [stop([1.0, x], e, upper=0.0) for x, e in zip((1.0, -1.0), restitution, strict=True)]
    load = [([weight, 0.0], sb.Constant(1.0))]
    M, K = np.diag([1.0, inertia]), np.diag([0.0, spring])
    return sb.System.from_matrices(M, K, loads=load, contacts=contacts, initial_displacement=q0, initial_velocity=v0)


def balls(starts, restitution, v0, gap=0.0):
    """Equal balls in a row, each with its stop at the next one: q_i - q_{i+1} <= gap."""
    n = len(v0)
    rows = np.eye(n)[:-1] - np.eye(n)[1:]
    contacts = [stop(row, restitution, upper=gap) for row in rows]
    given = {"initial_displacement": starts, "initial_velocity": v0}
    return sb.System.from_matrices(np.eye(n), np.zeros((n, n)), contacts=contacts, **given)


ROW = np.array([0.0, 0.1, 0.2, 0.30000000000000004, 0.4])  # differences of doubles: 0.1 but for rounding


@pytest.mark.fast(1)
def test_an_impact_whose_result_the_order_decides_ends_the_horizon():
    """All at once (-0.6, 0.4, ...); one after the other, as gaps give it, (0, 0, 0, 0, 1)."""
    v0, at_once = np.eye(5)[0], [-0.6, 0.4, 0.4, 0.4, 0.4]
    touching = sb.reference(balls(np.zeros(5), 1.0, v0), 1.0)
    assert touching.horizon == 0.0
    assert touching.states[1][-1] == pytest.approx(at_once, abs=1e-12)
    later = sb.reference(balls(np.array([-0.5, 0.0, 0.0, 0.0, 0.0]), 1.0, v0), 1.0)
    assert 0.49 < later.horizon < 0.5 + 1e-12
    assert sb.reference(balls(ROW, 1.0, v0, -0.1), 1.0).horizon == 0.0
    apart = sb.reference(balls(np.zeros(5), 1.0, v0, 1e-12), 1.0)
    assert apart.horizon == 1.0
    assert apart.states[1][-1] == pytest.approx([0.0, 0.0, 0.0, 0.0, 1.0], abs=1e-12)


@pytest.mark.parametrize(
    ("restitution", "v0", "v"),
    [(1.0, [1.0, 0.0, -1.0], [-1.0, 0.0, 1.0]), (0.0, [1.0, 0.0, 0.0], [1 / 3, 1 / 3, 1 / 3])],
)
def test_an_impact_whose_result_no_order_changes_is_known(restitution, v0, v):
    """Two balls that hit a third from both sides, and balls that stay together."""
    run = sb.reference(balls(np.zeros(3), restitution, v0), 1.0)
    assert run.horizon == 1.0
    assert run.states[1][-1] == pytest.approx(v, abs=1e-9)


def test_a_comparison_says_why_a_flat_drop_ends_the_horizon():
    system = bar(0.2, (0.5, 0.5), (-0.5, 0.0))
    reference = sb.reference(system, 2.0)
    assert reference.horizon <= 1.0 + 1e-9
    run = sb.integrate(system, sb.MoreauJean(), 1e-3, 2.0)
    assert "hit at one time, t = 1: their order decides" in str(sb.compare(run, reference))


FLAT = [(0.2, (0.5, 0.5), (-0.5, 0.0), 1.0, 0.0), (0.05, (0.8, 0.8), (-0.5, 0.0), 1.0, 0.0)]
ROCKING = [
    (3.0, (0.25, 0.5), (-0.5, 0.125), 2.0, 4.0),
    (1.5, (0.5, 0.5), (-0.375, -0.25), 2.0, 0.0),
    (2.0, (0.5, 0.5), (-0.3, 0.0), 1.0, 4.0),
    (0.05, (0.8, 0.8), (-0.3, 0.1), 1.0, 0.0),
]


@pytest.mark.parametrize("case", FLAT + ROCKING, ids=str)
@pytest.mark.fast(1)
def test_a_bar_that_rocks_comes_to_rest(case):
    """Infinitely many impacts of both ends in turns. At rest at first and at last: the impulses are the weight's."""
    inertia, restitution, q0, weight, spring = case
    t = np.linspace(0.0, 12.0, 241)
    run = sb.reference(bar(inertia, restitution, q0, weight, spring), 12.0, t_eval=t)
    assert sum(c.impulse for c in run.contacts) == pytest.approx(12.0 * weight, rel=1e-9)
    assert np.max(np.abs(run.states[1][-1])) < 1e-12
    assert max(abs(c.position[-1]) for c in run.contacts) < 1e-12
    assert np.max(np.abs(run.energy.loss)) < 1e-9


@pytest.mark.parametrize("restitution", [0.0, 0.8])
def test_a_contact_that_another_one_which_leaves_presses_again(restitution):
    """sin(w t) presses both until pi/w; then A leaves, and drives B on its stop.

    M^-1 = (1, -0.9; -0.9, 1), p = (1, 1/5). From pi/w on, s = |sin|: R_B = (0.9 - 0.2) s, u_A'' = -(1 - 0.18 - 0.63) s.
    """
    w, T = 2.8, 1.5
    contacts = [stop(row, restitution, upper=0.0) for row in ([1.0, 0.0], [0.0, 1.0])]
    M = np.linalg.inv([[1.0, -0.9], [-0.9, 1.0]])
    load = [([1.0, 0.2], sb.Harmonic(1.0, w))]
    run = sb.reference(sb.System.from_matrices(M, np.zeros((2, 2)), loads=load, contacts=contacts), T)
    later = (1.0 + np.cos(w * T)) / w
    assert [c.impulse for c in run.contacts] == pytest.approx([2.0 / w, 0.4 / w + 0.7 * later], rel=1e-12)
    left = -0.19 / w * (T - np.pi / w + np.sin(w * T) / w)
    assert run.contacts[0].position[-1] == pytest.approx(left, rel=1e-10)
    assert abs(run.contacts[1].position[-1]) < 1e-15


@pytest.mark.fast(1)
@pytest.mark.parametrize("upper", [0.0, pytest.param(0.5, marks=pytest.mark.slow)])
def test_a_body_at_rest_on_its_stop_takes_its_part_in_a_blow(upper):
    """A rests on a lower stop, B hits an upper one with speed 1: 0 <= P_A _|_ U_A+ >= 0 and U_B+ = -1/2.

    P_B - P_A/2 = 3/2 and P_A = P_B/2: P = (1, 2), after which A stays and B leaves with 1/2, a quarter of the energy.
    """
    contacts = [stop([1.0, 0.0], lower=0.0), stop([0.0, 1.0], upper=upper)]
    system = sb.System.from_matrices(COUPLED, np.zeros((2, 2)), contacts=contacts, initial_velocity=[0.0, 1.0])
    t_end = upper + 1.0
    run = sb.reference(system, t_end)
    assert [c.impulse for c in run.contacts] == pytest.approx([1.0, 2.0], rel=1e-12)
    assert run.contacts[0].position[-1] == pytest.approx(0.0, abs=1e-12)
    assert run.contacts[1].position[-1] == pytest.approx(upper - 0.5, abs=1e-12)
    energy = 0.5 * COUPLED[1, 1]
    assert run.energy.stop_dissipation[-1] == pytest.approx(0.75 * energy, rel=1e-12)


@pytest.mark.fast(1)
@pytest.mark.parametrize("written", ["decimals", "moving stop"])
def test_two_that_start_on_their_stops_but_for_rounding_have_no_order(written):
    """A stop at the decimal 0.3 and a start at the double next to it: who is hit first is not known in float64. Written
    exactly they are hit at once, (-0.5, -0.65); A first gives (-0.9125, -0.275): no horizon either."""
    q0 = [0.3, 0.1]
    contacts = [stop([1.0, 0.0], upper="0.3"), stop([0.0, 1.0], upper="0.1")]
    if written == "moving stop":
        motion = sb.Harmonic(0.02, 9.0, 1.0)
        moved = sb.Stops(upper=0.1 + float(motion.value(0.0)), stiffness=np.inf, restitution=0.5)
        contacts[1] = sb.Contact(row=[0.0, 1.0], stops=moved, offset=motion)
    given = {"initial_displacement": q0, "initial_velocity": [1.0, 1.3]}
    system = sb.System.from_matrices(COUPLED, 5.0 * np.eye(2), contacts=contacts, **given)
    assert sb.reference(system, 1.0).horizon == 0.0


@pytest.mark.parametrize("size", [1, 2, 3])
def test_a_plastic_impact_of_a_free_body(size):
    """It stays where it is hit: P = v/(row M^-1 row), and nothing presses it."""
    rng = np.random.default_rng(size)
    A = rng.standard_normal((size, size))
    mass, row, v0 = A @ A.T + np.eye(size), np.eye(size)[0], np.append(0.3, np.full(size - 1, 0.7))
    contact = stop(row, 0.0, upper=0.1)
    system = sb.System.from_matrices(mass, np.zeros((size, size)), contacts=[contact], initial_velocity=v0)
    run = sb.reference(system, 1.0)
    assert run.horizon == 1.0
    assert run.impacts.count == 1
    assert run.impacts.times[0] == pytest.approx(1.0 / 3.0, rel=1e-12)
    assert run.contacts[0].impulse == pytest.approx(0.3 / np.linalg.inv(mass)[0, 0], rel=1e-10)
    assert run.contacts[0].position[-1] == pytest.approx(0.1, rel=1e-12)


def bed(bodies: int) -> tuple:
    """Equal bodies side by side, each on a stop below, with springs and inertia between them."""
    n, neighbours = np.eye(bodies), np.eye(bodies, k=1) + np.eye(bodies, k=-1)
    return 4.0 * n + neighbours, 100.0 * (2.0 * n - neighbours), -np.ones(bodies), -n


PRESSED = {
    "free": ([[1.0]], [[0.0]], [1.0], [[1.0]]),
    "one": ([[0.7]], [[0.3]], [1.3], [[1.0]]),
    "row of 2": ([[0.7]], [[0.3]], [1.3], [[2.0]]),
    "both held": ([[2.0, 0.3], [0.3, 1.1]], [[3.0, -1.0], [-1.0, 2.0]], [1.3, 0.7], [[1.0, 0.0], [0.0, 1.0]]),
    "bed of 2": bed(2),
    "bed of 40": bed(40),
}
LOADS = {  # and their integrals to t = 1
    "constant": (sb.Constant(1.0), 1.0),
    "falling": (sb.Sampled([0.0, 1.0, 9.0], [2.0, 1.0, -3.0]), 1.5),
    "rising": (sb.Sampled([0.0, 1.0, 2.0], [0.0, 1.0, 2.0]), 0.5),
    "sine": (sb.Harmonic(1.0, 2.8), (1.0 - np.cos(2.8)) / 2.8),
}


@pytest.mark.fast(8)
@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("name", PRESSED)
def test_a_body_that_is_pressed_on_its_stop_stays_there(name, load):
    """Rounding is all that moves it: its energy balance is not open by that. What the stops withhold is not zero
    because the load is at t = 0. J = row^-T p int f dt."""
    M, K, p, rows = (np.array(x) for x in PRESSED[name])
    f, integral = LOADS[load]
    contacts = [stop(row, upper=0.0) for row in rows]
    system = sb.System.from_matrices(M, K, loads=[(p, f)], contacts=contacts)
    run = sb.reference(system, 1.0)
    assert run.horizon == 1.0
    assert not np.any(run.tip)
    assert [(contact.impacts.count, contact.fraction) for contact in run.contacts] == [(0, 1.0)] * len(rows)
    J = np.linalg.solve(rows.T, p) * integral
    assert [contact.impulse for contact in run.contacts] == pytest.approx(J, rel=1e-10)


def test_a_contact_that_leaves_is_driven_back_by_a_blow_on_another():
    """Both start on lower stops, A leaves with 0.2, B hits with 1: P_B = 3/2 turns A to 0.2 - 3/4, and that is hit
    after it, P_A = 3/2 (3/4 - 0.2), which takes half of that from B."""
    contacts = [stop([1.0, 0.0], lower=0.0), stop([0.0, 1.0], lower=0.0)]
    M = np.linalg.inv([[1.0, -0.5], [-0.5, 1.0]])
    system = sb.System.from_matrices(M, np.zeros((2, 2)), contacts=contacts, initial_velocity=[0.2, -1.0])
    run = sb.reference(system, 1.0)
    P = 1.5 * 0.55
    # B leaves with 1/2 - P/2 > 0: no more blows.
    assert [c.impulse for c in run.contacts] == pytest.approx([P, 1.5], rel=1e-12)
    assert [c.position[-1] for c in run.contacts] == pytest.approx([0.5 * 0.55, 0.5 - 0.5 * P], rel=1e-12)
