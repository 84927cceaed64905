"""Moreau and Jean's time stepping: impulses that obey Newton's law, on the theta-method."""

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
