"""Everything of the paper: the tables, what is measured across them, and the page."""

from __future__ import annotations

import base64
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from PIL import Image

import stiffbeam as sb
from stiffbeam.basics.storage import source_hash
from stiffbeam.figures.chart import Figure
from stiffbeam.studies.base import Store

from . import misprints, no_contact
from .claims import Evidence, judged
from .costs import costs
from .figures import close_up, picture, shares
from .numbers import EXACT_MEMBERS, MEMBERS, Numbers, numbers_of
from .page import write_page
from .table import Reading, make_table

TABLES = tuple(range(1, 18))
Part = dict[str, Any]


def reproduce(
    tables: Sequence[int] | None,
    reading: Reading,
    out: Path,
    jobs: int = 2,
    members: tuple[int, int] = (MEMBERS, EXACT_MEMBERS),
    command: str = "python -m dumont2002",
) -> tuple[Path, dict[int, Part]]:
    """Make ``tables``, None for all of them and everything else of the paper.

    Finished parts stand in ``out`` and are taken from there by the next call. The claims need every table.

    Parameters
    ----------
    members : tuple of int
        Size of an ensemble of a run and of an exact motion.

    Returns
    -------
    page : Path
    parts : dict
        ``{"numbers": see numbers_of, "pictures": {name: PNG in base64}}`` by table.

    Raises
    ------
    InputError
        For a table that the paper does not have.
    """
    wanted = TABLES if tables is None else tables
    for number in wanted:
        if number not in TABLES:
            remedy = "`stiffbeam cases` lists them"
            raise sb.InputError("table", number, f"be one of the paper's, {TABLES[0]} to {TABLES[-1]}", remedy)
    store = Store(out / "finished", [asdict(reading), members, source_hash(), source_hash(Path(__file__).parent)])
    work = (delayed(finished)(store, f"table {n}", table_part, n, reading, members) for n in wanted)
    parts: Any = Parallel(min(jobs, len(wanted)), return_as="generator")(work)
    made = dict[int, Part]()
    for number, part in zip(wanted, parts, strict=True):
        made[number] = part
        print(f"table {number} done, {len(made)} of {len(wanted)}", file=sys.stderr)
    across: Part = {}
    if tables is None:
        numbers = {number: part["numbers"] for number, part in made.items()}
        across = finished(store, "all tables", across_tables, numbers, reading)
    return write_page(out / "index.html", made, reading, command, across), made


def finished(store: Store, name: str, make: Callable[..., Part], *arguments: Any) -> Part:
    """A part from the store, else from ``make(*arguments)``."""
    return store.rows({"part": name}, lambda: [make(*arguments)])[0]


def table_part(number: int, reading: Reading, members: tuple[int, int]) -> Part:
    """Numbers and pictures of one table."""
    table = make_table(sb.paper_case(number), reading)
    pictures = {"figure": encoded(picture(table))}
    if number == 10:
        pictures["close-up"] = encoded(close_up(table))
    return {"numbers": numbers_of(table, *members), "pictures": pictures}


def across_tables(numbers: dict[int, Numbers], reading: Reading) -> Part:
    """Claims, costs, misprints, Section 5.1 and the shares of contact: measured of all tables together."""
    curves, timed = no_contact.error_curves(reading), costs(reading)
    errors = [
        {"curve": name, "largest error": float(np.max(whole)), "of it the scheme's": float(np.max(in_time))}
        for name, (whole, in_time) in curves.items()
    ]
    return {
        "costs": timed, "errors": errors, "claims": list(judged(Evidence(numbers, timed, errors, reading))),
        "misprints": list(misprints.measured()),
        "pictures": {"shares": encoded(shares(numbers)), "without contact": encoded(no_contact.picture(curves))},
    }  # fmt: skip


def encoded(figure: Figure) -> str:
    """A picture as PNG in base64; a palette makes a quarter of the size, and twenty of them go into one page."""
    content, small = BytesIO(), BytesIO()
    figure.savefig(content, format="png", dpi=150)
    Image.open(content).convert("RGB").quantize(48, Image.Quantize.MAXCOVERAGE).save(small, format="png", optimize=True)
    return base64.b64encode(small.getvalue()).decode()
