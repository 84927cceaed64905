"""Columns of numbers in text files: records of loggers and spreadsheets, and runs of other programs."""

from __future__ import annotations

import csv
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from ..basics.arrays import Array
from ..basics.storage import regular_text
from ..basics.text import Units
from ..basics.validation import InputError, number, positive

MOST_BYTES = 1 << 28  # of a file of columns
UNITS = {  # in seconds
    "ns": 1e-9, **dict.fromkeys(("us", "µs", "μs"), 1e-6), **dict.fromkeys(("ms", "msec", "milliseconds"), 1e-3),
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0), **dict.fromkeys(("min", "minutes"), 60.0),
    **dict.fromkeys(("h", "hours"), 3600.0),
}  # fmt: skip
SCALED = {"m", "mm", "cm", "km", "um", "µm", "in", "ft", "deg", "rad", "n", "mn", "kn", "g"}  # units of values
# Names of the times, in small letters; "min" may be a minimum.
TIMES = ("t", "time", "timestamp", "zeit", "temps", "tiempo", "tempo", *sorted(UNITS.keys() - {"s", "min", "h"}))
NAMED_TIME = re.compile(rf"({'|'.join(TIMES)})[\s_]+(?:in\s+)?([^\s\[({{/]\S*)")
NAMED = re.compile(r"(.*?)(?:\s*[\[({/,]\s*(.*?)[\])}.\s]*)?")
COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")  # a number with a decimal comma
STEADY, HOLE = 0.01, 1.5  # in median steps: what equal ones differ by; from where on one is a hole


def read_columns(file: Path, field: str) -> pandas.DataFrame:
    """Table of the numbers in a file, each row under the number of its line.

    Between the cells are semicolons, tabs, commas or blanks; beside all but commas a decimal comma is a point. The
    first line may name the columns, or the last comment before the numbers; comments begin with # or %. Without names
    the columns are 0, 1, 2. A column whose head is empty numbers the rows and is left out. Raises InputError with file,
    line and rule for a line of another length, an empty cell, and what is no finite number.
    """
    remark, lines, numbers = "", list[str](), list[int]()
    for count, line in enumerate(regular_text(field, file, MOST_BYTES).splitlines(), 1):
        if line.lstrip(' "')[:1] in ("#", "%"):
            remark = remark if lines else line.lstrip(' "#%')
        elif line.strip():
            lines.append(line)
            numbers.append(count)
    if not lines:
        remedy = "a line holds a time and a value, as in 0.0, 1.5"
        raise InputError(field, str(file), "hold two or more lines of numbers", remedy)
    separator = _separator(lines[min(1, len(lines) - 1)])  # behind a line of names
    cells = [_cells(line, separator) for line in lines]
    names: list[Any] = []
    if _float(next((cell for cell in cells[0] if cell), "")) is None:
        names, cells, numbers = _cells(lines[0], _separator(lines[0])), cells[1:], numbers[1:]
    elif remark and len(behind := _cells(remark, _separator(remark))) == len(cells[0]):
        names = behind
    width = len(names) or len(cells[0])
    if names and not cells:
        raise InputError(field, str(file), "hold lines of numbers below their names", "write a time and a value a line")
    for line, row in zip(numbers, cells, strict=True):
        if len(row) != width:  # its cells may belong to other columns
            remedy = "name every column" if names else "give every line as many cells as the first"
            raise InputError(field, f"{file}, line {line}: {len(row)} columns", f"have {width} columns", remedy)
    table = pandas.DataFrame(cells, index=numbers, columns=range(width), dtype=str)
    values = table.apply(pandas.to_numeric, errors="coerce").astype(float)
    bad = np.argwhere(~np.isfinite(values.to_numpy()))
    if len(bad):
        row, column = bad[0]
        cell, line = cells[row][column], numbers[row]
        remedy = "write a number" if cell else "a cell is empty: fill it, or leave the line out"
        if names and not row and _float(cell) is None and cell:
            remedy = "leave out all but one line of names: each other line holds numbers, as in 0.0, 1.5"
        raise InputError(field, f"{file}, line {line}: {cell!r}", "be a finite number", remedy)
    values.columns = pandas.Index(names or range(width))
    return values.loc[:, [name not in ("", "Unnamed: 0") for name in values.columns]]


def _separator(line: str) -> str:
    """The character between the cells of a line."""
    blanks = line.split()
    spaced = "," not in line or (len(blanks) > 1 and any(map(COMMA.fullmatch, blanks)) and ", " not in line)
    return next((x for x in ";\t" if x in line), " " if spaced else ",")


def _cells(line: str, separator: str) -> list[str]:
    """The cells of a line, with points in place of decimal commas."""
    line = " ".join(line.split()) if separator == " " else line
    try:
        cells = [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    except csv.Error:  # a cell longer than any number: the line as one cell is refused with its number
        return [line]
    return [x.replace(",", ".") if separator != "," and COMMA.fullmatch(x) else x for x in cells]


def _float(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def bare(name: Any) -> tuple[str, str]:
    """A name and its unit, in small letters: ("time", "ms") for "Time [ms]", "Time/ms", "time_ms" and "Time in ms"."""
    text = str(name).strip().lower()
    parts = NAMED_TIME.fullmatch(text) or NAMED.fullmatch(text)
    assert parts is not None
    return parts[1], parts[2] or (parts[1] if parts[1] in UNITS else "")


def time_of(file: Path, field: str, table: pandas.DataFrame) -> Any:
    """The column of the times: the one that is named so, without names the first. Raises InputError where names have
    no time, and where a first column without a name does not increase or counts rows."""
    named = [name for name in table.columns if bare(name)[0] in TIMES]
    if len(named) == 1:
        return named[0]
    first = table.columns[0]
    if named or isinstance(first, str):
        found = f"{file}: {', '.join(map(repr, named or table.columns))}"
        remedy = "rename the others" if named else "name the times t; of a file without times give dt and column"
        raise InputError(field, found, "have one column of times", remedy)
    steps, remedy = np.diff(table[first]), "name the columns in a first line, the times t; without times give dt"
    if not np.all(steps >= 0.0):
        raise InputError(field, f"{file}: a first column that decreases", "have its times first, sorted", remedy)
    # A run may be written at whole times; another column that increases is the times then.
    if np.all(steps == 1.0) and len(steps) > 2 and (field == "sampled" or np.all(np.diff(table.iloc[:, 1]) > 0.0)):
        raise InputError(field, f"{file}: a first column of row numbers", "have its times first", remedy)
    return first


def factor_of(time: Any, unit: str) -> float:
    """Factor on the times of a column, whose name may have a unit, to those of a case in this unit, "" for none.

    Raises InputError for a unit that is none of time, and for all but seconds where the case has no unit.
    """
    written = bare(time)[1]
    if not written or written == unit:
        return 1.0
    factor = UNITS.get(written, 0.0) / UNITS.get(unit or "s", np.inf)
    if not factor or (not unit and factor != 1.0):
        rule = f"be given for times in {written}" + f" where the case counts in {unit}" * bool(unit)
        remedy = f"write one of {', '.join(UNITS)} into the name {time!r}, or give it"
        if factor:
            remedy = f"give time_factor = {factor:g} for seconds, 1 for {written}, or the case its units"
        raise InputError("time_factor", None, rule, remedy)
    return factor


def read_samples(
    file: Path, column: str | None = None, dt: float | None = None, time_factor: float | None = None,
    start: float | None = None, units: Units = (),
) -> tuple[Array, Array]:  # fmt: skip
    """Times and values of a record, see ``read_columns``.

    Parameters
    ----------
    column : str, optional
        Name of the values; without it there must be one column beside the times.
    dt : float, optional
        Sampling interval of a file without times.
    time_factor : float, optional
        Factor on the times of the file, by default that from the unit in the name of their column to that of the case.
    start : float, optional
        Time of the first sample; the others move with it.
    units : tuple, optional
        Units of length, time and force of the case.

    Raises
    ------
    InputError
        For what cannot be read, for columns that are not known to be times and values, for an unknown unit of time, and
        for values in other units than those of the case.
    """
    table = read_columns(file, "sampled")
    names = list(table.columns)
    time = None if dt is not None and not any(bare(x)[0] in TIMES for x in names) else time_of(file, "sampled", table)
    if dt is not None and time is not None:
        raise InputError("dt", dt, f"be left out where {file} has times, {time!r}", "leave it out")
    others = [x for x in names if x != time]
    if column is None:
        if len(others) != 1 or names.count(others[0]) > 1:
            named = " or ".join(repr(x) for x in others if isinstance(x, str)) or "a name in a first line"
            found, remedy = f"{file}: {len(names)} columns", "give dt, the sampling interval"
            remedy = f"name one: column = {named}" if others else remedy
            raise InputError("sampled", found, "have two columns, times and values", remedy)
        column = others[0]
    elif others.count(column) != 1:
        remedy = f"the file has {', '.join(map(str, others)) or 'none'}"
        raise InputError("column", column, f"be the name of one column of values in {file}", remedy)
    scale = re.split(r"[^\w]", bare(column)[1])[0]
    if units and scale in SCALED and scale not in re.split(r"\W", " ".join(units).lower()):
        rule = f"be in the units of the case, {', '.join(units)}"
        raise InputError("column", column, rule, "write its values in these, and these into its name")
    values = table[column].to_numpy(float)
    if time is None:
        return number("start", start or 0.0) + positive("dt", dt) * np.arange(len(values)), values
    factor = factor_of(time, units[1] if units else "") if time_factor is None else positive("time_factor", time_factor)
    t = table[time].to_numpy(float) * factor
    t = t if start is None else t - t[0] + number("start", start)
    _warn_of_holes(file, t, values)
    return t, values


def _warn_of_holes(file: Path, t: Array, values: Array) -> None:
    """Warn where samples are missing from a record at equal steps, unless it is constant across the hole."""
    steps = np.diff(t)
    if len(steps) < 8 or not (median := float(np.median(steps))) > 0.0:
        return
    wide = (steps > HOLE * median) & (np.diff(values) != 0.0)
    if np.any(wide) and np.mean(np.abs(steps - median) <= STEADY * median) > 0.9:
        first = int(np.argmax(wide))
        holes = f"{np.count_nonzero(wide)} holes, the first" if np.count_nonzero(wide) > 1 else "a hole"
        warnings.warn(f"{file}: {holes} from t = {t[first]:g} to {t[first + 1]:g}: it is filled in by its kind, "
                      "linear or cubic", stacklevel=4)  # fmt: skip
