"""Parameters by path: sweeps and members against closed forms, and the message for a path that is not there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.files.cases import case_of
from stiffbeam.studies.parameters import named
from stiffbeam.studies.sweep import sections

G = 1.0


def bounce(restitution: float, amplitude: float, frequency: float) -> tuple[float, float]:
    """Position and velocity at t = n T of a ball that hits the table A sin w t once a period.

    It leaves with g T/2 and arrives with -g T/2, so the table's speed is w A cos phi = (g T/2) (1 - e)/(1 + e).
    """
    period = 2.0 * np.pi / frequency
    speed = 0.5 * G * period
    phase = np.arccos(speed * (1.0 - restitution) / (1.0 + restitution) / (amplitude * frequency))
    flown = period - phase / frequency
    return amplitude * np.sin(phase) + speed * flown - 0.5 * G * flown**2, speed - G * flown


def ball() -> sb.System:
    position, velocity = bounce(0.55, 1.2, 1.0)
    stops = sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.55)
    return one_mass(0.0, stops, load=sb.Constant(-G), offset=sb.Harmonic(-1.2, 1.0), q=position, v=velocity)


@pytest.mark.fast(1)
@pytest.mark.parametrize(
    ("parameter", "values", "expected"),
    [
        ("contacts[0].stops.restitution", [0.5, 0.55, 0.6], lambda e: bounce(e, 1.2, 1.0)),
        ("contacts[0].offset.frequency", [1.0, 1.02, 1.04], lambda w: bounce(0.55, 1.2, w)),
        ("frequency", [1.0, 1.02, 1.04], lambda w: bounce(0.55, 1.2, w)),
    ],
)
def test_a_ball_on_a_vibrating_table_is_swept(parameter, values, expected):
    records = sb.study(
        "sweep",
        ball(),
        parameter=parameter,
        values=values,
        dt=1e-3,
        t_end=10.0,
        transient=80,
        periods=4,
        method="exact",
    )
    found = sections(records.found, parameter)
    assert list(found) == values
    assert set(records.table.method) == {"exact"}
    for value, section in found.items():
        assert section == pytest.approx(expected(value)[0], abs=1e-5)


def test_one_stop_of_several_is_swept():
    """Both stops are pressed at all times: mass, damper and the springs 4 + k_1 + k_2 respond linearly."""
    stops = [sb.Stops(upper=-9.0, stiffness=2.0), sb.Stops(lower=9.0, stiffness=3.0)]
    system = sb.System.from_matrices(
        [[1.0]],
        [[4.0]],
        [[1.0]],
        loads=[([1.0], sb.Harmonic(1.0, 2.0))],
        contacts=[sb.Contact([1.0], each) for each in stops],
    )
    values = [3.0, 4.0]
    records = sb.study(
        "sweep",
        system,
        parameter="stops[1].stiffness",
        values=values,
        method="exact",
        dt=1e-3,
        t_end=9.0,
        transient=20,
        periods=3,
    )
    for stiffness, section in sections(records.found, "stops[1].stiffness").items():
        spring = 4.0 + 2.0 + stiffness
        harmonic = np.imag(1.0 / (spring - 4.0 + 2.0j))
        assert section == pytest.approx(9.0 * (stiffness - 2.0) / spring + harmonic, abs=1e-8)


def test_an_amplitude_goes_with_the_square_of_the_frequency():
    """From rest: q = F/(k - w^2) (sin w t - w/w_0 sin w_0 t) with F = c w^2."""
    system = sb.System.from_matrices([[1.0]], [[4.0]], loads=[([1.0], sb.Harmonic(1.0, 1.0))], observe=[1.0])
    frequencies, t = np.array([1.0, 1.5, 3.0]), np.linspace(0.0, 5.0, 6)
    members = sb.varied_members(system, {"frequency": frequencies, "loads[0].time.amplitude": 0.2 * frequencies**2})
    for w, member in zip(frequencies, members, strict=True):
        q = 0.2 * w**2 / (4.0 - w**2) * (np.sin(w * t) - 0.5 * w * np.sin(2.0 * t))
        assert sb.reference(member, 5.0, t_eval=t).tip == pytest.approx(q, abs=1e-10)


def test_drives_of_one_frequency_go_together_with_their_phases():
    both = sb.Superposition(sb.Harmonic(1.0, 2.0), sb.Harmonic(3.0, 2.0, 0.5))
    system = sb.System.from_matrices([[1.0]], [[4.0]], loads=[([1.0], both)], observe=[1.0])
    member = sb.varied_members(system, frequency=[5.0])[0]
    terms = [term for _, term in member.loads[0][1].terms]
    assert terms == [sb.Harmonic(1.0, 5.0), sb.Harmonic(3.0, 5.0, 0.5)]
    with pytest.raises(sb.InputError, match="by its path"):
        sb.varied_members(system, amplitude=[5.0])


def test_paths_of_a_beam_change_its_problem():
    drive = sb.Harmonic(0.02, 5.0)
    stops = [sb.Stops(-0.1, 0.1, stiffness=1e4), sb.Stops(upper=0.1, stiffness=1e4, position=0.5)]
    system = sb.semidiscretise(sb.BeamProblem(stiffness=3.0, stops=stops, base=drive), 6)
    members = sb.varied_members(
        system, {"base.frequency": [7.0], "stops[1].damping": [2.0], "contacts[0].stops.upper": [0.2]}
    )
    changed = [sb.Stops(-0.1, 0.2, stiffness=1e4), sb.Stops(upper=0.1, stiffness=1e4, position=0.5, damping=2.0)]
    built = sb.semidiscretise(sb.BeamProblem(stiffness=3.0, stops=changed, base=sb.Harmonic(0.02, 7.0)), 6)
    assert members[0].fingerprint == built.fingerprint


def test_initial_data_have_the_names_of_from_matrices():
    members = sb.varied_members(ball(), {"initial_displacement[0]": [1.0, 2.0], "initial_velocity[0]": [3.0, 4.0]})
    assert [(m.q0[0], m.v0[0]) for m in members] == [(1.0, 3.0), (2.0, 4.0)]


@pytest.mark.parametrize(
    "path", ["", ".", "stops", "stops.stifness", "stops[2].damping", "q0[3]", "loads[0]", "base.frequency"]
)
def test_a_path_that_is_not_there_is_answered_with_those_that_are(path):
    with pytest.raises(sb.InputError, match=r"did you mean|known: frequency"):
        sb.varied_members(ball(), {path: [1.0]})


def test_members_with_other_matrices_are_the_beams_of_their_stiffness():
    def beam(stiffness: float) -> sb.System:
        return sb.semidiscretise(sb.BeamProblem(stiffness=stiffness, base=sb.Harmonic(0.02, 5.0)), 6)

    members = sb.varied_members(beam(3.0), {"stiffness": [4.0, 3.0]})
    assert [m.fingerprint for m in members] == [beam(4.0).fingerprint, beam(3.0).fingerprint]
    many = sb.integrate_ensemble(beam(3.0), sb.HHT(-0.1), 1e-3, 0.1, members, every=1)
    for tip, stiffness in zip(many.tip, (4.0, 3.0), strict=True):
        np.testing.assert_array_equal(tip, sb.integrate(beam(stiffness), sb.HHT(-0.1), 1e-3, 0.1).tip)


def test_of_two_drives_the_varied_one_sets_the_period():
    """Two harmonic responses; the section at n T of the second drive sees the second as a constant."""
    loads = [([1.0], sb.Harmonic(1.0, 1.0)), ([1.0], sb.Harmonic(0.5, 1.7))]
    system = sb.System.from_matrices([[1.0]], [[4.0]], [[1.0]], loads=loads, observe=[1.0])
    options = {"method": "exact", "dt": 1e-3, "t_end": 9.0, "transient": 20, "periods": 3}
    values = [1.3, 1.7]
    rows = sb.study("sweep", system, parameter="loads[1].time.frequency", values=values, **options).found
    for w, section in sections(rows, "loads[1].time.frequency").items():
        t = 2.0 * np.pi / w * np.arange(21, 24)
        first = np.imag(np.exp(1j * t) / (4.0 - 1.0 + 1.0j))
        assert section == pytest.approx(first + np.imag(0.5 / (4.0 - w**2 + 1.0j * w)), abs=1e-6)


@pytest.mark.slow
def test_a_scheme_with_an_impact_law_sweeps_a_rigid_stop():
    options = {"parameter": "contacts[0].stops.restitution", "values": [0.5, 0.6], "transient": 60, "periods": 3}
    rows = {
        method: sb.study("sweep", ball(), method=method, dt=5e-4, t_end=10.0, **options).found
        for method in ("exact", "MoreauJean")
    }
    for value, section in sections(rows["MoreauJean"], options["parameter"]).items():
        assert section == pytest.approx(sections(rows["exact"], options["parameter"])[value], abs=5e-3)
        assert section == pytest.approx(bounce(value, 1.2, 1.0)[0], abs=5e-3)
    counts = [set(found["count"][found.kind == "contact"]) for found in rows.values()]
    assert counts == [{3}, {3}]


@pytest.mark.parametrize("path", ["contacts[0].stops.restitution", "stops[0].restitution", "stops.restitution"])
def test_the_only_stops_of_a_beam_have_paths(path):
    stops = sb.Stops(-0.1, 0.1, stiffness=np.inf, restitution=0.5)
    system = sb.semidiscretise(sb.BeamProblem(stiffness=3.0, stops=stops, base=sb.Harmonic(0.02, 5.0)), 6)
    member = sb.varied_members(system, {path: [0.7]})[0]
    assert member.contacts[0].stops == sb.Stops(-0.1, 0.1, stiffness=np.inf, restitution=0.7)


def test_a_path_is_on_an_axis_with_its_unit():
    stops = sb.Stops(-0.1, 0.1, stiffness=1e4, damping=3.0)
    units = ("mm", "s", "N")
    beam = sb.BeamProblem(stiffness=300.0, stops=stops, base=sb.Harmonic(0.2, 10.0), length=1.0, mass_per_length=1.0)
    case = case_of(sb.semidiscretise(replace(beam, units=units), 6), 1e-3, 1.0)
    wanted = {
        "stiffness": "N/mm",
        "damping": "N s/mm",
        "dissipation": "s/mm",
        "lower": "mm",
        "motion.frequency": "rad/s",
    }
    for name, unit in wanted.items():
        assert named(case, f"contacts[0].stops.{name}") == f"contacts[0].stops.{name} ({unit})"
    assert named(case, "stops.exponent") == "stops.exponent"
    hertz = case_of(sb.semidiscretise(replace(beam, units=units, stops=replace(stops, exponent=1.5)), 6), 1e-3, 1.0)
    assert named(hertz, "stops.stiffness") == "stops.stiffness"


def test_two_paths_to_one_number_are_refused():
    """The later one won, and the results had the values of both."""
    stops = sb.Stops(upper=0.2, stiffness=50.0)
    system = one_mass(1.0, stops, damping=0.1, load=sb.Harmonic(amplitude=1.0, frequency=2.0))
    for one, other in (
        ("stops[0].upper", "contacts[0].stops.upper"), ("stops.upper", "stops[0].upper"),
        ("initial_displacement[0]", "q0[0]"),
    ):  # fmt: skip
        with pytest.raises(sb.InputError, match="be the only one to set its number"):
            sb.varied_members(system, {one: [0.1], other: [0.3]})
        assert len(sb.varied_members(system, {one: [0.1], other: [0.1]})) == 1
    grid = {"parameter": "stops[0].upper", "values": [0.1, 0.2], "second_values": [0.3, 0.4]}
    for second in ("contacts[0].stops.upper", "clearance"):
        with pytest.raises(sb.InputError, match="be the only one to set its number"):
            sb.study("sweep", system, dt=1e-2, t_end=1.0, second=second, **grid)
    kept = sb.varied_members(system, {"damping.scale": [2.0], "damping[0][0]": [1.0], "stops[0].upper": [0.4]})
    assert kept[0].damping[0, 0] == 1.0
