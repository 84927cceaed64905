"""Time scales and speeds of motions: those that stiffness does not turn have them too."""

from __future__ import annotations

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.measures.errors import longest_delay
from stiffbeam.model.modes import undamped_modes
from stiffbeam.model.scales import scales

G = 9.81


def ball(stiffness: float, floor: sb.Stops) -> sb.System:
    """A ball that falls on a floor from a height of 1."""
    return one_mass(stiffness, floor, load=sb.Constant(-G), q=1.0)


FLOORS = {
    "rigid": sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.5),
    "stiff": sb.Stops(lower=0.0, stiffness=1e6),
    "hertz": sb.Stops(lower=0.0, stiffness=1e6, exponent=1.5, dissipation=0.1),
}


def test_a_run_on_a_rigid_floor_is_compared():
    """Impacts at sqrt(2/g) and then every e^k 2 sqrt(2/g): five to 1.3, and the tip within a percent."""
    system = sb.problem("bouncing-ball").system
    found = sb.compare(sb.integrate(system, sb.MoreauJean(0.5), 1e-3, 1.3), sb.reference(system, 1.3))
    fall = np.sqrt(2.0 / G)
    times = fall * (1.0 + 2.0 * np.cumsum(np.append(0.0, 0.5 ** np.arange(1, 9))))
    assert found.contacts[0].run.impacts == found.contacts[0].reference.impacts == int(np.sum(times <= 1.3)) == 5
    assert found.tip_error_rms == pytest.approx(2.3e-3, rel=0.05)
    assert found.matched_until == found.window == 1.3
    assert np.isfinite(found.phase.lag)


@pytest.mark.parametrize("floor", FLOORS.values(), ids=FLOORS)
def test_a_stiffness_that_does_not_show_changes_no_scale(floor):
    """The motions of K = 0 and K = 1e-9 are the same to 1e-9 of the height."""
    free, held = (ball(stiffness, floor) for stiffness in (0.0, 1e-9))
    for t_end in (np.inf, 5.0):
        assert scales(free, t_end).period == pytest.approx(scales(held, t_end).period, rel=1e-12)
    assert longest_delay(free, 5.0) == pytest.approx(longest_delay(held, 5.0), rel=1e-12)
    a, b = (sb.perturbed_members(system, 3) for system in (free, held))
    for one, other in zip(a, b, strict=True):
        assert np.allclose(one.q0, other.q0, rtol=1e-9)
        assert np.allclose(one.v0, other.v0, rtol=1e-9)


def test_perturbations_of_a_ball_are_of_the_order_of_size_times_the_motion():
    """At most 2 of the height and the speed of the fall; members that fall make as many impacts as it."""
    for floor in FLOORS.values():
        system = ball(0.0, floor)
        members = sb.perturbed_members(system, 20, 1e-3)
        q, v = (np.array([getattr(x, name)[0] for x in members]) for name in ("q0", "v0"))
        assert 1e-4 < np.max(np.abs(q - 1.0)) <= 2e-3
        assert 1e-3 < np.max(np.abs(v)) <= 1e-3 * np.sqrt(2.0 * G) * 1.01


@pytest.mark.parametrize("name", ["bouncing-ball", "kelvin-voigt", "hertz", "hunt-crossley", "bouncing-bar"])
def test_problems_without_stiffness_have_scales(name):
    problem = sb.problem(name)
    found = scales(problem.system, 10.0)
    assert 0.0 < found.speed < np.inf
    assert 0.0 < found.period <= 10.0


def test_free_bodies_and_bodies_between_stops_have_scales_in_any_unit():
    """Without forces a body crosses the gap of 2 with speed 3; a free one has the run's length alone."""
    walls = sb.Contact([1.0], sb.Stops(-1.0, 1.0, stiffness=np.inf, restitution=1.0))
    for time in (1.0, 1e-6):
        start = {"initial_velocity": [3.0 * time]}
        body = sb.System.from_matrices([[1.0]], [[0.0]], contacts=[walls], **start)
        assert scales(body, 100.0 / time).rates == pytest.approx(3.0 * time)
        free = sb.System.from_matrices([[1.0]], [[0.0]], observe=[1.0], **start)
        assert scales(free, 7.0 / time).period == pytest.approx(7.0 / time)


def test_a_beam_has_its_natural_frequencies(table10):
    system = sb.semidiscretise(table10, 25)
    assert np.array_equal(scales(system, 1.0).rates, undamped_modes(system).omega)


def test_a_stop_that_moves_gives_speed():
    """A ball at rest on a table of amplitude 0.1 and frequency 20 is thrown with a speed of 2."""
    contact = sb.Contact([1.0], sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.5), offset=sb.Harmonic(0.1, 20.0))
    table = sb.System.from_matrices([[1.0]], [[0.0]], loads=[([1.0], sb.Constant(-G))], contacts=[contact])
    assert scales(table, 10.0).speed == pytest.approx(2.0)
    assert scales(table, 10.0).rates == pytest.approx(G / 2.0)


def test_a_body_held_by_stops_alone_has_an_equilibrium():
    """Mass 100 on two springs of 1e5: 981/2e5; by Hertz's law (490.5/1e5)^(2/3)."""
    for exponent, depth in ((1.0, 4.905e-3), (1.5, (490.5 / 1e5) ** (2.0 / 3.0))):
        stops = sb.Stops(lower=0.0, stiffness=1e5, exponent=exponent)
        contacts = [sb.Contact([1.0, arm], stops) for arm in (-0.5, 0.5)]
        load = ([1.0, 0.0], sb.Constant(-981.0))
        body = sb.System.from_matrices(np.diag([100.0, 8.0]), np.zeros((2, 2)), loads=[load], contacts=contacts)
        assert np.allclose(sb.static_equilibrium(body), [-depth, 0.0], rtol=1e-12, atol=1e-15)


def test_only_the_stops_that_close_hold_an_equilibrium():
    """A free chain on two stops: the first carries all the weight, as the second is too far."""
    spring = 1e3 * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    contacts = [
        sb.Contact([1.0, 0.0, 0.0], sb.Stops(lower=-0.1, stiffness=1e4)),
        sb.Contact([0.0, 0.0, 1.0], sb.Stops(lower=-0.5, stiffness=1e4)),
    ]
    weight = G * np.ones(3)
    chain = sb.System.from_matrices(np.eye(3), spring, loads=[(-weight, sb.Constant(1.0))], contacts=contacts)
    lowest = -0.1 - 3.0 * G / 1e4
    expected = [lowest, lowest - 2.0 * G / 1e3, lowest - 3.0 * G / 1e3]
    assert np.allclose(sb.static_equilibrium(chain), expected, rtol=1e-12)


@pytest.mark.parametrize("seed", [0, 94, 105, 179, 217, 232])
def test_a_motion_without_strain_is_no_stiffness_where_rounding_makes_it_one(seed):
    """A free body in turned axes: the least eigenvalue of K is some 1e-16, and a stop holds it or nothing does."""
    rng = np.random.default_rng(seed)
    n = 4
    free = rng.normal(size=n)
    free /= np.linalg.norm(free)
    across = np.eye(n) - np.outer(free, free)
    root = rng.normal(size=(n, n))
    K = across @ (root @ root.T + 0.1 * np.eye(n)) @ across
    load = rng.normal(size=n)
    load *= np.sign(load @ free)
    stop, loads = sb.Stops(upper=0.1, stiffness=1e3), [(load, sb.Constant(2.0))]
    K, row = 0.5 * (K + K.T), free + 0.1 * rng.normal(size=n)
    held = sb.System.from_matrices(np.eye(n), K, loads=loads, contacts=[sb.Contact(row, stop)])
    q = sb.static_equilibrium(held)
    assert row @ q > 0.1
    assert np.max(np.abs(2.0 * load - K @ q + row * stop.force(row @ q))) < 1e-8
    with pytest.raises(sb.InputError, match="hold the system"):
        sb.static_equilibrium(sb.System.from_matrices(np.eye(n), K, loads=loads, observe=row))


def test_three_stops_on_one_body_have_one_equilibrium():
    """Hertz, square and linear stops of one mass; the forces of two are zero."""
    laws = [
        (-0.0932, 0.3012, 26248.0, 1.5, -1.4917),
        (None, 0.8344, 892.7, 2.0, 0.4189),
        (0.1178, 0.7586, 36803.4, 1.0, -1.3053),
    ]
    stops = [(sb.Stops(low, up, stiffness=k, exponent=p), row) for low, up, k, p, row in laws]
    system = sb.System.from_matrices(
        [[1.0]], [[0.3723]], loads=[([1.0], sb.Constant(1.3425))], contacts=[sb.Contact([row], x) for x, row in stops]
    )
    (q,) = sb.static_equilibrium(system)
    assert abs(1.3425 - 0.3723 * q + sum(row * float(x.force(row * q)) for x, row in stops)) < 1e-9
