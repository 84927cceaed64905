"""A tube in a round hole: the true circle and polygons against SciPy with a radial force."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag

import stiffbeam as sb

CLEARANCE, KAPPA, T_END = 3e-4, 1e6, 0.1
HOLE = sb.Stops(-CLEARANCE, CLEARANCE, stiffness=KAPPA)


def tube(size: float, phase: float, stops: sb.Stops | tuple[sb.Stops, ...] | None = HOLE) -> sb.BeamProblem:
    """The tube of ``studies/loose_supports.py`` under a force of 22 Hz."""
    load = sb.PointLoad(0.9, sb.Harmonic(size, 2 * np.pi * 22, phase))
    return sb.BeamProblem(
        length=1.2, stiffness=668.0, mass_per_length=0.647, viscosity=0.15, stops=stops, loads=(load,)
    )  # fmt: skip


def by_scipy(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position (2, k) and force (k,) of the end in the true circle: sigma = -kappa (|r| - c)_+ r/|r|."""
    x, y = (sb.semidiscretise(tube(*each), 6) for each in ((12.0, 0.0), (5.0, 1.0)))
    n = x.size
    mass = block_diag(x.mass, y.mass)
    inverse = np.linalg.inv(mass)
    K, C = block_diag(x.stiffness, y.stiffness), block_diag(x.damping, y.damping)
    (p, f), (_, g) = x.loads[0], y.loads[0]
    ends = np.array([n - 1, 2 * n - 1])

    def rhs(t, z):
        q, v = z[: 2 * n], z[2 * n :]
        force = np.concatenate([p * float(f.value(t)), p * float(g.value(t))]) - K @ q - C @ v
        r = q[ends]
        size = np.hypot(*r)
        if size > CLEARANCE:
            force[ends] -= KAPPA * (size - CLEARANCE) * r / size
        return np.concatenate([v, inverse @ force])

    z = solve_ivp(rhs, (0.0, t[-1]), np.zeros(4 * n), "DOP853", t, rtol=1e-7, atol=1e-11, max_step=2e-4).y
    return z[ends], KAPPA * np.maximum(np.hypot(*z[ends]) - CLEARANCE, 0.0)


@pytest.mark.slow
def test_the_circle_is_that_of_scipy():
    t = np.linspace(0.0, 0.5 * T_END, 251)
    r, force = by_scipy(t)
    circle = sb.two_planes(tube(12.0, 0.0), 6, tube(5.0, 1.0, None), None)
    exact = sb.reference(circle.system, t[-1], "cvode-adams", t_eval=t)
    ends = circle.normals[0] @ exact.states[0].T
    np.testing.assert_allclose(ends, r, atol=1e-5 * CLEARANCE)
    np.testing.assert_allclose(-exact.contacts[0].force, force, atol=5e-5 * np.max(force))
    assert (circle.sides, circle.gap_error, circle.force_ratio(0.1)) == (None, 0.0, (1.0, 1.0))
    (rate,) = sb.contact_rates(exact, tangents=list(circle.tangents)).rates
    assert rate["sliding_work"].value > 0.0
    # More sides approach it.
    apart = []
    for sides in (4, 8, 16):
        polygon = sb.two_planes(tube(12.0, 0.0), 6, tube(5.0, 1.0, None), sides)
        apart.append(np.sqrt(np.mean((sb.reference(polygon.system, t[-1], t_eval=t).tip - r[0]) ** 2)) / CLEARANCE)
    assert apart[0] > 2.0 * apart[1] > 4.0 * apart[2]


@pytest.mark.slow
def test_two_circles_at_once():
    """Their nodes are coupled: a scheme with small steps is near the adaptive reference."""
    holes = (replace(HOLE, position=0.6), HOLE)
    circles = sb.two_planes(tube(40.0, 0.0, holes), 6, tube(20.0, 1.0, None), None)
    run = sb.integrate(circles.system, sb.Trapezoidal(), 1e-5, 0.02)
    exact = sb.reference(circles.system, 0.02, "dop853", t_eval=run.t)
    assert np.max(np.abs(run.tip - exact.tip)) < 0.02 * CLEARANCE
    for one, other in zip(run.contacts, exact.contacts, strict=True):
        assert one.impacts.count == other.impacts.count > 0
        assert one.impulse == pytest.approx(other.impulse, rel=0.01)


@pytest.mark.slow
def test_the_polygon_against_the_circle():
    """The errors that the guide states: position, impulse and largest force."""
    t = np.linspace(0.0, T_END, 1001)
    r, force = by_scipy(t)
    errors = {}
    for sides in (6, 12, 16):
        found = sb.two_planes(tube(12.0, 0.0), 6, tube(5.0, 1.0, None), sides)
        exact = sb.reference(found.system, T_END, t_eval=t)
        q = exact.states[0]
        angles = 2 * np.pi / sides * np.arange(sides // 2)
        total = np.hypot(*(sum(c.force * part(a) for c, a in zip(exact.contacts, angles, strict=True))
                           for part in (np.cos, np.sin)))  # fmt: skip
        apart = np.hypot(q[:, 5] - r[0], q[:, 11] - r[1])
        position = np.sqrt(np.mean(apart**2)) / CLEARANCE
        errors[sides] = (position, np.mean(total) / np.mean(force) - 1.0, np.max(total) / np.max(force) - 1.0)
        rates = sb.contact_rates(exact, tangents=found.tangents)
        assert all(each["sliding_work"].value > 0.0 for each in rates.rates)
    assert errors[6][0] > errors[12][0] > errors[16][0]
    assert errors[12][0] < 0.12
    assert abs(errors[12][1]) < 0.03
    assert abs(errors[16][1]) < 0.03
    assert abs(errors[12][2]) < 0.4


def test_the_stated_errors_are_those_of_its_contacts():
    """Forces of the contacts at points around the hole; corners by the first gap that closes on the way out."""
    for sides, depth in ((4, 0.05), (12, 0.1), (16, 0.3)):
        found = sb.two_planes(tube(1.0, 0.0), 6, sides=sides)
        system = found.system
        theta = np.linspace(0.0, 2 * np.pi, 400 * sides + 1)
        q = np.zeros((len(theta), system.size))
        q[:, 5], q[:, 11] = np.cos(theta), np.sin(theta)
        reach = CLEARANCE / np.max(np.abs(q @ found.normals.T), axis=1)
        assert np.max(reach) / CLEARANCE - 1.0 == pytest.approx(found.gap_error, rel=1e-9)
        assert np.min(reach) == pytest.approx(CLEARANCE)
        u = (1.0 + depth) * CLEARANCE * q @ found.normals.T
        forces = np.array([c.stops.force(x, 0.0 * x) for c, x in zip(system.contacts, u.T, strict=True)])
        sizes = np.linalg.norm(forces.T @ found.normals[:, [5, 11]], axis=1) / (KAPPA * depth * CLEARANCE)
        assert found.force_ratio(depth) == pytest.approx((np.min(sizes), np.max(sizes)), rel=1e-6)
        np.testing.assert_allclose(np.sum(found.normals * found.tangents, axis=1), 0.0, atol=1e-15)
        np.testing.assert_allclose(np.linalg.norm(found.tangents, axis=1), 1.0)


def test_a_push_in_one_plane_stays_in_it():
    """With two of the sides across the push the motion is that of the single plane."""
    found = sb.two_planes(tube(12.0, 0.0), 6, sides=4)
    one = sb.reference(sb.semidiscretise(tube(12.0, 0.0), 6), 0.05)
    both = sb.reference(found.system, 0.05, t_eval=one.t)
    np.testing.assert_allclose(both.tip, one.tip, atol=1e-9 * np.max(np.abs(one.tip)))
    assert both.contacts[0].impacts.count == one.contacts[0].impacts.count > 1
    assert not both.contacts[1].impacts.count


def test_the_system_has_the_units_of_the_problem():
    physical = sb.BeamProblem.from_physical(
        length=1200.0, bending_stiffness=668e6, mass_per_length=6.47e-7, stops=sb.Stops(-0.3, 0.3, stiffness=1e3),
        initial_velocity=sb.PolynomialProfile((0.0, 1.0)), units=sb.Units("mm", "s", "N"),
    )  # fmt: skip
    system = sb.two_planes(physical, 6, sides=4).system
    assert system.units == physical.units
    run = sb.integrate(system, sb.HHT(), 1e-5, 0.02)
    assert run.units == physical.units
    assert re.search(r"normal work rate \S+ N mm/s ", str(sb.contact_rates(run)))
    words = [axis.get_ylabel() for axis in sb.paper_figure(run, ["displacement", "shear"]).axes]
    assert words == ["tip displacement $u(t)$ (mm)", r"contact force $\sigma$ (N)", r"contact force $\sigma$ (N)"]


def test_what_is_no_round_hole_is_refused():
    for stops, word in ((sb.Stops(-1e-4, 3e-4, stiffness=1e6), "lower = -upper"), (None, None)):
        problem = tube(1.0, 0.0, stops)
        if word is None:
            assert not sb.two_planes(problem, 6).system.contacts
            continue
        with pytest.raises(sb.InputError, match=word):
            sb.two_planes(problem, 6)
    with pytest.raises(sb.InputError, match="even"):
        sb.two_planes(tube(1.0, 0.0), 6, sides=7)
    with pytest.raises(sb.InputError, match="rest in two planes"):
        sb.two_planes(replace(tube(1.0, 0.0), base=sb.Harmonic(1e-3, 30.0), stops=replace(HOLE, position=0.6)), 6)
