"""Modes of systems whose frequencies lie many powers of ten apart, against mpmath with 80 digits."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.model import modes as graded
from stiffbeam.model.modes import congruence, modes, product

mpmath = pytest.importorskip("mpmath")
EPS = float(np.finfo(float).eps)


def true_squares(mass, stiffness, springs=()):
    """The eigenvalues of L^-1 K L^-T, M = L L^T, in 80 digits."""
    with mpmath.workdps(80):
        K = mpmath.matrix(stiffness.tolist())
        for row, kappa in springs:
            r = mpmath.matrix(row.tolist())
            K += mpmath.mpf(kappa) * r * r.T
        inverse = mpmath.inverse(mpmath.cholesky(mpmath.matrix(mass.tolist())))
        return sorted(mpmath.eigsy(inverse * K * inverse.T, eigvals_only=True))


def system_of(mass, stiffness):
    return sb.System.from_matrices(mass, stiffness, observe=np.eye(len(mass))[0])


def chain(rng, n, decades):
    B = np.eye(n) - np.eye(n, k=-1)
    mass, springs = 10.0 ** rng.uniform(-decades / 2, decades / 2, (2, n))
    return np.diag(mass), B.T @ np.diag(springs) @ B


@pytest.mark.parametrize("seed", range(30))
def test_every_frequency_has_all_its_digits(seed):
    """Unless it is below the rounding of the entries of K, and then it is zero; with and without a hard stop."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 9))
    mass, stiffness = chain(rng, n, 12.0)
    if seed % 3 == 0:
        x = rng.normal(size=(n, n))
        mass = mass + 1e-3 * np.min(np.diag(mass)) * x @ x.T
    springs = ((rng.normal(size=n), 1e8 * float(np.max(stiffness))),) if seed % 2 else ()
    found = modes(system_of(mass, stiffness), springs)
    true = true_squares(mass, stiffness, springs)
    for omega, square in zip(found.omega, true, strict=True):
        if omega == 0.0:
            assert abs(square) < 1e-13 * true[-1]
        else:
            assert abs(omega / mpmath.sqrt(square) - 1) < 16 * n * EPS
    assert np.count_nonzero(found.omega) >= 1
    assert np.max(np.abs(found.shapes.T @ mass @ found.shapes - np.eye(n))) < 1e-12


def test_frequencies_below_the_square_root_of_the_rounding():
    """omega_1/omega_n of 1e-10: its square is 1e-20 of the largest."""
    mass, stiffness = np.diag([1e-4, 1e3, 1e3]), np.array([[1e5, -1e5, 0.0], [-1e5, 1e5, 0.0], [0.0, 0.0, 1e-6]])
    stiffness[1, 1] += 2.0**-16
    found = modes(system_of(mass, stiffness))
    true = [mpmath.sqrt(x) for x in true_squares(mass, stiffness)]
    assert found.omega[0] < 2e-9 * found.omega[-1]
    assert max(abs(a / b - 1) for a, b in zip(found.omega, true, strict=True)) < 16 * EPS


@pytest.mark.parametrize("n", [1, 2, 5, 40])
def test_a_free_chain_has_one_rigid_body_motion(n):
    rng = np.random.default_rng(n)
    B = np.eye(n)[1:] - np.eye(n)[:-1]
    stiffness = B.T @ np.diag(10.0 ** rng.uniform(-3, 3, n - 1)) @ B
    found = modes(system_of(np.diag(rng.uniform(0.5, 2.0, n)), stiffness))
    assert np.count_nonzero(found.omega == 0.0) == 1


def test_a_product_has_twice_the_digits():
    rng = np.random.default_rng(3)
    A, B = rng.normal(size=(4, 60)), rng.normal(size=(60, 3))
    A, B = np.hstack([A, -A]), np.vstack([B, B * (1.0 + 1e-12 * rng.normal(size=B.shape))])  # cancels to 1e-12
    high, low = product(A, B)
    with mpmath.workdps(60):
        true = mpmath.matrix(A.tolist()) * mpmath.matrix(B.tolist())
        for i in range(4):
            for j in range(3):
                assert abs(mpmath.mpf(high[i, j]) + mpmath.mpf(low[i, j]) - true[i, j]) < 1e-28
    huge = np.diag([1e300, 1e290])
    assert np.array_equal(congruence(huge, np.eye(2)), huge)


def test_modes_that_take_minutes_announce_it(monkeypatch):
    """Before they are refined, with a way that takes seconds."""
    monkeypatch.setattr(graded, "MINUTE", 20)
    mass, stiffness = chain(np.random.default_rng(0), 30, 8.0)
    with pytest.warns(UserWarning, match=r"modes of 30 unknowns will take about 2\d\d s: reduce_model"):
        modes(system_of(mass, stiffness))
