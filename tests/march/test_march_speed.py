"""The benchmark runs, holds its three programs together, and knows a miss from a hit."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

STUDIES = Path(__file__).parents[2] / "studies"


@pytest.mark.slow
def test_the_quick_benchmark_writes_its_records_and_its_page(tmp_path):
    command = [sys.executable, str(STUDIES / "march_speed.py"), "--quick", "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)
    record = json.loads((tmp_path / "march_speed.json").read_text())
    assert (tmp_path / "march_speed.png").stat().st_size > 20_000
    recorded = json.loads((STUDIES / "march_speed.json").read_text())
    assert recorded.keys() == record["ratios"].keys()
    assert all(value > 0.0 for value in record["ratios"].values())


def test_a_ratio_is_missed_when_it_is_worse_by_more_than_a_third(monkeypatch):
    monkeypatch.syspath_prepend(str(STUDIES))
    from march_speed import missed

    recorded = {"a / b": 0.6, "loop / a, times": 600.0}
    assert missed({"a / b": 0.79, "loop / a, times": 460.0}, recorded) == []
    assert missed({"a / b": 0.1, "loop / a, times": 9000.0}, recorded) == []
    assert len(missed({"a / b": 0.81, "loop / a, times": 440.0}, recorded)) == 2
