"""Tables of a case file, field by field, and the matrices and records in files beside it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..basics.units import SI, Units, units_labels
from ..basics.validation import InputError, near
from ..model.contact import Contact, Stops
from ..model.contact_law import LINEAR
from ..model.modes import modal_damping
from ..model.problem import PolynomialProfile
from ..model.reduction import reduce_model
from ..model.sampled import Sampled
from ..model.system import System
from ..model.time_functions import Constant, Harmonic, LoadFunction, Superposition, TimeFunction

SUFFIXES = (".mtx", ".npz", ".npy")


def read_matrix(file: Path, field: str = "array") -> Any:
    """The array, dense or SciPy sparse, of a file: Matrix Market .mtx (a symmetric half stands for the whole),
    SciPy's or NumPy's .npz with one array, NumPy's .npy.

    Nothing is unpickled. Raises InputError for another suffix, a file that cannot be read, and several arrays.
    """
    if file.suffix not in SUFFIXES:
        remedy = "write the matrix by scipy.io.mmwrite or numpy.save"
        if file.suffix == ".mat":
            remedy = "in Python: scipy.io.mmwrite('K.mtx', scipy.io.loadmat('model.mat')['K'])"
        raise InputError(field, str(file), f"be a file of {', '.join(SUFFIXES)}", remedy)
    if not file.is_file():
        raise InputError(field, str(file), "be a file beside the case", "give its path relative to the case file")
    try:
        return {".mtx": _market, ".npz": _npz, ".npy": np.load}[file.suffix](file)
    except InputError as error:
        raise InputError(field, error.value, error.rule, error.remedy) from None
    except Exception as error:  # whatever the readers of three formats raise for a damaged file
        write = "scipy.io.mmwrite" if file.suffix == ".mtx" else "numpy.save or scipy.sparse.save_npz"
        kind = "Matrix Market" if file.suffix == ".mtx" else "NumPy or SciPy"
        raise InputError(field, str(file), f"be readable as {kind}", f"write it by {write} ({error})") from None


def _market(file: Path) -> Any:
    from scipy.io import mmread
    from scipy.sparse import coo_array, issparse

    with warnings.catch_warnings():
        # A matrix up to SciPy 1.19, which warns from 1.18 on; an array later.
        warnings.simplefilter("ignore", DeprecationWarning)
        found = mmread(file)
    return coo_array(found) if issparse(found) else found


def _npz(file: Path) -> Any:
    from scipy.sparse import load_npz

    with np.load(file) as archive:
        names = list(archive)
        # SciPy's archives name their format; NumPy's hold arrays only.
        if "format" in names:
            return load_npz(file)
        if len(names) != 1:
            raise InputError("array", f"{file} with {', '.join(names)}", "hold one array", "save each by itself")
        return archive[names[0]]


def read_samples(file: Path, column: str | None = None) -> tuple[list[float], list[float]]:
    """Times and values from a file of columns between commas, semicolons, tabs or blanks.

    The first column holds the times. ``column`` names that of the values in a first line of names; without it
    there must be two columns. Empty lines and those that begin with # are passed over. Raises InputError naming
    file, line and rule for a file that cannot be read, a line of another length and what is no number.
    """
    try:
        # utf-8-sig: spreadsheets begin a file with a byte order mark.
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("sampled", str(file), "be a readable file beside the case", f"give another: {error}") from None
    rows = [(i + 1, split_line(line)) for i, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    if not rows:
        remedy = "a line holds a time and a value, as in 0.0, 1.5"
        raise InputError("sampled", str(file), "hold two or more lines of numbers", remedy)
    # A first line that begins with no number holds the names.
    names = [] if _number(rows[0][1][0]) is not None else rows.pop(0)[1]
    if names and rows and _number(rows[0][1][0]) is None:
        line, cells = rows[0]
        remedy = "leave out all but one line of names: each other line holds a time and its value, as in 0.0, 1.5"
        raise InputError("sampled", f"{file}, line {line}: {cells[0]!r}", "be a number", remedy)
    width = len(names or rows[0][1]) if rows else 0
    if column is not None and column not in names:
        raise InputError("column", column, f"be a name in the first line of {file}", near(column, names))
    if column is not None and names.count(column) > 1:
        raise InputError("column", column, f"be the name of one column of {file}", "rename the others")
    if column is not None and names.index(column) == 0:
        remedy = f"name {' or '.join(map(repr, names[1:])) or 'another column'}"
        raise InputError("column", column, f"be a column of values: the first of {file} holds the times", remedy)
    if column is None and width != 2:
        remedy = f"name one: column = {' or '.join(map(repr, names[1:])) or 'a name in a first line'}"
        raise InputError("sampled", f"{file}: {width} columns", "have two columns, times and values", remedy)
    wanted = 1 if column is None else names.index(column)
    samples: list[tuple[float, float]] = []
    for line, cells in rows:
        # Refused, since its cells may belong to other columns.
        if len(cells) != width:
            remedy = "give every line as many cells as the first"
            raise InputError("sampled", f"{file}, line {line}: {len(cells)} columns", f"have {width} columns", remedy)
        t, value = _number(cells[0]), _number(cells[wanted])
        if t is None or value is None:
            bad = cells[0] if t is None else cells[wanted]
            remedy = "write decimals with a point" if bad else "the cell is empty: fill it, or leave the line out"
            raise InputError("sampled", f"{file}, line {line}: {bad!r}", "be a number", remedy)
        samples.append((t, value))
    return [t for t, _ in samples], [value for _, value in samples]


def split_line(line: str) -> list[str]:
    """Cells of a line between semicolons, tabs, commas or blanks, the first of these that it has."""
    # In this order: beside semicolons or tabs a comma belongs to a number.
    for separator in (";", "\t", ","):
        if separator in line:
            return [cell.strip().strip('"') for cell in line.split(separator)]
    return line.split()


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


_KINDS = {str: "a text", bool: "a truth value", int: "an integer", float: "a number", list: "a list", dict: "a table"}
_WRITTEN = {str: '"..."', bool: "true", int: "1", float: "1.0", list: "[...]", dict: "{ ... }"}


@dataclass
class Reader:
    """Reads one table field by field; every InputError names file, field, value and rule."""

    table: dict[str, Any]
    where: str
    folder: Path | None = None

    def error(self, field: str, value: Any, rule: str, remedy: str) -> InputError:
        """An InputError that names file and table beside the field."""
        return InputError(f"{self.where}: {field}", value, rule, remedy)

    def only(self, known: set[str]) -> None:
        """Raise InputError for a field that is not in ``known``."""
        for key in self.table:
            if key not in known:
                raise self.error(key, self.table[key], "be a known field", near(key, sorted(known)))

    def get(self, field: str, kind: type | tuple[type, ...], rule: str, default: Any = ...) -> Any:
        """The value of ``field``; InputError where it is of another kind, or is not given and has no default."""
        # ... stands for no default, since None is one.
        if field not in self.table:
            if default is ...:
                raise self.error(field, None, f"be given and {rule}", f"write {field} = ...")
            return default
        value = self.table[field]
        # In Python a truth value is an integer.
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            written = _WRITTEN[kind[0] if isinstance(kind, tuple) else kind]
            is_kind = next((name for x, name in _KINDS.items() if isinstance(value, x)), "something else")
            remedy = f"it is {is_kind}: write {field} = {written}"
            raise self.error(field, value, rule, remedy)
        return value

    def line(self, field: str, default: Any = ...) -> str:
        """A text for one line of a terminal, a page or a file name."""
        text = self.get(field, str, "be a string", default)
        if not text.strip() or len(text) > 200 or not text.isprintable():
            raise self.error(field, text, "be 1 to 200 printable letters", "leave control characters out")
        return text

    def number(self, field: str, default: Any = ...) -> Any:
        """A number, or a text that ``build`` checks; InputError for anything else."""
        return self.get(field, (int, float, str), "be a number", default)

    def sub(self, field: str) -> Self | None:
        """The reader of the table ``field``, None where it is not given."""
        table = self.get(field, dict, "be a table", None)
        return None if table is None else type(self)(table, f"{self.where}.{field}", self.folder)

    def tables(self, field: str, example: str) -> list[Self]:
        """A reader for every table of the list ``field``."""
        return self._several(field, self.get(field, list, "be a list of tables", []), example)

    def one_or_several(self, field: str) -> list[Self]:
        """A table, or a list of tables: [problem.field] once or [[problem.field]] once for each."""
        value = self.get(field, (dict, list), "be a table or a list of tables", [])
        if isinstance(value, dict):
            return [type(self)(value, f"{self.where}.{field}", self.folder)]
        return self._several(field, value, "it as { name = value, ... }")

    def _several(self, field: str, tables: list[Any], example: str) -> list[Self]:
        for i, table in enumerate(tables):
            if not isinstance(table, dict):
                raise self.error(f"{field}[{i}]", table, "be a table", f"write {example}")
        return [type(self)(table, f"{self.where}.{field}[{i}]", self.folder) for i, table in enumerate(tables)]

    def polynomial(self, field: str) -> Any:
        """A polynomial profile from its coefficients, None where ``field`` is not given."""
        rule = "be a list of polynomial coefficients, constant first"
        coefficients = self.get(field, list, rule, None)
        if coefficients is None:
            return None
        try:
            return PolynomialProfile(tuple(coefficients))
        except InputError:
            raise self.error(field, coefficients, rule, "for example [0, 0, 1]") from None

    def build(self, make_it: Any, *args: Any, **kwargs: Any) -> Any:
        """``make_it`` with this file named in its InputError."""
        try:
            return make_it(*args, **kwargs)
        except InputError as error:
            raise InputError(f"{self.where}: {error.field}", error.value, error.rule, error.remedy) from None

    def units(self) -> Units:
        """Names of the units of length, time and force."""
        default = dict(zip(("length", "time", "force"), SI, strict=True))
        self.only(set(default))
        return self.build(units_labels, [*(default | self.table).values()])

    def time_function(self, besides: set[str]) -> TimeFunction:
        """The sum, samples or harmonic function that this table describes; ``besides`` are fields of others in it."""
        if "sum" in self.table:
            self.only({"sum"} | besides)
            parts = self.tables("sum", "{ amplitude = ..., frequency = ... }")
            return self.build(Superposition, *(part.time_function(set()) for part in parts))
        if "sampled" in self.table:
            return self.sampled(besides)
        if "constant" in self.table:
            self.only({"constant"} | besides)
            return self.build(Constant, self.number("constant"))
        others = {"constant", "sampled", "sum"}  # for the message: there is none of them here
        self.only({"amplitude", "frequency", "phase"} | others | besides)
        return self.build(Harmonic, self.number("amplitude"), self.number("frequency"), self.number("phase", 0.0))

    def stops(self, besides: set[str]) -> Stops:
        """``position`` is along the beam, the tip where it is left out; ``motion`` is how the stops move."""
        of_law = (*LINEAR, "restitution")
        self.only({"lower", "upper", "stiffness", *of_law} | besides)
        law = {"stiffness": self.number("stiffness")} | {x: self.number(x) for x in of_law if x in self.table}
        motion = self.sub("motion")
        return self.build(
            Stops,
            self.number("lower", None),
            self.number("upper", None),
            position=self.number("position", None),
            motion=None if motion is None else motion.time_function(set()),
            **law,
        )

    def sampled(self, besides: set[str]) -> Sampled:
        """The samples of a file beside the case, or written into it."""
        self.only({"sampled", "kind", "column"} | besides)
        source = self.get("sampled", (str, dict), "be the name of a file, or a table { t = [...], values = [...] }")
        kind = self.get("kind", str, "be 'linear' or 'cubic'", "linear")
        if isinstance(source, str):
            if self.folder is None:
                remedy = "write the samples into the case: sampled = { t = [...], values = [...] }"
                raise self.error("sampled", source, "need no other file here", remedy)
            column = self.get("column", str, "be the name of a column", None)
            return self.build(Sampled, *self.build(read_samples, self.folder / source, column), kind)
        samples = type(self)(source, f"{self.where}.sampled")
        samples.only({"t", "values"})
        t, values = (samples.get(name, list, "be a list of numbers") for name in ("t", "values"))
        return self.build(Sampled, t, values, kind)


FIELDS = {"mass", "stiffness", "damping", "modal_damping", "loads", "contacts", "units"}
LARGE = 2000  # unknowns, from which on it is worth a warning before their dense matrices are made
VECTORS = {"observe", "initial_displacement", "initial_velocity"}
ROW = "be a list of numbers, the name of a file, or a table { unknown = number }, unknowns counted from 0"


class SystemReader(Reader):
    """Reads a system, its loads { row, time function } and its contacts { row, stops, offset }."""

    def model(self) -> System:
        """The system, reduced where the table has ``modes``."""
        if "modes" not in self.table:
            return self.system()
        modes = self.get("modes", int, "be an integer")
        make_it = partial(reduce_model, modes=modes, modal_damping=self._ratio())
        return self._made(make_it, FIELDS | VECTORS | {"modes"})[0]

    def system(self) -> System:
        """The system of the whole table; InputError names the field that is wrong."""
        system: System = self._made(System.from_matrices, FIELDS | VECTORS)
        if "modal_damping" not in self.table:
            return system
        added = self.build(modal_damping, system.mass, system.stiffness, self._ratio())
        return replace(system, damping=system.damping + added)

    def _ratio(self) -> Any:
        return self.get("modal_damping", (int, float, list), "be a ratio or a list of them", 0.0)

    def _made(self, make_it: Any, known: set[str]) -> Any:
        """``make_it`` of the matrices, loads, contacts and vectors of the table, which has no other fields."""
        self.only(known)
        units = self.sub("units")
        mass = self.matrix("mass")
        # Rows need n before the system is built, which refuses a mass of another shape.
        n = mass.shape[0] if mass.ndim == 2 else 0
        if n > LARGE and "modes" not in self.table:
            warnings.warn(f"{self.where}: {n} unknowns take minutes: modes = 40 keeps the slowest", stacklevel=2)
        loads, contacts = (self.one_or_several(name) for name in ("loads", "contacts"))
        return self.build(
            make_it,
            mass,
            self.matrix("stiffness"),
            self.matrix("damping") if "damping" in self.table else None,
            loads=[load.load(n) for load in loads],
            contacts=[contact.contact(n) for contact in contacts],
            **{name: self.row(name, n) for name in sorted(VECTORS & set(self.table))},
            **{} if units is None else {"units": units.units()},
        )

    def matrix(self, field: str) -> Any:
        """A matrix from the file or the list of rows that ``field`` gives."""
        source = self.get(field, (str, list), "be the name of a file, or a list of rows")
        return self.from_file(field, source) if isinstance(source, str) else self.numbers(field, source)

    def row(self, field: str, n: int) -> Any:
        """n numbers, one per unknown."""
        source = self.get(field, (list, str, dict), ROW)
        if isinstance(source, str):
            content = self.from_file(field, source)
            return np.asarray(content.toarray() if hasattr(content, "toarray") else content).ravel()
        if isinstance(source, list):
            return self.numbers(field, source)
        # A table of single entries, the others zero.
        entries = type(self)(source, f"{self.where}.{field}", self.folder)
        row = np.zeros(n)
        for unknown in source:
            if not unknown.isdecimal() or int(unknown) >= n:
                raise self.error(
                    f"{field}.{unknown}", source[unknown], f"be of an unknown from 0 to {n - 1}", "the first is 0"
                )
            row[int(unknown)] = entries.number(unknown)
        return row

    def from_file(self, field: str, name: str) -> Any:
        """The matrix in the file ``name``, in the folder of the case."""
        if self.folder is None:
            raise self.error(field, name, "need no other file here", "write its numbers into the case")
        return self.build(read_matrix, self.folder / name, field)

    def numbers(self, field: str, rows: list[Any]) -> Any:
        """The ``rows`` as a float array; InputError where rows differ in length."""
        try:
            return np.asarray(rows, float)
        except (TypeError, ValueError):
            raise self.error(field, rows, "be numbers, every row as long as the first", "fill rows with 0") from None

    def load(self, n: int) -> tuple[Any, LoadFunction]:
        """(vector, time function) of one load on n unknowns."""
        return self.row("row", n), self.time_function({"row"})

    def contact(self, n: int) -> Contact:
        """One contact on n unknowns, with its stops and the motion of its offset."""
        offset = self.sub("offset")
        return self.build(
            Contact,
            self.row("row", n),
            self.stops({"row", "offset"}),
            None if offset is None else offset.time_function(set()),
        )
