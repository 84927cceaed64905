"""scheme x modes x dt -> Propagator: K steps of a scheme as the arrays of one linear map.

A scheme is a linear step, and K steps of it are again one, with K S force nodes. In modal coordinates
its homogeneous part is one small matrix per mode, and stepping *unit* states and *unit* forces through
the scheme's own ``step`` reads off every array: nothing here knows any scheme. The march then costs
one product with ``reading`` and one with ``transition`` per block, and touches the stops node by node.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arrays import Array, aligned, padded
from .contact import Stops
from .drive import Drive, Term
from .modal import Modes
from .schemes import Scheme
from .system import System
from .time_functions import evaluate


@dataclass(frozen=True, eq=False)
class Propagator:
    """K steps from the state z (a, n) in modal coordinates, as x = (z, g(t), padding) of D numbers.

    g(t) are the d drive coefficients at the block's start. The block's entries w (R,) are the contact
    arguments, node by node and contact by contact, followed by the channel positions at the ends of
    steps that are no node:

        w = reading x + inflow          z_new = transition z + g drive_state + inflow'
        F_i = F(w_i),  then  w += push_i F_i,  z_new += push'_i F_i     for the nodes in order,

    where w_i = r + s F_i is solved in closed form with s = ``push[i, i]`` (0 where the contact is
    extrapolated and w_i is the predictor). ``inflow`` is there for sampled loads and offsets only.
    """

    scheme: Scheme
    dt: float
    steps: int  # K
    contacts: int  # m
    stops: tuple[Stops, ...]
    reading: Array  # (R, D)
    transition: Array  # (a, a, n)
    push: Array  # (N, R), N = K S m force nodes
    push_state: Array  # (N, D)
    drive: Drive
    drive_state: Array  # (d, D)
    samples: tuple[Term, ...]  # loads that are sampled at the nodes
    sample_entries: Array  # (loads K S, R)
    sample_state: Array  # (loads K S, D)
    offset_samples: tuple[Term, ...]  # offsets that are sampled at the entries
    channel_of_entry: NDArray[np.int64]  # (R,), -1 for padding
    time_of_entry: Array  # (R,) from the block's start
    end_entry: NDArray[np.int64]  # (K, channels): the entry that holds a channel at the end of a step
    # The velocity of every channel at the ends of the steps, read only where it is wanted:
    velocity: Array  # (K, channels, D)
    velocity_push: Array  # (K, channels, N)
    velocity_samples: Array  # (K, channels, loads K S)

    @property
    def components(self) -> int:
        """a."""
        return self.transition.shape[0]

    def pack(self, z: Array) -> Array:
        """(a, n) -> (D,)."""
        packed = aligned((self.reading.shape[1],))
        packed[: z.size] = z.reshape(-1)
        return packed

    def unpack(self, z: Array) -> Array:
        """(..., D) -> (..., a, n)."""
        a, _, n = self.transition.shape
        return z[..., : a * n].reshape(*z.shape[:-1], a, n)

    @property
    def harmonic(self) -> bool:
        """Whether every load and offset is in the drive, so that there is no inflow."""
        return not self.samples and not self.offset_samples

    def inflow(self, starts: Array, last: float) -> tuple[Array, Array, Array]:
        """What sampled loads and offsets add to the entries (B, R) and states (B, D) of blocks at ``starts``.

        Also the samples (B, loads K S). No rows without any. Callables are not asked for times after
        ``last``: a block may run past the end, its surplus steps are dropped.
        """
        values = np.zeros((len(starts), self.sample_entries.shape[0]))
        if self.harmonic:
            return np.zeros((0, self.reading.shape[0])), np.zeros((0, self.reading.shape[1])), values
        if self.samples:
            offsets = np.add.outer(np.arange(self.steps), self.scheme.nodes).ravel() * self.dt
            times = np.minimum(np.add.outer(starts, offsets), last)
            values = np.concatenate([evaluate(f, times) for _, f in self.samples], axis=1)
        entries, state = values @ self.sample_entries, values @ self.sample_state
        times = np.minimum(np.add.outer(starts, self.time_of_entry), last)
        for unit, function in self.offset_samples:
            entries += np.where(self.channel_of_entry == np.argmax(unit), evaluate(function, times), 0.0)
        return entries, state, values


def build(scheme: Scheme, system: System, modes: Modes, dt: float, steps: int, contact: str) -> Propagator:
    """Probe ``steps`` steps of ``scheme`` on the modes of ``system``."""
    equation, n = modes.equation, system.size
    K, S, m = steps, len(scheme.nodes), len(system.contacts)
    rows = np.array([modes.force(row) for row, _ in system.channels])  # (channels, n), modal
    drive = Drive.of(system)
    basis, samples = drive.split(system.loads, n)
    basis, sampled = modes.force(basis), [modes.force(p) for p, _ in samples]
    offsets, offset_samples = drive.offsets(system)

    # One batch of unit inputs: state components | contact forces | sampled loads | drive coefficients.
    zero = np.zeros(n)
    a = scheme.initial(equation, [np.zeros((2, n))] * scheme.history, zero).shape[0]
    pulses = [rows[c] for c in range(m)] + sampled  # a unit force at one node of the first step
    batch = a + S * len(pulses) + drive.size
    z = np.zeros((a, batch, n))
    z[np.arange(a), np.arange(a)] = 1.0
    states, positions, predictions = [], [], []
    for k in range(K):
        forces = []
        for s, c in enumerate(scheme.nodes):
            force = np.zeros((batch, n))
            if k == 0:
                for p, vector in enumerate(pulses):
                    force[a + p * S + s] = vector
            force[batch - drive.size :] = drive.transition((k + c) * dt).T @ basis
            forces.append(force)
        predictions.append(np.stack(scheme.predict(equation, dt, z)))
        z, at_nodes = scheme.step(equation, dt, z, forces)
        states.append(z)
        positions.append(np.stack(at_nodes))
    arguments = positions if contact == "implicit" else predictions

    # The entries: (what is read, its time), contact arguments first.
    entries: list[tuple[int, Array, float]] = []
    for k in range(K):
        for s, c in enumerate(scheme.nodes):
            entries += [(i, arguments[k][s], (k + c) * dt) for i in range(m)]
    N = len(entries)
    # The last node holds the end of the step if its position is the new q, whatever the scheme calls it.
    end_is_node = contact == "implicit" and np.array_equal(positions[0][-1], states[0][0])
    end_entry = np.empty((K, len(rows)), np.int64)
    for k in range(K):
        for i in range(len(rows)):
            if end_is_node and i < m:
                end_entry[k, i] = (k * S + S - 1) * m + i
            else:
                end_entry[k, i] = len(entries)
                entries.append((i, states[k][0], (k + 1) * dt))
    R, D = padded(len(entries)), padded(a * n + drive.size)
    tail = slice(a * n, a * n + drive.size)  # where x holds g

    def flat(x: Array) -> Array:
        """(a, n) -> (D,), padded."""
        out = np.zeros(D)
        out[: a * n] = x.reshape(-1)
        return out

    reading, response = aligned((R, D)), np.zeros((batch, R))
    channel_of_entry, time_of_entry = np.full(R, -1, np.int64), np.zeros(R)
    for r, (i, field, time) in enumerate(entries):
        reading[r] = flat(field[:a] * rows[i])
        response[:, r] = field @ rows[i]
        reading[r, tail] = response[batch - drive.size :, r] + drive.transition(time).T @ offsets[:, i]
        channel_of_entry[r], time_of_entry[r] = i, time

    # A force in step k acts as one in step 0, k steps later.
    def shifted(pulse: int, k: int) -> tuple[Array, Array, Array]:
        """Entries, end state and end velocities for pulse ``pulse`` given in step k."""
        out = np.zeros(R)
        out[k * S * m : N] = response[pulse, : N - k * S * m]
        surplus = len(entries) - N
        per_step = surplus // K
        out[N + k * per_step : len(entries)] = response[pulse, N : len(entries) - k * per_step]
        speeds = np.zeros((K, len(rows)))
        for later in range(k, K):
            speeds[later] = rows @ states[later - k][1, pulse]
        return out, flat(states[K - 1 - k][:, pulse]), speeds

    push, push_state = aligned((N, R)), aligned((N, D))
    velocity_push = np.zeros((K, len(rows), N))
    for k in range(K):
        for s in range(S):
            for c in range(m):
                i = (k * S + s) * m + c
                push[i], push_state[i], velocity_push[..., i] = shifted(a + c * S + s, k)
    L = len(samples) * K * S
    sample_entries, sample_state = np.zeros((L, R)), np.zeros((L, D))
    velocity_samples = np.zeros((K, len(rows), L))
    for p in range(len(samples)):
        for k in range(K):
            for s in range(S):
                i = (p * K + k) * S + s
                sample_entries[i], sample_state[i], velocity_samples[..., i] = shifted(a + (m + p) * S + s, k)

    velocity = np.zeros((K, len(rows), D))
    derivative = drive.derivative()
    for k in range(K):
        at_end = drive.transition((k + 1) * dt)
        for i, row in enumerate(rows):
            speed = states[k][1] @ row
            velocity[k, i] = flat(states[k][1, :a] * row)
            velocity[k, i, tail] = speed[batch - drive.size :] + at_end.T @ derivative.T @ offsets[:, i]

    return Propagator(
        scheme=scheme,
        dt=dt,
        steps=K,
        contacts=m,
        stops=tuple(contact.stops for contact in system.contacts),
        reading=reading,
        transition=np.ascontiguousarray(states[-1][:, :a]),
        push=push,
        push_state=push_state,
        drive=drive,
        drive_state=np.array([flat(states[-1][:, b]) for b in range(batch - drive.size, batch)]),
        samples=tuple(samples),
        sample_entries=sample_entries,
        sample_state=sample_state,
        offset_samples=tuple(offset_samples),
        channel_of_entry=channel_of_entry,
        time_of_entry=time_of_entry,
        end_entry=end_entry,
        velocity=velocity,
        velocity_push=velocity_push,
        velocity_samples=velocity_samples,
    )
