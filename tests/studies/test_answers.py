"""What the answers of the studies are made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stiffbeam.files.cases import paper_case
from stiffbeam.schemes import registered
from stiffbeam.studies import converge, impacts, precision, rigid, study
from stiffbeam.studies.chaos import exponents, stated
from stiffbeam.studies.ensemble import difference

SMALL = replace(paper_case(10), cells=8, t_end=0.8)


def point(octave, error, dt, left_out=""):
    return {"octave": octave, "error_rms": error, "dt": dt, "left_out": left_out, "kind": "contact", "scheme": "bdf2"}


def test_the_envelope_takes_the_worst_of_every_whole_octave():
    rows = [
        point(0, 1e-2, 1.0, "impacts differ"), point(0, 1e-3, 0.7),
        point(1, 3e-3, 0.5), point(1, 4e-3, 0.4),
        point(2, 1e-3, 0.25), point(2, 5e-4, 0.2),
        point(3, 1e-5, 0.125), point(3, 1e-9, 0.1, "rounding"),
    ]  # fmt: skip
    assert converge.envelope(rows) == ([0.5, 0.25], [4e-3, 1e-3])
    assert converge.orders(rows)["contact", "bdf2"].slope == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("kind", "scheme", "t_end", "steps", "reason"),
    [
        ("contact", "bdf2", 0.15, 1000, "impacts differ"),
        ("smooth", "bdf2", 0.6, 12, "error above 10 %"),
        ("smooth", "sdirk", 0.1, 10, "motion not resolved"),
        ("smooth", "sdirk", 0.6, 200_000, "rounding"),
        ("smooth", "bdf2", 0.6, 2_000, ""),
    ],
)
def test_a_point_that_means_nothing_says_why_it_is_left_out(kind, scheme, t_end, steps, reason):
    where = {"kind": kind, "scheme": scheme, "form": "displacement", "contact": "implicit", "t_end": t_end}
    (row,) = converge.evaluate(replace(SMALL, t_end=0.6), where | {"steps": steps, "octave": 0})
    assert row["left_out"] == reason
    other = point(1, 1e-4, 0.5), point(2, 1e-5, 0.25)
    slope = converge.orders([point(0, 1.0, 1.0, row["left_out"]), *other])["contact", "bdf2"]
    assert slope.points == (2 if reason else 3)


def test_every_scheme_converges_with_its_order_on_the_smooth_problem():
    case = replace(paper_case(10), cells=4, dt=1e-3, t_end=0.7)
    labels = [str(scheme) for scheme in registered()]
    records = study("converge", case, schemes=labels, kinds=["smooth"], halvings=3)
    found = converge.orders(records.rows)
    assert len(found) == len(labels)
    for scheme in registered():
        order = found["smooth", str(scheme)]
        assert abs(order.slope - scheme.order) < 0.1, scheme
        assert order.points == 3


def test_the_cheapest_method_is_found_between_its_points():
    def row(method, cost, error):
        return {"method": method, "seconds": cost, "error": error}

    rows = [row("fast", 1.0, 1e-2), row("fast", 100.0, 1e-6), row("slow", 50.0, 1e-2), row("slow", 500.0, 1e-5)]
    rows += [row("never", 1e-3, 1e-2), row("never", 1e3, 2e-4), row("at once", 0.5, 1e-9)]
    at_once, first, second = precision.cheapest(rows, 1e-4, "seconds")
    assert at_once == (0.5, "at once at most")  # its cheapest point is below the error already
    assert first == (pytest.approx(10.0), "fast")  # half-way in both logarithms
    assert second == (pytest.approx(50.0 * 10 ** (2 / 3)), "slow")
    # One that is right at a coarse step by chance costs what all finer ones keep.
    chance = [row("chance", cost, e) for cost, e in ((1.0, 1e-2), (2.0, 1e-5), (4.0, 1e-3), (8.0, 1e-5), (16.0, 1e-6))]
    assert precision.cheapest(chance, 1e-4, "seconds") == [(pytest.approx(4.0 * 2**0.5), "chance")]
    assert precision.cheapest(chance[:3], 1e-4, "seconds") == []
    cheap = {"fast at most", "slow at most", "never at most", "at once at most"}
    assert {name for _, name in precision.cheapest(rows, 1e-2, "seconds")} == cheap


@pytest.mark.parametrize(("spread", "allowed"), [(0.0, 0.0), (10.0, 1.96 * 10.0 * np.sqrt(1 / 16 + 1 / 128))])
def test_a_count_is_right_only_if_every_finer_one_is(spread, allowed):
    """To the tolerance and the 95 % interval of a difference of means over 16 and 128 members."""

    def row(dt, count, scheme="bdf2", purpose="step"):
        return {"scheme": scheme, "purpose": purpose, "dt": dt, "count": count, "count_spread": spread, "members": 16}

    edge = 100.0 + 5.0 + allowed
    rows = [row(0.0, 100.0, "exact"), row(1e-4, 100.0), row(5e-5, 200.0), row(1e-6, 0.0, purpose="contact")]
    rows += [row(2.5e-5, edge - 0.01), row(1.25e-5, 200.0 - edge + 0.01)]
    assert impacts.right_from(rows, "bdf2") == 2.5e-5  # right by accident at 1e-4 does not count
    assert np.isnan(impacts.right_from([*rows, row(6e-6, edge + 0.01)], "bdf2"))
    assert impacts.right_from([*rows, row(2e-5, edge + 0.01)], "bdf2") == 1.25e-5
    assert np.isnan(impacts.right_from(rows, "hht"))
    assert np.isnan(impacts.right_from(rows[1:], "bdf2"))


def test_the_count_of_a_single_run_is_right_within_the_spread_of_exact_ones():
    """One run has no spread: with NaN in its place every count was right."""

    def row(dt, count, scheme="bdf2", spread=np.nan):
        return {"scheme": scheme, "purpose": "step", "dt": dt, "count": count, "count_spread": spread, "members": 1}

    exact = row(0.0, 100.0, "exact", 4.0)
    assert np.isnan(impacts.right_from([exact, row(1e-4, 26.0)], "bdf2"))
    assert impacts.right_from([exact, row(1e-4, 26.0), row(5e-5, 109.0)], "bdf2") == 5e-5


@pytest.mark.parametrize("count", [2, 4, 20])
def test_intervals_of_few_members_hold_with_95_percent(count):
    """Normal intervals hold with 71 and 82 % for two values."""
    rng, tries = np.random.default_rng(0), 1000
    a, b = rng.normal(3.0, 1.0, (2, tries, count))
    off = [difference(*pair) for pair in zip(a, b, strict=True)]
    rows = [[{"method": "exact", "exponent": x, "late": 9.0} for x in values] for values in a]
    means = [pair for each in rows if (pair := exponents(each)["exact"]) is not None]
    assert len(means) == tries
    assert np.mean([abs(x) <= width for x, width in off]) > 0.93
    assert 0.93 < np.mean([abs(x - 3.0) <= width for x, width in means]) < 0.97
    assert difference(np.ones(3), np.zeros(3)) == (1.0, 0.0)


def test_the_limit_of_rigid_stops_begins_above_the_last_stiffness_with_other_impacts():
    """Not at the first row: 4 has their number by chance, and factors may be in any order."""
    counts = {64.0: 3, 256.0: 3, 4.0: 3, 1.0: 1, 16.0: 2}
    rows = [{"kappa": kappa, "impacts": count, "rigid_impacts": 3} for kappa, count in counts.items()]
    assert [row["kappa"] for row in rigid.same_impacts(rows)] == [64.0, 256.0]


@pytest.mark.parametrize(("pairs", "told"), [(2, False), (5, False), (6, True)])
def test_few_pairs_tell_no_exponent(pairs, told):
    """All of n pairs on one side of their median: 2^(1 - n) by chance, 6 % of five."""
    rows = [{"method": "exact", "exponent": 1.0 + 0.1 * k, "late": 2.0} for k in range(pairs)]
    assert ("exact" in stated(rows)) == told


@pytest.mark.parametrize(("t_end", "words"), [(0.1, "inside its horizon"), (0.8, "past its horizon")])
def test_the_single_exact_motion_of_impacts_is_past_its_horizon_only_there(t_end, words):
    options = {"schemes": ["HHT(alpha=-0.1)"], "halvings": 1, "members": 2, "sensitivity": False}
    found = study("impacts", SMALL, t_end=t_end, **options)
    ends = {row["horizon"] for row in found.rows if "horizon" in row}
    assert (ends == {t_end}) == (words == "inside its horizon")
    assert f"by float64 {words}, has" in found.answer.notes
