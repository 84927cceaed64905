"""The method-of-lines right-hand side of a system, as its adaptive solvers and ``ode`` call it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import scipy.linalg

from ..basics.arrays import Array
from ..kernels.rhs import Equations
from .contact import channel_motion, channel_position, laws
from .contact_law import pressure
from .sampled import Sampled
from .state_space import StateSpace, on_positions, on_velocities
from .time_functions import Drive, LoadFunction, Term, evaluate, in_closed_form, parts_of


class RightHandSide:
    """z' = f(t, z) of a StateSpace, z = (y, input, viscous, impulse of every contact).

    Given a ``mass`` E (n, n), E y' = f(t, y): ``descriptor``.

        input'   = sum_k f_k p_k^T q' - sum_c F_c o_c',   viscous' = q'^T C q',   impulse_c' = -F_c

    integrate with the motion what nobody could add up from its outputs. The impulse has a sign, > 0 on the upper
    stop: -F is as smooth as the motion, |F| would have a kink of its own where a narrow gap is crossed. Where a
    stop damps there is one more, absorbed' = -sum_c F_c u_c' of those that do: stored and dissipated together, which is
    as smooth as the motion too. ``equations`` are the numbers, which C reads. ``in_python`` is True where a function of
    time is a bare callable, which Python calls once per evaluation, at times inside ``window`` only.
    """

    def __init__(self, first_order: StateSpace, mass: Array | None = None) -> None:
        self.system = system = first_order.system
        self.first_order = first_order
        self.states = n = 2 * system.size
        contacts = system.contacts
        m = len(contacts)
        self.damped = any(c.stops.dissipative for c in contacts)
        self.size = n + 2 + m + self.damped
        self.z0 = np.concatenate([first_order.y0, np.zeros(2 + m + self.damped)])
        self._mass = None if mass is None else scipy.linalg.lu_factor(mass)
        # Functions of time: amplitudes of those in closed form, then of those that Python has to call.
        drive, units = Drive.of(system), np.eye(m)
        leaves = (f for function in system.time_functions for f in parts_of(function))
        called = list({id(f): f for f in leaves if not in_closed_form(f)}.values())
        loads = _amplitudes(drive, called, first_order.loads, n)
        power = _amplitudes(drive, called, [(on_velocities(p), f) for p, f in system.loads], n)
        moving = [(units[i], c.offset) for i, c in enumerate(contacts) if c.offset is not None]
        offsets = _amplitudes(drive, called, moving, m)
        of_offsets = np.any(offsets[len(offsets) - len(called) :], axis=1)
        self._called: list[Any] = [(f, getattr(f, "value", f), x) for f, x in zip(called, of_offsets, strict=True)]
        # Rows of the velocity and acceleration of every contact. With E on the left C has E y': they take E^-1 along.
        rows = np.array([c.row for c in contacts]).reshape(m, system.size)
        velocities = on_velocities(rows)
        accelerations, inertia = velocities, None
        if self._mass is not None and mass is not None:
            accelerations = scipy.linalg.lu_solve(self._mass, velocities.T, trans=1).T
            inertia = np.asarray(scipy.linalg.block_diag(mass, np.eye(self.size - n)))
        damping = np.zeros((n if system.damped else 0, n))
        damping[1::2, 1::2] = system.damping[: len(damping) // 2]
        self.equations = Equations(
            size=self.size, damped=self.damped, called=len(called), matrix=first_order.matrix, inertia=inertia,
            damping=damping, frequencies=np.array(drive.frequencies), edges=drive.edges, records=drive.table,
            loads=loads, power=power, offsets=offsets, pushes=first_order.columns, positions=on_positions(rows),
            velocities=velocities, accelerations=accelerations, law=laws(contacts),
            bandwidths=self._bandwidths(inertia),
        )  # fmt: skip
        self.regime, self.lengths, self.levels = self.equations.regime, self.equations.lengths, self.equations.levels
        self.in_python, self.roots = bool(called), len(self.levels)
        self.bandwidths = self.equations.bandwidths  # lower and upper of E and df/dz, None where a band does not pay
        # (contact, +1 upper or -1 lower) of every gap.
        self.sides = [(i, side) for i, c in enumerate(contacts) for side, _ in c.stops.sides]

    @property
    def window(self) -> tuple[float, float]:
        """The times at which functions of time may be asked."""
        first, last = self.equations.window.tolist()
        return first, last

    @window.setter
    def window(self, times: tuple[float, float]) -> None:
        self.equations.window[:] = times

    def value(self, t: float, z: Array) -> Array:
        """f(t, z)."""
        self.ask(t)
        return self.equations.right_hand_side(t, z)

    def rate(self, t: float, z: Array) -> Array:
        """z', which is f(t, z) where no mass is given."""
        out = self.value(t, z)
        if self._mass is not None:
            out[: self.states] = scipy.linalg.lu_solve(self._mass, out[: self.states])
        return out

    def jacobian(self, t: float, z: Array, cj: float = 0.0, sign: float = 1.0) -> Array:
        """cj E + sign df/dz, (size, size), without the rows of the integrals: they act on nothing."""
        self.ask(t)
        return self.equations.jacobian(t, z, cj, sign)

    def event_functions(self, t: float, z: Array) -> Array:
        """The event functions less their ``levels``, (roots,), see ``kernels/rhs.h``."""
        self.ask(t)
        return self.equations.event_functions(t, z)

    def ask(self, t: float) -> None:
        """Call the functions of time that are not in closed form, for C to read."""
        given = self.equations.given
        for k, (function, value, moves) in enumerate(self._called):
            inside = self._inside(t)
            result = value(np.asarray(inside))
            if np.iscomplexobj(result) or not math.isfinite(result):
                result = evaluate(function, inside)  # which says what is wrong
            given[0, k] = result
            if moves:
                given[1, k] = function.rate(inside)
                given[2, k] = function.acceleration(inside) if self.damped else 0.0  # the rate of a damped stop's force

    def pressing(self, t: float, z: Array, k: int) -> float:
        """|F| of side k in contact."""
        i, side = self.sides[k]
        contact, y = self.system.contacts[i], z[: self.states]
        u, v = channel_motion(contact.row, contact.offset, self._inside(t), y[::2], y[1::2])
        depth = side * (u - contact.stops.bound(side))
        return max(0.0, pressure(max(0.0, float(depth)), side * float(v), contact.stops.coefficients))

    def stored(self, t: float, z: Array) -> Array:
        """Energy (contacts,) in the stops at t, with the functions of time of the window."""
        t, q = self._inside(t), z[: self.states : 2]
        contacts = self.system.contacts
        return np.array([c.stops.energy(channel_position(c.row, c.offset, t, q)) for c in contacts], float).reshape(-1)

    def jumped(self, t: float, z: Array, stored: Array) -> Array:
        """z where stops that held the energy ``stored`` jump at t: the rest of their energy is input, and those that
        damp have absorbed it."""
        gained = self.stored(t, z) - stored
        if not np.any(gained):
            return z
        z = z.copy()
        z[self.states] += np.sum(gained)
        if self.damped:
            z[-1] += np.sum(gained[[c.stops.dissipative for c in self.system.contacts]])
        return z

    def _bandwidths(self, inertia: Array | None) -> tuple[int, int] | None:
        lower, upper = self.first_order.bandwidths
        # With a mass the band must hold E too.
        if inertia is not None:
            below, above = scipy.linalg.bandwidth(inertia)
            lower, upper = max(lower, below), max(upper, above)
        return (lower, upper) if lower + upper + 1 < self.states // 3 else None

    def channels(self, t: Array, y: Array) -> tuple[Array, Array]:
        """Positions and velocities of the system's channels; y (k, m) at t (k,) -> (k, channels) each."""
        motions = [channel_motion(row, o, t, y[:, ::2], y[:, 1::2]) for row, o in self.system.channels]
        positions, velocities = (np.stack(x, axis=-1) for x in zip(*motions, strict=True))
        return positions, velocities

    def _inside(self, t: float) -> float:
        first, last = self.window
        return min(max(t, first), last)


def _amplitudes(drive: Drive, called: list[LoadFunction], terms: Iterable[Term], width: int) -> Array:
    """Amplitudes (d, width) of the harmonics and records in ``terms``, then of the functions that Python calls."""
    basis, rest = drive.split(terms, width)
    records = drive.recorded([(vector, f) for vector, f in rest if isinstance(f, Sampled)], width)
    python = np.zeros((len(called), width))
    for vector, function in rest:
        if not isinstance(function, Sampled):
            python[next(k for k, f in enumerate(called) if f is function)] += vector
    return np.concatenate([basis, records, python])
