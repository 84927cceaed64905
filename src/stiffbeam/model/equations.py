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
    """M q'' + C q' + K q = f. Subclasses give mass, damping, stiffness and solve."""

    def mass(self, x: Array) -> Array:
        """M x."""
        raise NotImplementedError

    def damping(self, x: Array) -> Array:
        """C x."""
        raise NotImplementedError

    def stiffness(self, x: Array) -> Array:
        """K x."""
        raise NotImplementedError

    def solve(self, a: float, b: float, x: Array) -> Array:
        """(M + a C + b K)^-1 x."""
        raise NotImplementedError

    def flow(self, t: float, y: Array, force0: Array, force1: Array) -> Array:
        """y after the time t under a force that goes linearly from force0 to force1, exactly."""
        raise NotImplementedError

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


class Matrices(Equation):
    """Matrices (n, n); factorisations are kept, so a fixed step pays for one."""

    def __init__(self, mass: Array, damping: Array, stiffness: Array) -> None:
        self._mass, self._damping, self._stiffness = mass, damping, stiffness
        self._factors: dict[tuple[Any, ...], Any] = {}

    @property
    def solved(self) -> list[tuple[Any, ...]]:
        """The pairs (a, b) of all solves, and ("flow", t) of flows."""
        return list(self._factors)

    def mass(self, x: Array) -> Array:
        """M x for every row of x, shape (..., n)."""
        return x @ self._mass

    def damping(self, x: Array) -> Array:
        """C x for every row of x."""
        return x @ self._damping.T

    def stiffness(self, x: Array) -> Array:
        """K x for every row of x."""
        return x @ self._stiffness

    def solve(self, a: float, b: float, x: Array) -> Array:
        """By triangular factors, kept for every pair (a, b); x has shape (..., n)."""
        # A run of fixed steps uses one pair (a, b) or a few: each is factorised once.
        if (a, b) not in self._factors:
            self._factors[a, b] = _solver(self._mass + a * self._damping + b * self._stiffness)
        flat = x.reshape(-1, x.shape[-1]).T
        # An overflow goes on as infinity, which the march sees.
        return self._factors[a, b](flat, check_finite=False).T.reshape(x.shape)

    def flow(self, t: float, y: Array, force0: Array, force1: Array) -> Array:
        """By the exponential of the block matrix of (q, v), kept for every t."""
        if ("flow", t) not in self._factors:
            self._factors["flow", t] = _flow(self._mass, self._damping, self._stiffness, t)
        fastest, E, P, Q = self._factors["flow", t]
        state = np.concatenate([y[0], y[1] / fastest], axis=-1)
        new = state @ E.T + force0 @ P.T + (force1 - force0) @ Q.T
        n = len(self._mass)
        return np.array([new[..., :n], new[..., n:] * fastest])


def _solver(matrix: Array) -> Callable[..., Array]:
    """x -> matrix^-1 x, by Cholesky's factor where the matrix is symmetric and positive definite."""
    if np.array_equal(matrix, matrix.T):
        with suppress(np.linalg.LinAlgError):
            return partial(scipy.linalg.cho_solve, scipy.linalg.cho_factor(matrix))
    return partial(scipy.linalg.lu_solve, scipy.linalg.lu_factor(matrix))


def _flow(mass: Array, damping: Array, stiffness: Array, t: float) -> tuple[float, Array, Array, Array]:
    """The speed that velocities are divided by, and e^{At}, t phi_1(At) B, t phi_2(At) B of y' = A y + B f, y = (q, v):
    what a state, a force and its change over t do."""
    n, inverse = len(mass), np.linalg.inv(mass)
    # Velocities in units of the fastest motion, so that the two halves are of one size.
    fastest = np.sqrt(np.max(np.abs(inverse @ stiffness), initial=0.0)) or 1.0 / t
    # One exponential gives all three: that of [[A, B, 0], [0, 0, I], [0, 0, 0]], with A and B times t (Van Loan).
    whole = np.zeros((4 * n, 4 * n))
    whole[:n, n : 2 * n] = fastest * t * np.eye(n)
    whole[n : 2 * n, : 2 * n] = -t * np.hstack([inverse @ stiffness / fastest, inverse @ damping])
    whole[n : 2 * n, 2 * n : 3 * n], whole[2 * n : 3 * n, 3 * n :] = t * inverse / fastest, np.eye(n)
    E, P, Q = np.split(scipy.linalg.expm(whole)[: 2 * n], [2 * n, 3 * n], axis=1)
    return fastest, E.copy(), P.copy(), Q.copy()  # without the matrix that they are parts of


class Modal(Equation):
    """Mass-normalised modes: M = I, C = diag(damping), K = diag(omega^2)."""

    def __init__(self, omega: Array, damping: Array) -> None:
        self._damping, self._stiffness = damping, omega**2
        self._flows: dict[float, tuple[Array, ...]] = {}

    def mass(self, x: Array) -> Array:
        """x: the modes are mass-normalised."""
        return x

    def damping(self, x: Array) -> Array:
        """x times the damping of each mode."""
        return self._damping * x

    def stiffness(self, x: Array) -> Array:
        """x times omega^2 of each mode."""
        return self._stiffness * x

    def solve(self, a: float, b: float, x: Array) -> Array:
        """One division a mode."""
        return x / (1.0 + a * self._damping + b * self._stiffness)

    def flow(self, t: float, y: Array, force0: Array, force1: Array) -> Array:
        """By ``oscillation`` of each mode, kept for every t."""
        if t not in self._flows:
            self._flows[t] = oscillation(np.sqrt(self._stiffness), self._damping, t)
        C, S, rate, V, X = self._flows[t]
        q, v = y
        slope = (force1 - force0) / t
        position = C * q + S * v + V * force0 + X * slope
        return np.array([position, rate * v - self._stiffness * S * q + S * force0 + V * slope])


def oscillation(omega: Array, damping: Array, t: float) -> tuple[Array, ...]:
    """C, S, S', V, X at t of x'' + c x' + omega^2 x = f: x = C from x(0) = 1, x = S from x'(0) = 1, and from rest
    x = V for f = 1, x = X for f = time.

    C = 1 - omega^2 V, S = V' = X'', S' = 1 - c S - omega^2 V. By cosine and sine; of a slow mode, whose 1 - C would
    cancel, by the exponential of the equation with time in units of t.
    """
    c, sigma = damping, 0.5 * damping
    # Closed form: cosine and sine below critical damping, two decaying exponentials above.
    root = sigma**2 - omega**2
    wide = np.sqrt(np.abs(root)) * t
    decay = np.exp(-sigma * t)
    safe = np.where(wide > 0.0, wide, 1.0)
    # sigma - sqrt(root) cancels under strong damping, so the slow rate is omega^2/(sigma + sqrt(root)).
    slow = np.exp(-(omega**2) * t / np.where(sigma > 0.0, sigma + np.sqrt(np.maximum(root, 0.0)), 1.0))
    fast = np.exp(-(sigma + np.sqrt(np.maximum(root, 0.0))) * t)
    over = (root >= 0.0) & (wide >= 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        # Near critical damping, wide < 1, the difference of the exponentials cancels: sinh does not.
        sinc = np.where(root < 0.0, np.sin(wide) / safe, np.where(wide < 1.0, np.sinh(wide) / safe, 0.0))
        sinc = np.where(wide > 0.0, sinc, 1.0)
        S = np.where(over, t * (slow - fast) / (2.0 * safe), decay * t * sinc)
        even = np.where(root < 0.0, np.cos(wide), np.cosh(np.minimum(wide, 1.0)))
        even = np.where(over, 0.5 * (slow + fast), decay * even)
        # Undamped, 1 - cos as 2 sin^2 of half the angle, which does not cancel.
        less = np.where((c == 0.0), 2.0 * np.sin(0.5 * wide) ** 2, 1.0 - even - sigma * S)  # 1 - C, C = even + sigma S
        squares = np.where(omega > 0.0, omega**2, 1.0)
        V, X = less / squares, (t - S - c * less / squares) / squares
    C, rate = even + sigma * S, even - sigma * S
    # Slow modes: the columns are those of x, x', a constant force and one that grows with time.
    few = omega * t < 0.5
    A = np.zeros((np.count_nonzero(few), 4, 4))
    A[:, 0, 1] = A[:, 1, 2] = A[:, 2, 3] = 1.0
    A[:, 1, 0], A[:, 1, 1] = -((omega[few] * t) ** 2), -c[few] * t
    E = scipy.linalg.expm(A)
    C[few], rate[few] = E[:, 0, 0], E[:, 1, 1]
    S[few], V[few], X[few] = t * E[:, 0, 1], t**2 * E[:, 0, 2], t**3 * E[:, 0, 3]
    return C, S, rate, V, X
