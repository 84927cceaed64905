"""Branches of periodic orbits: folds by the two orbits that meet there, a flip by its multiplier."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references.exact import continuation


def softly_stopped(frequency: float) -> sb.System:
    return one_mass(1.0, sb.Stops(upper=0.5, stiffness=4.0), damping=0.1, load=sb.Harmonic(0.3, frequency))


def turn(frequency: Any) -> Any:
    return 2.0 * np.pi / frequency


def two_sided(frequency: float) -> sb.System:
    if frequency <= 0.0:
        raise sb.InputError("frequency", frequency, "be > 0", "for example 1.0")
    stop = sb.Stops(lower=-0.5, upper=0.5, stiffness=400.0)
    return one_mass(1.0, stop, damping=0.2, load=sb.Harmonic(1.0, frequency))


def test_a_corrector_may_leave_the_values_at_which_the_system_exists():
    """The free orbit grazes and folds at 1.72; the first long step beyond it tries a negative frequency."""
    tried = []

    def recorded(frequency: float) -> sb.System:
        tried.append(frequency)
        return two_sided(frequency)

    branch = sb.continuation(recorded, "frequency", [3.0, *np.linspace(4.5, 1.5, 50)], turn)
    assert min(tried) <= 0.0
    assert branch.folds == pytest.approx([1.723389518], abs=1e-8)
    assert branch.end == "at the end of the values"


def test_a_branch_ends_where_the_system_does():
    def cut(frequency: float) -> sb.System:
        if frequency < 2.2:
            raise sb.InputError("frequency", frequency, "be 2.2 or more", "for example 2.5")
        return two_sided(frequency)

    branch = sb.continuation(cut, "frequency", np.linspace(3.0, 2.2, 8), turn)
    assert branch.end.startswith("at 2.2 frequency must be 2.2 or more")
    assert branch.values[-1] == pytest.approx(2.2, abs=1e-9)
    with pytest.raises(sb.InputError):
        sb.continuation(cut, "frequency", [2.1, 3.0], turn)


@pytest.mark.slow
def test_two_orbits_meet_at_a_fold():
    """Their distance is that of a square root: four times as far from the fold it doubles."""
    branch = sb.continuation(softly_stopped, "frequency", np.linspace(1.25, 1.35, 20), turn)
    assert len(branch.folds) == 2
    fold = float(np.max(branch.folds))
    top = int(np.argmax(np.diff(branch.values) < 0.0))  # where it turns back
    assert 0.0 <= fold - branch.values[top] < 1e-3
    near = int(np.argmin(np.abs(branch.values[: top + 1] - 1.316)))
    branch = sb.continuation(
        softly_stopped, "frequency", np.linspace(branch.values[near], 1.3185, 20), turn, branch.orbit(near)
    )
    assert abs(branch.folds[0] - fold) < 1e-9
    top, distances = int(np.argmax(np.diff(branch.values) < 0.0)), []
    for away in (1e-4, 4e-4):
        value, orbits = fold - away, []
        for k in (slice(0, top + 1), slice(top, int(np.argmin(branch.values[top:])) + top + 1)):
            order = np.argsort(branch.values[k])
            x = branch.values[k][order]
            guess = [np.array([np.interp(value, x, state[k][order, 0])]) for state in (branch.q, branch.v)]
            orbits.append(sb.periodic_orbit(softly_stopped(value), turn(value), guess))
        assert [orbit.stable for orbit in orbits] == [True, False]
        distances.append(abs(orbits[0].q[0] - orbits[1].q[0]))
    assert abs(distances[1] / distances[0] - 2.0) < 0.05
    assert branch.orbit(0).residual < 1e-13


def test_without_contact_it_is_the_linear_response():
    """|q(0)| of x'' + c x' + x = a sin(w t), and its multipliers exp(-c T/2 +- ...)."""

    def linear(frequency: float) -> sb.System:
        return one_mass(1.0, damping=0.2, load=sb.Harmonic(0.3, frequency))

    branch = sb.continuation(linear, "frequency", [0.5, 0.7, 0.9, 1.1, 1.3], turn)
    w = branch.values
    assert len(w) >= 3
    amplitude = 0.3 / (1.0 - w**2 + 0.2j * w)
    assert np.allclose(branch.q[:, 0], amplitude.imag, atol=1e-10)
    assert np.allclose(branch.v[:, 0], amplitude.real * w, atol=1e-10)
    assert np.allclose(np.abs(branch.multipliers), np.exp(-0.1 * turn(w))[:, None], rtol=1e-9)
    assert len(branch.folds) + len(branch.flips) == 0


def damped_beam(frequency: float) -> sb.System:
    stops, base = sb.Stops(-0.1, 0.1, stiffness=5e6), sb.Harmonic(0.2, frequency)
    return sb.semidiscretise(sb.BeamProblem(stiffness=300.0, viscosity=0.05, stops=stops, base=base), 8)


@pytest.mark.slow
def test_the_flip_of_the_beam():
    """Where the multiplier of the 90-event orbit is -1: 32.975300288681 by a prototype."""
    branch = sb.continuation(damped_beam, "frequency", [33.0, 32.97, 32.94], turn)
    assert np.allclose(branch.flips, 32.975300288681, rtol=0.0, atol=1e-9)
    assert len(branch.flips) == 1
    assert list(branch.stable[[0, -1]]) == [False, True]


@pytest.mark.slow
def test_a_branching_of_the_beam():
    """Of branches with different points. With points closer to the place than BESIDE they differ by 1e-8."""
    places = [
        sb.continuation(damped_beam, "frequency", np.linspace(49.63, 49.58, count), turn).at("branching")
        for count in (6, 7, 9)
    ]
    assert np.allclose(places, [[49.5998487551]], rtol=0.0, atol=1e-10)


def grazed(gap: float, stiffness: float) -> sb.System:
    """x'' + 0.1 x' + x = cos(2.8 t) below a stop: without contact |x| has the amplitude GRAZING."""
    restitution = 0.8 if np.isinf(stiffness) else None
    stop = sb.Stops(upper=gap, stiffness=stiffness, restitution=restitution)
    return one_mass(1.0, stop, damping=0.1, load=sb.Harmonic(1.0, 2.8))


RESPONSE = 1.0 / (1.0 - 2.8**2 + 0.28j)
GRAZING = abs(RESPONSE)


@pytest.mark.fast(1)
@pytest.mark.parametrize(
    ("values", "stiffness"),
    [(np.linspace(0.2, 0.1, 9), 5.0), (np.linspace(0.2, 0.1, 9), np.inf), (np.linspace(0.05, 0.2, 9), np.inf)],
)
def test_a_grazing_in_closed_form(values, stiffness):
    """The linear response reaches the stop: from without contact, and from the unstable orbit with an impact."""
    guess = ([RESPONSE.imag], [2.8 * RESPONSE.real]) if values[0] > GRAZING else None
    branch = sb.continuation(
        lambda gap: grazed(gap, stiffness), "gap", values, turn(2.8), guess, grazings=np.isfinite(stiffness)
    )
    assert np.allclose(branch.at("grazing"), GRAZING, rtol=0.0, atol=1e-9)
    assert len(branch.at("grazing")) == 1
    if np.isinf(stiffness):
        assert "grazes its rigid stop" in branch.end
        assert np.all(branch.stable) == (values[0] > GRAZING)
    else:
        assert list(branch.events[[0, -1]]) == [0, 2]
        assert branch.values[-1] == pytest.approx(0.1)


@pytest.mark.slow
def test_the_graze_of_a_damped_stop_in_closed_form():
    """Past the frequency at which the linear response has the size of the gap, a touched orbit, unstable, is free."""

    def damped(frequency: float, gap: float = 0.2, damping: float = 4.0) -> sb.System:
        stop = sb.Stops(upper=gap, stiffness=5.0, damping=damping)
        return one_mass(1.0, stop, damping=0.1, load=sb.Harmonic(1.0, frequency))

    branch = sb.continuation(damped, "frequency", np.linspace(2.4, 3.2, 12), turn)
    # (1 - w^2)^2 + 0.01 w^2 = 25
    exact = np.sqrt(0.995 + np.sqrt(0.995**2 + 24.0))
    assert np.allclose(branch.at("grazing"), [exact], rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(branch.stable, branch.values > exact)
    # Small steps cannot pass the graze: its reason ends the branch.
    guess = ([RESPONSE.imag], [2.8 * RESPONSE.real])
    ended = sb.continuation(lambda x: damped(2.8, x, 0.5), "gap", np.linspace(0.2, 0.1, 9), turn(2.8), guess)
    assert "grazes its damped stop" in ended.end
    assert np.allclose(ended.at("grazing"), [GRAZING], rtol=0.0, atol=1e-9)


def hard(frequency: float) -> sb.System:
    return one_mass(1.0, sb.Stops(upper=0.0, stiffness=400.0), damping=0.2, load=sb.Harmonic(1.0, frequency))


@pytest.mark.slow
def test_a_march_comes_back_to_the_doubled_branch():
    """Beside the flip it is near the orbit of one period; an adaptive march that starts off it settles on it."""
    branch = sb.continuation(hard, "frequency", np.linspace(2.5, 2.65, 10), turn)
    assert list(branch.stable[[0, -1]]) == [True, False]
    doubled = branch.doubled(0)
    assert np.all(doubled.stable)
    assert 0.0 < doubled.values[0] - branch.flips[0] < 1e-3
    w = float(doubled.values[-1])
    q, v = doubled.q[-1], doubled.v[-1]
    start = replace(hard(w), q0=q + 1e-2, v0=v, origin=None)
    t = turn(w) * np.array([0.0, 100.0, 101.0, 102.0])
    march = sb.reference(start, t[-1], method="dop853", t_eval=t, rtol=1e-10, atol=1e-12)
    assert np.allclose(march.tip[[1, 3]], q[0], atol=1e-7)
    assert abs(march.tip[2] - q[0]) > 0.1
    with pytest.raises(sb.InputError, match="be the number of a flip, of which there are 1"):
        branch.doubled(1)


def test_a_branch_that_loses_its_symmetry():
    """A mass between two stops: a multiplier is 1 without a fold where orbits that are not symmetric leave.

    Witness: the map over half a period with the sign of the state turned, by differences, has the multiplier -1 there.
    """

    def symmetric(frequency: float) -> sb.System:
        return one_mass(1.0, sb.Stops(-0.5, 0.5, stiffness=50.0), damping=0.1, load=sb.Harmonic(2.0, frequency))

    branch = sb.continuation(symmetric, "frequency", np.linspace(4.0, 1.5, 20), turn)
    assert [x.kind for x in branch.bifurcations] == ["branching"]
    point = branch.bifurcations[0]
    # The place does not depend on the points beside it, although the corrector is singular there.
    other = sb.continuation(symmetric, "frequency", np.linspace(2.0, 1.5, 13), turn)
    assert abs(other.at("branching")[0] - point.value) < 1e-12
    half = 0.5 * turn(point.value)

    def turned(z: np.ndarray) -> np.ndarray:
        moved = replace(symmetric(point.value), q0=z[:1], v0=z[1:], origin=None)
        run = sb.reference(moved, half, method="dop853", t_eval=[0.0, half], rtol=1e-12, atol=1e-14)
        return -np.array([run.tip[-1], run.tip_velocity[-1]])

    assert np.allclose(turned(point.z), point.z, atol=1e-3)  # along the crossing branch z is known to sqrt(rounding)
    h = 1e-5
    slope = np.column_stack([(turned(point.z + h * e) - turned(point.z - h * e)) / (2.0 * h) for e in np.eye(2)])
    assert np.min(np.abs(np.linalg.eigvals(slope) + 1.0)) < 1e-3


@pytest.mark.slow
def test_a_torus_of_two_masses():
    """Where a pair of multipliers of an impacting orbit leaves the unit circle; witness: differences of a march.

    The march: matrix exponentials between impacts, impacts by bisection.
    """
    m, c, zeta, e = np.array([1.0, 5.0]), np.array([[1.0, -1.0], [-1.0, 2.0]]), 0.1, 0.8

    def masses(frequency: float) -> sb.System:
        stop = sb.Contact(np.array([1.0, 0.0]), sb.Stops(upper=0.0, stiffness=np.inf, restitution=e))
        load = ([1.0, 0.0], sb.Harmonic(1.0, frequency, phase=1.0))
        return sb.System.from_matrices(np.diag(m), c, 2.0 * zeta * c, loads=[load], contacts=[stop])

    branch = sb.continuation(masses, "frequency", np.linspace(1.75, 1.7, 6), turn)
    assert [x.kind for x in branch.bifurcations] == ["torus"]
    point, w = branch.bifurcations[0], branch.bifurcations[0].value
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-c / m[:, None], -2.0 * zeta * c / m[:, None]]])
    drive = np.linalg.solve(1j * w * np.eye(4) - A, np.array([0.0, 0.0, 1.0, 0.0]) * np.exp(1j))

    def flow(z: np.ndarray, t: float, tau: float) -> np.ndarray:
        now, then = ((drive * np.exp(1j * w * x)).imag for x in (t, t + tau))
        return scipy.linalg.expm(A * tau) @ (z - now) + then

    def mapped(z: np.ndarray) -> np.ndarray:
        t, step = 0.0, turn(w) / 200
        for _ in range(200):
            ahead = flow(z, t, step)
            if ahead[0] > 0.0:
                low, high = 0.0, step
                for _ in range(60):
                    middle = 0.5 * (low + high)
                    low, high = (low, middle) if flow(z, t, middle)[0] > 0.0 else (middle, high)
                z = flow(z, t, low) * [1.0, 1.0, -e, 1.0]
                ahead = flow(z, t + low, step - low)
            z, t = ahead, t + step
        return z

    assert np.allclose(mapped(point.z), point.z, atol=1e-10)
    h = 1e-6
    slope = np.column_stack([(mapped(point.z + h * x) - mapped(point.z - h * x)) / (2.0 * h) for x in np.eye(4)])
    leading = np.linalg.eigvals(slope)
    leading = leading[np.argsort(-np.abs(leading))][:2]
    assert np.allclose(np.abs(leading), 1.0, atol=1e-7)
    assert np.min(np.abs(leading.imag)) > 0.1


def test_what_a_continuation_refuses():
    with pytest.raises(sb.InputError, match="be two or more numbers"):
        sb.continuation(softly_stopped, "frequency", [1.0], turn)
    with pytest.raises(sb.InputError, match="be a multiple of 2 pi"):
        sb.continuation(softly_stopped, "frequency", [1.0, 1.1], 1.0)


def test_a_search_that_is_led_astray_starts_again(monkeypatch):
    """Guesses beside the branch, and a motion that overflows: the flip stays where it is."""
    branch = sb.continuation(hard, "frequency", np.linspace(2.5, 2.65, 10), turn)
    guesses: list[float] = []

    def astray(places: Any, steps: Any, share: float) -> np.ndarray:
        guesses.append(share)
        return np.full_like(steps[0], 0.5)

    calls: list[float] = []

    def overflowing(follower: Any, z: np.ndarray, value: float) -> Any:
        calls.append(value)
        if len(calls) == 3:
            raise FloatingPointError("overflow encountered in multiply")
        return flow(follower, z, value)

    follower = type(branch.follower)
    flow = follower.flow
    monkeypatch.setattr(continuation, "krogh_interpolate", astray)
    monkeypatch.setattr(follower, "flow", overflowing)
    other = sb.continuation(hard, "frequency", np.linspace(2.5, 2.65, 10), turn)
    assert guesses
    assert len(calls) > 7
    assert np.allclose(other.flips, branch.flips, rtol=0.0, atol=1e-10)
    assert len(other.flips) == 1


def test_a_branch_that_ends_where_its_start_meets_a_rigid_stop_says_so():
    """Newton's method then goes beyond the stop by rounding."""

    def resting(w):
        stop = sb.Stops(upper=0.1, stiffness=np.inf, restitution=0.0)
        return one_mass(1.0, stop, damping=0.2, load=sb.Harmonic(1.0, w, np.pi / 2))

    branch = sb.continuation(resting, "frequency", np.linspace(1.5, 0.9, 12), lambda w: 2 * np.pi / w)
    assert branch.end.endswith("the period starts on a stop, where the flow has no derivative")
