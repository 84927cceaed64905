"""Frozen periodic orbits: against motions in mpmath that start on them, and ``periodic_orbit``."""

from __future__ import annotations

import tomllib
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.testset.problem import folder, system_of

FILES = {
    file.stem: tomllib.loads(file.read_text(encoding="utf-8"))
    for file in sorted((folder().parent / "orbits").glob("*.toml"))
}
SMALL = [name for name in FILES if not name.startswith("beam")]
BEAMS = [pytest.param(name, marks=pytest.mark.slow) for name in FILES if name.startswith("beam")]


def numbers(name: str, answer: str) -> Any:
    return np.array(FILES[name]["answers"][answer], float)


def multipliers(name: str) -> Any:
    return numbers(name, "multipliers_real") + 1j * numbers(name, "multipliers_imag")


def system(name: str) -> sb.System:
    """The system, which starts on the orbit."""
    start = {"initial_displacement": numbers(name, "q").tolist(), "initial_velocity": numbers(name, "v").tolist()}
    return system_of(name, FILES[name]["system"] | start)


def test_there_are_twenty_stable_and_unstable_ones_of_one_and_many_masses():
    stable = [file["stable"] for file in FILES.values()]
    assert len(stable) >= 20
    assert min(stable.count(True), stable.count(False)) >= 8
    assert {len(file["system"]["mass"]) for file in FILES.values() if isinstance(file["system"]["mass"], list)} >= {
        1,
        2,
    }
    for name, file in FILES.items():
        assert file["stable"] == bool(np.max(np.abs(multipliers(name))) < 1.0)


@pytest.mark.parametrize("name", [*SMALL, *BEAMS])
def test_a_periodic_orbit_found_anew_is_the_one_of_the_file(name):
    period = FILES[name]["period"]
    start = numbers(name, "q"), numbers(name, "v")
    orbit = sb.periodic_orbit(system(name), period, tuple(x * (1.0 + 1e-6) for x in start))
    near = 1e-10 * max(1.0, abs(multipliers(name)[0]))
    for one, other in zip((orbit.q, orbit.v), start, strict=True):
        assert np.max(np.abs(one - other)) < near * max(np.max(np.abs(other)), 1e-3)
    assert np.allclose(orbit.events, numbers(name, "event_times"), rtol=0.0, atol=1e-10 * period)
    assert [(c, new) for c, _, new in FILES[name]["answers"]["itinerary"]] == [
        *zip(orbit.event_contacts, orbit.event_sides, strict=True)
    ]
    frozen = multipliers(name)
    assert np.allclose(np.sort_complex(orbit.multipliers), np.sort_complex(frozen), atol=1e-8 * abs(frozen[0]))


@pytest.mark.fast(1)
@pytest.mark.parametrize("name", SMALL)
def test_the_law_in_mpmath_leads_back_within_the_digits_of_the_file(name):
    """From the start in 40 digits: the events, and the start after a period."""
    mp = pytest.importorskip("mpmath")
    from precise_motion import PreciseMotion

    file, answers = FILES[name], FILES[name]["answers"]
    with mp.workdps(40):
        turns = Fraction(file["period_text"].partition(" ")[0])
        period = turns.numerator * mp.pi / mp.mpf(float(file["period_text"].partition("/")[2]))
        motion = PreciseMotion(system(name), period / 24)
        start = [mp.matrix([mp.mpf(x) for x in answers[key]]) for key in ("q", "v")]
        events, *end = motion.over(period, *start)
        # A unit of the last digit, and what the rounding of the start becomes.
        radius = 100 * max(1, abs(multipliers(name)[0])) * mp.mpf("2e-24")
        assert [(c, new) for _, c, new in events] == [(c, new) for c, _, new in answers["itinerary"]]
        for (t, *_), text in zip(events, answers["event_times"], strict=True):
            assert abs(t - mp.mpf(text)) < radius
        for one, other in zip(end, start, strict=True):
            assert mp.norm(one - other, mp.inf) < radius
