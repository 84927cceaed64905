"""``stiffbeam animate``: a film of the schemes beside the exact motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..basics.progress import progress
from . import completion
from .application import app
from .options import Case, Dt, Json, TEnd
from .output import check_json, default_folder, say, write_json


@app.command()
def animate(
    case: Case,
    schemes: Annotated[
        str | None,
        typer.Option(help="comma-separated; default: the case's first run", autocompletion=completion.schemes),
    ] = None,
    dt: Dt = None,
    t_end: TEnd = None,
    seconds: Annotated[float, typer.Option(help="length of the film")] = 8.0,
    out: Annotated[Path | None, typer.Option(help=".gif or .mp4; default: stiffbeam-output/CASE/animation.gif")] = None,
    json_file: Json = None,
) -> None:
    """Film of the beam between its stops: schemes beside the exact motion, with a flash at each impact."""
    from ..basics.validation import InputError
    from ..figures.animation import animate as film
    from ..files.cases import find_case
    from ..march.integrate import integrate
    from ..references import best_reference
    from ..schemes.labels import parse_run, split_runs
    from ..trajectory.trajectory import Trajectory

    check_json(json_file)
    chosen = find_case(case)
    form = chosen.forms[0]
    runs = [chosen.runs[0]] if schemes is None else [parse_run(text, form) for text in split_runs(schemes)]
    if len({form for _, form in runs}) != 1:
        remedy = "name the form behind each scheme, as in hht@displacement"
        raise InputError("--schemes", schemes, "be of one form: the film shows one system", remedy)
    system, end = chosen.system(runs[0][1]), chosen.t_end if t_end is None else t_end
    file = out if out is not None else default_folder(chosen.name) / "animation.gif"
    with progress() as show:
        show("reference", 0, 0)
        motions: list[Trajectory] = [best_reference(system, end, progress=show)]
        for scheme, _ in runs:
            show(str(scheme), 0, 0)
            motions.append(integrate(system, scheme, chosen.dt if dt is None else dt, end))
        film(motions, file, seconds, show=show)
    records = {"case": chosen.name, "motions": [motion.label for motion in motions], "t_end": end, "file": str(file)}
    if not write_json("animate", records, json_file):
        say(f"Written: {file}")
