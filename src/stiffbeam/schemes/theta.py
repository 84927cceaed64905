"""The theta-method, which makes BDF2's first step, and the trapezoidal rule by name."""

from __future__ import annotations

import numpy as np

from .mean_reaction import MeanReaction, midpoint
from .scheme import Array, Equation, Scheme, Step, in_interval, oscillator


class Theta(Scheme):
    """y^{n+1} = y^n + dt [(1 - theta) f^n + theta f^{n+1}].

    Order 2 for theta = 1/2 (the trapezoidal rule), else 1; A-stable. State: (y^n, f^n).

    Parameters
    ----------
    theta : float
        In [1/2, 1].

    Raises
    ------
    InputError
        For any other theta.

    References
    ----------
    Dumont (2002), Section 5.2.1.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.Theta(theta=1.0)
    Theta(theta=1.0)
    """

    name = "theta"
    paper = "Section 5.2.1"
    look = (7, 8, 6)
    arguments = ("theta",)

    def __init__(self, theta: float = 0.5) -> None:
        self.theta = in_interval("theta", theta, 0.5, 1.0)
        self.order = 2 if self.theta == 0.5 else 1

    def initial(self, equation: Equation, history: list[Array], force: Array) -> Array:
        """(y, f) with the rate f of the state and the force given."""
        return np.concatenate([history[0], equation.rate(history[0], force)])

    @property
    def conserving(self) -> Scheme | None:
        """The midpoint form for theta = 1/2, None for others."""
        return MeanReaction(self, midpoint) if self.theta == 0.5 else None

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """One implicit stage at t_{n+1}."""
        y, rate = z[: equation.order], z[equation.order :]
        r = y + (1.0 - self.theta) * dt * rate
        rate_new = equation.implicit_rate(self.theta * dt, r, loads[0] + reactions[0])
        y_new = r + self.theta * dt * rate_new
        return np.concatenate([y_new, rate_new]), [y_new]

    def characteristic(self, x: float, xi: float) -> Array:
        """Degree 1: the root is (1 + (1 - theta) z)/(1 - theta z)."""
        z = oscillator(x, xi)
        return np.array([1.0 - self.theta * z, -1.0 - (1.0 - self.theta) * z])


class Trapezoidal(Theta):
    """y^{n+1} = y^n + dt/2 (f^n + f^{n+1}): the theta-method with theta = 1/2.

    Order 2, A-stable. It dissipates no energy on a linear system, and does not damp the highest modes.

    References
    ----------
    Newmark, J. Eng. Mech. Div. ASCE 85 (1959) 67-94, beta = 1/4, gamma = 1/2.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.Trapezoidal()
    Trapezoidal()
    """

    name = "trapezoidal"
    look = (4, 4, 4)
    arguments = ()

    def __init__(self) -> None:
        super().__init__(0.5)
