"""``stiffbeam reproduce``: the paper's tables and figures, judged, as one page."""

from __future__ import annotations

import importlib
import shlex
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from ..basics.progress import progress
from ..basics.validation import InputError, integer
from .application import app
from .options import Jobs, Json, References, option
from .output import check_json, console, make_folder, say, table_of, write_json

What = Annotated[str, typer.Argument(help="all, table N or figure N")]
Number = Annotated[int | None, typer.Argument(help="1 .. 17", show_default=False)]
Out = Annotated[Path, option("folder for the page, the pictures and the store")]
Contact = Annotated[str, option("implicit, or extrapolated as the paper describes it")]
Printed = Annotated[bool, typer.Option("--printed", help="HHT and SDIRK with the paper's misprints")]


@app.command()
def reproduce(
    what: What = "all",
    number: Number = None,
    out: Out = Path("stiffbeam-output/reproduction"),
    contact: Contact = "implicit",
    printed: Printed = False,
    references: References = None,
    jobs: Jobs = None,
    json_file: Json = None,
) -> None:
    """Reproduce Dumont (2002) in a checkout: tables, figures, claims and misprints on one page."""
    from ..basics.resources import cores

    tables = _tables(what, number)
    paper = _paper()
    if jobs is not None:
        integer("--jobs", jobs, 1)
    check_json(json_file)
    make_folder(out)
    chosen = paper.reading(contact, printed, references)
    with progress() as show:
        typed = shlex.join(["stiffbeam", *sys.argv[1:]])  # without the folder of the program
        page, results = paper.reproduce(tables, chosen, out, jobs or cores(), progress=show, command=typed)
    written = [page]
    if what == "figure":
        drawn = out / chosen.name / f"table{number}" / f"figure{number}.png"
        written.insert(0, Path(shutil.copy2(drawn, out)))
    records = {f"table{n}": finished.numbers for n, finished in results.items()}
    if not write_json("reproduce", {"tables": records}, json_file):
        _print(records, paper.exact_name)
        say("Written: " + ", ".join(str(file) for file in written))
    if any(record["failures"] for record in records.values()):
        raise typer.Exit(1)


def _paper() -> Any:
    """The package ``studies/dumont2002`` of the checkout that this package runs from.

    Its processes find it by the path as well. InputError where an installed package has no checkout around it.
    """
    package = Path(__file__).parents[1]
    studies = package.parents[1] / "studies"
    if not (studies / "dumont2002" / "__init__.py").is_file():
        rule = "run from a checkout, whose studies/dumont2002 makes the paper's page"
        raise InputError("reproduce", str(package), rule, "in a checkout, pip install -e . and repeat it")
    if str(studies) not in sys.path:
        sys.path.append(str(studies))  # at the end: site.py there is not Python's
    return importlib.import_module("dumont2002.reproduce")


def _tables(what: str, number: int | None) -> list[int] | None:
    if what == "all" and number is None:
        return None
    if what not in ("table", "figure") or number is None:
        words = what if number is None else f"{what} {number}"
        raise InputError("reproduce", words, "be all, table N or figure N", "for example: stiffbeam reproduce table 10")
    return [number]


def _print(records: dict[str, Any], exact_name: Callable[[str, dict[str, Any]], str]) -> None:
    from ..measures.report import WIDTH, percent

    lines: list[dict[str, str]] = []
    for name, record in records.items():
        motions = {f"{equation} {row['scheme']}": row for equation, row in record["runs"].items()}
        motions |= {exact_name(form, row): row for form, row in record["exact"].items()}
        for motion, row in motions.items():
            line = {
                "table": name,
                "motion": motion,
                "impacts": str(row["impacts"]),
                "contact": percent(row["fraction"]),
            }
            lines.append(line | ({"horizon": f"{row['horizon']:.3g}"} if "horizon" in row else {}))
        lines += [{"table": name, "motion": f"{eq} failed: {why}"} for eq, why in record["failures"].items()]
    console(WIDTH).print(table_of(lines))
    say("One run each; impacts of the exact motion are counted by events.")
