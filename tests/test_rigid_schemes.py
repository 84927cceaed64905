"""Schemes for rigid stops against plain loops, their own energy identities, a known answer, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from bouncing_bar import bouncing_bar, pressure
from rigid_loops import Loop

import stiffbeam as sb
from stiffbeam import InputError
from stiffbeam.files.cases import parse_case

INF = float("inf")
SCHEMES = {
    "moreau_jean": sb.MoreauJean(),
    "paoli_schatzman": sb.PaoliSchatzman(),
    "contact_stabilised": sb.ContactStabilisedNewmark(),
    "nonsmooth_alpha": sb.NonsmoothGeneralisedAlpha(),
    "backward_euler": sb.Theta(1.0),
}


def chain(contacts=1, damping="none", moving=False, e=None):
    """Four masses in a row, driven, with stops at one or two of them: the System and the same as a Loop."""
    M, n = np.diag([1.0, 0.7, 1.3, 0.8]), 4
    K = 40.0 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    C = {"none": np.zeros((n, n)), "stiffness": 0.004 * K, "coupling": np.diag([0.0, 0.0, 0.0, 1.5])}[damping]
    B = np.eye(n)[[3, 1][:contacts]]
    lower, upper = np.array([-0.3, -0.25][:contacts]), np.array([0.2, INF][:contacts])
    motion = sb.Harmonic(0.03, 5.0, 0.3)
    load, drive = np.array([0.0, 6.0, 0.0, -3.0]), sb.Harmonic(3.0, 4.0, 1.0)
    stops = [
        sb.Stops(lower=lo, upper=None if hi == INF else hi, stiffness=INF, restitution=e)
        for lo, hi in zip(lower, upper, strict=True)
    ]
    offsets = [motion if moving else None, None][:contacts]
    system = sb.System.from_matrices(
        M, K, C, loads=[(load, drive)], initial_velocity=[0.0, 0.5, 1.0, -0.5],
        contacts=[sb.Contact(*x) for x in zip(B, stops, offsets, strict=True)],
    )  # fmt: skip
    on = np.array([1.0, 0.0][:contacts]) * moving
    loop = Loop(
        M, C, K, B, lower, upper, np.full(contacts, e or 0.0), lambda t: load * float(drive.value(t)),
        lambda t: on * float(motion.value(t)), lambda t: on * float(motion.rate(t)),
    )  # fmt: skip
    return system, loop


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


def steps_of(system, scheme, dt, steps):
    """q, v, reactions (steps, contacts), energies, impulses of the load, all of an undamped system at every step."""
    run = sb.integrate(system, scheme, dt, steps * dt)
    q, v = run.states
    R = np.stack([c.force[1:] for c in run.contacts], axis=1)
    assert np.any(R)
    return run, q, v, R, system.energy(run.t, q, v)


@pytest.mark.parametrize("e", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("theta", [0.5, 0.6, 1.0])
def test_the_energy_of_moreau_and_jean(theta, e):
    """The docstring's identity; its last term where the law of restitution is met with equality."""
    system, _ = chain(2, e=e)
    dt = 0.02
    run, q, v, R, E = steps_of(system, sb.MoreauJean(theta), dt, 400)
    f = system.load(run.t)
    dq, dv = np.diff(q, axis=0), np.diff(v, axis=0)
    work = np.sum(((1.0 - theta) * f[:-1] + theta * f[1:]) * dq, axis=1)
    squares = np.sum(dv * (dv @ system.mass) + dq * (dq @ system.stiffness), axis=1)
    U = v @ np.array([c.row for c in system.contacts]).T
    of_impacts = (1.0 - theta * (1.0 + e)) * np.sum(U[:-1] * dt * R, axis=1)
    rest = np.diff(E) - work - (0.5 - theta) * squares - of_impacts
    assert np.max(np.abs(rest)) < 1e-12 * np.max(E)


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_the_energy_of_paoli_and_schatzman(e):
    system, loop = chain(2, e=e)
    dt, beta = 0.02, 0.3
    run, q, v, R, _ = steps_of(system, sb.PaoliSchatzman(beta), dt, 400)
    middle = q[1:] - 0.5 * dt * v[1:]
    K, M = system.stiffness, system.mass
    E = 0.5 * np.sum(v[1:] * (v[1:] @ (M + (beta - 0.25) * dt**2 * K)) + middle * (middle @ K), axis=1)
    across = q[2:] - q[:-2]
    work = 0.5 * np.sum(system.load(run.t)[1:-1] * across, axis=1)
    side = np.where(R[1:] < 0.0, loop.upper, loop.lower)
    with np.errstate(invalid="ignore"):
        gap = np.where(R[1:] != 0.0, (q @ loop.B.T)[:-2] - side, 0.0)
    taken = (1.0 + e) * np.sum(R[1:] * gap, axis=1) / 2.0
    assert np.max(np.abs(np.diff(E) - work + taken)) < 1e-12 * np.max(E)


def test_the_energy_of_the_contact_stabilised_scheme():
    system, _ = chain(2)
    dt = 0.02
    run, q, v, R, E = steps_of(system, sb.ContactStabilisedNewmark(), dt, 400)
    B, f = np.array([c.row for c in system.contacts]), system.load(run.t)
    dq, a = np.diff(q, axis=0), np.diff(v, axis=0) / dt
    put_back = (dq - dt * v[:-1] - 0.5 * dt**2 * a) @ system.mass  # B^T nu
    work = np.sum(0.5 * (f[1:] + f[:-1]) * dq, axis=1)
    rest = np.diff(E) - work - np.sum(R * (dq @ B.T), axis=1) + np.sum(put_back * a, axis=1)
    assert np.max(np.abs(rest)) < 1e-12 * np.max(E)
    assert np.any(np.abs(put_back) > 1e-6)
    assert np.max(np.abs(np.delete(put_back, [3, 1], axis=1))) < 1e-13  # at the contacts only


@pytest.mark.parametrize("e", [0.0, 0.7])
def test_the_energy_of_the_nonsmooth_generalised_alpha_scheme(e):
    system, _ = chain(2, e=e)
    dt = 0.02
    run, q, v, R, E = steps_of(system, sb.NonsmoothGeneralisedAlpha(1.0), dt, 400)
    B, f = np.array([c.row for c in system.contacts]), system.load(run.t)
    dq, mean_q, mean_f = np.diff(q, axis=0), 0.5 * (q[1:] + q[:-1]), 0.5 * (f[1:] + f[:-1])
    a = np.linalg.solve(system.mass, (mean_f - mean_q @ system.stiffness).T).T
    nu = ((dq - dt * v[:-1] - 0.5 * dt**2 * a) @ system.mass) @ B.T
    U, P = 0.5 * (v[1:] + v[:-1]) @ B.T, dt * R
    rest = np.diff(E) - np.sum(mean_f * dq, axis=1) - np.sum(P * U + (0.5 * dt * P - nu) * (a @ B.T), axis=1)
    assert np.max(np.abs(rest)) < 1e-12 * np.max(E)


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_the_energy_of_moreau_jean_and_bilbao(e):
    system, _ = chain(2, e=e)
    dt = 0.02
    run, q, v, R, _ = steps_of(system, sb.MoreauJeanBilbao(), dt, 400)
    basis = sb.modes(system)
    shapes = basis.shapes / np.sqrt(np.sum(basis.shapes * (system.mass @ basis.shapes), axis=0))
    x, y = (np.linalg.solve(shapes, z[1:].T).T for z in (q, v))
    w = basis.omega
    phi = 4.0 * np.sin(0.5 * w * dt) ** 2 / (w * dt) ** 2
    E = 0.5 * np.sum(y**2 / phi + (w * x) ** 2 - dt * y * w**2 * x, axis=1)
    mean = 0.5 * (v[2:] + v[1:-1])
    B = np.array([c.row for c in system.contacts])
    work = dt * np.sum((system.load(run.t)[1:-1] + R[1:] @ B) * mean, axis=1)
    assert np.max(np.abs(np.diff(E) - work)) < 1e-12 * np.max(E)


@pytest.mark.parametrize("damping", ["none", "stiffness"])
def test_free_motion_under_a_constant_load_is_exact_for_moreau_jean_and_bilbao(damping):
    system, _ = chain(1, damping, e=0.5)
    load = [(np.array([1.0, 0.0, 2.0, 0.0]), sb.Constant(0.7))]
    free = sb.System.from_matrices(
        system.mass, system.stiffness, system.damping, load, observe=np.eye(4)[3], initial_velocity=system.v0
    )
    run = sb.integrate(free, sb.MoreauJeanBilbao(), 0.3, 30.0)
    assert np.max(np.abs(run.tip - sb.reference(free, 30.0, t_eval=run.t).tip)) < 1e-12


def test_moreau_and_jean_lose_what_newtons_law_takes_and_nothing_else():
    system, _ = chain(2, moving=True, e=0.4)
    still, _ = chain(2, e=0.4)
    E = sb.integrate(still, sb.MoreauJean(), 0.01, 5.0).energy
    assert abs(E.loss[-1]) < 1e-12 * np.max(E.energy)
    assert E.stop_dissipation[-1] > 0.1 * np.max(E.energy)
    moved = sb.integrate(system, sb.MoreauJean(), 0.001, 5.0).energy  # the stop's work is a sum over steps
    assert abs(moved.loss[-1]) < 1e-2 * np.max(moved.energy)
    assert np.all(sb.integrate(chain(2)[0], sb.BDF2(), 0.01, 5.0).energy.stop_dissipation == 0.0)


def on_the_bar(scheme, e=None, cells=100):
    """(energy gained over three periods in units of m g h, rms of the pressure on [300, 500], deepest penetration)."""
    dt = 10.0 / cells / 30.0
    system = bouncing_bar(cells) if e is None else bouncing_bar(cells, restitution=e)
    run = sb.integrate(system, scheme, dt, 16.0)
    inside = (run.t > 1.05) & (run.t < 5.0 / 3.0 - 0.05)
    error = run.contact_force[inside] - pressure(run.t[inside] - 0.5 * dt)
    gained = (run.energy.energy[-1] - run.energy.energy[0] - run.energy.input[-1]) / 500.0
    return gained, np.sqrt(np.mean(error**2)), max(0.0, -np.min(run.tip))


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


def test_a_body_that_rests_on_its_stop_stays_there():
    """Weight 3 on a spring-free mass: the reaction is the weight from the first step on. Moreau and Jean's lets go
    where rounding leaves a gap, for a step."""
    for e, scheme in ((0.5, sb.MoreauJean()), (None, sb.Trapezoidal()), (None, sb.ContactStabilisedNewmark())):
        stops = sb.Stops(lower=0.0, stiffness=INF, restitution=e)
        weight = [([1.0], sb.Constant(-3.0))]
        system = sb.System.from_matrices([[1.0]], [[0.0]], loads=weight, contacts=[sb.Contact([1.0], stops)])
        run = sb.integrate(system, scheme, 0.01, 1.0)
        assert np.max(np.abs(run.tip)) < (1e-15 if e is None else 3.0 * 0.01**2)
        assert run.contacts[0].impulse == pytest.approx(3.0, rel=1e-12 if e is None else 0.02)
        if e is None:
            assert np.allclose(run.contact_force[1:], 3.0, rtol=1e-12)
            assert run.impacts.count == 0  # it was there before


def test_an_ensemble_has_the_bits_of_its_members():
    system, _ = chain(1, e=0.5)
    members = sb.perturbed(system, 3, scale=1e-3)
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
            one = sb.System.from_matrices(
                [[1.0]], [[1.0]], contacts=[sb.Contact([1.0], stops)], initial_displacement=[q], initial_velocity=[v]
            )
            run = sb.integrate(one, scheme, dt, 1.2)
            after = run.t[-1] + start - np.pi / 6.0
            dts.append(dt)
            errors.append(abs(run.tip[-1] - 0.5 * np.cos(after) + e * np.sqrt(0.75) * np.sin(after)))
    slope = np.polyfit(np.log(dts), np.log(errors), 1)[0]
    assert 0.75 < slope < 1.25  # the scatter over starts is a factor of ten
    assert max(errors[-12:]) < 2.0 * dts[-1]


def test_members_are_all_of_one_kind():
    system, _ = chain(1)
    soft = sb.System.from_matrices(
        system.mass, system.stiffness, loads=system.loads,
        contacts=[sb.Contact(system.contacts[0].row, sb.Stops(lower=-0.3, upper=0.2, stiffness=1e3))],
    )  # fmt: skip
    with pytest.raises(InputError, match=r"member|matrices|load"):
        sb.integrate_ensemble(system, sb.BDF2(), 0.02, 1.0, [system, soft])
    with pytest.raises(InputError, match="members"):
        sb.integrate_ensemble(system, sb.BDF2(), 0.02, 1.0, sb.varied(system, stops=[soft.contacts[0].stops]))


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: sb.integrate(chain(1)[0], sb.MoreauJean(), 0.01, 1.0), "restitution"),
        (lambda: sb.integrate(chain(1, e=0.5)[0], sb.BDF2(), 0.01, 1.0), "restitution"),
        (lambda: sb.integrate(chain(1)[0], sb.ExponentialFlow(), 0.01, 1.0), "argument"),
        (lambda: sb.integrate(chain(1)[0], sb.BDF2(), 0.01, 1.0, contact="conserving"), "contact|conserve"),
        (lambda: sb.integrate(chain(1)[0], sb.BDF2(), 0.01, 1.0, contact="extrapolated"), "contact"),
        (lambda: sb.integrate(chain(1)[0], sb.BDF2(), 0.01, 1.0, engine="numpy"), "engine"),
        (lambda: sb.integrate(chain(1)[0].first_order(), sb.BDF2(), 0.01, 1.0), "FirstOrderSystem"),
        (lambda: sb.integrate(chain(1, "coupling", e=0.5)[0], sb.MoreauJeanBilbao(), 0.01, 1.0), "decouple"),
        (lambda: sb.reference(chain(1)[0], 1.0, method="cvode"), "finite"),
        (lambda: sb.reference(chain(1)[0], 1.0, method="multiprecision"), "restitution"),
        (lambda: sb.lyapunov(chain(1)[0], 1.0), "restitution"),
        (lambda: chain(1)[0].rhs(0.0, np.zeros(8)), "finite"),
    ],
)
def test_what_is_refused(call, named):
    with pytest.raises(InputError, match=named):
        call()


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


def test_compliant_stops_and_starts_beyond_rigid_ones_are_refused():
    compliant = sb.System.from_matrices(
        [[1.0]], [[1.0]], contacts=[sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=5.0))]
    )
    with pytest.raises(InputError, match="Trapezoidal"):
        sb.integrate(compliant, sb.MoreauJean(), 0.01, 1.0)
    stops = sb.Stops(upper=0.1, stiffness=INF)
    beyond = sb.System.from_matrices([[1.0]], [[1.0]], contacts=[sb.Contact([1.0], stops)], initial_displacement=[0.2])
    with pytest.raises(InputError, match="between"):
        sb.integrate(beyond, sb.BDF2(), 0.01, 1.0)
    twice = sb.System.from_matrices([[1.0]], [[1.0]], contacts=[sb.Contact([1.0], stops)] * 2)
    with pytest.raises(InputError, match="follow"):
        sb.integrate(twice, sb.BDF2(), 0.01, 1.0)


def test_a_case_file_can_have_rigid_stops():
    text = """
[[case]]
name = "wall"
cells = 6
dt = 1e-4
t_end = 0.1
runs = ["moreau-jean", "nonsmooth-alpha(rho=0.8)"]
[case.problem]
stiffness = 300.0
stops = { lower = -0.1, upper = 0.1, stiffness = inf, restitution = 0.5 }
base = { amplitude = 0.2, frequency = 10.0 }
"""
    case = parse_case(text, "wall.toml")
    assert case.problem.stops == sb.Stops(lower=-0.1, upper=0.1, stiffness=INF, restitution=0.5)
    assert [str(scheme) for scheme, _ in case.runs] == ["moreau-jean(theta=0.5)", "nonsmooth-alpha(rho=0.8)"]
    for scheme, form in case.runs:
        assert sb.integrate(sb.semidiscretise(case.problem, 6, form), scheme, case.dt, case.t_end).impacts.count > 0


def test_a_run_is_saved_with_its_stops(tmp_path):
    system, _ = chain(1, e=0.5)
    run = sb.integrate(system, sb.MoreauJean(), 0.02, 4.0)
    again = sb.load(run.save(tmp_path / "run.nc"))
    assert again.contacts[0].stops == system.contacts[0].stops
    assert np.array_equal(again.contacts[0].impacts.impulses, run.contacts[0].impacts.impulses, equal_nan=True)
