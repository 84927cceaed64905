"""Contacts that are hit, let go or brought to rest at one time: momentum, closed forms, and frozen
solutions in many digits."""

from __future__ import annotations

import numpy as np
import pytest
from rigid_solutions import known

import stiffbeam as sb


def stop(row, restitution, **where):
    return sb.Contact(row=row, stops=sb.Stops(stiffness=np.inf, restitution=restitution, **where))


def bar(inertia, restitution, q0, weight=1.0, spring=0.0, v0=(0.0, 0.0)):
    """A rigid bar of mass 1 that falls on supports at both ends: its middle, downwards, and its turn."""
    contacts = [stop([1.0, x], e, upper=0.0) for x, e in zip((1.0, -1.0), restitution, strict=True)]
    load = [([weight, 0.0], sb.Constant(1.0))]
    M, K = np.diag([1.0, inertia]), np.diag([0.0, spring])
    return sb.System.from_matrices(M, K, loads=load, contacts=contacts, initial_displacement=q0, initial_velocity=v0)


@pytest.mark.slow
def test_an_order_that_rounding_decides_is_not_certified():
    """Left falls from 1/10, right from 1/2: in decimals they close together at 2/sqrt(5), in doubles they do not."""
    system, t = bar(0.5, (0.5, 0.5), (-0.3, 0.2)), np.linspace(0.0, 4.0, 401)
    run, truth = sb.reference(system, 4.0, t_eval=t), known("order by rounding")
    assert 0.88 < run.horizon < 2.0 / np.sqrt(5.0)
    off = np.abs(run.tip[:: truth.every] - truth.tip)
    assert np.max(off[t[:: truth.every] <= run.horizon]) < 1e-14
    assert np.max(off) > 0.01


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


@pytest.mark.parametrize("restitution", [0.2, 0.5, 0.8])
def test_ends_that_do_not_move_each_other_chatter_side_by_side(restitution):
    """Inertia 1: the flat fall is that of two balls, which rest after sqrt(2 h/g) (1 + 2 e/(1 - e))."""
    rest = 1.0 + 2.0 * restitution / (1.0 - restitution)
    system = bar(1.0, (restitution, restitution), (-0.5, 0.0))
    run = sb.reference(system, rest + 1.0)
    assert run.horizon == rest + 1.0
    for mine, other in zip(run.contacts, known(f"side by side, {restitution}").contacts, strict=True):
        assert mine.impacts.count == len(other.times)
        assert mine.fraction == pytest.approx(1.0 / (rest + 1.0), rel=1e-5)
        assert mine.impulse == pytest.approx(0.5 * (rest + 1.0), rel=1e-12)


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
