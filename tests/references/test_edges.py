"""The exact solution where a gap is zero, and what it does not let out: open ledgers, NaN, endless searches."""

from __future__ import annotations

import dataclasses

import mpmath
import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references.ensemble import reference_ensemble
from stiffbeam.references.exact.motion import Solver
from stiffbeam.references.exact.solution import audit


def over_a_stop(load: float, v: float = 0.0) -> sb.System:
    """q'' + 100 q = load over a stop at 0."""
    return one_mass(100.0, sb.Stops(0.0, None, stiffness=1e4), load=sb.Constant(load), v=v)


def test_a_gap_that_never_leaves_its_zero_stays_one_piece():
    """Two equal masses move alike: the stop between them, met and not pressed, sees nothing of that."""
    contact, alike = sb.Contact([1.0, -1.0], sb.Stops(0.0, None, stiffness=1e4)), {"initial_velocity": [1.0, 1.0]}
    system = sb.System.from_matrices(np.eye(2), 9.0 * np.eye(2), contacts=[contact], observe=[1.0, 0.0], **alike)
    ref = sb.reference(system, 30.0)
    assert ref.work.counters["switches"] == 0
    assert np.max(np.abs(ref.tip - np.sin(3.0 * ref.t) / 3.0)) < 1e-13


# ---------------------------------------------------------------- what must not get out


@pytest.mark.parametrize("damped", [False, True])
def test_a_missed_event_is_a_failure_with_its_time(damped, table10):
    """The audit names a time behind the event that a motion drops, which goes on in the regime of its fifth segment."""
    system = sb.semidiscretise(dataclasses.replace(table10, viscosity=0.02 if damped else 0.0), 8)
    solution, k = Solver(system).solve(0.2), 5
    audit(solution, 0.2)
    with pytest.raises(sb.SolverFailure, match="energy balance is open") as failure:
        audit(solution.first(k), 0.2)
    assert solution.times[k] < failure.value.t <= 0.2


@pytest.mark.parametrize("t_eval", [[np.nan, 0.5], [0.1, np.nan], [0.1, np.inf], [0.1, 2.0]])
@pytest.mark.parametrize("method", ["exact", "multiprecision", "cvode", "dop853"])
def test_output_times_that_are_no_times_are_refused(method, t_eval):
    system = over_a_stop(-10.0, v=1.0)
    with pytest.raises(sb.InputError, match="t_eval"):
        sb.reference(system, 1.0, method, t_eval=t_eval)
    with pytest.raises(sb.InputError, match="t_eval"):
        reference_ensemble(system, 1.0, [system], t_eval=t_eval)
    with pytest.raises(sb.InputError, match=f"did you mean {method}"):
        sb.reference(system, 1.0, method[:-1])


LOST = pytest.mark.xfail(raises=sb.SolverFailure, strict=True, reason="no closed form beside so strong a dashpot yet")


@pytest.mark.parametrize("c", [1e6, *(pytest.param(c, marks=LOST) for c in (1e8, 1.878692e9, 2.442e9))])
def test_what_a_strong_dashpot_holds_is_known_to_its_horizon(c):
    """q2' = (q1 - q2)/c beside q1'' + 0.167 q1' + q1 - q2 = 0: 1e-9 of the motion, less than eigenvectors hold."""
    K, D = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.diag([0.167, c])
    v0 = np.array([0.873, -0.063])
    system = sb.System.from_matrices(np.eye(2), K, D, observe=[0.0, 1.0], initial_velocity=v0)
    found = sb.reference(system, 9.0)
    t = np.linspace(0.0, found.horizon, 30)
    with mpmath.workdps(60):
        A = mpmath.zeros(4)
        A[0, 2] = A[1, 3] = 1
        for i in range(2):
            for j in range(2):
                A[2 + i, j], A[2 + i, 2 + j] = -mpmath.mpf(K[i, j]), -mpmath.mpf(D[i, j])
        values, left, right = mpmath.eig(A, left=True, right=True)
        start = mpmath.matrix([0, 0, *map(mpmath.mpf, v0)])
        parts = [right[1, k] * (left[k, :] * start)[0] / (left[k, :] * right[:, k])[0] for k in range(4)]
        tip = [float(mpmath.re(sum(p * mpmath.exp(x * s) for p, x in zip(parts, values, strict=True)))) for s in t]
    assert np.max(np.abs(found.at(t)[0] - tip)) <= 1e-3 * np.max(np.abs(tip))


def test_a_small_force_beside_a_large_one_is_felt():
    """1e-15 pulls a free mass by 1e-15 t^2/2, where 1 holds another by 1e-12."""
    load = ([1.0, 1e-15], sb.Constant(1.0))
    system = sb.System.from_matrices(
        np.eye(2), np.diag([1e12, 0.0]), np.diag([1.0, 0.0]), observe=[1.0, 1.0], loads=[load]
    )
    assert sb.reference(system, 100.0).tip[-1] == pytest.approx(6e-12, rel=1e-9)


@pytest.mark.parametrize("k", [1e-13, 1e-10, 1e-6])
def test_a_slow_mode_answers_from_rest(k):
    """f (1 - cos w t)/w^2 is f t^2/2 in so short a time, but the static answer f/w^2 has no digit of it."""
    stops = sb.Stops(upper=1e3, stiffness=100.0)
    system = sb.System.from_matrices(
        np.eye(2), np.diag([1.0, k]), loads=[([0.0, 1.0], sb.Constant(1e-3))], observe=[0.0, 1.0],
        contacts=[sb.Contact(row, stops) for row in np.eye(2)],
    )  # fmt: skip
    found = sb.reference(system, 10.0)
    assert found.tip[-1] == pytest.approx(0.05 * (1.0 - k * 100.0 / 12.0), rel=1e-11 + (k * 100.0) ** 2)


def test_a_stiffness_within_the_rounding_of_a_zero_ends_the_horizon():
    """det K = 1e-14, which is 45 roundings of its entries and counts as none: w^2 = 5e-15, lost is w^2 t^2/12."""
    K = np.array([[1.0 + 1e-14, -1.0], [-1.0, 1.0]])
    system = sb.System.from_matrices(
        np.eye(2), K, loads=[([1.0, 0.3], sb.Constant(1e-3))], observe=[1.0, 0.0], initial_velocity=[0.1, 0.0]
    )
    assert 1e5 < sb.reference(system, 6e6).horizon < (12.0 * 1e-3 / 5e-15) ** 0.5


def test_a_span_too_short_for_output_times_is_refused():
    system = over_a_stop(-10.0, v=1.0)
    found = sb.reference(system, 1e-300)
    assert found.horizon == 1e-300
    assert np.allclose(found.tip, found.t, rtol=1e-15, atol=0.0)
    with pytest.raises(sb.InputError, match="t_end"):
        sb.reference(system, 1e-322)


# ---------------------------------------------------------------- by events


def test_the_largest_of_many_nearly_equal_peaks_is_found():
    """Two modes beat while the mass never leaves its stop: the best sample need not stand beside the best peak."""
    contacts = [sb.Contact([0.0, 1.0], sb.Stops(None, 0.0, stiffness=k)) for k in (227.53731723797804, 346.34962543162)]
    system = sb.System.from_matrices(
        np.diag([1.88879202, 1.71843308]), [[11.99455883, -4.75162367], [-4.75162367, 4.75162367]],
        loads=[([0.0, 1.0], sb.Constant(1.9069528109114349))], contacts=contacts,
    )  # fmt: skip
    found = sb.reference(system, 14.0)
    force = np.abs(contacts[0].stops.force(found.at(np.linspace(0.0, 14.0, 400_001), 0)[0]))
    assert found.impacts.count == 0
    assert np.max(force) * (1.0 - 1e-12) <= found.contacts[0].peak_force <= np.max(force) * (1.0 + 1e-8)


@pytest.mark.fast(4)
@pytest.mark.parametrize("method", ["exact", "multiprecision"])
@pytest.mark.parametrize("turn", range(6))
def test_a_graze_as_deep_as_1e_12_of_the_motion_is_seen(turn, method):
    """u = sin t + a sin 3 t has its top 1 - a at t = pi/2 for a < 1/9."""
    a = 0.1 * turn / 5.0
    stop = sb.Stops(upper=(1.0 - a) * (1.0 - 1e-12), stiffness=50.0)
    modes = np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2.0)  # frequencies 1 and 3
    K = modes @ np.diag([1.0, 9.0]) @ modes.T
    contact = sb.Contact(modes @ [1.0, 1.0], stop)
    system = sb.System.from_matrices(np.eye(2), K, contacts=[contact], initial_velocity=modes @ [1.0, 3.0 * a])
    found = sb.reference(system, 2.0, method)
    assert found.impacts.count == 1
    curvature = 1.0 - 9.0 * a
    early = np.sqrt(2e-12 * (1.0 - a) / curvature)
    assert found.impacts.times[0] == pytest.approx(np.pi / 2.0 - early, abs=2e-9)
