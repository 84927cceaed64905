"""Nothing false can be certified by ``assert_within_reference``: what proves nothing is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.pytest_plugin import within_reference


@pytest.fixture(scope="module")
def reference() -> sb.Reference:
    stop = sb.Contact([1.0], sb.Stops(None, 0.3, stiffness=100.0))
    return sb.reference(sb.System.from_matrices([[1.0]], [[4.0]], contacts=[stop], initial_velocity=[1.0]), 5.0)


def test_the_reference_itself_passes_and_an_error_does_not(reference):
    within_reference((reference.t, reference.tip), reference, 1e-12)
    with pytest.raises(AssertionError, match="off by"):
        within_reference((reference.t, 1.01 * reference.tip), reference, 1e-3)


@pytest.mark.parametrize(
    ("t", "u", "word"),
    [
        ([0.0, 4.0, 0.0], [0.0, 99.0, 0.0], "increase"),  # the last time is no end: the 99 was never looked at
        ([5.0, 0.0], [99.0, 0.0], "increase"),
        ([0.0, np.nan, 1.0], [0.0, 99.0, 0.0], "finite"),
        ([0.0, 1.0], [0.0, np.nan], "finite"),
        ([0.0], [0.0 + 5.0j], "real"),  # the imaginary part was dropped
        ([], [], "one length"),
    ],
)
def test_runs_that_prove_nothing_are_refused(reference, t, u, word):
    with pytest.raises(sb.InputError, match=word):
        within_reference((np.array(t), np.array(u)), reference, 1e-3)


def test_arrays_in_a_list_are_a_run_and_one_array_is_none(reference):
    """``sb.compare`` asks for lists."""
    t, u = reference.t, reference.tip
    within_reference([t, u], reference, 1e-12)
    within_reference([t, u, reference.tip_velocity], reference, 1e-12)
    with pytest.raises(AssertionError, match="off by"):
        within_reference([t, 1.01 * u], reference, 1e-3)
    with pytest.raises(sb.InputError, match=r"got 'ndarray': put the arrays into a list"):
        within_reference(np.column_stack([t, u]), reference, 1e-3)
    with pytest.raises(sb.InputError, match="4 arrays"):
        within_reference([t, u, u, u], reference, 1e-3)


@pytest.mark.parametrize("tolerance", [np.inf, np.nan, 0.0, -1.0])
def test_tolerances_that_prove_nothing_are_refused(reference, tolerance):
    with pytest.raises(sb.InputError, match="tolerance"):
        within_reference((reference.t, reference.tip + 9.0), reference, tolerance)


@pytest.mark.parametrize("until", [np.nan, -1.0, 6.0])
def test_spans_without_a_time_to_compare_are_refused(reference, until):
    with pytest.raises(sb.InputError, match="until"):
        within_reference((reference.t, reference.tip), reference, 1e-3, until=until)


def test_a_reference_without_a_horizon_certifies_nothing(reference):
    unknown = dataclasses.replace(reference, horizon=float("nan"))
    with pytest.raises(sb.InputError, match="horizon"):
        within_reference((reference.t, reference.tip), unknown, 1e-3)


def test_a_run_of_another_system_is_refused(reference):
    """Even where the motions are close."""
    other = dataclasses.replace(reference.system, v0=np.array([1.0 + 1e-9]))
    with pytest.raises(sb.InputError, match="same system"):
        within_reference(sb.integrate(other, sb.HHT(), 1e-3, 5.0), reference, 0.1)
    within_reference(sb.integrate(reference.system, sb.HHT(), 1e-3, 5.0), reference, 0.1)
