"""``stiffbeam advise``, the scheme and time step for a given error; ``stiffbeam doubt``, how sure results are."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ..basics.resources import TALK, progress
from ..basics.validation import InputError
from .application import Case, Dt, Form, Json, TEnd, app, option
from .output import check_json, default_folder, make_folder, say, write_json


@app.command()
def advise(
    case: Case,
    want: Annotated[
        str | None, option("admissible errors of tip, impacts, peak_force, impulse, normal_work; default: tip=1e-3,...")
    ] = None,
    schemes: Annotated[str | None, option("comma-separated; default: all", "schemes")] = None,
    form: Form = None,
    t_end: TEnd = None,
    most_steps: Annotated[int | None, option("most steps of a run; the search ends there")] = None,
    members: Annotated[int, option("perturbed runs per mean, past the horizon")] = 48,
    out: Annotated[Path | None, option("folder for the journal; default: stiffbeam-output/CASE")] = None,
    json_file: Json = None,
) -> None:
    """Find the cheapest scheme, contact treatment and time step for given errors, and the errors that no step reaches.

    For a case with a table case.uncertain it also ranks scheme, mesh and data as sources of uncertainty of the advised
    run. The advice itself stands on stderr before that.

    After every refinement a line on stderr says the least errors so far; a search that was stopped goes on.
    """
    from ..files.cases import find_case
    from ..schemes.labels import parse_run, split_runs
    from ..studies.advice import advise as find
    from ..studies.runner import Journal

    chosen = find_case(case)
    wanted: dict[str, float] | None = None if want is None else {}
    for item in filter(None, (want or "").split(",")):
        name, _, value = (part.strip() for part in item.partition("="))
        try:
            wanted[name] = float(value)  # type: ignore[index]
        except ValueError:
            raise InputError("--want", item, "read quantity=error", "for example tip=1e-3") from None
    parsed = None if schemes is None else [parse_run(text)[0] for text in split_runs(schemes)]
    check_json(json_file)
    if form is not None and form != chosen.forms[0] and chosen.uncertain:
        remedy = f"use {chosen.forms[0]}, or stiffbeam doubt"
        raise InputError("--form", form, "be the case's first to rank its uncertainties", remedy)
    system = chosen if chosen.uncertain else chosen.system(form)
    end = chosen.t_end if t_end is None else t_end
    folder = make_folder(out if out is not None else default_folder(chosen.name))

    def tell(line: str) -> None:
        if not TALK.quiet:
            print(line, file=sys.stderr, flush=True)

    with progress() as show, Journal(folder / "journal", "advise", chosen) as journal:
        advice = find(
            system, wanted, end, parsed, most_steps=most_steps, members=members, progress=show, tell=tell,
            journal=journal,
        )  # fmt: skip
    if not write_json("advise", {"case": chosen.name} | advice.to_dict(), json_file):
        say(str(advice))
    if advice.recommendation is None:
        raise typer.Exit(1)


@app.command()
def doubt(
    case: Case,
    uncertain: Annotated[str | None, option("path=tolerance,..., relative; default: those of the case file")] = None,
    scheme: Annotated[str | None, option("scheme to examine; default: the case's first", "schemes")] = None,
    dt: Dt = None,
    members: Annotated[int, option("number of random systems, each solved on two meshes, at least 8")] = 48,
    seed: Annotated[int, option("seed of the random systems")] = 1,
    tolerance: Annotated[float, option("for the data horizon, relative to the largest |u|")] = 0.05,
    json_file: Json = None,
) -> None:
    """Contributions of rounding, scheme, mesh and data to the uncertainty of every quantity, and the largest of the
    four.

    The tolerances are those of the case file, in its table case.uncertain. For matrices the table case.finer holds a
    finer model.
    """
    from ..files.cases import find_case
    from ..schemes.labels import parse_run
    from ..studies.doubt import doubt as find

    chosen = find_case(case)
    if uncertain is not None:
        chosen = replace(chosen, uncertain=dict(map(_tolerance, uncertain.split(","))))
    check_json(json_file)
    parsed = None if scheme is None else parse_run(scheme)[0]
    with progress() as show:
        result = find(chosen, parsed, dt, members, seed, tolerance, progress=show)
    if not write_json("doubt", {"case": chosen.name} | result.to_dict(), json_file):
        say(str(result))


def _tolerance(item: str) -> tuple[str, Any]:
    """Path and distribution of "path=tolerance"."""
    from ..model.uncertain import Uncertain

    path, _, value = (part.strip() for part in item.rpartition("="))
    try:
        return path, Uncertain(tolerance=float(value))
    except ValueError:
        raise InputError("--uncertain", item, "read path=tolerance", "for example stiffness=0.01") from None
