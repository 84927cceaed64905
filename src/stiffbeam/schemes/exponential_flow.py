"""The exact flow of the linear system over a step, with forces interpolated linearly in time."""

from __future__ import annotations

import numpy as np

from .mean_reaction import MeanReaction, exact
from .scheme import Array, Equation, Scheme, Step, oscillator


class ExponentialFlow(Scheme):
    """y^{n+1} = e^{A dt} y^n + dt phi_1(A dt) B f^n + dt phi_2(A dt) B (f^{n+1} - f^n).

    phi_1(z) = (e^z - 1)/z, phi_2(z) = (e^z - 1 - z)/z^2. Free motion is exact at any step; loads and reactions are
    interpolated linearly, order 2. Between contacts there is neither period elongation nor dissipation: all errors come
    from the contact. Use contact="conserving". With "implicit" the stops do work on the motion, and the largest forces
    of Table 10 at dt = 1e-4 are twice as large. State: (y, f).

    References
    ----------
    Hochbruck and Ostermann, Acta Numerica 19 (2010) 209-286.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.ExponentialFlow()
    ExponentialFlow()
    """

    name = "exponential-flow"
    look = (6, 7, 6)

    def initial(self, equation: Equation, history: list[Array], force: Array) -> Array:
        """(y, f) with the force f given."""
        return np.concatenate([history[0], force[None]])

    @property
    def conserving(self) -> Scheme:
        """The exact flow under loads linear in time and a constant reaction."""
        return MeanReaction(self, exact)

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """No stage is solved; the force at t_{n+1} ends this step and begins the next."""
        force = loads[0] + reactions[0]
        y = equation.flow(dt, z[:-1], z[-1], force)
        return np.concatenate([y, force[None]]), [y]

    def characteristic(self, x: float, xi: float) -> Array:
        """Degree 1: the root is e^z."""
        return np.array([1.0, -np.exp(oscillator(x, xi))])
