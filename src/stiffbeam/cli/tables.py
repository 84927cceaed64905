"""Tables of a command. One that is wider than the terminal is printed in parts, so that no number is broken."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

from ..basics.text import cells_of

if TYPE_CHECKING:
    from rich.table import Table

NAME = 36  # characters of a first column that are not broken
EDGES = 1  # columns of both edges, less one separator


def table_of(lines: Sequence[Mapping[str, str]], width: float = math.inf) -> Table:
    """A table of lines, text by heading; – for empty entries. Columns of numbers stand to the right.

    In one that is wider than ``width``, headings are broken between words, and texts, but no numbers.
    """
    from rich import box
    from rich.table import Table

    headings, rows = cells_of(lines)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=0)
    columns = list(zip(*rows, strict=True))
    room = width - EDGES
    narrow = sum(max(map(len, [name, *cells])) + 1 for name, cells in zip(headings, columns, strict=True)) > room
    rest = sum(_least(name, cells) + 1 for name, cells in zip(headings[1:], columns[1:], strict=True))
    for i, (name, cells) in enumerate(zip(headings, columns, strict=True)):
        number, whole = _numbers(cells), not i and max(map(len, cells)) <= min(NAME, room - rest)
        head = "\n".join(wrap(name, _least(name, cells), break_on_hyphens=False)) if narrow and number else name
        side = "right" if number else "left"
        table.add_column(head, justify=side, overflow="fold", no_wrap=whole or (narrow and number))
    for row in rows:
        table.add_row(*row)
    return table


def tables_of(lines: Sequence[Mapping[str, str]], width: int) -> list[Table]:
    """``table_of``, in several tables where one would be too wide. Each begins with the columns that name its lines."""
    headings, rows = cells_of(lines)
    columns = dict(zip(headings, zip(*rows, strict=True), strict=True))
    least = {name: _least(name, cells) + 1 for name, cells in columns.items()}
    # The first texts, and the numbers before them.
    numbers = [_numbers(cells) for cells in columns.values()]
    first = numbers.index(False) if False in numbers else 0
    end = numbers.index(True, first + 1) if True in numbers[first + 1 :] else len(numbers)
    names, parts = headings[:end], [list[str]()]
    for name in headings[end:]:
        if parts[-1] and sum(least[x] for x in (*names, *parts[-1], name)) > width - EDGES:
            parts.append([])
        parts[-1].append(name)
    return [table_of([{x: line[x] for x in (*names, *part) if x in line} for line in lines], width) for part in parts]


def _numbers(cells: Sequence[str]) -> bool:
    return any(cell.removeprefix("≤ ")[:1] in "+-0123456789" for cell in cells if cell)


def _least(heading: str, cells: Sequence[str]) -> int:
    """Width of a column whose texts are broken between words, and whose numbers are not broken."""
    texts = cells if _numbers(cells) else [word for cell in cells for word in cell.split()]
    return max(map(len, [*texts, *heading.split()]), default=0)
