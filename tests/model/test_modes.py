"""Modes and scales: all digits of every frequency, what is soft beside what is stiff."""

from __future__ import annotations

from dataclasses import replace

import mpmath
import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.measures.errors import longest_delay
from stiffbeam.model.modes import exact_product, modes, undamped_modes
from stiffbeam.model.scales import scales

EPS = float(np.finfo(float).eps)
G = 9.81
PROBLEM = sb.BeamProblem(stiffness=300.0)
FREE = replace(PROBLEM, supports="free-free")


def system_of(mass, stiffness, damping=None, loads=()):
    return sb.System.from_matrices(mass, stiffness, damping, loads, observe=np.eye(len(mass))[0])


# ------------------------------------------------------------------ frequencies many powers of ten apart


def true_squares(mass, stiffness):
    """The eigenvalues of L^-1 K L^-T, M = L L^T, in 80 digits."""
    with mpmath.workdps(80):
        K = mpmath.matrix(stiffness.tolist())
        inverse = mpmath.inverse(mpmath.cholesky(mpmath.matrix(mass.tolist())))
        return sorted(mpmath.eigsy(inverse * K * inverse.T, eigvals_only=True))


def chain(rng, n, decades):
    B = np.eye(n) - np.eye(n, k=-1)
    mass, springs = 10.0 ** rng.uniform(-decades / 2, decades / 2, (2, n))
    return np.diag(mass), B.T @ np.diag(springs) @ B


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.fast(12)
def test_every_frequency_has_all_its_digits(seed):
    """Unless it is below the rounding of the entries of K, and then it is zero."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 9))
    mass, stiffness = chain(rng, n, 12.0)
    if seed % 3 == 0:
        x = rng.normal(size=(n, n))
        mass = mass + 1e-3 * np.min(np.diag(mass)) * x @ x.T
    found, true = modes(system_of(mass, stiffness)), true_squares(mass, stiffness)
    for omega, square in zip(found.omega, true, strict=True):
        if omega == 0.0:
            assert abs(square) < 1e-13 * true[-1]
        else:
            assert abs(omega / mpmath.sqrt(square) - 1) < 16 * n * EPS
    assert np.count_nonzero(found.omega) >= 1
    assert np.max(np.abs(found.shapes.T @ mass @ found.shapes - np.eye(n))) < 1e-12


@pytest.mark.parametrize("form", ["displacement", "hermite"])
def test_the_slow_frequencies_of_a_beam_have_the_digits_of_its_factor(form):
    """A processor's own order of sums shows in none of them: 16 roundings of a copy of the problem are more."""
    system = sb.semidiscretise(PROBLEM, 25, form)
    of_factor = system.stiffness_factor.T @ system.stiffness_factor
    assert np.max(np.abs(of_factor - system.stiffness)) < 1e-14 * np.max(system.stiffness)
    with mpmath.workdps(40):
        factor = mpmath.matrix(system.stiffness_factor.tolist())
        true = true_squares(system.mass, factor.T * factor)
    found = modes(system).omega
    assert max(abs(omega / mpmath.sqrt(square) - 1) for omega, square in zip(found, true, strict=True)) < 8 * EPS


@pytest.mark.parametrize("cells", [49, 50, 75])  # more than 100 unknowns: slow modes alone are refined
def test_beams_that_nothing_holds_and_that_a_heavy_mass_ends(cells):
    assert np.array_equal(modes(sb.semidiscretise(FREE, cells, "hermite")).omega[:2], np.zeros(2))
    heavy = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, tip_mass=1e16), cells, "hermite")
    matrices = replace(heavy, origin=None, observe=np.eye(heavy.size)[-2])
    # A massless cantilever under its tip: 3 EI/L^3 over the mass, whose rounding in the matrix is 1e-16.
    assert modes(matrices).omega[0] ** 2 == pytest.approx(900.0 / 1e16, rel=1e-10)


@pytest.mark.parametrize("n", [1, 2, 5, 30])
def test_a_free_chain_has_one_rigid_body_motion(n):
    """Whose damping is zero too, and not the rounding of zero."""
    rng = np.random.default_rng(n)
    B = np.eye(n)[1:] - np.eye(n)[:-1]
    stiffness = B.T @ np.diag(10.0 ** rng.uniform(-3, 3, n - 1)) @ B
    found = modes(system_of(np.diag(rng.uniform(0.5, 2.0, n)), stiffness, 0.3 * stiffness))
    assert np.count_nonzero(found.omega == 0.0) == 1
    assert found.omega[0] == found.damping[0] == 0.0


def test_a_product_is_rounded_once():
    rng = np.random.default_rng(3)
    A, B = rng.normal(size=(4, 60)), rng.normal(size=(60, 3))
    A, B = np.hstack([A, -A]), np.vstack([B, B * (1.0 + 1e-12 * rng.normal(size=B.shape))])  # cancels to 1e-12
    found = exact_product(A, B)
    with mpmath.workdps(60):
        true = mpmath.matrix(A.tolist()) * mpmath.matrix(B.tolist())
        assert all(found[i, j] == float(true[i, j]) for i, j in np.ndindex(4, 3))
    huge = np.diag([1e300, 1e290])
    assert np.array_equal(exact_product(np.eye(2), huge, np.eye(2)), huge)


# ------------------------------------------------------------------ what is soft beside what is stiff


def dragged(c: float) -> sb.System:
    """Mass 1 is dragged along sin t by a dashpot c; mass 2 hangs on mass 1 by a dashpot 0.9."""
    damping, load = [[c + 0.9, -0.9], [-0.9, 0.9]], ([1.0, 0.0], sb.Harmonic(c, 1.0))
    return sb.System.from_matrices(np.eye(2), np.diag([1.0, 4.0]), damping, [load], observe=[0.0, 1.0])


@pytest.mark.parametrize("c", [1e2, 1e3, 1e6, 1e9])
def test_a_creep_beside_a_strong_dashpot_has_its_own_digits(c):
    """Slowest like exp(-t/c); and the load c sin t moves mass 1 by 1, not by c: members are perturbed by as much."""
    found, members = sb.modes(dragged(c)), sb.perturbed_members(dragged(c), 20, 1e-3)
    assert found.coupled
    assert found.omega[0] == pytest.approx(1.0 / c, rel=2.0 / c)
    assert found.damping_ratio[0] == 1.0
    for name in ("q0", "v0"):
        assert 1e-4 < np.max([np.abs(getattr(member, name)) for member in members]) < 1e-2


def test_damping_that_couples_none_is_found_to():
    """alpha M + beta K and modal damping of beams, of random matrices, of chains over ten decades and of a plate; of a
    free beam, whose two fastest modes are one at either end."""
    rng = np.random.default_rng(4)
    assert not modes(sb.semidiscretise(replace(FREE, modal_damping=0.02), 60, "hermite")).coupled
    for form in ("displacement", "hermite"):
        for cells in (5, 60):
            assert not modes(sb.semidiscretise(replace(PROBLEM, viscosity=1e-3, mass_damping=0.5), cells, form)).coupled
    for alpha, beta in ((0.3, 0.0), (0.0, 1e-3), (0.3, 1e-3), (1e3, 1e-6)):
        n = int(rng.integers(3, 40))
        X, Y, springs = rng.normal(size=(n, n)), rng.normal(size=(n, n)), 10.0 ** rng.uniform(-5.0, 5.0, n + 1)
        soft = np.diag(springs[:-1] + springs[1:]) - np.diag(springs[1:-1], 1) - np.diag(springs[1:-1], -1)
        for M, K in (
            (X @ X.T + 0.01 * np.eye(n), Y @ Y.T), (np.diag(10.0 ** rng.uniform(-3.0, 3.0, n)), soft),
        ):  # fmt: skip
            assert not modes(system_of(M, K, alpha * M + beta * K)).coupled
            assert not modes(system_of(M, K, sb.modal_damping(M, K, 0.02))).coupled
    # 20 x 15 unknowns: the first fit of the two factors was off by 31 eps, and the modes counted as coupled.
    along, across = (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1) for n in (20, 15))
    laplace = np.kron(np.eye(15), along) + np.kron(across, np.eye(20))
    M, K = 0.02 * np.eye(300), 4e4 * laplace @ laplace
    assert not modes(system_of(M, K, 1e-5 * K + 0.5 * M)).coupled
    off = np.diag(1e-9 * np.eye(300)[0]) * (1e-5 * K + 0.5 * M)
    assert modes(system_of(M, K, 1e-5 * K + 0.5 * M + off)).coupled


@pytest.mark.slow
def test_modal_damping_reaches_the_slowest_mode():
    """C phi_j = 2 zeta omega_j M phi_j where omega_j^2 is 1e-13 of the largest, and where it is 1e-14 of it."""
    basis = modes(sb.semidiscretise(replace(PROBLEM, modal_damping=0.02), 300, "hermite"))
    assert np.allclose(basis.damping[:5], 0.04 * basis.omega[:5], rtol=1e-5)
    assert np.allclose(sb.modal_damping(np.eye(2), np.diag([1e14, 1.0]), 0.02), np.diag([4e5, 0.04]), rtol=1e-12)


# ------------------------------------------------------------------ time scales and speeds of motions


def ball(stiffness: float, floor: sb.Stops) -> sb.System:
    """A ball that falls on a floor from a height of 1."""
    return one_mass(stiffness, floor, load=sb.Constant(-G), q=1.0)


FLOORS = {
    "rigid": sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.5), "stiff": sb.Stops(lower=0.0, stiffness=1e6),
    "hertz": sb.Stops(lower=0.0, stiffness=1e6, exponent=1.5, dissipation=0.1),
}  # fmt: skip


@pytest.mark.parametrize("floor", FLOORS.values(), ids=FLOORS)
def test_a_stiffness_that_does_not_show_changes_no_scale(floor):
    """The motions of K = 0 and K = 1e-9 are the same to 1e-9 of the height; members differ by 2 of it at most."""
    free, held = (ball(stiffness, floor) for stiffness in (0.0, 1e-9))
    for t_end in (np.inf, 5.0):
        assert scales(free, t_end).period == pytest.approx(scales(held, t_end).period, rel=1e-12)
    assert longest_delay(free, 5.0) == pytest.approx(longest_delay(held, 5.0), rel=1e-12)
    made = [sb.perturbed_members(system, 20, 1e-3) for system in (free, held)]
    (q0, other), (v0, rate) = (np.array([[getattr(x, name) for x in each] for each in made]) for name in ("q0", "v0"))
    assert np.allclose(q0, other, rtol=1e-9)
    assert np.allclose(v0, rate, rtol=1e-9)
    assert 1e-4 < np.max(np.abs(q0 - 1.0)) <= 2e-3
    assert 1e-3 < np.max(np.abs(v0)) <= 1e-3 * np.sqrt(2.0 * G) * 1.01


def test_scales_of_free_bodies_bodies_between_stops_and_beams(table10):
    """Without forces a body crosses the gap of 2 with speed 3; a free one has the run's length alone. A table of
    amplitude 0.1 and frequency 20 throws with a speed of 2, a spring compressed by 0.1 with sqrt(kappa/m) of it."""
    for time in (1.0, 1e-6):
        body = one_mass(0.0, sb.Stops(-1.0, 1.0, stiffness=np.inf, restitution=1.0), v=3.0 * time)
        assert scales(body, 100.0 / time).rates == pytest.approx(3.0 * time)
        assert scales(one_mass(0.0, v=3.0 * time), 7.0 / time).period == pytest.approx(7.0 / time)
    beam = sb.semidiscretise(table10, 25)
    assert np.array_equal(scales(beam, 1.0).rates, undamped_modes(beam).omega)
    table = one_mass(0.0, FLOORS["rigid"], load=sb.Constant(-G), offset=sb.Harmonic(0.1, 20.0))
    assert scales(table, 10.0).speed == pytest.approx(2.0)
    assert scales(table, 10.0).rates == pytest.approx(G / 2.0)
    pressed = one_mass(0.0, sb.Stops(upper=0.0, stiffness=400.0), q=0.1)
    assert scales(pressed, 10.0).speed == pytest.approx(20.0 * 0.1)


def test_a_push_that_a_stop_ends_has_the_speed_with_which_it_arrives():
    """sqrt(2 f (d + depth) - 2 U): f = 3 over a gap of 2, and as deep as the stop holds it."""
    pushed = one_mass(0.0, sb.Stops(upper=2.0, stiffness=100.0), load=sb.Constant(3.0))
    assert scales(pushed, 100.0).speed == pytest.approx(np.sqrt(2.0 * (3.0 * 2.03 - 0.5 * 100.0 * 0.03**2)))
