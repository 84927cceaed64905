"""Paoli and Schatzman's scheme in positions, with the stiffness weighted as by Dumont and Paoli."""

from __future__ import annotations

import numpy as np

from .scheme import RESTITUTED, Array, Equation, RigidScheme, Step, in_interval


class PaoliSchatzman(RigidScheme):
    """M (q+ - 2 q + q-) + dt/2 C (q+ - q-) + dt^2 K (beta q+ + (1 - 2 beta) q + beta q-) = dt^2 f + dt B^T P,

        0 <= P  _|_  B (q+ + e q-)/(1 + e) + g0 >= 0.

    With E between two steps, 1/2 |v|_M^2 + 1/2 |(q + q-)/2|_K^2 + (beta - 1/4) dt^2/2 |v|_K^2, v = (q - q-)/dt,
    without damping and where P > 0 makes the bracket zero,

        E+ - E = f . (q+ - q-)/2 - (1 + e) P gap-/(2 dt),    gap- = B q- + g0.

    So it dissipates for e = 0, whose positions keep every gap open. For e > 0 it gains energy where a position was
    beyond the stop. Order 1. State: (q, v, f), v the backward difference.

    Parameters
    ----------
    beta : float
        Stable at any step for beta >= 1/4.

    References
    ----------
    Paoli and Schatzman, SIAM J. Numer. Anal. 40 (2002) 702-733; Dumont and Paoli, ESAIM M2AN 40 (2006) 705-734.
    """

    look = (4, 10, 2)
    arguments = ("beta",)
    conditions = (RESTITUTED,)

    def __init__(self, beta: float = 0.25) -> None:
        self.beta = in_interval("beta", beta, 0.25, 0.5)

    def start(self, equation: Equation, dt: float, y: Array, force: Array) -> Array:
        """State at t = 0, with q- such that (q+ - q-)/(2 dt) is the initial velocity."""
        bent = equation.solve(0.0, self.beta * dt**2, equation.net_force(y, force))
        return np.array([y[0], y[1] - 0.5 * dt * bent, force])

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """reactions[0] is P/dt; loads[0] is carried to the next step."""
        q, v, f = z
        net = equation.net_force(np.array([q, v]), f + reactions[0])
        v_new = v + dt * equation.solve(0.5 * dt, self.beta * dt**2, net)
        q_new = q + dt * v_new
        return np.array([q_new, v_new, loads[0]]), [np.array([q_new, q - dt * v])]
