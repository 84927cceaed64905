"""A scorecard as a page of HTML."""

from __future__ import annotations

import html
import json
from pathlib import Path
from typing import TYPE_CHECKING

from ..basics.whole_file import write_whole
from ..figures.panels import save_figure
from ..figures.style import short
from .pictures import score_picture
from .show import COLUMNS, LEGEND, PAST, PAST_TITLE, detail_rows, overview_rows, past_rows, reasons
from .verdicts import NOT_TAKEN, summary

if TYPE_CHECKING:
    from .scorecard import Scorecard
    from .verdicts import Entry

STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:80rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;font-size:13px;display:block;overflow-x:auto}
th,td{padding:.25rem .6rem;border-bottom:1px solid #ddd;text-align:right;white-space:nowrap}
th:first-child,td:first-child{text-align:left}td.outcome{text-align:left}
.flag{background:#fde2d9}.off{color:#999}img{max-width:100%}h2{margin-top:2.5rem}"""


def html_table(headings: list[str], rows: list[list[str]], classes: list[list[str]] | None = None) -> str:
    """A table whose cells are escaped; classes: one for each cell."""
    head = "".join(f"<th scope=col>{html.escape(x)}</th>" for x in headings)
    body = []
    for i, row in enumerate(rows):
        kinds = classes[i] if classes else [""] * len(row)
        cells = "".join(f'<td class="{kind}">{html.escape(x)}</td>' for x, kind in zip(row, kinds, strict=True))
        body.append(f"<tr>{cells}</tr>")
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"


def html_tables(card: Scorecard) -> str:
    """The table of the scorecard, for a notebook and for the page."""
    if len(card.integrators) == 1:
        rows = detail_rows(card.entries)
        flags = ["flag" if e.flagged else "off" if e.outcome == NOT_TAKEN else "" for e in card.entries]
        return html_table(list(COLUMNS), rows, [[flag] * (len(COLUMNS) - 1) + ["outcome"] for flag in flags])
    headings, rows = overview_rows(card)
    kinds = [[_kind(cell) for cell in row] for row in rows]
    return html_table(headings, rows, kinds) + f"<p>{html.escape(LEGEND)}</p>"


def _kind(cell: str) -> str:
    return "flag" if cell.endswith((" !", " <", "failed")) else "off" if cell == "–" else ""


def save_page(card: Scorecard, folder: Path) -> list[Path]:
    """index.html, score.json and one picture per problem that somebody has taken."""
    pictures, sections = [], []
    for problem in card.problems:
        entries = [e for e in card.entries if e.problem is problem]
        taken = any(e.runs for e in entries)
        if taken:
            pictures.append(save_figure(score_picture(entries), folder / f"{problem.name}.png"))
        sections.append(_section(entries, f"{problem.name}.png" if taken else None))
    lines = "".join(f"<li>{html.escape(line)}</li>" for line in reasons(card))
    past = past_rows(card)
    beyond = f"<h2>{PAST_TITLE}</h2>{html_table(list(PAST), past)}" if past else ""
    page = (
        "<!DOCTYPE html><html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width,initial-scale=1'>"
        f"<title>Scorecard</title><style>{STYLE}</style>"
        f"<h1>Scorecard, test set {card.version}</h1><p>{html.escape(summary(card.entries))}.</p>{html_tables(card)}"
        f"<ul>{lines}</ul>{''.join(sections)}{beyond}</html>\n"
    )
    records = json.dumps(card.to_dict(), indent=1, allow_nan=False) + "\n"
    return [write_whole(folder / "index.html", page), write_whole(folder / "score.json", records), *pictures]


def _section(entries: list[Entry], picture: str | None) -> str:
    """One problem: what it catches, its picture, and a row for each integrator."""
    problem = entries[0].problem
    rows = [[short(e.integrator), *row[1:]] for e, row in zip(entries, detail_rows(entries), strict=True)]
    kinds = [["flag" if e.flagged else ""] * (len(COLUMNS) - 1) + ["outcome"] for e in entries]
    shown = "<p>Nobody has taken it.</p>"
    if picture is not None:
        shown = f'<p><img src="{picture}" alt="error against cost on {problem.name}"></p>'
    title, text = html.escape(problem.title), html.escape(problem.catches)
    table = html_table(["integrator", *COLUMNS[1:]], rows, kinds)
    return f"<h2 id={problem.name}>{title}</h2><p>{text}</p>{shown}{table}"
