"""Schemes for y' = A y + B f: theta-method, BDF2, Bathe's composite of both, exponential flow; and the form of two of
them that conserves energy in contact."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..basics.validation import number
from .scheme import Array, Equation, Scheme, Step, oscillator

Advance = Callable[[Any, float, Array, Array, Array, Array], Array]


class MeanReaction(Scheme):
    """y^{n+1} = advance(y^n; f^n, f^{n+1}, lambda), lambda the mean reaction over the step.

    A constant force does the work lambda . (q^{n+1} - q^n) on the linear system, and ``advance`` conserves
    the energy beside it; so where lambda is the discrete gradient of the stops' energy (see
    ``Treatment``), kinetic + elastic + stop energy is conserved without loads and damping, whatever
    the step. State: (y, f), the load carried. It has the name of the scheme it is a form of.
    """

    nodes = (1.0,)

    def __init__(self, scheme: Scheme, advance: Advance) -> None:
        self.scheme, self.advance = scheme, advance
        self.order = scheme.order

    def initial(self, equation: Equation, history: list[Array], force: Array) -> Array:
        """(y, f) with the load f at the start."""
        return np.concatenate([history[0], force[None]])

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """loads[0] is the load at t_{n+1}, reactions[0] the mean reaction over the step."""
        y = self.advance(equation, dt, z[:-1], z[-1], loads[0], reactions[0])
        return np.concatenate([y, loads[0][None]]), [y]

    def label(self, digits: int | None = None) -> str:
        """Label of the original scheme."""
        return self.scheme.label(digits)


def midpoint(equation: Any, dt: float, y: Array, f0: Array, f1: Array, reaction: Array) -> Array:
    """y + dt k, k = A (y + dt/2 k) + B [(f0 + f1)/2 + reaction]: the trapezoidal rule under that force."""
    return y + dt * equation.implicit_rate(0.5 * dt, y, 0.5 * (f0 + f1) + reaction)


def exact(equation: Any, dt: float, y: Array, f0: Array, f1: Array, reaction: Array) -> Array:
    """The exact solution under a force that goes linearly from f0 + reaction to f1 + reaction."""
    return equation.flow(dt, y, f0 + reaction, f1 + reaction)


class Theta(Scheme):
    """y^{n+1} = y^n + dt [(1 - theta) f^n + theta f^{n+1}].

    Order 2 for theta = 1/2 (the trapezoidal rule), else 1; A-stable. State: (y^n, f^n).

    Parameters
    ----------
    theta : float
        In [1/2, 1].

    References
    ----------
    Dumont (2002), Section 5.2.1.
    """

    look = (7, 8, 6)
    arguments = ("theta",)

    def __init__(self, theta: float = 0.5) -> None:
        self.theta = number("theta", theta, least=0.5, most=1.0)
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
        y, rate = z[:2], z[2:]
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

    look = (4, 4, 4)
    arguments = ()

    def __init__(self) -> None:
        super().__init__(0.5)


class ExponentialFlow(Scheme):
    """y^{n+1} = e^{A dt} y^n + dt phi_1(A dt) B f^n + dt phi_2(A dt) B (f^{n+1} - f^n).

    phi_1(z) = (e^z - 1)/z, phi_2(z) = (e^z - 1 - z)/z^2. Free motion is exact at any step; loads and reactions are
    interpolated linearly, order 2. Between contacts there is neither period elongation nor dissipation: all errors come
    from the contact. Use contact="conserving". With "implicit" the stops do work on the motion, and the largest forces
    of Table 10 at dt = 1e-4 are twice as large. State: (y, f).

    References
    ----------
    Hochbruck and Ostermann, Acta Numerica 19 (2010) 209-286.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.ExponentialFlow()
    ExponentialFlow()
    """

    look = (6, 7, 6)

    initial = MeanReaction.initial

    @property
    def conserving(self) -> Scheme:
        """The exact flow under loads linear in time and a constant reaction."""
        return MeanReaction(self, exact)

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """No stage is solved; the force at t_{n+1} ends this step and begins the next."""
        force = loads[0] + reactions[0]
        y = equation.flow(dt, z[:-1], z[-1], force)
        return np.concatenate([y, force[None]]), [y]

    def characteristic(self, x: float, xi: float) -> Array:
        """Degree 1: the root is e^z."""
        return np.array([1.0, -np.exp(oscillator(x, xi))])


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
