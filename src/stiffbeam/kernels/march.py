"""The march in blocks, the states that it passes, the steps on rigid stops, and contacts: march.h describes the arrays.

Each is checked here: one of another type, shape or order raises TypeError.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..basics.arrays import Array, padded
from .library import Structure, address, filled, library

LINEAR, BY_LAW, MEAN = range(3)  # how a node finds its force: of springs, any law, or its mean over the step
LAW, TALLY, EVENT = 6, 8, 6  # numbers of a law, a tally and an impact
OVERFLOW = 1e100  # A position beyond this ends the run. Its square, in an energy, is still a float64.
AT_A_STOP, WHERE_PREDICTED, WHERE_CLOSED = range(3)  # when a node can press; the first in a position, else a velocity

BLOCK, DRIVE, _RUN, _RIGID = (Structure("march.h", name) for name in ("Block", "Drive", "Run", "Rigid"))


def run(block: Any, drive: Any, arrays: Mapping[str, Any], first: int, steps: int, every: int, dt: float) -> bool:
    """Compute ``steps`` steps from step ``first`` with a BLOCK, a DRIVE and the arrays of a Run.

    Returns True if all are done; where the list of impacts may not hold another block's, False is returned and the call
    can be made again with a longer one.
    """
    outputs = len(arrays["positions"])
    if 0 < outputs <= (first + steps) // every or min(first, steps) < 0:
        raise ValueError("outputs do not fit the steps")
    if block.nodes % max(1, block.K * len(arrays["law"])):
        raise ValueError("contacts do not fit the block")
    x = _RUN(
        arrays, first=first, steps=steps, every=every, dt=dt, B=-(-steps // block.K), C=block.C, K=block.K,
        N=block.N, R=block.R, D=block.D, state=block.D + (block.a - 1) * block.n,
        W=padded(block.D + 1 + 2 * drive.F) + block.N,
    )  # fmt: skip
    return bool(filled(library().march(block, drive, x)))


def switch_time(u0: float, v0: float, u1: float, v1: float, side: float, law: Array, dt: float) -> float:
    """Fraction of the step, 0 to 1, at which contact with the stop on ``side`` begins or ends, from positions and
    velocities at both ends; law (6,).

    That is where the cubic Hermite interpolant crosses the stop. At a damped stop that is penetrated, or held on to
    rounding, contact ends, and begins again, where the force changes sign.
    """
    return library().switch_time(u0, v0, u1, v1, side, address(law, (LAW,)), dt)


def states(transition: Array, push: Array, forces: Array, starts: Array, K: int, room: Array) -> Array:
    """q and q' (2, 1 + steps, n) at the ends of single steps under known forces, every K steps from one of the starts.
    The first row, before the steps, is zero.

    transition: (a, a n), as in a Block; push: (F, a n); forces: (steps, F); starts: (B, a n). room: numbers in a row,
    the first of which the result takes.
    """
    (a, D), (steps, F), B = transition.shape, forces.shape, -(-len(forces) // K)
    n, z = D // a, np.empty((3, D))
    out = room[: 2 * (1 + steps) * n].reshape(2, 1 + steps, n)
    out[:, 0] = 0.0
    arrays = (transition, (a, a * n)), (push, (F, D)), (forces, (steps, F)), (starts, (B, D))
    at = (address(x, shape) for x, shape in (*arrays, (z, z.shape), (out, out.shape)))
    library().states(a, n, F, steps, K, *at)
    return out


def rigid_steps(linear: Mapping[str, Array], **given: Array) -> tuple[Array, Array]:
    """States (K, D) at the ends of K steps from z (D,), advanced in place, and reactions (K, S, m).

    linear, given: the arrays of Rigid in march.h; ``linear`` those of the scheme, ``given`` driven, shifts, predicted
    and z.
    """
    (S, m, D), K = linear["reading"].shape, len(given["driven"])
    path, reactions = np.empty((K, D)), np.empty((K, S, m))
    filled(library().rigid_steps(_RIGID({**linear, **given, "path": path, "reactions": reactions})))
    return path, reactions


def contact_forces(u: Array, v: Array, law: Array, energy: Array | None = None) -> Array:
    """F(u, u') on the beam, of the shape of u and v; law (.., 6), of each or of all. ``energy`` takes U(u)."""
    shape = np.shape(u)
    law = law if law.shape == (*shape, LAW) else np.broadcast_to(law, (*shape, LAW))
    u, v, law, F = *(np.asarray(x, float, order="C") for x in (u, v, law)), np.empty(shape)
    at = address(u, shape), address(v, shape), address(law, (*shape, LAW)), address(F, shape)
    library().contact_forces(F.size, *at, None if energy is None else address(energy, shape))
    return F
