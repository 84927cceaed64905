"""A piecewise-linear system in ball arithmetic: every number is an interval that contains the true one.

    Z = (q, q', 1, sin w_1 t, cos w_1 t, ...),   Z' = G Z in a regime,   Z+ = J Z- at an impact on a rigid stop

Coordinates are those of the free modes, in which products of flows, and so their radii, grow little.

Signs between events are proved on subintervals by Taylor polynomials with remainder and Bernstein coefficients:

    h(t + L x) = sum_{k < K} h_k x^k + R x,   |R| <= |form|.w max_i(|Z_K|_i/w_i)/(1 - theta/(K + 1)),   0 <= x <= 1

Z_K = (L G)^K Z/K!, and theta = L max_i (|G| w)_i/w_i for a positive vector w. A quantity that is zero at an event is
divided by x there: its sign, and that its rate is not zero, are proved together.
Source: Tucker, Validated Numerics (2011); Johansson, Arb, IEEE Trans. Comput. 66 (2017) 1281-1292.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from flint import arb, arb_mat, ctx

from ..basics.arrays import Array
from ..basics.validation import InputError, exact_value
from ..model.system import System
from ..model.time_functions import Drive
from ..piecewise.follow import LET_GO
from .multiprecision.linear_flow import LinearFlow, bernstein
from .multiprecision.rational import number

THETA = 5.0  # of a Taylor polynomial: length times rate
LONGEST = 1.5  # times L, of a subinterval that ends at an event
TERMS = 48  # (LONGEST THETA)^TERMS/TERMS! is 2^-63
ABOVE = 1.05  # times the spectral radius of |G|: the rate that weights reach
BISECTIONS = 40  # of a subinterval


class Watched(NamedTuple):
    """u - g into the stop ``side`` of a contact, or that plus (c/kappa) u' where ``lagging``, times ``sign``."""

    contact: int
    side: int
    lagging: bool
    sign: int

    @property
    def form(self) -> tuple[int, int, bool]:
        """Key of ``BallSystem.form``."""
        return self.contact, self.side, self.lagging


class ExactPeriod:
    """The period as an exact number: ``turns`` of the first drive, 2 pi turns/w, or the float64 number without one."""

    def __init__(self, system: System, period: float) -> None:
        frequencies = Drive.of(system).frequencies
        self.period, self.frequency, self.turns = period, None, 0
        if not frequencies:
            return
        self.frequency = frequencies[0]
        ratio, pi = exact_value(self.frequency)
        self.turns = round(period * float(self.frequency) / (2.0 * np.pi))
        # All drives must repeat after one exact period; the doubles next to 0.1 and 0.3 do not.
        for frequency in frequencies[1:]:
            other, other_pi = exact_value(frequency)
            if pi != other_pi or (self.turns * other / ratio).denominator != 1:
                rule = f"be an exact multiple of {self.frequency!r}/{self.turns} for a proof"
                remedy = 'give frequencies as texts, for example "0.3" and "0.1", or integers'
                raise InputError("frequency", frequency, rule, remedy)

    @property
    def ball(self) -> Any:
        """At the current precision."""
        if self.frequency is None:
            return arb(number(self.period))
        return 2 * arb.pi() * self.turns / arb(number(self.frequency))

    @property
    def text(self) -> str:
        """Formula of the period."""
        if self.frequency is None:
            return f"{float(self.period)!r}"
        return f"{2 * self.turns} pi/{float(self.frequency)!r}"


class BallSystem(LinearFlow):
    """The exact numbers of a system as balls at the current precision, in modal coordinates.

    columns: (N, N), of the coordinates, from ``frame_of``. All forms (1, N) and matrices belong to them.
    """

    def __init__(self, system: System, columns: Array) -> None:
        self.frame = arb_mat([[arb(x) for x in line] for line in columns.tolist()])
        super().__init__(system, ctx.prec, self.frame)
        self.clock = self.start().entries()[2 * self.n :]  # at t = 0
        self.identity = identity(self.N)
        self._gaps: dict[tuple[int, int, bool], Any] = {}
        self._generators: dict[tuple[int, ...], Any] = {}

    def form(self, contact: int, side: int, lagging: bool) -> Any:
        """u - g, or u - g + (c/kappa) u', times the side: positive into the stop, (1, N)."""
        key = contact, side, lagging
        if key not in self._gaps:
            self._gaps[key] = self.gap(*key) * side
        return self._gaps[key]

    def closed(self, sides: Sequence[int]) -> Any:
        """G (N, N) with the contacts on the given sides, 0 and LET_GO free."""
        key = tuple(side if abs(side) == 1 else 0 for side in sides)
        if key not in self._generators:
            self._generators[key] = super().closed(key)
        return self._generators[key]

    def impact(self, contact: int) -> Any:
        """J (N, N) of an impact on a rigid stop: u'+ = -e u'-."""
        e = arb(number(self.system.contacts[contact].stops.restitution or 0.0))
        return self.identity - self.push(contact) * self.rates[contact] * ((1 + e) / self.compliance[contact, contact])

    def watched(self, sides: Sequence[int]) -> list[Watched]:
        """Quantities that are positive for as long as the contacts stay on these sides."""
        quantities = []
        for c, side in enumerate(sides):
            stop, contact = 1 if side > 0 else -1, self.problem.contacts[c]
            if side == 0:
                stops = (-1, contact.g1), (1, contact.g2)
                # Open: the gaps to both stops.
                quantities += [Watched(c, stop, False, -1) for stop, g in stops if g is not None]
            elif abs(side) == LET_GO:
                # Beyond a damped stop that has let go: still deeper than the stop, with a force that would pull.
                quantities += [Watched(c, stop, False, 1), Watched(c, stop, True, -1)]
            else:
                # Pressed: beyond the stop, and on a damped one with a force that presses.
                damped = self.system.contacts[c].stops.damping > 0.0
                quantities += [Watched(c, stop, lagging, 1) for lagging in ((False, True) if damped else (False,))]
        return quantities


class SignProver:
    """Signs of forms over segments, at the current precision."""

    def __init__(self, balls: BallSystem) -> None:
        self.balls = balls
        self._scales: dict[tuple[int, ...], tuple[Any, Any, Array, float]] = {}
        self._jumps: dict[tuple[tuple[int, ...], int], Any] = {}

    def regime(self, sides: Sequence[int]) -> tuple[Any, Any, Array, float]:
        """L, L G, weights w and theta of a regime."""
        key = tuple(side if abs(side) == 1 else 0 for side in sides)
        if key not in self._scales:
            G = self.balls.closed(key)
            sizes = np.array([[float(x.abs_upper()) for x in line] for line in G.tolist()])
            sizes *= 1.0 + 1e-12  # for the float64 sums below
            w = _weights(sizes, 2 * self.balls.n)
            rate = max(float(np.max(sizes @ w / w)), 1e-300) * (1.0 + 1e-12)
            # A power of two, so that L and its multiples are exact.
            length = arb(2.0 ** np.floor(np.log2(THETA / rate)))
            self._scales[key] = length, G * length, w, float(length) * rate
        return self._scales[key]

    def ahead(self, sides: Sequence[int], Z: Any, count: int) -> Any:
        """Z after ``count`` lengths L, by flows over powers of two of them."""
        length, key = self.regime(sides)[0], tuple(side if abs(side) == 1 else 0 for side in sides)
        power = 0
        while count >> power:
            if count >> power & 1:
                if (key, power) not in self._jumps:
                    self._jumps[key, power] = (self.balls.closed(key) * (length * 2**power)).exp()
                Z = self._jumps[key, power] * Z
            power += 1
        return Z

    def segment(
        self, sides: Sequence[int], start: Any, end: Any, tau: Any, zeros: tuple[Any, Any], quantities: list[Watched]
    ) -> Iterator[tuple[Watched, Any, bool | None]]:
        """Quantities not proved to be positive, with the time from the segment's start, and False if they are negative.

        start, end: Z at the two ends, tau apart. zeros: keys of the forms that are zero there, None for none.
        """
        length = self.regime(sides)[0]
        # Lengths L from the start, and one part back from the end: a zero at either end is at x = 0.
        count = int(float(tau / length) - 0.5) if tau >= 2 * length else 0
        pieces = [(self.ahead(sides, start, k), k * length, length, 1, k == 0) for k in range(count)]
        if count == 0:
            pieces = [(start, arb(0), tau / 2, 1, True)]
        # The part at the end has half to one and a half L; a short segment is two halves.
        remaining = tau - count * length if count else tau / 2
        pieces.append((end, tau, remaining, -1, True))
        for Z, at, width, direction, edge in pieces:
            zero = (zeros[0] if direction > 0 else zeros[1]) if edge else None
            series, tails = self._series(sides, Z, width * direction)
            for quantity in quantities:
                form = self.balls.form(*quantity.form) * quantity.sign
                p = (series * form.transpose()).entries()
                tail = self._tail(sides, form, tails)
                # Zero at this end: p/x has to be positive, and with it the rate there.
                if quantity.form == zero:
                    p = p[1:]
                    p[0] += tail
                else:
                    p[0] += tail
                place = positive(p)
                if place is not None:
                    yield quantity, at + direction * width * place[0], place[1]

    def _series(self, sides: Sequence[int], Z: Any, width: Any) -> tuple[Any, Any]:
        """Coefficients (TERMS, N) of Z in x = s/width, |width| <= 3 L/2, and Z_K (N, 1)."""
        length, scaled, _, _ = self.regime(sides)
        ratio, lines, factor = width / length, [], arb(1)
        for k in range(TERMS):
            lines.append((Z * factor).entries())
            Z = scaled * Z / (k + 1)
            factor *= ratio
        return arb_mat(lines), Z * factor

    def _tail(self, sides: Sequence[int], form: Any, last: Any) -> Any:
        """A ball that contains what the polynomial of a form leaves out."""
        _, _, w, theta = self.regime(sides)
        size = max(float(abs(x).upper()) / weight for x, weight in zip(last.entries(), w.tolist(), strict=True))
        reach = sum(float(abs(x).upper()) * weight for x, weight in zip(form.entries(), w.tolist(), strict=True))
        # The factor and the last term exceed what this float64 arithmetic rounds off.
        bound = size * reach / (1.0 - LONGEST * theta / (TERMS + 1)) * (1.0 + 1e-9) + 1e-250
        return arb(0, bound)


def positive(p: list[Any]) -> tuple[Any, bool | None] | None:
    """None where a polynomial, balls of its coefficients, is positive on [0, 1].

    Else a place where this is not proved, and False where p is negative there.
    """
    # The cheap test: the constant exceeds all other terms.
    if p[0].lower() > sum((abs(x).upper() for x in p[1:]), arb(0)):
        return None
    waiting = [(arb(0), arb(1), 0)]
    while waiting:
        a, w, depth = waiting.pop()
        b = bernstein(p, a, w)
        if all(x > 0 for x in b):
            continue
        # The first and the last coefficient are values of p, which disprove a sign.
        for value, place in ((b[0], a), (b[-1], a + w)):
            if value < 0:
                return place, False
        # Where both ends may be zero, smaller intervals decide nothing.
        if depth == BISECTIONS or (b[0].contains(0) and b[-1].contains(0)):
            return a + w / 2, None
        # The left half comes next, so that the first failure is reported.
        waiting += [(a + w / 2, w / 2, depth + 1), (a, w / 2, depth + 1)]
    return None


def _weights(sizes: Array, free: int) -> Array:
    """Weights w > 0 with max_i (|G| w)_i/w_i about the least there is, in any units; |G| (N, N), ``free`` unknowns.

    (rate - |G|) w = u gives |G| w <= rate w for u >= 0 and a rate above the spectral radius.
    """
    rate = ABOVE * max(float(np.max(np.abs(np.linalg.eigvals(sizes)))), 1e-300)
    u = np.repeat([0.0, 1.0], [free, len(sizes) - free])
    # The drive pushes: weights of positions and velocities are then in units of the motion.
    w = np.linalg.solve(rate * np.eye(len(sizes)) - sizes, u)
    if not np.min(w) > 0.0:  # the drive does not reach an unknown
        w = np.linalg.solve(rate * np.eye(len(sizes)) - sizes, np.where(w > 0.0, u, 1.0))
    # Any positive weights serve, also those that rounding has spoiled.
    return np.maximum(np.nan_to_num(w / np.max(w)), 1e-300)


def identity(size: int) -> Any:
    """(size, size)."""
    return arb_mat([[arb(int(i == j)) for j in range(size)] for i in range(size)])


def frame_of(system: System, period: float) -> Array:
    """Free modes with q' over their frequencies, in float64: (N, N), exact as they are."""
    d = Drive.of(system).size
    # Any invertible columns serve, since they count as exact numbers: float64 is enough.
    squares, shapes = scipy.linalg.eigh((system.stiffness + system.stiffness.T) / 2.0, system.mass)
    # A rigid motion has frequency 0: one turn in the period is its unit.
    omega = np.sqrt(np.maximum(squares, (2.0 * np.pi / period) ** 2))
    return np.asarray(scipy.linalg.block_diag(shapes / omega, shapes, np.eye(d)))


def trimmed(matrix: Any) -> Any:
    """The same balls rounded to the current precision."""
    return arb_mat([[+x for x in line] for line in matrix.tolist()])
