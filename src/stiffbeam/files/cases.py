"""Cases: the paper's 17 tables, a user's own files, and systems, in one form."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import chain, islice
from pathlib import Path
from typing import Any

from ..basics.storage import regular_text
from ..basics.text import Units, several
from ..basics.validation import InputError, exact_float, file_path, instance, integer, one_of, positive, step_count
from ..model.contact import Stops
from ..model.problem import BeamProblem
from ..model.semidiscretisation import FORMS, semidiscretise
from ..model.system import System
from ..schemes import RIGID, SDIRK, Scheme, takes_stops
from ..schemes.labels import make, parse_run
from . import paper_text
from .reader import Reader, located


@dataclass(frozen=True)
class Case:
    """A problem with the grid, time step, time span and runs to make of it, as a case file holds them.

    The problem has the numbers of the file as they are written, such as 0.001 and "pi/2": float64 takes the nearest
    doubles, multiprecision the numbers themselves.

    Parameters
    ----------
    name, title : str
    problem : BeamProblem or None
        None for a system of matrices.
    cells : int
        Cells of the grid, 0 without one.
    dt, t_end : float
    runs : sequence of (Scheme, form)
    published : dict
        Values that the source reports, by kind and run.
    notes : sequence of str
        What is inferred rather than stated in the source, each with its reason.
    uncertain : mapping of path to (low, high)
        Ranges of parameters, from which ``doubt`` draws.
    matrices : System, optional
        In place of a problem and its grid.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> case = sb.paper_case(10)
    >>> case.cells, case.dt, case.system()
    (25, 0.0001, <System, displacement: 25 unknowns, 2 loads, 1 contact>)
    """

    name: str
    title: str
    problem: BeamProblem | None
    cells: int
    dt: float
    t_end: float
    runs: tuple[tuple[Scheme, str], ...]
    published: dict[str, dict[str, float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    uncertain: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    matrices: System | None = None

    @property
    def beam(self) -> BeamProblem:
        """The problem. Raises InputError for a system of matrices, since mesh refinement needs a beam."""
        if self.problem is None:
            found = f"{self.name}, a system of matrices"
            raise InputError("case", found, "be a beam with a grid here", "describe it as a beam")
        return self.problem

    @property
    def units(self) -> Units:
        """The units of the problem, or of the matrices."""
        return (self.matrices or self.beam).units

    @property
    def has_stops(self) -> bool:
        """Return True if there is a stop."""
        return bool(self.beam.all_stops if self.matrices is None else self.matrices.contacts)

    @property
    def grid(self) -> str:
        """The grid, or the number of unknowns, in words."""
        return f"{self.cells} cells" if self.matrices is None else several(self.matrices.size, "unknown")

    @property
    def forms(self) -> tuple[str, ...]:
        """The forms that studies look at by default, the first where one is enough."""
        if self.matrices is not None:
            return (self.matrices.form,)
        problem = self.beam
        # Elements where beam or runs need them; else the paper's, the second without damping and tip mass.
        if problem.for_elements or {form for _, form in self.runs} == {"hermite"}:
            return ("hermite",)
        return FORMS if problem.viscosity == problem.tip_mass == problem.mass_damping == 0.0 else FORMS[:1]

    def system(self, form: str | None = None) -> System:
        """The semi-discrete system in this form, by default the first of ``forms``. Matrices have one form."""
        if self.matrices is None:
            return semidiscretise(self.beam, self.cells, form or self.forms[0])
        if form is not None:
            one_of("form", form, self.forms, "be that of the system")
        return self.matrices


def default_schemes(stops: Iterable[Stops] = ()) -> list[Scheme]:
    """The paper's three, or up to three that are made for rigid stops where the stops are."""
    paper, each = [make("bdf2"), SDIRK(nystrom=True), make("hht")], list(stops)
    taken = (scheme for scheme in chain(paper, map(make, RIGID)) if takes_stops(scheme, each))
    return list(islice(taken, 3)) or paper


def case_of(system: System, dt: float | None, t_end: float | None, name: str = "system") -> Case:
    """A case of a System, with its ``default_schemes``; one that is a beam on a grid as it stands keeps both.

    Raises InputError without a step and a time span, which a System does not have.
    """
    instance("case", system, System, "make it with semidiscretise or from_matrices, or take a Case")
    t_end, dt = positive("t_end", t_end), positive("dt", dt)
    step_count(dt, t_end)
    runs = tuple((scheme, system.form) for scheme in default_schemes(c.stops for c in system.contacts))
    beam = system.problem
    if beam is not None and system.origin is not None:
        case = Case(name, name, beam, system.origin.cells, dt, t_end, runs)
        # Only if the grid makes this very system: other data or matrices would be lost with the problem.
        if case.system(system.form).fingerprint == system.fingerprint and case.forms[0] == system.form:
            return case
    return Case(name, name, None, 0, dt, t_end, runs, matrices=system)


MOST_BYTES = 1 << 20  # of a case file
DOTTED = re.compile(r"(?:\.[ \t]*[\w\"'-]+[ \t]*){50}")  # a key, which takes memory by the square of its length


def paper_case(table: int) -> Case:
    """Return the case of a table of Dumont (2002).

    Parameters
    ----------
    table : int
        1 to 17.

    Returns
    -------
    Case

    Raises
    ------
    InputError
        For any other number.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.paper_case(10).problem.stiffness
    300.0
    """
    return find_case(f"table{table}")


def find_case(name: str) -> Case:
    """A case by name: ``table1`` .. ``table17``, a TOML file with one case, or ``file.toml:case``."""
    head, colon, wanted = name.partition(".toml:")
    file, known = f"{head}.toml" if colon else name, paper_cases()
    # The paper's tables first: no file can stand in their way.
    if name in known or not file.endswith(".toml"):
        return known[one_of("case", name, known, "be a table of the paper or a TOML file")]
    cases = load_cases(file)
    if not wanted and len(cases) > 1:
        raise InputError("case", name, "name one case of the file", f"add :{' or :'.join(cases)} to it")
    return cases[one_of("case", wanted or next(iter(cases)), cases, f"be one of the cases in {file}")]


@cache
def paper_cases() -> dict[str, Case]:
    """The paper's tables by name, in order."""
    return _parse(tomllib.loads(paper_text(), parse_float=exact_float), "paper.toml")


def load_cases(file: str | Path) -> dict[str, Case]:
    """Return the cases of a TOML file by name.

    Parameters
    ----------
    file : path

    Returns
    -------
    dict of str to Case

    Raises
    ------
    InputError
        Names file, field, value and rule.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import stiffbeam as sb
    >>> text = '''
    ... [[case]]
    ... name = "strip"
    ... dt = 1e-4
    ... t_end = 1.0
    ... cells = 25
    ... [case.problem]
    ... stiffness = 300.0
    ... stops = { upper = 0.1, stiffness = 5e6 }
    ... base = { amplitude = 0.2, frequency = 10.0 }
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "strip.toml")
    ...     _ = file.write_text(text)
    ...     list(sb.load_cases(file))
    ['strip']
    """
    file = file_path("case file", file)
    text = regular_text("case file", file, MOST_BYTES)
    if DOTTED.search(text):
        raise InputError("case file", str(file), "have less than 50 dots in a key", "use tables")
    try:
        data = tomllib.loads(text, parse_float=exact_float)  # decimals keep their exact values
    except (ValueError, ArithmeticError, RecursionError) as error:
        raise InputError("case file", str(file), "be valid TOML", f"mend it: {error}") from None
    return _parse(data, str(file), file.parent)


def compared(case: Case, form: str) -> list[Scheme]:
    """Schemes of a comparison: those that the case runs in this form, or all that it runs; on a table of the paper
    each of its three besides."""
    schemes = [scheme for scheme, of_run in case.runs if of_run == form] or [scheme for scheme, _ in case.runs]
    table = paper_cases().get(case.name)
    # A file of the user may have the name of a table: other runs are left as they are.
    besides = default_schemes() if table is not None and case.runs == table.runs else []
    return schemes + [x for x in besides if type(x) not in map(type, schemes)]


# ---------------------------------------------------------------- the file's form


@dataclass
class Entry:
    """A case as its table in a file."""

    name: str
    dt: float
    t_end: float
    title: str | None = None
    cells: int | None = None
    runs: list[str] | None = None
    inferred: list[str] = field(default_factory=list)
    problem: BeamProblem | None = None
    system: System | None = None
    published: dict[str, dict[str, float]] = field(default_factory=dict)
    uncertain: dict[str, list[float]] = field(default_factory=dict)

    def case(self) -> Case:
        """The case of a beam or of a system of matrices."""
        if (self.problem is None) == (self.system is None):
            remedy = "[case.problem] is a beam, [case.system] names matrices"
            rule = "be given, or a system" if self.system is None else "stand alone, without a system"
            raise InputError("problem", None, rule, remedy)
        if self.system is not None and self.cells is not None:
            raise InputError("cells", self.cells, "be left out", "a system of matrices has no grid")
        # A time step that does not divide the span is refused here, before any work.
        step_count(positive("dt", self.dt), positive("t_end", self.t_end))
        return Case(
            self.name, self.title or self.name, self.problem,
            0 if self.problem is None else integer("cells", self.cells, 4), float(self.dt), float(self.t_end),
            tuple(self._runs()), self.published, tuple(self.inferred),
            {path: tuple(map(float, ends)) for path, ends in self.uncertain.items()}, self.system,
        )  # fmt: skip

    def _runs(self) -> Iterable[tuple[Scheme, str]]:
        """The runs in the form that fits what is solved."""
        beam, system = self.problem, self.system
        stops = beam.all_stops if beam is not None else [contact.stops for contact in system.contacts] if system else []
        form = "matrices" if beam is None else "hermite" if beam.for_elements else "displacement"
        for run in [str(x) for x in default_schemes(stops)] if self.runs is None else self.runs:
            # Data from others must not import modules.
            if ":" in run:
                remedy = "leave it out, and name it on the command line: --schemes mymodule:Central"
                raise InputError("runs", run, "be schemes of the package", remedy)
            scheme, written = parse_run(run, form)
            if beam is None and written != form:
                raise InputError("runs", f"@{written}", "be without a form", "it is that of the matrices: leave @ out")
            yield scheme, written


def _parse(data: dict[str, Any], source: str, folder: Path | None = None) -> dict[str, Case]:
    """The cases by name. folder: of the files that a case names; None for a text that has to hold everything."""
    cases: dict[str, Case] = {}
    entries = data.get("case")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{source}: case", entries, "be one or more [[case]] tables", "begin the file with [[case]]")
    unknown = set(data) - {"case"}
    if unknown:
        remedy = "move it below the line [[case]]"
        raise InputError(f"{source}: {min(unknown)}", data[min(unknown)], "stand inside a [[case]] table", remedy)
    reader = Reader(folder)
    for entry in entries:
        name = entry.get("name", "case") if isinstance(entry, dict) else "case"
        try:
            case = reader.read(entry, Entry).case()
        except Exception as error:
            raise located(error, f"{source}: {str(name)[:100]}") from None
        if case.name in cases:
            raise InputError(f"{source}: name", case.name, "be given once", "give each case a name of its own")
        cases[case.name] = case
    return cases
