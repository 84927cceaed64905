"""Schemes for rigid stops: steps of plain loops, known motions, order; in ensembles, comparisons, cases and files."""

from __future__ import annotations

import numpy as np
import pytest
from bouncing_bar import bouncing_bar, pressure
from rigid_chain import INF, chain
from rigid_loops import Loop
from systems import one_mass

import stiffbeam as sb
from stiffbeam.files.cases import parse_case

SCHEMES = {
    "moreau_jean": sb.MoreauJean(),
    "paoli_schatzman": sb.PaoliSchatzman(),
    "contact_stabilised": sb.ContactStabilisedNewmark(),
    "nonsmooth_alpha": sb.NonsmoothGeneralisedAlpha(),
    "backward_euler": sb.Theta(1.0),
}


@pytest.mark.fast(12)
@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize(
    ("contacts", "damping", "moving"),
    [(1, "none", False), (1, "stiffness", True), (1, "coupling", False), (2, "none", True), (2, "coupling", False)],
)
def test_every_step_is_that_of_a_plain_loop(name, contacts, damping, moving):
    scheme = SCHEMES[name]
    e = 0.6 if getattr(scheme, "restitutes", False) else None
    system, loop = chain(contacts, damping, moving, e)
    dt, steps = 0.02, 250
    run = sb.integrate(system, scheme, dt, steps * dt)
    wanted = getattr(loop, name)(system.q0, system.v0, dt, steps)
    q, v = run.states
    assert np.max(np.abs(q - [x for x, _, _ in wanted])) < 1e-10
    assert np.max(np.abs(v[1:] - [x for _, x, _ in wanted[1:]])) < 1e-8
    for c, contact in enumerate(run.contacts):
        assert contact.impacts.count >= 2
        assert np.max(np.abs(contact.force - [x[c] for _, _, x in wanted])) < 1e-6 * np.max(np.abs(contact.force))
        assert contact.impulse == pytest.approx(dt * np.sum(np.abs([x[c] for _, _, x in wanted])), rel=1e-9)


@pytest.mark.parametrize("damping", ["none", "stiffness"])
def test_free_motion_under_a_constant_load_is_exact_for_moreau_jean_and_bilbao(damping):
    system, _ = chain(1, damping, e=0.5)
    load = [(np.array([1.0, 0.0, 2.0, 0.0]), sb.Constant(0.7))]
    free = sb.System.from_matrices(
        system.mass, system.stiffness, system.damping, load, observe=np.eye(4)[3], initial_velocity=system.v0
    )
    run = sb.integrate(free, sb.MoreauJeanBilbao(), 0.3, 30.0)
    assert np.max(np.abs(run.tip - sb.reference(free, 30.0, t_eval=run.t).tip)) < 1e-12


def on_the_bar(scheme, e=None, cells=100):
    """(energy gained over three periods in units of m g h, rms of the pressure on [300, 500], deepest penetration)."""
    dt = 10.0 / cells / 30.0
    system = bouncing_bar(cells) if e is None else bouncing_bar(cells, restitution=e)
    run = sb.integrate(system, scheme, dt, 16.0)
    inside = (run.t > 1.05) & (run.t < 5.0 / 3.0 - 0.05)
    error = run.contact_force[inside] - pressure(run.t[inside] - 0.5 * dt)
    gained = (run.energy.energy[-1] - run.energy.energy[0] - run.energy.input[-1]) / 500.0
    return gained, np.sqrt(np.mean(error**2)), max(0.0, -np.min(run.tip))


@pytest.mark.fast(4)
@pytest.mark.parametrize(
    ("scheme", "e", "gained", "rms", "deepest"),
    [
        (sb.MoreauJean(), 1.0, (-1e-12, 1e-12), (400.0, 404.0), (0.03, 0.04)),
        (sb.MoreauJean(), 0.0, (-0.05, -0.02), (0.2, 0.7), (0.01, 0.03)),
        (sb.PaoliSchatzman(), 1.0, (0.85, 0.87), (20.0, 21.5), (0.05, 0.06)),
        (sb.PaoliSchatzman(), 0.0, (-0.04, -0.02), (0.2, 1.1), (0.0, 1e-13)),
        (sb.ContactStabilisedNewmark(), None, (-0.045, -0.03), (0.2, 0.7), (0.0, 1e-13)),
        (sb.NonsmoothGeneralisedAlpha(), 0.0, (-0.06, -0.05), (0.2, 0.7), (0.0, 1e-13)),
        (sb.NonsmoothGeneralisedAlpha(1.0), 0.0, (-0.025, -0.015), (0.2, 0.7), (0.0, 1e-13)),
        (sb.Trapezoidal(), None, (50.0, 500.0), (300.0, INF), (0.0, 1e-13)),
    ],
)
def test_the_bouncing_bar(scheme, e, gained, rms, deepest):
    """The last digits are chaos: measured, the intervals say what is known of each."""
    for found, (low, high) in zip(on_the_bar(scheme, e), (gained, rms, deepest), strict=True):
        assert low <= found <= high


@pytest.mark.parametrize("rho", [0.0, 0.5, 1.0])
def test_contacts_that_close_together_keep_their_gaps_under_damping_that_couples_the_modes(rho):
    """The positions of nonsmooth generalised-alpha react by (M + a C + b K)^-1 (M + a C) M^-1, which is not symmetric:
    as if it were, gaps were violated by 1e-3 of the motion."""
    rng = np.random.default_rng(1)
    pull, n = rng.normal(size=3), 3
    M, K = np.diag([1.0, 2.0, 0.5]), 4.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    C, B = 2.0 * np.outer(pull, pull), np.array([[1.0, 0.4, 0.0], [0.0, 1.0, 0.3], [0.2, 0.0, 1.0]])
    lower, upper, e = np.full(n, -INF), np.array([0.1, 0.05, 0.0]), np.array([0.0, 0.5, 0.8])
    load = np.array([3.0, 4.0, 1.0])
    stops = [sb.Stops(upper=g, stiffness=INF, restitution=x) for g, x in zip(upper, e, strict=True)]
    loads, contacts = [(load, sb.Harmonic(1.0, 2.0, 0.5))], [sb.Contact(*x) for x in zip(B, stops, strict=True)]
    system = sb.System.from_matrices(M, K, C, loads=loads, contacts=contacts)
    run = sb.integrate(system, sb.NonsmoothGeneralisedAlpha(rho), 0.1, 10.0)
    together = np.sum([contact.force != 0.0 for contact in run.contacts], axis=0)
    assert np.count_nonzero(together >= 2) >= 5
    still = np.zeros(n)
    loop = Loop(M, C, K, B, lower, upper, e, lambda t: load * np.sin(2.0 * t + 0.5), lambda t: still, lambda t: still)
    wanted = loop.nonsmooth_alpha(still, still, 0.1, 100, rho)
    assert np.max(np.abs(run.states[0] - [q for q, _, _ in wanted])) < 1e-12
    for c, contact in enumerate(run.contacts):
        assert np.max(contact.position) - upper[c] < 1e-14


def test_a_body_that_rests_on_its_stop_stays_there():
    """Weight 3 on a spring-free mass: the reaction is the weight from the first step on. Moreau and Jean's lets go
    where rounding leaves a gap, for a step."""
    for e, scheme in ((0.5, sb.MoreauJean()), (None, sb.Trapezoidal()), (None, sb.ContactStabilisedNewmark())):
        stops = sb.Stops(lower=0.0, stiffness=INF, restitution=e)
        system = one_mass(0.0, stops, load=sb.Constant(-3.0))
        run = sb.integrate(system, scheme, 0.01, 1.0)
        assert np.max(np.abs(run.tip)) < (1e-15 if e is None else 3.0 * 0.01**2)
        assert run.contacts[0].impulse == pytest.approx(3.0, rel=1e-12 if e is None else 0.02)
        if e is None:
            assert np.allclose(run.contact_force[1:], 3.0, rtol=1e-12)
            assert run.impacts.count == 0  # it was there before


def test_an_equilibrium_on_a_stop_is_no_motion():
    """Held at a gap that is not zero, several unknowns: the predicted position is short of the stop by its rounding."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        n = int(rng.integers(2, 5))
        B, load, row = rng.normal(size=(n, n)), np.ones(n), np.eye(n)[n - 1]
        K, M = B @ B.T + np.eye(n), np.diag(rng.uniform(0.5, 2.0, n))
        g = 0.5 * np.linalg.solve(K, load)[-1]
        held = np.block([[K, -row[:, None]], [row[None], np.zeros((1, 1))]])
        *q, R = np.linalg.solve(held, np.append(load, g))
        if g <= 0.0 or R >= 0.0:
            continue
        stops, loads = sb.Stops(upper=g, stiffness=INF, restitution=0.5), [(load, sb.Constant(1.0))]
        contact = sb.Contact(row, stops)
        start = [*q[:-1], g]
        system = sb.System.from_matrices(M, K, loads=loads, contacts=[contact], initial_displacement=start)
        run = sb.integrate(system, sb.MoreauJean(), 1e-2, 5.0)
        assert np.max(np.abs(run.contacts[0].position - g)) < 1e-12
        assert run.impacts.count == 0
        assert run.contacts[0].impulse == pytest.approx(5.0 * abs(R), rel=1e-9)


def test_an_ensemble_has_the_bits_of_its_members():
    system, _ = chain(1, e=0.5)
    members = sb.perturbed_members(system, 3, scale=1e-3)
    found = sb.integrate_ensemble(system, sb.MoreauJean(), 0.02, 4.0, members)
    solo = [sb.integrate(member, sb.MoreauJean(), 0.02, 4.0) for member in members]
    assert np.array_equal([run.contacts[0].impulse for run in solo], found.impulse)


@pytest.mark.parametrize(
    "scheme",
    [sb.MoreauJean(), sb.PaoliSchatzman(), sb.NonsmoothGeneralisedAlpha(1.0), sb.MoreauJeanBilbao()],
    ids=lambda scheme: scheme.name,
)
@pytest.mark.fast(1)
def test_through_an_impact_every_scheme_is_of_first_order(scheme):
    """x'' + x = 0 from x = 0 with speed 1 meets the stop at 1/2 after pi/6 and comes back with e times its speed.

    A single run's slope is noise, since where in the step the impact lies is chance: 12 starts for each step.
    """
    e, stops = 0.6, sb.Stops(upper=0.5, stiffness=INF, restitution=0.6)
    dts, errors = [], []
    for steps in (100, 200, 400, 800):
        dt = 1.2 / steps
        for start in np.arange(12) / 12.0 * dt:
            q, v = np.sin(start), np.cos(start)
            one = one_mass(1.0, stops, q=q, v=v)
            run = sb.integrate(one, scheme, dt, 1.2)
            after = run.t[-1] + start - np.pi / 6.0
            dts.append(dt)
            errors.append(abs(run.tip[-1] - 0.5 * np.cos(after) + e * np.sqrt(0.75) * np.sin(after)))
    slope = np.polyfit(np.log(dts), np.log(errors), 1)[0]
    assert 0.75 < slope < 1.25  # the scatter over starts is a factor of ten
    assert max(errors[-12:]) < 2.0 * dts[-1]


def test_a_comparison_pairs_the_impacts_that_each_has_itself():
    system, _ = chain(1, e=0.5)
    run, reference = sb.integrate(system, sb.MoreauJean(), 0.002, 2.0), sb.reference(system, 2.0)
    found = sb.compare(run, reference)
    (contact,) = found.contacts
    assert contact.run.impacts == run.contacts[0].impacts.until(found.window).count
    assert contact.reference.impacts == reference.contacts[0].impacts.until(found.window).count
    assert np.isnan(contact.run.peak_force)
    assert contact.run_totals.impulse == run.contacts[0].impulse
    assert found.tip_error_to(found.matched_until) < 0.02
    assert abs(contact.matching.first_error) < 0.02


def test_a_case_file_can_have_rigid_stops():
    text = """
[[case]]
name = "wall"
cells = 6
dt = 1e-4
t_end = 0.1
runs = ["moreau-jean", "NonsmoothGeneralisedAlpha(rho=0.8)"]
[case.problem]
stiffness = 300.0
stops = { lower = -0.1, upper = 0.1, stiffness = inf, restitution = 0.5 }
base = { amplitude = 0.2, frequency = 10.0 }
"""
    case = parse_case(text, "wall.toml")
    assert case.problem.stops == sb.Stops(lower=-0.1, upper=0.1, stiffness=INF, restitution=0.5)
    assert [str(scheme) for scheme, _ in case.runs] == ["MoreauJean(theta=0.5)", "NonsmoothGeneralisedAlpha(rho=0.8)"]
    for scheme, form in case.runs:
        assert sb.integrate(sb.semidiscretise(case.problem, 6, form), scheme, case.dt, case.t_end).impacts.count > 0


def test_a_run_is_saved_with_its_stops(tmp_path):
    system, _ = chain(1, e=0.5)
    run = sb.integrate(system, sb.MoreauJean(), 0.02, 4.0)
    again = sb.load(run.save(tmp_path / "run.nc"))
    assert again.contacts[0].stops == system.contacts[0].stops
    assert np.array_equal(again.contacts[0].impacts.impulses, run.contacts[0].impacts.impulses, equal_nan=True)
