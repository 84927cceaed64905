"""The paper's two forms against the beam's own modes, series and closed forms; stops anywhere along the beam."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from oracles import beam_mode, beam_roots, moving_support_series
from scipy.integrate import solve_ivp

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.files.cases import load_cases
from stiffbeam.measures.errors import observed_order
from stiffbeam.measures.frequencies import steady_state
from stiffbeam.model.beam import mode, roots, tip_response
from stiffbeam.model.modes import modes
from stiffbeam.model.semidiscretisation import FORMS, bending_stencil, velocity_curvature_matrices
from stiffbeam.model.state_space import state_space
from stiffbeam.model.time_functions import Drive

# ------------------------------------------------------------------ frequencies, stencils, series


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


# ------------------------------------------------------------------ the beam without stops in closed form


def test_the_roots_solve_the_frequency_equation():
    found = roots(12)
    assert np.allclose(found[:3], [1.875104068711961, 4.694091132974175, 7.854757438237613], rtol=1e-15)
    assert np.all(np.diff(found) > 2.5)
    assert np.max(np.abs(np.cos(found) + 1.0 / np.cosh(found))) < 1e-14
    assert np.allclose(found, beam_roots(12), rtol=1e-14)
    x = np.linspace(0.0, 1.0, 9)
    for root in found[[0, 1, 4]]:
        assert np.allclose(mode(root, x), beam_mode(root, x), rtol=1e-11, atol=1e-11)


def tip_ratio(problem: sb.BeamProblem, cells: int) -> complex:
    """(-a^2 M + i a C + K) q = p by a dense solve, the load's complex amplitude p from its two phases."""
    system = sb.semidiscretise(problem, cells)
    a = problem.base.frequency
    # load(t) = Im(p e^{i a t}): p = load(quarter period) + i load(0)
    p = system.load(0.5 * np.pi / a) + 1j * system.load(0.0)
    q = np.linalg.solve(-(a**2) * system.mass + 1j * a * system.damping + system.stiffness, p)
    row, _ = system.channels[system.tip_channel]
    return complex(row @ q) / (problem.base.amplitude * np.exp(1j * problem.base.phase))


@pytest.mark.parametrize("viscosity", [0.0, 2.0])
@pytest.mark.parametrize("frequency", [10.0, 100.0])
def test_the_driven_tip_is_what_a_fine_grid_approaches(viscosity, frequency):
    base = sb.Harmonic(amplitude=0.2, frequency=frequency, phase=0.4)
    problem = sb.BeamProblem(stiffness=300.0, viscosity=viscosity, base=base)
    exact = tip_response(problem)
    cells = np.array([40, 57, 80])
    errors = [abs(tip_ratio(problem, int(n)) - exact) for n in cells]
    assert errors[-1] < 3e-3 * abs(exact)
    assert abs(observed_order(1.0 / cells, errors).slope - 2.0) < 0.1


def test_a_slow_clamp_carries_the_tip_along():
    slow = sb.BeamProblem(stiffness=300.0, base=sb.Harmonic(amplitude=0.2, frequency=1e-3))
    # ratio = 1 + O(a^2/k^2)
    assert abs(tip_response(slow) - 1.0) < 1e-3**2 / 300.0
    with pytest.raises(InputError, match="harmonic base"):
        tip_response(replace(slow, base=None))
    load = sb.PointLoad(position=0.5, time=sb.Constant(1.0))
    with pytest.raises(InputError, match="no loads"):
        tip_response(replace(slow, loads=(load,)))


@pytest.mark.parametrize("viscosity", [0.0, 0.05])
def test_the_steady_motion_solves_the_equation_of_motion(viscosity):
    loads = (sb.PointLoad(0.5, sb.Harmonic(3.0, 40.0, 0.3)), sb.DistributedLoad(lambda x: 1.0 + x, sb.Constant(2.0)))
    problem = sb.BeamProblem(stiffness=300.0, viscosity=viscosity, base=sb.Harmonic(0.2, 10.0), loads=loads)
    system = sb.semidiscretise(problem, 8)
    y, start = steady_state(system)
    drive = Drive.of(system)
    assert np.array_equal(start, drive.coefficients(0.0))
    rate = drive.derivative()
    for t in (0.0, 0.37, 2.0):
        g = drive.coefficients(t)
        q, v, a = (x @ y for x in (g, rate @ g, rate @ rate @ g))
        residual = system.mass @ a + system.damping @ v + system.stiffness @ q - system.load(t)
        assert np.max(np.abs(residual)) < 1e-10 * np.max(np.abs(system.load(t)))


# ------------------------------------------------------------------ stops anywhere along the beam


K2 = 300.0
CELLS = 10
MIDDLE = sb.Stops(-0.03, 0.03, stiffness=4e4, position=0.6, motion=sb.Harmonic(0.004, 7.0, phase=0.3))
TIP = sb.Stops(-0.1, 0.1, stiffness=2e5)
BASE = sb.Harmonic(0.2, 10.0)


def beam(*stops: sb.Stops, base=BASE) -> sb.BeamProblem:
    return sb.BeamProblem(stiffness=K2, stops=stops, base=base)


def in_absolute_coordinates(t: np.ndarray, cells: int = CELLS, t_end: float = 0.5) -> np.ndarray:
    """u (k, cells) by DOP853 on textbook differences of u itself: no moving frame, no matrix of the package.

    u_0 = phi, u_{-1} = u_1; at the free end u_{M+1} = 2 u_M - u_{M-1} and the central k^2 u_xxx = -sigma.
    MIDDLE presses on node 6 at 0.6 with -kappa (u - m - g)/h, TIP on the half cell at the end.
    """
    h = 1.0 / cells

    def push(u, lower, upper, kappa):
        return -kappa * (max(u - upper, 0.0) - max(lower - u, 0.0))

    def rhs(t, y):
        u = np.concatenate([[y[0], 0.2 * np.sin(10.0 * t)], y[:cells], [0.0, 0.0]])  # u_{-1}, u_0, .., u_{M+2}
        u[cells + 2] = 2.0 * u[cells + 1] - u[cells]
        u[cells + 3] = 2.0 * u[cells + 2] - 2.0 * u[cells] + u[cells - 1]
        fourth = u[:-4] - 4.0 * u[1:-3] + 6.0 * u[2:-2] - 4.0 * u[3:-1] + u[4:]
        a = -K2 / h**4 * fourth[-cells:]
        m = 0.004 * np.sin(7.0 * t + 0.3)
        a[5] += push(y[5] - m, -0.03, 0.03, 4e4) / h
        a[-1] += 2.0 * push(y[cells - 1], -0.1, 0.1, 2e5) / h
        return np.concatenate([y[cells:], a])

    found = solve_ivp(rhs, (0.0, t_end), np.zeros(2 * cells), "DOP853", t, rtol=1e-10, atol=1e-13)
    return found.y[:cells].T


@pytest.mark.slow
def test_moving_stops_off_the_tip_are_those_of_the_beam_in_absolute_coordinates():
    system = sb.semidiscretise(beam(MIDDLE, TIP), CELLS)
    t = np.linspace(0.0, 0.5, 401)
    exact = sb.reference(system, 0.5, t_eval=t)
    u = in_absolute_coordinates(t)
    inside = t < exact.horizon
    assert exact.contacts[0].impacts.count > 3
    assert exact.contacts[1].impacts.count > 3
    # The witness's tolerance, grown by the impacts; a lift or a motion of the wrong sign is off by 1e-2.
    assert np.max(np.abs(exact.tip - u[:, -1])[inside]) < 1e-5
    gap = u[:, 5] - 0.004 * np.sin(7.0 * t + 0.3)
    assert np.max(np.abs(exact.contacts[0].position - gap)[inside]) < 1e-5
    assert np.max(np.abs(exact.contacts[1].position - u[:, -1])[inside]) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("method", ["dop853", "cvode", "multiprecision"])
def test_every_kind_of_reference_takes_them(method):
    """A place between nodes, base and stop moving at frequencies of their own, decimals as such."""
    middle = sb.Stops(-0.03, 0.03, stiffness="4e4", position="0.53", motion=sb.Harmonic("0.004", 7.0))
    system = sb.semidiscretise(sb.BeamProblem(stiffness=K2, stops=[middle, TIP], base=sb.Harmonic("0.2", 10.0)), 8)
    exact = sb.reference(system, 0.5)
    other = sb.reference(system, 0.5, method, t_eval=exact.t)
    inside = exact.t <= min(exact.horizon, other.horizon)
    assert np.all(inside)
    for a, b in zip(exact.contacts, other.contacts, strict=True):
        assert a.impacts.count == b.impacts.count > 1
        # Forces of 1e3, positions of 1e-1: the adaptive solvers' rtol of 1e-9 or so, grown by a few impacts.
        assert np.max(np.abs(a.position - b.position)) < (1e-11 if method == "multiprecision" else 1e-5)


def test_a_stop_at_a_node_is_the_same_contact_as_one_of_matrices():
    row, tip = np.zeros(CELLS), np.zeros(CELLS)
    row[4] = tip[-1] = 1.0
    made = sb.semidiscretise(beam(sb.Stops(-0.05, 0.05, stiffness=4e4, position=0.5), TIP), CELLS)
    given = sb.System.from_matrices(
        made.mass, made.stiffness, loads=made.loads, observe=tip, initial_velocity=made.v0,
        contacts=[
            sb.Contact(row, sb.Stops(-0.05, 0.05, stiffness=4e4), sb.Harmonic(0.75 * 0.2, 10.0)),
            sb.Contact(tip, TIP),
        ],
    )  # fmt: skip
    runs = [sb.integrate(system, sb.BDF2(), 1e-4, 0.3) for system in (made, given)]
    # Modes of a factor and of a matrix differ in rounding; the plain march has no modes.
    assert np.max(np.abs(runs[0].tip - runs[1].tip)) < 1e-9
    for a, b in zip(made.contacts, given.contacts, strict=True):
        assert np.array_equal(a.row, b.row)
        assert a.offset == b.offset
        assert a.stops == b.stops
    again = sb.System(
        mass=made.mass, damping=made.damping, stiffness=made.stiffness, loads=given.loads, contacts=given.contacts,
        observe=tip, q0=made.q0, v0=made.v0, origin=made.origin,
    )  # fmt: skip
    assert again.problem == made.problem
    assert again.fingerprint == made.fingerprint
    assert np.array_equal(sb.integrate(again, sb.BDF2(), 1e-4, 0.3).tip, runs[0].tip)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("theta", [0.5, 0.25])
def test_what_a_stop_between_nodes_feels_is_of_second_order(form, theta):
    """row K^-1 row^T, how far the beam gives way at the stop, against the cantilever's a^3/(3 EI)."""
    cells, errors = np.array([16, 32, 64, 128]), []
    for M in cells:
        a = (M // 2 + theta) / M  # the same place in the cell on every grid
        system = sb.semidiscretise(beam(sb.Stops(-1.0, 1.0, stiffness=1.0, position=a), base=None), int(M), form)
        row = system.contacts[0].row
        errors.append(abs(row @ np.linalg.solve(system.stiffness, row) - a**3 / (3.0 * K2)) / (a**3 / (3.0 * K2)))
    order = -np.polyfit(np.log(cells), np.log(errors), 1)[0]
    assert order > 1.9  # 2.0 in the displacement form, 2.9 in the other one, whose errors cancel
    assert errors[-1] < 4.0 / cells[-1] ** 2


def test_the_problem_of_a_system_has_its_stops_where_they_are():
    problem = beam(MIDDLE, TIP)
    system = sb.semidiscretise(problem, CELLS)
    assert system.problem == problem
    assert system.problem.all_stops == (MIDDLE, TIP)
    assert pickle.loads(pickle.dumps(system)).problem == problem
    softer = sb.varied_members(system, stops=[[sb.Stops(-0.03, 0.03, stiffness=1.0), TIP]])[0]
    assert softer.problem is not None
    assert softer.problem.all_stops[0] == sb.Stops(
        -0.03, 0.03, stiffness=1.0, position=0.6, motion=sb.Harmonic(0.004, 7.0, phase=0.3)
    )
    slower = sb.varied_members(system, frequency=[9.0])[0]  # the base's: the gap follows it
    assert slower.fingerprint == sb.semidiscretise(beam(MIDDLE, TIP, base=sb.Harmonic(0.2, 9.0)), CELLS).fingerprint
    elsewhere = sb.Contact(np.ones(CELLS), TIP)
    assert replace(system, contacts=(elsewhere,)).problem is None


def test_single_stops_in_a_list_is_that_stops_and_at_the_tip_nothing_changes():
    assert sb.BeamProblem(stiffness=K2, stops=[TIP]) == sb.BeamProblem(stiffness=K2, stops=TIP)
    assert sb.BeamProblem(stiffness=K2, stops=[]).stops is None
    plain, placed = (
        sb.semidiscretise(beam(stops), CELLS) for stops in (TIP, sb.Stops(-0.1, 0.1, stiffness=2e5, position=1))
    )
    assert plain.fingerprint == placed.fingerprint
    assert repr(TIP) == "Stops(lower=-0.1, upper=0.1, stiffness=200000.0)"


def test_contacts_are_in_the_order_given_and_survive_a_file(tmp_path):
    system = sb.semidiscretise(beam(TIP, MIDDLE), CELLS)
    run = sb.integrate(system, sb.HHT(), 1e-3, 0.2)
    assert [c.stops.upper for c in run.contacts] == [0.1, 0.03]
    back = sb.load(run.save(tmp_path / "run.nc"), system)
    for a, b in zip(run.contacts, back.contacts, strict=True):
        assert a.stops == b.stops
        assert np.array_equal(a.position, b.position)
        assert np.array_equal(a.impacts.times, b.impacts.times)


CASE = """
[[case]]
name = "two"
cells = 10
dt = 1e-3
t_end = 0.1
[case.problem]
stiffness = 300
base = { amplitude = 0.2, frequency = 10 }
[[case.problem.stops]]
lower = -0.03
upper = 0.03
stiffness = 4e4
position = 0.6
motion = { amplitude = 0.004, frequency = 7, phase = 0.3 }
[[case.problem.stops]]
lower = -0.1
upper = 0.1
stiffness = 2e5
"""


def test_a_case_file_lists_them(tmp_path):
    file = tmp_path / "two.toml"
    file.write_text(CASE)
    assert load_cases(file)["two"].problem == beam(MIDDLE, TIP)
    file.write_text(CASE.replace("position = 0.6", "position = 1.6"))
    with pytest.raises(sb.InputError, match=r"two.problem: stops.position must lie on the beam, 0 < position <= 1"):
        load_cases(file)
    file.write_text(CASE.replace("phase = 0.3", "phase = 0.3, speed = 1"))
    with pytest.raises(sb.InputError, match=r"stops\[0\].motion: speed must be a known field"):
        load_cases(file)


# ------------------------------------------------------------------ initial data and point loads


@pytest.mark.parametrize("profile", [lambda x: 0.1 + 0.0 * x, lambda x: 0.1 + x**2, lambda x: 0.1 - 3 * x**2 + x**3])
def test_initial_displacements_that_meet_the_clamp_are_accepted(profile):
    problem = sb.BeamProblem(stiffness=1.0, base=sb.Constant(0.1), initial_displacement=profile)
    x = np.array([0.25, 0.5, 0.75, 1.0])
    expected = profile(x) - 0.1 * (1.0 - x**2)  # v = u - phi (1 - x^2)
    assert np.max(np.abs(sb.semidiscretise(problem, 4).q0 - expected)) < 1e-15 * 4


@pytest.mark.parametrize("position", [0.03, 0.23, 0.5, 0.7, 0.999, 1.0])
@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
def test_a_point_load_keeps_its_moment_about_the_clamp_between_nodes(position, form):
    problem = sb.BeamProblem(stiffness=1.0, loads=[sb.PointLoad(position, sb.Constant(7.0))])
    assert isinstance(problem.loads, tuple)
    load = sb.semidiscretise(problem, 25, form).load(0.0)
    x = np.arange(1, 26) / 25
    assert abs(load @ x - 7.0 * position) < 7.0 * 1e-14
    assert np.count_nonzero(load) <= 2


# ------------------------------------------------------------------ units


LENGTH, WIDTH, HEIGHT = 2.0, 0.05, 0.01  # a steel strip (m)


BENDING = 2.1e11 * WIDTH * HEIGHT**3 / 12  # EI


MASS = 7850.0 * WIDTH * HEIGHT  # rho A


FIRST = 1.8751040687119612**2 * math.sqrt(BENDING / (MASS * LENGTH**4))  # rad/s


STRIP = {"length": LENGTH, "bending_stiffness": BENDING, "mass_per_length": MASS}


TIP_STIFFNESS = 3.0 * BENDING / LENGTH**3  # N/m under a force at the tip


@pytest.mark.parametrize("noise", [lambda X: 0.0 * X, lambda X: 2e-17 * (X > 0.0)], ids=["none", "last bits"])
def test_a_beam_that_starts_straight_and_level_with_its_clamp_is_accepted(noise):
    """phi(0) is the same number only up to rounding, for lengths that are no power of two."""
    amplitude, phase = 0.073, 1.63
    problem = sb.BeamProblem.from_physical(
        length=3.07,
        bending_stiffness=1.0,
        mass_per_length=1.0,
        base=sb.Harmonic(amplitude, 30.0, phase),
        initial_displacement=lambda X: amplitude * np.sin(phase) + noise(X),
    )
    system = sb.semidiscretise(problem, 8)
    assert np.max(np.abs(system.q0 - amplitude * np.sin(phase) * (np.arange(1, 9) / 8.0) ** 2)) < 1e-15


def test_a_model_of_rotations_has_its_units():
    units = sb.Units("rad", "s", "N m")
    names = [units.of(x) for x in ("velocity", "stop stiffness", "impulse", "energy")]
    assert names == ["rad/s", "N m/rad", "N m s", "J"]
    with pytest.raises(sb.InputError, match=r"one of N, .*kN m"):
        sb.Units(force="rad")
