"""A solver that cannot finish in reasonable time says so: before it starts where that is known, else on its way."""

from __future__ import annotations

import pytest

import stiffbeam as sb
from stiffbeam.basics import resources
from stiffbeam.references.adaptive import restarts


@pytest.mark.fast(2)
@pytest.mark.parametrize("method", ["cvode", "cvode-adams", "ida", "dop853", "radau", "kvaerno3"])
def test_work_without_end_is_given_up(method, monkeypatch):
    monkeypatch.setattr(restarts, "MOST_EVALUATIONS", 300)
    system = sb.System.from_matrices([[1.0]], [[1.0]], observe=[1.0], initial_displacement=[1.0])
    with pytest.raises(sb.SolverFailure, match="more than 300; loosen rtol") as failure:
        sb.reference(system, 500.0, method)
    assert 0.0 < failure.value.t < 500.0


def test_what_no_pass_repeats_takes_its_time_from_all(monkeypatch):
    """Of 20 s for 10 passes 10 s of compiling leave 1 s for each."""
    now = [0.0]
    monkeypatch.setattr(resources, "clock", lambda: now[0])
    with resources.deadline(20.0, 10.0):
        with resources.once():
            now[0] = 10.0
        now[0] = 10.9
        resources.in_time(0.5)
        now[0] = 11.1
        with pytest.raises(resources.OutOfTime):
            resources.in_time(0.5)
