"""Colours and dashes belong to names: the same on the page, in a comparison and in every study."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import rgb_to_hsv, to_rgb

import stiffbeam as sb
from dumont2002 import figures as page
from stiffbeam.figures import chart
from stiffbeam.figures.chart import EXACT, look
from stiffbeam.figures.runs import comparison_panels
from stiffbeam.schemes import RIGID, SCHEMES, registered


class Newcomer(sb.BDF2):
    name = "newcomer"


@pytest.fixture
def registry():
    """The registry of schemes, whose order too is as before in the end."""
    before = dict(SCHEMES)
    yield SCHEMES
    SCHEMES.clear()
    SCHEMES.update(before)


@pytest.mark.parametrize("place", [0, 3, len(SCHEMES)])
def test_a_new_scheme_changes_no_other_look(place, registry):
    labels = [str(scheme) for scheme in registered()]
    before = {label: look(label) for label in labels}
    entries = list(registry.items())
    entries.insert(place, ("newcomer", Newcomer))
    registry.clear()
    registry.update(entries)
    assert {label: look(label) for label in labels} == before
    new = look("newcomer")
    assert all((new["linestyle"], new["marker"]) != (x["linestyle"], x["marker"]) for x in map(look, chart.LOOKS))
    assert look("newcomer") == new


def test_a_scheme_has_its_colour_and_dashes_on_the_page_too():
    for equation, label in (("(4.13)", "hht"), ("(4.11)", "bdf2"), ("(4.14)", "sdirk")):
        colour, dashes = page.STYLE[equation]
        assert colour == look(label)["color"]
        assert look(label)["linestyle"] == ((0, dashes) if dashes else "-")
    # Other discretisations of the same scheme are shades of its colour, each with dashes of its own.
    for equation, its in page.EQUATIONS.items():
        hue = rgb_to_hsv(to_rgb(page.STYLE[equation][0]))[0]
        assert hue == pytest.approx(rgb_to_hsv(to_rgb(look(its.scheme)["color"]))[0], abs=0.02)
    for name in ("bdf2", "sdirk"):
        own = [page.STYLE[equation] for equation, its in page.EQUATIONS.items() if its.scheme == name]
        assert len({colour for colour, _ in own}) == len({dashes for _, dashes in own}) == len(own)


def test_the_exact_motion_is_black_everywhere():
    assert {look(label)["color"] for label in EXACT} == {"black"}
    assert {"exact", "multiprecision"} <= set(EXACT)
    assert {colour for colour, _ in page.EXACT.values()} == {"black"}
    coloured = {look(str(scheme))["color"] for scheme in registered()}
    assert "black" not in coloured


def test_a_comparison_draws_every_scheme_in_its_look():
    system = sb.semidiscretise(sb.paper_case(10).problem, 8)
    runs = [sb.integrate(system, scheme, 1e-4, 0.05) for scheme in (sb.HHT(), sb.SDIRK(nystrom=True), sb.BDF2())]
    exact = sb.reference(system, 0.05)
    axis = comparison_panels("three schemes", runs, [exact]).axes[0]
    curves = [line for line in axis.get_lines() if len(line.get_xdata()) > 2]
    assert curves[0].get_color() == "black"
    assert [line.get_color() for line in curves[1:]] == [look(name)["color"] for name in ("hht", "sdirk", "bdf2")]
    assert all(np.max(np.abs(line.get_ydata())) > 0.0 for line in curves)


def test_registered_schemes_can_be_told_apart_in_grey():
    """Those of LOOKS by their dashes alone: a print has no colours."""
    dashes = [look(name)["linestyle"] for name in chart.LOOKS]
    assert len(set(map(str, dashes))) == len(dashes) == len(chart.DASHES)
    assert {*SCHEMES, *RIGID} <= set(chart.LOOKS)
