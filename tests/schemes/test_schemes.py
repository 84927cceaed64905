"""Orders, equivalences and classical properties of every registered scheme."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import exact_linear, newmark_hht_loop
from systems import linear_part

import stiffbeam as sb
from stiffbeam.model.equations import Modal
from stiffbeam.model.state_space import state_space
from stiffbeam.schemes import GAMMA_THIRD_ORDER, registered
from stiffbeam.schemes.sdirk import GAMMA_MAX, GAMMA_MIN

ALL = [*registered(), sb.HHT(-0.1).printed()]


def observed_order(system, scheme, steps, exact_at, t_end):
    """Slope of log(error) over log(dt) by regression, and the error at the finest step."""
    errors = []
    for n in steps:
        run = sb.integrate(system, scheme, t_end / n, t_end, every=n)
        q, v = run.states
        errors.append(np.max(np.abs(np.concatenate([q[-1] - exact_at[0], v[-1] - exact_at[1]]))))
    slope = np.polyfit(np.log(1.0 / np.array(steps)), np.log(errors), 1)[0]
    return slope, errors[-1]


@pytest.mark.parametrize("scheme", ALL, ids=str)
def test_every_scheme_has_its_order_on_a_smooth_forced_system(scheme, three_masses):
    t_end = 4.0
    load = np.array([1.0, 0.0, -1.0])
    exact = exact_linear(
        *linear_part(three_masses),
        np.array([t_end]),
        1.3,
        load * np.cos(0.4),
        load * np.sin(0.4),
        np.array([0.0, 0.35, 0.35]),
    )
    # dt <= 0.02 against periods above 2: asymptotic; the errors stay far above rounding (1e-13).
    slope, finest = observed_order(three_masses, scheme, [200, 280, 400, 560, 800], (exact[0][0], exact[1][0]), t_end)
    assert abs(slope - scheme.order) < 0.1
    assert finest < (0.02 if scheme.order == 1 else 2e-3)


def test_the_printed_sigma_costs_an_order(three_masses):
    """2.9 at coarse steps, where the third-order error still dominates, falling to 2."""
    load = np.array([1.0, 0.0, -1.0])
    exact = exact_linear(
        *linear_part(three_masses),
        np.array([4.0]),
        1.3,
        load * np.cos(0.4),
        load * np.sin(0.4),
        np.array([0.0, 0.35, 0.35]),
    )
    end = (exact[0][0], exact[1][0])
    coarse, _ = observed_order(three_masses, sb.SDIRK().printed("sigma"), [50, 70, 100], end, 4.0)
    fine, _ = observed_order(three_masses, sb.SDIRK().printed("sigma"), [6400, 9000, 12800], end, 4.0)
    assert coarse > 2.8
    assert abs(fine - 2.0) < 0.1


@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.2), sb.SDIRK(), sb.SDIRK(1.0, nystrom=True)], ids=str)
def test_the_order_holds_with_damping_that_does_not_decouple(scheme):
    damping = np.array([[0.3, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # a dashpot at one mass
    load = np.array([1.0, 0.0, 0.0])
    system = sb.System.from_matrices(
        np.diag([2.0, 1.0, 1.0]),
        np.array([[8.0, -3.0, 0.0], [-3.0, 7.0, -3.0], [0.0, -3.0, 5.0]]),
        damping,
        loads=[(load, sb.Harmonic(1.0, 1.3))],
        observe=[0.0, 0.0, 1.0],
        initial_velocity=[0.0, 0.4, -0.5],
    )
    exact = exact_linear(*linear_part(system), np.array([2.0]), 1.3, load, 0 * load, 0 * load)
    steps = [100, 140, 200, 280]
    slope, _ = observed_order(system, scheme, steps, (exact[0][0], exact[1][0]), 2.0)
    assert abs(slope - scheme.order) < 0.1
    assert sb.integrate(system, scheme, 0.02, 2.0).provenance["march"] == "dense blocks"


@pytest.mark.filterwarnings("ignore:gamma = 0.3 evaluates forces")
def test_sdirk_for_rates_and_in_nystroem_form_are_equal(table10_system):
    for gamma in (GAMMA_THIRD_ORDER, 1.0, 0.3):
        runs = [sb.integrate(table10_system, sb.SDIRK(gamma, nystrom=n), 1e-4, 0.1) for n in (False, True)]
        assert np.max(np.abs(runs[0].tip - runs[1].tip)) < 1e-10 * np.max(np.abs(runs[0].tip))
        assert runs[0].impacts.count == runs[1].impacts.count > 0


@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
def test_bdf2_on_the_papers_first_order_form_gives_the_same_run(form, table10):
    """(4.11) on (3.5) and (4.5) on (3.12), in a plain loop over y' = A y + ..., against the scheme on M, C and K."""
    system, dt, steps = sb.semidiscretise(table10, 25, form), 1e-4, 600  # the first six impacts
    given = state_space(system)
    contact, one = given.contacts[0], np.eye(len(given.y0))
    y, tip = [given.y0], [contact.row @ given.y0]
    force, load = contact.contact.stops.force(tip[0]), lambda t: sum(b * f.value(t) for b, f in given.loads)
    rate = given.matrix @ y[0] + load(0.0) + force * contact.column
    for n in range(steps):
        # The trapezoidal rule makes the first step: y = known + c (A y + load + F column).
        c, known = (dt / 2, y[0] + dt / 2 * rate) if n == 0 else (2 * dt / 3, (4 * y[n] - y[n - 1]) / 3)
        free, push = np.linalg.solve(
            one - c * given.matrix, np.array([known + c * load((n + 1) * dt), c * contact.column]).T
        ).T
        force = contact.contact.stops.solve(contact.row @ free, contact.row @ push)
        y.append(free + force * push)
        tip.append(contact.row @ y[-1])
    run = sb.integrate(system, sb.BDF2(), dt, steps * dt)
    assert run.impacts.count > 0
    # eps (w_max/w_1)^2 = 1e-10 of rounding in the matrices, over 600 steps and through contact
    assert np.max(np.abs(run.tip - tip)) < 1e-9 * np.max(np.abs(run.tip))
    assert np.max(np.abs(run.states[0] - np.array(y) @ given.to_q.T)) < 1e-9


def test_hht_equals_a_plain_loop_over_its_three_equations(table10):
    system = sb.semidiscretise(table10, 25)
    t_end, dt = 0.06, 1e-4
    run = sb.integrate(system, sb.HHT(-0.1), dt, t_end)
    loop = newmark_hht_loop(
        system.mass, system.stiffness, system.contacts[0].row, -0.1, 0.1, 5e6, system.load(np.arange(601) * dt),
        -0.1, dt, 600, system.q0, system.v0,
    )  # fmt: skip
    assert run.impacts.count == 3
    assert np.max(np.abs(run.tip - loop)) < 1e-9 * np.max(np.abs(loop))


def test_the_third_order_gamma_is_a_root_and_meets_the_order_conditions():
    g = GAMMA_THIRD_ORDER
    assert abs(1 / 6 - 1.5 * g + 3 * g**2 - g**3) < 1e-16
    scheme = sb.SDIRK(0.4359)
    assert scheme.gamma == g
    c = np.array(scheme.nodes)
    assert np.allclose(c, scheme.A.sum(axis=1), atol=1e-15)
    for value, wanted in (
        (scheme.b.sum(), 1), (scheme.b @ c, 1 / 2), (scheme.b @ c**2, 1 / 3), (scheme.b @ scheme.A @ c, 1 / 6),
    ):  # fmt: skip
        assert abs(value - wanted) < 1e-14
    assert abs(scheme.nodes[1] - (1 + g) / 2) < 1e-14  # Owren and Simonsen's abscissa


def test_gamma_one_has_the_tableau_that_follows_from_the_corrected_sigma():
    scheme = sb.SDIRK(1.0)
    assert np.allclose(scheme.nodes, (1.0, 1.0 / 3.0, 1.0), atol=1e-15)
    assert np.allclose(scheme.b, (-0.75, 0.75, 1.0), atol=1e-15)


@pytest.mark.parametrize("gamma", [0.2, 0.4359, 0.8, 1.0, 2.0])
def test_sdirk_amplifies_like_the_papers_stability_function(gamma):
    with pytest.warns(UserWarning, match="Remark 8") if gamma > 1 else __import__("contextlib").nullcontext():
        scheme = sb.SDIRK(gamma)
    g = scheme.gamma
    for x in (0.1, 1.0, 10.0, 1e3):
        z = 1j * x
        R = ((3 * g**2 - 3 * g + 0.5) * z**2 - (3 * g - 1) * z + 1) / (1 - g * z) ** 3
        eigenvalues = np.linalg.eigvals(amplification_matrix(scheme, x))
        assert np.min(np.abs(eigenvalues - R)) < 1e-12
        assert np.min(np.abs(eigenvalues - np.conj(R))) < 1e-12


def test_l_stability_ends_at_the_two_gammas_of_page_61():
    polynomial = np.polynomial.Polynomial([1, -12, 48, -72, 24])
    assert abs(polynomial(GAMMA_MIN)) < 1e-13
    assert abs(polynomial(GAMMA_MAX)) < 1e-11
    x = np.logspace(-2, 4, 2000)

    def worst(g):
        z = 1j * x
        return np.max(np.abs(((3 * g**2 - 3 * g + 0.5) * z**2 - (3 * g - 1) * z + 1) / (1 - g * z) ** 3))

    assert worst(GAMMA_MIN + 1e-3) <= 1 + 1e-12 < worst(GAMMA_MIN - 1e-3)
    assert worst(GAMMA_MAX - 1e-3) <= 1 + 1e-12 < worst(GAMMA_MAX + 1e-3)


@pytest.mark.filterwarnings("ignore:gamma = 0.3 evaluates forces")
def test_the_published_damping_at_ten_refutes_the_higher_gamma_the_higher_the_damping():
    """|R(10 i)| = .74 .37 .44 .28 .11 .027 .052 at these gammas: not monotone."""
    published = {0.18043: 0.74, 0.2: 0.37, 0.3: 0.44, 0.4359: 0.28, 0.6: 0.11, 0.8: 0.027, 1.0: 0.052}
    for gamma, radius in published.items():
        eigenvalues = np.abs(np.linalg.eigvals(amplification_matrix(sb.SDIRK(gamma), 10.0)))
        assert abs(np.max(eigenvalues) - radius) < 0.06 * radius


def amplification_matrix(scheme, x):
    """The step matrix for q'' + x^2 q = 0 with dt = 1."""
    equation = Modal(np.array([x]), np.zeros(1))
    zero = [np.zeros(1)] * len(scheme.nodes)
    size = len(scheme.initial(equation, [np.zeros((2, 1))] * scheme.history, np.zeros(1)))
    return np.array([scheme.step(equation, 1.0, unit[:, None], zero, zero)[0][:, 0] for unit in np.eye(size)]).T


@pytest.mark.parametrize("scheme", list(registered()), ids=str)
def test_every_registered_scheme_is_unconditionally_stable(scheme):
    for x in np.logspace(-3, 4, 150):
        assert np.max(np.abs(np.linalg.eigvals(amplification_matrix(scheme, x)))) <= 1 + 1e-9


def test_the_trapezoidal_rule_is_hht_with_alpha_zero(table10_system):
    theta = sb.integrate(table10_system, sb.Theta(0.5), 1e-4, 0.05)
    hht = sb.integrate(table10_system, sb.HHT(0.0), 1e-4, 0.05)
    assert np.max(np.abs(theta.tip - hht.tip)) < 1e-11


def test_parameters_outside_their_range_are_refused_with_the_way_out():
    with pytest.raises(sb.InputError, match="pass -alpha"):
        sb.HHT(0.1)
    with pytest.raises(sb.InputError, match="L-stable"):
        sb.SDIRK(0.1)
    for pole_or_zero in (0.25777, 0.29289, 0.60507):
        with pytest.raises(sb.InputError, match="coefficients"):
            sb.SDIRK(pole_or_zero)
    with pytest.raises(sb.InputError, match="theta"):
        sb.Theta(0.3)


def test_printed_forms_are_chosen_by_name_and_bad_names_are_refused():
    assert str(sb.HHT(-0.1).printed()) == "HHT(alpha=-0.1).printed(unweighted)"
    assert sb.SDIRK().printed().sigma == -sb.SDIRK().sigma
    with pytest.raises(sb.InputError, match="sigma"):
        sb.SDIRK().printed("sigmaa")
    with pytest.raises(sb.InputError, match="printed form"):
        sb.BDF2().printed()


def assert_second_order(system, scheme, t_end):
    """Order 2 against the closed form of the three masses."""
    load, start = np.array([1.0, 0.0, -1.0]), np.array([0.0, 0.35, 0.35])
    forces = load * np.cos(0.4), load * np.sin(0.4)
    q, v = exact_linear(*linear_part(system), np.array([t_end]), 1.3, *forces, start)[:2]
    slope, _ = observed_order(system, scheme, [200, 280, 400, 560], (q[0], v[0]), t_end)
    assert abs(slope - 2.0) < 0.1


def test_the_printed_stage_matrix_is_refused_where_it_is_unstable_and_second_order_where_not(three_masses, table10):
    printed = sb.SDIRK(nystrom=True).printed("stage-matrix")
    # The paper's own system is beyond the limit: w_max dt = 4.3.
    with pytest.raises(sb.InputError, match=r"omega dt < 0\.13"):
        sb.integrate(sb.semidiscretise(table10, 25), printed, 1e-4, 0.01)
    assert_second_order(three_masses, printed, t_end=2.0)


def test_a_scheme_of_ones_own_runs_without_registration(three_masses):
    class ImplicitMidpoint(sb.Scheme):
        """k = f(t + dt/2, y + dt/2 k): its only node is not the end of the step."""

        name = "midpoint"
        nodes = (0.5,)

        def step(self, equation, dt, z, loads, reactions):
            k = equation.implicit_rate(dt / 2, z, loads[0] + reactions[0])
            return z + dt * k, [z + dt / 2 * k]

    scheme = ImplicitMidpoint()
    assert_second_order(three_masses, scheme, t_end=4.0)


class Own(sb.Scheme):
    """Implicit Euler, to be broken in one way at a time."""

    def step(self, equation, dt, z, loads, reactions):
        y = z + dt * equation.implicit_rate(dt, z, loads[0] + reactions[0])
        return y, [y]


def test_a_step_that_breaks_the_contract_is_refused(three_masses):
    class Nonlinear(Own):
        def step(self, equation, dt, z, loads, reactions):
            return super().step(equation, dt, z**2, loads, reactions)

    class LooksAhead(Own):
        nodes = (0.5, 1.0)

        def step(self, equation, dt, z, loads, reactions):
            y, [stage] = super().step(equation, dt, z, loads[1:], reactions[1:])
            return y, [stage, stage]

    class Forgetful(Own):
        nodes = (0.5, 1.0)

    class RadauIIA(Own):
        nodes = (1 / 3, 1.0)

        def step(self, equation, dt, z, loads, reactions):
            stages = dt * np.array([[5 / 12, -1 / 12], [3 / 4, 1 / 4]])
            rates = equation.implicit_rate(stages, z, np.stack(loads) + np.stack(reactions))
            return z + stages[-1] @ rates, list(z + stages @ rates)

    for scheme, word in (
        (Nonlinear(), "linear"), (LooksAhead(), r"causal.*fully implicit.*system\.ode\(\)"), (Forgetful(), "and 2 y"),
        (RadauIIA(), r"one number.*fully implicit.*solve\(system, dt, t_end\)"),
    ):  # fmt: skip
        with pytest.raises(sb.InputError, match=word):
            sb.integrate(three_masses, scheme, 0.01, 0.1)
    run = sb.integrate(three_masses, Own(), 0.01, 0.1)
    assert run.label == "Own@matrices"


def test_a_last_node_that_is_not_the_end_of_the_step_is_noticed(table10):
    """The force acts on an explicit guess of the end; the tip is the state's, not the guess."""

    class Guess(sb.Scheme):
        nodes = (1.0,)

        def step(self, equation, dt, z, loads, reactions):
            y = z + dt * equation.implicit_rate(dt, z, loads[0] + reactions[0])
            return y, [z + dt * z[::-1]]

    run = sb.integrate(sb.semidiscretise(table10, 8), Guess(), 1e-6, 0.01, every=100)
    assert np.max(np.abs(run.tip - run.states[0][:, -1])) < 1e-14


def test_what_is_no_scheme_or_no_system_is_refused(three_masses):
    for system, scheme in ((three_masses, "hht"), (three_masses, sb.HHT), ("beam", sb.HHT())):
        with pytest.raises(sb.InputError, match="be a"):
            sb.integrate(system, scheme, 0.01, 0.1)
