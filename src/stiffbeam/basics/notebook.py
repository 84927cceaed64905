"""Results in a notebook: tables in HTML, and pictures, which objects call by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import Any


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> str:
    """A table with a line of heads; the first cell of a row is its name, the others are to the right.

    >>> html_table(["run", "impacts"], [["HHT(alpha=-0.1)", "53"]]).count("<td")
    1
    """
    parts = ['<table class="stiffbeam">']
    if caption:
        parts.append(f'<caption style="text-align:left">{escape(caption)}</caption>')
    if heads:
        parts.append(f"<thead><tr>{''.join(f'<th>{escape(head)}</th>' for head in heads)}</tr></thead>")
    parts.append("<tbody>")
    for name, *cells in rows:
        columns = "".join(f'<td style="text-align:right">{escape(cell)}</td>' for cell in cells)
        parts.append(f'<tr><th style="text-align:left">{escape(name)}</th>{columns}</tr>')
    return "".join([*parts, "</tbody></table>"])


def html_facts(title: str, facts: Iterable[tuple[str, str]]) -> str:
    """A table of names and values under a title; facts without a value are left out."""
    return html_table([], [(name, value) for name, value in facts if value], title)


DRAW: dict[str, Callable[..., Any]] = {}  # by name: "run", "comparison", "film"
