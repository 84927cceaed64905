"""Columns of numbers in text files: records of loggers and spreadsheets, and runs of other programs."""

from __future__ import annotations

import csv
import re
import warnings
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from ..basics.arrays import Array
from ..basics.storage import regular_text
from ..basics.text import Units, several
from ..basics.validation import InputError, number, positive

MOST_BYTES = 1 << 28  # of a file of columns
SCALED = {"m", "mm", "cm", "km", "um", "µm", "in", "ft", "deg", "rad", "n", "mn", "kn", "g"}  # units of values
TIMES = "t", "time", "zeit", "temps"  # names of the times, in small letters
COMMA = r"([+-]?\d*),(\d+(?:[eE][+-]?\d+)?)"  # a number with a decimal comma
FIRST = re.compile(r'[\s",;]*[+-]?([.,]?\d|(nan|inf)\b)', re.IGNORECASE)  # number of a line
COMMENT = re.compile(r'[\s"]*[#%]')
STEADY, HOLE = 0.01, 1.5  # in median steps: what equal ones differ by; from where on one is a hole


def read_columns(file: Path, field: str) -> pandas.DataFrame:
    """Table of the numbers in a file.

    Between the cells are semicolons, tabs, commas or blanks; beside all but commas a decimal comma is a point. The
    first line may name the columns, or the last comment before the numbers; comments begin with # or %. Without names
    the columns are 0, 1, 2. A column whose head is empty numbers the rows and is left out. Raises InputError with file,
    line and rule for a line of another length, an empty cell, and what is no finite number.
    """
    remark, rows = "", dict[int, str]()
    for count, line in enumerate(regular_text(field, file, MOST_BYTES).splitlines(), 1):
        if COMMENT.match(line):
            remark = remark if rows else line.lstrip(' "#%')
        elif line.strip():
            rows[count] = line
    first = next(iter(rows), 0)
    head = rows.pop(first) if rows and not FIRST.match(rows[first]) else remark
    if not rows:
        raise InputError(field, str(file), "hold lines of numbers", "write a time and a value a line, as in 0.0, 1.5")
    lines, separator = list(rows), _separator(next(iter(rows.values())))
    try:
        cells = pandas.read_csv(
            StringIO("\n".join(rows.values())), sep=r"\s+" if separator == " " else separator, header=None, dtype=str,
            keep_default_na=False, skipinitialspace=True,
        )  # fmt: skip
    except pandas.errors.ParserError as error:
        found = re.search(r"in line (\d+), saw (\d+)", str(error))  # of those that pandas was given
        where = f"{file}, line {lines[int(found[1]) - 1]}: {found[2]} columns" if found else f"{file}: {error}"
        raise InputError(field, where, "have as many cells in every line", "mend or leave out this line") from None
    if separator != ",":
        cells = cells.replace(rf"^{COMMA}\s*$", r"\1.\2", regex=True)
    values = cells.apply(pandas.to_numeric, errors="coerce").to_numpy(float)
    for row, column in np.argwhere(~np.isfinite(values))[:1]:
        found = f"{file}, line {lines[row]}: {cells.iloc[row, column]!r:.50}"
        raise InputError(field, found, "be a finite number", "write a number into every cell below the names")
    # The csv module reads no cells that are longer.
    heads = csv.reader([head[:100_000].strip(" ")], delimiter=_separator(head), skipinitialspace=True)
    names: list[Any] = [name.strip() for name in next(heads)]
    if len(names) != len(cells.columns) or not any(names):
        if head is not remark:
            rule = f"have as many names as columns, {len(cells.columns)}"
            raise InputError(field, f"{file}: {head!r}", rule, "name every column")
        names = list(cells.columns)
    return pandas.DataFrame(values, columns=pandas.Index(names)).loc[:, [name != "" for name in names]]


def _separator(line: str) -> str:
    """The character between the cells of a line."""
    blanks = line.split()
    spaced = "," not in line or (len(blanks) > 1 and any(re.fullmatch(COMMA, x) for x in blanks) and ", " not in line)
    return next((x for x in ";\t" if x in line), " " if spaced else ",")


def bare(name: Any) -> tuple[str, str]:
    """A name and its unit, in small letters: ("time", "ms") for "Time [ms]", "Time/ms" and "time, ms"."""
    bare_name, *unit = re.split(r"\s*[\[({/,]\s*", str(name).strip().lower(), maxsplit=1)
    return bare_name, "".join(unit).rstrip("])}. ")


def time_of(file: Path, field: str, table: pandas.DataFrame, unit: str | None) -> Any:
    """The column of the times: the one that is named so, without names the first.

    unit: in which times count, None for any. Raises InputError where names have no time or one in another unit, and
    where a first column without a name counts rows.
    """
    named = [name for name in table.columns if bare(name)[0] in TIMES]
    first = table.columns[0]
    if len(named) == 1:
        written = bare(named[0])[1]
        if unit is not None and written not in ("", unit.lower()):
            remedy = f"give time_factor, the {unit} in one {written}" if field == "sampled" else f"write them in {unit}"
            raise InputError(field, f"{file}: {named[0]!r}", f"have its times in {unit}, as the case", remedy)
        return named[0]
    if named or isinstance(first, str):
        found = f"{file}: {', '.join(map(repr, named or table.columns))}"
        remedy = "rename the others" if named else "name the times t; of a file without times give dt and column"
        raise InputError(field, found, "have one column of times", remedy)
    steps, remedy = np.diff(table[first]), "name the columns in a first line, the times t; without times give dt"
    # A run may be written at whole times; another column that increases is the times then.
    if np.all(steps == 1.0) and len(steps) > 2 and (field == "sampled" or np.all(np.diff(table.iloc[:, 1]) > 0.0)):
        raise InputError(field, f"{file}: a first column of row numbers", "have its times first", remedy)
    return first


def read_samples(
    file: Path, column: str | None = None, dt: float | None = None, time_factor: float | None = None,
    start: float | None = None, units: Units = (),
) -> tuple[Array, Array]:  # fmt: skip
    """Times and values of a record, see ``read_columns``.

    column: name of the values; without it there must be one column beside the times. dt: sampling interval of a file
    without times. time_factor: factor on the times; without it a unit in the name of their column must be that of the
    case. start: time of the first sample; the others move with it. units: of length, time and force of the case. Raises
    InputError for columns that are not known to be times and values, and for other units than those of the case.
    """
    table = read_columns(file, "sampled")
    names, time = list(table.columns), None
    unit = None if time_factor is not None else units[1] if units else "s"
    if dt is None or any(bare(x)[0] in TIMES for x in names):
        time = time_of(file, "sampled", table, unit)
        if dt is not None:
            raise InputError("dt", dt, f"be left out where {file} has times, {time!r}", "leave it out")
    others = [x for x in names if x != time]
    column = others[0] if column is None and len(others) == 1 else column
    if others.count(column) != 1:
        remedy = f"it has {', '.join(map(repr, others))}" if others else "of a file without times give dt"
        raise InputError("column", column, f"be the name of one column of values in {file}", remedy)
    scale = re.split(r"[^\w]", bare(column)[1])[0]
    if units and scale in SCALED and scale not in re.split(r"\W", " ".join(units).lower()):
        rule = f"be in the units of the case, {', '.join(units)}"
        raise InputError("column", column, rule, "write its values in these, and these into its name")
    values = table[column].to_numpy(float)
    if time is None:
        return number("start", start or 0.0) + positive("dt", dt) * np.arange(len(values)), values
    t = table[time].to_numpy(float) * (1.0 if time_factor is None else positive("time_factor", time_factor))
    _warn_of_holes(file, t, values)
    return t if start is None else t - t[0] + number("start", start), values


def _warn_of_holes(file: Path, t: Array, values: Array) -> None:
    """Warn where samples are missing from a record at equal steps, unless it is constant across the hole."""
    steps = np.diff(t)
    if len(steps) < 8 or np.mean(np.abs(steps - np.median(steps)) <= STEADY * np.median(steps)) < 0.9:
        return
    holes = np.flatnonzero((steps > HOLE * np.median(steps)) & (np.diff(values) != 0.0))
    if len(holes):
        first = f"from t = {t[holes[0]]:g} to {t[holes[0] + 1]:g}"
        warnings.warn(f"{file}: samples are missing at {several(len(holes), 'place')}, first {first}", stacklevel=4)
