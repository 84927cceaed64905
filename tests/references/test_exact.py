"""The exact solution against closed forms, its own equation of motion and fine sampling."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.model.modes import modes
from stiffbeam.references import solve


def test_the_exact_solution_satisfies_the_equation_of_motion_everywhere(table10_system):
    """M q'' + K q - loads - contact = 0, with q'' by differences of the closed-form velocity."""
    ref = solve(table10_system, 0.08, "exact", None, 0.0, None)
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


def test_frequencies_from_the_curvature_factor_lose_less_than_from_the_stiffness():
    """Against 40-digit frequencies of the same matrices: eps w_max/w_1 instead of its square."""
    mpmath = pytest.importorskip("mpmath")
    M = 25
    system = sb.semidiscretise(sb.BeamProblem(stiffness=300.0), M)
    with mpmath.workdps(40):
        h = mpmath.mpf(1) / M
        C = mpmath.zeros(M, M)
        C[0, 0] = mpmath.sqrt(2)
        for i in range(1, M):
            C[i, i] = 1
            C[i, i - 1] = -2
            if i > 1:
                C[i, i - 2] = 1
        scale = mpmath.diag([1] * (M - 1) + [mpmath.sqrt(2)])
        B = C * scale
        eigenvalues = sorted(mpmath.eigsy(B.T * B, eigvals_only=True))
        exact = np.array([float(mpmath.sqrt(300 * x) / h**2) for x in eigenvalues])
    by_factor = modes(system).omega
    by_stiffness = modes(dataclasses.replace(system, origin=None)).omega
    assert abs(by_factor[0] / exact[0] - 1) < 1e-12
    assert abs(by_factor[0] / exact[0] - 1) < 0.1 * abs(by_stiffness[0] / exact[0] - 1) + 1e-13
    assert np.max(np.abs(by_factor / exact - 1)) < 1e-12


@pytest.mark.parametrize("method", ["exact", "multiprecision"])
def test_a_mode_at_the_drives_frequency_that_is_not_forced_is_no_resonance(method):
    """K = diag(4, 9, 16) driven at 3 on the first mass only: u = (sin 3t - 1.5 sin 2t)/(4 - 9)."""
    system = sb.System.from_matrices(
        np.eye(3), np.diag([4.0, 9.0, 16.0]), loads=[([1.0, 0.0, 0.0], sb.Harmonic(1.0, 3.0))], observe=[1.0, 0.0, 0.0]
    )
    ref = sb.reference(system, 5.0, method)
    expected = (np.sin(3 * ref.t) - 1.5 * np.sin(2 * ref.t)) / (4.0 - 9.0)
    assert np.max(np.abs(ref.tip - expected)) < 1e-13
    forced = sb.System.from_matrices(
        np.eye(3), np.diag([4.0, 9.0, 16.0]),
        loads=[([1.0, 0.0, 0.0], sb.Harmonic(1.0, 3.0)), ([0.0, 0.0, 1.0], sb.Harmonic(1.0, 4.0))],
        observe=[0.0, 0.0, 1.0],
    )  # fmt: skip
    ref = sb.reference(forced, 5.0, method)  # at resonance: it grows in proportion to time
    assert np.max(np.abs(ref.tip - (np.sin(4 * ref.t) / 4.0 - ref.t * np.cos(4 * ref.t)) / 8.0)) < 1e-13
