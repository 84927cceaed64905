"""What a number is counted in stands beside it: in tables, answers, pictures and files."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.basics.text import unit_of
from stiffbeam.files.cases import Case
from stiffbeam.schemes import registered

BEAM = {"stops": sb.Stops(-2e-3, 2e-3, stiffness=1e5), "base": sb.Harmonic(2e-3, 150.0)}
STEEL = sb.BeamProblem(length=0.4, stiffness=4.2, mass_per_length=0.16, units=("m", "s", "N"), **BEAM)
PLAIN = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(-0.1, 0.1, stiffness=5e4), base=sb.Harmonic(0.2, 10.0))
RUNS = ((sb.HHT(-0.1), "displacement"),)
LABELS = [str(scheme) for scheme in registered()]
# What each study is asked, what its answer says and what its axes say of the steel beam.
STUDIES = {
    "sweep": ({"values": [140.0, 160.0], "periods": 2, "transient": 1}, ["(N)"],
              ["(rad/s)", "(N)", "(m)"]),
    "energy": ({"schemes": LABELS[:1]}, ["to t = 0.1"], ["(s)", "(J)"]),
    "chaos": ({"schemes": LABELS[:1], "starts": 8}, ["(1/s)", "digits per s"], ["(1/s)"]),
    "ensemble": ({"schemes": LABELS[:1], "members": 3}, ["duration (s)", "(N)", "(J)"],
                 ["(N)", "(J)"]),
    "rigid": ({"factors": [16.0, 256.0, 4096.0], "impacts": 2}, ["(N/m)"], ["(N/m)", "time (s)"]),
    "converge": ({"integrators": LABELS[:1], "halvings": 3, "impacts": 1, "kinds": ["smooth"]}, [], ["(s)"]),
}  # fmt: skip


def words_of(figure) -> list[str]:
    """Every label and title of a picture."""
    axes = [text for axis in figure.axes for text in (axis.get_xlabel(), axis.get_ylabel(), axis.get_title("left"))]
    return [figure.get_suptitle(), *axes]


@pytest.mark.fast(3)
@pytest.mark.parametrize("name", STUDIES)
def test_a_study_of_a_physical_case_names_its_units(name):
    options, answered, drawn = STUDIES[name]
    records = sb.study(name, Case("steel", "steel", STEEL, 8, 1e-4, 0.6 if name == "chaos" else 0.1, RUNS), **options)
    words = words_of(records.figure())
    assert not records.lost
    assert all(text in str(records) for text in answered)
    for text in drawn:
        assert any(text in word for word in words), (text, words)
    assert not any("u(1," in word for word in words)  # the tip is at L
    assert records.to_dict()["units"] == ["m", "s", "N"]


def test_a_comparison_names_the_unit_of_every_number():
    def compared(system, dt, t_end):
        run, reference = sb.integrate(system, sb.HHT(-0.1), dt, t_end), sb.reference(system, t_end)
        return run, reference, str(sb.compare(run, reference))

    run, reference, text = compared(sb.semidiscretise(STEEL, 8), 1e-4, 0.1)
    assert all(words in text for words in ("(N)", "(N s)", "(s)"))
    words = words_of(sb.compare(run, reference).figure())
    for text in ("tip displacement $u(L, t)$ (m)", "max |u|", "time $t$ (s)"):
        assert any(text in word for word in words), text
    assert np.allclose(run.displacement(0.4), run.tip, atol=1e-15)  # along its own length
    plain, _, text = compared(sb.semidiscretise(PLAIN, 8), 1e-3, 0.5)
    assert "(N)" not in text
    assert "units" not in plain.to_xarray()["tip"].attrs
    contact = sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=1e4))
    run, _, text = compared(
        sb.System.from_matrices([[1.0]], [[100.0]], contacts=[contact], initial_velocity=[2.0]), 1e-3, 1.0
    )
    assert "mesh" not in text
    assert "units" not in run.to_xarray()["tip"].attrs


@pytest.mark.parametrize(
    ("units", "quantity", "name"),
    [(("m", "s", "N"), "energy", "J"), (("rad", "s", "N m"), "stop stiffness", "N m/rad"), ((), "energy", ""),
     (("m", "s", "N"), "mass per length", "kg/m"), (("mm", "s", "N"), "energy", "N mm"),
     (("mm", "ms", "kN"), "velocity", "mm/ms"), (("mm", "s", "N"), "mass per length", "N s²/mm²")],
)  # fmt: skip
def test_derived_units_follow_from_three(units, quantity, name):
    assert unit_of(units, quantity) == name


@pytest.mark.parametrize("units", [("m", "", "N"), ("m", "s"), ("m", "s", 1), "mm", ("m", "s", "\x1b[2J")])
def test_units_that_are_none(units):
    with pytest.raises(sb.InputError, match=r"^units must "):
        sb.BeamProblem(stiffness=1.0, units=units)
