"""Schemes whose reaction is constant over the step, for contact="conserving"."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .scheme import Array, Equation, Scheme, Step

Advance = Callable[[Any, float, Array, Array, Array, Array], Array]


class MeanReaction(Scheme):
    """y^{n+1} = advance(y^n; f^n, f^{n+1}, lambda), lambda the mean reaction over the step.

    A constant force does the work lambda . (q^{n+1} - q^n) on the linear system, and ``advance`` conserves
    the energy beside it; so where lambda is the discrete gradient of the stops' energy (see
    stage), kinetic + elastic + stop energy is conserved without loads and damping, whatever
    the step. State: (y, f), the load carried. It has the name of the scheme it is a form of.
    """

    nodes = (1.0,)

    def __init__(self, scheme: Scheme, advance: Advance) -> None:
        self.scheme, self.advance = scheme, advance
        self.order = scheme.order

    @property
    def conserving(self) -> Scheme:
        """The scheme itself: it has this form already."""
        return self

    def initial(self, equation: Equation, history: list[Array], force: Array) -> Array:
        """(y, f) with the load f at the start."""
        return np.concatenate([history[0], force[None]])

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """loads[0] is the load at t_{n+1}, reactions[0] the mean reaction over the step."""
        y = self.advance(equation, dt, z[:-1], z[-1], loads[0], reactions[0])
        return np.concatenate([y, loads[0][None]]), [y]

    def characteristic(self, x: float, xi: float) -> Array | None:
        """Characteristic polynomial of the original scheme: without contact both forms take the same step."""
        return self.scheme.characteristic(x, xi)

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the original scheme."""
        return self.scheme.parameters

    def label(self, digits: int | None = None, kind: str = "") -> str:
        """Label of the original scheme."""
        return self.scheme.label(digits, kind)


def midpoint(equation: Any, dt: float, y: Array, f0: Array, f1: Array, reaction: Array) -> Array:
    """y + dt k, k = A (y + dt/2 k) + B [(f0 + f1)/2 + reaction]: the trapezoidal rule under that force."""
    return y + dt * equation.implicit_rate(0.5 * dt, y, 0.5 * (f0 + f1) + reaction)


def exact(equation: Any, dt: float, y: Array, f0: Array, f1: Array, reaction: Array) -> Array:
    """The exact solution under a force that goes linearly from f0 + reaction to f1 + reaction."""
    return equation.flow(dt, y, f0 + reaction, f1 + reaction)
