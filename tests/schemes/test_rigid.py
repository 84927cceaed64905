"""Schemes for rigid stops: plain loops, the energy of every step, closed forms, order one through an impact."""

from __future__ import annotations

import numpy as np
import pytest
from rigid_loops import INF, Loop, chain
from systems import one_mass

import stiffbeam as sb

LOOPS = {
    "moreau_jean": sb.MoreauJean(),
    "paoli_schatzman": sb.PaoliSchatzman(),
    "contact_stabilised": sb.ContactStabilisedNewmark(),
    "nonsmooth_alpha": sb.NonsmoothGeneralisedAlpha(),
}


@pytest.mark.fast(14)
@pytest.mark.parametrize(
    ("contacts", "damping", "moving"),
    [
        (1, "none", False),
        (1, "stiffness", True),
        (1, "coupling", False),
        (2, "none", True),
        (2, "coupling", False),
        (2, "turning", False),
    ],
)
@pytest.mark.parametrize("name", LOOPS)
def test_every_step_is_that_of_a_plain_loop(name, contacts, damping, moving):
    """The reactions by trying every set of closed contacts; a file and an ensemble keep them."""
    e = 0.6 if LOOPS[name].restitutes else None
    system, loop = chain(contacts, damping, moving, e)
    dt, steps = 0.02, 250
    run = sb.integrate(system, LOOPS[name], dt, steps * dt)
    wanted = getattr(loop, name)(system.q0, system.v0, dt, steps)
    q, v = run.states
    assert np.max(np.abs(q - [x for x, _, _ in wanted])) < 1e-10
    assert np.max(np.abs(v[1:] - [x for _, x, _ in wanted[1:]])) < 1e-8
    for c, contact in enumerate(run.contacts):
        R = np.array([x[c] for _, _, x in wanted])
        assert contact.impacts.count >= (0 if damping == "turning" else 2)  # a turning body may miss its stops
        assert np.max(np.abs(contact.force - R)) <= 1e-6 * np.max(np.abs(contact.force))
        assert contact.impulse == pytest.approx(dt * np.sum(np.abs(R)), rel=1e-9)
    many = sb.integrate_ensemble(system, LOOPS[name], dt, steps * dt, [system, system])
    assert np.array_equal(many.contacts[0].impulse, [run.contacts[0].impulse] * 2)


@pytest.mark.parametrize("name", ["moreau_jean", "paoli_schatzman", "nonsmooth_alpha"])
def test_reactions_of_bodies_that_turn_each_other_fast(name):
    """A step turns by more than a radian: reactions are far from the minimum of any energy, and take a rule of their
    own."""
    rng, n, dt, steps = np.random.default_rng(16), 4, 0.02, 40
    G, K, load = rng.normal(size=(n, n)), 40.0 * np.eye(n), 30.0 * rng.normal(size=n)
    C, lower, upper = 100.0 * (G - G.T), -rng.uniform(0.05, 0.2, n), rng.uniform(0.05, 0.2, n)
    stops = [sb.Stops(lo, hi, stiffness=INF, restitution=0.5) for lo, hi in zip(lower, upper, strict=True)]
    contacts, drive = [sb.Contact(row, s) for row, s in zip(np.eye(n), stops, strict=True)], sb.Harmonic(3.0, 4.0, 1.0)
    v = 3.0 * rng.normal(size=n)
    system = sb.System.from_matrices(np.eye(n), K, C, [(load, drive)], contacts, initial_velocity=v)
    still, force = lambda t: np.zeros(n), lambda t: load * float(drive.value(t))
    loop = Loop(np.eye(n), C, K, np.eye(n), lower, upper, np.full(n, 0.5), force, still, still)
    wanted = [q for q, _, _ in getattr(loop, name)(system.q0, system.v0, dt, steps)]
    assert np.max(np.abs(sb.integrate(system, LOOPS[name], dt, steps * dt).states[0] - wanted)) < 1e-8


def test_moreau_and_jean_lose_what_newtons_law_takes_and_nothing_else():
    E = sb.integrate(chain(2, e=0.4)[0], sb.MoreauJean(), 0.01, 5.0).energy
    assert abs(E.loss[-1]) < 1e-12 * np.max(E.energy)
    assert E.stop_dissipation[-1] > 0.1 * np.max(E.energy)
    moved = sb.integrate(chain(2, moving=True, e=0.4)[0], sb.MoreauJean(), 0.001, 5.0).energy
    assert abs(moved.loss[-1]) < 1e-2 * np.max(moved.energy)  # the stop's work is a sum over steps
    elastic = sb.integrate(chain(2)[0], sb.ContactStabilisedNewmark(), 0.01, 5.0)
    assert np.all(elastic.energy.stop_dissipation == 0.0)


# The elastic bar that bounces on a wall under gravity, by characteristics in rational numbers: E = 900, rho = 1,
# L = 10, so c = 30; gravity 10, dropped from 5. It lands at t = 1 with speed 10, is in contact for 2L/c = 2/3 and
# flies again. Doyen, Ern and Piperno, SIAM J. Sci. Comput. 33 (2011) 223-249.
CONTACTS = ((1.0, 5.0 / 3.0), (11.0 / 3.0, 13.0 / 3.0))


def pressure(t):
    """The contact pressure in the first two contacts, 0 outside."""
    first, second = (t - start for start, _ in CONTACTS)
    inside = [(x >= 0.0) & (x <= 2.0 / 3.0) for x in (first, second)]
    return np.where(inside[0], 300.0 * (1.0 + first), 0.0) + np.where(inside[1], 500.0 - 300.0 * second, 0.0)


def bouncing_bar(cells: int, **stops) -> sb.System:
    """Linear elements, lumped mass; unknown 0 is the foot, at height q_0 + 5 over a stop at 0."""
    dx = 10.0 / cells
    mass = np.full(cells + 1, dx)
    mass[[0, -1]] *= 0.5
    stiffness = (
        900.0
        / dx
        * (np.diag(np.r_[1.0, np.full(cells - 1, 2.0), 1.0]) - np.eye(cells + 1, k=1) - np.eye(cells + 1, k=-1))
    )
    foot = sb.Contact(np.eye(cells + 1)[0], sb.Stops(lower=0.0, **({"stiffness": np.inf} | stops)), sb.Constant(5.0))
    return sb.System.from_matrices(np.diag(mass), stiffness, loads=[(-10.0 * mass, sb.Constant(1.0))], contacts=[foot])


@pytest.mark.fast(4)
@pytest.mark.parametrize(
    ("scheme", "e", "gained", "rms", "deepest"),
    [
        (sb.MoreauJean(), 1.0, (-1e-12, 1e-12), (400.0, 404.0), (0.03, 0.04)),
        (sb.MoreauJean(), 0.0, (-0.05, -0.02), (0.2, 0.7), (0.01, 0.03)),
        (sb.PaoliSchatzman(), 1.0, (0.85, 0.87), (20.0, 21.5), (0.05, 0.06)),
        (sb.PaoliSchatzman(), 0.0, (-0.04, -0.02), (0.2, 1.1), (0.0, 1e-13)),
        (sb.ContactStabilisedNewmark(), None, (-0.045, -0.03), (0.2, 0.7), (0.0, 1e-13)),
        (sb.NonsmoothGeneralisedAlpha(), 0.0, (-0.06, -0.05), (0.2, 0.7), (0.0, 1e-13)),
        (sb.NonsmoothGeneralisedAlpha(1.0), 0.0, (-0.025, -0.015), (0.2, 0.7), (0.0, 1e-13)),
    ],
)
def test_the_bouncing_bar(scheme, e, gained, rms, deepest):
    """Energy gained over three periods over m g h, rms of the pressure on [300, 500], deepest penetration.

    The last digits are chaos: measured, the intervals say what is known of each.
    """
    cells = 100
    dt = 10.0 / cells / 30.0
    run = sb.integrate(bouncing_bar(cells, **({} if e is None else {"restitution": e})), scheme, dt, 16.0)
    inside = (run.t > 1.05) & (run.t < 5.0 / 3.0 - 0.05)
    error = run.contact_force[inside] - pressure(run.t[inside] - 0.5 * dt)
    gain = (run.energy.energy[-1] - run.energy.energy[0] - run.energy.input[-1]) / 500.0
    found = gain, np.sqrt(np.mean(error**2)), max(0.0, -np.min(run.tip))
    for value, (low, high) in zip(found, (gained, rms, deepest), strict=True):
        assert low <= value <= high


@pytest.mark.parametrize("scheme", [sb.MoreauJean(), sb.ContactStabilisedNewmark()], ids=str)
def test_a_body_that_rests_on_its_stop_stays_there(scheme):
    """Weight 3 on a spring-free mass: the reaction is the weight from the first step on. Moreau and Jean's lets go
    where rounding leaves a gap, for a step."""
    e = 0.5 if isinstance(scheme, sb.MoreauJean) else None
    stops = sb.Stops(lower=0.0, stiffness=INF, restitution=e)
    run = sb.integrate(one_mass(0.0, stops, load=sb.Constant(-3.0)), scheme, 0.01, 1.0)
    assert np.max(np.abs(run.tip)) < (1e-15 if e is None else 3.0 * 0.01**2)
    assert run.contacts[0].impulse == pytest.approx(3.0, rel=1e-12 if e is None else 0.02)
    if e is None:
        assert np.allclose(run.contact_force[1:], 3.0, rtol=1e-12)
        assert run.impacts.count == 0  # it was there before


def test_an_equilibrium_on_a_stop_is_no_motion():
    """Held at a gap that is not zero, several unknowns: the predicted position is short of the stop by its rounding."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        n = int(rng.integers(2, 5))
        B, load, row = rng.normal(size=(n, n)), np.ones(n), np.eye(n)[n - 1]
        K, M = B @ B.T + np.eye(n), np.diag(rng.uniform(0.5, 2.0, n))
        g = 0.5 * np.linalg.solve(K, load)[-1]
        held = np.block([[K, -row[:, None]], [row[None], np.zeros((1, 1))]])
        *q, R = np.linalg.solve(held, np.append(load, g))
        if g <= 0.0 or R >= 0.0:
            continue
        contact = sb.Contact(row, sb.Stops(upper=g, stiffness=INF, restitution=0.5))
        system = sb.System.from_matrices(
            M, K, loads=[(load, sb.Constant(1.0))], contacts=[contact], initial_displacement=[*q[:-1], g]
        )
        run = sb.integrate(system, sb.MoreauJean(), 1e-2, 5.0)
        assert np.max(np.abs(run.contacts[0].position - g)) < 1e-12
        assert run.impacts.count == 0
        assert run.contacts[0].impulse == pytest.approx(5.0 * abs(R), rel=1e-9)


@pytest.mark.parametrize(
    "scheme",
    [sb.MoreauJean(), sb.PaoliSchatzman(), sb.NonsmoothGeneralisedAlpha(1.0)],
    ids=lambda scheme: type(scheme).__name__,
)
@pytest.mark.fast(2)
def test_through_an_impact_every_scheme_is_of_first_order(scheme):
    """x'' + x = 0 from x = 0 with speed 1 meets the stop at 1/2 after pi/6 and comes back with e times its speed.

    A single run's slope is noise, since where in the step the impact lies is chance: 12 starts for each step.
    """
    e, stops = 0.6, sb.Stops(upper=0.5, stiffness=INF, restitution=0.6)
    dts, errors = [], []
    for steps in (100, 200, 400, 800):
        dt = 1.2 / steps
        for start in np.arange(12) / 12.0 * dt:
            run = sb.integrate(one_mass(1.0, stops, q=np.sin(start), v=np.cos(start)), scheme, dt, 1.2)
            after = run.t[-1] + start - np.pi / 6.0
            dts.append(dt)
            errors.append(abs(run.tip[-1] - 0.5 * np.cos(after) + e * np.sqrt(0.75) * np.sin(after)))
    slope = np.polyfit(np.log(dts), np.log(errors), 1)[0]
    assert 0.75 < slope < 1.25  # the scatter over starts is a factor of ten
    assert max(errors[-12:]) < 2.0 * dts[-1]
