"""A system as y' = A y + ..., contacts included, y = (q_1, q_1', ..., q_n, q_n'): the order of (3.5).

The numbers that ``ode`` and the adaptive solvers read. Those of the paper's forms follow from the stencils: their
matrices are banded and have rounded entries that do not perturb the lowest frequencies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg

from ..basics.arrays import Array
from .stencils import bending_stencil, velocity_curvature_matrices
from .time_functions import LoadFunction

if TYPE_CHECKING:
    from .system import System


def on_positions(row: Array) -> Array:
    """The row on y, (..., 2n), of a row on q."""
    out = np.zeros((*row.shape[:-1], 2 * row.shape[-1]))
    out[..., ::2] = row
    return out


def on_velocities(row: Array) -> Array:
    """The row on y, (..., 2n), of a row on q'; also the column of a force on q''."""
    return np.roll(on_positions(row), 1, axis=-1)


@dataclass(frozen=True, eq=False, kw_only=True)
class StateSpace:
    """y' = A y + sum_k b_k f_k(t) + sum_c column_c F_c(row_c q + o_c(t)),  2 n unknowns.

    matrix: A (2n, 2n). loads: pairs (b_k, f_k). columns: (contacts, 2n). system: with q = y[::2] and q' = y[1::2].
    """

    matrix: Array
    loads: list[tuple[Array, LoadFunction]]
    columns: Array
    system: System

    @property
    def y0(self) -> Array:
        """(2n,), the start."""
        return on_positions(self.system.q0) + on_velocities(self.system.v0)

    @cached_property
    def bandwidths(self) -> tuple[int, int]:
        """(lower, upper) bandwidth of the Jacobian."""
        pattern = self.matrix != 0.0
        for column, contact in zip(self.columns, self.system.contacts, strict=True):
            rows = [on_positions(contact.row), *([on_velocities(contact.row)] if contact.stops.dissipative else [])]
            for row in rows:
                pattern = pattern | np.outer(column != 0.0, row != 0.0)
        i, j = np.nonzero(pattern)
        return int(max(0, np.max(i - j))), int(max(0, np.max(j - i)))


def state_space(system: System) -> StateSpace:
    """y' = A y + ... of a system, its mass inverted."""
    divide = _inverse_mass(system.mass)
    if system.form in _OVER_MASS:
        stiffness, damping = _OVER_MASS[system.form](system)
    else:
        stiffness, damping = divide(system.stiffness), divide(system.damping)
    return _interleaved(system, stiffness, damping, divide)


def descriptor(system: System) -> tuple[Array, StateSpace]:
    """(E, right) with E y' = right(t, y), no mass inverted.

    E is (2n, 2n): the identity on the positions, M on the velocities.
    """
    E = np.eye(2 * system.size)
    E[1::2, 1::2] = system.mass
    return E, _interleaved(system, system.stiffness, system.damping, lambda x: x)


def _interleaved(system: System, stiffness: Array, damping: Array, divide: Callable[[Array], Array]) -> StateSpace:
    """Positions and velocities in turn. The arguments are those of q'': those of q' are exact."""
    n = system.size
    matrix = np.zeros((2 * n, 2 * n))
    matrix[::2, 1::2] = np.eye(n)
    matrix[1::2, ::2] = 0.0 - stiffness  # no signed zeros in the Jacobian
    matrix[1::2, 1::2] = 0.0 - damping
    rows = np.array([contact.row for contact in system.contacts]).reshape(-1, n)
    return StateSpace(
        matrix=matrix,
        loads=[(on_velocities(divide(p)), f) for p, f in system.loads],
        columns=on_velocities(np.array([divide(row) for row in rows]).reshape(-1, n)),
        system=system,
    )


def _inverse_mass(mass: Array) -> Callable[[Array], Array]:
    diagonal = np.diag(mass)
    # A diagonal mass divides entry by entry, with one rounding each.
    if not np.any(mass - np.diag(diagonal)):
        return lambda x: (x.T / diagonal).T
    factor = scipy.linalg.cho_factor(mass)
    return lambda x: scipy.linalg.cho_solve(factor, x)


def _displacement(system: System) -> tuple[Array, Array]:
    """M^-1 K and M^-1 C of (3.5): small whole multiples of EI/(m h^4), rounded alike.

    Dividing the stiffness by the mass entry by entry would perturb the lowest frequency by
    eps (w_max/w_1)^2, more than a tight tolerance allows.
    """
    assert system.origin is not None
    M, problem = system.size, system.origin.problem
    cell = problem.mass_per_length * problem.length / M
    H = bending_stencil(M)
    H[-1] *= cell / (0.5 * cell + problem.tip_mass)
    fourth = (M / problem.length) ** 4 / problem.mass_per_length
    return problem.stiffness * fourth * H, problem.viscosity * fourth * H + problem.mass_damping * np.eye(M)


def _velocity_curvature(system: System) -> tuple[Array, Array]:
    """M^-1 K = EI/m R L of (3.12), since P R = L^T Q: banded, where P^-1 is not; and no damping."""
    assert system.origin is not None
    M, problem = system.size, system.origin.problem
    _, _, L, R = velocity_curvature_matrices(M, float(M))  # h = 1: whole multiples of 1/4
    return problem.stiffness / problem.mass_per_length * (M / problem.length) ** 4 * (R @ L), np.zeros((M, M))


_OVER_MASS = {"displacement": _displacement, "velocity-curvature": _velocity_curvature}
