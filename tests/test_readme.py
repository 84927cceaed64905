"""The README's Python and TOML are run as written."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
PYTHON = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
TOML = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("block", PYTHON, ids=lambda block: block.splitlines()[2][:30])
def test_every_python_block_runs(block, tmp_path):
    done = subprocess.run([sys.executable, "-W", "error", "-c", block], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


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
