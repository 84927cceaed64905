"""The method-of-lines right-hand side and its Jacobian, compiled, as SUNDIALS and SciPy call them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.sparse

from ...basics.arrays import Array
from ...model.contact import laws
from ...model.contact_law import pressure, pull, side_slopes, slopes
from ...model.drive import Drive
from ...model.first_order import FirstOrderSystem
from ...model.system import System
from ...model.time_functions import LoadFunction, TimeFunction, evaluate, offset_rate, offset_values
from .kernels import gaps, right_hand_side

THROUGH = 2  # a contact that follows its law, both sides of its switches


class RightHandSide:
    """z' = f(t, z) of a FirstOrderSystem, z = (y, input, viscous, impulse of every contact).

    Given a ``mass`` E (m, m), E y' = f(t, y): ``System.descriptor``.

        input'   = sum_k f_k p_k^T q' - sum_c F_c o_c',   viscous' = q'^T C q',   impulse_c' = -F_c

    integrate with the motion what nobody could add up from its outputs. The impulse has a sign, > 0 on the upper
    stop: -F is as smooth as the motion, |F| would have a kink of its own where a narrow gap is crossed. Where a
    stop damps there is one more, absorbed' = -sum_c F_c u_c' of those that do: stored and dissipated together, which is
    as smooth as the motion too. ``regime`` (contacts,) is chi of every contact, in which the force is smooth on both
    sides of its switches, or THROUGH for the law itself. ``lengths`` (contacts,): of the contacts' motion, by which
    the switch function of a damped stop is made a length.
    Harmonic and constant functions are compiled in; a bare callable is called once per evaluation, at
    times inside ``window`` only.
    """

    def __init__(self, first_order: FirstOrderSystem, mass: Array | None = None) -> None:
        system = first_order.system
        self.first_order = first_order
        self.states = len(first_order.y0)
        self._mass = None if mass is None else scipy.linalg.lu_factor(mass)
        contacts = first_order.contacts
        m = len(contacts)
        self.damped = any(c.contact.stops.dissipative for c in contacts)
        self.size = self.states + 2 + m + self.damped
        self.z0 = np.concatenate([first_order.y0, np.zeros(2 + m + self.damped)])
        self.lengths = np.ones(m)
        self.signed = True  # whether the impulses have a sign; those of a solver without roots have none
        self.regime = np.full(m, THROUGH, np.int64)
        self.window = (-math.inf, math.inf)
        self.drive = Drive.of(system)
        basis, rest = self.drive.split(first_order.loads, self.states)
        self._rest = [(vector, _at_one_time(function)) for vector, function in rest]
        powers = [(first_order.to_v.T @ p, f) for p, f in system.loads]
        power, rest_power = self.drive.split(powers, self.states)
        self._power_rows = [row for row, _ in rest_power]
        offsets = np.zeros((self.drive.size, m))
        self._offsets_rest = []
        for i, c in enumerate(contacts):
            known, sampled = self.drive.split([] if c.contact.offset is None else [(np.ones(1), c.contact.offset)], 1)
            if sampled:
                self._offsets_rest.append(i)
            else:
                offsets[:, i : i + 1] = known
        self._shifts, self._shift_rates, self._shift_accelerations = np.zeros((3, m))
        self._offset_accelerations = self.drive.derivative().T @ self.drive.derivative().T @ offsets
        damping = first_order.to_v.T @ system.damping @ first_order.to_v if system.damped else np.zeros((0, 0))
        self._contacts = (
            np.array(self.drive.frequencies, float),
            np.array([c.row for c in contacts]).reshape(m, self.states),
            np.array([first_order.to_v.T @ c.contact.row for c in contacts]).reshape(m, self.states),
            offsets,
            self.drive.derivative().T @ offsets,
            laws(system.contacts),
        )
        self._system = (
            *_sparse(first_order.matrix),
            *_sparse(damping),
            basis,
            power,
            np.array([c.column for c in contacts]).reshape(m, self.states),
        )
        self(0.0, self.z0.copy(), np.empty(self.size))

    def __call__(self, t: float, z: Array, out: Array) -> None:
        """Write f(t, z) into ``out``."""
        shifts, shift_rates = self._offsets(t)
        right_hand_side(
            t, _fixed(z), out, self.states, *self._system, *self._contacts, self.regime, shifts, shift_rates
        )
        if self._rest:
            t = self._inside(t)
            y, n = z[: self.states], self.states
            for (vector, function), row in zip(self._rest, self._power_rows, strict=True):
                value = function(t)
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

    def jacobian(self, t: float, z: Array) -> Array:
        """df/dz, (size, size), without the rows of the integrals: they act on nothing."""
        jacobian, y, n = np.zeros((self.size, self.size)), z[: self.states], self.states
        jacobian[:n, :n] = self.first_order.matrix
        for i, c in enumerate(self.first_order.contacts):
            if self.regime[i] == 0:
                continue
            u, v = (float(x) for x in self.first_order.contact_motion(c, self._inside(t), y))
            chi = self.regime[i] if self.regime[i] != THROUGH else int(c.contact.stops.state(u, v))
            slope, to_rate = side_slopes(u, v, chi, c.contact.stops.coefficients)
            if slope:
                jacobian[:n, :n] -= slope * np.outer(c.column, c.row)
            if to_rate:
                jacobian[:n, :n] -= to_rate * np.outer(c.column, self.first_order.velocity_row(c))
        return jacobian

    def gaps(self, t: float, z: Array, out: Array) -> None:
        """Write u - g2 or g1 - u of every side, > 0 in the stop, then the rates of all of them.

        Of a damped stop, instead of its gap, what is > 0 where it presses: the lesser of gap and force, as a length.
        With one among the stops a third row follows: the rates of the forces of the damped ones, else of the gaps.
        """
        shifts = self._offsets(t)
        if not self.damped:
            gaps(t, _fixed(z), out, self.states, *self._contacts, *shifts)
            return
        half = len(self.sides)
        gaps(t, _fixed(z), out[: 2 * half], self.states, *self._contacts, *shifts)
        z_rate = self.rate(t, z)
        for k, (i, side) in enumerate(self.sides):
            rate, stops = out[half + k], self.first_order.contacts[i].contact.stops
            out[2 * half + k] = rate
            if not stops.dissipative:
                continue
            law, d = stops.coefficients, out[k]
            acceleration = side * (self._contacts[2][i] @ z_rate[: self.states] + self._offset_acceleration(t, i))
            slope, to_rate = slopes(d, rate, law)
            out[2 * half + k] = slope * rate + to_rate * acceleration
            out[k] = min(d, pull(d, rate, self.lengths[i], law))

    def pressing(self, t: float, z: Array, k: int) -> float:
        """|F| of side k in contact."""
        i, side = self.sides[k]
        c = self.first_order.contacts[i]
        u, v = self.first_order.contact_motion(c, self._inside(t), z[: self.states])
        depth = side * (u - (c.contact.stops.g2 if side > 0 else c.contact.stops.g1))
        return max(0.0, pressure(max(0.0, float(depth)), side * float(v), c.contact.stops.coefficients))

    @property
    def roots(self) -> int:
        """How many numbers ``gaps`` writes."""
        return (3 if self.damped else 2) * len(self.sides)

    def _offset_acceleration(self, t: float, i: int) -> float:
        offset = self.first_order.contacts[i].contact.offset
        return 0.0 if offset is None else float(offset.acceleration(self._inside(t)))  # type: ignore[union-attr]

    @cached_property
    def sides(self) -> list[tuple[int, int]]:
        """(contact, +1 upper or -1 lower) of every gap."""
        sides = []
        for i, c in enumerate(self.first_order.contacts):
            sides += [(i, 1)] if np.isfinite(c.contact.stops.g2) else []
            sides += [(i, -1)] if np.isfinite(c.contact.stops.g1) else []
        return sides

    @property
    def banded(self) -> bool:
        """Whether a banded solver pays."""
        return sum(self.first_order.bandwidths) + 1 < self.states // 3

    def channels(self, t: Array, y: Array) -> tuple[Array, Array]:
        """Positions and velocities of the system's channels; y (k, m) at t (k,) -> (k, channels) each."""
        system: System = self.first_order.system
        q, v = y @ self.first_order.to_q.T, y @ self.first_order.to_v.T
        positions = system.positions(t, q)
        for i, c in enumerate(self.first_order.contacts):  # (3.12) carries v_M beside w
            positions[:, i] = y @ c.row + offset_values(c.contact.offset, t)
        velocities = np.stack([v @ row + offset_rate(o, t) for row, o in system.channels], axis=-1)
        return positions, velocities

    def _inside(self, t: float) -> float:
        return min(max(t, self.window[0]), self.window[1])

    def _offsets(self, t: float) -> tuple[Array, Array]:
        """The part of the offsets and their rates that is not compiled in, (m,) each."""
        for i in self._offsets_rest:
            offset, inside = self.first_order.contacts[i].contact.offset, self._inside(t)
            self._shifts[i] = offset_values(offset, inside)
            self._shift_rates[i] = offset_rate(offset, inside)
        return self._shifts, self._shift_rates


def _at_one_time(function: LoadFunction) -> Callable[[float], float]:
    """f(t) as a float, without what ``evaluate`` asks each time: it has been asked where the loads were scanned."""
    values = function.value if isinstance(function, TimeFunction) else function

    def value(t: float) -> float:
        found = float(values(np.asarray(t)))
        return found if math.isfinite(found) else float(evaluate(function, t))  # which says what is wrong

    return value


def _sparse(matrix: Array) -> tuple[Array, Array, Array]:
    sparse = scipy.sparse.csr_matrix(matrix)
    return sparse.indptr.astype(np.int64), sparse.indices.astype(np.int64), sparse.data.astype(np.float64)


def _fixed(z: Array) -> Array:
    """z as SUNDIALS hands states over, read-only: for arrays of another kind the kernels would be compiled again."""
    if z.flags.writeable:
        z = z.view()
        z.setflags(write=False)
    return z
