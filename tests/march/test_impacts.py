"""The table of impacts: when contacts begin and end, by every march and every solver."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references.horizon import time_tolerance
from stiffbeam.trajectory.records import COLUMNS, Impacts


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
                found.append((begun, root(k, stops.upper_bound if chi[k - 1] > 0 else stops.lower_bound)))
                begun = None
            if chi[k] != 0:
                begun = root(k, stops.upper_bound if chi[k] > 0 else stops.lower_bound)
    return found if begun is None else [*found, (begun, np.nan)]


@pytest.mark.slow
def test_sampled_contacts_begin_and_end_where_the_hermite_cubics_cross(system, kernel):
    run = sb.integrate(system, sb.HHT(alpha=-0.1), 2e-4, 0.6)
    stops = system.contacts[0].stops
    expected = np.array(spans(run.t, run.tip, run.tip_velocity, stops))
    assert run.impacts.count > 10
    assert np.allclose(np.stack([run.impacts.times, run.impacts.ends], axis=1), expected, atol=1e-12, equal_nan=True)
    closed = ~np.isnan(run.impacts.ends)
    assert np.all(run.impacts.durations[closed] > 0.0)
    assert np.all(run.impacts.ends[:-1] <= run.impacts.times[1:])


@pytest.mark.slow
def test_a_march_of_single_steps_sees_the_same_ends(system, monkeypatch):
    """A contact may begin in one block of steps and end in another."""
    blocks = sb.integrate(system, sb.BDF2(), 2e-4, 0.3).impacts
    monkeypatch.setattr("stiffbeam.march.integrate.block_length", lambda *_: 1)
    steps = sb.integrate(system, sb.BDF2(), 2e-4, 0.3).impacts
    assert blocks.count > 5
    assert np.allclose(steps.ends, blocks.ends, atol=1e-9, equal_nan=True)


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


def hammer(v0: float = 1.0, load: float = 0.0, **law: Any) -> sb.System:
    """A free mass of 1 that starts on its stop at 0."""
    return one_mass(0.0, sb.Stops(upper=0.0, **law), load=sb.Constant(load), v=v0)


def at_start(run: sb.Trajectory) -> Impacts:
    """Row of the contact that is there at t = 0."""
    assert run.impacts.at_start is not None
    return run.impacts.at_start


def solved(system: sb.System, method: str) -> sb.Trajectory:
    """Solution to t = 1, by a reference or by HHT or Moreau-Jean."""
    if method != "scheme":
        return sb.reference(system, 1.0, method)
    rigid = np.isinf(system.contacts[0].stops.stiffness)
    return sb.integrate(system, sb.MoreauJean(theta=0.5) if rigid else sb.HHT(alpha=-0.1), 1e-4, 1.0)


@pytest.mark.parametrize("method", ["exact", "multiprecision", "cvode", "dop853", "scheme"])
def test_a_stroke_that_starts_on_the_stop_has_a_row(method, tmp_path):
    """Half a sine: m v sqrt(kappa/m) = 10 and 2 m v until pi sqrt(m/kappa); it counts as no impact."""
    run = solved(hammer(stiffness=100.0), method)
    row = at_start(run)
    assert run.impacts.count == 0
    assert row.count == 1
    rel = 1e-4 if method == "scheme" else 1e-8
    assert [row.times[0], row.stops[0]] == [0.0, 1]
    assert [row.ends[0], row.peaks[0], row.impulses[0]] == pytest.approx([np.pi / 10.0, 10.0, 2.0], rel=rel)
    saved = sb.load(run.save(tmp_path / "run.nc"))
    assert saved.impacts.count == 0
    for table in (run.impacts, saved.impacts):
        frame = table.to_dataframe()
        assert frame["impact_open_at_start"].tolist() == [True]
        assert frame["impact_peak_force"][0] == row.peaks[0]


@pytest.mark.parametrize("method", ["multiprecision", "cvode", "scheme"])
def test_a_damped_stroke_that_starts_on_the_stop(method):
    """Its force is largest at t = 0, c v, and ends before the gap opens."""
    system = hammer(stiffness=100.0, damping=19.0)
    row, known = (at_start(solved(system, name)) for name in (method, "exact"))
    rel = 1e-3 if method == "scheme" else 1e-7
    assert known.peaks[0] == pytest.approx(19.0, rel=1e-12)
    for name in ("ends", "peaks", "impulses"):
        assert getattr(row, name) == pytest.approx(getattr(known, name), rel=rel)


@pytest.mark.parametrize("method", ["exact", "scheme"])
def test_a_blow_of_a_rigid_stop_at_the_start_has_a_row(method):
    """(1 + e) m v; pressed by 2 with e = 0, m v + 2 t, which is open at the end."""
    row = at_start(solved(hammer(stiffness=np.inf, restitution=0.5), method))
    assert row.impulses == pytest.approx([1.5])
    assert row.ends[0] == pytest.approx(0.0, abs=2e-4)
    run = solved(hammer(load=2.0, stiffness=np.inf, restitution=0.0), method)
    assert run.impacts.count == 0
    assert np.isnan(at_start(run).ends[0])
    assert run.contacts[0].impulse == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize("method", ["exact"])
def test_what_a_load_presses_on_a_rigid_stop_has_a_row_until_it_leaves(method):
    """cos(2 t) presses until pi/4, with 1/2."""
    stops = sb.Stops(upper=0.0, stiffness=np.inf, restitution=0.5)
    run = solved(one_mass(0.0, stops, load=sb.Harmonic(1.0, 2.0, np.pi / 2.0)), method)
    row = at_start(run)
    assert [row.ends[0], row.impulses[0]] == pytest.approx([np.pi / 4.0, 0.5], rel=1e-9)
    assert run.impacts.count == 0


@pytest.mark.parametrize("law", [{"stiffness": 100.0}, {"stiffness": np.inf, "restitution": 0.5}], ids=str)
@pytest.mark.parametrize("method", ["exact", "multiprecision", "scheme"])
def test_rest_on_a_stop_without_a_gap_has_no_row(method, law):
    """Nothing presses it, and nothing moves."""
    if method == "multiprecision" and "restitution" in law:
        pytest.skip("many digits are for compliant stops")
    run = solved(hammer(0.0, **law), method)
    assert run.impacts.count == 0
    assert not run.impacts.listed()[0].impulses.any() or np.isnan(run.impacts.listed()[0].ends).all()


@pytest.mark.filterwarnings("ignore:invalid value")
def test_extrapolated_forces_of_several_stops_overflow_as_those_of_one():
    """The sum of squared forces overflows long before a position does: that is no failure of a search."""
    contacts = [sb.Contact(np.ones(1), sb.Stops(lower=-0.1, stiffness=1e4, exponent=p)) for p in (1.5, 3.0)]
    system = sb.System.from_matrices([[1.0]], [[1.0]], contacts=contacts, initial_velocity=[-9.0])
    with pytest.raises(sb.Diverged, match="implicit contact"):
        sb.integrate(system, sb.Trapezoidal(), 0.1, 20.0, contact="extrapolated")
