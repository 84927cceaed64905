"""Harmonic and constant time functions as coefficients g(t) = (1, sin w1 t, cos w1 t, sin w2 t, ...)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array
from .system import System
from .time_functions import Constant, Harmonic, LoadFunction

Term = tuple[Array, LoadFunction]


@dataclass(frozen=True)
class Drive:
    """The d = 1 + 2 F functions of time that the harmonic and constant loads of a system are made of."""

    frequencies: tuple[float, ...]

    @classmethod
    def of(cls, system: System) -> Drive:
        functions = [f for _, f in system.loads] + [offset for _, offset in system.channels]
        return cls(tuple(sorted({f.frequency for f in functions if isinstance(f, Harmonic)})))

    @property
    def size(self) -> int:
        """d."""
        return 1 + 2 * len(self.frequencies)

    @property
    def rates(self) -> Array:
        """The angular frequency of each of the d functions, 0 for the constant."""
        return np.concatenate([[0.0], np.repeat(self.frequencies, 2)])

    def coefficients(self, t: ArrayLike) -> Array:
        """g(t), shape t.shape + (d,)."""
        phase = np.multiply.outer(np.asarray(t, float), np.asarray(self.frequencies, float))
        g = np.ones((*np.shape(t), self.size))
        g[..., 1::2], g[..., 2::2] = np.sin(phase), np.cos(phase)
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

        The rest are the terms that are neither Harmonic nor Constant.
        """
        basis, rest = np.zeros((self.size, width)), []
        for vector, function in terms:
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

    def offset(self, system: System, channel: int) -> Callable[[Array], tuple[Array, Array]]:
        """t -> (o(t), o'(t)) of a channel whose offset is harmonic or constant."""
        column = self.offsets(system)[0][:, channel]

        def values(t: Array) -> tuple[Array, Array]:
            g = self.coefficients(t)
            return g @ column, g @ self.derivative().T @ column

        return values
