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

from ..basics.units import Units
from ..basics.validation import InputError, exact_float, file_path, instance, integer, near, positive, step_count
from ..model.contact import Stops
from ..model.members import varied_members
from ..model.problem import BeamProblem, BeamSection, DistributedLoad, Load, PointLoad
from ..model.semidiscretisation import FORMS, semidiscretise
from ..model.system import System
from ..schemes import BDF2, HHT, RIGID, SDIRK, Scheme, takes_stops
from ..schemes.labels import make, parse_run
from .paper import case_blocks, paper_text
from .reader import Reader, SystemReader


@dataclass(frozen=True)
class Case:
    """A problem with the grid, time step, time span and runs to make of it, as a case file holds them.

    The problem has the numbers of the file as they are written, such as 0.001 and "pi/2": float64 takes the nearest
    doubles, multiprecision the numbers themselves.

    Parameters
    ----------
    name, title : str
    problem : BeamProblem
    cells : int
        Cells of the grid.
    dt, t_end : float
    runs : sequence of (Scheme, form)
    published : dict
        Values that the source reports, by kind and run.
    notes : sequence of str
        What is inferred rather than stated in the source, each with its reason.
    uncertain : mapping of path to (low, high)
        Ranges of parameters, from which ``doubt`` draws.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> case = sb.paper_case(10)
    >>> case.cells, case.dt, case.system()
    (25, 0.0001, <System, displacement: 25 unknowns, 2 loads, 1 contact>)
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
    uncertain: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def beam(self) -> BeamProblem | None:
        """The problem; None for a system of matrices."""
        return self.problem

    @property
    def units(self) -> Units:
        """Names of the units of the problem."""
        return self.problem.units

    @property
    def has_stops(self) -> bool:
        """Return True if the problem has a stop."""
        return self.problem.stops is not None

    @property
    def grid(self) -> str:
        """The grid in words."""
        return f"{self.cells} cells"

    @property
    def forms(self) -> tuple[str, ...]:
        """The forms that studies look at by default, the first where one is enough."""
        problem = self.problem
        # Elements where beam or runs need them; else the paper's, the second without damping and tip mass.
        if problem.for_elements or {form for _, form in self.runs} == {"hermite"}:
            return ("hermite",)
        return FORMS if problem.viscosity == problem.tip_mass == problem.mass_damping == 0.0 else FORMS[:1]

    def system(self, form: str | None = None) -> System:
        """The semi-discrete system in this form, by default the first of ``forms``."""
        return semidiscretise(self.problem, self.cells, form or self.forms[0])

    def refined(self, form: str) -> System | None:
        """The system on twice the cells; None for matrices without a finer model."""
        return semidiscretise(self.problem, 2 * self.cells, form)


@dataclass(frozen=True)
class SystemCase(Case):
    """A case of a System. ``problem`` and ``cells`` raise InputError, because mesh refinement needs a beam.

    finer: the same structure on a finer mesh, from which ``doubt`` estimates the error of the mesh.
    """

    problem: BeamProblem = field(init=False, repr=False, compare=False)
    cells: int = field(init=False, repr=False, compare=False)
    matrices: System = field(kw_only=True)
    finer: System | None = field(kw_only=True, default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        finer, remedy = self.finer, "describe the same structure on a finer mesh"
        if finer is not None and _excited(finer) != _excited(self.matrices):
            rule = "have as many loads as the system, and its contacts with the same stops"
            raise InputError("finer", repr(finer), rule, remedy)
        if finer is not None and finer.size <= self.matrices.size:
            rule = f"have more than the {self.matrices.size} unknowns of the system"
            raise InputError("finer", f"{finer.size} unknowns", rule, remedy)

    def __getattr__(self, name: str) -> Any:
        if name in ("problem", "cells"):
            remedy = "describe it as a beam, or compare matrices with a finer model by `stiffbeam doubt`"
            raise InputError("case", f"{self.name}, a system of matrices", "be a beam with a grid here", remedy)
        raise AttributeError(name)

    @property
    def beam(self) -> None:
        """None: a system of matrices is not a beam."""
        return None

    @property
    def units(self) -> Units:
        """Names of the units of the matrices."""
        return self.matrices.units

    @property
    def has_stops(self) -> bool:
        """Return True if the system has a contact."""
        return bool(self.matrices.contacts)

    @property
    def grid(self) -> str:
        """The number of unknowns, in words."""
        return f"{self.matrices.size} unknown{'s' * (self.matrices.size > 1)}"

    @property
    def forms(self) -> tuple[str, ...]:
        """The one form that the matrices are in."""
        return (self.matrices.form,)

    def system(self, form: str | None = None) -> System:
        """The system itself; InputError for another form."""
        if form not in (None, self.matrices.form):
            raise InputError("form", form, "be that of the system", near(form or "", self.forms))
        return self.matrices

    def refined(self, form: str) -> System | None:
        """The finer model, if there is one."""
        return self.finer


def _excited(system: System) -> tuple[int, list[Stops]]:
    return len(system.loads), [contact.stops for contact in system.contacts]


def default_schemes(stops: Iterable[Stops] = ()) -> list[Scheme]:
    """The paper's three, or three with an impact law where rigid stops have restitution."""
    paper, each = [make("bdf2"), SDIRK(nystrom=True), make("hht")], list(stops)
    taken = (scheme for scheme in chain(paper, map(make, RIGID)) if takes_stops(scheme, each))
    return list(islice(taken, 3)) or paper


def case_of(
    system: System,
    dt: float | None,
    t_end: float | None,
    name: str = "system",
    finer: System | None = None,
) -> Case:
    """A case of a System, with its ``default_schemes``; one that is a beam on a grid as it stands keeps both.

    finer: see ``SystemCase``. Raises InputError without a step and a time span, which a System does not have.
    """
    instance("case", system, System, "make it with semidiscretise or from_matrices, or take a Case")
    if dt is None or t_end is None:
        raise InputError("dt and t_end", (dt, t_end), "be given with a System", "for example dt=1e-4, t_end=1.0")
    step_count(positive("dt", dt), positive("t_end", t_end))
    runs = tuple((scheme, system.form) for scheme in default_schemes(c.stops for c in system.contacts))
    beam = system.problem
    if beam is not None and system.cells is not None:
        case = Case(name, name, beam, system.cells, float(dt), float(t_end), runs)
        # Only if the grid makes this very system: other data or matrices would be lost with the problem.
        same = case.system(system.form).fingerprint == system.fingerprint and case.forms[0] == system.form
        if same and finer is None:
            return case
    return SystemCase(name, name, float(dt), float(t_end), runs, matrices=system, finer=finer)


MOST_BYTES, MOST_LINE, MOST_DOTS = 1 << 20, 1 << 16, 50  # of a case file, a line and a key in it


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
    integer("table", table, 1)
    return find_case(f"table{table}")


def find_case(name: str) -> Case:
    """A case by name: ``table1`` .. ``table17``, a TOML file with one case, or ``file.toml:case``."""
    if not isinstance(name, str):
        raise InputError("case", name, "be the name of a case", "table1 to table17, or a TOML file")
    # The paper's tables first: no file can stand in their way.
    known = paper_cases()
    if name in known:
        return known[name]
    file_path("case", name, "table1 to table17, or a TOML file")
    file = case_file(name)
    # The case behind the file and a colon.
    wanted = name[len(file) + 1 :]
    if file.endswith(".toml") or Path(file).is_file():
        cases = load_cases(file)
        if wanted:
            if wanted not in cases:
                raise InputError("case", wanted, f"be one of the cases in {file}", near(wanted, cases))
            return cases[wanted]
        if len(cases) > 1:
            raise InputError("case", name, "name one case of the file", f"add :{' or :'.join(cases)} to it")
        return next(iter(cases.values()))
    raise InputError("case", name, "be a table of the paper or a TOML file", near(name, known))


def case_file(name: str) -> str:
    """The file in ``file.toml`` or ``file.toml:case``."""
    head, separator, _ = name.partition(".toml:")
    return head + ".toml" if separator else name


@cache
def paper_cases() -> dict[str, Case]:
    """The paper's tables by name, in order."""
    return _parse(_toml(paper_text()), "paper.toml")


def case_text(name: str) -> str:
    """The case as the text of a TOML file; ``name`` as in ``find_case``."""
    case = find_case(name)
    text = paper_text() if name in paper_cases() else Path(case_file(name)).read_text(encoding="utf-8")
    return case_blocks(text)[case.name]


def parse_case(text: str, source: str) -> Case:
    """The one case in a TOML text."""
    return next(iter(_parse(_toml(text), source).values()))


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
    file = file_path("case file", file, "stiffbeam cases --show table10 prints one")
    try:
        data = _toml(_bounded(file))
    except FileNotFoundError:
        remedy = "stiffbeam cases --show table10 prints one to start from"
        raise InputError("case file", str(file), "exist", remedy) from None
    except InputError:
        raise
    except OSError as error:
        raise InputError("case file", str(file), "be a readable file", f"{error.strerror}: give another") from None
    except ValueError as error:  # of TOML, of UTF-8, and of a path with a zero in it
        raise InputError("case file", str(file), "be valid TOML", f"mend it: {error}") from None
    except RecursionError:
        raise InputError("case file", str(file), "be valid TOML", "it nests lists too deeply") from None
    return _parse(data, str(file), file.parent)


def _bounded(file: Path) -> str:
    """The text of a case file. Raises InputError for one of a size that no case has: a dotted key takes memory
    in proportion to the square of its length."""
    # One byte more than allowed shows that a file is too long, whatever its size.
    with file.open("rb") as stream:
        content = stream.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        remedy = "put samples into a file beside it"
        raise InputError("case file", str(file), f"have at most {MOST_BYTES} bytes", remedy)
    for number, line in enumerate(content.split(b"\n"), 1):
        if len(line) > MOST_LINE:
            remedy = "break lists over lines"
            raise InputError(f"{file}: line {number}", f"{len(line)} bytes", f"have at most {MOST_LINE}", remedy)
        # Dots in quotes nest nothing.
        key = re.sub(rb'"[^"]*"|\'[^\']*\'', b"", line).partition(b"=")[0]
        if key.count(b".") > MOST_DOTS:
            raise InputError(f"{file}: line {number}", "a key of many dots", f"have at most {MOST_DOTS}", "use tables")
    return content.decode("utf-8").replace("\r\n", "\n")


def compared_runs(case: Case) -> list[tuple[Scheme, str]]:
    """Runs of a comparison: those of the case, and on a table of the paper each of its three schemes."""
    runs = list(case.runs)
    table = paper_cases().get(case.name)
    # A file of the user may have the name of a table: other runs are left as they are.
    if table is not None and case.runs == table.runs:
        names = {scheme.name for scheme, _ in runs}
        three = (BDF2(), SDIRK(nystrom=True), HHT())
        runs += [(scheme, "displacement") for scheme in three if scheme.name not in names]
    return runs


# ---------------------------------------------------------------- the file's form


def _toml(text: str) -> dict[str, Any]:
    """TOML whose decimals keep their exact values."""
    return tomllib.loads(text, parse_float=exact_float)


def _parse(data: dict[str, Any], source: str, folder: Path | None = None) -> dict[str, Case]:
    """folder: where the files that a case names are; None for a text that has to hold everything itself."""
    cases: dict[str, Case] = {}
    entries = data.get("case")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{source}: case", entries, "be one or more [[case]] tables", "begin the file with [[case]]")
    unknown = set(data) - {"case"}
    if unknown:
        remedy = "move it below the line [[case]]"
        raise InputError(f"{source}: {min(unknown)}", data[min(unknown)], "stand inside a [[case]] table", remedy)
    for entry in entries:
        if not isinstance(entry, dict):
            raise InputError(f"{source}: case", entry, "be a table", "write [[case]]")
        case = _Reader(entry, f"{source}: {entry.get('name', 'case')}", folder).case()
        if case.name in cases:
            raise InputError(f"{source}: name", case.name, "be given once", "give each case a name of its own")
        cases[case.name] = case
    return cases


class _Reader(Reader):
    """Reads a case, its problem, and what belongs to that."""

    def case(self) -> Case:
        # No form for the whole case: every run has its own.
        if "form" in self.table:
            remedy = f'write it behind a scheme, runs = ["HHT@{self.table["form"]}"]'
            raise self.error("form", self.table["form"], "be left out", remedy)
        parts = {"problem", "system", "finer", "published", "uncertain"}
        self.only({"name", "title", "cells", "dt", "t_end", "runs", "inferred"} | parts)
        # A beam or a system of matrices, one of them.
        name = self.line("name")
        problem, matrices = self.sub("problem"), self.get("system", dict, "be a table", None)
        if (problem is None) == (matrices is None):
            remedy = "[case.problem] is a beam, [case.system] names matrices"
            both = None if matrices is None else "beside a system"
            raise self.error("problem", both, "be given and be a table" if matrices is None else "stand alone", remedy)
        system = None if matrices is None else SystemReader(matrices, f"{self.where}.system", self.folder).model()
        more = self.get("finer", dict, "be a table", None)
        finer: Any = None if more is None else SystemReader(more, f"{self.where}.finer", self.folder).model()
        beam = None if problem is None else problem.problem()
        all_stops = beam.all_stops if beam is not None else [c.stops for c in system.contacts] if system else []
        # Runs, in the form that fits what is solved.
        runs = self.get("runs", list, "be a list of runs", [str(x) for x in default_schemes(all_stops)])
        dt, t_end = self.number("dt"), self.number("t_end")
        # A time step that does not divide the span is refused here, before any work.
        self.build(step_count, self.build(positive, "dt", dt), self.build(positive, "t_end", t_end))
        form = "matrices" if beam is None else "hermite" if beam.for_elements else "displacement"
        parsed = []
        for run in runs:
            if not isinstance(run, str):
                raise self.error("runs", run, "be strings like 'HHT(alpha=-0.1)@displacement'", "write it in quotes")
            # Data from others must not import modules.
            if ":" in run:
                remedy = "leave it out, and name it on the command line: --schemes mymodule:Central"
                raise self.error("runs", run, "be schemes of the package", remedy)
            parsed.append(self.build(parse_run, run, form))
        # What the source has published, and notes on it.
        published = self.get("published", dict, "be a table", {})
        for kind, values in published.items():
            if not isinstance(values, dict) or not all(isinstance(v, (int, float)) for v in values.values()):
                raise self.error(f"published.{kind}", values, "be a table of numbers by run", 'write "BDF2" = 10')
        notes = self.get("inferred", list, "be a list of strings", [])
        if not all(isinstance(note, str) for note in notes):
            raise self.error("inferred", notes, "be a list of strings", 'write ["..."]')
        common: dict[str, Any] = {
            "name": name, "title": self.line("title", name), "dt": float(dt),
            "t_end": float(t_end), "runs": tuple(parsed), "published": published, "notes": tuple(notes),
            "uncertain": self.uncertain(),
        }  # fmt: skip
        # A system has no grid and no other form.
        if system is not None:
            if "cells" in self.table:
                raise self.error("cells", self.table["cells"], "be left out", "a system of matrices has no grid")
            wrong = next((form for _, form in parsed if form != "matrices"), None)
            if wrong is not None:
                raise self.error("runs", f"@{wrong}", "be without a form", "it is that of the matrices: leave @ out")
            return self.varied(self.build(SystemCase, matrices=system, finer=finer, **common))
        assert beam is not None
        if finer is not None:
            raise self.error("finer", "matrices", "stand beside [case.system]", "a beam is refined by its cells")
        cells = self.build(integer, "cells", self.get("cells", int, "be an integer >= 4"), 4)
        return self.varied(Case(problem=beam, cells=cells, **common))

    def uncertain(self) -> dict[str, tuple[float, float]]:
        """Ranges by path."""
        ranges = self.get("uncertain", dict, "be a table of paths", {})
        for path, ends in ranges.items():
            numbers = isinstance(ends, list) and len(ends) == 2 and all(isinstance(x, (int, float)) for x in ends)
            if not numbers or not ends[0] < ends[1]:
                remedy = 'write "stops.stiffness" = [4.5e6, 5.5e6]'
                raise self.error(f'uncertain."{path}"', ends, "be a range of two increasing numbers", remedy)
        return {path: (float(ends[0]), float(ends[1])) for path, ends in ranges.items()}

    def varied(self, case: Case) -> Case:
        """The case; a path that it does not have, and an end of a range that no system can have, are refused here."""
        if case.uncertain:
            self.build(varied_members, case.system(), case.uncertain)
        return case

    def problem(self) -> BeamProblem:
        shared = {"stops", "base", "loads", "initial_displacement", "initial_velocity"}
        more = ("tip_mass", "mass_damping", "rotary_inertia", "tip_inertia")
        shared |= {"supports", "modal_damping", "sections", *more}
        # Names of a physical beam mean SI; the others are the paper's.
        physical = any(name in self.table for name in ("length", "bending_stiffness", "mass_per_length"))
        parameters = (
            ("length", "bending_stiffness", "mass_per_length", "bending_viscosity")
            if physical
            else ("stiffness", "viscosity")
        )
        if not physical and "units" in self.table:
            remedy = "leave it out, or write length, bending_stiffness and mass_per_length in place of stiffness"
            raise self.error("units", self.table["units"], "be a known field", remedy)
        self.only(shared | set(parameters) | ({"units", "time_unit"} if physical else set()))
        if self.number("time_unit", 1) != 1:
            remedy = "times are in seconds: leave it out, and give dt and t_end in seconds"
            raise self.error("time_unit", self.table["time_unit"], "be 1", remedy)
        numbers = {key: self.number(key) for key in (*parameters, *more) if key in self.table}
        # Ask for the required ones: ``numbers`` holds those that there are.
        for key in parameters[:3] if physical else parameters[:1]:
            self.number(key)
        base = self.sub("base")
        loads = self.tables("loads", "{ position = ..., amplitude = ..., ... }")
        units = self.sub("units")
        return self.build(
            BeamProblem.from_physical if physical else BeamProblem,
            **numbers | ({} if units is None else {"units": units.units()}),
            stops=[stops.stops({"position", "motion"}) for stops in self.one_or_several("stops")],
            base=None if base is None else base.time_function(set()),
            loads=tuple(load.load() for load in loads),
            initial_displacement=self.polynomial("initial_displacement"),
            initial_velocity=self.polynomial("initial_velocity"),
            supports=self.get("supports", str, "be a string", "clamped-free"),
            modal_damping=self.get("modal_damping", (int, float, list), "be a ratio or a list of them", 0.0),
            sections=[part.section() for part in self.one_or_several("sections")],
        )

    def section(self) -> BeamSection:
        self.only({"begin", "end", "stiffness", "mass"})
        numbers = {name: self.number(name) for name in ("stiffness", "mass") if name in self.table}
        return self.build(BeamSection, self.number("begin"), self.number("end"), **numbers)

    def load(self) -> Load:
        if "shape" in self.table:
            return DistributedLoad(self.polynomial("shape"), self.time_function({"shape"}))
        return self.build(PointLoad, self.number("position"), self.time_function({"position"}))
