"""Work that would take too long is cut or left out, and the reason stands in the result."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam import references
from stiffbeam.files.cases import paper_case
from stiffbeam.measures.errors import first_impacts_end
from stiffbeam.references.registry import Steps
from stiffbeam.studies import comparison, precision, study

SMALL = replace(paper_case(10), cells=6, t_end=0.1, dt=1e-4)


def slow(system, dt, t_end):
    """The explicit midpoint rule, a millisecond a step."""
    ode, steps = system.ode(), round(t_end / dt)
    y, tips = ode.y0, [ode.tip(0.0, ode.y0)[0]]
    for k in range(steps):
        middle = y + 0.5 * dt * ode.rhs(k * dt, y)
        y = y + dt * ode.rhs((k + 0.5) * dt, middle)
        tips.append(ode.tip((k + 1) * dt, y)[0])
        until = time.process_time() + 1e-3
        while time.process_time() < until:
            pass
    return np.linspace(0.0, t_end, steps + 1), np.array(tips)


def test_the_main_reference_ends_where_its_budget_does(monkeypatch):
    monkeypatch.setattr(comparison, "expected_seconds", lambda *_, **__: 100.0)
    result = comparison.compare_case(SMALL, references=["exact"], budget=20.0)
    (exact,) = result.references
    assert exact.t[-1] == pytest.approx(0.7 * SMALL.t_end)  # 80 of 100 s allow less than all
    assert exact.provenance["budget"] == "to t = 0.07 of 0.1: the budget ends there"
    assert not result.failures
    assert {each.window for each in result.comparisons} == {exact.horizon}
    whole = sb.reference(SMALL.system("displacement"), SMALL.t_end)
    np.testing.assert_array_equal(whole.at(exact.t)[0], exact.tip)


def test_a_solver_over_the_budget_is_left_out_unless_it_is_named(monkeypatch):
    monkeypatch.setattr(precision, "expected_seconds", lambda *_, **__: 12.0)
    options = {"schemes": ["BDF2"], "halvings": 2, "tolerances": [1e-6]}
    records = study("precision", SMALL, **options)
    assert {row["method"] for row in records.refusals} >= {"cvode", "kvaerno5"}
    assert all("allow the 12 s" in row["refused"] and "name " in row["refused"] for row in records.refusals)
    named = study("precision", SMALL, methods=["cvode-adams"], **options)
    assert not named.refusals
    assert "cvode-adams" in {row["method"] for row in named.numbers}


@pytest.mark.slow
def test_a_slow_function_has_fewer_steps(monkeypatch):
    monkeypatch.setattr(precision, "TOO_SLOW", 0.3)
    records = study("precision", SMALL, schemes=[slow, "BDF2"], methods=["exact"], dt=5e-4)
    steps = {name: [row["work"] for row in records.rows if name in row["method"]] for name in ("slow", "BDF2")}
    assert len(steps["BDF2"]) == 10
    assert 1 <= len(steps["slow"]) <= 4
    assert "Errors are taken to t = " in records.answer.notes


def test_a_window_holds_the_only_impact_of_a_motion():
    stop = sb.Contact([1.0], sb.Stops(upper=0.9, stiffness=100.0))
    system = sb.System.from_matrices([[1.0]], [[1.0]], contacts=[stop], initial_velocity=[1.0])
    one = sb.reference(system, 2.5)
    assert one.impacts.count == 1
    assert first_impacts_end(one, 4) == pytest.approx(0.5 * (one.impacts.times[0] + 2.5))
    none = sb.reference(system, 1.0)
    assert none.impacts.count == 0
    assert first_impacts_end(none, 4) == 0.5


def test_pilots_that_the_start_dominates_are_longer(monkeypatch):
    """IDA from rest takes as long for one pilot as for two; the whole span costs 64 times that."""
    system = SMALL.system("displacement")

    def solve(system, t_end, *_):
        return SimpleNamespace(work=SimpleNamespace(march_seconds=max(0.2, 6.4 * t_end / SMALL.t_end)))

    monkeypatch.setattr(references, "solve", solve)
    expected = references.expected_seconds(system, SMALL.t_end, "ida", 1e-9, None, Steps(), worth=0.01)
    assert expected == pytest.approx(6.4, rel=0.1)
