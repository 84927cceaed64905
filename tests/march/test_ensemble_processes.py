"""Ensembles in the processes of joblib: the results of one process."""

from __future__ import annotations

from dataclasses import replace

import joblib
import numpy as np
import pytest

import stiffbeam as sb

SYSTEM = replace(sb.paper_case(10), cells=8).system()
SCHEME, DT, T_END = sb.HHT(alpha=-0.1), 1e-3, 0.2
LOADED = replace(SYSTEM, loads=(*SYSTEM.loads, (SYSTEM.contacts[0].row, lambda t: np.sin(t))))  # travels as well
SAMPLED = [
    replace(SYSTEM, loads=(*SYSTEM.loads, (SYSTEM.contacts[0].row, sb.Sampled([0.0, 0.2], [0.0, x])))) for x in (1, 2)
]


def same(one, other) -> None:
    np.testing.assert_allclose(one.tip, other.tip, rtol=0.0, atol=1e-9)
    for a, b in zip(one.contacts, other.contacts, strict=True):
        np.testing.assert_array_equal(a.impact_count, b.impact_count)
        np.testing.assert_allclose(a.impulse, b.impulse, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "members",
    [
        sb.perturbed_members(SYSTEM, 9),
        sb.perturbed_members(LOADED, 3, t_end=1.0),
        sb.varied_members(SYSTEM, {"stops.stiffness": np.linspace(1e4, 5e6, 5)}),
        SAMPLED,
    ],
    ids=["initial data", "function", "stiffness", "records"],
)
def test_processes_find_the_results_of_one(members):
    t, system = np.linspace(0.0, T_END, 7), getattr(members, "system", SAMPLED[0])
    runs = [sb.integrate_ensemble(system, SCHEME, DT, T_END, members, every=50, since=0.1)]
    exact = [sb.reference_ensemble(system, T_END, members, t)]
    with joblib.parallel_config("loky", n_jobs=2):
        runs.append(sb.integrate_ensemble(system, SCHEME, DT, T_END, members, every=50, since=0.1))
        exact.append(sb.reference_ensemble(system, T_END, members, t))
    same(*runs)
    same(*exact)
    assert runs[1].ledger(1).energy.shape == runs[0].ledger(1).energy.shape


def test_an_error_of_a_member_ends_the_ensemble():
    members = sb.varied_members(SYSTEM, {"stops.damping": [0.0, 1.0]})
    with pytest.raises(sb.InputError, match="extrapolated"), joblib.parallel_config("threading", n_jobs=2):
        sb.integrate_ensemble(SYSTEM, SCHEME, DT, T_END, members, "extrapolated")
