"""A scorecard as a page of HTML."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..basics.storage import write_whole
from ..figures.panels import save_figure, short
from .pictures import score_picture
from .show import COLUMNS, LEGEND, PAST, PAST_TITLE, detail_rows, overview_rows, past_rows, reasons
from .verdicts import NOT_TAKEN, Entry, summary

if TYPE_CHECKING:
    from .scorecard import Scorecard

Row = list[tuple[str, str]]  # text and class of every cell


def html_tables(card: Scorecard) -> str:
    """Table of the scorecard, for a notebook."""
    return _filled(card)


def save_page(card: Scorecard, folder: Path) -> list[Path]:
    """Write index.html, score.json and one picture for each problem that an integrator has taken."""
    pictures: list[Path] = []
    sections: list[dict[str, Any]] = []
    for problem in card.problems:
        entries = [e for e in card.entries if e.problem is problem]
        rows = [[(short(e.integrator), row[0][1]), *row[1:]] for e, row in zip(entries, _rows(entries), strict=True)]
        sections.append({"problem": problem, "rows": rows, "picture": None})
        if any(e.runs for e in entries):
            sections[-1]["picture"] = f"{problem.name}.png"
            pictures.append(save_figure(score_picture(entries), folder / f"{problem.name}.png"))
    records = json.dumps(card.to_dict(), indent=1, allow_nan=False) + "\n"
    page = write_whole(folder / "index.html", _filled(card, sections))
    return [page, write_whole(folder / "score.json", records), *pictures]


def _filled(card: Scorecard, sections: Sequence[dict[str, Any]] | None = None) -> str:
    """page.html with the numbers of the scorecard; its tables alone without ``sections``."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    loader = FileSystemLoader(Path(__file__).parent)
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    if len(card.integrators) == 1:
        headings, rows, legend = list(COLUMNS), _rows(card.entries), ""
    else:
        headings, texts = overview_rows(card)
        rows, legend = [[(text, _kind(text)) for text in row] for row in texts], LEGEND
    return environment.get_template("page.html").render(
        card=card, headings=headings, rows=rows, legend=legend, sections=sections, summary=summary(card.entries),
        reasons=reasons(card), columns=["integrator", *COLUMNS[1:]], past_title=PAST_TITLE, past_columns=PAST,
        past=[[(text, "") for text in row] for row in past_rows(card)],
    ).lstrip()  # fmt: skip


def _rows(entries: Sequence[Entry]) -> list[Row]:
    """Rows of ``detail_rows`` with their classes."""
    kinds = ["flag" if e.flagged else "off" if e.outcome == NOT_TAKEN else "" for e in entries]
    rows = zip(detail_rows(entries), kinds, strict=True)
    return [[*((text, kind) for text in row[:-1]), (row[-1], "outcome")] for row, kind in rows]


def _kind(cell: str) -> str:
    return "flag" if cell.endswith((" !", " <", "failed")) else "off" if cell == "–" else ""
