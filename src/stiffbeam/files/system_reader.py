"""[case.system]: a model of anyone's own by its matrices, written into the case or in files beside it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..model.contact import Contact
from ..model.system import System
from ..model.time_functions import LoadFunction
from .matrices import read_matrix
from .reader import Reader

FIELDS = {"mass", "stiffness", "damping", "loads", "contacts", "observe", "initial_displacement", "initial_velocity"}
ROW = "be a list of numbers, the name of a file, or a table { unknown = number }, unknowns counted from 0"


class SystemReader(Reader):
    """Reads a system, its loads { row, time function } and its contacts { row, stops, offset }."""

    def system(self) -> System:
        """The system of the whole table; InputError names the field that is wrong."""
        self.only(FIELDS)
        mass = self.matrix("mass")
        n = mass.shape[0] if mass.ndim == 2 else 0
        loads, contacts = (self.one_or_several(name) for name in ("loads", "contacts"))
        return self.build(
            System.from_matrices,
            mass,
            self.matrix("stiffness"),
            self.matrix("damping") if "damping" in self.table else None,
            loads=[load.load(n) for load in loads],
            contacts=[contact.contact(n) for contact in contacts],
            **{
                name: self.row(name, n)
                for name in ("observe", "initial_displacement", "initial_velocity")
                if name in self.table
            },
        )

    def matrix(self, field: str) -> Any:
        """A matrix from the file or the list of rows that ``field`` gives."""
        given = self.get(field, (str, list), "be the name of a file, or a list of rows")
        return self.from_file(field, given) if isinstance(given, str) else self.numbers(field, given)

    def row(self, field: str, n: int) -> Any:
        """n numbers, one per unknown."""
        given = self.get(field, (list, str, dict), ROW)
        if isinstance(given, str):
            found = self.from_file(field, given)
            return np.asarray(found.toarray() if hasattr(found, "toarray") else found).ravel()
        if isinstance(given, list):
            return self.numbers(field, given)
        entries = type(self)(given, f"{self.where}.{field}", self.folder)
        row = np.zeros(n)
        for unknown in given:
            if not unknown.isdecimal() or int(unknown) >= n:
                raise self.error(
                    f"{field}.{unknown}", given[unknown], f"be of an unknown from 0 to {n - 1}", "the first is 0"
                )
            row[int(unknown)] = entries.number(unknown)
        return row

    def from_file(self, field: str, name: str) -> Any:
        """The matrix in the file ``name``, in the folder of the case."""
        if self.folder is None:
            raise self.error(field, name, "need no other file here", "write its numbers into the case")
        return self.build(read_matrix, self.folder / name)

    def numbers(self, field: str, given: list[Any]) -> Any:
        """The list ``given`` as a float array; InputError where rows differ in length."""
        try:
            return np.asarray(given, float)
        except (TypeError, ValueError):
            raise self.error(field, given, "be numbers, every row as long as the first", "fill rows with 0") from None

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
