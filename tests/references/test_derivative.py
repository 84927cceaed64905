"""Derivatives of exact motions: against closed forms, and against differences of exact flows on random systems."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from law_systems import driven, free_system, kelvin_voigt_system, rigid_system, stops_of
from systems import one_mass, rotor

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.model.members import value_at, with_values
from stiffbeam.model.system_data import slopes
from stiffbeam.references.exact.motion import Solver
from stiffbeam.references.exact.solution import solve_exact

WIDTHS = (3e-3, 3e-4, 3e-5, 3e-6, 1e-7)  # the last for motions that grow so fast that only it is narrow enough
ORDER_4 = ((1, 8.0 / 12.0), (-1, -8.0 / 12.0), (2, -1.0 / 12.0), (-2, 1.0 / 12.0))
T_END = 2.0


def recorded(seed: int) -> sb.System:
    """Spring stops, under a record besides the drive."""
    rng = np.random.default_rng([39, seed])
    system = driven(rng, [partial(stops_of, law="")])
    force = sb.Sampled(np.linspace(0.0, T_END, 9), 4.0 * rng.normal(size=9), str(rng.choice(["linear", "cubic"])))
    return replace(system, loads=(*system.loads, (rng.normal(size=system.size), force)))


def random_system(index: int) -> tuple[sb.System, dict[str, float]]:
    """System ``index``, of every kind of contact in turn, and its parameters by path."""
    system = (recorded, kelvin_voigt_system, rigid_system, free_system)[index % 4](index)
    (contact, *_), names = system.contacts, ["loads[0].time.amplitude", "loads[0].time.frequency", "v0[0]"]
    names += [f"contacts[0].stops.{x}" for x in ("lower", "upper") if getattr(contact.stops, x) is not None]
    names += ["contacts[0].stops.restitution"] if contact.stops.restitution else []
    names += [] if contact.stops.rigid else ["contacts[0].stops.stiffness"]
    names += ["contacts[0].stops.damping"] if contact.stops.damping else ["loads[0].time.phase"]
    names += ["contacts[0].offset.amplitude", "contacts[0].offset.frequency"] if contact.offset else []
    names += ["loads[1].time.values[3]"] if index % 4 == 0 else []
    return system, {name: value_at(system, name) for name in names}


def distances(index: int, count: int) -> tuple[float, float, int]:
    """Distance of derivatives to differences of order 4, the same over what is known of these, and how many compared.

    In ``count`` of the system's parameters. Differences are known to the least distance between two widths of them.
    Distances are relative to the largest derivative of that quantity, and no less than a thousandth of it over the
    parameter.
    """
    system, parameters = random_system(index)
    t = np.linspace(0.0, T_END, 12)[1:]
    seen = lambda run: np.array([run.tip, run.tip_velocity])  # noqa: E731
    reference = solve_exact(system, T_END, t)
    paths = np.random.default_rng(index).permutation(list(parameters))[:count].tolist()
    change = reference.derivative(paths)
    worst, beyond, compared = 0.0, 0.0, 0
    for p, path in enumerate(paths):
        value, differences = parameters[path], []
        scale = max(abs(value), 0.1)
        for h in np.multiply(WIDTHS, scale):
            runs = [solve_exact(with_values(system, {path: value + k * h}), T_END, t) for k, _ in ORDER_4]
            if all(run.impacts.count == reference.impacts.count for run in runs):
                differences.append(sum(weight * seen(run) for run, (_, weight) in zip(runs, ORDER_4, strict=True)) / h)
        if len(differences) < 2:
            continue
        for found, wanted, here in zip(
            np.swapaxes(differences, 0, 1), seen(change)[..., p], seen(reference), strict=True
        ):
            known = np.isfinite(wanted) & np.all(np.isfinite(found), axis=0)
            if np.any(known):
                size = max(np.max(np.abs(wanted[known])), 1e-3 * np.max(np.abs(here[known])) / scale, 1e-300)
                error = np.min(np.abs(found - wanted)[:, known], axis=0) / size
                spread = np.min(np.abs(np.diff(found[:, known], axis=0)), axis=0) / size
                worst, compared = max(worst, float(np.max(error))), compared + len(error)
                beyond = max(beyond, float(np.max(error / (1e-9 + spread))))
    return worst, beyond, compared


@pytest.mark.parametrize(
    ("first", "count", "parameters"),
    [(24, 4, 1), pytest.param(0, 40, 1, marks=pytest.mark.slow), pytest.param(0, 2000, 2, marks=pytest.mark.campaign)],
)
def test_derivatives_are_those_of_differences_of_exact_flows(first, count, parameters):
    """Differences of order 4 lose rounding times the growth of neighbours over the width: most agree to 1e-9."""
    found = [distances(index, parameters) for index in range(first, first + count)]
    errors, beyond, compared = np.array(found).T
    assert np.all(beyond < 10.0), np.flatnonzero(beyond >= 10.0)
    assert np.mean(errors < 1e-8) > 0.9
    assert np.median(errors) < 1e-9
    assert np.sum(compared) > 15 * count


def test_a_free_mass_and_a_spring_in_closed_form():
    """x = v t to the gap g, half a period of sqrt(kappa/m) in the stop, then back."""
    m, kappa, g, v = 2.0, 50.0, 0.3, 1.5
    system = one_mass(0.0, sb.Stops(upper=g, stiffness=kappa), mass=m, v=v)
    reference = sb.reference(system, 2.0, t_eval=[0.1, 1.9])
    change = reference.derivative(["initial_velocity", "stops.upper", "stops.stiffness"])
    half = np.pi * np.sqrt(m / kappa)
    assert change.wrt == ("v0[0]", "stops.upper", "stops.stiffness")
    # afterwards x = g - v (t - g/v - half)
    assert np.allclose(change.tip[-1], [-1.9 + half, 2.0, v * -half / (2.0 * kappa)], rtol=1e-12)
    assert np.allclose(change.tip_velocity, [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], atol=1e-12)
    assert change.horizon == 1.9
    assert np.isinf(change.exists_until)
    along = reference.derivative([("mass", [[1.0]])])
    assert along.wrt == ("mass along a direction",)
    assert np.allclose(along.tip[-1], v * half / (2.0 * m), rtol=1e-12)


@pytest.mark.parametrize("name", ["mass", "damping", "stiffness"])
def test_a_direction_of_a_matrix_agrees_with_differences(name):
    """Gyroscopic rotor: the damping and its direction are not symmetric. Order 2 at this width leaves 1e-9."""
    system, rng, t = rotor(), np.random.default_rng(3), np.array([0.0, 0.3])
    direction = rng.normal(size=(4, 4))
    if name != "damping":
        direction = direction + direction.T
    change = sb.reference(system, 0.3, t_eval=t).derivative([(name, direction)])
    width, ends = 1e-5, []
    for way in (width, -width):
        moved = replace(system, **{name: getattr(system, name) + way * direction})
        ends.append(np.concatenate([x[-1] for x in sb.reference(moved, 0.3, t_eval=t).states]))
    slope = (ends[0] - ends[1]) / (2.0 * width)
    np.testing.assert_allclose(change.state[-1, :, 0], slope, atol=1e-6 * np.max(np.abs(slope)))


@pytest.mark.parametrize("wrt", [("rows", np.eye(2)), ("stiffness", [[0.0, 1.0], [0.0, 0.0]]), ("mass", [1.0]), 3])
def test_a_direction_that_is_none_is_refused(wrt):
    system = sb.System.from_matrices(np.eye(2), np.eye(2), initial_velocity=[1.0, 0.0], observe=[1.0, 0.0])
    with pytest.raises(InputError, match="wrt"):
        sb.reference(system, 1.0).derivative([wrt])


def test_a_tip_that_no_wave_has_reached_does_not_end_the_horizon():
    system = sb.semidiscretise(sb.paper_case(10).problem, 25)
    assert sb.reference(system, 0.02).derivative(["base.amplitude"]).horizon == 0.02


def test_a_bouncing_ball_in_closed_form_until_its_chatter_ends():
    """t_n = t_1 (1 + 2 e + ... + 2 e^(n-1)), t_1 = sqrt(2 h/a); behind it x = v_n s - a s^2/2, v_n = e^n a t_1."""
    h, a, e = 1.0, 9.81, 0.6
    system = one_mass(0.0, sb.Stops(lower=0.0, stiffness=np.inf, restitution=e), load=sb.Constant(-a), q=h)
    reference = sb.reference(system, 3.0)
    paths = ["q0[0]", "contacts[0].stops.restitution", "loads[0].time.level"]
    change = reference.derivative(paths)
    first, n = np.sqrt(2.0 * h / a), np.arange(6)
    times = first * (2.0 * np.cumsum(e**n) - 1.0)
    by_e = 2.0 * first * np.cumsum(n * e ** np.maximum(n - 1.0, 0.0))
    assert np.allclose(reference.impacts.times[:6], times, rtol=1e-12)
    speeds, s = e ** (n + 1) * a * first, 0.5 * np.diff(times)  # halfway to the next impact
    late, faster = (
        [times / (2.0 * h), by_e, times / (2.0 * a)],
        [1.0 / (2.0 * h), (n + 1) / e, -1.0 / (2.0 * a) + 0 * n],
    )
    for p, own in enumerate([0.0, 0.0, 0.5 * s**2]):  # level = -a
        by = (speeds * faster[p])[:-1] * s - (speeds[:-1] - a * s) * late[p][:-1] + own
        np.testing.assert_allclose(reference.derivative(paths, times[:-1] + s).tip[:, p], by, rtol=1e-10, atol=1e-13)
    end = first * (1.0 + e) / (1.0 - e)
    assert abs(change.exists_until - end) < 1e-9
    assert "chatter" in change.reason
    assert np.all(np.isnan(change.tip[reference.t > end]))
    assert np.all(np.isfinite(change.tip[reference.t < end - 1e-6]))


def test_at_a_graze_no_impact_time_has_a_derivative():
    """x = v sin t touches the stop at 1 with the speed sqrt(v^2 - 1), which rounding of v makes anything to 2e-8."""
    stops = sb.Stops(upper=1.0, stiffness=np.inf, restitution=0.5)
    reference = sb.reference(one_mass(1.0, stops, v=1.0 + 4e-16), 3.0)
    change = reference.derivative(["v0[0]"])
    assert reference.impacts.count
    assert abs(change.exists_until - np.pi / 2.0) < 1e-6
    assert "graze" in change.reason
    assert np.all(np.isnan(change.tip[reference.t > 1.6]))
    assert np.allclose(change.tip[reference.t < 1.5, 0], np.sin(reference.t[reference.t < 1.5]), atol=1e-13)
    assert np.isinf(sb.reference(one_mass(1.0, stops, v=1.0 + 1e-10), 3.0).derivative(["v0[0]"]).exists_until)


@pytest.mark.parametrize("where", ["loads[0].time.values[3]", "contacts[0].offset.values[3]"])
def test_a_cubic_record_of_a_load_and_of_a_pressed_stop(where):
    """The motion is linear in the samples of either while the contact presses: one difference is exact."""
    record = sb.Sampled(np.linspace(0.0, 3.0, 7), np.array([0.0, 0.1, -0.1, 0.15, 0.0, 0.1, 0.0]), "cubic")
    stops = sb.Stops(upper=-9.0, stiffness=30.0)
    system = one_mass(4.0, stops, load=record, offset=record, q=-270.0 / 34.0, v=1.0)

    def tip(by: float) -> Any:
        moved = with_values(system, {where: 0.15 + by})
        return sb.reference(moved, 3.0, t_eval=np.linspace(0.1, 3.0, 30))

    found = tip(0.0).derivative([where]).tip[:, 0]
    np.testing.assert_allclose(found, 10.0 * (tip(0.05).tip - tip(-0.05).tip), rtol=0.0, atol=1e-12)
    assert np.max(np.abs(found)) > 0.01


def test_what_a_derivative_refuses(table10):
    system = sb.semidiscretise(table10, 4)
    reference = sb.reference(system, 0.02)
    with pytest.raises(sb.InputError, match="be a path to a number of the system"):
        reference.derivative(["stops.stifness"])
    with pytest.raises(sb.InputError, match="name parameters"):
        reference.derivative([])
    with pytest.raises(sb.InputError, match=r"t must increase"):
        reference.derivative(["v0[0]"], [0.015, 0.01])
    with pytest.raises(sb.InputError, match="keep the terms of the loads"):
        reference.derivative(["viscosity"])  # at 0 the load of the moving clamp has one term less
    tip = replace(table10, stops=replace(table10.stops, position=1.0))
    with pytest.raises(sb.InputError, match="exponents"):
        reference.derivative(["stops.exponent"])  # beside 1 the law is another
    with pytest.raises(sb.InputError, match="keep the terms of the loads, the observed points"):
        sb.reference(sb.semidiscretise(tip, 4), 0.02).derivative(["stops[0].position"])


@pytest.mark.parametrize("form", ["displacement", "velocity-curvature", "hermite"])
def test_the_place_of_a_stop_beside_and_on_a_node(table10, form):
    """Rows of linear elements have a kink on a node, and no derivative there; those of cubic ones have one slope."""

    def tip(place: float) -> sb.Reference:
        stops = replace(table10.stops, lower=-0.05, upper=0.05, stiffness=5e4, position=place)
        system = sb.semidiscretise(replace(table10, stops=stops), 8, form)
        return sb.reference(system, 0.1, t_eval=[0.0, 0.1])

    for place in (0.501, 0.52, 0.5):
        if place == 0.5 and form != "hermite":
            with pytest.raises(sb.InputError, match="smooth"):
                tip(place).derivative(["stops[0].position"])
            continue
        change = tip(place).derivative(["stops[0].position"])
        difference = (tip(place + 1e-6).tip[-1] - tip(place - 1e-6).tip[-1]) / 2e-6
        assert change.bounds[0] < 1e-6
        assert change.tip[-1, 0] == pytest.approx(difference, rel=1e-6)
        assert abs(difference) > 0.1  # the stop is hit


def test_impacts_at_one_time_have_no_derivative():
    """Two balls fall from 1, with a damper between them: one that stops first slows the other."""
    contacts = [sb.Contact(row, sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.8)) for row in np.eye(2)]
    load, damping = ([-1.0, -1.0], sb.Constant(9.81)), np.array([[0.2, -0.1], [-0.1, 0.2]])
    start = {"initial_displacement": [1.0, 1.0]}
    balls = sb.System.from_matrices(np.eye(2), np.zeros((2, 2)), damping, [load], contacts, **start)
    change = sb.reference(balls, 0.6).derivative(["q0[0]"])
    assert abs(change.exists_until - 0.455) < 1e-3
    assert "at one time" in change.reason
    assert np.all(np.isnan(change.tip[-1]))


@pytest.mark.parametrize("stops", [{"stiffness": np.inf, "restitution": 0.5}, {"stiffness": 100.0, "damping": 5.0}])
@pytest.mark.parametrize("path", ["q0[0]", "stops.upper"])
def test_a_start_on_a_rigid_or_damped_stop_has_no_derivative(stops, path):
    system = one_mass(1.0, sb.Stops(upper=1.0, **stops), q=1.0, v=-1.0)
    change = sb.reference(system, 1.0).derivative([path])
    assert change.exists_until == 0.0
    assert "starts on its stop" in change.reason


def test_a_released_contact_moves_with_its_load():
    """A mass on a rigid stop, pulled by a sin(w t) - p: it leaves where a sin(w t) = p."""
    a, p, w = 3.0, 1.0, 2.0
    contact = sb.Contact(np.ones(1), sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.0))
    loads = [(np.ones(1), sb.Harmonic(a, w)), (np.ones(1), sb.Constant(-p))]
    system = sb.System.from_matrices([[1.0]], [[0.0]], loads=loads, contacts=[contact])
    t, leaves = np.array([0.1, 0.4]), np.arcsin(p / a) / w
    change = sb.reference(system, 0.4).derivative(["loads[0].time.amplitude"], t)
    # x'' = a sin(w t) - p from rest: nothing depends on the time of the release.
    moved = (np.sin(w * leaves) - np.sin(w * t) + w * (t - leaves) * np.cos(w * leaves)) / w**2
    np.testing.assert_allclose(change.tip[:, 0], np.where(t < leaves, 0.0, moved), rtol=1e-10)


def test_a_rigid_stop_has_no_derivative_in_a_damping() -> None:
    system = one_mass(1.0, sb.Stops(upper=0.1, stiffness=np.inf, restitution=0.5))
    with pytest.raises(sb.InputError, match="be left out for rigid stops"):
        slopes(system, ["stops.damping"])


@pytest.mark.parametrize("path", ["stops[0].upper", "base.amplitude", "base.frequency", "stiffness"])
def test_a_stiff_beam_keeps_its_digits(path: str) -> None:
    """Ten cells of Table 10's beam and ten events: an exponential that is not balanced errs by 3e-8 here."""
    end, beam = 0.06, sb.semidiscretise(sb.paper_case(10).problem, 10)

    def tip(by: float) -> np.ndarray:
        system = with_values(beam, {path: value_at(beam, path) + by})
        return Solver(system).solve(end).states(np.array([end]))[0][0]

    h = 1e-5 * value_at(beam, path)
    difference = (tip(-2 * h) - 8 * tip(-h) + 8 * tip(h) - tip(2 * h)) / (12 * h)
    exact = sb.reference(beam, end, t_eval=[0.0, end]).derivative([path], [end]).state[0, : beam.size, 0]
    np.testing.assert_allclose(exact, difference, rtol=0, atol=4e-9 * np.max(np.abs(difference)))


def test_a_contact_that_leaves_its_stop_slowly_does_not_graze_it():
    """Held with e = 0 by a stop that moves, and let go with no speed: against differences of order 4."""
    record = sb.Sampled(np.linspace(0.0, 3.0, 7), np.array([0.0, 0.1, -0.1, 0.15, 0.0, 0.1, 0.0]), "cubic")
    stops = sb.Stops(upper=0.2, stiffness=np.inf, restitution=0.0)

    def moved(amplitude: float) -> sb.Reference:
        system = one_mass(4.0, stops, damping=0.1, load=sb.Harmonic(amplitude, 2.3), offset=record, v=1.0)
        return sb.reference(system, 3.0, t_eval=[1.1, 2.0, 3.0])

    change = moved(2.0).derivative(["loads[0].time.amplitude"])
    assert np.isinf(change.exists_until)
    difference = (
        sum(weight * moved(2.0 + k * 1e-3).tip for k, weight in zip((-2, -1, 1, 2), (1, -8, 8, -1), strict=True))
        / 12e-3
    )
    np.testing.assert_allclose(change.tip[:, 0], difference, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("law", [{"stiffness": 10.0}, {"stiffness": 10.0, "damping": 0.5},
                                 {"stiffness": np.inf, "restitution": 0.5}])  # fmt: skip
@pytest.mark.parametrize("wrt", ["loads[0].time.amplitude", "v0[0]"])
def test_a_contact_that_rests_without_a_force_has_no_derivative(law, wrt):
    """Pushed one way it swings freely, the other way on its stop: two one-sided derivatives."""
    system = one_mass(1.0, sb.Stops(upper=0.0, **law), load=sb.Harmonic(0.0, 3.0))
    found = sb.reference(system, 2.0).derivative([wrt], t=[1.0])
    assert found.exists_until == 0.0
    assert "rests on its stop" in found.reason
    assert np.all(np.isnan(found.tip))


def test_every_array_of_a_system_has_its_own_bound():
    """The row of a stop depends on the length, but its slope is 1e12 times less than that of the stiffness."""
    for place, smooth in ((0.5001, True), (0.5, False)):  # a node is a kink
        stops = sb.Stops(upper=0.1, stiffness=1e4, position=place)
        system = sb.semidiscretise(sb.BeamProblem(stiffness=3e10, stops=stops), 4)
        if not smooth:
            with pytest.raises(InputError, match="smooth"):
                slopes(system, ["length"])
            continue
        _, (column,), (bound,) = slopes(system, ["length"])
        row = column.rows[0]
        assert np.max(np.abs(row)) > 1.0  # theta = 4 place/length - 2 has the slope -2.0004
        assert np.allclose(row[1:3], [2.0004, -2.0004], rtol=10.0 * bound)
