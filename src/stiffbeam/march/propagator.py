"""scheme x coordinates x dt -> Propagator: K steps of a scheme as the arrays of one linear map.

A scheme is a linear step, and K steps of it are again one, with K S force nodes. Stepping *unit* states and
*unit* forces through the scheme's own ``step`` reads off every array: nothing here knows any scheme. In modal
coordinates the homogeneous part is one small matrix per mode, else one large one. The march then costs
one product with ``reading`` and one with ``transition`` per block, and touches the stops node by node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..basics.arrays import Array, IntArray, aligned, padded
from ..kernels.march import BY_LAW, LINEAR, MEAN, Block, Forcing, Inflow
from ..model.system import System
from ..model.time_functions import Drive, Term, evaluate, offset_rate
from ..schemes import Scheme
from .probe import Coordinates, Readers, StepMap, probe
from .treatment import Treatment


@dataclass(frozen=True, eq=False)
class Entries:
    """The contacts at every node, padded to eight, then the channels at the ends of steps that are no node, then
    where they are read the contacts' velocities at every node."""

    nodes: int  # N, a multiple of eight
    end_first: IntArray  # (C,), see Block
    end_stride: IntArray
    rates: IntArray
    place: IntArray  # (entries,): the step times g plus the reading that stands there, -1 for padding

    @classmethod
    def of(cls, readers: Readers, steps: int, ends_at_last_node: bool) -> Entries:
        """Entries over so many steps."""
        S, m, C = len(readers.nodes), readers.contacts, readers.channels
        # Where the last node is the end of the step, the positions of the contacts there are entries of nodes already.
        at_ends = C - m if ends_at_last_node else C
        count = steps * S * m
        N = padded(count, least=0)
        reading = np.arange(steps * readers.size).reshape(steps, -1)
        ends = reading[:, readers.at_ends][:, C - at_ends :]
        padding = np.full(N - count, -1)
        of_rates = reading[:, readers.node_rates].ravel()
        place = [reading[:, readers.at_nodes].ravel(), padding, ends.ravel(), of_rates]
        # For every channel the entry at the end of the first step, and the distance to that of the next.
        first, stride = N + np.arange(C), np.full(C, at_ends)
        if ends_at_last_node:
            first[:m], stride[:m] = (S - 1) * m + np.arange(m), S * m
            first[m:] = N + np.arange(at_ends)
        rates = np.pad(N + ends.size + np.arange(count), (0, N - count)) if len(of_rates) else of_rates
        return cls(N, first, stride, rates, np.concatenate(place))

    def of_readings(self, x: Array, width: int) -> Array:
        """(..., K, g) -> (..., width), zero where no reading stands."""
        *batch, K, g = x.shape
        # One zero more than readings: the place -1 of the padding leads to it.
        flat = np.zeros((*batch, K * g + 1), x.dtype)
        flat[..., :-1] = x.reshape(*batch, K * g)
        rows = np.zeros((*batch, width), x.dtype)
        rows[..., : len(self.place)] = flat[..., self.place]
        return rows


class Powers:
    """A step map's transition A to the powers 2^i, (n, k, k) each, and what is made by doubling with them.

    ``turn``: every undamped mode that a scheme turns, as A turns (omega q, q'), is turned by 2^i times the angle of
    one step. Step by step the rounding of one step's turn comes in again and again, the same in every block, and is
    work that no force has done: 1e-10 of the energy in 1e6 steps.
    """

    def __init__(self, one: StepMap, steps: int, turn: bool) -> None:
        self.steps = steps
        self.levels = [one.transition]
        rotation = _Rotation(one) if turn and one.coordinates.basis is not None else None
        if rotation is not None:
            self.levels[0] = rotation.put(self.levels[0], 1)
        # Squaring gives A^1, A^2, A^4, ..: log2 K products, where step by step K are needed.
        while 2 ** len(self.levels) <= steps:
            squared = self.levels[-1] @ self.levels[-1]
            if rotation is not None:
                squared = rotation.put(squared, 2 ** len(self.levels))
            self.levels.append(squared)

    @cached_property
    def last(self) -> Array:
        """A^steps."""
        # The powers that the binary digits of K name; powers of one matrix commute.
        sum_of_levels = None
        for i, level in enumerate(self.levels):
            if self.steps >> i & 1:
                sum_of_levels = level if sum_of_levels is None else sum_of_levels @ level
        assert sum_of_levels is not None
        return sum_of_levels

    def readings(self, reading: Array) -> Array:
        """reading A^j of (n, g, k) for j < steps: (n, steps, g, k)."""
        n, g, k = reading.shape
        made, done = np.empty((n, self.steps, g, k)), 1
        made[:, 0] = reading
        # Doubling: the readings so far, behind A^done, give as many later ones.
        for level in self.levels:
            more = min(done, self.steps - done)
            if more > 0:
                made[:, done : done + more] = (made[:, :more].reshape(n, more * g, k) @ level).reshape(n, more, g, k)
                done += more
        return made

    def pushes(self, push: Array) -> Array:
        """A^j push of (n, k, p) for j < steps: (n, k, steps, p)."""
        n, k, p = push.shape
        made, done = np.empty((n, k, self.steps, p)), 1
        made[:, :, 0] = push
        # Doubling, as in ``readings``.
        for level in self.levels:
            more = min(done, self.steps - done)
            if more > 0:
                made[:, :, done : done + more] = (level @ made[:, :, :more].reshape(n, k, -1)).reshape(n, k, more, p)
                done += more
        return made


class _Rotation:
    """The undamped modes whose q and q', the first two components, a step turns; see Powers."""

    def __init__(self, one: StepMap) -> None:
        basis, A = one.coordinates.basis, one.transition[:, :2, :2]
        assert basis is not None
        # A rigid-body mode has no angle and is never turned; the 1 avoids a division by zero.
        self.w = np.where(basis.omega > 0.0, basis.omega, 1.0)
        # Sine and cosine, each as the mean of the two entries that are equal in a rotation.
        self.angle = np.arctan2(0.5 * (self.w * A[:, 0, 1] - A[:, 1, 0] / self.w), 0.5 * (A[:, 0, 0] + A[:, 1, 1]))
        size = np.array([[np.ones_like(self.w), 1.0 / self.w], [self.w, np.ones_like(self.w)]]).transpose(2, 0, 1)
        turns = (basis.omega > 0.0) & (basis.damping == 0.0)
        # Only where A is this rotation: numerical dissipation or damping must stay in the powers.
        self.turns = turns & np.all(np.abs(A - self._by(1)) < 1e-9 * size, axis=(1, 2))

    def _by(self, steps: int) -> Array:
        c, s = np.cos(steps * self.angle), np.sin(steps * self.angle)
        return np.array([[c, s / self.w], [-self.w * s, c]]).transpose(2, 0, 1)

    def put(self, power: Array, steps: int) -> Array:
        exact = power.copy()
        exact[:, :2, :2] = np.where(self.turns[:, None, None], self._by(steps), power[:, :2, :2])
        return exact


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
    def coordinates(self) -> Coordinates:
        """The coordinates of the steps."""
        return self.one.coordinates

    @property
    def used(self) -> int:
        """D, the numbers of a state."""
        return len(self.one.keep) * self.coordinates.rows.shape[1]

    def pack(self, z: Array) -> Array:
        """The scheme's states (a, members, N) -> (members, D + ...), see Block."""
        mixed = np.einsum("ce,emj->cmj", self.one.mix, z)
        # The state once more behind itself but for its last component, so that a shift by e n needs no wrapping.
        again = self.used - self.coordinates.parts
        packed = aligned((mixed.shape[1], self.used + again))
        packed[:, : self.used] = mixed.swapaxes(0, 1).reshape(len(packed), -1)
        packed[:, self.used :] = packed[:, :again]
        return packed

    def unpack(self, packed: Array) -> Array:
        """Packed (members, ...) -> states (a, members, N) that go on as the packed ones do."""
        a, N = self.one.mix.shape[1], self.coordinates.rows.shape[1]
        z = np.zeros((a, len(packed), N))
        z[self.one.keep] = packed[:, : self.used].reshape(-1, len(self.one.keep), N).swapaxes(0, 1)
        return z

    @property
    def compliances(self) -> tuple[Array, Array]:
        """(nodes, m, m) each: how the forces at a node move its contacts and their velocities."""
        m, rates, nodes = len(self.coordinates.columns), self.block.rates, self.block.nodes
        S = self.block.compliance(m).reshape(-1, m, m).swapaxes(1, 2)
        of_rates = [self.block.push[np.ix_(here, rates[here])].T for here in np.arange(nodes).reshape(-1, m)]
        return S, np.array(of_rates).reshape(S.shape)

    @property
    def harmonic(self) -> bool:
        """Return True where every load and offset is in the drive, so that there is no inflow."""
        return not self.samples and not self.offset_samples

    def samples_at(self, starts: Array, last: float) -> Array:
        """Values of the sampled loads at the nodes of blocks that start at ``starts`` (B,), (B, loads K S).

        No function is asked for times of steps that start after ``last``: a block may run past the end, its surplus
        steps are dropped.
        """
        if not self.samples:
            return np.zeros((len(starts), 0))
        begun = np.add.outer(starts, np.arange(self.steps) * self.one.dt)[..., None]  # (B, K, 1)
        surplus = begun > last - 0.5 * self.one.dt
        times = np.where(surplus, last, begun + np.array(self.one.scheme.nodes) * self.one.dt).reshape(len(starts), -1)
        return np.concatenate([evaluate(f, times) for _, f in self.samples], axis=1)

    def inflow(self, starts: Array, last: float) -> Inflow:
        """Share of sampled loads and offsets in the blocks that start at ``starts`` (B,), see ``samples_at``."""
        (D, R), K, readers = self.block.reading.shape, self.steps, self.one.readers
        if self.harmonic:
            return Inflow(np.zeros((0, R + D)), np.zeros((0, K, readers.channels)))
        values = self.samples_at(starts, last)
        rows = values @ self.sample_rows
        velocity = np.tensordot(values, self.sample_velocity, 1)
        if self.offset_samples:
            begun = np.add.outer(starts, np.arange(K) * self.one.dt)[..., None]  # (B, K, 1)
            times = np.where(begun > last - 0.5 * self.one.dt, last, begun + readers.when * self.one.dt)
            moved = np.zeros(times.shape)  # (B, K, g)
            for unit, function in self.offset_samples:
                # A moving stop adds its offset to positions and the rate of its offset to velocities.
                for rates, value in ((False, evaluate), (True, offset_rate)):
                    here = np.flatnonzero((readers.is_rate == rates) & (readers.channel == np.argmax(unit)))
                    moved[..., here] += value(function, times[..., here])
            rows[:, :R] += self.entries.of_readings(moved, R)
            velocity = velocity + moved[..., readers.end_rates]
        return Inflow(rows, velocity)

    @cached_property
    def own_forcing(self) -> Forcing:
        """``forcing`` of the system of the coordinates itself."""
        return self.forcing([self.coordinates.system])

    def forcing(self, systems: Sequence[System]) -> Forcing:
        """The harmonic and constant loads and offsets of systems that differ from this one in nothing else.

        A load is Re P e^(i w t), and all it does follows from what it does in one step from rest: what h + k steps
        make is A^k times what h make, and what k make from h on. A member has the bits of its solo run: nothing
        here depends on how many there are.
        """
        drives, V = [Drive.of(system) for system in systems], len(systems)
        one, readers, coordinates, K = self.one, self.one.readers, self.coordinates, self.steps
        N, (D, R) = coordinates.rows.shape[1], self.block.reading.shape
        pairs = list(zip(drives, systems, strict=True))
        # Constant, sines and cosines of the loads and offsets of every member.
        bases = [(drive.split(coordinates.loads(x), N)[0], drive.offsets(x)[0]) for drive, x in pairs]
        constants = {bool(np.any(load[0]) or np.any(shift[0])) for load, shift in bases}
        if V > 1 and (coordinates.parts == 1 or len(constants) > 1 or len({drive.size for drive in drives}) > 1):
            return _side_by_side([self.forcing([system]) for system in systems])
        frequencies = np.array([(0.0, *drive.frequencies) for drive in drives])  # (V, F), the constant first
        loads = _amplitudes(np.array([load for load, _ in bases]))  # (V, F, N)
        shifts = _amplitudes(np.array([shift for _, shift in bases]))  # (V, F, C)
        constant, most = constants == {True}, frequencies.shape[1]
        if not constant and most > 1:  # a load of nothing does nothing
            frequencies, loads, shifts = frequencies[:, 1:], loads[:, 1:], shifts[:, 1:]
        # One step from rest: at every node the load has the phase of the drive there.
        F = frequencies.shape[1]
        turn = np.exp(1j * frequencies * one.dt * np.array(one.scheme.nodes)[:, None, None])  # (S, V, F)
        acting = loads * turn[..., None]
        # Real and imaginary part are two loads, since ``from_rest`` is real.
        state, read = one.from_rest(
            np.ascontiguousarray(acting)
            .view(float)
            .reshape(*acting.shape, 2)
            .swapaxes(-1, -2)
            .reshape(len(turn), -1, N)
        )
        n, k, _ = state.shape
        phase = np.exp(1j * one.dt * np.multiply.outer(np.arange(K + 1), frequencies)).swapaxes(0, 1)  # (V, K + 1, F)
        path = np.empty((V, n, k, K, F), complex)  # what 1, 2, .. K steps make
        path[..., 0, :] = _complex(state.reshape(n, k, V, F, 2).transpose(2, 0, 1, 3, 4))
        # Doubling by the rule of the docstring: ``done`` further steps after 1, 2, .. steps.
        done = 1
        for level in self.powers.levels:
            more = min(done, K - done)
            if more > 0:
                later = path[..., done - 1 : done, :] * phase[:, None, None, 1 : more + 1]
                path[..., done : done + more, :] = _product(level, path[..., :more, :]) + later
                done += more
        # Readings: of the force in the step itself, then of the state that earlier steps have left.
        read = _complex(read.reshape(-1, V, F, 2)).swapaxes(0, 1)  # (V, g, F)
        read = read[:, None] * phase[:, :K, None]
        if K > 1:
            states = np.ascontiguousarray(path[..., :-1, :]).reshape(V, n * k, K - 1, F)
            read[:, 1:] += _product(one.reading.transpose(1, 0, 2).reshape(-1, n * k), states).swapaxes(1, 2)
        # Moving stops: o in positions, i w o in velocities.
        if np.any(shifts):
            moved = shifts[:, :, readers.channel].swapaxes(1, 2)[:, None] * phase[:, :K, None]  # (V, K, g, F)
            moved = moved * np.exp(1j * one.dt * readers.when[:, None] * frequencies[:, None])[:, None]
            moved[:, :, readers.is_rate] *= 1j * frequencies[:, None, None]
            read += moved
        # Rows on entries and new state, as those of ``push``; then real ones for 1, sin w t and cos w t.
        rows = np.zeros((V, F, R + D), complex)
        rows[..., :R] = self.entries.of_readings(read.transpose(0, 3, 1, 2), R)
        rows[..., R:] = path[..., -1, :].transpose(0, 3, 2, 1).reshape(V, F, n * k)
        velocity = _by_sines(read[:, :, readers.end_rates].transpose(0, 3, 1, 2), most).transpose(0, 2, 3, 1)
        driven, velocity = (np.ascontiguousarray(x) for x in (frequencies[:, F - most + 1 :], velocity))
        return Forcing(float(constant), driven, _by_sines(rows, most), velocity)


def _amplitudes(basis: Array) -> Array:
    """P (V, F, ...) of the functions g @ basis = Re sum P e^(i w t), basis (V, d, ...)."""
    # s sin w t + c cos w t = Re (c - i s) e^(i w t).
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
    # Complex numbers as pairs of real ones: half the multiplications of a complex product.
    real = np.ascontiguousarray(x).view(float)
    made = matrix @ real.reshape(*real.shape[:-2], -1)
    return made.reshape(*made.shape[:-1], *real.shape[-2:]).view(complex)


def _side_by_side(each: Sequence[Forcing]) -> Forcing:
    """Drive of several members, those with fewer frequencies than others given some that carry nothing."""
    most = max(x.frequencies.shape[1] for x in each)
    missing = [most - x.frequencies.shape[1] for x in each]
    return Forcing(
        max(x.constant for x in each),
        # The added frequencies have rows of zeros, so that any value will do.
        np.concatenate(
            [np.pad(x.frequencies, ((0, 0), (0, k)), constant_values=1.0) for x, k in zip(each, missing, strict=True)]
        ),
        np.concatenate([np.pad(x.rows, ((0, 0), (0, 2 * k), (0, 0))) for x, k in zip(each, missing, strict=True)]),
        np.concatenate([np.pad(x.velocity, ((0, 0),) * 3 + ((0, 2 * k),)) for x, k in zip(each, missing, strict=True)]),
    )


def build(
    scheme: Scheme,
    coordinates: Coordinates,
    dt: float,
    steps: int,
    treatment: Treatment,
    reduced: bool = True,
    rule: int = LINEAR,
) -> Propagator:
    """Probe a step of ``scheme`` and arrange what ``steps`` of them do.

    ``rule``: how a node finds its force, see Block; BY_LAW has the velocities at the nodes among the entries.
    ``reduced``: leave out the components of the state that only add to others, see ``probe.independent``.
    """
    # Loads and offsets that are no formula are sampled; the others are left to ``forcing``.
    system, drive = coordinates.system, Drive.of(coordinates.system)
    samples = drive.split(coordinates.loads(system), coordinates.rows.shape[1])[1]
    offset_samples = drive.offsets(system)[1]
    vectors = np.array([vector for vector, _ in samples]) if samples else None
    one = probe(scheme, coordinates, dt, treatment.predicts, rule == BY_LAW, vectors, reduced)
    powers, entries = Powers(one, steps, rule == MEAN), Entries.of(one.readers, steps, one.ends_at_last_node)
    K, S, m, P = steps, len(scheme.nodes), len(coordinates.columns), one.push.shape[-1] // len(scheme.nodes)
    n, g, k = one.reading.shape
    C = one.readers.channels
    R, D = len(entries.place), k * n

    # What is read from the state, step by step, and from forces: one in step i acts as one in step 0, i steps later.
    flat = powers.readings(one.reading).transpose(1, 2, 3, 0).reshape(K, g, D)
    of_force = np.zeros((K + 1, g, P * S))  # the last for steps before the force
    of_force[0] = one.at_once
    of_force[1:K] = flat[:-1] @ one.push.transpose(1, 0, 2).reshape(D, P * S)
    step = np.arange(K)
    # delay < 0: the force comes after the reading, which takes the zeros in row K.
    delay = step - step[:, None]
    seen = of_force[np.where(delay >= 0, delay, K)].transpose(3, 0, 1, 2).reshape(P, S, K, K, g)
    # A force in step j acts through the K - 1 - j steps that follow it in the block.
    left = powers.pushes(one.push)[:, :, ::-1].transpose(3, 2, 1, 0).reshape(P, S, K, D)  # by step of the force
    pushed = np.zeros((P, S, K, R + D))
    pushed[..., :R] = entries.of_readings(seen, R)
    pushed[..., R:] = left
    speeds = seen[..., one.readers.end_rates]

    # Arrays on the state. The transition is stored by cyclic diagonals, see Block.
    reading, transition = aligned((D, R)), aligned((k, D))
    reading[:] = entries.of_readings(flat.transpose(2, 0, 1), R)
    component = np.arange(k)
    shifted = powers.last[:, component, (component + component[:, None]) % k]  # cyclic diagonals, (n, e, c)
    transition[:] = shifted.transpose(1, 2, 0).reshape(k, D)
    velocity = np.ascontiguousarray(flat[:, one.readers.end_rates])

    # Arrays on the contact forces, in the order of the nodes: step, node of the step, contact.
    nodes, N = K * S * m, entries.nodes
    push, velocity_push = aligned((N, R + D)), np.zeros((K, C, N))
    push[:nodes] = pushed[:m].transpose(2, 1, 0, 3).reshape(nodes, R + D)
    velocity_push[..., :nodes] = speeds[:m].transpose(3, 4, 2, 1, 0).reshape(K, C, nodes)
    block = Block(
        reading=reading,
        transition=transition,
        push=push,
        end_first=entries.end_first,
        end_stride=entries.end_stride,
        velocity=velocity,
        velocity_push=velocity_push,
        rates=entries.rates,
        nodes=nodes,
        rule=rule,
    )
    # The samples come load by load, then step by step.
    kind_by_kind = (0, 2, 1)
    return Propagator(
        one=one,
        powers=powers,
        steps=K,
        block=block,
        entries=entries,
        samples=tuple(samples),
        sample_rows=pushed[m:].transpose(*kind_by_kind, 3).reshape(-1, R + D),
        sample_velocity=speeds[m:].transpose(*kind_by_kind, 3, 4).reshape((P - m) * K * S, K, C),
        offset_samples=tuple(offset_samples),
    )
