"""Seconds of a run are those of its second time: the clock stands still while kernels are compiled."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

from stiffbeam.basics import resources
from stiffbeam.basics.resources import clock, stopped_clock, wall_clock

FIRST = """
import stiffbeam as sb
stops = sb.Stops(upper=0.01, stiffness=50.0, exponent=1.5)  # of a law that the common kernel does not hold
system = sb.System.from_matrices([[1.0]], [[10.0]], contacts=[sb.Contact([1.0], stops)], initial_velocity=[1.0])
first, second = (sb.integrate(system, sb.Trapezoidal(), 1e-3, 20.0).work for _ in range(2))
print(first.seconds, first.ns_per_step, second.ns_per_step)
"""


def test_the_clock_stands_still_and_goes_on():
    begun = wall_clock()
    with stopped_clock():
        stood = wall_clock()
        with stopped_clock():
            time.sleep(0.05)
        time.sleep(0.05)
        assert wall_clock() == stood
    assert begun <= stood <= wall_clock() < begun + 0.09
    time.sleep(0.02)
    assert wall_clock() >= stood + 0.015


def test_the_clock_of_runs_counts_no_waiting():
    begun = clock()
    time.sleep(0.1)
    assert clock() - begun < 0.05
    with stopped_clock():
        sum(range(10**6))
    assert clock() - begun < 0.05


@pytest.mark.slow
def test_the_first_run_of_all_says_what_a_step_takes(tmp_path, monkeypatch):
    """Compiling takes thousands of times as long as this run."""
    monkeypatch.setenv("STIFFBEAM_CACHE_DIR", str(tmp_path))
    done = subprocess.run([sys.executable, "-c", FIRST], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    seconds, first, second = map(float, done.stdout.split())
    assert seconds < 1.0
    assert first < 100.0 * second


def test_a_display_tells_of_kernels_that_are_compiled(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")  # to rich, standard error is a terminal
    monkeypatch.setattr(resources, "LONG", 0.0)
    with resources.progress() as show:
        show("exact", 0, 0)
        time.sleep(0.3)
        assert "exact" in (before := capsys.readouterr().err)
        assert "compiling" not in before
        with stopped_clock():
            time.sleep(0.3)
    assert "compiling once" in capsys.readouterr().err
