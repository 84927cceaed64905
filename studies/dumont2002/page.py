"""The page: one HTML file with everything in it, page.html filled in, written whole or not at all."""

from __future__ import annotations

import base64
import csv
import io
import platform
import re
from collections.abc import Mapping, Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from stiffbeam.basics.storage import write_whole
from stiffbeam.files.cases import paper_cases

from . import no_contact, rows
from .ensembles import PERIODS, PERTURBATION
from .figures import name_of
from .make import Finished
from .reading import Reading
from .sample import of_members
from .table import drive_of
from .typeset import anchor, percent, typeset, written
from .verdicts import FAILS, HOLDS, NOT_MEASURED, OPEN, PARTLY, PLURAL, SCHEME_ONLY, UNTESTABLE

DOI = "10.1016/S0378-4754(02)00003-4"  # by the number printed at the foot of its first page
HERE = Path(__file__).parent
COLOURS = {HOLDS: "holds", PARTLY: "partly", FAILS: "fails", SCHEME_ONLY: "fails"} | dict.fromkeys(
    (OPEN, UNTESTABLE, NOT_MEASURED), "open"
)
KINDS = {".svg": "image/svg+xml", ".png": "image/png", ".gif": "image/gif"}


def write_page(
    file: Path, tables: Mapping[int, Finished], reading: Reading, command: str, across: Mapping[str, Any] | None = None
) -> Path:
    """Tables, what is measured of them, and where it comes from; ``across`` all of them where they are all made.

    across: the rows of claims, misprints, costs and errors without contact, and the pictures of curves, close_up
    and contact_shares.
    """
    numbers = {number: finished.numbers for number, finished in tables.items()}
    exact = [row for found in numbers.values() for row in found["exact"].values()]
    packages = ", ".join(f"{name} {version(name)}" for name in ("stiffbeam", "numpy", "scipy", "matplotlib"))
    context: dict[str, Any] = {
        "tables": tables, "numbers": numbers, "reading": reading, "command": command, "whole": across is not None,
        "known": any(row["digits"] for row in exact), "today": date.today().isoformat(),
        "versions": f"{packages}; Python {platform.python_version()}, {platform.machine()}",
        "style": Markup((HERE / "style.css").read_text(encoding="utf-8")),
    }  # fmt: skip
    if across is not None:
        found = [row["verdict"] for row in across["claims"]]
        shares = [100 * of_members(row, "fraction").mean for row in exact]
        columns = ("section", "claim", "measured", "verdict")
        context |= {
            **across,
            "counts": {x: found.count(x) for x in sorted(set(found), key=lambda x: (-found.count(x), x))},
            "claims_csv": [["section", "the paper says", "measured", "verdict"],
                           *([row[x] for x in columns] for row in across["claims"])],
            "extremes": tuple(f"{which(shares):.2g}" for which in (min, max)),
        }  # fmt: skip
    return write_whole(file, environment().get_template("page.html").render(context).lstrip())


def environment() -> Environment:
    """Templates of this folder with the page's functions and filters."""
    made = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined,
        keep_trailing_newline=True,
    )  # fmt: skip
    functions: dict[str, Any] = {
        "rows": rows, "spread": rows.spread, "parameters": rows.parameters, "legend": rows.legend, "percent": percent,
        "written": written, "title": title, "drive": lambda number: drive_of(paper_cases()[f"table{number}"]),
        "name_of": name_of, "without_contact": no_contact, "PERIODS": PERIODS, "PERTURBATION": PERTURBATION,
        "PLURAL": PLURAL, "COLOURS": COLOURS, "DOI": DOI,
    }  # fmt: skip
    filters: dict[str, Any] = {
        "anchor": anchor, "typeset": typeset, "whole": whole, "parts": rows.parts, "line": line, "data_uri": data_uri,
        "csv_uri": csv_uri,
    }  # fmt: skip
    made.globals.update(functions)
    made.filters.update(filters)
    return made


def title(number: int) -> str:
    """Heading of a table and of its figure."""
    return f"Table {number}, Fig. {number}: {paper_cases()[f'table{number}'].title}"


def line(text: str) -> str:
    """Text in one line."""
    return type(text)(re.sub(r"[ \n]+", " ", text).strip())


def whole(name: str) -> str:
    """A name whose ``3 (4.13)`` or ``|σ|`` no line end divides."""
    return re.sub(r"^(\d+) (?=\()", "\\1\u00a0", name).replace("|σ|", "|\u2060σ\u2060|")


def data_uri(file: Path) -> str:
    """A picture as an address that holds it."""
    return f"data:{KINDS[file.suffix]};base64,{base64.b64encode(file.read_bytes()).decode()}"


def csv_uri(lines: Sequence[Sequence[str]]) -> str:
    """Rows as an address that holds them as CSV."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(lines)
    return f"data:text/csv;charset=utf-8;base64,{base64.b64encode(stream.getvalue().encode()).decode()}"
