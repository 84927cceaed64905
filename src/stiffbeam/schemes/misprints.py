"""The paper's misprints that run, as schemes of their own; the textbook definitions stay clean.

A study can so show what each of them costs. Misprints that do not run (a missing term, a wrong index)
are listed in the paper's reproduction, not here.
"""

from __future__ import annotations

import numpy as np

from .newmark import HHT
from .scheme import Array, Equation, Step
from .sdirk import GAMMA_THIRD_ORDER, SDIRK


class UnweightedHHT(HHT):
    """(4.13) as printed: M a^{n+1} = -(1 + alpha) K q^{n+1} + alpha K q^n + f^{n+1}; order 1 under load.

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


class PrintedSigma(SDIRK):
    """(4.9) with the printed sign of sigma: order 2 instead of 3 at gamma = 0.4359."""

    def __init__(self, gamma: float = GAMMA_THIRD_ORDER, nystrom: bool = False) -> None:
        super().__init__(gamma, nystrom)
        self.order = 2

    @property
    def sigma(self) -> float:
        """The tableau's sigma with the sign as printed."""
        return -super().sigma


class PrintedStageMatrix(SDIRK):
    """(4.14) with the printed stage matrix: off-diagonal sigma, gamma^2 b1, gamma^2 b2 for those of A A.

    Order 2. Its spectral radius exceeds 1 at every step, by (omega dt)^4/310 for small ones at gamma = 0.4359: every
    mode grows, and most systems overflow.
    """

    def __init__(self, gamma: float = GAMMA_THIRD_ORDER, nystrom: bool = True) -> None:
        super().__init__(gamma, nystrom=True)  # always in second-order form
        self.order = 2

    @property
    def Abar(self) -> np.ndarray:
        """The stage matrix as printed, in the place of A A."""
        g, s, (b1, b2, _) = self.gamma, self.sigma, self.b
        return np.array([[g**2, 0.0, 0.0], [s, g**2, 0.0], [b1 * g**2, b2 * g**2, g**2]])

    def characteristic(self, x: float, xi: float) -> None:
        """None: the R(z) of (4.14) belongs to A A."""
        return None
