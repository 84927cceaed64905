"""The contacts of a block node by node, compiled: several at once, and one or several under any law."""

from __future__ import annotations

import math

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.compiled import compiled
from ...model.active_set import solve_node
from ...model.contact_law import G1, G2, KAPPA, stage_force, stage_stiffness, state
from ...model.stage import MEAN, solve_stage


@compiled
def resolve_several(push: Array, compliance: Array, law: Array, out: Array, forces: Array) -> bool:
    """The stops of m contacts, the m entries of a node together. Whether any is met.

    Where one is met alone, and the force on it leaves the others open, that is all; else see ``solve_node``.
    """
    m = law.shape[0]
    met = False
    for first in range(0, compliance.shape[0], m):
        beyond, last = 0, 0
        for c in range(m):
            forces[first + c] = 0.0
            if state(out[first + c], law[c, G1], law[c, G2]) != 0.0:
                beyond, last = beyond + 1, c
        if beyond == 0:
            continue
        met = True
        i = first + last
        stiff = stage_stiffness(law[last, KAPPA], compliance[i, last])
        force = stage_force(out[i], stiff, law[last, G1], law[last, G2])
        alone = beyond == 1
        for c in range(m):
            if c != last:
                u = out[first + c] + force * compliance[i, c]
                alone = alone and state(u, law[c, G1], law[c, G2]) == 0.0
        if alone:
            forces[i] = force
            for j in range(np.uint64(first), np.uint64(out.size)):
                out[j] += force * push[i, j]
        else:
            together = solve_node(out[first : first + m], compliance[first : first + m], law)
            for c in range(m):
                forces[first + c] = together[c]
                if together[c] != 0.0:
                    for j in range(np.uint64(first), np.uint64(out.size)):
                        out[j] += together[c] * push[first + c, j]
    return met


@compiled
def resolve_by_law(
    push: Array, compliance: Array, rates: IntArray, rule: int, law: Array, before: Array, out: Array, forces: Array
) -> int:
    """The stops under any law, node by node; ``before`` (m,): the positions one node ago, advanced in place.

    0 where none is met, 1 where one is, -1 - i where the forces of node i were not found.
    """
    m = law.shape[0]
    rated = rates.size > 0
    r, w, S, S_rate = np.zeros(m), np.zeros(m), np.zeros((m, m)), np.zeros((m, m))
    met = 0
    for first in range(0, compliance.shape[0], m):
        touched = False
        for c in range(m):
            u = out[first + c]
            forces[first + c] = 0.0
            touched = touched or state(u, law[c, G1], law[c, G2]) != 0.0
            touched = touched or (rule == MEAN and state(before[c], law[c, G1], law[c, G2]) != 0.0)
        if touched:
            met = 1
            for c in range(m):
                r[c] = out[first + c]
                w[c] = out[rates[first + c]] if rated else 0.0
                for e in range(m):
                    S[c, e] = compliance[first + e, c]
                    S_rate[c, e] = push[first + e, rates[first + c]] if rated else 0.0
            force = solve_stage(r, w, S, S_rate, before, rule, law)
            for c in range(m):
                if math.isnan(force[c]) and not math.isnan(r[c]):
                    return -1 - first
                forces[first + c] = force[c]
                if force[c] != 0.0:
                    for j in range(out.size):
                        out[j] += force[c] * push[first + c, j]
        for c in range(m):
            before[c] = out[first + c]
    return met
