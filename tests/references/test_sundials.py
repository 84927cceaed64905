"""CVODE and IDA as libraries: warnings, versions, errors; and functions of time that Python evaluates for C."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from systems import SYSTEMS, chain, stop

import stiffbeam as sb
from stiffbeam.references.adaptive import sundials

METHODS = ("cvode", "cvode-adams", "ida")


@pytest.mark.parametrize("method", METHODS)
def test_a_start_on_a_stop_is_no_warning_of_the_library(method, capfd):
    """An event function that is zero for the first step made SUNDIALS write to the terminal."""
    still = sb.System.from_matrices(
        [[0.05]], [[1.2e4]],
        loads=[([1.0], sb.Sampled([0.0, 0.01, 0.012, 0.03], [0.0, 0.0, -150.0, -150.0]))],
        contacts=[sb.Contact([1.0], sb.Stops(lower=-8e-3, upper=0.0, stiffness=5e6, damping=100.0))],
    )  # fmt: skip
    assert sb.reference(still, 0.03, method).impacts.count > 0
    assert capfd.readouterr() == ("", "")


class Called:
    """A function of time as Python has to call it."""

    def __init__(self, function) -> None:
        self.value, self.rate, self.acceleration = function.value, function.rate, function.acceleration


@pytest.mark.fast(6, slow=12)
@pytest.mark.parametrize("method", [*METHODS, "dop853", "lsoda"])
@pytest.mark.parametrize("name", [x for x in SYSTEMS if x not in ("banded", "rotor", "viscous")])
def test_functions_of_time_in_python_give_the_same_motion(name, method):
    """C reads their values where it computes those of a harmonic or a record itself."""
    make, t_end = SYSTEMS[name]
    system = make()
    loads = [(vector, Called(function)) for vector, function in system.loads]
    contacts = [sb.Contact(c.row, c.stops, None if c.offset is None else Called(c.offset)) for c in system.contacts]
    python = dataclasses.replace(system, loads=loads, contacts=contacts)
    edges = system.drive.edges
    one, other = (sb.reference(x, t_end, method, rtol=1e-9, breakpoints=edges) for x in (system, python))
    np.testing.assert_allclose(other.tip, one.tip, atol=1e-5 * np.max(np.abs(one.tip)))
    for a, b in zip(one.contacts, other.contacts, strict=True):
        np.testing.assert_allclose(b.impacts.times, a.impacts.times, atol=1e-6 * t_end)
        np.testing.assert_allclose(b.impacts.peaks, a.impacts.peaks, rtol=1e-4)
        np.testing.assert_allclose(b.impacts.impulses, a.impacts.impulses, rtol=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_an_error_in_a_load_comes_through_the_library(method):
    def load(t):
        if np.ndim(t) == 0 and 0.1 < t < 0.4:
            raise KeyboardInterrupt
        return np.sin(t)

    with pytest.raises(KeyboardInterrupt):
        sb.reference(chain(2, stop(2), [(np.ones(2), load)]), 0.5, method)


def test_another_version_of_the_library_is_refused(monkeypatch):
    monkeypatch.setattr(sundials, "VERSION", 5)
    sundials.library_of.cache_clear()
    try:
        with pytest.raises(sb.InputError, match=r"be SUNDIALS 5.*got 'version 7'.*dop853"):
            sb.reference(chain(3, stop()), 0.1, method="cvode")
    finally:
        sundials.library_of.cache_clear()


def test_a_load_that_overflows_is_refused():
    t = np.linspace(0.0, 1.0, 5)
    system = chain(2, stop(2), [(np.ones(2), sb.Sampled(t, [0, 0, 1e300, 1e300, 0]))])
    with pytest.raises(sb.InputError, match="energy that float64 can hold"):
        sb.reference(system, 1.0, method="cvode")
