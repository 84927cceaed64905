"""One rule for all: contact at t = 0 is no impact, a start exactly on a stop that does not leave it included."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb


def mass(q: float, v: float, load: float = 0.0) -> sb.System:
    """q'' + 100 q = load, a stop at 1 with 1e4 above: a contact lasts 0.031, a flight more than 0.53."""
    stops = sb.Stops(upper=1.0, stiffness=1e4)
    return sb.System.from_matrices(
        [[1.0]], [[100.0]], loads=[([1.0], sb.Constant(load))], contacts=[sb.Contact([1.0], stops)],
        initial_displacement=[q], initial_velocity=[v],
    )  # fmt: skip


# How it starts, when it ends, impacts by hand: a flight from u = 1 with speed v takes (2 pi - 2 atan(v/10))/10.
STARTS = [
    ((1.0, 5.0), 0.55, 0),  # moves in: contact from t = 0, the next at 0.567
    ((1.0, 0.0, 200.0), 0.03, 0),  # is pressed in
    ((1.0, -5.0), 0.55, 1),  # leaves, and is back at 0.536
    ((0.9, 5.0), 0.55, 1),
    ((1.01, 0.0), 0.55, 0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("start", "end", "count"), STARTS)
@pytest.mark.parametrize("method", ["exact", "cvode", "dop853", "radau"])
def test_references(start, end, count, method):
    found = sb.reference(mass(*start), end, method)
    assert found.impacts.count == count
    if method == "exact":
        assert found.impacts_sampled(1e-3).count == count


@pytest.mark.parametrize(("start", "end", "count"), STARTS)
@pytest.mark.parametrize("engine", ["numba", "numpy"])
def test_schemes(start, end, count, engine):
    system = mass(*start)
    for view in (system, system.first_order()):
        assert sb.integrate(view, sb.BDF2(), 1e-3, end, engine=engine).impacts.count == count
    many = sb.integrate_ensemble(system, sb.BDF2(), 1e-3, end, [system, system], engine=engine)
    assert np.all(many.impact_count == count)


def test_the_lower_stop_is_the_mirror_image():
    stops = sb.Stops(lower=-1.0, stiffness=1e4)
    for v, count in ((-5.0, 0), (5.0, 1)):
        system = sb.System.from_matrices(
            [[1.0]], [[100.0]], contacts=[sb.Contact([1.0], stops)], initial_displacement=[-1.0], initial_velocity=[v]
        )
        assert sb.reference(system, 0.55).impacts.count == count
        assert sb.integrate(system, sb.BDF2(), 1e-3, 0.55).impacts.count == count
