"""The interface of schemes for rigid stops: a step, and for each reaction the quantity complementary to it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from .scheme import Array, Equation, Scheme

if TYPE_CHECKING:
    from ..model.contact import Stops

# The reaction of a node keeps x between the stops and presses only where x is at one; x is
POSITION = "position"  # x, new
RESTITUTED = "restituted position"  # (x_new + e x_old)/(1 + e)
VELOCITY = "velocity"  # x_new + e x_old, kept from going into a stop that ``predict`` finds closed
WHERE_CLOSED = "velocity where closed"  # the same, where the node before this one is at the stop
AHEAD = 0.5  # of a step, where ``predict`` looks


class RigidScheme(Scheme):
    """A scheme for stops with stiffness=inf: a linear step, and a reaction at each node after its condition.

    At node i a step returns the pair (x_new, x_old) to which ``conditions[i]`` applies, in the place of (q, q').
    Reactions are forces: a constant force over one step is its impulse over dt, also where the literature writes the
    scheme with impulses. ``start`` makes the first state. State: (q, v, f) with the load f, unless a subclass documents
    another.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> ball = sb.problem("bouncing-ball")
    >>> run = sb.integrate(ball.system, sb.MoreauJean(theta=0.5), dt=1e-3, t_end=1.3)
    >>> run.impacts.count
    5
    """

    second_order_only: ClassVar[bool] = True
    modal_only: ClassVar[bool] = False  # whether it is defined mode by mode only
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
    each = list(stops)
    restitutes = isinstance(scheme, RigidScheme) and scheme.restitutes
    if any(one.rigid for one in each):
        return all((one.restitution is not None) == restitutes for one in each)
    return not isinstance(scheme, RigidScheme)
