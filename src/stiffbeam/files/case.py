"""What a case is: a beam with a grid, or a system of anyone's own, with the runs to make of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from ..basics.units import Units
from ..basics.validation import InputError, near, positive, step_count
from ..model.contact import Stops
from ..model.problem import BeamProblem
from ..model.semidiscretisation import FORMS, semidiscretise
from ..model.system import System
from ..schemes import RIGID, SDIRK, Scheme, make, takes_stops


@dataclass(frozen=True)
class Case:
    """A problem with the grid, step, time span and runs to make of it.

    The problem's numbers are those of the file as written, 0.001 and "pi/2" exactly: float64 sees the nearest
    doubles, multiprecision the numbers themselves.
    runs: (scheme, form) pairs. published: what the source reports, by kind and run. notes: what is
    inferred rather than stated, each with its reason.
    """

    name: str
    title: str
    problem: BeamProblem
    cells: int
    dt: float
    t_end: float
    runs: tuple[tuple[Scheme, str], ...]
    published: dict[str, dict[str, float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def beam(self) -> BeamProblem | None:
        """The problem; None for a system of matrices."""
        return self.problem

    @property
    def units(self) -> Units:
        """The units of the problem."""
        return self.problem.units

    @property
    def has_stops(self) -> bool:
        """Whether the problem has a stop."""
        return self.problem.stops is not None

    @property
    def grid(self) -> str:
        """The grid in words."""
        return f"{self.cells} cells"

    @property
    def forms(self) -> tuple[str, ...]:
        """The forms that studies look at by default, the first where one is enough."""
        problem = self.problem
        if problem.for_elements or {form for _, form in self.runs} == {"hermite"}:
            return ("hermite",)
        return FORMS if problem.viscosity == problem.tip_mass == problem.mass_damping == 0.0 else FORMS[:1]

    def system(self, form: str | None = None) -> System:
        """The semi-discrete system in this form, by default the first of ``forms``."""
        return semidiscretise(self.problem, self.cells, form or self.forms[0])


@dataclass(frozen=True)
class SystemCase(Case):
    """A case of a System. ``problem`` and ``cells`` raise InputError: what refines a grid needs a beam."""

    problem: BeamProblem = field(init=False, repr=False, compare=False)
    cells: int = field(init=False, repr=False, compare=False)
    matrices: System = field(kw_only=True)

    def __getattr__(self, name: str) -> Any:
        if name in ("problem", "cells"):
            remedy = "describe it as a beam with a number of cells"
            raise InputError("case", f"{self.name}, a system of matrices", "be a beam with a grid here", remedy)
        raise AttributeError(name)

    @property
    def beam(self) -> None:
        """None: a system of matrices is not a beam."""
        return None

    @property
    def units(self) -> Units:
        """The units of the matrices."""
        return self.matrices.units

    @property
    def has_stops(self) -> bool:
        """Whether the system has a contact."""
        return bool(self.matrices.contacts)

    @property
    def grid(self) -> str:
        """The number of unknowns, in words."""
        return f"{self.matrices.size} unknowns"

    @property
    def forms(self) -> tuple[str, ...]:
        """The one form that the matrices are in."""
        return (self.matrices.form,)

    def system(self, form: str | None = None) -> System:
        """The system itself; InputError for another form."""
        if form not in (None, self.matrices.form):
            raise InputError("form", form, "be that of the system", near(form or "", self.forms))
        return self.matrices


def default_schemes(stops: Iterable[Stops] = ()) -> list[Scheme]:
    """The paper's three, or three with an impact law where rigid stops have restitution."""
    paper, each = [make("bdf2"), SDIRK(nystrom=True), make("hht")], list(stops)
    taken = [scheme for scheme in [*paper, *map(make, RIGID)] if takes_stops(scheme, each)]
    return taken[:3] or paper


def case_of(system: System, dt: float | None, t_end: float | None, name: str = "system") -> Case:
    """A case of a System, with its ``default_schemes``; one that is a beam on a grid as it stands keeps both.

    Raises InputError without a step and a time span, which a System does not have.
    """
    if dt is None or t_end is None:
        raise InputError("dt and t_end", (dt, t_end), "be given with a System", "for example dt=1e-4, t_end=1.0")
    step_count(positive("dt", dt), positive("t_end", t_end))
    runs = tuple((scheme, system.form) for scheme in default_schemes(c.stops for c in system.contacts))
    beam = system.problem
    if beam is not None and system.cells is not None:
        made = Case(name, name, beam, system.cells, float(dt), float(t_end), runs)
        if made.system(system.form).fingerprint == system.fingerprint and made.forms[0] == system.form:
            return made
    return SystemCase(name, name, float(dt), float(t_end), runs, matrices=system)
