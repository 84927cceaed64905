"""A beam in metres, seconds and newtons, against the textbook: nothing is converted on the way."""

from __future__ import annotations

import math

import numpy as np
import pytest

import stiffbeam as sb

LENGTH, WIDTH, HEIGHT = 2.0, 0.05, 0.01  # a steel strip (m)


BENDING = 2.1e11 * WIDTH * HEIGHT**3 / 12  # EI


MASS = 7850.0 * WIDTH * HEIGHT  # rho A


FIRST = 1.8751040687119612**2 * math.sqrt(BENDING / (MASS * LENGTH**4))  # rad/s


STRIP = {"length": LENGTH, "bending_stiffness": BENDING, "mass_per_length": MASS}


TIP_STIFFNESS = 3.0 * BENDING / LENGTH**3  # N/m under a force at the tip


@pytest.mark.parametrize("noise", [lambda X: 0.0 * X, lambda X: 2e-17 * (X > 0.0)], ids=["none", "last bits"])
def test_a_beam_that_starts_straight_and_level_with_its_clamp_is_accepted(noise):
    """phi(0) is the same number only up to rounding, for lengths that are no power of two."""
    amplitude, phase = 0.073, 1.63
    problem = sb.BeamProblem.from_physical(
        length=3.07,
        bending_stiffness=1.0,
        mass_per_length=1.0,
        base=sb.Harmonic(amplitude, 30.0, phase),
        initial_displacement=lambda X: amplitude * np.sin(phase) + noise(X),
    )
    system = sb.semidiscretise(problem, 8)
    assert np.max(np.abs(system.q0 - amplitude * np.sin(phase) * (np.arange(1, 9) / 8.0) ** 2)) < 1e-15


def test_a_model_of_rotations_has_its_units():
    units = sb.Units("rad", "s", "N m")
    names = [units.of(x) for x in ("velocity", "stop stiffness", "impulse", "energy")]
    assert names == ["rad/s", "N m/rad", "N m s", "J"]
    with pytest.raises(sb.InputError, match=r"one of N, .*kN m"):
        sb.Units(force="rad")
