"""The benchmark runs, holds its programs together, and knows a miss from a hit; its page is its record."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

STUDIES = Path(__file__).parents[2] / "studies"


@pytest.fixture
def speed(monkeypatch):
    monkeypatch.syspath_prepend(str(STUDIES))
    import speed

    return speed


@pytest.mark.slow
def test_the_quick_benchmark_prints_every_table():
    command = [sys.executable, str(STUDIES / "speed.py"), "--quick"]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    for title in ("## A time step", "## By the number of cells", "## An ensemble", "## A reference"):
        assert title in text
    equal = re.findall(r"^\| (\S+) \| [0-9.]+ \| equal \|$", text, re.MULTILINE)
    assert equal == ["cvode", "cvode-adams", "ida"]


def test_a_ratio_is_missed_when_it_is_worse_by_more_than_a_third(speed):
    recorded = {"a / b": 0.6, "a / c": 2.0}
    assert speed.missed({"a / b": 0.79, "a / c": 2.6}, recorded) == []
    assert speed.missed({"a / b": 0.1}, recorded) == []
    assert len(speed.missed({"a / b": 0.81, "a / c": 2.7}, recorded)) == 2


def test_the_page_is_written_from_the_record(speed):
    record = json.loads((STUDIES / "speed.json").read_text(encoding="utf-8"))
    assert (STUDIES / "speed.md").read_text(encoding="utf-8") == speed.page(record)
    assert record["ratios"] == speed.ratios_of(record)
    assert set(record) >= set(speed.TABLES)


def test_no_page_types_the_time_of_a_step():
    pages = [*(STUDIES / "guide").glob("*.md"), *(STUDIES / "theory").glob("*.md"), STUDIES / "README.md"]
    pages.append(STUDIES.parent / "README.md")
    typed = [page.name for page in pages if re.search(r"\d\s*(ns|µs)\b", page.read_text(encoding="utf-8"))]
    assert not typed
