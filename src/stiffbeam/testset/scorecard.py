"""The scorecard: all measurements of a score, as records, tables and pictures."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..basics.pictures import DRAW
from . import page, pictures, show
from .problem import VERSION, Problem
from .verdicts import Entry

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import RenderableType


@dataclass(frozen=True, repr=False)
class Scorecard:
    """Entries of a score, integrator by integrator and problem by problem.

    Parameters
    ----------
    entries : sequence of Entry
    version : str
        Version of the test set.
    """

    entries: tuple[Entry, ...]
    version: str = VERSION

    @property
    def flagged(self) -> tuple[Entry, ...]:
        """The entries with wrong results, or that broke off."""
        return tuple(entry for entry in self.entries if entry.flagged)

    @property
    def integrators(self) -> list[str]:
        """The names of the integrators, in the order of the entries."""
        return list(dict.fromkeys(entry.integrator for entry in self.entries))

    @property
    def problems(self) -> list[Problem]:
        """The problems, in the order of the entries."""
        return list({entry.problem.name: entry.problem for entry in self.entries}.values())

    def entry(self, integrator: str, problem: str) -> Entry:
        """One entry by integrator and problem; KeyError if there is none."""
        for each in self.entries:
            if (each.integrator, each.problem.name) == (integrator, problem):
                return each
        raise KeyError((integrator, problem))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and texts, for JSON."""
        return {
            "measured": ["entries.runs.seconds"],
            "test_set": self.version,
            "entries": [entry.to_dict() for entry in self.entries],
        }

    def to_dataframe(self) -> Any:
        """One line per run."""
        from ..basics.text import table

        rows = [
            {"integrator": e.integrator, "problem": e.problem.name, "outcome": e.outcome, "level": r.level,
             "cost": r.cost, "seconds": r.seconds, **asdict(r.errors)}
            for e in self.entries for r in e.runs
        ]  # fmt: skip
        return table({key: [row[key] for row in rows] for key in rows[0]} if rows else {})

    def __repr__(self) -> str:
        counts = f"{len(self.integrators)} integrators, {len(self.problems)} problems, {len(self.flagged)} flagged"
        return f"<Scorecard: {counts}>"

    def __str__(self) -> str:
        from rich.console import Console

        stream = StringIO()
        Console(file=stream, width=self.width).print(self.tables())
        return stream.getvalue().rstrip()

    @property
    def width(self) -> int:
        """Width of the printed table, in characters."""
        return max(150, 24 + 13 * len(self.integrators))

    def tables(self) -> RenderableType:
        """Tables to print: one integrator in detail, several beside each other."""
        return show.detail(self) if len(self.integrators) == 1 else show.overview(self)

    def _repr_html_(self) -> str:
        return page.html_tables(self)

    def plot(self, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
        """Draw the smallest error of every integrator, problem by problem; return ``ax``, or the new Figure. kwargs: of
        ``Axes.plot``."""
        return DRAW["scorecard"](self, ax, **kwargs)

    def figure(self, problem: str) -> Figure:
        """Error against cost on one problem, with its motion."""
        return pictures.score_picture([e for e in self.entries if e.problem.name == problem])

    def save(self, folder: str | Path) -> list[Path]:
        """Write the page index.html, score.json and one picture per problem."""
        return page.save_page(self, Path(folder))
