"""The exact solution with damping or several contacts: sums of complex exponentials, regime by regime.

    q(t_0 + tau) = Re [ W (c exp(lambda tau)) ] + Re [ X exp(i Omega (t_0 + tau)) ]

with the eigenvalues lambda of the regime's contact state, one of each conjugate pair, and the response
X to the drive. A contact state is in general not proportionally damped, hence the 2n eigenvalues.
Regimes (which contact is on which stop) are made as they are met, since there are 3^m of them
(exponential_tracer.py).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..drive import Drive
from ..system import System

Complex = Any  # arrays of complex128


@dataclass(frozen=True, eq=False)
class Regime:
    """lambda: (k,). W: (n, k). from_q, from_v: (k, n), c = from_q q + from_v q' of the homogeneous part.
    response: X (n, 1 + F) complex, to the constant and to exp(i Omega t) of every drive frequency."""

    eigenvalues: Complex
    W: Complex
    from_q: Complex
    from_v: Complex
    response: Complex


@dataclass(frozen=True, eq=False)
class ExponentialSolution:
    """The pieces: at times[i] the contacts are on the sides[i] (m,), homogeneous coefficients c[i]."""

    drive: Drive
    regimes: dict[tuple[int, ...], Regime]
    times: Array
    sides: NDArray[np.int64]
    c: list[Complex]
    evaluations: int

    @classmethod
    def joined(cls, parts: Sequence[ExponentialSolution]) -> ExponentialSolution:
        """One solution from consecutive ones of the same tracer."""
        return replace(
            parts[-1],
            times=np.concatenate([part.times for part in parts]),
            sides=np.concatenate([part.sides for part in parts]),
            c=[c for part in parts for c in part.c],
            evaluations=sum(part.evaluations for part in parts),
        )

    def first(self, count: int) -> ExponentialSolution:
        """The first ``count`` pieces."""
        return replace(self, times=self.times[:count], sides=self.sides[:count], c=self.c[:count])

    def regime(self, piece: int) -> Regime:
        return self.regimes[tuple(self.sides[piece].tolist())]

    def state_at_start(self, piece: int) -> tuple[Array, Array]:
        """q, q' (1, n) where a piece begins, from that piece."""
        return self._inside(piece, self.times[piece : piece + 1], np.eye(len(self.regime(piece).W)))

    def flow(self, piece: int, tau: float, dq: Array, dv: Array) -> tuple[Array, Array]:
        """The homogeneous flow of a piece's regime over tau: (n, k) -> (n, k)."""
        regime = self.regime(piece)
        c = (regime.from_q @ dq + regime.from_v @ dv) * np.exp(regime.eigenvalues * tau)[:, None]
        return (regime.W @ c).real, (regime.W @ (regime.eigenvalues[:, None] * c)).real

    @property
    def shortest_period(self) -> float:
        """Of the oscillating part; what is overdamped has decayed in a fraction of it."""
        fastest = [np.max(np.abs(r.eigenvalues.imag), initial=0.0) for r in self.regimes.values()]
        return 2.0 * np.pi / max(*fastest, *self.drive.frequencies, 1e-300)

    def offset(self, system: System, channel: int) -> Callable[[Array], tuple[Array, Array]]:
        """o(t) and o'(t) of a channel."""
        return self.drive.offset(system, channel)

    def states(self, t: Array) -> tuple[Array, Array]:
        """q, q' (k, n) at any times."""
        return self.observed(t, np.eye(len(next(iter(self.regimes.values())).W)))

    def observed(self, t: Array, row: Array) -> tuple[Array, Array]:
        """row @ q and its rate at any times, (k,), or (k, rows) for several rows."""
        piece = np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)
        shape = (len(t), *np.shape(row)[:-1])
        u, v = np.empty(shape), np.empty(shape)
        order = np.argsort(piece, kind="stable")
        for here in np.split(order, np.flatnonzero(np.diff(piece[order])) + 1):
            if len(here):
                u[here], v[here] = self._inside(int(piece[here[0]]), t[here], row)
        return u, v

    def _inside(self, piece: int, t: Array, row: Array) -> tuple[Array, Array]:
        """``observed`` at times of one piece."""
        regime = self.regime(piece)
        W, X, spin = row @ regime.W, row @ regime.response, spin_of(self.drive, t)
        moving = self.c[piece] * np.exp(np.multiply.outer(t - self.times[piece], regime.eigenvalues))
        rates = 1j * np.array([0.0, *self.drive.frequencies])
        u = (moving @ W.T).real + (spin @ X.T).real
        return u, ((moving * regime.eigenvalues) @ W.T).real + ((spin * rates) @ X.T).real

    def work(self, system: System, edges: Array) -> tuple[Array, Array]:
        """Work of the loads and viscous loss between consecutive edges, which include every switch.

        Products of exponentials, integrated in closed form: int_0^h exp(z s) ds = h (exp(z h) - 1)/(z h).
        """
        force = phasors(self.drive.split(system.loads, system.size)[0])  # (1 + F, n)
        offsets = phasors(self.drive.offsets(system)[0])  # (1 + F, channels)
        drive_rates = 1j * np.array([0.0, *self.drive.frequencies])
        piece = np.maximum(np.searchsorted(self.times, edges[:-1], side="right") - 1, 0)
        given, taken = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
        for j, (a, h) in enumerate(zip(edges[:-1], np.diff(edges), strict=True)):
            regime = self.regime(int(piece[j]))
            spin = spin_of(self.drive, np.array([a]))[0]
            rates = np.concatenate([regime.eigenvalues, drive_rates])
            moving = regime.W * (self.c[piece[j]] * np.exp(regime.eigenvalues * (a - self.times[piece[j]])))
            v = np.concatenate([moving, regime.response * spin], axis=1) * rates  # (n, terms)
            given[j] = _integral(force.T * spin, drive_rates, v, rates, h)
            q = np.concatenate([moving, regime.response * spin], axis=1)
            for i, contact in enumerate(system.contacts):
                side = self.sides[piece[j], i]
                if side and contact.offset is not None:
                    # F = kappa (g - row q - o), a sum of exponentials with the constant among them
                    o = offsets[:, i] * spin
                    depth = contact.row @ q
                    depth[len(regime.eigenvalues) :] += o
                    depth[len(regime.eigenvalues)] -= contact.stops.g2 if side > 0 else contact.stops.g1
                    F = -contact.stops.stiffness * depth
                    given[j] -= _integral(F[None], rates, (o * drive_rates)[None], drive_rates, h)
            if system.damped:
                taken[j] = _integral(v, rates, system.damping @ v, rates, h)
        return given, taken


def _integral(x: Complex, x_rates: Complex, y: Complex, y_rates: Complex, h: float) -> float:
    """int_0^h Re(sum_k x_k exp(x_rates_k s)) . Re(sum_l y_l exp(y_rates_l s)) ds; x (n, k), y (n, l)."""
    total = 0.0
    for other, rates in ((y, y_rates), (y.conj(), y_rates.conj())):
        z = h * np.add.outer(x_rates, rates)
        safe = np.where(z == 0.0, 1.0, z)
        total += float(np.sum((x.T @ other) * np.where(z == 0.0, 1.0, np.expm1(z) / safe)).real)
    return 0.5 * h * total


def spin_of(drive: Drive, t: Array) -> Complex:
    """(1, exp(i Omega t), ...), (k, 1 + F)."""
    return np.exp(1j * np.multiply.outer(t, np.array([0.0, *drive.frequencies])))


def phasors(basis: Array) -> Complex:
    """Rows g(t) @ basis (d, ...) as complex amplitudes of (1, exp(i Omega t), ...): cosine - i sine."""
    return np.concatenate([basis[:1].astype(complex), basis[2::2] - 1j * basis[1::2]])
