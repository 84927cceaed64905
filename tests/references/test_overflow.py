"""Numbers near the ends of float64: a finite result, a refusal or Diverged, never an infinity in what comes back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fuzz_surfaces import BEAM, STOPS, mass, numbers_in

import stiffbeam as sb


def pressed(**law: float) -> sb.System:
    """A mass that begins inside its stop."""
    return mass(stops=sb.Stops(**STOPS | law), initial_displacement=[0.3], initial_velocity=[1.0])


def beam(form: str = "displacement", stops: dict[str, float] | None = None, **given: Any) -> sb.System:
    law = {} if stops is None else {"stops": sb.Stops(**STOPS | stops)}
    return sb.semidiscretise(sb.BeamProblem(**BEAM | law | given), 4, form)


def one(m: float = 1.0, k: float = 25.0, c: float = 0.0, row: float = 1.0, q0: float = 0.0, v0: float = 1.0):
    contact = sb.Contact([row], sb.Stops(**STOPS))
    start = {"initial_displacement": [q0], "initial_velocity": [v0]}
    return sb.System.from_matrices([[m]], [[k]], [[c]], contacts=[contact], **start)


SYSTEMS: dict[str, Callable[[float], sb.System]] = {
    "stiffness": lambda x: beam(stiffness=x), "viscosity": lambda x: beam(viscosity=x),
    "mass damping": lambda x: beam(mass_damping=x), "tip mass": lambda x: beam(tip_mass=x),
    "length": lambda x: beam(length=x), "mass per length": lambda x: beam(mass_per_length=x),
    "hermite": lambda x: beam("hermite", stiffness=x), "amplitude": lambda x: beam(base=sb.Harmonic(x, 10.0)),
    "frequency": lambda x: beam(base=sb.Harmonic(0.2, x)),
    "load": lambda x: beam(loads=sb.PointLoad(0.5, sb.Constant(x))),
    "stop": lambda x: beam(stops={"stiffness": x}),
    "stop of curvature": lambda x: beam("velocity-curvature", {"stiffness": x}),
    "gap": lambda x: beam(stops={"lower": -x, "upper": x}), "stop's damping": lambda x: beam(stops={"damping": x}),
    "stop's dissipation": lambda x: beam(stops={"dissipation": x}), "exponent": lambda x: beam(stops={"exponent": x}),
    "m": lambda x: one(m=x), "k": lambda x: one(k=x), "c": lambda x: one(c=x), "row": lambda x: one(row=x),
    "q0": lambda x: one(q0=x), "v0": lambda x: one(v0=x), "pressed": lambda x: pressed(stiffness=x),
    "pressed, exponent 1.5": lambda x: pressed(stiffness=x, exponent=1.5),
    "pressed, damping": lambda x: pressed(damping=x),
    "pressed, dissipation": lambda x: pressed(dissipation=x, exponent=1.5),
    "offset": lambda x: mass(offset=sb.Harmonic(x, 3.0)),
}  # fmt: skip
RUNS: dict[str, Callable[[sb.System], Any]] = {
    "hht": lambda system: sb.integrate(system, sb.HHT(), 1e-3, 0.05),
    "conserving": lambda system: sb.integrate(system, sb.Trapezoidal(), 1e-3, 0.05, contact="conserving"),
    "extrapolated": lambda system: sb.integrate(system, sb.BDF2(), 1e-3, 0.05, contact="extrapolated"),
    "ensemble": lambda system: sb.integrate_ensemble(system, sb.HHT(), 1e-3, 0.05, [system, system]),
    "exact": lambda system: sb.reference(system, 0.05, seconds=2.0),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("what", SYSTEMS)
def test_a_parameter_at_any_power_of_ten_ends_in_finite_numbers_or_says_why_not(what):
    for x in (*10.0 ** np.arange(-300, 0, 60.0), *10.0 ** np.arange(25, 301, 45.0), 1e308, 1.7e308):
        for name, run in RUNS.items():
            try:
                found = run(SYSTEMS[what](x))
                bad = [field for field, values in numbers_in(found) if not np.all(np.isfinite(values))]
            except (sb.InputError, sb.Diverged, sb.SolverFailure):
                continue
            assert not bad, (x, name, bad)


def test_a_contact_force_beyond_float64_is_an_overflow():
    """The positions stay below 1e81, the force does not."""
    system = pressed(dissipation=1e100, exponent=1.5)
    with pytest.raises(sb.Diverged, match=r"overflowed at t = 0\.001"):
        sb.integrate(system, sb.HHT(), 1e-3, 0.05)


def test_frequencies_beyond_float64_are_refused():
    assert np.isfinite(sb.modes(one(k=1e299)).omega[0])
    for system in (one(k=1.7e308), one(k=1e300, m=1e-20), one(c=1e300, m=1e-20)):
        with pytest.raises(sb.InputError, match="be in the range of float64 over the mass"):
            sb.integrate(system, sb.HHT(), 1e-3, 0.05)


def test_a_search_that_stands_still_ends_and_leaves_float64_as_it_was():
    """Decay rates of 1e70 die out at once, and are no reason to search on; a copy for the horizon meets them too.

    Which of the refusals it is depends on rounding: a search that gets on, by 1e-25 a switch, is too long.
    """
    before, why = np.geterr(), r"stands still|rounding is as large|overflows|s of CPU end before"
    for viscosity in (1e25, 1e30, 1e50, 1e70):
        with pytest.raises((sb.SolverFailure, sb.InputError), match=why) as caught:
            sb.reference(beam(viscosity=viscosity), 0.05, t_eval=np.linspace(0.0, 0.05, 501), seconds=20.0)
        assert np.geterr() == before  # while the failure, and with it all that stopped, is still held
        if isinstance(caught.value, sb.SolverFailure):
            assert caught.value.t < 0.05
