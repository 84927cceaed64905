"""``stiffbeam studies``: every study on one case."""

from __future__ import annotations

import sys
from typing import Any

import typer

from ..basics.progress import progress
from .application import Out, Smoke, app, print_records, run_one, takes
from .options import Case, Jobs, Json, References
from .output import check_json, write_json


@app.command()
def studies(
    case: Case = "table10",
    out: Out = None,
    references: References = None,
    jobs: Jobs = None,
    smoke: Smoke = False,
    json_file: Json = None,
) -> None:
    """Run every study on one case; a second run continues where the first was stopped."""
    from ..basics.validation import InputError
    from ..files.cases import find_case
    from ..studies import STUDIES, find_study

    check_json(json_file)
    chosen, empty = find_case(case), False
    asked: list[dict[str, Any]] = []
    for name in STUDIES:
        study = find_study(name)
        named = {"references": str(references)} if references is not None and takes(study, "references") else {}
        try:
            with progress() as show:
                records, written = run_one(study, chosen, out, jobs, named, smoke, show)
        except InputError as error:  # a study that this case cannot be asked, which is no failure
            print(f"{study.command}: not asked, {error}", file=sys.stderr)
            continue
        asked.append(records.to_dict())
        if str(json_file) != "-":
            print_records(records, written)
        empty = empty or bool(records.failures and not written)
    write_json("studies", {"case": chosen.name, "studies": asked}, json_file)
    if empty:
        raise typer.Exit(1)
