"""The first impact's force, the beam's own speed, and what formulas of restitution deliver: each by a second way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from mpmath import mp

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.references import solve
from stiffbeam.studies import first_impact as first
from stiffbeam.studies import restitution as rest
from stiffbeam.studies import rigid_beam, study

CASE = sb.paper_case(10)


def test_the_point_contact_solves_its_equation():
    """s D = 1/s - s^(-1/2) D in the Laplace domain, inverted numerically."""
    for t in (0.3, 1.65, 4.0):
        for order, power in ((2.0, 1), (3.0, 2)):
            transform = lambda s, power=power: s**-0.5 / (s**1.5 + 1) / (s if power == 2 else 1)  # noqa: E731
            assert abs(first.penetration(t, order) - float(mp.invertlaplace(transform, t, method="talbot"))) < 1e-10
    t = np.linspace(0.0, 5.0, 5001)
    assert abs(max(first.penetration(x) for x in t) - first.largest_penetration()) < 1e-6
    assert abs(first.largest_penetration() - 0.858) < 1e-3


def test_the_beams_own_motion_is_where_elements_go():
    """Hermite elements from the smooth start: order 4 in the frequencies that matter."""
    problem = first.started(CASE.problem, first.SMOOTH)
    system = first.without_contact(sb.semidiscretise(problem, 24, form="hermite"))
    t = np.array([0.0, 0.02, 0.05])
    run = solve(system, 0.05, "exact", t, 0.0, None)
    for k in range(3):
        tip, speed = first.beam_tip(problem, first.SMOOTH, float(t[k]))
        assert abs(tip - run.tip[k]) < 1e-7
        assert abs(speed - run.tip_velocity[k]) < 1e-4
    # From rest the position converges too, the speed only like the square root of the number of modes.
    speeds = [first.beam_tip(CASE.problem, first.OWN, 0.05, n)[1] for n in (50_000, 200_000)]
    assert abs(speeds[1] - speeds[0]) < 3.0 * 8.0 / (np.pi * math.sqrt(2.0 * 50_000))  # the rms of the terms between


@pytest.mark.slow
def test_a_smooth_start_has_a_peak_that_converges():
    records = study("first_impact", CASE, cells=[40, 80, 160], starts=[first.SMOOTH], forms=["displacement", "hermite"])
    assert not records.failures
    rows = {(row["form"], row["cells"]): row for row in records.rows}
    finest = rows["hermite", 160]["share"]
    # The tip loses 3e-4 of its speed within the rise of the force: theory has it constant.
    assert abs(finest - first.largest_penetration()) < 1e-3
    errors = [abs(rows["displacement", n]["share"] / finest - 1.0) for n in (40, 80, 160)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.2)
    assert abs(rows["hermite", 40]["share"] / finest - 1.0) < 1e-3
    assert rows["hermite", 160]["impulse_share"] == pytest.approx(first.penetration(first.WINDOW, 3.0), rel=2e-3)


@pytest.mark.slow
def test_a_start_from_rest_has_a_speed_that_does_not():
    records = study("first_impact", CASE, cells=[20, 40, 80], starts=[first.OWN], forms=["displacement"])
    off = [abs(row["speed"] / row["beam_speed"] - 1.0) for row in records.rows]
    assert max(off) > 0.1
    assert abs(first.beam_speed(CASE.problem, first.OWN) - 7.407) < 0.05


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"stops": sb.Stops(upper=0.1, stiffness=5e6, exponent=1.5)}, "exponent"),
        ({"stops": sb.Stops(upper=0.1, stiffness=5e6, position=0.5)}, "stops at rest at the tip"),
        ({"viscosity": 0.1}, "viscosity"),
    ],
)
def test_what_the_theory_is_not_of_is_refused(changed, named):
    case = replace(CASE, problem=replace(CASE.problem, **changed), cells=8)
    with pytest.raises(InputError, match=named):
        study("first_impact", case, cells=[8], forms=["displacement"], starts=[first.OWN])


def test_a_stop_out_of_reach_is_refused():
    case = replace(CASE, problem=replace(CASE.problem, stops=sb.Stops(upper=10.0, stiffness=5e6)))
    records = study("first_impact", case, cells=[8], forms=["displacement"], starts=[first.OWN])
    assert "reached" in records.rows[0]["refused"]


# Rounded to five digits, computed apart from the package.
DELIVERED = {
    "Hunt-Crossley": (0.95237, 0.90902, 0.76800, 0.66296, 0.58129, 0.51583),
    "Lankarani-Nikravesh": (0.95351, 0.91318, 0.79597, 0.72524, 0.68422, 0.66527),
    "Herbert-McWhannell": (0.95011, 0.90089, 0.72268, 0.59362, 0.51997, 0.49070),
    "Lee-Wang": (0.97561, 0.95237, 0.86934, 0.79920, 0.73900, 0.68666),
    "Flores": (0.94683, 0.89392, 0.68318, 0.47044, 0.25621, 0.06944),
    "from_restitution": (0.95, 0.9, 0.7, 0.5, 0.3, 0.1),
}


def test_restitution_delivered():
    wanted = (0.95, 0.9, 0.7, 0.5, 0.3, 0.1)
    for name, values in DELIVERED.items():
        for e, value in zip(wanted, values, strict=True):
            assert abs(rest.restitution_of(rest.FORMULAS[name](e), 1.0) - value) < 0.51e-5


@pytest.mark.slow
def test_balls_deliver_what_the_closed_forms_say():
    records = study("restitution", CASE, wanted=[0.2, 0.6, 0.95])
    assert not records.failures
    assert len(records.rows) == 3 * (len(rest.FORMULAS) + 1)
    for row in records.rows:
        assert abs(row["measured"] - row["delivered"]) < 1e-10


def test_kelvin_voigt_lets_go_earlier_than_its_formula_has_it():
    """x'' + 2 zeta x' + x = 0 from (0, 1), to where 2 zeta x' + x = 0, in mpmath."""
    for e in (0.1, 0.5, 0.9):
        zeta = rest.zeta_of(e)
        w = mp.sqrt(1 - mp.mpf(zeta) ** 2)
        x = lambda t, z=zeta, w=w: mp.exp(-z * t) * mp.sin(w * t) / w  # noqa: E731
        assert abs(float(mp.diff(x, mp.pi / w)) + e) < 1e-12  # the formula's own
        force = lambda t, x=x, z=zeta: x(t) + 2 * z * mp.diff(x, t)  # noqa: E731
        when = mp.findroot(force, (0.5 * mp.pi / w, 0.99 * mp.pi / w), solver="anderson")
        assert abs(float(-mp.diff(x, when)) - rest.kelvin_voigt_restitution(zeta)) < 1e-10


def test_the_beam_between_stops_is_the_same_in_other_units():
    """Span and stiffnesses were those of Table 10 in any units: its beam in thousandths of time had no impulse."""
    found = []
    for length, time, mass in ((1.0, 1.0, 1.0), (1e3, 1e3, 1e-3)):
        stops = sb.Stops(lower=-0.1 * length, upper=0.1 * length, stiffness=5e6 * mass / time**2)
        base = sb.Harmonic(amplitude=0.2 * length, frequency=10.0 / time)
        parts = {"stiffness": 300.0 * mass * length**3 / time**2, "mass_per_length": mass / length, "length": length}
        system = sb.semidiscretise(sb.BeamProblem(stops=stops, base=base, **parts), cells=6)
        case = study("rigid_beam", system, dt=1e-4 * time, t_end=time, cells=[6], divide=[1])
        exact = [row for row in case.rows if row["method"] == rigid_beam.EXACT]
        found.append([row["impulse"] * time / mass / length for row in exact])
        found[-1] += [row["kappa"] * time**2 / mass for row in exact if row["kappa"] is not None]
    assert found[1] == pytest.approx(found[0], rel=1e-6)


@pytest.mark.slow
def test_towards_rigid_stops_the_impulse_converges_and_the_count_does_not():
    records = study("rigid_beam", CASE, kappas=[5e6, 1e9], cells=[12, 24], divide=[1])
    assert not records.failures
    exact = [row for row in records.rows if row["method"] == rigid_beam.EXACT]
    by = {(row["cells"], row["kappa"], row["node"], row["restitution"]): row for row in exact}
    for cells in (12, 24):
        assert abs(by[cells, 1e9, rigid_beam.NODE, None]["lost"]) < 1e-9
        assert abs(by[cells, None, rigid_beam.NODE, 1.0]["lost"]) < 1e-9
        assert by[cells, None, rigid_beam.NODE, 0.0]["lost"] > 0.0
        # A node with mass behind a stiff spring bounces as with restitution 1: in 6 and 17 bounces to 7 and 9 %.
        a, b = by[cells, 1e9, rigid_beam.NODE, None], by[cells, None, rigid_beam.NODE, 1.0]
        assert a["impulse"] == pytest.approx(b["impulse"], rel=0.12)
    coarse, fine = (by[cells, None, rigid_beam.NODE, 1.0]["impacts"] for cells in (12, 24))
    assert fine > 1.5 * coarse
    conserving = [row for row in records.rows if row["method"] == rigid_beam.CONSERVING]
    assert max(abs(row["lost"]) for row in conserving) < 1e-9
