"""The method-of-lines right-hand side and its Jacobian, compiled, as SUNDIALS and SciPy call them."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from ..arrays import Array
from ..compiled import compiled
from ..drive import Drive
from ..first_order import FirstOrderSystem
from ..system import System
from ..time_functions import Constant, Harmonic, evaluate, offset_rate, offset_values


class RightHandSide:
    """y' = f(t, y) of a FirstOrderSystem. Harmonic and constant functions are compiled in; a bare
    callable is called once per evaluation."""

    def __init__(self, first_order: FirstOrderSystem) -> None:
        system = first_order.system
        self.first_order = first_order
        self.size = len(first_order.y0)
        self.drive = Drive.of(system)
        matrix = scipy.sparse.csr_matrix(first_order.matrix)
        basis, self._rest = self.drive.split(first_order.loads, self.size)
        contacts = first_order.contacts
        m = len(contacts)
        offsets, offsets_rest = np.zeros((self.drive.size, m)), []
        for i, c in enumerate(contacts):
            offset = c.contact.offset
            if isinstance(offset, (Harmonic, Constant)):
                offsets[:, i : i + 1], _ = self.drive.split([(np.ones(1), offset)], 1)
            elif offset is not None:
                offsets_rest.append(i)
        self._offsets_rest = offsets_rest
        self._shifts = np.zeros(m)
        self._args = (
            matrix.indptr.astype(np.int64),
            matrix.indices.astype(np.int64),
            matrix.data.astype(np.float64),
            np.array(self.drive.frequencies, float),
            basis,
            np.array([c.row for c in contacts]).reshape(m, self.size),
            np.array([c.column for c in contacts]).reshape(m, self.size),
            offsets,
            np.array([c.contact.stops.stiffness for c in contacts]),
            np.array([c.contact.stops.g1 for c in contacts]),
            np.array([c.contact.stops.g2 for c in contacts]),
        )
        self(0.0, first_order.y0.copy(), np.empty(self.size))

    def shifts(self, t: float) -> Array:
        """The part of the offsets that is not compiled in, (m,)."""
        for i in self._offsets_rest:
            self._shifts[i] = offset_values(self.first_order.contacts[i].contact.offset, t)
        return self._shifts

    def __call__(self, t: float, y: Array, out: Array) -> None:
        """Write f(t, y) into ``out``."""
        _rhs(t, y, out, *self._args, self.shifts(t))
        for vector, function in self._rest:
            out += vector * evaluate(function, t)

    def value(self, t: float, y: Array) -> Array:
        """f(t, y)."""
        out = np.empty(self.size)
        self(t, y, out)
        return out

    def jacobian(self, t: float, y: Array) -> Array:
        """df/dy, (m, m)."""
        return self.first_order.jacobian(t, y)

    def gaps(self, t: float, y: Array, out: Array) -> None:
        """Write u - g2 and g1 - u of every contact side that has a stop: each rises through 0 at an impact."""
        _gaps(t, y, out, *self._args[3:4], *self._args[5:6], *self._args[7:8], *self._args[9:], self.shifts(t))

    @property
    def sides(self) -> list[tuple[int, int]]:
        """(contact, +1 upper or -1 lower) of every entry of ``gaps``."""
        sides = []
        for i, c in enumerate(self.first_order.contacts):
            sides += [(i, 1)] if np.isfinite(c.contact.stops.g2) else []
            sides += [(i, -1)] if np.isfinite(c.contact.stops.g1) else []
        return sides

    @property
    def banded(self) -> bool:
        """Whether a banded solver pays."""
        return sum(self.first_order.bandwidths) + 1 < self.size // 3

    def channels(self, t: Array, y: Array) -> tuple[Array, Array]:
        """Positions and velocities of the system's channels; y (k, m) at t (k,) -> (k, channels) each."""
        system: System = self.first_order.system
        q, v = y @ self.first_order.to_q.T, y @ self.first_order.to_v.T
        positions = system.positions(t, q)
        for i, c in enumerate(self.first_order.contacts):  # (3.12) carries v_M beside w
            positions[:, i] = y @ c.row + offset_values(c.contact.offset, t)
        velocities = np.stack([v @ row + offset_rate(o, t) for row, o in system.channels], axis=-1)
        return positions, velocities


@compiled
def _rhs(t, y, out, indptr, indices, data, frequencies, basis, rows, columns, offsets, kappa, g1, g2, shifts):
    n = y.size
    for i in range(n):
        total = basis[0, i]
        for k in range(indptr[i], indptr[i + 1]):
            total += data[k] * y[indices[k]]
        out[i] = total
    g = np.empty(1 + 2 * frequencies.size)
    g[0] = 1.0
    for k in range(frequencies.size):
        g[1 + 2 * k] = np.sin(frequencies[k] * t)
        g[2 + 2 * k] = np.cos(frequencies[k] * t)
        for i in range(n):
            out[i] += basis[1 + 2 * k, i] * g[1 + 2 * k] + basis[2 + 2 * k, i] * g[2 + 2 * k]
    for c in range(kappa.size):
        u = shifts[c]
        for k in range(g.size):
            u += offsets[k, c] * g[k]
        for i in range(n):
            u += rows[c, i] * y[i]
        if u > g2[c] or u < g1[c]:
            force = kappa[c] * (min(max(u, g1[c]), g2[c]) - u)
            for i in range(n):
                out[i] += columns[c, i] * force


@compiled
def _gaps(t, y, out, frequencies, rows, offsets, g1, g2, shifts):
    k = 0
    for c in range(g1.size):
        u = shifts[c] + offsets[0, c]
        for f in range(frequencies.size):
            u += offsets[1 + 2 * f, c] * np.sin(frequencies[f] * t) + offsets[2 + 2 * f, c] * np.cos(frequencies[f] * t)
        for i in range(y.size):
            u += rows[c, i] * y[i]
        if np.isfinite(g2[c]):
            out[k] = u - g2[c]
            k += 1
        if np.isfinite(g1[c]):
            out[k] = g1[c] - u
            k += 1
