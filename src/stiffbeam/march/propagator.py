"""scheme x modes x dt -> Propagator: K steps of a scheme as the arrays of one linear map.

A scheme is a linear step, and K steps of it are again one, with K S force nodes. In modal coordinates
its homogeneous part is one small matrix per mode, and stepping *unit* states and *unit* forces through
the scheme's own ``step`` reads off every array: nothing here knows any scheme. The march then costs
one product with ``reading`` and one with ``transition`` per block, and touches the stops node by node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, aligned, padded
from ..model.drive import Drive, Term
from ..model.modes import Modes
from ..model.system import System
from ..model.time_functions import evaluate, offset_rate
from ..schemes import Scheme
from .kernels.layout import Block, Forcing, Inflow
from .probe import Probe, probe_load


@dataclass(frozen=True, eq=False)
class Propagator:
    """K steps from the state z (a, n) in modal coordinates, packed as D numbers.

    The block's entries w (R,) are the contact arguments, node by node and contact by contact, followed
    by the channel positions at the ends of steps that are no node:

        (w, z_new) = (reading z, transition z) + g rows + inflow
        F_i = F(w_i),  then  (w, z_new) += push_i F_i      for the nodes in order,

    where w_i = r + s F_i is solved in closed form with the compliance s (0 where the contact is
    extrapolated and w_i is the predictor); for other laws than the linear one see ``stage``, which takes the
    velocities at the nodes too, entries after the others. ``block`` holds what is the same for every load; the
    rows of the harmonic and constant loads, with g(t) at the block's start, are made by ``forcing``;
    ``inflow`` is there for sampled loads and offsets only.
    """

    scheme: Scheme
    dt: float
    steps: int  # K
    system: System
    basis: Modes
    block: Block
    end_channels: NDArray[np.int64]  # the channels read at the ends of steps
    extrapolated: bool
    keep: NDArray[np.int64]  # the components of the scheme's state that the packed one holds
    mix: Array  # (len(keep), a): what each of them holds
    units: Probe  # what the steps make of unit states
    samples: tuple[Term, ...]  # loads that are sampled at the nodes
    sample_rows: Array  # (loads K S, R + D)
    sample_velocity: Array  # (loads K S, K, channels)
    offset_samples: tuple[Term, ...]  # offsets that are sampled at the entries

    def pack(self, z: Array) -> Array:
        """The scheme's states (a, members, n) -> (members, D + (kept - 1) n), see Block."""
        mixed = np.einsum("ce,emj->cmj", self.mix, z)
        kept, members, n = mixed.shape
        packed = aligned((members, self.block.reading.shape[1] + (kept - 1) * n))
        packed[:, : kept * n] = np.moveaxis(mixed, 0, 1).reshape(members, -1)
        packed[:, kept * n : (2 * kept - 1) * n] = packed[:, : (kept - 1) * n]
        return packed

    def unpack(self, packed: Array) -> Array:
        """Packed (members, ...) -> states (a, members, n) that go on as the packed ones do."""
        a, n = self.mix.shape[1], self.system.size
        z = np.zeros((a, len(packed), n))
        z[self.keep] = np.moveaxis(packed[:, : len(self.keep) * n].reshape(-1, len(self.keep), n), 1, 0)
        return z

    @property
    def amplification(self) -> Array:
        """(n, kept, kept): what the K steps make of the kept components of every mode, without forces."""
        kept, n = len(self.keep), self.system.size
        matrix = np.zeros((n, kept, kept))
        for e, c in np.ndindex(kept, kept):
            matrix[:, c, (c + e) % kept] = self.block.transition[e, c * n : (c + 1) * n]
        return matrix

    @property
    def compliances(self) -> tuple[Array, Array]:
        """(nodes, m, m) each: how the forces at a node move its contacts and their velocities there."""
        (nodes, m), rates = self.block.compliance.shape, self.block.rates
        S = np.moveaxis(self.block.compliance.reshape(-1, m, m), 1, 2)
        of_rates = [self.block.push[np.ix_(here, rates[here])].T for here in np.arange(nodes).reshape(-1, m)]
        return S, np.array(of_rates).reshape(S.shape)

    @property
    def harmonic(self) -> bool:
        """Whether every load and offset is in the drive, so that there is no inflow."""
        return not self.samples and not self.offset_samples

    @property
    def entry_times(self) -> Array:
        """From the block's start; 0 for padding of the nodes, none for that at the end; rates not counted."""
        nodes = np.add.outer(np.arange(self.steps), self.scheme.nodes) * self.dt
        ends = (1 + np.arange(self.steps)) * self.dt
        at_nodes = np.zeros(len(self.block.push))
        at_nodes[: len(self.block.compliance)] = np.repeat(nodes.ravel(), len(self.system.contacts))
        return np.concatenate([at_nodes, np.repeat(ends, len(self.end_channels))])

    @property
    def entry_channels(self) -> NDArray[np.int64]:
        """The channel of each entry, -1 for padding of the nodes."""
        at_nodes = np.full(len(self.block.push), -1)
        contacts = len(self.system.contacts)
        at_nodes[: len(self.block.compliance)] = np.arange(len(self.block.compliance)) % max(1, contacts)
        return np.concatenate([at_nodes, np.tile(self.end_channels, self.steps)])

    def inflow(self, starts: Array, last: float) -> Inflow:
        """What sampled loads and offsets add to the blocks that start at ``starts`` (B,).

        Callables are not asked for times after ``last``: a block may run past the end, its surplus
        steps are dropped.
        """
        (R, D), K, channels = self.block.reading.shape, self.steps, self.block.velocity.shape[1]
        if self.harmonic:
            return Inflow(np.zeros((0, R + D)), np.zeros((0, K, channels)))
        values = np.zeros((len(starts), len(self.sample_rows)))
        if self.samples:
            offsets = np.add.outer(np.arange(K), self.scheme.nodes).ravel() * self.dt
            times = np.minimum(np.add.outer(starts, offsets), last)
            values = np.concatenate([evaluate(f, times) for _, f in self.samples], axis=1)
        rows = values @ self.sample_rows
        velocity = np.tensordot(values, self.sample_velocity, 1)
        ends = starts[:, None] + (1 + np.arange(K)) * self.dt
        times = np.minimum(np.add.outer(starts, self.entry_times), last)
        for unit, function in self.offset_samples:
            here = np.flatnonzero(self.entry_channels == np.argmax(unit))
            rows[:, here] += evaluate(function, times[:, here])
            for node in here[here < len(self.block.rates)]:
                rows[:, self.block.rates[node]] += offset_rate(function, times[:, node])
            velocity[..., np.argmax(unit)] += offset_rate(function, np.minimum(ends, last))
        return Inflow(rows, velocity)

    def forcing(self, systems: Sequence[System]) -> Forcing:
        """The harmonic and constant loads and offsets of systems that differ from this one in nothing else.

        Probed once for all of them: from rest, under each drive coefficient of each system.
        """
        drives = [Drive.of(system) for system in systems]
        most = max(len(drive.frequencies) for drive in drives)
        # Members may have fewer frequencies than others: the places left over carry nothing.
        drives = [Drive(x.frequencies + (1.0,) * (most - len(x.frequencies))) for x in drives]
        V, d, n, K = len(systems), drives[0].size, self.system.size, self.steps
        frequencies = np.array([drive.frequencies for drive in drives]).reshape(V, -1)
        loads = np.stack(
            [self.basis.force(drive.split(s.loads, n)[0]) for drive, s in zip(drives, systems, strict=True)]
        )
        shifts = np.stack([drive.offsets(s)[0] for drive, s in zip(drives, systems, strict=True)])  # (V, d, channels)
        probed = probe_load(
            self.scheme, self.basis.equation, self.dt, self.units, loads,
            lambda x, t: turned(x, frequencies, t), self.extrapolated,
        )  # fmt: skip
        rows, (R, D) = modal_rows(self.system, self.basis), self.block.reading.shape
        forced = aligned((V, d, R + D))
        fields = entries_of(probed, rows, len(self.system.contacts), self.end_channels)
        forced[..., : fields.shape[1]] = fields.reshape(V, d, -1)
        mixed = np.einsum("ce,emj->cmj", self.mix, probed.states[-1])  # (kept, V d, n)
        forced[..., R : R + mixed.shape[0] * n] = np.moveaxis(mixed, 0, 1).reshape(V, d, -1)
        rates = shifts.copy()  # g' @ shifts = g @ rates
        rates[:, 0] = 0.0
        rates[:, 1::2], rates[:, 2::2] = (
            -frequencies[..., None] * shifts[:, 2::2],
            frequencies[..., None] * shifts[:, 1::2],
        )
        velocity = np.empty((V, K, len(rows), d))
        for c, row in enumerate(rows):
            velocity[:, :, c] = np.moveaxis(np.sum(probed.states[:, 1] * row, axis=-1).reshape(K, V, d), 0, 1)
        if np.any(shifts):
            read = np.flatnonzero(self.entry_channels >= 0)
            rated = read[read < len(self.block.rates)]
            for entries, nodes, moving in ((read, read, shifts), (self.block.rates[rated], rated, rates)):
                moved = turned(moving, frequencies, self.entry_times[nodes])  # (entries, V, d, channels)
                moved = moved[np.arange(len(nodes)), ..., self.entry_channels[nodes]]
                forced[..., entries] += np.moveaxis(moved, 0, -1)
            velocity += np.moveaxis(turned(rates, frequencies, (1 + np.arange(K)) * self.dt), (0, 3), (1, 2))
        constant = float(np.any(loads[:, 0]) or np.any(shifts[:, 0]))
        return Forcing(constant, frequencies, forced, velocity)


def turned(basis: Array, frequencies: Array, t: float | Array) -> Array:
    """T(t)^T basis with g(t_0 + t) = T(t) g(t_0): the load t after the start per unit of g there.

    basis: (V, d, ...). frequencies: (V, F). t: a number, or times (k,) for (k, V, d, ...). Elementwise, so that a
    member has the bits of its solo run.
    """
    phase = np.multiply.outer(t, frequencies)
    phase = phase.reshape(*phase.shape, *[1] * (basis.ndim - 2))
    s, c = np.sin(phase), np.cos(phase)
    before, sines, cosines = (slice(None),) * (np.ndim(t) + 1), slice(1, None, 2), slice(2, None, 2)
    out = np.empty((*np.shape(t), *basis.shape))
    out[(*before, slice(0, 1))] = basis[:, :1]
    out[(*before, sines)] = c * basis[:, sines] - s * basis[:, cosines]
    out[(*before, cosines)] = s * basis[:, sines] + c * basis[:, cosines]
    return out


def entries_of(probed: Probe, rows: Array, contacts: int, end_channels: Array) -> Array:
    """The entries (batch, ...) that a batch of inputs makes: contact arguments at every node, padded to
    eight, then the ``end_channels`` at the ends of steps, then the contacts' velocities at every node, where the
    probe has them."""
    arguments = probed.arguments
    K, S, batch, _ = arguments.shape
    nodes, ends = np.empty((K, S, contacts, batch)), np.empty((K, len(end_channels), batch))
    for c in range(contacts):
        nodes[:, :, c] = np.sum(arguments * rows[c], axis=-1)
    for i, channel in enumerate(end_channels):
        ends[:, i] = np.sum(probed.states[:, 0] * rows[channel], axis=-1)
    padding = np.zeros((padded(K * S * contacts, least=0) - K * S * contacts, batch))
    moving = np.einsum("ksbj,cj->kscb", probed.velocities, rows[:contacts])
    return np.concatenate([x.reshape(-1, batch) for x in (nodes, padding, ends, moving)]).T


def modal_rows(system: System, basis: Modes) -> Array:
    """The rows of the channels in modal coordinates, shape (channels, n)."""
    return np.array([basis.force(row) for row, _ in system.channels])  # (channels, n)
