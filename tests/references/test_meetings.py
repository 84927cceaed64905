"""Where eigenvalues meet each other or a drive: critical damping, free bodies, resonance, against closed forms,
matrix exponentials."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from systems import system_of
from witness import Case, Contact, solve

import stiffbeam as sb


def system(mass, damping, stiffness, contacts=(), loads=(), q0=None, v0=None):
    n = len(mass)
    return sb.System.from_matrices(
        mass, stiffness, damping, contacts=[sb.Contact(row, stops) for row, stops in contacts], loads=loads,
        observe=np.eye(n)[0], initial_displacement=q0, initial_velocity=v0,
    )  # fmt: skip


def one(damping, stiffness, load, q0, v0, contacts=()):
    loads = [] if load is None else [([1.0], load)]
    return system([[1.0]], [[damping]], [[stiffness]], contacts, loads, [q0], [v0])


@pytest.mark.parametrize("method", ["exact", "multiprecision"])
@pytest.mark.parametrize(
    ("damping", "stiffness", "load", "q0", "v0", "closed"),
    [
        (4.0, 4.0, None, 1.0, 0.0, lambda t: (1 + 2 * t) * np.exp(-2 * t)),
        (4.0, 4.0, sb.Constant(4.0), 0.0, 0.0, lambda t: 1 - (1 + 2 * t) * np.exp(-2 * t)),
        (0.5, 0.0, None, 0.0, 1.0, lambda t: -2 * np.expm1(-t / 2)),
        (0.5, 0.0, sb.Constant(1.0), 0.0, 0.0, lambda t: 2 * t + 4 * np.expm1(-t / 2)),
        (1e-13, 0.0, sb.Constant(1.0), 0.0, 0.0, lambda t: t**2 / 2 - 1e-13 * t**3 / 6),
        (0.0, 0.0, sb.Constant(1.0), 1.0, 2.0, lambda t: 1 + 2 * t + t**2 / 2),
        (0.0, 0.0, sb.Harmonic(1.0, 2.0), 0.0, 0.0, lambda t: t / 2 - np.sin(2 * t) / 4),
        (0.0, 9.0, sb.Harmonic(1.0, 3.0), 0.0, 0.0, lambda t: (np.sin(3 * t) / 3 - t * np.cos(3 * t)) / 6),
    ],
    ids=["critical", "critical, loaded", "free, damped", "free, damped, loaded", "free, hardly damped", "free, loaded",
         "free, driven", "resonance"],
)  # fmt: skip
@pytest.mark.fast(8)
def test_closed_forms_of_one_mass(method, damping, stiffness, load, q0, v0, closed):
    """Two contacts out of reach, so that it is the solution by complex exponentials."""
    far = [([1.0], sb.Stops(-1e3, 1e3, stiffness=1.0))] * 2
    ref = sb.reference(one(damping, stiffness, load, q0, v0, far), 5.0, method)
    assert ref.horizon == 5.0
    assert np.max(np.abs(ref.tip - closed(ref.t))) < 2e-14 * np.max(np.abs(closed(ref.t)))


def case(damping, stiffness, loads, stops=(), v0=None):
    """Plain data of masses one; stops: (row, lower, upper, kappa)."""
    n = len(stiffness)
    contacts = tuple(Contact(np.array(row, float), *rest) for row, *rest in stops)
    forces = tuple((np.array(p, float), wave) for p, wave in loads)
    speeds = np.zeros(n) if v0 is None else np.array(v0, float)
    return Case(
        np.eye(n), np.array(damping, float), np.array(stiffness, float), np.zeros(n), speeds, forces, contacts,
        np.eye(n)[0], 6.0,
    )  # fmt: skip


def swing(size, frequency):
    return ("harmonic", size, frequency, 0.0)


PAIR, NONE = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.zeros((2, 2))
STOPS = [([1.0, 0.0], -0.2, 0.1, 400.0), ([0.0, 1.0], -np.inf, 0.3, 100.0)]
ONE = [([1.0], -0.5, 0.5, 80.0)]
HELD = np.diag([4.0, 9.0])
MEETINGS = {
    "critical damping": case([[2.0]], [[1.0]], [([1.0], swing(3.0, 2.0))], ONE),
    "critical damping in contact only": case(
        [[20.0]], [[0.0]], [([1.0], swing(90.0, 2.0))], [([1.0], -0.5, 0.5, 100.0)], [1.0]
    ),
    "free body, dampers inside": case(
        0.1 * PAIR, 50.0 * PAIR, [([1.0, 0.0], swing(3.0, 2.0)), ([0.0, 1.0], ("constant", -0.5))], STOPS
    ),
    "free body, one damper on the ground": case(
        np.diag([0.7, 0.0]), 50.0 * PAIR, [([1.0, 1.0], swing(3.0, 2.0))], STOPS
    ),
    "free body, no damping": case(NONE, 50.0 * PAIR, [([1.0, 1.0], swing(3.0, 2.0))], STOPS),
    "resonance of the free regime": case(NONE, HELD, [([1.0, 1.0], swing(0.5, 2.0))], STOPS),
    "resonance of a contact regime": case(NONE, HELD, [([1.0, 1.0], swing(8.0, float(np.sqrt(404.0))))], STOPS),
    "one vector to four eigenvalues": case(
        [[3.2, 0.9], [0.9, 0.8]], np.diag([4.0, 0.25]), [([1.0, 1.0], swing(3.0, 2.0))], STOPS
    ),
    "equal critical modes": case(4.0 * np.eye(2), 4.0 * np.eye(2), [([1.0, 1.0], swing(9.0, 2.0))], STOPS),
}


@pytest.mark.parametrize("name", list(MEETINGS))
@pytest.mark.fast(1)
def test_it_is_the_motion_by_matrix_exponentials(name):
    """Both err by roundings that the impacts magnify, a few powers of ten in this time."""
    plain = MEETINGS[name]
    made, t_end = system_of(plain), plain.t_end
    ref = sb.reference(made, t_end)
    assert ref.horizon == t_end
    assert ref.contacts[0].impacts.count > 1
    other = solve(plain).tip(ref.t)
    assert np.max(np.abs(ref.tip - other)) < 1e-9 * np.max(np.abs(other))
    assert np.max(np.abs(ref.energy.loss)) < 1e-11 * np.max(np.abs(ref.energy.input))
    many = sb.reference(made, t_end, "multiprecision", t_eval=ref.t)
    assert many.horizon == t_end
    assert np.max(np.abs(ref.tip - many.tip)) < 1e-10 * np.max(np.abs(many.tip))


@pytest.mark.parametrize("method", ["exact", "multiprecision"])
def test_two_bodies_that_only_dashpots_join(method):
    """Both stay where they come to rest: two eigenvalues are zero, with vectors that nothing tells apart."""
    K = scipy.linalg.block_diag(1.75740234e6 * np.array([[1, -1], [-1, 1]]), 0.103501745 * np.array([[1, -1], [-1, 1]]))
    D, M, v0 = np.zeros((4, 4)), np.diag([1.06739444, 1.42537542, 0.04774586, 0.01844781]), [0.0, 0.4535271, 0.7, 0.0]
    D[np.ix_([1, 3], [1, 3])] = 654.01983123 * np.array([[1.0, -1.0], [-1.0, 1.0]]) + np.diag([0.0, 8.04826245])
    made = sb.System.from_matrices(M, K, D, observe=np.eye(4)[3], initial_velocity=v0)
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-inverse @ K, -inverse @ D]])
    ref = sb.reference(made, 2.0, method, t_eval=np.linspace(0.0, 2.0, 6))
    tip = [(scipy.linalg.expm(A * t) @ np.append(np.zeros(4), v0))[3] for t in ref.t]
    assert ref.horizon == 2.0
    assert np.allclose(ref.tip, tip, rtol=0.0, atol=1e-9 * max(tip))
