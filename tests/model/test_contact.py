"""Normal compliance: force, energy and the stage equation, for one contact and for several."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stiffbeam as sb
from stiffbeam.kernels.march import solve_node

EPS = np.finfo(float).eps


def test_force_energy_and_state_on_both_sides():
    """On the stop itself there is no contact, one double beyond it there is."""
    stops, beyond = sb.Stops(-0.1, 0.2, stiffness=50.0), [np.nextafter(-0.1, -1.0), np.nextafter(0.2, 1.0)]
    u = [-0.3, -0.1, 0.0, 0.2, 0.5]
    assert np.allclose(stops.force(u), [10.0, 0.0, 0.0, 0.0, -15.0], rtol=1e-14)
    assert np.allclose(stops.energy(u), [1.0, 0.0, 0.0, 0.0, 2.25], rtol=1e-14)
    assert np.array_equal(stops.state(u + beyond), [-1, 0, 0, 0, 1, -1, 1])
    for one, side in ((sb.Stops(-0.1, stiffness=50.0), -1), (sb.Stops(upper=0.2, stiffness=50.0), 1)):
        assert np.array_equal(one.state([-1e6, -1.0, 0.0, 1.0, 1e6]), [min(side, 0)] * 2 + [0] + [max(side, 0)] * 2)


def by_enumeration(r, S, stops):
    """The forces of the regime, of all 3^m, whose positions contradict it least."""
    best, found = math.inf, None
    for regime in itertools.product((-1, 0, 1), repeat=len(stops)):
        gaps = [s.upper_bound if k > 0 else s.lower_bound for s, k in zip(stops, regime, strict=True) if k]
        if not np.all(np.isfinite(gaps)):
            continue
        closed = np.flatnonzero(regime)
        kappa = np.array([stops[c].stiffness for c in closed])
        force = np.zeros(len(stops))
        if len(closed):
            # F_c = kappa (g - v_c) with v = r + S F on the closed contacts.
            matrix = np.diag(1.0 / kappa) + S[np.ix_(closed, closed)]
            force[closed] = np.linalg.solve(matrix, np.array(gaps) - r[closed])
        v = r + S @ force
        wrong = 0.0
        for x, k, stop, push in zip(v, regime, stops, force, strict=True):
            # A closed contact is off its stop by F/kappa: the difference of its position and the stop would lose that.
            inside = max(stop.lower_bound - x, x - stop.upper_bound, 0.0)
            wrong = max(wrong, inside if k == 0 else max(0.0, k * push / stop.stiffness))
        if wrong < best:
            best, found = wrong, force
    # One regime is consistent, up to the rounding of its positions.
    assert best < 1e-14 * (5.0 + np.max(np.abs(S)) * np.max(np.abs(found)))
    return found


@st.composite
def several(draw):
    """Positions, an SPD compliance of condition up to 1e8, and stops, for m = 1 to 3."""
    m = draw(st.sampled_from([1, 2, 3]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    Q, _ = np.linalg.qr(rng.normal(size=(m, m)))
    S = (Q * np.logspace(0.0, -draw(st.floats(0.0, 8.0)), m)) @ Q.T * 10.0 ** draw(st.floats(-9.0, 0.0))
    r = rng.uniform(-3.0, 3.0, m)
    stops = []
    for c in range(m):
        lower, upper = -rng.uniform(0.01, 1.5), rng.uniform(0.01, 1.5)
        side = draw(st.sampled_from(["both", "lower", "upper"]))
        stops.append(
            sb.Stops(
                None if side == "upper" else lower,
                None if side == "lower" else upper,
                stiffness=10.0 ** rng.uniform(0.0, 9.0),
            )
        )
        if draw(st.integers(0, 7)) == 0:
            r[c] = stops[c].lower_bound if stops[c].lower is not None else stops[c].upper_bound  # exactly on the edge
    return r, 0.5 * (S + S.T), stops


def close(a, b, S, stops):
    """Equal to rounding: both solve (1/kappa + S) F = g - r, whose inverse turns errors into forces."""
    matrix = np.diag([1.0 / s.stiffness for s in stops]) + S
    error = 1e-14 * (5.0 + np.linalg.norm(matrix) * np.max(np.abs(a)))
    return np.max(np.abs(a - b)) <= np.linalg.norm(np.linalg.inv(matrix)) * error


def solve_several(r, S, stops):
    return solve_node(np.ascontiguousarray(r), np.ascontiguousarray(S), np.array([s.law for s in stops]))


@settings(max_examples=200)
@given(several())
@pytest.mark.slow
def test_several_contacts_are_solved_as_by_trying_all_regimes(case):
    r, S, stops = case
    assert close(by_enumeration(r, S, stops), solve_several(r, S, stops), S, stops)


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
    assert np.allclose(solve_several(np.array([0.5, 0.5]), S, stops), total / 2.0, rtol=1e-12)
