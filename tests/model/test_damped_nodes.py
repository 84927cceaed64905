"""Massless contact nodes with damping: against the node's own first-order equation, and what the refusals advise."""

from __future__ import annotations

import re
from dataclasses import replace
from math import cos, sin

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag

import stiffbeam as sb
from stiffbeam import InputError

RIGID = {"stiffness": np.inf}


class Node:
    """M q'' + C q' + K q = p f for all but the last unknown b, which has no mass: C_bb b' + ... = p_b f + s F, s b + o
    between the stops by an F that presses. SciPy's DOP853 from switch to switch; free, b is a state of its own."""

    def __init__(self, system, mass):
        K, C, n = system.stiffness, system.damping, len(mass)
        self.inverse, self.lag, self.C_bb, (self.p, self.f) = 1.0 / mass, C[:n, n], C[n, n], system.loads[0]
        self.pull = np.hstack([K[:, :n], C[:, :n], K[:, n:]])  # of (q, q', b), but for C_ib b'
        contact = system.contacts[0]
        self.stops, self.offset, self.s, self.n, self.side = (contact.stops, contact.offset, contact.row[-1], n, 0)

    def moved(self, t):
        """o and o'."""
        o = self.offset
        return (o.amplitude * sin(o.frequency * t), o.amplitude * o.frequency * cos(o.frequency * t)) if o else (0, 0)

    def gap(self, side, t):
        """b on the stop, and its rate."""
        o, rate = self.moved(t)
        return ((self.stops.upper_bound if side > 0 else self.stops.lower_bound) - o) / self.s, -rate / self.s

    def rate(self, t, y):
        """b' if it were free, and the forces on the others but for C_ib b'."""
        force = self.p * (self.f.amplitude * sin(self.f.frequency * t + self.f.phase)) - self.pull @ y
        return force[self.n] / self.C_bb, force[: self.n]

    def right(self, t, y, kappa=None):
        """kappa: a spring for the stop, without sides or switches."""
        n, (moving, force) = self.n, self.rate(t, y)
        if kappa is not None:
            moving -= self.s * kappa * self.stops.penetration(self.s * y[-1] + self.moved(t)[0]) / self.C_bb
        elif self.side:
            moving = self.gap(self.side, t)[1]
        return np.concatenate([y[n:-1], self.inverse * (force - self.lag * moving), [moving]])

    def events(self):
        """What rises through 0: side (s b + o - g) of a free node, F on a held one, which pulls then."""
        if self.side:
            found = [lambda t, y: self.side * (self.gap(self.side, t)[1] - self.rate(t, y)[0]) / self.s]
        else:
            found = [lambda t, y, x=x: x * self.s * (y[-1] - self.gap(x, t)[0]) for x in self.sides()]
        for event in found:
            event.terminal, event.direction = True, 1.0
        return found

    def sides(self):
        return [x for x, g in ((1, self.stops.upper_bound), (-1, self.stops.lower_bound)) if np.isfinite(g)]

    def solve(self, y, times):
        """States (times, 2n + 1), and the times of all entries and of all releases."""
        t, found, entries, releases = 0.0, [], [], []
        while True:
            due = times[len(found) :]
            path = solve_ivp(
                self.right,
                (t, times[-1]),
                y,
                "DOP853",
                due,
                events=self.events(),
                rtol=1e-12,
                atol=1e-13,
                max_step=0.02,
            )
            found += list(np.transpose(path.y)) if np.size(path.y) else []
            if path.status != 1:
                return np.array(found), np.array(entries), np.array(releases)
            k = next(k for k, x in enumerate(path.t_events) if len(x))
            t, y = float(path.t_events[k][0]), path.y_events[k][0]
            (releases if self.side else entries).append(t)
            self.side = 0 if self.side else self.sides()[k]
            y[-1] = self.gap(self.side, t)[0] if self.side else y[-1]


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
    size, frequency = rng.uniform(10.0, 40.0), rng.uniform(0.5, 8.0)
    late = np.arctan(beta * frequency)  # the node's lag: it starts at 0
    load = rng.normal(size=n), sb.Harmonic(size, frequency, late)
    row, offset = rng.choice([1.0, -2.0]) * np.eye(n)[-1], rng.choice([None, sb.Harmonic(0.03, 4.0)])
    system = sb.System.from_matrices(
        np.diag(rng.uniform(0.5, 2.0, n)),
        stiffness,
        damping,
        [load],
        [sb.Contact(row, sb.Stops(*sides, **RIGID), offset)],
        initial_velocity=rng.normal(size=n),
    )
    return system, beta


def start_of(condensed):
    """(q, q', b) at t = 0, where the node of ``damped_node`` is after long rest."""
    return np.concatenate([condensed.q0, condensed.v0, [0.0]])


@pytest.mark.parametrize("seed", range(300))
@pytest.mark.fast(1, slow=29)
def test_a_damped_node_is_a_kelvin_voigt_stop_where_it_has_relaxed(seed):
    system, beta = damped_node(seed)
    condensed = system.massless_contacts(damping="relaxed")
    t, start = np.linspace(0.0, 3.0, 61), start_of(condensed)
    wanted, entries, releases = Node(system, np.diag(condensed.mass)).solve(start, t)
    found = sb.reference(condensed, 3.0, t_eval=t)
    flight = np.min(entries[1:] - releases[: len(entries) - 1], initial=3.0)
    error = np.max(np.abs(found.states[0] - wanted[:, : condensed.size])) / np.max(np.abs(wanted))
    assert found.contacts[0].impacts.count == len(entries)
    # The witness's own 1e-9 as in other tests of it, and what is left of the last contact when the next begins.
    assert error < 1e-9 + np.exp(-flight / beta)


@pytest.mark.slow
def test_the_node_of_the_witness_is_the_limit_of_stiff_springs():
    """Radau with a spring for the stop: within C/kappa of the reaction that has no spring."""
    system, _ = damped_node(0)
    condensed = system.massless_contacts(damping="relaxed")
    node, t, start = Node(system, np.diag(condensed.mass)), np.linspace(0.0, 3.0, 61), start_of(condensed)
    wanted, entries, _ = node.solve(start, t)
    assert len(entries) >= 2
    off = []
    for kappa in (1e4, 1e5):
        path = solve_ivp(node.right, (0.0, 3.0), start, "Radau", t, args=(kappa,), rtol=1e-9, atol=1e-11, max_step=0.01)
        off.append(np.max(np.abs(path.y.T - wanted)[:, -1]) / np.max(np.abs(wanted[:, -1])))
    assert off[1] < 0.15 * off[0] < 0.15 * 0.05


@pytest.mark.slow
def test_a_light_node_with_restitution_0_errs_in_first_order_of_its_mass():
    system, _ = damped_node(21)  # flights of four relaxation times
    moved, t = np.zeros_like(system.mass), np.linspace(0.0, 3.0, 61)
    condensed = system.massless_contacts(damping="relaxed")
    moved[:-1, :-1] = condensed.mass
    wanted, entries, _ = Node(system, np.diag(condensed.mass)).solve(start_of(condensed), t)
    contact, errors = system.contacts[0], []
    for kept in (1e-2, 1e-3):
        light = replace(
            system,
            mass=kept * system.mass + (1.0 - kept) * moved,
            v0=np.append(condensed.v0, 0.0),
            contacts=(sb.Contact(contact.row, replace(contact.stops, restitution=0.0), contact.offset),),
        )
        found = sb.reference(light, 3.0, t_eval=t)
        assert found.contacts[0].impacts.count == len(entries)
        errors.append(np.max(np.abs(found.states[0][:, :-1] - wanted[:, : condensed.size])))
    assert errors[0] < 0.01 * np.max(np.abs(wanted))
    assert errors[1] == pytest.approx(0.1 * errors[0], rel=0.05)


CHAIN = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])


def chain(stiffness=CHAIN, stops=None, **given):
    """Three masses, the last before a rigid stop."""
    contact = sb.Contact([0.0, 0.0, 1.0], stops or sb.Stops(upper=0.1, **RIGID))
    return sb.System.from_matrices(np.eye(3), stiffness, contacts=[contact], **given)


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
        chain(**given).massless_contacts(damping=asked)
    remedies = re.findall(r"damping='(\w+)'", str(refused.value))
    assert remedies[-1] == "condensed"
    for remedy in remedies:
        made = chain(**given, initial_velocity=[0.0, 1.0, 0.0]).massless_contacts(damping=remedy)
        assert (made.contacts[0].stops.damping > 0.0) == (remedy == "relaxed")
        assert sb.reference(made, 1.0).impacts.count


@pytest.mark.slow
def test_condensed_damping_leaves_rigid_motions_and_free_flights_as_they_are():
    free = np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    drifting = chain(stiffness=free, damping=0.03 * free, initial_velocity=np.ones(3))
    made = drifting.massless_contacts(damping="condensed")
    assert np.max(np.abs(made.damping @ np.ones(2))) < 1e-16
    for damping in ("relaxed", "condensed"):
        system, _ = damped_node(0)
        system = replace(system, contacts=(sb.Contact(np.eye(system.size)[-1], sb.Stops(upper=1e3, **RIGID)),))
        condensed, t = system.massless_contacts(damping=damping), np.linspace(0.0, 1.0, 21)
        wanted, entries, _ = Node(system, np.diag(condensed.mass)).solve(start_of(condensed), t)
        assert not len(entries)
        found = sb.reference(condensed, 1.0, t_eval=t)
        assert np.max(np.abs(found.states[0] - wanted[:, : condensed.size])) < 1e-9
        # The node: relaxed with the lag of its load, condensed at rest under its forces.
        lag = np.max(np.abs(found.tip - wanted[:, -1]))
        assert lag < 1e-9 if damping == "relaxed" else lag > 1e-6


@pytest.mark.slow
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


def test_two_damped_nodes_of_a_symmetric_chain_move_as_the_one_of_its_half():
    whole = 40.0 * (2.0 * np.eye(5) - np.eye(5, k=1) - np.eye(5, k=-1))
    half = 40.0 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])  # of the middle mass one half
    wall, t = sb.Stops(upper=0.05, **RIGID), np.linspace(0.0, 4.0, 81)
    seen = []
    for mass, stiffness, at, speed in (
        (np.eye(5), whole, (0, 4), [0.0, 1.0, 1.0, 1.0, 0.0]),
        (np.diag([1.0, 1.0, 0.5]), half, (0,), [0.0, 1.0, 1.0]),
    ):
        contacts = [sb.Contact(np.eye(len(mass))[b], wall) for b in at]
        damping = 0.003 * stiffness
        system = sb.System.from_matrices(mass, stiffness, damping, contacts=contacts, initial_velocity=speed)
        found = sb.reference(system.massless_contacts(damping="relaxed"), 4.0, t_eval=t)
        assert all(contact.impacts.count >= 2 for contact in found.contacts)
        seen += [contact.position for contact in found.contacts]
    assert len(seen) == 3
    assert np.max(np.abs(seen[0] - seen[1])) < 1e-12
    assert np.max(np.abs(seen[0] - seen[2])) < 1e-12


def two_chains(multiples):
    """Three unknowns each, whose damping is a multiple of their stiffness; 2 and 3 meet."""
    chain = np.array([[60.0, -30.0, 0.0], [-30.0, 55.0, -20.0], [0.0, -20.0, 25.0]])
    parts = chain, 1.3 * chain[::-1, ::-1]
    stiffness, damping = block_diag(*parts), block_diag(*(m * K for m, K in zip(multiples, parts, strict=True)))
    return sb.System.from_matrices(
        np.diag([1.0, 1.0, 0.2, 0.2, 1.5, 1.5]),
        stiffness,
        damping,
        contacts=[sb.Contact([0.0, 0.0, 1.0, -1.0, 0.0, 0.0], sb.Stops(upper=0.05, **RIGID))],
        initial_velocity=[1.0, 1.0, 0.0, 0.0, -1.0, 0.0],
    )


@pytest.mark.slow
def test_damped_nodes_of_two_bodies_are_one_kelvin_voigt_stop():
    """Against implicit steps of the nodes' first-order equations under one unilateral force."""
    beta, h, t_end = 5e-3, 5e-5, 2.0
    system = two_chains((beta, beta))
    condensed = system.massless_contacts(damping="relaxed")
    b, i, row = [2, 3], [0, 1, 4, 5], np.array([1.0, -1.0])
    K, C = system.stiffness, system.damping
    of_nodes = np.linalg.inv(C[np.ix_(b, b)] / h + K[np.ix_(b, b)])
    lag, to_inner, to_nodes = C[np.ix_(b, b)] / h, K[np.ix_(i, b)], of_nodes @ row
    give, inverse = row @ to_nodes, 1.0 / np.diag(condensed.mass)
    q, v, nodes = np.zeros(4), np.array([1.0, 1.0, -1.0, 0.0]), np.zeros(2)
    path = [q]
    for k in range(round(t_end / h)):
        q = q + 0.5 * h * v
        pull = K[np.ix_(i, i)] @ q + C[np.ix_(i, i)] @ v
        after = of_nodes @ (lag @ nodes - to_inner.T @ q - C[np.ix_(b, i)] @ v)
        after = after + to_nodes * min(0.0, (0.05 - row @ after) / give)
        v = v - h * inverse * (pull + to_inner @ after + C[np.ix_(i, b)] @ (after - nodes) / h)
        q, nodes = q + 0.5 * h * v, after
        if (k + 1) % 400 == 0:
            path.append(q)
    found = sb.reference(condensed, t_end, t_eval=np.linspace(0.0, t_end, len(path)))
    assert found.contacts[0].impacts.count >= 2
    assert np.max(np.abs(found.states[0] - path)) < 1e-3 * np.max(np.abs(path))


def test_a_contact_has_one_relaxation_time():
    with pytest.raises(InputError, match="same multiple"):
        two_chains((5e-3, 4e-3)).massless_contacts(damping="relaxed")
    assert two_chains((5e-3, 4e-3)).massless_contacts(damping="condensed").contacts[0].stops.damping == 0.0
    one_sided = two_chains((5e-3, 4e-3)).massless_contacts(damping="relaxed", nodes=[2])
    assert one_sided.contacts[0].stops.damping == pytest.approx(5e-3 * 25.0, rel=1e-13)
