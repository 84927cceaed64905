"""What a number is counted in stands beside it: in tables, answers, pictures and files."""

from __future__ import annotations

import re

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.basics.units import unit_of
from stiffbeam.files.cases import Case
from stiffbeam.measures.report import comparison_text

BEAM = {"stops": sb.Stops(-2e-3, 2e-3, stiffness=1e5), "base": sb.Harmonic(2e-3, 150.0)}
STEEL = sb.BeamProblem.from_physical(length=0.4, bending_stiffness=4.2, mass_per_length=0.16, **BEAM)
PLAIN = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(-0.1, 0.1, stiffness=5e4), base=sb.Harmonic(0.2, 10.0))
RUNS = ((sb.HHT(-0.1), "displacement"),)
CASES = {
    "steel": Case("steel", "steel", STEEL, 8, 1e-4, 0.1, RUNS),
    "longer": Case("steel", "steel", STEEL, 8, 1e-4, 0.6, RUNS),
    "plain": Case("plain", "plain", PLAIN, 8, 1e-3, 1.0, RUNS),
}
SCHEMES = {"schemes": ["HHT(alpha=-0.1)"]}
# What each study is asked, what its answer says and what its axes say of the steel beam.
STUDIES = {
    "sweep": ({"values": [140.0, 160.0], "periods": 2, "transient": 1}, ["(N)"],
              ["(rad/s)", "(N)", "(m)"]),
    "energy": (SCHEMES, ["to t = 0.1"], ["(s)", "(J)"]),
    "chaos": (SCHEMES | {"starts": 8}, ["(1/s)", "digits per s"], ["(s)", "(1/s)", "(m)", "(m/s)"]),
    "ensemble": (SCHEMES | {"members": 3}, ["per s", "(N)", "(J)"],
                 ["(N)", "(J)", "(rad/s)", "(m)"]),
    "rigid": ({"factors": [16.0, 256.0, 4096.0], "impacts": 2}, ["(N/m)"], ["(N/m)", "time (s)", "force (N)", "(m)"]),
    "converge": ({"integrators": SCHEMES["schemes"], "halvings": 3, "impacts": 1, "kinds": ["smooth"]}, [], ["(s)"]),
}  # fmt: skip


def words_of(figure) -> list[str]:
    """Every label and title of a picture."""
    axes = [text for axis in figure.axes for text in (axis.get_xlabel(), axis.get_ylabel(), axis.get_title("left"))]
    return [figure.get_suptitle(), *axes]


@pytest.mark.fast(3)
@pytest.mark.parametrize("name", STUDIES)
def test_a_study_of_a_physical_case_names_its_units(name):
    options, answered, drawn = STUDIES[name]
    records = sb.study(name, CASES["longer" if name == "chaos" else "steel"], **options)
    assert not records.lost
    words = words_of(records.figure())
    for text in answered:
        assert text in str(records)
    for text in drawn:
        assert any(text in word for word in words), (text, words)
    assert not any("u(1," in word for word in words)  # the tip is at L
    assert records.to_dict()["units"] == ["m", "s", "N"]
    assert records.table.attrs["units"] == ["m", "s", "N"]


def test_a_study_of_a_case_without_units_names_none():
    records = sb.study("sweep", CASES["plain"], values=[9.0, 10.0], periods=2, transient=1)
    words = words_of(records.figure())
    assert "tip $u(1, nT)$" in words
    assert not re.search(r"\((m|s|N|rad/s|Hz)\)", "".join(words))


def compared(system: sb.System, dt: float, t_end: float):
    run, reference = sb.integrate(system, sb.HHT(-0.1), dt, t_end), sb.reference(system, t_end)
    return run, reference, sb.compare(run, reference)


def test_a_comparison_names_its_units():
    *_, steel = compared(sb.semidiscretise(STEEL, 8), 1e-4, 0.1)
    text = comparison_text([steel])
    for words in ("(N)", "(N s)", "(s)"):
        assert words in text
    *_, plain = compared(sb.semidiscretise(PLAIN, 8), 1e-3, 0.5)
    text = comparison_text([plain])
    assert "(N)" not in text


def test_a_comparison_of_matrices_names_no_mesh_and_no_units():
    contact = sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=1e4))
    system = sb.System.from_matrices([[1.0]], [[100.0]], contacts=[contact], initial_velocity=[2.0])
    run, _, result = compared(system, 1e-3, 1.0)
    assert "mesh" not in comparison_text([result])
    assert "units" not in run.to_xarray()["tip"].attrs


def test_the_four_panels_of_a_physical_case_are_in_metres_and_seconds():
    from stiffbeam.figures.runs import four_panels

    run, reference, _ = compared(sb.semidiscretise(STEEL, 8), 1e-4, 0.1)
    words = words_of(four_panels("steel", [run], [reference]))
    for text in ("tip displacement $u(L, t)$ (m)", "max |$u(L, t)$|", "time $t$ (s)", "a = 150"):
        assert any(text in word for word in words), text


def test_a_file_names_the_unit_of_every_variable(tmp_path):
    run, reference, _ = compared(sb.semidiscretise(STEEL, 8), 1e-4, 0.1)
    assert run.energy.energy[-1] > 0.0  # so that the ledger is written
    data = run.to_xarray()
    units = {str(name): data[name].attrs["units"] for name in data.variables if "units" in data[name].attrs}
    assert units["time"] == units["impact_time"] == "s"
    assert (units["tip"], units["tip_velocity"], units["contact_force"]) == ("m", "m/s", "N")
    assert (units["impact_peak_force"], units["impact_impulse"], units["contact_impulse"]) == ("N", "N s", "N s")
    assert (units["energy_kinetic"], units["contact_fraction"]) == ("J", "1")
    for one in (run, reference):
        assert sb.load(one.save(tmp_path / "run.nc")).units == ("m", "s", "N")
    plain = sb.integrate(sb.semidiscretise(PLAIN, 8), sb.HHT(), 1e-3, 0.01)
    assert "units" not in plain.to_xarray()["tip"].attrs


def test_the_same_numbers_in_other_units_are_another_system():
    """Else a cache would give back a reference in millimetres for one in metres."""
    numbers = {"length": 1.0, "bending_stiffness": 300.0, "mass_per_length": 1.0}
    problems = [
        sb.BeamProblem(stiffness=300.0),
        sb.BeamProblem.from_physical(**numbers),
        sb.BeamProblem.from_physical(**numbers, units=("mm", "s", "N")),
    ]
    systems = [sb.semidiscretise(problem, 8) for problem in problems]
    assert len({system.fingerprint for system in systems}) == 3
    assert all(np.array_equal(system.stiffness, systems[0].stiffness) for system in systems)


@pytest.mark.parametrize(
    ("units", "quantity", "name"),
    [
        (("m", "s", "N"), "energy", "J"),
        (("rad", "s", "N m"), "energy", "J"),
        (("rad", "s", "N m"), "stop stiffness", "N m/rad"),
        ((), "energy", ""),
        (("m", "s", "N"), "mass per length", "kg/m"),
        (("mm", "s", "N"), "energy", "N mm"),
        (("mm", "ms", "kN"), "velocity", "mm/ms"),
        (("mm", "s", "N"), "mass per length", "N s²/mm²"),
    ],
)
def test_derived_units_follow_from_three(units, quantity, name):
    assert unit_of(units, quantity) == name


@pytest.mark.parametrize("units", [("m", "", "N"), ("m", "s"), ("m", "s", 1), "mm", 1, ("m", "s", "\x1b[2J")])
def test_units_are_three_printable_names(units):
    with pytest.raises(sb.InputError, match=r"^units must "):
        sb.BeamProblem(stiffness=1.0, units=units)


def test_a_physical_beam_is_evaluated_along_its_own_length():
    run = sb.integrate(sb.semidiscretise(STEEL, 8), sb.HHT(), 1e-4, 0.01)
    assert np.allclose(run.displacement(0.4), run.tip, atol=1e-15)
    with pytest.raises(sb.InputError, match=r"x must lie in \[0, 0\.4\]"):
        run.displacement(0.5)
