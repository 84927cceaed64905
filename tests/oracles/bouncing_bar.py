"""The elastic bar that bounces on a wall under gravity, with its solution by characteristics in rational numbers.

E = 900, rho = 1, L = 10, so c = 30; gravity 10, dropped from 5. It lands at t = 1 with speed 10, is in contact for
2L/c = 2/3 and flies again; the motion has period 16/3. Doyen, Ern and Piperno, SIAM J. Sci. Comput. 33 (2011) 223-249.
"""

from __future__ import annotations

import numpy as np

import stiffbeam as sb

PERIOD = 16.0 / 3.0
IMPULSE = 800.0 / 3.0
CONTACTS = ((1.0, 5.0 / 3.0), (11.0 / 3.0, 13.0 / 3.0))


def pressure(t):
    """The contact pressure in the first two contacts, 0 outside."""
    first, second = (t - start for start, _ in CONTACTS)
    inside = [(x >= 0.0) & (x <= 2.0 / 3.0) for x in (first, second)]
    return np.where(inside[0], 300.0 * (1.0 + first), 0.0) + np.where(inside[1], 500.0 - 300.0 * second, 0.0)


def bouncing_bar(cells: int, **stops) -> sb.System:
    """Linear elements, lumped mass; unknown 0 is the foot, at height q_0 + 5 over a stop at 0."""
    dx = 10.0 / cells
    mass = np.full(cells + 1, dx)
    mass[[0, -1]] *= 0.5
    stiffness = (
        900.0
        / dx
        * (np.diag(np.r_[1.0, np.full(cells - 1, 2.0), 1.0]) - np.eye(cells + 1, k=1) - np.eye(cells + 1, k=-1))
    )
    foot = sb.Contact(np.eye(cells + 1)[0], sb.Stops(lower=0.0, **({"stiffness": np.inf} | stops)), sb.Constant(5.0))
    return sb.System.from_matrices(np.diag(mass), stiffness, loads=[(-10.0 * mass, sb.Constant(1.0))], contacts=[foot])
