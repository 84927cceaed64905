"""Backward differentiation: BDF2, (4.5) and (4.11), and Bathe's composite scheme."""

from __future__ import annotations

import numpy as np

from ..basics.validation import number
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


class Bathe(Scheme):
    """Trapezoidal rule over a share s of the step, then a three-point backward formula over the rest:

        y^{n+s} = y^n + s dt/2 (f^n + f^{n+s}),
        s (2 - s) y^{n+1} = y^{n+s} - (1 - s)^2 y^n + s (1 - s) dt f^{n+1}.

    Order 2, L-stable. State: (y^n, f^n).

    Parameters
    ----------
    split : float
        s in (0, 1). 1/2 is Bathe's choice; 2 - sqrt 2 is TR-BDF2, where both stages solve with the same matrix.

    References
    ----------
    Bathe and Baig, Comput. Struct. 83 (2005) 2513-2524; Bank et al., IEEE Trans. Electron Devices 32 (1985) 1992-2007.
    """

    look = (5, 5, 5)
    arguments = ("split",)
    variants = ({"split": 2.0 - 2.0**0.5},)

    def __init__(self, split: float = 0.5) -> None:
        self.split = number("split", split, least=0.01, most=0.99)
        self.nodes = (self.split, 1.0)

    initial = Theta.initial

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """Two implicit stages, at t_n + s dt and at t_{n+1}."""
        y, rate = z[:2], z[2:]
        s = self.split
        half = s * dt / 2.0
        r = y + half * rate
        y_split = r + half * equation.implicit_rate(half, r, loads[0] + reactions[0])
        c = (1.0 - s) / (2.0 - s) * dt
        r = (y_split - (1.0 - s) ** 2 * y) / (s * (2.0 - s))
        rate_new = equation.implicit_rate(c, r, loads[1] + reactions[1])
        y_new = r + c * rate_new
        return np.concatenate([y_new, rate_new]), [y_split, y_new]

    def characteristic(self, x: float, xi: float) -> Array:
        """Degree 1: the product of the two stages."""
        z, s = oscillator(x, xi), self.split
        trapezoidal = (1.0 + s * z / 2.0) / (1.0 - s * z / 2.0)
        return np.array([s * (2.0 - s) - s * (1.0 - s) * z, (1.0 - s) ** 2 - trapezoidal])
