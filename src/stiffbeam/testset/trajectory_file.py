"""Reader of a trajectory file that another program wrote."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError

NAMES = {"t": ("t", "time"), "u": ("u", "tip", "displacement"), "v": ("v", "velocity", "tip_velocity")}
COLUMNS = (["t", "u"], ["t", "u", "v"])


def read_trajectory(file: Path) -> tuple[Array, ...]:
    """(t, u), or (t, u, v) where there is a third column; commas, semicolons, tabs or blanks between them.

    A first line may name them, t, u and v (or time, tip or displacement, velocity or tip_velocity) in any order; other
    names are refused, and without names that is the order. Empty lines and those that begin with # are passed over,
    but for names behind the # of the last line before the numbers.
    Raises InputError naming file, line and rule for a file that cannot be read, and for lines that are not two or three
    numbers each.
    """
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("--trajectory", str(file), "be a readable file", f"give another: {error}") from None
    rows: list[list[float]] = []
    names: list[str] = []
    for number, line in enumerate(lines, start=1):
        cells = line.replace(",", " ").replace(";", " ").split()
        if not cells:
            continue
        if line.startswith("#"):
            behind = [_known(cell) for cell in line.lstrip("#").replace(",", " ").replace(";", " ").split()]
            if not rows and sorted(behind) in COLUMNS:
                names = behind
            continue
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            if not rows and not names:
                names = _columns(cells, f"{file}, line {number}")
                continue
            remedy = "for example 0.1, 0.02, 1.5"
            raise InputError("--trajectory", f"{file}, line {number}: {line!r}", "hold numbers", remedy) from None
        if len(row) not in (2, 3) or (rows and len(row) != len(rows[0])):
            rule = "hold t, u and perhaps v, the same in every line"
            empty = any(not cell.strip() for cell in re.split("[,;\t]", line))
            remedy = "a cell is empty: fill it, or leave the line out" if empty else "write the same columns everywhere"
            raise InputError("--trajectory", f"{file}, line {number}: {len(row)} numbers", rule, remedy)
        rows.append(row)
    if len(rows) < 4:
        remedy = "write the run out at more times"
        raise InputError("--trajectory", f"{file}: {len(rows)} lines of numbers", "hold at least 4 of them", remedy)
    if names and len(names) != len(rows[0]):
        raise InputError(
            "--trajectory", f"{file}: {len(names)} names, {len(rows[0])} columns", "name every column", "t, u and v"
        )
    columns = dict(zip(names or "tuv", np.array(rows).T, strict=False))
    return tuple(columns[name] for name in "tuv" if name in columns)


def _known(cell: str) -> str:
    """t, u or v for one of its names, else the cell itself."""
    return next((x for x, names in NAMES.items() if cell.strip("\"'").lower() in names), cell)


def _columns(cells: list[str], where: str) -> list[str]:
    """t, u and v in the order of a line of names."""
    columns = [_known(cell) for cell in cells]
    if sorted(columns) not in COLUMNS:
        raise InputError(
            "--trajectory", f"{where}: {' '.join(cells)!r}", "name t, u and perhaps v, each once", "such as t,u,v"
        )
    return columns
