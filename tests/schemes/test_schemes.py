"""Laws of every scheme: its textbook loop, its order, its amplification, its energy, its contract, its label."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from systems import case_of, one_mass, three_masses
from witness import solve

import stiffbeam as sb
from stiffbeam.model.equations import Equation
from stiffbeam.schemes import GAMMA_THIRD_ORDER, RIGID, PrintedSigma, PrintedStageMatrix, UnweightedHHT, registered
from stiffbeam.schemes.labels import parse_run, split_runs
from stiffbeam.schemes.scheme import check_contract
from stiffbeam.schemes.sdirk import GAMMA_MAX, GAMMA_MIN
from stiffbeam.studies.base import chosen

ALL = list(registered())
PRINTED = [UnweightedHHT(-0.1), PrintedSigma()]
CONSERVING = [sb.Trapezoidal(), sb.ExponentialFlow()]


@pytest.mark.parametrize("scheme", [scheme for scheme in ALL if not isinstance(scheme, sb.ExponentialFlow)], ids=str)
def test_a_reaction_acts_as_a_load_does(scheme):
    """So that the textbook's formula under loads is also the one under contact."""
    rng, S = np.random.default_rng(3), len(scheme.nodes)
    equation = Equation(np.diag([1.0, 2.0]), np.diag([0.3, 0.1]), np.array([[5.0, -1.0], [-1.0, 4.0]]))
    z = scheme.initial(equation, list(rng.normal(size=(scheme.history, 2, 2))), rng.normal(size=2))
    force, none = list(rng.normal(size=(S, 2))), [np.zeros(2)] * S
    loaded, reacted = (scheme.step(equation, 0.1, z, *pair) for pair in ((force, none), (none, force)))
    assert np.array_equal(loaded[0], reacted[0])
    assert np.array_equal(loaded[1], reacted[1])


def test_every_scheme_keeps_the_contract_that_integrate_checks_of_others():
    forms, rigid = [scheme.conserving for scheme in CONSERVING], [kind() for kind in RIGID.values()]
    for scheme in [*ALL, *PRINTED, PrintedStageMatrix(), *forms, *rigid]:
        check_contract(scheme)


# ------------------------------------------------------------------ order


def observed(system, scheme, steps, t_end):
    """Slope of log(error) over log(dt) against the matrix exponential, and the error of the finest step."""
    q, v = solve(case_of(system, t_end)).states(np.array([t_end]))
    errors = []
    for n in steps:
        end = [x[-1] for x in sb.integrate(system, scheme, t_end / n, t_end, every=n).states]
        errors.append(np.max(np.abs(np.concatenate([end[0] - q[0], end[1] - v[0]]))))
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0], errors[-1]


@pytest.mark.parametrize("dashpot", [None, 0.3])
@pytest.mark.parametrize("scheme", [*ALL, PRINTED[0], PrintedStageMatrix()], ids=str)
@pytest.mark.fast(24)
def test_every_scheme_has_its_order_on_a_smooth_forced_system(scheme, dashpot):
    """dt <= 0.02 against periods above 2: asymptotic, and far above rounding. A dashpot couples the modes."""
    system = three_masses(None if dashpot is None else np.diag([dashpot, 0.0, 0.0]))
    slope, finest = observed(system, scheme, [200, 280, 400, 560, 800], 4.0)
    assert abs(slope - scheme.order) < 0.1
    assert finest < (0.02 if scheme.order == 1 else 2e-3)
    march = sb.integrate(system, scheme, 0.02, 2.0).provenance["march"]
    assert march == ("modal blocks" if dashpot is None else "dense blocks")


def test_the_printed_sigma_costs_an_order():
    """2.9 at coarse steps, where the third-order error still dominates, falling to 2."""
    system = three_masses()
    assert observed(system, PRINTED[1], [50, 70, 100], 4.0)[0] > 2.8
    assert abs(observed(system, PRINTED[1], [6400, 9000, 12800], 4.0)[0] - 2.0) < 0.1


@pytest.mark.parametrize("scheme", CONSERVING, ids=str)
def test_the_conserving_contact_converges_at_order_two(scheme):
    """x'' + 4 x = 0 let go inside a spring stop, whose closed form has one half period on each side."""
    w, a = np.sqrt(24.0), 0.1
    ball, steps = one_mass(4.0, sb.Stops(upper=a, stiffness=20.0), v=1.0), [300, 600, 1200, 2400]
    t = np.arcsin(2.0 * a) / 2.0  # there with speed v, in the stop around ``level`` with frequency w, out with -v
    v, level = np.sqrt(1.0 - 4.0 * a**2), 20.0 * a / w**2
    left = 2.0 - t - 2.0 * np.arctan2(v / w, a - level) / w
    tip = a * np.cos(2.0 * left) - v / 2.0 * np.sin(2.0 * left)
    errors = [abs(sb.integrate(ball, scheme, 2.0 / n, 2.0, "conserving", every=n).tip[-1] - tip) for n in steps]
    assert abs(np.polyfit(np.log(steps), np.log(errors), 1)[0] + 2.0) < 0.3


@pytest.mark.filterwarnings("ignore:gamma = 0.3 evaluates forces")
@pytest.mark.parametrize("gamma", [GAMMA_THIRD_ORDER, 1.0, 0.3])
def test_sdirk_for_rates_and_in_nystroem_form_are_equal(gamma, table10):
    system = sb.semidiscretise(table10, 25)
    runs = [sb.integrate(system, sb.SDIRK(gamma, nystrom=n), 1e-4, 0.1) for n in (False, True)]
    assert np.max(np.abs(runs[0].tip - runs[1].tip)) < 1e-10 * np.max(np.abs(runs[0].tip))
    assert runs[0].impacts.count == runs[1].impacts.count > 0


# ------------------------------------------------------------------ amplification

GRID = np.logspace(-3, 3, 61)
PARAMETERS = [
    *(sb.HHT(a) for a in np.linspace(-1 / 3, 0.0, 4)), *(sb.SDIRK(g) for g in (0.2, 0.35, 0.5, 0.8)),
    *(sb.GeneralisedAlpha(r) for r in np.linspace(0.0, 0.9, 3)),
]  # fmt: skip


@pytest.mark.parametrize("xi", [0.0, 0.05])
@pytest.mark.parametrize("scheme", [*ALL, *PRINTED, *PARAMETERS], ids=str)
def test_the_march_amplifies_like_the_closed_form(scheme, xi):
    """To 1e-10, elongation relative to the period; stable where undamped; damping kept at small steps.

    rho = 1 is the exception: near its triple root -1 the roots move by the third root of rounding over the cube of
    their distance, 3e-10 of eps/|distance|^2 at dt/T = 1000.
    """
    measured, theory = sb.amplification(scheme, GRID, xi), sb.amplification(scheme, GRID, xi, source="closed form")
    defective = isinstance(scheme, sb.GeneralisedAlpha) and scheme.rho == 1.0
    for name in ("spectral_radius", "period_elongation", "damping_ratio"):
        found, wanted = getattr(measured, name), getattr(theory, name)
        scale = 1.0 + np.abs(wanted) if name == "period_elongation" else 1.0
        assert np.array_equal(np.isnan(found), np.isnan(wanted))
        assert np.nanmax(np.abs(found - wanted) / scale) < (1e-8 if defective else 1e-10)
    if scheme in ALL:
        assert np.max(measured.spectral_radius) <= 1.0 + 1e-9
        assert measured.stable_to == np.inf
        x = 2.0 * np.pi * GRID[0]  # every scheme errs by x^2 times a constant below 1
        assert abs(measured.damping_ratio[0] - xi) < x**2
        assert abs(measured.period_elongation[0]) < x**2


# ------------------------------------------------------------------ energy


def let_go(cells: int, **law: float) -> sb.System:
    """A bent beam let go between stops, undamped and without loads."""
    stops = sb.Stops(-0.1, 0.1, **({"stiffness": 5e6} | law))
    bent = sb.PolynomialProfile((0.0, 0.0, 0.3))
    return sb.semidiscretise(sb.BeamProblem(stiffness=300.0, stops=stops, initial_displacement=bent), cells)


def several(m: int, p: float) -> sb.System:
    """Five masses with m contacts on random rows."""
    rng = np.random.default_rng([m, 1])
    A, B = rng.normal(size=(2, 5, 5))
    contacts = [sb.Contact(rng.normal(size=5), sb.Stops(-0.3, 0.2, stiffness=300.0, exponent=p)) for _ in range(m)]
    mass, stiffness = np.eye(5) + 0.1 * A @ A.T, np.eye(5) + B @ B.T
    return sb.System.from_matrices(mass, stiffness, contacts=contacts, initial_velocity=rng.normal(size=5))


@pytest.mark.parametrize("scheme", [*CONSERVING, sb.Theta(0.5)], ids=str)
@pytest.mark.parametrize(
    ("system", "dt", "steps"),
    [*((let_go(25), dt, 400) for dt in (1e-4, 1e-3, 1e-2, 0.1)),
     *((let_go(10, exponent=p), 1e-3, 2000) for p in (1.5, 2.0, 3.0)),
     *((several(m, p), 0.02, 1000) for m in (2, 3) for p in (1.0, 1.5)),
     pytest.param(let_go(25), 1e-4, 10**6, marks=pytest.mark.slow)],
)  # fmt: skip
def test_the_conserving_contact_keeps_the_energy(scheme, system, dt, steps):
    """At any step, under any power law, with several contacts at once: eps of the force at each impact."""
    run = sb.integrate(system, scheme, dt, steps * dt, contact="conserving", every=max(1, steps // 500))
    assert min(c.impacts.count for c in run.contacts) > 3
    energy = run.energy.energy
    assert np.max(np.abs(energy / energy[0] - 1.0)) < 1e-11
    assert np.max(np.abs(run.energy.loss)) < 1e-11 * energy[0]


def test_bdf2_by_hand_after_the_trapezoidal_rule():
    """(4.5): y^1 by the trapezoidal rule, then every step from two before; its contact takes v* from them."""
    k, kappa, h = 4.0, 30.0, 0.05
    A, eye = np.array([[0.0, 1.0], [-k, 0.0]]), np.eye(2)
    free = sb.integrate(one_mass(k, q=-0.2, v=0.3), sb.BDF2(), h, 4 * h)
    y = np.stack(free.states, axis=-1)[:, 0]
    assert np.allclose(y[1], np.linalg.solve(eye - h / 2 * A, (eye + h / 2 * A) @ y[0]), rtol=0.0, atol=1e-15)
    pressed = sb.integrate(
        one_mass(k, sb.Stops(upper=0.0, stiffness=kappa), q=0.2, v=0.3), sb.BDF2(), h, 4 * h, "extrapolated"
    )
    for path, contact in ((y, 0.0), (np.stack(pressed.states, axis=-1)[:, 0], kappa)):
        for before, now, new in zip(path, path[1:], path[2:], strict=False):
            ahead = (4.0 * now[0] - before[0] + 2.0 * h * (2.0 * now[1] - before[1])) / 3.0
            force = np.array([0.0, -contact * max(ahead, 0.0)])
            right = (4.0 * now - before + 2.0 * h * force) / 3.0
            assert np.allclose(new, np.linalg.solve(eye - 2.0 * h / 3.0 * A, right), rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("scheme", CONSERVING)
def test_without_contact_nothing_is_left_to_conserve(scheme):
    runs = [sb.integrate(three_masses(), scheme, 1e-2, 2.0, contact) for contact in ("implicit", "conserving")]
    np.testing.assert_allclose(runs[1].tip, runs[0].tip, rtol=0, atol=1e-13)


@pytest.mark.parametrize("seed", range(8))
def test_the_flow_of_modes_is_the_matrix_exponential(seed):
    """Under a linear force: free, slow, critical and overdamped modes."""
    rng = np.random.default_rng(seed)
    omega = np.array([0.0, 1e-3, 0.3, 0.999, 1.0, 1.7, 30.0]) * 10.0 ** rng.uniform(-1, 1)
    damping = rng.choice([0.0, 0.1, 2.0, 20.0], size=7) * rng.random(7)
    equation, t = Equation(np.ones(7), damping, omega**2), 10.0 ** rng.uniform(-1, 0.5)
    y, f0, f1 = rng.normal(size=(2, 7)), rng.normal(size=7), rng.normal(size=7)
    found = equation.flow(t, y, f0, f1)
    full = Equation(np.eye(7), np.diag(damping), np.diag(omega**2)).flow(t, y, f0, f1)
    for j in range(7):
        A = np.array([[0, 1, 0, 0], [-(omega[j] ** 2), -damping[j], 1, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
        want = scipy.linalg.expm(A * t) @ [*y[:, j], f0[j], (f1[j] - f0[j]) / t]
        scale = np.max(np.abs(want)) + np.max(np.abs(y)) + omega[j] * np.max(np.abs(y))
        assert np.max(np.abs(found[:, j] - want[:2])) < 1e-11 * scale
        assert np.max(np.abs(full[:, j] - want[:2])) < 1e-10 * scale * (1.0 + np.max(omega))


# ------------------------------------------------------------------ a scheme of one's own; labels


class Midpoint(sb.Scheme):
    """k = f(t + theta dt, y + theta dt k): its only node is not the end of the step."""

    def __init__(self, theta: float = 0.5) -> None:
        self.theta, self.nodes = theta, (theta,)

    @property
    def parameters(self):
        return {"theta": self.theta}

    def step(self, equation, dt, z, loads, reactions):
        k = equation.implicit_rate(self.theta * dt, z, loads[0] + reactions[0])
        return z + dt * k, [z + self.theta * dt * k]


class SymplecticEuler(sb.Scheme):
    """v^{n+1} = v^n + dt a^n, q^{n+1} = q^n + dt v^{n+1}: explicit, stable to w dt = 2; no theory stated."""

    nodes = (0.0,)

    def step(self, equation, dt, z, loads, reactions):
        q, v = z
        v_new = v + dt * equation.acceleration(z, loads[0] + reactions[0])
        return np.stack([q + dt * v_new, v_new]), [z]


class Guess(sb.Scheme):
    """Implicit Euler whose force acts on an explicit guess of the end."""

    def step(self, equation, dt, z, loads, reactions):
        y = z + dt * equation.implicit_rate(dt, z, loads[0] + reactions[0])
        return y, [z + dt * z[::-1]]


class Stiffer(sb.HHT):
    """HHT with another step."""

    def step(self, equation, dt, z, loads, reactions):
        return super().step(equation, 0.9 * dt, z, loads, reactions)


def test_a_scheme_of_ones_own_runs_without_registration(table10):
    assert abs(observed(three_masses(), Midpoint(), [200, 280, 400, 560], 4.0)[0] - 2.0) < 0.1
    x = np.linspace(0.01, 0.6, 1000)
    found = sb.amplification(SymplecticEuler(), x)
    assert abs(found.stable_to - 1 / np.pi) < x[1] - x[0]
    assert np.all(np.isnan(found.period_elongation[x > 1 / np.pi + 1e-3]))
    # The tip is the state's, not the guess.
    run = sb.integrate(sb.semidiscretise(table10, 8), Guess(), 1e-6, 0.01, every=100)
    assert np.max(np.abs(run.tip - run.states[0][:, -1])) < 1e-14
    assert run.label.startswith("Guess@")
    # Never by the name of the one it changes.
    case = sb.paper_case(10)
    assert list(chosen(case, [Stiffer(-0.2)])) == ["Stiffer(alpha=-0.2)"]
    assert list(chosen(case, [sb.HHT(-0.2), "bdf2"])) == ["HHT(alpha=-0.2)", "BDF2"]


@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
@pytest.mark.parametrize(
    "scheme",
    [*ALL, *PRINTED, sb.Theta(0.75), sb.HHT(-1.0 / 3.0), sb.HHT(-0.12345678), sb.SDIRK(GAMMA_MIN),
     PrintedStageMatrix(1.0)],
    ids=str,
)  # fmt: skip
def test_a_run_reads_back_from_its_own_label(scheme, form):
    again, same_form = parse_run(f"{scheme}@{form}")
    assert type(again) is type(scheme)
    assert (again.parameters, same_form) == (scheme.parameters, form)


def test_a_label_may_leave_out_what_has_a_default():
    scheme, form = parse_run(" hht ")
    assert (type(scheme), scheme.alpha, form) == (sb.HHT, -0.1, "displacement")
    assert parse_run("bdf2", "velocity-curvature")[1] == "velocity-curvature"
    sdirk = parse_run("sdirk( gamma = 0.4359 , nystrom=True ) @ displacement")[0]
    assert (sdirk.gamma, sdirk.nystrom) == (GAMMA_THIRD_ORDER, True)  # the paper's digits mean the root
    assert str(sdirk) == "SDIRK(gamma=0.4359, nystrom=True)"
    assert parse_run(" test_schemes:Midpoint(theta=0.6) @ velocity-curvature")[1] == "velocity-curvature"
    text = "bdf2, SDIRK(gamma=0.5, nystrom=True)@displacement,PrintedSigma,"
    assert [x.strip() for x in split_runs(text)] == [
        "bdf2", "SDIRK(gamma=0.5, nystrom=True)@displacement", "PrintedSigma",
    ]  # fmt: skip


# ------------------------------------------------------------------ textbook numbers


def test_error_expansions_and_radii_at_infinity():
    """Trapezoidal rule: arctangent. BDF2: elongation x^2/3, damping x^3/4. SDIRK: order 3. rho: -rho, thrice."""
    x = np.array([1e-3, 0.1, 1.0, 100.0])
    exact = 2.0 * np.pi * x / (2.0 * np.arctan(np.pi * x)) - 1.0
    assert np.max(np.abs(sb.amplification(sb.Trapezoidal(), x).period_elongation - exact) / (1 + exact)) < 1e-11
    for scheme, elongation in (
        (sb.HHT(-0.1), 0.0395),
        (sb.BDF2(), 0.102),
    ):  # of the literature, at a tenth of the period
        assert abs(sb.amplification(scheme, 0.1).period_elongation[0] - elongation) < 0.0006
    x = np.array([2e-3, 4e-3])
    bdf = sb.amplification(sb.BDF2(), x)
    assert np.allclose(bdf.period_elongation, (2 * np.pi * x) ** 2 / 3, rtol=1e-3)
    assert np.allclose(bdf.damping_ratio, (2 * np.pi * x) ** 3 / 4, rtol=1e-3)
    sdirk = sb.amplification(sb.SDIRK(), 10 * x)
    assert 7.0 < sdirk.damping_ratio[1] / sdirk.damping_ratio[0] < 8.5
    far = np.array([1e4, 1e5])
    for rho in (0.0, 0.5, 0.8):
        radius = sb.amplification(sb.GeneralisedAlpha(rho), far).spectral_radius
        assert np.all(np.abs(radius - rho) < 1.1 * (2 * np.pi * far) ** (-2 / 3))
    for scheme in (sb.BDF2(), sb.SDIRK(), sb.Bathe(), sb.Bathe(2 - 2**0.5)):
        assert sb.amplification(scheme, 1e5).spectral_radius[0] < 2e-3  # L-stable


def test_bathe_with_the_tr_bdf2_split_amplifies_like_tr_bdf2():
    """R(z) of Bank et al. with gamma = 2 - sqrt 2, written from its tableau."""
    g = 2 - np.sqrt(2)
    d, w = g / 2, np.sqrt(2) / 4
    A, b = np.array([[0, 0, 0], [d, d, 0], [w, w, d]]), np.array([w, w, d])
    for x in (0.05, 0.3, 2.0):
        z = 2j * np.pi * x
        R = 1 + z * b @ np.linalg.solve(np.eye(3) - z * A, np.ones(3))
        assert abs(sb.amplification(sb.Bathe(g), x).spectral_radius[0] - abs(R)) < 1e-12


def R(g, z):
    """Stability function of SDIRK, (4.9)."""
    return ((3 * g**2 - 3 * g + 0.5) * z**2 - (3 * g - 1) * z + 1) / (1 - g * z) ** 3


def test_the_tableau_meets_the_order_conditions():
    g = GAMMA_THIRD_ORDER
    assert abs(1 / 6 - 1.5 * g + 3 * g**2 - g**3) < 1e-16
    scheme = sb.SDIRK(0.4359)
    c = np.array(scheme.nodes)
    assert scheme.gamma == g
    assert np.allclose(c, scheme.A.sum(axis=1), atol=1e-15)
    conditions = scheme.b.sum(), scheme.b @ c, scheme.b @ c**2, scheme.b @ scheme.A @ c
    assert np.allclose(conditions, (1, 1 / 2, 1 / 3, 1 / 6), rtol=0, atol=1e-14)
    assert abs(scheme.nodes[1] - (1 + g) / 2) < 1e-14  # Owren and Simonsen's abscissa
    one = sb.SDIRK(1.0)  # of the corrected sigma
    assert np.allclose(one.nodes, (1.0, 1.0 / 3.0, 1.0), atol=1e-15)
    assert np.allclose(one.b, (-0.75, 0.75, 1.0), atol=1e-15)
    assert PrintedSigma().sigma == -sb.SDIRK().sigma


def test_l_stability_ends_at_the_two_gammas_of_page_61():
    polynomial = np.polynomial.Polynomial([1, -12, 48, -72, 24])
    assert abs(polynomial(GAMMA_MIN)) < 1e-13
    assert abs(polynomial(GAMMA_MAX)) < 1e-11
    worst = lambda g: np.max(np.abs(R(g, 1j * np.logspace(-2, 4, 2000))))  # noqa: E731
    assert worst(GAMMA_MIN + 1e-3) <= 1 + 1e-12 < worst(GAMMA_MIN - 1e-3)
    assert worst(GAMMA_MAX - 1e-3) <= 1 + 1e-12 < worst(GAMMA_MAX + 1e-3)
