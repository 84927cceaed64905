"""The semi-discrete system that every scheme and every solver integrates."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array
from .contact import Contact
from .first_order import FirstOrderSystem, interleaved
from .time_functions import Constant, Harmonic, LoadFunction, TimeFunction, evaluate, offset_values
from .validation import InputError

if TYPE_CHECKING:
    from .problem import BeamProblem


_PROCESS, _CALLABLES = uuid4().hex, {}


@dataclass(frozen=True, eq=False, kw_only=True)
class System:
    """M q'' + C q' + K q = sum_k p_k f_k(t) + sum_c row_c^T F_c(row_c q + o_c(t)),  n unknowns.

    mass, damping, stiffness: (n, n), symmetric; M positive definite, C and K positive semidefinite.
    loads: pairs (p_k of shape (n,), f_k). contacts: where the stops act. observe: the row of ``tip``,
    None for the position of the first contact. q0, v0: (n,) initial data. stiffness_factor: G with
    G^T G = K where one is known, from which frequencies lose eps w_max/w_1 rather than its square.
    Make one with ``semidiscretise`` or ``System.from_matrices``.
    """

    mass: Array
    damping: Array
    stiffness: Array
    loads: tuple[tuple[Array, LoadFunction], ...] = ()
    contacts: tuple[Contact, ...] = ()
    observe: Array | None = None
    q0: Array
    v0: Array
    stiffness_factor: Array | None = None
    form: str = "matrices"
    problem: BeamProblem | None = None
    build_first_order: Callable[[System], FirstOrderSystem] | None = field(default=None, repr=False)

    @classmethod
    def from_matrices(
        cls,
        mass: Any,
        stiffness: Any,
        damping: Any = None,
        loads: Sequence[tuple[ArrayLike, LoadFunction]] = (),
        contacts: Sequence[Contact] = (),
        observe: ArrayLike | None = None,
        initial_displacement: ArrayLike | None = None,
        initial_velocity: ArrayLike | None = None,
    ) -> System:
        """Anyone's finite-element model: dense or SciPy sparse matrices, any contact row.

        Raises InputError naming what is wrong: shape, symmetry, definiteness.
        """
        mass = _symmetric("mass", mass)
        n = len(mass)
        stiffness = _symmetric("stiffness", stiffness, n)
        damping = np.zeros((n, n)) if damping is None else _symmetric("damping", damping, n)
        try:
            np.linalg.cholesky(mass)
        except np.linalg.LinAlgError:
            least = float(np.linalg.eigvalsh(mass)[0])
            remedy = "condense unknowns without mass out of the model first"
            raise InputError("mass", f"least eigenvalue {least:.3g}", "be positive definite", remedy) from None
        for name, matrix in (("stiffness", stiffness), ("damping", damping)):
            spectrum = np.linalg.eigvalsh(matrix)
            if spectrum[0] < -1e-10 * max(abs(spectrum[-1]), 1e-300):
                raise InputError(name, f"least eigenvalue {spectrum[0]:.3g}", "be positive semidefinite")
        contacts = (contacts,) if isinstance(contacts, Contact) else tuple(contacts)
        for contact in contacts:
            if not isinstance(contact, Contact):
                raise InputError("contacts", contact, "hold Contact(row, stops) only")
            if contact.row.shape != (n,):
                raise InputError("contact.row", contact.row.shape, f"have shape ({n},)")
        for load in loads:
            if not isinstance(load, (tuple, list)) or len(load) != 2:
                raise InputError("loads", load, "hold pairs (vector, time function)")
            if not isinstance(load[1], TimeFunction) and not callable(load[1]):
                raise InputError("loads", load[1], "pair a vector with a Harmonic, a Constant or a function of time")
        if observe is None and not contacts:
            raise InputError("observe", None, "name the row of .tip where there is no contact", "pass observe=row")
        return cls(
            mass=mass,
            damping=damping,
            stiffness=stiffness,
            loads=tuple((_vector("loads", vector, n), function) for vector, function in loads),
            contacts=contacts,
            observe=None if observe is None else _vector("observe", observe, n),
            q0=np.zeros(n)
            if initial_displacement is None
            else _vector("initial_displacement", initial_displacement, n),
            v0=np.zeros(n) if initial_velocity is None else _vector("initial_velocity", initial_velocity, n),
        )

    def __repr__(self) -> str:
        return f"<System, {self.form}: {self.size} unknowns, {len(self.loads)} loads, {len(self.contacts)} contacts>"

    @property
    def size(self) -> int:
        """n, the number of unknowns."""
        return len(self.mass)

    @property
    def damped(self) -> bool:
        return bool(np.any(self.damping))

    @cached_property
    def channels(self) -> tuple[tuple[Array, LoadFunction | None], ...]:
        """The observed positions (row, offset): one per contact, then the tip where it is another row."""
        rows = tuple((contact.row, contact.offset) for contact in self.contacts)
        return rows if self.observe is None else (*rows, (self.observe, None))

    @property
    def tip_channel(self) -> int:
        """The index in ``channels`` of the tip."""
        return 0 if self.observe is None else len(self.contacts)

    def load(self, t: ArrayLike) -> Array:
        """sum_k p_k f_k(t); shape t.shape + (n,)."""
        t = np.asarray(t, float)
        total = np.zeros((*t.shape, self.size))
        for vector, function in self.loads:
            total += evaluate(function, t)[..., None] * vector
        return total

    def positions(self, t: ArrayLike, q: Array) -> Array:
        """row q + o(t) of every channel; q of shape t.shape + (n,) gives t.shape + (channels,)."""
        return np.stack([q @ row + offset_values(offset, t) for row, offset in self.channels], axis=-1)

    def contact_energy(self, t: ArrayLike, q: Array) -> Array:
        """sum_c U_c(row_c q + o_c(t))."""
        total = np.zeros(np.shape(t))
        for contact in self.contacts:
            total = total + contact.stops.energy(q @ contact.row + offset_values(contact.offset, t))
        return total

    def energies(self, t: ArrayLike, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """(1/2 q'^T M q', 1/2 q^T K q, sum_c U_c), each t.shape; q, v of shape t.shape + (n,)."""
        kinetic = 0.5 * np.sum(v * (v @ self.mass), axis=-1)
        strain = q @ self.stiffness_factor.T if self.stiffness_factor is not None else None
        elastic = np.sum(strain**2, axis=-1) if strain is not None else np.sum(q * (q @ self.stiffness), axis=-1)
        return kinetic, 0.5 * elastic, self.contact_energy(t, q)

    def energy(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """E, the sum of ``energies``."""
        return sum(self.energies(t, q, v), np.zeros(np.shape(t)))

    def first_order(self) -> FirstOrderSystem:
        """y' = A y + ...: the paper's (v_1, v_1', ..., v_M, v_M') (3.5) or (w, s, v_M) (3.12)."""
        build = self.build_first_order or interleaved
        return build(self)

    def descriptor(self) -> tuple[Array, FirstOrderSystem]:
        """(E, right) with E y' = right(t, y), y = (q_1, q_1', ..., q_n, q_n'), no mass inverted.

        E is (2n, 2n): the identity on the positions, M on the velocities.
        """
        n = self.size
        q, v = slice(0, 2 * n, 2), slice(1, 2 * n, 2)
        E = np.zeros((2 * n, 2 * n))
        E[q, q], E[v, v] = np.eye(n), self.mass
        return E, interleaved(self, inverse=lambda x: x)

    def rhs(self, t: float, y: Array) -> Array:
        """The method-of-lines right-hand side in first-order form."""
        return self._first_order.rhs(t, y)

    def jacobian(self, t: float, y: Array) -> Array:
        """d rhs/dy, (m, m)."""
        return self._first_order.jacobian(t, y)

    @cached_property
    def _first_order(self) -> FirstOrderSystem:
        return self.first_order()

    def displacement(self, t: ArrayLike, q: Array, x: ArrayLike) -> Array:
        """u(x, t) of a beam by a cubic spline through the nodes; t (m,), q (m, n), x (...) -> (m, ...)."""
        from .semidiscretisation import beam_displacement

        return beam_displacement(self, np.asarray(t, float), q, x)

    @cached_property
    def fingerprint(self) -> str:
        """A hash of everything that determines the solution; equal for equal systems in any process.

        A bare callable cannot be hashed by content: it counts as equal to itself only, in this process.
        """
        digest = hashlib.sha256(self.form.encode())
        for array in (self.mass, self.damping, self.stiffness, self.q0, self.v0, self.observe):
            digest.update(b"none" if array is None else np.ascontiguousarray(array).tobytes())
        for vector, function in self.loads:
            digest.update(vector.tobytes() + _describe(function).encode())
        for contact in self.contacts:
            digest.update(contact.row.tobytes() + repr(contact.stops).encode() + _describe(contact.offset).encode())
        return digest.hexdigest()


def _describe(function: LoadFunction | None) -> str:
    if function is None or isinstance(function, (Harmonic, Constant)):
        return repr(function)
    _CALLABLES[id(function)] = function  # kept, so that no other one is ever given its number
    return f"callable {_PROCESS} {id(function)}"


def _symmetric(name: str, matrix: Any, n: int | None = None) -> Array:
    given = np.asarray(matrix.toarray() if hasattr(matrix, "toarray") else matrix)
    if not np.isrealobj(given):
        raise InputError(name, f"a matrix of {given.dtype}", "be real")
    dense = np.array(given, float)
    if dense.ndim != 2 or dense.shape[0] != dense.shape[1] or (n is not None and len(dense) != n):
        raise InputError(name, dense.shape, "be a square matrix" if n is None else f"have shape ({n}, {n})")
    if not np.all(np.isfinite(dense)):
        raise InputError(name, "an entry that is not finite", "be finite")
    if np.max(np.abs(dense - dense.T), initial=0.0) > 1e-12 * np.max(np.abs(dense), initial=0.0):
        raise InputError(name, "an unsymmetric matrix", "be symmetric to 1e-12")
    return 0.5 * (dense + dense.T)


def _vector(name: str, vector: ArrayLike, n: int) -> Array:
    array = np.array(vector, float).ravel()
    if array.shape != (n,) or not np.all(np.isfinite(array)):
        raise InputError(name, array.shape, f"be {n} finite numbers")
    return array
