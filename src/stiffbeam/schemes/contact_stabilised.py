"""The contact-stabilised Newmark method of Deuflhard, Krause and Ertel."""

from __future__ import annotations

import numpy as np

from .scheme import POSITION, Array, Equation, RigidScheme, Step


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
