"""Schemes for rigid stops: in place of a law of force, 0 <= reaction _|_ x >= 0 with a gap or a velocity x."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..basics.validation import number
from .newmark import GeneralisedAlpha
from .scheme import Array, Equation, Scheme, Step

if TYPE_CHECKING:
    from ..model.contact import Stops

# The reaction of a node keeps x between the stops and presses only where x is at one; x is
POSITION = "position"  # x, new
RESTITUTED = "restituted position"  # (x_new + e x_old)/(1 + e)
VELOCITY = "velocity"  # x_new + e x_old, kept from going into a stop that ``predict`` finds closed
WHERE_CLOSED = "velocity where closed"  # the same, where the node before this one is at the stop
AHEAD = 0.5  # of a step, where ``predict`` looks


class RigidScheme(Scheme):
    """A scheme for stops with stiffness=inf: a linear step, and at each node a reaction that satisfies a condition.

    At node i a step returns the pair (x_new, x_old) to which ``conditions[i]`` applies, in the place of (q, q').
    Reactions are forces: a constant force over one step is its impulse over dt, also where the literature writes the
    scheme with impulses. ``start`` makes the first state. State: (q, v, f) with the load f, by default.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> ball = sb.problem("bouncing-ball")
    >>> run = sb.integrate(ball.system, sb.MoreauJean(theta=0.5), dt=1e-3, t_end=1.3)
    >>> run.impacts.count
    5
    """

    order = 1
    conditions: ClassVar[tuple[str, ...]]

    @property
    def restitutes(self) -> bool:
        """True if the scheme has Newton's law of restitution."""
        return any(condition != POSITION for condition in self.conditions)

    def predict(self, equation: Equation, dt: float, z: Array) -> list[Array]:
        """q + dt v/2, by whose gap a stop is found closed before the step."""
        return [z[0] + AHEAD * dt * z[1] for _ in self.nodes]

    def initial(self, equation: Equation, history: list[Array], force: Array) -> Array:
        """(q, v, f) from the position, the velocity and the load."""
        return np.concatenate([history[0], force[None]])

    def start(self, equation: Equation, dt: float, y: Array, force: Array) -> Array:
        """The state at t = 0 from y = (q, q') and the load there."""
        return self.initial(equation, [y], force)


def takes_stops(scheme: Scheme, stops: Iterable[Stops]) -> bool:
    """Return True where ``scheme`` has a law for all these stops: compliance, or for rigid ones restitution or none."""
    if isinstance(scheme, RigidScheme):
        return all(one.rigid and (one.restitution is not None) == scheme.restitutes for one in stops)
    return not any(one.rigid for one in stops)


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
        self.theta = number("theta", theta, least=0.5, most=1.0)

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
        self.beta = number("beta", beta, least=0.25, most=0.5)

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


class ContactStabilisedNewmark(RigidScheme):
    """q_p = q + dt v + M^-1 B^T nu,  0 <= nu _|_ gap(q_p) >= 0: the predictor, put back between the stops,

        q+ = q_p + dt^2/2 a,  v+ = v + dt a,  M a = (f + f+)/2 - C (v + v+)/2 - K (q + q+)/2 + B^T R,

    0 <= R _|_ gap(q+) >= 0. Without nu the force of a persistent contact would swing between zero and twice its value.
    With E = 1/2 v^T M v + 1/2 q^T K q, without damping,

        E+ - E = (f + f+)/2 . (q+ - q) + R (gap+ - gap) - nu B a,

    and where R > 0, gap+ = 0: it dissipates R gap. It has no restitution: a body rebounds by its own elasticity.
    Order 1. State: (q, v, f).

    References
    ----------
    Deuflhard, Krause and Ertel, Int. J. Numer. Methods Eng. 73 (2008) 1274-1290.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.ContactStabilisedNewmark()
    ContactStabilisedNewmark()
    """

    look = (2, 11, 5)
    nodes = (1.0, 1.0)
    conditions = (POSITION, POSITION)

    def step(self, equation: Equation, dt: float, z: Array, loads: list[Array], reactions: list[Array]) -> Step:
        """reactions[0] is 2 nu/dt^2 and reactions[1] is R."""
        q, v, f = z
        put_back = q + dt * v + 0.5 * dt**2 * equation.solve(0.0, 0.0, reactions[0])
        force = 0.5 * (f + loads[1]) + reactions[1]
        known = equation.net_force(np.array([0.5 * (q + put_back), v]), force)
        a = equation.solve(0.5 * dt, 0.25 * dt**2, known)
        q_new, v_new = put_back + 0.5 * dt**2 * a, v + dt * a
        return np.array([q_new, v_new, loads[1]]), [np.array([put_back, q]), np.array([q_new, q])]


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
