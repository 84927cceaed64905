"""reproduce: the tables, what is measured across them, and the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stiffbeam.basics.plain import plain
from stiffbeam.basics.validation import InputError
from stiffbeam.figures import save_figure
from stiffbeam.files.cases import paper_case
from stiffbeam.studies.engine.journal import Journal

from . import claims_section, sections
from .claims import judged
from .costs import costs
from .ensembles import EXACT_MEMBERS, MEMBERS
from .evidence import Evidence
from .html import Html
from .make import SOURCE, TABLES, Finished, Progress, make_tables
from .misprints import measured
from .no_contact import error_curves, in_time, whole
from .numbers import exact_name as exact_name
from .page import Section, write_page
from .reading import Reading
from .reading import reading as reading
from .resting import shares

PAGE = "index.html"


def reproduce(
    tables: Sequence[int] | None,
    reading: Reading,
    out: Path,
    jobs: int = 2,
    members: int = MEMBERS,
    exact_members: int = EXACT_MEMBERS,
    progress: Progress = lambda what, done, total: None,
    command: str = "stiffbeam reproduce",
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
    made = make_tables(wanted, reading, out, jobs, members, exact_members, progress)
    numbers = {number: finished.numbers for number, finished in made.items()}
    across = _Across(out / reading.name, reading, {"members": members, "exact_members": exact_members}, progress)
    before: list[Section] = []
    totals: Html | str = ""
    after: list[Section] = [
        ("Impacts and contact", sections.impacts(numbers)),
        ("Spectra", sections.spectra(numbers)),
    ]
    if tables is None:
        timed = across.rows("CPU time", lambda: costs(wanted, reading))
        claims = across.rows("claims", lambda: list(judged(Evidence(numbers, timed, reading))))
        totals = claims_section.totals(claims)
        before = [
            ("What the paper could not see", _punch_line(across.folder, made)),
            ("How the paper is read", sections.how_read(reading)),
            ("Claims", claims_section.claims(claims)),
            ("Section 5.1: without contact", _no_contact(across)),
        ]
        after += [
            ("CPU time", sections.cpu(timed)),
            ("Misprints", sections.misprints(across.rows("misprints", lambda: list(measured())))),
        ]
    else:
        before = [("How the paper is read", sections.how_read(reading))]
    progress("writing the page", 0, 0)
    return write_page(out / PAGE, made, reading, before, after, command, totals), made


class _Across:
    """What is measured across the tables, journalled part by part."""

    def __init__(self, folder: Path, reading: Reading, options: dict[str, Any], progress: Progress) -> None:
        self.folder, self.reading, self.options, self.progress = folder, reading, options, progress
        self.journal = Journal(folder / "journal", f"reproduce-across-{SOURCE}", paper_case(10))

    def rows(self, part: str, make: Callable[[], list[dict[str, Any]]]) -> list[dict[str, Any]]:
        """The rows of a finished ``part``, else those that ``make`` gives."""
        point = self.reading.to_dict() | self.options | {"part": part}
        found = self.journal.rows(point)
        if found is None:
            self.progress(part, 0, 0)
            found = self.journal.keep(point, plain(make()))
        return found


def _punch_line(folder: Path, made: dict[int, Finished]) -> Html:
    numbers = {number: finished.numbers for number, finished in made.items()}
    picture = save_figure(shares(numbers), folder / "contact-shares.svg")
    return sections.punch_line(numbers, folder / "table10" / "close-up.svg", picture)


def _no_contact(across: _Across) -> Html:
    files = [across.folder / name for name in ("no-contact-error.svg", "no-contact-in-time.svg")]

    def make() -> list[dict[str, Any]]:
        curves = error_curves(across.reading)
        for file, draw in zip(files, (whole, in_time), strict=True):
            save_figure(draw(curves), file)
        return [{"name": c.name, "error": float(np.max(c.error)), "in_time": float(np.max(c.in_time))} for c in curves]

    rows = across.rows("section 5.1", make)
    if not all(file.is_file() for file in files):
        make()
    return sections.no_contact(files, {row["name"]: row for row in rows})
