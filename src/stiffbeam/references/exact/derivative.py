"""Derivatives of the exact solution with respect to initial data and parameters: ``reference.derivative``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array, IntArray
from ...basics.resources import afford, working
from ...basics.validation import InputError
from ...model.system_data import slopes
from ...trajectory.trajectory import Reference
from .motion import Motion, Solver
from .tangent import GRAZE, STEP, Tangent, Variation

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

    @cached_property
    @working("differentiating")
    def _at_outputs(self) -> Array:
        """The motion at the times t and its derivatives, NaN where these do not exist, (k, 1 + p, N)."""
        y = self.tangent.at(self.t, self.tangent.segment_at(self.t))
        y[self.t >= self.exists_until, 1:] = np.nan
        return y

    def _of_form(self, name: str) -> Array:
        """Derivative (k, p) of a form of the variation, such as the tip."""
        y, variation = self._at_outputs, self.tangent.variation
        slopes = np.array([np.imag(getattr(x, name)) / STEP for x in variation.beside])
        return y[:, 1:] @ getattr(variation.base, name) + y[:, 0] @ slopes.T

    @cached_property
    def tip(self) -> Array:
        """Derivative of the observed position, (k, p)."""
        return self._of_form("seen")

    @cached_property
    def tip_velocity(self) -> Array:
        """Derivative of the observed velocity, (k, p)."""
        return self._of_form("seen_rate")

    @cached_property
    def state(self) -> Array:
        """Derivative of (q, q'), (k, 2n, p)."""
        X, p = self.tangent.variation.X, len(self.wrt)
        afford("wrt", p, "ask for fewer parameters or times", floats=8.0 * len(self.t) * len(X) * p)
        y, n = self._at_outputs[:, 1:], len(X)
        parts = [y[:, :, :n] @ X.T, y[:, :, n : 2 * n] @ X.T]
        return np.moveaxis(np.concatenate(parts, axis=2), 1, 2)

    @cached_property
    @working("differentiating a copy for the horizon")
    def horizon(self) -> float:
        """Time to which the derivative of a copy of the motion agrees to 1e-3 of the largest, 0 where it never does."""
        # A copy as for the horizon of the motion: rounded otherwise, or with other segments.
        t, variation, t_end = self.t, self.tangent.variation, float(self.reference.provenance["t_end"])
        system = variation.system
        copy = Solver(system).perturbed(COPY, 1).solve(t_end)
        tangent = Tangent(variation, copy, t_end)
        other = Derivative(self.reference, self.wrt, t, self.bounds, self.exists_until, self.reason, tangent)
        # Until a wave arrives the terms of the tip cancel to rounding.
        modes, row = self._at_outputs[:, 1:, : variation.n], variation.base.seen[: variation.n]
        terms = np.abs(modes) @ np.abs(row) + np.abs(self.tip - modes @ row)
        scale = AGREEMENT * np.nan_to_num(np.abs(self.tip)) + GRAZE * np.nan_to_num(terms)
        apart = np.abs(other.tip - self.tip) > np.maximum.accumulate(scale, axis=0)
        wrong = np.flatnonzero(np.any(apart, axis=1) | (t >= self.exists_until))
        known = float(t[max(0, wrong[0] - 1)]) if len(wrong) else float(t[-1])
        return min(known, self.reference.horizon) if np.isfinite(self.reference.horizon) else known


def chatter_ends(solution: Motion) -> list[float]:
    """Times at which impacts on a rigid stop have accumulated: 2 v/(a (1 - e)) after the one behind which the contact
    is held, which would have left it with v under the acceleration a into the stop."""
    times, contacts, sides, marks = solution.events
    meet, blows, ends = solution.free.meet, solution.blows, []
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
    size = (2.0 * system.size + 8.0) * len(names)
    afford("wrt", len(names), "ask for fewer parameters", floats=3.0 * size * len(solution.times))
    tangent = Tangent(Variation(system, columns), solution, t_end)
    exists, reason = min(ends_of(tangent), default=(np.inf, ""))
    return Derivative(reference, tuple(names), t, bounds, exists, reason, tangent)


def ends_of(tangent: Tangent) -> list[tuple[float, str]]:
    """Times from which a motion has no derivative, each with the reason.

    Of undamped compliant stops a rest alone has none: their force is continuous, and so is the derivative of the flow.
    """
    system = tangent.variation.system
    ends = [(t, "a contact grazes its stop") for t in tangent.grazes]
    ends += [(t, "two contacts are hit at one time") for t in tangent.ties]
    if system.rigid:
        ends += [(t, "the impacts of a chatter end") for t in chatter_ends(tangent.motion)]
        if 0 in tangent.hits:
            ends.append((0.0, "an impact at the start"))
    # On rigid and damped stops velocity or force jumps: a near miss is another motion than an impact.
    for contact, stops in enumerate(x.stops for x in system.contacts):
        for side in stops.sides:
            ends += [(t, "a contact rests on its stop without a force") for t in rests(tangent, contact, side)]
            if stops.rigid or stops.damping > 0.0:
                ends += [(t, "a contact grazes its stop") for t in near_misses(tangent, contact, side)]
                if starts_on_stop(tangent, contact, side):
                    ends.append((0.0, "a contact starts on its stop, which the parameter moves away or into it"))
    return ends


def _near(tangent: Tangent, contact: int, side: int, t: Array, owner: IntArray) -> NDArray[np.bool_]:
    """True where an open contact is at its stop to rounding."""
    base, y = tangent.variation.base, tangent.motion_at(t, owner)
    form, gap = base.position[contact], base.gap(contact, side)
    size = np.abs(y) @ np.abs(form) + abs(np.sum(form - gap))
    return side * (y @ gap) >= -tangent.graze * size


def rests(tangent: Tangent, contact: int, side: int) -> list[float]:
    """The time from which an open contact stays at its stop to rounding, of which a parameter, or a direction of the
    start, moves it off or into it, or from which a rigid stop holds one without a reaction."""
    if tangent.rigid:
        held = np.flatnonzero((tangent.sides[:, contact] != 0) & (tangent.lengths > 0.0))
        starts = tangent.times[held]
        impulses = tangent.motion.press(contact, starts, starts + tangent.lengths[held])[1]
        return starts[impulses == 0.0][:1].tolist()
    owner, at, h, _ = tangent.cut()
    there = np.all([_near(tangent, contact, side, at + s * h, owner) for s in (0.0, 0.5, 1.0)], axis=0)
    for i in np.flatnonzero((tangent.sides[:, contact] == 0) & (tangent.lengths > 0.0)).tolist():
        if np.all(there[owner == i]):
            y = tangent.at(tangent.times[i : i + 1] + 0.5 * tangent.lengths[i], np.array([i]))[0]
            if _depend(tangent, y, contact, side)[0]:
                return [float(tangent.times[i])]
    return []


def _depend(tangent: Tangent, y: Array, contact: int, side: int) -> list[bool]:
    """True where the gap, and the rate, of a contact in y (1 + D, N) depend on a parameter: sums far below their terms
    are cancellation."""
    row, n = tangent.variation.data.rows[contact], tangent.variation.n
    parts = zip(tangent.gap(y, contact, side)[1], (y[1:, :n], y[1:, n : 2 * n]), strict=True)
    moved = ((np.abs(x), np.abs(part) @ np.abs(row) + np.abs(x - part @ row)) for x, part in parts)
    return [bool(np.any(size > 1e-12 * terms)) for size, terms in moved]


def near_misses(tangent: Tangent, contact: int, side: int) -> list[float]:
    """Times at which an open contact reaches its stop to rounding and turns back."""
    owner, at, h, _ = tangent.cut()
    here = np.flatnonzero((tangent.sides[owner, contact] == 0) & (h > 0.0))

    def approaches(t: Array, owner: IntArray) -> NDArray[np.bool_]:
        return side * (tangent.motion_at(t, owner) @ tangent.variation.base.rate[contact]) > 0.0

    # Parts of steps in which the approach ends, halved until they are a time.
    times = [at[here] + s * h[here] for s in np.linspace(0.0, 1.0, 1 + LOOKS)]
    up = np.array([approaches(t, owner[here]) for t in times])
    part, which = np.nonzero(up[:-1] & ~up[1:])
    low, high, owner = np.array(times)[part, which], np.array(times)[part + 1, which], owner[here][which]
    for _ in range(HALVINGS if len(low) else 0):
        middle = 0.5 * (low + high)
        before = approaches(middle, owner)
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    # Of a contact that leaves its stop slowly rounding makes maxima: half the way to one of these it is no farther.
    here, half = (_near(tangent, contact, side, t, owner) for t in (high, 0.5 * (tangent.times[owner] + high)))
    return high[here & ~half].tolist()


def starts_on_stop(tangent: Tangent, contact: int, side: int) -> bool:
    """Return True if a contact starts on its stop to rounding, and its gap there depends on a parameter."""
    n, row = tangent.variation.n, tangent.variation.data.rows[contact]
    y = tangent.whole(0, 0.0, tangent.z[0], tangent.dz[0])
    (gap, rate), _, size = tangent.gap(y, contact, side)
    if abs(gap) > tangent.graze * size:
        return False
    v = y[0, n : 2 * n]
    speeds = np.abs(row) @ np.abs(v) + abs(float(rate - row @ v))
    # At rest there, a rigid contact is hit or leaves as the speed is turned.
    both = tangent.rigid and abs(rate) <= tangent.graze * speeds
    return any(_depend(tangent, y, contact, side)[: 1 + both])
