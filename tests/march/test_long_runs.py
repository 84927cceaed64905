"""Long runs: what rounding leaves of phase and impact times; work in proportion to the span; clocks."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import mpmath
import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references import solve

EPS = np.finfo(float).eps


@pytest.mark.slow
@pytest.mark.parametrize("method", ["trapezoidal", "exact"])
def test_the_phase_of_the_drive_is_right_at_a_million(method):
    """q'' + 0.4 q' + 25 q = 3 sin(4 t + 0.3) has settled to Im 3 e^(i (4 t + 0.3))/(25 - W^2 + 0.4 i W), W = 4, and for
    the trapezoidal rule W = (2/dt) tan(4 dt/2). A time in float64 has a phase known to eps 4 t/2."""
    dt, end = 1e-2, 1e6
    system = one_mass(25.0, damping=0.4, load=sb.Harmonic(3.0, 4.0, 0.3))
    t = np.linspace(0.0, end, 101)
    with mpmath.workdps(40):
        if method == "exact":
            tip, W = sb.reference(system, end, t_eval=t).tip, mpmath.mpf(4)
        else:
            tip, W = sb.integrate(system, sb.Trapezoidal(), dt, end, every=10**6).tip, 2 / dt * mpmath.tan(2 * dt)
        gain = 3 / (25 - W**2 + 0.4j * W)
        steady = [float((gain * mpmath.expj(4 * mpmath.mpf(float(when)) + mpmath.mpf(0.3))).imag) for when in t[1:]]
    assert np.max(np.abs(tip[1:] - steady)) < float(abs(gain)) * EPS * 0.5 * 4.0 * end


def swinging() -> sb.System:
    """u = 2 sin t to the stop at 1/2, there 0.495 + A cos(10 s - phi): impacts every 2 (asin(1/4) + phi/10)."""
    return one_mass(1.0, sb.Stops(-0.5, 0.5, stiffness=99.0), v=2.0)


@pytest.mark.slow
def test_2e4_events_of_the_exact_solution_close_their_ledger_and_say_what_is_lost():
    end = 8200.0
    found = sb.reference(swinging(), end)
    assert len(found.solution.times) > 20_000
    with mpmath.workdps(40):
        flight = mpmath.asin(mpmath.mpf(1) / 4)
        half = 2 * (flight + mpmath.atan2(mpmath.sqrt(mpmath.mpf(15) / 4) / 10, mpmath.mpf("0.005")) / 10)
        wanted = np.array([float(flight + i * half) for i in range(found.impacts.count)])
    lost = 10.0 ** sb.lyapunov(swinging(), end).digits
    assert 1e3 < lost < 1e7  # what a neighbour is magnified by: the frequency depends on the energy
    assert np.max(np.abs(found.impacts.times - wanted)) < EPS * lost * len(found.solution.times)
    assert found.horizon == end
    assert len(found.impacts.times) == math.floor((end - float(flight)) / float(half)) + 1
    assert np.max(np.abs(found.energy.energy - 2.0)) < 100 * EPS * 2.0
    assert np.max(np.abs(found.energy.loss)) < 100 * EPS * 2.0


@pytest.mark.parametrize(("method", "t_end"), [("exact", 200.0), ("multiprecision", 50.0), ("ida", 50.0)])
@pytest.mark.slow
def test_twice_the_span_is_twice_the_work(method, t_end):
    """Counted in evaluations, not in seconds; events of one run do not stay for the next."""
    counter = "rhs" if method == "ida" else "evaluations"
    counts = []
    for span in (t_end, 2 * t_end):
        run = solve(swinging(), span, method, np.linspace(0.0, span, 1 + 8 * round(span)), 1e-7, None, 30)
        counts.append((run.work.counters[counter], run.impacts.count))
    (work, impacts), (twice, impacts_twice) = counts
    assert impacts > 10
    assert abs(impacts_twice - 2 * impacts) <= 2
    assert 1.8 < twice / work < 2.2


def test_the_tangent_flow_takes_one_step_a_segment_or_sample():
    steps = []
    for t_end in (50.0, 100.0):
        steps.append(sb.reference(swinging(), t_end).work.counters["switches"])
        assert len(sb.lyapunov(swinging(), t_end).t) == 201 + steps[-1]
    assert abs(steps[1] - 2 * steps[0]) <= 2


@pytest.mark.parametrize("springs", [1e6, 1e10])
def test_a_free_bar_falls_from_a_uniform_displacement(springs):
    """q^T K q of a motion without strain is rounding, which may be negative: no energy is lost by it."""
    n = 10
    M, K = np.diag([0.5, *np.ones(n - 1), 0.5]) / n, np.zeros((n + 1, n + 1))
    for i in range(n):
        K[i : i + 2, i : i + 2] += springs * n * (1.0 + 0.1 * np.sin(i)) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    contact = sb.Contact(np.eye(n + 1)[-1], sb.Stops(upper=0.1, stiffness=1e5))
    system = sb.System.from_matrices(
        M, K, loads=[(np.diag(M).copy(), sb.Constant(1.0))], contacts=[contact],
        initial_displacement=np.full(n + 1, -0.3),
    )  # fmt: skip
    run = sb.reference(system, 1.2)
    assert run.horizon > 0.7
    assert run.impacts.times[0] == pytest.approx(np.sqrt(0.8), rel=1e-9)  # a fall by 0.4


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")
def test_the_benchmark_prints_every_ratio():
    """Differences of times, which on a busy machine may have any sign."""
    script = Path(__file__).parents[2] / "studies" / "benchmarks" / "run.py"
    text = subprocess.run([sys.executable, script, "--quick"], check=True, capture_output=True, text=True).stdout
    ratios = [float(x) for x in re.findall(r"^ *(\S+)  \(", text, re.MULTILINE)]
    assert len(ratios) == 6
    assert np.all(np.isfinite(ratios))
