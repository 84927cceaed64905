"""``stiffbeam reproduce``: the paper's tables and figures, judged, as one page."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

What = Annotated[str, typer.Argument(help="all, table N or figure N")]
Number = Annotated[int | None, typer.Argument(help="1 .. 17", show_default=False)]
Out = Annotated[Path, typer.Option(help="folder for the page, the pictures and the store")]
Contact = Annotated[str, typer.Option(help="implicit, or extrapolated as the paper describes it")]
Printed = Annotated[bool, typer.Option("--printed", help="HHT and SDIRK with the paper's misprints")]
References = Annotated[Path | None, typer.Option(help="folder of frozen references; default: ./reference if there")]
Jobs = Annotated[int | None, typer.Option(help="processes; default: one per core")]
Json = Annotated[Path | None, typer.Option("--json", help="write the numbers here, - for stdout")]


def register(app: typer.Typer, progress: Callable) -> None:
    """Add the command to ``app``; ``progress`` is its progress display."""

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
        """Remake Dumont (2002): tables, figures, claims and misprints on one page."""
        from .reproduce.everything import reproduce as remake
        from .reproduce.reading import reading

        tables = _tables(what, number)
        _check(out, jobs, json_file)
        chosen = reading(contact, printed, references)
        with progress() as shown:
            cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
            page, made = remake(tables, chosen, out, jobs or cores, progress=shown, command=_command())
        written = [page]
        if what == "figure":
            drawn = out / chosen.name / f"table{number}" / f"figure{number}.png"
            written.insert(0, Path(shutil.copy2(drawn, out)))
        records = {f"table{n}": finished.numbers for n, finished in made.items()}
        text = json.dumps(records, indent=2, ensure_ascii=False) + "\n"
        if json_file is not None and str(json_file) == "-":
            print(text, end="")
            return
        if json_file is not None:
            json_file.parent.mkdir(parents=True, exist_ok=True)
            json_file.write_text(text, encoding="utf-8")
        _print(records)
        print("Written: " + ", ".join(str(file) for file in written))
        if any(record["failures"] for record in records.values()):
            raise typer.Exit(1)


def _tables(what: str, number: int | None) -> list[int] | None:
    from .validation import InputError

    if what == "all" and number is None:
        return None
    if what not in ("table", "figure") or number is None:
        given = what if number is None else f"{what} {number}"
        raise InputError("reproduce", given, "be all, table N or figure N", "for example: stiffbeam reproduce table 10")
    return [number]


def _check(out: Path, jobs: int | None, json_file: Path | None) -> None:
    from .validation import InputError

    if jobs is not None and jobs < 1:
        raise InputError("--jobs", jobs, "be >= 1")
    if json_file is not None and json_file.is_dir():
        raise InputError("--json", str(json_file), "be a file, or - for the terminal")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("--out", str(out), "be a folder that can be written to", str(error)) from None


def _command() -> str:
    """The command as it was typed, but for the place of the program."""
    return shlex.join(["stiffbeam", *sys.argv[1:]])


def _print(records: dict) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from .report import WIDTH, percent

    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("table", "motion", "impacts", "contact", "horizon"):
        table.add_column(heading, justify="left" if heading in ("table", "motion") else "right")
    for name, found in records.items():
        for equation, row in found["runs"].items():
            table.add_row(name, f"{equation} {row['scheme']}", str(row["impacts"]), percent(row["fraction"]), "")
        for form, row in found["true"].items():
            table.add_row(name, f"true, {form}", str(row["impacts"]), percent(row["fraction"]), f"{row['horizon']:.3g}")
        for equation, why in found["failures"].items():
            table.add_row(name, f"{equation} failed: {why}", "", "", "")
    Console(width=None if sys.stdout.isatty() else WIDTH).print(table)
