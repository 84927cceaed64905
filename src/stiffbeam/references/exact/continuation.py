"""Branches of periodic orbits of the exact flow over a parameter: pseudo-arclength, with bifurcations located.

    G(z, a) = P(z, a) - z = 0,   (dz, da) . (z - z0, a - a0) = ds

The derivative of P by the parameter is that of the exact flow (piecewise/tangent.py), with the end of the period where
it moves. Where the branch is far from a fold the parameter itself is stepped, so that a point takes one system. Test
functions of the multipliers m change their sign at bifurcations:

    fold, branching    prod (m_i - 1)       the branch turns back, or another crosses it
    flip               prod (m_i + 1)       the branch of twice the period leaves it
    torus              prod (m_i m_j - 1)   i < j, a pair that is complex

At a grazing a gap touches zero: a pair of events is born or dies.
Source: Seydel, Practical Bifurcation and Stability Analysis, 3rd ed. (2010), sections 4.5 and 5.3; Kuznetsov, Elements
of Applied Bifurcation Theory (2004), section 10.2.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import krogh_interpolate
from scipy.optimize import brentq

from ...basics.arrays import Array
from ...basics.resources import Show, afford, displayed, silent
from ...basics.text import several
from ...basics.validation import InputError, function, integer, numbers, positive
from ...model.system import System, require_system
from ...model.system_data import SystemData, data_of, slope_of, slope_of_period
from ...piecewise.measures import within_float64
from ...piecewise.tangent import Tangent
from ...trajectory.trajectory import SolverFailure
from .orbit import ALONE, Orbit, PeriodMap, abrupt, distances, events, periodic_orbit, rigid_grazing, shallowest, turn

CORRECTIONS = 8  # iterations of the corrector
CLOSED = 1e-11  # relative defect at which a point counts
LOCATED = 1e-13  # the same of a bifurcation
ROUNDED = 1e-15  # of the derivative's norm: a defect that is rounding
FAST, SLOW = 3, 6  # corrections up to which the next step is longer, from which on it is shorter
LONGER, SHORTER, LOST = 1.4, 0.5, 0.25  # of a step: after few corrections, after many, after a failure
LONGEST, SHORTEST = 2.0, 1e-10  # steps, of the first one
MOST = 20  # points for each of the values, on a branch that turns back
REACHED = 1e-6  # of the derivative's norm: distance of a multiplier from its value at a bifurcation
OFF = 0.3  # of a step: distance of a point from the tangent from which on it may be of another branch
RESCALED = 3.0  # factor by which a motion grows or shrinks until it is the new unit
TURN = 0.8  # cosine between the directions of neighbouring points, below which the step is shorter
CLOSE = 1e-4  # distance of two points below which the way between them is rounding
ALONG = 0.5  # of the parameter's part of the direction: where so much is left two steps on, the value is stepped
LINEAR = 1e-9  # of the derivatives of data by the parameter: those at both limits give the others
NOISE = 1e-9  # of a test function: below it its sign is rounding, as without damping
NEARLY = 1e-4  # of the range: the distance of a grazing that ends a branch from its last point
BESIDE = 0.02  # of a step: as near comes the search to a point where another branch crosses
SPLIT = 12  # halvings of a step between two grazings
AWAY = (1e-2, 3e-3, 1e-3, 1e-4, 3e-2, 1e-5, 1e-1)  # distances from a flip at which twice the period is looked for
LOST_AT = (SolverFailure, InputError, np.linalg.LinAlgError, FloatingPointError)  # no point there, or no system
TESTS: dict[str, Callable[[NDArray[np.complex128]], float]] = {
    "fold": lambda m: float(np.prod(m - 1.0).real),
    "flip": lambda m: float(np.prod(m + 1.0).real),
    "torus": lambda m: float(np.prod((np.outer(m, m) - 1.0)[np.triu_indices(len(m), 1)]).real),
}


@dataclass(frozen=True, eq=False)
class Bifurcation:
    """A located point of a branch.

    Parameters
    ----------
    kind : str
        "fold", "flip", "torus", "branching" or "grazing".
    value : float
        Of the parameter.
    z : array (2n,)
        The state (q, q') at the start of the period.
    place : int
        Number of the orbits of the branch before it.
    """

    kind: str
    value: float
    z: Array = field(repr=False)
    place: int = 0


@dataclass(frozen=True, eq=False)
class _Point:
    """A point of a branch with its direction and the tangent along its orbit."""

    z: Array
    value: float
    direction: Array
    multipliers: NDArray[np.complex128]
    size: float
    events: int
    tangent: Tangent

    @property
    def kept(self) -> tuple[float, Array, NDArray[np.complex128], int]:
        """Its part in a branch: value, state, multipliers and number of events."""
        return self.value, self.z, self.multipliers, self.events

    def other_half(self) -> Array:
        """z(T/2) - z(0), (2n,): on a branch of twice the period zero where that is left."""
        half = np.array([0.5 * self.tangent.path.t_end])
        return self.tangent.states(half)[0, : len(self.z)] - self.z


@dataclass(frozen=True, eq=False)
class Branch:
    """Periodic orbits along a parameter.

    Parameters
    ----------
    parameter : str
    values : array (k,)
        Values of the parameter.
    q, v : array (k, n)
        States at the start of the period.
    multipliers : array (k, 2n)
        Floquet multipliers, the largest first.
    events : array (k,)
        Number of events in a period.
    bifurcations : tuple of Bifurcation
        In the order of the branch.
    end : str
        The reason why the branch ends.
    """

    parameter: str
    values: Array
    q: Array
    v: Array
    multipliers: NDArray[np.complex128]
    events: NDArray[np.int64]
    bifurcations: tuple[Bifurcation, ...]
    end: str
    follower: _Follower = field(repr=False)

    def __repr__(self) -> str:
        counted = Counter(x.kind for x in self.bifurcations)
        plural = {"torus": "tori"}
        kinds = [f"{n} {plural.get(kind, kind + 's') if n != 1 else kind}" for kind, n in counted.items()]
        return (
            f"<Branch over {self.parameter}: {several(len(self.values), 'orbit')} from {self.values[0]:g} to "
            f"{self.values[-1]:g}, {np.count_nonzero(self.stable)} stable, {', '.join(kinds) or 'no bifurcation'}>"
        )

    @property
    def stable(self) -> NDArray[np.bool_]:
        """(k,), True where all multipliers lie inside the unit circle."""
        return np.abs(self.multipliers[:, 0]) < 1.0 - ALONE

    def at(self, kind: str) -> Array:
        """Values of the parameter at the bifurcations of a kind."""
        return np.array([x.value for x in self.bifurcations if x.kind == kind])

    @property
    def folds(self) -> Array:
        """Values of the parameter at which the branch turns back."""
        return self.at("fold")

    @property
    def flips(self) -> Array:
        """Values of the parameter at which a multiplier is -1."""
        return self.at("flip")

    def orbit(self, i: int) -> Orbit:
        """The orbit of a point, with its event times solved for."""
        value = float(self.values[i])
        return periodic_orbit(self.follower.make_system(value), self.follower.period(value), (self.q[i], self.v[i]))

    def doubled(self, i: int = 0) -> Branch:
        """The branch of twice the period that leaves this one at its flip number i.

        It ends where it leaves the range of the parameter, or where it comes back to a branch of this period.

        Parameters
        ----------
        i : int
            Number of the flip, as in ``flips``.

        Returns
        -------
        Branch
            ``q`` and ``v`` are those at the start of one of its two periods.

        Raises
        ------
        InputError
            For a flip that the branch does not have.
        SolverFailure
            Where no orbit of twice the period is found beside the flip.

        Examples
        --------
        >>> import numpy as np, stiffbeam as sb
        >>> def stopped(w):
        ...     stop = sb.Contact([1.0], sb.Stops(upper=0.0, stiffness=400.0))
        ...     load = ([1.0], sb.Harmonic(1.0, w))
        ...     return sb.System.from_matrices([[1.0]], [[1.0]], [[0.2]], loads=[load], contacts=[stop])
        >>> branch = sb.continuation(stopped, "frequency", np.linspace(2.5, 2.65, 10), lambda w: 2 * np.pi / w)
        >>> len(branch.flips), bool(np.all(branch.doubled(0).stable))
        (1, True)
        """
        flips = [x for x in self.bifurcations if x.kind == "flip"]
        integer("i", i, 0)
        if i >= len(flips):
            raise InputError("i", i, f"be the number of a flip, of which there are {len(flips)}", "see branch.flips")
        return self.follower.doubled(flips[i])


class _Follower:
    """Points of one branch, in units of the first orbit's motion and of the parameter's range."""

    def __init__(
        self, make_system: Callable[[float], System], period: Callable[[float], float], parameter: str,
        limits: tuple[float, float], first_step: float, most: int, grazings: bool,
    ) -> None:  # fmt: skip
        self.make_system, self.period, self.parameter, self.limits = make_system, period, parameter, limits
        self.span, self.most, self.grazings = limits[1] - limits[0], most, grazings
        self.show: Show = silent
        self.first_step, self.scale = first_step, np.ones(0)
        self._last: tuple[float, PeriodMap, float] | None = None
        self._slopes: tuple[Array, Array] | None = None  # at both limits, where they are linear between them
        first, middle, last = (self._slope(x) for x in (limits[0], 0.5 * sum(limits), limits[1]))
        if np.max(np.abs(0.5 * (first + last) - middle)) <= LINEAR * np.max(np.abs(middle)):
            self._slopes = first, last

    def mapping(self, value: float) -> tuple[PeriodMap, float]:
        """The period map at a value of the parameter, with its derivative by it, and dT/da."""
        if self._last is None or self._last[0] != value:
            system, period = self.make_system(value), self.period(value)
            mapping = PeriodMap(system, period, [self.slope(value, system)])
            self._last = value, mapping, slope_of_period(self.period, value)
        return self._last[1:]

    def _slope(self, value: float, system: System | None = None) -> Array:
        return slope_of(self.make_system, system or self.make_system(value), value, self.parameter)[0].vector()

    def slope(self, value: float, system: System) -> SystemData:
        """Derivative of the data of the system by the parameter, without that of the initial data."""
        share, ends = (value - self.limits[0]) / self.span, self._slopes
        vector = self._slope(value, system) if ends is None else (1.0 - share) * ends[0] + share * ends[1]
        vector[-2 * system.size :] = 0.0
        return data_of(system).of_vector(vector)

    def flow(self, z: Array, value: float) -> tuple[Array, Array, Array, Tangent]:
        """P(z), its derivatives by z and by the parameter, and the tangent."""
        mapping, longer = self.mapping(value)
        end, D, tangent = mapping.flow(z)
        if tangent.ties or tangent.grazes:
            reason = "impacts at one time or a graze, where the flow has no derivative"
            raise SolverFailure("continuation", value, reason, "end before, or take other values")
        # The end of the period moves with the parameter: dP/da has T' times the rate of the state there.
        rate = tangent.regimes[-1].A[: len(z)] @ np.append(end, tangent.generators.basis.values(mapping.period, 0))
        return end, D, tangent.last[: len(z), 0] + rate * longer, tangent

    def point(
        self, z0: Array, value0: float, normal: Array, ahead: Array, guess: Array | None = None,
        closed: float = CLOSED, length: float = np.inf,
    ) -> tuple[_Point, int]:  # fmt: skip
        """The point of the branch in the plane through (z0, value0) across ``normal``, and the number of corrections.

        ahead: the direction along which the branch goes on. guess: a step (2n + 1,) in the plane to start from. closed:
        relative defect at which a point counts. length: of the step; a point too far off is of another branch. Raises
        SolverFailure where no point is reached.
        """
        z, value, N, before = z0, value0, len(z0), np.inf
        if guess is not None:
            z, value = z + guess[:N] * self.scale, value + float(guess[N]) * self.span
        for count in range(CORRECTIONS):
            end, D, by_value, tangent = self.flow(z, value)
            defect = (end - z) / self.scale
            size = float(np.max(np.abs(defect)))
            # G and the plane as one system, in units of the motion and of the range.
            bordered = np.zeros((N + 1, N + 1))
            bordered[:N, :N] = (D - np.eye(N)) * self.scale / self.scale[:, None]
            bordered[:N, N] = by_value * self.span / self.scale
            bordered[N] = normal
            moved = np.append((z - z0) / self.scale, (value - value0) / self.span)
            if size < max(closed, ROUNDED * float(np.linalg.norm(bordered))) or 0.5 * before < size < CLOSED:
                if np.linalg.norm(moved) > OFF * length:
                    reason = "the corrector goes to another branch"
                    raise SolverFailure("continuation", value, reason, "take closer values")
                # Tangent of the branch: G does not change along it.
                direction = np.linalg.solve(bordered, np.append(np.zeros(N), 1.0))
                direction /= np.linalg.norm(direction)
                direction = direction if direction @ ahead >= 0.0 else -direction
                m = np.asarray(np.linalg.eigvals(D), complex)
                m = m[np.argsort(-np.abs(m), kind="stable")]
                switches = len(tangent.path.times) - 1
                return _Point(z, value, direction, m, float(np.linalg.norm(D)), switches, tangent), count
            if size > before and count > (2 if guess is None else 1):  # a kink: a shorter step costs less than more
                break
            before, step = size, np.linalg.solve(bordered, -np.append(defect, normal @ moved))
            if not np.linalg.norm(step) < 10.0:
                break
            z, value = z + step[:N] * self.scale, value + float(step[N]) * self.span
        raise SolverFailure("continuation", value, "the corrector does not converge", "take closer values")

    def ahead(self, start: _Point, ds: float, before: _Point | None, straight: bool) -> tuple[_Point, int]:
        """The point at the distance ds along the direction of another; before: the point before that one. straight:
        search from the tangent, else from the cubic through both points."""
        N = len(start.z)
        normal, guess = start.direction, None
        if before is not None:
            apart = self.apart(before, start)
            bend = (start.direction - before.direction) / np.linalg.norm(apart)
            if (normal[N] + 2.0 * ds * bend[N]) * np.sign(normal[N]) > ALONG * abs(normal[N]):
                normal = np.append(np.zeros(N), 1.0)  # one system for all corrections
            # The cubic through both points along their directions, over the way across the plane.
            step, h = ds * float(normal @ start.direction), float(normal @ apart)
            u, rate = (x.direction / (normal @ x.direction) for x in (before, start))
            # A chord of close points is rounding: there a parabola along both directions.
            chord = apart / h - rate if np.linalg.norm(apart) > CLOSE else 0.5 * (u - rate)
            curve = (step / h) * (rate - u + 3.0 * chord) + (step / h) ** 2 * (rate - u + 2.0 * chord)
            guess = None if straight else -step * curve
        z = start.z + ds * start.direction[:N] * self.scale
        value = start.value + ds * float(start.direction[N]) * self.span
        return self.point(z, value, normal, start.direction, guess, length=ds)

    def apart(self, one: _Point, other: _Point) -> Array:
        """The way from one point to another, (2n + 1,)."""
        return np.append((other.z - one.z) / self.scale, (other.value - one.value) / self.span)

    def follow(self, start: _Point, step: float, loses: bool = False) -> Branch:
        """The branch from a point on. loses: it is of twice the period, and ends where it is of one."""
        low, high = self.limits
        points, bifurcations, near = [start.kept], list[Bifurcation](), list[tuple[float, float]]()
        point, before, straight, end = start, None, False, ""
        while not end:
            self.show(f"continuation: {self.parameter} = {point.value:.5g}", len(points), self.most)
            if abrupt(point.tangent.generators.system) and len(near) < len(points):
                near.append(distances(point.tangent))
            reason, lost = "the branch turns sharply", "the corrector does not converge"
            try:
                new, count = self.ahead(point, step, before, straight)
            except LOST_AT as error:
                reason = str(error) if isinstance(error, InputError) else getattr(error, "reason", lost)
                new, count = None, CORRECTIONS
            # Lost, or turning sharply: a shorter step, along the tangent alone.
            if new is None or new.direction @ point.direction < TURN:
                step, straight = step * LOST, True
                if step < SHORTEST * self.first_step:
                    end = f"at {point.value:.10g} {reason}"
                    # The reason may be a graze just ahead, where the flow has no derivative.
                    graze = rigid_grazing([x[0] for x in points], near, NEARLY * self.span) if near else None
                    if graze is not None:
                        bifurcations.append(Bifurcation("grazing", graze, point.z, len(points)))
                        end = "rigid" if point.tangent.path.rigid else "damped"
                        end = f"at {graze:.10g} a contact grazes its {end} stop, where the flow has no derivative"
                continue
            # The two halves of the orbit have changed places: between the points they were equal.
            if loses and (new.other_half() / self.scale) @ (point.other_half() / self.scale) < 0.0:
                end = f"near {point.value:.5g} it comes back to a branch of half its period"
                break
            bifurcations += [replace(x, place=len(points)) for x in self.between(point, new)]
            if not low <= new.value <= high:
                end = "at the end of the values"
                last = self.reached(point, new, low if new.value < low else high)
                points += [] if last is None else [last.kept]
                break
            (point, step, before), straight = self.rescaled(new, step, point), False
            points.append(point.kept)
            factor = LONGER if count <= FAST else SHORTER if count >= SLOW else 1.0
            step = min(step * factor, LONGEST * self.first_step)
            if len(points) >= self.most:
                end = f"at {point.value:.10g} after {self.most} orbits: start again from there, or allow more"
        if len(points) < 2:
            raise SolverFailure("continuation", start.value, end.partition(" ")[2], "take closer values")
        values, states, multipliers, events = (np.array(x) for x in zip(*points, strict=True))
        n = len(start.z) // 2
        return Branch(
            self.parameter, values, states[:, :n], states[:, n:], multipliers, events.astype(np.int64),
            tuple(x for x in bifurcations if low <= x.value <= high), end, self,
        )  # fmt: skip

    def rescaled(self, point: _Point, step: float, before: _Point) -> tuple[_Point, float, _Point | None]:
        """A point, a step and the point before, in units of its motion where that has become another by a factor."""
        factor = point.tangent.path.units / self.scale
        if np.all((factor < RESCALED) & (factor > 1.0 / RESCALED)):
            return point, step, before
        self.scale = self.scale * factor
        direction = point.direction / np.append(factor, 1.0)
        size = float(np.linalg.norm(direction))
        return replace(point, direction=direction / size), step * size, None

    def reached(self, one: _Point, other: _Point, value: float) -> _Point | None:
        """The point between two at a value of the parameter; None where it is not reached."""
        z = one.z + (value - one.value) / (other.value - one.value) * (other.z - one.z)
        try:
            return self.point(z, value, np.append(np.zeros(len(z)), 1.0), other.direction)[0]
        except LOST_AT:
            return None

    def between(self, one: _Point, other: _Point) -> Iterator[Bifurcation]:
        """The bifurcations between two neighbours. At a graze of a damped stop the multipliers jump."""
        sizes = sorted(float(np.abs(x.multipliers[0])) for x in (one, other))
        jumps = sizes[0] < 1.0 <= sizes[1] and abrupt(one.tangent.generators.system)
        for kind, test in TESTS.items():
            before, after = test(one.multipliers), test(other.multipliers)
            if before * after < 0.0 and min(abs(before), abs(after)) > NOISE:
                # A multiplier of 1 is a fold only where the parameter turns back; else another branch crosses.
                name = "branching" if kind == "fold" and one.direction[-1] * other.direction[-1] >= 0.0 else kind
                point = self.located(one, other, lambda x, test=test: test(x.multipliers), name == "branching")
                if point is not None and _reached(kind, point):
                    jumps = False
                    yield Bifurcation(name, point.value, point.z)
        if self.grazings or jumps:
            yield from self.grazings_between(one, other)

    def grazings_between(self, one: _Point, other: _Point, depth: int = 0) -> Iterator[Bifurcation]:
        """The grazings of compliant stops, damped or not, between two neighbours."""
        before, after = (Counter(event[1:] for event in events(x.tangent)) for x in (one, other))
        changes = (after - before) + (before - after)
        if not changes:
            return
        self.show(f"continuation: grazings from {self.parameter} = {one.value:.5g} on", depth, SPLIT)
        contacts = {event[0] for event in changes}
        # One pair of events of one contact: the graze is where its turning gap changes sign.
        if sum(changes.values()) == 2 and len(contacts) == 1:
            contact = contacts.pop()
            for t, side in shallowest((one if before.total() > after.total() else other).tangent, contact):
                if turn(one.tangent, contact, side, t) * turn(other.tangent, contact, side, t) < 0.0:
                    graze = self.located(one, other, lambda x, t=t, side=side: turn(x.tangent, contact, side, t))
                    if graze is not None:
                        yield Bifurcation("grazing", graze.value, graze.z)
                    return
        # Several changes, or none that fits: look at the halves of the step.
        if depth < SPLIT:
            try:
                middle, _ = self.inside(one, other, 0.5)
            except LOST_AT:
                return
            yield from self.grazings_between(one, middle, depth + 1)
            yield from self.grazings_between(middle, other, depth + 1)

    def doubled(self, flip: Bifurcation) -> Branch:
        """The branch of twice the period that leaves at a flip, along the vector that a period turns round."""
        period = self.period
        follower = copy(self)
        follower.period, follower.show = lambda x: 2.0 * period(x), silent
        follower._last = None
        with within_float64("continuation", period(flip.value)):
            _, D, _, _ = self.flow(flip.z, flip.value)
            m, vectors = np.linalg.eig(D * self.scale / self.scale[:, None])
            across = np.real(vectors[:, np.argmin(np.abs(m + 1.0))])
            normal = np.append(across / np.linalg.norm(across), 0.0)
            for away in AWAY:
                try:
                    z = flip.z + away * normal[:-1] * self.scale
                    point, _ = follower.point(z, flip.value, normal, normal)
                except LOST_AT:
                    continue
                # Orbits of one period solve this too: the halves must differ.
                if np.linalg.norm(point.other_half() / self.scale) > away:
                    return follower.follow(point, away, loses=True)
        reason = "no orbit of twice the period is found beside the flip"
        raise SolverFailure("continuation", flip.value, reason, "start periodic_orbit from a run beside it")

    def inside(
        self, one: _Point, other: _Point, share: float, guess: Array | None = None, closed: float = CLOSED
    ) -> tuple[_Point, Array]:
        """The point between two neighbours, in the plane across the cubic through them at a share of the way, and the
        step (2n + 1,) to it in the plane. guess: of that step. closed: see ``point``."""
        apart = self.apart(one, other)
        length, s = float(np.linalg.norm(apart)), share
        along = s * s * (3.0 - 2.0 * s) * apart
        along += length * s * (1.0 - s) * ((1.0 - s) * one.direction - s * other.direction)
        rate = 6.0 * s * (1.0 - s) * apart
        rate += length * ((1.0 - s) * (1.0 - 3.0 * s) * one.direction + s * (3.0 * s - 2.0) * other.direction)
        z, value = one.z + along[:-1] * self.scale, one.value + float(along[-1]) * self.span
        within, normal = np.inf if guess is None else length, rate / np.linalg.norm(rate)
        point = self.point(z, value, normal, one.direction, guess, closed, within)[0]
        return point, np.append((point.z - z) / self.scale, (point.value - value) / self.span)

    def located(
        self, one: _Point, other: _Point, test: Callable[[_Point], float], crossed: bool = False
    ) -> _Point | None:
        """The point between two neighbours where a test function vanishes, None where it is not reached. crossed: by a
        branch along which rounding moves points by its size over their distance: there the place is interpolated."""
        known = {s: (point, np.zeros(len(one.direction))) for s, point in ((0.0, one), (1.0, other))}
        size = 1e-13 * abs(one.value) / max(abs(other.value - one.value), 1e-300)  # of the parameter, in ways between
        near = BESIDE if crossed else float(np.clip(size, 1e-14, 1e-9))

        def at(s: float, closed: float = LOCATED) -> _Point:
            places = sorted(known, key=lambda x: abs(x - s))[:4]  # of the nearest points
            if abs(places[0] - s) <= 1e-9 * crossed:
                return known[places[0]][0]
            step = krogh_interpolate(places, [known[x][1] for x in places], s)
            try:
                known[s] = self.inside(one, other, s, step, closed)
            except LOST_AT:
                known[s] = self.inside(one, other, s, None, closed)
            return known[s][0]

        try:
            share: Any = brentq(lambda s: test(at(s)), 0.0, 1.0, xtol=near, rtol=np.float64(1e-14))
            if not crossed:
                return at(share)
            six = np.clip(share, 2.5 * BESIDE, 1.0 - 2.5 * BESIDE) + BESIDE * (np.arange(6) - 2.5)
            share = float(krogh_interpolate([test(at(x)) for x in six.tolist()], six, 0.0))
            return at(share, 1e-8)  # the corrector is singular there: the interpolated point counts as it is
        except (*LOST_AT, ValueError):
            return None


def _reached(kind: str, point: _Point) -> bool:
    """Return True where a multiplier has its value at a bifurcation: a test function jumps where an event goes."""
    m = point.multipliers
    m = np.abs(m[np.abs(m.imag) > REACHED]) if kind == "torus" else m
    return bool(np.min(np.abs(m + (kind == "flip" or -1.0)), initial=np.inf) <= REACHED * max(1.0, point.size))


def continuation(
    make_system: Callable[[float], System],
    parameter: str,
    values: ArrayLike,
    period: float | Callable[[float], float],
    guess: Any = None,
    grazings: bool = False,
    most: int | None = None,
    progress: bool | Show = False,
) -> Branch:
    """Periodic orbits along a branch, through folds and past flips, stable or not.

    Parameters
    ----------
    make_system : callable
        The system at a value of the parameter, smooth in it.
    parameter : str
        Its name, for tables and messages.
    values : sequence of float
        The branch starts at the first value, with the orbit near the guess, and goes towards the last. It ends where it
        leaves their range. The first step is the range over their number.
    period : float or callable
        Period of the orbits; for a driven system a function of the parameter, ``lambda w: 2 * np.pi / w``.
    guess : as for ``periodic_orbit``
    grazings : bool
        Locate where a compliant stop is touched for the first or last time, also if the stability does not change.
        Limitation: if one touch of a contact begins and another ends between two points, neither is located. A damped
        stop that lets go and presses again within one contact is no grazing: where these two events vanish from
        ``.events``, the force touches 0 and the multipliers are continuous.
    most : int
        Number of orbits after which the branch ends; by default 20 for each of the values.
    progress : as for ``reference``

    Returns
    -------
    Branch
        ``.values .q .v .multipliers .stable .bifurcations .folds .flips .events .end``, ``.orbit(i)`` and
        ``.doubled(i)``.

    Raises
    ------
    InputError
        For values that are not two or more different numbers.
    SolverFailure
        If no orbit is near the guess. If a branch cannot be continued, ``.end`` states the reason.

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
        rule = "be two or more numbers, the last another than the first"
        raise InputError("values", values, rule, "np.linspace(a, b, 50)")
    function("make_system", make_system, "for example lambda value: ...")
    length = 0.0 if callable(period) else positive("period", period)
    of_value = period if callable(period) else lambda _: length
    limits = float(np.min(along)), float(np.max(along))
    afford("values", len(along), "take fewer", seconds=0.02 * len(along))
    most = MOST * len(along) if most is None else integer("most", most, 2)
    first = require_system(make_system(float(along[0])))
    start = periodic_orbit(first, of_value(float(along[0])), guess)
    follower = _Follower(make_system, of_value, parameter, limits, 1.0 / (len(along) - 1), most, grazings)
    follower.scale = start.path.units
    with within_float64("continuation", start.period), displayed(progress) as follower.show:
        normal = np.append(np.zeros(2 * first.size), np.sign(along[-1] - along[0]))
        point, _ = follower.point(np.concatenate([start.q, start.v]), float(along[0]), normal, normal)
        return follower.follow(point, follower.first_step)
