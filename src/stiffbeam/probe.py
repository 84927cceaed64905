"""Probing: a scheme's own step, taken with unit states, unit forces and the unit drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import Array
from .drive import Drive
from .equations import Modal
from .schemes import Scheme


@dataclass(frozen=True, eq=False)
class Probe:
    """What K steps make of a batch of unit inputs, in modal coordinates.

    The batch holds, in this order: a unit state for each of the a components (all modes at once, since
    they decouple); a unit force of each of P kinds at each of the S nodes of the *first* step; each of
    the d drive coefficients g at the start. states: (K, a, batch, n), z at the ends of the steps.
    positions, predictions: (K, S, batch, n), q at the nodes and what ``predict`` expects there.
    """

    states: Array
    positions: Array
    predictions: Array
    drive_size: int  # d

    @property
    def components(self) -> int:
        """a."""
        return self.states.shape[1]

    @property
    def of_states(self) -> slice:
        """The responses to the unit states in a batch axis."""
        return slice(0, self.components)

    def of_pulse(self, kind: int, node: int) -> int:
        """The response to a unit force of a kind at a node of the first step."""
        return self.components + kind * self.positions.shape[1] + node

    @property
    def of_drive(self) -> slice:
        """The responses to the drive coefficients."""
        return slice(self.states.shape[2] - self.drive_size, None)

    @property
    def ends_at_last_node(self) -> bool:
        """Whether the last node holds the new q, whatever the scheme calls it."""
        return np.array_equal(self.positions[0, -1], self.states[0, 0])


def probe(scheme: Scheme, equation: Modal, dt: float, steps: int, pulses: Array, drive: Drive, basis: Array) -> Probe:
    """Take ``steps`` steps. pulses: (P, n) modal force vectors; basis: (d, n), the load is g(t) @ basis."""
    n, S = basis.shape[1], len(scheme.nodes)
    a = scheme.initial(equation, [np.zeros((2, n))] * scheme.history, np.zeros(n)).shape[0]
    batch = a + S * len(pulses) + drive.size
    z = np.zeros((a, batch, n))
    z[np.arange(a), np.arange(a)] = 1.0
    states, positions, predictions = [], [], []
    for k in range(steps):
        forces = np.zeros((S, batch, n))
        for s, c in enumerate(scheme.nodes):
            if k == 0:
                forces[s, a + s : a + S * len(pulses) : S] = pulses
            forces[s, batch - drive.size :] = drive.transition((k + c) * dt).T @ basis
        predictions.append(np.stack(scheme.predict(equation, dt, z)))
        z, at_nodes = scheme.step(equation, dt, z, list(forces))
        states.append(z)
        positions.append(np.stack(at_nodes))
    return Probe(np.stack(states), np.stack(positions), np.stack(predictions), drive.size)
