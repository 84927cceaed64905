"""The slowest modes of large models: those of all modes, and of the beam itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.model import modes as modes_module
from stiffbeam.model.modes import slowest

PROBLEM = sb.BeamProblem(stiffness=300.0)
ROOTS = np.array([1.8751040687119611, 4.694091132974175, 7.854757438237613])  # of cos x cosh x = -1


@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
@pytest.mark.parametrize("viscosity", [0.0, 0.02])
def test_a_few_modes_are_those_of_all(form, viscosity):
    if form != "displacement" and viscosity:
        form, viscosity = "hermite", 0.02
    system = sb.semidiscretise(replace(PROBLEM, viscosity=viscosity), 250, form)
    few, whole = sb.modes(system, 6), sb.modes(system)
    np.testing.assert_allclose(few.omega, whole.omega[:6], rtol=1e-9)
    np.testing.assert_allclose(few.shapes, whole.shapes[:, :6], atol=1e-7 * np.max(np.abs(whole.shapes)))
    np.testing.assert_allclose(few.damping_ratio, whole.damping_ratio[:6], rtol=1e-8, atol=1e-12)
    assert len(repr(few).splitlines()) == 7


@pytest.mark.slow
def test_frequencies_of_thousands_of_cells_are_those_of_the_beam(monkeypatch):
    def no_dense(*_):
        raise AssertionError("all modes were computed")

    monkeypatch.setattr(modes_module, "_undamped", no_dense)
    system = sb.semidiscretise(PROBLEM, 2000)
    omega = sb.modes(system, 3).omega
    np.testing.assert_allclose(omega, ROOTS**2 * np.sqrt(300.0), rtol=1e-5)


def test_other_systems_find_them_among_all():
    rng = np.random.default_rng(4)
    n = 210
    A, B = rng.normal(size=(2, n, n))
    plain = sb.System.from_matrices(np.eye(n), A @ A.T, observe=np.eye(n)[0])
    coupled = replace(plain, damping=1e-3 * B @ B.T)
    floating = sb.semidiscretise(replace(PROBLEM, supports="free-free"), 120, "hermite")
    for system in (plain, coupled, floating):
        assert slowest(system, 4) is None
        few, whole = sb.modes(system, 4), sb.modes(system)
        assert few.coupled == whole.coupled
        np.testing.assert_array_equal(few.omega, whole.omega[:4])
        np.testing.assert_array_equal(few.shapes, whole.shapes[:, :4])


def test_a_large_matrix_with_a_negative_eigenvalue_is_refused():
    """Banded and full ones are judged by their factors, which a small negative eigenvalue must not pass."""
    n = 100
    bands = np.diag(np.full(n, 2.0)) - np.eye(n, k=1) - np.eye(n, k=-1)
    least = 4.0 * np.sin(0.5 * np.pi / (n + 1)) ** 2
    full = 1e-3 * np.ones((n, n)) / n
    for matrix, bottom in ((bands, least), (bands + full, float(np.linalg.eigvalsh(bands + full)[0]))):
        for shift, accepted in ((0.5 * bottom, True), (bottom - 1e-12, True), (bottom + 1e-9, False), (1.5, False)):
            shifted = matrix - shift * np.eye(n)
            if accepted:
                sb.System.from_matrices(np.eye(n), shifted, observe=np.eye(n)[0])
                continue
            with pytest.raises(sb.InputError, match="positive semidefinite"):
                sb.System.from_matrices(np.eye(n), shifted, observe=np.eye(n)[0])
            with pytest.raises(sb.InputError, match="positive definite"):
                sb.System.from_matrices(shifted, np.eye(n), observe=np.eye(n)[0])
