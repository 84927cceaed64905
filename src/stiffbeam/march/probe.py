"""Probing: a scheme's own step, taken with unit states, unit forces and unit drives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..equations import Modal
from ..schemes import Scheme


@dataclass(frozen=True, eq=False)
class Probe:
    """What K steps make of a batch of inputs, in modal coordinates.

    states: (K, a, batch, n), z at the ends of the steps. positions, predictions: (K, S, batch, n), q at
    the nodes and what ``predict`` expects there.
    """

    states: Array
    positions: Array
    predictions: Array

    @property
    def ends_at_last_node(self) -> bool:
        """Whether the last node holds the new q, whatever the scheme calls it."""
        return np.array_equal(self.positions[0, -1], self.states[0, 0])


def components(scheme: Scheme, equation: Modal, n: int) -> int:
    """a, the number of state components of a scheme."""
    return scheme.initial(equation, [np.zeros((2, n))] * scheme.history, np.zeros(n)).shape[0]


def probe_units(scheme: Scheme, equation: Modal, dt: float, steps: int, pulses: Array) -> Probe:
    """The batch: a unit state for each of the a components (all modes at once, since they decouple), then
    the modal force vectors ``pulses`` (P, n), each at each of the S nodes of the *first* step."""
    n, S = pulses.shape[1], len(scheme.nodes)
    a = components(scheme, equation, n)
    batch = a + S * len(pulses)
    z = np.zeros((a, batch, n))
    z[np.arange(a), np.arange(a)] = 1.0
    first = np.zeros((S, batch, n))
    for s in range(S):
        first[s, a + s :: S] = pulses
    none = np.zeros((S, batch, n))
    return _march(scheme, equation, dt, z, lambda k: first if k == 0 else none, steps)


def probe_load(
    scheme: Scheme, equation: Modal, dt: float, steps: int, load: Callable[[float], Array], shape: tuple[int, int]
) -> Probe:
    """From rest under a load: ``load(t)`` of ``shape`` = (batch, n), t counted from the start."""
    z = np.zeros((components(scheme, equation, shape[1]), *shape))
    return _march(scheme, equation, dt, z, lambda k: [load((k + c) * dt) for c in scheme.nodes], steps)


def _march(scheme: Scheme, equation: Modal, dt: float, z: Array, forces: Callable, steps: int) -> Probe:
    states, positions, predictions = [], [], []
    for k in range(steps):
        predictions.append(np.stack(scheme.predict(equation, dt, z)))
        z, at_nodes = scheme.step(equation, dt, z, list(forces(k)))
        states.append(z)
        positions.append(np.stack(at_nodes))
    return Probe(np.stack(states), np.stack(positions), np.stack(predictions))
