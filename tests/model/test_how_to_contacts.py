"""The how-to scripts for contacts that the package does not have as such, each against one number of its own oracle."""

from __future__ import annotations

import massless_contact
import numpy as np
import pytest
import round_hole
from scipy.integrate import solve_ivp

import stiffbeam as sb


def test_twelve_sides_have_the_peak_force_of_the_circle():
    """Against SciPy with the force kappa (|r| - c)_+ along r; the polygon may be 2 % too soft to 28 % too stiff."""
    system = round_hole.tube_in_hole(12)
    inverse, n, ends = np.linalg.inv(system.mass), system.size, [5, 11]

    def rhs(t, z):
        q, v = z[:n], z[n:]
        force = system.load(t) - system.stiffness @ q - system.damping @ v
        size = np.hypot(*q[ends])
        force[ends] -= round_hole.KAPPA * max(size - round_hole.CLEARANCE, 0.0) * q[ends] / (size or 1.0)
        return np.concatenate([v, inverse @ force])

    exact = sb.reference(system, 0.1)
    z = solve_ivp(rhs, (0.0, 0.1), np.zeros(2 * n), "DOP853", exact.t, rtol=1e-7, atol=1e-11, max_step=2e-4).y
    circle = round_hole.KAPPA * (np.hypot(*z[ends]) - round_hole.CLEARANCE)
    polygon = np.hypot(*(round_hole.directions(12).T @ np.array([contact.force for contact in exact.contacts])))
    assert np.max(polygon) == pytest.approx(np.max(circle), rel=0.05)
    assert round_hole.force_ratio(12, 1e-9) == pytest.approx((0.0, 1.0), abs=1e-6)


def test_a_rod_without_mass_at_its_end_rebounds_with_its_speed():
    """The impulse of a free rod on a wall is twice its momentum; the mass of the node sets the error, 1/(2 n)."""
    assert sb.reference(massless_contact.rod(40), 3.0).contacts[0].impulse == pytest.approx(2.0, rel=1 / 80)
