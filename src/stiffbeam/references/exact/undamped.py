"""The exact solution without damping and with at most one contact: three regimes, all of it compiled.

The regimes are free and on either stop, each with modes of its own (two eigendecompositions: the stops
share their stiffness). In a regime every mode is known in closed form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...model.drive import Drive
from ...model.modes import Modes
from ...model.system import System
from .exact_measures import panels
from .oscillation import responses
from .switching import follow_row


class Regime(NamedTuple):
    """eta'' + omega^2 eta = c + harmonics, eta = h + P g(t), in one contact regime.

    omega: (n,). level: c (n,). particular: P (n, d), d-th drive coefficient to modal amplitude, its
    constant column zero. row: (n,) the contact position's modal row; offset: (d,) its offset in g.
    close: (p, 2), the pairs of a mode and a drive frequency so close that P would be large and h cancel
    it; P is zero there, and the mode answers that drive from rest at the start of every piece. close_force:
    (p, 2), the modal force of a pair's sine and cosine.
    """

    omega: Array
    level: Array
    particular: Array
    row: Array
    offset: Array
    close: NDArray[np.int64]
    close_force: Array


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """The pieces: at times[i] regime[i] begins with the homogeneous part h, h' of rows i.

    regime: 0 free, +1 upper, -1 lower. h, rate: (pieces, n) in the modes of that regime.
    """

    drive: Drive
    bases: dict[int, Modes]
    regimes: dict[int, Regime]
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
        side = int(self.regime[piece])
        eta, rate = self.modal(self.times[piece : piece + 1], np.array([piece]), side)
        return self.bases[side].to_nodal(eta), self.bases[side].to_nodal(rate)

    def flow(self, piece: int, tau: float, dq: Array, dv: Array) -> tuple[Array, Array]:
        """The homogeneous flow of a piece's regime over tau: (n, k) -> (n, k)."""
        basis = self.bases[int(self.regime[piece])]
        c, s, _ = (x[:, None] for x in _oscillation(basis.omega, tau))
        eta, rate = basis.to_modal(dq.T).T, basis.to_modal(dv.T).T
        return basis.shapes @ (c * eta + s * rate), basis.shapes @ (c * rate - basis.omega[:, None] ** 2 * s * eta)

    def modal(self, t: Array, piece: NDArray[np.int64], regime: int) -> tuple[Array, Array]:
        """eta, eta' (k, n) at times t inside the given pieces, all of one regime."""
        law = self.regimes[regime]
        tau = (t - self.times[piece])[:, None]
        still = np.zeros((len(tau), len(law.omega)))
        c, s, v = _oscillation(law.omega, tau) if np.any(tau) else (still + 1.0, still, still)
        h, rate = self.h[piece], self.rate[piece]
        g = self.drive.coefficients(t)
        eta = h * c + rate * s + law.level * v + g @ law.particular.T
        velocity = rate * c + (law.level - law.omega**2 * h) * s + g @ self.drive.derivative().T @ law.particular.T
        for (mode, k), close_force in zip(law.close.tolist(), law.close_force, strict=True):
            w, frequency = law.omega[mode], self.drive.frequencies[k]
            sine, cosine = np.sin(frequency * self.times[piece]), np.cos(frequency * self.times[piece])
            a, b = close_force[0] * sine + close_force[1] * cosine, close_force[0] * cosine - close_force[1] * sine
            from_cosine, from_sine = np.empty((2, len(tau)))
            responses(w, frequency, tau[:, 0], from_cosine, from_sine)
            eta[:, mode] += a * from_cosine + b * from_sine
            velocity[:, mode] += a * (s[:, mode] - frequency * from_sine) + b * frequency * from_cosine
        return eta, velocity

    @property
    def shortest_period(self) -> float:
        """Of the modes of all regimes and of the drive."""
        fastest = [float(r.omega[-1]) for r in self.regimes.values()]
        return 2.0 * np.pi / max(*fastest, *self.drive.frequencies, 1e-300)

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
        n = len(self.h[0])
        q, v = np.empty((len(t), n)), np.empty((len(t), n))
        for regime, basis in self.bases.items():
            here = np.flatnonzero(self.regime[piece] == regime)
            for part in np.array_split(here, max(1, len(here) * n // 2_000_000)):
                eta, rate = self.modal(t[part], piece[part], regime)
                q[part], v[part] = basis.to_nodal(eta), basis.to_nodal(rate)
        return q, v

    def offset(self, system: System, channel: int) -> Callable[[Array], tuple[Array, Array]]:
        """o(t) and o'(t) of a channel."""
        return self.drive.offset(system, channel)

    def observed(self, t: Array, row: Array) -> tuple[Array, Array]:
        """row @ q and its rate at any times, (k,)."""
        u, v = np.empty(len(t)), np.empty(len(t))
        piece, frequencies = self.piece_at(t), np.array(self.drive.frequencies)
        for regime, basis in self.bases.items():
            here, law, seen = np.flatnonzero(self.regime[piece] == regime), self.regimes[regime], basis.force(row)
            position, velocity = np.empty((2, len(here)))
            follow_row(
                t[here], piece[here], self.times, self.h, self.rate, law.omega, law.level, seen,
                seen @ law.particular, frequencies, law.close, law.close_force, position, velocity,
            )  # fmt: skip
            u[here], v[here] = position, velocity
        return u, v


def _oscillation(omega: Array, tau: Array | float) -> tuple[Array, Array, Array]:
    """cos(omega tau), sin(omega tau)/omega and (1 - cos(omega tau))/omega^2, regular at omega = 0."""
    x = omega * tau
    c, s = np.cos(x), np.sin(x)
    versine = np.where(c < 0.5, 1.0 - c, s * s / (1.0 + np.abs(c)))
    slow = x < 1e-4
    if not np.any(slow):
        return c, s / omega, versine / omega**2
    divisor = np.where(omega > 0.0, omega, 1.0)
    s = np.where(slow, tau * (1.0 - x * x / 6.0), s / divisor)
    return c, s, np.where(slow, 0.5 * tau * tau * (1.0 - x * x / 12.0), versine / divisor**2)
