"""Several stops at one node at a time: the complementarity problem v = r + S F(v), by active set."""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array
from ..basics.compiled import compiled, inlined
from .contact_law import G1, G2, KAPPA


@inlined
def solve_definite(A: Array, b: Array, n: int) -> None:
    """x with A x = b in place of b, A = L D L^T the first n rows; its lower part becomes L and D."""
    # No exchange of rows: a definite A has positive pivots.
    for i in range(n):
        for j in range(i):
            for k in range(j):
                A[i, j] -= A[i, k] * A[k, k] * A[j, k]
            A[i, j] /= A[j, j]
        for k in range(i):
            A[i, i] -= A[i, k] * A[i, k] * A[k, k]
            b[i] -= A[i, k] * b[k]
    for i in range(n - 1, -1, -1):
        b[i] /= A[i, i]
        for k in range(i + 1, n):
            b[i] -= A[k, i] * b[k]


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
    force, target, right = np.zeros(m), np.zeros(m), np.zeros(m)
    side = np.zeros(m)  # +1 on the upper stop, -1 on the lower, 0 open
    factor, which = np.zeros((m, m)), np.zeros(m, np.int64)
    # The limit is for rounding, which keeps a search from ending where S has a condition of 1e14 or more. Rigid stops
    # are refused from 1e12 on; compliant ones add 1/kappa to the diagonal.
    for _ in range(20 * m):
        # Penetration times stiffness is the force that it would cause alone: the largest one enters.
        worst = 0.0
        entering = -1
        stop = 0.0
        for c in range(m):
            if side[c] == 0.0:
                v = r[c]
                for e in range(m):
                    v += compliance[e, c] * force[e]
                depth = max(v - g2[c], g1[c] - v)
                # A depth that rounding of v explains must not enter, or the same contact would enter and leave forever.
                if depth > 1e-15 * abs(v) and kappa[c] * depth > worst:
                    worst = kappa[c] * depth
                    entering = c
                    stop = 1.0 if v > g2[c] else -1.0
        if entering < 0:
            break
        side[entering] = stop
        # Solve for the closed contacts, some of which may open again.
        while True:
            # (1/kappa + S) F = g - r on the closed contacts, the others left at zero.
            closed = 0
            for c in range(m):
                target[c] = 0.0
                if side[c] != 0.0:
                    which[closed] = c
                    right[closed] = (g2[c] if side[c] > 0.0 else g1[c]) - r[c]
                    for e in range(closed):
                        factor[closed, e] = compliance[which[e], c]
                    factor[closed, closed] = 1.0 / kappa[c] + compliance[c, c]
                    closed += 1
            solve_definite(factor, right, closed)
            for i in range(closed):
                target[which[i]] = right[i]
            # As far as the first force that would pull: beyond it the minimum over pressing forces is left.
            way = 1.0
            opening = -1
            for c in range(m):
                if side[c] != 0.0 and target[c] * side[c] >= 0.0:  # the force opposes its side
                    # Equal forces are both zero: the contact opens without a move.
                    part = force[c] / (force[c] - target[c]) if force[c] != target[c] else 0.0
                    if opening < 0 or part < way:
                        way = part
                        opening = c
            if opening < 0:
                for c in range(m):
                    force[c] = target[c]
                break
            # Move to the first zero; set it exactly, so that rounding leaves no force on an open contact.
            for c in range(m):
                force[c] += way * (target[c] - force[c])
            force[opening] = 0.0
            side[opening] = 0.0
    return force
