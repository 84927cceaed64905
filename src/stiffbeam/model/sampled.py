"""A function of time known by samples: a polygon or a cubic spline, a polynomial between any two of them; noise."""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array, freeze, is_read_only, read_only
from ..basics.resources import afford
from ..basics.validation import InputError, instance, integer, itself, non_negative, numbers, one_of, positive, sequence

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
        # Slopes that overflow are refused once, here, and not at every evaluation.
        with np.errstate(over="ignore", invalid="ignore"):
            if not np.all(np.isfinite(self.pieces)):
                remedy = "check the times: two lie so close that slopes overflow"
                raise InputError("sampled.values", "slopes that overflow", "be representable in float64", remedy)

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
    def slopes(self) -> Array:
        """m_i of the cubic kind, as doubles; NaN where float64 cannot hold the spline."""
        from scipy.interpolate import CubicSpline

        try:
            return np.asarray(CubicSpline(self.t, self.values)(self.t, 1))
        except (
            ValueError,
            np.linalg.LinAlgError,
        ):  # a divided difference overflows, or two times are one beside others
            return np.full(len(self.t), np.nan)

    @cached_property
    def pieces(self) -> Array:
        """(samples - 1, 4): coefficient k of (t - t_i)^k between samples i and i + 1, of the ``derivative``-th."""
        # Hermite's cubics from values and slopes; a polygon has its rise alone.
        h, pieces = np.diff(self.t), np.zeros((len(self.t) - 1, 4))
        rise = np.diff(self.values) / h
        pieces[:, 0], pieces[:, 1] = self.values[:-1], rise
        if self.kind == "cubic":
            m = self.slopes
            pieces[:, 1] = m[:-1]
            pieces[:, 2] = (3.0 * rise - 2.0 * m[:-1] - m[1:]) / h
            pieces[:, 3] = (m[:-1] + m[1:] - 2.0 * rise) / h**2
        for _ in range(self.derivative):
            pieces = pieces[:, 1:] * np.arange(1, pieces.shape[1])
        # Four columns for every kind, so that records of different kinds stand in one table.
        return np.pad(pieces, ((0, 0), (0, 4 - pieces.shape[1])))

    def piece_at(self, t: ArrayLike) -> NDArray[np.int64]:
        """The sample that a time follows; the later one at a sample. Raises InputError outside the samples."""
        t = np.asarray(t, float)
        self.covers(float(np.min(t, initial=self.t[0])), float(np.max(t, initial=self.t[-1])))
        if not np.all(np.isfinite(t)):
            raise InputError("t", "a time that is not finite", "be a time", "look at what it was computed from")
        return np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)

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
        t = np.asarray(t, float)
        i = self.piece_at(t)
        return moved(self.pieces[i], t - self.t[i])

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
        if t.ndim == 0 and self.t[0] <= t <= self.t[-1]:  # one time, as an adaptive solver asks
            i = min(bisect_right(self._times, t) - 1, len(self._times) - 2)
            return np.asarray(_horner(self._rows[order][i], float(t) - self._times[i]))
        # Arrays, and times outside the samples, for which ``piece_at`` raises.
        i = self.piece_at(t)
        c = self._columns[order][i]
        return _horner([c[..., k] for k in range(c.shape[-1])], t - self.t[i])

    @cached_property
    def _columns(self) -> list[Array]:
        """Coefficients of every derivative (samples - 1, ...)."""
        columns = [self.pieces[:, : self.degree + 1]]
        for _ in range(self.degree):
            columns.append(columns[-1][:, 1:] * np.arange(1, columns[-1].shape[1]))
        return columns

    @cached_property
    def _rows(self) -> list[list[list[float]]]:
        return [c.tolist() for c in self._columns]

    @cached_property
    def _times(self) -> list[float]:
        return self.t.tolist()

    def derived(self, times: int) -> Sampled:
        """f' or f''. Raises InputError where that would hold impulses."""
        if times > self.degree:
            self._derivative(self.t[0], times)
        return Sampled(self.t, self.values, self.kind, self.derivative + times)


def _horner(c: Any, s: Any) -> Any:
    """sum_k c_k s^k."""
    value = c[-1]
    for k in range(len(c) - 2, -1, -1):
        value = value * s + c[k]
    return value


def moved(c: Array, s: ArrayLike) -> Array:
    """The coefficients (..., P) of p(s + .) from those of p: Horner's scheme, as often as there are any to move."""
    # On a copy: coefficient k collects s times the one above it, the last ones first.
    c, last = np.array(c), np.shape(c)[-1] - 1
    for first in range(last):
        for k in range(last - 1, first - 1, -1):
            c[..., k] += s * c[..., k + 1]
    return c


NUMBERS = 24.0  # kept for each sample at most, with the coefficients of its cubic
PER_PERIOD = 16  # samples in the shortest period: the spline between them is off by 1e-4 of it


def noise(t_end: float, rms: float, band: tuple[float, float], seed: int) -> Sampled:
    """Return f(t) = rms sqrt(2/n) sum_k cos(w_k t + phase_k) on [0, t_end], as a cubic record.

    The w_k are the n multiples of 2 pi/t_end in the band. The spectrum is flat in the band and zero outside; the mean
    square over t_end is rms^2.

    Parameters
    ----------
    t_end : float
    rms : float
        Root mean square, in the unit of the load.
    band : (float, float)
        Lowest and highest angular frequency.
    seed : int
        Seed of the uniform phases.

    Returns
    -------
    Sampled

    Raises
    ------
    InputError
        For a band without a multiple of 2 pi/t_end.

    Examples
    --------
    >>> import numpy as np
    >>> import stiffbeam as sb
    >>> record = sb.noise(t_end=10.0, rms=2.0, band=(5.0, 50.0), seed=1)
    >>> round(float(np.sqrt(np.mean(record.values[:-1] ** 2))), 6)
    2.0
    """
    base = 2.0 * np.pi / positive("t_end", t_end)
    ends = sequence("band", band, "be two frequencies", "for example (1.0, 10.0)")
    if len(ends) != 2:
        raise InputError("band", band, "be two frequencies", "for example (1.0, 10.0)")
    low, high = non_negative("band", ends[0]), positive("band", ends[1])
    # A band that ends at a multiple of the base holds it, however the quotient is rounded.
    count = PER_PERIOD * np.floor(high / base * (1 + 1e-12))
    # Before the conversion to an integer: a quotient may be infinite.
    afford("band", tuple(band), "lower its upper end, or shorten t_end", floats=NUMBERS * count)
    count = int(count)
    # From 1: the mean stays zero.
    k = np.arange(max(1, int(np.ceil(low / base))), count // PER_PERIOD + 1)
    if not len(k):
        raise InputError("band", tuple(band), f"hold a multiple of 2 pi/t_end = {base:.6g}", "widen it")
    phases = np.random.default_rng(integer("seed", seed, 0)).uniform(0.0, 2.0 * np.pi, len(k))
    spectrum = np.zeros(count // 2 + 1, complex)
    spectrum[k] = 0.5 * count * np.exp(1j * phases)  # irfft gives sum_k cos(2 pi j k/count + phase_k) at sample j
    # n cosines have the mean square n/2.
    values = positive("rms", rms) * np.sqrt(2.0 / len(k)) * np.fft.irfft(spectrum, count)
    # The last sample repeats the first: the sum of cosines has the period t_end.
    return Sampled(np.linspace(0.0, t_end, count + 1), np.append(values, values[0]), "cubic")


def random_phases(record: Sampled, seed: int) -> Sampled:
    """Return a record with the amplitude spectrum of another one and random phases.

    Mean and mean square of the values are those of the record. The last sample repeats the first.

    Parameters
    ----------
    record : Sampled
        Equidistant.
    seed : int
        Seed of the uniform phases.

    Returns
    -------
    Sampled

    Raises
    ------
    InputError
        For times that are not equidistant.

    Examples
    --------
    >>> import numpy as np
    >>> import stiffbeam as sb
    >>> t = np.linspace(0.0, 10.0, 501)
    >>> measured = sb.Sampled(t, np.sin(3.0 * t) + 0.5 * np.cos(17.0 * t))
    >>> other = sb.random_phases(measured, seed=1)
    >>> bool(np.isclose(np.mean(other.values[:-1] ** 2), np.mean(measured.values[:-1] ** 2)))
    True
    """
    instance("record", record, Sampled, "make one with stiffbeam.Sampled(t, values)")
    step = np.diff(record.t)
    # The FFT takes equal steps.
    if len(step) < 3 or np.ptp(step) > 1e-6 * step[0]:
        raise InputError("record", record, "have equidistant samples", "sample it: Sampled(t, record.value(t), kind)")
    values = record.value(record.t)[:-1]
    spectrum = np.fft.rfft(values)
    phases = np.random.default_rng(integer("seed", seed, 0)).uniform(0.0, 2.0 * np.pi, len(spectrum))
    # The mean keeps its value.
    phases[0] = 0.0
    if len(values) % 2 == 0:
        phases[-1] = 0.0  # a real record has a real last line
    new = np.fft.irfft(spectrum * np.exp(1j * phases), len(values))
    return Sampled(record.t, np.append(new, new[0]), record.kind)
