"""The exact solution with damping or several contacts: sums of complex exponentials, regime by regime.

    q(t_0 + tau) = Re [ W (c exp(lambda tau) + sum_j f_j psi_j(lambda, tau)) ] + Re [ X exp(i Omega (t_0 + tau)) ]

with the eigenvalues lambda of the regime's contact state, one of each conjugate pair, the answers psi_j to
forces f_j tau^j (polynomial_answer.py), and the response X to the drive. Sampled functions of time are
polynomials between their samples, where a piece ends too. A contact state is in general not proportionally
damped, hence the 2n eigenvalues. Regimes (which contact is on which stop) are made as they are met, since
there are 3^m of them (exponential_tracer.py).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...model.drive import Drive
from ...model.system import System
from ...piecewise.linear import Complex, Regime, phasors, spin_of


@dataclass(frozen=True, eq=False, repr=False)
class ExponentialSolution:
    """The pieces: at times[i] the contacts are on the sides[i] (m,), see events; homogeneous parts c[i]."""

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
        """The regime of a piece."""
        return self.regimes[tuple(self.sides[piece].tolist())]

    def state_at_start(self, piece: int) -> tuple[Array, Array]:
        """q, q' (1, n) where a piece begins, from that piece."""
        return self.states_in(self.times[piece : piece + 1], np.array([piece]))

    def flow(self, piece: int, tau: float, dq: Array, dv: Array) -> tuple[Array, Array]:
        """The homogeneous flow of a piece's regime over tau: (n, k) -> (n, k)."""
        regime = self.regime(piece)
        y = regime.free(regime.from_q @ dq + regime.from_v @ dv, tau)
        return (regime.W @ y).real, (regime.W_rate @ y).real

    @property
    def shortest_period(self) -> float:
        """Of the oscillating part."""
        fastest = [np.max(np.abs(r.eigenvalues.imag), initial=0.0) for r in self.regimes.values()]
        return 2.0 * np.pi / max(*fastest, *self.drive.frequencies, 1e-300)

    @property
    def periods(self) -> Array:
        """The shortest of the oscillating part of every piece, (pieces,)."""
        own = {key: np.max(np.abs(r.eigenvalues.imag), initial=0.0) for key, r in self.regimes.items()}
        fastest = np.array([own[tuple(line)] for line in self.sides.tolist()])
        return 2.0 * np.pi / np.maximum(fastest, max(*self.drive.frequencies, 0.0, 1e-300))

    @property
    def fastest_decay(self) -> float:
        """The largest decay rate of any mode in any regime, 1/time."""
        return max(float(-np.min(r.eigenvalues.real, initial=0.0)) for r in self.regimes.values())

    def press(
        self, system: System, contact: int, starts: Array, ends: Array, sides: NDArray[np.int64]
    ) -> tuple[Array, Array]:
        """Peak |sigma| and the integral of |sigma| in the spans [starts, ends] (k,) of contact on ``sides``."""
        from ...piecewise.measures import pressed_by

        return pressed_by(system, self, contact, starts, ends, sides)

    def offset(self, system: System, channel: int) -> Callable[[Array], tuple[Array, Array]]:
        """o(t) and o'(t) of a channel."""
        return self.drive.offset(system, channel)

    def piece_at(self, t: Array) -> NDArray[np.int64]:
        """The piece that each time t (k,) lies in; a switch belongs to the piece it begins."""
        return np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)

    def states(self, t: Array) -> tuple[Array, Array]:
        """q, q' (k, n) at any times."""
        return self.states_in(t, self.piece_at(t))

    def states_in(self, t: Array, piece: NDArray[np.int64]) -> tuple[Array, Array]:
        """q, q' (k, n) as the given pieces have them at times t, which may be the ends of those."""
        return self._inside(piece, t, np.eye(len(next(iter(self.regimes.values())).W)))

    def observed(self, t: Array, row: Array) -> tuple[Array, Array]:
        """row @ q and its rate at any times, (k,), or (k, rows) for several rows."""
        return self._inside(self.piece_at(t), t, row)

    @cached_property
    def _by_regime(self) -> tuple[list[Regime], list[Complex], NDArray[np.int64], NDArray[np.int64]]:
        """The regimes met, the coefficients (pieces, k) of each; the regime of every piece, its place in there."""
        met: dict[tuple[int, ...], list[Complex]] = {}
        which, place = np.empty((2, len(self.times)), np.int64)
        for piece, key in enumerate(map(tuple, self.sides.tolist())):
            own = met.setdefault(key, [])
            place[piece] = len(own)
            own.append(self.c[piece])
        number = {key: i for i, key in enumerate(met)}
        which[:] = [number[key] for key in map(tuple, self.sides.tolist())]
        return [self.regimes[key] for key in met], [np.array(own) for own in met.values()], which, place

    def _inside(self, piece: NDArray[np.int64], t: Array, row: Array) -> tuple[Array, Array]:
        """``observed`` at times of the given pieces."""
        regimes, coefficients, which, place = self._by_regime
        shape = (len(t), *np.shape(row)[:-1])
        u, v = np.empty(shape), np.empty(shape)
        own = which[piece]
        for i, regime in enumerate(regimes):
            here = np.flatnonzero(own == i)
            moved, response = ((row @ regime.W).T, (row @ regime.response).T)
            moved_rate, response_rate = (row @ regime.W_rate).T, (row @ regime.response_rate).T
            terms = len(regime.eigenvalues) * (1 + self.drive.order)
            for part in np.array_split(here, max(1, len(here) * terms // 1_000_000)):
                if not len(part):
                    continue
                at, spin = piece[part], spin_of(self.drive, t[part])
                begun = self.times[at]
                force = regime.push @ self.drive.polynomials(begun)
                y = regime.ahead(coefficients[i][place[at]], spin_of(self.drive, begun), force, t[part] - begun)
                u[part] = (y @ moved).real + (spin @ response).real
                v[part] = (y @ moved_rate).real + (spin @ response_rate).real
        return u, v

    def work(self, system: System, edges: Array) -> tuple[Array, Array]:
        """Work of the loads and viscous loss between consecutive edges, which include every switch.

        Products of exponentials, integrated in closed form: int_0^h exp(z s) ds = h (exp(z h) - 1)/(z h).
        With records or chains by quadrature, see ``measured_work``.
        """
        if self.drive.records or any(regime.chains for regime in self.regimes.values()):
            return measured_work(self, system, edges)
        force = phasors(self.drive.split(system.loads, system.size)[0])  # (1 + F, n)
        offsets = phasors(self.drive.offsets(system)[0])  # (1 + F, channels)
        drive_rates = 1j * np.array([0.0, *self.drive.frequencies])
        piece = self.piece_at(edges[:-1])
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
                if abs(side) == 1 and contact.offset is not None:
                    # F = kappa (g - row q - o), a sum of exponentials with the constant among them
                    o = offsets[:, i] * spin
                    depth = contact.row @ q
                    depth[len(regime.eigenvalues) :] += o
                    depth[len(regime.eigenvalues)] -= contact.stops.g2 if side > 0 else contact.stops.g1
                    F = -contact.stops.spring(int(side))[0] * depth
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


def measured_work(solution: ExponentialSolution, system: System, edges: Array) -> tuple[Array, Array]:
    """``ExponentialSolution.work`` by Gauss-Legendre quadrature, exact to rounding.

    The first panel behind every edge is as short as the fastest decay, each next one twice as long, up to half
    the shortest period: what is overdamped has decayed before its panels are longer than it lasts.
    """
    from ...piecewise.measures import NODES, WEIGHTS

    longest = 0.5 * solution.shortest_period
    decay = max(float(np.max(-r.eigenvalues.real, initial=0.0)) for r in solution.regimes.values())
    given, taken = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
    owner, left, width = graded(longest, decay, edges)
    for part in np.array_split(np.arange(len(left)), max(1, len(left) // 20_000)):
        t = (left[part][:, None] + width[part][:, None] * (NODES + 1.0) / 2.0).ravel()
        piece = solution.piece_at(edges[owner[part]]).repeat(len(NODES))
        q, v = solution.states_in(t, piece)
        power = np.sum(system.load(t) * v, axis=1)
        for i, contact in enumerate(system.contacts):
            if contact.offset is not None:
                o, rate = solution.offset(system, i)(t)
                for side in (-1, 1):
                    here = solution.sides[piece, i] == side
                    if np.any(here):
                        kappa, constant = contact.stops.spring(side)
                        power -= np.where(here, constant - kappa * (q @ contact.row + o), 0.0) * rate
        for total, values in ((given, power), (taken, np.sum(v * (v @ system.damping), axis=1))):
            np.add.at(total, owner[part], values.reshape(-1, len(NODES)) @ WEIGHTS * width[part] / 2.0)
    return given, taken


def graded(longest: float, decay: float, edges: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Panels between consecutive edges: owner, left end and width of each; see ``measured_work``."""
    owners, lefts, widths = [], [], []
    for k, (a, h) in enumerate(zip(edges[:-1], np.diff(edges), strict=True)):
        cuts = [0.0]
        width = min(longest, 1.0 / decay) if decay * longest > 1.0 else longest
        while cuts[-1] + width < h and width < longest:
            cuts.append(cuts[-1] + width)
            width *= 2.0
        rest = h - cuts[-1]
        cuts = np.append(cuts[:-1], cuts[-1] + np.linspace(0.0, rest, 1 + max(1, int(np.ceil(rest / longest)))))
        owners.append(np.full(len(cuts) - 1, k))
        lefts.append(a + cuts[:-1])
        widths.append(np.diff(cuts))
    return np.concatenate(owners), np.concatenate(lefts), np.concatenate(widths)
