"""The linear equation M q'' + C q' + K q = f as schemes read it, in matrices or in modes.

A scheme's state is an array z of shape (components, ..., n) whose first two rows are y = (q, q'). Arrays may carry
batch axes in the middle, so that many unit states are stepped at once. A scheme may read the matrices, or

    rate(y, f) = A y + B f,   implicit_rate(c, r, f) = k with k = A (r + c k) + B f.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg

from ..basics.arrays import Array
from ..basics.validation import InputError

# Stages that depend on each other, as of Radau IIA: no scheme's step, but any other program's.
FULLY_IMPLICIT = (
    "a fully implicit method runs everywhere as a function solve(system, dt, t_end), its equation is system.ode()"
)


class Equation:
    """M q'' + C q' + K q = f by its matrices (n, n), or by their diagonals (n,) where modes decouple it.

    Factorisations and exponentials are kept, so that steps of one length pay for one. ``solved`` has them by the pairs
    (a, b) of ``solve`` and by ("flow", t).
    """

    def __init__(self, mass: Array, damping: Array, stiffness: Array) -> None:
        self._mass, self._damping, self._stiffness = mass, damping, stiffness
        self.solved: dict[tuple[Any, ...], Any] = {}

    def mass(self, x: Array) -> Array:
        """M x for every row of x, shape (..., n)."""
        return _product(self._mass, x)

    def damping(self, x: Array) -> Array:
        """C x for every row of x."""
        return _product(self._damping, x)

    def stiffness(self, x: Array) -> Array:
        """K x for every row of x."""
        return _product(self._stiffness, x)

    def solve(self, a: float, b: float, x: Array) -> Array:
        """(M + a C + b K)^-1 x for every row of x."""
        if self._mass.ndim == 1:
            return x / (self._mass + a * self._damping + b * self._stiffness)
        if (a, b) not in self.solved:
            self.solved[a, b] = _solver(self._mass + a * self._damping + b * self._stiffness)
        flat = x.reshape(-1, x.shape[-1]).T
        # An overflow goes on as infinity, which the march sees.
        return self.solved[a, b](flat, check_finite=False).T.reshape(x.shape)

    def flow(self, t: float, y: Array, force0: Array, force1: Array) -> Array:
        """y after the time t under a force that goes linearly from force0 to force1, exactly."""
        decoupled = self._mass.ndim == 1
        if ("flow", t) not in self.solved:
            make = _modal_flow if decoupled else _flow
            self.solved["flow", t] = make(self._mass, self._damping, self._stiffness, t)
        E, P, Q = self.solved["flow", t]
        if decoupled:
            terms = (E[..., 0], y[0]), (E[..., 1], y[1]), (P[..., 0], force0), (Q[..., 0], force1 - force0)
            return np.array([sum(column[:, i] * x for column, x in terms) for i in range(2)])
        new = np.concatenate(list(y), axis=-1) @ E.T + force0 @ P.T + (force1 - force0) @ Q.T
        return np.array(np.split(new, 2, axis=-1))

    def net_force(self, y: Array, force: Array) -> Array:
        """f - C q' - K q."""
        return force - self.damping(y[1]) - self.stiffness(y[0])

    def acceleration(self, y: Array, force: Array) -> Array:
        """q'' = M^-1 (f - C q' - K q)."""
        return self.solve(0.0, 0.0, self.net_force(y, force))

    def rate(self, y: Array, force: Array) -> Array:
        """y' = (q', q'')."""
        return np.array([y[1], self.acceleration(y, force)])

    def implicit_rate(self, c: float, r: Array, force: Array) -> Array:
        """k = (q', q'') at y = r + c k: one solve with M + c C + c^2 K.

        Solved for q'' first: (q - r_q)/c would lose eps |q|/c in the velocity.
        """
        if np.ndim(c):
            rule = "be one number: the stages are solved one after the other"
            raise InputError("implicit_rate: c", f"{np.ndim(c)} dimensions", rule, FULLY_IMPLICIT)
        # The state at the end without the acceleration; the solve gives the acceleration that it lacks.
        ahead = np.array([r[0] + c * r[1], r[1]])
        acceleration = self.solve(c, c * c, self.net_force(ahead, force))
        return np.array([r[1] + c * acceleration, acceleration])


def _product(matrix: Array, x: Array) -> Array:
    return matrix * x if matrix.ndim == 1 else x @ matrix.T


def _solver(matrix: Array) -> Callable[..., Array]:
    """x -> matrix^-1 x, by Cholesky's factor where the matrix is symmetric and positive definite."""
    if np.array_equal(matrix, matrix.T):
        with suppress(np.linalg.LinAlgError):
            return partial(scipy.linalg.cho_solve, scipy.linalg.cho_factor(matrix))
    return partial(scipy.linalg.lu_solve, scipy.linalg.lu_factor(matrix))


def _flow(mass: Array, damping: Array, stiffness: Array, t: float) -> tuple[Array, Array, Array]:
    """e^{At}, t phi_1(At) B, t phi_2(At) B of y' = A y + B f, y = (q, v): what a state, a force and its change over t
    do. The matrices are (..., n, n)."""
    n, inverse = mass.shape[-1], np.linalg.inv(mass)
    # Velocities in units of the fastest motion, so that the two halves are of one size; forces in units of its rates.
    fastest = np.maximum(np.sqrt(np.max(np.abs(inverse @ stiffness), axis=(-1, -2), keepdims=True)), 1.0 / t)
    # One exponential gives all three: that of [[A, B, 0], [0, 0, I], [0, 0, 0]], with A and B times t (Van Loan).
    whole = np.zeros((*mass.shape[:-2], 4 * n, 4 * n))
    whole[..., :n, n : 2 * n] = fastest * t * np.eye(n)
    whole[..., n : 2 * n, :n] = -t * inverse @ stiffness / fastest
    whole[..., n : 2 * n, n : 2 * n] = -t * inverse @ damping
    whole[..., n : 2 * n, 2 * n : 3 * n] = whole[..., 2 * n : 3 * n, 3 * n :] = np.eye(n)
    E, P, Q = np.split(scipy.linalg.expm(whole)[..., : 2 * n, :], [2 * n, 3 * n], axis=-1)
    unit = np.concatenate([np.ones_like(fastest), fastest], axis=-1).repeat(n, axis=-1)
    rows = np.swapaxes(unit, -1, -2)
    return rows * E / unit, rows * P @ (t * inverse / fastest), rows * Q @ (t * inverse / fastest)


@np.errstate(over="ignore", invalid="ignore")  # of exponentials whose place cosine and sine take
def _modal_flow(mass: Array, damping: Array, squares: Array, t: float) -> tuple[Array, Array, Array]:
    """``_flow`` of each mode of mass 1; squares: omega^2."""
    E, P, Q = _flow(mass[:, None, None], damping[:, None, None], squares[:, None, None], t)
    # Of fast modes the exponential loses what the phase turns by: cosine and sine keep their size.
    wide = np.sqrt(np.maximum(squares - 0.25 * damping**2, 0.0))
    fast = wide * t > 1.0
    c, k, wide = damping[fast], squares[fast], wide[fast]
    decay = np.exp(-0.5 * c * t)
    even, S = decay * np.cos(wide * t), decay * np.sin(wide * t) / wide
    C, rate = even + 0.5 * c * S, even - 0.5 * c * S
    V = (1.0 - C) / k
    E[fast] = np.array([[C, S], [-k * S, rate]]).transpose(2, 0, 1)
    P[fast, :, 0] = np.array([V, S]).T
    Q[fast, :, 0] = np.array([(1.0 - (S + c * V) / t) / k, V / t]).T
    return E, P, Q
