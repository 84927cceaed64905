"""What compare, advise and the studies say of a beam that never moves, and of one that never touches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.measures.comparison import AT_REST
from stiffbeam.model.scales import scales

STILL = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(lower=-0.1, upper=0.1, stiffness=5e6))
FAR = replace(STILL, stops=sb.Stops(lower=-1.0, upper=1.0, stiffness=5e6), base=sb.Harmonic(0.2, 10.0))
NEAR = replace(FAR, stops=STILL.stops)
PULSE = sb.Sampled([0.0, 0.1, 0.2, 1.0], [0.0, 1.0, 0.0, 0.0])


@pytest.mark.parametrize(("change", "still"), [
    ({}, True), ({"base": sb.Harmonic(0.0, 10.0)}, True), ({"base": sb.Harmonic(1e-9, 10.0)}, False),
    ({"loads": sb.PointLoad(position=0.5, time=sb.Constant(0.0))}, True),
    ({"loads": sb.PointLoad(position=0.5, time=sb.Sampled([0.0, 1.0], [0.0, 0.0]))}, True),
    ({"loads": sb.PointLoad(position=0.5, time=PULSE)}, False), ({"initial_velocity": lambda x: 1e-9 + 0 * x}, False),
    ({"stops": sb.Stops(lower=0.0, upper=0.1, stiffness=5e6)}, True),
    ({"stops": sb.Stops(lower=0.01, upper=0.1, stiffness=5e6)}, False),  # pressed at the start
    ({"stops": sb.Stops(lower=-0.1, stiffness=5e6, motion=sb.Harmonic(0.2, 10.0))}, False),
])  # fmt: skip
def test_what_stays_at_rest_is_known(change: dict[str, object], still: bool) -> None:
    system = sb.semidiscretise(replace(STILL, **change), cells=4)
    assert (scales(system, 0.5).speed == 0.0) == still
    assert np.any(sb.reference(system, t_end=0.5).tip) != still


@pytest.mark.parametrize(
    ("problem", "said"), [(STILL, AT_REST), (FAR, "No impacts: the motion reaches no stop to t = 0.2."), (NEAR, "")]
)
def test_compare_and_advise_say_that_nothing_moves_or_touches(problem: sb.BeamProblem, said: str) -> None:
    system = sb.semidiscretise(problem, cells=6)
    reference = sb.reference(system, t_end=0.2)
    assert bool(sum(len(c.impacts.times) for c in reference.contacts)) == (said == "")
    found = sb.compare(sb.integrate(system, sb.HHT(alpha=-0.1), dt=1e-3, t_end=0.2), reference)
    assert found.remark == found.to_dict()["remark"] == said
    assert " ".join(str(found).split()).startswith(said or "To the horizon")
    records = sb.study("advise", system, t_end=0.2, want={"tip": 0.5}, schemes=[sb.BDF2()])
    assert said in records.answer.notes
    assert records.answer.verdict.startswith("BDF2")
