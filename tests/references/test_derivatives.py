"""Derivatives of exact motions against a closed form and against fourth-order differences of exact motions."""

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.model.members import value_at, with_values
from stiffbeam.model.system_data import data_of, slope_of, slopes
from stiffbeam.references.exact.derivative import Derivative
from stiffbeam.references.exact.motion import Solver

T = 1.0


def derivative(system: sb.System, end: float, t: list[float], paths: list[str]) -> Derivative:
    """Derivatives of the exact motion to ``end``, at times t."""
    return sb.reference(system, end, t_eval=[0.0, end]).derivative(paths, t)


def bouncing(damping: float = 0.0) -> sb.System:
    """Two masses between stops, driven: some ten contacts."""
    stops = sb.Stops(-0.08, 0.1, stiffness=4e3, damping=damping)
    return sb.System.from_matrices(
        [[1.0, 0.0], [0.0, 2.0]],
        [[300.0, -100.0], [-100.0, 150.0]],
        damping=[[0.4, -0.1], [-0.1, 0.3]],
        loads=[([0.0, 1.0], sb.Harmonic(60.0, 9.0, phase=0.3)), ([5.0, 1.0], sb.Harmonic(2.0, 9.0))],
        contacts=[sb.Contact(np.array([0.2, 1.0]), stops)],
        initial_displacement=[0.01, 0.02],
        initial_velocity=[0.5, -1.0],
    )


PATHS = [
    "stops[0].stiffness", "stops[0].upper", "loads[0].time.amplitude", "loads[0].time.frequency", "loads[0].time.phase",
    "q0[1]", "v0[0]",
]  # fmt: skip


def moved(system: sb.System, path: str, by: float):
    """State at T and the event times."""
    system = with_values(system, {path: value_at(system, path) + by})
    solution = Solver(system).solve(T)
    return np.concatenate([x[0] for x in solution.states(np.array([T]))]), solution.times[1:]


@pytest.mark.parametrize("damping", [0.0, 8.0])
def test_differences_of_exact_motions(damping: float) -> None:
    system = bouncing(damping)
    paths = PATHS + (["stops[0].damping"] if damping else [])
    exact = derivative(system, T, [0.5 * T, T], paths)
    assert len(exact.events) > 7
    for j, path in enumerate(paths):
        h = 1e-4 * abs(value_at(system, path))
        runs = {k: moved(system, path, k * h) for k in (-2, -1, 1, 2)}
        for x, values in (
            (exact.state[1, :, j], [runs[k][0] for k in (-2, -1, 1, 2)]),
            (exact.event_times[:, j], [runs[k][1] for k in (-2, -1, 1, 2)]),
        ):
            difference = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * h)
            np.testing.assert_allclose(x, difference, rtol=0, atol=2e-8 * np.max(np.abs(difference)), err_msg=path)


def test_one_mass_against_a_stop_in_closed_form() -> None:
    """u = v0 t to the stop at g, then half a period pi/w on it, w = sqrt(kappa): back with -v0."""
    kappa, g, v = 400.0, 0.3, 2.0
    system = one_mass(0.0, sb.Stops(upper=g, stiffness=kappa), v=v)
    d = derivative(system, T, [T], ["stops[0].stiffness", "stops[0].upper", "v0[0]"])
    on_stop = np.pi / np.sqrt(kappa)
    slower = -0.5 * on_stop / kappa  # d(pi/w)/dkappa
    np.testing.assert_allclose(
        d.event_times, [[0, 1 / v, -g / v**2], [slower, 1 / v, -g / v**2]], rtol=1e-12, atol=1e-14
    )
    # u(T) = g - v (T - g/v - pi/w)
    np.testing.assert_allclose(d.state[0, 0], [v * slower, 2.0, -(T - on_stop)], rtol=1e-11)
    np.testing.assert_allclose(d.state[0, 1], [0.0, 0.0, -1.0], rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize(
    ("stops", "names"),
    [
        (sb.Stops(-0.08, 0.1, stiffness=4e3, damping=8.0), ("lower", "upper", "stiffness", "damping")),
        (sb.Stops(-0.08, 0.1, stiffness=4e3), ("upper", "stiffness", "damping")),
        (sb.Stops(upper=0.1, stiffness=np.inf, restitution=1.0), ("upper", "restitution")),
    ],
)
def test_numbers_of_stops_have_exact_slopes(stops: sb.Stops, names: tuple[str, ...]) -> None:
    """Those of one contact and of all, against differences of the data of changed systems."""
    contacts = [sb.Contact(row, stops) for row in np.eye(2)]
    system = sb.System.from_matrices(np.eye(2), np.eye(2), contacts=contacts)
    for path in [f"{start}.{name}" for name in names for start in ("stops", "stops[1]", "contacts[0].stops")]:
        _, (column,), bounds = slopes(system, [path])
        value = value_at(system, path)
        differences, _ = slope_of(
            lambda x, path=path: with_values(system, {path: x}), system, value, path, data_of(system)
        )
        np.testing.assert_allclose(column.vector(), differences.vector(), rtol=0, atol=1e-10)
        assert np.count_nonzero(column.vector()) == (2 if path.startswith("stops.") else 1)
        assert bounds[0] == 0.0


def test_a_rigid_stop_has_no_derivative_in_a_damping() -> None:
    stops = sb.Stops(upper=0.1, stiffness=np.inf, restitution=0.5)
    system = sb.System.from_matrices([[1.0]], [[1.0]], contacts=[sb.Contact(np.ones(1), stops)])
    with pytest.raises(sb.InputError, match="be left out for rigid stops"):
        slopes(system, ["stops.damping"])


@pytest.mark.parametrize("path", ["stops[0].weight", "stops[3].stiffness", "nothing"])
def test_a_path_that_leads_to_no_number_is_refused(path: str) -> None:
    system = bouncing()
    with pytest.raises(sb.InputError, match="path to a number of the system"):
        derivative(system, 0.1, [0.1], [path])


def test_a_graze_has_no_derivative_of_its_time() -> None:
    """u = a sin(w t) reaches the stop at u = a with no speed: the time is NaN, the state's derivative stays."""
    system = one_mass(4.0, sb.Stops(upper=0.5, stiffness=100.0), v=1.0)
    d = derivative(system, 1.2, [1.2], ["v0[0]"])
    assert np.all(np.isnan(d.event_times))
    np.testing.assert_allclose(d.state[0, :, 0], [0.5 * np.sin(2.4), np.cos(2.4)], rtol=1e-6)


def test_a_parameter_that_adds_a_load_is_refused() -> None:
    """The viscosity of a beam on a moving base enters the load of the base too, which at 0 is left out."""
    stops = sb.Stops(-0.1, 0.1, stiffness=5e6)
    beam = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, stops=stops, base=sb.Harmonic(0.2, 10.0)), 4)
    with pytest.raises(sb.InputError, match="keep the terms of the loads"):
        derivative(beam, 0.01, [0.01], ["viscosity"])


@pytest.mark.parametrize("path", ["stops[0].upper", "base.amplitude", "base.frequency"])
def test_a_stiff_beam_keeps_its_digits(path: str) -> None:
    """Ten cells of Table 10's beam and ten events: an exponential that is not balanced errs by 3e-8 here."""
    end, beam = 0.06, sb.semidiscretise(sb.paper_case(10).problem, 10)

    def tip(by: float) -> np.ndarray:
        system = with_values(beam, {path: value_at(beam, path) + by})
        return Solver(system).solve(end).states(np.array([end]))[0][0]

    h = 1e-5 * value_at(beam, path)
    difference = (tip(-2 * h) - 8 * tip(-h) + 8 * tip(h) - tip(2 * h)) / (12 * h)
    exact = derivative(beam, end, [end], [path]).state[0, : beam.size, 0]
    np.testing.assert_allclose(exact, difference, rtol=0, atol=4e-9 * np.max(np.abs(difference)))


@pytest.mark.parametrize("path", ["stops[0].stiffness", "base.amplitude", "loads[0].time.phase"])
def test_a_reference_gives_the_derivatives_of_its_tip_and_its_impacts(path: str) -> None:
    """Against differences of references: the tip of a beam moves with its base too."""
    system, end = bouncing() if path.startswith("loads") else sb.semidiscretise(sb.paper_case(10).problem, 6), 0.08
    t = np.linspace(0.0, end, 41)
    reference = sb.reference(system, end, t_eval=t)
    h = 1e-4 * value_at(system, path)
    runs = [
        sb.reference(with_values(system, {path: value_at(system, path) + k * h}), end, t_eval=t) for k in (-2, -1, 1, 2)
    ]

    def difference(values: list[np.ndarray]) -> np.ndarray:
        return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * h)

    exact = reference.derivative([path])
    assert exact.wrt == (path,)
    tips = difference([run.tip for run in runs])
    np.testing.assert_allclose(exact.tip[:, 0], tips, rtol=0, atol=1e-6 * np.max(np.abs(tips)))
    assert reference.impacts.count == len(exact.impact_times[0])
    times = difference([run.impacts.times for run in runs])
    np.testing.assert_allclose(
        exact.impact_times[0][:, 0], times, rtol=0, atol=1e-6 * np.max(np.abs(times), initial=1e-9)
    )


def test_only_an_exact_reference_has_derivatives() -> None:
    system = bouncing()
    with pytest.raises(sb.InputError, match=r"reference must be of method .*got 'dop853'"):
        sb.reference(system, 0.1, "dop853").derivative(["stops[0].stiffness"])
    with pytest.raises(sb.InputError, match="wrt must name parameters"):
        sb.reference(system, 0.1).derivative([])
    with pytest.raises(sb.InputError, match=r"t must increase in \[0, 0.1\]"):
        sb.reference(system, 0.1).derivative(["v0[0]"], [0.05, 0.02])
