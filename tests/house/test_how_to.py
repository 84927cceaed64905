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
from scipy.integrate import solve_ivp

import stiffbeam as sb

SCRIPTS = Path(__file__).parents[2] / "studies" / "how-to"
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
@pytest.mark.parametrize("script", ["noise", "massless_contact", "round_hole"])
def test_a_short_script_asserts_its_number(script):
    done = subprocess.run(
        [sys.executable, "-W", "error", str(SCRIPTS / f"{script}.py")], capture_output=True, text=True
    )
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
def test_the_hermite_model(tmp_path):
    """Frequencies to (beta_j h)^4/720, the damping ratios of Rayleigh's formula; the files are a case for commands."""
    text = printed("hermite_model", tmp_path)
    omega = CLAMPED_FREE**2 * np.sqrt(180.0 / 1.2)
    np.testing.assert_allclose(numbers("frequencies", text), omega, rtol=(CLAMPED_FREE[-1] / 20) ** 4 / 720)
    np.testing.assert_allclose(numbers("damping ratios", text), 0.5 * (0.8 / omega + 2e-5 * omega), atol=5e-6)
    assert min(numbers("impacts", text)[:2]) > 0
    errors = re.findall(r"tip error ([\d.]+) %", text)
    assert len(errors) == 3
    assert max(map(float, errors)) < 1.0


@pytest.mark.slow
def test_the_hammer(tmp_path):
    """Two squared half sines and what is left of the noise; DOP853 agrees to its tolerance, grown by the impacts."""
    text = printed("hammer", tmp_path)
    assert numbers("impulse of the record", text)[0] == pytest.approx(0.5 * (60.0 * 0.004 + 12.0 * 0.003), rel=5e-3)
    (off,) = re.findall(r"differs by ([\d.e-]+)", text)
    assert float(off) < 1e-6
    again = printed("hammer", tmp_path, "--record", str(tmp_path / "hammer.csv"))  # its own record, as a user's
    assert again == text


@pytest.mark.slow
def test_the_base_motion(tmp_path):
    """Smoothing takes the noise of 2 micrometres and no more: a knot every 16 samples keeps a 16th of it."""
    text = printed("base_motion", tmp_path)
    assert numbers("smoothing takes away", text)[0] == pytest.approx(2.0 * np.sqrt(1 - 1 / 16), rel=0.1)
    hertz = CLAMPED_FREE[0] ** 2 / (2 * np.pi) * np.sqrt(1.1 / 0.16) / 0.4**2
    assert numbers("first natural frequency", text)[0] == pytest.approx(hertz, rel=0.01)
    assert len(re.findall(r"within 1 % to t = [\d.]+ s", text)) == 2


@pytest.mark.slow
def test_the_tube_in_loose_supports(tmp_path):
    """The impacts of the table are those of the exact motion by DOP853; the mesh is the doubt of a coarse one."""
    text = printed("loose_supports", tmp_path, "--cells", "4", "8", "--members", "8")
    assert "4 cells" in text
    assert re.search(r"impacts at contact 1: mesh \(\d+ %\) exceeds rounding", text)
    case = replace(sb.load_cases(tmp_path / "tube.toml")["tube"], cells=8)
    other = sb.reference(case.system(), case.t_end, "dop853", rtol=1e-9)
    rows = [np.zeros(8), np.zeros(8)]  # outer radius times the slope, at nodes 4 and 8
    rows[0][[4, 2]], rows[1][[7, 6]] = [0.0095 / 0.3, -0.0095 / 0.3], [0.0095 / 0.15, -0.0095 / 0.15]
    t = np.linspace(0.0, case.t_end, 200_001)
    rates = other.state_at(t)[1]
    for number, contact in enumerate(other.contacts, 1):
        table = np.genfromtxt(tmp_path / f"impacts-{number}.csv", delimiter=",", skip_header=1, usecols=(1, 4, 7, 8))
        force = np.abs(contact.stops.force(other.at(t, contact=number - 1)[0]))
        for speed, works in (
            (other.at(t, contact=number - 1)[1], table[:, 2]),
            (rates @ rows[number - 1], table[:, 3]),
        ):
            assert np.sum(works) == pytest.approx(np.trapezoid(force * np.abs(speed), t), rel=1e-3)
        np.testing.assert_allclose(table[:, 0], contact.impacts.times, atol=1e-6)
        np.testing.assert_allclose(table[:-1, 1], contact.impacts.peaks[:-1], rtol=1e-4)


@pytest.mark.slow
def test_identification(tmp_path):
    """The exact motion leads back to the stop that made the record, within three of its own standard deviations."""
    text = printed("identify", tmp_path, "--windows", "0.053", "0.06", "--grid", "9", "--noise", "1e-4")
    error, deviation, gap, gap_deviation, misfit = numbers("exact motion", text)[:5]
    assert abs(error) < 3.0 * deviation < 10.0
    assert abs(gap) < 3.0 * gap_deviation < 1.0
    assert misfit == pytest.approx(1.0, abs=0.3)
    assert numbers("trapezoidal", text)[4] > 2.0  # of the noise: it has no parameters that fit


@pytest.mark.slow
def test_the_flip_of_a_scheme(monkeypatch):
    """The exponential scheme puts the flip where its distance falls by four with half the step; implicit contact has
    no multipliers there."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import scheme_flips

    flip, state = scheme_flips.exact_flip()
    assert flip == pytest.approx(32.975300288681, abs=1e-9)
    apart = [
        float(scheme_flips.line(sb.ExponentialFlow(), "conserving", steps, flip, state)) for steps in (8000, 16000)
    ]
    assert apart[0] / apart[1] == pytest.approx(4.0, abs=1.5)
    assert abs(apart[1]) < 0.02
    refused = scheme_flips.line(sb.Trapezoidal(), "implicit", 8000, flip, state)
    assert refused == "no periodic orbit found" or refused.startswith("multipliers with two widths")


@pytest.mark.slow
def test_basins(monkeypatch):
    """Ends of motions agree with SciPy's event search; with a quarter of the step fewer starts end on the wrong one."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import basins

    members = basins.starts(6)
    truth = basins.exact(members)
    assert 0.3 < np.mean(truth) < 0.9
    period = 2.0 * np.pi / basins.FREQUENCY

    def rate(t, y):
        return y[1], 0.7 * np.sin(basins.FREQUENCY * t) - 0.08 * y[1] - y[0] - 100.0 * max(y[0] - 0.5, 0.0)

    for k in (0, 14, 35):
        y = np.concatenate(members.start(k))
        end = solve_ivp(rate, (0.0, basins.PERIODS * period), y, method="DOP853", rtol=1e-10, max_step=0.02)
        last = end.t > (basins.PERIODS - basins.LAST) * period
        assert (np.max(end.y[0, last]) > 0.5) == truth[k]
    scheme = sb.BDF2()
    coarse, fine = (np.mean(basins.computed(members, scheme, "implicit", n) != truth) for n in (50, 200))
    assert fine < 0.5 * coarse
    monkeypatch.setattr(basins, "PERIODS", 200)
    assert np.array_equal(basins.exact(members), truth)  # all have settled
