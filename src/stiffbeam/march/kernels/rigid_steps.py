"""The steps of a scheme for rigid stops: a linear step, then the reactions node by node."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...basics.arrays import Array
from ...basics.compiled import compiled
from ...model.contact_law import G1, G2, KAPPA
from ...model.stage import solve_node, solve_pivoting

ON_STOP = 1e-13  # of the terms of a predicted position: so near a stop it is on it
SYMMETRIC = 1e-12  # of the largest entry: a compliance whose two halves differ by less is symmetric
AT_A_STOP, WHERE_PREDICTED, WHERE_CLOSED = range(3)  # when a node can press; the first in a position, else a velocity


class Linear(NamedTuple):
    """A step on states of D numbers, with S nodes and m contacts.

    blocks: (a, a, n) where every mode steps by itself, else no rows; matrix: (D, D) else. reading: (S, m, D), the
    argument of each node from the old state; predicting: (m, D). responses: (S, m, D), of the new state to unit
    reactions; compliance: (S, S, m, m), of the argument of the second node's contacts to reactions at the first,
    [.., contact of the reaction, contact of the argument]. kinds: (S,). bounds: (S, m, 2), where the stops stand
    in the arguments; stops: (m, 2), in positions.
    """

    blocks: Array
    matrix: Array
    reading: Array
    predicting: Array
    responses: Array
    compliance: Array
    kinds: Array
    bounds: Array
    stops: Array


@compiled
def steps(
    linear: Linear, driven: Array, shifts: Array, predicted_shifts: Array, z: Array, path: Array, reactions: Array
) -> None:
    """States ``path`` (K, D) at the ends of K steps from z (D,), advanced in place, and reactions (K, S, m).

    driven: (K, D), what loads add to the states; shifts: (K, S, m), what loads and offsets add to the arguments;
    predicted_shifts: (K, m).
    """
    blocks, matrix, reading, predicting, responses, compliance, kinds, bounds, stops = linear
    S, m, D = reading.shape
    a, _, n = blocks.shape
    law, r, r_before = np.empty((m, 3)), np.empty((S, m)), np.empty(m)
    law[:, KAPPA] = math.inf
    closed = np.zeros(m)
    oblique = np.zeros(S, np.bool_)
    for s in range(S):
        at_node = compliance[s, s]
        oblique[s] = m > 1 and np.max(np.abs(at_node - at_node.T)) > SYMMETRIC * np.max(np.abs(at_node))
    for k in range(path.shape[0]):
        new = path[k]
        # Arguments of the nodes from the old state, before any reaction.
        for s in range(S):
            for c in range(m):
                total = shifts[k, s, c]
                for d in range(D):
                    total += reading[s, c, d] * z[d]
                r[s, c] = total
        for c in range(m):
            total, size = predicted_shifts[k, c], abs(predicted_shifts[k, c])
            for d in range(D):
                term = predicting[c, d] * z[d]
                total += term
                size += abs(term)
            # What rounding takes from the sum does not open a contact that rests on its stop.
            for side in range(2):
                off = abs(total - stops[c, side])
                if off < math.inf and off <= ON_STOP * (size + abs(stops[c, side])):
                    total = stops[c, side]
            r_before[c] = total
        # The new state without reactions.
        if a:
            for i in range(a):
                for j in range(n):
                    total = driven[k, i * n + j]
                    for e in range(a):
                        total += blocks[i, e, j] * z[e * n + j]
                    new[i * n + j] = total
        else:
            for i in range(D):
                total = driven[k, i]
                for d in range(D):
                    total += matrix[i, d] * z[d]
                new[i] = total
        # Reactions node by node. A node on the velocity may press only if its contact is closed: by the predicted
        # position, or by the reaction that a node on the position found in this step.
        for s in range(S):
            touched = False
            for c in range(m):
                lower, upper = bounds[s, c, 0], bounds[s, c, 1]
                if kinds[s] == WHERE_PREDICTED:
                    lower = lower if r_before[c] <= stops[c, 0] else -math.inf
                    upper = upper if r_before[c] >= stops[c, 1] else math.inf
                elif kinds[s] == WHERE_CLOSED:
                    lower = lower if closed[c] > 0.0 else -math.inf
                    upper = upper if closed[c] < 0.0 else math.inf
                law[c, G1], law[c, G2] = lower, upper
                touched = touched or r[s, c] < lower or r[s, c] > upper
                reactions[k, s, c] = 0.0
            if touched:
                if oblique[s]:
                    force = solve_pivoting(r[s], compliance[s, s], law)
                else:
                    force = solve_node(r[s], compliance[s, s], law)
                for c in range(m):
                    reactions[k, s, c] = force[c]
                    if force[c] != 0.0:
                        for d in range(D):
                            new[d] += force[c] * responses[s, c, d]
                        for later in range(s + 1, S):
                            for e in range(m):
                                r[later, e] += force[c] * compliance[s, later, c, e]
            if kinds[s] == AT_A_STOP:
                for c in range(m):
                    closed[c] = reactions[k, s, c]
        for d in range(D):
            z[d] = new[d]
