"""The numbers in which a scheme is stepped: modes, which do not see each other, or all unknowns together."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..model.equations import Equation, FirstOrder, Matrices
from ..model.first_order import FirstOrderSystem
from ..model.modes import Modes
from ..model.system import System
from ..model.time_functions import LoadFunction, evaluate


@dataclass(frozen=True, eq=False)
class Coordinates:
    """x (N,) with q = q(x): y = (x, x') for an equation of second order, y = x for one of first order.

    They fall into ``parts`` that no linear step couples: N of them, or 1. rows: (C, N), channel c is at
    rows[c] @ x + o_c(t). columns: (m, N), what a unit force of a contact adds to the right-hand side.
    """

    system: System
    equation: Equation = field(init=False)
    parts: int = field(init=False)
    rows: Array = field(init=False)
    columns: Array = field(init=False)

    def start(self, q0: Array, v0: Array) -> Array:
        """y (order, N) at t = 0 from initial data (n,)."""
        raise NotImplementedError

    def loads(self, member: System) -> list[tuple[Array, LoadFunction]]:
        """The loads of such a system, their vectors (N,) as parts of the right-hand side."""
        raise NotImplementedError

    def states(self, y: Array) -> tuple[Array, Array]:
        """q and q' (..., n) of y (order, ..., N)."""
        raise NotImplementedError

    def load(self, member: System, t: ArrayLike) -> Array:
        """What its loads add to the right-hand side, (..., N) at times t (...)."""
        total = np.zeros((*np.shape(t), self.rows.shape[1]))
        for vector, function in self.loads(member):
            total += evaluate(function, t)[..., None] * vector
        return total

    def units(self, components: int) -> Array:
        """Unit states (components, batch, N), of all parts at once."""
        if self.parts > 1:
            eye = np.eye(components)
            return np.repeat(eye[..., None], self.parts, axis=2)
        N = self.rows.shape[1]
        return np.moveaxis(np.eye(components * N).reshape(components, N, -1), 1, 2).copy()

    def by_part(self, z: Array) -> Array:
        """States (k, batch, N) -> (parts, components of a part, batch)."""
        k, batch, N = z.shape
        return z.transpose(2, 0, 1) if self.parts > 1 else z.transpose(0, 2, 1).reshape(1, k * N, batch)

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False)
class InModes(Coordinates):
    """The modes of a system whose damping does not couple them."""

    basis: Modes

    def __post_init__(self) -> None:
        rows = np.array([self.basis.force(row) for row, _ in self.system.channels])
        m = len(self.system.contacts)
        self._set(equation=self.basis.equation, parts=len(self.basis.omega), rows=rows, columns=rows[:m])

    def start(self, q0: Array, v0: Array) -> Array:
        """y (order, N) at t = 0."""
        return self.basis.to_modal(np.array([q0, v0]))

    def loads(self, member: System) -> list[tuple[Array, LoadFunction]]:
        """Their vectors (N,) in these coordinates."""
        return [(self.basis.force(vector), f) for vector, f in member.loads]

    def states(self, y: Array) -> tuple[Array, Array]:
        """q and q' (..., n)."""
        return self.basis.to_nodal(y[0]), self.basis.to_nodal(y[1])


@dataclass(frozen=True, eq=False)
class Together(Coordinates):
    """The unknowns of a system as they are, or those of its first-order form ``given``."""

    given: System | FirstOrderSystem

    @classmethod
    def of(cls, given: System | FirstOrderSystem) -> Together:
        """With the system that a first-order one was made from."""
        return cls(given if isinstance(given, System) else given.system, given)

    def __post_init__(self) -> None:
        given = self.given
        if isinstance(given, System):
            rows = np.array([row for row, _ in given.channels])
            columns = rows[: len(given.contacts)]
            equation: Equation = Matrices(given.mass, given.damping, given.stiffness)
        else:
            rows = np.array([c.row for c in given.contacts] + ([] if given.observe is None else [given.observe]))
            columns = np.array([c.column for c in given.contacts]).reshape(-1, len(given.y0))
            equation = FirstOrder(given.matrix)
        self._set(equation=equation, parts=1, rows=rows, columns=columns)

    def start(self, q0: Array, v0: Array) -> Array:
        """y (order, N) at t = 0."""
        return np.array([q0, v0]) if isinstance(self.given, System) else self.given.y0[None]

    def loads(self, member: System) -> list[tuple[Array, LoadFunction]]:
        """Their vectors (N,) in these coordinates."""
        return list(member.loads if isinstance(self.given, System) else self.given.loads)

    def states(self, y: Array) -> tuple[Array, Array]:
        """q and q' (..., n)."""
        if isinstance(self.given, System):
            return y[0], y[1]
        return y[0] @ self.given.to_q.T, y[0] @ self.given.to_v.T
