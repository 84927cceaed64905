"""Signorini's condition with a massless contact node: a known answer, a solver of its own, what is refused."""

from __future__ import annotations

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
