"""Orbits over a parameter: the branch against the section that it should meet, and what the study says of it."""

from __future__ import annotations

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.studies import study
from stiffbeam.studies.sweep import sections

STOP = sb.Contact(np.ones(1), sb.Stops(upper=0.0, stiffness=400.0))
LOAD = ([1.0], sb.Harmonic(1.0, 2.6))
OSCILLATOR = sb.System.from_matrices([[1.0]], [[1.0]], [[0.2]], loads=[LOAD], contacts=[STOP])
OPTIONS = {"dt": 1e-2, "t_end": 20.0}
VALUES = np.linspace(2.5, 2.65, 5).tolist()


def test_the_section_lies_on_the_stable_branch():
    """Another way to the same motion: where the tip repeats itself once a period, it is the orbit's."""
    found = study("orbits", OSCILLATOR, values=VALUES, **OPTIONS)
    orbits = [row for row in found.table.to_dict("records") if row["kind"] == "orbit" and row["length"] == 1]
    swept = study("sweep", OSCILLATOR, values=VALUES, method="exact", periods=4, transient=60, **OPTIONS)
    settled = {value: tips for value, tips in sections(swept.found, "frequency").items() if np.ptp(tips) < 1e-4}
    assert settled
    orbits.sort(key=lambda row: row["frequency"])
    w = [row["frequency"] for row in orbits]
    for value, tips in settled.items():
        tip = np.interp(value, w, [row["tip"] for row in orbits])
        assert abs(tip - tips[-1]) < 1e-3


def test_orbits_of_two_periods_are_followed_from_the_motion():
    found = study("orbits", OSCILLATOR, values=[2.6, 2.68], length=2, **OPTIONS)
    orbits = [row for row in found.table.to_dict("records") if row["kind"] == "orbit"]
    assert {row["phase"] for row in orbits} == {0, 1}
    assert found.answer.verdict == (
        "Orbits of 2 periods over frequency 2.6 to 2.68: flip at 2.66955: stable below, unstable above."
    )


def softly_stopped(frequency):
    return one_mass(1.0, sb.Stops(upper=0.5, stiffness=4.0), damping=0.1, load=sb.Harmonic(0.3, frequency))


@pytest.mark.slow
def test_a_branch_ends_at_a_fold_and_says_so():
    """Its distance from the orbit that it meets there falls as a square root: the last multiplier is near 1."""
    found = study("orbits", softly_stopped(1.2), values=[1.2, 1.35], **OPTIONS)
    (end,) = [row["reason"] for row in found.table.to_dict("records") if row["kind"] == "end"]
    assert end == "at 1.3179: a fold, where two orbits meet and the branch turns back"
    orbits = found.table[found.table.kind == "orbit"]
    last = orbits.loc[orbits.frequency.idxmax()]
    assert 0.9 < last["real"] < 1.0
    assert "stable all along. The branch ends at 1.3179: a fold" in f"{found.answer.verdict} {found.answer.notes}"


@pytest.mark.slow
def test_a_branching_is_one_of_the_beams_changes():
    """49.5998487551 by branches in pseudo-arclength. Newton's method fails close to it: the digits are fewer."""
    stops, base = sb.Stops(-0.1, 0.1, stiffness=5e6), sb.Harmonic(0.2, 49.6)
    beam = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, viscosity=0.05, stops=stops, base=base), 8)
    found = study("orbits", beam, values=[49.58, 49.63], dt=1e-3, t_end=1.0)
    (change,) = [row for row in found.table.to_dict("records") if row["kind"] == "change"]
    assert change["what"] == "branching"
    assert abs(change["frequency"] - 49.5998487551) < 1e-3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"parameter": "dt", "values": [1e-3, 2e-3]}, "be a path to a number of the system"),
        ({"values": [2.0, 2.0]}, "span a range"),
        ({"length": 0}, "be an integer >= 1"),
    ],
)
def test_what_the_study_refuses(options, words):
    with pytest.raises(sb.InputError, match=words):
        study("orbits", OSCILLATOR, **OPTIONS, **options)


def test_laws_and_drives_without_an_exact_period_are_refused():
    record = sb.Sampled(np.array([0.0, 30.0]), np.array([0.0, 1.0]))
    hertz = sb.Contact(np.ones(1), sb.Stops(upper=0.0, stiffness=400.0, exponent=1.5))
    for load, contact, words in ((([1.0], record), STOP, "have one drive frequency"), (LOAD, hertz, "a linear law")):
        system = sb.System.from_matrices([[1.0]], [[1.0]], [[0.2]], loads=[load], contacts=[contact])
        with pytest.raises(sb.InputError, match=words):
            study("orbits", system, **OPTIONS)
