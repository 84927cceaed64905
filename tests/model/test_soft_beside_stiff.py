"""What is soft beside what is stiff: damping that couples modes is never dropped, wrong signs are never overlooked."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from scipy.integrate import solve_ivp

import stiffbeam as sb
from stiffbeam.model.modes import modes


def dragged(c: float) -> sb.System:
    """Mass 1 is dragged along sin t by a dashpot c; mass 2 hangs on mass 1 by a dashpot 0.9."""
    return sb.System.from_matrices(
        np.eye(2),
        np.diag([1.0, 4.0]),
        [[c + 0.9, -0.9], [-0.9, 0.9]],
        loads=[([1.0, 0.0], sb.Harmonic(c, 1.0))],
        observe=[0.0, 1.0],
    )


@pytest.mark.parametrize("c", [1e8, 1e9, 1e11])
@pytest.mark.parametrize("scheme", [sb.Trapezoidal(), sb.BDF2(), sb.HHT(), sb.ExponentialFlow()], ids=str)
def test_a_mass_that_only_a_weak_dashpot_moves_moves(c, scheme):
    """q2'' + 0.9 q2' + 4 q2 = 0.9 sin t to 1/c of it."""
    run = sb.integrate(dragged(c), scheme, 1e-3, 10.0)
    found = solve_ivp(lambda t, y: [y[1], 0.9 * (np.sin(t) - y[1]) - 4.0 * y[0]], (0.0, 10.0), [0.0, 0.0], "DOP853",
                      t_eval=run.t[::500], rtol=1e-11, atol=1e-13)  # fmt: skip
    assert np.max(np.abs(run.tip[::500] - found.y[0])) < 1e-5


def test_members_are_perturbed_in_proportion_to_what_a_dashpot_lets_move():
    """The load c sin t moves mass 1 by 1, not by c."""
    for c in (1e2, 1e9):
        members = sb.perturbed_members(dragged(c), 20, 1e-3)
        q, v = (np.array(members.fields[name]) for name in ("q0", "v0"))
        assert 1e-4 < np.max(np.abs(q)) < 1e-2
        assert 1e-4 < np.max(np.abs(v)) < 1e-2


def test_two_viscous_beams_joined_by_a_dashpot():
    """The second moves through the dashpot only, of 1e-10 of the largest entry of the damping."""
    beam = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, stops=sb.Stops(-10.0, 10.0, stiffness=1e5)), 60)
    n = beam.size
    K, joint = scipy.linalg.block_diag(beam.stiffness, beam.stiffness), np.zeros(2 * n)
    joint[n - 1], joint[2 * n - 1] = 1.0, -1.0
    damping = 4e-3 * K + 0.05 * np.outer(joint, joint)
    first, second = np.eye(2 * n)[[n - 1, 2 * n - 1]]
    mass = scipy.linalg.block_diag(beam.mass, beam.mass)
    system = sb.System.from_matrices(mass, K, damping, loads=[(first, sb.Constant(50.0))], observe=second)
    run = sb.integrate(system, sb.Trapezoidal(), 1e-4, 0.2)
    inverse, A = np.linalg.inv(mass), np.zeros((4 * n + 1, 4 * n + 1))
    A[: 2 * n, 2 * n : -1] = np.eye(2 * n)
    A[2 * n : -1] = np.hstack([-inverse @ K, -inverse @ damping, inverse @ first[:, None] * 50.0])
    tip = scipy.linalg.expm(0.2 * A)[2 * n - 1, -1]
    assert abs(run.tip[-1] - tip) < 1e-3 * abs(tip)
    assert abs(tip) > 1e-4


def test_damping_that_couples_none_is_found_to():
    """alpha M + beta K of beams, of random matrices and of chains whose springs differ by ten decades."""
    rng = np.random.default_rng(4)
    for form in ("displacement", "hermite"):
        for cells in (5, 60):
            problem = sb.BeamProblem(
                stiffness=300.0, stops=sb.Stops(-0.1, 0.1, stiffness=5e6), viscosity=1e-3, mass_damping=0.5
            )
            assert modes(sb.semidiscretise(problem, cells, form)) is not None
    for alpha, beta in ((0.3, 0.0), (0.0, 1e-3), (0.3, 1e-3), (1e3, 1e-6)):
        n = int(rng.integers(3, 40))
        X, Y, springs = rng.normal(size=(n, n)), rng.normal(size=(n, n)), 10.0 ** rng.uniform(-5.0, 5.0, n + 1)
        full = X @ X.T + 0.01 * np.eye(n), Y @ Y.T
        chain = np.diag(springs[:-1] + springs[1:]) - np.diag(springs[1:-1], 1) - np.diag(springs[1:-1], -1)
        for M, K in (full, (np.diag(10.0 ** rng.uniform(-3.0, 3.0, n)), chain)):
            assert modes(sb.System.from_matrices(M, K, alpha * M + beta * K, observe=np.eye(n)[0])) is not None


def test_a_free_body_with_internal_damping_keeps_its_momentum():
    """The damping of its motion as a whole is zero, not the rounding of zero."""
    n = 30
    K = 1e6 * (np.diag(np.r_[1.0, 2.0 * np.ones(n - 2), 1.0]) - np.eye(n, k=1) - np.eye(n, k=-1))
    found = modes(sb.System.from_matrices(np.eye(n), K, 0.3 * K, observe=np.eye(n)[0]))
    assert found is not None
    assert found.omega[0] == found.damping[0] == 0.0


@pytest.mark.parametrize("c", [1e3, 1e6, 1e9])
def test_a_creep_beside_a_strong_dashpot_has_its_own_digits(c):
    """x'' + (c + 0.9) x' + x = 0.9 y', y'' + 0.9 y' + 4 y = 0.9 x': slowest like exp(-t/c)."""
    found = sb.modes(dragged(c))
    assert found.coupled
    assert found.omega[0] == pytest.approx(1.0 / c, rel=2.0 / c)
    assert found.damping_ratio[0] == 1.0


@pytest.mark.slow
def test_modal_damping_reaches_the_slowest_mode():
    """C phi_j = 2 zeta omega_j M phi_j where omega_j^2 is 1e-13 of the largest, and where it is 1e-14 of it."""
    beam = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(-0.1, 0.1, stiffness=5e6), modal_damping=0.02)
    system = sb.semidiscretise(beam, 300, "hermite")
    basis = modes(system)
    assert basis is not None
    assert np.allclose(basis.damping[:5], 0.04 * basis.omega[:5], rtol=1e-5)
    assert np.allclose(sb.modal_damping(np.eye(2), np.diag([1e14, 1.0]), 0.02), np.diag([4e5, 0.04]), rtol=1e-12)


def test_a_soft_spring_beside_a_stiff_one_holds():
    load = [([1.0, 1.0], sb.Constant(1.0))]
    held = sb.System.from_matrices(np.eye(2), np.diag([1e16, 1.0]), loads=load, observe=[0.0, 1.0])
    assert np.allclose(sb.static_equilibrium(held), [1e-16, 1.0], rtol=1e-14, atol=0.0)
    free = sb.System.from_matrices(
        np.eye(3), [[1e16, 0.0, 0.0], [0.0, 1.0, -1.0], [0.0, -1.0, 1.0]], observe=[0.0, 0.0, 1.0]
    )
    with pytest.raises(sb.InputError, match="a rigid motion"):
        sb.static_equilibrium(free)
