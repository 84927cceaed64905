"""The linear part of a system as a scheme sees it: "apply K" and "solve M + a C + b K".

A scheme's state is an array z of shape (components, ..., n); its first ``order`` rows are the
first-order variable y: y = (q, q') for a second-order equation, y = (y,) for a first-order one.
Arrays may carry batch axes in the middle, so that many unit states are stepped at once. Each equation offers

    rate(y, f) = A y + B f,   implicit_rate(c, r, f) = k with k = A (r + c k) + B f,   velocity(y), of the positions

to schemes that read it as y' = A y + B f, and one of second order its matrices to those that do not.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from .arrays import Array


class SecondOrder:
    """M q'' + C q' + K q = f. Subclasses give the four operations; the rest is written over them."""

    order = 2

    def mass(self, x: Array) -> Array:
        raise NotImplementedError

    def damping(self, x: Array) -> Array:
        raise NotImplementedError

    def stiffness(self, x: Array) -> Array:
        raise NotImplementedError

    def solve(self, a: float, b: float, x: Array) -> Array:
        """(M + a C + b K)^-1 x."""
        raise NotImplementedError

    def net_force(self, y: Array, force: Array) -> Array:
        """f - C q' - K q."""
        return force - self.damping(y[1]) - self.stiffness(y[0])

    def acceleration(self, y: Array, force: Array) -> Array:
        """q'' = M^-1 (f - C q' - K q)."""
        return self.solve(0.0, 0.0, self.net_force(y, force))

    def velocity(self, y: Array) -> Array:
        return y[1]

    def rate(self, y: Array, force: Array) -> Array:
        """(q', q'')."""
        return np.stack([y[1], self.acceleration(y, force)])

    def implicit_rate(self, c: float, r: Array, force: Array) -> Array:
        """k = (q', q'') at y = r + c k: one solve with M + c C + c^2 K.

        Solved for q'' first: (q - r_q)/c would lose eps |q|/c in the velocity.
        """
        ahead = np.stack([r[0] + c * r[1], r[1]])
        acceleration = self.solve(c, c * c, self.net_force(ahead, force))
        return np.stack([r[1] + c * acceleration, acceleration])


class Matrices(SecondOrder):
    """Full matrices (n, n); factorisations are kept, so a fixed step pays for one."""

    def __init__(self, mass: Array, damping: Array, stiffness: Array) -> None:
        self._mass, self._damping, self._stiffness = mass, damping, stiffness
        self._factors: dict[tuple[float, float], object] = {}

    def mass(self, x: Array) -> Array:
        return x @ self._mass

    def damping(self, x: Array) -> Array:
        return x @ self._damping

    def stiffness(self, x: Array) -> Array:
        return x @ self._stiffness

    def solve(self, a: float, b: float, x: Array) -> Array:
        if (a, b) not in self._factors:
            matrix = self._mass + a * self._damping + b * self._stiffness
            self._factors[a, b] = scipy.linalg.cho_factor(matrix)
        flat = x.reshape(-1, x.shape[-1]).T
        return scipy.linalg.cho_solve(self._factors[a, b], flat).T.reshape(x.shape)


class Modal(SecondOrder):
    """Mass-normalised modes: M = I, C = diag(damping), K = diag(omega^2)."""

    def __init__(self, omega: Array, damping: Array) -> None:
        self._damping, self._stiffness = damping, omega**2

    def mass(self, x: Array) -> Array:
        return x

    def damping(self, x: Array) -> Array:
        return self._damping * x

    def stiffness(self, x: Array) -> Array:
        return self._stiffness * x

    def solve(self, a: float, b: float, x: Array) -> Array:
        return x / (1.0 + a * self._damping + b * self._stiffness)


class FirstOrder:
    """y' = A y + f with a full matrix A (n, n); the rows of z are one y each."""

    order = 1

    def __init__(self, matrix: Array) -> None:
        self._matrix = matrix
        self._factors: dict[float, object] = {}

    def velocity(self, y: Array) -> Array:
        return y[0] @ self._matrix.T

    def rate(self, y: Array, force: Array) -> Array:
        return y @ self._matrix.T + force

    def implicit_rate(self, c: float, r: Array, force: Array) -> Array:
        if c not in self._factors:
            self._factors[c] = scipy.linalg.lu_factor(np.eye(len(self._matrix)) - c * self._matrix)
        right = self.rate(r, force)
        flat = right.reshape(-1, right.shape[-1]).T
        return scipy.linalg.lu_solve(self._factors[c], flat).T.reshape(right.shape)
