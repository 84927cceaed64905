"""Where eigenvalues meet each other or a drive: critical damping, free bodies, resonance, against closed forms,
matrix exponentials."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from systems import one_mass

import stiffbeam as sb


@pytest.mark.parametrize("method", ["exact", "multiprecision"])
@pytest.mark.parametrize(
    ("damping", "stiffness", "load", "q0", "v0", "closed"),
    [
        (4.0, 4.0, None, 1.0, 0.0, lambda t: (1 + 2 * t) * np.exp(-2 * t)),
        (4.0, 4.0, sb.Constant(4.0), 0.0, 0.0, lambda t: 1 - (1 + 2 * t) * np.exp(-2 * t)),
        (0.5, 0.0, None, 0.0, 1.0, lambda t: -2 * np.expm1(-t / 2)),
        (0.5, 0.0, sb.Constant(1.0), 0.0, 0.0, lambda t: 2 * t + 4 * np.expm1(-t / 2)),
        (1e-13, 0.0, sb.Constant(1.0), 0.0, 0.0, lambda t: t**2 / 2 - 1e-13 * t**3 / 6),
        (0.0, 0.0, sb.Constant(1.0), 1.0, 2.0, lambda t: 1 + 2 * t + t**2 / 2),
        (0.0, 0.0, sb.Harmonic(1.0, 2.0), 0.0, 0.0, lambda t: t / 2 - np.sin(2 * t) / 4),
        (0.0, 9.0, sb.Harmonic(1.0, 3.0), 0.0, 0.0, lambda t: (np.sin(3 * t) / 3 - t * np.cos(3 * t)) / 6),
    ],
    ids=["critical", "critical, loaded", "free, damped", "free, damped, loaded", "free, hardly damped", "free, loaded",
         "free, driven", "resonance"],
)  # fmt: skip
@pytest.mark.fast(8)
def test_closed_forms_of_one_mass(method, damping, stiffness, load, q0, v0, closed):
    """Two contacts out of reach, so that it is the solution by complex exponentials."""
    far = [sb.Contact([1.0], sb.Stops(-1e3, 1e3, stiffness=1.0))] * 2
    system = replace(one_mass(stiffness, damping=damping, load=load, q=q0, v=v0), contacts=far)
    ref = sb.reference(system, 5.0, method)
    assert ref.horizon == 5.0
    assert np.max(np.abs(ref.tip - closed(ref.t))) < 2e-14 * np.max(np.abs(closed(ref.t)))


@pytest.mark.parametrize("method", ["exact", "multiprecision"])
def test_two_bodies_that_only_dashpots_join(method):
    """Both stay where they come to rest: two eigenvalues are zero, with vectors that nothing tells apart."""
    K = scipy.linalg.block_diag(1.75740234e6 * np.array([[1, -1], [-1, 1]]), 0.103501745 * np.array([[1, -1], [-1, 1]]))
    D, M, v0 = np.zeros((4, 4)), np.diag([1.06739444, 1.42537542, 0.04774586, 0.01844781]), [0.0, 0.4535271, 0.7, 0.0]
    D[np.ix_([1, 3], [1, 3])] = 654.01983123 * np.array([[1.0, -1.0], [-1.0, 1.0]]) + np.diag([0.0, 8.04826245])
    made = sb.System.from_matrices(M, K, D, observe=np.eye(4)[3], initial_velocity=v0)
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-inverse @ K, -inverse @ D]])
    ref = sb.reference(made, 2.0, method, t_eval=np.linspace(0.0, 2.0, 6))
    tip = [(scipy.linalg.expm(A * t) @ np.append(np.zeros(4), v0))[3] for t in ref.t]
    assert ref.horizon == 2.0
    assert np.allclose(ref.tip, tip, rtol=0.0, atol=1e-9 * max(tip))
