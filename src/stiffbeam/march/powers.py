"""A step map raised to powers by squaring, and what is made by doubling with them."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..basics.arrays import Array
from .coordinates import InModes
from .probe import StepMap


class Powers:
    """A step map's transition A to the powers 2^i, (n, k, k) each, and what is made by doubling with them.

    ``turn``: every undamped mode that a scheme turns, as A turns (omega q, q'), is turned by 2^i times the angle of
    one step. Step by step the rounding of one step's turn comes in again and again, the same in every block, and is
    work that no force has done: 1e-10 of the energy in 1e6 steps.
    """

    def __init__(self, one: StepMap, steps: int, turn: bool) -> None:
        self.steps = steps
        self.levels = [one.transition]
        rotation = _Rotation(one) if turn and isinstance(one.coordinates, InModes) else None
        if rotation is not None:
            self.levels[0] = rotation.put(self.levels[0], 1)
        while 2 ** len(self.levels) <= steps:
            squared = self.levels[-1] @ self.levels[-1]
            if rotation is not None:
                squared = rotation.put(squared, 2 ** len(self.levels))
            self.levels.append(squared)

    @cached_property
    def last(self) -> Array:
        """A^steps."""
        found = None
        for i, level in enumerate(self.levels):
            if self.steps >> i & 1:
                found = level if found is None else found @ level
        assert found is not None
        return found

    def readings(self, reading: Array) -> Array:
        """reading A^j of (n, g, k) for j < steps: (n, steps, g, k)."""
        n, g, k = reading.shape
        made, done = np.empty((n, self.steps, g, k)), 1
        made[:, 0] = reading
        for level in self.levels:
            more = min(done, self.steps - done)
            if more > 0:
                made[:, done : done + more] = (made[:, :more].reshape(n, more * g, k) @ level).reshape(n, more, g, k)
                done += more
        return made

    def pushes(self, push: Array) -> Array:
        """A^j push of (n, k, p) for j < steps: (n, k, steps, p)."""
        n, k, p = push.shape
        made, done = np.empty((n, k, self.steps, p)), 1
        made[:, :, 0] = push
        for level in self.levels:
            more = min(done, self.steps - done)
            if more > 0:
                made[:, :, done : done + more] = (level @ made[:, :, :more].reshape(n, k, -1)).reshape(n, k, more, p)
                done += more
        return made


class _Rotation:
    """The undamped modes whose q and q', the first two components, a step turns; see Powers."""

    def __init__(self, one: StepMap) -> None:
        assert isinstance(one.coordinates, InModes)
        basis, A = one.coordinates.basis, one.transition[:, :2, :2]
        self.w = np.where(basis.omega > 0.0, basis.omega, 1.0)
        self.angle = np.arctan2(0.5 * (self.w * A[:, 0, 1] - A[:, 1, 0] / self.w), 0.5 * (A[:, 0, 0] + A[:, 1, 1]))
        size = np.moveaxis(np.array([[np.ones_like(self.w), 1.0 / self.w], [self.w, np.ones_like(self.w)]]), -1, 0)
        turns = (basis.omega > 0.0) & (basis.damping == 0.0)
        self.turns = turns & np.all(np.abs(A - self._by(1)) < 1e-9 * size, axis=(1, 2))

    def _by(self, steps: int) -> Array:
        c, s = np.cos(steps * self.angle), np.sin(steps * self.angle)
        return np.moveaxis(np.array([[c, s / self.w], [-self.w * s, c]]), -1, 0)

    def put(self, power: Array, steps: int) -> Array:
        exact = power.copy()
        exact[:, :2, :2] = np.where(self.turns[:, None, None], self._by(steps), power[:, :2, :2])
        return exact
