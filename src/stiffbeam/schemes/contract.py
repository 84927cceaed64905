"""What a step must keep: linear in state and forces, causal in the nodes. Checked once per run."""

from __future__ import annotations

import numpy as np

from ..equations import Modal
from ..validation import InputError
from .scheme import Scheme

TOLERANCE = 1e-10  # of rounding; a broken contract shows at order one


def check_contract(scheme: Scheme) -> None:
    """Raise InputError where ``step`` breaks what both marches build on.

    Tried on two damped modes with random states and forces: step(x + 2 y) = step(x) + 2 step(y), and no
    position at a node changes with the force at a later one.
    """
    rng = np.random.default_rng(0)
    equation, dt, nodes = Modal(np.array([0.7, 1.9]), np.array([0.1, 0.3])), 0.4, len(scheme.nodes)
    history = [rng.normal(size=(2, 2)) for _ in range(scheme.history)]
    shape = scheme.initial(equation, history, rng.normal(size=2)).shape

    def step(z, forces):
        z_new, positions = scheme.step(equation, dt, z, list(forces))
        if len(positions) != nodes or np.shape(z_new) != shape:
            got = f"{len(positions)} positions and a state of shape {np.shape(z_new)}"
            raise InputError(f"{scheme}.step", got, f"return {nodes} positions, one per node, and a state of {shape}")
        return np.asarray(z_new), np.array(positions)

    x, y = ((rng.normal(size=shape), rng.normal(size=(nodes, 2))) for _ in range(2))
    both = step(x[0] + 2.0 * y[0], x[1] + 2.0 * y[1])
    for whole, a, b in zip(both, step(*x), step(*y), strict=True):
        if not np.max(np.abs(whole - a - 2.0 * b)) <= TOLERANCE * np.max(np.abs(whole)):
            raise InputError(f"{scheme}.step", "a step that is not", "be linear in (state, forces)")
    for later in range(1, nodes):
        changed = x[1].copy()
        changed[later] += 1.0
        difference = step(x[0], changed)[1] - step(*x)[1]
        if np.any(difference[:later]):
            raise InputError(
                f"{scheme}.step",
                f"a position before node {later} that moves with the force there",
                "be causal",
                "order the nodes so that every position depends on its own and earlier forces only",
            )
