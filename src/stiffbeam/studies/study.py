"""What a study is: a question, the points where it is asked, and what is found at one of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..cases import Case
from ..plain import plain

if TYPE_CHECKING:
    import pandas

Point = dict[str, Any]  # plain numbers, strings and lists: it is a key in the journal
Row = dict[str, Any]  # likewise; what a line of a DataFrame can take
Rows = Sequence[Row]


@dataclass(frozen=True)
class Study:
    """points(case, **options) -> where to look; evaluate(case, point) -> rows; answer(rows) -> a sentence.

    ``evaluate`` is a pure function at the top of its module, so that another process can call it; the
    point's entries, lists left out, stand in each of its rows. What one point finds must not depend on the others; what
    needs them all (a slope, a ranking) belongs to ``answer`` and the picture. smoke: options for a run
    of seconds. timed: the rows hold seconds, so points must not run side by side.
    """

    name: str
    question: str
    points: Callable[..., list[Point]]
    evaluate: Callable[[Case, Point], list[Row]]
    answer: Callable[[Rows], str]
    smoke: Mapping[str, Any] = field(default_factory=dict)
    timed: bool = False


@dataclass(frozen=True)
class Records:
    """What a study found. rows: flat dictionaries; one with ``failed`` says why its point has nothing else."""

    study: Study
    case: Case
    options: dict[str, Any]
    rows: list[Row]
    seconds: float

    @property
    def answer(self) -> str:
        """The answer in a sentence or two, with numbers."""
        found = [row for row in self.rows if "failed" not in row]
        failed = {row["failed"] for row in self.rows if "failed" in row}
        if not found:
            return "No point could be evaluated: " + "; ".join(sorted(failed))
        return self.study.answer(found)

    @property
    def failures(self) -> list[Row]:
        return [row for row in self.rows if "failed" in row]

    def figure(self):
        """The study's picture, a matplotlib Figure."""
        from importlib import import_module

        return import_module(f"..figures.{self.study.name}", __package__).draw(self)

    def to_dataframe(self) -> pandas.DataFrame:
        import pandas

        return pandas.DataFrame(self.rows)

    def to_dict(self) -> dict[str, Any]:
        return {
            "study": self.study.name,
            "question": self.study.question,
            "case": self.case.name,
            "options": plain(self.options),
            "answer": self.answer,
            "seconds": round(self.seconds, 3),
            "rows": plain(self.rows),
        }

    def save(self, folder: str | Path, stem: str = "") -> list[Path]:
        """Write <stem>.json, <stem>.csv and <stem>.png into ``folder``; stem: the study's name if none is given."""
        from ..figures import save_figure

        folder, stem = Path(folder), stem or self.study.name
        folder.mkdir(parents=True, exist_ok=True)
        text = folder / f"{stem}.json"
        text.write_text(json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n", encoding="utf-8")
        table = folder / f"{stem}.csv"
        self.to_dataframe().to_csv(table, index=False)
        return [text, table, save_figure(self.figure(), folder / f"{stem}.png")]
