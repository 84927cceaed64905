"""Several stops at one node at a time: the complementarity problem v = r + S F(v), by active set."""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array
from ..basics.compiled import compiled
from .contact_law import G1, G2, KAPPA


@compiled
def solve_node(r: Array, compliance: Array, law: Array) -> Array:
    """The forces F (m,) with v = r + S F and F_c = F_c(v_c), S symmetric positive semidefinite, laws (m, 3).

    They minimise 1/2 F^T S F + r^T F + sum_c (F_c^2/(2 kappa_c) - g_c F_c), g_c the stop that F_c comes
    from. Lawson and Hanson's active set: close the contact that penetrates most, solve for the closed
    ones, and go only as far as no force changes sign, opening those that reach zero. It ends, because every iteration
    lowers the minimum over the closed contacts.
    """
    m = r.size
    kappa, g1, g2 = law[:, KAPPA], law[:, G1], law[:, G2]
    force = np.zeros(m)
    side = np.zeros(m)  # +1 on the upper stop, -1 on the lower, 0 open
    for _ in range(20 * m):
        worst = 0.0
        entering = -1
        stop = 0.0
        for c in range(m):
            if side[c] == 0.0:
                v = r[c]
                for e in range(m):
                    v += compliance[e, c] * force[e]
                depth = max(v - g2[c], g1[c] - v)
                if depth > 1e-15 * abs(v) and kappa[c] * depth > worst:
                    worst = kappa[c] * depth
                    entering = c
                    stop = 1.0 if v > g2[c] else -1.0
        if entering < 0:
            break
        side[entering] = stop
        while True:
            # (1/kappa + S) F = g - r on the closed contacts, the others left at zero.
            matrix = np.eye(m)
            right = np.zeros(m)
            for c in range(m):
                if side[c] != 0.0:
                    right[c] = (g2[c] if side[c] > 0.0 else g1[c]) - r[c]
                    matrix[c, c] = 1.0 / kappa[c] + compliance[c, c]
                    for e in range(m):
                        if e != c and side[e] != 0.0:
                            matrix[c, e] = compliance[e, c]
            target = np.linalg.solve(matrix, right)
            way = 1.0
            opening = -1
            for c in range(m):
                if side[c] != 0.0 and target[c] * side[c] >= 0.0:  # the force opposes its side
                    part = force[c] / (force[c] - target[c]) if force[c] != target[c] else 0.0
                    if opening < 0 or part < way:
                        way = part
                        opening = c
            if opening < 0:
                force = target
                break
            for c in range(m):
                force[c] += way * (target[c] - force[c])
            force[opening] = 0.0
            side[opening] = 0.0
    return force
