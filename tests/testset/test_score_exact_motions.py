"""What is exact is never flagged, whatever its steps; what is exact but for one thing is.

The motions are closed forms written here, or the exact solution at the asked steps.
"""

import re

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.testset.measure import CONVERGES, NOT_FALLING, errors_of, motion_of
from stiffbeam.testset.score import score_trajectories


def sampled(name, steps, everything=False):
    """The exact motion of a problem at ``steps`` equal steps."""
    known = sb.problem(name)
    t = np.arange(steps + 1) * known.t_end / steps
    run = sb.reference(known.system, known.t_end, t_eval=t)
    return (t, *run.states) if everything else (t, run.tip, run.tip_velocity)


@pytest.mark.parametrize("name", ["mass-on-a-stop", "elastic-bar", "hammer-pulse", "bilinear-gap"])
@pytest.mark.parametrize("steps", [50, 60, 100, 240])
@pytest.mark.fast(4)
def test_exact_motions_at_halved_steps(name, steps):
    """Halved steps share the one next to the peak of the force: its error there does not fall."""
    entry = score_trajectories(name, [sampled(name, k * steps) for k in (1, 2, 4)]).entries[0]
    assert (entry.outcome, entry.missed) == (CONVERGES, ())


@pytest.mark.parametrize("name", ["mass-on-a-stop", "elastic-bar", "bilinear-gap", "table10"])
@pytest.mark.parametrize(
    ("steps", "clock", "velocity", "says"),
    [(60, 1.0, 1.0, None), (400, 1.0, 1.0, None), (6000, 1e3, 1e-3, r"times are 1000 times as long: units\?"),
     (400, 1.0, -1.0, r"rate of the position over -(1(\.\d+)?|0\.9\d*): signs\?"),
     (400, 1.0, 1e-3, r"rate of the position over (1\d{3}(\.\d)?|9\d\d\.\d): units\?")],
)  # fmt: skip
def test_what_is_known_but_for_its_clock_or_its_velocity_is_told_so(name, steps, clock, velocity, says):
    """Milliseconds for seconds, a velocity the other way round; and nothing of what is right, coarse or fine."""
    t, u, v = sampled(name, steps)
    said = " ".join(str(score_trajectories(name, [(clock * t, u, velocity * v)])).split())
    assert "?" not in said if says is None else re.search(says, said), said


def ball(steps):
    """The bouncing ball's parabolas."""
    known = sb.problem("bouncing-ball")
    data = known.data
    (e,), (g,) = (c["restitution"] for c in data["contacts"]), (-f["constant"] for f in data["loads"])
    t, u = np.arange(steps + 1) * known.t_end / steps, np.empty(steps + 1)
    at, x, v, last = 0.0, data["initial_displacement"][0], data["initial_velocity"][0], -1.0
    floor = data["contacts"][0]["lower"]
    while last < t[-1]:
        flight = (v + np.sqrt(v * v + 2.0 * g * (x - floor))) / g
        here = (t > last) & (t <= at + flight)
        s = t[here] - at
        u[here] = x + v * s - 0.5 * g * s * s
        last = at + flight if flight > 1e-9 else np.inf
        u[t > last] = floor
        at, x, v = at + flight, floor, e * (g * flight - v)
    return t, u


@pytest.mark.parametrize("steps", [700, 1027, 2001, 3840])
def test_impacts_of_positions_alone_against_a_rigid_stop(steps):
    """Without velocities: no difference is taken across the jump."""
    known = sb.problem("bouncing-ball")
    assert "restitution" in known.data["contacts"][0]
    t, u = ball(steps)
    errors = errors_of(known, motion_of(known, t, u))
    assert errors.tip_max < 1.0 / steps  # between steps by a cubic, which does not know the jump
    assert errors.impact_time < 5.0 * known.t_end / steps


def test_steps_too_long_for_impacts_of_positions_alone():
    """The eighth impact follows the seventh within a step: they are not counted, and no verdict is made of that."""
    entry = score_trajectories("bouncing-ball", [ball(steps) for steps in (60, 120, 240)]).entries[0]
    assert (entry.outcome, entry.missed, entry.best.impacts) == (CONVERGES, (), -1)
    assert "not counted" in entry.reason


@pytest.mark.parametrize("name", ["table10", "aster-beam", "bilinear-gap"])
@pytest.mark.parametrize(("factor", "outcome"), [(1.0, CONVERGES), (1.05, NOT_FALLING), (1.2, NOT_FALLING)])
def test_a_velocity_that_is_off_by_a_factor(name, factor, outcome):
    def integrator(system, dt, t_end):
        run = sb.integrate(system, sb.Trapezoidal(), dt, t_end)
        return run.t, run.tip, factor * run.tip_velocity

    entry = sb.score(integrator, name, statistics=False).entries[0]
    assert entry.outcome == outcome
    assert ("velocity" in entry.missed) == (factor != 1.0)


def test_impacts_where_there_are_none():
    def spurious(system, dt, t_end):
        steps = round(t_end / dt)
        t, w = np.arange(steps + 1) * dt, np.sqrt(10.0)
        u, v = system.q0[0] * np.cos(w * t), -system.q0[0] * w * np.sin(w * t)
        asked = np.arange(steps + 1) % (steps // 60) == 0
        u[~asked & (np.abs(t - 2.03) < 0.04)] = 0.02  # the stop is at 0.01; right wherever the answers are known
        return t, u, v

    entry = sb.score(spurious, "free-oscillator").entries[0]
    assert entry.outcome == NOT_FALLING
    assert "impact times" in entry.missed


def test_a_stop_that_moves():
    """With all unknowns its impacts are counted and its peak is known; with the tip alone the card says that not."""
    name = "stop-along-the-beam"
    whole = score_trajectories(name, [sampled(name, steps, everything=True) for steps in (3840, 7680, 15360)])
    entry = whole.entries[0]
    assert entry.outcome == CONVERGES
    assert entry.best.impacts == len(sb.problem(name).answers["impacts"].value)
    assert entry.best.impact_time < 1e-4
    assert abs(entry.best.peak_force) < 1e-3
    tip = score_trajectories(name, [sampled(name, steps) for steps in (3840, 7680, 15360)]).entries[0]
    assert tip.best.impacts == -1
    assert "all unknowns" in tip.reason
