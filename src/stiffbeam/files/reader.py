"""Tables of a case file as objects of the model, by cattrs; the matrices and records in files beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, NewType

import numpy as np
from cattrs import BaseValidationError, Converter, IterableValidationNote
from cattrs.cols import list_structure_factory
from cattrs.gen import make_dict_structure_fn, make_mapping_structure_fn

from ..basics.arrays import Array
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
    """The array, dense or SciPy sparse, of a regular file: Matrix Market .mtx (a symmetric half stands for the
    whole), SciPy's .npz, NumPy's .npy. Nothing is unpickled. Raises InputError for any other file."""
    from scipy.io import mmread
    from scipy.sparse import load_npz

    readers = {".mtx": partial(mmread, spmatrix=False), ".npz": load_npz, ".npy": np.load}
    if file.suffix not in readers:
        remedy = "write the matrix by scipy.io.mmwrite or numpy.save; scipy.io.loadmat reads .mat"
        raise InputError("", str(file), f"be a file of {', '.join(readers)}", remedy)
    if not file.is_file():  # devices and pipes have no end
        raise InputError("", str(file), "be a regular file that exists", "give its path relative to the case file")
    try:
        return readers[file.suffix](file)
    except Exception as error:  # whatever the readers of three formats raise for a damaged file
        remedy = f"write it by scipy.io.mmwrite, scipy.sparse.save_npz or numpy.save ({error})"
        raise InputError("", str(file), f"be a readable matrix in {file.suffix}", remedy) from None


# ---------------------------------------------------------------- tables

Matrix = NewType("Matrix", object)  # a list of rows, of a diagonal matrix its diagonal, or the name of a file
Row = NewType("Row", object)  # n numbers, one per unknown
RowLoad = tuple[Row, LoadFunction]
KINDS = {str: "a text", int: "an integer", float: "a number", list: "a list", dict: "a table"}
WRITTEN = {str: '"..."', int: "1", float: "1.0", list: "[...]", dict: "{ ... }"}


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
        system = System.from_matrices(**given) if modes is None else reduce_model(**given, modes=modes)[0]
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


def _units(value: Any, _: Any) -> Units:
    """Names of the units of length, time and force."""
    return units_labels([*(SI_TABLE | _table(value, [*SI_TABLE])).values()])


class Reader:
    """Converter of the tables of a case file. ``folder``: that of the files which the case names, None for a text that
    has to hold everything itself."""

    def __init__(self, folder: Path | None) -> None:
        self.folder, self.size, self.units = folder, 0, ()  # of the system that is read: its unknowns, its units
        self.convert = convert = Converter()
        hooks: dict[Any, Any] = {
            Units: _units, Matrix: self._matrix, Row: self._row,
            System: self._system, RowLoad: self._row_load, Load: self._load,
            Contact: self._contact,
            TimeFunction: self._time, LoadFunction: self._time, LoadFunction | None: self._time,
            Profile: lambda x, _: PolynomialProfile(x),
            str | Points: lambda x, _: self.read(x, Points if isinstance(x, dict) else str),
            Stops | Sequence[Stops] | None: lambda x, _: self.read(x, Sequence[Stops]),
            float | Sequence[float]: lambda x, _: self.read(x, list[float] if isinstance(x, list) else float),
        }  # fmt: skip
        # By class, which comes before the conversions that cattrs has for these.
        for plain, hook in ((float, _number), (int, lambda value, _: _kind(value, int)), (str, _text)):
            convert.register_structure_hook(plain, hook)
        convert.register_structure_hook_factory(lambda kind: getattr(kind, "__origin__", None) in SEQUENCES, self._list)
        convert.register_structure_hook_factory(is_dataclass, self._class)
        convert.register_structure_hook_factory(lambda kind: getattr(kind, "__origin__", None) is dict, self._names)
        for kind, hook in hooks.items():
            convert.register_structure_hook_func(lambda each, kind=kind: each == kind, hook)

    def read(self, value: Any, kind: Any) -> Any:
        """A table or an entry as an object of this kind. Raises errors of cattrs, see ``located``."""
        return self.convert.structure(value, kind)

    def _class(self, kind: Any) -> Any:
        names, make = [x.name for x in fields(kind) if x.init], make_dict_structure_fn(kind, self.convert)

        def read(value: Any, _: Any) -> Any:
            units = _table(value, names).get("units")
            if "units" in names:
                self.units = tuple((SI_TABLE | units).values()) if isinstance(units, dict) else ()
            return make(value, kind)

        return read

    def _list(self, kind: Any) -> Any:
        inner = kind.__args__[0]
        make = list_structure_factory(list[inner], self.convert)

        def items(value: Any, _: Any) -> list[Any]:
            # [case.problem.stops] once, or [[case.problem.stops]] once for each.
            if isinstance(value, dict) and inner not in (str, float):
                return [self.read(value, inner)]
            return make(_kind(value, list), list[inner])

        return items

    def _names(self, kind: Any) -> Any:
        make = make_mapping_structure_fn(kind, self.convert)
        return lambda value, _: make(_kind(value, dict), kind)

    def _system(self, value: Any, _: Any) -> System:
        self.size = 0
        return self.read(value, Matrices).system()

    def _time(self, value: Any, _: Any, own: tuple[str, ...] = ()) -> TimeFunction:
        """The sum, samples, constant or harmonic function of a table; ``own`` are others in it."""
        rest = {name: x for name, x in _kind(value, dict).items() if name not in own}
        one = next((name for name in ("sampled", "sum", "constant") if name in rest), "")
        if one == "sampled":
            return self._sampled(self.read(rest, Samples))
        _table(rest, [one] if one else ["amplitude", "frequency", "phase", "constant", "sampled", "sum"])
        if one == "sum":
            return Superposition(*self.read(rest, dict[str, Sequence[TimeFunction]])["sum"])
        return Constant(_number(rest["constant"])) if one else self.read(rest, Harmonic)

    def _sampled(self, record: Samples) -> Sampled:
        if isinstance(record.sampled, Points):
            return Sampled(np.array(record.sampled.t), np.array(record.sampled.values), record.kind)
        options = {x.name: getattr(record, x.name) for x in fields(record)[2:]}
        return Sampled(*read_samples(self._beside(record.sampled), **options, units=self.units), record.kind)

    def _load(self, value: Any, _: Any) -> Load:
        name = "shape" if "shape" in _kind(value, dict) else "position"
        where = _needed(value, name, "..., or shape = [...]")
        time = self._time(value, None, (name,))
        return DistributedLoad(PolynomialProfile(where), time) if name == "shape" else PointLoad(where, time)

    def _row_load(self, value: Any, _: Any) -> tuple[Array, TimeFunction]:
        time = self._time(value, None, ("row",))
        return self._row(_needed(value, "row", "{ 0 = 1.0 }")), time

    def _contact(self, value: Any, _: Any) -> Contact:
        """Row and offset beside the fields of the stops."""
        names = [x.name for x in fields(Stops) if x.name not in ("position", "motion")]
        _table(value, [*names, "row", "offset"])
        row = self._row(_needed(value, "row", "{ 0 = 1.0 }"))
        stops = self.read({name: x for name, x in value.items() if name in names}, Stops)
        return Contact(row, stops, self._time(value["offset"], None) if "offset" in value else None)

    def _beside(self, name: str) -> Path:
        if self.folder is None:
            raise InputError("file", name, "be left out here", "write its numbers into the text")
        return self.folder / name

    def _matrix(self, value: Any, _: Any = None) -> Any:
        """A matrix; a vector is the diagonal of one."""
        _kind(value, (str, list))
        matrix = read_matrix(self._beside(value)) if isinstance(value, str) else numbers("", value, *NUMBERS)
        matrix = np.diag(matrix) if matrix.ndim == 1 else matrix
        self.size = matrix.shape[0]
        return matrix

    def _row(self, value: Any, _: Any = None) -> Array:
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


def located(error: Exception, path: str) -> InputError:
    """The first fault in an error of cattrs, as an InputError with the path of its field."""
    if isinstance(error, BaseValidationError):
        noted, others = error.group_exceptions()  # type: ignore[attr-defined]
        if not noted:
            return located(others[0], path)
        inner, note = noted[0]
        step = note.index if isinstance(note, IterableValidationNote) else note.name
        return located(inner, f"{path}[{step}]" if isinstance(step, int) else f"{path}.{step}")
    if isinstance(error, InputError):
        # "stops.upper" of the table stops is its upper.
        head, _, rest = error.field.partition(".")
        table = re.sub(r"\[\d+\]$", "", path).rpartition(".")[2]
        field = rest if head in (table, table.removesuffix("s")) else error.field
        return InputError(f"{path}.{field}" if field else path, error.value, error.rule, error.remedy)
    if isinstance(error, KeyError):
        return InputError(path, None, "be given", f"write {error.args[0]} = ...")
    raise error


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
        raise InputError("", value, f"be {' or '.join(KINDS[x] for x in kinds)}", f"write {WRITTEN[kinds[0]]}")
    return value


def _needed(table: dict[str, Any], name: str, written: str = "...") -> Any:
    if name not in table:
        raise InputError(name, None, "be given", f"write {name} = {written}")
    return table[name]


def _text(value: Any, _: Any = None) -> str:
    """A text that can be printed: control characters would reach the terminal."""
    if not all(x.isprintable() or x in " \t\n" for x in _kind(value, str)):
        raise InputError("", value, "hold printable letters", "leave control characters out")
    return value


def _number(value: Any, _: Any = None) -> float:
    """A number with its exact value; a text such as "pi/2" is one."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str, Fraction)):
        _kind(value, float)
    try:
        return value if isinstance(value, float) else exact_float(value)
    except (ValueError, ArithmeticError):
        raise InputError("", value, "be a number in the range of float64", 'for example 0.001, or "pi/2"') from None
