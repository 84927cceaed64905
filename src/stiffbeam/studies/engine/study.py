"""What a study is: a question, the points where it is asked, and what is found at one of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...basics.storage import write_whole
from ...basics.text import plain
from ...references import substitute

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from ...files.cases import Case

Point = dict[str, Any]  # plain numbers, strings and lists: it is a key in the journal
Row = dict[str, Any]  # likewise; what a line of a DataFrame can take
Rows = Sequence[Row]


class Answer(str):
    """A sentence with numbers, and the same as a table: one flat dictionary a line, texts as they are printed.

    rest: what of the sentence does not stand in the table.
    """

    table: list[dict[str, str]]
    rest: str

    def __new__(cls, sentence: str, table: Sequence[Mapping[str, str]] = (), rest: str = "") -> Answer:
        """The sentence with its table, whose lines are copied."""
        answer = super().__new__(cls, sentence)
        answer.table, answer.rest = [dict(line) for line in table], rest
        return answer


@dataclass(frozen=True)
class Study:
    """points(case, **options) -> where to look; evaluate(case, point) -> rows; answer(rows, case) -> a sentence;
    draw(records) -> a picture.

    ``evaluate`` is a pure function at the top of its module, so that another process can call it; the
    point's entries, lists left out, stand in each of its rows. What one point finds must not depend on the
    others; what needs them all (a slope, a ranking) belongs to ``answer`` and the picture.
    smoke: options for a run of seconds. measured: columns that are seconds of this machine, so points must not run
    side by side; every other column has the same bits in every run on a machine, interrupted or not.
    marches: some points run a scheme, so the march is compiled before any of them. needs_stops: it asks about
    contact. needs_motion: about the case's own motion, so that a case at rest is refused. all_cores: a point keeps
    every core busy by itself. named_by: options whose values stand in the names of the command's files.
    """

    name: str
    question: str
    points: Callable[..., list[Point]]
    evaluate: Callable[[Case, Point], list[Row]]
    answer: Callable[[Rows, Case], str]
    draw: Callable[[Records], Figure]
    smoke: Mapping[str, Any] = field(default_factory=dict)
    measured: tuple[str, ...] = ()
    marches: bool = True
    needs_stops: bool = False
    needs_motion: bool = False
    all_cores: bool = False
    named_by: tuple[str, ...] = ()

    @property
    def command(self) -> str:
        """Its name on the command line."""
        return self.name.replace("_", "-")


@dataclass(frozen=True)
class Records:
    """What a study found. rows: flat dictionaries; one with ``failed`` says why its point has nothing else,
    one with ``refused`` why it cannot be asked there."""

    study: Study
    case: Case
    options: dict[str, Any]
    rows: list[Row]
    seconds: float

    def __repr__(self) -> str:
        return f"<Records {self.study.name} of {self.case.name}: {len(self.rows)} rows, {len(self.failures)} failed>"

    def __str__(self) -> str:
        return f"{self.study.question}\n{self.answer}"

    @property
    def answer(self) -> Answer:
        """The answer in a sentence or two, with numbers; ``.table`` is the same line by line."""
        if not self.found:
            reasons = {row.get("failed") or row["refused"] for row in self.rows}
            nothing = "No point could be evaluated"
            return Answer(f"{nothing}: " + "; ".join(sorted(reasons)), rest=nothing)
        answer = self.study.answer(self.found, self.case)
        answer = answer if isinstance(answer, Answer) else Answer(answer, rest=answer)
        if "exact" not in answer or not (note := substitute(self.case.system(), self.case.t_end)):
            return answer
        return Answer(f"{answer} {note}", answer.table, f"{answer.rest} {note}")

    @property
    def found(self) -> list[Row]:
        """The rows of points that were evaluated."""
        return [row for row in self.rows if "failed" not in row and "refused" not in row]

    @property
    def failures(self) -> list[Row]:
        """The rows of points that broke off: a run that overflowed, a solver that gave up."""
        return [row for row in self.rows if "failed" in row]

    @property
    def refusals(self) -> list[Row]:
        """The rows of points that cannot be asked, as a misprint that grows at that step."""
        return [row for row in self.rows if "refused" in row]

    def figure(self) -> Figure:
        """The study's picture, a matplotlib Figure."""
        return self.study.draw(self)

    def to_dataframe(self) -> pandas.DataFrame:
        """The rows as a pandas table, units in its attrs; needs pandas."""
        import pandas

        frame = pandas.DataFrame(self.rows)
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
            "rows": plain(self.rows),
        }

    def save(self, folder: str | Path, stem: str = "") -> list[Path]:
        """Write <stem>.json, <stem>.csv and <stem>.png into ``folder``; stem: the study's name if none is given."""
        from ...figures import save_figure

        folder, stem = Path(folder), stem or self.study.name
        text = write_whole(folder / f"{stem}.json", json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n")
        table = write_whole(folder / f"{stem}.csv", self.to_dataframe().to_csv(index=False))
        return [text, table, save_figure(self.figure(), folder / f"{stem}.png")]
