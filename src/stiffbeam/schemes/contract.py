"""The contract of a step: linear in state, loads and reactions, causal in the nodes, a pure function."""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..model.equations import FULLY_IMPLICIT, Modal
from .scheme import Scheme

_KEPT: set[tuple[type, str]] = set()  # the schemes of this package that have been found to keep it
TOLERANCE = 1e-10  # of rounding; a broken contract shows at order one


def check_contract(scheme: Scheme) -> None:
    """Raise InputError where ``step`` breaks the contract that both marches rely on.

    Tried on two damped modes with random states, loads and reactions: step(x + 2 y) = step(x) + 2 step(y),
    and so for ``predict``; no state at a node changes with a load or a reaction at a later one; nothing in
    one mode changes with the other; and the same input gives the same bits again. Checked once per run, of the
    schemes of this package once for each set of parameters.
    """
    own, name = is_known(scheme), (type(scheme), str(scheme))  # a scheme and its conserving form have one label
    if own and name in _KEPT:
        return
    if scheme.starter is not None:
        check_contract(scheme.starter)
    rng = np.random.default_rng(0)
    equation, dt, nodes = Modal(np.array([0.7, 1.9]), np.array([0.1, 0.3])), 0.4, len(scheme.nodes)
    history = [rng.normal(size=(2, 2)) for _ in range(scheme.history)]
    shape = scheme.initial(equation, history, rng.normal(size=2)).shape

    def step(z: Array, forces: Array) -> tuple[Array, Array, Array]:
        z_new, stages = scheme.step(equation, dt, z, list(forces[0]), list(forces[1]))
        if len(stages) != nodes or any(np.shape(y) != (2, 2) for y in stages) or np.shape(z_new) != shape:
            got = f"{len(stages)} states at nodes, of shapes {[np.shape(y) for y in stages]}, and {np.shape(z_new)}"
            rule = f"return a state of shape {shape} and {nodes} y = (q, q') of shape (2, 2), one per node"
            raise InputError(f"{scheme}.step", got, rule, "Trapezoidal in stiffbeam.schemes shows how")
        predicted = scheme.predict(equation, dt, z)
        if len(predicted) != nodes:
            remedy = "return one for each of the scheme's nodes"
            raise InputError(f"{scheme}.predict", len(predicted), f"return {nodes} positions, one per node", remedy)
        return np.asarray(z_new), np.array(stages), np.array(predicted)

    x, y = ((rng.normal(size=shape), rng.normal(size=(2, nodes, 2))) for _ in range(2))
    once = step(*x)
    both = step(x[0] + 2.0 * y[0], x[1] + 2.0 * y[1])
    for whole, a, b in zip(both, once, step(*y), strict=True):
        if not np.max(np.abs(whole - a - 2.0 * b)) <= TOLERANCE * np.max(np.abs(whole)):
            remedy = "leave out what is constant, squared or cut off"
            raise InputError(f"{scheme}.step", "a step that is not", "be linear in (state, loads, reactions)", remedy)
    for first, again in zip(once, step(*x), strict=True):
        if not np.array_equal(first, again):
            remedy = "keep nothing on self; what a step needs of earlier ones belongs into the state"
            raise InputError(f"{scheme}.step", "a step that remembers", "give the same for the same input", remedy)
    other = x[0].copy(), x[1].copy()
    other[0][..., 1] += 1.0
    other[1][..., 1] += 1.0
    for first, changed in zip(once, step(*other), strict=True):
        if np.max(np.abs(first - changed)[..., 0]) > TOLERANCE * np.max(np.abs(first)):
            rule = "be made of the equation's operations, so that modes do not mix"
            remedy = "use equation.mass, stiffness, damping and solve"
            raise InputError(f"{scheme}.step", "a step that mixes unknowns by itself", rule, remedy)
    for later in range(1, nodes):
        changed = x[1].copy()
        changed[:, later] += 1.0
        difference = step(x[0], changed)[1] - step(*x)[1]
        if np.any(difference[:later]):
            raise InputError(
                f"{scheme}.step",
                f"a state before node {later} that moves with the force there",
                "be causal",
                f"let every node depend on its own and earlier forces only; {FULLY_IMPLICIT}",
            )
    if own:
        _KEPT.add(name)


def is_known(scheme: Scheme) -> bool:
    """Return True if the scheme, and the scheme of which it is a form, are of this package. Type and label then define
    it."""
    inner = getattr(scheme, "scheme", None)
    return type(scheme).__module__.rpartition(".")[0] == __package__ and (inner is None or is_known(inner))
