"""The interface of a study: its question, its points, the rows of one point, answer and picture.

Many rows are kept in columns: a row of numbers takes some bytes more than its numbers, in memory and in the journal.
"""

from __future__ import annotations

import inspect
import json
import re
import sys
from base64 import b64decode, b64encode
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from html import escape
from itertools import accumulate, chain, islice, repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload
from zlib import compress, decompress

import numpy as np
from numpy.typing import NDArray

from ..basics.resources import afford
from ..basics.storage import write_whole
from ..basics.text import cells_of, html_table, plain, several
from ..basics.validation import InputError, integer, one_of, positive
from ..figures.chart import Axis, Panel, Picture, heading, png, render, save_figure, short, with_nan
from ..model.time_functions import covered, stays_at_rest
from ..references import substitute
from ..references.registry import BEST

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from ..files.cases import Case


Row = dict[str, Any]  # plain numbers, strings and lists: what a line of a DataFrame can take
Point = dict[str, Any]  # plain numbers, strings and lists: it is a key in the journal
Rows = Sequence[Row]
LEAST = {"cells": 2} | dict.fromkeys(
    ("members", "starts", "halvings", "impacts", "steps", "per_decade", "count", "divide"), 1
)  # of integer options, by name


def by_contact(rows: Rows) -> dict[str, list[Row]]:
    """The rows of each contact under its place, "" for the only one, else " at contact 1", ...; those without a contact
    belong to all."""
    numbers = sorted({row["contact_number"] for row in rows if "contact_number" in row})
    if len(numbers) < 2:
        return {"": list(rows)}
    return {f" at contact {n}": [row for row in rows if row.get("contact_number", n) == n] for n in numbers}


class Answer(str):
    """The verdict, a sentence that answers the question with numbers, and remarks on it.

    table: the numbers behind it, one flat dictionary a line, texts as they are printed.
    """

    verdict: str
    table: list[dict[str, str]]
    notes: str

    def __new__(cls, verdict: str, table: Sequence[Mapping[str, str]] = (), notes: str = "") -> Answer:
        """The verdict and the notes as one text with its table, whose lines are copied."""
        answer = super().__new__(cls, f"{verdict} {notes}".strip())
        answer.verdict, answer.table, answer.notes = verdict, [dict(line) for line in table], notes
        return answer

    @classmethod
    def of_contacts(cls, answers: Mapping[str, Answer]) -> Answer:
        """Joint answer of those at several contacts, by the place of each; common notes appear once."""

        def joined(texts: Mapping[str, str]) -> str:
            if len(alike := set(texts.values())) == 1:
                return alike.pop()
            return " ".join(f"{place.strip().capitalize()}: {text}" for place, text in texts.items())

        lines = [
            ({"contact": place.removeprefix(" at contact ")} if place else {}) | line
            for place, answer in answers.items()
            for line in answer.table
        ]
        verdicts, notes = ({place: getattr(x, name) for place, x in answers.items()} for name in ("verdict", "notes"))
        return cls(joined(verdicts), lines, joined(notes))

    def worded(self, words: Callable[[str], str]) -> Answer:
        """The answer with every text passed through ``words``."""
        table = [{words(name): words(text) for name, text in line.items()} for line in self.table]
        return Answer(words(self.verdict), table, words(self.notes))

    def text(self) -> str:
        """Verdict, table and notes as lines of plain text."""
        heads, rows = cells_of(self.table)
        cells = [heads, *rows] if heads else []
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in cells]
        return "\n".join(filter(None, [self.verdict, *lines, self.notes]))


@dataclass(frozen=True)
class Study:
    """points(case, **options) -> where to look; evaluate(case, point) -> rows; answer(rows, case) -> verdict and table;
    picture(records) -> panels, declared, see ``figures.chart``.

    ``evaluate`` is a pure function at the top of its module, so that another process can call it. The point's entries,
    without lists, are part of each of its rows. The rows of one point must not depend on the others. Results of all
    rows (a slope, a ranking) belong to ``answer`` and the picture, which are called only if there are rows and get NaN
    for missing entries. The picture's title is the verdict. Texts call the reference "exact"; if an adaptive solution
    replaces the exact one, they get its name.

    ``plan`` fills in and checks the options that several studies share. smoke: options for a run of seconds. measured:
    columns that are seconds of this machine, so points must not run in parallel; every other column has the same bits
    in every run on a machine, interrupted or not. marches: some points run a scheme, so its loop is compiled before any
    of them. needs_stops: the study is about contact. needs_motion: it is about the case's own motion, so that a case at
    rest is refused. all_cores: a point keeps every core busy by itself. each_contact: the answer is given contact by
    contact. of_case: the rows depend on the case. named_by: options whose values are part of the names of the command's
    files.
    """

    name: str
    question: str
    points: Callable[..., list[Point]]
    evaluate: Callable[[Case, Point], list[Row]]
    answer: Callable[[Rows, Case], Answer]
    picture: Callable[[Records], Picture]
    smoke: Mapping[str, Any] = field(default_factory=dict)
    measured: tuple[str, ...] = ()
    marches: bool = True
    needs_stops: bool = False
    needs_motion: bool = False
    all_cores: bool = False
    each_contact: bool = False
    of_case: bool = True
    named_by: tuple[str, ...] = ()

    def plan(self, case: Case, **options: Any) -> list[Point]:
        """The points, after the checks that all studies share; ``dt``, ``t_end`` and ``form`` are the case's where they
        are not given.

        Raises InputError for an option that the study does not have or that is out of range, and for a case without
        the stops or the motion that the study asks about, or whose records end before it does.
        """
        parameters = inspect.signature(self.points).parameters
        known = {name: option.default for name, option in parameters.items() if name != "case"}
        if self.needs_stops and not case.has_stops:
            raise InputError("case", case.name, "have stops", f"{self.command} asks about contact")
        if self.needs_motion and stays_at_rest(case.system()):
            remedy = "give it a base motion, a load or initial data"
            raise InputError("case", f"{case.name}, which starts at rest and which nothing drives", "move", remedy)
        for name in options:
            one_of(f"option of {self.name}", name, known, "be one the study knows")
        options = {name: value for name, value in options.items() if value is not None}
        for name, value in options.items():
            if name in ("dt", "t_end", "courant"):
                positive(name, value)
            elif name in LEAST and (isinstance(known[name], int) or name in ("cells", "divide")):
                for number in value if isinstance(value, (list, tuple)) else [value]:
                    integer(name, number, LEAST[name])
        defaults = {"dt": case.dt, "t_end": case.t_end, "form": case.forms[0]}
        options = {name: value for name, value in defaults.items() if name in known} | options
        if "t_end" in known or self.needs_motion or self.needs_stops:
            covered(case.system(options.get("form")).time_functions, options.get("t_end", case.t_end))
        # Every halving doubles the steps: what takes too long is refused before the first run.
        if "halvings" in known:
            steps = options.get("t_end", case.t_end) / options["dt"]
            halvings = options.get("halvings", known["halvings"])
            seconds = 2e-8 * steps * 2.0 ** min(halvings, 1000)  # 20 ns a step
            afford("halvings", halvings, "take fewer", seconds=seconds)
        return self.points(case, **options)

    @property
    def command(self) -> str:
        """Name of the study on the command line."""
        return self.name.replace("_", "-")


def declared(module: str, question: str, **options: Any) -> Study:
    """Return the study of a module: its points, evaluate, answer and picture, under the module's name.

    module: ``__name__``, in the last statement of the module. options: the other fields of ``Study``.
    """
    parts = vars(sys.modules[module])
    functions = [parts[name] for name in ("points", "evaluate", "answer", "picture")]
    return Study(module.rpartition(".")[2], question, *functions, **options)


@dataclass(frozen=True)
class Records:
    """The rows of a study and the results from them.

    rows: flat dictionaries, a list of up to 10 000. More are a Sequence that keeps them in columns and makes each
    dictionary when it is asked for. A row with ``failed`` has the reason why its point has no result, one with
    ``refused`` the reason why the point is impossible.
    """

    study: Study
    case: Case
    options: dict[str, Any]
    rows: Rows
    seconds: float

    def __repr__(self) -> str:
        rows = several(len(self.rows), "row")
        return f"<Records {self.study.name} of {self.case.name}: {rows}, {len(self.failures)} failed>"

    def __str__(self) -> str:
        missing = [f"{word}: {reason}" for word, reason in self.missing if self.found]
        return "\n".join([self.study.question, self.answer.text(), *missing])

    def _repr_html_(self) -> str:
        answer = self.answer
        heads, rows = cells_of(answer.table)
        notes = [f"<p>{escape(text)}</p>" for text in (answer.verdict, answer.notes) if text]
        return "".join([notes[0], html_table(heads, rows) if rows else "", *notes[1:]])

    def _repr_png_(self) -> bytes:
        return png(self.figure())

    @property
    def answer(self) -> Answer:
        """The verdict with numbers; ``.table`` has them line by line."""
        if not self.found:
            reasons = {row.get("failed") or row["refused"] for row in self.rows}
            return Answer(f"No point could be evaluated: {'; '.join(sorted(reasons))}" if reasons else "No points.")
        parts = by_contact(self.numbers) if self.study.each_contact else {"": self.numbers}
        answer = Answer.of_contacts({place: self.study.answer(group, self.case) for place, group in parts.items()})
        named = answer.worded(self.words)
        if not self._substitute or (str(named), named.table) == (str(answer), answer.table):
            return named
        return Answer(named.verdict, named.table, f"{named.notes} {self._substitute}".strip())

    @cached_property
    def _substitute(self) -> str:
        return substitute(self.case.system(), self.case.t_end) if self.study.of_case else ""

    def words(self, text: str) -> str:
        """A text with the name of the adaptive reference instead of "exact", if it replaces the exact one."""
        return re.sub(r"\bexact\b", short(BEST[1]), text) if self._substitute else text

    @property
    def found(self) -> Rows:
        """The rows of points that were evaluated."""
        return self._found()

    @property
    def failures(self) -> list[Row]:
        """The rows of points that broke off: a run that overflowed, a solver that gave up."""
        return [row for row in self.rows if "failed" in row]

    @property
    def refusals(self) -> list[Row]:
        """The rows of impossible points, such as a misprint that is unstable at that step."""
        return [row for row in self.rows if "refused" in row]

    @property
    def missing(self) -> list[tuple[str, str]]:
        """("failed" or "left out", reason) of the points without a result; a reason that differs in numbers only
        appears once."""
        reasons = [("failed", row["failed"]) for row in self.failures]
        reasons += [("left out", row["refused"]) for row in self.refusals]
        alike: dict[tuple[str, str], list[str]] = {}
        for word, reason in reasons:
            alike.setdefault((word, re.sub(r"[\d.]+(e[+-]?\d+)?", "", reason)), []).append(reason)
        more = {key: f" (and {len(same) - 1} more)" if len(same) > 1 else "" for key, same in alike.items()}
        return [(key[0], same[0] + more[key]) for key, same in alike.items()]

    @property
    def numbers(self) -> Rows:
        """``found`` with NaN where a row has no number."""
        return self._found(with_nan)

    def _found(self, change: Callable[[Row], Row] | None = None) -> Rows:
        """The rows of points that were evaluated, each changed: a list where the rows are one."""
        found = Selection(self.rows, lambda row: "failed" not in row and "refused" not in row, change)
        return list(found) if isinstance(self.rows, list) else found

    def figure(self) -> Figure:
        """The study's picture under its verdict, a matplotlib Figure."""
        verdict = self.answer.verdict
        title = heading(self.case, verdict) if self.study.of_case else verdict
        picture = self.study.picture(self) if self.found else Picture([[Panel("no point", Axis(), Axis(), ())]], 4.0)
        return render(picture, title, self.case.units, self.words)

    def to_dataframe(self) -> pandas.DataFrame:
        """The rows as a pandas table, units in its attrs; needs pandas."""
        import pandas

        frame = pandas.DataFrame(list(self.rows))
        frame.attrs["units"] = asdict(self.case.units)
        return frame

    def to_dict(self) -> dict[str, Any]:
        """Study, options, rows and failures as plain numbers and texts, for JSON.

        measured: the fields, and the columns of rows, that are times of this machine or tell of them. All others
        are equal to the last bit when the command is run again or has been interrupted.
        """
        told = ("answer", "table") if self.study.measured else ()
        return {
            "measured": ["seconds", *told, *(f"rows.{column}" for column in self.study.measured)],
            "study": self.study.name,
            "question": self.study.question,
            "case": self.case.name,
            "units": asdict(self.case.units),
            "options": plain(self.options),
            "answer": str(answer := self.answer),
            "table": answer.table,
            "seconds": round(self.seconds, 3),
            "rows": [plain(row) for row in self.rows],
        }

    def save(self, folder: str | Path, stem: str = "") -> list[Path]:
        """Write <stem>.json, <stem>.csv and <stem>.png into ``folder``; stem: the study's name if none is given."""
        folder, stem = Path(folder), stem or self.study.name
        text = write_whole(folder / f"{stem}.json", json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n")
        table = write_whole(folder / f"{stem}.csv", self.to_dataframe().to_csv(index=False))
        return [text, table, save_figure(self.figure(), folder / f"{stem}.png")]


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
        codes = [place.setdefault(json.dumps(value, default=scalar), len(place)) for value in values]
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
        columns = [[Column.of([scalar(row[name]) for row in some]) for name in names] for names, some in place.items()]
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


def scalar(value: Any) -> Any:
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
    >>> from stiffbeam.studies.interface import Batch, Table
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
