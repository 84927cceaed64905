"""Contacts that rest on rigid stops, or are hit, let go or brought to rest at one time: momentum, closed forms, and
frozen solutions in many digits."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb

COUPLED = np.linalg.inv([[1.0, 0.5], [0.5, 1.0]])  # M of which the inverse is this


def stop(row, restitution=0.5, **where):
    return sb.Contact(row=row, stops=sb.Stops(stiffness=np.inf, restitution=restitution, **where))


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


@pytest.mark.parametrize("height", [0.5, 0.47], ids=["at an output", "between"])
def test_a_comparison_says_why_a_flat_drop_ends_the_horizon(height):
    """A rigid bar of mass 1 that falls on supports at both ends: its middle, downwards, and its turn."""
    ends = [stop([1.0, x], upper=0.0) for x in (1.0, -1.0)]
    weight, start = [([1.0, 0.0], sb.Constant(1.0))], {"initial_displacement": [-height, 0.0]}
    system = sb.System.from_matrices(np.diag([1.0, 0.2]), np.zeros((2, 2)), None, weight, ends, **start)
    reference = sb.reference(system, 2.0)
    assert reference.horizon <= 1.0 + 1e-9
    run = sb.integrate(system, sb.MoreauJean(), 1e-3, 2.0)
    said = f"hit at one time, t = {np.sqrt(2.0 * height):.6g}: their order decides"
    assert said in " ".join(str(sb.compare(run, reference)).split())


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
