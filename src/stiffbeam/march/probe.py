"""Matrices of a scheme's step in modal or other coordinates, from calls with unit states and unit forces."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array
from ..model.equations import Equation
from ..model.modes import Modes
from ..model.system import System
from ..schemes import Scheme


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
