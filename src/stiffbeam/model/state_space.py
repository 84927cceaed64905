"""A system as y' = A y + ..., contacts included: the numbers that ``ode`` and the adaptive solvers read.

Matrices give y = (q_1, q_1', ..., q_n, q_n'). The paper's forms give the y of (3.5) and (3.12), whose matrices are
banded and have rounded entries that do not perturb the lowest frequencies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg

from ..basics.arrays import Array
from .contact import Contact
from .stencils import bending_stencil, velocity_curvature_matrices
from .time_functions import LoadFunction, offset_rate, offset_values

if TYPE_CHECKING:
    from .system import System


@dataclass(frozen=True, eq=False, kw_only=True)
class StateContact:
    """A contact on y: the force column * F(row @ y + offset(t))."""

    row: Array
    column: Array
    contact: Contact


@dataclass(frozen=True, eq=False, kw_only=True)
class StateSpace:
    """y' = A y + sum_k b_k f_k(t) + sum_c column_c F_c(row_c y + o_c(t)),  m unknowns.

    matrix: A (m, m). loads: pairs (b_k, f_k). y0: (m,). to_q, to_v: (n, m), q = to_q y and q' = to_v y.
    """

    matrix: Array
    loads: tuple[tuple[Array, LoadFunction], ...]
    contacts: tuple[StateContact, ...]
    y0: Array
    to_q: Array
    to_v: Array
    system: System

    def velocity_row(self, contact: StateContact) -> Array:
        """(m,): the velocity of a contact point is velocity_row @ y + o'(t)."""
        return self.to_v.T @ contact.contact.row

    def contact_motion(self, contact: StateContact, t: float, y: Array) -> tuple[float, float]:
        """Position and velocity of a contact point against its stops."""
        offset = contact.contact.offset
        position = contact.row @ y + offset_values(offset, t)
        return float(position), float(self.velocity_row(contact) @ y + offset_rate(offset, t))

    @cached_property
    def bandwidths(self) -> tuple[int, int]:
        """(lower, upper) bandwidth of the Jacobian."""
        pattern = self.matrix != 0.0
        for c in self.contacts:
            column = c.column != 0.0
            pattern = pattern | np.outer(column, c.row != 0.0)
            if c.contact.stops.dissipative:
                pattern = pattern | np.outer(column, self.velocity_row(c) != 0.0)
        i, j = np.nonzero(pattern)
        return int(max(0, np.max(i - j))), int(max(0, np.max(j - i)))


def state_space(system: System) -> StateSpace:
    """y' = A y + ... of a system: (3.5), (3.12), or its matrices with M inverted."""
    if system.form == "displacement":
        return _displacement(system)
    return _velocity_curvature(system) if system.form == "velocity-curvature" else interleaved(system)


def descriptor(system: System) -> tuple[Array, StateSpace]:
    """(E, right) with E y' = right(t, y), y = (q_1, q_1', ..., q_n, q_n'), no mass inverted.

    E is (2n, 2n): the identity on the positions, M on the velocities.
    """
    n = system.size
    q, v = slice(0, 2 * n, 2), slice(1, 2 * n, 2)
    E = np.zeros((2 * n, 2 * n))
    E[q, q], E[v, v] = np.eye(n), system.mass
    return E, interleaved(system, inverse=lambda x: x)


def interleaved(system: System, inverse: Callable[[Array], Array] | None = None) -> StateSpace:
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
    return StateSpace(
        matrix=matrix,
        loads=tuple((column(p), f) for p, f in system.loads),
        contacts=tuple(StateContact(row=row(c.row), column=column(c.row), contact=c) for c in system.contacts),
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


def _displacement(system: System) -> StateSpace:
    """(3.5) itself. Its entries are small whole multiples of EI/(m h^4), rounded alike.

    Dividing the stiffness by the mass entry by entry would perturb the lowest frequency by
    eps (w_max/w_1)^2, more than a tight tolerance allows.
    """
    assert system.origin is not None
    M, problem = system.size, system.origin.problem
    H = bending_stencil(M)
    cell = problem.mass_per_length * problem.length / M
    H[-1] *= cell / (0.5 * cell + problem.tip_mass)
    m, fourth = problem.mass_per_length, (M / problem.length) ** 4
    plain = interleaved(system)
    q, v = slice(0, 2 * M, 2), slice(1, 2 * M, 2)
    matrix = plain.matrix.copy()
    matrix[v, q] = 0.0 - problem.stiffness / m * fourth * H
    matrix[v, v] = 0.0 - problem.viscosity / m * fourth * H - problem.mass_damping * np.eye(M)
    return replace(plain, matrix=matrix)


def _velocity_curvature(system: System) -> StateSpace:
    """(3.12) itself: y = (w_0, s_1, w_1, s_2, ..., w_{M-1}, s_M, v_M), banded."""
    assert system.origin is not None
    problem = system.origin.problem
    M, m = system.size, problem.mass_per_length
    _, _, L, R = velocity_curvature_matrices(M, problem.length)
    w, s = slice(0, 2 * M, 2), slice(1, 2 * M, 2)
    size = 2 * M + 1
    matrix = np.zeros((size, size))
    matrix[w, s], matrix[s, w] = L, -(problem.stiffness / m) * R
    matrix[-1, 2 * M - 1] = 1.0  # v_M' = s_M (Remark 4)
    # No signed zeros, as in ``interleaved``.
    matrix += 0.0
    mass = scipy.linalg.cho_factor(system.mass)

    def column(vector: Array) -> Array:
        out = np.zeros(size)
        out[s] = scipy.linalg.cho_solve(mass, vector)
        return out

    # The push of a tip contact is (3/h) sigma e_M, over m, see ``semidiscretisation``.
    h = problem.length / M
    tip, push = np.zeros(size), np.zeros(size)
    tip[-1], push[2 * M - 1] = 1.0, 3.0 / (m * h)
    y0 = np.zeros(size)
    y0[w], y0[s], y0[-1] = L @ system.q0, system.v0, system.q0[-1]
    to_q, to_v = np.zeros((M, size)), np.zeros((M, size))
    to_q[:, w], to_v[:, s] = np.linalg.inv(L), np.eye(M)

    def row(vector: Array) -> Array:
        # The tip is a separate unknown; other points follow from the curvatures.
        return tip if np.array_equal(vector, np.eye(M)[-1]) else vector @ to_q

    def contact(c: Contact) -> StateContact:
        at_tip = row(c.row) is tip
        return StateContact(row=row(c.row), column=push if at_tip else column(c.row), contact=c)

    return StateSpace(
        matrix=matrix,
        loads=tuple((column(p), f) for p, f in system.loads),
        contacts=tuple(contact(c) for c in system.contacts),
        y0=y0,
        to_q=to_q,
        to_v=to_v,
        system=system,
    )
