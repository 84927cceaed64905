"""The paper's two forms against the beam's own modes, series and closed forms; stops anywhere along the beam."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles import beam_roots, moving_support_series
from scipy.integrate import solve_ivp

import stiffbeam as sb
from stiffbeam.model.modes import modes
from stiffbeam.model.right_hand_side import RightHandSide, over_mass
from stiffbeam.model.semidiscretisation import FORMS, bending_stencil, velocity_curvature_matrices

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
    """Order of errors (len(cells), ...) in the number of cells."""
    return -np.polyfit(np.log(cells), np.log(errors), 1)[0]


def grids(cells, form="displacement", **fields):
    """The beam on each of these grids."""
    return [sb.semidiscretise(sb.BeamProblem(**({"stiffness": 300.0} | fields)), int(M), form) for M in cells]


# ------------------------------------------------------------------ frequencies and stencils


@pytest.mark.parametrize("form", FORMS)
def test_frequencies_converge_to_the_beams_at_second_order(form):
    cells = np.array([20, 40, 80])
    errors = [np.abs(modes(s).omega[:3] - beam_roots(3) ** 2 * np.sqrt(300.0)) for s in grids(cells, form)]
    assert np.all(np.abs(slope(cells, np.array(errors)) - 2.0) < 0.1)


def test_the_displacement_stencils_are_the_papers():
    H = -bending_stencil(6) / np.array([1, 1, 1, 1, 1, 0.5])[:, None]
    inside = [[4, -6, 4, -1, 0, 0], [-1, 4, -6, 4, -1, 0], [0, -1, 4, -6, 4, -1]]
    assert np.array_equal(H, [[-7, 4, -1, 0, 0, 0], *inside, [0, 0, -1, 4, -5, 2], [0, 0, 0, -2, 4, -2]])
    M, k2, d = 5, 300.0, 0.7  # (3.5)
    equations = RightHandSide(*grids([M], viscosity=d, stops=sb.Stops(-0.1, 0.1, stiffness=1e3)))
    row = equations.matrix[2 * (M - 1) + 1]  # v_M''
    assert np.allclose(row[[2 * M - 6, 2 * M - 4, 2 * M - 2]], -k2 * M**4 * np.array([2, -4, 2]))
    assert np.allclose(row[[2 * M - 5, 2 * M - 3, 2 * M - 1]], -d * M**4 * np.array([2, -4, 2]))
    assert np.isclose(equations.pushes[0, -1], 2 * M)  # (2/h) sigma
    assert grids([25], viscosity=d)[0].ode().bandwidths == (5, 4)


def test_the_papers_velocity_curvature_eigenvalues_are_imaginary_and_well_conditioned():
    """The matrix of (3.12) on (k w, s); and its frequencies are those of the system of second order."""
    M = 20
    (system,) = grids([M], "velocity-curvature")
    _, _, L, R = velocity_curvature_matrices(M)
    none = np.zeros((M, M))
    eigenvalues, vectors = np.linalg.eig(np.sqrt(300.0) * np.block([[none, L], [-R, none]]))
    assert np.max(np.abs(eigenvalues.real)) < 1e-9 * np.max(np.abs(eigenvalues))
    assert abs(np.linalg.cond(vectors) - 2.04) < 0.05
    assert np.allclose(np.sort(np.abs(eigenvalues))[::2], modes(system).omega, rtol=1e-9)
    assert np.allclose(
        system.mass @ over_mass(system)[0], system.stiffness, rtol=0.0, atol=1e-14 * np.max(system.stiffness)
    )


# ------------------------------------------------------------------ motions and deflections


@pytest.mark.parametrize("form", FORMS)
def test_the_moving_support_converges_to_its_series_at_second_order_in_space(form):
    """SDIRK's error in time is far below; 60 terms of the series leave 1e-9."""
    t, cells = np.linspace(0.0, 0.08, 9), np.array([20, 40, 80])
    exact = moving_support_series(300.0, E, A, t, 60)
    assert np.max(np.abs(exact - moving_support_series(300.0, E, A, t, 40))) < 1e-8
    tips = [sb.integrate(s, sb.SDIRK(), 1e-5, 0.08, every=1000).tip for s in grids(cells, form, base=VersineBase())]
    assert abs(slope(cells, [np.sqrt(np.mean((tip - exact) ** 2)) for tip in tips]) - 2.0) < 0.1


@pytest.mark.parametrize("form", FORMS)
def test_static_deflections_are_the_textbooks(form):
    """Uniform load p: p/(8 k^2). Point load at x_d, anywhere: P x_d^2 (3 - x_d)/(6 k^2)."""
    cells, uniform = np.array([40, 80, 160]), sb.DistributedLoad(lambda x: 1.0 + 0 * x, sb.Constant(3.0))
    tips = [np.linalg.solve(s.stiffness, s.load(0.0))[-1] for s in grids(cells, form, loads=(uniform,))]
    assert abs(slope(cells, np.abs(np.array(tips) - 3.0 / 2400.0)) - 2.0) < 0.1
    for position in (0.03, 0.25, 0.5, 0.7, 0.73, 0.999, 1.0):
        exact, load = 5.0 * position**2 * (3 - position) / 1800.0, sb.PointLoad(position, sb.Constant(5.0))
        made = grids(cells, form, loads=[load])
        errors = [abs(np.linalg.solve(s.stiffness, s.load(0.0))[-1] - exact) for s in made]
        if position >= 0.25:
            assert errors[-1] < 2e-4 * exact
            assert errors[-1] < max(0.3 * errors[0], 1e-7 * exact)  # exact at nodes in one of the forms
        assert abs(made[0].load(0.0) @ np.arange(1, 41) / 40 - 5.0 * position) < 5.0 * 1e-14
        assert np.count_nonzero(made[0].load(0.0)) <= 2


@pytest.mark.parametrize("viscosity", [0.0, 2.0])
@pytest.mark.parametrize("frequency", [10.0, 100.0])
def test_the_driven_tip_is_what_a_fine_grid_approaches(viscosity, frequency):
    """(-a^2 M + i a C + K) q = p by a dense solve, the load's complex amplitude p from its two phases.

    The beam itself: (EI + i a eta) u'''' = m a^2 u, u(0) = 1, u'(0) = u''(L) = u'''(L) = 0.
    """
    fields = {"viscosity": viscosity, "base": sb.Harmonic(0.2, frequency, 0.4)}
    a, errors, root = frequency, [], (frequency**2 / complex(300.0, frequency * viscosity)) ** 0.25
    exact = (np.cos(root) + np.cosh(root)) / (1.0 + np.cos(root) * np.cosh(root))
    for system in grids(cells := np.array([40, 57, 80]), **fields):
        p = system.load(0.5 * np.pi / a) + 1j * system.load(0.0)  # load(t) = Im(p e^{i a t})
        q = np.linalg.solve(-(a**2) * system.mass + 1j * a * system.damping + system.stiffness, p)
        errors.append(abs(system.channels[system.tip_channel][0] @ q / (0.2 * np.exp(0.4j)) - exact))
    assert errors[-1] < 3e-3 * abs(exact)
    assert abs(slope(cells, errors) - 2.0) < 0.1


@pytest.mark.parametrize("profile", [lambda x: 0.1 + 0.0 * x, lambda x: 0.1 + x**2, lambda x: 0.1 - 3 * x**2 + x**3])
def test_initial_displacements_that_meet_the_clamp_are_accepted(profile):
    problem = sb.BeamProblem(stiffness=1.0, base=sb.Constant(0.1), initial_displacement=profile)
    x = np.array([0.25, 0.5, 0.75, 1.0])
    expected = profile(x) - 0.1 * (1.0 - x**2)  # v = u - phi (1 - x^2)
    assert np.max(np.abs(sb.semidiscretise(problem, 4).q0 - expected)) < 1e-15 * 4
    moving = replace(problem, base=sb.Harmonic(0.1, 2.0, "pi/6"), initial_displacement=None, initial_velocity=profile)
    for form in FORMS:
        expected = profile(x) - 0.2 * np.cos(np.pi / 6) * (1.0 - x**2)
        assert np.max(np.abs(sb.semidiscretise(moving, 4, form).v0 - expected)) < 1e-14


# ------------------------------------------------------------------ stops anywhere along the beam


K2, CELLS, BASE = 300.0, 10, sb.Harmonic(0.2, 10.0)
MIDDLE = sb.Stops(-0.03, 0.03, stiffness=4e4, position=0.6, motion=sb.Harmonic(0.004, 7.0, phase=0.3))
TIP = sb.Stops(-0.1, 0.1, stiffness=2e5)


def beam(*stops: sb.Stops, base=BASE) -> sb.BeamProblem:
    return sb.BeamProblem(stiffness=K2, stops=stops, base=base)


def in_absolute_coordinates(t: np.ndarray) -> np.ndarray:
    """u (k, cells) by DOP853 on textbook differences of u itself: no moving frame, no matrix of the package.

    u_0 = phi, u_{-1} = u_1; at the free end u_{M+1} = 2 u_M - u_{M-1} and the central k^2 u_xxx = -sigma.
    MIDDLE presses on node 6 at 0.6 with -kappa (u - m - g)/h, TIP on the half cell at the end.
    """
    h, n = 1.0 / CELLS, CELLS
    push = lambda u, gap, kappa: -kappa * (max(u - gap, 0.0) - max(-gap - u, 0.0))  # noqa: E731

    def rhs(t, y):
        u = np.concatenate([[y[0], 0.2 * np.sin(10.0 * t)], y[:n], [0.0, 0.0]])  # u_{-1}, u_0, .., u_{M+2}
        u[n + 2] = 2.0 * u[n + 1] - u[n]
        u[n + 3] = 2.0 * u[n + 2] - 2.0 * u[n] + u[n - 1]
        a = -K2 / h**4 * (u[:-4] - 4.0 * u[1:-3] + 6.0 * u[2:-2] - 4.0 * u[3:-1] + u[4:])[-n:]
        a[5] += push(y[5] - 0.004 * np.sin(7.0 * t + 0.3), 0.03, 4e4) / h
        a[-1] += 2.0 * push(y[n - 1], 0.1, 2e5) / h
        return np.concatenate([y[n:], a])

    return solve_ivp(rhs, (0.0, t[-1]), np.zeros(2 * n), "DOP853", t, rtol=1e-10, atol=1e-13).y[:n].T


@pytest.mark.slow
def test_moving_stops_off_the_tip_are_those_of_the_beam_in_absolute_coordinates():
    """To the witness's tolerance, grown by the impacts; a lift or a motion of the wrong sign is off by 1e-2."""
    t = np.linspace(0.0, 0.5, 401)
    exact, u = sb.reference(sb.semidiscretise(beam(MIDDLE, TIP), CELLS), 0.5, t_eval=t), in_absolute_coordinates(t)
    assert all(contact.impacts.count > 3 for contact in exact.contacts)
    for seen, wanted in (
        (exact.tip, u[:, -1]), (exact.contacts[0].position, u[:, 5] - 0.004 * np.sin(7.0 * t + 0.3)),
        (exact.contacts[1].position, u[:, -1]),
    ):  # fmt: skip
        assert np.max(np.abs(seen - wanted)[t < exact.horizon]) < 1e-5


def test_a_stop_at_a_node_is_the_same_contact_as_one_of_matrices():
    still, moves = sb.Stops(-0.05, 0.05, stiffness=4e4), sb.Superposition(terms=[(0.75, sb.Harmonic(0.2, 10.0))])
    tip, made = np.eye(CELLS)[-1], sb.semidiscretise(beam(replace(still, position=0.5), TIP), CELLS)
    contacts = [sb.Contact(np.eye(CELLS)[4], still, moves), sb.Contact(tip, TIP)]
    given = sb.System.from_matrices(
        made.mass, made.stiffness, loads=made.loads, observe=tip, initial_velocity=made.v0, contacts=contacts
    )
    for a, b in zip(made.contacts, contacts, strict=True):
        assert np.array_equal(a.row, b.row)
        assert (a.offset, a.stops) == (b.offset, b.stops)
    runs = [sb.integrate(system, sb.BDF2(), 1e-4, 0.3).tip for system in (made, given)]
    assert np.max(np.abs(runs[0] - runs[1])) < 1e-9  # modes of a factor and of a matrix differ in rounding
    again = replace(made, contacts=given.contacts, loads=given.loads, observe=tip)
    assert (again.problem, again.fingerprint) == (made.problem, made.fingerprint)
    assert np.array_equal(sb.integrate(again, sb.BDF2(), 1e-4, 0.3).tip, runs[0])
