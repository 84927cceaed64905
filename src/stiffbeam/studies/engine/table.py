"""Rows of a study in columns: a row of numbers takes some bytes more than its numbers, in memory and in the journal."""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from itertools import accumulate, chain, islice, repeat
from typing import Any, overload
from zlib import compress, decompress

import numpy as np
from numpy.typing import NDArray

Row = dict[str, Any]  # plain numbers, strings and lists: what a line of a DataFrame can take
FEW = 64  # rows of a point, below which columns save nothing
CODES = 256  # different values of a column that are counted through in one byte each


class Column:
    """Values of one name, with their types: numbers in an array, or few different values counted through."""

    def __init__(self, codes: NDArray[Any], values: list[Any] | None) -> None:
        self.codes, self.values = codes, values  # values None: the codes are the values

    @classmethod
    def of(cls, values: Sequence[Any]) -> Column:
        """Column of plain values, one or more."""
        kinds = set(map(type, values))
        if kinds == {float}:
            numbers = np.array(values)
            # By their bits: zeros of both signs stay two values, and NaN is equal to itself.
            bits, first, codes = np.unique(numbers.view(np.int64), return_index=True, return_inverse=True)
            if len(bits) > min(CODES, len(values) // 8 + 1):
                return cls(numbers, None)
            return cls.counted(codes, [values[i] for i in first])
        if kinds == {int} and min(values) >= -(2**63) and max(values) < 2**63:
            return cls(np.array(values, np.min_scalar_type(max(values)) if min(values) >= 0 else np.int64), None)
        place: dict[str, int] = {}
        codes = [place.setdefault(json.dumps(value, default=_plain), len(place)) for value in values]
        return cls.counted(np.array(codes), [json.loads(text) for text in place])

    @classmethod
    def counted(cls, codes: NDArray[Any], values: list[Any]) -> Column:
        """Column of few different values, by the place of each; a single one takes no place."""
        dtype = np.min_scalar_type(len(values))
        same = np.broadcast_to(np.zeros((), dtype), codes.shape)
        return cls(codes.astype(dtype) if len(values) > 1 else same, values)

    def __iter__(self) -> Iterator[Any]:
        numbers = self.codes.tolist()
        if self.values is None:
            return iter(numbers)
        return repeat(self.values[0], len(numbers)) if len(self.values) == 1 else map(self.values.__getitem__, numbers)

    def to_json(self) -> list[Any]:
        """The column as JSON: the type of the codes, the codes and the values."""
        # A single value needs no codes.
        codes = b"" if self.values is not None and len(self.values) == 1 else compress(self.codes.tobytes(), 1)
        return [self.codes.dtype.str, b64encode(codes).decode(), self.values]

    @classmethod
    def from_json(cls, column: list[Any], count: int) -> Column:
        """The column of ``count`` values that ``to_json`` wrote. Raises ValueError for another number."""
        dtype, text, values = column
        codes = np.frombuffer(decompress(b64decode(text)), dtype) if text else np.zeros(count, dtype)
        if values is not None and not text:
            return cls.counted(codes, values)
        if len(codes) != count:
            raise ValueError(f"{len(codes)} values for {count} rows")
        return cls(codes, values)


class Batch:
    """Rows of one point by columns. Rows with the same names share their columns."""

    def __init__(self, kinds: NDArray[Any], names: list[list[str]], columns: list[list[Column]]) -> None:
        self.kinds, self.names, self.columns = kinds, names, columns  # the kind of each row, an index into the others

    @classmethod
    def of(cls, rows: Sequence[Row]) -> Batch:
        """Rows of numbers, texts and lists; numbers of NumPy become plain ones."""
        place: dict[tuple[str, ...], list[Row]] = {}
        for row in rows:
            place.setdefault(tuple(row), []).append(row)
        index = {names: i for i, names in enumerate(place)}
        kinds = np.array([index[tuple(row)] for row in rows], np.min_scalar_type(len(place)))
        columns = [[Column.of([_plain(row[name]) for row in some]) for name in names] for names, some in place.items()]
        return cls(kinds, [list(names) for names in place], columns)

    def __len__(self) -> int:
        return len(self.kinds)

    def __iter__(self) -> Iterator[Row]:
        # One iterator for each kind; the list of kinds restores the order of the rows.
        rows = [self._rows_of(kind) for kind in range(len(self.names))]
        return map(next, map(rows.__getitem__, self.kinds.tolist()))

    def _rows_of(self, kind: int) -> Iterator[Row]:
        names = self.names[kind]
        return (dict(zip(names, values, strict=True)) for values in zip(*self.columns[kind], strict=True))

    def to_json(self) -> dict[str, Any]:
        """The batch as JSON."""
        columns = [[column.to_json() for column in some] for some in self.columns]
        return {
            "kinds": Column(self.kinds, None).to_json(),
            "count": len(self),
            "names": self.names,
            "columns": columns,
        }

    @classmethod
    def from_json(cls, entry: dict[str, Any]) -> Batch:
        """The batch that ``to_json`` wrote. Raises ValueError for columns that do not fit together."""
        kinds = Column.from_json(entry["kinds"], entry["count"]).codes
        counts = np.bincount(kinds, minlength=len(entry["names"])).tolist()
        columns = [
            [Column.from_json(column, count) for column in some]
            for some, count in zip(entry["columns"], counts, strict=True)
        ]
        return cls(kinds, entry["names"], columns)


def _plain(value: Any) -> Any:
    """A NumPy scalar as a plain number."""
    return value.item() if isinstance(value, np.generic) else value


class _Rows(Sequence[Row]):
    """Dictionaries that are made when they are asked for."""

    @overload
    def __getitem__(self, i: int) -> Row: ...
    @overload
    def __getitem__(self, i: slice) -> list[Row]: ...
    def __getitem__(self, i: int | slice) -> Row | list[Row]:
        """Row i, or those of a slice as a list."""
        if isinstance(i, slice):
            start, stop, step = i.indices(len(self))
            return list(islice(self, start, stop, step)) if step > 0 else list(self)[i]
        i = i + len(self) if i < 0 else i
        if i >= 0:
            for row in self._from(i):
                return row
        raise IndexError(i)

    def _from(self, i: int) -> Iterator[Row]:
        """The rows from number i >= 0 on."""
        return islice(self, i, None)


class Table(_Rows):
    """Rows of many points, a Sequence of dictionaries that makes each of them when it is asked for.

    Examples
    --------
    >>> from stiffbeam.studies.engine.table import Batch, Table
    >>> table = Table([Batch.of([{"x": 0.5, "n": 1}, {"x": 1.5, "n": 2}]), [{"x": 2.0}]])
    >>> len(table), table[1], [row["x"] for row in table]
    (3, {'x': 1.5, 'n': 2}, [0.5, 1.5, 2.0])
    """

    def __init__(self, parts: Iterable[Batch | list[Row]]) -> None:
        self.parts = list(parts)

    @cached_property
    def _ends(self) -> list[int]:
        return list(accumulate(map(len, self.parts)))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __iter__(self) -> Iterator[Row]:
        return chain.from_iterable(self.parts)

    def _from(self, i: int) -> Iterator[Row]:
        part = bisect_right(self._ends, i)
        before = self._ends[part - 1] if part else 0
        return islice(chain.from_iterable(self.parts[part:]), i - before, None)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sequence) or len(other) != len(self):
            return False
        return all(a == b for a, b in zip(self, other, strict=True))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"<Table: {len(self)} rows of {len(self.parts)} points>"


class Selection(_Rows):
    """Rows of a Sequence that a test keeps, each of them changed, made when they are asked for."""

    def __init__(
        self, rows: Sequence[Row], keep: Callable[[Row], bool], change: Callable[[Row], Row] | None = None
    ) -> None:
        self.rows, self.keep, self.change = rows, keep, change

    def __iter__(self) -> Iterator[Row]:
        kept = filter(self.keep, self.rows)
        return kept if self.change is None else map(self.change, kept)

    @cached_property
    def _count(self) -> int:
        return sum(1 for _ in filter(self.keep, self.rows))

    def __len__(self) -> int:
        return self._count
