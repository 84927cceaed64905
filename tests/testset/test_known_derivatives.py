"""Derivatives of the test set, by ways of their own."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

import stiffbeam as sb

mp = pytest.importorskip("mpmath")
ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "reference" / "problems"
FILES = {file.stem: tomllib.loads(file.read_text(encoding="utf-8")) for file in FOLDER.glob("*.toml")}
KNOWN = sorted(name for name, file in FILES.items() if "derivatives" in file)
CONTACT = {name: file["system"]["contacts"][0] for name, file in FILES.items()}
POWERS = ("hertz", "hunt-crossley")
KAPPA, DISSIPATION = "contacts[0].stops.stiffness", "contacts[0].stops.dissipation"


def test_nine_problems_have_derivatives_of_tip_and_velocity_with_22_digits():
    assert len(KNOWN) == 9
    for name in KNOWN:
        known = sb.problem(name).derivatives
        assert set(known) == {"tip", "tip_velocity"}
        assert known["tip"].keys() == known["tip_velocity"].keys()
        for answer in known["tip"].values():
            assert "22 digits" in answer.how
            assert len(answer.digits.strip("-0.").partition("e")[0].replace(".", "")) >= 20 or answer.value == -1.0


@pytest.mark.parametrize("name", [name for name in KNOWN if name not in POWERS])
def test_the_derivatives_of_the_exact_solution(name):
    """In double precision, segment by segment: no code of either way."""
    problem = sb.problem(name)
    paths = list(problem.derivatives["tip"])
    found = sb.reference(problem.system, problem.t_end).derivative(paths)
    for what, values in (("tip", found.tip), ("tip_velocity", found.tip_velocity)):
        known = [problem.derivatives[what][path].value for path in paths]
        assert values[-1] == pytest.approx(known, rel=1e-10, abs=1e-13)


def restitution(x):
    """e of Hunt and Crossley at lambda v = x."""
    return mp.findroot(lambda e: x * (1 + e) - mp.log((1 + x) / (1 - e * x)), mp.mpf("0.6"))


def test_power_laws_by_their_scaling():
    """T is proportional to kappa^(-2/5) v^(-1/5) for Hertz and to kappa^(-2/5) for Hunt and Crossley, whose e depends
    on lambda v only: lambda v (1 + e) = ln[(1 + lambda v)/(1 - e lambda v)]."""
    with mp.workdps(40):
        for name in POWERS:
            file = FILES[name]
            tip, velocity = (
                {path: mp.mpf(x) for path, x in file["derivatives"][what].items()} for what in ("tip", "tip_velocity")
            )
            answers = {key: mp.mpf(x["value"]) for key, x in file["answers"].items() if isinstance(x["value"], str)}
            T, e, kappa = answers["contact_time"], answers["restitution"], mp.mpf(CONTACT[name]["stiffness"])
            assert abs(tip[KAPPA] / (-mp.mpf(2) / 5 * e * T / kappa) - 1) < mp.mpf(10) ** -21
            assert velocity[KAPPA] == 0
            if name == "hertz":  # tip = -v (t_end - t_0 - T), t_0 = -q0/v, v = 1
                after = mp.mpf(file["t_end"]) + mp.mpf(file["system"]["initial_displacement"][0]) - T
                entry = -mp.mpf(file["system"]["initial_displacement"][0])
                assert abs(tip["v0[0]"] - (-after - entry - T / 5)) < mp.mpf(10) ** -21
                assert (tip["q0[0]"], velocity["v0[0]"]) == (-1, -1)
            else:
                slope = mp.diff(restitution, 1)
                assert abs(velocity[DISSIPATION] / -slope - 1) < mp.mpf(10) ** -12
                assert abs(velocity["v0[0]"] / -(e + slope) - 1) < mp.mpf(10) ** -12
