"""The table of impacts: when contacts begin and end, by every march and every solver."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import stiffbeam as sb
from stiffbeam.references.horizon import time_tolerance
from stiffbeam.trajectory.impacts import COLUMNS, Impacts


@pytest.fixture(scope="module")
def system() -> sb.System:
    case = sb.paper_case(10)
    return sb.semidiscretise(case.problem, 10)


def spans(t: np.ndarray, u: np.ndarray, v: np.ndarray, stops: sb.Stops) -> list[tuple[float, float]]:
    """Begin and end of every contact after t = 0 in positions at steps: roots of SciPy's Hermite cubics."""
    curve, chi = CubicHermiteSpline(t, u, v), stops.state(u)
    found, begun = [], None

    def root(k: int, stop: float) -> float:
        inside = [s for s in curve.solve(stop, extrapolate=False) if t[k - 1] < s <= t[k]]
        return min(inside)

    for k in range(1, len(t)):
        if chi[k] != chi[k - 1]:
            if chi[k - 1] != 0 and begun is not None:
                found.append((begun, root(k, stops.g2 if chi[k - 1] > 0 else stops.g1)))
                begun = None
            if chi[k] != 0:
                begun = root(k, stops.g2 if chi[k] > 0 else stops.g1)
    return found if begun is None else [*found, (begun, np.nan)]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["numba", "numpy"])
def test_sampled_contacts_begin_and_end_where_the_hermite_cubics_cross(system, engine):
    run = sb.integrate(system, sb.HHT(alpha=-0.1), 2e-4, 0.6, engine=engine)
    stops = system.contacts[0].stops
    expected = np.array(spans(run.t, run.tip, run.tip_velocity, stops))
    assert run.impacts.count > 10
    assert np.allclose(np.stack([run.impacts.times, run.impacts.ends], axis=1), expected, atol=1e-12, equal_nan=True)
    closed = ~np.isnan(run.impacts.ends)
    assert np.all(run.impacts.durations[closed] > 0.0)
    assert np.all(run.impacts.ends[:-1] <= run.impacts.times[1:])


@pytest.mark.slow
def test_a_march_of_single_steps_and_one_in_jax_see_the_same_ends(system):
    """A contact may begin in one block of steps and end in another; a first-order system has no blocks."""
    blocks = sb.integrate(system, sb.BDF2(), 2e-4, 0.3).impacts
    steps = sb.integrate(system.first_order(), sb.BDF2(), 2e-4, 0.3).impacts
    assert blocks.count > 5
    assert np.allclose(steps.ends, blocks.ends, atol=1e-9, equal_nan=True)
    pytest.importorskip("jax")
    members = sb.integrate_ensemble(system, sb.BDF2(), 2e-4, 0.3, sb.perturbed(system, 2, 1e-12), engine="jax")
    assert np.allclose(members.contacts[0].impacts_of(0).ends, blocks.ends, atol=1e-9, equal_nan=True)


@pytest.mark.slow
def test_exact_and_adaptive_ends_agree_and_time_in_contact_is_their_sum(system):
    exact = sb.reference(system, 0.2)
    assert exact.horizon == 0.2
    for method in ("cvode", "dop853", "multiprecision"):
        other = sb.reference(system, 0.2, method)
        inside = exact.impacts.ends < other.horizon
        assert np.count_nonzero(inside) > 3
        # impact times agree to time_tolerance inside the horizon; exits do too, at the same speeds
        difference = exact.impacts.ends[inside] - other.impacts.ends[: len(inside)][inside]
        assert np.max(np.abs(difference)) < time_tolerance(system), method
    ends = np.where(np.isnan(exact.impacts.ends), 0.2, exact.impacts.ends)
    assert np.sum(ends - exact.impacts.times) / 0.2 == pytest.approx(exact.contacts[0].fraction, rel=1e-9)


def test_rows_are_taken_and_put_together(system):
    impacts = sb.integrate(system, sb.HHT(alpha=-0.1), 1e-3, 0.6).impacts
    again = Impacts.concatenate([impacts.take(slice(0, 3)), impacts.take(np.arange(impacts.count) >= 3)])
    for name in COLUMNS:
        assert np.array_equal(getattr(again, name), getattr(impacts, name), equal_nan=True)
    assert again.kind == impacts.kind
    assert impacts.until(impacts.times[2]).count == 3


def test_an_ensemble_and_a_file_keep_the_ends(system, tmp_path):
    run = sb.integrate(system, sb.HHT(alpha=-0.1), 1e-3, 0.6)
    assert np.array_equal(sb.load(run.save(tmp_path / "run.nc")).impacts.ends, run.impacts.ends, equal_nan=True)
    three = sb.integrate_ensemble(system, sb.HHT(alpha=-0.1), 1e-3, 0.6, [system] * 3)
    assert np.array_equal(three.contacts[0].impacts_of(2).ends, run.impacts.ends, equal_nan=True)
