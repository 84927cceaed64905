"""Files with few digits: the exact motion of bilinear-gap in them is neither praised nor flagged, a wrong one is."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.testset.measure import CONVERGES, FEW_DIGITS, NOT_FALLING
from stiffbeam.testset.score import score_trajectories

NAME = "bilinear-gap"
FORMATS = {
    "six digits": lambda x: float(f"{x:.6g}"),
    "seven places": lambda x: float(f"{x:.7f}"),
    "single precision": lambda x: float(np.float32(x)),
    "single precision, written with eight digits": lambda x: float(f"{np.float32(x):.8g}"),
}


@pytest.fixture(scope="module")
def exact():
    """Runs (t, u, v) with ever shorter steps."""
    known = sb.problem(NAME)
    found = []
    for steps in (480, 960, 1920, 3840):
        t = np.linspace(0.0, known.t_end, steps + 1)
        run = sb.reference(known.system, known.t_end, t_eval=t)
        found.append((t, run.tip, run.tip_velocity))
    return found


def outcome(runs):
    return score_trajectories(NAME, runs).entries[0].outcome


@pytest.mark.parametrize("name", FORMATS)
def test_exact_motions_in_few_digits_are_told_apart(exact, name):
    rounded = np.vectorize(FORMATS[name])
    assert outcome(exact) == CONVERGES
    runs = [(t, rounded(u), rounded(v)) for t, u, v in exact]
    card = score_trajectories(NAME, runs)
    assert card.entries[0].outcome == FEW_DIGITS
    assert "write more digits" in str(card)
    assert not card.flagged
    assert outcome([(rounded(t), rounded(u), rounded(v)) for t, u, v in runs]) == FEW_DIGITS


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_wrong_by_more_than_its_digits_is_flagged(exact, name):
    rounded = np.vectorize(FORMATS[name])
    assert outcome([(t, rounded(1.001 * u), rounded(1.001 * v)) for t, u, v in exact]) == NOT_FALLING


def test_a_converging_scheme_converges_in_six_digits():
    known, rounded = sb.problem(NAME), np.vectorize(FORMATS["six digits"])
    runs = []
    for steps in (480, 960, 1920, 3840):
        run = sb.integrate(known.system, sb.Trapezoidal(), known.t_end / steps, known.t_end)
        runs.append((run.t, rounded(run.tip), rounded(run.tip_velocity)))
    assert outcome(runs) == CONVERGES


@pytest.mark.parametrize(("name", "method"), [("kelvin-voigt", "exact"), ("hunt-crossley", "dop853")])
@pytest.mark.parametrize("digits", ["six digits", "single precision"])
def test_a_force_of_a_damped_stop_is_not_that_of_the_digits_over_the_step(name, method, digits):
    """Between steps the velocity counts, not the rate of the rounded positions: its error grows like 1/dt."""
    known, rounded, runs = sb.problem(name), np.vectorize(FORMATS[digits]), []
    for steps in (4000, 8000, 16000, 32000, 64000):
        t = np.linspace(0.0, known.t_end, steps + 1)
        run = sb.reference(known.system, known.t_end, method, t_eval=t)
        runs.append((t, rounded(run.tip), rounded(run.tip_velocity)))
    (entry,) = score_trajectories(name, runs).entries
    assert not entry.flagged
    assert abs(entry.best.peak_force) < 1e-5


def test_full_digits_do_not_excuse(exact):
    assert outcome([(t, u + 1e-8 * np.sin(t), v) for t, u, v in exact]) == NOT_FALLING
