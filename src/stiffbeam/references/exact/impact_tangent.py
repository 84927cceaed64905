"""The tangent flow along a motion with rigid stops: what impacts do to neighbours, and what holding them does.

    dt = -(row dq-)/U-                         by which a neighbour is later, U = row q' + o'
    dq+ = dq- + (q'- - q'+) dt
    dq'+ = dq'- + q''- dt - J (row (dq'- + q''- dt) + o'' dt) - q''+ dt,   q'+ = q'- - J U-, Newton's law
    row dq = row dq' = 0                       while a contact is held

A contact that is held after impacts, e = 0 or at the end of its chatter, leaves of a neighbour's vector what is
M-orthogonal to M^-1 row^T: impulses along the row do not touch it. Source: Mueller, Chaos, Solitons & Fractals 5 (1995)
1671-1681, for linear systems with several contacts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...basics.arrays import Array
from .impacting import Solution
from .taylor import rate, value

ROUNDING = 1e-14  # of a vector, what a projection leaves of one along its own direction
FELT = 1e-12  # of the largest change of velocity along a row: less is rounding


@dataclass(frozen=True, eq=False)
class Neighbours:
    """What ``tangent.growth`` asks of a motion, here one with impacts."""

    solution: Solution

    @cached_property
    def blows(self) -> dict[int, set[int]]:
        """The contacts that are hit at the start of a stretch."""
        found: dict[int, set[int]] = {}
        for stretch, contact in self.solution.blows:
            found.setdefault(stretch, set()).add(contact)
        return found

    @property
    def times(self) -> Array:
        """The starts of the stretches."""
        return np.array(self.solution.times)

    def flow(self, piece: int, tau: float, dq: Array, dv: Array) -> tuple[Array, Array]:
        """Vectors (n, k) at tau after dq, dv in a stretch."""
        return self.solution.model.neighbours(dq, dv, self.solution.held[piece], tau)

    def across(self, piece: int, dq: Array, dv: Array) -> tuple[Array, Array]:
        """Vectors (n, k) at the start of a stretch from those at the end of the one before."""
        solution, stretch = self.solution, piece
        model, start = solution.model, solution.times[stretch]
        before, after = solution.held[stretch - 1], solution.held[stretch]
        v_after = solution.states[stretch][1]
        c, _ = model.stretch(solution.times[stretch - 1], *solution.states[stretch - 1], before)
        tau = start - solution.times[stretch - 1]
        v_before = rate(c, tau)
        turned = np.linalg.solve(model.rows @ model.back, model.rows @ (v_after - v_before))  # P
        new = [x for x in after if x not in before]
        felt = np.abs(turned) * np.diag(model.rows @ model.back) > FELT * np.max(np.abs(v_before), initial=0.0)
        hit = [x for x in np.flatnonzero(felt).tolist() if x not in before and x in self.blows.get(stretch, ())]
        if hit:
            hit += [x for x in before if x in after]  # held on, they take their part
            rows, back = model.rows[hit], model.back[:, hit]
            speeds = rows @ v_before + [model.shift(x, start)[1] for x in hit]
            first = int(np.argmax(np.abs(speeds)))
            late = -(rows[first] @ dq) / speeds[first]
            k = np.arange(2, len(c))
            a_before = value(c[2:] * (k * (k - 1.0))[:, None], tau)
            ahead, _ = model.stretch(start, *solution.states[stretch], after)
            e = np.array([0.0 if x in after else float(model.system.contacts[x].stops.restitution or 0.0) for x in hit])
            curve = np.array([2.0 * model.shift(x, start)[2] for x in hit])
            moved = dv + np.outer(a_before, late)
            kick = np.linalg.solve(rows @ back, (1.0 + e)[:, None] * (rows @ moved + np.outer(curve, late)))
            dq = dq + np.outer(v_before - v_after, late)
            dv = moved - back @ kick - np.outer(2.0 * ahead[2], late)
        return self.on_stops(piece, dq, dv) if new else (dq, dv)

    def on_stops(self, piece: int, dq: Array, dv: Array) -> tuple[Array, Array]:
        """Projection of vectors (n, k) while the contacts of a segment are held."""
        model, held = self.solution.model, list(self.solution.held[piece])
        if not held:
            return dq, dv
        rows, back = model.rows[held], model.back[:, held]
        inverse = np.linalg.inv(rows @ back)
        dq, dv = (_left(x - back @ (inverse @ (rows @ x)), x) for x in (dq, dv))
        return dq, dv


def _left(projected: Array, before: Array) -> Array:
    """Vectors (n, k) after a projection, zero where all that is left of them is its rounding."""
    sizes = np.linalg.norm(projected, axis=0), np.linalg.norm(before, axis=0)
    return np.where(sizes[0] > ROUNDING * sizes[1], projected, 0.0)
