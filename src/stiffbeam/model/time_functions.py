"""Functions of time: the base motion phi(t), the load factors f_k(t), the stop offsets o_c(t).

All those of a system as numbers are its ``Drive``: harmonics g(t) = (1, sin w1 t, cos w1 t, sin w2 t, ...), and
polynomials between samples.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable
from uuid import uuid4

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import (
    Frozen,
    InputError,
    constants,
    exact_value,
    integer,
    number,
    numbers,
    one_of,
    sequence,
)

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

KINDS = {"linear": 1, "cubic": 3}  # and the degree between two samples
ORDERS = ("value", "rate", "acceleration")  # the methods of a time function by the order of the derivative
BEYOND = 1e-9  # of its span, how far outside its samples a record is still asked for: t_end is rounded


@runtime_checkable
class TimeFunction(Protocol):
    """f(t) with two derivatives, vectorised: an array of times gives an array of that shape.

    ``Harmonic``, ``Constant``, ``Sampled`` and ``Superposition`` are time functions. A class of your own needs the
    three methods ``value``, ``rate`` and ``acceleration``. Times where it is not smooth are the argument
    ``breakpoints`` of ``reference``.

    Examples
    --------
    >>> import numpy as np
    >>> import stiffbeam as sb
    >>> class Ramp:
    ...     def value(self, t):
    ...         return 2.0 * np.asarray(t)
    ...     def rate(self, t):
    ...         return 2.0 + 0.0 * np.asarray(t)
    ...     def acceleration(self, t):
    ...         return 0.0 * np.asarray(t)
    >>> isinstance(Ramp(), sb.TimeFunction)
    True
    """

    def value(self, t: ArrayLike, /) -> Array:
        """f(t)."""
        ...

    def rate(self, t: ArrayLike, /) -> Array:
        """f'(t)."""
        ...

    def acceleration(self, t: ArrayLike, /) -> Array:
        """f''(t)."""
        ...


class Derivable(Frozen):
    """Base of time functions that give their derivatives of every order, ``_at(t, order)``."""

    def value(self, t: ArrayLike) -> Array:
        """f(t)."""
        return self._at(t, 0)

    def rate(self, t: ArrayLike) -> Array:
        """f'(t)."""
        return self._at(t, 1)

    def acceleration(self, t: ArrayLike) -> Array:
        """f''(t)."""
        return self._at(t, 2)

    def _at(self, t: ArrayLike, order: int) -> Array:
        raise NotImplementedError


@dataclass(frozen=True)
class Harmonic(Derivable):
    """f(t) = amplitude sin(frequency t + phase).

    A number given as a text ("0.2", "pi/2", "2*pi*50"), Fraction or Decimal is carried exactly into multiprecision.

    Parameters
    ----------
    amplitude : float
    frequency : float
        Angular frequency > 0, in radians per unit of time.
    phase : float
        In radians; pi/2 makes a cosine.

    Raises
    ------
    InputError
        For a number that is not finite, and a frequency that is not positive.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> float(sb.Harmonic(amplitude=0.2, frequency=10.0, phase="pi/2").value(0.0))
    0.2
    """

    amplitude: float
    frequency: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        vars(self)["amplitude"] = number("amplitude", self.amplitude, exact=True)
        # Its square is a number.
        vars(self)["frequency"] = number("frequency", self.frequency, exact=True, least=1e-150, most=1e150)
        vars(self)["phase"] = number("phase", self.phase, exact=True)

    def _at(self, t: ArrayLike, order: int) -> Array:
        size = (1.0, self.frequency, -(self.frequency**2))[order] * self.amplitude
        return size * (np.cos if order == 1 else np.sin)(self.frequency * np.asarray(t, float) + self.phase)


@dataclass(frozen=True)
class Constant(Derivable):
    """f(t) = level.

    Parameters
    ----------
    level : float
        A text ("9.81"), Fraction or Decimal is carried exactly into multiprecision.

    Raises
    ------
    InputError
        For a level that is not finite.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> float(sb.Constant(-9.81).value(3.0))
    -9.81
    """

    level: float

    def __post_init__(self) -> None:
        vars(self)["level"] = number("level", self.level, exact=True)

    def _at(self, t: ArrayLike, order: int) -> Array:
        return np.full(np.shape(t), 0.0 if order else float(self.level))


@dataclass(frozen=True, eq=False, repr=False)
class Sampled(Derivable):
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
        one_of("kind", self.kind, KINDS, "be 'linear' or 'cubic'")
        for name in ("t", "values"):
            vars(self)[name] = constants(f"sampled.{name}", getattr(self, name), "be finite numbers in a row")
        if self.t.ndim != 1 or len(self.t) < 2:
            raise InputError("sampled.t", self.t, "be two or more times in a row", "give a list")
        if self.values.shape != self.t.shape:
            rule = f"be one per time, {len(self.t)}"
            raise InputError("sampled.values", f"shape {self.values.shape}", rule, "give as many values as times")
        steps = np.diff(self.t)
        if not np.all(steps > 0.0):
            at = int(np.argmin(steps > 0.0))
            remedy = "for a jump give two samples at times close to each other"
            raise InputError("sampled.t", float(self.t[at + 1]), f"increase: it follows {self.t[at]:g}", remedy)
        if integer("derivative", self.derivative, 0) > KINDS[self.kind]:
            rule = f"be at most {KINDS[self.kind]} for kind={self.kind!r}, beyond which there are jumps"
            raise InputError("derivative", self.derivative, rule, 'take samples of kind "cubic"')
        self.spline  # noqa: B018  which refuses slopes that overflow

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
    def degree(self) -> int:
        """Degree of the polynomials between samples."""
        return KINDS[self.kind] - self.derivative

    @cached_property
    def spline(self) -> PPoly:
        """The interpolant of the samples, of which the function is a derivative."""
        from scipy.interpolate import CubicSpline, PPoly

        with np.errstate(over="ignore", invalid="ignore"):
            try:
                lines = [np.diff(self.values) / np.diff(self.t), self.values[:-1]]
                whole = CubicSpline(self.t, self.values) if self.kind == "cubic" else PPoly(lines, self.t)
                if np.all(np.isfinite(whole.c)):
                    return whole
            except ValueError:  # a divided difference overflows, or two times are one beside others
                pass
        remedy = "check the times: two lie so close that slopes overflow"
        raise InputError("sampled.values", "slopes that overflow", "be representable in float64", remedy)

    def taylor(self, t: Array) -> Array:
        """Coefficients (.., 4) of f(t + s) = c_0 + c_1 s + c_2 s^2 + c_3 s^3 up to the next sample, also outside."""
        return np.stack([self.spline(t, self.derivative + k) / math.factorial(k) for k in range(4)], axis=-1)

    def covers(self, start: float, end: float) -> None:
        """Raise InputError unless it is known from start to end."""
        slack = BEYOND * float(self.t[-1] - self.t[0])
        for t in (start, end):
            if not self.t[0] - slack <= t <= self.t[-1] + slack:
                rule = f"be evaluated within its samples, [{self.t[0]:.12g}, {self.t[-1]:.12g}]"
                remedy = "let it begin at 0, in a case file by start = 0, and reach t_end, 0 where nothing acts"
                raise InputError("a sampled time function", f"t = {t:.12g}", rule, remedy)

    def _at(self, t: ArrayLike, order: int) -> Array:
        if order > self.degree:
            self.derived(order)  # raises InputError
        t = np.asarray(t, float)
        self.covers(float(np.min(t, initial=self.t[0])), float(np.max(t, initial=self.t[-1])))
        return np.asarray(self.spline(t, self.derivative + order))

    def derived(self, times: int) -> Sampled:
        """f' or f''. Raises InputError where that would hold impulses."""
        return Sampled(self.t, self.values, self.kind, self.derivative + times)


@dataclass(frozen=True, init=False)
class Superposition(Derivable):
    """f(t) = sum_k factor_k f_k(t).

    Parameters
    ----------
    *functions : TimeFunction
        Functions f_k with the factor 1.
    terms : sequence of (float, TimeFunction)
        Pairs (factor_k, f_k). The attribute has all pairs, a sum among them term by term.

    Raises
    ------
    InputError
        For anything without value, rate and acceleration, such as a bare function, and for terms that are no pairs.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> float(sb.Superposition(sb.Constant(1.0), sb.Harmonic(2.0, 3.0, phase="pi/2")).value(0.0))
    3.0
    """

    terms: tuple[tuple[float, TimeFunction], ...]

    def __init__(self, *functions: TimeFunction, terms: Sequence[tuple[float, TimeFunction]] = ()) -> None:
        rule, remedy = "hold pairs (factor, time function)", "for example (0.5, Constant(1.0))"
        pairs = [*((1.0, f) for f in functions), *sequence("Superposition.terms", terms, rule, remedy)]
        if not pairs:
            raise InputError("Superposition", "nothing", "add one function or more", "for none give Constant(0.0)")
        for pair in pairs:
            if not isinstance(pair, (tuple, list)) or len(pair) != 2:
                raise InputError("Superposition.terms", pair, rule, remedy)
        # A sum in a sum is flattened, the factors multiplied.
        vars(self)["terms"] = tuple(
            (number("Superposition.terms", number("Superposition.terms", factor) * inner), leaf)
            for factor, f in pairs
            for inner, leaf in parts(time_function("Superposition", f, moves=True))
        )

    def _at(self, t: ArrayLike, order: int) -> Array:
        return sum((factor * evaluate(f, t, order) for factor, f in self.terms), np.zeros(np.shape(t)))


LoadFunction = TimeFunction | Callable[[Any], Any]
KNOWN = (Harmonic, Constant, Sampled)  # what closed forms are made of


def parts(function: LoadFunction | None) -> tuple[tuple[float, LoadFunction], ...]:
    """The (factor, f) that a Superposition adds up; any other function itself, none for None."""
    return function.terms if isinstance(function, Superposition) else () if function is None else ((1.0, function),)


def leaves(*functions: LoadFunction | None) -> list[LoadFunction]:
    """The functions of ``parts`` of all these, without their factors."""
    return [leaf for function in functions for _, leaf in parts(function)]


def derivative(function: TimeFunction, order: int) -> LoadFunction:
    """f' or f''; in closed form where f is. Raises InputError for a polygon, whose acceleration is impulses."""
    if isinstance(function, Harmonic):
        # In closed form again, so that the exact solution accepts the derivative.
        if order == 2:
            return Harmonic(-function.amplitude * function.frequency**2, function.frequency, function.phase)
        return Harmonic(function.amplitude * function.frequency, function.frequency, function.phase + np.pi / 2)
    if isinstance(function, Constant):
        return Constant(0.0)
    if isinstance(function, Sampled):
        return function.derived(order)
    if isinstance(function, Superposition) and all(isinstance(f, KNOWN) for _, f in function.terms):
        return Superposition(terms=[(factor, derivative(f, order)) for factor, f in function.terms])  # type: ignore[misc]
    return getattr(function, ORDERS[order])


def time_function(field: str, function: Any, moves: bool = False) -> Any:
    """``function`` if it is one of time: a TimeFunction, or a callable. A base or a stop that ``moves`` by it takes its
    rate and acceleration too."""
    bare = callable(function) and not isinstance(function, type)
    timed = isinstance(function, TimeFunction) and not isinstance(function, type)
    if not timed and (moves or not bare):
        rule = (
            "have value(t), rate(t) and acceleration(t)" if bare else "be a Harmonic, a Constant or a function of time"
        )
        raise InputError(field, function, rule, "for example Harmonic(0.1, 2.0)")
    return function


def evaluate(function: LoadFunction | None, t: ArrayLike, order: int = 0) -> Array:
    """f(t), or of a TimeFunction f'(t) or f''(t), as a float array of the shape of ``t``; 0 for None."""
    t = np.asarray(t, float)
    if function is None:
        return np.zeros(t.shape)
    remedy = "write it with NumPy functions, for example numpy.where for an if"
    # A function of the user may raise, or return anything.
    try:
        # Known classes first: the test for a protocol looks at every method.
        timed = isinstance(function, (*KNOWN, Superposition, TimeFunction))
        result = getattr(function, ORDERS[order])(t) if timed else function(t)  # type: ignore[operator]
    except InputError:
        raise
    except Exception as error:  # whatever the functions of others raise
        raise InputError("a time function", repr(error), "take an array of times", remedy) from None
    values = numbers("a time function", result, "return finite real numbers", remedy)
    if values.shape not in (t.shape, ()):
        raise InputError("a time function", values.shape, f"return one value per time, shape {t.shape}", remedy)
    return values if values.shape == t.shape else np.broadcast_to(values, t.shape)


_PROCESS, _CALLABLES = uuid4().hex, {}


def description(function: LoadFunction | None) -> str:
    """A text that is equal for equal functions; of other functions than those of this module in this process only."""
    if function is None or isinstance(function, (Harmonic, Constant)):
        return repr(function)
    if isinstance(function, Sampled):
        return f"sampled {function.digest}"
    if isinstance(function, Superposition):
        return " + ".join(f"{factor!r} ({description(f)})" for factor, f in function.terms)
    # A method, such as the rate of a base, is a new object each time: by its function and the object that has it.
    behind = getattr(function, "__func__", function), getattr(function, "__self__", None)
    key = tuple(map(id, behind))
    _CALLABLES[key] = behind  # kept, so that no other one is ever given its number
    return f"callable {_PROCESS} {key}"


# ---------------------------------------------------------------- all those of a system as numbers


@dataclass(frozen=True, eq=False)
class Drive:
    """The d = 1 + 2 F functions g(t) that harmonic and constant loads and offsets of a system are made of, its R
    ``records``, which are Sampled, and the functions ``called``, which have no closed form, each once.

    Two frequencies that are equal in float64 but not exactly count as two: multiprecision distinguishes them.
    """

    frequencies: tuple[float, ...]
    records: tuple[Sampled, ...]
    called: tuple[LoadFunction, ...]

    @classmethod
    def of(cls, functions: Iterable[LoadFunction | None]) -> Drive:
        """The drive of these functions."""
        terms = leaves(*functions)
        # Frequencies are distinguished by their exact values, see the docstring of the class.
        frequencies = {exact_value(f.frequency): f.frequency for f in terms if isinstance(f, Harmonic)}
        records = dict.fromkeys(f for f in terms if isinstance(f, Sampled))
        called = {id(f): f for f in terms if not isinstance(f, KNOWN)}
        return cls(tuple(sorted(frequencies.values())), tuple(records), tuple(called.values()))

    @property
    def others(self) -> tuple[LoadFunction, ...]:
        """The functions that are neither Harmonic nor Constant: ``records``, then ``called``."""
        return (*self.records, *self.called)

    @property
    def size(self) -> int:
        """d."""
        return 1 + 2 * len(self.frequencies)

    def rates(self, amplitudes: Array) -> Array:
        """Amplitudes in g of f' from those of f, (d, ..)."""
        rates, frequencies = np.zeros_like(amplitudes), np.array(self.frequencies)[:, None]
        rates[1::2], rates[2::2] = -frequencies * amplitudes[2::2], frequencies * amplitudes[1::2]
        return rates

    def amplitudes(self, functions: Sequence[LoadFunction | None]) -> Array:
        """Column k: the amplitudes of f_k in g(t), in the records and in the functions ``called``, (d + R + C, ..)."""
        amplitudes, others = np.zeros((self.size + len(self.others), len(functions))), self.others
        for k, (factor, f) in ((k, part) for k, function in enumerate(functions) for part in parts(function)):
            if isinstance(f, Harmonic):
                i = 1 + 2 * self.frequencies.index(f.frequency)
                amplitudes[i, k] += factor * f.amplitude * math.cos(f.phase)
                amplitudes[i + 1, k] += factor * f.amplitude * math.sin(f.phase)
            elif isinstance(f, Constant):
                amplitudes[0, k] += factor * f.level
            else:  # records are equal by their numbers, other functions only themselves
                at = [x is f or (isinstance(x, Sampled) and x == f) for x in others].index(True)
                amplitudes[self.size + at, k] += factor
        return amplitudes

    @cached_property
    def edges(self) -> Array:
        """The times of all samples, in order: between two of them every record is a polynomial."""
        # The empty array is for systems without records: an empty list cannot be concatenated.
        return np.unique(np.concatenate([np.zeros(0), *(record.t for record in self.records)]))

    @cached_property
    def table(self) -> Array:
        """(edges, R, 4): coefficient k of s^k in every record at an edge + s, up to the next edge."""
        table = np.zeros((len(self.edges), len(self.records), 4))
        for r, record in enumerate(self.records):  # where one has not begun, or has ended, it is not asked for
            table[:, r] = record.taylor(self.edges)
        return table

    def require_samples(self, t_end: float) -> None:
        """Raise InputError unless all records have samples from 0 to ``t_end``."""
        for record in self.records:
            record.covers(0.0, t_end)

    def require_closed_form(self, what: str) -> None:
        """Raise InputError for functions other than Harmonic, Constant and Sampled; what: needs such ones."""
        for function in self.called:
            rule, remedy = f"be made of Harmonic, Constant and Sampled for {what}", "Sampled(t, values, 'cubic')"
            raise InputError("time function", function, rule, f"sample it: {remedy}")
