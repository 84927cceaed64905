"""scheme x modes x dt -> Propagator: K steps of a scheme as the arrays of one linear map.

A scheme is a linear step, and K steps of it are again one, with K S force nodes. In modal coordinates
its homogeneous part is one small matrix per mode, and stepping *unit* states and *unit* forces through
the scheme's own ``step`` reads off every array: nothing here knows any scheme. The march then costs
one product with ``reading`` and one with ``transition`` per block, and touches the stops node by node.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .arrays import Array, aligned, padded
from .contact import Stops
from .drive import Drive, Term
from .modal import Modes
from .probe import Probe, probe
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


class Entry(NamedTuple):
    """One entry of a block: which channel it reads, in which probed field (batch, n), at which time."""

    channel: int
    field: Array
    time: float


def build(scheme: Scheme, system: System, modes: Modes, dt: float, steps: int, contact: str) -> Propagator:
    """Probe ``steps`` steps of ``scheme`` on the modes of ``system`` and arrange what they say."""
    K, S, m, n = steps, len(scheme.nodes), len(system.contacts), system.size
    rows = np.array([modes.force(row) for row, _ in system.channels])  # (channels, n), modal
    drive = Drive.of(system)
    basis, samples = drive.split(system.loads, n)
    offsets, offset_samples = drive.offsets(system)
    pulses = np.array([*rows[:m], *(modes.force(p) for p, _ in samples)]).reshape(-1, n)
    probed = probe(scheme, modes.equation, dt, K, pulses, drive, modes.force(basis))
    entries, end_entry = _entries(scheme, probed, dt, m, len(rows), contact)
    R, D = padded(len(entries)), padded(probed.components * n + drive.size)
    modal, tail = slice(0, probed.components * n), slice(probed.components * n, probed.components * n + drive.size)

    # What every entry and every velocity reads from x = (z, g, padding).
    reading, response = aligned((R, D)), np.zeros((probed.states.shape[2], R))
    for r, entry in enumerate(entries):
        response[:, r] = entry.field @ rows[entry.channel]
        reading[r, modal] = (entry.field[probed.of_states] * rows[entry.channel]).reshape(-1)
        reading[r, tail] = response[probed.of_drive, r] + drive.transition(entry.time).T @ offsets[:, entry.channel]
    velocity = np.zeros((K, len(rows), D))
    for k, i in np.ndindex(K, len(rows)):
        rate = probed.states[k, 1]
        offset_rate = drive.transition((k + 1) * dt).T @ drive.derivative().T @ offsets[:, i]
        velocity[k, i, modal] = (rate[probed.of_states] * rows[i]).reshape(-1)
        velocity[k, i, tail] = (rate @ rows[i])[probed.of_drive] + offset_rate

    def pulse(kind: int, k: int, s: int) -> tuple[Array, Array, Array]:
        """What a unit force at node s of step k does to the entries, the end state and the velocities.

        A force in step k acts as one in step 0, k steps later.
        """
        b = probed.of_pulse(kind, s)
        # Both groups of entries, at the nodes and at the ends of steps, run step by step.
        at_nodes, at_ends = response[b, : K * S * m], response[b, K * S * m : len(entries)]
        out, end = np.zeros(R), np.zeros(D)
        out[: len(entries)] = np.concatenate([_later(at_nodes, k, K), _later(at_ends, k, K)])
        end[modal] = probed.states[K - 1 - k, :, b].reshape(-1)
        speeds = np.zeros((K, len(rows)))
        speeds[k:] = probed.states[: K - k, 1, b] @ rows.T
        return out, end, speeds

    push, push_state, velocity_push = (
        aligned((K * S * m, R)),
        aligned((K * S * m, D)),
        np.zeros((K, len(rows), K * S * m)),
    )
    for i, (k, s, c) in enumerate(np.ndindex(K, S, m)):
        push[i], push_state[i], velocity_push[..., i] = pulse(c, k, s)
    L = len(samples) * K * S
    sample_entries, sample_state, velocity_samples = np.zeros((L, R)), np.zeros((L, D)), np.zeros((K, len(rows), L))
    for i, (p, k, s) in enumerate(np.ndindex(len(samples), K, S)):
        sample_entries[i], sample_state[i], velocity_samples[..., i] = pulse(m + p, k, s)

    drive_state = np.zeros((drive.size, D))
    drive_state[:, modal] = np.moveaxis(probed.states[-1][:, probed.of_drive], 1, 0).reshape(drive.size, -1)
    return Propagator(
        scheme=scheme,
        dt=dt,
        steps=K,
        contacts=m,
        stops=tuple(contact.stops for contact in system.contacts),
        reading=reading,
        transition=np.ascontiguousarray(probed.states[-1][:, probed.of_states]),
        push=push,
        push_state=push_state,
        drive=drive,
        drive_state=drive_state,
        samples=tuple(samples),
        sample_entries=sample_entries,
        sample_state=sample_state,
        offset_samples=tuple(offset_samples),
        channel_of_entry=np.array([e.channel for e in entries] + [-1] * (R - len(entries))),
        time_of_entry=np.array([e.time for e in entries] + [0.0] * (R - len(entries))),
        end_entry=end_entry,
        velocity=velocity,
        velocity_push=velocity_push,
        velocity_samples=velocity_samples,
    )


def _entries(
    scheme: Scheme, probed: Probe, dt: float, contacts: int, channels: int, contact: str
) -> tuple[list[Entry], NDArray[np.int64]]:
    """Contact arguments at every node, then the channels at the ends of steps that no node holds.

    Also (K, channels), the entry that holds each channel at the end of each step.
    """
    K, S = probed.positions.shape[:2]
    arguments = probed.positions if contact == "implicit" else probed.predictions
    entries = [Entry(c, arguments[k, s], (k + scheme.nodes[s]) * dt) for k, s, c in np.ndindex(K, S, contacts)]
    at_node = contact == "implicit" and probed.ends_at_last_node
    end_entry = np.empty((K, channels), np.int64)
    for k, i in np.ndindex(K, channels):
        if at_node and i < contacts:
            end_entry[k, i] = (k * S + S - 1) * contacts + i
        else:
            end_entry[k, i] = len(entries)
            entries.append(Entry(i, probed.states[k, 0], (k + 1) * dt))
    return entries, end_entry


def _later(values: Array, k: int, steps: int) -> Array:
    """Values that run step by step, moved k of ``steps`` steps back in time: zeros, then the first."""
    shift = k * (len(values) // steps)
    return np.concatenate([np.zeros(shift), values[: len(values) - shift]])
