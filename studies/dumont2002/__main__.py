"""Reproduce Dumont (2002): tables, figures, claims and misprints on one page.

In the folder studies/ of a checkout:

    python -m dumont2002 table 10
    python -m dumont2002 figure 17 --out figures
    python -m dumont2002 all

Finished tables are read from the output folder by the next run.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from stiffbeam.basics.validation import InputError, integer
from stiffbeam.files.cases import paper_case
from stiffbeam.measures.report import percent, short

from .numbers import exact_name
from .reading import reading
from .reproduce import reproduce

OUT = Path(__file__).parents[2] / "stiffbeam-output" / "reproduction"


def main(words: Sequence[str] | None = None) -> int:
    """Write the page and the pictures; return 0, 1 if a run failed, 2 for bad input."""
    given = _parser().parse_args(words)
    try:
        integer("--jobs", given.jobs, 1)
        chosen = reading(given.contact, given.printed, given.references)
        tables = _tables(given.what, given.number)
        typed = shlex.join(["python", "-m", "dumont2002", *(sys.argv[1:] if words is None else words)])
        page, results = reproduce(tables, chosen, given.out, given.jobs, command=typed)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    written = [page]
    if given.what == "figure":
        drawn = given.out / chosen.name / f"table{given.number}" / f"figure{given.number}.png"
        written.insert(0, Path(shutil.copy2(drawn, given.out)))
    records = {f"table{n}": finished.numbers for n, finished in results.items()}
    if given.json is not None:
        given.json.write_text(json.dumps({"tables": records}, indent=1) + "\n", encoding="utf-8")
    print(pd.DataFrame(_lines(records)).fillna("").to_string(index=False))
    print("One run each; impacts of the exact motion are counted by events.")
    print("Written: " + ", ".join(str(file) for file in written))
    return int(any(record["failures"] for record in records.values()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "python -m dumont2002", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="?", default="all", help="all, table or figure")
    parser.add_argument("number", nargs="?", type=int, help="of the table or figure, 1 to 17")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for the page, pictures and finished tables")
    parser.add_argument("--contact", default="implicit", help="implicit, or extrapolated as the paper describes it")
    parser.add_argument("--printed", action="store_true", help="HHT and SDIRK with the paper's misprints")
    parser.add_argument("--references", type=Path, help="folder of frozen references (default: reference/)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--json", type=Path, help="file for all numbers")
    return parser


def _tables(what: str, number: int | None) -> list[int] | None:
    """Return the tables of a selection, None for all."""
    if what == "all" and number is None:
        return None
    if what not in ("table", "figure") or number is None:
        words = what if number is None else f"{what} {number}"
        raise InputError(
            "selection", words, "be all, table N or figure N", "for example: python -m dumont2002 table 10"
        )
    return [number]


def _lines(records: dict[str, Any]) -> list[dict[str, str]]:
    """Return one line for each run and each exact motion."""
    lines: list[dict[str, str]] = []
    for name, record in records.items():
        counts = paper_case(int(name.removeprefix("table"))).published.get("impacts", {})
        counts = {label.partition("@")[0]: f"{count:g}" for label, count in counts.items()}
        motions = {f"{equation} {short(row['scheme'])}": row for equation, row in record["runs"].items()}
        motions |= {exact_name(form, row): row for form, row in record["exact"].items()}
        for motion, row in motions.items():
            line = {
                "table": name,
                "motion": motion,
                "impacts": str(row["impacts"]),
                "contact": percent(row["fraction"]),
            }
            line |= {"paper's impacts": counts[row["scheme"]]} if row.get("scheme") in counts else {}
            lines.append(line | ({"horizon": f"{row['horizon']:.3g}"} if "horizon" in row else {}))
        lines += [{"table": name, "motion": f"{eq} failed: {why}"} for eq, why in record["failures"].items()]
    return lines


if __name__ == "__main__":
    sys.exit(main())
