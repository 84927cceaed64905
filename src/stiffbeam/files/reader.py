"""Tables of a case file as objects of the model, by their type hints; the matrices and records in files beside it."""

from __future__ import annotations

import re
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields, replace
from fractions import Fraction
from functools import cache, partial, reduce
from operator import or_
from pathlib import Path
from typing import Any, NewType, get_args, get_origin, get_type_hints

import numpy as np

from ..basics.arrays import Array
from ..basics.storage import LARGEST
from ..basics.text import SI, Units
from ..basics.validation import InputError, exact_float, near, numbers, units_labels
from ..model.contact import Contact, Stops
from ..model.modes import modal_damping
from ..model.problem import DistributedLoad, Load, PointLoad, PolynomialProfile, Profile
from ..model.reduction import reduce_model
from ..model.system import System
from ..model.time_functions import Constant, Harmonic, LoadFunction, Sampled, Superposition, TimeFunction
from .columns import read_samples


def read_matrix(file: Path) -> Any:
    """The array, dense or SciPy sparse, of a regular file: Matrix Market .mtx (a symmetric half stands for the whole),
    SciPy's .npz, NumPy's .npy. Nothing is unpickled. Raises InputError for any other file."""
    from scipy.io import mmread
    from scipy.sparse import load_npz

    readers = {".mtx": partial(mmread, spmatrix=False), ".npz": load_npz, ".npy": np.load}
    if file.suffix not in readers:
        remedy = "write the matrix by scipy.io.mmwrite or numpy.save"
        if file.suffix == ".mat":
            remedy = "in Python: scipy.io.mmwrite('K.mtx', scipy.io.loadmat('model.mat')['K'])"
        raise InputError("", str(file), f"be a file of {', '.join(readers)}", remedy)
    if not file.is_file():  # devices and pipes have no end
        raise InputError("", str(file), "be a regular file that exists", "give its path relative to the case file")
    if file.stat().st_size > LARGEST:
        raise InputError("", str(file), f"have at most {LARGEST} bytes", "reduce the model first")
    try:
        return readers[file.suffix](file)
    except Exception as error:  # whatever the readers of three formats raise for a damaged file
        remedy = f"write it by scipy.io.mmwrite, scipy.sparse.save_npz or numpy.save ({error})"
        raise InputError("", str(file), f"be a readable matrix in {file.suffix}", remedy) from None


# ---------------------------------------------------------------- tables

Line = NewType("Line", str)  # a text for one line of a terminal, a page or a file name
Matrix = NewType("Matrix", object)  # a list of rows, of a diagonal matrix its diagonal, or the name of a file
Row = NewType("Row", object)  # n numbers, one per unknown
RowLoad = tuple[Row, LoadFunction]
KINDS = {  # in words, and as they are written
    str: ("a text", '"..."'), bool: ("a truth value", "true"), int: ("an integer", "1"), float: ("a number", "1.0"),
    list: ("a list", "[...]"), dict: ("a table", "{ ... }"),
}  # fmt: skip


@dataclass(kw_only=True)
class Matrices:
    """A system in a case file; modes: it is reduced to so many."""

    mass: Matrix
    stiffness: Matrix
    damping: Matrix | None = None
    modal_damping: float | Sequence[float] = 0.0
    modes: int | None = None
    loads: Sequence[RowLoad] = ()
    contacts: Sequence[Contact] = ()
    observe: Row | None = None
    initial_displacement: Row | None = None
    initial_velocity: Row | None = None
    units: Units = ()

    def system(self) -> System:
        """The system of these matrices, loads and contacts."""
        given = dict(vars(self))
        modes, ratios = given.pop("modes"), given.pop("modal_damping")
        if modes is not None:
            return reduce_model(**given, modes=modes, modal_damping=ratios)[0]
        system = System.from_matrices(**given)
        if np.any(ratios):
            added = modal_damping(system.mass, system.stiffness, ratios)
            system = replace(system, damping=system.damping + added)
        return system


@dataclass
class Points:
    """Samples written into a case file."""

    t: Sequence[float]
    values: Sequence[float]


@dataclass
class Samples:
    """A record in a case file; after ``kind`` the arguments of ``read_samples``."""

    sampled: str | Points
    kind: str = "linear"
    column: str | None = None
    dt: float | None = None
    time_factor: float | None = None
    start: float | None = None


SI_TABLE = dict(zip(("length", "time", "force"), SI, strict=True))


class Reader:
    """Makes objects of the tables of a case file. ``folder``: that of the files which the case names, None for a text
    that has to hold everything itself. ``path``: names and indexes that lead to what is read, as far as an error."""

    def __init__(self, folder: Path | None, path: str) -> None:
        self.folder, self.path = folder, [path]
        self.size, self.unit = 0, ""  # of the system that is read: its unknowns, unit of time
        self.hooks: dict[Any, Any] = {
            str: _text, float: _number, int: lambda x: _kind(x, int), Line: _line, Units: _units,
            Matrix: self._matrix, Row: self._row, System: self._system, RowLoad: self._row_load, Load: self._load,
            Contact: self._contact, TimeFunction: self._time, Profile: PolynomialProfile,
            str | Points: lambda x: self.read(x, Points if isinstance(x, dict) else str),
            Stops | Sequence[Stops]: lambda x: self.read(x, Sequence[Stops]),
            float | Sequence[float]: lambda x: self.read(x, list[float] if isinstance(x, list) else float),
        }  # fmt: skip

    def read(self, value: Any, kind: Any) -> Any:
        """A table or an entry as an object of this kind, each field of a class by its type hint."""
        if kind in self.hooks:
            return self.hooks[kind](value)
        inner = get_args(kind)
        if inner[-1:] == (type(None),):  # TOML has no None: the field is left out
            return self.read(value, reduce(or_, inner[:-1]))
        if get_origin(kind) in SEQUENCES:
            # [case.problem.stops] once, or [[case.problem.stops]] once for each.
            if isinstance(value, dict) and inner[0] not in (str, float):
                return [self.read(value, inner[0])]
            return [self._part(f"[{i}]", x, inner[0]) for i, x in enumerate(_kind(value, list))]
        if get_origin(kind) is dict:
            return {name: self._part(f".{name}", x, inner[1]) for name, x in _kind(value, dict).items()}
        known = _fields(kind)
        units = _table(value, [*known]).get("units")
        if "units" in known:
            self.unit = (SI_TABLE | units)["time"] if isinstance(units, dict) else ""
        for name in (name for name, (_, needed) in known.items() if needed):
            _taken(value, name)
        return kind(**{name: self._part(f".{name}", value[name], known[name][0]) for name in known if name in value})

    def _part(self, step: str, value: Any, kind: Any) -> Any:
        self.path.append(step)
        part = self.read(value, kind)
        self.path.pop()  # not after an error, of which this is the place
        return part

    def _system(self, value: Any) -> System:
        self.size = 0
        return self.read(value, Matrices).system()

    def _time(self, value: Any) -> TimeFunction:
        """The sum, samples, constant or harmonic function of a table."""
        one = next((name for name in ("sum", "sampled", "constant") if name in _kind(value, dict)), "")
        if one == "sampled":
            record = self.read(value, Samples)
            points, options = record.sampled, {x.name: getattr(record, x.name) for x in fields(record)[2:]}
            if isinstance(points, Points):
                return Sampled(np.array(points.t), np.array(points.values), record.kind)
            return Sampled(*read_samples(self._beside(points), **options, unit=self.unit), record.kind)
        _table(value, [one] if one else ["amplitude", "frequency", "phase", "constant", "sampled", "sum"])
        if one == "sum":
            return Superposition(*self._part(".sum", value["sum"], Sequence[TimeFunction]))
        return Constant(_number(value["constant"])) if one else self.read(value, Harmonic)

    def _load(self, value: Any) -> Load:
        name = "shape" if "shape" in _kind(value, dict) else "position"
        where, rest = _taken(value, name, "..., or shape = [...]")
        time = self._time(rest)
        return DistributedLoad(PolynomialProfile(where), time) if name == "shape" else PointLoad(where, time)

    def _row_load(self, value: Any) -> tuple[Array, TimeFunction]:
        row, rest = _taken(value, "row", "{ 0 = 1.0 }")
        return self._row(row), self._time(rest)

    def _contact(self, value: Any) -> Contact:
        """Row and offset beside the fields of the stops."""
        row, rest = _taken(value, "row", "{ 0 = 1.0 }")
        _table(rest, [*(x.name for x in fields(Stops) if x.name not in ("position", "motion")), "offset"])
        offset = self._time(rest.pop("offset")) if "offset" in rest else None
        return Contact(self._row(row), self.read(rest, Stops), offset)

    def _beside(self, name: str) -> Path:
        if self.folder is None:
            raise InputError("file", name, "be left out here", "write its numbers into the text")
        return self.folder / name

    def _matrix(self, value: Any) -> Any:
        """A matrix; a vector is the diagonal of one."""
        _kind(value, (str, list))
        matrix = read_matrix(self._beside(value)) if isinstance(value, str) else numbers("", value, *NUMBERS)
        matrix = np.diag(matrix) if matrix.ndim == 1 else matrix
        self.size = matrix.shape[0]
        return matrix

    def _row(self, value: Any) -> Array:
        if isinstance(_kind(value, (list, str, dict)), str):
            content = read_matrix(self._beside(value))
            return np.asarray(content.toarray() if hasattr(content, "toarray") else content).ravel()
        if isinstance(value, list):
            return numbers("", value, *NUMBERS)
        # A table of single entries, the others zero.
        if not value:
            raise InputError("", value, "be on an unknown", "for example { 0 = 1.0 }")
        row = np.zeros(self.size)
        for unknown, x in value.items():
            if not unknown.isdecimal() or int(unknown) >= self.size:
                raise InputError(unknown, x, f"be of an unknown from 0 to {self.size - 1}", "the first is 0")
            row[int(unknown)] = _number(x)
        return row


SEQUENCES = (list, tuple, Sequence)
NUMBERS = "be numbers, every row as long as the first", "fill rows with 0"


@contextmanager
def reading(folder: Path | None, path: str) -> Generator[Reader, None, None]:
    """Context with a Reader, in which an InputError gets the path of the field that is wrong."""
    reader = Reader(folder, path)
    try:
        yield reader
    except InputError as error:
        # "stops.upper" of the table stops is its upper.
        path, (head, _, rest) = "".join(reader.path), error.field.partition(".")
        table = re.sub(r"\[\d+\]$", "", path).rpartition(".")[2]
        field = rest if head in (table, table.removesuffix("s")) else error.field
        raise InputError(f"{path}.{field}" if field else path, error.value, error.rule, error.remedy) from None


@cache
def _fields(kind: type[Any]) -> dict[str, tuple[Any, bool]]:
    """Type of each field of a dataclass, and True where it must be given."""
    hints = get_type_hints(kind)
    return {x.name: (hints[x.name], x.default is x.default_factory is MISSING) for x in fields(kind) if x.init}


def _units(value: Any) -> Units:
    """Names of the units of length, time and force."""
    return units_labels([*(SI_TABLE | _table(value, [*SI_TABLE])).values()])


def _table(value: Any, names: list[str]) -> dict[str, Any]:
    """``value`` if it is a table of these fields. Raises InputError with the nearest names."""
    for key in _kind(value, dict):
        if key not in names:
            raise InputError(key, value[key], "be a known field", near(key, sorted(names)))
    return value


def _kind(value: Any, kind: type | tuple[type, ...]) -> Any:
    """``value`` if it is of this kind; in Python a truth value is an integer."""
    kinds = kind if isinstance(kind, tuple) else (kind,)
    if isinstance(value, bool) or not isinstance(value, kinds):
        found = next((name for x, (name, _) in KINDS.items() if isinstance(value, x)), "something else")
        rule = f"be {' or '.join(KINDS[x][0] for x in kinds)}"
        raise InputError("", value, rule, f"it is {found}: write {KINDS[kinds[0]][1]}")
    return value


def _taken(table: Any, name: str, written: str = "...") -> tuple[Any, dict[str, Any]]:
    """An entry that a table must have, and the other ones."""
    if name not in _kind(table, dict):
        raise InputError(name, None, "be given", f"write {name} = {written}")
    return table[name], {other: x for other, x in table.items() if other != name}


def _text(value: Any, printable: str = " \t\n") -> str:
    """A text that can be printed: control characters would reach the terminal."""
    if not all(x.isprintable() or x in printable for x in _kind(value, str)):
        raise InputError("", value, "hold printable letters", "leave control characters out")
    return value


def _line(value: Any) -> str:
    if not _text(value, "").strip() or len(value) > 200:
        raise InputError("", value, "be 1 to 200 printable letters", "shorten it, or write one")
    return value


def _number(value: Any) -> float:
    """A number with its exact value; a text such as "pi/2" is one."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str, Fraction)):
        _kind(value, float)
    try:
        return value if isinstance(value, float) else exact_float(value)
    except (ValueError, ZeroDivisionError):
        raise InputError("", value, "be a number in the range of float64", 'for example 0.001, or "pi/2"') from None
