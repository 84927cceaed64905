"""Results show themselves: tables in notebooks, pictures of their own and in the axes of others, SciPy's words."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from systems import one_mass, two_contacts

import stiffbeam as sb

PNG = b"\x89PNG\r\n\x1a\n"


def cells(thing) -> list[list[str]]:
    """The cells of every table, row by row; elements that are not closed are errors."""
    text = thing._repr_html_()
    assert "<pre" not in text
    rows = ElementTree.fromstring(f"<div>{text}</div>").iter("tr")
    return [["".join(cell.itertext()) for cell in row] for row in rows]


@pytest.fixture(scope="module")
def things():
    system = two_contacts()
    run, reference = sb.integrate(system, sb.HHT(-0.1), 1e-3, 2.0), sb.reference(system, 2.0)
    return {
        "run": run,
        "reference": reference,
        "comparison": sb.compare(run, reference),
        "scorecard": sb.score([sb.HHT(-0.1)], ["mass-on-a-stop"]),
    }


def test_a_picture_of_a_run_shows_it(things):
    for kind, black in (("run", False), ("reference", True)):
        figure = things[kind].plot()
        assert figure._repr_png_().startswith(PNG)
        line = figure.axes[0].lines[0]
        assert np.array_equal(line.get_ydata(), things[kind].tip)
        assert (line.get_color() == "black") == black
        assert all(axis.get_ylabel() for axis in figure.axes)


def test_a_reaction_of_a_rigid_stop_is_no_force_of_an_impact():
    """Its mean over a step grows like 1/dt: the axis states it, and the title has the impulse."""
    system = one_mass(100.0, sb.Stops(upper=0.5, stiffness=np.inf, restitution=0.8), v=10.0)
    run, exact = sb.integrate(system, sb.MoreauJean(), 1e-3, 1.0), sb.reference(system, 1.0)
    for thing, label in ((run, "mean per step"), (exact, "without impulses")):
        figure = thing.plot()
        assert figure.axes[1].get_ylabel().endswith(label)
        largest = np.nanmax(thing.impacts.impulses)
        assert f"{thing.impacts.count} impacts, largest impulse {largest:.4g}" in figure.get_suptitle()
        assert "contact force" not in figure.get_suptitle()


@pytest.mark.parametrize("kind", ["comparison", "scorecard"])
def test_every_result_is_a_table_in_a_notebook(kind, things):
    assert cells(things[kind])


@pytest.mark.slow
def test_records_of_a_study_show_their_table_and_picture():
    records = sb.study("modes", schemes=["BDF2"], steps=400)
    rows = cells(records)
    assert rows[0] == list(records.answer.table)
    assert len(rows) == 1 + len(records.answer.table)
    assert records._repr_png_().startswith(PNG)
