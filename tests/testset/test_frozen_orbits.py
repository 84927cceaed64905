"""Frozen periodic orbits: against motions in mpmath that start on them, and ``periodic_orbit``."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from systems import case_of
from witness import solve

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


@pytest.mark.parametrize("name", [*SMALL, *BEAMS])
def test_a_periodic_orbit_found_anew_is_the_one_of_the_file(name):
    period = FILES[name]["period"]
    start = numbers(name, "q"), numbers(name, "v")
    orbit = sb.periodic_orbit(system(name), period, tuple(x * (1.0 + 1e-6) for x in start))
    near = 1e-10 * max(1.0, abs(multipliers(name)[0]))
    for one, other in zip((orbit.q, orbit.v), start, strict=True):
        assert np.max(np.abs(one - other)) < near * max(np.max(np.abs(other)), 1e-3)
    assert np.allclose(orbit.events, numbers(name, "event_times"), rtol=0.0, atol=1e-10 * period)
    frozen = multipliers(name)
    assert FILES[name]["stable"] == bool(np.max(np.abs(frozen)) < 1.0)
    assert np.allclose(np.sort_complex(orbit.multipliers), np.sort_complex(frozen), atol=1e-8 * abs(frozen[0]))


def elastic(name: str) -> bool:
    """True of stops that are neither rigid nor damped, which the witness takes."""
    stops = [contact.stops for contact in system(name).contacts]
    return not any(x.rigid or x.damping for x in stops)


@pytest.mark.fast(1)
@pytest.mark.parametrize("name", [name for name in SMALL if elastic(name)])
def test_the_law_in_mpmath_leads_back_within_the_digits_of_the_file(name):
    """From the start in 40 digits: the events, and the start after a period."""
    file, answers = FILES[name], FILES[name]["answers"]
    with mp.workdps(40):
        turns = Fraction(file["period_text"].partition(" ")[0])
        period = turns.numerator * mp.pi / mp.mpf(float(file["period_text"].partition("/")[2]))
        q, v = (np.array([mp.mpf(x) for x in answers[key]]) for key in ("q", "v"))
        motion = solve(replace(case_of(system(name), period), q0=q, v0=v), 40)
        # A unit of the last digit, and what the rounding of the start becomes.
        radius = 100 * max(1, abs(multipliers(name)[0])) * mp.mpf("2e-24")
        assert [x.chi for x in motion.pieces[1:]] == list(sides_after(answers["itinerary"], motion.pieces[0].chi))
        for piece, text in zip(motion.pieces[1:], answers["event_times"], strict=True):
            assert abs(piece.t - mp.mpf(text)) < radius
        assert max(abs(x - y) for x, y in zip(motion.state(period), [*q, *v], strict=True)) < radius


def sides_after(itinerary: list[Any], sides: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """Sides of all contacts after every event."""
    for contact, _, new in itinerary:
        sides = (*sides[:contact], new, *sides[contact + 1 :])
        yield sides
