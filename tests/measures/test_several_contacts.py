"""Studies and pictures show every contact of a system."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from systems import two_contacts

import stiffbeam as sb
from stiffbeam.figures.runs import four_panels
from stiffbeam.files.cases import paper_case
from stiffbeam.measures.errors import first_impacts_end, impact_times, match, matched_until
from stiffbeam.studies import find_study, study
from stiffbeam.studies.common import solve_once, system_of
from stiffbeam.studies.interface import by_contact

SMALL = replace(paper_case(10), cells=8, t_end=0.8)


def with_a_stop_half_way(case, form):
    """The case's system with stops half way along the beam too, on its displacement without the base's part."""
    system = system_of(case, form)
    (tip,) = system.contacts
    middle = np.zeros(system.size)
    middle[system.size // 2 - 1] = 1.0
    half_way = sb.Contact(middle, sb.Stops(-0.02, 0.03, stiffness=2e4))
    return replace(system, contacts=(tip, half_way))


@pytest.fixture
def two(monkeypatch):
    for name in ("sweep", "space", "common"):  # in this order: an import must not find the patched one
        monkeypatch.setattr(import_module(f"stiffbeam.studies.{name}"), "system_of", with_a_stop_half_way)


@pytest.mark.slow
def test_impacts_are_counted_at_every_contact(two):
    records = study("impacts", SMALL, **find_study("impacts").smoke)
    blocks = by_contact(records.rows)
    assert list(blocks) == [" at contact 1", " at contact 2"]
    exact = solve_once(with_a_stop_half_way(SMALL, "displacement"), 0.2)
    for i, (place, rows) in enumerate(blocks.items()):
        (first, *_) = [row for row in rows if row["scheme"] == "HHT(alpha=-0.1)"]
        assert first["reference_count"] == exact.contacts[i].impacts.count > 0
        sampled = next(row for row in rows if row["scheme"] == "reference")
        assert sampled["count"] == exact.impacts_sampled(sampled["dt"], contact=i).count
        assert f"{place.strip().capitalize()}: " in records.answer
    titles = [axis.get_title(loc="left") for axis in records.figure().axes]
    assert [sum(place in title for title in titles) for place in blocks] == [6, 6]  # every panel


def test_distributions_are_those_of_every_contact(two):
    records = study("ensemble", SMALL, schemes=["HHT(alpha=-0.1)"], members=3, t_end=0.2, size=0.02)
    members = {key: [row["count"] for row in rows if row["kind"] == "member" and row["method"] == "exact"]
               for key, rows in by_contact(records.rows).items()}  # fmt: skip
    assert [len(counts) for counts in members.values()] == [3, 3]
    assert members[" at contact 1"] != members[" at contact 2"]
    labels = [tick.get_text() for tick in records.figure().axes[0].get_yticklabels()]
    assert labels == [
        "exact at contact 1",
        "exact at contact 2",
        "HHT(alpha=-0.1) at contact 1",
        "HHT(alpha=-0.1) at contact 2",
    ]
    assert "At contact 2: Over 3 members" in records.answer
    assert records.answer.notes.count("Off by") == 1  # what holds at both contacts stands once

    def said(values, digits: str = ".3g") -> str:
        mean, deviation = format(np.mean(values), digits), float(f"{np.std(values):.2g}")
        return f"{mean} ± {deviation:g}" if deviation else f"all {mean}"

    exact = [line["impacts"] for line in records.answer.table if line["method"] == "exact"]
    assert exact == [said(counts) for counts in members.values()]
    peaks = [row["peak_force"] for row in records.rows if row["kind"] == "member" and row["method"] == "exact"]
    lines = [line for line in records.answer.table if line["method"] == "exact"]
    for line, counts, forces in zip(lines, members.values(), (peaks[:3], peaks[3:]), strict=True):
        assert line["impacts per unit of time"] == said(np.array(counts) / 0.2)
        assert line["largest force"] == said(forces, ".4g")


def test_a_sweep_draws_a_line_for_every_contact(two):
    options = {"parameter": "dt", "values": [1e-4, 5e-5], "periods": 1, "transient": 0}
    records = study("sweep", SMALL, **options)
    rows = [row for row in records.rows if row["kind"] == "contact"]
    assert [(row["dt"], row["contact_number"]) for row in rows if row["contact_number"] == 2]
    assert "impacts per period at contact 2" in records.answer.text()
    count = records.figure().axes[1]
    assert len(count.get_lines()) == 2
    grid = study("sweep", SMALL, **options, second="alpha", second_values=[-0.1, -0.2])
    assert sum("at contact 2" in axis.get_title(loc="left") for axis in grid.figure().axes) == 3


@pytest.mark.slow
def test_the_contact_of_every_stop_converges_in_space(two):
    records = study("space", SMALL, cells=[6, 8, 12], finest=20, forms=["displacement"], impacts=4)
    quantities = {row["quantity"] for row in records.rows if row.get("kind") == "contact" and "quantity" in row}
    assert {"first impact's time at contact 1", "first impact's impulse at contact 1"} <= quantities
    records.figure().canvas.draw()


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


def test_the_four_panels_zoom_on_every_contact():
    system = two_contacts()
    exact, run = sb.reference(system, 6.0), sb.integrate(system, sb.HHT(), 1e-3, 6.0)
    figure = four_panels("two contacts", [run], [exact])
    zooms = figure.axes[2:4]
    assert [axis.get_title(loc="left") for axis in zooms] == [
        "(c) first impact at contact 1", "(d) first impact at contact 2",
    ]  # fmt: skip
    assert figure.axes[4].get_title(loc="left").startswith("(e) spectrum")
    for axis, contact in zip(zooms, exact.contacts, strict=True):
        start, end = axis.get_xlim()
        assert start < contact.impacts.times[0] < end
        stops = [line.get_ydata()[0] for line in axis.get_lines() if len(line.get_ydata()) == 2]
        assert stops == [x for x in (contact.stops.lower, contact.stops.upper) if x is not None]
    # No stop acts on the tip, which is observed elsewhere: none is drawn beside it.
    assert all(len(line.get_ydata()) > 2 for line in figure.axes[0].get_lines())


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
