"""Beams by cubic elements: closed forms of frequencies and deflections, transfer matrices, limits in contact."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse
from scipy.optimize import brentq

import stiffbeam as sb
from stiffbeam.model.problem import SUPPORTS

EI, L, M_LENGTH = 3.0, 2.0, 0.7  # no quantity is 1
UNIT = np.sqrt(EI / (M_LENGTH * L**4))  # omega = (beta L)^2 UNIT

# The characteristic equations, divided by cosh where they grow, and where to look for the n-th root.
CHARACTERISTIC = {
    "clamped-free": (lambda b: np.cos(b) + 1.0 / np.cosh(b), -0.5),
    "clamped-clamped": (lambda b: np.cos(b) - 1.0 / np.cosh(b), 0.5),
    "free-free": (lambda b: np.cos(b) - 1.0 / np.cosh(b), 0.5),
    "clamped-pinned": (lambda b: np.sin(b) - np.cos(b) * np.tanh(b), 0.25),
    "pinned-pinned": (np.sin, 0.0),
}


def roots(function, shift: float, count: int) -> np.ndarray:
    """beta_n L, one in each [(n + shift) pi - 0.7, (n + shift) pi + 0.7]."""
    centres = (np.arange(1, count + 1) + shift) * np.pi
    return np.array([brentq(function, c - 0.7, c + 0.7, xtol=1e-15) for c in centres])


def beam(supports: str = "clamped-free", **fields) -> sb.BeamProblem:
    return sb.BeamProblem(stiffness=EI, length=L, mass_per_length=M_LENGTH, supports=supports, **fields)


def frequencies(system: sb.System, count: int) -> np.ndarray:
    omega = sb.modes(system).omega
    return omega[omega > 0.0][:count]


@pytest.mark.parametrize("supports", SUPPORTS)
def test_frequencies_are_the_characteristic_equations_at_order_four(supports):
    exact = roots(*CHARACTERISTIC[supports], 4) ** 2 * UNIT
    cells = np.array([12, 16, 24, 32])
    errors = np.array(
        [frequencies(sb.semidiscretise(beam(supports), int(M), "hermite"), 4) / exact - 1.0 for M in cells]
    )
    assert np.all(errors > 0.0)  # Rayleigh and Ritz: from above
    for j in range(4):
        order = -np.polyfit(np.log(cells), np.log(errors[:, j]), 1)[0]
        assert abs(order - 4.0) < 0.1, (supports, j)
        # The leading term of consistent elements, (beta h)^4/1440.
        assert errors[-1, j] == pytest.approx((np.sqrt(exact[j] / UNIT) / 32) ** 4 / 1440.0, rel=0.05)


def test_a_free_beam_has_two_rigid_motions_of_frequency_zero():
    found = sb.modes(sb.semidiscretise(beam("free-free", mass_damping=0.1), 10, "hermite"))
    assert np.array_equal(found.omega[:2], [0.0, 0.0])
    assert found.omega[2] > 1.0
    assert np.all(np.isnan(found.damping_ratio[:2]))
    assert not found.coupled
    x = np.repeat(np.linspace(0.0, L, 11), 2)[::2]
    for shape in found.shapes.T[:2]:
        line = np.polyfit(x, shape[::2], 1)
        assert np.max(np.abs(shape[::2] - np.polyval(line, x))) < 1e-10 * np.max(np.abs(shape))


@pytest.mark.parametrize("form", ["hermite", "displacement"])
def test_a_tip_mass_solves_its_transcendental_equation(form):
    """1 + cos b cosh b + mu b (cos b sinh b - sin b cosh b) = 0, mu = tip mass/(m L)."""
    mass = 0.3
    mu = mass / (M_LENGTH * L)

    def equation(b):
        return 1.0 / np.cosh(b) + np.cos(b) + mu * b * (np.cos(b) * np.tanh(b) - np.sin(b))

    exact = np.array([brentq(equation, 0.5, 1.9), brentq(equation, 3.9, 4.7)]) ** 2 * UNIT
    cells = np.array([8, 16, 32]) if form == "hermite" else np.array([40, 80, 160])
    errors = [np.abs(frequencies(sb.semidiscretise(beam(tip_mass=mass), int(M), form), 2) / exact - 1.0) for M in cells]
    for j in range(2):
        order = -np.polyfit(np.log(cells), np.log([e[j] for e in errors]), 1)[0]
        assert abs(order - (4.0 if form == "hermite" else 2.0)) < 0.1


@pytest.mark.parametrize(
    ("supports", "place", "deflection"),
    [  # of a unit load spread evenly over the beam, at x = place L, over L^4/EI
        ("clamped-free", 1.0, 1 / 8),
        ("clamped-clamped", 0.5, 1 / 384),
        ("clamped-pinned", 0.5, 1 / 192),
        ("pinned-pinned", 0.5, 5 / 384),
    ],
)
def test_the_sag_under_an_even_load(supports, place, deflection):
    """Nodal values are exact, so are those of the cubic element at mid-span on an even number of them."""
    weight = sb.DistributedLoad(sb.PolynomialProfile((1.0,)), sb.Constant(2.5))
    problem = beam(supports, loads=(weight,))
    system = sb.semidiscretise(problem, 6, "hermite")
    q = np.linalg.solve(system.stiffness, system.load(0.0))
    exact = 2.5 * deflection * L**4 / EI
    assert system.displacement([0.0], q[None], place * L)[0] == pytest.approx(exact, rel=1e-10)
    run = sb.reference(replace(system, q0=q), 1.0)  # at rest it stays
    assert np.max(np.abs(run.tip - run.tip[0])) < 1e-10 * exact


def test_a_beam_at_rest_on_a_stop_shares_the_load_with_it():
    """A cantilever under P at its tip, on a spring stop at a with the gap g: by superposition of closed forms."""
    P, a, g, kappa = 2.0, 0.6 * L, 0.01, 40.0

    def sag(at, load_at):  # of a cantilever under a unit load
        low, high = min(at, load_at), max(at, load_at)
        return low**2 * (3.0 * high - low) / (6.0 * EI)

    force = (P * sag(a, L) - g) / (1.0 / kappa + sag(a, a))
    tip = P * sag(L, L) - force * sag(L, a)
    problem = beam(
        stops=[sb.Stops(upper=g, stiffness=kappa, position=a), sb.Stops(lower=-1.0, stiffness=1.0)],
        loads=(sb.PointLoad(L, sb.Constant(P)),),
    )

    def pressed(system):  # K q + kappa row (row q - g) = load
        row = system.contacts[0].row
        return np.linalg.solve(system.stiffness + kappa * np.outer(row, row), system.load(0.0) + kappa * g * row)

    system = sb.semidiscretise(problem, 5, "hermite")  # 0.6 is a node: exact
    q = pressed(system)
    assert q @ system.channels[system.tip_channel][0] == pytest.approx(tip, rel=1e-10)
    assert kappa * (q @ system.contacts[0].row - g) == pytest.approx(force, rel=1e-10)
    coarse, fine = (sb.semidiscretise(problem, M) for M in (20, 40))  # the paper's form, second order
    errors = [abs(pressed(s) @ s.channels[s.tip_channel][0] - tip) for s in (coarse, fine)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_damping_ratios_of_both_kinds_of_damping():
    """xi = eta omega/(2 EI) + a/(2 omega)."""
    problem = beam(viscosity=0.02, mass_damping=0.3)
    for form in ("hermite", "displacement"):
        found = sb.modes(sb.semidiscretise(problem, 12, form))
        assert not found.coupled
        assert np.allclose(found.damping_ratio, 0.5 * 0.02 / EI * found.omega + 0.5 * 0.3 / found.omega, rtol=1e-9)


def test_damping_that_couples_the_modes_has_complex_ones():
    """A dashpot at the tip: every mode solves (lambda^2 M + lambda C + K) shape = 0; weak: c phi_tip^2/(2 omega)."""
    system = sb.semidiscretise(beam(), 6, "hermite")
    row = system.observe
    plain = sb.modes(system)
    for c in (1e-4, 0.5):
        damped = replace(system, damping=c * np.outer(row, row))
        found = sb.modes(damped)
        assert found.coupled
        for omega, ratio, shape in zip(found.omega, found.damping_ratio, found.shapes.T, strict=True):
            value = -ratio * omega + 1j * omega * np.sqrt(max(0.0, 1.0 - ratio**2))
            residual = value**2 * (system.mass @ shape) + value * (damped.damping @ shape) + system.stiffness @ shape
            assert np.linalg.norm(residual) < 1e-9 * np.linalg.norm(system.stiffness @ shape)
            assert np.real(np.conj(shape) @ system.mass @ shape) == pytest.approx(1.0)
    weak = sb.modes(replace(system, damping=1e-4 * np.outer(row, row)))
    assert np.allclose(weak.damping_ratio, 0.5e-4 * (row @ plain.shapes) ** 2 / plain.omega, rtol=1e-3)
    over = sb.modes(sb.System.from_matrices(np.eye(2), np.diag([1.0, 9.0]), [[4.0, 0.1], [0.1, 0.2]], observe=[1, 0]))
    assert len(over.omega) == 3  # two that only decay, one that oscillates
    assert np.count_nonzero(over.damping_ratio == 1.0) == 2
    assert "damping ratio" in repr(over)


def test_the_field_of_a_beam_is_its_initial_data_anywhere():
    """u0 and v0 cubics: elements hold them exactly."""
    u0, v0 = sb.PolynomialProfile((0.0, 0.0, 3.0, -1.0)), sb.PolynomialProfile((0.0, 0.0, 1.0, 0.5))
    problem = beam(viscosity=0.2, initial_displacement=u0, initial_velocity=v0)
    x = np.array([0.0, 0.3, 1.234, L])
    system = sb.semidiscretise(problem, 7, "hermite")
    run = sb.integrate(system, sb.BDF2(), 1e-3, 0.01)
    assert np.allclose(run.displacement(x)[0], u0(x), atol=1e-12)
    assert np.allclose(run.velocity(x)[0], v0(x), atol=1e-12)
    assert pickle.loads(pickle.dumps(run)).system.problem == problem
    with pytest.raises(sb.InputError, match="x must lie in"):
        run.displacement(-0.1)


def test_moving_the_clamp_is_moving_the_frame():
    """A clamp that moves by phi against the same beam at rest, pushed by -m phi'' - a m phi': u - phi of both agree."""
    phi = sb.Harmonic(0.1, 4.0, "pi/2")
    moved = beam(base=phi, mass_damping=0.4, viscosity=0.01)
    push = -M_LENGTH * 0.1 * 4.0 * np.array([-4.0, 0.4])  # of phi'' ~ cos, of a phi' ~ -sin
    loads = (
        sb.DistributedLoad(sb.PolynomialProfile((1.0,)), sb.Harmonic(push[0], 4.0, "pi/2")),
        sb.DistributedLoad(sb.PolynomialProfile((1.0,)), sb.Harmonic(-push[1], 4.0)),
    )
    still = beam(mass_damping=0.4, viscosity=0.01, loads=loads)
    t = np.linspace(0.0, 3.0, 301)
    a, b = (sb.reference(sb.semidiscretise(p, 12, "hermite"), 3.0, t_eval=t) for p in (moved, still))
    # The frames differ by phi x^2, which elements hold exactly.
    assert np.max(np.abs(a.tip - phi.value(t) - b.tip)) < 1e-9 * np.max(np.abs(b.tip))


@pytest.mark.slow
def test_multiprecision_takes_the_paper_form_with_tip_mass_and_damping_and_the_elements_matrices():
    problem = sb.BeamProblem(
        stiffness="300.1",
        mass_damping="0.3",
        tip_mass="0.1",
        base=sb.Harmonic("0.2", 10.0),
        stops=sb.Stops(-0.1, 0.1, stiffness=1e4),
    )
    for form in ("displacement", "hermite"):
        system = sb.semidiscretise(problem, 4, form)
        exact = sb.reference(system, 0.3)
        precise = sb.reference(system, 0.3, "multiprecision", t_eval=exact.t)
        assert np.max(np.abs(exact.tip - precise.tip)) < 1e-9 * np.max(np.abs(exact.tip))
        assert ("stiffness = 300.1" in system.exact_parameters) == (form == "displacement")


def test_modal_damping_is_the_ratio_asked_for():
    """Of every mode, of the first ones, and in a free decay; for a beam and for matrices."""
    problem = beam(modal_damping=[0.02, 0.05], supports="clamped-pinned")
    found = sb.modes(sb.semidiscretise(problem, 8, "hermite"))
    np.testing.assert_allclose(found.damping_ratio[:4], [0.02, 0.05, 0.0, 0.0], atol=1e-12)
    mass, stiffness = np.diag([1.0, 2.0]), np.array([[30.0, -10.0], [-10.0, 20.0]])
    C = sb.modal_damping(mass, stiffness, 0.03)
    assert np.array_equal(sb.modal_damping(scipy.sparse.csr_array(mass), stiffness, 0.03), C)
    system = sb.System.from_matrices(mass, stiffness, C, observe=[1.0, 0.0])
    np.testing.assert_allclose(sb.modes(system).damping_ratio, 0.03, rtol=1e-12)
    w, shape = sb.modes(system).omega[0], sb.modes(system).shapes[:, 0]
    exact = sb.reference(replace(system, q0=shape), 5.0)
    d = w * np.sqrt(1 - 0.03**2)
    decay = np.exp(-0.03 * w * exact.t) * (np.cos(d * exact.t) + 0.03 * w / d * np.sin(d * exact.t))
    np.testing.assert_allclose(exact.tip, shape[0] * decay, atol=1e-12)
    free = sb.modal_damping(np.eye(2), np.array([[1.0, -1.0], [-1.0, 1.0]]), 0.1)  # a rigid motion has none
    np.testing.assert_allclose(free @ [1.0, 1.0], 0.0, atol=1e-14)
