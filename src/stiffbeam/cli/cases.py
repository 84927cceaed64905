"""``stiffbeam cases``: list the cases."""

from __future__ import annotations

from typing import Annotated

import typer

from .application import app
from .options import Json
from .output import check_json, console, say, write_json


@app.command()
def cases(
    show: Annotated[str | None, typer.Option(help="print one case as TOML, as a start for your own file")] = None,
    json_file: Json = None,
) -> None:
    """List the paper's cases."""
    from ..files.cases import case_text, paper_cases

    check_json(json_file)
    if show is not None:
        say(case_text(show).rstrip())
        return
    listed = paper_cases().values()
    rows = [
        {
            "name": c.name, "title": c.title, "cells": c.cells, "dt": c.dt, "t_end": c.t_end,
            "runs": [f"{scheme}@{form}" for scheme, form in c.runs],
            "published": c.published, "inferred": list(c.notes),
        }
        for c in listed
    ]  # fmt: skip
    if write_json("cases", {"cases": rows}, json_file):
        return
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("case", "title", "cells", "dt", "t_end", "runs"):
        table.add_column(heading, no_wrap=heading == "case", overflow="fold")
    for c in listed:
        runs = "\n".join(f"{scheme}@{form}" for scheme, form in c.runs)
        table.add_row(c.name, c.title, str(c.cells), f"{c.dt:g}", f"{c.t_end:g}", runs)
    console().print(table)
    say("All are non-dimensional.")
    say("t_end and other inferred values carry their reason in `stiffbeam cases --show NAME`.")
