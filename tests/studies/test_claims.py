"""What the page says of the paper's claims: decided by the spread, and never the end of the page."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb
from dumont2002 import claims as judging
from dumont2002.claims import (
    FAILS,
    HOLDS,
    NOT_MEASURED,
    OPEN,
    PARTLY,
    SCHEME_ONLY,
    Evidence,
    in_parts,
    judged,
    of_both,
)  # fmt: skip
from dumont2002.numbers import Sample, numbers_of
from dumont2002.table import Reading, make_table
from stiffbeam.trajectory.trajectory import Diverged

NOTHING = Evidence({n: {"runs": {}, "exact": {}, "failures": {"(4.13)": "overflow"}} for n in range(1, 18)}, [],
                   Reading())  # fmt: skip


def sample(*values: float) -> Sample:
    return Sample(np.array(values, float))


def test_the_spread_decides_or_leaves_open():
    near, far = sample(1.0, 1.2, 0.8, 1.1), sample(5.0, 5.2, 4.9, 5.1)
    assert far.above(near) is True
    assert near.above(far) is False
    assert near.above(sample(1.1, 0.9, 1.0, 1.2)) is None
    assert near.above(1.05) is None
    assert sample(2.0, 2.0).above(1.0) is True  # members that do not differ decide by themselves
    assert sample(2.0, 2.5).above(sample(1.0)) is None  # one degree of freedom decides little


def test_a_verdict_tells_the_scheme_from_the_beam():
    found = [of_both([a], [b]) for a in (True, False) for b in (True, False)]
    assert found == [HOLDS, SCHEME_ONLY, PARTLY, FAILS]
    assert {of_both([None], [True]), of_both([False, True], [None])} == {OPEN}
    assert [in_parts(x) for x in ([True, True], [True, False], [False], [True, None])] == [HOLDS, PARTLY, FAILS, OPEN]


@pytest.mark.parametrize("error", [Diverged("hht", 1.0, "a smaller step"), sb.InputError("x", 1, "be 2", "add 1")])
def test_what_cannot_be_measured_says_so(error, monkeypatch):
    def fail(e):
        """Never."""
        raise error

    def fine(e):
        """Always."""
        return "Fine.", HOLDS

    monkeypatch.setattr(judging, "CLAIMS", [("5", "before", fail), ("6", "after", fine)])
    first, second = judged(NOTHING)
    assert (first["verdict"], second["verdict"]) == (NOT_MEASURED, HOLDS)
    assert str(error) in first["measured"]
    assert second["holds if"] == "Always."


def test_a_run_that_overflowed_is_evidence_for_nothing():
    with pytest.raises(ValueError, match=r"\(4.13\) overflowed on Table 3"):
        NOTHING.motions(3)


# ---------------------------------------------------------------- what is measured


@pytest.fixture(scope="module")
def short():
    """Table 17 to half a time unit with the exact solution in float64: five periods, twice its horizon."""
    return make_table(replace(sb.paper_case(17), t_end=0.5), Reading())


@pytest.mark.slow
def test_ensembles_span_ten_periods(short):
    found = numbers_of(short, 3, 2)
    assert found["periods"] == 10
    members = found["runs"]["(4.13)"]["members"]
    assert len(members["impacts"]) == len(set(members["fraction"])) == 3
    assert len(found["exact"]["displacement"]["members"]["depth"]) == 2
    # The impacts of a member to T are those of its solo run.
    system = short.systems["displacement"]
    solo = sb.integrate(sb.perturbed_members(system, 3)[1], sb.HHT(-0.1), short.case.dt, short.case.t_end)
    assert members["impacts"][1] == solo.impacts.count
