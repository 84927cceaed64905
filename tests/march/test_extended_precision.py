"""The block march against a scheme's own steps in extended precision, and where modes drift or meet."""

from __future__ import annotations

import extended_march
import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.schemes import registered

SCHEMES = list(registered())


@pytest.mark.parametrize("scheme", [*SCHEMES, sb.HHT(-0.1).printed("unweighted")], ids=str)
@pytest.mark.fast(2)
def test_blocks_round_table_10_by_a_bit_a_step(scheme):
    """Through five impacts or more, as if every step rounded the same way; four times that for what they magnify."""
    case = sb.paper_case(10)
    beam = sb.semidiscretise(case.problem, case.cells)
    dt, steps = 2e-5, 3600
    run = sb.integrate(beam, scheme, dt, steps * dt)
    assert run.impacts.count >= 5
    exact = extended_march.march(beam, scheme, dt, steps)[:, beam.tip_channel]
    assert np.max(np.abs(run.tip - exact)) < 4 * steps * np.finfo(float).eps * np.max(np.abs(run.tip))


def oscillator(
    stiffness: float = 1.0, viscous: float = 0.0, load: sb.Harmonic | sb.Constant | None = None
) -> sb.System:
    """A mass on a spring below a stop."""
    return one_mass(
        stiffness, sb.Stops(upper=1.0, stiffness=100.0), damping=viscous, load=load or sb.Harmonic(0.5, 0.3), v=1.5
    )


@pytest.mark.parametrize("scheme", [sb.Trapezoidal(), sb.BDF2(), sb.SDIRK()], ids=str)
@pytest.mark.parametrize(
    "system",
    [
        oscillator(viscous=2.0),  # two eigenvalues that are one
        oscillator(load=sb.Harmonic(0.1, 1.0)),  # a load in resonance
        oscillator(stiffness=0.0, load=sb.Constant(0.4)),  # a free mass that is pressed on its stop
        oscillator(stiffness=1e-11, load=sb.Harmonic(1.0, 20.0)),  # one that a spring hardly turns
    ],
    ids=["critically damped", "resonance", "free", "nearly free"],
)
@pytest.mark.fast(2)
def test_modes_that_drift_meet_or_resonate(scheme, system):
    dt, steps = 1e-2, 2000
    run = sb.integrate(system, scheme, dt, steps * dt)
    exact = extended_march.march(system, scheme, dt, steps)[:, 0]
    assert run.impacts.count > 0 or system.damping[0, 0] > 0.0
    assert np.max(np.abs(run.tip - exact)) < 1e-11 * np.max(np.abs(exact))


@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.fast(2)
def test_two_masses_that_nothing_holds_fly_on(scheme):
    """q_1 + q_2 = t, and q_1 - q_2 swings: 300 units of time in 3e6 steps."""
    system = sb.System.from_matrices(
        np.eye(2), [[100.0, -100.0], [-100.0, 100.0]], observe=[1.0, 1.0], initial_velocity=[1.0, 0.0]
    )
    run = sb.integrate(system, scheme, 1e-4, 300.0, every=1000)
    assert np.max(np.abs(run.tip - run.t)) < 1e-8 * 300.0


def test_memory_does_not_grow_with_the_steps():
    """Ten times as many, with as many outputs and some more impacts."""
    import tracemalloc

    system = oscillator(viscous=0.1)
    peaks = []
    for t_end in (100.0, 100.0, 1000.0):
        tracemalloc.start()
        run = sb.integrate(system, sb.HHT(-0.1), 1e-3, t_end, every=round(100 * t_end))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(run.t) == 11
    assert peaks[2] < 1.5 * peaks[1]
