"""The tangent flow: against closed forms, against the growth of perturbations, and what is made of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from law_systems import kelvin_voigt_system, rigid_system
from systems import beam_of, two_contacts

import stiffbeam as sb
from stiffbeam.references import horizon
from stiffbeam.references.exact.motion import Solver
from stiffbeam.references.exact.tangent import Tangent, Variation


def test_without_contact_the_energy_of_a_tangent_vector_is_conserved(table10):
    free = sb.semidiscretise(dataclasses.replace(table10, stops=None), 12)
    growth = sb.lyapunov(free, 1.0)
    assert growth.log_growth.shape == (201, 4)
    assert np.max(np.abs(growth.log_growth)) < 1e-11
    assert abs(growth.exponent) < 1e-11


def test_a_damped_oscillator_loses_half_its_damping_a_period():
    """x'' + c x' + w^2 x = 0: Phi = exp(-c t/2) after whole periods of sqrt(w^2 - c^2/4)."""
    c, w = 0.3, 2.0
    t_end = 4 * 2 * np.pi / np.sqrt(w**2 - c**2 / 4)
    system = sb.System.from_matrices([[1.0]], [[w**2]], [[c]], observe=[1.0], initial_velocity=[1.0])
    growth = sb.lyapunov(system, t_end)
    assert np.allclose(growth.log_growth[-1], -c * t_end / 2, rtol=1e-12)
    assert abs(growth.exponent + c / 2) < 1e-13
    assert growth.digits == 0.0  # it loses none on the way down


PARTING = {  # system, end, step along the vector, error of the logarithm, whether at all times or at the end
    "table 10": (lambda: beam_of("displacement"), 0.15, 1e-8, 0.05, True),
    "viscous": (lambda: beam_of("displacement", 0.02), 0.3, 1e-8, 0.05, True),
    "two contacts": (two_contacts, 6.0, 1e-8, 0.05, True),
    **{f"damped stops {s}": (lambda s=s: kelvin_voigt_system(s), 3.0, 1e-7, 2e-6, False) for s in (0, 1, 3, 7)},
    **{f"rigid stops {s}": (lambda s=s: rigid_system(s), 1.5, 1e-8, 1e-5, False) for s in (1, 2, 4, 5, 6, 7, 8, 10)},
}


@pytest.mark.parametrize("which", PARTING)
@pytest.mark.fast(8)
def test_tangent_vectors_grow_as_perturbed_motions_part(which):
    """Compared while the difference is small, to the step times second derivatives. At an event of a stop whose force
    jumps one of the two motions is still ahead of it."""
    make, t_end, step, error, always = PARTING[which]
    system = make()
    growth = sb.lyapunov(system, t_end, rng=3)
    base = Solver(system).solve(t_end)
    variation = Variation(system)
    vectors = horizon._vectors(Tangent(variation, base, t_end), 3)
    dq, dv = (variation.X @ x.T for x in np.split(vectors, 2, axis=1))

    def size(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.sqrt(np.sum(v * (system.mass @ v), axis=0) + np.sum(q * (system.stiffness @ q), axis=0))

    dq, dv = (x / size(dq, dv) for x in (dq, dv))
    assert len(base.times) > 1
    t, logs = (x if always else x[-1:] for x in (growth.t, growth.log_growth))
    here = base.states(t)
    for j in range(dq.shape[1]):
        moved = dataclasses.replace(system, q0=system.q0 + step * dq[:, j], v0=system.v0 + step * dv[:, j])
        q, v = (b - a for a, b in zip(here, Solver(moved).solve(t_end).states(t), strict=True))
        measured = np.log(size(q.T, v.T) / step)
        # What is not linear is of the size of the difference, relative to a motion of size one.
        linear = logs[:, j] < np.log(1e-4 / step)
        assert np.sum(linear) > (150 if always else 0)
        assert np.max(np.abs(measured - logs[:, j])[linear]) < error
