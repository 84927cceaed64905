"""A round hole: closed forms, a hand-written oscillator in SciPy, symmetries, the node's equations, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stiffbeam as sb
from stiffbeam.march import direct_march
from stiffbeam.model.contact import laws
from stiffbeam.model.stage import solve_turning

CLEARANCE, KAPPA, T_END = 0.1, 1e3, 2.0
LAWS = {
    "linear": sb.Stops(upper=CLEARANCE, stiffness=KAPPA),
    "Hertz": sb.Stops(upper=CLEARANCE, stiffness=KAPPA, exponent=1.5),
    "Hunt-Crossley": sb.Stops(upper=CLEARANCE, stiffness=KAPPA, dissipation=0.5),
    "Kelvin-Voigt": sb.Stops(upper=CLEARANCE, stiffness=KAPPA, damping=2.0),
}


def oscillator(stops: sb.Stops, angle: float = 0.0, second: float = 2.0, **changes) -> sb.System:
    """A driven mass in a hole, all data turned by ``angle``; second: amplitude of the load along the second axis."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    loads = [(turn[:, 0], sb.Harmonic(2.0, 3.0)), (turn[:, 1], sb.Harmonic(second, 3.0, 1.2))]
    matrices = np.eye(2), 4 * np.eye(2), 0.1 * np.eye(2)
    start = changes.pop("initial_velocity", turn @ [0.3, 0.1])
    return sb.System.from_matrices(*matrices, loads, [sb.Contact(np.eye(2), stops)], turn[:, 0], None, start, **changes)


def by_hand(stops: sb.Stops, t: np.ndarray) -> np.ndarray:
    """(x, y, x', y') of ``oscillator``, with the energy that the stop dissipates and its impulse, (6, k)."""

    def rate(time, z):
        r, v = z[:2], z[2:4]
        size = np.hypot(*r)
        depth, push, elastic = size - CLEARANCE, 0.0, 0.0
        towards = r @ v / size if size else 0.0
        if depth > 0.0:
            elastic = KAPPA * depth**stops.exponent
            push = max(0.0, elastic * (1.0 + stops.dissipation * towards) + stops.damping * towards)
        drive = 2.0 * np.array([np.sin(3.0 * time), np.sin(3.0 * time + 1.2)])
        away = -push * r / size if size else np.zeros(2)
        return [*v, *(drive - 4.0 * r - 0.1 * v + away), (push - elastic) * towards, push]

    return solve_ivp(rate, (0.0, t[-1]), [0, 0, 0.3, 0.1, 0, 0], "DOP853", t, rtol=1e-11, atol=1e-13, max_step=1e-3).y


@pytest.mark.fast(1)
@pytest.mark.parametrize("law", LAWS)
def test_adaptive_references_give_the_motion_of_a_hand_written_oscillator(law):
    stops, t = LAWS[law], np.linspace(0.0, T_END, 201)
    system, hand = oscillator(stops), by_hand(LAWS[law], t)
    size = np.hypot(hand[0], hand[1])
    assert np.max(size) > 1.05 * CLEARANCE
    for method in ("cvode-adams", "ida", "dop853"):
        exact = sb.reference(system, T_END, method, t_eval=t)
        record = exact.contacts[0]
        np.testing.assert_allclose(exact.tip, hand[0], atol=2e-8)
        np.testing.assert_allclose(record.position, size, atol=2e-8)
        np.testing.assert_allclose(record.velocity * size, hand[0] * hand[2] + hand[1] * hand[3], atol=2e-7)
        assert record.impulse == pytest.approx(hand[5, -1], rel=1e-7)
        np.testing.assert_allclose(exact.energy.stop_dissipation, hand[4] * stops.dissipative, atol=1e-6)
        assert np.max(np.abs(exact.energy.loss)) < 1e-7
        # Entries and exits lie on the circle, where the law does not let go earlier.
        listed, _ = record.impacts.listed()
        assert listed.count >= 3
        np.testing.assert_allclose(exact.at(listed.times, contact=0)[0], CLEARANCE, atol=1e-8)
        assert np.all(listed.peaks[:-1] > 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["kvaerno5", "radau"])
@pytest.mark.parametrize("law", LAWS)
def test_implicit_references_in_python_and_jax_agree(law, method):
    t = np.linspace(0.0, T_END, 201)
    exact = sb.reference(oscillator(LAWS[law]), T_END, method, t_eval=t)
    np.testing.assert_allclose(exact.tip, by_hand(LAWS[law], t)[0], atol=2e-8)


@pytest.mark.parametrize("method", ["cvode-adams", "cvode", "ida", "dop853"])
def test_a_steady_whirl_is_its_closed_form(method):
    """r = R (cos w t, sin w t): the load is the force that this motion takes, and all records are constants."""
    radius, w, k, c = 1.2 * CLEARANCE, 2.0, 4.0, 0.5
    a, b = (k - w * w + KAPPA * (1.0 - CLEARANCE / radius)) * radius, c * w * radius
    size, phase = np.hypot(a, b), np.arctan2(b, a)
    loads = [([1.0, 0.0], sb.Harmonic(size, w, phase + 0.5 * np.pi)), ([0.0, 1.0], sb.Harmonic(size, w, phase))]
    system = sb.System.from_matrices(
        np.eye(2), k * np.eye(2), c * np.eye(2), loads, [sb.Contact(np.eye(2), LAWS["linear"])], [1.0, 0.0],
        [radius, 0.0], [0.0, w * radius],
    )  # fmt: skip
    t, force = np.linspace(0.0, 5.0, 101), KAPPA * (radius - CLEARANCE)
    exact = sb.reference(system, 5.0, method, t_eval=t)
    record = exact.contacts[0]
    np.testing.assert_allclose(exact.tip, radius * np.cos(w * t), atol=1e-8)
    np.testing.assert_allclose(record.position, radius, atol=1e-8)
    np.testing.assert_allclose(record.force, -force, rtol=1e-6)
    assert record.impulse == pytest.approx(5.0 * force, rel=1e-7)
    assert record.fraction == 1.0
    np.testing.assert_allclose(exact.energy.input, c * (w * radius) ** 2 * t, atol=1e-6)
    # Schemes follow with the square of the step: BDF2 starts with another scheme.
    errors = [np.max(np.abs(sb.integrate(system, sb.HHT(-0.05), dt, 1.0).contacts[0].position - radius))
              for dt in (4e-3, 2e-3)]  # fmt: skip
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


SCHEMES = [sb.HHT(-0.05), sb.BDF2(), sb.GeneralisedAlpha(0.7), sb.Bathe()]


@pytest.mark.fast(1)
@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
def test_turned_data_give_the_turned_motion_to_rounding(scheme):
    for law in LAWS.values():
        runs = [sb.integrate(oscillator(law, angle), scheme, 2e-3, 0.6) for angle in (0.0, 0.7, 2.0)]
        for run in runs[1:]:
            np.testing.assert_allclose(run.tip, runs[0].tip, atol=1e-12)
            np.testing.assert_allclose(run.contacts[0].force, runs[0].contacts[0].force, atol=1e-8)
            assert run.contacts[0].impacts.count == runs[0].contacts[0].impacts.count > 0


@pytest.mark.fast(1)
@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.parametrize("contact", ["implicit", "extrapolated"])
def test_a_motion_along_one_row_is_that_of_two_stops(scheme, contact):
    for law in LAWS.values():
        if contact == "extrapolated" and law.dissipative:
            continue
        hole = oscillator(law, second=0.0, initial_velocity=[0.3, 0.0])
        pair = replace(hole, contacts=(sb.Contact(np.array([1.0, 0.0]), replace(law, lower=-CLEARANCE)),))
        one, two = (sb.integrate(x, scheme, 2e-3, T_END, contact=contact, engine="direct") for x in (hole, pair))
        assert one.provenance["march"] == "direct"
        np.testing.assert_allclose(one.tip, two.tip, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(np.abs(one.contacts[0].force), np.abs(two.contacts[0].force), atol=1e-10)
        np.testing.assert_allclose(one.contacts[0].impacts.times, two.contacts[0].impacts.times, atol=1e-12)
        assert one.contacts[0].impacts.count >= 2
        assert np.all(one.contacts[0].impacts.stops == 1)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.parametrize("law", ["linear", "Hertz", "Hunt-Crossley"])
def test_schemes_converge_to_the_reference(scheme, law):
    """Errors of order 2 in the mean over several steps: those of entries scatter."""
    system = oscillator(LAWS[law])
    steps = np.array([1e-3, 7e-4, 5e-4, 3.5e-4, 2.5e-4])
    runs = [sb.integrate(system, scheme, dt, round(1.4 / dt) * dt) for dt in steps]
    references = [sb.reference(system, run.t[-1], "dop853", t_eval=run.t) for run in runs]
    errors = [np.sqrt(np.mean((run.tip - x.tip) ** 2)) for run, x in zip(runs, references, strict=True)]
    run, exact = runs[-1], references[-1]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order > 1.3, errors
    assert errors[-1] < 2e-3 * np.max(np.abs(exact.tip))
    assert run.contacts[0].impacts.count == exact.contacts[0].impacts.count
    assert run.contacts[0].impulse == pytest.approx(exact.contacts[0].impulse, rel=1e-3)


@pytest.mark.slow
def test_forces_of_a_node_satisfy_the_law_in_every_direction():
    """Two holes and a stop on one row, coupled by a full compliance: u = r + S F with F of the law written out."""
    rng = np.random.default_rng(3)
    owners = np.array([0, 0, 1, 2, 2])
    for law in LAWS.values():
        touched = 0
        for _ in range(100):
            A, B = rng.normal(size=(2, 5, 5))
            S, S_rate = 10 ** rng.uniform(-5, -2) * A @ A.T, 10 ** rng.uniform(-3, -1) * B @ B.T
            if law.dissipative:
                S_rate = rng.uniform(1.0, 100.0) * S
            r, w = rng.uniform(-0.2, 0.2, 5), rng.normal(size=5)
            stops = [law, replace(law, lower=-CLEARANCE), replace(law, upper=0.5 * CLEARANCE)]
            contacts = [sb.Contact(np.ones(1), x) for x in stops]
            forces, rows = solve_turning(r, w, S, S_rate, laws(contacts), owners)
            u, v = r + S @ rows, w + S_rate @ rows
            for c, stop in enumerate(stops):
                mine = owners == c
                size = np.linalg.norm(u[mine])
                n = u[mine] / size
                d, towards = size - stop.upper_bound, v[mine] @ n
                expected = KAPPA * max(d, 0.0) ** law.exponent * (1 + law.dissipation * towards) + law.damping * towards
                # On the circle itself a force that jumps takes any value up to its jump.
                if law.jumps and abs(d) < 1e-12:
                    assert -1e-9 <= abs(forces[c]) <= law.damping * towards + 1e-9
                    continue
                expected = max(0.0, expected) if d > 0.0 else 0.0
                np.testing.assert_allclose(rows[mine], -expected * n, atol=1e-9 * (1.0 + expected))
                assert abs(forces[c]) == pytest.approx(expected, abs=1e-9 * (1.0 + expected))
                touched += expected > 0.0
        assert touched > 100


@pytest.mark.parametrize("form", ["explicit", "descriptor"])
@pytest.mark.parametrize("law", LAWS)
def test_jacobians_are_derivatives_of_the_right_hand_side(law, form):
    rng = np.random.default_rng(1)
    system = replace(oscillator(LAWS[law]), mass=np.array([[2.0, 0.3], [0.3, 1.0]]))
    ode = system.ode(form)
    y = ode.state([0.09, 0.08], rng.normal(size=2))
    steps = 1e-6 * np.eye(len(y))
    slopes = np.array([(ode.rhs(0.1, y + h) - ode.rhs(0.1, y - h)) / 2e-6 for h in steps]).T
    np.testing.assert_allclose(ode.jac(0.1, y), slopes, atol=1e-5 * np.max(np.abs(slopes)))
    if form == "explicit":
        np.testing.assert_allclose(system.rhs(0.1, y), ode.rhs(0.1, y), atol=1e-11)
        np.testing.assert_allclose(system.jacobian(0.1, y), ode.jac(0.1, y), atol=1e-9)
        assert ode.events[0](0.1, y) > 0.0
        centre = ode.state([0.0, 0.0], [1.0, 2.0])
        np.testing.assert_allclose(ode.rhs(0.0, centre)[[0, 2]], [1.0, 2.0])


@pytest.mark.slow
@pytest.mark.parametrize("law", ["linear", "Kelvin-Voigt"])
def test_energy_is_balanced(law):
    """Without loads and dampers: elastic impacts keep the energy, and what a damped hole takes is what is missing."""
    system = oscillator(LAWS[law])
    free = replace(system, loads=(), damping=np.zeros((2, 2)), v0=np.array([1.0, 0.2]))
    start, ends = 0.5 * 1.04, []
    for run in (sb.reference(free, T_END, "dop853"), sb.integrate(free, sb.Trapezoidal(), 4e-4, T_END)):
        energy = run.energy
        left = energy.kinetic[-1] + energy.elastic[-1] + energy.stops[-1] + energy.stop_dissipation[-1]
        ends.append(energy.stop_dissipation[-1])
        assert left == pytest.approx(start, rel=2e-3)
    assert (ends[0] > 0.05) == (law == "Kelvin-Voigt")
    assert ends[1] == pytest.approx(ends[0], rel=5e-3, abs=1e-9)


@pytest.mark.slow
def test_records_ensembles_and_tables_take_a_hole(tmp_path: Path):
    system = oscillator(LAWS["linear"])
    run = sb.integrate(system, sb.HHT(-0.05), 1e-3, T_END)
    exact = sb.reference(system, T_END, "cvode-adams", t_eval=run.t)
    assert "HHT" in str(sb.compare(run, exact))
    run.save(tmp_path / "run.nc")
    saved = sb.load(tmp_path / "run.nc")
    np.testing.assert_array_equal(saved.contacts[0].position, run.contacts[0].position)
    again = sb.Trajectory.from_arrays(run.t, system=system, states=run.states)
    assert again.contacts[0].impacts.count == run.contacts[0].impacts.count
    members = sb.varied_members(system, {"contacts[0].stops.upper": [0.05, CLEARANCE]})
    several = sb.integrate_ensemble(system, sb.HHT(-0.05), 1e-3, T_END, members=members, every=1)
    np.testing.assert_array_equal(several.tip[1], run.tip)
    assert "Hole" in repr(system.contacts[0])
    # Sliding velocity: (x y' - y x')/|r|.
    rates = sb.contact_rates(run, tangents=[np.array([[0.0, -1.0], [1.0, 0.0]])])
    q, v = run.states
    slides = np.abs(q[:, 0] * v[:, 1] - q[:, 1] * v[:, 0]) / np.maximum(np.hypot(*q.T), 1e-30)
    power = np.abs(run.contacts[0].force) * slides
    assert rates.rates[0]["sliding_work"].value == pytest.approx(np.mean(power), rel=1e-2)
    # The rows of the hole itself would give the normal work.
    with pytest.raises(sb.InputError, match="turned by a right angle"):
        sb.contact_rates(run, tangents=[system.contacts[0].row])


@pytest.mark.slow
def test_a_case_file_takes_two_rows(tmp_path: Path):
    (tmp_path / "hole.toml").write_text(
        """[[case]]
name = "hole"
dt = 1e-3
t_end = 2.0
[case.system]
mass = [[1.0, 0.0], [0.0, 1.0]]
stiffness = [[4.0, 0.0], [0.0, 4.0]]
observe = [1.0, 0.0]
initial_velocity = [0.3, 0.1]
[[case.system.contacts]]
row = [[1.0, 0.0], [0.0, 1.0]]
upper = 0.1
stiffness = 1e3
"""
    )
    (case,) = sb.load_cases(tmp_path / "hole.toml").values()
    (contact,) = case.system(case.forms[0]).contacts
    assert contact.radial
    np.testing.assert_array_equal(contact.row, np.eye(2))
    assert contact.stops.upper_bound == CLEARANCE
    run = sb.integrate(case.system(case.forms[0]), sb.HHT(-0.05), 1e-3, T_END)
    undriven = replace(oscillator(LAWS["linear"]), loads=(), damping=np.zeros((2, 2)))
    np.testing.assert_array_equal(run.tip, sb.integrate(undriven, sb.HHT(-0.05), 1e-3, T_END).tip)


def test_what_a_hole_cannot_be_is_refused():
    rows = np.eye(2)
    for stops, options, word in (
        (sb.Stops(lower=-0.1, upper=0.1, stiffness=1.0), {}, "no lower"),
        (sb.Stops(upper=0.0, stiffness=1.0), {}, "upper > 0"),
        (sb.Stops(upper=0.1, stiffness=float("inf")), {}, "finite"),
        (LAWS["linear"], {"offset": sb.Harmonic(0.1, 1.0)}, "offset must be None"),
    ):
        with pytest.raises(sb.InputError, match=word):
            sb.Contact(rows, stops, **options)
    with pytest.raises(sb.InputError, match="round hole first"):
        sb.System.from_matrices(rows, rows, contacts=[sb.Contact(rows, LAWS["linear"])])
    with pytest.raises(sb.InputError, match="hold 3 numbers"):
        sb.System.from_matrices(np.eye(3), np.eye(3), contacts=[sb.Contact(rows, LAWS["linear"])], observe=[1, 0, 0])


def test_what_takes_no_hole_refuses_it_with_a_remedy():
    system = oscillator(LAWS["linear"])
    calls = [
        lambda: sb.reference(system, T_END),
        lambda: sb.reference(system, T_END, "multiprecision"),
        lambda: sb.static_equilibrium(system, 0.0),
        lambda: system.massless_contacts(),
        lambda: sb.lyapunov(system, T_END),
        lambda: sb.periodic_orbit(system, 2.0 * np.pi / 3.0),
        lambda: sb.integrate(system, sb.Trapezoidal(), 1e-3, T_END, contact="conserving"),
    ]
    for call in calls:
        with pytest.raises(sb.InputError, match=r"round hole.*sides=12"):
            call()


def test_a_march_of_minutes_through_a_hole_is_announced(monkeypatch):
    """With its estimate, after the first steps; flat stops march in compiled code."""
    system = oscillator(LAWS["linear"])
    sb.integrate(system, sb.HHT(-0.05), 1e-3, T_END)  # a warning would fail the test
    monkeypatch.setattr(direct_march, "MINUTES", 1e-9)
    with pytest.warns(UserWarning, match=r"a round hole will take about \d+ s more: flat stops"):
        sb.integrate(system, sb.HHT(-0.05), 1e-3, T_END)
    flat = replace(system, contacts=(sb.Contact([1.0, 0.0], sb.Stops(-0.1, 0.1, stiffness=KAPPA)),))
    sb.integrate(flat, sb.HHT(-0.05), 1e-3, T_END, engine="direct")


def test_sliding_in_a_reduced_model_takes_its_rows_by_the_basis():
    """As with the whole model; a row of the whole model is refused with this remedy."""
    matrices = np.eye(9), np.diag([4.0, 4.0, *range(400, 1100, 100)]) + 0.5, 0.1 * np.eye(9)
    rows = np.eye(9)[:2]
    loads = [(rows[0], sb.Harmonic(2.0, 3.0)), (rows[1], sb.Harmonic(2.0, 3.0, 1.2))]
    data = {"loads": loads, "contacts": [sb.Contact(rows, LAWS["linear"])], "observe": rows[0]}
    turned = np.array([-rows[1], rows[0]])
    whole = sb.integrate(sb.System.from_matrices(*matrices, **data), sb.HHT(), 1e-3, T_END)
    model = sb.reduce_model(*matrices, **data, modes=2)
    run = sb.integrate(model.system, sb.HHT(), 1e-3, T_END)
    found, known = (
        sb.contact_rates(x, tangents=[t]).rates[0]["sliding_work"].value
        for x, t in ((run, turned @ model.basis), (whole, turned))
    )
    assert found == pytest.approx(known, rel=1e-2)
    with pytest.raises(sb.InputError, match=r"pass row @ model\.basis"):
        sb.contact_rates(run, tangents=[turned])
