"""Large sparse models in few modes: statics exact, frequencies, contact against the full model."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy.sparse

import stiffbeam as sb
from stiffbeam.model import reduction


def strip(elements: int):
    """M, K of a clamped-free beam of cubic elements, EI = m = L = 1, sparse; and the row of its tip."""
    h = 1.0 / elements
    k = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                  [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]]) / h**3  # fmt: skip
    m = h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                            [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])  # fmt: skip
    unknowns = (2 * np.arange(elements)[:, None] + np.arange(4)).ravel()  # of each element in turn
    gather = scipy.sparse.csr_array((np.ones(4 * elements), (np.arange(4 * elements), unknowns)))
    each = scipy.sparse.eye_array(elements)
    found = [(gather.T @ scipy.sparse.kron(each, x) @ gather).tocsc()[2:, 2:] for x in (m, k)]
    tip = np.zeros(2 * elements)
    tip[-2] = 1.0
    return *found, tip


def forced(tip, n):
    """A load at mid-span, a stop at the tip."""
    load = np.zeros(n)
    load[n // 2 - 1 - (n // 2 - 1) % 2] = 1.0
    return {
        "loads": [(load, sb.Harmonic(3.0, 2.5))],
        "contacts": [sb.Contact(tip, sb.Stops(-0.1, 0.05, stiffness=300.0))],
    }


def test_frequencies_are_the_models_and_rayleigh_damping_decouples():
    M, K, tip = strip(60)
    system, _ = sb.reduce_model(
        M, K, 0.1 * M + 1e-4 * K, contacts=[sb.Contact(tip, sb.Stops(upper=1.0, stiffness=1.0))], modes=6
    )
    roots = np.array([1.8751040687119611, 4.694091132974175, 7.854757438237613])
    found = sb.modes(system)
    np.testing.assert_allclose(found.omega[:3], roots**2, rtol=(roots[-1] / 60) ** 4 / 720)
    assert not found.coupled
    np.testing.assert_allclose(found.damping_ratio[:3], 0.5 * (0.1 / roots**2 + 1e-4 * roots**2), rtol=1e-6)


def test_contact_converges_to_the_full_model():
    """Each doubling of the modes is nearer to all 32 unknowns."""
    M, K, tip = strip(16)
    data = forced(tip, 32)
    full = sb.reference(sb.System.from_matrices(M, K, **data), 3.0)
    assert full.impacts.count > 2
    assert full.horizon == 3.0
    off = []
    for modes in (2, 4, 8, 16):
        run = sb.reference(sb.reduce_model(M, K, **data, modes=modes)[0], 3.0)
        off.append(np.max(np.abs(run.tip - full.tip)) / np.max(np.abs(full.tip)))
    assert all(b < 0.5 * a for a, b in pairwise(off))
    assert off[-1] < 1e-3


def test_thousands_of_unknowns_are_small():
    """6000 unknowns: nothing dense of n x n is made, and the run is that of 400 unknowns to what elements err by."""
    runs = []
    for elements in (200, 3000):
        M, K, tip = strip(elements)
        system, _ = sb.reduce_model(M, K, **forced(tip, M.shape[0]), modes=12)
        assert system.size <= 14
        runs.append(sb.integrate(system, sb.HHT(alpha=-0.1), 1e-3, 1.0).tip)
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-4 * np.max(np.abs(runs[0])))


def test_initial_data_that_the_basis_lacks_are_told():
    M, K, tip = strip(20)
    q0 = sb.modes(sb.System.from_matrices(M, K, observe=tip)).shapes
    sb.reduce_model(M, K, observe=tip, initial_displacement=q0[:, 0], modes=5)  # no warning
    with pytest.warns(UserWarning, match=r"5 modes lose 0\.0?[19]\d* of the initial_displacement"):
        sb.reduce_model(M, K, observe=tip, initial_displacement=q0[:, 0] + 0.1 * q0[:, 15], modes=5)


def test_unknowns_without_mass_are_condensed():
    """Half the mass of two elements at each node, none for its rotation; frequencies of an independent solution."""
    _, K, tip = strip(10)
    masses = np.zeros(20)
    masses[::2] = 0.1
    masses[-2] = 0.05
    system = {"stiffness": K, "observe": tip, "loads": [(tip, sb.Constant(0.7))]}
    with pytest.raises(sb.InputError, match=r"condense .*reduce_model"):
        sb.System.from_matrices(np.diag(masses), **system)
    small, basis = sb.reduce_model(scipy.sparse.diags_array(masses), **system, modes=3)
    np.testing.assert_allclose(sb.modes(small).omega[:3], [3.49995637, 21.68977853, 60.12387411], rtol=1e-9)
    assert (basis @ np.linalg.solve(small.stiffness, small.load(0.0)))[-2] == pytest.approx(0.7 / 3.0, rel=1e-10)


@pytest.mark.parametrize("modes", [1, 5, 60])
def test_dense_and_lanczos_give_the_same_modes(modes, monkeypatch):
    M, K, tip = strip(150)
    dense, _ = sb.reduce_model(M, K, observe=tip, modes=modes)
    monkeypatch.setattr(reduction, "DENSE", 10)
    sparse, _ = sb.reduce_model(M, K, observe=tip, modes=modes)
    # rounding by the condition of K
    np.testing.assert_allclose(np.diag(dense.stiffness)[:modes], np.diag(sparse.stiffness)[:modes], rtol=1e-7)


@pytest.mark.parametrize("beside", [0.0, -1.0], ids=["alone", "on a mass that is a mode"])
def test_a_load_that_moves_no_mass_is_refused(beside):
    K = np.array([[3.0, beside, 0.0], [beside, 5.0, 0.0], [0.0, 0.0, 7.0]])
    load = [([0.0, 1.0, 0.0], sb.Constant(1.0))]
    with pytest.raises(sb.InputError, match="loads, contacts and observe must move mass"):
        sb.reduce_model(np.diag([1.0, 0.0, 1.0]), K, None, load, observe=[1.0, 0.0, 0.0], modes=1)


def test_modal_damping_belongs_to_the_reduced_modes():
    """On top of a damping matrix."""
    M, K, tip = strip(40)
    contacts = [sb.Contact(tip, sb.Stops(upper=1.0, stiffness=1.0))]
    system, _ = sb.reduce_model(M, K, 0.1 * M, contacts=contacts, modes=5)
    added = sb.modal_damping(system.mass, system.stiffness, [0.02, 0.03])
    natural = sb.modes(replace(system, damping=system.damping + added))
    expected = 0.05 / natural.omega
    expected[:2] += (0.02, 0.03)
    np.testing.assert_allclose(natural.damping_ratio, expected, rtol=1e-9)
    with pytest.raises(sb.InputError, match="at most one for each"):
        sb.modal_damping(system.mass, system.stiffness, [0.01] * 9)


def test_gyroscopic_terms_stay():
    M, K, tip = strip(10)
    skew = scipy.sparse.diags_array([1.0, -1.0], offsets=[1, -1], shape=K.shape)
    system, T = sb.reduce_model(M, K, damping=skew, observe=tip, modes=3)
    assert system.gyroscopic
    np.testing.assert_allclose(system.damping, T.T @ (skew @ T), atol=1e-12 * np.max(np.abs(system.damping)))


def test_a_stop_that_moves_does_so_in_the_reduced_model():
    mass, stiffness, tip = strip(4)
    contact = sb.Contact(tip, sb.Stops(upper=0.1, stiffness=1e3), sb.Harmonic(0.01, 3.0))
    assert sb.reduce_model(mass, stiffness, contacts=[contact], modes=3)[0].contacts[0].offset == contact.offset
