"""The nonsmooth generalised-alpha scheme: the motion without reactions, then its positions, then its velocities."""

from __future__ import annotations

import numpy as np

from .newmark import GeneralisedAlpha
from .scheme import POSITION, WHERE_CLOSED, Array, Equation, RigidScheme, Step


class NonsmoothGeneralisedAlpha(RigidScheme):
    """q+ = q + dt v + dt^2 [(1/2 - beta) a + beta a+] + M^-1 B^T nu,  v+ = v~ + M^-1 B^T P,

        v~ = v + dt [(1 - gamma) a + gamma a+],  M s+ = f+ - C v~ - K q+,
        (1 - alpha_m) a+ + alpha_m a = (1 - alpha_f) s+ + alpha_f s,
        0 <= nu _|_ gap(q+) >= 0;  where q+ is at the stop 0 <= P _|_ U+ + e U >= 0, else P = 0,

    with alpha_m, alpha_f, beta and gamma of generalised-alpha. Gap and velocity conditions both hold at every step. nu
    does not enter the condition of P, so the two problems are solved one after the other. With rho = 1, without
    damping, E = 1/2 v^T M v + 1/2 q^T K q and x_m = (x + x+)/2,

        E+ - E = f_m . (q+ - q) + P U_m + (dt P/2 - nu) B a_m;

    rho < 1 also damps the highest modes. Order 1 through impacts. State: (q, v, a, s).

    Parameters
    ----------
    rho : float
        Spectral radius at infinite frequency, in [0, 1].

    References
    ----------
    Bruels, Acary and Cardona, Comput. Methods Appl. Mech. Eng. 281 (2014) 131-161; here C v~ in the place of C v.
    """

    look = (3, 12, 1)
    arguments = ("rho",)
    nodes = (1.0, 1.0)
    conditions = (POSITION, WHERE_CLOSED)

    def __init__(self, rho: float = 0.8) -> None:
        smooth = GeneralisedAlpha(rho)
        self.rho, self.alpha_m, self.alpha_f = rho, smooth.alpha_m, smooth.alpha_f
        self.beta, self.gamma = smooth.beta, smooth.gamma

    def initial(self, equation: Equation, history: list[Array], force: Array) -> Array:
        """(q, v, a, a) with a from the equation of motion under the load alone."""
        a = equation.acceleration(history[0], force)
        return np.array([*history[0], a, a])

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """reactions[0] is nu/dt^2 and reactions[1] is P/dt."""
        q, v, a, s = z
        share = (1.0 - self.alpha_f) / (1.0 - self.alpha_m)
        known = (self.alpha_f * s - self.alpha_m * a) / (1.0 - self.alpha_m)
        q_ahead = q + dt * v + dt**2 * ((0.5 - self.beta) * a + self.beta * known)
        q_ahead = q_ahead + dt**2 * equation.solve(0.0, 0.0, reactions[0])
        v_ahead = v + dt * ((1.0 - self.gamma) * a + self.gamma * known)
        net = equation.net_force(np.array([q_ahead, v_ahead]), loads[0])
        s_new = equation.solve(share * self.gamma * dt, share * self.beta * dt**2, net)
        q_new = q_ahead + dt**2 * self.beta * share * s_new
        v_new = v_ahead + dt * self.gamma * share * s_new + dt * equation.solve(0.0, 0.0, reactions[1])
        z_new = np.array([q_new, v_new, known + share * s_new, s_new])
        return z_new, [np.array([q_new, q]), np.array([v_new, v])]
