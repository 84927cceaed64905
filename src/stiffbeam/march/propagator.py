"""scheme x coordinates x dt -> Propagator: K steps of a scheme as the arrays of one linear map.

A scheme is a linear step, and K steps of it are again one, with K S force nodes. Stepping *unit* states and
*unit* forces through the scheme's own ``step`` reads off every array: nothing here knows any scheme. In modal
coordinates the homogeneous part is one small matrix per mode, else one large one. The march then costs
one product with ``reading`` and one with ``transition`` per block, and touches the stops node by node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, aligned
from ..model.drive import Drive, Term
from ..model.system import System
from ..model.time_functions import evaluate, offset_rate
from ..schemes import Scheme
from .coordinates import Coordinates
from .entries import Entries
from .kernels.layout import Block, Forcing, Inflow
from .powers import Powers
from .probe import StepMap


@dataclass(frozen=True, eq=False)
class Propagator:
    """K steps from the state z (a, N), packed as D numbers.

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

    one: StepMap
    powers: Powers
    steps: int  # K
    block: Block
    entries: Entries
    samples: tuple[Term, ...]  # loads that are sampled at the nodes
    sample_rows: Array  # (loads K S, R + D)
    sample_velocity: Array  # (loads K S, K, channels)
    offset_samples: tuple[Term, ...]  # offsets that are sampled at the entries

    @property
    def scheme(self) -> Scheme:
        """Whose steps these are."""
        return self.one.scheme

    @property
    def coordinates(self) -> Coordinates:
        """In which they are taken."""
        return self.one.coordinates

    @property
    def dt(self) -> float:
        """The step."""
        return self.one.dt

    @property
    def keep(self) -> NDArray[np.int64]:
        """The components of the scheme's state that the packed one holds."""
        return self.one.keep

    @property
    def mix(self) -> Array:
        """(len(keep), a): what each of them holds."""
        return self.one.mix

    @property
    def used(self) -> int:
        """How many of the D numbers are not padding."""
        return len(self.keep) * self.coordinates.rows.shape[1]

    def pack(self, z: Array) -> Array:
        """The scheme's states (a, members, N) -> (members, D + ...), see Block."""
        mixed = np.einsum("ce,emj->cmj", self.mix, z)
        packed = aligned((mixed.shape[1], self.block.reading.shape[1] + self.used - self.coordinates.parts))
        packed[:, : self.used] = np.moveaxis(mixed, 0, 1).reshape(len(packed), -1)
        self.repeat(packed)
        return packed

    def repeat(self, packed: Array) -> None:
        """Packed states (members, ...) from their first D numbers."""
        again = self.used - self.coordinates.parts
        packed[:, self.used : self.used + again] = packed[:, :again]

    def unpack(self, packed: Array) -> Array:
        """Packed (members, ...) -> states (a, members, N) that go on as the packed ones do."""
        a, N = self.mix.shape[1], self.coordinates.rows.shape[1]
        z = np.zeros((a, len(packed), N))
        z[self.keep] = np.moveaxis(packed[:, : self.used].reshape(-1, len(self.keep), N), 1, 0)
        return z

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

    def samples_at(self, starts: Array, last: float) -> Array:
        """What the sampled loads are at the nodes of blocks that start at ``starts`` (B,), (B, loads K S).

        No function is asked for times of steps that start after ``last``: a block may run past the end, its surplus
        steps are dropped.
        """
        if not self.samples:
            return np.zeros((len(starts), 0))
        begun = np.add.outer(starts, np.arange(self.steps) * self.dt)[..., None]  # (B, K, 1)
        surplus = begun > last - 0.5 * self.dt
        times = np.where(surplus, last, begun + np.array(self.scheme.nodes) * self.dt).reshape(len(starts), -1)
        return np.concatenate([evaluate(f, times) for _, f in self.samples], axis=1)

    def inflow(self, starts: Array, last: float) -> Inflow:
        """What sampled loads and offsets add to the blocks that start at ``starts`` (B,), see ``samples_at``."""
        (R, D), K, readers = self.block.reading.shape, self.steps, self.one.readers
        if self.harmonic:
            return Inflow(np.zeros((0, R + D)), np.zeros((0, K, readers.channels)))
        values = self.samples_at(starts, last)
        rows = values @ self.sample_rows
        velocity = np.tensordot(values, self.sample_velocity, 1)
        if self.offset_samples:
            begun = np.add.outer(starts, np.arange(K) * self.dt)[..., None]  # (B, K, 1)
            times = np.where(begun > last - 0.5 * self.dt, last, begun + readers.when * self.dt)
            moved = np.zeros(times.shape)  # (B, K, g)
            for unit, function in self.offset_samples:
                for rates, value in ((False, evaluate), (True, offset_rate)):
                    here = np.flatnonzero((readers.is_rate == rates) & (readers.channel == np.argmax(unit)))
                    moved[..., here] += value(function, times[..., here])
            rows[:, :R] += self.entries.of_readings(moved, R)
            velocity = velocity + moved[..., readers.end_rates]
        return Inflow(rows, velocity)

    def forcing(self, systems: Sequence[System]) -> Forcing:
        """The harmonic and constant loads and offsets of systems that differ from this one in nothing else.

        A load is Re P e^(i w t), and all it does follows from what it does in one step from rest: what h + k steps
        make is A^k times what h make, and what k make from h on. A member has the bits of its solo run: nothing
        here depends on how many there are.
        """
        drives, V = [Drive.of(system) for system in systems], len(systems)
        one, readers, coordinates, K = self.one, self.one.readers, self.coordinates, self.steps
        N, (R, D) = coordinates.rows.shape[1], self.block.reading.shape
        pairs = list(zip(drives, systems, strict=True))
        bases = [(drive.split(coordinates.loads(x), N)[0], drive.offsets(x)[0]) for drive, x in pairs]
        constants = {bool(np.any(load[0]) or np.any(shift[0])) for load, shift in bases}
        if V > 1 and (coordinates.parts == 1 or len(constants) > 1 or len({drive.size for drive in drives}) > 1):
            return _side_by_side([self.forcing([system]) for system in systems])
        frequencies = np.array([(0.0, *drive.frequencies) for drive in drives])  # (V, F), the constant first
        loads = _amplitudes(np.stack([load for load, _ in bases]))  # (V, F, N)
        shifts = _amplitudes(np.stack([shift for _, shift in bases]))  # (V, F, C)
        constant, most = constants == {True}, frequencies.shape[1]
        if not constant and most > 1:  # a load of nothing does nothing
            frequencies, loads, shifts = frequencies[:, 1:], loads[:, 1:], shifts[:, 1:]
        F = frequencies.shape[1]
        turn = np.exp(1j * frequencies * self.dt * np.array(self.scheme.nodes)[:, None, None])  # (S, V, F)
        acting = loads * turn[..., None]
        state, read = one.from_rest(np.stack([np.real(acting), np.imag(acting)], axis=-2).reshape(len(turn), -1, N))
        n, k, _ = state.shape
        phase = np.exp(1j * self.dt * np.multiply.outer(np.arange(K + 1), frequencies)).swapaxes(0, 1)  # (V, K + 1, F)
        path = np.empty((V, n, k, K, F), complex)  # what 1, 2, .. K steps make
        path[..., 0, :] = _complex(state.reshape(n, k, V, F, 2).transpose(2, 0, 1, 3, 4))
        done = 1
        for level in self.powers.levels:
            more = min(done, K - done)
            if more > 0:
                later = path[..., done - 1 : done, :] * phase[:, None, None, 1 : more + 1]
                path[..., done : done + more, :] = _product(level, path[..., :more, :]) + later
                done += more
        read = _complex(read.reshape(-1, V, F, 2)).swapaxes(0, 1)  # (V, g, F)
        read = read[:, None] * phase[:, :K, None]
        if K > 1:
            states = np.ascontiguousarray(path[..., :-1, :]).reshape(V, n * k, K - 1, F)
            read[:, 1:] += _product(one.reading.transpose(1, 0, 2).reshape(-1, n * k), states).swapaxes(1, 2)
        if np.any(shifts):
            moved = shifts[:, :, readers.channel].swapaxes(1, 2)[:, None] * phase[:, :K, None]  # (V, K, g, F)
            moved = moved * np.exp(1j * self.dt * readers.when[:, None] * frequencies[:, None])[:, None]
            moved[:, :, readers.is_rate] *= 1j * frequencies[:, None, None]
            read += moved
        rows = np.zeros((V, F, R + D), complex)
        rows[..., :R] = self.entries.of_readings(np.moveaxis(read, -1, 1), R)
        rows[..., R : R + n * k] = path[..., -1, :].transpose(0, 3, 2, 1).reshape(V, F, n * k)
        velocity = np.moveaxis(_by_sines(np.moveaxis(read[:, :, readers.end_rates], -1, 1), most), 1, -1)
        return Forcing(
            float(constant), frequencies[:, F - most + 1 :], _by_sines(rows, most), np.ascontiguousarray(velocity)
        )


def _amplitudes(basis: Array) -> Array:
    """P (V, F, ...) of the functions g @ basis = Re sum P e^(i w t), basis (V, d, ...)."""
    return np.concatenate([basis[:, :1], basis[:, 2::2] - 1j * basis[:, 1::2]], axis=1)


def _by_sines(amplitudes: Array, most: int) -> Array:
    """``_amplitudes`` undone: what goes with 1, sin w t, cos w t, .. (V, d, ...); ``most`` counts the constant, which
    may be left out where it is zero."""
    V, F = amplitudes.shape[:2]
    basis = aligned((V, 2 * most - 1, *amplitudes.shape[2:]))
    if most == F:
        basis[:, 0] = np.real(amplitudes[:, 0])
    waves = amplitudes[:, F - most + 1 :]
    basis[:, 1::2], basis[:, 2::2] = -np.imag(waves), np.real(waves)
    return basis


def _complex(pairs: Array) -> Array:
    return pairs[..., 0] + 1j * pairs[..., 1]


def _product(matrix: Array, x: Array) -> Array:
    """A real matrix (.., e, k) on complex x (V, .., k, steps, F), of one shape for every V."""
    real = np.ascontiguousarray(x).view(float)
    made = matrix @ real.reshape(*real.shape[:-2], -1)
    return made.reshape(*made.shape[:-1], *real.shape[-2:]).view(complex)


def _side_by_side(each: Sequence[Forcing]) -> Forcing:
    """Of several members, those with fewer frequencies than others given some that carry nothing."""
    most = max(x.frequencies.shape[1] for x in each)
    missing = [most - x.frequencies.shape[1] for x in each]
    return Forcing(
        max(x.constant for x in each),
        np.concatenate(
            [np.pad(x.frequencies, ((0, 0), (0, k)), constant_values=1.0) for x, k in zip(each, missing, strict=True)]
        ),
        np.concatenate([np.pad(x.rows, ((0, 0), (0, 2 * k), (0, 0))) for x, k in zip(each, missing, strict=True)]),
        np.concatenate([np.pad(x.velocity, ((0, 0),) * 3 + ((0, 2 * k),)) for x, k in zip(each, missing, strict=True)]),
    )
