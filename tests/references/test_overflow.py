"""Numbers near the ends of float64: a finite result, a refusal or Diverged, never an infinity in what comes back."""

from __future__ import annotations

import numpy as np
import pytest
from fuzz_surfaces import BEAM, STOPS, mass
from systems import one_mass

import stiffbeam as sb


def test_a_contact_force_beyond_float64_is_an_overflow():
    """The positions stay below 1e81, the force does not."""
    stops = sb.Stops(**STOPS, dissipation=1e100, exponent=1.5)
    system = mass(stops=stops, initial_displacement=[0.3], initial_velocity=[1.0])
    with pytest.raises(sb.Diverged, match=r"overflowed at t = 0\.001"):
        sb.integrate(system, sb.HHT(), 1e-3, 0.05)


def test_frequencies_beyond_float64_are_refused():
    stops = sb.Stops(**STOPS)
    assert np.isfinite(sb.modes(one_mass(1e299, stops)).omega[0])
    for k, m, c in ((1.7e308, 1.0, 0.0), (1e300, 1e-20, 0.0), (25.0, 1e-20, 1e300)):
        system = one_mass(k, stops, mass=m, damping=c)
        with pytest.raises(sb.InputError, match="be in the range of float64 over the mass"):
            sb.integrate(system, sb.HHT(), 1e-3, 0.05)


def test_a_search_that_stands_still_ends_and_leaves_float64_as_it_was():
    """Decay rates of 1e70 die out at once, and are no reason to search on; a copy for the horizon meets them too.

    Which of the refusals it is depends on rounding: a search that gets on, by 1e-25 a switch, is too long.
    """
    before, why = np.geterr(), r"stands still|rounding is as large|overflows|s of CPU end before"
    for viscosity in (1e25, 1e30, 1e50, 1e70):
        system = sb.semidiscretise(sb.BeamProblem(**BEAM, viscosity=viscosity), 4)
        with pytest.raises((sb.SolverFailure, sb.InputError), match=why) as caught:
            sb.reference(system, 0.05, t_eval=np.linspace(0.0, 0.05, 501), seconds=20.0)
        assert np.geterr() == before  # while the failure, and with it all that stopped, is still held
        if isinstance(caught.value, sb.SolverFailure):
            assert caught.value.t < 0.05
