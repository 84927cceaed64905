"""The how-to scripts run as they stand, without warnings; each asserts one of its numbers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "studies" / "how-to"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_asserts_its_number(script, tmp_path):
    text = (FOLDER / f"{script}.py").read_text(encoding="utf-8")
    assert text.count("\n") <= 60
    assert "assert" in text
    command = [sys.executable, "-W", "error", str(FOLDER / f"{script}.py")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, len(done.stdout) > 20) == (0, True), done.stderr
