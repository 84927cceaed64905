"""The how-to scripts run as they stand; what they print is held against closed forms."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import stiffbeam as sb

SCRIPTS = Path(__file__).parents[2] / "studies" / "how-to"
SHORT = (
    "noise",
    "massless_contact",
    "round_hole",
    "hammer",
    "base_motion",
    "hermite_model",
    "identify",
    "basins",
    "rotor",
)
CLAMPED_FREE = np.array([1.8751040687119611, 4.694091132974175, 7.854757438237613])  # cos x cosh x = -1


def printed(script: str, folder: Path, *arguments: str) -> str:
    command = [sys.executable, "-W", "error", str(SCRIPTS / f"{script}.py"), "--out", str(folder), *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=os.environ | {"MPLBACKEND": "agg"})
    assert done.returncode == 0, done.stderr
    assert (folder / f"{script}.png").stat().st_size > 20_000
    return done.stdout


def numbers(line: str, text: str) -> list[float]:
    (found,) = re.findall(rf"^{line}(.*)$", text, re.MULTILINE)
    return [float(x) for x in re.findall(r"(?<![\w.])\d+\.?\d*(?:e[+-]?\d+)?", found)]


@pytest.mark.slow
@pytest.mark.parametrize("script", SHORT)
def test_a_short_script_asserts_its_number(script, tmp_path):
    command = [sys.executable, "-W", "error", str(SCRIPTS / f"{script}.py")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, len(done.stdout) > 20) == (0, True), done.stderr


@pytest.mark.slow
def test_the_steel_strip(tmp_path):
    """Frequencies of the drawing's numbers to h^2 = 1/400 of them; the same force in both systems of units."""
    text = printed("steel_strip", tmp_path)
    hertz = CLAMPED_FREE**2 / (2 * np.pi) * np.sqrt(210e9 * 1e-3**2 / 12 / 7850) / 0.4**2
    # (3.6) has order 2: mode j is off by some (beta_j h)^2/4, h = 1/20
    np.testing.assert_allclose(numbers("frequencies", text), hertz, rtol=CLAMPED_FREE[-1] ** 2 / 1600)
    here, there = numbers("largest contact force", text)
    assert here == pytest.approx(there, rel=1e-3)
    assert "linear solves" in text


@pytest.mark.slow
def test_the_tube_in_loose_supports(tmp_path):
    """The impacts of the table are those of the exact motion by DOP853; the mesh is the doubt of a coarse one."""
    text = printed("loose_supports", tmp_path, "--cells", "4", "8", "--members", "8")
    assert "4 cells" in text
    assert re.search(r"Largest source of uncertainty: mesh for .*impacts at contact 1", text)
    case = replace(sb.load_cases(tmp_path / "tube.toml")["tube"], cells=8)
    other = sb.reference(case.system(), case.t_end, "dop853", rtol=1e-9)
    for number, contact in enumerate(other.contacts, 1):
        table = np.genfromtxt(tmp_path / f"impacts-{number}.csv", delimiter=",", names=True)
        np.testing.assert_allclose(table["impact_time"], contact.impacts.times, atol=1e-6)
        np.testing.assert_allclose(table["impact_peak_force"][:-1], contact.impacts.peaks[:-1], rtol=1e-4)
