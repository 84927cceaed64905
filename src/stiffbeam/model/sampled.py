"""A function of time known by samples: a polygon or a cubic spline, a polynomial between any two of them."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array, freeze, is_read_only, read_only
from ..basics.validation import InputError, itself, numbers, one_of

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

KINDS = {"linear": 1, "cubic": 3}  # and the degree between two samples
BEYOND = 1e-9  # of its span, how far outside its samples a record is still asked for: t_end is rounded


@dataclass(frozen=True, eq=False, repr=False)
class Sampled:
    """f(t) through the points (t_i, values_i), for t_0 <= t <= t_last; or its ``derivative``-th derivative.

        "linear"    f(t_i + s) = values_i + s (values_{i+1} - values_i)/(t_{i+1} - t_i)
        "cubic"     the cubic with the values and the slopes m_i, m_{i+1} of the spline (not-a-knot, C^2)

    A jump is two samples close to each other. Two records with equal numbers are equal, in any process. The samples and
    the slopes m_i are doubles, from which the function follows exactly.

    Parameters
    ----------
    t : array (N,)
        Increasing times, at least two. Copied; the copy is read-only.
    values : array (N,)
        One value per time. Copied; the copy is read-only.
    kind : {"linear", "cubic"}
    derivative : int
        Order of the derivative that the function is.

    Raises
    ------
    InputError
        For times that do not increase, for values that are not finite, for a derivative that would hold impulses, such
        as the acceleration of a polygon, and for times outside the samples: let a pulse end with samples of 0.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> record = sb.Sampled([0.0, 1.0, 2.0], [0.0, 4.0, 0.0])
    >>> float(record.value(0.25))
    1.0
    """

    t: Array
    values: Array
    kind: str = "linear"
    derivative: int = 0

    def __post_init__(self) -> None:
        itself("time function", self, Sampled)
        one_of("kind", self.kind, KINDS, "be 'linear' or 'cubic'")
        for name in ("t", "values"):
            stated, rule = getattr(self, name), "be two or more finite numbers in a row"
            array = stated if is_read_only(stated) else numbers(f"sampled.{name}", stated, rule)
            if array.ndim != 1 or len(array) < 2:
                raise InputError(f"sampled.{name}", stated, rule, "give a list")
            object.__setattr__(self, name, read_only(array))
        if len(self.t) != len(self.values):
            remedy = "give as many values as times"
            raise InputError("sampled.values", len(self.values), f"be one per time, {len(self.t)}", remedy)
        steps = np.diff(self.t)
        if not np.all(steps > 0.0):
            at = int(np.argmin(steps > 0.0))
            remedy = "for a jump give two samples at times close to each other"
            raise InputError("sampled.t", float(self.t[at + 1]), f"increase: it follows {self.t[at]:g}", remedy)
        order = self.derivative
        if isinstance(order, bool) or not isinstance(order, int) or not 0 <= order <= KINDS[self.kind]:
            rule = f"be an integer from 0 to {KINDS[self.kind]} for kind={self.kind!r}"
            raise InputError("derivative", order, rule, "0 is the function itself")
        self._whole  # noqa: B018  which refuses slopes that overflow

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        freeze(self, "t", "values")

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("t", "values", "kind", "derivative")}

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Sampled) and self.digest == other.digest)

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        times = "" if not self.derivative else f", derivative={self.derivative}"
        return (
            f"<Sampled {self.kind}{times}: {len(self.t)} samples on [{self.t[0]:g}, {self.t[-1]:g}],"
            f" {np.min(self.values):g} to {np.max(self.values):g}, {self.digest[:8]}>"
        )

    @cached_property
    def digest(self) -> str:
        """A hash of all its numbers."""
        content = self.t.tobytes() + self.values.tobytes() + f"{self.kind} {self.derivative}".encode()
        return hashlib.sha256(content).hexdigest()

    @property
    def breakpoints(self) -> Array:
        """The times of the samples: between them it is a polynomial."""
        return self.t

    @property
    def degree(self) -> int:
        """Degree of the polynomials between samples."""
        return KINDS[self.kind] - self.derivative

    @cached_property
    def _whole(self) -> PPoly:
        """The interpolant of the samples."""
        from scipy.interpolate import CubicSpline, PPoly

        with np.errstate(over="ignore", invalid="ignore"):
            try:
                if self.kind == "cubic":
                    whole = CubicSpline(self.t, self.values)
                else:
                    whole = PPoly(np.array([np.diff(self.values) / np.diff(self.t), self.values[:-1]]), self.t)
            # A divided difference overflows, or two times are one beside others.
            except (ValueError, np.linalg.LinAlgError):
                whole = None
        if whole is None or not np.all(np.isfinite(whole.c)):
            remedy = "check the times: two lie so close that slopes overflow"
            raise InputError("sampled.values", "slopes that overflow", "be representable in float64", remedy)
        return whole

    @cached_property
    def slopes(self) -> Array:
        """m_i of the cubic kind."""
        return np.asarray(self._whole(self.t, 1))

    @cached_property
    def _polynomials(self) -> list[PPoly]:
        """The function and its derivatives between the samples."""
        return [self._whole.derivative(k) for k in range(self.derivative, KINDS[self.kind] + 1)]

    @cached_property
    def pieces(self) -> Array:
        """(samples - 1, 4): coefficient k of (t - t_i)^k between samples i and i + 1."""
        c = self._polynomials[0].c[::-1].T
        # Four columns for every kind, so that records of different kinds stand in one table.
        return np.pad(c, ((0, 0), (0, 4 - c.shape[1])))

    def covers(self, start: float, end: float) -> None:
        """Raise InputError unless it is known from start to end."""
        slack = BEYOND * float(self.t[-1] - self.t[0])
        for t in (start, end):
            if not self.t[0] - slack <= t <= self.t[-1] + slack:
                remedy = "end the run there, or append samples, 0 where nothing acts"
                where = f"[{self.t[0]:.12g}, {self.t[-1]:.12g}]"
                rule = f"be evaluated within its samples, {where}"
                raise InputError("a sampled time function", f"t = {t:.12g}", rule, remedy)

    def taylor(self, t: ArrayLike) -> Array:
        """(..., 4): coefficient k of s^k in f(t + s), which holds up to the next sample."""
        c = np.zeros((*np.shape(t), 4))
        for k in range(self.degree + 1):
            c[..., k] = self._derivative(t, k) / math.factorial(k)
        return c

    def value(self, t: ArrayLike) -> Array:
        """The interpolant at t; InputError outside the samples."""
        return self._derivative(t, 0)

    def rate(self, t: ArrayLike) -> Array:
        """First derivative at t. Raises InputError if the interpolant jumps."""
        return self._derivative(t, 1)

    def acceleration(self, t: ArrayLike) -> Array:
        """Second derivative at t. Raises InputError if it does not exist."""
        return self._derivative(t, 2)

    def _derivative(self, t: ArrayLike, order: int) -> Array:
        if order > self.degree:
            jump = "slopes jump" if order > 1 else "values jump"
            rule = f"have a derivative of order {order}: its {jump} at the samples"
            raise InputError("a sampled time function", f"kind={self.kind!r}", rule, 'take samples of kind "cubic"')
        t = np.asarray(t, float)
        self.covers(float(np.min(t, initial=self.t[0])), float(np.max(t, initial=self.t[-1])))
        return np.asarray(self._polynomials[order](t))

    def derived(self, times: int) -> Sampled:
        """f' or f''. Raises InputError where that would hold impulses."""
        if times > self.degree:
            self._derivative(self.t[0], times)
        return Sampled(self.t, self.values, self.kind, self.derivative + times)


def moved(c: Array, s: ArrayLike) -> Array:
    """The coefficients (..., P) of p(s + .) from those of p: Horner's scheme, as often as there are any to move."""
    # On a copy: coefficient k collects s times the one above it, the last ones first.
    c, last = np.array(c), np.shape(c)[-1] - 1
    for first in range(last):
        for k in range(last - 1, first - 1, -1):
            c[..., k] += s * c[..., k + 1]
    return c
