"""The how-to scripts run as they stand, without warnings; each asserts one of its numbers."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "studies" / "how-to"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py"))
SHORTER = {"ranking": ["table10"]}


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_asserts_its_number(script, tmp_path, monkeypatch, capsys):
    text = (FOLDER / f"{script}.py").read_text(encoding="utf-8")
    assert text.count("\n") <= 60
    assert "assert" in text
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [f"{script}.py", *SHORTER.get(script, [])])
    runpy.run_path(str(FOLDER / f"{script}.py"), run_name="__main__")
    assert len(capsys.readouterr().out) > 20
