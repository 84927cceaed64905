"""Moreau-Jean on the exact recursion of every mode."""

from __future__ import annotations

import numpy as np

from .rigid_scheme import VELOCITY, RigidScheme
from .scheme import Array, Equation, Step


class MoreauJeanBilbao(RigidScheme):
    """Mode by mode q+ = q + dt v+,  v+ = b v + dt phi (f + R - w^2 q),  b = exp(-2 sigma dt),

        phi = (1 + b - 2 exp(-sigma dt) cos(dt sqrt(w^2 - sigma^2)))/(w dt)^2,

    with sigma half the damping. Free motion under a constant load is exact at any step, since q+ - A q + b q- = 0 is.
    R acts as the load does, with 0 <= R _|_ U+ + e U >= 0 where the gap of q + dt v/2 is closed. With
    E = 1/2 v.(1/phi) v + 1/2 q.w^2 q - dt/2 v.w^2 q, which lies between two steps, without damping,

        E+ - E = f . dt (v + v+)/2 + dt R (U + U+)/2:

    it dissipates what Newton's law dissipates, (1 - e)/2 |U| P, and nothing else. Order 1 through impacts, no phase
    error between them. State: (q, v, f), v the backward difference.

    References
    ----------
    Bilbao, J. Audio Eng. Soc. 61 (2013) 376-389; Siconos, MoreauJeanBilbaoOSI.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.MoreauJeanBilbao()
    MoreauJeanBilbao()
    """

    name = "moreau-jean-bilbao"
    look = (5, 9, 6)
    modal_only = True
    conditions = (VELOCITY,)

    def start(self, equation: Equation, dt: float, y: Array, force: Array) -> Array:
        """State at t = 0, with the exact q(-dt) under the load at t = 0."""
        before = equation.backward(dt, y, force)
        return np.array([y[0], (y[0] - before) / dt, force])

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """loads[0] is carried to the next step; the load of this one is in the state."""
        q, v, f = z
        kept, phi = equation.recursion(dt)
        v_new = kept * v + dt * phi * (f + reactions[0] - equation.stiffness(q))
        return np.array([q + dt * v_new, v_new, loads[0]]), [np.array([v_new, v])]
