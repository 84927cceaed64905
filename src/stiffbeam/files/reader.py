"""Reading tables of a case file, field by field."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from ..basics.validation import InputError, near
from ..model.contact import Stops
from ..model.contact_law import LINEAR
from ..model.profiles import PolynomialProfile
from ..model.sampled import Sampled
from ..model.time_functions import Constant, Harmonic, Sum, TimeFunction
from .samples import read_samples

_KINDS = {str: "a text", bool: "a truth value", int: "an integer", float: "a number", list: "a list", dict: "a table"}


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
        if field not in self.table:
            if default is ...:
                raise self.error(field, None, f"be given and {rule}", f"write {field} = ...")
            return default
        value = self.table[field]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.error(field, value, rule, f"it is {_KINDS.get(type(value), 'something else')}")
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
        tables = self.get(field, list, "be a list of tables", [])
        for i, table in enumerate(tables):
            if not isinstance(table, dict):
                raise self.error(f"{field}[{i}]", table, "be a table", f"write {example}")
        return [type(self)(table, f"{self.where}.{field}[{i}]", self.folder) for i, table in enumerate(tables)]

    def one_or_several(self, field: str) -> list[Self]:
        """A table, or a list of tables: [problem.field] once or [[problem.field]] once for each."""
        given = self.get(field, (dict, list), "be a table or a list of tables", [])
        if isinstance(given, dict):
            return [type(self)(given, f"{self.where}.{field}", self.folder)]
        for i, table in enumerate(given):
            if not isinstance(table, dict):
                raise self.error(f"{field}[{i}]", table, "be a table", "write it as { name = value, ... }")
        return [type(self)(table, f"{self.where}.{field}[{i}]", self.folder) for i, table in enumerate(given)]

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

    def time_function(self, besides: set[str]) -> TimeFunction:
        """The sum, samples or harmonic function that this table describes; ``besides`` are fields of others in it."""
        if "sum" in self.table:
            self.only({"sum"} | besides)
            parts = self.tables("sum", "{ amplitude = ..., frequency = ... }")
            return self.build(Sum, *(part.time_function(set()) for part in parts))
        if "sampled" in self.table:
            return self.sampled(besides)
        if "constant" in self.table:
            self.only({"constant"} | besides)
            return self.build(Constant, self.number("constant"))
        self.only({"amplitude", "frequency", "phase"} | besides)
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
        given = self.get("sampled", (str, dict), "be the name of a file, or a table { t = [...], values = [...] }")
        kind = self.get("kind", str, "be 'linear' or 'cubic'", "linear")
        if isinstance(given, str):
            if self.folder is None:
                remedy = "write the samples into the case: sampled = { t = [...], values = [...] }"
                raise self.error("sampled", given, "need no other file here", remedy)
            column = self.get("column", str, "be the name of a column", None)
            return self.build(Sampled, *self.build(read_samples, self.folder / given, column), kind)
        samples = type(self)(given, f"{self.where}.sampled")
        samples.only({"t", "values"})
        t, values = (samples.get(name, list, "be a list of numbers") for name in ("t", "values"))
        return self.build(Sampled, t, values, kind)
