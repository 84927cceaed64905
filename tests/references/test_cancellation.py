"""Nothing certified is wrong where terms cancel: near resonance, over tiny times, with extreme numbers.

The witness is mpmath (witness.py): matrix exponentials with 60 digits, and closed forms.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from systems import case_of, one_mass
from witness import solve

import stiffbeam as sb
from stiffbeam.references.horizon import DISPLACEMENT_TOLERANCE
from stiffbeam.references.multiprecision import AGREEMENT


def truth(system: sb.System, times: np.ndarray) -> np.ndarray:
    return solve(case_of(system, float(times[-1])), 60).tip(times)


def driven(frequency: float, stiffness: float = 1.0, phase: float = 0.7) -> sb.System:
    return one_mass(stiffness, load=sb.Harmonic(1.0, frequency, phase))


@pytest.mark.parametrize("method", ["exact", "multiprecision"])
@pytest.mark.parametrize(
    ("drive", "t_end"),
    [((1.01,), 1e-5), ((1.01,), 1e-12), ((1.01,), 50.0), ((1.0 + 1e-9,), 50.0), ((1.0,), 1e-5), ((1.0,), 50.0),
     ((2.0, 0.0, 0.0), 1e-6)],
)  # fmt: skip
def test_a_drive_near_resonance_and_at_it_over_tiny_and_long_times(drive, t_end, method):
    """And of a free mass: u = (O t - sin O t)/O^2, t = 1e-6, with a leading term of O t^3/6 = 1e-18."""
    system, times = driven(*drive), np.linspace(0.0, t_end, 6)
    found, exact = sb.reference(system, t_end, method, times), truth(system, times)
    error = np.max(np.abs(found.tip - exact)) / np.max(np.abs(exact))
    assert found.horizon == t_end
    # the phase (w + Omega) t/2 = 50 is known to 50 eps
    assert error < 1e-13


@pytest.mark.parametrize("t_end", [1e-9, 1e-5, 1.0, 1e5, 1e12])
def test_an_overdamped_mass_that_creeps_is_solved_or_not_certified(t_end):
    """x'' + 1e7 x' + 1e-5 x = 1: the modes' amplitudes of 1e5 cancel to 1e-7 t."""
    system = one_mass(1e-5, damping=1e7, load=sb.Constant(1.0))
    times = np.linspace(0.0, t_end, 5)
    exact = truth(system, times)
    many = sb.reference(system, t_end, "multiprecision", times)
    assert many.horizon == t_end
    assert np.max(np.abs(many.tip - exact)) <= AGREEMENT * np.max(exact)
    if t_end == 1e-5:
        with pytest.raises(sb.SolverFailure):  # float64 has no digit left of it
            sb.reference(system, t_end, t_eval=times)
        return
    double = sb.reference(system, t_end, t_eval=times)
    inside = np.linspace(0.0, double.horizon, 5)
    exact = truth(system, inside)
    assert np.max(np.abs(double.at(inside)[0] - exact)) <= DISPLACEMENT_TOLERANCE * np.max(exact)


def test_where_float64_sums_cancel_all_of_a_multiprecision_reference_has_many_digits():
    """x'' + 1e7 x' + 1e-5 x = 1 over 1e-5: outputs, times between them, work and loss, and what a contact feels."""
    system = one_mass(1e-5, sb.Stops(None, -1.0, stiffness=1e-5), damping=1e7, load=sb.Constant(1.0))
    many = sb.reference(system, 1e-5, "multiprecision", np.linspace(0.0, 1e-5, 5))
    times = np.linspace(0.0, 1e-5, 14)
    loads = [*system.loads, ([-1.0], sb.Constant(1e-5))]  # it never leaves its stop
    exact = truth(replace(system, stiffness=[[2e-5]], loads=loads, contacts=[], observe=[1.0]), times)
    assert np.max(np.abs(many.at(times)[0] - exact)) < 1e-13 * exact[-1]
    assert np.isclose(many.contacts[0].peak_force, 1e-5 * (1.0 + exact[-1]), rtol=1e-15)
    assert np.isclose(many.contacts[0].impulse, 1e-10, rtol=1e-12)
    assert np.allclose(many.energy.input, many.tip, rtol=1e-13, atol=1e-30)  # int 1 u' dt = u
    assert np.max(np.abs(many.energy.loss)) < 1e-15 * many.energy.energy[0]
    # u' = f (1 - exp(-1e7 t))/1e7 but for 1e-12, f = 1 - 1e-5: int 1e7 u'^2 dt = f^2 (t - 1.5e-7)/1e7
    assert np.isclose(many.energy.viscous[-1], (1.0 - 1e-5) ** 2 * (1e-5 - 1.5e-7) / 1e7, rtol=1e-9)


def test_outputs_at_the_zeros_of_a_motion_are_not_certified():
    """x'' + w^2 x = 0 from x = 0, asked at multiples of 250 periods: every output is rounding."""
    omega = 3.7
    system = one_mass(omega**2, v=5.0)
    times = np.linspace(0.0, 1000 * 2 * np.pi / omega, 5)
    assert sb.reference(system, times[-1], t_eval=times).horizon < times[1]
    assert sb.reference(system, times[-1], t_eval=np.linspace(0.0, times[-1], 2000)).horizon == times[-1]


# ------------------------------------------------------------------ the equation, unforced modes


def test_the_exact_solution_satisfies_the_equation_of_motion_everywhere(table10_system):
    """M q'' + K q - loads - contact = 0, with q'' by differences of the closed-form velocity."""
    ref = sb.reference(table10_system, 0.08)
    rng = np.random.default_rng(0)
    t, step = rng.uniform(0.001, 0.079, 40), 1e-9
    _, ahead = ref.solution.states(t + step)
    _, behind = ref.solution.states(t - step)
    q, _ = ref.solution.states(t)
    residual = (ahead - behind) / (2 * step) @ table10_system.mass + q @ table10_system.stiffness
    residual -= table10_system.load(t)
    contact = table10_system.contacts[0]
    residual -= contact.stops.force(q @ contact.row)[:, None] * contact.row
    # differences: eps |v|/step = 2e-6 and w_max^3 v step^2 = 1e-4, per unit mass of 0.04 |q''| = 1e4
    assert np.max(np.abs(residual)) < 1e-4 * np.max(np.abs(q @ table10_system.stiffness))


@pytest.mark.parametrize("method", ["exact", "multiprecision"])
def test_a_mode_at_the_drives_frequency_that_is_not_forced_is_no_resonance(method):
    """K = diag(4, 9, 16) driven at 3 on the first mass and at 4 on the last, where it is one."""
    loads = [([1.0, 0.0, 0.0], sb.Harmonic(1.0, 3.0)), ([0.0, 0.0, 1.0], sb.Harmonic(1.0, 4.0))]
    system = sb.System.from_matrices(np.eye(3), np.diag([4.0, 9.0, 16.0]), loads=loads, observe=[1.0, 0.0, 0.0])
    ref = sb.reference(system, 5.0, method)
    t, q = ref.t, ref.states[0]
    assert np.max(np.abs(q[:, 0] - (np.sin(3 * t) - 1.5 * np.sin(2 * t)) / (4.0 - 9.0))) < 1e-13
    assert np.max(np.abs(q[:, 2] - (np.sin(4 * t) / 4.0 - t * np.cos(4 * t)) / 8.0)) < 1e-13
