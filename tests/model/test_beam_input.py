"""What a beam and its case file may not ask for, and what a case file names."""

from __future__ import annotations

from dataclasses import replace

import pytest
from test_beams import L, beam

import stiffbeam as sb
from stiffbeam.files.cases import load_cases


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: beam("clamped-hinged"), "supports must be known"),
        (lambda: beam("free-free", base=sb.Constant(0.1)), "base must be None for a free-free beam"),
        (lambda: beam("clamped-pinned", tip_mass=0.1), "tip_mass must be 0 for a clamped-pinned beam"),
        (lambda: beam(tip_mass=-0.1), "tip_mass must be >= 0"),
        (lambda: beam("pinned-pinned", stops=sb.Stops(upper=1, stiffness=1)), "stops.position must be inside a"),
        (lambda: sb.semidiscretise(beam("pinned-pinned"), 8), "supports must be clamped-free in the displacement form"),
        (lambda: sb.semidiscretise(beam(tip_mass=1.0), 8, "velocity-curvature"), "tip_mass must be 0 in the velocity"),
        (lambda: beam("clamped-clamped", initial_displacement=lambda x: x**2), "initial_displacement must equal"),
        (lambda: beam("clamped-clamped", initial_displacement=lambda x: x**2 * (x - L)), "zero slope at the clamp x"),
        (lambda: sb.semidiscretise(beam(), 8, "hermit"), "form must be one that there is.*hermite"),
    ],
)  # fmt: skip
def test_what_a_beam_cannot_be_is_refused(make, message):
    with pytest.raises(sb.InputError, match=message):
        make()


def test_a_case_file_names_supports_and_form(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(
        """
[[case]]
name = "strip"
cells = 8
dt = 1e-3
t_end = 0.1
runs = ["HHT@hermite"]
[case.problem]
length = 2.0
bending_stiffness = 3.0
mass_per_length = 0.7
supports = "clamped-pinned"
mass_damping = 0.3
"""
    )
    case = load_cases(file)["strip"]
    assert case.problem == replace(beam("clamped-pinned", mass_damping=0.3), units=("m", "s", "N"))
    assert case.runs[0][1] == "hermite"
