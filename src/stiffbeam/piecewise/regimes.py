"""The regimes of a system, made when a motion first enters them: as pairs, and as rows of the table of the loop.

Where nothing is damped the pairs are the modes of the system with the springs of its closed contacts. Else they are
those of linear.py, complex where damping couples. Records and eigenvalues that meet have no pairs: such a regime keeps
its sums of exponentials, and the loop leaves it to ``Tracer``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from threading import Lock
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, content
from ..model.modes import Modes, undamped_modes
from ..model.system import System
from ..model.time_functions import Drive
from .follow import Table
from .linear import Correction, Perturbation, Pushed, Regime, correction, regime_of, rounded_sum

CLOSE = 0.125  # |Omega - omega|/(Omega + omega) below which the particular solution is not used
NONE = np.zeros((0, 2), np.int64)
Known = dict[tuple[Any, ...], Any]
_KNOWN: WeakKeyDictionary[System, Known] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Pairs:
    """One regime as in follow.py. outward: (4, K, n); inward: (4, n, K); response: (2, d, n); close: (p, 2);
    pulls: (p, 2). exponentials: its sums of these, where it has no real modes; turns: (k,), y = -turns Im c."""

    sigma: Array
    omega: Array
    level: Array
    outward: Array
    inward: Array
    response: Array
    close: NDArray[np.int64]
    pulls: Array
    exponentials: Regime | None = None
    turns: Array | None = None

    def __post_init__(self) -> None:
        # In one order in memory, which pickled arrays keep: sums of other orders differ in their last bits.
        for name in ("outward", "inward", "response"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name)))

    @property
    def followed(self) -> bool:
        """True if the loop can follow the regime."""
        return self.exponentials is None or not (self.exponentials.chains or self.exponentials.push.shape[1])

    @property
    def steady(self) -> Array:
        """The response to the drive, (d, n)."""
        return self.response[0] if self.exponentials is not None else self.response[0] @ self.outward[0]

    @property
    def fastest(self) -> float:
        """The largest |sigma + i omega|."""
        return float(np.max(np.hypot(self.sigma, self.omega), initial=0.0))

    def coefficients(self, x: Array, y: Array) -> Any:
        """c of the pairs x, y (..., k)."""
        assert self.turns is not None
        return x - 1j * y / self.turns

    def pairs(self, c: Any) -> tuple[Array, Array]:
        """x, y of the coefficients c (..., k)."""
        return np.real(c).copy(), -np.imag(c) * self.turns

    def flow(self, tau: float, dq: Array, dv: Array) -> tuple[Array, Array]:
        """The homogeneous flow over tau: (n, k) -> (n, k)."""
        x, y = (dq.T @ a + dv.T @ b for a, b in (self.inward[:2], self.inward[2:]))
        if self.exponentials is not None and self.exponentials.chains:
            x, y = self.pairs(self.exponentials.free(self.coefficients(x, y).T, tau).T)
        else:
            # tau sinc(omega tau/pi) is sin(omega tau)/omega, regular at omega = 0.
            c, s = np.exp(self.sigma * tau) * [np.cos(self.omega * tau), tau * np.sinc(self.omega * tau / np.pi)]
            x, y = x * c + y * s, y * c - x * (self.omega**2 * s)
        q, v = (x @ a + y @ b for a, b in (self.outward[:2], self.outward[2:]))
        return q.T, v.T


@dataclass(frozen=True, eq=False)
class Ways:
    """Between complex modes and the amplitudes of the free modes, as in ``Pairs``. to: (n, n), amplitudes of q."""

    to: Array
    sigma: Array
    omega: Array
    outward: Array
    inward: Array
    turns: Array


def ways_of(regime: Regime, free: Modes) -> Ways:
    """The pairs x = Re c, y = -omega Im c of complex modes, in the amplitudes of the ``free`` modes; of a chain's
    coefficients y = -Im c."""
    to = free.shapes.T @ free.mass
    # Real eigenvalues and chains have no frequency to divide by: y = -Im c.
    turns = np.where((regime.eigenvalues.imag > 0.0) & regime.single, regime.eigenvalues.imag, 1.0)
    sigma, omega = regime.eigenvalues.real.copy(), np.where(regime.single, regime.eigenvalues.imag, 0.0)
    outward = [(f(z) / w).T for z in (to @ regime.W, to @ regime.W_rate) for f, w in ((np.real, 1.0), (np.imag, turns))]
    inward = [f(z @ free.shapes).T for f in (np.real, np.imag) for z in (regime.from_q, regime.from_v)]
    inward[2:] = [-turns * z for z in inward[2:]]
    return Ways(to, sigma, omega, np.stack(outward), np.stack(inward), turns)


def of_exponentials(regime: Regime, ways: Ways) -> Pairs:
    """The regime of complex modes as pairs."""
    response = np.stack([_real(ways.to @ x).T for x in (regime.response, regime.response_rate)])
    zeros, none = np.zeros(len(ways.sigma)), np.zeros((0, 2))
    return Pairs(
        ways.sigma, ways.omega, zeros, ways.outward, ways.inward, response, NONE, none, regime, ways.turns
    )  # fmt: skip


def _real(phasors: Any) -> Array:
    """Complex amplitudes (n, 1 + F) of (1, exp(i Omega t), ...) as those of (1, sin, cos, ...), (n, d)."""
    made = np.empty((len(phasors), 2 * phasors.shape[1] - 1))
    made[:, 0], made[:, 1::2], made[:, 2::2] = phasors[:, 0].real, -phasors[:, 1:].imag, phasors[:, 1:].real
    return made


class Pressing(NamedTuple):
    """Stiffness of every contact, 0 where it is open; rows and stiffnesses of the closed ones; the loads (d, n) of the
    drive with those of the stops."""

    kappas: tuple[float, ...]
    springs: tuple[tuple[Array, float], ...]
    force: Array


class Source:
    """Modes, loads and offsets from which the regimes of a system and of its perturbed copies are made.

    known: modes by the stiffnesses of the closed contacts, 0 for open ones, and, of damped regimes, the parts that no
    load changes; used and added to, by default those of the system itself. span: the longest time that is asked for;
    over a short one the slow modes answer the drive from rest.
    """

    def __init__(self, system: System, known: Known | None = None, span: float = math.inf) -> None:
        self.system, self.drive, self.span = system, Drive.of(system), span
        self.known = _KNOWN.setdefault(system, {}) if known is None else known
        self.corrections: dict[tuple[float, ...], Correction] = {}
        self._pressing: dict[tuple[int, ...], Pressing] = {}
        self.pushed = Pushed.of(system, self.drive)
        self.damped = system.damped or bool(self.drive.records)
        self.kappas = [float(c.stops.stiffness) for c in system.contacts]
        self.dampings = [float(c.stops.damping) for c in system.contacts]
        self.lags = np.array([c / kappa for c, kappa in zip(self.dampings, self.kappas, strict=True)])
        self.lagging = bool(self.lags.any())
        self.frequencies = np.array(self.drive.frequencies, float)

    def pressing(self, sides: tuple[int, ...]) -> Pressing:
        """The stops that press on these sides; made once for all copies."""
        if sides not in self._pressing:
            kappas, springs, force = [0.0] * len(sides), [], self.pushed.loads.copy()
            for i, (contact, side) in enumerate(zip(self.system.contacts, sides, strict=True)):
                if side:
                    # sigma = kappa (gap - row q - offset): the first term is a load, the second in the matrix.
                    kappas[i], constant = contact.stops.spring(side)
                    springs.append((contact.row, kappas[i]))
                    force -= kappas[i] * np.outer(self.pushed.offsets[:, i], contact.row)
                    force[0] += constant * contact.row
            self._pressing[sides] = Pressing(tuple(kappas), tuple(springs), force)
        return self._pressing[sides]

    def modes(self, pressing: Pressing, perturbation: Perturbation | None, rng: np.random.Generator | None) -> Modes:
        """The undamped modes with these stops, or those of a copy."""
        kappas, springs, _ = pressing
        if kappas not in self.known:
            self.known[kappas] = undamped_modes(self.system, springs)
        base = self.known[kappas]
        if perturbation is None or rng is None:
            return base
        if kappas not in self.corrections:
            self.corrections[kappas] = correction(self.system, springs, base)
        return self.corrections[kappas].perturbed(perturbation.frequency, rng)

    def regime(
        self, sides: tuple[int, ...], perturbation: Perturbation | None, t_end: float, free: Modes | None
    ) -> tuple[Pairs, Modes]:
        """The regime with the contacts on these sides, 0 where nothing presses, of motions to t_end, in amplitudes of
        the ``free`` modes, its own where there are none; and its undamped modes."""
        # Both stops have the same modes.
        rng = None if perturbation is None else perturbation.random(*map(abs, sides))
        pressing = self.pressing(sides)
        basis = self.modes(pressing, perturbation, rng)
        free = free or basis
        # Damping couples modes, and the loop has no rate of close pairs for d + lag d': complex modes there.
        close = NONE if self.damped else close_pairs(basis.omega, self.frequencies, self.span)
        pressed = [i for i, side in enumerate(sides) if side]
        if self.damped or (self.lagging and (len(close) or self.lags[pressed].any())):
            span = self.span if self.span < math.inf else t_end
            key = (content(self.system.damping), span, *((i, self.kappas[i], self.dampings[i]) for i in pressed))
            frame, ways = (None, None) if perturbation else self.known.get(key, (None, None))
            regime = regime_of(self.system, self.drive, self.pushed, sides, span, perturbation, basis, frame)
            if ways is None or regime.chains:
                ways = ways_of(regime, free)
            if not (perturbation or regime.chains):
                self.known[key] = regime.frame, ways
            return of_exponentials(regime, ways), basis
        # Modal forces, and the way from the free modes to those of this regime.
        force = pressing.force
        modal, inward = basis.force(force), np.eye(len(basis.omega))
        if pressed:
            inward = free.shapes.T @ (self.system.mass @ basis.shapes)
        if perturbation is not None and rng is not None:
            # A perturbed copy: both change by their rounding. Forces differ by side: other random numbers.
            size = perturbation.state
            if pressed:
                lost = rounded_sum(free.shapes.T, rounded_sum(self.system.mass, basis.shapes))
                inward = inward + size * lost * rng.uniform(-1.0, 1.0, inward.shape)
            own = perturbation.random(*(side + 2 for side in sides))
            modal = modal + size * rounded_sum(force, basis.shapes) * own.uniform(-1.0, 1.0, modal.shape)
        # The response P, but for close pairs: there it would be large, and they answer from rest.
        gain, pulls = basis.omega**2 - (self.drive.rates**2)[:, None], np.zeros((len(close), 2))
        gain[0] = np.inf  # the constant stays with the pairs
        if len(close):
            mode, sine = close[:, 0], 1 + 2 * close[:, 1]
            gain[sine, mode] = gain[sine + 1, mode] = np.inf
            pulls[:, 0], pulls[:, 1] = modal[sine, mode], modal[sine + 1, mode]
        P = modal / gain
        nothing = np.zeros_like(inward)  # what x makes of q', and y of q
        # P': (sin w t)' = w cos w t, (cos w t)' = -w sin w t
        rates = np.zeros_like(P)
        rates[1::2], rates[2::2] = -P[2::2] * self.drive.rates[2::2, None], P[1::2] * self.drive.rates[1::2, None]
        made = Pairs(
            np.zeros(len(basis.omega)), basis.omega, np.ascontiguousarray(modal[0]),
            np.array([inward.T, nothing, nothing, inward.T]), np.array([inward, nothing, nothing, inward]),
            np.array([P, rates]), close, pulls,
        )  # fmt: skip
        return made, basis


def close_pairs(omega: Array, frequencies: Array, span: float) -> NDArray[np.int64]:
    """(p, 2): the modes and drive frequencies that lie close to each other, or are both slow against ``span``."""
    total = omega[:, None] + frequencies
    return np.argwhere((np.abs(omega[:, None] - frequencies) < CLOSE * total) | (total * span < 0.9))


class Regimes:
    """The regimes so far of one system, or of a perturbed copy of it."""

    def __init__(self, source: Source, perturbation: Perturbation | None = None) -> None:
        self.source, self.perturbation = source, perturbation
        self.number: dict[tuple[int, ...], int] = {}
        self.made: list[Pairs] = []
        self.table: Table  # from the first regime on
        self.rows: list[Array]  # of the contacts, in the ``free`` modes
        self.free: Modes | None = None
        self.making = Lock()  # members of an ensemble share their regimes

    def __getstate__(self) -> dict[str, Any]:
        """The state that can be sent to another process, where a lock of its own is made."""
        return {name: value for name, value in vars(self).items() if name != "making"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.making = Lock()

    def at(self, sides: tuple[int, ...], t_end: float) -> int:
        """Number of the regime with the contacts pressed on these sides. It is made, for motions to t_end, if it is
        new."""
        with self.making:
            # The free regime first: all others are expressed in its modes.
            if self.free is None:
                open_ = (0,) * len(sides)
                made, self.free = self.source.regime(open_, self.perturbation, t_end, None)
                self.rows = [self.free.force(contact.row) for contact in self.source.system.contacts]
                self.table = self._empty(3, len(made.sigma), len(made.close))
                self.add(open_, made)
            if sides not in self.number:
                self.add(sides, self.source.regime(sides, self.perturbation, t_end, self.free)[0])
        return self.number[sides]

    def add(self, sides: tuple[int, ...], made: Pairs) -> None:
        """Add a regime to the table."""
        table, r = self.table, len(self.made)
        self.number[sides] = r
        self.made.append(made)
        # Twice the rows when the table is full, and wider arrays for a regime with more pairs: filled anew.
        R, K, p = len(table.sizes), table.sigma.shape[1], table.close.shape[1]
        if r >= R or len(made.sigma) > K or len(made.close) > p:
            table = self._empty(2 * r if r >= R else R, max(K, len(made.sigma)), max(p, len(made.close)))
            for key, number in self.number.items():
                self._fill(table, number, key, self.made[number])
            self.table = table
        else:
            self._fill(table, r, sides, made)

    def _empty(self, R: int, K: int, p: int) -> Table:
        source = self.source
        contacts, n, F = source.system.contacts, source.system.size, len(source.frequencies)
        m, d = len(contacts), source.drive.size
        sigma, omega, level = np.zeros((3, R, K))
        g1, g2 = np.array([(c.stops.lower_bound, c.stops.upper_bound) for c in contacts], float).reshape(m, 2).T.copy()
        return Table(
            np.zeros((R, m), np.int64), np.zeros(R, np.int64), np.zeros(R, np.int64), sigma, omega, level,
            np.zeros((R, K + F), np.int64), np.zeros((R, 2, K + F)), np.zeros((R, 4, K, n)), np.zeros((R, 4, n, K)),
            np.zeros((R, 2, d, n)), np.zeros((R, 2, m, K)), np.zeros((R, m, d)),
            source.frequencies, np.zeros((R, p, 2), np.int64), np.zeros(R, np.int64), np.zeros((R, p, 2)), g1, g2,
            source.lags,
        )  # fmt: skip

    def _fill(self, table: Table, r: int, sides: tuple[int, ...], made: Pairs) -> None:
        size, p, drives = len(made.sigma), len(made.close), self.source.frequencies
        table.sides[r] = sides
        table.undamped[r], table.closes[r] = made.exponentials is None, p
        table.sigma[r, :size], table.omega[r, :size], table.level[r, :size] = made.sigma, made.omega, made.level
        sigma, omega = np.concatenate([made.sigma, 0.0 * drives]), np.concatenate([made.omega, drives])
        # From slow to fast, as the search expects its terms.
        order = np.argsort(np.hypot(sigma, omega), kind="stable")
        table.order[r, : len(order)] = order
        table.speeds[r, 0, : len(order)], table.speeds[r, 1, : len(order)] = sigma[order], omega[order]
        table.outward[r, :, :size], table.inward[r, :, :, :size] = made.outward, made.inward
        table.response[r, :, :, : made.response.shape[2]] = made.response
        # Every contact's view of the pairs and of the drive, its offset included.
        for i, row in enumerate(self.rows):
            table.rows[r, :, i, :size] = made.outward[:2] @ row
            table.waves[r, i] = made.steady @ row + self.source.pushed.offsets[:, i]
        table.close[r, :p], table.pulls[r, :p] = made.close, made.pulls
        table.sizes[r] = size if made.followed else -size  # at last: now a loop may find it

    def start(self, q: Array, v: Array, t_end: float, settled: bool = True) -> tuple[Array, Array]:
        """The amplitudes of the free modes and their rates at q, q'. Unless ``settled`` those of a copy are changed in
        proportion to the motion, the amplitudes of the start and of the drive, and to the terms they are sums of."""
        number = self.at((0,) * len(self.source.system.contacts), t_end)
        basis, free = self.free, self.made[number]
        assert basis is not None
        eta, rate = basis.to_modal(q), basis.to_modal(v)
        if self.perturbation is None or settled:
            return eta, rate
        # A perturbed copy: amplitudes change in proportion to the largest of motion and drive, in energy.
        drive, size = self.source.drive, self.perturbation.state
        omega, turned = basis.omega, basis.mass @ basis.shapes
        slowest = omega[omega > 0.0][:1]  # what a constant load moves, it moves at natural frequencies
        rates = np.where(drive.rates > 0.0, drive.rates, slowest[0] if len(slowest) else 0.0)
        if free.exponentials is None:
            driven = np.sum(np.abs(free.response[0]) * rates[:, None], axis=0)
        else:  # where a drive is answered from rest there is no response to it
            pushed = float(np.max(np.abs(basis.force(self.source.system.load(0.0)))))  # modal: in the units of ``rate``
            driven = pushed / (slowest if len(slowest) else np.array([np.inf]))
        least = max(float(np.max(np.hypot(omega * eta, rate))), float(np.max(driven)))
        # A slow mode is changed by least/omega, though by no more than 1e8 times that of the fastest.
        noise = self.perturbation.random(99).uniform(-1.0, 1.0, (2, eta.size))
        scale = np.where(omega > 0.0, np.maximum(omega, 1e-8 * omega[-1]), slowest[0] if len(slowest) else np.inf)
        eta = eta + size * (least / scale + rounded_sum(q, turned)) * noise[0]
        return eta, rate + size * (least + rounded_sum(v, turned)) * noise[1]

    def nodal(self, eta: Array, rate: Array) -> tuple[Array, Array]:
        """q and q' (..., n) of amplitudes of the free modes and their rates."""
        assert self.free is not None
        return self.free.to_nodal(eta), self.free.to_nodal(rate)
