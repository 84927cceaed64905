"""Completion as a shell asks for it: commands, cases, files, schemes, methods, items of a list."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = "import sys; sys.argv = ['stiffbeam']; from stiffbeam.cli import main; main()"


def completed(line: str, folder=None) -> list[str]:
    words = line.split(" ")
    asked = {"_STIFFBEAM_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=os.environ | asked, cwd=folder, capture_output=True, text=True, timeout=60
    )
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.fast(1)
@pytest.mark.parametrize(
    ("line", "answers"),
    [
        ("stiffbeam comp", ["compare"]),
        ("stiffbeam compare table1", ["table1", *(f"table{n}" for n in range(10, 18))]),
        ("stiffbeam converge table10 --schemes BD", ["BDF2"]),
        ("stiffbeam compare table10 --schemes BDF2,HH", ["BDF2,HHT"]),
        ("stiffbeam compare table10 --references exact,cvode-", ["exact,cvode-adams"]),
        ("stiffbeam reference table10 --method ida", ["ida"]),
        ("stiffbeam score BDF2,kvaerno", ["BDF2,kvaerno3", "BDF2,kvaerno5"]),
        ("stiffbeam score BDF2 --problem bouncing-ball", ["bouncing-ball"]),
    ],
)
def test_values_are_completed(line, answers):
    assert completed(line) == answers


@pytest.mark.slow
def test_a_case_file_is_completed(tmp_path):
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "strip.toml").write_text("")
    (tmp_path / "models" / "notes.txt").write_text("")
    assert completed("stiffbeam compare mod", tmp_path) == ["models/"]
    assert completed("stiffbeam compare models/", tmp_path) == ["models/strip.toml"]
