"""contact="conserving": the discrete gradient of the stops' energy, and the schemes that take it."""

from __future__ import annotations

import math

import numpy as np
import plain_march
import pytest
import scipy.linalg
from systems import one_mass

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.kernels.contact import solve_stage
from stiffbeam.kernels.march import MEAN
from stiffbeam.model.equations import Matrices, Modal

SCHEMES = [sb.Trapezoidal(), sb.ExponentialFlow(), sb.Theta(0.5)]


def free_beam(cells: int, **law: float) -> sb.System:
    """A beam let go bent, between stops, undamped and without loads."""
    stops = sb.Stops(-0.1, 0.1, **({"stiffness": 5e6} | law))
    bent = sb.PolynomialProfile((0.0, 0.0, 0.3))
    return sb.semidiscretise(sb.BeamProblem(stiffness=300.0, stops=stops, initial_displacement=bent), cells)


@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.parametrize("dt", [1e-4, 1e-3, 1e-2, 0.1])
def test_energy_is_kept_at_any_step(scheme, dt):
    run = sb.integrate(free_beam(25), scheme, dt, 400 * dt, contact="conserving")
    assert run.impacts.count > 3
    energy = run.energy.energy
    # An impact loses eps of the position times the force, some 1e-15 of the energy here, and there are hundreds.
    assert np.max(np.abs(energy / energy[0] - 1.0)) < 1e-11
    assert np.max(np.abs(run.energy.loss)) < 1e-11 * energy[0]


@pytest.mark.parametrize("p", [1.5, 2.0, 3.0])
def test_energy_is_kept_by_power_laws(p):
    for scheme in SCHEMES[:2]:
        run = sb.integrate(free_beam(10, exponent=p), scheme, 1e-3, 2.0, contact="conserving")
        assert run.impacts.count > 3
        assert np.max(np.abs(run.energy.energy / run.energy.energy[0] - 1.0)) < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES[:2], ids=str)
def test_energy_drifts_by_1e_11_in_a_million_steps_at_most(scheme):
    run = sb.integrate(free_beam(25), scheme, 1e-4, 100.0, contact="conserving", every=10_000)
    assert run.impacts.count > 50_000
    assert np.max(np.abs(run.energy.energy / run.energy.energy[0] - 1.0)) < 1e-11


def several(rng: np.random.Generator, m: int, p: float) -> sb.System:
    n = 5
    A, B = rng.normal(size=(2, n, n))
    contacts = [sb.Contact(rng.normal(size=n), sb.Stops(-0.3, 0.2, stiffness=300.0, exponent=p)) for _ in range(m)]
    mass, stiffness = np.eye(n) + 0.1 * A @ A.T, np.eye(n) + B @ B.T
    return sb.System.from_matrices(mass, stiffness, contacts=contacts, initial_velocity=rng.normal(size=n))


@pytest.mark.parametrize("p", [1.0, 1.5])
@pytest.mark.parametrize("m", [2, 3])
def test_energy_is_kept_by_several_contacts_at_once(m, p):
    system = several(np.random.default_rng([m, 1]), m, p)
    for scheme in SCHEMES[:2]:
        run = sb.integrate(system, scheme, 0.02, 20.0, contact="conserving")
        assert min(c.impacts.count for c in run.contacts) > 3
        assert np.max(np.abs(run.energy.energy / run.energy.energy[0] - 1.0)) < 2e-12


@pytest.mark.parametrize("scheme", SCHEMES[:2], ids=str)
def test_kernel_and_oracle_agree(scheme, in_numpy):
    system = free_beam(6, stiffness=1e4)
    run = sb.integrate(system, scheme, 1e-3, 0.6, contact="conserving")
    assert run.impacts.count > 2
    with in_numpy():
        other = sb.integrate(system, scheme, 1e-3, 0.6, contact="conserving")
    assert np.max(np.abs(other.tip - run.tip)) < 1e-10
    assert np.max(np.abs(plain_march.march(system, scheme, 1e-3, 0.6, "conserving").tip - run.tip)) < 1e-9
    for name in ("times", "peaks", "impulses"):
        a, b = getattr(run.impacts, name), getattr(other.impacts, name)
        assert np.allclose(a, b, rtol=1e-6, equal_nan=True)
    assert np.isclose(run.contacts[0].impulse, other.contacts[0].impulse, rtol=1e-9)
    ensemble = sb.integrate_ensemble(system, scheme, 1e-3, 0.6, [system, system], contact="conserving", every=1)
    assert np.array_equal(ensemble.tip[1], run.tip)


@pytest.mark.parametrize("scheme", SCHEMES[:2], ids=str)
def test_it_converges_to_the_exact_motion(scheme):
    # A forced, damped system whose stop is soft: the force is Lipschitz, so the order is that of the scheme.
    contact, load = sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=20.0)), sb.Harmonic(2.0, 1.3, 0.4)
    system = sb.System.from_matrices([[1.0]], [[4.0]], [[0.1]], [([1.0], load)], [contact])
    exact = sb.reference(system, 6.0, t_eval=np.linspace(0.0, 6.0, 13)).tip
    steps, errors = np.array([32, 64, 128, 256, 512]), []
    for n in steps:
        run = sb.integrate(system, scheme, 1.0 / n, 6.0, contact="conserving", every=n // 2)
        errors.append(np.max(np.abs(run.tip - exact)))
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert abs(slope - 2.0) < 0.2


@pytest.mark.parametrize("scheme", SCHEMES[:2], ids=str)
def test_the_impulse_is_the_momentum_that_is_turned_round(scheme):
    stops = sb.Stops(upper=0.0, stiffness=2000.0)
    ball = one_mass(0.0, stops, mass=2.0, q=-0.1, v=1.0)
    for dt in (0.4, 0.05, 0.01):
        run = sb.integrate(ball, scheme, dt, 2.0, contact="conserving")
        assert abs(run.tip_velocity[-1] + 1.0) < 1e-14
        assert abs(run.contacts[0].impulse - 4.0) < 1e-13
        if run.impacts.count:  # at the largest step it may turn round in one
            assert np.allclose(run.impacts.impulses, 4.0, atol=1e-13)


def mean_force(r, u0, s, stops):
    """Of one contact that ends at r + s F."""
    one, none = np.ones(1), np.zeros((1, 1))
    return solve_stage(r * one, 0.0 * one, s * one[None], none, u0 * one, MEAN, stops.law[None])[0]


def secant(u, u0, law):
    """The slope of the energy between two positions: minus the mean force at a node that does not give way."""
    one, none = np.ones(1), np.zeros((1, 1))
    return -solve_stage(u * one, 0.0 * one, none, none, u0 * one, MEAN, law[None])[0]


def test_the_mean_force_solves_its_equation():
    rng = np.random.default_rng(2)
    for _ in range(3000):
        p, kappa = float(rng.choice([1.0, 1.0, 1.5, 2.7])), float(10.0 ** rng.uniform(-1, 6))
        g1, g2 = sorted(rng.normal(size=2) * 0.3)
        g1, g2 = (-math.inf, g2) if rng.random() < 0.3 else (g1, math.inf) if rng.random() < 0.3 else (g1, g2)
        r, u0, s = rng.normal(), rng.normal(), float(10.0 ** rng.uniform(-10, 1)) * (rng.random() < 0.95)
        stops = sb.Stops(g1 if np.isfinite(g1) else None, g2 if np.isfinite(g2) else None, stiffness=kappa, exponent=p)
        F = mean_force(r, u0, s, stops)
        u = r + s * F
        # Energies at both ends against the work of F: rounding of the positions times the forces there.
        force = max(abs(float(stops.force(x))) for x in (u, u0, r))
        held = float(stops.energy(u0)) + float(stops.energy(u))
        gain = float(stops.energy(u) - stops.energy(u0)) + F * (u - u0)
        peak = max(abs(float(stops.force(x))) for x in (u, u0))
        assert abs(gain) <= 1e-12 * held + 1e-14 * (peak + abs(F)) * (abs(r) + abs(u0) + s * abs(F))
        assert force >= abs(F) * (1.0 - 1e-9)


def test_the_secant_does_not_cancel():
    # Two depths next to each other: the mean force is that at the middle, to their distance squared.
    for p in (1.0, 1.5, 3.0):
        for gap in (1e-3, 1e-8, 1e-13, 0.0):
            found = secant(1.0 + gap, 1.0, sb.Stops(upper=0.5, stiffness=7.0, exponent=p).law)
            assert math.isclose(found, 7.0 * (0.5 + 0.5 * gap) ** p, rel_tol=2.0 * gap**2 + 1e-14)


def test_several_mean_forces_at_once():
    rng = np.random.default_rng(5)
    for _ in range(300):
        m = int(rng.integers(2, 5))
        p = float(rng.choice([1.0, 1.5]))
        laws = np.array([sb.Stops(-0.5, 0.4, stiffness=10.0 ** rng.uniform(0, 4), exponent=p).law for _ in range(m)])
        A = rng.normal(size=(m, m))
        S, r, u0 = A @ A.T * 10.0 ** rng.uniform(-6, 0), rng.normal(size=m), rng.normal(size=m)
        F = solve_stage(r, np.zeros(m), S, np.zeros((m, m)), u0, MEAN, laws)
        u = r + S @ F
        for c in range(m):
            want = -secant(u[c], u0[c], laws[c])
            assert abs(F[c] - want) <= 1e-9 * (abs(want) + np.abs(S[c]) @ np.abs(F) / S[c, c])


@pytest.mark.parametrize("seed", range(8))
def test_the_flow_of_modes_is_the_matrix_exponential(seed):
    rng = np.random.default_rng(seed)
    omega = np.array([0.0, 1e-3, 0.3, 0.999, 1.0, 1.7, 30.0]) * 10.0 ** rng.uniform(-1, 1)
    damping = rng.choice([0.0, 0.1, 2.0, 20.0], size=7) * rng.random(7)
    equation, t = Modal(omega, damping), 10.0 ** rng.uniform(-1, 0.5)
    y, f0, f1 = rng.normal(size=(2, 7)), rng.normal(size=7), rng.normal(size=7)
    found = equation.flow(t, y, f0, f1)
    full = Matrices(np.eye(7), np.diag(damping), np.diag(omega**2)).flow(t, y, f0, f1)
    for j in range(7):
        A = np.array([[0, 1, 0, 0], [-(omega[j] ** 2), -damping[j], 1, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
        want = scipy.linalg.expm(A * t) @ [*y[:, j], f0[j], (f1[j] - f0[j]) / t]
        scale = np.max(np.abs(want)) + np.max(np.abs(y)) + omega[j] * np.max(np.abs(y))
        assert np.max(np.abs(found[:, j] - want[:2])) < 1e-11 * scale
        assert np.max(np.abs(full[:, j] - want[:2])) < 1e-10 * scale * (1.0 + np.max(omega))


def test_free_motion_of_the_exponential_flow_is_exact():
    system = sb.System.from_matrices(
        np.eye(2), [[5.0, -2.0], [-2.0, 2.0]], observe=[0.0, 1.0], initial_velocity=[1.0, 0.0]
    )
    run = sb.integrate(system, sb.ExponentialFlow(), 0.5, 50.0)
    assert np.max(np.abs(run.tip - sb.reference(system, 50.0, t_eval=run.t).tip)) < 1e-13


class TestRefusals:
    def test_schemes_that_dissipate(self):
        for scheme in (sb.HHT(-0.1), sb.BDF2(), sb.SDIRK(), sb.Theta(0.6), sb.Bathe()):
            with pytest.raises(InputError, match="exponential-flow"):
                sb.integrate(free_beam(6), scheme, 1e-3, 0.1, contact="conserving")

    def test_stops_that_dissipate(self):
        with pytest.raises(InputError, match=r"stops\.dissipation.*implicit contact"):
            sb.integrate(free_beam(6, dissipation=0.1), sb.Trapezoidal(), 1e-3, 0.1, contact="conserving")

    def test_members_that_dissipate(self):
        linear = free_beam(6)
        members = sb.varied_members(linear, stops=[sb.Stops(upper=0.1, stiffness=10.0, damping=1.0)])
        with pytest.raises(InputError, match=r"stops\.damping"):
            sb.integrate_ensemble(linear, sb.Trapezoidal(), 1e-3, 0.1, members, contact="conserving")


@pytest.mark.parametrize("scheme", [sb.Trapezoidal(), sb.ExponentialFlow()])
def test_without_contact_nothing_is_left_to_conserve(three_masses, scheme):
    """A system without contacts marches as ever."""
    runs = [sb.integrate(three_masses, scheme, 1e-2, 2.0, contact) for contact in ("implicit", "conserving")]
    np.testing.assert_allclose(runs[1].tip, runs[0].tip, rtol=0, atol=1e-13)
