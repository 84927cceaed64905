"""The method-of-lines right-hand side of a system, as its adaptive solvers and ``ode`` call it.

y' = A y + ..., contacts included, y = (q_1, q_1', ..., q_n, q_n'): the order of (3.5)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg

from ..basics.arrays import Array
from ..kernels.rhs import Equations
from .beam import velocity_curvature_matrices
from .contact import channel_motion, channel_position, laws
from .contact_law import pressure
from .time_functions import Drive, LoadFunction, Sampled, Term, evaluate, in_closed_form, parts_of

if TYPE_CHECKING:
    from .system import System


def on_positions(row: Array) -> Array:
    """The row on y, (..., 2n), of a row on q."""
    out = np.zeros((*row.shape[:-1], 2 * row.shape[-1]))
    out[..., ::2] = row
    return out


def on_velocities(row: Array) -> Array:
    """The row on y, (..., 2n), of a row on q'; also the column of a force on q''."""
    return np.roll(on_positions(row), 1, axis=-1)


def first_order(stiffness: Array, damping: Array) -> Array:
    """A (2n, 2n) of y' = A y, where q'' = -stiffness q - damping q'."""
    n = len(stiffness)
    A = np.zeros((2 * n, 2 * n))
    A[::2, 1::2] = np.eye(n)
    A[1::2, ::2] = 0.0 - stiffness  # no signed zeros in the Jacobian
    A[1::2, 1::2] = 0.0 - damping
    return A


def over_mass(system: System) -> tuple[Array, Array, Callable[[Array], Array]]:
    """M^-1 K, M^-1 C, and x -> M^-1 x."""
    diagonal = np.diag(system.mass)
    if not np.any(system.mass - np.diag(diagonal)):
        # By reciprocals: on the paper's grids they are whole numbers, and their products with its stencils exact. A
        # rounding of each entry would perturb the lowest frequency by eps (w_max/w_1)^2.
        reciprocal = 1.0 / diagonal
        divide = lambda x: (x.T * reciprocal).T  # noqa: E731
    else:
        factor = scipy.linalg.cho_factor(system.mass)
        divide = lambda x: scipy.linalg.cho_solve(factor, x)  # noqa: E731
    if system.form != "velocity-curvature":
        return divide(system.stiffness), divide(system.damping), divide
    # M^-1 K = EI/m R L of (3.12), since P R = L^T Q: banded, where P^-1 is not; and no damping.
    assert system.origin is not None
    M, problem = system.size, system.origin.problem
    _, _, L, R = velocity_curvature_matrices(M, float(M))  # h = 1: whole multiples of 1/4
    stiffness = problem.stiffness / problem.mass_per_length * (M / problem.length) ** 4 * (R @ L)
    return stiffness, np.zeros((M, M)), divide


class RightHandSide:
    """z' = f(t, z) of a system, z = (y, input, viscous, impulse of every contact); of a ``descriptor`` E z' = f(t, z),
    with the mass in E and not inverted.

        input'   = sum_k f_k p_k^T q' - sum_c F_c o_c',   viscous' = q'^T C q',   impulse_c' = -F_c

    integrate with the motion what nobody could add up from its outputs. The impulse has a sign, > 0 on the upper
    stop: -F is as smooth as the motion, |F| would have a kink of its own where a narrow gap is crossed. Where a
    stop damps there is one more, absorbed' = -sum_c F_c u_c' of those that do: stored and dissipated together, which is
    as smooth as the motion too. ``equations`` are the numbers, which C reads. ``in_python`` is True where a function of
    time is a bare callable, which Python calls once per evaluation, at times inside ``window`` only.
    """

    def __init__(self, system: System, descriptor: bool = False) -> None:
        self.system, self.states = system, 2 * system.size
        contacts, n = system.contacts, self.states
        m = len(contacts)
        self.damped = any(c.stops.dissipative for c in contacts)
        self.size = n + 2 + m + self.damped
        self.z0 = np.zeros(self.size)
        self.z0[:n] = on_positions(system.q0) + on_velocities(system.v0)
        stiffness, damping, divide = system.stiffness, system.damping, lambda x: x
        mass = np.eye(n)
        if descriptor:
            mass[1::2, 1::2] = system.mass
        else:
            stiffness, damping, divide = over_mass(system)
        self.mass, self._factor = mass, scipy.linalg.lu_factor(mass) if descriptor else None
        matrix = first_order(stiffness, damping)
        rows = np.array([c.row for c in contacts]).reshape(m, system.size)
        pushes = on_velocities(np.array([divide(row) for row in rows]).reshape(rows.shape))
        # Functions of time: amplitudes of those in closed form, then of those that Python has to call.
        drive, units = Drive.of(system), np.eye(m)
        leaves = (f for function in system.time_functions for f in parts_of(function))
        called = list({id(f): f for f in leaves if not in_closed_form(f)}.values())
        loads = _amplitudes(drive, called, [(on_velocities(divide(p)), f) for p, f in system.loads], n)
        power = _amplitudes(drive, called, [(on_velocities(p), f) for p, f in system.loads], n)
        moving = [(units[i], c.offset) for i, c in enumerate(contacts) if c.offset is not None]
        offsets = _amplitudes(drive, called, moving, m)
        of_offsets = np.any(offsets[len(offsets) - len(called) :], axis=1)
        self._called: list[Any] = [(f, getattr(f, "value", f), x) for f, x in zip(called, of_offsets, strict=True)]
        # Rows of the velocity and acceleration of every contact. With E on the left C has E y': they take E^-1 along.
        positions, velocities = on_positions(rows), on_velocities(rows)
        accelerations, inertia = velocities, None
        if self._factor is not None:
            accelerations = scipy.linalg.lu_solve(self._factor, velocities.T, trans=1).T
            inertia = np.asarray(scipy.linalg.block_diag(mass, np.eye(self.size - n)))
        viscous = np.zeros((n if system.damped else 0, n))
        viscous[1::2, 1::2] = system.damping[: len(viscous) // 2]
        # Where df/dz has entries, and E.
        pattern = (matrix != 0.0) | (mass != 0.0)
        for push, contact, position, velocity in zip(pushes, contacts, positions, velocities, strict=True):
            felt = position + velocity if contact.stops.dissipative else position
            pattern |= np.outer(push != 0.0, felt != 0.0)
        lower, upper = scipy.linalg.bandwidth(pattern)
        self.equations = Equations(
            size=self.size, damped=self.damped, called=len(called), matrix=matrix, inertia=inertia, damping=viscous,
            frequencies=np.array(drive.frequencies), edges=drive.edges, records=drive.table, loads=loads, power=power,
            offsets=offsets, pushes=pushes, positions=positions, velocities=velocities, accelerations=accelerations,
            law=laws(contacts), bandwidths=(lower, upper) if lower + upper + 1 < n // 3 else None,
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
        if self._factor is not None:
            out[: self.states] = scipy.linalg.lu_solve(self._factor, out[: self.states])
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
