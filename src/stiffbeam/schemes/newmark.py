"""Newmark's family: HHT-alpha and generalised-alpha take one step, Newmark's updates with weighted forces."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial

from ..basics.validation import number
from .scheme import Array, Equation, Scheme, Step


class WeightedNewmark(Scheme):
    """(1 - alpha_m) M a^{n+1} + alpha_m M a^n = (1 - alpha_f) N^{n+1} + alpha_f N^n,

        q^{n+1} = q^n + dt v^n + dt^2 [(1/2 - beta) a^n + beta a^{n+1}],
        v^{n+1} = v^n + dt [(1 - gamma) a^n + gamma a^{n+1}],       N = f - C v - K q.

    Order 2 for gamma = 1/2 - alpha_m + alpha_f, if every force is in N and the acceleration a is carried
    from step to step, with a^0 from the equation of motion; a is not M^-1 N. Loads and contact enter as
    (1 - alpha_f) f^{n+1} + alpha_f f^n. beta = (1/2 + gamma)^2/4. State: (q, v, a, M^-1 N).
    """

    def __init__(self, alpha_m: float, alpha_f: float) -> None:
        self.alpha_m, self.alpha_f = alpha_m, alpha_f
        self.beta = (1.0 - alpha_m + alpha_f) ** 2 / 4.0
        self.gamma = 0.5 - alpha_m + alpha_f

    def initial(self, equation: Equation, history: list[Array], force: Array) -> Array:
        """(q, v, a, a) with a from the equation of motion."""
        q, v = history[0]
        a = equation.acceleration(history[0], force)
        return np.array([q, v, a, a])

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """One solve for a^{n+1}; loads and reactions act at t_{n+1}."""
        q, v, a, net = z
        beta, gamma = self.beta, self.gamma
        of_new, of_old = (1.0 - self.alpha_f) / (1.0 - self.alpha_m), self.alpha_f / (1.0 - self.alpha_m)
        inertia = self.alpha_m / (1.0 - self.alpha_m)
        q_ahead = q + dt * v + dt**2 * (0.5 - beta) * a
        v_ahead = v + dt * (1.0 - gamma) * a
        known = of_new * equation.net_force(np.array([q_ahead, v_ahead]), loads[0] + reactions[0])
        known = known + equation.mass(of_old * net - inertia * a)
        a_new = equation.solve(of_new * gamma * dt, of_new * beta * dt**2, known)
        q_new = q_ahead + dt**2 * beta * a_new
        v_new = v_ahead + dt * gamma * a_new
        net_new = (a_new + inertia * a - of_old * net) / of_new
        z_new = np.array([q_new, v_new, a_new, net_new])
        return z_new, [z_new[:2]]

    def characteristic(self, x: float, xi: float) -> Array:
        """Degree 3, in alpha_m, alpha_f, beta and gamma."""
        # The three equations with q, v, a times powers of dt and every new value lambda times the old one.
        one, root = Polynomial([-1.0, 1.0]), Polynomial([0.0, 1.0])  # lambda - 1, lambda
        rate = 1.0 - self.gamma + self.gamma * root
        position = rate + (0.5 - self.beta + self.beta * root) * one
        inertia = (self.alpha_m + (1.0 - self.alpha_m) * root) * one**2
        forces = 2.0 * xi * x * one * rate + x**2 * position
        return (inertia + (self.alpha_f + (1.0 - self.alpha_f) * root) * forces).coef[::-1]


class HHT(WeightedNewmark):
    """M a^{n+1} = (1 + alpha) N^{n+1} - alpha N^n,  N = f - C q' - K q (loads and contact included),

        q^{n+1} = q^n + dt v^n + dt^2 [(1/2 - beta) a^n + beta a^{n+1}],    beta = (1 - alpha)^2/4,
        v^{n+1} = v^n + dt [(1 - gamma) a^n + gamma a^{n+1}],               gamma = 1/2 - alpha.      (4.13)

    The weighted Newmark step with alpha_m = 0 and alpha_f = -alpha. Order 2, A-stable. The contact enters as
    (1 + alpha) sigma(q^{n+1}) - alpha sigma(q^n). The order drops to 1 where the acceleration is computed again from
    M a = N in each step, and where a force is left out of the weighting as the paper prints (``UnweightedHHT``).

    Parameters
    ----------
    alpha : float
        In [-1/3, 0]; 0 is the trapezoidal rule. Other packages write alpha_H = -alpha in [0, 1/3], or 1 + alpha in
        [2/3, 1].

    References
    ----------
    Dumont (2002), (4.13); Hilber, Hughes and Taylor, Earthquake Eng. Struct. Dyn. 5 (1977) 283-292.
    """

    look = (2, 2, 2)
    arguments = ("alpha",)
    variants = ({"alpha": 0.0}, {"alpha": -0.3})

    def __init__(self, alpha: float = -0.1) -> None:
        remedy = "if your alpha is in [0, 1/3], pass -alpha; if in [2/3, 1], alpha - 1"
        self.alpha = number("alpha", alpha, least=-1.0 / 3.0, most=0.0, remedy=remedy)
        super().__init__(0.0, -self.alpha)


class UnweightedHHT(HHT):
    """(4.13) as printed, a misprint: M a^{n+1} = -(1 + alpha) K q^{n+1} + alpha K q^n + f^{n+1}; order 1 under load.

    The stiffness is weighted, load and contact (the paper's F + G) are not; the damping, absent from
    the print, is weighted with the stiffness. State: (q, v, a).
    """

    order = 1

    def initial(self, equation: Equation, history: list[Array], force: Array) -> Array:
        """(q, v, a) with a from the equation of motion."""
        return np.array([*history[0], equation.acceleration(history[0], force)])

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """Load and reaction at t_{n+1} enter with weight 1."""
        q, v, a = z
        alpha, beta, gamma = self.alpha, self.beta, self.gamma
        ahead = np.array([q + dt * v + dt**2 * (0.5 - beta) * a, v + dt * (1.0 - gamma) * a])
        none = np.zeros_like(q)
        inner = (1.0 + alpha) * equation.net_force(ahead, none) - alpha * equation.net_force(z[:2], none)
        a_new = equation.solve(
            (1.0 + alpha) * gamma * dt, (1.0 + alpha) * beta * dt**2, inner + (loads[0] + reactions[0])
        )
        q_new = ahead[0] + dt**2 * beta * a_new
        z_new = np.array([q_new, ahead[1] + dt * gamma * a_new, a_new])
        return z_new, [z_new[:2]]


class GeneralisedAlpha(WeightedNewmark):
    """The weighted Newmark step with, for a spectral radius rho at infinite frequency,

        alpha_m = (2 rho - 1)/(rho + 1),    beta  = (1 - alpha_m + alpha_f)^2/4,
        alpha_f = rho/(rho + 1),            gamma = 1/2 - alpha_m + alpha_f.

    Order 2, A-stable. The weights fall on the old values, as in Chung and Hulbert. HHT is alpha_m = 0 and
    alpha_f = -alpha.

    Parameters
    ----------
    rho : float
        In [0, 1]: 1 dissipates no energy on a linear system, 0 removes the highest modes in one step.

    References
    ----------
    Chung and Hulbert, J. Appl. Mech. 60 (1993) 371-375, (25)-(27).
    """

    look = (3, 3, 3)
    arguments = ("rho",)
    variants = ({"rho": 0.0}, {"rho": 1.0})

    def __init__(self, rho: float = 0.8) -> None:
        self.rho = number("rho", rho, least=0.0, most=1.0)
        super().__init__((2.0 * self.rho - 1.0) / (self.rho + 1.0), self.rho / (self.rho + 1.0))
