"""The solution in many digits: against float64 inside the horizon, against itself past it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from systems import case_of, one_mass, two_contacts
from witness import solve

import stiffbeam as sb
from stiffbeam.references.horizon import time_tolerance
from stiffbeam.references.multiprecision import carry

pytest.importorskip("flint")


def viscous(viscosity: float, cells: int) -> sb.System:
    return sb.semidiscretise(dataclasses.replace(sb.paper_case(10).problem, viscosity=viscosity), cells)


MOTIONS = {  # system, end, horizon of float64, its largest difference to there over the motion, digits of another run
    "table 10": (lambda: sb.paper_case(10).system(), 0.7, (0.3, 0.45), 1e-3, 120),  # loses 33 digits per time unit
    "viscous": (lambda: viscous(0.05, 12), 0.3, (0.3, 0.3), 1e-9, 80),
    "overdamped": (lambda: viscous(20.0, 8), 0.3, (0.3, 0.3), 1e-9, 80),  # most modes, within 1e-7 of each other
    "two contacts, one moving": (two_contacts, 50.0, (20.0, 40.0), 1e-3, 120),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MOTIONS)
def test_float64_parts_from_it_at_its_horizon_and_the_digits_confirm_themselves(name):
    make, t_end, (least, most), error, digits = MOTIONS[name]
    system = make()
    many = sb.reference(system, t_end, "multiprecision")
    double = sb.reference(system, t_end, t_eval=many.t)
    assert many.horizon == t_end
    assert many.provenance["digits_confirmed_with"] < many.provenance["digits"] < 200
    assert many.provenance["digits_confirmed_with"] == 20 + np.ceil(1.05 * sb.lyapunov(system, t_end).digits)
    assert least <= double.horizon <= most
    inside, off = many.t <= double.horizon, np.abs(many.tip - double.tip) / np.max(np.abs(many.tip))
    assert np.max(off[inside]) < error
    assert np.max(off[~inside], initial=1.0) > 0.1
    assert all(contact.impacts.count > 1 for contact in many.contacts)
    # An independent number of digits gives the same switches over the whole span.
    other = carry(system, t_end, digits)
    assert np.array_equal(other.sides, many.solution.sides)
    assert np.max(np.abs(other.times - many.solution.times)) < 1e-14 * max(1.0, 0.2 * t_end)
    # The energy ledger closes as it does in float64: the pieces are one solution.
    assert np.max(np.abs(many.energy.loss)) < 1e-10 * np.max(many.energy.energy)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s: sb.reference(s, 0.1, "multiprecision", digits=5), "digits"),
        (lambda s: sb.lyapunov(s, -1.0), "t_end"),
        (lambda s: sb.lyapunov(s.problem, 1.0), "System"),
    ],
)
def test_what_exact_motions_cannot_take_is_refused(call, words, table10):
    with pytest.raises(sb.InputError, match=words):
        call(sb.semidiscretise(table10, 6))


@pytest.mark.slow
def test_a_damped_mass_between_stops_bounces_as_in_mpmath_past_the_float64_horizon():
    pytest.importorskip("mpmath")
    system = one_mass(1.0, sb.Stops(-0.64, 0.31, stiffness=200.0), damping=0.02, load=sb.Harmonic(3.8, 1.5), v=1.0)
    many, double = sb.reference(system, 56.0, "multiprecision"), sb.reference(system, 56.0)
    times, sides = (np.array(x) for x in zip(*solve(case_of(system, 56.0), 40).switches(0), strict=True))
    assert many.horizon == 56.0 > double.horizon + 15.0
    assert np.array_equal(many.solution.sides[1:, 0], sides)
    assert np.max(np.abs(many.solution.times[1:] - times)) < 1e-13  # rounding of the times to float64
    # float64 has it to its horizon.
    n = min(double.impacts.count, many.impacts.count)
    apart = np.abs(double.impacts.times[:n] - many.impacts.times[:n])
    assert np.max(apart[many.impacts.times[:n] < double.horizon]) < time_tolerance(system)
