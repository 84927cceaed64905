"""The table of impacts beyond the marches' own law: contact that is there at the start, files, references."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.trajectory.records import COLUMNS, Impacts

METHODS = ["exact", "multiprecision", "cvode", "dop853", "scheme"]


def test_rows_are_taken_and_put_together():
    system = sb.semidiscretise(sb.paper_case(10).problem, 10)
    impacts = sb.integrate(system, sb.HHT(alpha=-0.1), 1e-3, 0.6).impacts
    again = Impacts.concatenate([impacts.take(slice(0, 3)), impacts.take(np.arange(impacts.count) >= 3)])
    for name in COLUMNS:
        assert np.array_equal(getattr(again, name), getattr(impacts, name), equal_nan=True)
    assert again.kind == impacts.kind
    assert impacts.until(impacts.times[2]).count == 3


def hammer(v0: float = 1.0, load: Any = None, **law: Any) -> sb.System:
    """A free mass of 1 that starts on its stop at 0."""
    return one_mass(0.0, sb.Stops(upper=0.0, **law), load=load or sb.Constant(0.0), v=v0)


def solved(system: sb.System, method: str) -> sb.Trajectory:
    """To t = 1, by a reference or by HHT or Moreau-Jean."""
    if method != "scheme":
        return sb.reference(system, 1.0, method)
    rigid = np.isinf(system.contacts[0].stops.stiffness)
    return sb.integrate(system, sb.MoreauJean(theta=0.5) if rigid else sb.HHT(alpha=-0.1), 1e-4, 1.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.fast(2)
def test_a_stroke_that_starts_on_the_stop_has_a_row(method, tmp_path):
    """Half a sine: m v sqrt(kappa/m) = 10 and 2 m v until pi sqrt(m/kappa); it counts as no impact."""
    run = solved(hammer(stiffness=100.0), method)
    row = run.impacts.at_start
    assert run.impacts.count == 0
    assert [row.count, row.times[0], row.stops[0]] == [1, 0.0, 1]
    rel = 1e-4 if method == "scheme" else 1e-8
    assert [row.ends[0], row.peaks[0], row.impulses[0]] == pytest.approx([np.pi / 10.0, 10.0, 2.0], rel=rel)
    saved = sb.load(run.save(tmp_path / "run.nc"))
    assert saved.impacts.count == 0
    for table in (run.impacts, saved.impacts):
        frame = table.to_dataframe()
        assert frame["impact_open_at_start"].tolist() == [True]
        assert frame["impact_peak_force"][0] == row.peaks[0]


@pytest.mark.parametrize("method", ["exact", "multiprecision", "cvode", "scheme"])
@pytest.mark.fast(2)
def test_a_damped_stroke_that_starts_on_the_stop(method):
    """x'' + 19 x' + 100 x = 0: the force is largest at t = 0, c v, and ends before the gap opens, where it is zero."""
    run = solved(hammer(stiffness=100.0, damping=19.0), method)
    row, w = run.impacts.at_start, np.sqrt(100.0 - 9.5**2)
    end = (np.pi - np.arctan2(19.0 * w, 100.0 - 19.0 * 9.5)) / w
    speed = np.exp(-9.5 * end) * (np.cos(w * end) - 9.5 / w * np.sin(w * end))
    rel = 1e-3 if method == "scheme" else 1e-7
    assert [row.ends[0], row.peaks[0], row.impulses[0]] == pytest.approx([end, 19.0, 1.0 - speed], rel=rel)


@pytest.mark.parametrize("method", ["exact", "scheme"])
def test_a_blow_of_a_rigid_stop_at_the_start_has_a_row(method):
    """(1 + e) m v; pressed by 2 with e = 0, m v + 2 t, which is open at the end; by cos 2t until pi/4, with 1/2."""
    row = solved(hammer(stiffness=np.inf, restitution=0.5), method).impacts.at_start
    assert row.impulses == pytest.approx([1.5])
    assert row.ends[0] == pytest.approx(0.0, abs=2e-4)
    run = solved(hammer(load=sb.Constant(2.0), stiffness=np.inf, restitution=0.0), method)
    assert run.impacts.count == 0
    assert np.isnan(run.impacts.at_start.ends[0])
    assert run.contacts[0].impulse == pytest.approx(3.0, rel=1e-3)
    if method == "exact":
        run = solved(hammer(0.0, sb.Harmonic(1.0, 2.0, np.pi / 2.0), stiffness=np.inf, restitution=0.5), method)
        row = run.impacts.at_start
        assert [row.ends[0], row.impulses[0]] == pytest.approx([np.pi / 4.0, 0.5], rel=1e-9)
        assert run.impacts.count == 0
