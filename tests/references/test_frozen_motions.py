"""Motions frozen from many digits: event times, peaks, positions and horizons of random systems.

Version 0.2.0 computed ``frozen_motions.json``: the values in many digits, the horizons in double precision. Each value
has a deviation: the largest difference of the double precision solution, and of those of two systems whose stiffness
and start differ by 4 roundings, from it. So it says by how much rounding moves this value.

``frozen_rigid_motions.json``: motions between rigid stops in 40 digits and more, by power series in ball arithmetic.
The random ones have one to three unknowns, damping, constant loads and moving stops. The others are named after what
happens in them: contacts that are hit, let go or brought to rest at one time, loads that rise from zero on a body at
rest, an order of impacts that rounding decides, blows of two contacts in turns. Errors stay below 1e-12 to ``until``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from systems import function_of

import stiffbeam as sb

SYSTEMS, RIGID = (
    json.loads(Path(__file__).with_name(name).read_text(encoding="utf-8"))
    for name in ("frozen_motions.json", "frozen_rigid_motions.json")
)
ROUNDING = 1e-12  # of the scale: what any order of summation may lose before impacts magnify it
FACTOR = 100.0  # of the deviation: another order of summation is another sample of a few roundings


def contact(data: dict[str, Any]) -> sb.Contact:
    stiffness = np.inf if data["stiffness"] is None else data["stiffness"]
    stops = sb.Stops(
        data["lower"], data["upper"], stiffness=stiffness, damping=data["damping"], restitution=data["restitution"]
    )
    return sb.Contact(data["row"], stops, function_of(data["offset"]))


def system(data: dict[str, Any]) -> sb.System:
    loads = [(vector, function_of(f)) for vector, f in data["loads"]]
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


@pytest.mark.parametrize("frozen", RIGID, ids=[frozen["name"] for frozen in RIGID])
def test_the_exact_motion_between_rigid_stops_is_the_frozen_one(frozen):
    t_end, until, (least, most) = frozen["t_end"], frozen["until"], frozen["horizon"]
    run = sb.reference(system(frozen["system"]), t_end)
    assert least <= run.horizon <= most

    t = np.array(frozen["t"])
    scale = np.max(np.abs(frozen["tip"])) or 1.0
    certified, early = t <= run.horizon, t <= until
    paths = [(None, frozen["tip"]), *((i, contact["position"]) for i, contact in enumerate(frozen["contacts"]))]
    off = np.abs([run.at(t, which)[0] - true for which, true in paths])
    assert np.max(off[:, certified]) < 1e-3 * scale
    assert np.max(off[:, early]) < 1e-12 * scale

    for record, true in zip(run.contacts, frozen["contacts"], strict=True):
        if true["impacts"] is not None:
            rows = np.array([row for row in true["impacts"] if row[0] <= until], float).reshape(-1, 4)
            found = record.impacts.until(until)
            assert np.array_equal(found.stops, rows[:, 2])
            for values, exact, rel in (
                (found.times, rows[:, 0], 0.0),
                (found.ends, rows[:, 1], 0.0),
                (found.impulses, rows[:, 3], 1e-8),
            ):
                assert values == pytest.approx(exact, rel=rel, abs=1e-12, nan_ok=True)
        if until == t_end:
            assert record.impulse == pytest.approx(true["impulse"], rel=1e-10, abs=1e-12)
            assert record.fraction == pytest.approx(true["fraction"], abs=1e-6)  # that the end of chatter takes
    assert np.max(np.abs(run.energy.loss)) < 1e-12 * (1.0 + np.max(run.energy.energy))
