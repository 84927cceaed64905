"""Random systems with sampled loads: the exact solution against DOP853 with restarts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from systems import random_chain

import stiffbeam as sb
from stiffbeam.model.time_functions import parts_of
from stiffbeam.references import solve


def recorded_chain(number: int) -> tuple[sb.System, float]:
    """The ``number``-th chain with a record among its loads, and two of its longest periods."""
    seed = -1
    while number >= 0:
        seed += 1
        system, slow = random_chain(seed, [{}], 0.1)
        number -= any(isinstance(x, sb.Sampled) for f in system.time_functions for x in parts_of(f))
    return system, 4.0 * math.pi / slow


@pytest.mark.slow
@pytest.mark.parametrize("number", range(12))
def test_the_exact_solution_of_sampled_loads_is_dop853s_with_restarts(number):
    system, t_end = recorded_chain(number)
    t = np.linspace(0.0, t_end, 301)
    exact = sb.reference(system, t_end, t_eval=t)
    # Chaos magnifies what DOP853 errs by: twice the tolerance tells how long it is known.
    other, looser = (solve(system, t_end, "dop853", t, rtol, None) for rtol in (1e-12, 1e-10))
    scale = float(np.max(np.abs(exact.tip)))
    known = np.maximum.accumulate(np.abs(other.tip - looser.tip)) <= 1e-5 * scale
    off = np.abs(exact.tip - other.tip)[known & (t <= exact.horizon)]
    assert np.max(off) < 1e-4 * scale  # ten times what the two tolerances of DOP853 may differ by
    assert np.max(np.abs(exact.energy.loss)) < 1e-9 * np.max(exact.energy.energy)
