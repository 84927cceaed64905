"""Everything of the paper: the tables, what is measured across them, and the page."""

from __future__ import annotations

import base64
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from joblib import Parallel, delayed

from stiffbeam.basics.storage import source_hash
from stiffbeam.basics.validation import InputError
from stiffbeam.files.cases import paper_case
from stiffbeam.studies.base import Store

from . import misprints, no_contact
from .claims import Evidence, judged
from .costs import costs
from .figures import close_up, picture, shares
from .numbers import EXACT_MEMBERS, MEMBERS, Numbers, numbers_of
from .page import write_page
from .table import Reading, make_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HERE = Path(__file__).parent
TABLES = tuple(range(1, 18))
# The longest first, so that no process is left alone with one of them.
LONGEST_FIRST = (1, 3, 4, 11, 8, 12, 7, 9, 5, 13, 16, 15, 6, 2, 10, 14, 17)


def reproduce(
    tables: Sequence[int] | None,
    reading: Reading,
    out: Path,
    jobs: int = 2,
    members: tuple[int, int] = (MEMBERS, EXACT_MEMBERS),
    command: str = "python -m dumont2002",
) -> tuple[Path, dict[int, dict[str, Any]]]:
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
            raise InputError("table", number, f"be one of the paper's, {TABLES[0]} to {TABLES[-1]}", remedy)
    store = Store(out / "finished", [asdict(reading), members, source_hash(), source_hash(HERE)])
    order = [number for number in LONGEST_FIRST if number in wanted]
    work = (delayed(finished)(store, f"table {n}", table_part, n, reading, members) for n in order)
    made: dict[int, dict[str, Any]] = {}
    parts: Any = Parallel(min(jobs, len(order)), return_as="generator")(work)
    for number, part in zip(order, parts, strict=True):
        made[number] = part
        print(f"table {number} done, {len(made)} of {len(order)}", file=sys.stderr)
    made = {number: made[number] for number in wanted}
    across = across_tables(store, {n: part["numbers"] for n, part in made.items()}, reading) if tables is None else {}
    return write_page(out / "index.html", made, reading, command, across), made


def finished(store: Store, name: str, make: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
    """A part from the store, else from ``make(*arguments)``."""
    return store.rows({"part": name}, lambda: [make(*arguments)])[0]


def table_part(number: int, reading: Reading, members: tuple[int, int]) -> dict[str, Any]:
    """Numbers and pictures of one table."""
    made = make_table(paper_case(number), reading)
    pictures = {"figure": encoded(picture(made))}
    if number == 10:
        pictures["close-up"] = encoded(close_up(made))
    return {"numbers": numbers_of(made, *members), "pictures": pictures}


def across_tables(store: Store, numbers: dict[int, Numbers], reading: Reading) -> dict[str, Any]:
    """Claims, costs, misprints, Section 5.1 and the shares of contact: measured of all tables together."""
    timed = finished(store, "costs", lambda: {"rows": costs(TABLES, reading)})["rows"]
    evidence = Evidence(numbers, timed, reading)
    return {
        "costs": timed,
        "claims": finished(store, "claims", lambda: {"rows": list(judged(evidence))})["rows"],
        "misprints": finished(store, "misprints", lambda: {"rows": list(misprints.measured())})["rows"],
        "without_contact": finished(store, "section 5.1", section_5_1, reading),
        "shares": encoded(shares(numbers)),
    }


def section_5_1(reading: Reading) -> dict[str, Any]:
    """Largest errors without contact, and their picture."""
    curves = no_contact.error_curves(reading)
    rows = [
        {"curve": c.name, "largest error": float(np.max(c.error)), "of it the scheme's": float(np.max(c.in_time))}
        for c in curves
    ]
    return {"rows": rows, "picture": encoded(no_contact.picture(curves))}


def encoded(figure: Figure) -> str:
    """A picture as PNG in base64; a palette makes a quarter of the size, and twenty of them go into one page."""
    from PIL import Image

    content, small = BytesIO(), BytesIO()
    figure.savefig(content, format="png", dpi=150)
    Image.open(content).convert("RGB").quantize(48).save(small, format="png", optimize=True)
    return base64.b64encode(small.getvalue()).decode()
