"""Derivatives of the exact solution with respect to initial data and parameters: ``reference.derivative``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array, IntArray
from ...basics.progress import working
from ...basics.resources import afford
from ...basics.validation import InputError
from ...model.system import System
from ...model.system_data import slopes
from ...trajectory.trajectory import Reference
from .motion import Motion, Solver
from .tangent import GRAZE, Tangent, path_of_solution
from .variation import TERMS, Variation

AGREEMENT = 1e-3  # of the largest derivative so far: two copies that differ by more are past the horizon
LOOKS = 4  # parts of a step, two radians of the fastest motion, among which a peak is looked for
HALVINGS = 45  # of the part in which a peak is
# As large as the perturbations of the copies of a horizon.
COPY = 4.0 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Derivative:
    """Derivatives of a Reference with respect to p parameters, which are the last axis of every array.

    Attributes
    ----------
    wrt : tuple of str
        The p paths.
    t : (k,) array
        Fixed times of ``tip``, ``tip_velocity`` and ``state``.
    bounds : (p,) array
        Relative errors of the derivatives of the system's data.
    exists_until : float
        The first time from which no derivative exists; values from it on are NaN. Infinite where there is none.
    reason : str
        Reason why no derivative exists from then on; empty if it exists throughout.
    """

    reference: Reference = field(repr=False)
    wrt: tuple[str, ...]
    t: Array
    bounds: Array
    exists_until: float
    reason: str
    tangent: Tangent = field(repr=False)

    def __repr__(self) -> str:
        until = "" if np.isinf(self.exists_until) else f", exists until t = {self.exists_until:.6g}: {self.reason}"
        return f"<Derivative in {', '.join(self.wrt)}{until}>"

    def _masked(self, t: Array, values: Array) -> Array:
        values[t >= self.exists_until] = np.nan
        return values

    @cached_property
    @working("differentiating")
    def _at_outputs(self) -> tuple[IntArray, Array]:
        """Segments (k,) of the times t, and the motion and its derivatives there, (k, 1 + p, 2n)."""
        segments = self.tangent.segment_at(self.t)
        return segments, self.tangent.at(self.t, segments)

    @cached_property
    def _tip(self) -> Array:
        """Derivatives of the observed position and velocity, (k, 2, p)."""
        variation, (segments, z) = self.tangent.variation, self._at_outputs
        found = np.empty((len(self.t), 2, len(self.wrt)))
        for regime, part in self.tangent.parts(segments, 3 * z[0].size):
            series = regime.series(self.t[part], self.tangent.since[segments[part]], z[part], 2)
            seen, eta = series.u[:2, :, 1:, 0], series.eta[:2]
            if self._system.observe is not None:
                seen = eta[:, :, 1:] @ variation.data.observe + eta[:, :, 0] @ variation.slopes["observe"].T
            found[part] = np.moveaxis(seen, 0, 1)
        return self._masked(self.t, found)

    @property
    def tip(self) -> Array:
        """Derivative of the observed position, (k, p)."""
        return self._tip[:, 0]

    @property
    def tip_velocity(self) -> Array:
        """Derivative of the observed velocity, (k, p)."""
        return self._tip[:, 1]

    @cached_property
    def state(self) -> Array:
        """Derivative of (q, q'), (k, 2n, p)."""
        X, p = self.tangent.variation.X, len(self.wrt)
        afford("wrt", p, "ask for fewer parameters or times", floats=8.0 * len(self.t) * len(X) * p)
        parts = np.split(self._at_outputs[1][:, 1:], 2, axis=2)
        return self._masked(self.t, np.moveaxis(np.concatenate([x @ X.T for x in parts], axis=2), 1, 2))

    @property
    def _system(self) -> System:
        assert self.reference.system is not None
        return self.reference.system

    @cached_property
    @working("differentiating a copy for the horizon")
    def horizon(self) -> float:
        """Time to which the derivative of a copy of the motion agrees to 1e-3 of the largest, 0 where it never does."""
        # A copy as for the horizon of the motion: rounded otherwise, or with other segments.
        t, system, t_end = self.t, self._system, float(self.reference.provenance["t_end"])
        copy = Solver(system).perturbed(COPY, 1).solve(t_end)
        tangent = Tangent(self.tangent.variation, path_of_solution(system, copy, t_end))
        other = Derivative(self.reference, self.wrt, t, self.bounds, self.exists_until, self.reason, tangent)
        # Until a wave arrives the terms of the tip cancel to rounding.
        variation, modes = self.tangent.variation, self._at_outputs[1][:, 1:, : self.tangent.variation.n]
        row = variation.free.rows[0] if system.observe is None else variation.data.observe
        terms = np.abs(modes) @ np.abs(row) + np.abs(self.tip - modes @ row)
        scale = AGREEMENT * np.nan_to_num(np.abs(self.tip)) + GRAZE * np.nan_to_num(terms)
        apart = np.abs(other.tip - self.tip) > np.maximum.accumulate(scale, axis=0)
        wrong = np.flatnonzero(np.any(apart, axis=1) | (t >= self.exists_until))
        known = float(t[max(0, wrong[0] - 1)]) if len(wrong) else float(t[-1])
        return min(known, self.reference.horizon) if np.isfinite(self.reference.horizon) else known


def maxima(p: Array, h: Array) -> tuple[IntArray, Array]:
    """The inner maxima of polynomials p (K, S) on [0, h], h (S,): the number of each and its place."""
    rate = np.arange(1.0, len(p))[:, None] * p[1:]

    def rising(s: Array, which: Any) -> NDArray[np.bool_]:
        return np.polynomial.polynomial.polyval(s, rate[:, which], tensor=False) > 0.0

    edges = np.multiply.outer(np.linspace(0.0, 1.0, 1 + LOOKS), h)
    up = np.array([rising(s, slice(None)) for s in edges])
    part, which = np.nonzero(up[:-1] & ~up[1:])
    low, high = edges[part, which], edges[part + 1, which]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        before = rising(middle, which)
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return which, high


def chatter_ends(solution: Motion) -> list[float]:
    """Times at which impacts on a rigid stop have accumulated: 2 v/(a (1 - e)) after the one behind which the contact
    is held, which would have left it with v under the acceleration a into the stop."""
    times, contacts, sides, marks = solution.events
    meet, blows, ends = solution.made.free.meet, solution.blows, []
    for t, i, side, mark in zip(times.tolist(), contacts.tolist(), sides.tolist(), marks.tolist(), strict=True):
        e = float(solution.system.contacts[i].stops.restitution or 0.0)
        if abs(side) != 1 or e == 0.0:
            continue
        held = np.flatnonzero(solution.sides[solution.piece_at(np.array([t]))[0]])
        speed = np.abs(blows.before[(blows.mark == mark) & (blows.contact == i)])
        if i in held and len(speed) and e < 1.0:
            reaction = abs(float(solution.reactions(np.array([t]))[0, i]))
            pull = reaction / float(np.linalg.inv(meet[np.ix_(held, held)])[held == i, held == i][0])
            t += 2.0 * float(speed[-1]) / (pull * (1.0 - e)) if pull > 0.0 else 0.0
        ends.append(t)
    return ends


@working("differentiating")
def derivative(reference: Reference, wrt: Sequence[Any], t: Array) -> Derivative:
    """Derivatives of an exact solution, see ``Reference.derivative``."""
    system, solution = reference.system, reference.solution
    assert system is not None
    if not isinstance(solution, Motion):
        rule, remedy = 'be of method "exact" and solved in this process for a derivative', "take stiffbeam.reference"
        raise InputError("reference", reference.provenance["method"], rule, remedy)
    names, columns, bounds = slopes(system, wrt)
    t_end = float(reference.provenance["t_end"])
    path = path_of_solution(system, solution, t_end)
    size = (2.0 * system.size + 8.0) * len(names)
    afford("wrt", len(names), "ask for fewer parameters", floats=3.0 * size * len(path.times))
    tangent = Tangent(Variation(system, columns), path)
    exists, reason = min(ends_of(system, solution, tangent), default=(np.inf, ""))
    return Derivative(reference, tuple(names), t, bounds, exists, reason, tangent)


def ends_of(system: System, solution: Any, tangent: Tangent) -> list[tuple[float, str]]:
    """Times from which a motion has no derivative, each with the reason.

    Undamped compliant stops have none of these: their force is continuous, and so is the derivative of the flow.
    """
    ends = [(t, "a contact grazes its stop") for t in tangent.grazes]
    ends += [(t, "two contacts are hit at one time") for t in tangent.ties]
    if system.rigid:
        ends += [(t, "the impacts of a chatter end") for t in chatter_ends(solution)]
        if 0 in tangent.path.hits:
            ends.append((0.0, "an impact at the start"))
    # On rigid and damped stops velocity or force jumps: a near miss is another motion than an impact.
    for contact, stops in enumerate(x.stops for x in system.contacts):
        if stops.rigid or stops.damping > 0.0:
            for side, _ in stops.sides:
                ends += [(t, "a contact grazes its stop") for t in near_misses(tangent, contact, side)]
                if starts_on_stop(tangent, contact, side):
                    ends.append((0.0, "a contact starts on its stop, which the parameter moves away or into it"))
    return ends


def near_misses(tangent: Tangent, contact: int, side: int) -> list[float]:
    """Times at which an open contact reaches its stop to rounding and turns back."""
    owner, at, h, z = tangent.cut()

    def gaps(owner: IntArray, t: Array, z: Array) -> Iterator[tuple[IntArray, Array, Array]]:
        """Parts of the times, the series of the depth there, negative in the gap, and the size of its terms."""
        for regime, part in tangent.parts(owner, (TERMS + 1) * z[0].size):
            series = regime.series(t[part], tangent.since[owner[part]], z[part][:, None])
            yield part, side * tangent.gap(series, contact, side)[:, :, 0], tangent.size(series, contact, side)

    def near(owner: IntArray, t: Array) -> NDArray[np.bool_]:
        found = np.zeros(len(t), bool)
        for part, depth, size in gaps(owner, t, tangent.states(t, owner)):
            found[part] = depth[0] > -tangent.graze * size
        return found

    here = np.flatnonzero((tangent.path.sides[owner, contact] == 0) & (h > 0.0))
    owner, at, h, z = owner[here], at[here], h[here], z[here]
    tops, segment = [np.zeros(0)], [np.zeros(0, np.int64)]
    for part, depth, _ in gaps(owner, at, z) if len(here) else ():
        which, s = maxima(depth, h[part])
        tops.append(at[part[which]] + s)
        segment.append(owner[part[which]])
    top, own = np.concatenate(tops), np.concatenate(segment)
    if not len(top):
        return []
    # Of a contact that leaves its stop slowly rounding makes maxima: half the way to one of these it is no farther.
    return top[near(own, top) & ~near(own, 0.5 * (tangent.path.times[own] + top))].tolist()


def starts_on_stop(tangent: Tangent, contact: int, side: int) -> bool:
    """Return True if a contact starts on its stop to rounding, and its gap there depends on a parameter."""
    variation, n, series = tangent.variation, tangent.variation.n, tangent.at_start(0)
    row, z, dz = variation.free.rows[contact], tangent.z[0], tangent.dz[0]
    gap, size = tangent.gap(series, contact, side)[:2, 0], float(tangent.size(series, contact, side)[0])
    if abs(float(gap[0, 0])) > tangent.graze * size:
        return False
    speeds = np.abs(row) @ np.abs(z[n:]) + abs(float(gap[1, 0] - row @ z[n:]))
    # At rest there, a rigid contact is hit or leaves as the speed is turned.
    both = tangent.rigid and abs(float(gap[1, 0])) <= tangent.graze * speeds
    for k, part in enumerate([slice(0, n), slice(n, 2 * n)][: 1 + both]):
        # Sums far below their terms are cancellation: the gap does not depend on the parameter.
        terms = np.abs(dz[:, part]) @ np.abs(row) + np.abs(gap[k, 1:] - dz[:, part] @ row)
        if np.any(np.abs(gap[k, 1:]) > 1e-12 * terms):
            return True
    return False
