"""Work grows in proportion to the time span: counted in evaluations and stored rows, not in seconds."""

from __future__ import annotations

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references import solve


def swinging() -> sb.System:
    """A mass that bounces between its stops in the same way for ever: every span of time costs the same."""
    return one_mass(1.0, sb.Stops(-0.5, 0.5, stiffness=99.0), v=2.0)


def damped_pair() -> sb.System:
    """Damped, driven, with two contacts: the periodic motion it settles to costs the same each period."""
    unit = np.eye(2)
    return sb.System.from_matrices(
        unit, 40.0 * np.array([[2.0, -1.0], [-1.0, 2.0]]), 0.4 * unit,
        loads=[(unit[0], sb.Harmonic(9.0, 4.0))],
        contacts=[sb.Contact(row, sb.Stops(-0.1, 0.1, stiffness=500.0)) for row in unit],
    )  # fmt: skip


COUNTER = {"exact": "evaluations", "multiprecision": "evaluations", "kvaerno3": "steps", "kvaerno5": "steps"}


@pytest.mark.parametrize(
    ("method", "make", "t_end"),
    [
        ("exact", swinging, 200.0),
        ("exact", damped_pair, 100.0),
        ("multiprecision", swinging, 50.0),
        ("multiprecision", damped_pair, 25.0),
        ("cvode", swinging, 50.0),
        ("cvode-adams", swinging, 50.0),
        ("ida", swinging, 50.0),
        ("dop853", swinging, 50.0),
        ("lsoda", swinging, 50.0),
        ("radau", swinging, 25.0),
        pytest.param("kvaerno5", swinging, 25.0, marks=pytest.mark.slow),
        pytest.param("kvaerno3", swinging, 25.0, marks=pytest.mark.slow),
    ],
)
@pytest.mark.slow
def test_twice_the_span_is_twice_the_work(method, make, t_end):
    system, counts = make(), []
    for span in (t_end, 2 * t_end):
        run = solve(system, span, method, np.linspace(0.0, span, 1 + 8 * round(span)), 1e-7, None, 30)
        counts.append((run.work.counters[COUNTER.get(method, "rhs")], len(run.contacts[0].impacts.times)))
    (work, impacts), (twice, impacts_twice) = counts
    assert impacts > 10
    assert abs(impacts_twice - 2 * impacts) <= 2
    assert 1.8 < twice / work < 2.2


@pytest.mark.slow
@pytest.mark.parametrize("method", ["cvode", "cvode-adams", "ida"])
def test_sundials_is_never_asked_to_store_every_step(method, monkeypatch):
    """Given two times, scikit-sundae keeps every internal step in an array that it copies at each of them."""
    from sksundae.cvode import CVODE
    from sksundae.ida import IDA

    def solve_all(*_):
        raise AssertionError("solve was called: it may keep every step")

    for solver in (CVODE, IDA):
        monkeypatch.setattr(solver, "solve", solve_all)
    run = solve(swinging(), 100.0, method, np.array([0.0, 100.0]), 1e-8, None)
    assert len(run.t) == 2
    assert run.impacts.count > 30


@pytest.mark.slow
def test_events_of_one_run_do_not_stay_for_the_next():
    """scikit-sundae gathers events over the life of a solver: every run has a new one."""
    counts = [solve(swinging(), 30.0, method, None, 1e-8, None).impacts.count for method in ("cvode", "ida") * 2]
    assert len(set(counts)) == 1


def test_the_tangent_flow_takes_one_step_a_piece_or_sample():
    steps = []
    for t_end in (50.0, 100.0):
        growth = sb.lyapunov(swinging(), t_end)
        switches = sb.reference(swinging(), t_end).work.counters["switches"]
        assert len(growth.t) == 201 + switches
        steps.append(switches)
    assert abs(steps[1] - 2 * steps[0]) <= 2
