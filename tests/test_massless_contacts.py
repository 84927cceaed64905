"""Signorini's condition with a massless contact node: a known answer, a solver of its own, what is refused."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from bouncing_bar import IMPULSE, bouncing_bar, pressure
from scipy.integrate import solve_ivp

import stiffbeam as sb
from stiffbeam import InputError

RIGID = {"stiffness": np.inf}


def rms_of_pressure(system):
    """Over the first contact but a twentieth at either end, where the wave front is as wide as the cells."""
    t = np.linspace(1.05, 5.0 / 3.0 - 0.05, 2001)
    found = sb.reference(system, t_end=2.0, t_eval=t)
    return np.sqrt(np.mean((found.contacts[0].force - pressure(t)) ** 2))


@pytest.mark.slow
def test_the_pressure_under_a_bouncing_bar():
    assert rms_of_pressure(bouncing_bar(100).massless_contacts()) < 0.03  # of 300 to 500
    assert rms_of_pressure(bouncing_bar(100).massless_contacts("renard")) < 1.0  # whose mass is spread over the bar


def test_a_bouncing_bar_meets_the_wall_six_times_in_three_periods():
    found = sb.reference(bouncing_bar(50).massless_contacts(), t_end=16.0).contacts[0]
    assert found.impacts.count == 6
    assert found.impacts.impulses[:2] == pytest.approx(IMPULSE, rel=5e-3)  # 3.3e-3 and 3.5e-3
    assert found.impacts.times[:2] == pytest.approx([1.0, 11.0 / 3.0], abs=5e-3)


@pytest.mark.parametrize("kappa", [np.inf, 30.0])
@pytest.mark.parametrize("scale", [1.0, -2.0])
def test_the_same_motion_as_of_the_node_held_in_balance(kappa, scale):
    """The witness solves for the node at every call of the right-hand side; it has no stop of stiffness K_bb."""
    M = np.diag([1.0, 0.5, 0.7])
    K = np.array([[30.0, -10.0, 0.0], [-10.0, 25.0, -15.0], [0.0, -15.0, 20.0]])
    load, f = np.array([0.3, -0.2, 1.5]), sb.Harmonic(4.0, 3.0, 0.4)
    stops, offset = sb.Stops(lower=-0.2, upper=0.1, stiffness=kappa), sb.Harmonic(0.02, 2.0)
    system = sb.System.from_matrices(
        M,
        K,
        loads=[(load, f)],
        contacts=[sb.Contact([0.0, 0.0, scale], stops, offset)],
        initial_velocity=[0.0, 1.0, 0.0],
    )
    moved = np.diag([1.0, 1.2])
    held = K[2, 2] / scale**2

    def node(t, q):
        free = scale * (load[2] * f.value(t) - K[2, :2] @ q) / K[2, 2] + float(offset.value(t))
        inside = free - np.clip(free, -0.2, 0.1)
        press = -inside * held if kappa == np.inf else -inside / (1.0 / held + 1.0 / kappa)
        return free, (load[2] * f.value(t) - K[2, :2] @ q + scale * press) / K[2, 2]

    def right(t, y):
        q = y[:2]
        force = load[:2] * f.value(t) - K[:2, :2] @ q - K[:2, 2] * node(t, q)[1]
        return np.concatenate([y[2:], force / np.diag(moved)])

    t = np.linspace(0.0, 3.0, 301)
    wanted = solve_ivp(right, (0.0, 3.0), [0.0, 0.0, 0.0, 1.0], "DOP853", t, rtol=1e-12, atol=1e-13, max_step=1e-2).y
    condensed = system.massless_contacts()
    assert np.array_equal(condensed.mass, moved)
    found = sb.reference(condensed, t_end=3.0, t_eval=t)
    free = np.array([node(when, q)[0] for when, q in zip(t, wanted[:2].T, strict=True)])
    assert found.contacts[0].impacts.count >= 2
    assert np.max(np.abs(found.tip - free)) < 1e-9  # max_step bounds what DOP853 misses at the kinks


def test_the_papers_stops_are_as_stiff_as_its_grid(table10):
    beam = sb.semidiscretise(table10, 25)
    tip = np.eye(25)[-1]
    observed = sb.System.from_matrices(beam.mass, beam.stiffness, contacts=beam.contacts, observe=tip)
    with pytest.raises(InputError, match="observe"):
        observed.massless_contacts()
    rigid = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, stops=sb.Stops(lower=-0.1, upper=0.1, **RIGID)), 25)
    assert rigid.massless_contacts().contacts[0].stops.stiffness == pytest.approx(300.0 * 25**3, rel=1e-12)  # k^2/h^3


@pytest.mark.parametrize("redistribute", ["neighbour", "renard"])
def test_the_mass_goes_somewhere(redistribute):
    bar = bouncing_bar(10)
    assert np.sum(bar.massless_contacts(redistribute).mass) == pytest.approx(10.0, rel=1e-13)
    beam = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, stops=sb.Stops(upper=0.1, **RIGID)), 8)
    moved = beam.massless_contacts(redistribute).mass
    x = np.arange(1, 9) / 8.0
    assert np.sum(moved) == pytest.approx(np.sum(beam.mass), rel=1e-13)
    if redistribute == "renard":
        for power in (1, 2):
            wanted = x**power @ np.diag(beam.mass)
            assert x[:-1] ** power @ np.diag(moved) == pytest.approx(wanted, rel=1e-12)


class Node:
    """M q'' + C q' + K q = p f for all but the last unknown b, which has no mass: C_bb b' + ... = p_b f, b in [lower,
    upper] by a reaction that presses. SciPy's DOP853 from switch to switch; free, b is a state of its own."""

    def __init__(self, system, mass):
        self.K, self.C, self.inverse, (self.p, self.f) = system.stiffness, system.damping, 1.0 / mass, system.loads[0]
        self.stops, self.n, self.side = system.contacts[0].stops, len(mass), 0

    def rate(self, t, y):
        n, load = self.n, self.p * self.f.amplitude * np.sin(self.f.frequency * t + self.f.phase)
        free = (load[n] - self.K[n, :n] @ y[:n] - self.C[n, :n] @ y[n:-1] - self.K[n, n] * y[-1]) / self.C[n, n]
        return free, load[:n] - self.K[:n, :n] @ y[:n] - self.K[:n, n] * y[-1] - self.C[:n, :n] @ y[n:-1]

    def right(self, t, y):
        free, force = self.rate(t, y)
        moving = 0.0 if self.side else free
        return np.concatenate([y[self.n : -1], self.inverse * (force - self.C[: self.n, self.n] * moving), [moving]])

    def stiff(self, kappa, t, y):
        """A spring for the stop, without sides or switches."""
        free, force = self.rate(t, y)
        moving = free - kappa * self.stops.penetration(y[-1]) / self.C[self.n, self.n]
        return np.concatenate([y[self.n : -1], self.inverse * (force - self.C[: self.n, self.n] * moving), [moving]])

    def solve(self, y, times):
        """States (times, 2n + 1), and the times of all entries and of all releases."""
        t, found, entries, releases = 0.0, [], [], []
        while True:
            sides = [self.side] if self.side else [x for x in (1, -1) if np.isfinite(self.gap(x))]
            events = [lambda t, y: self.side * self.rate(t, y)[0]] if self.side else []
            events += [] if self.side else [lambda t, y, x=x: x * (y[-1] - self.gap(x)) for x in sides]
            for event in events:
                event.terminal, event.direction = True, -1.0 if self.side else 1.0
            due = times[len(found) :]
            path = solve_ivp(
                self.right, (t, times[-1]), y, "DOP853", due, events=events, rtol=1e-12, atol=1e-13, max_step=0.02
            )
            found += list(np.transpose(path.y)) if np.size(path.y) else []
            if path.status != 1:
                return np.array(found), np.array(entries), np.array(releases)
            k = next(k for k, x in enumerate(path.t_events) if len(x))
            t, y = float(path.t_events[k][0]), path.y_events[k][0]
            (releases if self.side else entries).append(t)
            self.side = 0 if self.side else sides[k]
            y[-1] = self.gap(self.side) if self.side else y[-1]

    def gap(self, side):
        return self.stops.g2 if side > 0 else self.stops.g1


def damped_node(seed):
    """A random system with a rigid stop at its last unknown, its damping there that of the material; and beta."""
    rng = np.random.default_rng([seed, 1414])
    n, beta = int(rng.integers(2, 5)), 10.0 ** rng.uniform(-3.5, -1.5)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n - 1, n - 1))
    stiffness = 10.0 * (4.0 * np.eye(n) + A @ A.T)
    damping = beta * stiffness
    damping[:-1, :-1] += rng.choice([0.0, 0.1]) * B @ B.T
    gap = float(rng.uniform(0.05, 0.3))
    sides = [(-gap, None), (None, gap), (-gap, 0.7 * gap)][rng.integers(3)]
    load = rng.normal(size=n), sb.Harmonic(float(rng.uniform(10.0, 40.0)), float(rng.uniform(0.5, 8.0)))
    system = sb.System.from_matrices(
        np.diag(rng.uniform(0.5, 2.0, n)),
        stiffness,
        damping,
        [load],
        [sb.Contact(np.eye(n)[-1], sb.Stops(*sides, **RIGID))],
        initial_velocity=rng.normal(size=n),
    )
    return system, beta


def relaxed_start(condensed):
    """(q, q', b) at t = 0 with the node where it is after long rest."""
    b = float(condensed.positions(0.0, condensed.q0)[0])
    return np.concatenate([condensed.q0, condensed.v0, [b]])


@pytest.mark.parametrize(
    "seed", [pytest.param(s, marks=pytest.mark.slow if s < 40 else pytest.mark.campaign) for s in range(300)]
)
@pytest.mark.fast(6)
def test_a_damped_node_is_a_kelvin_voigt_stop_where_it_has_relaxed(seed):
    system, beta = damped_node(seed)
    condensed = system.massless_contacts(damping="relaxed")
    t, start = np.linspace(0.0, 3.0, 61), relaxed_start(condensed)
    if system.contacts[0].stops.penetration(start[-1]):
        pytest.skip("starts beyond the stop")
    wanted, entries, releases = Node(system, np.diag(condensed.mass)).solve(start, t)
    found = sb.reference(condensed, 3.0, t_eval=t)
    flight = np.min(entries[1:] - releases[: len(entries) - 1], initial=3.0)
    error = np.max(np.abs(found.states[0] - wanted[:, : condensed.size])) / np.max(np.abs(wanted))
    assert found.contacts[0].impacts.count == len(entries)
    # The witness's own 1e-9 as in other tests of it, and what is left of the last contact when the next begins.
    assert error < 1e-9 + np.exp(-flight / beta)


def test_the_node_of_the_witness_is_the_limit_of_stiff_springs():
    """Radau with a spring for the stop: within C/kappa of the reaction that has no spring."""
    system, _ = damped_node(4)
    condensed = system.massless_contacts(damping="relaxed")
    node, t, start = Node(system, np.diag(condensed.mass)), np.linspace(0.0, 3.0, 61), relaxed_start(condensed)
    wanted, entries, _ = node.solve(start, t)
    assert len(entries) >= 2
    off = []
    for kappa in (1e4, 1e5):
        right = lambda t, y, kappa=kappa: node.stiff(kappa, t, y)  # noqa: E731
        path = solve_ivp(right, (0.0, 3.0), start, "Radau", t, rtol=1e-9, atol=1e-11, max_step=0.01)
        off.append(np.max(np.abs(path.y.T - wanted)[:, -1]) / np.max(np.abs(wanted[:, -1])))
    assert off[1] < 0.15 * off[0] < 0.15 * 0.05


def small(row=(0.0, 0.0, 1.0), mass=None, stiffness=None, **given):
    stops = given.pop("stops", sb.Stops(upper=0.1, **RIGID))
    K = [[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]] if stiffness is None else stiffness
    contacts = given.pop("contacts", [sb.Contact(row, stops)])
    return sb.System.from_matrices(np.eye(3) if mass is None else mass, K, contacts=contacts, **given)


COUPLED = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.2], [0.0, 0.2, 1.0]]


def pair(*places, gaps=(0.1, 0.1)):
    """Rigid stops at two unknowns."""
    return [sb.Contact(np.eye(3)[i], sb.Stops(upper=g, **RIGID)) for i, g in zip(places, gaps, strict=True)]


@pytest.mark.parametrize(
    ("system", "how", "named"),
    [
        (lambda: small(), "elsewhere", "redistribute"),
        (lambda: small(), "renard", "held"),
        (lambda: small(contacts=[], observe=[1.0, 0.0, 0.0]), "neighbour", "contact"),
        (lambda: small(row=(0.0, 1.0, 1.0)), "neighbour", "one unknown"),
        (lambda: small(mass=COUPLED), "neighbour", "renard"),
        (lambda: small(damping=0.1 * np.eye(3)), "neighbour", "damping='condensed'"),
        (lambda: small(stops=sb.Stops(upper=0.1, restitution=0.5, **RIGID)), "neighbour", "restitution"),
        (lambda: small(stops=sb.Stops(upper=0.1, stiffness=10.0, exponent=1.5)), "neighbour", "exponent"),
        (lambda: small(loads=[(np.eye(3)[2], np.sin)]), "neighbour", "Sampled"),
        (lambda: small(contacts=pair(1, 2)), "neighbour", "beside"),
        (lambda: small(contacts=pair(2, 2, gaps=(0.1, 0.2))), "neighbour", "own"),
        (lambda: small(stiffness=np.diag([1.0, 1.0, 0.0])), "neighbour", "held"),
        (lambda: small(stiffness=np.eye(3)), "neighbour", "coupled"),
    ],
)  # fmt: skip
def test_what_is_refused(system, how, named):
    with pytest.raises(InputError, match=named):
        system().massless_contacts(how)


CHAIN = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
POLYGON = [(np.eye(3)[2], sb.Sampled([0.0, 1.0], [0.0, 1.0]))]


@pytest.mark.parametrize(
    ("given", "asked", "named"),
    [
        ({"damping": 0.01 * CHAIN}, "none", "flights between contacts are long against 0.01, or"),
        ({"damping": 0.01 * CHAIN + 0.1 * np.eye(3)}, "none", "multiple of the stiffness"),
        ({"damping": 0.01 * CHAIN + 0.1 * np.eye(3)}, "relaxed", "multiple of the stiffness"),
        ({"damping": 0.01 * CHAIN, "stops": sb.Stops(upper=0.1, stiffness=9.0)}, "relaxed", "be inf"),
        ({"damping": 0.01 * CHAIN, "loads": POLYGON}, "relaxed", "Harmonic and Constant"),
    ],
    ids=[
        "not asked for",
        "other damping",
        "other damping, relaxed",
        "a spring in series",
        "a load without steady state",
    ],
)
def test_the_remedies_for_damping_at_a_node_work_as_they_are_written(given, asked, named):
    with pytest.raises(InputError, match=named) as refused:
        small(**given).massless_contacts(damping=asked)
    remedies = re.findall(r"damping='(\w+)'", str(refused.value))
    assert remedies[-1] == "condensed"
    for remedy in remedies:
        made = small(**given, initial_velocity=[0.0, 1.0, 0.0]).massless_contacts(damping=remedy)
        assert (made.contacts[0].stops.damping > 0.0) == (remedy == "relaxed")
        assert sb.reference(made, 1.0).impacts.count


def test_condensed_damping_leaves_rigid_motions_and_free_flights_as_they_are():
    free = np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    drifting = small(stiffness=free, damping=0.03 * free, initial_velocity=np.ones(3))
    made = drifting.massless_contacts(damping="condensed")
    assert np.max(np.abs(made.damping @ np.ones(2))) < 1e-16
    for damping in ("relaxed", "condensed"):
        system, _ = damped_node(0)
        system = replace(system, contacts=(sb.Contact(system.contacts[0].row, sb.Stops(upper=1e3, **RIGID)),))
        condensed, t = system.massless_contacts(damping=damping), np.linspace(0.0, 3.0, 61)
        wanted, entries, _ = Node(system, np.diag(condensed.mass)).solve(relaxed_start(condensed), t)
        assert not len(entries)
        found = sb.reference(condensed, 3.0, t_eval=t)
        assert np.max(np.abs(found.states[0] - wanted[:, : condensed.size])) < 1e-9
        # The node: relaxed with the lag of its load, condensed at rest under its forces.
        lag = np.max(np.abs(found.tip - wanted[:, -1]))
        assert lag < 1e-9 if damping == "relaxed" else lag > 1e-6


def test_a_viscous_beam_on_rigid_stops():
    """Its base moves, so that its loads act on the node; every reference and scheme takes the damped stop."""
    wall = sb.Stops(lower=-0.1, upper=0.1, **RIGID)
    base = sb.Harmonic(amplitude=0.2, frequency=10.0)
    beam = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, viscosity=0.3, stops=wall, base=base), 8)
    condensed = beam.massless_contacts(damping="relaxed")
    stops = condensed.contacts[0].stops
    assert stops.stiffness == pytest.approx(300.0 * 8**3, rel=1e-12)
    assert stops.damping == pytest.approx(0.3 * 8**3, rel=1e-12)
    # k^2 phi + d phi' pulls at the node, which lags behind it: what is left is phi, a node that follows the base.
    t = np.linspace(0.0, 0.5, 101)
    assert condensed.contacts[0].offset.value(t) == pytest.approx(2.0 / 8**2 * base.value(t), abs=1e-15)
    found = sb.reference(condensed, 0.5, t_eval=t)
    assert found.horizon == 0.5
    assert found.impacts.count == 3
    for method, error in (("multiprecision", 1e-13), ("dop853", 1e-9)):
        other = sb.reference(condensed, 0.5, method=method, t_eval=t)
        assert np.max(np.abs(found.tip - other.tip)) < error
        assert other.impacts.count == 3


def test_rigid_stops_are_told_apart():
    assert (
        repr(sb.Stops(upper=0.1, restitution=0.5, **RIGID))
        == "Stops(lower=None, upper=0.1, stiffness=inf, restitution=0.5)"
    )
    for numbers in (
        {"damping": 1.0},
        {"exponent": 1.5},
        {"dissipation": 1.0},
        {"restitution": 1.1},
        {"restitution": np.nan},
    ):
        with pytest.raises(InputError):
            sb.Stops(upper=0.1, **RIGID, **numbers)
    with pytest.raises(InputError, match="from_restitution"):
        sb.Stops(upper=0.1, stiffness=1.0, restitution=0.5)
