"""Uncertain parameters: draws against their distributions, members against systems built by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import invoke
from systems import one_mass

import stiffbeam as sb
from stiffbeam.files.cases import find_case, parse_case
from stiffbeam.studies import study

RECORD = sb.Sampled(np.linspace(0.0, 0.5, 51), 4.0 * np.sin(44.0 * np.linspace(0.0, 0.5, 51)), "cubic")
HHT = sb.HHT(-0.1)


def tube(bending: float = 300.0, kappa: tuple[float, float] = (1e4, 2e4), level: float = 1.0, place: float = 0.55):
    """A beam between two loose supports of different stiffness, under a record."""
    stops = [
        sb.Stops(-2e-4, 2e-4, stiffness=kappa[0], position=place),
        sb.Stops(-2e-4, 2e-4, stiffness=kappa[1], damping=0.5),
    ]
    force = sb.Sampled(RECORD.t, level * RECORD.values, "cubic")
    problem = sb.BeamProblem.from_physical(
        length=1.0, bending_stiffness=bending, mass_per_length=1.0, bending_viscosity=1.0, stops=stops,
        loads=(sb.PointLoad(0.7, force),),
    )  # fmt: skip
    return sb.semidiscretise(problem, 6)


def assert_alike(many: sb.Ensemble, i: int, run: sb.Trajectory, rtol: float) -> None:
    """Member i is the run of a system built by hand."""
    for seen, record in zip(many.contacts, run.contacts, strict=True):
        assert seen.impact_count[i] == record.impacts.count
        assert seen.peak_force[i] == pytest.approx(record.peak_force, rel=rtol)
        assert seen.impulse[i] == pytest.approx(record.impulse, rel=rtol)


PATHS = {"stiffness": 0.01, "stops.stiffness": sb.Uncertain(deviation=0.1), "loads[0].time.scale": 0.05}


def test_members_with_other_matrices_are_the_beams_built_by_hand():
    system = tube()
    members = sb.uncertain_members(system, PATHS, 5)
    many = sb.integrate_ensemble(system, HHT, 2e-4, 0.5, members, every=1)
    assert members.separate
    assert len({m.stiffness.tobytes() for m in members}) == 5
    assert all(np.sum(c.impact_count) > 0 for c in many.contacts)
    for i, (bending, kappa, level) in enumerate(members.values):
        hand = tube(300.0 * bending, (1e4 * kappa, 2e4 * kappa), level)  # one factor for both supports
        run = sb.integrate(hand, HHT, 2e-4, 0.5)
        assert_alike(many, i, run, 1e-6)
        np.testing.assert_allclose(many.tip[i], run.tip, rtol=0.0, atol=1e-6 * np.max(np.abs(run.tip)))
        assert many.ledger(i).supplied[-1] == pytest.approx(run.energy.supplied[-1], rel=1e-6)


@pytest.mark.slow
def test_the_exact_members_are_the_exact_beams_built_by_hand():
    system = tube()
    members = sb.uncertain_members(
        system, {"stiffness": 0.05, "stops[0].position": sb.Uncertain(between=(0.5, 0.6))}, 3
    )
    exact = sb.reference_ensemble(system, 0.2, members)
    for i, (bending, place) in enumerate(members.values):
        assert_alike(exact, i, sb.reference(tube(300.0 * bending, place=place), 0.2), 1e-6)


def test_members_that_share_their_matrices_march_side_by_side():
    system = tube()
    members = sb.uncertain_members(system, {"stops[1].upper": 0.1, "stops[0].stiffness": 0.1}, 4)
    assert not members.separate
    many = sb.integrate_ensemble(system, HHT, 5e-4, 0.5, members)
    for i, member in enumerate(members):
        assert_alike(many, i, sb.integrate(member, HHT, 5e-4, 0.5), 1e-12)
    assert members[0].contacts[1].stops.upper == 2e-4 * members.values[0, 0]


@pytest.mark.slow
def test_a_factor_on_a_record_is_that_of_each_member():
    """The record is one object in all members: a march that looked at it alone gave all the load of the first."""
    system = tube()
    members = sb.varied_members(system, {"loads[0].time.scale": [0.5, 1.0, 2.0]})
    many = sb.integrate_ensemble(system, HHT, 5e-4, 0.5, members)
    exact = sb.reference_ensemble(system, 0.1, members)
    for i, level in enumerate((0.5, 1.0, 2.0)):
        assert_alike(many, i, sb.integrate(tube(level=level), HHT, 5e-4, 0.5), 1e-6)
        assert_alike(exact, i, sb.reference(tube(level=level), 0.1), 1e-6)


def test_matrices_by_a_function_and_by_a_factor_are_one():
    mass, stiffness = np.diag([1.0, 0.5]), np.array([[900.0, -400.0], [-400.0, 400.0]])

    def build(values: dict[str, float]) -> sb.System:
        stops = sb.Stops(-values["gap"], values["gap"], stiffness=2e4)
        loads = [([1.0, 0.0], sb.Harmonic(3.0, 20.0))]
        contact = sb.Contact(np.array([0.0, 1.0]), stops)
        return sb.System.from_matrices(mass, values["k"] * stiffness, loads=loads, contacts=[contact])

    names = {"k": sb.Uncertain(tolerance=0.1), "gap": sb.Uncertain(between=(0.003, 0.004))}
    members = sb.uncertain_members(build, names, 4, nominal={"k": 1.0})
    assert members.system.stiffness[0, 0] == 900.0  # the nominal one, with the gap in the middle
    assert members.system.contacts[0].stops.upper == pytest.approx(0.0035)
    many = sb.integrate_ensemble(members.system, HHT, 1e-3, 2.0, members)
    for i, (k, gap) in enumerate(members.values):
        assert_alike(many, i, sb.integrate(build({"k": k, "gap": gap}), HHT, 1e-3, 2.0), 1e-12)
    by_factor = sb.uncertain_members(build({"k": 1.0, "gap": 0.0035}), {"stiffness.scale": 0.1}, 4)
    assert by_factor.separate
    for member, (factor,) in zip(by_factor, by_factor.values, strict=True):
        np.testing.assert_allclose(member.stiffness, factor * stiffness, rtol=1e-15)


@pytest.mark.slow
def test_draws_have_their_distributions_and_more_members_keep_the_first():
    """Of 4000 draws a mean is off by 5 of its deviations in one of two million; a normal value has kurtosis 3."""
    system = one_mass(4.0, sb.Stops(None, 1.0, stiffness=9.0), load=sb.Harmonic(2.0, 3.0, 0.5))
    paths = {
        "loads[0].time.amplitude": sb.Uncertain(tolerance=0.2),
        "stops[0].stiffness": sb.Uncertain(deviation=0.1),
        "loads[0].time.phase": sb.Uncertain(between=(0.0, 6.0)),
    }
    many = sb.uncertain_members(system, paths, 4000)
    np.testing.assert_array_equal(many.values[:7], sb.uncertain_members(system, paths, 7).values)
    assert np.any(many.values[:7] != sb.uncertain_members(system, paths, 7, seed=2).values)
    uniform, normal, phase = many.values.T
    for values, mean, deviation in (
        (uniform, 1.0, 0.2 / np.sqrt(3)),
        (normal, 1.0, 0.1),
        (phase, 3.0, 6 / np.sqrt(12)),
    ):
        assert abs(np.mean(values) - mean) < 5 * deviation / np.sqrt(4000)
        assert np.std(values) == pytest.approx(deviation, rel=5 / np.sqrt(8000))
    assert ((uniform >= 0.8) & (uniform <= 1.2)).all()
    assert np.max(np.abs(np.corrcoef(many.values.T) - np.eye(3))) < 5 / np.sqrt(4000)
    assert np.mean(((normal - 1.0) / 0.1) ** 4) == pytest.approx(3.0, abs=5 * np.sqrt(96 / 4000))
    assert many[5].loads[0][1].amplitude == 2.0 * uniform[5]
    assert many[5].loads[0][1].phase == phase[5]


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "path": ({"stops[0].kappa": 0.1}, r"be a path to a number of the system"),
    "zero": ({"stops[0].damping": 0.1}, r"finite and not 0 for a tolerance.*between two values"),
    "large": ({"stiffness": 1.5}, "uncertain stiffness: tolerance must be below 1"),
    "negative": ({"stiffness": -0.1}, "uncertain stiffness: tolerance must be"),
    "short": ({"frequency": 0.1}, r"path to one number.*loads\[0\].time.frequency"),
    "twice": ({"stops.stiffness": 0.1, "stops[1].stiffness": 0.1}, "name each number once"),
    "none": ({}, "name at least one parameter"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_drawn_is_refused(what):
    paths, words = REFUSED[what]
    with pytest.raises(sb.InputError, match=words):
        sb.uncertain_members(tube(), paths, 3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "state one of tolerance, deviation, between"),
        ({"tolerance": 0.1, "deviation": 0.1}, "state one of"),
        ({"between": (2.0, 1.0)}, "increasing"),
        ({"between": 1.0}, "be two numbers"),
        ({"deviation": 0.0}, "deviation must be"),
    ],
)
def test_a_distribution_that_states_none_is_refused(options, words):
    with pytest.raises(sb.InputError, match=words):
        sb.Uncertain(**options)


CASE = """
[[case]]
name = "tube"
cells = 6
dt = 2e-4
t_end = 0.5
[case.problem]
length = 1.0
bending_stiffness = 300.0
mass_per_length = 1.0
bending_viscosity = 1.0
loads = [{ position = 0.7, sampled = { t = TIMES, values = VALUES }, kind = "cubic" }]
[[case.problem.stops]]
lower = -2e-4
upper = 2e-4
stiffness = 1e4
position = 0.55
[[case.problem.stops]]
lower = -2e-4
upper = 2e-4
stiffness = 2e4
damping = 0.5
[case.uncertain]
stiffness = 0.01
stops.stiffness = { deviation = 0.1 }
"loads[0].time.scale" = 0.05
"""
CASE = CASE.replace("TIMES", str(RECORD.t.tolist())).replace("VALUES", str(RECORD.values.tolist()))


def test_a_value_that_a_distribution_draws_and_nothing_can_have_is_refused_with_its_cause():
    with pytest.raises(sb.InputError, match=r"must be > 0, got '?-.*its distribution draws such values"):
        sb.uncertain_members(tube(), {"stops.stiffness": sb.Uncertain(deviation=1.0)}, 64)


def test_a_name_of_a_case_file_is_a_path(tmp_path: Path):
    """A file states the stiffness as bending_stiffness, and its tolerance too."""
    (tmp_path / "tube.toml").write_text(
        """[[case]]
name = "tube"
cells = 4
dt = 1e-4
t_end = 0.1
[case.problem]
length = 1.2
bending_stiffness = 668.0
mass_per_length = 0.647
bending_viscosity = 0.15
[case.uncertain]
bending_stiffness = 0.01
bending_viscosity = 0.1
"""
    )
    case = sb.load_cases(tmp_path / "tube.toml")["tube"]
    system = case.system()
    (changed,) = sb.varied_members(system, {"bending_stiffness": [700.0]}).systems()
    assert changed.problem.stiffness == 700.0
    drawn = sb.uncertain_members(system, case.uncertain, 4).systems()
    assert len({x.problem.stiffness for x in drawn}) == len({x.problem.viscosity for x in drawn}) == 4
    assert all(abs(x.problem.stiffness / 668.0 - 1.0) <= 0.01 for x in drawn)


@pytest.mark.slow
def test_a_case_file_states_what_is_uncertain_and_the_ensemble_draws_it(tmp_path: Path):
    (tmp_path / "tube.toml").write_text(CASE)
    case = find_case(str(tmp_path / "tube.toml"))
    relative = {"stiffness": sb.Uncertain(0.01), "loads[0].time.scale": sb.Uncertain(0.05)}
    assert dict(case.uncertain) == PATHS | relative
    arguments = ["ensemble", str(tmp_path / "tube.toml"), "--members", "4", "--schemes", "HHT(alpha=-0.1)"]
    result = invoke([*arguments, "--out", str(tmp_path), "--json", "-"])
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)
    drawn = sb.uncertain_members(tube(), PATHS, 4)
    for row in (r for r in said["rows"] if r["kind"] == "member" and r["method"] == "HHT(alpha=-0.1)"):
        bending, kappa, level = drawn.values[row["member"]]
        run = sb.integrate(tube(300.0 * bending, (1e4 * kappa, 2e4 * kappa), level), HHT, 2e-4, 0.5)
        assert row["count"] == run.contacts[row["contact_number"] - 1].impacts.count
    assert "stiffness ±1 %, stops.stiffness deviation 10 %, loads[0].time.scale ±5 %" in said["notes"]
    with pytest.raises(sb.InputError, match="size must be left out"):
        study("ensemble", case, size=1e-3)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("stiffnes = 0.01", "tube: parameter must be a path"),
        ('stiffness = "thick"', 'uncertain "stiffness": tolerance must be'),
        ("stiffness = { tolerance = 0.1, between = [1, 2] }", "state one of"),
        ("stiffness = { tolerance = 0.1, kind = 3 }", "be a known field"),
    ],
)
def test_a_case_file_that_states_no_distribution_is_refused_with_its_place(line, words):
    with pytest.raises(sb.InputError, match=words):
        parse_case(CASE.partition("[case.uncertain]")[0] + "[case.uncertain]\n" + line, "own.toml")


@pytest.mark.slow
def test_an_ensemble_of_drawn_members_is_saved_with_its_numbers(tmp_path: Path):
    system = tube()
    many = sb.integrate_ensemble(system, HHT, 1e-3, 0.1, sb.uncertain_members(system, PATHS, 3))
    assert many.save(tmp_path / "many.nc").is_file()
    frame = many.to_dataframe()
    drawn = many.to_xarray()
    for path, numbers in zip(PATHS, many.members.values.T, strict=True):
        assert drawn[path].values.tolist() == frame[path].tolist() == numbers.tolist()
    assert frame.contact_peak_force_1.tolist() == many.contacts[1].peak_force.tolist()
    assert frame.attrs["parameter"] == "stiffness, stops.stiffness, loads[0].time.scale"
