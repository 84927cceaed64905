"""The README's Python and TOML are run as written."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
PYTHON = [block for block in BLOCKS if "def test_" not in block]
TESTS = [block for block in BLOCKS if "def test_" in block]
TOML = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("block", PYTHON, ids=lambda block: block.splitlines()[2][:30])
def test_every_python_block_runs(block, tmp_path):
    done = subprocess.run([sys.executable, "-W", "error", "-c", block], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def test_the_downstream_test_passes(tmp_path):
    (tmp_path / "test_mine.py").write_text(TESTS[0], encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_mine.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "1 passed" in done.stdout


def test_the_case_file_runs(tmp_path):
    from stiffbeam.cases import load_cases

    (file := tmp_path / "my-beam.toml").write_text(TOML[0], encoding="utf-8")
    case = load_cases(file)["steel"]
    assert case.problem.units is not None
    assert len(case.runs) == 3
    # the commented lines are part of the documentation: they have to be right as well
    full = re.sub(r"^# (?=loads)", "", TOML[0], flags=re.MULTILINE)
    file.write_text(full, encoding="utf-8")
    assert len(load_cases(file)["steel"].problem.loads) == 2
