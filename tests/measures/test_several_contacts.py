"""Measures, tables and pictures show every contact of a system."""

from __future__ import annotations

import numpy as np
import pytest
from systems import two_contacts

import stiffbeam as sb
from stiffbeam.measures.errors import first_impacts_end, impact_times, match, matched_until
from stiffbeam.measures.report import common_window


def test_windows_and_matching_hold_for_all_contacts():
    system = two_contacts()
    exact, run = sb.reference(system, 6.0), sb.integrate(system, sb.HHT(), 1e-3, 6.0)
    each = [contact.impacts.times for contact in exact.contacts]
    assert all(len(times) for times in each)
    assert np.array_equal(impact_times(exact), np.sort(np.concatenate(each)))
    n = 5
    end = first_impacts_end(exact, n)
    assert sum(int(np.sum(times < end)) for times in each) == n
    apart = [match(a.impacts, b.impacts, 6.0).matched_until for a, b in zip(run.contacts, exact.contacts, strict=True)]
    assert matched_until(run, exact, 6.0) == min(apart)


@pytest.mark.parametrize("impacts", [1, 2, 3, 4])
def test_a_window_ends_between_impacts_of_several_contacts_at_one_time(impacts):
    """Three equal stops at one unknown are hit together: an end at their impact would be decided by rounding."""
    load, stop = ([1.0], sb.Harmonic(amplitude=1.0, frequency=2.0)), sb.Stops(upper=0.2, stiffness=50.0)
    contacts = [sb.Contact([1.0], stop)] * 3
    system = sb.System.from_matrices([[1.0]], [[1.0]], [[0.05]], loads=[load], contacts=contacts)
    exact = sb.reference(system, 30.0)
    distinct = exact.contacts[0].impacts.times
    last = -(-impacts // 3)
    assert first_impacts_end(exact, impacts) == pytest.approx(0.5 * (distinct[last - 1] + distinct[last]), rel=1e-9)


@pytest.mark.fast(1)
@pytest.mark.parametrize("method", ["exact", "multiprecision", "cvode"])
def test_a_body_that_two_stops_squeeze_from_both_sides_stays_where_it_is(method):
    """Both press 0.1 sin 2t - 0.05 deep, and q = 0: no energy at any switch, 0.25 between them."""
    wave = sb.Harmonic(0.1, 2.0), sb.Harmonic(-0.1, 2.0)
    stops = sb.Stops(upper=0.05, stiffness=100.0), sb.Stops(lower=-0.05, stiffness=100.0)
    pair = [sb.Contact([1.0], stop, offset) for stop, offset in zip(stops, wave, strict=True)]
    system = sb.System.from_matrices([[1.0]], [[1.0]], contacts=pair)
    ref = sb.reference(system, 1.5, method)
    begin = np.arcsin(0.5) / 2.0
    end = np.pi / 2.0 - begin
    impulse = 5.0 * (np.cos(2.0 * begin) - np.cos(2.0 * end)) - 5.0 * (end - begin)
    assert np.max(np.abs(ref.states[0])) < 1e-14
    assert np.max(np.abs(ref.energy.energy)) == pytest.approx(0.25, rel=1e-5)
    assert np.max(np.abs(ref.energy.loss)) < 1e-7
    for record, side in zip(ref.contacts, (1, -1), strict=True):
        assert record.impacts.stops.tolist() == [side]
        assert record.impacts.times == pytest.approx([begin], abs=1e-9)
        assert record.impacts.impulses == pytest.approx([impulse], rel=1e-8)
        assert record.peak_force == pytest.approx(5.0, rel=1e-8)


def row_of_masses(uppers, stiffness=100.0):
    """Masses on springs of their own, each before a stop."""
    n = len(uppers)
    contacts = [sb.Contact(np.eye(n)[i], sb.Stops(upper=u, stiffness=stiffness)) for i, u in enumerate(uppers)]
    springs = np.diag(np.arange(2.0, n + 2.0) ** 2)
    return sb.System.from_matrices(np.eye(n), springs, contacts=contacts, initial_velocity=np.ones(n))


def test_the_table_leaves_out_the_contacts_that_nothing_touches():
    system = row_of_masses((0.3, 9.0, 9.0, 0.1, 9.0))
    text = str(sb.compare(sb.integrate(system, sb.Trapezoidal(), 1e-3, 4.0), sb.reference(system, 4.0)))
    lines = [line.strip() for line in text.splitlines()]
    for i in (0, 3):  # of reference and run, to the horizon and in all
        assert sum(line.startswith(f"contact {i}, row ") for line in lines) == 4
    assert "Never touched: 3 of 5 contacts." in lines
    free = row_of_masses((9.0, 9.0))
    lines = str(sb.compare(sb.integrate(free, sb.Trapezoidal(), 1e-3, 4.0), sb.reference(free, 4.0))).splitlines()
    assert not any("contact 0" in line or "Never touched" in line for line in lines)
    assert any(line.startswith("exact (reference)") and line.split()[-3:] == ["0", "0", "%"] for line in lines)


def test_a_solver_that_ends_early_cuts_no_other_error_short():
    system = two_contacts()
    exact, run = sb.reference(system, 6.0), sb.integrate(system, sb.HHT(), 1e-4, 6.0)
    early = sb.reference(system, 0.5, "dop853")
    whole, short = sb.compare(run, exact), sb.compare(early, exact)
    assert short.window < 0.6 < whole.matched_until
    assert common_window([whole, short]) == common_window([whole])


def test_pictures_show_six_contacts_that_are_touched():
    system = row_of_masses((9.0, *[0.05] * 8))
    exact, run = sb.reference(system, 3.0), sb.integrate(system, sb.HHT(), 1e-3, 3.0)
    titles = [axis.get_title(loc="left")[4:] for axis in sb.compare(run, exact).figure().axes]
    wanted = [f"first impact at contact {i}, row {i}" for i in range(1, 7)]
    assert [title for title in titles if "first impact" in title] == wanted
    assert sum("force of contact" in title for title in titles) == 1
    force = run.plot().axes[1]
    assert [line.get_label().partition(":")[0] for line in force.lines] == [f"contact {i}" for i in range(1, 7)]
    free = row_of_masses((9.0, 9.0))
    exact, run = sb.reference(free, 3.0), sb.integrate(free, sb.HHT(), 1e-3, 3.0)
    assert len(sb.compare(run, exact).figure().axes) == 2
    assert [text.get_text() for text in run.plot().axes[1].texts] == ["no contact"]
