"""The method-of-lines right-hand side: compiled with its Jacobian, as SUNDIALS and SciPy call them, and in JAX."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse

from ..basics.arrays import Array
from ..basics.validation import InputError
from .contact import channel_motion, channel_position, laws
from .contact_law import Law, damps, pressure
from .right_hand_side_kernels import (
    THROUGH,
    Equations,
    block_of,
    event_functions,
    event_functions_at,
    jacobian,
    residual,
    right_hand_side,
)
from .sampled import Sampled
from .state_space import StateSpace
from .time_functions import Drive, LoadFunction, Term, TimeFunction, evaluate, offset_rate, offset_values

if TYPE_CHECKING:
    from .system import System


class RightHandSide:
    """z' = f(t, z) of a StateSpace, z = (y, input, viscous, impulse of every contact).

    Given a ``mass`` E (n, n), E y' = f(t, y): ``descriptor``.

        input'   = sum_k f_k p_k^T q' - sum_c F_c o_c',   viscous' = q'^T C q',   impulse_c' = -F_c

    integrate with the motion what nobody could add up from its outputs. The impulse has a sign, > 0 on the upper
    stop: -F is as smooth as the motion, |F| would have a kink of its own where a narrow gap is crossed. Where a
    stop damps there is one more, absorbed' = -sum_c F_c u_c' of those that do: stored and dissipated together, which is
    as smooth as the motion too. ``regime`` (contacts,) is chi of every contact, in which the force is smooth on both
    sides of its events, or THROUGH for the law itself. ``lengths`` (contacts,): of the contacts' motion, by which
    the event function of a damped stop is made a length.
    ``equations`` holds the numbers, ``block`` their places for the compiled functions of ``right_hand_side_kernels``.
    ``in_python`` is True where a function of time is a bare callable, which Python calls once per evaluation, at times
    inside ``window`` only.
    """

    def __init__(self, first_order: StateSpace, mass: Array | None = None) -> None:
        system = first_order.system
        self.first_order = first_order
        self.states = n = len(first_order.y0)
        contacts = first_order.contacts
        m = len(contacts)
        self.damped = any(c.contact.stops.dissipative for c in contacts)
        self.size = n + 2 + m + self.damped
        self.z0 = np.concatenate([first_order.y0, np.zeros(2 + m + self.damped)])
        self.callbacks = "Python"  # "compiled" where the solver calls the kernels itself, "JAX"
        self.compile_seconds = 0.0  # of what a solver compiles for it
        self._mass = None if mass is None else scipy.linalg.lu_factor(mass)

        # Functions of time: amplitudes for the kernels, and those that Python has to call.
        drive = Drive.of(system)
        loads, self._called = _compiled_part(drive, first_order.loads, n)
        powers = [(first_order.to_v.T @ p, f) for p, f in system.loads]
        power, self._called_power = _compiled_part(drive, powers, n)
        units = np.eye(m)
        moving = [(units[i], c.contact.offset) for i, c in enumerate(contacts) if c.contact.offset is not None]
        offsets, called_offsets = _compiled_part(drive, moving, m)
        self._called_offsets = sorted({int(np.flatnonzero(unit)[0]) for unit, _ in called_offsets})
        for i in self._called_offsets:  # a sum that is called in part is called whole
            offsets[:, i] = 0.0

        # Rows of the viscous power, and of the velocity and acceleration of every contact.
        damping = first_order.to_v.T @ system.damping @ first_order.to_v if system.damped else np.zeros((0, 0))
        velocity_rows = np.array([first_order.velocity_row(c) for c in contacts]).reshape(m, n)
        acceleration_rows = velocity_rows
        inertia = np.zeros((0, 0))
        # With E on the left the kernel has E y': the rows take E^-1 along.
        if self._mass is not None and mass is not None:
            acceleration_rows = np.ascontiguousarray(scipy.linalg.lu_solve(self._mass, velocity_rows.T, trans=1).T)
            inertia = np.asarray(scipy.linalg.block_diag(mass, np.eye(self.size - n)))
        # Arrays to which a solver writes later.
        self.regime = np.full(m, THROUGH, np.int64)
        self._window = np.array([-math.inf, math.inf])
        self.lengths = np.ones(m)
        arrays = Equations(
            *_sparse(first_order.matrix),
            *_sparse(damping),
            *_sparse(inertia),
            frequencies=np.array(drive.frequencies, float),
            edges=drive.edges,
            records=drive.table.reshape(len(drive.edges), len(drive.records) * drive.order),
            loads=loads,
            power=power,
            pushes=np.array([c.column for c in contacts]).reshape(m, n),
            position_rows=np.array([c.row for c in contacts]).reshape(m, n),
            velocity_rows=velocity_rows,
            acceleration_rows=acceleration_rows,
            offsets=offsets,
            law=laws(system.contacts),
            lengths=self.lengths,
            regime=self.regime,
            shifts=np.zeros((3, m)),
            levels=np.zeros(self.roots),
            window=self._window,
        )
        # Contiguous arrays stay the same objects, so that writing to ``regime`` or ``window`` reaches the kernels.
        self.equations = Equations(*map(np.ascontiguousarray, arrays))
        self.block = block_of(self.equations)
        self(0.0, self.z0.copy(), np.empty(self.size))

    @property
    def in_python(self) -> bool:
        """Return True where a function of time is called from Python."""
        return bool(self._called or self._called_offsets)

    @property
    def window(self) -> tuple[float, float]:
        """The times at which functions of time may be asked."""
        return float(self._window[0]), float(self._window[1])

    @window.setter
    def window(self, times: tuple[float, float]) -> None:
        self._window[:] = times

    def __call__(self, t: float, z: Array, out: Array) -> None:
        """Write f(t, z) into ``out``."""
        # Offsets before the kernel, which reads their shifts; the other callables after it, added to its rates.
        self._call_offsets(t)
        right_hand_side(t, _writable(z), out, self.block)
        if self._called:
            t = self._inside(t)
            y, n = z[: self.states], self.states
            for (vector, function), (row, _) in zip(self._called, self._called_power, strict=True):
                value = _at_one_time(function, t)
                out[:n] += vector * value
                out[n] += value * (row @ y)

    def value(self, t: float, z: Array) -> Array:
        """f(t, z)."""
        out = np.empty(self.size)
        self(t, z, out)
        return out

    def rate(self, t: float, z: Array) -> Array:
        """z', which is f(t, z) where no mass is given."""
        out = self.value(t, z)
        if self._mass is not None:
            out[: self.states] = scipy.linalg.lu_solve(self._mass, out[: self.states])
        return out

    def residual(self, t: float, z: Array, rate: Array, out: Array) -> None:
        """Write E z' - f(t, z) into ``out``; for a system with a ``mass``."""
        self._call_offsets(t)
        residual(t, _writable(z), _writable(rate), out, self.block)
        if self._called:
            t = self._inside(t)
            for (vector, function), (row, _) in zip(self._called, self._called_power, strict=True):
                value = _at_one_time(function, t)
                out[: self.states] -= vector * value
                out[self.states] -= value * (row @ z[: self.states])

    def jacobian(self, t: float, z: Array, cj: float = 0.0, sign: float = 1.0) -> Array:
        """cj E + sign df/dz, (size, size), without the rows of the integrals: they act on nothing."""
        self._call_offsets(t)
        J = np.empty(self.size * self.size)
        jacobian(t, _writable(z), cj, sign, J, 0, self.size, self.block)
        return J.reshape(self.size, self.size).T

    def event_functions(self, t: float, z: Array, out: Array) -> None:
        """Write the event functions less their ``levels`` into ``out``: those of the kernel of this name."""
        self._call_offsets(t)
        if self.damped and self.in_python:  # the rate of a damped stop's force takes the acceleration of the contact
            shifts, inside = self.equations.shifts, self._inside(t)
            shifts[2] = 0.0
            for i in self._called_offsets:
                offset = self.first_order.contacts[i].contact.offset
                shifts[2, i] = offset.acceleration(inside)  # type: ignore[union-attr]
            for vector, function in self._called:
                shifts[2] += self.equations.acceleration_rows @ vector * _at_one_time(function, inside)
        event_functions(t, _writable(z), out, self.block)

    def event_functions_at(self, t: Array, z: Array, out: Array) -> None:
        """Write the event functions at times t (k,) with states z (k, n) into the rows of ``out``; for functions of
        time that are all compiled."""
        event_functions_at(t, z, out, self.block)

    @property
    def levels(self) -> Array:
        """The values (roots,) at which event functions count as zero; to be written to."""
        return self.equations.levels

    def pressing(self, t: float, z: Array, k: int) -> float:
        """|F| of side k in contact."""
        i, side = self.sides[k]
        c = self.first_order.contacts[i]
        u, v = self.first_order.contact_motion(c, self._inside(t), z[: self.states])
        depth = side * (u - c.contact.stops.bound(side))
        return max(0.0, pressure(max(0.0, float(depth)), side * float(v), c.contact.stops.coefficients))

    def stored(self, t: float, z: Array) -> Array:
        """Energy (contacts,) in the stops at t, with the functions of time of the window."""
        t, y = self._inside(t), z[: self.states]
        contacts = self.first_order.contacts
        return np.array(
            [c.contact.stops.energy(self.first_order.contact_motion(c, t, y)[0]) for c in contacts], float
        ).reshape(-1)

    def jumped(self, t: float, z: Array, stored: Array) -> Array:
        """z where stops that held the energy ``stored`` jump at t: the rest of their energy is input, and those that
        damp have absorbed it."""
        gained = self.stored(t, z) - stored
        if not np.any(gained):
            return z
        z = z.copy()
        z[self.states] += np.sum(gained)
        if self.damped:
            damps = [c.contact.stops.dissipative for c in self.first_order.contacts]
            z[-1] += np.sum(gained[damps])
        return z

    @property
    def roots(self) -> int:
        """Number of event functions."""
        return (3 if self.damped else 2) * len(self.sides)

    @cached_property
    def sides(self) -> list[tuple[int, int]]:
        """(contact, +1 upper or -1 lower) of every gap."""
        return [(i, side) for i, c in enumerate(self.first_order.contacts) for side, _ in c.contact.stops.sides]

    @cached_property
    def bandwidths(self) -> tuple[int, int] | None:
        """Lower and upper bandwidth of E and df/dz, None where a banded solver does not pay."""
        lower, upper = self.first_order.bandwidths
        # With a mass the band must hold E too.
        if self.equations.mass_columns.size:
            e = self.equations
            below = np.repeat(np.arange(self.size), np.diff(e.mass_row_starts)) - e.mass_columns
            lower, upper = max(lower, int(np.max(below))), max(upper, -int(np.min(below)))
        return (lower, upper) if lower + upper + 1 < self.states // 3 else None

    def channels(self, t: Array, y: Array) -> tuple[Array, Array]:
        """Positions and velocities of the system's channels; y (k, m) at t (k,) -> (k, channels) each."""
        system: System = self.first_order.system
        q, v = y @ self.first_order.to_q.T, y @ self.first_order.to_v.T
        positions = system.positions(t, q)
        for i, c in enumerate(self.first_order.contacts):  # (3.12) carries v_M beside w
            positions[:, i] = channel_position(c.row, c.contact.offset, t, y)
        velocities = np.stack([channel_motion(row, o, t, q, v)[1] for row, o in system.channels], axis=-1)
        return positions, velocities

    def _inside(self, t: float) -> float:
        return min(max(t, float(self._window[0])), float(self._window[1]))

    def _call_offsets(self, t: float) -> None:
        """Ask the offsets that are not compiled for position and rate."""
        for i in self._called_offsets:
            offset, inside = self.first_order.contacts[i].contact.offset, self._inside(t)
            self.equations.shifts[0, i] = offset_values(offset, inside)
            self.equations.shifts[1, i] = offset_rate(offset, inside)


def _compiled_part(drive: Drive, terms: Iterable[Term], width: int) -> tuple[Array, list[Term]]:
    """Amplitudes (d + R, width) of the harmonics and records in ``terms``, and the terms that Python has to call."""
    basis, rest = drive.split(terms, width)
    # A bare callable has no amplitudes: it stays a term.
    records = [(vector, f) for vector, f in rest if isinstance(f, Sampled)]
    return np.concatenate([basis, drive.recorded(records, width)]), [
        (vector, f) for vector, f in rest if not isinstance(f, Sampled)
    ]


def _at_one_time(function: LoadFunction, t: float) -> float:
    """f(t), without what ``evaluate`` asks each time: it has been checked before."""
    value = (function.value if isinstance(function, TimeFunction) else function)(np.asarray(t))
    if np.iscomplexobj(value) or not math.isfinite(value):
        return float(evaluate(function, t))  # which says what is wrong
    return float(value)


def _sparse(matrix: Array) -> tuple[Array, Array, Array]:
    sparse = scipy.sparse.csr_matrix(matrix)
    return sparse.indptr.astype(np.int64), sparse.indices.astype(np.int64), sparse.data.astype(np.float64)


def _writable(z: Array) -> Array:
    """z, or a copy where it is read-only: for arrays of two kinds the kernels would be compiled twice."""
    return z if z.flags.writeable else z.copy()


# ---------------------------------------------------------------- in JAX: one program for each shape of systems


class Numbers(NamedTuple):
    """Arrays of ``right_hand_side_kernels.Equations`` for JAX.

    All that is linear stands in one matrix, since JAX takes longer to start a small product than to compute it.
    """

    linear: Any  # see ``linear_part``
    damping: Any
    frequencies: Any
    edges: Any
    records: Any  # (edges, R, P)
    pushes: Any
    law: Any
    regime: Any
    window: Any


class Kind(NamedTuple):
    """Constants of a compiled program beside the shapes: the exponent of every contact, and whether stops damp."""

    exponents: tuple[float, ...]
    damped: bool


def numbers_of(rhs: RightHandSide) -> tuple[Kind, Numbers]:
    """Kind and numbers of a right-hand side, its regime and window those of now.

    Raises InputError for functions of time that JAX cannot trace, and for one with a mass.
    """
    if rhs.in_python:
        rule = "be made of Harmonic, Constant and Sampled for JAX"
        raise InputError("time function", "a callable", rule, "use the adaptive solver cvode")
    e, first_order = rhs.equations, rhs.first_order
    system = first_order.system
    n, m, d = rhs.states, len(e.law), len(e.loads)
    # Columns: the state, the functions of time, their rates.
    offsets = e.offsets.T
    linear = np.zeros((n + 3 * m + d, n + 2 * d))
    rate, position, velocity, offset_rate, power = _parts(linear, n, m)
    rate[:, :n], rate[:, n : n + d] = first_order.matrix, e.loads.T
    position[:, :n], position[:, n : n + d] = e.position_rows, offsets
    velocity[:, :n], velocity[:, n + d :] = e.velocity_rows, offsets
    offset_rate[:, n + d :] = offsets
    power[:, :n] = e.power
    damping = first_order.to_v.T @ system.damping @ first_order.to_v if system.damped else np.zeros((0, n))
    records = d - 1 - 2 * len(e.frequencies)
    table = e.records.reshape(len(e.edges), records, -1) if records else np.zeros((0, 0, 0))
    kind = Kind(tuple(float(p) for p in e.law[:, 3]), rhs.damped)
    return kind, Numbers(
        linear, damping, e.frequencies, e.edges, table, e.pushes, e.law, rhs.regime.copy(), np.array(rhs.window)
    )


def _parts(rows: Any, n: int, m: int) -> tuple[Any, Any, Any, Any, Any]:
    """Split rows into those of ``Linear``, of n states and m contacts."""
    ends = n, n + m, n + 2 * m, n + 3 * m
    return rows[: ends[0]], rows[ends[0] : ends[1]], rows[ends[1] : ends[2]], rows[ends[2] : ends[3]], rows[ends[3] :]


def functions_of_time(t: Any, numbers: Numbers) -> tuple[Any, Any]:
    """1, sin w_1 t, cos w_1 t, ..., the records, (d + R,); and their rates."""
    import jax.numpy as jnp

    w = numbers.frequencies
    # Sines and cosines in the order of ``Drive.coefficients``, with their rates.
    s, c = jnp.sin(w * t), jnp.cos(w * t)
    g, rate = jnp.stack([s, c], axis=1).ravel(), jnp.stack([w * c, -w * s], axis=1).ravel()
    values = rates = jnp.zeros(numbers.records.shape[1])
    if numbers.records.size:
        edges = numbers.edges
        inside = jnp.clip(t, numbers.window[0], numbers.window[1])
        # At the end of a window the polynomial before it holds.
        before = jnp.minimum(inside, jnp.nextafter(numbers.window[1], -jnp.inf))
        k = jnp.clip(jnp.searchsorted(edges, before, side="right") - 1, 0, len(edges) - 2)
        tau = inside - edges[k]
        for j in range(numbers.records.shape[2] - 1, -1, -1):  # Horner's scheme
            rates = rates * tau + values
            values = values * tau + numbers.records[k, :, j]
    return jnp.concatenate([jnp.ones(1), g, values]), jnp.concatenate([jnp.zeros(1), rate, rates])


class Linear(NamedTuple):
    """Rows of the right-hand side that are linear in the state, the functions of time and their rates."""

    rate: Any  # (n,), of the state without contact forces
    positions: Any  # (m,), of the contacts
    velocities: Any
    offset_rates: Any
    power: Any  # of the loads, in the functions of time too


def linear_part(t: Any, y: Any, numbers: Numbers) -> Linear:
    """The linear part at t and y (n,), by one product of a matrix."""
    import jax.numpy as jnp

    g, g_rate = functions_of_time(t, numbers)
    rows = numbers.linear @ jnp.concatenate([y, g, g_rate])
    parts = Linear(*_parts(rows, len(y), len(numbers.law)))
    return parts._replace(power=g @ parts.power)


def contact_forces(kind: Kind, linear: Linear, numbers: Numbers) -> list[Any]:
    """Forces of the contacts."""
    import jax.numpy as jnp

    forces = []
    for c, p in enumerate(kind.exponents):
        stop: Any = Law(*numbers.law[c])._replace(p=p)  # the exponent is a constant of the program
        force: Any = 0.0
        # The regime is data, not structure: one compiled program computes both sides and selects.
        for side in (1, -1):
            bound = stop.g2 if side > 0 else stop.g1
            # A side without a stop counts as open, its infinite bound outside the arithmetic.
            there = jnp.isfinite(bound)
            depth = jnp.where(there, side * (linear.positions[c] - jnp.where(there, bound, 0.0)), -1.0)
            rate = side * linear.velocities[c]
            by_law = jnp.where(depth > 0.0, jnp.maximum(0.0, pressure(depth, rate, stop)), 0.0)
            closed = jnp.where(numbers.regime[c] == side, pressure(depth, rate, stop), 0.0)
            force = force - side * jnp.where(numbers.regime[c] == THROUGH, by_law, closed)
        forces.append(force)
    return forces


def rate_of_state(kind: Kind, t: Any, y: Any, numbers: Numbers) -> Any:
    """y' (n,)."""
    linear = linear_part(t, y, numbers)
    forces = contact_forces(kind, linear, numbers)
    return linear.rate + sum(push * force for push, force in zip(numbers.pushes, forces, strict=True))


def rate_with_integrals(kind: Kind, t: Any, z: Any, numbers: Numbers) -> Any:
    """z' of ``RightHandSide``: y' with the rates of the ledger's integrals."""
    import jax.numpy as jnp

    y = z[: numbers.pushes.shape[1]]
    linear = linear_part(t, y, numbers)
    forces = contact_forces(kind, linear, numbers)
    rate, given, absorbed = linear.rate, linear.power, 0.0
    for c, force in enumerate(forces):
        rate = rate + numbers.pushes[c] * force
        given = given - force * linear.offset_rates[c]
        absorbed = absorbed - jnp.where(damps(Law(*numbers.law[c])), force * linear.velocities[c], 0.0)
    viscous = y @ numbers.damping @ y if numbers.damping.shape[0] else 0.0 * given
    integrals = [given, viscous, *(-force for force in forces), *([absorbed] if kind.damped else [])]
    return jnp.concatenate([rate, jnp.stack(integrals)])
