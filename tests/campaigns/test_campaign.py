"""The campaign in small: a fixed part in seconds, a larger one marked slow; README.md beside it has the whole of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from campaign import VIOLATIONS, campaign
from judge import Truth, judge, judge_reference, judged
from random_systems import FAMILIES, MEETING, MEETING_FROM, case
from systems import system_of

import stiffbeam as sb

SEED = 1


def clean(verdicts):
    assert verdicts
    assert not [v for v in verdicts if v.outcome in VIOLATIONS]


@pytest.mark.filterwarnings("ignore")  # an extreme system may warn; what it certifies is what counts
@pytest.mark.parametrize("index", [*range(len(FAMILIES)), *range(MEETING_FROM, MEETING_FROM + 3 * len(MEETING))])
@pytest.mark.fast(3)
def test_nothing_certified_is_wrong(index):
    """The exact solution and many digits, of one system of every family and three whose eigenvalues meet."""
    clean(judged(SEED, index, ("exact", "multiprecision"))[1])


@pytest.mark.parametrize(
    "systems", [pytest.param(12, marks=pytest.mark.slow), pytest.param(120, marks=pytest.mark.campaign)]
)
def test_nothing_certified_is_wrong_by_any_method(systems):
    """With every method in turn, each under a time limit of its own."""
    found, violations = campaign("systems", list(range(systems)), SEED, jobs=2, limit=200.0)
    assert not violations
    assert np.sum(found.outcome == "right") > 1.5 * systems
    assert set(found.family) == set(FAMILIES)


@pytest.mark.slow
def test_the_judge_sees_what_is_wrong(monkeypatch):
    """Each certificate, spoilt by little, is found out."""
    monkeypatch.setattr("judge.MOST_SECONDS", 0.5)
    made = case(SEED, 12)
    truth = Truth(made)
    good = sb.reference(system_of(made), made.t_end, t_eval=truth.t)
    assert judge_reference(good, truth, "exact").outcome == "right"
    assert good.impacts.count > 2

    def spoilt(**changes):
        impacts = replace(good.impacts, **changes)
        contact = replace(good.contacts[0], impacts=impacts)
        return judge_reference(replace(good, contacts=(contact,)), truth, "exact")

    x = good.impacts
    late = x.times + np.where(np.arange(x.count) == 1, 1.5 * truth.time_tolerance, 0.0)
    assert "impact" in spoilt(times=late).reason
    assert "stop" in spoilt(stops=-x.stops).reason
    assert "peak" in spoilt(peaks=x.peaks * (1 + 1e-5)).reason
    assert "impulse" in spoilt(impulses=x.impulses * (1 + 1e-5)).reason
    fewer = {name: getattr(x, name)[1:] for name in ("times", "stops", "peaks", "impulses")}
    assert "missing" in spoilt(**fewer).reason
    bent = replace(good, tip=good.tip + 2e-3 * truth.scale * (truth.t > 0.5 * made.t_end))
    assert judge_reference(bent, truth, "exact").outcome == "wrong"
    assert judge_reference(replace(good, horizon=float("nan")), truth, "exact").outcome == "not finite"


@pytest.mark.slow
def test_a_system_that_takes_too_long_is_counted_and_not_waited_for():
    _, (violation,) = campaign("systems", [0], SEED, jobs=1, limit=1e-4, methods=("exact",))
    assert "  hang: " in violation


def test_an_ensemble_says_how_long_its_first_member_can_be_trusted():
    system = sb.semidiscretise(sb.paper_case(10).problem, 10)
    ensemble = sb.reference_ensemble(system, 1.0, sb.perturbed_members(system, 2))
    assert 0.1 < ensemble.provenance["horizon"] < 1.0
    assert ensemble.provenance["horizon"] == sb.reference(ensemble.members[0], 1.0).horizon


FOUND = [(1, 605, "cvode"), (1, 1231, "exact"), (1, 1642, "exact"), (1, 1642, "multiprecision"),
         pytest.param(90, 100, "cvode", marks=pytest.mark.campaign)]  # fmt: skip


@pytest.mark.parametrize(("seed", "index", "method"), FOUND)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.slow
def test_what_the_campaign_found_stays_mended(seed, index, method):
    """A narrow gap crossed by CVODE, a motion below rounding, a fast decay at a stop, errors of CVODE that
    two tolerances share."""
    clean([judge(case(seed, index), method)])
