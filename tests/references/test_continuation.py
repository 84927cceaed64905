"""Branches of periodic orbits: folds by the two orbits that meet there, a flip by its multiplier."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import stiffbeam as sb


def softly_stopped(frequency: float) -> sb.System:
    stop = sb.Contact(np.array([1.0]), sb.Stops(upper=0.5, stiffness=4.0))
    load = ([1.0], sb.Harmonic(0.3, frequency))
    return sb.System.from_matrices([[1.0]], [[1.0]], [[0.1]], loads=[load], contacts=[stop])


def turn(frequency: Any) -> Any:
    return 2.0 * np.pi / frequency


@pytest.mark.slow
def test_two_orbits_meet_at_a_fold():
    """Their distance is that of a square root: four times as far from the fold it doubles."""
    branch = sb.continuation(softly_stopped, "frequency", np.linspace(1.25, 1.35, 20), turn)
    assert len(branch.folds) == 2
    fold = float(np.max(branch.folds))
    top = int(np.argmax(np.diff(branch.values) < 0.0))  # where it turns back
    assert 0.0 <= fold - branch.values[top] < 1e-3
    near = int(np.argmin(np.abs(branch.values[: top + 1] - 1.316)))
    branch = sb.continuation(
        softly_stopped, "frequency", np.linspace(branch.values[near], 1.3185, 20), turn, branch.orbit(near)
    )
    assert abs(branch.folds[0] - fold) < 1e-9
    top, distances = int(np.argmax(np.diff(branch.values) < 0.0)), []
    for away in (1e-4, 4e-4):
        value, orbits = fold - away, []
        for k in (slice(0, top + 1), slice(top, int(np.argmin(branch.values[top:])) + top + 1)):
            order = np.argsort(branch.values[k])
            x = branch.values[k][order]
            guess = [np.array([np.interp(value, x, state[k][order, 0])]) for state in (branch.q, branch.v)]
            orbits.append(sb.periodic_orbit(softly_stopped(value), turn(value), guess))
        assert [orbit.stable for orbit in orbits] == [True, False]
        distances.append(abs(orbits[0].q[0] - orbits[1].q[0]))
    assert abs(distances[1] / distances[0] - 2.0) < 0.05
    assert branch.orbit(0).residual < 1e-13


def test_without_contact_it_is_the_linear_response():
    """|q(0)| of x'' + c x' + x = a sin(w t), and its multipliers exp(-c T/2 +- ...)."""

    def linear(frequency: float) -> sb.System:
        load = ([1.0], sb.Harmonic(0.3, frequency))
        return sb.System.from_matrices([[1.0]], [[1.0]], [[0.2]], loads=[load], observe=[1.0])

    branch = sb.continuation(linear, "frequency", [0.5, 0.7, 0.9, 1.1, 1.3], turn)
    w = branch.values
    assert len(w) >= 3
    amplitude = 0.3 / (1.0 - w**2 + 0.2j * w)
    assert np.allclose(branch.q[:, 0], amplitude.imag, atol=1e-10)
    assert np.allclose(branch.v[:, 0], amplitude.real * w, atol=1e-10)
    assert np.allclose(np.abs(branch.multipliers), np.exp(-0.1 * turn(w))[:, None], rtol=1e-9)
    assert len(branch.folds) + len(branch.flips) == 0


@pytest.mark.slow
def test_the_flip_of_the_beam():
    """Where the multiplier of the 90-event orbit is -1: 32.975300288681 by a prototype."""

    def beam(frequency: float) -> sb.System:
        stops, base = sb.Stops(-0.1, 0.1, stiffness=5e6), sb.Harmonic(0.2, frequency)
        return sb.semidiscretise(sb.BeamProblem(stiffness=300.0, viscosity=0.05, stops=stops, base=base), 8)

    branch = sb.continuation(beam, "frequency", [33.0, 32.97, 32.94], turn)
    assert np.allclose(branch.flips, 32.975300288681, rtol=0.0, atol=1e-9)
    assert len(branch.flips) == 1
    assert list(branch.stable[[0, -1]]) == [False, True]


def test_what_a_continuation_refuses():
    with pytest.raises(sb.InputError, match="be two or more numbers"):
        sb.continuation(softly_stopped, "frequency", [1.0], turn)
    with pytest.raises(sb.InputError, match="be a multiple of 2 pi"):
        sb.continuation(softly_stopped, "frequency", [1.0, 1.1], 1.0)
