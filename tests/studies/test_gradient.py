"""Orders of a scheme's value and derivative: conserving contact keeps order 2 in both, implicit contact does not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.studies import gradient


def small_case() -> sb.Case:
    """Table 10's beam with four cells, whose fastest mode the steps resolve."""
    return dataclasses.replace(sb.paper_case(10), cells=4)


@pytest.mark.slow
def test_conserving_contact_keeps_the_order_in_the_derivative():
    records = sb.study("gradient", small_case(), schemes=["trapezoidal"], halvings=8, starts=6, impacts=3, jobs=1)
    lines = {line["method"]: line for line in records.answer.table}
    assert set(lines) == {"Trapezoidal", "Trapezoidal averaged", "Trapezoidal conserving"}
    orders = {name: float(line["order of the derivative"].split()[0]) for name, line in lines.items()}
    assert orders["Trapezoidal conserving"] > 1.8
    assert orders["Trapezoidal averaged"] > 1.8
    assert orders["Trapezoidal"] < 1.4
    errors = {name: float(line["derivative, finest"]) for name, line in lines.items()}
    assert errors["Trapezoidal"] > 100.0 * errors["Trapezoidal conserving"]
    assert errors["Trapezoidal"] > 100.0 * errors["Trapezoidal averaged"]
    assert all(float(line["order of the value"].split()[0]) > 1.6 for line in lines.values())


def test_the_exact_derivative_is_that_of_differences():
    """In the study's own direction and from its own starts."""
    case = small_case()
    system = case.system("displacement")
    direction = np.linspace(0.0, 1.0, system.size)
    starts, size = gradient.starts_of(system, 0.05, 3, direction)
    values, slopes = gradient.exact_values(system, 0.05, starts, direction)

    def tip(velocity: np.ndarray) -> float:
        moved = dataclasses.replace(system, v0=velocity)
        return float(sb.reference(moved, 0.05, t_eval=[0.0, 0.05]).tip[-1])

    h = 1e-6 * size
    for start, value, slope in zip(starts, values, slopes, strict=True):
        assert value == tip(start)
        assert abs((tip(start + h * direction) - tip(start - h * direction)) / (2.0 * h) - slope) < 1e-5 * abs(slope)
