"""Reproduce Dumont (2002): tables, figures, claims and misprints on one page.

In the folder studies/ of a checkout:

    python -m dumont2002 table 10
    python -m dumont2002 figure 17 --out figures
    python -m dumont2002 all

Finished tables are read from the output folder by the next run.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

import stiffbeam as sb
from stiffbeam.basics.storage import write_whole
from stiffbeam.basics.validation import integer

from .page import measures
from .reproduce import reproduce
from .table import Reading

OUT = Path(__file__).parents[2] / "stiffbeam-output" / "reproduction"
SHOWN = ("motion", "impacts", "paper's", "contact, %", "horizon")  # of the columns of a table, in a terminal


def main(words: Sequence[str] | None = None) -> int:
    """Write the page and the pictures; return 0, 1 if a run failed, 2 for bad input."""
    parser = argparse.ArgumentParser(
        "python -m dumont2002", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="?", default="all", help="all, table or figure")
    parser.add_argument("number", nargs="?", type=int, help="of the table or figure, 1 to 17")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for the page, pictures and finished tables")
    parser.add_argument("--contact", default="implicit", help="implicit, or extrapolated as the paper describes it")
    parser.add_argument("--printed", action="store_true", help="HHT and SDIRK with the paper's misprints")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--json", type=Path, help="file for all numbers")
    given = parser.parse_args(words)
    try:
        integer("--jobs", given.jobs, 1)
        if given.what not in ("all", "table", "figure") or (given.what == "all") != (given.number is None):
            asked = given.what if given.number is None else f"{given.what} {given.number}"
            example = "for example: python -m dumont2002 table 10"
            raise sb.InputError("selection", asked, "be all, table N or figure N", example)
        tables = None if given.number is None else [given.number]
        typed = shlex.join(["python", "-m", "dumont2002", *(sys.argv[1:] if words is None else words)])
        reading = Reading(given.contact, given.printed)
        page, parts = reproduce(tables, reading, given.out, given.jobs, command=typed)
    except sb.InputError as error:
        print(error, file=sys.stderr)
        return 2
    written = [page]
    for number, part in parts.items() if given.what == "figure" else ():
        drawn = base64.b64decode(part["pictures"]["figure"])
        written.append(write_whole(given.out / f"figure{number}.png", drawn))
    numbers = {number: part["numbers"] for number, part in parts.items()}
    if given.json is not None:
        records = {f"table{number}": found for number, found in numbers.items()}
        written.append(write_whole(given.json, json.dumps({"tables": records}, indent=1) + "\n"))
    for number, found in numbers.items():
        print(f"Table {number}")
        print(measures(number, found).filter(SHOWN).to_string(index=False))
        for equation, why in found["failures"].items():
            print(f"{equation} failed: {why}")
    print("One run each; impacts of the exact motion are counted by events.")
    print("Written: " + ", ".join(str(file) for file in written))
    return int(any(found["failures"] for found in numbers.values()))


if __name__ == "__main__":
    sys.exit(main())
