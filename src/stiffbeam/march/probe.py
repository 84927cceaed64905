"""Probing: a scheme's own step, taken with unit states, unit forces and unit drives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..basics.arrays import Array
from ..model.equations import Modal
from ..model.modes import Modes
from ..schemes import Scheme

Delayed = Callable[[Array, "float | Array"], Array]


@dataclass(frozen=True, eq=False)
class Probe:
    """What K steps make of a batch of inputs, in modal coordinates.

    states: (K, a, batch, n), z at the ends of the steps. arguments: (K, S, batch, n), q at the nodes, or where the
    contact is extrapolated what ``predict`` expects there. velocities: q' at the nodes, of the same shape; of no node
    where they are not asked for. ends_at_last_node: whether the last node holds the new q, whatever the scheme calls
    it.
    """

    states: Array
    arguments: Array
    velocities: Array
    ends_at_last_node: bool


def components(scheme: Scheme, equation: Modal, n: int) -> int:
    """a, the number of state components of a scheme."""
    return scheme.initial(equation, [np.zeros((2, n))] * scheme.history, np.zeros(n)).shape[0]


def probe_units(
    scheme: Scheme,
    equation: Modal,
    dt: float,
    steps: int,
    reactions: Array,
    loads: Array,
    extrapolated: bool,
    rated: bool,
) -> Probe:
    """The batch: a unit state for each of the a components (all modes at once, since they decouple), then
    the modal force vectors ``reactions`` (m, n) and ``loads`` (L, n), each at each of the S nodes of the
    *first* step. ``rated``: with the velocities at the nodes.

    One step is taken; what it makes of the unit states is a matrix A per mode, and step k of A^k.
    """
    (m, n), S = reactions.shape, len(scheme.nodes)
    a = components(scheme, equation, n)
    batch = a + S * (m + len(loads))
    z = np.zeros((a, batch, n))
    z[np.arange(a), np.arange(a)] = 1.0
    first = np.zeros((2, S, batch, n))  # loads, reactions
    for s in range(S):
        first[1, s, a + s : a + S * m : S] = reactions
        first[0, s, a + S * m + s :: S] = loads
    one = _step(scheme, equation, dt, z, first[0], first[1], extrapolated, rated)
    states = np.empty((steps, a, batch, n))
    states[:1] = one.states
    done = 1
    while done < steps:
        more = min(done, steps - done)
        states[done : done + more] = _applied(states[done - 1, :, :a], states[:more])
        done += more
    arguments, velocities = (_at_nodes(x, x[0, :, :a], states) for x in (one.arguments, one.velocities))
    return Probe(states, arguments, velocities, one.ends_at_last_node)


def turned(probed: Probe, basis: Modes) -> Probe:
    """The same with every undamped mode turned by k times the angle of one step, for a scheme that turns (omega q, q').

    Step by step the rounding of one step's turn comes in k times, the same in every block, and is work that no
    force has done: 1e-10 of the energy in 1e6 steps. For the states of MeanReaction, (q, q', f) or (q, q'), with
    the new q at the only node; inputs act in the first two steps.
    """
    states, w = probed.states.copy(), np.where(basis.omega > 0.0, basis.omega, 1.0)
    one = states[0]  # (a, batch, n); the first two of the batch are q and q'
    angle = np.arctan2(0.5 * (w * one[0, 1] - one[1, 0] / w), 0.5 * (one[0, 0] + one[1, 1]))
    size = np.array([[np.ones_like(w), 1.0 / w], [w, np.ones_like(w)]])

    def turn(k: int) -> Array:
        c, s = np.cos(k * angle), np.sin(k * angle)
        return np.array([[c, s / w], [-w * s, c]])

    turns = (basis.omega > 0.0) & (basis.damping == 0.0)
    turns &= np.all(np.abs(one[:2, :2] - turn(1)) < 1e-9 * size, axis=(0, 1))
    for k in range(len(states)):
        exact = states[k, :2].copy()
        if k > 1:
            exact = np.einsum("cdj,dbj->cbj", turn(k - 1), probed.states[1, :2])
        exact[:, :2] = turn(k + 1)
        states[k, :2] = np.where(turns, exact, states[k, :2])
    return replace(probed, states=states, arguments=states[:, None, 0])


def probe_load(
    scheme: Scheme, equation: Modal, dt: float, units: Probe, loads: Array, delayed: Delayed, extrapolated: bool
) -> Probe:
    """From rest under loads g(t) @ loads, per unit of each of the d functions g at the start.

    loads: (V, d, n), modal; ``delayed(basis, t)`` is the basis (V, d, ...) of the same function counted from t on,
    or (times, V, d, ...) at several. The batch is V d. What h + k steps make is A^k, from ``units``, times what h
    make, and what k make from h on.
    """
    V, d, n = loads.shape
    steps, a = units.states.shape[:2]
    rest, none = np.zeros((a, V * d, n)), np.zeros((len(scheme.nodes), V * d, n))
    at_nodes = np.stack([delayed(loads, c * dt).reshape(V * d, n) for c in scheme.nodes])
    rated = units.velocities.shape[1] > 0
    one = _step(scheme, equation, dt, rest, at_nodes, none, extrapolated, rated)

    def later(x: Array, t: float | Array) -> Array:
        """What x (..., V d, n) is from t on, per unit of g at the start."""
        apart = np.moveaxis(x.reshape(*x.shape[:-2], V, d, n), (-3, -2), (0, 1))
        moved = np.moveaxis(delayed(apart, t), (np.ndim(t), np.ndim(t) + 1), (-3, -2))
        return moved.reshape(*np.shape(t), *x.shape)

    states = np.empty((steps, a, V * d, n))
    states[:1] = one.states
    done = 1
    while done < steps:
        more = min(done, steps - done)
        after = _applied(units.states[:more, :, :a], states[done - 1])
        states[done : done + more] = after + later(states[:more], done * dt)
        done += more
    t = np.arange(1, steps) * dt
    arguments, velocities = (
        _at_nodes(x, unit[0, :, :a], states, later(x[0], t))
        for x, unit in ((one.arguments, units.arguments), (one.velocities, units.velocities))
    )
    return Probe(states, arguments, velocities, one.ends_at_last_node)


def _step(
    scheme: Scheme,
    equation: Modal,
    dt: float,
    z: Array,
    loads: Array,
    reactions: Array,
    extrapolated: bool,
    rated: bool,
) -> Probe:
    """The scheme's own step."""
    new, at_nodes = scheme.step(equation, dt, z, list(loads), list(reactions))
    positions, velocities = np.moveaxis(np.stack(at_nodes), 1, 0)
    arguments = np.stack(scheme.predict(equation, dt, z)) if extrapolated else positions
    velocities = velocities if rated else velocities[:0]
    return Probe(new[None], arguments[None], velocities[None], np.array_equal(positions[-1], new[0]))


def _applied(matrices: Array, states: Array) -> Array:
    """Mode by mode matrices (..., e, c, n) on states (..., c, batch, n), either of them one or many."""
    return np.einsum("...ecj,...cbj->...ebj", matrices, states)


def _at_nodes(first: Array, of_state: Array, states: Array, forced: Array | float = 0.0) -> Array:
    """Values at the nodes of all steps (K, S, batch, n) from those of the first (1, S, batch, n), and of unit
    states (S, a, n); ``forced`` (K - 1, S, batch, n) is what acts in the later steps."""
    return np.concatenate([first, _applied(of_state, states[:-1]) + forced])
