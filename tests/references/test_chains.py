"""Where eigenvalues meet each other or a drive: critical damping, free bodies, resonance, against closed forms,
mpmath's and SciPy's matrix exponentials, which know of no Jordan chains."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import scipy.linalg
from systems import system_of
from vibro_impact import Case, Contact
from vibro_march import solve

import stiffbeam as sb
from stiffbeam.piecewise.spectrum import differences, groups, largest


@pytest.mark.parametrize(
    "nodes",
    [
        [-1.0, -1.0],
        [0.0, 0.0, 0.0],
        [1j, 1j * (1 + 1e-9)],
        [-30.0, -30.0, 0.0, 0.0],
        [2j, 2.1j, 0.0],
        [0.0, -1e-9, 0.0, 3j],
    ],
)
@pytest.mark.parametrize("tau", [1e-6, 0.3, 3.0, 100.0])
def test_divided_differences_of_the_exponential_and_their_bounds(nodes, tau):
    """The first row of exp of the bidiagonal matrix of the nodes, in mpmath, to the condition eps |mu tau| of exp."""
    own, found, bounds = np.array(nodes, complex), np.empty(len(nodes), complex), np.empty(len(nodes))
    differences(own, tau, found)
    with mpmath.workdps(60 + int(abs(own[0].real) * tau)):
        Z = mpmath.diag([mpmath.mpc(x) * tau for x in nodes])
        for i in range(len(nodes) - 1):
            Z[i, i + 1] = tau
        true = np.array([complex(x) for x in mpmath.expm(Z)[0, :]])
    rest = 0.5 * tau
    largest(own, len(own), rest, tau - rest, bounds)
    assert np.all(np.abs(true) <= bounds * (1.0 + 1e-12))
    scale = np.maximum(np.abs(true), 1e-300)
    spread = max(abs(x - y) for x in nodes for y in nodes) * tau
    assert np.max(np.abs(found - true) / scale) < 1e-15 * (100.0 + 10.0 * spread + abs(own[0]) * tau)


def test_the_groups_of_a_spectrum_are_all_of_it():
    """sum V L = 1 and sum V T L = A, whichever oscillations are together because they are slower than the span."""
    rng, together = np.random.default_rng(2), 0
    for _ in range(200):
        n = int(rng.integers(1, 6))
        omega, shape = np.sort(rng.uniform(1.0, 3.0, n)), rng.normal(size=(n, rng.integers(1, n + 1)))
        damping, span = 10.0 ** rng.uniform(-4.0, 1.0) * shape @ shape.T, 10.0 ** rng.uniform(-1.0, 1.0)
        s, found = groups(omega, damping, span)
        A = np.block([[np.zeros((n, n)), np.diag(s)], [-np.diag(omega**2 / s), -damping]])
        for power, true in ((0, np.eye(2 * n)), (1, A)):
            parts = [g.V @ np.linalg.matrix_power(g.T, power) @ g.L for g in found]
            total = sum(2.0 * x.real if g.paired else x.real for x, g in zip(parts, found, strict=True))
            condition = max(np.linalg.norm(g.V) * np.linalg.norm(g.L) for g in found)
            assert np.max(np.abs(total - true)) < 1e-13 * condition * max(1.0, float(np.max(np.abs(A))))
        together += any(g.paired and len(g.T) > 1 for g in found)
    assert together > 5


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


def test_two_oscillations_slower_than_the_span():
    """One group, apart from its conjugates: |lambda| t_end is 0.6 and 0.8, |lambda - lambda*| t_end more than 1."""
    K, D = np.array([[2.0, -0.5], [-0.5, 2.0]]), np.diag([0.1, 0.0])
    tip = scipy.linalg.expm(np.block([[np.zeros((2, 2)), np.eye(2)], [-K, -D]]) * 0.5)[0, 2]
    ref = sb.reference(system(np.eye(2), D, K, v0=[1.0, 0.0]), 0.5, t_eval=[0.0, 0.5])
    assert ref.horizon == 0.5
    assert np.allclose(ref.tip, [0.0, tip], rtol=0.0, atol=1e-15)


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


@pytest.mark.slow
def test_critical_damping_under_a_record():
    t = np.linspace(0.0, 6.0, 25)
    far = [([1.0], sb.Stops(-0.5, 0.5, stiffness=80.0))]
    made = one(2.0, 1.0, sb.Sampled(t, 5.0 * np.sin(3.0 * t), kind="cubic"), 0.0, 0.0, far)
    ref = sb.reference(made, 6.0)
    assert ref.horizon == 6.0
    assert ref.impacts.count > 3
    other = sb.reference(made, 6.0, "dop853", rtol=1e-12, t_eval=ref.t)
    assert np.max(np.abs(ref.tip - other.tip)) < 1e-8 * np.max(np.abs(ref.tip))
