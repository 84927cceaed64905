"""The how-to script for noise, and ensembles whose members have records of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from noise import noise
from systems import bouncing_chain

import stiffbeam as sb
from stiffbeam.references import solve

T_END, BAND = 6.0, (2.0, 20.0)


def test_noise_is_the_sum_of_cosines_that_its_docstring_states():
    record = noise(T_END, 0.7, BAND, seed=3)
    base = 2.0 * np.pi / T_END
    k = np.arange(np.ceil(BAND[0] / base), np.floor(BAND[1] / base) + 1)
    phases = np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, len(k))
    cosines = np.cos(np.outer(record.t, base * k) + phases)
    np.testing.assert_allclose(record.values, 0.7 * np.sqrt(2.0 / len(k)) * np.sum(cosines, axis=1), atol=1e-12)
    assert np.mean(record.values[:-1] ** 2) == pytest.approx(0.49, rel=1e-12)


def shaken(seed: int, moving: bool = False) -> sb.System:
    """The chain under noise of its own, with stops that move by noise."""
    system = bouncing_chain()
    offset = noise(T_END, 0.02, BAND, seed + 100) if moving else system.contacts[0].offset
    return replace(
        system,
        loads=(*system.loads, (np.array([0.0, 1.0, 0.5]), noise(T_END, 4.0, BAND, seed))),
        contacts=(replace(system.contacts[0], offset=offset),),
    )


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.fast(1)
def test_members_with_noise_of_their_own_are_their_solo_runs(moving):
    """To the bit, ledger included; of schemes and of the exact solution."""
    members = [shaken(seed, moving) for seed in range(3)]
    many = sb.integrate_ensemble(members[0], sb.HHT(alpha=-0.1), 1e-3, T_END, members, every=10)
    t = np.linspace(0.0, 1.0, 11)
    exact = sb.reference_ensemble(members[0], 1.0, members, t_eval=t)
    for i, member in enumerate(members):
        solo = sb.integrate(member, sb.HHT(alpha=-0.1), 1e-3, T_END, every=10)
        np.testing.assert_array_equal(many.tip[i], solo.tip)
        assert many.impact_count[i] == solo.impacts.count
        np.testing.assert_array_equal(many.ledger(i).loss[-1], solo.energy.loss[-1])
        np.testing.assert_array_equal(exact.tip[i], solve(member, 1.0, "exact", t, 0.0, None).tip)
    assert len(set(many.tip[:, -1].tolist())) == 3
