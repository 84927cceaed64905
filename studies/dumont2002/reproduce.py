"""Everything of the paper: the tables, what is measured across them, and the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stiffbeam.basics.validation import InputError
from stiffbeam.figures.chart import save_figure

from .claims import judged
from .costs import costs
from .ensembles import EXACT_MEMBERS, MEMBERS
from .evidence import Evidence
from .figures import shares
from .make import TABLES, Finished, make_tables, store, stored
from .misprints import measured
from .no_contact import error_curves, in_time, whole
from .numbers import exact_name as exact_name
from .page import write_page
from .reading import Reading
from .reading import reading as reading

PAGE = "index.html"


def reproduce(
    tables: Sequence[int] | None,
    reading: Reading,
    out: Path,
    jobs: int = 2,
    members: int = MEMBERS,
    exact_members: int = EXACT_MEMBERS,
    command: str = "python -m dumont2002",
) -> tuple[Path, dict[int, Finished]]:
    """Make ``tables``, None for all of them and everything else of the paper; returns (page, tables).

    Everything finished stands in ``out`` and is taken from there by the next call; see ``make_tables``.
    The claims need every table and are judged with all of them only. Raises InputError.
    """
    wanted = list(TABLES if tables is None else tables)
    for number in wanted:
        if number not in TABLES:
            remedy = "`stiffbeam cases` lists them"
            raise InputError("table", number, f"be one of the paper's, {TABLES[0]} to {TABLES[-1]}", remedy)
    made = make_tables(wanted, reading, out, jobs, members, exact_members)
    across = None
    if tables is None:
        options = reading.to_dict() | {"members": members, "exact_members": exact_members}
        across = _across(made, reading, out / reading.name, options)
    return write_page(out / PAGE, made, reading, command, across), made


def _across(made: dict[int, Finished], reading: Reading, folder: Path, options: dict[str, Any]) -> dict[str, Any]:
    """Measurements of all tables together for ``write_page``, stored part by part."""
    numbers = {number: finished.numbers for number, finished in made.items()}
    pictures = [folder / name for name in ("no-contact-error.svg", "no-contact-in-time.svg")]

    def rows(part: str, make: Callable[[], list[dict[str, Any]]], again: bool = False) -> list[dict[str, Any]]:
        """Rows of a finished ``part``, else, or once more, those that ``make`` gives."""
        file = folder / f"{part.replace(' ', '-').lower()}.json"
        found = stored(file, options)
        return store(file, options, make()) if found is None or again else found

    def errors() -> list[dict[str, Any]]:
        curves = error_curves(reading)
        for file, draw in zip(pictures, (whole, in_time), strict=True):
            save_figure(draw(curves), file)
        return [{"name": c.name, "error": float(np.max(c.error)), "in_time": float(np.max(c.in_time))} for c in curves]

    timed = rows("CPU time", lambda: costs(list(made), reading))
    return {
        "costs": timed,
        "claims": rows("claims", lambda: list(judged(Evidence(numbers, timed, reading)))),
        "errors": rows("section 5.1", errors, again=not all(file.is_file() for file in pictures)),
        "misprints": rows("misprints", lambda: list(measured())),
        "curves": pictures,
        "close_up": folder / "table10" / "close-up.svg",
        "contact_shares": save_figure(shares(numbers), folder / "contact-shares.svg"),
    }
