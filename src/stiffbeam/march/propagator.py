"""A scheme's step as matrices, ``StepMap``, and K steps as the arrays of one linear map, ``Propagator``.

Calls with unit states and unit forces give the matrices of a step, in modal or other coordinates. A scheme is a linear
step, and K steps of it are again one, with K S force nodes. In modal coordinates the homogeneous part is one small
matrix per mode, else one large one. The march then costs one product with ``reading`` and one with ``transition`` per
block, and touches the stops node by node.
"""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array, aligned, copied, padded
from ..kernels.library import BLOCK, BY_LAW, DRIVE, MEAN
from ..model.equations import Equation
from ..model.modes import Modes
from ..model.system import System
from ..model.time_functions import Drive, evaluate
from ..schemes import Scheme
from .treatment import Treatment


class Coordinates:
    """x (N,) with q = q(x), y = (x, x'): the modes ``basis`` of a system, or without one its unknowns as they are.

    They fall into ``parts`` that no linear step couples: N modes, or 1. equation: the linear part. rows: (C, N),
    channel c is at rows[c] @ x + o_c(t). columns: (m, N), what a unit force of a contact adds to the right-hand side.
    """

    def __init__(self, system: System, basis: Modes | None) -> None:
        self.system, self.basis = system, basis
        self.rows = np.array([self.vector(row) for row, _ in system.channels])
        self.columns = self.rows[: len(system.contacts)]
        self.parts, self.equation = 1, Equation(system.mass, system.damping, system.stiffness)
        if basis is not None:
            self.parts, self.equation = len(basis.omega), basis.equation

    def vector(self, force: Array) -> Array:
        """A vector of forces (n,) as part of the right-hand side, (N,)."""
        return force if self.basis is None else self.basis.force(force)

    def start(self, q0: Array, v0: Array) -> Array:
        """y (2, N) at t = 0 from initial data (n,)."""
        y = np.array([q0, v0])
        return y if self.basis is None else self.basis.to_modal(y)

    def states(self, y: Array) -> tuple[Array, Array]:
        """q and q' (..., n) of y (2, ..., N)."""
        return (y[0], y[1]) if self.basis is None else (self.basis.to_nodal(y[0]), self.basis.to_nodal(y[1]))

    def load(self, member: System, t: ArrayLike) -> Array:
        """Share of the loads of such a system in the right-hand side, (..., N) at times t (...)."""
        return self.vector(member.load(t))

    def units(self, components: int) -> Array:
        """Unit states (components, batch, N), of all parts at once."""
        # Parts that do not couple are probed side by side: one unit state acts on the same component of all.
        if self.parts > 1:
            eye = np.eye(components)
            return np.repeat(eye[..., None], self.parts, axis=2)
        N = self.rows.shape[1]
        return np.moveaxis(np.eye(components * N).reshape(components, N, -1), 1, 2).copy()

    def by_part(self, z: Array) -> Array:
        """States (k, batch, N) -> (parts, components of a part, batch)."""
        k, batch, N = z.shape
        return z.transpose(2, 0, 1) if self.parts > 1 else z.transpose(0, 2, 1).reshape(1, k * N, batch)


INDEPENDENT = 1e-13  # of what a component does, beyond rounding
SAME = 1e-9  # of the positions that a unit leads to: a scheme may add up the same ones in another order


class Readers:
    """Readings of a step, g positions and velocities: of the contacts at the S nodes, of the C channels at its
    end, and where that is ``rated`` the velocities of the contacts at the nodes.

    channel, when, is_rate, field: (g,), whose it is, at which share of the step, whether it is a velocity, and in
    which of the fields of a step it is read: positions at the nodes, at the end, velocities there and at the nodes.
    """

    def __init__(self, nodes: tuple[float, ...], contacts: int, channels: int, rated: bool) -> None:
        self.nodes, self.contacts, self.channels, self.rated = nodes, contacts, channels, rated
        S, m, C = len(nodes), contacts, channels
        first = np.cumsum([0, S * m, C, C, S * m if rated else 0]).tolist()
        self.at_nodes, self.at_ends, self.end_rates, self.node_rates = (slice(*x) for x in pairwise(first))
        # Positions at the nodes, positions at the end, velocities there, velocities at the nodes.
        which, ends, of_nodes = np.repeat(np.arange(S), m), np.arange(C), np.tile(np.arange(m), S)
        g, self.channel = first[-1], np.concatenate([of_nodes, ends, ends, of_nodes])[: first[-1]]
        self.when = np.concatenate([np.repeat(nodes, m), np.ones(2 * C), np.repeat(nodes, m)])[:g]
        self.is_rate = np.arange(g) >= first[2]
        self.field = np.concatenate([which, 0 * ends + S, 0 * ends + S + 1, S + 2 + which])[:g]


def components(scheme: Scheme, equation: Equation, n: int) -> int:
    """a, the number of state components of a scheme."""
    return scheme.initial(equation, [np.zeros((2, n))] * scheme.history, np.zeros(n)).shape[0]


class StepMap:
    """Map of one step of a scheme, part by part of its coordinates, from unit states and unit forces,

        z' = transition z + push f,      w = sum over parts of reading z + at_once f,

    f the forces of P kinds at each of the S nodes, f[p S + s], the contacts' first, then of unit loads; w the g
    readings, with the velocities at the nodes where ``rated``. Of the scheme's state the k components ``keep`` are
    carried, each with its share ``mix`` (k, a) of the others; ``reduced``: without those that only add to others, see
    ``independent``. transition: (n, k, k). push: (n, k, P S). reading: (n, g, k). at_once: (g, P S).
    """

    def __init__(
        self, scheme: Scheme, coordinates: Coordinates, dt: float, extrapolated: bool = False, rated: bool = False,
        reduced: bool = True,
    ) -> None:  # fmt: skip
        self.scheme, self.coordinates, self.dt = scheme, coordinates, dt
        equation, (C, N), m = coordinates.equation, coordinates.rows.shape, len(coordinates.columns)
        vectors = [coordinates.vector(vector) for vector, _ in coordinates.system.loads]
        forces = np.concatenate([coordinates.columns, np.array(vectors).reshape(-1, N)])
        S, P, a = len(scheme.nodes), len(forces), components(scheme, equation, N)
        self.keep, self.mix = independent(scheme, dt, extrapolated) if reduced else (np.arange(a), np.eye(a))
        self.readers = readers = Readers(tuple(scheme.nodes), m, C, rated)
        # One batch: unit states without forces, then a unit force of every kind at every node.
        units = coordinates.units(len(self.keep))
        states = units.shape[1]
        z, acting = np.zeros((a, states + P * S, N)), np.zeros((2, S, states + P * S, N))
        z[self.keep, :states] = units
        # acting[0] are loads, acting[1] reactions; force p at node s is column p S + s.
        for s in range(S):
            acting[1, s, states + s : states + m * S : S] = forces[:m]
            acting[0, s, states + m * S + s :: S] = forces[m:]
        new, at_nodes = scheme.step(equation, dt, z, list(acting[0]), list(acting[1]))
        new = np.asarray(new)
        # The contact forces are functions of these positions: of the stages, or of the predicted ones.
        places = scheme.predict(equation, dt, z) if extrapolated else [y[0] for y in at_nodes]
        fields = np.array([*places, new[0], new[1], *(y[1] for y in at_nodes if rated)])
        carried = coordinates.by_part(np.einsum("ca,abj->cbj", self.mix, new))
        self.transition = np.ascontiguousarray(carried[..., :states])
        self.push = np.ascontiguousarray(carried[..., states:])
        self.reading = _shares(coordinates, readers, fields[:, :states])
        self.at_once = _read(coordinates, readers, fields[:, states:])
        # Extrapolated positions are predictions of the nodes, not the positions at the end of the step.
        bound = SAME * np.max(np.abs(new[0]), axis=-1, keepdims=True) if rated else 0.0  # else the bits count
        self.ends_at_last_node = not extrapolated and bool(np.all(np.abs(at_nodes[-1][0] - new[0]) <= bound))


def _read(coordinates: Coordinates, readers: Readers, fields: Array) -> Array:
    """The readings (g, batch) of fields (fields, batch, N)."""
    # Row by row and not as a matrix product, whose rounding depends on the size of the batch.
    read = np.array([np.sum(fields * row, axis=-1) for row in coordinates.rows])
    return read[readers.channel, readers.field]


def _shares(coordinates: Coordinates, readers: Readers, fields: Array) -> Array:
    """Response of the readings to unit states (fields, batch, N) of every part, (n, g, k)."""
    if coordinates.parts == 1:
        return _read(coordinates, readers, fields)[None]
    # No part couples with another: row times field is the response of each part, without a sum over them.
    rows = coordinates.rows[readers.channel]
    return np.ascontiguousarray((fields[readers.field] * rows[:, None]).transpose(2, 0, 1))


def independent(scheme: Scheme, dt: float, extrapolated: bool = False) -> tuple[NDArray[np.int64], Array]:
    """The components of the state that a run needs, and what each of them has to hold.

    If a unit of component e does to all that follows what x_ec units of the components c do, whatever the equation,
    then e need not be carried: c becomes c + x_ec e. (HHT's acceleration enters by q + dt v + dt^2 (1/2 - beta) a
    and v + dt (1 - gamma) a only.) Seen on three damped motions with periods of about dt, every component in units
    of what it does to the position. Returns (keep, mix), mix of shape (kept, a).
    """
    rates, decay = np.array([0.4, 1.1, 2.3]) / dt, np.array([0.3, 0.2, 0.5]) / dt
    equation, n = Equation(np.ones(3), decay, rates**2), len(rates)
    # A unit of every component, on all motions at once, without forces.
    a = components(scheme, equation, n)
    z = np.zeros((a, a, n))
    z[np.arange(a), np.arange(a)] = 1.0
    # What a part of the input does, so many times, shows how much is rounding: terms that cancel leave nothing else.
    parts = np.array([1.0, 3.0, 5.0, 7.0, 11.0])[:, None, None]
    z = (z[:, None] / parts).reshape(a, -1, n)
    none = [np.zeros(z.shape[1:])] * len(scheme.nodes)
    new, stages = scheme.step(equation, dt, z, none, none)
    guesses = scheme.predict(equation, dt, z) if extrapolated else []
    fields = np.array([*new, *(y[0] for y in stages), *(y[1] for y in stages), *guesses])
    times = parts * fields.reshape(-1, len(parts), a, n)
    does = times[:, 0]  # (fields, a, n)
    rounding = np.max(np.abs(times - times[:, :1]), axis=(1, 3))[..., None]
    does = np.where(np.abs(does) <= 16.0 * rounding, 0.0, does)
    effects = does.transpose(0, 2, 1).reshape(-1, a)
    # Every component in units of what it does to the position; one that moves no position keeps its unit.
    units = np.max(np.abs(does[0]), axis=1)
    units = np.where(units > 0.0, units, 1.0)
    effects = effects / units
    # Every effect counts alike, whatever its size; rows that are all rounding are left out.
    size = np.max(np.abs(effects), axis=1)
    effects = effects[size > 0.0] / size[size > 0.0, None]
    # A component that those kept so far can stand in for is dropped, and they hold its share.
    keep: list[int] = []
    mix = np.eye(a)
    for e in range(a):
        x = np.linalg.lstsq(effects[:, keep], effects[:, e], rcond=None)[0]
        left = np.max(np.abs(effects[:, keep] @ x - effects[:, e]))
        if left <= INDEPENDENT * np.max(np.abs(effects[:, e])):
            mix[keep, e] = x * units[e] / units[keep]
        else:
            keep.append(e)
    return np.array(keep), mix[keep]


class Entries:
    """The contacts at every node of so many steps, padded to eight, then the channels at the ends of steps that are no
    node, then where they are read the contacts' velocities at every node.

    nodes: N, a multiple of eight. end_first, end_stride: (C,), rates: (N,), see march.h. size: R, of all.
    """

    def __init__(self, readers: Readers, steps: int, ends_at_last_node: bool) -> None:
        S, m, C = len(readers.nodes), readers.contacts, readers.channels
        # Where the last node is the end of the step, the positions of the contacts there are entries of nodes already.
        self.readers, self.skipped = readers, m if ends_at_last_node else 0
        at_ends, count = C - self.skipped, steps * S * m
        self.nodes = N = padded(count, least=0)
        # For every channel the entry at the end of the first step, and the distance to that of the next.
        self.end_first, self.end_stride = N + np.arange(C) - self.skipped, np.full(C, at_ends)
        if ends_at_last_node:
            self.end_first[:m], self.end_stride[:m] = (S - 1) * m + np.arange(m), S * m
        rates = N + steps * at_ends + np.arange(count if readers.rated else 0)
        self.size = N + steps * at_ends + len(rates)
        self.rates = np.pad(rates, (0, N - count)) if len(rates) else rates

    def of_readings(self, x: Array) -> Array:
        """(..., K, g) -> (..., R), zero between the nodes and the ends."""
        r, (*batch, K, _) = self.readers, x.shape
        at_ends = slice(r.at_ends.start + self.skipped, r.at_ends.stop)
        parts = (x[..., at] for at in (r.at_nodes, at_ends, r.node_rates))
        nodes, ends, rates = (part.reshape(*batch, K * part.shape[-1]) for part in parts)
        return np.concatenate([nodes, np.zeros((*batch, self.nodes - nodes.shape[-1])), ends, rates], axis=-1)


def powers_of(one: StepMap, steps: int, turn: bool) -> list[Array]:
    """A step map's transition A to the powers 1, 2, 4, ... up to ``steps``, (n, k, k) each.

    ``turn``: every undamped mode whose q and q', the first two components, a scheme turns keeps their determinant of 1.
    The rounding of a power comes in again and again, the same in every block, and is work that no force has done: 1e-10
    of the energy in 1e6 steps.
    """
    levels, basis = [one.transition.copy()], one.coordinates.basis
    # Squaring: log2 K products, where step by step K are needed.
    while 2 ** len(levels) <= steps:
        levels.append(levels[-1] @ levels[-1])
    if turn and basis is not None:
        for level in levels:
            squared = np.linalg.det(level[:, :2, :2])
            # Only where A is a rotation: numerical dissipation and damping stay.
            turns = (basis.damping == 0.0) & (np.abs(squared - 1.0) < 1e-9)
            level[turns, :2, :2] /= np.sqrt(squared[turns])[:, None, None]
    return levels


def repeated(start: Array, levels: list[Array], steps: int) -> Array:
    """start A^j of (n, g, k) for j < steps: (n, steps, g, k)."""
    n, g, k = start.shape
    made, done = np.empty((n, steps, g, k)), 1
    made[:, 0] = start
    # Doubling: those so far, behind A^done, give as many later ones.
    for level in levels:
        more = min(done, steps - done)
        if more > 0:
            made[:, done : done + more] = (made[:, :more].reshape(n, more * g, k) @ level).reshape(n, more, g, k)
            done += more
    return made


class Forcing(NamedTuple):
    """Response of a block to the drive of harmonic and constant loads and offsets. effects: see march.h; c: the drive
    for C."""

    effects: Array
    c: Any


class Propagator:
    """K steps from the state z (a, N), packed as D numbers, with the entries w (R,), see ``Entries``:

        (w, z_new) = (reading z, transition z) + g rows + inflow
        F_i = F(w_i),  then  (w, z_new) += push_i F_i      for the nodes in order,

    where w_i = r + s F_i is solved in closed form with the compliance s (0 where the contact is extrapolated and w_i is
    the predictor); for other laws than the linear one see node.c. ``forcing`` gives the rows of harmonic and constant
    loads, with g(t) at the block's start, ``inflow`` the share of others; all else is the same for every load.

    rule: how a node finds its force: LINEAR, BY_LAW, with the velocities at the nodes among the entries, or MEAN.
    reduced: without the components of the state that only add to others, see ``independent``. c: a Block, see march.h.
    """

    def __init__(
        self, scheme: Scheme, coordinates: Coordinates, dt: float, steps: int, treatment: Treatment, rule: int,
        reduced: bool = True,
    ) -> None:  # fmt: skip
        self.coordinates, self.steps = coordinates, steps
        self.one = one = StepMap(scheme, coordinates, dt, treatment.predicts, rule == BY_LAW, reduced)
        self.entries = entries = Entries(one.readers, steps, one.ends_at_last_node)
        K, S, m, P = steps, len(scheme.nodes), len(coordinates.columns), one.push.shape[-1] // len(scheme.nodes)
        (n, g, k), C, levels = one.reading.shape, one.readers.channels, powers_of(one, steps, rule == MEAN)
        R, D = entries.size, k * n
        self.used = D  # numbers of a state
        flat = repeated(one.reading, levels, K).transpose(1, 2, 3, 0).reshape(K, g, D)
        pushed, speeds = _of_forces(one, levels, entries, flat)
        # Arrays on the state. The transition is stored by cyclic diagonals.
        self.reading = copied(entries.of_readings(flat.transpose(2, 0, 1)))
        self.transition = copied(by_diagonals(levels[-1]))  # K is a power of two
        # Arrays on the contact forces, in the order of the nodes: step, node of the step, contact.
        self.nodes = nodes = K * S * m
        self.push = aligned((entries.nodes, R + D))
        self.push[:nodes] = pushed[:m].transpose(2, 1, 0, 3).reshape(nodes, R + D)
        # Of a channel's velocities at the ends of steps: what the state and what the forces do.
        self.velocity = flat[:, one.readers.end_rates].swapaxes(0, 1)  # (C, K, D)
        self.velocity_push = speeds[:m].transpose(4, 3, 2, 1, 0).reshape(C, K, nodes)
        self.c = BLOCK(
            vars(self) | vars(entries), R=R, D=D, a=k, n=n, K=K, nodes=nodes, rule=rule, rated=len(entries.rates) > 0
        )  # fmt: skip
        # Of unit loads, load by load and node by node: on entries and new state (L K S, R + D), on velocities.
        self.load_rows = pushed[m:].transpose(0, 2, 1, 3).reshape(-1, R + D)
        self.load_velocity = speeds[m:].transpose(0, 2, 1, 4, 3).reshape((P - m) * K * S, C, K)
        # Functions that are no formula are sampled, at nodes and entries: their shares in the loads and the offsets.
        drive, self.loads = coordinates.system.drive, P - m
        self.load_samples, self.offset_samples = (
            [(share, f) for share, f in zip(shares[drive.size :], drive.others, strict=True) if np.any(share)]
            for shares in amplitudes_of(coordinates.system)
        )
        self.harmonic = not self.load_samples and not self.offset_samples  # then there is no inflow

    def pack(self, z: Array) -> Array:
        """The scheme's state (a, N) -> (D + ...,), see march.h."""
        # The state once more behind itself but for its last component, so that a shift by e n needs no wrapping.
        again = self.used - self.coordinates.parts
        packed = aligned((self.used + again,))
        packed[: self.used] = (self.one.mix @ z).ravel()
        packed[self.used :] = packed[:again]
        return packed

    def unpack(self, packed: Array) -> Array:
        """Packed (..., D + ...) -> states (a, ..., N) that go on as the packed ones do."""
        (*batch, _), (_, N) = packed.shape, self.coordinates.rows.shape
        z = np.zeros((self.one.mix.shape[1], *batch, N))
        z[self.one.keep] = np.moveaxis(packed[..., : self.used].reshape(*batch, -1, N), -2, 0)
        return z

    @property
    def compliances(self) -> tuple[Array, Array]:
        """(nodes, m, m) each: how the forces at a node move its contacts and their velocities."""
        nodes = np.arange(self.nodes).reshape(-1, len(self.coordinates.columns))
        at = lambda entries: np.array([self.push[np.ix_(here, entries[here])].T for here in nodes])  # noqa: E731
        return at(np.arange(self.nodes)), at(self.entries.rates)

    def inflow(self, starts: Array, last: float) -> dict[str, Array | None]:
        """Share of sampled loads and offsets in the blocks that start at ``starts`` (B,), as arrays of a Run.

        No function is asked for times of steps that start after ``last``: a block may run past the end.
        """
        if self.harmonic:
            return {"inflow": None, "inflow_velocity": None}
        K, B, readers, dt = self.steps, len(starts), self.one.readers, self.one.dt
        begun = np.add.outer(starts, np.arange(K) * dt)[..., None]  # (B, K, 1)
        at_shares = lambda when: np.where(begun > last - 0.5 * dt, last, begun + when * dt)  # noqa: E731
        times, moved = at_shares(np.array(readers.nodes)).reshape(B, -1), None
        values = np.zeros((B, self.loads, times.shape[1]))  # (B, L, K S)
        for shares, f in self.load_samples:
            values += shares[:, None] * evaluate(f, times)[:, None]
        if self.offset_samples:
            times = at_shares(readers.when)
            moved = np.zeros(times.shape)  # (B, K, g)
            for shares, f in self.offset_samples:
                share = shares[readers.channel]
                for order in (0, 1):
                    here = np.flatnonzero((readers.is_rate == order) & (share != 0.0))
                    moved[..., here] += share[here] * evaluate(f, times[..., here], order)
        rows, velocity = self._effect(values.reshape(B, -1), moved)
        return {"inflow": rows, "inflow_velocity": np.ascontiguousarray(velocity)}

    def _effect(self, loads: Array, moved: Array | None) -> tuple[Array, Array]:
        """Effect of loads (.., L K S) and of the motion of stops in the readings (.., K, g) on entries and new state
        (.., R + D) and on velocities (.., C, K). Stops move positions by offsets, velocities by the rates of these."""
        rows, velocity = loads @ self.load_rows, np.tensordot(loads, self.load_velocity, 1)
        if moved is not None:
            rows[..., : self.entries.size] += self.entries.of_readings(moved)
            velocity += moved[..., self.one.readers.end_rates].swapaxes(-1, -2)
        return rows, velocity

    @cached_property
    def own_forcing(self) -> Forcing:
        """``forcing`` of the system of the coordinates itself."""
        return self.forcing(self.coordinates.system)

    def forcing(self, system: System) -> Forcing:
        """The harmonic and constant loads and offsets of a system that differs from this one in nothing else."""
        drive, readers, dt, moved = system.drive, self.one.readers, self.one.dt, None
        begun = np.arange(self.steps)[:, None] * dt
        loads, offsets = (x[: drive.size] for x in amplitudes_of(system))
        at_nodes = (begun + np.array(readers.nodes) * dt).reshape(-1, 1)
        values = _ahead(drive, loads, at_nodes).swapaxes(1, 2).reshape(drive.size, -1)  # (d, L K S)
        if np.any(offsets):
            read = np.where(readers.is_rate, drive.rates(offsets)[:, readers.channel], offsets[:, readers.channel])
            moved = _ahead(drive, read, begun + readers.when * dt)  # (d, K, g)
        rows, velocity = self._effect(values, moved)  # (d, R + D), (d, C, K)
        constant = float(np.any(rows[0]) or np.any(velocity[0]))
        # Of what a block begins with, in a multiple of 8 numbers, and of its forces.
        (C, K, D), d = self.velocity.shape, drive.size
        effects = aligned((C, K, padded(D + d) + self.entries.nodes))
        effects[..., :D], effects[..., D : D + d] = self.velocity, velocity.transpose(1, 2, 0)
        effects[..., padded(D + d) :][..., : self.nodes] = self.velocity_push
        arrays = {"frequencies": np.array(drive.frequencies), "rows": copied(rows)}
        return Forcing(effects, DRIVE(arrays, constant=constant, R=rows.shape[1] - D, D=D))


def amplitudes_of(system: System) -> list[Array]:
    """Amplitudes of the functions of the loads, and of the offsets of the channels, see Drive."""
    functions = [f for _, f in system.loads], [offset for _, offset in system.channels]
    return [system.drive.amplitudes(x) for x in functions]


def _ahead(drive: Drive, basis: Array, times: Array) -> Array:
    """The functions g(t0 + times) @ basis as g(t0) @ what is returned: basis (d, X) and times (T, X) -> (d, T, X)."""
    phase = np.multiply.outer(np.array(drive.frequencies), times)
    sine, cosine, (s, c) = np.sin(phase), np.cos(phase), (basis[1::2, None], basis[2::2, None])
    ahead = np.empty((drive.size, len(times), basis.shape[1]))
    ahead[0], ahead[1::2], ahead[2::2] = basis[0], s * cosine - c * sine, s * sine + c * cosine
    return ahead


def by_diagonals(transition: Array) -> Array:
    """A transition (n, k, k) by its cyclic diagonals (k, k n), see march.h."""
    component = np.arange(transition.shape[1])
    shifted = transition[:, component, (component + component[:, None]) % len(component)]
    return np.ascontiguousarray(shifted.transpose(1, 2, 0)).reshape(len(component), -1)


def _of_forces(one: StepMap, levels: list[Array], entries: Entries, flat: Array) -> tuple[Array, Array]:
    """Effects of a unit force of every kind at every node of a block: on entries and new state (P, S, K, R + D), and on
    the channels' velocities (P, S, K, K, C). flat: the readings (K, g, D) of the state, step by step."""
    (K, g, D), S = flat.shape, len(one.readers.nodes)
    P = one.push.shape[-1] // S
    # A force in step i acts as one in step 0, i steps later.
    of_force = np.zeros((K + 1, g, P * S))  # the last for steps before the force
    of_force[0] = one.at_once
    of_force[1:K] = flat[:-1] @ one.push.transpose(1, 0, 2).reshape(D, P * S)
    step = np.arange(K)
    # delay < 0: the force comes after the reading, which takes the zeros in row K.
    delay = step - step[:, None]
    seen = of_force[np.where(delay >= 0, delay, K)].transpose(3, 0, 1, 2).reshape(P, S, K, K, g)
    # A force in step j acts through the K - 1 - j steps that follow it in the block.
    pushes = repeated(one.push.swapaxes(1, 2), [level.swapaxes(1, 2) for level in levels], K)  # A^j push, transposed
    left = pushes[:, ::-1].transpose(2, 1, 3, 0).reshape(P, S, K, D)  # by step of the force
    return np.concatenate([entries.of_readings(seen), left], axis=-1), seen[..., one.readers.end_rates]
