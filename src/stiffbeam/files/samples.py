"""Measured records as text: times and values in columns."""

from __future__ import annotations

from pathlib import Path

from ..basics.validation import InputError, near


def read_samples(file: Path, column: str | None = None) -> tuple[list[float], list[float]]:
    """Times and values from a file of columns between commas, semicolons, tabs or blanks.

    The first column holds the times. ``column`` names that of the values in a first line of names; without it
    there must be two columns. Empty lines and those that begin with # are passed over. Raises InputError naming
    file, line and rule for a file that cannot be read, a line of another length and what is no number.
    """
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("sampled", str(file), "be a readable file beside the case", f"give another: {error}") from None
    rows = [(i + 1, _cells(line)) for i, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    if not rows:
        remedy = "a line holds a time and a value, as in 0.0, 1.5"
        raise InputError("sampled", str(file), "hold two or more lines of numbers", remedy)
    names = [] if _number(rows[0][1][0]) is not None else rows.pop(0)[1]
    width = len(names or rows[0][1]) if rows else 0
    if column is not None and column not in names:
        raise InputError("column", column, f"be a name in the first line of {file}", near(column, names))
    if column is not None and names.count(column) > 1:
        raise InputError("column", column, f"be the name of one column of {file}", "rename the others")
    if column is not None and names.index(column) == 0:
        remedy = f"name {' or '.join(map(repr, names[1:])) or 'another column'}"
        raise InputError("column", column, f"be a column of values: the first of {file} holds the times", remedy)
    if column is None and width != 2:
        remedy = f"name one: column = {' or '.join(map(repr, names[1:])) or 'a name in a first line'}"
        raise InputError("sampled", f"{file}: {width} columns", "have two columns, times and values", remedy)
    wanted = 1 if column is None else names.index(column)
    found: list[tuple[float, float]] = []
    for line, cells in rows:
        if len(cells) != width:
            remedy = "give every line as many cells as the first"
            raise InputError("sampled", f"{file}, line {line}: {len(cells)} columns", f"have {width} columns", remedy)
        t, value = _number(cells[0]), _number(cells[wanted])
        if t is None or value is None:
            bad = cells[0] if t is None else cells[wanted]
            remedy = "write decimals with a point" if bad else "the cell is empty: fill it, or leave the line out"
            raise InputError("sampled", f"{file}, line {line}: {bad!r}", "be a number", remedy)
        found.append((t, value))
    return [t for t, _ in found], [value for _, value in found]


def _cells(line: str) -> list[str]:
    for separator in (";", "\t", ","):
        if separator in line:
            return [cell.strip().strip('"') for cell in line.split(separator)]
    return line.split()


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
