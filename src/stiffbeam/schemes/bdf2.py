"""BDF2: the second-order backward differentiation formula, (4.5) and (4.11)."""

from __future__ import annotations

import numpy as np

from .conserving import Theta
from .scheme import Array, Equation, Scheme, Step, oscillator


class BDF2(Scheme):
    """y^{n+1} = 4/3 y^n - 1/3 y^{n-1} + (2 dt/3) f(t^{n+1}, y^{n+1}).

    Order 2, L-stable. The first step is the theta-method's with theta = 1/2. State: (y^n, y^{n-1}). The extrapolated
    contact takes q* = 4/3 q^n - 1/3 q^{n-1} + (2 dt/3)(2 v^n - v^{n-1}), v = q', from the values that the paper names.

    References
    ----------
    Dumont (2002), (4.5) on (3.12) and (4.11) on (3.5).

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.BDF2()
    BDF2()
    """

    look = (0, 0, 0)
    history = 2

    @property
    def starter(self) -> Scheme:
        """The trapezoidal rule, which makes y^1 to second order."""
        return Theta(0.5)

    def initial(self, equation: Equation, history: list[Array], force: Array) -> Array:
        """(y^n, y^{n-1}); the force is not needed."""
        return np.concatenate(history)

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """One implicit stage at t_{n+1}."""
        y, y_before = z[:2], z[2:]
        c = 2.0 * dt / 3.0
        r = (4.0 * y - y_before) / 3.0
        y_new = r + c * equation.implicit_rate(c, r, loads[0] + reactions[0])
        return np.concatenate([y_new, y]), [y_new]

    def characteristic(self, x: float, xi: float) -> Array:
        """Degree 2, of the two-step formula."""
        return np.array([1.5 - oscillator(x, xi), -2.0, 0.5])

    def predict(self, equation: Equation, dt: float, z: Array) -> list[Array]:
        """q*, at t_{n+1}."""
        y, y_before = z[:2], z[2:]
        rate = 2.0 * y[1] - y_before[1]
        return [(4.0 * y[0] - y_before[0] + 2.0 * dt * rate) / 3.0]
