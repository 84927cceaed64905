"""Damping matrices that are not symmetric, or give energy: schemes and solvers against DOP853 of SciPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from adaptive_systems import rotor
from law_systems import Witness

import stiffbeam as sb

TIMES = np.linspace(0.0, 3.0, 301)


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    return Witness(rotor()).solve(TIMES)[0]


@pytest.mark.parametrize("method", ["exact", "dop853"])
def test_solvers_follow_the_rotor(method, truth):
    """The others are compared with the exact solution in test_solvers."""
    run = sb.reference(rotor(), 3.0, method, t_eval=TIMES)
    assert sum(c.impacts.count for c in run.contacts) == 19
    assert np.max(np.abs(run.tip - truth)) < 1e-6 * np.max(np.abs(truth))
    assert np.max(np.abs(run.energy.loss)) < 1e-6 * np.max(run.energy.energy)  # gyroscopic forces do no work


def test_what_needs_a_symmetric_or_passive_damping_refuses_another():
    free = replace(rotor(), contacts=(), loads=())
    from stiffbeam.measures.amplification import free_mode_errors

    with pytest.raises(sb.InputError, match=r"damping must have a symmetric .*for the errors of each mode"):
        free_mode_errors(sb.integrate(free, sb.HHT(), 1e-3, 1.0))
    for damping in ([[np.nan]], [[1.0, 0.0]]):
        with pytest.raises(sb.InputError, match="damping must"):
            sb.System.from_matrices([[1.0]], [[1.0]], damping, observe=[1.0])


def test_damping_that_gives_energy_is_marched_and_refused_or_solved_exactly():
    """x'' - .2 x' + 40 x = 0 grows until it meets both stops: the adaptive solvers agree, and so do the schemes."""
    stops = sb.Contact([1.0], sb.Stops(-0.1, 0.1, stiffness=500.0))
    system = sb.System.from_matrices([[1.0]], [[40.0]], [[-0.2]], contacts=[stops], initial_velocity=[0.5])
    assert not system.passive
    ref = sb.reference(system, 3.0, "dop853", t_eval=TIMES)
    assert ref.impacts.count > 0
    assert ref.horizon == 3.0
    assert ref.energy.viscous[-1] < 0.0
    run = sb.integrate(system, sb.HHT(), 1e-3, 3.0, every=10)
    assert np.max(np.abs(run.tip - ref.tip)) < 1e-3 * np.max(np.abs(ref.tip))
    assert run.energy.viscous[-1] == pytest.approx(ref.energy.viscous[-1], rel=1e-2)
    with pytest.raises(sb.InputError, match=r"damping must take energy .*use dop853"):
        sb.reference(system, 3.0)
