"""Normal compliance: force, energy and the stage equation, for one contact and for several."""

from __future__ import annotations

import numpy as np

import stiffbeam as sb
from stiffbeam.kernels.march import solve_node


def test_force_energy_and_state_on_both_sides():
    """On the stop itself there is no contact, one double beyond it there is."""
    stops, beyond = sb.Stops(-0.1, 0.2, stiffness=50.0), [np.nextafter(-0.1, -1.0), np.nextafter(0.2, 1.0)]
    u = [-0.3, -0.1, 0.0, 0.2, 0.5]
    assert np.allclose(stops.force(u), [10.0, 0.0, 0.0, 0.0, -15.0], rtol=1e-14)
    assert np.allclose(stops.energy(u), [1.0, 0.0, 0.0, 0.0, 2.25], rtol=1e-14)
    assert np.array_equal(stops.state(u + beyond), [-1, 0, 0, 0, 1, -1, 1])
    for one, side in ((sb.Stops(-0.1, stiffness=50.0), -1), (sb.Stops(upper=0.2, stiffness=50.0), 1)):
        assert np.array_equal(one.state([-1e6, -1.0, 0.0, 1.0, 1e6]), [min(side, 0)] * 2 + [0] + [max(side, 0)] * 2)


def test_rigid_contacts_that_almost_follow_from_each_other_meet_their_conditions():
    """Two of the rows nearly parallel, up to the condition of 1e12 that rigid stops are accepted with."""
    rng, conditions = np.random.default_rng(4), []
    for _ in range(2000):
        m = int(rng.integers(2, 7))
        rows = rng.normal(size=(m, m + 2))
        rows[1] = rng.choice([1.0, -1.0]) * rows[0] + 10.0 ** rng.uniform(-5.5, 0.0) * rng.normal(size=m + 2)
        S, r = rows @ rows.T, rng.normal(size=m)
        if np.linalg.cond(S) > 1e12:
            continue
        conditions.append(np.linalg.cond(S))
        g1, g2 = -0.1 * rng.random(m), 0.1 * rng.random(m)
        F = solve_node(r, S, np.transpose([np.full(m, np.inf), g1, g2]))
        v = r + S @ F
        error = 1e-14 * np.max(np.abs(r) + np.abs(S) @ np.abs(F))
        assert np.all(v <= g2 + error)
        assert np.all(v >= g1 - error)
        assert np.all(np.abs(v - g2)[F < 0.0] <= error)
        assert np.all(np.abs(v - g1)[F > 0.0] <= error)
    assert max(conditions) > 1e11


def test_two_contacts_at_one_point_share_the_force():
    """A singular compliance: the same point touches two equal springs, twice as stiff as one."""
    stops = [sb.Stops(-0.1, 0.1, stiffness=1e4)] * 2
    S = np.full((2, 2), 1e-3)
    total = -2e4 / (1.0 + 2e4 * 1e-3) * (0.5 - 0.1)
    forces = solve_node(np.array([0.5, 0.5]), S, np.array([s.law for s in stops]))
    assert np.allclose(forces, total / 2.0, rtol=1e-12)
