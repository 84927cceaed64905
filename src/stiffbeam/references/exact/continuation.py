"""Branches of periodic orbits of the exact flow over a parameter: pseudo-arclength, with folds and flips located.

    G(z, a) = P(z, a) - z = 0,   (dz, da) . (z - z0, a - a0) = ds

The derivative of P by the parameter is that of the exact flow (piecewise/tangent.py), with the end of the period where
it moves. A fold is where da changes its sign along the branch, a flip where det(D + I) does.
Source: Seydel, Practical Bifurcation and Stability Analysis, 3rd ed. (2010), sections 4.5 and 5.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from ...basics.arrays import Array
from ...basics.resources import afford
from ...basics.validation import InputError, numbers
from ...model.system import System, require_system
from ...model.system_data import ORDER_8, slope_of
from ...piecewise.generator import Generators
from ...piecewise.measures import within_float64
from ...piecewise.tangent import Tangent
from ...trajectory.trajectory import SolverFailure
from .orbit import ALONE, Orbit, PeriodMap, periodic_orbit

CORRECTIONS = 8  # iterations of the corrector
CLOSED = 1e-11  # relative defect at which a point counts
FAST, SLOW = 3, 6  # corrections up to which the next step is longer, from which on it is shorter
LONGER, SHORTER, SHORTEST = 1.4, 0.5, 1e-5  # of a step, and of the first
MOST = 20  # points for each of the values, on a branch that turns back
REACHED = 1e-6  # of the derivative's norm: distance of a multiplier from 1 at a fold, from -1 at a flip
TURN = 0.7  # cosine between the directions of neighbouring points, below which the step is halved


@dataclass(frozen=True, eq=False)
class _Point:
    """A point of a branch, its direction, and what is looked at along it."""

    z: Array
    value: float
    direction: Array
    derivative: Array
    events: int

    @property
    def turns(self) -> float:
        """The parameter's part of the direction, zero at a fold."""
        return float(self.direction[-1])

    @property
    def flips(self) -> float:
        """det(D + I), zero at a flip."""
        return float(np.linalg.det(self.derivative + np.eye(len(self.derivative))))


@dataclass(frozen=True, eq=False)
class Branch:
    """Periodic orbits along a parameter.

    Parameters
    ----------
    parameter : str
    values : array (k,)
        Of the parameter.
    q, v : array (k, n)
        States at the start of the period.
    multipliers : array (k, 2n)
        Floquet multipliers, the largest first.
    events : array (k,)
        Number of events in a period.
    folds, flips : array
        Values of the parameter at folds and period doublings.
    make_system, period : callable
        Of the parameter.
    """

    parameter: str
    values: Array
    q: Array
    v: Array
    multipliers: NDArray[np.complex128]
    events: NDArray[np.int64]
    folds: Array
    flips: Array
    make_system: Callable[[float], System]
    period: Callable[[float], float]

    def __repr__(self) -> str:
        return (
            f"<Branch over {self.parameter}: {len(self.values)} orbits from {self.values[0]:g} to {self.values[-1]:g},"
            f" {np.count_nonzero(self.stable)} stable, {len(self.folds)} folds, {len(self.flips)} flips>"
        )

    @property
    def stable(self) -> NDArray[np.bool_]:
        """(k,), True where all multipliers lie inside the unit circle."""
        return np.abs(self.multipliers[:, 0]) < 1.0 - ALONE

    def orbit(self, i: int) -> Orbit:
        """The orbit of a point, with its event times solved for."""
        value = float(self.values[i])
        return periodic_orbit(self.make_system(value), self.period(value), (self.q[i], self.v[i]))


class _Follower:
    """Points of one branch, in units of the first orbit's motion and of the range of the parameter."""

    def __init__(
        self, make_system: Callable[[float], System], period: Callable[[float], float], parameter: str, span: float
    ) -> None:
        self.make_system, self.period, self.parameter, self.span = make_system, period, parameter, span
        self.scale = np.ones(0)

    def flow(self, z: Array, value: float) -> tuple[Array, Array, Array, Tangent]:
        """P(z), its derivatives by z and by the parameter, and the tangent."""
        system, period = self.make_system(value), self.period(value)
        mapping = PeriodMap(system, period)
        slope, _ = slope_of(self.make_system, system, value, self.parameter)
        slope = slope.of_vector(np.concatenate([slope.vector()[: -2 * system.size], np.zeros(2 * system.size)]))
        mapping.generators = Generators(system, [slope])
        path, n = mapping.path(z), system.size
        if 0 in path.hits:
            raise SolverFailure(
                "continuation", value, "the period starts with an impact", "shift the phase of the loads"
            )
        tangent = Tangent(mapping.generators, path, np.eye(2 * n))
        if tangent.ties or tangent.grazes:
            reason = "impacts at one time or a graze, where the flow has no derivative"
            raise SolverFailure("continuation", value, reason, "end before, or take other values")
        regime, tau = tangent.regimes[-1], float(tangent.lengths[-1])
        Z = regime.ahead(tangent.Z[-1][:, None], tau)[:, 0]
        by_value = tangent.last[: 2 * n, 0] + (regime.A @ Z)[: 2 * n] * slope_of_period(self.period, value)
        return Z[: 2 * n], tangent.last[: 2 * n, 1:], by_value, tangent

    def point(self, z: Array, value: float, normal: Array, ahead: Array) -> tuple[_Point, int]:
        """The point of the branch in the plane through (z, value) across ``normal``, and how many corrections it took.

        ahead: the direction along which the branch goes on. Raises SolverFailure where none is reached.
        """
        z0, value0 = z, value
        for count in range(CORRECTIONS):
            end, D, by_value, tangent = self.flow(z, value)
            defect = (end - z) / self.scale
            N = len(z)
            bordered = np.zeros((N + 1, N + 1))
            bordered[:N, :N] = (D - np.eye(N)) * self.scale / self.scale[:, None]
            bordered[:N, N] = by_value * self.span / self.scale
            bordered[N] = normal
            moved = np.append((z - z0) / self.scale, (value - value0) / self.span)
            if np.max(np.abs(defect)) < CLOSED:
                direction = np.linalg.solve(bordered, np.append(np.zeros(N), 1.0))
                direction /= np.linalg.norm(direction)
                direction = direction if direction @ ahead >= 0.0 else -direction
                return _Point(z, value, direction, D, len(tangent.path.times) - 1), count
            step = np.linalg.solve(bordered, -np.append(defect, normal @ moved))
            z, value = z + step[:N] * self.scale, value + float(step[N]) * self.span
            if not np.all(np.isfinite(z)) or np.linalg.norm(step) > 10.0:
                break
        raise SolverFailure("continuation", value, "the corrector does not converge", "take closer values")

    def ahead(self, start: _Point, ds: float) -> tuple[_Point, int]:
        """The point at the distance ds along the direction of another."""
        z = start.z + ds * start.direction[:-1] * self.scale
        value = start.value + ds * float(start.direction[-1]) * self.span
        return self.point(z, value, start.direction, start.direction)

    def located(self, start: _Point, ds: float, test: Callable[[_Point], float], multiplier: float) -> float | None:
        """The parameter where a test function vanishes between two points and a multiplier has its value there.

        None where the function jumps.
        """
        try:
            at: Any = brentq(
                lambda s: test(self.ahead(start, s)[0]) if s else test(start),
                0.0,
                ds,
                xtol=1e-13,
                rtol=np.float64(1e-14),
            )
            found = self.ahead(start, at)[0]
        except (SolverFailure, ValueError):
            return None
        off = np.min(np.abs(np.linalg.eigvals(found.derivative) - multiplier))
        return found.value if off <= REACHED * max(1.0, float(np.linalg.norm(found.derivative))) else None


def slope_of_period(period: Callable[[float], float], value: float) -> float:
    """dT/da by differences of order 8 of a function in closed form."""
    h = 2.0**-6 * (abs(value) or 1.0)
    pairs = np.array([(period(value + k * h) - period(value - k * h)) / h for k in range(1, 5)])
    return float(ORDER_8 @ pairs)


def continuation(
    make_system: Callable[[float], System],
    parameter: str,
    values: ArrayLike,
    period: float | Callable[[float], float],
    guess: Any = None,
) -> Branch:
    """Periodic orbits along a branch, through folds and past flips, stable or not.

    Parameters
    ----------
    make_system : callable
        The system at a value of the parameter, smooth in it.
    parameter : str
        Its name, for tables and messages.
    values : sequence of float
        From the first of these, which has an orbit near the guess, to the last; their mean distance is the first step.
        The branch ends where it leaves their range.
    period : float or callable
        Of the orbits; of a driven system a function of the parameter, ``lambda w: 2 * np.pi / w``.
    guess : as for ``periodic_orbit``

    Returns
    -------
    Branch
        ``.values .q .v .multipliers .stable .folds .flips .events``, and ``.orbit(i)``.

    Raises
    ------
    InputError
        For values that are not two or more different numbers.
    SolverFailure
        Where no orbit is near the guess, or the branch cannot be followed on.

    Examples
    --------
    >>> import numpy as np, stiffbeam as sb
    >>> def softly_stopped(w):
    ...     stop = sb.Contact([1.0], sb.Stops(upper=0.5, stiffness=4.0))
    ...     load = ([1.0], sb.Harmonic(0.3, w))
    ...     return sb.System.from_matrices([[1.0]], [[1.0]], [[0.1]], loads=[load], contacts=[stop])
    >>> branch = sb.continuation(softly_stopped, "frequency", np.linspace(1.15, 1.45, 8), lambda w: 2 * np.pi / w)
    >>> len(branch.folds)
    2
    """
    along = np.atleast_1d(numbers("values", values)).ravel()
    if len(along) < 2 or along[0] == along[-1]:
        raise InputError(
            "values", values, "be two or more numbers, the last another than the first", "np.linspace(a, b, 50)"
        )
    of_value = period if callable(period) else lambda _: float(period)  # type: ignore[arg-type]
    low, high = float(np.min(along)), float(np.max(along))
    afford("values", len(along), "take fewer", seconds=0.02 * len(along))
    first = make_system(float(along[0]))
    require_system(first)
    start = periodic_orbit(first, of_value(float(along[0])), guess)
    follower = _Follower(make_system, of_value, parameter, high - low)
    z, value = np.concatenate([start.q, start.v]), float(along[0])
    n = first.size
    follower.scale = np.repeat(
        [max(np.max(np.abs(start.path.q)), 1e-300), max(np.max(np.abs(start.path.v)), 1e-300)], n
    )
    with within_float64("continuation", of_value(value)):
        normal = np.append(np.zeros(2 * n), np.sign(along[-1] - along[0]))
        point, _ = follower.point(z, value, normal, normal)
        points, folds, flips = [point], list[float](), list[float]()
        step = first_step = 1.0 / (len(along) - 1)
        while low <= point.value <= high and len(points) < MOST * len(along):
            try:
                new, count = follower.ahead(point, step)
            except (SolverFailure, np.linalg.LinAlgError):
                new, count = None, CORRECTIONS
            if new is None or new.direction @ point.direction < TURN:
                step *= SHORTER
                if step < SHORTEST * first_step:
                    reason = "the branch cannot be followed on" if new is None else "the branch turns sharply"
                    raise SolverFailure("continuation", point.value, reason, "end before, or take closer values")
                continue
            if (
                new.turns * point.turns < 0.0
                and (at := follower.located(point, step, lambda x: x.turns, 1.0)) is not None
            ):
                folds.append(at)
            if (
                new.flips * point.flips < 0.0
                and (at := follower.located(point, step, lambda x: x.flips, -1.0)) is not None
            ):
                flips.append(at)
            point = new
            points.append(point)
            step *= LONGER if count <= FAST else SHORTER if count >= SLOW else 1.0
            step = min(step, 4.0 * first_step)
    inside = [x for x in points if low - 1e-12 <= x.value <= high + 1e-12]
    return _branch(parameter, inside, (folds, flips), make_system, of_value, n)


def _branch(
    parameter: str, points: Sequence[_Point], special: tuple[list[float], list[float]],
    make_system: Callable[[float], System], period: Callable[[float], float], n: int,
) -> Branch:  # fmt: skip
    multipliers = np.array([np.linalg.eigvals(x.derivative) for x in points], complex)
    order = np.argsort(-np.abs(multipliers), axis=1, kind="stable")
    states = np.array([x.z for x in points])
    return Branch(
        parameter, np.array([x.value for x in points]), states[:, :n], states[:, n:],
        np.take_along_axis(multipliers, order, axis=1), np.array([x.events for x in points], np.int64),
        np.array(special[0]), np.array(special[1]), make_system, period,
    )  # fmt: skip
