"""The kernel of exact motion against solutions that share no code with it, and flights against series."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from systems import case_of
from witness import solve

import stiffbeam as sb
from stiffbeam.kernels.library import Follower, Marks
from stiffbeam.references.exact.motion import Motion, Solver
from stiffbeam.references.exact.tangent import Variation

eye = np.eye


def chain(n: int, k: float) -> np.ndarray:
    return k * (2.0 * eye(n) - eye(n, k=1) - eye(n, k=-1))


def by_series(system: sb.System) -> Solver:
    solver = Solver(system)
    solver.free = solver.free.changed(kind=0, up=None, low=None)
    return solver


DRIVEN = {
    "resonance": lambda n, K, w: (0.0 * K, w[1]),
    "near resonance": lambda n, K, w: (0.0 * K, w[1] * (1.0 + 1e-7)),
    "critical": lambda n, K, w: (2.0 * w[0] * eye(n), 0.7 * w[0]),
    "overdamped": lambda n, K, w: (eye(n) * 5.0 * w[1], 0.7 * w[0]),
    "a stiff dashpot": lambda n, K, w: (1e3 * w[-1] * np.outer(eye(n)[2], eye(n)[2]), 0.7 * w[0]),
    "gyroscopic": lambda n, K, w: (w[0] * (eye(n, k=1) - eye(n, k=-1)), 0.31 * w[0]),
}


@pytest.mark.parametrize("name", DRIVEN)
def test_a_driven_system_without_contact_is_that_of_the_matrix_exponential(name):
    n, t = 5, np.linspace(0.0, 6.0, 13)
    K = chain(n, 30.0)
    w = np.sqrt(np.linalg.eigvalsh(K))
    C, frequency = DRIVEN[name](n, K, w)
    vector, q0 = np.arange(1.0, n + 1.0), np.linspace(0.1, -0.2, n)
    loads = [(vector, sb.Harmonic(1.0, frequency))]
    system = sb.System.from_matrices(eye(n), K, C, loads, observe=vector, initial_displacement=q0)
    q, _ = Solver(system).solve(6.0).states(t)
    wanted, _ = solve(case_of(system, 6.0)).states(t)
    assert np.max(np.abs(q - wanted)) < 1e-11 * np.max(np.abs(wanted))


@pytest.mark.parametrize("seed", range(12))
def test_flights_are_series_under_records(seed):
    rng = np.random.default_rng([seed, 56])
    n, rate = int(rng.integers(1, 6)), 10.0 ** rng.uniform(0.5, 2.0)
    K, C = chain(n, 10.0 ** rng.uniform(0.0, 3.0)), np.zeros((n, n))
    if seed % 3:
        C = 0.02 * K + (0.3 * np.diag(rng.uniform(size=n)) if seed % 3 == 2 else 0.0)
    t = np.sort(np.append([0.0, 4.0], rng.uniform(0.0, 4.0, int(4.0 * rate))))
    record = sb.Sampled(t, CubicSpline(t, np.cumsum(rng.normal(size=len(t))))(t), "cubic" if seed % 2 else "linear")
    contact = sb.Contact(
        eye(n)[-1], sb.Stops(-0.05, 0.07, stiffness=10.0 ** rng.uniform(1.0, 5.0), damping=2.0 * (seed % 2))
    )
    loads = [(rng.normal(size=n), record), (eye(n)[0], sb.Harmonic(3.0, 2.0, 0.3)), (eye(n)[0], sb.Constant(1.0))]
    system = sb.System.from_matrices(eye(n), K, C, loads=loads, contacts=[contact])
    flown, series = Solver(system).solve(4.0), by_series(system).solve(4.0)
    early = series.times < 0.4
    assert np.array_equal(flown.sides[: early.sum()], series.sides[early])
    assert np.allclose(flown.times[: early.sum()], series.times[early], rtol=0.0, atol=1e-11)
    at = np.linspace(0.0, 0.4, 7)
    (q, v), (wanted_q, wanted_v) = flown.states(at), series.states(at)
    assert np.max(np.abs(q - wanted_q)) < 1e-10 * np.max(np.abs(wanted_q))
    assert np.max(np.abs(v - wanted_v)) < 1e-10 * np.max(np.abs(wanted_v))


def pressed_often(damping: float) -> tuple[sb.System, Motion]:
    n = 60
    contact = sb.Contact(eye(n)[-1], sb.Stops(-0.1, 0.1, stiffness=2e4, damping=damping))
    system = sb.System.from_matrices(
        eye(n), chain(n, 1e3), loads=[(5.0 * np.ones(n), sb.Harmonic(1.0, 7.0))], contacts=[contact]
    )
    return system, Solver(system).solve(2.0)


@pytest.mark.parametrize("damping", [0.0, 20.0])
def test_peaks_and_impulses_are_those_of_many_samples(damping):
    """A single spring presses in closed form, a damped one as a series."""
    system, motion = pressed_often(damping)
    changed = np.abs(motion.sides[:, 0]) == 1
    starts, ends = motion.times[changed][:4], np.append(motion.times, 2.0)[1:][changed][:4]
    peaks, impulses = motion.press(0, starts, ends)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for a, b, peak, impulse in zip(starts, ends, peaks, impulses, strict=True):
        t = np.concatenate([0.5 * (a + b) + 0.5 * (b - a) * nodes, np.linspace(a, b, 4001)[1:-1]])
        u, v = (x @ system.contacts[0].row for x in motion.states(t))
        force = np.maximum(0.0, 2e4 * (np.abs(u) - 0.1) + damping * v * np.sign(u))
        assert abs(0.5 * (b - a) * weights @ force[:40] - impulse) < 1e-10 * impulse
        assert peak * (1.0 - 1e-5) < np.max(force) < peak * (1.0 + 1e-12)


@pytest.mark.parametrize("damping", [0.0, 20.0])
@pytest.mark.parametrize("side", [0, 1])
def test_the_flow_of_derivatives_over_a_step_is_the_sum_of_their_series(damping, side):
    variation = Variation(pressed_often(damping)[0])
    regime, n = variation.regime([side]), variation.n
    z, t = np.random.default_rng(1).normal(size=(1, 4, 2 * n)), np.zeros(1)
    step = np.array([2.0 / regime.fastest])
    found = regime.later(variation.whole(t, t, z), step)[0, 1:, : 2 * n]
    np.testing.assert_allclose(found, regime.flow(step[0], z[0, 1:]), rtol=0.0, atol=1e-13 * np.max(np.abs(found)))


def test_states_exactly_on_their_stops():
    """Contacts that move by rounding alone at first, along a chain."""
    n = 8
    contacts = [sb.Contact(row, sb.Stops(lower=0.0, stiffness=1e3)) for row in eye(n)]
    system = sb.System.from_matrices(
        eye(n), chain(n, 100.0), loads=[(eye(n)[0], sb.Harmonic(5.0, 3.0))], contacts=contacts
    )
    other = sb.reference(system, 3.0, "cvode-adams", rtol=1e-11)
    q, _ = Solver(system).solve(3.0).states(other.t)
    assert np.max(np.abs(q[:, 0] - other.tip)) < 1e-7 * np.max(np.abs(other.tip))


def test_wrong_arrays_are_errors_of_python():
    system, motion = pressed_often(0.0)
    free = motion.free
    with pytest.raises(TypeError, match="a kernel takes"):
        free.changed(w2=free.w2.astype("f4"))
    with pytest.raises(TypeError, match="a kernel takes"):
        free.changed(rows=np.zeros((1, 2)))
    with pytest.raises(TypeError, match="a kernel takes"):
        Follower(free, np.zeros(2), np.zeros(system.size))
    with pytest.raises(TypeError, match="a kernel takes"):
        Marks(*motion.marks[:3], motion.marks.side.astype("i4")).argument(free)
