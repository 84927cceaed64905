"""The benchmark prints its ratios, and its program by hand marches the same scheme."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

STUDIES = Path(__file__).parents[2] / "studies"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")
def test_the_benchmark_prints_every_ratio():
    command = [sys.executable, str(STUDIES / "benchmarks" / "run.py"), "--quick"]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    ratios = [float(x) for x in re.findall(r"^ *(\S+)  \(", text, re.MULTILINE)]
    assert len(ratios) == 6
    assert all(map(math.isfinite, ratios))  # a difference of times on a busy machine may have any sign
