"""HHT-alpha: Newmark's updates with the weighted equation of motion of Hilber, Hughes and Taylor."""

from __future__ import annotations

import numpy as np

from .scheme import Array, Scheme, in_interval


class HHT(Scheme):
    """M a^{n+1} = (1 + alpha) N^{n+1} - alpha N^n,  N = f - C q' - K q (loads and contact included),

        q^{n+1} = q^n + dt v^n + dt^2 [(1/2 - beta) a^n + beta a^{n+1}],    beta = (1 - alpha)^2/4,
        v^{n+1} = v^n + dt [(1 - gamma) a^n + gamma a^{n+1}],               gamma = 1/2 - alpha.      (4.13)

    Order 2, A-stable for alpha in [-1/3, 0]; alpha = 0 is the trapezoidal rule. Mind the sign: other
    packages write this alpha as alpha_H = -alpha in [0, 1/3], or as 1 + alpha in [2/3, 1].
    The acceleration is carried, with a^0 from the equation of motion; re-deriving it each step from
    M a = N, or leaving any force out of the weighting as the paper prints (``printed()``), drops to
    first order. The contact enters as (1 + alpha) sigma(v^{n+1}) - alpha sigma(v^n).
    State: (q, v, a, M^-1 N). Source: Dumont (2002), (4.13); Hilber, Hughes and Taylor, Earthquake Eng.
    Struct. Dyn. 5 (1977) 283-292.
    """

    name = "hht"
    paper = "(4.13)"
    second_order_only = True

    def __init__(self, alpha: float = -0.1) -> None:
        self.alpha = in_interval(
            "alpha", alpha, -1.0 / 3.0, 0.0, "if your alpha is in [0, 1/3], pass -alpha; if in [2/3, 1], alpha - 1"
        )
        self.beta = (1.0 - self.alpha) ** 2 / 4.0
        self.gamma = 0.5 - self.alpha

    @property
    def parameters(self):
        return {"alpha": self.alpha}

    def initial(self, equation, history, force) -> Array:
        q, v = history[0]
        a = equation.acceleration(history[0], force)
        return np.stack([q, v, a, a])

    def step(self, equation, dt, z, forces):
        q, v, a, net = z
        alpha, beta, gamma = self.alpha, self.beta, self.gamma
        q_ahead = q + dt * v + dt**2 * (0.5 - beta) * a
        v_ahead = v + dt * (1.0 - gamma) * a
        known = (1.0 + alpha) * equation.net_force(np.stack([q_ahead, v_ahead]), forces[0])
        a_new = equation.solve(
            (1.0 + alpha) * gamma * dt, (1.0 + alpha) * beta * dt**2, known - alpha * equation.mass(net)
        )
        q_new = q_ahead + dt**2 * beta * a_new
        v_new = v_ahead + dt * gamma * a_new
        net_new = (a_new + alpha * net) / (1.0 + alpha)
        return np.stack([q_new, v_new, a_new, net_new]), [q_new]
