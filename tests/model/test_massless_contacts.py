"""Signorini's condition with a massless contact node: a known answer, a solver of its own, what is refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from bouncing_bar import IMPULSE, bouncing_bar, pressure
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag

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


@pytest.mark.fast(1)
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


def rods(*bodies, **given):
    """Linear elements with lumped mass, end to end: (elements, length, impedance) each, wave speed 1; no elements: a
    body of one unknown that has that mass."""
    masses, stiffnesses = [], []
    for cells, length, impedance in bodies:
        dx = length / max(cells, 1)
        inside = np.full(max(cells - 1, 0), 2.0)
        masses += [impedance * dx * np.r_[0.5, inside / 2.0, 0.5]] if cells else [[impedance]]
        chain = np.diag(np.r_[1.0, inside, 1.0]) - np.eye(cells + 1, k=1) - np.eye(cells + 1, k=-1)
        stiffnesses += [impedance / dx * chain if cells else np.zeros((1, 1))]
    return sb.System.from_matrices(np.diag(np.concatenate(masses)), block_diag(*stiffnesses), **given)


def colliding(left, right, gap=0.1, speed=1.0):
    """The left one flies at ``speed`` over the gap to the right one, which is at rest."""
    n, size = left[0] + 1, left[0] + right[0] + 2
    row = np.eye(size)[n - 1] - np.eye(size)[n]
    contact = sb.Contact(row, sb.Stops(upper=gap, **RIGID))
    return rods(left, right, contacts=[contact], initial_velocity=speed * (np.arange(size) < n))


def momenta(system, states, cells):
    """Of the left rod and of the rest, in the last state."""
    each = np.diag(system.mass) * states[1][-1]
    return np.sum(each[:cells]), np.sum(each[cells:])


@pytest.mark.fast(1)
@pytest.mark.parametrize("engine", ["exact", "cvode", "multiprecision", "conserving"])
def test_equal_rods_exchange_their_velocities(engine):
    """d'Alembert: the force is 1/2 from t = .1 to 2.1, then the left rod is at rest and the right one flies."""
    cells = 10 if engine == "multiprecision" else 40
    system = colliding((cells, 1.0, 1.0), (cells, 1.0, 1.0)).massless_contacts()
    assert system.contacts[0].stops.stiffness == pytest.approx(cells / 2.0, rel=1e-13)  # two springs in series
    if engine == "conserving":
        run = sb.integrate(system, sb.Trapezoidal(), 0.25 / cells, 3.0, contact="conserving")
    else:
        run = sb.reference(system, 3.0, method=engine, t_eval=np.linspace(0.0, 3.0, 301))
    impacts, wave = run.contacts[0].impacts, 0.25 * cells ** (-2.0 / 3.0)  # the width of a front after one length
    assert impacts.count == 1
    assert impacts.times[0] == pytest.approx(0.1, abs=0.25 / cells)
    assert impacts.ends[0] - impacts.times[0] == pytest.approx(2.0, abs=3.0 * wave)
    assert run.contacts[0].impulse == pytest.approx(1.0, abs=wave)
    assert momenta(system, run.states, cells) == pytest.approx((0.0, 1.0), abs=wave)
    assert np.ptp(run.energy.energy) < (1e-6 if engine == "cvode" else 1e-12)


def characteristics(left, right, gap, t_end, dt):
    """The force between two free rods by their characteristics: a is the velocity that an end would have without it,
    and grows by what the force reflects from the other end, one travel there and back ago."""
    (length, z), (other, y) = left, right
    late, later = round(2.0 * length / dt), round(2.0 * other / dt)
    steps = round(t_end / dt)
    force, a, b = np.zeros(steps), np.ones(steps), np.zeros(steps)
    for k in range(steps):
        a[k] = a[k - late] - 2.0 * force[k - late] / z if k >= late else 1.0
        b[k] = b[k - later] + 2.0 * force[k - later] / y if k >= later else 0.0
        if gap <= 1e-12:
            force[k] = max(0.0, (a[k] - b[k]) * z * y / (z + y))
        gap -= dt * (a[k] - force[k] / z - b[k] - force[k] / y)
    return force


@pytest.mark.fast(1)
@pytest.mark.parametrize(("length", "impedance"), [(1.7, 0.5), (1.7, 3.0), (0.6, 2.0)])
def test_unlike_rods_against_their_characteristics(length, impedance):
    t_end, dt = 4.0, 1e-3
    system = colliding((80, 1.0, 1.0), (round(80 * length), length, impedance)).massless_contacts()
    t = dt * np.arange(1, round(t_end / dt) + 1)
    force = sb.reference(system, t_end, t_eval=t).contacts[0].force
    wanted = characteristics((1.0, 1.0), (length, impedance), 0.1, t_end, dt)
    # The momentum that has passed by then; a front of 80 elements is some .02 wide.
    assert np.max(np.abs(np.cumsum(-force - wanted))) * dt < 0.02 * np.sum(wanted) * dt


def test_a_ball_slows_down_on_a_rod():
    """m v' = -z v until the wave is back, 2L/c later. The ball keeps its mass."""
    cells, mass = 80, 0.5
    row = np.r_[np.zeros(cells), 1.0, -1.0]
    ball = np.r_[np.zeros(cells + 1), -1.0]
    contact = sb.Contact(row, sb.Stops(upper=0.1, **RIGID))
    system = rods((cells, 1.0, 1.0), (0, 1.0, mass), contacts=[contact], initial_velocity=ball).massless_contacts()
    t = np.linspace(0.0, 2.05, 42)
    found = sb.reference(system, 2.05, t_eval=t)
    assert np.max(np.abs(found.states[1][:, -1] + np.exp(-np.maximum(t - 0.1, 0.0) / mass))) < 5e-3


def string(cells, places):
    """Of tension and density 1, released as sin(pi x) above contacts at 0; u = sin(pi x) cos(pi t) until t = 1/2."""
    size = cells - 1
    return sb.System.from_matrices(
        np.eye(size) / cells,
        cells * (2.0 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1)),
        contacts=[sb.Contact(np.eye(size)[i], sb.Stops(lower=0.0, **RIGID)) for i in places],
        initial_displacement=np.sin(np.pi * np.arange(1, cells) / cells),
    )


@pytest.mark.parametrize("engine", ["exact", "conserving"])
def test_a_string_on_a_point_obstacle(engine):
    """The obstacle is in the middle; F = 2 pi sin(pi t) from t = 1/2 to 1."""
    cells = 160
    system = string(cells, [cells // 2 - 1]).massless_contacts()
    if engine == "exact":
        found = sb.reference(system, 1.4).contacts[0]
    else:
        found = sb.integrate(system, sb.Trapezoidal(), 0.5 / cells, 1.5, contact="conserving").contacts[0]
    assert found.impulse == pytest.approx(2.0, rel=1.5e-4)  # 2.00024 and 2.00025
    assert found.impacts.times[0] == pytest.approx(0.5, abs=1e-3)
    assert found.impacts.ends[0] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.fast(1)
@pytest.mark.parametrize("engine", ["exact", "conserving"])
def test_a_string_on_a_flat_obstacle(engine):
    """It turns round at t = 1/2, u = sin(pi x) |cos(pi t)|, by an impulse of 2 pi sin(pi x), 4 in all."""
    with pytest.raises(InputError, match=r"not coupled, here 0, 2, 4, 6, \.\.\., or"):
        string(20, range(19)).massless_contacts()
    errors = []
    for cells in (20, 40):
        system = string(cells, range(1, cells - 1, 2)).massless_contacts()
        if engine == "exact":
            run = sb.reference(system, 1.0)
        else:
            run = sb.integrate(system, sb.Trapezoidal(), 0.1 / cells, 1.0, contact="conserving")
        assert [contact.impacts.count for contact in run.contacts] == [1] * (cells // 2 - 1)
        assert np.ptp(run.energy.energy) < 1e-12
        errors.append(4.0 - sum(contact.impulse for contact in run.contacts))
    assert errors[0] < 0.13
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)  # second order


class Balance:
    """Nodes in balance under contacts of any rows: the active set that is consistent, of all that there are."""

    def __init__(self, system, nodes, mass):
        self.system, self.b, self.mass = system, nodes, mass
        self.i = [x for x in range(system.size) if x not in nodes]
        self.W = np.array([c.row for c in system.contacts])
        self.held = system.stiffness[np.ix_(nodes, nodes)]
        self.give = [0.0 if c.stops.rigid else 1.0 / c.stops.stiffness for c in system.contacts]

    def __call__(self, t, q):
        """(q_b, F) for the other unknowns q."""
        system, b, i = self.system, self.b, self.i
        load = system.load(t)[b] - system.stiffness[np.ix_(b, i)] @ q
        moved = [0.0 if c.offset is None else float(c.offset.value(t)) for c in system.contacts]
        base = self.W[:, i] @ q + moved
        for sides in product((0, 1, -1), repeat=len(base)):
            on = [c for c, side in enumerate(sides) if side]
            stops = [system.contacts[c].stops for c in on]
            target = np.array(
                [x.upper_bound if sides[c] > 0 else x.lower_bound for c, x in zip(on, stops, strict=True)]
            )
            if not np.all(np.isfinite(target)):
                continue
            W = self.W[np.ix_(on, b)]
            whole = np.block([[self.held, -W.T], [W, np.diag([self.give[c] for c in on])]])
            found = np.linalg.solve(whole, np.r_[load, target - base[on]])
            F = np.zeros(len(base))
            F[on] = found[len(b) :]
            u = self.W[:, b] @ found[: len(b)] + base
            free = all(
                c.stops.lower_bound <= u[k] + 1e-13 and u[k] - 1e-13 <= c.stops.upper_bound
                for k, c in enumerate(system.contacts)
                if not sides[k]
            )
            if free and all(F[c] * sides[c] <= 0.0 for c in on):
                return found[: len(b)], F
        raise AssertionError("no active set is consistent")

    def right(self, t, y):
        system, b, i = self.system, self.b, self.i
        q = y[: len(i)]
        q_b, F = self(t, q)
        force = system.load(t)[i] - system.stiffness[np.ix_(i, i)] @ q - system.stiffness[np.ix_(i, b)] @ q_b
        return np.concatenate([y[len(i) :], (force + self.W[:, i].T @ F) / self.mass])


def two_bodies(seed):
    """Unknowns 0, 1, 2 of a body and 3, 4, 5, 6 of another: 2 and 3 meet, a ball, 7, bounces between 5 and 6."""
    rng = np.random.default_rng([seed, 33])
    stiffness = np.diag(rng.uniform(1.0, 5.0, 8))
    for i, j in ((0, 1), (1, 2), (3, 4), (4, 5), (4, 6), (5, 6), (1, 4)):
        stretch = np.eye(8)[i] - np.eye(8)[j]
        stiffness += rng.uniform(10.0, 40.0) * np.outer(stretch, stretch)
    meet = np.r_[0.0, 0.0, 1.0, -2.0, 0.0, 0.0, 0.0, 0.0]
    between = np.r_[np.zeros(5), 0.3, 0.7, -1.0]
    contacts = [
        sb.Contact(meet, sb.Stops(-0.1, 0.15, **RIGID), sb.Harmonic(0.02, 2.0)),
        sb.Contact(between, sb.Stops(upper=0.05, stiffness=60.0)),
    ]
    load = rng.normal(size=8), sb.Harmonic(8.0, rng.uniform(1.0, 6.0), 0.4)
    velocity = np.r_[rng.normal(size=2), 0.0, 0.0, rng.normal(), 0.0, 0.0, 1.0]
    mass = np.diag(rng.uniform(0.5, 2.0, 8))
    return sb.System.from_matrices(mass, stiffness, loads=[load], contacts=contacts, initial_velocity=velocity)


@pytest.mark.fast(1, slow=6)
@pytest.mark.parametrize(("seed", "nodes"), [(s, n) for s in range(6) for n in (None, [2, 5], [3, 5, 6])])
def test_the_same_motion_as_of_nodes_of_two_bodies_in_balance(seed, nodes):
    system = two_bodies(seed)
    if nodes is None:
        ground = np.array(system.stiffness)
        ground[7, 7] = 3.0  # a ball on a spring of its own, coupled to others by rounding only
        ground[7, 0] = ground[0, 7] = 1e-15
        system = replace(system, stiffness=ground)
    condensed = system.massless_contacts(nodes=nodes)
    balance = Balance(system, [2, 3, 5, 6] if nodes is None else nodes, np.diag(condensed.mass))
    assert np.sum(balance.mass) == pytest.approx(np.trace(system.mass), rel=1e-13)
    t, start = np.linspace(0.0, 3.0, 301), np.r_[condensed.q0, condensed.v0]
    wanted = solve_ivp(balance.right, (0.0, 3.0), start, "DOP853", t, rtol=1e-10, atol=1e-11, max_step=2e-2).y
    found = sb.reference(condensed, 3.0, t_eval=t)
    assert sum(contact.impacts.count for contact in found.contacts) >= 2
    assert np.max(np.abs(found.states[0] - wanted[: condensed.size].T)) < 1e-7
    forces = np.array([balance(when, q)[1] for when, q in zip(t, wanted[: condensed.size].T, strict=True)])
    for contact, force in zip(found.contacts, forces.T, strict=True):
        assert np.max(np.abs(contact.force - force)) < 1e-5 * np.max(np.abs(forces))


def test_renard_keeps_mass_and_inertia_of_every_body():
    left, right = (8, 1.0, 1.0), (6, 0.6, 2.0)
    both = colliding(left, right)
    moved = np.diag(both.massless_contacts("renard").mass)
    assert np.sum(moved[:8]) == pytest.approx(1.0, rel=1e-12)
    assert np.sum(moved[8:]) == pytest.approx(1.2, rel=1e-12)
    clamped = np.array(both.stiffness)
    clamped[0, 0] *= 2.0
    with pytest.raises(InputError, match="held"):  # the left node's mass would be lost
        replace(both, stiffness=clamped).massless_contacts("renard")


def test_contacts_at_no_massless_node_stay_as_they_are():
    """A Hertz stop under the ball, and a rod's end that keeps its mass."""
    hertz = sb.Stops(lower=-1.0, stiffness=1e4, exponent=1.5, dissipation=0.1)
    rigid, rubber = sb.Stops(upper=0.1, **RIGID), sb.Stops(lower=-0.2, stiffness=50.0, damping=0.3)
    first, end, ball = np.eye(5)[0], np.eye(5)[3], np.eye(5)[4]
    contacts = [sb.Contact(end - ball, rigid), sb.Contact(ball, hertz), sb.Contact(first, rubber)]
    system = rods((3, 1.0, 1.0), (0, 1.0, 0.5), contacts=contacts)
    condensed = system.massless_contacts(nodes=[3])
    assert [contact.stops for contact in condensed.contacts[1:]] == [hertz, rubber]
    assert condensed.contacts[1].row.tolist() == [0.0, 0.0, 0.0, 1.0]
    assert condensed.contacts[0].row.tolist() == [0.0, 0.0, 1.0, -1.0]
    assert condensed.contacts[0].stops.stiffness == pytest.approx(3.0, rel=1e-13)
    with pytest.raises(InputError, match="damping"):  # the first node would be massless too, and its stop is damped
        system.massless_contacts()


def small(row=(0.0, 0.0, 1.0), mass=None, stiffness=None, **given):
    stops = given.pop("stops", sb.Stops(upper=0.1, **RIGID))
    K = [[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]] if stiffness is None else stiffness
    contacts = given.pop("contacts", [sb.Contact(row, stops)])
    return sb.System.from_matrices(np.eye(3) if mass is None else mass, K, contacts=contacts, **given)


COUPLED = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.2], [0.0, 0.2, 1.0]]


def pair(*places, gaps=(0.1, 0.1)):
    """Rigid stops at two unknowns."""
    return [sb.Contact(np.eye(3)[i], sb.Stops(upper=g, **RIGID)) for i, g in zip(places, gaps, strict=False)]


@pytest.mark.parametrize(
    ("system", "how", "named"),
    [
        (lambda: small(), "elsewhere", "redistribute"),
        (lambda: small(), "renard", "held"),
        (lambda: small(contacts=[], observe=[1.0, 0.0, 0.0]), "neighbour", "contact"),
        (lambda: small(row=(0.0, 1.0, 1.0)), "neighbour", "other contact nodes only"),
        (lambda: small(row=(1.0, 1.0, 1.0)), "neighbour", "unknowns with mass"),
        (lambda: small(mass=COUPLED), "neighbour", "renard"),
        (lambda: small(damping=0.1 * np.eye(3)), "neighbour", "damping='condensed'"),
        (lambda: small(stops=sb.Stops(upper=0.1, restitution=0.5, **RIGID)), "neighbour", "restitution"),
        (lambda: small(stops=sb.Stops(upper=0.1, stiffness=10.0, exponent=1.5)), "neighbour", "exponent"),
        (lambda: small(loads=[(np.eye(3)[2], np.sin)]), "neighbour", "Sampled"),
        (lambda: small(contacts=pair(1, 2)), "neighbour", "beside"),
        (lambda: small(contacts=pair(2, 2, gaps=(0.1, 0.2))), "neighbour", "own"),
        (lambda: small(stiffness=np.diag([1.0, 1.0, 0.0])), "neighbour", "held"),
        (lambda: small(stiffness=np.eye(3)), "neighbour", "coupled"),
        (lambda: small(contacts=[*pair(2), sb.Contact([1.0, 0.0, -1.0], sb.Stops(upper=1.0, **RIGID))]),
         "neighbour", "contacts 0 and 1 must be at nodes of their own"),
    ],
)  # fmt: skip
def test_what_is_refused(system, how, named):
    with pytest.raises(InputError, match=named):
        system().massless_contacts(how)


@pytest.mark.parametrize(
    ("nodes", "named"),
    [([0], "choose among"), ([], "choose among"), ([4], "choose among"), (2, "hold unknowns"), ([0.5], "integer")],
)
def test_nodes_are_unknowns_that_contacts_read(nodes, named):
    left, right = (1, 1.0, 1.0), (1, 1.0, 1.0)
    with pytest.raises(InputError, match=named):
        colliding(left, right).massless_contacts(nodes=nodes)


def test_a_rigid_stop_on_no_massless_node_is_refused():
    contacts = [sb.Contact(np.eye(3)[i], sb.Stops(upper=0.1, **RIGID)) for i in (0, 2)]
    with pytest.raises(InputError, match=r"contacts\[0\].stops.stiffness"):
        small(contacts=contacts).massless_contacts(nodes=[2])


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
