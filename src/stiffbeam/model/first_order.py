"""The semi-discrete system as the adaptive solvers and the first-order schemes see it: y' = A y + ..."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.arrays import Array, freeze, same
from .contact import Contact, polar
from .time_functions import LoadFunction, evaluate, offset_rate, offset_values

if TYPE_CHECKING:
    from .system import System


@dataclass(frozen=True, eq=False, kw_only=True)
class FirstOrderContact:
    """The contact of a first-order system: the force column * F(row @ y + offset(t)), of a hole two of both."""

    row: Array
    column: Array
    contact: Contact

    def __post_init__(self) -> None:
        freeze(self, "row", "column")

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()


@dataclass(frozen=True, eq=False, kw_only=True)
class FirstOrderSystem:
    """y' = A y + sum_k b_k f_k(t) + sum_c column_c F_c(row_c y + o_c(t)),  m unknowns.

    Made by ``System.first_order``.

    Parameters
    ----------
    matrix : array (m, m)
        A.
    loads : sequence of (array (m,), time function)
        Pairs (b_k, f_k).
    contacts : sequence of FirstOrderContact
    observe : array (m,), optional
        The row of ``tip`` in y.
    y0 : array (m,)
    to_q, to_v : array (n, m)
        q = to_q y and q' = to_v y of the second-order system.
    system : System
        The system it was made from.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system("velocity-curvature")
    >>> system.first_order().matrix.shape
    (51, 51)
    """

    matrix: Array
    loads: tuple[tuple[Array, LoadFunction], ...]
    contacts: tuple[FirstOrderContact, ...]
    observe: Array | None
    y0: Array
    to_q: Array
    to_v: Array
    system: System

    def __post_init__(self) -> None:
        freeze(self, "matrix", "observe", "y0", "to_q", "to_v")

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()

    def __repr__(self) -> str:
        return f"<FirstOrderSystem of {self.system!r}>"

    def is_of_its_system(self) -> bool:
        """Return True if it is, number by number, the first-order form of ``system``."""
        # By content: a pickled copy has other arrays with the same numbers.
        again = self.system.first_order()
        arrays = [(getattr(self, x), getattr(again, x)) for x in ("matrix", "observe", "y0", "to_q", "to_v")]
        if len(self.loads) != len(again.loads) or len(self.contacts) != len(again.contacts):
            return False
        arrays += [(a, b) for (a, _), (b, _) in zip(self.loads, again.loads, strict=True)]
        arrays += [(getattr(a, x), getattr(b, x)) for a, b in zip(self.contacts, again.contacts, strict=True)
                   for x in ("row", "column")]  # fmt: skip
        functions = [(f, g) for (_, f), (_, g) in zip(self.loads, again.loads, strict=True)]
        functions += [(a.contact, b.contact) for a, b in zip(self.contacts, again.contacts, strict=True)]
        return all(same(a, b) for a, b in arrays) and all(f is g or f == g for f, g in functions)

    def rhs(self, t: float, y: Array) -> Array:
        """f(t, y) of shape (m,)."""
        rate = self.matrix @ y
        for vector, function in self.loads:
            rate = rate + vector * evaluate(function, t)
        for c in self.contacts:
            force = c.contact.stops.force(*self.contact_motion(c, t, y))
            rate = rate + along(c, y, c.column) * force
        return rate

    def velocity_row(self, contact: FirstOrderContact) -> Array:
        """(m,) or (2, m): the velocity of a contact point is velocity_row @ y + o'(t)."""
        return (self.to_v.T @ contact.contact.row.T).T

    def contact_motion(self, contact: FirstOrderContact, t: float, y: Array) -> tuple[float, float]:
        """Position and velocity of a contact point against its stops; of a hole |r| and its rate."""
        offset = contact.contact.offset
        if contact.contact.radial:
            u, rate = polar(contact.row @ y, self.velocity_row(contact) @ y)
            return float(u), float(rate)
        position = contact.row @ y + offset_values(offset, t)
        return float(position), float(self.velocity_row(contact) @ y + offset_rate(offset, t))

    def jacobian(self, t: float, y: Array) -> Array:
        """df/dy of shape (m, m); the one-sided value on the kink of a contact."""
        jacobian = self.matrix.copy()
        for c in self.contacts:
            u, rate = self.contact_motion(c, t, y)
            slope, to_rate = c.contact.stops.tangent(u, rate)
            column, row, velocity_row = (along(c, y, x) for x in (c.column, c.row, self.velocity_row(c)))
            jacobian -= slope * np.outer(column, row)
            # Zero without damping: its outer product is left out.
            if to_rate:
                jacobian -= to_rate * np.outer(column, velocity_row)
            if c.contact.radial and u:
                # The direction turns by t dr/|r|, t at right angles to it, and d' by the velocity along t.
                across = [along(c, y, x, turned=True) for x in (c.column, c.row, self.velocity_row(c))]
                force = float(c.contact.stops.force(u, rate))
                turn = force * across[0] - to_rate * float(across[2] @ y) * column
                jacobian += np.outer(turn, across[1]) / u
        return jacobian

    @cached_property
    def bandwidths(self) -> tuple[int, int]:
        """(lower, upper) bandwidth of the Jacobian."""
        pattern = self.matrix != 0.0
        for c in self.contacts:
            column, row, velocity_row = (np.any(np.atleast_2d(x), 0) for x in (c.column, c.row, self.velocity_row(c)))
            pattern = pattern | np.outer(column, row)
            if c.contact.stops.dissipative:
                pattern = pattern | np.outer(column, velocity_row)
        i, j = np.nonzero(pattern)
        return int(max(0, np.max(i - j))), int(max(0, np.max(j - i)))


def along(contact: FirstOrderContact, y: Array, rows: Array, turned: bool = False) -> Array:
    """``rows`` of a contact along its force: as they are, of a hole in the direction of r or, turned, across it."""
    if not contact.contact.radial:
        return rows
    x, y_ = contact.row @ y
    size = np.hypot(x, y_) or 1.0
    return (np.array([-y_, x]) if turned else np.array([x, y_])) / size @ rows


def of_rows(function: Callable[[Array], Array], rows: Array) -> Array:
    """The function of a row, or of each of two rows."""
    return function(rows) if rows.ndim == 1 else np.array([function(row) for row in rows])


def interleaved(system: System, inverse: Callable[[Array], Array] | None = None) -> FirstOrderSystem:
    """y = (q_1, q_1', ..., q_n, q_n'), the order of (3.5); ``inverse`` stands for M^-1."""
    n = system.size
    q, v = slice(0, 2 * n, 2), slice(1, 2 * n, 2)
    divide = inverse or _inverse_mass(system.mass)

    def column(vector: Array) -> Array:
        out = np.zeros(2 * n)
        out[v] = divide(vector)
        return out

    def row(vector: Array) -> Array:
        out = np.zeros(2 * n)
        out[q] = vector
        return out

    # ``divide`` acts on the rows of q'' only: those of q' are exact.
    matrix = np.zeros((2 * n, 2 * n))
    matrix[q, v] = np.eye(n)
    matrix[v, q] = -divide(system.stiffness)
    matrix[v, v] = -divide(system.damping)
    matrix += 0.0  # no signed zeros in the Jacobian
    y0 = np.zeros(2 * n)
    y0[q], y0[v] = system.q0, system.v0
    to_q, to_v = np.zeros((n, 2 * n)), np.zeros((n, 2 * n))
    to_q[:, q], to_v[:, v] = np.eye(n), np.eye(n)
    return FirstOrderSystem(
        matrix=matrix,
        loads=tuple((column(p), f) for p, f in system.loads),
        contacts=tuple(
            FirstOrderContact(row=of_rows(row, c.row), column=of_rows(column, c.row), contact=c)
            for c in system.contacts
        ),
        observe=None if system.observe is None else row(system.observe),
        y0=y0,
        to_q=to_q,
        to_v=to_v,
        system=system,
    )


def _inverse_mass(mass: Array) -> Callable[[Array], Array]:
    diagonal = np.diag(mass)
    # A diagonal mass divides entry by entry, with one rounding each.
    if not np.any(mass - np.diag(diagonal)):
        return lambda x: (x.T / diagonal).T
    inverse = np.linalg.inv(mass)
    return lambda x: inverse @ x
