"""CVODE and IDA with compiled callbacks: every number equals that of scikit-sundae's Python callbacks to the bit."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.references.adaptive import sundials

METHODS = ("cvode", "cvode-adams", "ida")


@pytest.fixture
def in_python(monkeypatch):
    """A function that makes a reference with the callbacks that scikit-sundae takes."""

    def reference(*arguments, **keywords) -> sb.Reference:
        with monkeypatch.context() as patch:
            patch.setattr(sundials, "available", lambda: False)
            return sb.reference(*arguments, **keywords)

    return reference


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


def test_this_installation_has_compiled_callbacks():
    assert sundials.available()


@pytest.mark.parametrize("method", METHODS)
def test_a_start_on_a_stop_is_no_warning_of_the_library(method, in_python, capfd):
    """An event function that is zero for the first step made SUNDIALS write to the terminal."""
    still = sb.System.from_matrices(
        [[0.05]],
        [[1.2e4]],
        loads=[([1.0], sb.Sampled([0.0, 0.01, 0.012, 0.03], [0.0, 0.0, -150.0, -150.0]))],
        contacts=[sb.Contact([1.0], sb.Stops(lower=-8e-3, upper=0.0, stiffness=5e6, damping=100.0))],
    )
    for solve in (sb.reference, in_python):
        assert solve(still, 0.03, method).impacts.count > 0
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("method", METHODS)
def test_a_step_bound_tells_the_number_of_steps(method):
    """A slow motion, on which no step fails: after a start each step has the longest length."""
    slow = sb.System.from_matrices([[1.0]], [[1e-4]], initial_velocity=[1.0], observe=[1.0])
    counters = sb.reference(slow, 1.0, method=method, rtol=1e-4, atol=1e-4, max_step=1e-3).work.counters
    assert 1000 <= counters["steps"] <= 1100
    assert (counters["error_test_failures"], counters["convergence_failures"]) == (0, 0)


@pytest.mark.fast(2)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_both_ways_give_the_same_bits(in_python, name, method):
    system = SYSTEMS[name]()
    compiled = sb.reference(system, 0.5, method=method, rtol=1e-7)
    python = in_python(system, 0.5, method=method, rtol=1e-7)
    assert (compiled.provenance["callbacks"], python.provenance["callbacks"]) == ("compiled", "Python")
    counted = dict(compiled.work.counters)
    assert counted["rhs"] >= counted["steps"] + counted["error_test_failures"]
    assert {name: counted[name] for name in python.work.counters} == python.work.counters
    for one, other in zip(compiled.states, python.states, strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(compiled.contacts, python.contacts, strict=True):
        np.testing.assert_array_equal(one.impacts.times, other.impacts.times)
        np.testing.assert_array_equal(one.impacts.impulses, other.impacts.impulses)
        assert one.impulse == other.impulse


@pytest.mark.parametrize("method", METHODS)
def test_messages_of_the_library_are_not_printed_where_python_is_called(method, in_python, monkeypatch, capfd):
    """The error has them. What a function of the user prints is there."""
    monkeypatch.setattr(sundials, "MAX_STEPS", 2)

    def load(t):
        print("called")
        return np.sin(t)

    system = chain(2, [sb.Contact([0.0, 1.0], sb.Stops(upper=0.0, stiffness=1e3))], [([0.0, 1.0], load)])
    with pytest.raises(sb.SolverFailure, match="max_num_steps"):
        in_python(system, 5.0, method)
    out, err = capfd.readouterr()
    assert set(out.splitlines()) == {"called"}
    assert err == ""


def test_a_callable_load_is_called_from_python():
    system = chain(3, last(3, upper=0.02, stiffness=1e4), [(np.ones(3), lambda t: 3.0 * np.sin(11.0 * t))])
    called = sb.reference(system, 0.5, method="cvode-adams", rtol=1e-9)
    assert called.provenance["callbacks"] == "Python"
    harmonic = chain(3, last(3, upper=0.02, stiffness=1e4), [(np.ones(3), sb.Harmonic(3.0, 11.0))])
    np.testing.assert_allclose(called.tip, sb.reference(harmonic, 0.5).tip, atol=1e-7)


def test_a_damped_stop_beside_a_callable_load():
    stops = {"upper": 0.02, "stiffness": 1e4, "damping": 5.0}
    called = chain(3, last(3, **stops), [(np.ones(3), lambda t: 3.0 * np.sin(11.0 * t))])
    harmonic = chain(3, last(3, **stops), [(np.ones(3), sb.Harmonic(3.0, 11.0))])
    one, other = (sb.reference(system, 0.5, method="cvode", rtol=1e-9) for system in (called, harmonic))
    np.testing.assert_allclose(one.contacts[0].impacts.peaks, other.contacts[0].impacts.peaks, rtol=1e-5)


def test_without_the_library_python_takes_its_place(monkeypatch):
    monkeypatch.setattr(sundials, "TESTED", ())
    sundials._libraries.cache_clear()
    try:
        assert not sundials.available()
        reference = sb.reference(SYSTEMS["Hertz"](), 0.1, method="cvode")
    finally:
        sundials._libraries.cache_clear()
    assert reference.provenance["callbacks"] == "Python"


def test_a_load_that_overflows_is_refused():
    t = np.linspace(0.0, 1.0, 5)
    system = chain(2, last(2, upper=0.02, stiffness=1e4), [(np.ones(2), sb.Sampled(t, [0, 0, 1e300, 1e300, 0]))])
    with pytest.raises(sb.InputError, match="energy that float64 can hold"):
        sb.reference(system, 1.0, method="cvode")
