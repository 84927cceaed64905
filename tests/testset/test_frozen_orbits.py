"""Frozen orbits: against motions in mpmath that start on them, the float64 flow, and proofs made anew."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.testset.problem import FrozenOrbit

SMALL = [name for name in sb.frozen_orbits() if not name.startswith("beam")]
BEAMS = [name for name in sb.frozen_orbits() if name.startswith("beam")]


def test_there_are_twenty_stable_and_unstable_ones_of_one_and_many_masses():
    orbits = sb.frozen_orbits().values()
    assert len(orbits) >= 20
    assert min(sum(orbit.stable for orbit in orbits), sum(not orbit.stable for orbit in orbits)) >= 8
    assert {orbit.system.size for orbit in orbits} == {1, 2, 3, 8}
    for orbit in orbits:
        assert orbit.stable == bool(np.max(np.abs(orbit.multipliers)) < 1.0)
        assert all(0.0 < float(answer.radius or 0) < 1e-22 or answer.radius == "0" for answer in orbit.answers.values())


def returns(orbit: FrozenOrbit, **options: Any) -> None:
    """The float64 flow from the first sample: all samples, the events, and back after a period."""
    times = np.append(orbit.times, orbit.period)
    run = sb.reference(orbit.system, orbit.period, t_eval=times, **options)
    q, v = run.states
    near = 1e-10 * max(1.0, abs(orbit.multipliers[0]))
    assert np.max(np.abs(q - np.vstack([orbit.q, orbit.q[:1]]))) < near * np.max(np.abs(orbit.q))
    assert np.max(np.abs(v - np.vstack([orbit.v, orbit.v[:1]]))) < near * np.max(np.abs(orbit.v))


@pytest.mark.parametrize("name", sorted(sb.frozen_orbits()))
def test_the_exact_flow_passes_through_the_samples(name):
    returns(sb.frozen_orbit(name))


@pytest.mark.parametrize("name", SMALL)
def test_multipliers_and_events_are_those_of_the_float64_orbit(name):
    frozen = sb.frozen_orbit(name)
    orbit = sb.periodic_orbit(frozen.system, frozen.period, (frozen.q[0], frozen.v[0]))
    assert np.allclose(orbit.events, frozen.event_times, rtol=0.0, atol=1e-11 * frozen.period)
    assert np.allclose(np.sort_complex(orbit.multipliers), np.sort_complex(frozen.multipliers), atol=1e-9)


@pytest.mark.fast(1)
@pytest.mark.parametrize("name", SMALL)
def test_the_law_in_mpmath_leads_back_within_the_digits_of_the_file(name):
    """From the first sample in 40 digits: the events, the sample at half the period, and the start."""
    mp = pytest.importorskip("mpmath")
    from precise_motion import PreciseMotion

    frozen = sb.frozen_orbit(name)
    q, v, times = (frozen.answers[key] for key in ("q", "v", "event_times"))
    with mp.workdps(40):
        turns = Fraction(frozen.period_text.partition(" ")[0])
        period = turns.numerator * mp.pi / mp.mpf(float(frozen.period_text.partition("/")[2]))
        motion = PreciseMotion(frozen.system, period / 24)
        start = [mp.matrix([mp.mpf(x) for x in answer.digits[0]]) for answer in (q, v)]
        events, *end = motion.over(period, *start)
        grown = 100 * max(1, abs(frozen.multipliers[0]))  # what the rounding of the first sample becomes
        assert [(c, new) for _, c, new in events] == [(c, new) for c, _, new in frozen.itinerary]
        for (t, *_), text in zip(events, times.digits, strict=True):
            assert abs(t - mp.mpf(text)) < grown * mp.mpf(q.radius) + mp.mpf(times.radius)
        for one, other, answer in zip(end, start, (q, v), strict=True):
            assert mp.norm(one - other, mp.inf) < grown * mp.mpf(answer.radius)
        _, *middle = motion.over(period / 2, *start)
        for one, answer in zip(middle, (q, v), strict=True):
            there = mp.matrix([mp.mpf(x) for x in answer.digits[32]])
            assert mp.norm(one - there, mp.inf) < grown * mp.mpf(answer.radius)


@pytest.mark.parametrize("name", [*SMALL[::5], pytest.param(BEAMS[-1], marks=pytest.mark.slow)])
def test_a_proof_made_anew_has_the_digits_of_the_file(name):
    flint = pytest.importorskip("flint")
    frozen = sb.frozen_orbit(name)
    proof = sb.periodic_orbit(frozen.system, frozen.period, (frozen.q[0], frozen.v[0])).prove()
    assert proof.proved
    assert (proof.period_text, proof.itinerary, proof.stable) == (frozen.period_text, frozen.itinerary, frozen.stable)
    answers = frozen.answers
    pairs = [
        ("event_times", proof.event_times, answers["event_times"].digits),
        ("q", proof.q, answers["q"].digits[0]),
        ("v", proof.v, answers["v"].digits[0]),
        ("multipliers_real", [x.real for x in proof.multipliers], answers["multipliers_real"].digits),
    ]
    with flint.ctx.workprec(256):
        for key, balls, texts in pairs:
            for ball, text in zip(balls, texts, strict=True):
                assert abs(ball - flint.arb(text)) < flint.arb(answers[key].radius)


def test_a_score_measures_errors_on_the_orbit():
    frozen = sb.frozen_orbit("two-masses")
    run = sb.reference(frozen.system, frozen.period, t_eval=frozen.times)
    q, v = run.states
    score = frozen.score(frozen.times, q, v, frozen.multipliers)
    assert set(score) == {"q", "q_rms", "v", "multiplier"}
    assert max(score.values()) < 1e-11
    largest = np.max(np.abs(frozen.q))
    shifted = frozen.score(frozen.times[::-1], q[::-1] + 0.01 * largest, multipliers=1.1 * frozen.multipliers)
    assert abs(shifted["q"] - 0.01) < 1e-3  # the largest value of 64 samples
    assert abs(shifted["multiplier"] - 0.1) < 1e-12
    single = sb.frozen_orbit("bilinear-free")
    assert single.score(single.times, single.q[:, 0])["q"] < 1e-11
    with pytest.raises(sb.InputError, match="take the times modulo the period"):
        frozen.score([2.0 * frozen.period], q[:1])
    with pytest.raises(sb.InputError, match="q must have the shape"):
        frozen.score(frozen.times, q[:5])
    with pytest.raises(sb.InputError, match="orbit must be one of the frozen orbits"):
        sb.frozen_orbit("two-mass")
