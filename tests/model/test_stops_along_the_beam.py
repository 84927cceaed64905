"""Stops anywhere along the beam, several and moving, against closed forms and the beam in absolute coordinates."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stiffbeam as sb
from stiffbeam.files.cases import load_cases
from stiffbeam.model.semidiscretisation import FORMS

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
