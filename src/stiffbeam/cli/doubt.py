"""``stiffbeam doubt``: contributions of rounding, scheme, mesh and data to the uncertainty."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import typer

from ..basics.progress import progress
from . import completion
from .application import app
from .options import Case, Json
from .output import check_json, say, write_json


@app.command()
def doubt(
    case: Case,
    uncertain: Annotated[
        str | None, typer.Option(help="path=tolerance,..., relative; default: those of the case file")
    ] = None,
    scheme: Annotated[
        str | None,
        typer.Option(help="scheme to examine; default: the case's first", autocompletion=completion.schemes),
    ] = None,
    dt: Annotated[float | None, typer.Option(help="time step, instead of the case's")] = None,
    members: Annotated[int, typer.Option(help="number of random systems, each solved on two meshes")] = 48,
    seed: Annotated[int, typer.Option(help="seed of the random systems")] = 1,
    tolerance: Annotated[float, typer.Option(help="for the data horizon, relative to the largest |u|")] = 0.05,
    json_file: Json = None,
) -> None:
    """Contributions of rounding, scheme, mesh and data to the uncertainty of every quantity, and the largest of the
    four.

    The tolerances are those of the case file, under [case.uncertain].
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
    from ..basics.validation import InputError
    from ..model.uncertain import Uncertain

    path, _, value = (part.strip() for part in item.rpartition("="))
    try:
        return path, Uncertain(tolerance=float(value))
    except ValueError:
        raise InputError("--uncertain", item, "read path=tolerance", "for example stiffness=0.01") from None
