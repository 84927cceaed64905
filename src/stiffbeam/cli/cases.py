"""``stiffbeam cases``: what can be run."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from .application import app


@app.command()
def cases(
    show: Annotated[str | None, typer.Option(help="print one case as TOML, a start for your own file")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="for programs")] = False,
) -> None:
    """List the paper's cases."""
    from ..files.cases import case_text, paper_cases

    if show is not None:
        print(case_text(show).rstrip())
        return
    listed = paper_cases().values()
    if as_json:
        rows = [
            {
                "name": c.name, "title": c.title, "cells": c.cells, "dt": c.dt, "t_end": c.t_end,
                "runs": [f"{scheme}@{form}" for scheme, form in c.runs],
                "published": c.published, "inferred": list(c.notes),
            }
            for c in listed
        ]  # fmt: skip
        print(json.dumps(rows, indent=2))
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("case", "title", "cells", "dt", "t_end", "runs"):
        table.add_column(heading, no_wrap=heading == "case", overflow="fold")
    for c in listed:
        runs = "\n".join(f"{scheme}@{form}" for scheme, form in c.runs)
        table.add_row(c.name, c.title, str(c.cells), f"{c.dt:g}", f"{c.t_end:g}", runs)
    Console().print(table)
    print("All are non-dimensional.")
    print("t_end and other inferred values carry their reason in `stiffbeam cases --show NAME`.")
