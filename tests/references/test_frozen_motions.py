"""Motions frozen from many digits: event times, peaks, positions and horizons of random systems.

Version 0.2.0 computed ``frozen_motions.json``: the values in many digits, the horizons in double precision. Each value
has a deviation: the largest difference of the double precision solution, and of those of two systems whose stiffness
and start differ by 4 roundings, from it. So it says by how much rounding moves this value.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stiffbeam as sb

SYSTEMS = json.loads(Path(__file__).with_name("frozen_motions.json").read_text(encoding="utf-8"))
ROUNDING = 1e-12  # of the scale: what any order of summation may lose before impacts magnify it
FACTOR = 100.0  # of the deviation: another order of summation is another sample of a few roundings


def function(data: list[Any]) -> Any:
    kind, *numbers = data
    if kind == "sum":
        return sb.Superposition(*map(function, numbers))
    return {"constant": sb.Constant, "harmonic": sb.Harmonic, "sampled": sb.Sampled}[kind](*numbers)


def contact(data: dict[str, Any]) -> sb.Contact:
    stiffness = np.inf if data["stiffness"] is None else data["stiffness"]
    stops = sb.Stops(
        data["lower"], data["upper"], stiffness=stiffness, damping=data["damping"], restitution=data["restitution"]
    )
    return sb.Contact(data["row"], stops, data["offset"] and function(data["offset"]))


def system(data: dict[str, Any]) -> sb.System:
    loads = [(vector, function(f)) for vector, f in data["loads"]]
    contacts = [contact(c) for c in data["contacts"]]
    return sb.System.from_matrices(**data | {"loads": loads, "contacts": contacts})


@pytest.mark.parametrize("index", range(len(SYSTEMS)), ids=[frozen["name"] for frozen in SYSTEMS])
def test_the_exact_motion_is_the_frozen_one(index):
    frozen = SYSTEMS[index]
    run = sb.reference(system(frozen["system"]), frozen["t_end"], "exact")
    assert run.horizon >= 0.8 * frozen["horizon"]

    t, tip = np.array(frozen["t"]), np.array(frozen["tip"])
    valid = t <= run.horizon
    scale = np.max(np.abs(tip))
    bound = FACTOR * np.array(frozen["deviation"]) + ROUNDING * scale
    np.testing.assert_array_less(np.abs(run.at(t[valid])[0] - tip[valid]), bound[valid])

    for record, rows in zip(run.contacts, frozen["impacts"], strict=True):
        rows = [row for row in rows if row[0] <= run.horizon]
        impacts = record.impacts
        largest = max((row[3] for row in rows if row[3] is not None), default=0.0)
        assert impacts.count >= len(rows)
        for k, (time, stop, time_deviation, peak, peak_deviation) in enumerate(rows):
            assert impacts.stops[k] == stop
            assert abs(impacts.times[k] - time) <= FACTOR * time_deviation + ROUNDING * frozen["t_end"]
            if peak is not None:
                assert abs(impacts.peaks[k] - peak) <= FACTOR * peak_deviation + 1e3 * ROUNDING * largest
