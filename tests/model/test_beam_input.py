"""What a beam and its case file may not ask for, and what a case file names."""

from __future__ import annotations

from dataclasses import replace

from test_beams import beam

import stiffbeam as sb
from stiffbeam.files.cases import load_cases


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
    assert case.problem == replace(beam("clamped-pinned", mass_damping=0.3), units=sb.Units())
    assert case.runs[0][1] == "hermite"
