"""Time functions as numbers: harmonics g(t) = (1, sin w1 t, cos w1 t, sin w2 t, ...), and polynomials between
samples."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import InputError, exact_value
from .sampled import Sampled, moved
from .time_functions import Constant, Harmonic, LoadFunction, parts, parts_of

if TYPE_CHECKING:
    from .system import System

Term = tuple[Array, LoadFunction]
SPAN = 32  # steps from one sine to the next
# Systems cannot change, so a drive is computed once. Weak keys: the table keeps no system alive.
_KNOWN: WeakKeyDictionary[System, Drive] = WeakKeyDictionary()


@dataclass(frozen=True)
class Drive:
    """The d = 1 + 2 F functions of time that the harmonic and constant loads of a system are made of, and its
    R ``records``, the Sampled functions among its loads and offsets, each once.

    Two frequencies that are equal in float64 but not exactly count as two: multiprecision distinguishes them.
    """

    frequencies: tuple[float, ...]
    records: tuple[Sampled, ...] = ()

    @classmethod
    def of(cls, system: System) -> Drive:
        """The drive of all loads and all stop motions of ``system``; made once."""
        if system in _KNOWN:
            return _KNOWN[system]
        leaves = [leaf for function in system.time_functions for leaf in parts_of(function)]
        # Frequencies are distinguished by their exact values, see the docstring of the class.
        frequencies = {exact_value(f.frequency): f.frequency for f in leaves if isinstance(f, Harmonic)}
        records = dict.fromkeys(f for f in leaves if isinstance(f, Sampled))
        return _KNOWN.setdefault(system, cls(tuple(sorted(frequencies.values())), tuple(records)))

    @property
    def size(self) -> int:
        """d."""
        return 1 + 2 * len(self.frequencies)

    @cached_property
    def rates(self) -> Array:
        """The angular frequency of each of the d functions, 0 for the constant."""
        return np.concatenate([[0.0], np.repeat(self.frequencies, 2)])

    def coefficients(self, t: ArrayLike) -> Array:
        """g(t), shape t.shape + (d,)."""
        phase = np.multiply.outer(np.asarray(t, float), np.asarray(self.frequencies, float))
        g = np.ones((*np.shape(t), self.size))
        g[..., 1::2], g[..., 2::2] = np.sin(phase), np.cos(phase)
        return g

    def at_steps(self, first: int, count: int, dt: float) -> Array:
        """g at the times (first + k) dt, k < count, (count, d).

        Every SPAN-th by sine and cosine and those between by e^(i (a + b)) = e^(i a) e^(i b): no error adds up from
        one to the next, and each is within eps (w t + 4), what rounding w t costs and the products.
        """
        # Sines at every SPAN-th time only: they cost more than the complex product that gives the others.
        anchors = (first + SPAN * np.arange(-(-count // SPAN))) * dt
        far, near = (np.exp(1j * np.multiply.outer(t, self.frequencies)) for t in (anchors, np.arange(SPAN) * dt))
        turned = (far[:, None] * near).reshape(SPAN * len(anchors), len(self.frequencies))[:count]
        g = np.ones((count, self.size))
        g[:, 1::2], g[:, 2::2] = np.imag(turned), np.real(turned)
        return g

    def transition(self, tau: float) -> Array:
        """T with g(t + tau) = T g(t), (d, d)."""
        T = np.eye(self.size)
        for i, frequency in enumerate(self.frequencies):
            s, c = np.sin(frequency * tau), np.cos(frequency * tau)
            k = 1 + 2 * i
            T[k : k + 2, k : k + 2] = [[c, s], [-s, c]]
        return T

    def derivative(self) -> Array:
        """D with g'(t) = D g(t), (d, d)."""
        D = np.zeros((self.size, self.size))
        for i, frequency in enumerate(self.frequencies):
            k = 1 + 2 * i
            D[k, k + 1], D[k + 1, k] = frequency, -frequency
        return D

    def split(self, terms: Iterable[Term], width: int) -> tuple[Array, list[Term]]:
        """sum_k p_k f_k(t) = g(t) @ basis + sum over the rest; basis is (d, width).

        A Superposition is taken term by term. The rest are the terms that are neither Harmonic nor Constant.
        """
        basis, rest = np.zeros((self.size, width)), []
        for vector, function in ((factor * p, f) for p, whole in terms for factor, f in parts(whole)):
            # The rows stand in the order of ``coefficients``: the constant, then sine and cosine of each frequency.
            if isinstance(function, Harmonic):
                k = 1 + 2 * self.frequencies.index(function.frequency)
                basis[k] += function.sine * vector
                basis[k + 1] += function.cosine * vector
            elif isinstance(function, Constant):
                basis[0] += function.level * vector
            else:
                rest.append((vector, function))
        return basis, rest

    def offsets(self, system: System) -> tuple[Array, list[Term]]:
        """The channel offsets o_c(t) as ``split``: basis (d, channels)."""
        units = np.eye(len(system.channels))
        terms = [(units[c], o) for c, (_, o) in enumerate(system.channels) if o is not None]
        return self.split(terms, len(system.channels))

    def recorded(self, rest: Iterable[Term], width: int) -> Array:
        """The rest of ``split`` as amplitudes of the records, (R, width). Raises InputError for a term that is none."""
        amplitudes = np.zeros((len(self.records), width))
        for vector, function in rest:
            if not isinstance(function, Sampled):
                rule, remedy = (
                    "be made of Harmonic, Constant and Sampled for a closed form",
                    "use the adaptive solver cvode",
                )
                raise InputError("time function", function, rule, remedy)
            amplitudes[self.records.index(function)] += vector
        return amplitudes

    @cached_property
    def edges(self) -> Array:
        """The times of all samples, in order: between two of them every record is a polynomial."""
        # The empty array is for systems without records: an empty list cannot be concatenated.
        return np.unique(np.concatenate([np.zeros(0), *(record.t for record in self.records)]))

    def next_edge(self, t: float, t_end: float) -> float:
        """The first edge after t, or ``t_end`` where that comes before."""
        k = int(np.searchsorted(self.edges, t, side="right"))
        return min(float(self.edges[k]), t_end) if k < len(self.edges) else t_end

    @cached_property
    def order(self) -> int:
        """P, the number of coefficients of a record between two edges."""
        return 1 + max((record.degree for record in self.records), default=-1)

    @cached_property
    def table(self) -> Array:
        """(edges, R, P): ``polynomials`` at the edges."""
        if not self.records:
            return np.zeros((0, 0, 0))
        inside = [np.clip(self.edges, r.t[0], r.t[-1]) for r in self.records]  # where a record has ended none is asked
        return np.stack([r.taylor(t)[:, : self.order] for r, t in zip(self.records, inside, strict=True)], axis=1)

    def polynomials(self, t: ArrayLike) -> Array:
        """(..., R, P): coefficient k of s^k in every record at t + s, up to the next edge; t within the samples."""
        if not self.records:
            return np.zeros((*np.shape(t), 0, 0))
        # At an edge the polynomial that begins there; at the last edge the one that ends there.
        k = np.clip(np.searchsorted(self.edges, t, side="right") - 1, 0, len(self.edges) - 2)
        return moved(self.table[k], np.asarray(t - self.edges[k])[..., None])

    def offset(self, system: System, channel: int) -> Callable[[Array], tuple[Array, Array]]:
        """t -> (o(t), o'(t)) of a channel whose offset is in closed form."""
        basis, rest = self.offsets(system)
        column, recorded = basis[:, channel], self.recorded(rest, basis.shape[1])[:, channel]
        still, known = not np.any(column), not np.any(recorded)

        def values(t: Array) -> tuple[Array, Array]:
            o, rate = np.zeros(np.shape(t)), np.zeros(np.shape(t))
            if not still:
                g = self.coefficients(t)
                o, rate = g @ column, g @ self.derivative().T @ column
            if not known:
                c = np.einsum("r,...rk->...k", recorded, self.polynomials(t))
                o, rate = o + c[..., 0], rate + (c[..., 1] if self.order > 1 else 0.0)
            return o, rate

        return values


def stays_at_rest(system: System) -> bool:
    """Return True if q = 0 at all times: the system starts at 0 without velocity, and no load or stop pushes it.

    A bare callable, whose values are not known, and a stop that moves count as a push.
    """
    if np.any(system.q0) or np.any(system.v0) or any(np.any(p) and not _zero(f) for p, f in system.loads):
        return False
    return all(
        _zero(contact.offset) and contact.stops.lower_bound <= 0.0 <= contact.stops.upper_bound
        for contact in system.contacts
    )


def _zero(function: LoadFunction | None) -> bool:
    return all(
        factor == 0.0
        or (isinstance(f, Harmonic) and f.amplitude == 0.0)
        or (isinstance(f, Constant) and f.level == 0.0)
        or (isinstance(f, Sampled) and not np.any(f.values))
        for factor, f in parts(function)
    )
