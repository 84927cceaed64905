"""CVODE and IDA with the functions of rhs.c, and with functions of time that Python evaluates for these."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.references.adaptive import sundials

METHODS = ("cvode", "cvode-adams", "ida")


def chain(size: int, contacts: list[sb.Contact], loads=(), damping: float = 0.0) -> sb.System:
    """Unit masses between springs of 100, both ends held, the last with a velocity."""
    K = 100.0 * (2.0 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1))
    v0 = np.zeros(size)
    v0[-1] = 1.0
    return sb.System.from_matrices(
        np.eye(size),
        K,
        damping=damping * K,
        loads=loads,
        contacts=contacts,
        initial_velocity=v0,
        observe=np.eye(size)[-1],
    )


def last(size: int, **stops) -> list[sb.Contact]:
    """A stop at the last mass."""
    return [sb.Contact(np.eye(size)[-1], sb.Stops(**stops))]


def record(kind: str) -> sb.Sampled:
    """A load that rises and falls within 0.4."""
    t = np.linspace(0.0, 1.0, 21)
    return sb.Sampled(t, 30.0 * np.sin(np.pi * np.minimum(t / 0.4, 1.0)) ** 2, kind=kind)


SYSTEMS = {
    "table 10": lambda: sb.semidiscretise(sb.paper_case(10).problem, 10, "displacement"),
    "velocity-curvature": lambda: sb.semidiscretise(sb.paper_case(10).problem, 10, "velocity-curvature"),
    "banded": lambda: chain(40, last(40, upper=0.02, stiffness=1e4)),
    "two sides, damped": lambda: chain(3, last(3, lower=-0.02, upper=0.02, stiffness=1e4), damping=1e-3),
    "Hertz": lambda: chain(3, last(3, upper=0.02, stiffness=1e5, exponent=1.5)),
    "Kelvin-Voigt": lambda: chain(3, last(3, upper=0.02, stiffness=1e4, damping=5.0)),
    "Hunt-Crossley": lambda: chain(3, last(3, upper=0.02, stiffness=1e5, exponent=1.5, dissipation=0.3)),
    "two contacts": lambda: chain(
        3, [*last(3, upper=0.02, stiffness=1e4), sb.Contact([1.0, -1.0, 0.0], sb.Stops(upper=0.01, stiffness=3e3))]
    ),
    "polygon": lambda: chain(3, last(3, upper=0.02, stiffness=1e4), [(np.ones(3), record("linear"))]),
    "cubic record and a harmonic": lambda: chain(
        3, last(3, upper=0.02, stiffness=1e4), [(np.ones(3), sb.Superposition(record("cubic"), sb.Harmonic(3.0, 11.0)))]
    ),
    "moving stop": lambda: chain(
        3, [sb.Contact(np.eye(3)[-1], sb.Stops(upper=0.02, stiffness=1e4), offset=sb.Harmonic(0.01, 20.0))]
    ),
    "stop that moves by a record, damped": lambda: chain(
        3,
        [
            sb.Contact(
                np.eye(3)[-1],
                sb.Stops(upper=0.02, stiffness=1e4, damping=5.0),
                offset=sb.Sampled(np.linspace(0, 1, 9), 0.01 * np.sin(np.arange(9.0)), kind="cubic"),
            )
        ],
    ),
    "no contact": lambda: chain(3, [], [(np.ones(3), sb.Harmonic(3.0, 11.0))]),
}


@pytest.mark.parametrize("method", METHODS)
def test_a_start_on_a_stop_is_no_warning_of_the_library(method, capfd):
    """An event function that is zero for the first step made SUNDIALS write to the terminal."""
    still = sb.System.from_matrices(
        [[0.05]],
        [[1.2e4]],
        loads=[([1.0], sb.Sampled([0.0, 0.01, 0.012, 0.03], [0.0, 0.0, -150.0, -150.0]))],
        contacts=[sb.Contact([1.0], sb.Stops(lower=-8e-3, upper=0.0, stiffness=5e6, damping=100.0))],
    )
    assert sb.reference(still, 0.03, method).impacts.count > 0
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("method", METHODS)
def test_a_step_bound_tells_the_number_of_steps(method):
    """A slow motion, on which no step fails: after a start each step has the longest length."""
    slow = sb.System.from_matrices([[1.0]], [[1e-4]], initial_velocity=[1.0], observe=[1.0])
    counters = sb.reference(slow, 1.0, method=method, rtol=1e-4, atol=1e-4, max_step=1e-3).work.counters
    assert 1000 <= counters["steps"] <= 1100
    assert (counters["error_test_failures"], counters["convergence_failures"]) == (0, 0)


class Called:
    """A function of time as Python has to call it."""

    def __init__(self, function) -> None:
        self.value, self.rate, self.acceleration = function.value, function.rate, function.acceleration
        self.breakpoints = function.t if isinstance(function, sb.Sampled) else ()


@pytest.mark.fast(3)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_functions_of_time_in_python_give_the_same_motion(name, method):
    """C reads their values where it computes those of a harmonic or a record itself."""
    system = SYSTEMS[name]()
    loads = [(vector, Called(function)) for vector, function in system.loads]
    contacts = [
        sb.Contact(c.row, c.stops, None if c.offset is None else Called(c.offset)) for c in system.contacts
    ]  # fmt: skip
    python = dataclasses.replace(system, loads=loads, contacts=contacts)
    t_end = 0.5 if system.cells is None else 0.06  # a beam's errors grow a thousandfold in a tenth
    one, other = (sb.reference(x, t_end, method=method, rtol=1e-9) for x in (system, python))
    if not loads and all(c.offset is None for c in contacts):
        assert one.work.counters == other.work.counters
    np.testing.assert_allclose(other.tip, one.tip, atol=1e-5 * np.max(np.abs(one.tip)))
    for a, b in zip(one.contacts, other.contacts, strict=True):
        np.testing.assert_allclose(b.impacts.times, a.impacts.times, atol=1e-6)
        np.testing.assert_allclose(b.impacts.impulses, a.impacts.impulses, rtol=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_an_error_in_a_load_comes_through_the_library(method):
    def load(t):
        if np.ndim(t) == 0 and 0.1 < t < 0.4:
            raise KeyboardInterrupt
        return np.sin(t)

    with pytest.raises(KeyboardInterrupt):
        sb.reference(chain(2, last(2, upper=0.02, stiffness=1e4), [(np.ones(2), load)]), 0.5, method)


def test_another_version_of_the_library_is_refused(monkeypatch):
    monkeypatch.setattr(sundials, "VERSION", 5)
    sundials.library_of.cache_clear()
    try:
        with pytest.raises(sb.InputError, match=r"be SUNDIALS 5.*got 'version 7'.*dop853"):
            sb.reference(SYSTEMS["Hertz"](), 0.1, method="cvode")
    finally:
        sundials.library_of.cache_clear()


def test_a_load_that_overflows_is_refused():
    t = np.linspace(0.0, 1.0, 5)
    system = chain(2, last(2, upper=0.02, stiffness=1e4), [(np.ones(2), sb.Sampled(t, [0, 0, 1e300, 1e300, 0]))])
    with pytest.raises(sb.InputError, match="energy that float64 can hold"):
        sb.reference(system, 1.0, method="cvode")
