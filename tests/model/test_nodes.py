"""Contacts of any stiffness and law in a few steps, and nodes that a jump of the force holds on the stop."""

from __future__ import annotations

import numpy as np
import plain_march
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.kernels.library import address, filled, library

LAWS = [{}, {"exponent": 1.5}, {"exponent": 2.7}, {"dissipation": 0.3}, {"damping": 2.0},
        {"exponent": 1.5, "damping": 0.3, "dissipation": 0.2}]  # fmt: skip


def solve_node(r, S, law):
    """The forces F (m,) with v = r + F S and F_c = F_c(v_c) of springs or rigid stops; law (m, 3): stiffness, lower and
    upper stop, or more columns. S (m, m) has positive principal minors, or is semidefinite."""
    m, linear = len(law), np.zeros((len(law), 6))
    linear[:, :3] = law[:, :3]
    r, S, F = np.ascontiguousarray(r), np.ascontiguousarray(S), np.empty(m)
    filled(library().solve_node(m, address(r, (m,)), address(S, (m, m)), address(linear, (m, 6)), address(F, (m,))))
    return F


@pytest.mark.parametrize("contact", ["implicit", "conserving"])
@pytest.mark.parametrize("seed", range(60))
@pytest.mark.fast(20, slow=60)
def test_contacts_from_soft_to_almost_rigid_are_those_of_the_plain_loop(seed, contact):
    """One to four of them, pressed at the start or not, at steps of 1e-4 to 0.1; none of a mean force dissipates."""
    rng, n, laws = np.random.default_rng([seed, 3]), 4, LAWS if contact == "implicit" else LAWS[:3]
    A, B = rng.normal(size=(2, n, n))

    def stops() -> sb.Stops:
        (lower, upper), free = np.sort(rng.normal(size=2) * 0.3), rng.integers(4)
        law = {"stiffness": 10.0 ** rng.uniform(-1.0, 6.0)} | laws[rng.integers(len(laws))]
        return sb.Stops(None if free == 0 else lower, None if free == 1 else upper, **law)

    system = sb.System.from_matrices(
        np.eye(n) + 0.2 * A @ A.T, B @ B.T, initial_displacement=0.3 * rng.normal(size=n),
        contacts=[sb.Contact(rng.normal(size=n), stops()) for _ in range(rng.integers(1, 5))],
        initial_velocity=rng.normal(size=n) * 10.0 ** rng.uniform(-1.0, 1.0),
    )  # fmt: skip
    dt = 10.0 ** rng.uniform(-4.0, -1.0)
    run = sb.integrate(system, sb.Trapezoidal(), dt, 8 * dt, contact)
    q = plain_march.states(system, sb.Trapezoidal(), dt, 8, contact)[0]
    assert np.max(np.abs(run.states[0] - q)) < 1e-9 * np.max(np.abs(q))


@pytest.mark.parametrize("law", [{}, {"exponent": 1.5}], ids=["linear", "Hertz"])
@pytest.mark.parametrize("contact", ["implicit", "conserving"])
def test_a_lower_stop_mirrors_an_upper_one(contact, law):
    """Steps so short that a mean force as a quotient would lose digits; signs cost no rounding."""
    stops = (sb.Stops(upper=0.1, stiffness=1e4, **law), sb.Stops(-0.1, stiffness=1e4, **law))
    upper, lower = (
        sb.integrate(one_mass(1.0, each, v=v), sb.Trapezoidal(), 1e-5, 0.12, contact)
        for each, v in zip(stops, (1.0, -1.0), strict=True)
    )
    assert upper.contacts[0].peak_force > 0.0
    assert np.array_equal(upper.tip, -lower.tip)


def mass(v: float = 3.0) -> sb.System:
    return one_mass(1.0, sb.Stops(None, 0.5, stiffness=1000.0, damping=200.0), load=sb.Constant(2.0), v=v)


class Lagging(sb.Scheme):
    """The exact flow that takes the force at t_n from the state there, after its node has let go of it."""

    name = "lagging"
    order = 2
    nodes = (0.0, 1.0)

    def step(self, equation, dt, z, loads, reactions):
        y = equation.flow(dt, z, *(load + reaction for load, reaction in zip(loads, reactions, strict=True)))
        return y, [z, y]


def test_a_scheme_whose_node_no_force_moves_is_refused():
    with pytest.raises(InputError, match="answer a contact force within its step"):
        sb.integrate(mass(), Lagging(), 1e-3, 0.1)


# ------------------------------------------------------------------ the law on both sides, nodes of rigid contacts


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


@pytest.mark.parametrize("skew", [0.0, 1.0, 10.0])
def test_springs_and_rigid_stops_of_a_node_meet_their_conditions(skew):
    """A force where the position less what the spring gives is at its stop, none between the stops."""
    rng = np.random.default_rng(8)
    for _ in range(500):
        m = int(rng.integers(1, 13))
        A, G = rng.normal(size=(m, m + 2)), skew * rng.normal(size=(m, m))
        S, r = A @ A.T + G - G.T, 3.0 * rng.normal(size=m)
        kappa = np.where(rng.random(m) < 0.5, np.inf, 10.0 ** rng.uniform(-2.0, 6.0, m))
        g1, g2 = (
            np.where(rng.random(m) < 0.2, np.inf * s, s * rng.random(m) * rng.choice([0.0, 1.0])) for s in (-1, 1)
        )
        F = solve_node(r, S.T, np.transpose([kappa, g1, g2]))
        v, size = r + S @ F, np.abs(r) + np.abs(S) @ np.abs(F)
        at, error = v + F / kappa, 1e-12 * np.max(size)
        wanted = np.where(F < 0.0, g2, np.where(F > 0.0, g1, np.clip(v, g1, g2)))
        assert np.all(np.abs(np.where(F != 0.0, at, v) - wanted) <= error)


def test_two_contacts_at_one_point_share_the_force():
    """A singular compliance: the same point touches two equal springs, twice as stiff as one."""
    stops = [sb.Stops(-0.1, 0.1, stiffness=1e4)] * 2
    S = np.full((2, 2), 1e-3)
    total = -2e4 / (1.0 + 2e4 * 1e-3) * (0.5 - 0.1)
    forces = solve_node(np.array([0.5, 0.5]), S, np.array([s.law for s in stops]))
    assert np.allclose(forces, total / 2.0, rtol=1e-12)
