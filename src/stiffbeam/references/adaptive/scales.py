"""How large a motion is, before it is known: the scale of every unknown, in whatever units the system has."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg

from ...basics.arrays import Array
from ...basics.validation import InputError
from ...model.first_order import FirstOrderSystem
from ...model.time_functions import evaluate, offset_values

SAMPLES = 4097  # of every function of time, for its largest value


class Scales(NamedTuple):
    """unknowns (m,): of y. lengths, speeds (contacts,): of the contact positions and their rates. energy: E."""

    unknowns: Array
    lengths: Array
    speeds: Array
    energy: float


def scales_of(first_order: FirstOrderSystem, t_end: float) -> Scales:
    """The largest value that every unknown would take if it had the whole energy of the motion.

        E = E_0 + 1/2 sum_k max|f_k|^2 p_k^T S p_k + 1/2 sum_c (max |o_c - o_c(0)|)^2/(1/kappa_c + r_c^T S r_c)
        |q_i| <= sqrt(2 E S_ii),  |q'_i| <= sqrt(2 E (M^-1)_ii),  S = (K + 2 M/t_end^2)^-1

    E_0 is the energy at the start, the others are the work of the loads and of the moving stops if they
    acted slowly. 2 M/t_end^2 stands for what inertia holds back in the time: it gives f t_end^2/2m for a
    free mass. Every term has its dimension, so other units of length, time and mass give the same motion
    the same scales. A system in which nothing can move has scales 1.
    """
    system = first_order.system
    compliance = _inverse(system.stiffness + 2.0 / t_end**2 * system.mass)
    t = np.linspace(0.0, t_end, SAMPLES)
    energy = float(system.energy(np.zeros(1), system.q0[None], system.v0[None])[0])
    for vector, function in system.loads:
        largest = float(np.max(np.abs(evaluate(function, t))))
        energy += 0.5 * largest * largest * float(vector @ compliance @ vector)
    moves = []
    for contact in system.contacts:
        o = offset_values(contact.offset, t)
        moves.append(float(np.max(np.abs(o))))
        move = float(np.max(np.abs(o - o[0])))
        gives = float(contact.row @ compliance @ contact.row)
        if move and not contact.stops.dissipative:  # one that damps may hold the contact as if it were rigid
            gives += 1.0 / contact.stops.secant(move)
        energy += 0.5 * move * move / gives
    if not np.isfinite(energy):
        rule = "have an energy that float64 can hold"
        raise InputError("the motion", energy, rule, "take units in which loads and motions are smaller")
    if not energy > 0.0:
        ones = np.ones(len(system.contacts))
        return Scales(np.ones(len(first_order.y0)), ones, ones, 1.0)
    # (q, q') in terms of y, turned round: y = back (q, q').
    back = np.linalg.pinv(np.concatenate([first_order.to_q, first_order.to_v]))
    n = system.size
    spread = np.sum((back[:, :n] @ compliance) * back[:, :n], axis=1)
    mobility = _inverse(system.mass)
    spread += np.sum((back[:, n:] @ mobility) * back[:, n:], axis=1)
    lengths = np.array([np.sqrt(2.0 * energy * float(c.row @ compliance @ c.row)) for c in system.contacts])
    speeds = np.array([np.sqrt(2.0 * energy * float(c.row @ mobility @ c.row)) for c in system.contacts])
    unknowns = np.sqrt(2.0 * energy * np.maximum(spread, 0.0))
    for contact, length in zip(first_order.contacts, lengths, strict=True):  # (3.12) carries v_M beside w
        alone = (contact.row != 0.0) & (unknowns <= 1e-12 * length)
        unknowns[alone] = length / np.abs(contact.row[alone])
    unknowns = np.where(unknowns > 0.0, unknowns, np.max(unknowns))
    return Scales(unknowns, lengths + np.array(moves), speeds, energy)


def _inverse(matrix: Array) -> Array:
    return scipy.linalg.cho_solve(scipy.linalg.cho_factor(matrix), np.eye(len(matrix)))
