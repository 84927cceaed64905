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

LABELS = [str(scheme) for scheme in registered()]


# What each study is asked, what its answer says and what its axes say of the steel beam.
def test_a_new_scheme_changes_no_other_look():
    """A name has its colour and dashes wherever the registry puts it; the page's are the same, in shades."""
    before, kept = {label: look(label) for label in LABELS}, dict(SCHEMES)
    try:
        for place in (0, 3, len(kept)):
            entries = list(kept.items())
            entries.insert(place, ("newcomer", type("Newcomer", (sb.BDF2,), {"name": "newcomer"})))
            SCHEMES.clear()
            SCHEMES.update(entries)
            assert {label: look(label) for label in LABELS} == before
            new = look("newcomer")
            assert all(
                (new["linestyle"], new["marker"]) != (x["linestyle"], x["marker"]) for x in map(look, chart.LOOKS)
            )
    finally:
        SCHEMES.clear()
        SCHEMES.update(kept)
    for equation, label in (("(4.13)", "hht"), ("(4.11)", "bdf2"), ("(4.14)", "sdirk")):
        colour, dashes = page.STYLE[equation]
        assert colour == look(label)["color"]
        assert look(label)["linestyle"] == ((0, dashes) if dashes else "-")
    for equation, its in page.EQUATIONS.items():
        hue = rgb_to_hsv(to_rgb(page.STYLE[equation][0]))[0]
        assert hue == pytest.approx(rgb_to_hsv(to_rgb(look(its.scheme)["color"]))[0], abs=0.02)


def test_looks_can_be_told_apart_in_grey_and_the_exact_motion_is_black():
    dashes = [look(name)["linestyle"] for name in chart.LOOKS]
    assert len(set(map(str, dashes))) == len(dashes) == len(chart.DASHES)
    assert {*SCHEMES, *RIGID} <= set(chart.LOOKS)
    assert {look(label)["color"] for label in EXACT} == {colour for colour, _ in page.EXACT.values()} == {"black"}
    assert "black" not in {look(label)["color"] for label in LABELS}
    system = sb.semidiscretise(sb.paper_case(10).problem, 8)
    runs = [sb.integrate(system, scheme, 1e-4, 0.05) for scheme in (sb.HHT(), sb.SDIRK(nystrom=True), sb.BDF2())]
    axis = comparison_panels("three schemes", runs, [sb.reference(system, 0.05)]).axes[0]
    curves = [line for line in axis.get_lines() if len(line.get_xdata()) > 2]
    assert [line.get_color() for line in curves] == ["black", *(look(x)["color"] for x in ("hht", "sdirk", "bdf2"))]
    assert all(np.max(np.abs(line.get_ydata())) > 0.0 for line in curves)
