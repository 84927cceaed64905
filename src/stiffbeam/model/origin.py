"""What a system was made from, and what of that still holds for the system at hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from ..basics.arrays import Array, read_only, same
from ..basics.units import Units
from .contact import Contact, Stops
from .first_order import FirstOrderSystem
from .problem import BeamProblem
from .time_functions import LoadFunction

if TYPE_CHECKING:
    from .system import System


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Origin:
    """A beam, its discretisation, and the arrays that came of them.

    Each method answers for a given system by comparing the arrays it has with those made here, number by
    number. So a system whose stiffness was replaced has no factor from the old one, and no beam: data
    that do not belong to its matrices cannot be reached. The comparison costs n^2 and is made once.

    cells: of the grid. stiffness_factor: G with G^T G = stiffness. contacts: one per stops of the problem, in
    order. tip: the row of u(L, t). paper_form: makes the paper's own first-order form of a system with these
    matrices.
    """

    problem: BeamProblem
    form: str
    cells: int
    mass: Array
    damping: Array
    stiffness: Array
    loads: tuple[tuple[Array, LoadFunction], ...]
    contacts: tuple[Contact, ...]
    tip: Array
    q0: Array
    v0: Array
    stiffness_factor: Array
    paper_form: Callable[[System, BeamProblem], FirstOrderSystem]

    def __post_init__(self) -> None:
        self.freeze()

    def freeze(self) -> None:
        """Read-only copies of the arrays."""
        for name in ("mass", "damping", "stiffness", "tip", "q0", "v0", "stiffness_factor"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        object.__setattr__(self, "loads", tuple((read_only(vector), f) for vector, f in self.loads))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.freeze()  # a pickled array can be written to again

    def has_matrices_of(self, system: System) -> bool:
        """Whether mass, damping and stiffness are still those that the origin made."""
        return all(same(getattr(self, name), getattr(system, name)) for name in ("mass", "damping", "stiffness"))

    def first_order_of(self, system: System) -> FirstOrderSystem | None:
        """The paper's own first-order form, where the matrices are these."""
        return self.paper_form(system, self.problem) if self.has_matrices_of(system) else None

    def form_of(self, system: System) -> str | None:
        """Its name, where the matrices are these."""
        return self.form if self.has_matrices_of(system) else None

    def units_of(self, system: System) -> Units | None:
        """The beam's units, where the matrices are these."""
        return self.problem.units if self.has_matrices_of(system) else None

    def factor_of(self, system: System) -> Array | None:
        """G, where the stiffness is this one; mass and damping have no part in it."""
        return self.stiffness_factor if same(self.stiffness, system.stiffness) else None

    def starts(self, system: System) -> bool:
        """Whether the system has the initial data of the problem."""
        return same(self.q0, system.q0) and same(self.v0, system.v0)

    def problem_of(self, system: System) -> BeamProblem | None:
        """The beam with the stops that the system has, where matrices and loads are the beam's own.

        None where a contact is neither where the problem has stops, moving as they do, nor at rest at the tip.
        """
        if not self.has_matrices_of(system) or len(self.loads) != len(system.loads):
            return None
        pairs = zip(self.loads, system.loads, strict=True)
        if not all(same(a, b) and (f is g or f == g) for (a, f), (b, g) in pairs):
            return None
        found = tuple(self._stops_of(contact) for contact in system.contacts)
        if None in found:
            return None
        return self.problem if found == self.problem.all_stops else replace(self.problem, stops=found)

    def _stops_of(self, contact: Contact) -> Stops | None:
        """The contact's stops at the place of the problem's stops that have its row and offset."""
        for made, stops in zip(self.contacts, self.problem.all_stops, strict=True):
            if same(made.row, contact.row) and made.offset == contact.offset:
                return replace(contact.stops, position=stops.position, motion=stops.motion)
        return contact.stops if contact.offset is None and same(contact.row, self.tip) else None
