"""The semi-discrete system that every scheme and every solver integrates, its checks and its origin."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypedDict, Unpack
from weakref import WeakValueDictionary

import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike

from ..basics.arrays import Array, read_only, same
from ..basics.resources import afford
from ..basics.text import Units, several
from ..basics.validation import (
    Frozen,
    InputError,
    constants,
    exact_parts,
    instance,
    sequence,
    units_labels,
    vector,
)
from .beam import beam_field
from .contact import Contact, channel_motion, channel_position
from .problem import BeamProblem
from .time_functions import Drive, LoadFunction, TimeFunction, description, evaluate, parts, time_function

if TYPE_CHECKING:
    from .right_hand_side import ODE


_CHECKED: WeakValueDictionary[tuple[str, int], Array] = WeakValueDictionary()  # read-only matrices once looked at


def checked_matrix(name: str, matrix: Any, n: int | None = None) -> Array:
    """``matrix`` as a read-only float array (n, n), symmetric to the bit where it is so to rounding. InputError where
    it is not square, finite, symmetric and semidefinite, the mass definite; the damping need not be the last two."""
    # ``is`` guards against an id that is used again.
    if isinstance(matrix, np.ndarray) and _CHECKED.get((name, id(matrix))) is matrix and n in (None, len(matrix)):
        return matrix
    remedy = "give a list of rows, a NumPy array or a SciPy sparse matrix"
    full: Any = matrix
    if scipy.sparse.issparse(matrix):
        afford(name, f"shape {full.shape}", "condense the model", floats=float(np.prod(full.shape, dtype=float)))
        full = full.toarray()
    dense = constants(name, full, "be a matrix of finite numbers", remedy)
    if name == "mass" and dense.ndim == 1:
        dense = read_only(np.diag(dense))
    if dense.ndim != 2 or dense.shape[0] != dense.shape[1] or (n is not None and len(dense) != n) or not dense.size:
        rule = "be a square matrix" if n is None else f"have shape ({n}, {n})"
        raise InputError(name, f"shape {dense.shape}", rule, "one row and one column per unknown")
    if not np.array_equal(dense, dense.T):
        error = asymmetry(name, dense)
        if error is None:
            dense = read_only(0.5 * (dense + dense.T))
        elif name != "damping":
            raise error
    if name == "mass":
        try:
            np.linalg.cholesky(dense)
        except np.linalg.LinAlgError:
            least = np.linalg.eigvalsh(dense)[0]
            remedy = "condense unknowns without mass out: stiffbeam.reduce_model, in a case file modes = 40"
            raise InputError(name, f"least eigenvalue {least:.3g}", "be positive definite", remedy) from None
    elif name == "stiffness" and (least := _least(dense)) < -1e-10:
        rule, remedy = "be positive semidefinite", "look at its signs"
        raise InputError(name, f"least eigenvalue {least:.3g}, its diagonal scaled to ones", rule, remedy)
    _CHECKED[name, id(dense)] = dense
    return dense


def asymmetry(name: str, matrix: Any) -> InputError | None:
    """Error for a matrix, dense or sparse, that is not symmetric to rounding. Of a half, as FE programs write it,
    0.5*(A + A.T) is wrong."""
    size, apart = np.sqrt(np.abs(matrix.diagonal())), scipy.sparse.coo_array(matrix - matrix.T)
    if np.all(np.abs(apart.data) <= 1e-12 * size[apart.row] * size[apart.col]):
        return None
    half = any(part(matrix, k).count_nonzero() == 0 for part, k in ((scipy.sparse.triu, 1), (scipy.sparse.tril, -1)))
    found = "one half of a matrix" if half else "an unsymmetric matrix"
    remedy = "both halves: A + A.T without A's diagonal once" if half else "the symmetric part 0.5*(A + A.T)"
    return InputError(name, found, "be symmetric to 1e-12 of its diagonal", f"give {remedy}")


def _least(matrix: Array) -> float:
    """The least eigenvalue with the diagonal scaled to ones. Scaling keeps its sign, and stiff parts cannot hide soft
    ones."""
    size = np.sqrt(np.abs(np.diag(matrix)))
    size = np.where(size > 0.0, size, 1.0)
    return float(np.linalg.eigvalsh(matrix / size / size[:, None])[0])


def contacts_of(contacts: Any, n: int) -> tuple[Contact, ...]:
    """``contacts`` as a tuple; InputError where one is no Contact on n unknowns."""
    rule, remedy = "hold Contact(row, stops) only", "for none write ()"
    checked = [contacts] if isinstance(contacts, Contact) else sequence("contacts", contacts, rule, remedy)
    for contact in checked:
        instance("contacts", contact, Contact, remedy, rule)
        if len(contact.row) != n:
            raise InputError("contact.row", contact.row, f"hold {n} numbers", "one per unknown")
    return tuple(checked)


def loads_of(loads: Any, n: int) -> tuple[tuple[Array, LoadFunction], ...]:
    """``loads`` as pairs of a read-only vector (n,) and a time function; InputError where one is none."""
    checked, rule = [], "hold pairs (vector, time function)"
    for load in sequence("loads", loads, rule, "for none write ()"):
        if not isinstance(load, (tuple, list)) or len(load) != 2:
            raise InputError("loads", load, rule, "for example ([0, 0, 1], Constant(1.0))")
        if not np.any(row := vector("loads", load[0], n)):
            raise InputError("loads", row, "not be all zero", "leave out a load that moves nothing")
        checked.append((row, time_function("loads", load[1])))
    return tuple(checked)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Origin(Frozen):
    """A beam, its discretisation, and the system that they give.

    cells: of the grid. stiffness_factor: G with G^T G = stiffness. made: the system, with one contact per stops of the
    problem, in order.
    """

    problem: BeamProblem
    form: str
    cells: int
    stiffness_factor: Array
    made: System


class ModelData(TypedDict, total=False):
    """Other keywords of a model of matrices."""

    observe: ArrayLike | None
    initial_displacement: ArrayLike | None
    initial_velocity: ArrayLike | None
    units: Units


@dataclass(frozen=True, eq=False, kw_only=True)
class System(Frozen):
    """M q'' + C q' + K q = sum_k p_k f_k(t) + sum_c row_c^T F_c(row_c q + o_c(t)),  n unknowns.

    Make a system with ``semidiscretise`` or ``System.from_matrices``, and a changed one with ``dataclasses.replace``.
    With another mass, damping or stiffness it is no longer that of a beam. All arrays are checked and copied; the
    copies are read-only.

    Parameters
    ----------
    mass, damping, stiffness : array (n, n)
        M and K symmetric, M positive definite, K positive semidefinite. C is any square matrix: with gyroscopic terms,
        as of a rotor, it is not symmetric.
    loads : sequence of (array (n,), time function)
        Pairs (p_k, f_k).
    contacts : sequence of Contact
        Where stops act.
    observe : array (n,), optional
        The row of ``tip``; by default ``tip`` is the position of the first contact.
    q0, v0 : array (n,)
        Initial displacements and velocities.
    origin : Origin, optional
        The beam and grid that the matrices came from.
    units : tuple, optional
        Names of the units of length, time and force, such as ("mm", "s", "N"); by default those of the beam.

    Raises
    ------
    InputError
        For a wrong shape, a mass or stiffness that is not symmetric or not definite, and for a subclass.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> stops = sb.Stops(upper=0.1, stiffness=1e4)
    >>> sb.System.from_matrices([[1.0]], [[4.0]], contacts=[sb.Contact([1.0], stops)], initial_velocity=[1.0])
    <System, matrices: 1 unknown, 0 loads, 1 contact>
    """

    mass: Array
    damping: Array
    stiffness: Array
    loads: tuple[tuple[Array, LoadFunction], ...] = ()
    contacts: tuple[Contact, ...] = ()
    observe: Array | None = None
    q0: Array
    v0: Array
    origin: Origin | None = field(default=None, repr=False)
    units: Units = ()

    def __post_init__(self) -> None:
        mass = checked_matrix("mass", self.mass)
        n = len(mass)
        damping, stiffness = (checked_matrix(x, getattr(self, x), n) for x in ("damping", "stiffness"))
        contacts, loads = contacts_of(self.contacts, n), loads_of(self.loads, n)
        observe = None if self.observe is None else vector("observe", self.observe, n)
        if observe is None and not contacts:
            rule = "name the row of .tip where there is no contact"
            raise InputError("observe", None, rule, "pass observe=row, a one at the unknown to be seen")
        if observe is not None and not np.any(observe):
            raise InputError("observe", observe, "not be all zero", "a one at the unknown to be seen")
        # The checked copies take the place of the arguments.
        vars(self).update(
            mass=mass, damping=damping, stiffness=stiffness, loads=loads, contacts=contacts, observe=observe,
            q0=vector("initial_displacement", self.q0, n), v0=vector("initial_velocity", self.v0, n),
            units=units_labels(self.units),
        )  # fmt: skip
        if not self.keeps("mass", "damping", "stiffness"):
            vars(self)["origin"] = None

    def __getstate__(self) -> dict[str, Any]:
        """The fields; and the fingerprint, by which a copy in another process is known to be equal."""
        return super().__getstate__() | {"fingerprint": self.fingerprint}

    @classmethod
    def from_matrices(
        cls,
        mass: Any,
        stiffness: Any,
        damping: Any = None,
        loads: Sequence[tuple[ArrayLike, LoadFunction]] = (),
        contacts: Sequence[Contact] = (),
        **data: Unpack[ModelData],
    ) -> System:
        """System of any finite-element model: dense or SciPy sparse matrices, a vector for a diagonal mass.

        data: observe and units as in the class; initial_displacement and initial_velocity, by default at rest at zero.
        Raises InputError as the class does.
        """
        matrix = checked_matrix("mass", mass)
        start = {"q0": data.pop("initial_displacement", None), "v0": data.pop("initial_velocity", None)}
        options: Any = {name: np.zeros(len(matrix)) if x is None else x for name, x in start.items()} | data
        damping = np.zeros_like(matrix) if damping is None else damping
        return cls(mass=matrix, damping=damping, stiffness=stiffness, loads=loads, contacts=contacts, **options)  # type: ignore[arg-type]

    def __repr__(self) -> str:
        parts = {"unknown": self.size, "load": len(self.loads), "contact": len(self.contacts)}
        return f"<System, {self.form}: {', '.join(several(count, noun) for noun, count in parts.items())}>"

    @property
    def size(self) -> int:
        """n, the number of unknowns."""
        return len(self.mass)

    @cached_property
    def damped(self) -> bool:
        """True if any entry of the damping matrix is not zero."""
        return bool(np.any(self.damping))

    @cached_property
    def gyroscopic(self) -> bool:
        """True if the damping matrix is not symmetric."""
        return not np.array_equal(self.damping, self.damping.T)

    @cached_property
    def passive(self) -> bool:
        """True if the damping takes energy or none: its symmetric part is positive semidefinite."""
        symmetric = 0.5 * (self.damping + self.damping.T)
        return _least(symmetric) >= -1e-10

    @property
    def rigid(self) -> bool:
        """True if a stop is rigid."""
        return any(contact.stops.rigid for contact in self.contacts)

    @property
    def time_functions(self) -> list[LoadFunction | None]:
        """The functions of time: those of the loads, then the offsets of the channels."""
        return [*(function for _, function in self.loads), *(offset for _, offset in self.channels)]

    @cached_property
    def drive(self) -> Drive:
        """The harmonics, the records and the functions without closed form that the ``time_functions`` are made of."""
        return Drive.of(self.time_functions)

    @property
    def load_terms(self) -> list[tuple[Array, LoadFunction]]:
        """(vector, function) of every term of every load, sums term by term."""
        return [(factor * vector, term) for vector, f in self.loads for factor, term in parts(f)]

    @property
    def load_amplitudes(self) -> Array:
        """``Drive.amplitudes`` of the load sum_k p_k f_k(t), (.., n)."""
        vectors = np.array([p for p, _ in self.loads]).reshape(-1, self.size)
        return self.drive.amplitudes([f for _, f in self.loads]) @ vectors

    @property
    def stiffness_factor(self) -> Array | None:
        """G with G^T G = K of a beam, from which frequencies lose eps w_max/w_1 rather than its square."""
        return self.origin.stiffness_factor if self.origin else None

    @property
    def form(self) -> str:
        """The space discretisation that made the matrices, "matrices" for anyone's own."""
        return self.origin.form if self.origin else "matrices"

    def keeps(self, *names: str) -> bool:
        """Return True if these arrays equal those that the beam gave, number by number."""
        return self.origin is not None and all(same(getattr(self.origin.made, x), getattr(self, x)) for x in names)

    @cached_property
    def problem(self) -> BeamProblem | None:
        """The beam of which this is the semi-discretisation, its initial data being q0 and v0; else None.

        It follows the stops, and their absence. Other loads, or stops at other places, are those of no beam.
        """
        if self.origin is None:
            return None
        systems, problem = (self, self.origin.made), self.origin.problem
        loads, made_loads = ([(row.tobytes(), f) for row, f in x.loads] for x in systems)
        places, made_places = ([(c.row.tobytes(), c.offset) for c in x.contacts] for x in systems)
        if loads != made_loads or (places and places != made_places):
            return None
        pairs = zip(self.contacts, problem.all_stops, strict=False)
        stops = tuple(replace(c.stops, position=x.position, motion=x.motion) for c, x in pairs)
        return problem if stops == problem.all_stops else replace(problem, stops=stops)

    @cached_property
    def channels(self) -> tuple[tuple[Array, TimeFunction | None], ...]:
        """The observed positions (row, offset): one per contact, then the tip where it is another row."""
        rows = tuple((contact.row, contact.offset) for contact in self.contacts)
        return rows if self.observe is None else (*rows, (self.observe, None))

    @property
    def tip_channel(self) -> int:
        """The index in ``channels`` of the tip."""
        return 0 if self.observe is None else len(self.contacts)

    def reads_tip(self, contact: int) -> bool:
        """Return True if a contact acts on the tip itself."""
        (row, offset), (tip, tip_offset) = self.channels[contact], self.channels[self.tip_channel]
        return np.array_equal(row, tip) and offset == tip_offset

    def load(self, t: ArrayLike) -> Array:
        """sum_k p_k f_k(t); shape t.shape + (n,)."""
        forces = (np.multiply.outer(evaluate(function, t), row) for row, function in self.loads)
        return sum(forces, np.zeros((*np.shape(t), self.size)))

    def positions(self, t: ArrayLike, q: Array) -> Array:
        """row q + o(t) of every channel; q of shape t.shape + (n,) gives t.shape + (channels,)."""
        return np.stack([channel_position(row, offset, t, q) for row, offset in self.channels], axis=-1)

    def motions(self, t: ArrayLike, q: Array, v: Array) -> tuple[Array, Array]:
        """``positions`` of every channel, and their rates."""
        each = [channel_motion(row, offset, t, q, v) for row, offset in self.channels]
        positions, velocities = (np.stack(x, axis=-1) for x in zip(*each, strict=True))
        return positions, velocities

    def energies(self, t: ArrayLike, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """(1/2 q'^T M q', 1/2 q^T K q, sum_c U_c), each t.shape; q, v of shape t.shape + (n,)."""
        stored = (x.stops.energy(channel_position(x.row, x.offset, t, q)) for x in self.contacts)
        return *self.free_energies(q, v), sum(stored, np.zeros(np.shape(t)))

    def free_energies(self, q: Array, v: Array) -> tuple[Array, Array]:
        """(1/2 q'^T M q', 1/2 q^T K q), the energies without the contacts'."""
        kinetic = 0.5 * np.sum(v * (v @ self.mass), axis=-1)
        G = self.stiffness_factor
        elastic = np.sum(q * (q @ self.stiffness) if G is None else (q @ G.T) ** 2, axis=-1)
        return kinetic, 0.5 * elastic

    def ode(self) -> ODE:
        """Return the differential equation that the reference solvers integrate, for a solver of your own."""
        from .right_hand_side import ODE

        return ODE(self)

    def displacement(self, t: ArrayLike, q: Array, x: ArrayLike, of: str = "value") -> Array:
        """u(x, t) of a beam between its nodes, or with of="rate" and q' for q its velocity, see ``beam_field``.

        t (m,), q (m, n), x (...) -> (m, ...). Raises InputError for a system that is not a beam, and for x outside it.
        """
        if self.problem is None or self.origin is None:
            raise InputError("displacement(x)", self.form, "be asked of a beam", "for from_matrices use run.states")
        return beam_field(self.problem, self.form, self.origin.cells, np.asarray(t, float), q, x, of)

    @property
    def exact_parameters(self) -> tuple[str, ...]:
        """The numbers that multiprecision uses at their exact value, not as doubles, as ``name = text``."""
        if self.problem is not None and self.form != "hermite":
            return tuple(exact_parts(self.problem))
        return (*exact_parts(self.loads, "loads"), *exact_parts(self.contacts, "contacts"))

    @cached_property
    def fingerprint(self) -> str:
        """A hash of everything that determines the solution; equal for equal systems in any process.

        Numbers count by their exact values: a stop at the decimal 0.001 and one at the nearest double make two systems,
        whose motions diverge at the horizon of float64.
        """
        return hashlib.sha256(b"".join(self._content().values())).hexdigest()

    def _content(self) -> dict[str, bytes]:
        """Content of the fingerprint by name."""
        loads = (row.tobytes() + description(function).encode() for row, function in self.loads)
        contacts = (c.row.tobytes() + repr(c.stops).encode() + description(c.offset).encode() for c in self.contacts)
        return {
            "form": self.form.encode(),
            "mass": self.mass.tobytes(),
            "damping": self.damping.tobytes(),
            "stiffness": self.stiffness.tobytes(),
            "initial data": self.q0.tobytes() + self.v0.tobytes(),
            "observed point": b"none" if self.observe is None else self.observe.tobytes(),
            "loads": b"".join(loads),
            "contacts": b"".join(contacts),
            "exact parameters": "; ".join(self.exact_parameters).encode(),
            "units": repr(self.units).encode() if self.units else b"",
        }

    def differences(self, other: System) -> list[str]:
        """Names of the differences from another system: its unknowns, or form, mass, damping, initial data, ..."""
        if self.size != other.size:
            return [f"unknowns ({self.size} and {other.size})"]
        mine, theirs = self._content(), other._content()
        return [name for name, content in mine.items() if content != theirs[name]]


def require_system(system: Any, field: str = "system") -> System:
    """``system`` if it is a System."""
    return instance(field, system, System, "make it with semidiscretise or from_matrices")
