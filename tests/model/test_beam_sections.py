"""Rotary inertia, tip inertia, sections and modal damping, against transfer matrices that share no code."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import stiffbeam as sb
from stiffbeam.files.cases import load_cases

EI, L, M, J = 3.0, 2.0, 0.7, 0.02  # no quantity is 1
PARTS = (sb.BeamSection(0.0, 0.5, stiffness=2.5, mass=1.4), sb.BeamSection(1.5, 2.0, stiffness=0.3, mass=0.6))
LENGTHS = ((0.5, 2.5, 1.4), (1.0, 1.0, 1.0), (0.5, 0.3, 0.6))  # length, EI and m over those of the middle


def beam(**fields) -> sb.BeamProblem:
    return sb.BeamProblem(stiffness=EI, length=L, mass_per_length=M, **fields)


def transfer(w: float, rotary: float, parts=LENGTHS) -> np.ndarray:
    """(v, v', EI v'', (EI v'')' + w^2 J v') from x = 0 to L of EI v'''' + w^2 J v'' - w^2 m v = 0, part by part."""
    total = np.eye(4)
    for length, stiffer, heavier in parts:
        A = np.zeros((4, 4))
        A[0, 1], A[1, 2] = 1.0, 1.0 / (stiffer * EI)
        A[2, 3], A[2, 1], A[3, 0] = 1.0, -(w**2) * heavier * rotary, w**2 * heavier * M
        total = expm(A * length) @ total
    return total


def free_end(w: float, T: np.ndarray, mass: float, inertia: float) -> np.ndarray:
    """The two conditions at a free end with a body on it, as rows on the state at x = 0."""
    return np.array([T[2] - w**2 * inertia * T[1], T[3] + w**2 * mass * T[0]])


def clamped_free(count: int, rotary: float, mass: float, inertia: float, parts=LENGTHS) -> np.ndarray:
    """The first angular frequencies: roots of a determinant of the transfer matrix."""
    det = lambda w: np.linalg.det(free_end(w, transfer(w, rotary, parts), mass, inertia)[:, 2:])  # noqa: E731
    grid = np.linspace(0.05, 60.0, 1500)
    values = np.array([det(w) for w in grid])
    at = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))[:count]
    return np.array([brentq(det, grid[i], grid[i + 1], xtol=1e-13) for i in at])


@pytest.mark.parametrize("n", [1, 2, 3])
def test_rotary_inertia_of_a_pinned_beam_in_closed_form(n):
    """Rayleigh's beam: w^2 = EI k^4/(m + J k^2), k = n pi/L; elements converge to it from above at order 4."""
    k = n * np.pi / L
    wanted = np.sqrt(EI * k**4 / (M + J * k**2))
    cells = np.array([8, 16])
    problem = beam(supports="pinned-pinned", rotary_inertia=J)
    found = np.array([sb.modes(sb.semidiscretise(problem, c, "hermite")).omega[n - 1] for c in cells])
    errors = found / wanted - 1.0
    assert np.all(errors > 0.0)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.2)


@pytest.mark.parametrize(
    "fields",
    [
        {"sections": PARTS},
        {"sections": PARTS, "rotary_inertia": J},
        {"sections": PARTS, "rotary_inertia": J, "tip_mass": 0.4, "tip_inertia": 0.05},
        {"tip_mass": 0.4, "tip_inertia": 0.05},
    ],
    ids=lambda fields: "-".join(fields),
)
def test_frequencies_against_transfer_matrices(fields):
    parts = LENGTHS if "sections" in fields else ((L, 1.0, 1.0),)
    rotary, mass, inertia = (fields.get(name, 0.0) for name in ("rotary_inertia", "tip_mass", "tip_inertia"))
    wanted = clamped_free(3, rotary, mass, inertia, parts)
    coarse, fine = (sb.modes(sb.semidiscretise(beam(**fields), c, "hermite")).omega[:3] for c in (8, 16))
    assert np.all(coarse > fine)  # from above
    # (k h)^4/720 with the shortest wave, in the softest part: k^4 = m w^2/EI
    k = (M * wanted**2 / (0.3 * EI)) ** 0.25 if "sections" in fields else (M * wanted**2 / EI) ** 0.25
    assert np.all(fine / wanted - 1.0 < (k * L / 16) ** 4 / 720)


def test_a_shaken_stepped_beam_answers_as_its_transfer_matrix_says():
    """Base motion with sections, rotary inertia and a body at the tip: the steady tip, and the moment at the clamp."""
    w = 2.3
    T = transfer(w, J)
    rows = free_end(w, T, 0.4, 0.05)
    moment, shear = np.linalg.solve(rows[:, 2:], -rows[:, 0])  # u = 1, u' = 0 at the clamp
    tip = T[0] @ [1.0, 0.0, moment, shear]
    problem = beam(
        sections=PARTS, rotary_inertia=J, tip_mass=0.4, tip_inertia=0.05, base=sb.Harmonic(1.0, w, 0.5 * np.pi)
    )
    system = sb.semidiscretise(problem, 32, "hermite")
    # The steady motion: v(t) = Re(V e^{iwt}) of the system's own matrices and loads, phi = cos wt.
    force = sum(vector * f.value(0.0) for vector, f in system.loads)
    V = np.linalg.solve(system.stiffness - w**2 * system.mass, force)
    steady = replace(system, q0=V, v0=np.zeros(system.size))
    found = steady.displacement([0.0], V[None], [L])[0, 0]
    assert found == pytest.approx(tip, rel=1e-5)
    at_clamp = steady.moment(np.zeros(1), V[None], np.zeros((1, system.size)), [0.0])[0, 0]
    assert at_clamp == pytest.approx(moment, rel=2e-3)  # second derivatives converge at order 2


def test_the_steady_motion_marches():
    """The same start stays on its harmonic: loads and matrices belong together in time too."""
    problem = beam(sections=PARTS, rotary_inertia=J, base=sb.Harmonic(0.1, 2.3, 0.5 * np.pi))
    system = sb.semidiscretise(problem, 8, "hermite")
    force = sum(vector * f.value(0.0) for vector, f in system.loads)
    V = np.linalg.solve(system.stiffness - 2.3**2 * system.mass, force)
    exact = sb.reference(replace(system, q0=V, v0=np.zeros(system.size)), 6.0)
    np.testing.assert_allclose(exact.tip, exact.tip[0] * np.cos(2.3 * exact.t), atol=1e-9)


def test_modal_damping_is_the_ratio_asked_for():
    """Of every mode, of the first ones, and in a free decay; for a beam and for matrices."""
    problem = beam(modal_damping=[0.02, 0.05], supports="clamped-pinned")
    found = sb.modes(sb.semidiscretise(problem, 8, "hermite"))
    np.testing.assert_allclose(found.damping_ratio[:4], [0.02, 0.05, 0.0, 0.0], atol=1e-12)
    mass, stiffness = np.diag([1.0, 2.0]), np.array([[30.0, -10.0], [-10.0, 20.0]])
    C = sb.modal_damping(mass, stiffness, 0.03)
    system = sb.System.from_matrices(mass, stiffness, C, observe=[1.0, 0.0])
    np.testing.assert_allclose(sb.modes(system).damping_ratio, 0.03, rtol=1e-12)
    w, shape = sb.modes(system).omega[0], sb.modes(system).shapes[:, 0]
    exact = sb.reference(replace(system, q0=shape), 5.0)
    d = w * np.sqrt(1 - 0.03**2)
    decay = np.exp(-0.03 * w * exact.t) * (np.cos(d * exact.t) + 0.03 * w / d * np.sin(d * exact.t))
    np.testing.assert_allclose(exact.tip, shape[0] * decay, atol=1e-12)
    free = sb.modal_damping(np.eye(2), np.array([[1.0, -1.0], [-1.0, 1.0]]), 0.1)  # a rigid motion has none
    np.testing.assert_allclose(free @ [1.0, 1.0], 0.0, atol=1e-14)


def test_a_case_file_says_all_of_it(tmp_path):
    file = tmp_path / "stepped.toml"
    file.write_text(
        """
[[case]]
name = "stepped"
cells = 8
dt = 1e-3
t_end = 0.1
[case.problem]
stiffness = 3.0
rotary_inertia = 0.02
tip_inertia = 0.01
modal_damping = [0.01, 0.02]
sections = [{ begin = 0.0, end = 0.25, stiffness = 2.0 }, { begin = 0.5, end = 1.0, mass = 0.5 }]
"""
    )
    case = load_cases(file)["stepped"]
    assert case.problem == sb.BeamProblem(
        stiffness=3.0, rotary_inertia=0.02, tip_inertia=0.01, modal_damping=(0.01, 0.02),
        sections=(sb.BeamSection(0.0, 0.25, stiffness=2.0), sb.BeamSection(0.5, 1.0, mass=0.5)),
    )  # fmt: skip
    assert {form for _, form in case.runs} == {"hermite"}
