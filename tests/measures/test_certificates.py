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
    ("t", "u"),
    [
        ([0.0, 4.0, 0.0], [0.0, 99.0, 0.0]),  # the last time is no end: the 99 was never looked at
        ([5.0, 0.0], [99.0, 0.0]),
        ([0.0, np.nan, 1.0], [0.0, 99.0, 0.0]),
        ([0.0, 1.0, 2.0], [0.0, np.nan, 0.0]),
        ([0.0, 1.0, 2.0], [0.0, 5.0j, 0.0]),  # the imaginary part was dropped
        ([], []),
    ],
)
def test_runs_that_prove_nothing_are_refused(reference, t, u):
    with pytest.raises(sb.InputError):
        within_reference((np.array(t), np.array(u)), reference, 1e-3)


@pytest.mark.parametrize(("tolerance", "until"), [
    (np.inf, None), (np.nan, None), (0.0, None), (-1.0, None), (1e-3, np.nan), (1e-3, -1.0), (1e-3, 6.0),
])  # fmt: skip
def test_numbers_that_prove_nothing_are_refused(reference, tolerance, until):
    with pytest.raises(sb.InputError, match="tolerance" if until is None else "until"):
        within_reference((reference.t, reference.tip + 9.0), reference, tolerance, until=until)


def test_other_systems_and_unknown_horizons_certify_nothing(reference):
    """Even where the motions are close."""
    unknown = dataclasses.replace(reference, horizon=float("nan"))
    with pytest.raises(sb.InputError, match="horizon"):
        within_reference((reference.t, reference.tip), unknown, 1e-3)
    other = dataclasses.replace(reference.system, v0=np.array([1.0 + 1e-9]))
    with pytest.raises(sb.InputError, match="same system"):
        within_reference(sb.integrate(other, sb.HHT(), 1e-3, 5.0), reference, 0.1)
    within_reference(sb.integrate(reference.system, sb.HHT(), 1e-3, 5.0), reference, 0.1)
