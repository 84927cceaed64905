"""Both forms against the beam's own modes, series solutions and each other."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from oracles import beam_mode, beam_roots, moving_support_series

import stiffbeam as sb
from stiffbeam.model.modes import modes
from stiffbeam.model.semidiscretisation import FORMS, bending_stencil, velocity_curvature_matrices
from stiffbeam.model.state_space import state_space

E, A = 0.01, 40.0  # amplitude and frequency of the support's start from rest


class VersineBase:
    """phi = E (1 - cos a t): phi(0) = phi'(0) = 0, a start that is compatible with the clamp."""

    def value(self, t):
        return E * (1.0 - np.cos(A * np.asarray(t, float)))

    def rate(self, t):
        return E * A * np.sin(A * np.asarray(t, float))

    def acceleration(self, t):
        return E * A**2 * np.cos(A * np.asarray(t, float))


def slope(cells, errors):
    return -np.polyfit(np.log(cells), np.log(errors), 1)[0]


@pytest.mark.parametrize("form", FORMS)
def test_frequencies_converge_to_the_beams_at_second_order(form):
    exact = beam_roots(3) ** 2 * np.sqrt(300.0)
    cells = np.array([20, 40, 80])
    errors = np.array(
        [
            np.abs(modes(sb.semidiscretise(sb.BeamProblem(stiffness=300.0), int(M), form)).omega[:3] - exact)
            for M in cells
        ]
    )
    for j in range(3):
        assert abs(slope(cells, errors[:, j]) - 2.0) < 0.1
    assert abs(beam_roots(1)[0] - 1.8751040687) < 1e-10
    # The paper prints 3.5148 and 22.3480.
    assert np.allclose(beam_roots(2) ** 2, [3.5160, 22.0345], atol=5e-5)


def test_the_displacement_stencils_are_the_papers():
    H = -bending_stencil(6) / np.array([1, 1, 1, 1, 1, 0.5])[:, None]
    expected = [
        [-7, 4, -1, 0, 0, 0],
        [4, -6, 4, -1, 0, 0],
        [-1, 4, -6, 4, -1, 0],
        [0, -1, 4, -6, 4, -1],
        [0, 0, -1, 4, -5, 2],
        [0, 0, 0, -2, 4, -2],
    ]
    assert np.array_equal(H, expected)


def test_the_first_order_matrix_is_that_of_3_5():
    M, k2, d = 5, 300.0, 0.7
    problem = sb.BeamProblem(stiffness=k2, viscosity=d, stops=sb.Stops(-0.1, 0.1, stiffness=1e3))
    first_order = state_space(sb.semidiscretise(problem, M))
    row = first_order.matrix[2 * (M - 1) + 1]  # v_M''
    assert np.allclose(row[[2 * M - 6, 2 * M - 4, 2 * M - 2]], -k2 * M**4 * np.array([2, -4, 2]))
    assert np.allclose(row[[2 * M - 5, 2 * M - 3, 2 * M - 1]], -d * M**4 * np.array([2, -4, 2]))
    assert np.isclose(first_order.contacts[0].column[-1], 2 * M)  # (2/h) sigma
    assert first_order.bandwidths == (5, 4)


def test_the_weights_of_velocity_curvature_symmetrise_it_exactly():
    """P R = L^T Q in rational arithmetic: entries are whole multiples of 1/12 after scaling by h."""
    M = 7
    P, Q, L, R = velocity_curvature_matrices(M)

    def rational(matrix, scale):
        return [[Fraction(round(12 * x * scale), 12) for x in row] for row in matrix]

    p, q = rational(P, M), rational(Q, M)
    left, right = rational(R, 1 / M**2), rational(L, 1 / M**2)

    def product(a, b):
        return [[sum(a[i][k] * b[k][j] for k in range(M)) for j in range(M)] for i in range(M)]

    transposed = [[left_row[i] for left_row in right] for i in range(M)]
    assert product(p, left) == product(transposed, q)
    assert np.min(np.linalg.eigvalsh(P)) > 0
    assert np.min(np.linalg.eigvalsh(Q)) > 0


def test_the_papers_velocity_curvature_eigenvalues_are_imaginary_and_well_conditioned():
    M = 20
    system = sb.semidiscretise(sb.BeamProblem(stiffness=300.0), M, "velocity-curvature")
    A = state_space(system).matrix[: 2 * M, : 2 * M]
    scale = np.ones(2 * M)
    scale[::2] = np.sqrt(300.0)  # w times k
    scaled = scale[:, None] * A / scale
    eigenvalues, vectors = np.linalg.eig(scaled)
    assert np.max(np.abs(eigenvalues.real)) < 1e-9 * np.max(np.abs(eigenvalues))
    assert abs(np.linalg.cond(vectors) - 2.04) < 0.05
    omega = np.sort(np.abs(eigenvalues))[::2]
    assert np.allclose(omega, modes(system).omega, rtol=1e-9)


@pytest.mark.parametrize("form", FORMS)
def test_the_moving_support_converges_to_its_series_at_second_order_in_space(form):
    t = np.linspace(0.0, 0.08, 9)
    exact = moving_support_series(300.0, E, A, t, 60)
    # The series itself: its tail falls like 1/l^4, 1e-9 of the motion after 60 terms.
    assert np.max(np.abs(exact - moving_support_series(300.0, E, A, t, 40))) < 1e-8
    cells, errors = np.array([20, 40, 80]), []
    for M in cells:
        system = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, base=VersineBase()), int(M), form)
        # Time error far below: SDIRK of order 3 with w_1 dt = 6e-4.
        run = sb.integrate(system, sb.SDIRK(), 1e-5, 0.08, every=1000)
        errors.append(np.sqrt(np.mean((run.tip - exact) ** 2)))
    assert abs(slope(cells, errors) - 2.0) < 0.1


@pytest.mark.parametrize("form", FORMS)
def test_section_5_1_without_contact(form):
    """f = (k^2 l^4 - 4) X_1 sin 2t, u0 = 0, v0 = 2 X_1: u = X_1 sin 2t; k^2 = 8000, dt = 0.001, h = 0.04."""
    root = beam_roots(1)[0]
    X = lambda x: beam_mode(root, np.asarray(x))  # noqa: E731
    gain = 8000.0 * root**4 - 4.0
    problem = sb.BeamProblem(
        stiffness=8000.0,
        loads=(sb.DistributedLoad(lambda x: gain * X(x), sb.Harmonic(1.0, 2.0)),),
        initial_velocity=lambda x: 2.0 * X(x),
    )
    tip = X(np.array([1.0]))[0]
    cells, spatial = np.array([25, 50]), []
    for M in cells:
        system = sb.semidiscretise(problem, int(M), form)
        ref = sb.reference(system, 1.0, t_eval=np.linspace(0, 1, 101))
        spatial.append(np.max(np.abs(ref.tip - tip * np.sin(2 * ref.t))))
        for scheme in (sb.BDF2(), sb.HHT(-0.1), sb.SDIRK(1.0), sb.SDIRK(0.4359)):
            run = sb.integrate(system, scheme, 1e-3, 1.0, every=10)
            # In space h^2, in time the slow forced motion is followed to (w dt)^2 = 4e-6 and the free
            # oscillation excited by the spatial error is at most as large again.
            assert np.max(np.abs(run.tip - tip * np.sin(2 * run.t))) < 2.5 * spatial[-1] + 1e-5 * abs(tip)
    assert abs(slope(cells, spatial) - 2.0) < 0.2
    assert spatial[0] < 0.01 * abs(tip)


@pytest.mark.parametrize("form", FORMS)
def test_a_distributed_load_bends_the_beam_like_the_textbook(form):
    """Static tip deflection under a uniform load p: p/(8 k^2)."""
    problem = sb.BeamProblem(stiffness=300.0, loads=(sb.DistributedLoad(lambda x: 1.0 + 0 * x, sb.Constant(3.0)),))
    cells, errors = np.array([40, 80, 160]), []
    for M in cells:
        system = sb.semidiscretise(problem, int(M), form)
        tip = np.linalg.solve(system.stiffness, system.load(0.0))[-1]
        errors.append(abs(tip - 3.0 / (8 * 300.0)))
    assert abs(slope(cells, errors) - 2.0) < 0.1


@pytest.mark.parametrize("form", FORMS)
def test_a_point_load_is_a_dirac_load(form):
    """Static tip deflection under P at x_d: P x_d^2 (3 - x_d)/(6 k^2), at nodes and between them."""
    for position in (0.25, 0.7, 0.73, 1.0):
        exact = 5.0 * position**2 * (3 - position) / (6 * 300.0)
        errors = []
        for M in (40, 80, 160):
            problem = sb.BeamProblem(stiffness=300.0, loads=(sb.PointLoad(position, sb.Constant(5.0)),))
            system = sb.semidiscretise(problem, M, form)
            errors.append(abs(np.linalg.solve(system.stiffness, system.load(0.0))[-1] - exact))
        assert errors[-1] < 2e-4 * exact
        assert errors[-1] < max(0.3 * errors[0], 1e-7 * exact)  # exact at nodes in one of the forms


@pytest.mark.parametrize("form", FORMS)
def test_at_rest_on_a_displaced_clamp_the_beam_stays_straight(form):
    problem = sb.BeamProblem(stiffness=300.0, base=sb.Constant(0.3))
    run = sb.integrate(sb.semidiscretise(problem, 10, form), sb.HHT(), 1e-3, 0.2, every=50)
    assert np.allclose(run.displacement(np.linspace(0, 1, 11)), 0.3, atol=1e-9)


def test_the_forms_agree_with_viscosity_off_and_velocity_curvature_refuses_it(table10):
    with pytest.raises(sb.InputError, match="eliminates the displacement"):
        sb.semidiscretise(sb.BeamProblem(stiffness=300.0, viscosity=1.0), 10, "velocity-curvature")
    tips = [sb.integrate(sb.semidiscretise(table10, 100, form), sb.SDIRK(), 2e-5, 0.04, every=20).tip for form in FORMS]
    # Before the first contact, and h^1.3 only: "at rest" does not meet the moving clamp.
    assert np.max(np.abs(tips[0] - tips[1])) < 0.02 * np.max(np.abs(tips[0]))


def test_carried_tip_and_curvature_stay_consistent(table10):
    """v_M - h^2 [(M/3) w_0 + (M-1+M/6) w_1 + sum_{j>=2} (M-j) w_j] is conserved on (w, s, v_M)."""
    M = 12
    system = state_space(sb.semidiscretise(table10, M, "velocity-curvature"))
    weights = np.array([M / 3, M - 1 + M / 6, *(M - j for j in range(2, M))]) / M**2
    functional = np.zeros(2 * M + 1)
    functional[-1], functional[0 : 2 * M : 2] = 1.0, -weights
    assert np.max(np.abs(functional @ system.matrix)) < 1e-9
    assert abs(functional @ system.y0) < 1e-12


def test_bad_grids_and_forms_are_refused(table10):
    with pytest.raises(sb.InputError, match="cells"):
        sb.semidiscretise(table10, 3)
    with pytest.raises(sb.InputError, match="did you mean displacement"):
        sb.semidiscretise(table10, 10, "displacment")


def test_from_matrices_refuses_what_is_no_model():
    good = np.eye(2)
    for arguments, word in (
        ({"mass": -good}, "positive definite"),
        ({"mass": [[1.0, 0.5], [0.0, 1.0]]}, "symmetric"),
        ({"stiffness": np.eye(3)}, "shape"),
        ({"stiffness": -good}, "semidefinite"),
        ({"damping": np.eye(3)}, "shape"),
        ({"loads": [([1.0], sb.Constant(1.0))]}, "2 finite numbers"),
        ({"contacts": [sb.Contact([1.0, 0.0, 0.0], sb.Stops(-1, 1, stiffness=1.0))]}, "contact.row"),
        ({"observe": None}, "observe=row"),
    ):
        with pytest.raises(sb.InputError, match=word):
            sb.System.from_matrices(**({"mass": good, "stiffness": good, "observe": [1.0, 0.0]} | arguments))


def test_the_fingerprint_sees_every_parameter(table10):
    import dataclasses

    system = sb.semidiscretise(table10, 10)
    assert system.fingerprint == sb.semidiscretise(table10, 10).fingerprint
    for change in (
        {"stiffness": 300.0000001},
        {"viscosity": 1e-9},
        {"stops": sb.Stops(-0.1, 0.1, stiffness=5.0000001e6)},
        {"base": sb.Harmonic(0.2, 10.0, 1e-12)},
        {"initial_velocity": lambda x: 1e-12 * x**2},
    ):
        assert sb.semidiscretise(dataclasses.replace(table10, **change), 10).fingerprint != system.fingerprint
    assert sb.semidiscretise(table10, 11).fingerprint != system.fingerprint
