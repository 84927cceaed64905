"""Moreau and Jean's time stepping, impulses that obey Newton's law: on the theta-method, and mode by mode exactly."""

from __future__ import annotations

import numpy as np

from .scheme import VELOCITY, Array, Equation, RigidScheme, Step, in_interval


class MoreauJean(RigidScheme):
    """M (v+ - v) = dt [f_m - C v_m - K q_m] + B^T P,  q+ = q + dt v_m,  x_m = (1 - theta) x + theta x+,

        0 <= P  _|_  U+ + e U >= 0 where the gap of q + dt v/2 is closed, else P = 0;  U = B v, gap = B q + g0.

    With E = 1/2 v^T M v + 1/2 q^T K q, without damping,

        E+ - E = f_m . (q+ - q) + (1/2 - theta) (|v+ - v|_M^2 + |q+ - q|_K^2) + (1 - theta (1 + e)) U P,

    the last term where U+ = -e U. So theta = 1/2 dissipates only what Newton's law dissipates, (1 - e)/2 |U| P, and
    e = 1 conserves E. Within a persistent contact, steps with U > 0 and P > 0 gain energy. The gap is kept to O(dt): a
    penetration stays until the body leaves the stop. Order 1.

    Parameters
    ----------
    theta : float
        In [1/2, 1].

    References
    ----------
    Jean, Comput. Methods Appl. Mech. Eng. 177 (1999) 235-257; Acary, ZAMM 96 (2016) 585-603.
    """

    name = "moreau-jean"
    look = (1, 6, 3)
    arguments = ("theta",)
    conditions = (VELOCITY,)

    def __init__(self, theta: float = 0.5) -> None:
        self.theta = in_interval("theta", theta, 0.5, 1.0)

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """reactions[0] is P/dt, the impulse of the step as a mean force."""
        q, v, f = z
        theta = self.theta
        force = (1.0 - theta) * f + theta * loads[0] + reactions[0]
        ahead = np.array([q + theta * dt * v, v])
        change = equation.solve(theta * dt, (theta * dt) ** 2, dt * equation.net_force(ahead, force))
        v_new = v + change
        q_new = q + dt * v + theta * dt * change
        return np.array([q_new, v_new, loads[0]]), [np.array([v_new, v])]


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
