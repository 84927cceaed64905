"""The moving frame of a beam, v = u - phi(t) (1 - (x/L)^2): what it puts into loads, gaps and initial data.

v vanishes with its slope at the clamp, and at the tip it is u. A stop at x meets u - m(t) = v + o(t) with

    o(t) = phi(t) (1 - (x/L)^2) - m(t),   m the stop's own motion.

A stop acts through the same row as a point load at its place, so that its force does its virtual work on the position
it measures: ``row(share)`` of a discretisation is the row of v at x = share L.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..basics.arrays import Array
from .contact import Contact, Stops
from .offsets import combined
from .problem import BeamProblem

Row = Callable[[float], Array]


def contacts(problem: BeamProblem, row: Row) -> tuple[Contact, ...]:
    """One contact per stops, in their order."""
    return tuple(_contact(problem, stops, row) for stops in problem.all_stops)


def _contact(problem: BeamProblem, stops: Stops, row: Row) -> Contact:
    share = share_of(problem, stops)
    offset = combined((1.0 - share**2, problem.base), (-1.0, stops.motion))
    return Contact(row(share), replace(stops, position=None, motion=None), offset)


def share_of(problem: BeamProblem, stops: Stops) -> float:
    """x/L of the stops."""
    return 1.0 if stops.position is None else stops.position / problem.length


def observed(made: tuple[Contact, ...], tip: Array) -> Array | None:
    """The row of ``tip``, None where the first contact reads just that."""
    reads_tip = bool(made) and made[0].offset is None and np.array_equal(made[0].row, tip)
    return None if reads_tip else tip


def hat(share: float, M: int) -> Array:
    """Linear interpolation between the nodes beside x = share L; node 0 is held.

    The error for a smooth v is theta (1 - theta) h^2/2 v_xx, theta in [0, 1] the place within the cell: second order.
    """
    cell = min(int(share * M), M - 1)
    theta = share * M - cell
    weights = np.zeros(M + 1)
    weights[cell], weights[cell + 1] = 1.0 - theta, theta
    return weights[1:]
