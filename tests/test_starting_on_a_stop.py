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


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_a_start_on_a_stop_is_one_however_its_modes_are_rounded(damping):
    """The position is a sum over modes: its distance from the stop is not zero, but 1e-16 to either side."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, row, q, v = rng.normal(size=(4, 4)), np.eye(4)[rng.integers(4)], rng.normal(size=4), rng.normal(size=4)
        system = sb.System.from_matrices(
            np.eye(4), x @ x.T + np.eye(4), damping=damping * np.eye(4),
            contacts=[sb.Contact(row, sb.Stops(upper=float(row @ q), stiffness=1e4))],
            initial_displacement=q, initial_velocity=v * np.sign(row @ v),
        )  # fmt: skip
        contact = sb.reference(system, 1e-3).contacts[0]
        assert contact.impacts.count == 0
        assert contact.fraction == 1.0
