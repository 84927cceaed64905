"""The exact solution without damping and with at most one contact: three regimes, all of it compiled.

The regimes are free and on either stop, each with modes of its own (two eigendecompositions: the stops
share their stiffness). In a regime every mode is known in closed form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...model.drive import Drive
from ...model.modes import Modes
from ...model.system import System
from ...piecewise.measures import panels
from ...piecewise.oscillation import oscillations
from .following import Regimes
from .pieces import amplitudes, grow, observe, press


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """The pieces: at times[i] regime[i] begins with the homogeneous part h, h' of rows i.

    regime: 0 free, +1 upper, -1 lower. h, rate: (pieces, n) in the modes of that regime. bases: the modes without
    contact and on a stop.
    """

    drive: Drive
    bases: tuple[Modes, Modes]
    regimes: Regimes
    times: Array
    regime: NDArray[np.int64]
    h: Array
    rate: Array
    evaluations: int

    @classmethod
    def joined(cls, parts: Sequence[Solution]) -> Solution:
        """One solution from consecutive ones of the same tracer."""
        arrays = {name: np.concatenate([getattr(p, name) for p in parts]) for name in ("times", "regime", "h", "rate")}
        return replace(parts[-1], **arrays, evaluations=sum(part.evaluations for part in parts))

    @property
    def sides(self) -> NDArray[np.int64]:
        """chi in every piece, (pieces, 1); 0 without contact."""
        return self.regime[:, None]

    def first(self, count: int) -> Solution:
        """The first ``count`` pieces."""
        part = (x[:count] for x in (self.times, self.regime, self.h, self.rate))
        times, regime, h, rate = part
        return replace(self, times=times, regime=regime, h=h, rate=rate)

    def state_at_start(self, piece: int) -> tuple[Array, Array]:
        """q, q' (1, n) where a piece begins, from that piece."""
        return self.states_in(self.times[piece : piece + 1], np.array([piece]))

    def flow(self, piece: int, tau: float, dq: Array, dv: Array) -> tuple[Array, Array]:
        """The homogeneous flow of a piece's regime over tau: (n, k) -> (n, k)."""
        basis = self.bases[int(self.regime[piece])]
        turned = np.empty((3, len(basis.omega)))
        oscillations(basis.omega, tau, *turned)
        c, s = turned[0][:, None], turned[1][:, None]
        eta, rate = basis.to_modal(dq.T).T, basis.to_modal(dv.T).T
        return basis.shapes @ (c * eta + s * rate), basis.shapes @ (c * rate - basis.omega[:, None] ** 2 * s * eta)

    @property
    def shortest_period(self) -> float:
        """Of the modes of all regimes and of the drive."""
        return 2.0 * np.pi / max(float(np.max(self.regimes.omegas)), *self.drive.frequencies, 1e-300)

    @property
    def periods(self) -> Array:
        """The shortest of every piece's modes and of the drive, (pieces,)."""
        fastest = self.regimes.omegas[np.abs(self.regime), -1]
        return 2.0 * np.pi / np.maximum(fastest, max(*self.drive.frequencies, 0.0, 1e-300))

    @property
    def fastest_decay(self) -> float:
        """Zero: nothing is damped."""
        return 0.0

    def work(self, system: System, edges: Array) -> tuple[Array, Array]:
        """Work of the loads and viscous loss between consecutive edges, which include every switch.

        Gauss-Legendre quadrature on panels no longer than the shortest period is exact to rounding.
        """
        nodes, weights = np.polynomial.legendre.leggauss(10)
        index, left, width = panels(self.shortest_period, edges[:-1], edges[1:])
        basis, _ = self.drive.split(system.loads, system.size)
        moving = [(c, self.offset(system, i)) for i, c in enumerate(system.contacts) if c.offset is not None]
        work = np.zeros(len(left))
        for part in np.array_split(np.arange(len(left)), max(1, len(left) // 20_000)):
            t = left[part][:, None] + width[part][:, None] * (nodes + 1.0) / 2.0
            g, power = self.drive.coefficients(t.ravel()), np.zeros(t.size)
            for k in np.flatnonzero(np.any(basis, axis=1)):
                power += g[:, k] * self.observed(t.ravel(), basis[k])[1]
            for contact, offset in moving:
                o, o_rate = offset(t.ravel())
                power -= contact.stops.force(self.observed(t.ravel(), contact.row)[0] + o) * o_rate
            work[part] = power.reshape(t.shape) @ weights * width[part] / 2.0
        total = np.bincount(index, work, len(edges) - 1)
        return total, np.zeros_like(total)

    def piece_at(self, t: Array) -> NDArray[np.int64]:
        """The piece that each time t (k,) lies in; a switch belongs to the piece it begins."""
        return np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)

    def states(self, t: Array) -> tuple[Array, Array]:
        """q, q' (k, n) at any times."""
        return self.states_in(t, self.piece_at(t))

    def states_in(self, t: Array, piece: NDArray[np.int64]) -> tuple[Array, Array]:
        """q, q' (k, n) as the given pieces have them at times t, which may be the ends of those."""
        t, own, modal = np.array(t, float), self.regime[piece], np.empty((2, len(t), self.h.shape[1]))
        amplitudes(self.regimes, self.times, self.regime, self.h, self.rate, t, piece, *modal)
        q, v = np.empty_like(modal)
        for basis, here in zip(self.bases, (own == 0, own != 0), strict=True):
            q[here], v[here] = basis.to_nodal(modal[0, here]), basis.to_nodal(modal[1, here])
        return q, v

    def press(
        self, system: System, contact: int, starts: Array, ends: Array, sides: NDArray[np.int64]
    ) -> tuple[Array, Array]:
        """Peak |sigma| and the integral of |sigma| in the spans [starts, ends] (k,) of contact."""
        deepest, depths = np.zeros((2, len(starts)))
        first = self.piece_at(starts)
        press(self.regimes, self.times, self.regime, self.h, self.rate, starts, ends, first, deepest, depths)
        kappa = system.contacts[contact].stops.spring(1)[0]
        return kappa * deepest, kappa * depths

    def grow(self, edges: Array, dq: Array, dv: Array, enough: float) -> tuple[int, Array]:
        """ln of the growth of unit tangent vectors dq, dv (n, vectors) at the edges (k,), and how far that got: see
        ``following.grow``."""
        piece = self.piece_at(edges[:-1])
        basis = self.bases[int(self.regime[piece[0]])]
        q, v = (np.ascontiguousarray(basis.to_modal(x.T)) for x in (dq, dv))
        logs = np.zeros((len(edges), dq.shape[1]))
        return grow(self.regimes, self.regime, piece, np.diff(edges), q, v, enough, logs), logs

    def offset(self, system: System, channel: int) -> Callable[[Array], tuple[Array, Array]]:
        """o(t) and o'(t) of a channel."""
        return self.drive.offset(system, channel)

    def observed(self, t: Array, row: Array) -> tuple[Array, Array]:
        """row @ q and its rate at any times, (k,)."""
        t, (u, v) = np.array(t, float), np.empty((2, len(t)))
        rows = np.stack([basis.force(row) for basis in self.bases])
        waves = np.stack([rows[abs(side)] @ self.regimes.particulars[side] for side in (0, 1, -1)])
        observe(self.regimes, self.times, self.regime, self.h, self.rate, rows, waves, t, self.piece_at(t), u, v)
        return u, v
