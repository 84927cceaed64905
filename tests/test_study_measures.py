"""What the studies measure with: known lags, slopes, bounces and closed forms come back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles import beam_mode, beam_roots

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.files.cases import paper_case
from stiffbeam.measures.free_modes import free_mode_errors
from stiffbeam.measures.regression import observed_order
from stiffbeam.measures.smooth_motion import steady_state
from stiffbeam.model import closed_form
from stiffbeam.model.drive import Drive
from stiffbeam.model.modes import modes
from stiffbeam.model.semidiscretisation import FORMS
from stiffbeam.references.exact.rigid import rigid_limit
from stiffbeam.schemes import registered
from stiffbeam.studies import study
from stiffbeam.trajectory.trajectory import Trajectory, Work

# ---------------------------------------------------------------- observed orders


@pytest.mark.parametrize("slope", [0.5, 2.0, 3.0])
def test_an_exact_power_law_gives_its_slope_and_constant(slope):
    steps = 0.1 / 2.0 ** np.arange(6)
    order = observed_order(steps, 7.0 * steps**slope)
    assert order.slope == pytest.approx(slope, abs=1e-12)
    assert order.constant == pytest.approx(7.0, rel=1e-11)
    assert order.interval < 1e-10
    assert order.points == 6


@pytest.mark.slow
def test_the_interval_covers_the_slope_as_often_as_it_says():
    """2000 trials at 95 %: the share has the standard deviation 0.5 %, three of them are allowed."""
    rng = np.random.default_rng(7)
    steps = 0.1 / 2.0 ** np.arange(7)
    inside = 0
    for _ in range(2000):
        order = observed_order(steps, 3.0 * steps**2 * np.exp(rng.normal(0.0, 0.3, len(steps))))
        inside += abs(order.slope - 2.0) <= order.interval
    assert abs(inside / 2000 - 0.95) < 0.015


def test_too_few_points_have_no_slope_or_no_interval():
    assert np.isnan(observed_order([], []).slope)
    assert np.isnan(observed_order([0.1], [1.0]).slope)
    two = observed_order([0.1, 0.05], [4.0, 1.0])
    assert two.slope == pytest.approx(2.0)
    assert np.isnan(two.interval)
    assert str(two) == "2.00 (two points)"


# ---------------------------------------------------------------- lag and decay, mode by mode


def signal(system: sb.System, late: np.ndarray, decay: np.ndarray, noise: float) -> Trajectory:
    """A run whose mode j turns by late_j too slowly and decays decay_j too fast, with a ripple upon it."""
    basis = modes(system)
    assert basis is not None
    t = np.arange(0.0, 4.0, 0.005)
    own = 0.5 * basis.damping
    turning = np.sqrt(basis.omega**2 - own**2)
    z = np.exp(np.outer(t, -(own + decay) + 1j * (turning - late)))
    z = z * (1.0 + noise * np.cos(37.0 * t)[:, None]) * (1.0 + noise * 1j * np.sin(41.0 * t)[:, None])
    # z = c' - conj(lambda) c with lambda = -own + i turning
    c = z.imag / turning
    rate = z.real - own * c
    q, v = (x @ basis.shapes.T for x in (c, rate))
    return Trajectory(
        t=t, tip=q[:, -1], tip_velocity=v[:, -1], contacts=(), work=Work(), provenance={"dt": 0.005}, system=system,
        pieces=lambda: iter([(t, q, v)]),
    )  # fmt: skip


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_a_lag_and_a_decay_put_into_a_run_are_found_within_the_stated_error(noise, damping):
    stiffness = np.array([[500.0, -200.0], [-200.0, 300.0]])
    system = sb.System.from_matrices(np.diag([1.0, 2.0]), stiffness, damping=damping * stiffness, observe=[0.0, 1.0])
    basis = modes(system)
    assert basis is not None
    late, decay = np.array([0.11, -0.3]), np.array([0.02, 0.3])
    found = free_mode_errors(signal(system, late, decay, noise))
    own = 0.5 * basis.damping
    turning = np.sqrt(basis.omega**2 - own**2)
    elongation = turning / (turning - late) - 1.0
    ratio = (own + decay) / np.hypot(own + decay, turning - late)
    # Rounding: ln z and its phase are good to some eps over a span of a few units.
    assert np.all(np.abs(found.period_elongation - elongation) <= found.elongation_error + 1e-12)
    assert np.all(np.abs(found.damping_ratio - ratio) <= found.damping_error + 1e-12)
    assert np.all(found.elongation_error < (1e-10 if noise == 0.0 else 0.1 * np.abs(elongation)))


def test_a_run_that_is_not_free_is_refused(table10):
    system = sb.semidiscretise(table10, 6)
    with pytest.raises(InputError, match="free"):
        free_mode_errors(sb.integrate(system, sb.HHT(), 1e-3, 0.1))


@pytest.mark.parametrize("viscosity", [0.0, 0.02])
def test_every_scheme_is_as_late_and_as_damped_as_theory_says(viscosity):
    case = paper_case(10)
    case = replace(case, cells=6, problem=replace(case.problem, viscosity=viscosity))
    labels = [str(scheme) for scheme in registered()]
    records = study("modes", case, schemes=labels, dt=2e-4, steps=1500)
    assert not records.failures
    measured = [row for row in records.rows if np.isfinite(row["period_elongation"])]
    assert {row["scheme"] for row in measured if row["mode"] == 1} == set(labels)
    assert len(measured) > 0.8 * len(records.rows)
    for row in measured:
        for name in ("period_elongation", "damping_ratio"):
            # The modal coordinates are good to eps (w_max/w_1)^2 of the basis.
            distance = abs(row[name] - row[f"{name}_theory"])
            assert distance <= row[f"{name}_error"] + 1e-10, (row["scheme"], row["mode"], name)


# ---------------------------------------------------------------- rigid stops


def oscillator(stiffness: float, kappa: float, lower: float, upper: float, start: float, speed: float) -> sb.System:
    stops = sb.Stops(lower, upper, stiffness=kappa)
    return sb.System.from_matrices(
        [[2.0]], [[stiffness]], contacts=[sb.Contact(row=[1.0], stops=stops)],
        initial_displacement=[start], initial_velocity=[speed],
    )  # fmt: skip


def test_a_mass_on_a_spring_bounces_when_it_must():
    """q = A sin(w t) until A sin = g; then from stop to stop in 2 asin(g/A)/w, the speed turned round."""
    omega, amplitude, g = 3.0, 0.5, 0.2
    system = oscillator(2.0 * omega**2, 1e4, -g, g, 0.0, amplitude * omega)
    found = rigid_limit(system, 20.0)
    first = np.arcsin(g / amplitude) / omega
    expected = first * (1.0 + 2.0 * np.arange(found.impacts.count))
    assert found.impacts.count == int((20.0 / first + 1.0) // 2)
    assert np.max(np.abs(found.impacts.times - expected)) < 1e-12
    assert list(found.impacts.stops[:4]) == [1, -1, 1, -1]
    impulse = 2.0 * 2.0 * omega * np.sqrt(amplitude**2 - g**2)
    assert np.allclose(found.impacts.impulses, impulse, rtol=1e-12)
    # Between two impacts it is the same sine, mirrored.
    u, _ = found.at(expected[0] + np.array([0.5, 1.0]) * first)
    assert np.allclose(u, [amplitude * np.sin(0.5 * omega * first), 0.0], atol=1e-13)


def test_a_free_mass_bounces_at_even_intervals():
    found = rigid_limit(oscillator(0.0, 1e4, -0.3, 0.5, 0.1, 2.0), 10.0)
    expected = 0.2 + 0.4 * np.arange(found.impacts.count)
    assert found.impacts.count == 25
    assert np.max(np.abs(found.impacts.times - expected)) < 1e-12


def test_compliant_stops_approach_rigid_ones_at_rate_one_half():
    """Each contact costs half a period pi sqrt(m/kappa) of the mass on its spring, and so much the tip lags."""
    omega, amplitude, g = 3.0, 0.5, 0.2
    first = np.arcsin(g / amplitude) / omega
    end, count = 6.0 * first, 3
    kappas = 4.0 ** np.arange(10, 16)
    rigid = rigid_limit(oscillator(2.0 * omega**2, 1.0, -g, g, 0.0, amplitude * omega), end)
    assert rigid.impacts.count == count
    errors = []
    for kappa in kappas:
        compliant = sb.reference(oscillator(2.0 * omega**2, kappa, -g, g, 0.0, amplitude * omega), end)
        errors.append(abs(compliant.at(end)[0][0] - rigid.at(end)[0][0]))
    # At the end the mass passes the middle with its largest speed.
    expected = amplitude * omega * count * np.pi * np.sqrt(2.0 / kappas)
    assert abs(observed_order(1.0 / kappas, errors).slope - 0.5) < 0.01
    assert errors[-1] == pytest.approx(expected[-1], rel=0.01)


@pytest.mark.parametrize("form", FORMS)
def test_the_ledger_of_rigid_stops_closes_without_them(form, table10):
    """Elastic impacts take nothing: kinetic and elastic energy change by the work put in, to rounding."""
    found = rigid_limit(sb.semidiscretise(table10, 10, form), 0.5)
    assert found.impacts.count > 10
    ledger = found.energy
    had = np.max(np.abs(ledger.input) + ledger.energy)
    assert np.max(np.abs(ledger.stops)) == 0.0
    # Every impact rounds the state by eps (w_max/w_1) of its largest velocity.
    omega = modes(sb.semidiscretise(table10, 10, form)).omega
    rounding = np.finfo(float).eps * omega[-1] / omega[0] * found.impacts.count
    assert np.max(np.abs(ledger.kinetic + ledger.elastic - ledger.energy[0] - ledger.input)) < 10 * rounding * had
    assert np.max(np.abs(ledger.viscous)) == 0.0


def test_rigid_stops_refuse_what_they_cannot_take(table10):
    with pytest.raises(InputError, match="undamped"):
        rigid_limit(sb.semidiscretise(replace(table10, viscosity=0.1), 6), 0.1)
    with pytest.raises(InputError, match="one contact"):
        rigid_limit(sb.semidiscretise(replace(table10, stops=None), 6), 0.1)
    with pytest.raises(InputError, match="between rigid stops"):
        rigid_limit(oscillator(1.0, 1e4, -0.3, 0.5, 0.6, 0.0), 1.0)
    with pytest.raises(InputError, match="t_end"):
        rigid_limit(oscillator(1.0, 1e4, -0.3, 0.5, 0.1, 0.0), -1.0)
    moving = sb.Contact(row=[1.0], stops=sb.Stops(upper=1.0, stiffness=1.0), offset=sb.Constant(0.1))
    with pytest.raises(InputError, match="offset"):
        rigid_limit(sb.System.from_matrices([[1.0]], [[1.0]], contacts=[moving]), 1.0)


# ---------------------------------------------------------------- the beam in closed form


def test_the_roots_solve_the_frequency_equation():
    found = closed_form.roots(12)
    assert np.allclose(found[:3], [1.875104068711961, 4.694091132974175, 7.854757438237613], rtol=1e-15)
    assert np.all(np.diff(found) > 2.5)
    assert np.max(np.abs(np.cos(found) + 1.0 / np.cosh(found))) < 1e-14
    assert np.allclose(found, beam_roots(12), rtol=1e-14)


@pytest.mark.parametrize("i", [0, 1, 4])
def test_the_modes_are_clamped_and_free_where_they_should_be(i):
    """Derivatives of a Chebyshev interpolant: X = X' = 0 at the clamp, X'' = X''' = 0 at the tip."""
    root = closed_form.roots(6)[i]
    interpolant = np.polynomial.Chebyshev.interpolate(lambda x: closed_form.mode(root, x), 48, [0.0, 1.0])
    size = np.abs(closed_form.mode(root, 1.0))
    for derivative, x in ((0, 0.0), (1, 0.0), (2, 1.0), (3, 1.0)):
        value = interpolant.deriv(derivative)(x) if derivative else interpolant(x)
        # Each derivative of a polynomial of degree 48 amplifies rounding by up to 48^2.
        assert abs(value) < 1e-14 * size * (2 * 48**2) ** derivative
    inside = np.linspace(0.2, 0.8, 7)
    assert np.allclose(interpolant.deriv(4)(inside), root**4 * interpolant(inside), atol=1e-5 * root**4 * size)
    assert np.allclose(closed_form.mode(root, inside), beam_mode(root, inside), rtol=1e-11)


def test_the_modes_are_orthogonal():
    x, w = np.polynomial.legendre.leggauss(120)
    shapes = np.array([closed_form.mode(root, 0.5 * (x + 1.0)) for root in closed_form.roots(8)])
    gram = shapes @ np.diag(0.5 * w) @ shapes.T
    sizes = np.sqrt(np.diag(gram))
    assert np.max(np.abs(gram / np.outer(sizes, sizes) - np.eye(8))) < 1e-12


@pytest.mark.parametrize("form", FORMS)
def test_the_grids_frequencies_approach_the_beams_at_order_two(form, table10):
    free = replace(table10, stops=None)
    exact = closed_form.natural_frequencies(free, 3)
    assert exact[0] == pytest.approx(3.5160152685 * np.sqrt(300.0), rel=1e-10)
    cells = [40, 57, 80]
    errors = [np.abs(modes(sb.semidiscretise(free, n, form)).omega[:3] / exact - 1.0) for n in cells]
    for j in range(3):
        assert abs(observed_order(1.0 / np.array(cells), [e[j] for e in errors]).slope - 2.0) < 0.1


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
    exact = closed_form.tip_response(problem)
    cells = np.array([40, 57, 80])
    errors = [abs(tip_ratio(problem, int(n)) - exact) for n in cells]
    assert errors[-1] < 3e-3 * abs(exact)
    assert abs(observed_order(1.0 / cells, errors).slope - 2.0) < 0.1


def test_a_slow_clamp_carries_the_tip_along():
    slow = sb.BeamProblem(stiffness=300.0, base=sb.Harmonic(amplitude=0.2, frequency=1e-3))
    # ratio = 1 + O(a^2/k^2)
    assert abs(closed_form.tip_response(slow) - 1.0) < 1e-3**2 / 300.0
    with pytest.raises(InputError, match="harmonic base"):
        closed_form.tip_response(replace(slow, base=None))
    load = sb.PointLoad(position=0.5, time=sb.Constant(1.0))
    with pytest.raises(InputError, match="no loads"):
        closed_form.tip_response(replace(slow, loads=(load,)))


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


# ---------------------------------------------------------------- the ledger


VIEWS = ("displacement", "velocity-curvature", "first order", "damped")


@pytest.fixture(scope="module", params=VIEWS)
def view(request, table10):
    """A small beam in contact at once, as each form and march sees it."""
    problem = replace(table10, stops=sb.Stops(-0.002, 0.002, stiffness=1e5))
    if request.param == "damped":
        problem = replace(problem, viscosity=0.01)
    system = sb.semidiscretise(problem, 5, request.param if request.param in FORMS else "displacement")
    return system, system.first_order() if request.param == "first order" else system


@pytest.mark.fast(20)
@pytest.mark.parametrize("scheme", list(registered()), ids=str)
def test_the_ledger_of_every_scheme_and_form_balances(scheme, view):
    system, chosen = view
    if scheme.second_order_only and chosen is not system:
        with pytest.raises(InputError):
            sb.integrate(chosen, scheme, 1e-3, 0.2)
        return
    run = sb.integrate(chosen, scheme, 1e-3, 0.2)
    ledger, (q, v) = run.energy, run.states
    assert run.contacts[0].fraction > 0.1
    assert np.max(ledger.stops) > 0.0
    scale = np.max(np.abs(ledger.energy)) + np.max(np.abs(ledger.input))
    rounding = len(run.t) * np.finfo(float).eps * scale
    total = ledger.kinetic + ledger.elastic + ledger.stops
    assert np.max(np.abs(total - system.energy(run.t, q, v))) <= rounding
    balance = ledger.energy - ledger.energy[0] - ledger.input + ledger.viscous + ledger.loss
    assert np.max(np.abs(balance)) <= rounding
    assert np.max(np.abs(ledger.loss - ledger.contact - ledger.free)) <= rounding
    # Input, viscous loss and energy once more, straight from the states of every step.
    dq, force = np.diff(q, axis=0), np.array([system.load(t) for t in run.t])
    work = np.cumsum([0.5 * (force[n] + force[n + 1]) @ dq[n] for n in range(len(dq))])
    viscous = np.cumsum([d @ system.damping @ d / 1e-3 for d in dq])
    assert np.max(np.abs(ledger.input[1:] - work)) <= 10 * rounding
    assert np.max(np.abs(ledger.viscous[1:] - viscous)) <= 10 * rounding
    kinetic = 0.5 * np.einsum("ki,ij,kj->k", v, system.mass, v)
    assert np.max(np.abs(ledger.kinetic - kinetic)) <= 10 * rounding
    if system.damped:
        assert ledger.viscous[-1] > 1e-3 * scale


def test_one_step_tried_twice_has_no_order():
    from stiffbeam.measures.regression import observed_order

    assert np.isnan(observed_order([0.1, 0.1], [1e-3, 1e-3]).slope)
